"""Record types of feetech, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import feetech

__getattr__ = record_types(feetech)
