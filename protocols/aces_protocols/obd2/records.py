"""Record types of obd2, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import obd2

__getattr__ = record_types(obd2)
