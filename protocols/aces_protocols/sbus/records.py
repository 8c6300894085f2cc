"""Record types of sbus, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import sbus

__getattr__ = record_types(sbus)
