"""Record types of robotis, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import robotis

__getattr__ = record_types(robotis)
