"""The twin of an MTi: a body that rolls and turns, as its sensors have it.

1. Motion and noise are choices; values are those of that motion, each from the same instant: rates are the derivative of
   the orientation, acceleration is gravity in the body's axes.
2. It is set to send all at `rate_hz`, but status, temperature and pressure ten times slower. It stays where it is: its free
   acceleration and velocity are noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, ClassVar

import msgspec
from msgspec import Meta

from aces_bus.device import Twin
from aces_bus.device.settings import settings_of

#: Standard gravity (m/s²), and the magnetic field of the earth in its axes (1 is where the sensor was calibrated).
GRAVITY, MAGNETIC = 9.80665, (0.4, 0.0, -0.9)
#: Roll and how fast (rad, Hz), turn about the vertical (rad/s), noise (m/s², rad/s, m/s): choices.
ROLL, ROLL_HZ, TURN, NOISE_ACC, NOISE_GYR, NOISE_VEL = 0.3, 0.25, 0.2, 0.01, 0.002, 0.02


class MtiSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    rate_hz: Annotated[
        float, Meta(gt=0, le=2000, description="how often it is set to send (Hz, default 100)")
    ] = 100


Attitude = tuple[float, float, float]


class MtiTwin(Twin):
    """One sensor. `attitude` gives roll, pitch and yaw (rad) at a time (s), in place of `moving`."""

    protocol = "xsens_can"
    faults: ClassVar = {
        "lost": "the filter is not valid, and the orientation is wrong",
        "clip": "the x accelerometer is beyond its range",
    }
    attitude: Callable[[float], Attitude] | None = None

    def setup(self) -> None:
        """Power up and begin to send."""
        self.count = 0
        self.every(1 / settings_of(self.name, MtiSettings, self.config.settings).rate_hz, self._send)

    @staticmethod
    def moving(time: float) -> Attitude:
        """Return the usual motion: it rolls, and turns about the vertical."""
        yaw = (TURN * time + math.pi) % math.tau - math.pi
        return ROLL * math.sin(math.tau * ROLL_HZ * time), 0.0, yaw

    def state(self, time: float) -> tuple[Attitude, Attitude, Attitude]:
        """Return attitude (rad), rates about the body's axes (rad/s) and acceleration along them (m/s²), without noise."""
        step = 1e-4
        where = self.attitude or self.moving
        roll, pitch, yaw = where(time)
        before, after = where(time - step), where(time + step)
        roll_rate, pitch_rate, yaw_rate = (
            ((b - a + math.pi) % math.tau - math.pi) / (2 * step) for a, b in zip(before, after, strict=True)
        )
        sin_r, cos_r, sin_p, cos_p = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
        rates = (
            roll_rate - yaw_rate * sin_p,
            pitch_rate * cos_r + yaw_rate * sin_r * cos_p,
            yaw_rate * cos_r * cos_p - pitch_rate * sin_r,
        )
        return (roll, pitch, yaw), rates, in_body((roll, pitch, yaw), (0.0, 0.0, GRAVITY))

    def _send(self) -> None:
        now = self.clock.now()
        angles, rates, acceleration = self.state(now / 1e9)
        if "lost" in self.active_faults:
            angles = (angles[0] + 0.5, angles[1], angles[2])
        self.reply("SampleTime", delay_ns=0, time=now // 1000 % (1 << 32))
        self.reply("GroupCounter", delay_ns=0, count=self.count % (1 << 16))
        acc = [value + self.random.gauss(0, NOISE_ACC) for value in acceleration]
        if "clip" in self.active_faults:
            acc[0] = 100.0
        self.reply("Acceleration", delay_ns=0, **dict(zip("xyz", acc, strict=True)))
        gyr = [value + self.random.gauss(0, NOISE_GYR) for value in rates]
        self.reply("RateOfTurn", delay_ns=0, **dict(zip("xyz", gyr, strict=True)))
        self.reply(
            "Quaternion", delay_ns=0, **dict(zip(("q0", "q1", "q2", "q3"), quaternion(*angles), strict=True))
        )
        degrees = map(math.degrees, angles)
        self.reply("EulerAngles", delay_ns=0, **dict(zip(("roll", "pitch", "yaw"), degrees, strict=True)))
        field = in_body(angles, MAGNETIC)
        self.reply("MagneticField", delay_ns=0, **dict(zip("xyz", field, strict=True)))
        for name, noise in (("FreeAcceleration", NOISE_ACC), ("Velocity", NOISE_VEL)):
            drawn = [self.random.gauss(0, noise) for _ in "xyz"]
            self.reply(name, delay_ns=0, **dict(zip("xyz", drawn, strict=True)))
        if self.count % 10 == 0:
            flags = ["self_test"] + (["filter_valid"] if "lost" not in self.active_faults else [])
            flags += ["clip_acc_x", "clipping"] if "clip" in self.active_faults else []
            self.reply("Status", delay_ns=0, flags=flags)
            self.reply("Temperature", delay_ns=0, temperature=35.0)
            self.reply("Pressure", delay_ns=0, pressure=101_325.0)
        self.count += 1


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion of yaw, then pitch, then roll; its real part is first.

    >>> [round(part, 3) for part in quaternion(0, 0, math.pi / 2)]
    [0.707, 0.0, 0.0, 0.707]
    """
    (sr, cr), (sp, cp), (sy, cy) = (
        (math.sin(angle / 2), math.cos(angle / 2)) for angle in (roll, pitch, yaw)
    )
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def in_body(angles: Attitude, vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a vector of the earth in the axes of a body with this roll, pitch and yaw (rad).

    >>> [round(part, 3) for part in in_body((math.pi / 2, 0, 0), (0, 0, 1))]
    [0.0, 1.0, 0.0]
    """
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle), math.cos(angle)) for angle in angles)
    x, y, z = vector
    return (
        cp * cy * x + cp * sy * y - sp * z,
        (sr * sp * cy - cr * sy) * x + (sr * sp * sy + cr * cy) * y + sr * cp * z,
        (cr * sp * cy + sr * sy) * x + (cr * sp * sy - sr * cy) * y + cr * cp * z,
    )
