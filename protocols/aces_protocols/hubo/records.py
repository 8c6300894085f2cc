"""Record types of hubo, for `isinstance` and `match`; the stub beside tells editors their fields."""

from aces_bus.protocol import record_types

from .spec import hubo

__getattr__ = record_types(hubo)
