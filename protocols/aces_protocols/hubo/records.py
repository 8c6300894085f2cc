"""Record types of hubo, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import hubo

__getattr__ = record_types(hubo)
