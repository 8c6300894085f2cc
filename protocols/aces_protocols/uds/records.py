"""Record types of uds, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import uds

__getattr__ = record_types(uds)
