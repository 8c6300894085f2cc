"""A receiver that speaks NMEA 0183, as nearly all do.

1. GGA, or GNS, has the position; RMC only where neither comes, so that a controller sees each place once.
2. RMC has time, date, speed and course; GSA the kind of fix; GST accuracies. What is not sent stays unknown.
3. It is never asked or set: the receiver sends what it is set to, by its maker's own means.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from math import cos, hypot, radians, sin
from typing import ClassVar

from aces_bus.device import Driver, Job, Steps
from aces_bus.device.config import DeviceConfig
from aces_bus.device.host import Host
from aces_bus.device.settings import described
from aces_bus.protocol import Record

from .antenna import ReceiverTwin
from .receiver import Receiver, ReceiverSettings
from .sentences import KNOT, sentences

_FIX = ("latitude", "longitude", "altitude", "height", "quality", "satellites", "hdop")
#: Two digits of a year from here on are of the last century, when GPS began.
CENTURY = 80
#: What the twin sends in each period.
SENT = ("GGA", "RMC", "GSA", "GSV", "GST", "VTG")
#: Who looks for receivers waits so long for a sentence (ns): most send once a second.
LISTEN_NS = 2_500_000_000


class NmeaReceiver(Receiver):
    """Signals: see the README. `quality` is GGA's."""

    protocol = "nmea0183"
    messages: ClassVar = {
        "GGA": _FIX,
        "GNS": _FIX[:4] + _FIX[5:],
        "RMC": ("latitude", "longitude", "speed", "course", "velocity_north", "velocity_east", "time"),
        "GSA": ("fix", "pdop", "hdop"),
        "GST": ("horizontal_accuracy", "vertical_accuracy"),
    }

    def setup(self) -> None:
        """See `Receiver.setup`."""
        super().setup()
        self._fix_at: int | None = None

    def received(self, record: Record, instant: int) -> None:
        """Take what a sentence says."""
        match type(record).__name__:
            case "GGA" | "GNS":
                self._take_fix(record, instant)
            case "RMC":
                self._take_motion(record, instant)
            case "GSA":
                self.found(instant, fix=record.fix, pdop=_dop(record.pdop), hdop=_dop(record.hdop))
            case "GST":
                north, east = record.lat_deviation, record.lon_deviation
                across = None if north is None or east is None else hypot(north, east)
                self.found(instant, horizontal_accuracy=across, vertical_accuracy=record.alt_deviation)
            case _:
                pass

    def _take_fix(self, record: Record, instant: int) -> None:
        self._fix_at = instant
        name = type(record).__name__
        if name == "GGA":
            has_fix = record.quality not in (None, "none")
            self.found(instant, quality=record.quality)
        else:  # a letter for each system: N is none
            has_fix = bool(set(record.modes or "") - {"N"})
        self.found(instant, satellites=record.satellites, hdop=_dop(record.hdop))
        if not has_fix:
            self.lost()
            return
        altitude, separation = record.altitude, record.separation
        latitude, longitude = _angles(record)
        self.found(
            instant,
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            height=None if altitude is None or separation is None else altitude + separation,
        )

    def _take_motion(self, record: Record, instant: int) -> None:
        if record.status != "valid" or record.mode == "none":
            self.lost()
            self.found(instant, time=None)
            return
        period = 2e9 / self.settings.rate_hz
        if self._fix_at is None or instant - self._fix_at > period:
            latitude, longitude = _angles(record)
            self.found(instant, latitude=latitude, longitude=longitude)
        speed = None if record.speed is None else record.speed * KNOT
        course = None if record.course is None else radians(record.course)
        north = east = None
        if speed is not None and course is not None:
            north, east = speed * cos(course), speed * sin(course)
        self.found(
            instant,
            speed=speed,
            course=course,
            velocity_north=north,
            velocity_east=east,
            time=_instant_of(record.date, record.time),
        )


def _dop(value: float | None) -> float | None:
    """Return a dilution; receivers without a fix say 99.99."""
    return None if value is None or value >= 99 else value


def _angles(record: Record) -> tuple[float | None, float | None]:
    """Return latitude and longitude (rad) with their signs; None where a number or its letter is missing."""
    signs = {"north": 1, "east": 1, "south": -1, "west": -1}
    latitude, longitude = (
        None if value is None or sign not in signs else radians(value) * signs[sign]
        for value, sign in ((record.lat, record.lat_sign), (record.lon, record.lon_sign))
    )
    return latitude, longitude


def _instant_of(date: str | None, time: str | None) -> float | None:
    """Return ddmmyy and hhmmss.ss as seconds since 1970; None where they are not an instant.

    >>> _instant_of("150324", "101736.25"), _instant_of("060321", None), _instant_of("320321", "103607")
    (1710497856.25, None, None)
    """
    if date is None or time is None or len(date) != 6 or len(time) < 6:
        return None
    try:
        day, month, year = (int(date[at : at + 2]) for at in (0, 2, 4))
        began = datetime((1900 if year >= CENTURY else 2000) + year, month, day, tzinfo=UTC)
        passed = timedelta(hours=int(time[:2]), minutes=int(time[2:4]), seconds=float(time[4:]))
    except ValueError:
        return None
    return (began + passed).timestamp()  # a leap second, 60, is the first of the next minute


class NmeaTwin(ReceiverTwin):
    """A receiver that sends `SENT` in each period."""

    protocol = "nmea0183"

    def setup(self) -> None:
        """See `ReceiverTwin.setup`; it begins to send."""
        super().setup()
        self.every(1 / self.settings.rate_hz, self._send)

    def _send(self) -> None:
        for name, fields in sentences(self.epoch(), *SENT):
            self.reply(name, delay_ns=0, **fields)


def _scan(host: Host, job: Job) -> Steps:
    """Listen: a receiver sends by itself."""
    probe = host.probe("nmea0183")
    try:
        yield LISTEN_NS
        if probe.last_received is None:
            return []
        return [DeviceConfig(name="GNSS", driver="nmea0183", bus=host.name)]
    finally:
        host.remove(probe.name)


EXAMPLE = """
name = "nmea0183_example"
rate_hz = 20

[buses]
gnss = { link = "serial", protocol = "nmea0183", baud = 38_400 }

[devices.GNSS]
driver = "nmea0183"
bus = "gnss"
settings = { rate_hz = 2, origin = [48.0, 11.0, 520.0] }
"""

driver = Driver(
    "nmea0183",
    device=NmeaReceiver,
    twin=NmeaTwin,
    example=EXAMPLE,
    doc="A satellite receiver by its NMEA 0183 sentences: position, speed, time.",
    source="NMEA 0183, as pynmeagps has it",
    scan=_scan,
    settings=described(ReceiverSettings),
)
