"""Record types of odrive, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import odrive

__getattr__ = record_types(odrive)
