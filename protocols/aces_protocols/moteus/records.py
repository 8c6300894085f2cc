"""Record types of moteus, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import moteus

__getattr__ = record_types(moteus)
