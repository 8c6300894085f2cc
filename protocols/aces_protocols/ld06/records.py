"""Record types of ld06, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import ld06

__getattr__ = record_types(ld06)
