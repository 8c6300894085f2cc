"""Record types of pololu_qik, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import pololu_qik

__getattr__ = record_types(pololu_qik)
