"""Record types of lx16a, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import lx16a

__getattr__ = record_types(lx16a)
