"""The twin of an attitude board: the pelvis as the body has it, or a part of a simulated body called as its sensor.

1. Digits of D08: 750 a g along the axes, 100 a °/s; the sheet gives no scale, these are the scales of D12.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sin

from aces_bus.device import on
from aces_bus.protocol import Record

from ..hubo_sensors.twin import CENTIDEGREES, Axes, SensorTwin


class ImuTwin(SensorTwin):
    """A board in the pelvis. `feed(now)` gives (roll, pitch, roll_rate, pitch_rate) in rad and rad/s in place of the body.

    Noise (standard deviation): 0.02°, 0.02 °/s.
    """

    feed: Callable[[int], Sequence[float]] | None = None

    def setup(self) -> None:
        """Begin with nothing nulled."""
        super().setup()
        self.groups["motion"] = Axes(4, noise=2.0, hot=1.0)
        signs = next(
            (sensor.signs for sensor in self.sensors if sensor.kind == "imu" and sensor.signs is not None),
            None,
        )
        self._signs = signs if signs is not None else (1, 1, 1, 1)
        self._is_old = self.variant.dialect != "D12"
        self._part = next((sensor.name for sensor in self.sensors if sensor.kind == "imu"), self.config.name)

    def truth(self, name: str, now: int) -> list[float]:
        """See `SensorTwin.truth`."""
        if self.feed is not None:
            values = self.feed(now)
        elif (physics := self.world.body) is not None and (
            felt := physics.motion_of(self._part, now)
        ) is not None:
            values = (felt.roll, felt.pitch, *felt.rates[:2])
        else:
            body = self.body
            body.update(now)
            values = (body.roll, body.pitch, body.roll_rate, body.pitch_rate)
        turned = [sign * value for sign, value in zip(self._signs, values, strict=False)]
        if self._is_old:
            roll, pitch, *rates = turned
            return [750 * sin(roll), 750 * sin(pitch), *(rate * CENTIDEGREES for rate in rates)]
        return [value * CENTIDEGREES for value in turned]

    @on("ImuRequest")
    def answer(self, request: Record) -> None:
        """Send attitude and rates."""
        roll, pitch, roll_rate, pitch_rate = self.sample("motion")
        self.reply(
            "Imu",
            roll=roll * 0.01,
            pitch=pitch * 0.01,
            roll_rate=roll_rate * 0.01,
            pitch_rate=pitch_rate * 0.01,
        )

    @on("SensorRequestD08")
    def answer_all(self, request: Record) -> None:
        """Send digits of acceleration and rotation."""
        one, two, three, four = self.sample("motion")
        self.reply("ImuD08", acceleration=[one, two], gyro=[three, four])

    @on("NullImu")
    def take_null(self, request: Record) -> None:
        """Make the present attitude zero."""
        self.null("motion")

    @on("NullSensor")
    def take_null_of_old(self, request: Record) -> None:
        """Null the sensor; the older firmware has one null command for all boards."""
        if self._is_old and str(request.what) == "force_torque":
            self.null("motion")
