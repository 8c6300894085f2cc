"""LDROBOT's LD06, LD19, STL19P and LD14P: rounds of distances, and the nearest of each.

1. The scanner sends from power-up on and is not asked. Its motor is turned by itself (LD06: 10 Hz, or by a PWM pin), or by
   commands (LD14P), which are sent only where `rounds_hz` is set.
2. The points of a packet are spread evenly between its two angles. A round in which a packet is missing is dropped.
3. What is measured moves nothing: a stop has nothing to do.

Source: LDROBOT, LD06 LiDAR Development Manual, chapters 3 and 4; motor commands of the LD14P as lds2d 0.7.0 has them.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import msgspec
from msgspec import Meta

from aces_bus.device import Driver, Ticket
from aces_bus.device.settings import described, settings_of

from ..laser import LaserScanner, Point
from .twin import Ld06Twin

#: How long values of a round are fresh: the slowest LD14P turns at 2 Hz (s).
STALE_S = 1.5
#: How far the motor turns from a packet's last point to the next one's first, at most, in steps of points: usually one.
MOST_STEPS = 3.0


class Ld06Settings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    rounds_hz: (
        Annotated[
            float,
            Meta(
                ge=2,
                le=8,
                description="LD14P: turn so fast, 2 … 8 Hz; absent: no command is sent (LD06, LD19)",
            ),
        ]
        | None
    ) = None


class Ld06(LaserScanner):
    """Signals of a round: nearest (m), nearest_angle (rad), points, rate (Hz)."""

    protocol = "ld06"
    actions: ClassVar = {"scan": "turn, and measure (LD14P)", "pause": "stand still (LD14P)"}
    attributes: ClassVar = LaserScanner.attributes | {"is_wanted"}

    def setup(self) -> None:
        """Add the signals of a round."""
        self.settings = settings_of(self.name, Ld06Settings, self.config.settings)
        self.is_wanted = True
        self._last: float | None = None
        self.add_round("Measurements", STALE_S, "LD06 manual, chapter 3")

    @property
    def sends_every_s(self) -> float | None:
        """Time of a round; None while it is paused."""
        return 0.1 if self.is_wanted else None

    def start(self) -> Ticket | None:
        """Turn the motor, where that is the driver's affair."""
        return None if self.settings.rounds_hz is None else self.scan()

    def received(self, record: Any, instant: int) -> None:
        """Spread the points of a packet over its angles."""
        if type(record).__name__ != "Measurements":
            return
        points = record.points
        first, span = record.start_angle, (record.end_angle - record.start_angle) % 360
        step = span / (len(points) - 1)
        last, self._last = self._last, record.end_angle
        if last is not None:
            turned = (first - last) % 360
            if turned > MOST_STEPS * step:
                self.drop_round()  # a packet between them was lost
            elif first < last:
                self.end_round(instant)
        for number, point in enumerate(points):
            angle = first + number * step
            if angle >= 360 > angle - step and number:
                self.end_round(instant)
            self.take_point(angle % 360, point.distance, point.intensity)

    # ------------------------------------------------------------------ actions

    def scan(self) -> Ticket:
        """Turn, and measure, until `pause`."""
        self.is_wanted = True
        if self.settings.rounds_hz is not None:
            self.send("SetSpeed", speed=round(360 * self.settings.rounds_hz))
        return self.send("Start")

    def pause(self) -> Ticket:
        """Stand still, until `scan`."""
        self.is_wanted, self._last = False, None
        self.drop_round()
        return self.send("Stop")


EXAMPLE = """
name = "ld06"
rate_hz = 20

[buses]
line = { link = "serial", protocol = "ld06", baud = 230_400 }

[devices]
LIDAR = { driver = "ld06", bus = "line" }
"""

driver = Driver(
    "ld06",
    device=Ld06,
    twin=Ld06Twin,
    example=EXAMPLE,
    doc="LDROBOT LD06, LD14P, LD19, STL19P: rounds of distances.",
    source="LDROBOT, LD06 LiDAR Development Manual",
    settings=described(Ld06Settings),
)

__all__ = ["EXAMPLE", "Ld06", "Ld06Settings", "Point", "driver"]
