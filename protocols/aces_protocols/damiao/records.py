"""Record types of damiao, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import damiao

__getattr__ = record_types(damiao)
