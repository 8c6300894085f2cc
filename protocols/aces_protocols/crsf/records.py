"""Record types of crsf, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import crsf

__getattr__ = record_types(crsf)
