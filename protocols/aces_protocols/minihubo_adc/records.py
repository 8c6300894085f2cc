"""Record types of minihubo_adc, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import minihubo_adc

__getattr__ = record_types(minihubo_adc)
