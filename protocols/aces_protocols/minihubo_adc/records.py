"""Record types of minihubo_adc, for `isinstance` and `match`; the stub beside tells editors their fields."""

from aces_bus.protocol import record_types

from .spec import minihubo_adc

__getattr__ = record_types(minihubo_adc)
