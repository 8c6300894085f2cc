"""Record types of vesc, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import vesc

__getattr__ = record_types(vesc)
