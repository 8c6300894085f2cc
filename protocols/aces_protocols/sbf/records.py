"""Record types of sbf, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import sbf

__getattr__ = record_types(sbf)
