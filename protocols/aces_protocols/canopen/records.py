"""Record types of canopen, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import canopen

__getattr__ = record_types(canopen)
