"""Record types of dynamixel, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import dynamixel

__getattr__ = record_types(dynamixel)
