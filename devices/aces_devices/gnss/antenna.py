"""A simulated receiver, whatever it speaks: where its antenna is, and what it knows of that at an instant.

1. All that a twin sends at one instant is of one `Epoch`, so that what two messages say of it agrees.
2. Nothing of the sky is computed: the satellites stand still, and accuracies are constants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from math import atan2, cos, hypot, radians, sin, tau
from typing import ClassVar

from aces_bus.device import Twin
from aces_bus.device.settings import settings_of

from .earth import Origin
from .receiver import ReceiverSettings, origin_of

#: The place (°, °, m) and instant at which simulations begin, where nothing else is said: those of the spec's example.
USUAL_PLACE = (48.0, 11.0, 520.0)
BEGIN = datetime(2024, 3, 15, 10, 17, 36, tzinfo=UTC)


@dataclass(frozen=True)
class AntennaMotion:
    """Where an antenna is from the origin (m: north, east, up), and how it moves (m/s)."""

    north: float = 0.0
    east: float = 0.0
    up: float = 0.0
    velocity_north: float = 0.0
    velocity_east: float = 0.0
    velocity_up: float = 0.0


@dataclass(frozen=True)
class SatelliteInView:
    """A simulated satellite: its number of GPS, elevation and azimuth (°), signal (dB-Hz), whether it is used."""

    number: int
    elevation: int
    azimuth: int
    signal: int
    used: bool = True


@dataclass(frozen=True)
class Epoch:
    """What a receiver knows at one instant; SI."""

    time: datetime
    #: GPS time of week (ms); leap seconds are those of 2024.
    itow_ms: int
    #: Since the receiver was switched on.
    uptime_ms: int
    has_fix: bool
    latitude: float
    longitude: float
    height: float
    altitude: float
    velocity_north: float
    velocity_east: float
    velocity_down: float
    satellites: tuple[SatelliteInView, ...]
    horizontal_accuracy: float = 0.8
    vertical_accuracy: float = 1.2
    speed_accuracy: float = 0.05
    pdop: float = 1.2
    hdop: float = 0.7
    vdop: float = 0.98

    @property
    def speed(self) -> float:
        """Over ground, m/s."""
        return hypot(self.velocity_north, self.velocity_east)

    @property
    def course(self) -> float:
        """Over ground, from north over east, rad: 0 … τ."""
        return atan2(self.velocity_east, self.velocity_north) % tau

    @property
    def used(self) -> int:
        """Number of satellites that are used."""
        return sum(satellite.used for satellite in self.satellites)


#: Height of the geoid above the ellipsoid at `USUAL_PLACE` (m).
GEOID_M = 45.0
#: GPS time is ahead of UTC by so many seconds since 2017.
LEAP_S = 18
GPS_BEGAN = datetime(1980, 1, 6, tzinfo=UTC)
#: What the antenna of a resting receiver says of itself wanders by so much (standard deviation: m, m/s).
NOISE_M, NOISE_M_S = 0.02, 0.01
SKY = tuple(
    SatelliteInView(number, elevation, azimuth, signal, used=elevation > 10)
    for number, elevation, azimuth, signal in (
        (2, 63, 137, 44),
        (5, 41, 292, 41),
        (7, 61, 98, 45),
        (9, 25, 61, 36),
        (13, 18, 229, 33),
        (15, 36, 188, 38),
        (20, 12, 317, 30),
        (30, 74, 310, 46),
        (24, 6, 20, 22),
    )
)


class ReceiverTwin(Twin):
    """A receiver whose antenna rests at the origin, or moves.

    `feed(now)` says how it moves (ns → `AntennaMotion`). Without one, `world.shared["place"]` is asked, where another twin,
    such as that of a vehicle, has put such a function.
    """

    settings_type: ClassVar[type[ReceiverSettings]] = ReceiverSettings
    faults: ClassVar = {
        "no_fix": "does not know where it is, as indoors",
        "jump": "says that it is 30 m further north (or as many m as said), and that it is sure of it",
    }
    amounts: ClassVar = {"jump": 30.0}
    feed: Callable[[int], AntennaMotion] | None = None

    def setup(self) -> None:
        """Switch the receiver on; it knows its place at once."""
        self.settings = settings_of(self.name, self.settings_type, self.config.settings)
        latitude, longitude, height = USUAL_PLACE
        self.powered_at = self.clock.now()
        #: When it is `BEGIN`: all receivers of a world have the same time.
        self.began: int = self.world.shared.setdefault("gnss began", self.powered_at)
        self.origin = origin_of(self.settings) or Origin(radians(latitude), radians(longitude), height)

    def motion(self, now: int) -> AntennaMotion:
        """Return where the antenna is, and how it moves."""
        feed = self.feed or self.world.shared.get("place")
        return AntennaMotion() if feed is None else feed(now)

    def epoch(self) -> Epoch:
        """Return what the receiver knows now."""
        now = self.clock.now()
        motion, noise = self.motion(now), self.random.gauss
        wrong = self.active_faults.get("jump", 0.0)
        latitude, longitude = self.origin.place(
            motion.north + noise(0, NOISE_M) + wrong, motion.east + noise(0, NOISE_M)
        )
        height = self.origin.height + motion.up + noise(0, NOISE_M)
        since = (BEGIN - GPS_BEGAN).total_seconds() + LEAP_S
        passed = (now - self.began) / 1e6
        has_fix = "no_fix" not in self.active_faults
        return Epoch(
            time=datetime.fromtimestamp(round(BEGIN.timestamp() * 1000 + passed) / 1000, UTC),
            itow_ms=round(since * 1000 + passed) % 604_800_000,
            uptime_ms=(now - self.powered_at) // 1_000_000,
            has_fix=has_fix,
            latitude=latitude,
            longitude=longitude,
            height=height,
            altitude=height - GEOID_M,
            velocity_north=motion.velocity_north + noise(0, NOISE_M_S),
            velocity_east=motion.velocity_east + noise(0, NOISE_M_S),
            velocity_down=-motion.velocity_up + noise(0, NOISE_M_S),
            satellites=SKY if has_fix else (),
        )


def in_circle(radius_m: float, period_s: float) -> Callable[[int], AntennaMotion]:
    """Return a motion for `feed`: a circle around the origin, from its northern point over east.

    >>> circle = in_circle(10, 60)
    >>> at = circle(15_000_000_000)
    >>> round(at.north, 6), round(at.east, 6), round(at.velocity_north, 3)
    (0.0, 10.0, -1.047)
    """
    rate = tau / period_s

    def motion(now: int) -> AntennaMotion:
        angle = rate * now / 1e9
        return AntennaMotion(
            north=radius_m * cos(angle),
            east=radius_m * sin(angle),
            velocity_north=-radius_m * rate * sin(angle),
            velocity_east=radius_m * rate * cos(angle),
        )

    return motion
