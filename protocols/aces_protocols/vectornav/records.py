"""Record types of vectornav, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import vectornav

__getattr__ = record_types(vectornav)
