"""Record types of dronecan, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import dronecan

__getattr__ = record_types(dronecan)
