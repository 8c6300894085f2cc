"""Record types of hubovia, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import hubovia

__getattr__ = record_types(hubovia)
