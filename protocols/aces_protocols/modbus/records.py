"""Record types of modbus, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import modbus

__getattr__ = record_types(modbus)
