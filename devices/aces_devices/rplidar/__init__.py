"""SLAMTEC's RPLIDAR A1 and A2: rounds of distances, and the nearest of each.

1. A scan is begun when the bus opens, and anew when measurements end; a request ends it, so nothing is polled while it runs.
2. The motor is not this driver's: DTR starts it (A1), or `motor_duty` by the accessory board (A2).
3. What is measured moves nothing: a stop has nothing to do.
4. In the dialect `express` a packet has 32 distances from one angle on; where each is, the next packet's angle says. A
   packet whose next one was lost is dropped: its angles are not known.

Source: SLAMTEC, RPLIDAR Interface Protocol (A1 & A2 rev. 1.1).
"""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated, Any, ClassVar

import msgspec
from msgspec import Meta

from aces_bus.device import Driver, Job, Steps, Ticket
from aces_bus.device.settings import described, settings_of
from aces_bus.errors import NoReplyError
from aces_bus.protocol import Record

from ..laser import LaserScanner, Point
from .twin import RplidarTwin

#: How long an answer may take (s), and how long measurements may fail to come before a scan is begun anew (ns).
ANSWER_S, BROKEN_NS = 0.5, 1_000_000_000
#: How often the scan is looked after (s), and how long values of a round are fresh: the slowest motor turns at 1 Hz (s).
AGAIN_S, STALE_S = 0.5, 2.5
#: Health is asked before each scan, as a request ends it: until the next one it is the last that is known (s).
HEALTH_STALE_S = 86_400.0
#: How much farther than before the motor turns from one express packet to the next, at most: twice as far is a lost one.
MOST_TURNED = 1.5
HEALTH = ("good", "warning", "error")


class RplidarSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    motor_duty: (
        Annotated[
            int,
            Meta(
                ge=0,
                le=1023,
                description="duty of an A2's motor, 0 … 1023 (usual: 660); absent: not sent (A1)",
            ),
        ]
        | None
    ) = None


