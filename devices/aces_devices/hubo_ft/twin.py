"""The twin of a force/torque board: what a foot feels of the floor, what a hand carries.

1. In digits as scaled, the fields have 0.01 N·m and 0.1 N, unless the sensor has a matrix: then digits are what it undoes.
2. With a simulated body (`--physics`) whose part is called as the sensor, it is what acts on that part.
3. A hand carries nothing until it is fed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from aces_bus.device import on
from aces_bus.errors import CallerError
from aces_bus.protocol import Record

from ..hubo_sensors.twin import CENTIDEGREES, Axes, SensorTwin

#: Steps of a field: 0.01 N·m, 0.1 N; 1/100 °, 1/750 g.
_FORCE = (100.0, 100.0, 10.0)
#: m/s² (CGPM 1901).
STANDARD_GRAVITY = 9.80665
_TILT = (CENTIDEGREES, CENTIDEGREES, 750.0)
#: Which foot a sensor id is.
_FEET = {1: "R", 2: "L"}

Feed = Callable[[int], Sequence[float]]


class ForceTorqueTwin(SensorTwin):
    """A board of a foot or hand.

    `feed(now)` gives (mx, my, fz) in N·m and N, `tilt_feed(now)` (roll, pitch, az) in rad and g, in place of the body.
    Noise (standard deviation): 0.02 N·m, 0.2 N, 0.03°, 1/250 g.
    """

    feed: Feed | None = None
    tilt_feed: Feed | None = None

    def setup(self) -> None:
        """Begin with nothing nulled."""
        super().setup()
        is_foot = self.config.kind == "foot"
        self.side = _FEET.get(self.credentials.get("sensor", 0)) if is_foot else None
        self.groups["force"] = Axes(3, noise=2.0, hot=5.0)
        if is_foot:
            tilt = self.groups["tilt"] = Axes(3, noise=3.0, hot=1.0)
            tilt.nulled = [0, 1]  # nulling the third would take gravity away
            self.groups["motion"] = Axes(4, noise=3.0, hot=1.0)
        sensor = next((entry for entry in self.sensors if entry.kind == "force_torque"), None)
        self._signs = sensor.signs if sensor is not None and sensor.signs is not None else (1, 1, 1)
        self._tilt_signs = next(
            (entry.signs for entry in self.sensors if entry.kind == "tilt" and entry.signs is not None),
            (1, 1, 1),
        )
        self._part = self.config.name if sensor is None else sensor.name
        self._rows = _undone(sensor.matrix) if sensor is not None and sensor.matrix is not None else None

    def truth(self, name: str, now: int) -> list[float]:
        """See `SensorTwin.truth`."""
        if name == "force":
            return self._force(now)
        if name == "tilt":
            return [s * v * k for s, v, k in zip(self._tilt_signs, self._tilt(now), _TILT, strict=False)]
        roll, pitch, _ = self._tilt(now)
        if (physics := self.world.body) is not None and (
            felt := physics.motion_of(self._part, now)
        ) is not None:
            return [roll * 750, pitch * 750, *(rate * CENTIDEGREES for rate in felt.rates[:2])]
        body = self.body
        # Accelerations along the axes that turn with the foot, and its rates: those of the pelvis, roughly.
        return [roll * 750, pitch * 750, body.roll_rate * CENTIDEGREES, body.pitch_rate * CENTIDEGREES]

    def _force(self, now: int) -> list[float]:
        if self.feed is not None:
            mx, my, fz = self.feed(now)
        elif (physics := self.world.body) is not None and (
            felt := physics.wrench_on(self._part, now)
        ) is not None:
            mx, my, fz = *felt.torque[:2], felt.force[2]
        elif self.side is not None:
            self.body.update(now)
            foot = self.body.feet[self.side]
            mx, my, fz = foot.mx, foot.my, foot.fz
        else:
            mx = my = fz = 0.0
        a, b, c = self._signs[:3]
        mx, my, fz = a * mx, b * my, c * fz
        if self._rows is None:
            return [mx * _FORCE[0], my * _FORCE[1], fz * _FORCE[2]]
        return [p * mx + q * my + r * fz for p, q, r in self._rows]

    def _tilt(self, now: int) -> Sequence[float]:
        if self.tilt_feed is not None:
            return self.tilt_feed(now)
        if (physics := self.world.body) is not None and (
            felt := physics.motion_of(self._part, now)
        ) is not None:
            return (felt.roll, felt.pitch, felt.acceleration[2] / STANDARD_GRAVITY)
        if self.side is None:
            return (0.0, 0.0, 1.0)
        self.body.update(now)
        foot = self.body.feet[self.side]
        return (foot.roll, foot.pitch, 1.0)

    # ------------------------------------------------------------------ requests

    def _send_force(self, digital: bool) -> None:
        mx, my, fz = self.sample("force")
        if digital:
            self.reply("ForceTorqueDigits", mx=mx, my=my, fz=fz)
        else:
            self.reply("ForceTorque", mx=mx * 0.01, my=my * 0.01, fz=fz * 0.1)

    def _send_tilt(self, digital: bool) -> None:
        if "tilt" not in self.groups:
            return
        ax, ay, az = self.sample("tilt")
        if digital:
            self.reply("TiltDigits", ax=ax, ay=ay, az=az)
        else:
            self.reply("Tilt", ax=ax * 0.01, ay=ay * 0.01, az=az / 750)

    @on("ForceTorqueRequest")
    def answer_force(self, request: Record) -> None:
        """Force and torque, scaled or in digits."""
        self._send_force(request.mode == "ft_digital")

    @on("TiltRequest")
    def answer_tilt(self, request: Record) -> None:
        """Send a foot's tilt; a hand has no tilt sensor and does not answer."""
        self._send_tilt(request.mode == "tilt_digital")

    @on("SensorRequest")
    def answer_both(self, request: Record) -> None:
        """Force and tilt, in one of four mixtures."""
        self._send_force(request.mode in ("digital", "digital_tilt_scaled"))
        self._send_tilt(request.mode in ("digital", "scaled_tilt_digital"))

    @on("SensorRequestD08")
    def answer_all(self, request: Record) -> None:
        """Send digits of force and, of a foot, of acceleration and rotation."""
        mx, my, fz = self.sample("force")
        self.reply("ForceTorqueD08", mx=mx, my=my, fz=fz)
        if "motion" in self.groups:
            one, two, three, four = self.sample("motion")
            self.reply("ImuD08", acceleration=[one, two], gyro=[three, four])

    @on("NullSensor")
    def take_null(self, request: Record) -> None:
        """Null all of force and torque, one axis of it, or a foot's tilt."""
        what = str(request.what)
        if what == "force_torque":
            self.null("force")
            if self.variant.dialect != "D12" and "motion" in self.groups:
                self.null("motion")
        elif what == "tilt":
            if "tilt" in self.groups:
                self.null("tilt")
        elif what in ("mx", "my", "fz"):
            self.null("force", [("mx", "my", "fz").index(what)])


def _undone(matrix: Sequence[Sequence[float]]) -> list[list[float]]:
    """Return the inverse of a 3 × 3 matrix. Raises `CallerError` when it has none."""
    if len(matrix) != 3 or any(len(row) != 3 for row in matrix):
        raise CallerError("a force/torque sensor's matrix has three rows of three")
    try:
        inverse: list[list[float]] = np.linalg.inv(np.array(matrix)).tolist()
    except np.linalg.LinAlgError:
        raise CallerError("a force/torque sensor's matrix must have an inverse") from None
    return inverse
