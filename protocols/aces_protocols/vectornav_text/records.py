"""Record types of vectornav_text, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import vectornav_text

__getattr__ = record_types(vectornav_text)
