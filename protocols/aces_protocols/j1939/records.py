"""Record types of j1939, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import j1939

__getattr__ = record_types(j1939)