class Rplidar(LaserScanner):
    """Signals of a round: nearest (m), nearest_angle (rad), points, rate (Hz); health: 0 good, 1 warning, 2 error.

    `round` has all points of the last whole round; `on_round` is called with it, on the bus's loop.
    """

    protocol = "rplidar"
    actions: ClassVar = {
        "info": "read model, versions and serial number; the scan is begun anew",
        "scan": "measure, until `pause`",
        "pause": "end the scan",
        "reset": "begin as switched on",
    }
    asking: ClassVar = ("info",)
    attributes: ClassVar = LaserScanner.attributes | {"is_wanted"}

    def setup(self) -> None:
        """Add the signals of a round, and the health."""
        self.settings = settings_of(self.name, RplidarSettings, self.config.settings)
        self.is_wanted = True
        self._alarms: set[str] = set()
        self._measured = -BROKEN_NS
        #: Of express scans: the packet before, and how far the motor turned from one to the next (°).
        self._before: Any = None
        self._turned: float | None = None
        self.is_express = "ExpressMeasurements" in self.variant.messages
        message = "ExpressMeasurements" if self.is_express else "Measurement"
        self.add_round(message, STALE_S, "RPLIDAR protocol, figure 4-4")
        self.add_signal(
            "health",
            read_from=["Health"],
            stale_s=HEALTH_STALE_S,
            doc="0 good, 1 warning, 2 error; asked before each scan",
            source="RPLIDAR protocol, figure 4-18",
        )

    @property
    def sends_every_s(self) -> float | None:
        """Time of a round at the usual speed of the motor; None while it is paused."""
        return 0.2 if self.is_wanted else None

    def start(self) -> Job:
        """Begin the scan, and see that it goes on."""
        return self.job("scan", self._watch)

    def _watch(self, job: Job) -> Steps:
        while True:
            if self.is_wanted and self.clock.now() - self._measured >= BROKEN_NS:
                with suppress(NoReplyError):  # that it is silent, its host says
                    yield from self._begin()
            yield round(AGAIN_S * 1e9)

    def _begin(self) -> Steps:
        """Yield steps that begin a scan, if the scanner is well."""
        yield self.send("Stop")
        if self.settings.motor_duty is not None:
            yield self.send("SetMotor", duty=self.settings.motor_duty)
        health = yield self.ask("GetHealth", reply="Health", timeout_s=ANSWER_S)
        if health is None or health.status == "error":
            return
        self._before = self._turned = None
        if self.is_express:
            yield self.ask(
                "ExpressScan", reply="ExpressStarted", timeout_s=ANSWER_S, mode=0, flags=0, parameter=0
            )
        else:
            yield self.ask("Scan", reply="ScanStarted", timeout_s=ANSWER_S)

    def received(self, record: Record, instant: int) -> None:
        """Gather the points of a round; take the health."""
        name = type(record).__name__
        if name == "Health" and record.status in HEALTH:
            self.signals[f"{self.name}.health"].update(HEALTH.index(record.status), instant)
            alarms = {record.status} - {"good"}
            self.emit_alarms(alarms, self._alarms)
            self._alarms = alarms
        if name == "ExpressMeasurements":
            self._measured = instant
            self._spread(record, instant)
        if name != "Measurement":
            return
        self._measured = instant
        if record.turn == "begins":
            self.end_round(instant)
        self.take_point(record.angle, record.distance, record.quality)

    def _spread(self, record: Any, instant: int) -> None:
        """Take the distances of the packet before, now that the next angle is known (figure 4-12)."""
        before, self._before = self._before, record
        if before is None or record.begins:
            self._turned = None
            return
        turned = (record.angle - before.angle) % 360
        usual, self._turned = self._turned, turned
        if usual is not None and turned > MOST_TURNED * usual:
            self._turned = None  # a packet between them was lost
            self.drop_round()
            return
        for number, (distance, compensation) in enumerate(
            zip(before.distances, before.compensations, strict=True)
        ):
            nominal = before.angle + turned * number / len(before.distances)
            if nominal >= 360 > nominal - turned / len(before.distances):
                self.end_round(instant)
            self.take_point((nominal - compensation) % 360, distance, 0)

    # ------------------------------------------------------------------ actions

    def info(self) -> Job:
        """Read {"model": 24, "firmware": "1.15", "hardware": 0, "serial": "64E6…"}."""

        def steps(job: Job) -> Steps:
            yield self.send("Stop")
            found = yield self.ask("GetInfo", reply="Info", timeout_s=ANSWER_S)
            self._measured = -BROKEN_NS
            return {
                "model": found.model,
                "firmware": f"{found.firmware_major}.{found.firmware_minor:02}",
                "hardware": found.hardware,
                "serial": found.serial.hex().upper(),
            }

        return self.job("info", steps)

    def scan(self) -> Job:
        """Measure, until `pause`."""
        self.is_wanted = True
        return self.job("begin scan", lambda job: self._begin())

    def pause(self) -> Ticket:
        """End the scan, until `scan`."""
        self.is_wanted = False
        self.drop_round()
        return self.send("Stop")

    def reset(self) -> Ticket:
        """Begin as switched on; the scan is begun anew."""
        self.drop_round()
        return self.send("Reset")


EXAMPLE = """
name = "rplidar"
rate_hz = 20

[buses]
line = { link = "serial", protocol = "rplidar", baud = 115_200 }

[devices]
LIDAR = { driver = "rplidar", bus = "line" }
"""

driver = Driver(
    "rplidar",
    device=Rplidar,
    twin=RplidarTwin,
    example=EXAMPLE,
    doc="SLAMTEC RPLIDAR A1, A2: rounds of distances.",
    source="SLAMTEC, RPLIDAR Interface Protocol (A1 & A2 rev. 1.1)",
    settings=described(RplidarSettings),
)

__all__ = ["EXAMPLE", "Point", "Rplidar", "RplidarSettings", "driver"]
