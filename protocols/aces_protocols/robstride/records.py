"""Record types of robstride, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import robstride

__getattr__ = record_types(robstride)
