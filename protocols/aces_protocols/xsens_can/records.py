"""Record types of xsens_can, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import xsens_can

__getattr__ = record_types(xsens_can)
