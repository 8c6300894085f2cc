"""Record types of rmdx, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import rmdx

__getattr__ = record_types(rmdx)
