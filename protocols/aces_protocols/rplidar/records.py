"""Record types of rplidar, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import rplidar

__getattr__ = record_types(rplidar)
