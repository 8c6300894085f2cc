"""Record types of ubx, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import ubx

__getattr__ = record_types(ubx)
