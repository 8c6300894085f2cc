"""Record types of nmea0183, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import nmea0183

__getattr__ = record_types(nmea0183)
