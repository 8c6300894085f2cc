"""Record types of robotis, for `isinstance` and `match`; the stub beside tells editors their fields."""

from aces_bus.protocol import record_types

from .spec import robotis

__getattr__ = record_types(robotis)
