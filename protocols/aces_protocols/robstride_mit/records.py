"""Record types of robstride_mit, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import robstride_mit

__getattr__ = record_types(robstride_mit)
