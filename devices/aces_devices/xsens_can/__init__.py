"""An Xsens MTi on CAN: acceleration, rate of turn and orientation as signals in SI units. It is only read.

1. What the sensor is not set to send stays unknown. Its identifiers are those of the factory: one sensor a bus.
2. While its self-test has failed or its filter is not valid, orientation is unknown: what comes then is a guess.

Source: as the spec's.
"""

from __future__ import annotations

from math import pi
from typing import Any, ClassVar, NamedTuple

from aces_bus.device import Device, Driver, HostLoss, signal
from aces_bus.device.settings import described, settings_of

from .twin import MtiSettings, MtiTwin

#: Groups of values that three fields give: signal, message, unit; the fields are in SI units.
AXES = (
    ("acceleration", "Acceleration", "m/s²"), ("rate", "RateOfTurn", "rad/s"), ("magnetic", "MagneticField", ""),
    ("free_acceleration", "FreeAcceleration", "m/s²"), ("velocity", "Velocity", "m/s"),
)  # fmt: skip
ANGLES, QUATERNION = ("roll", "pitch", "yaw"), ("q0", "q1", "q2", "q3")
#: How long slow values are fresh (s).
SLOW_S = 5.0


class MtiReading(NamedTuple):
    """What `read` gives: m/s², rad/s, and orientation as a quaternion, its real part first; None where unknown."""

    acceleration: tuple[float, float, float] | None
    rate: tuple[float, float, float] | None
    quaternion: tuple[float, float, float, float] | None


class Mti(Device):
    """Signals: see the README. `read()` has acceleration, rate of turn and orientation at once."""

    protocol = "xsens_can"
    when_host_is_lost = HostLoss("nothing moves", "a sensor; it goes on sending")
    provides = (
        signal(
            "temperature",
            unit="K",
            of="Temperature.temperature",
            offset=273.15,
            stale_s=SLOW_S,
            doc="of the sensor",
            source="MT1604P §6.6.1",
        ),
        signal(
            "pressure",
            unit="Pa",
            of="Pressure.pressure",
            stale_s=SLOW_S,
            doc="of the air",
            source="MT1604P §6.6.2",
        ),
    )
    attributes: ClassVar = Device.attributes | {"settings"}

    def setup(self) -> None:
        """Add the signals."""
        self.settings = settings_of(self.name, MtiSettings, self.config.settings)
        self._alarms: set[str] = set()
        self._is_valid = True
        stale_s = max(0.1, 5 / self.settings.rate_hz)
        for name, message, unit in AXES:
            for axis in "xyz":
                self.add_signal(
                    f"{name}_{axis}", unit=unit, of=f"{message}.{axis}",
                    stale_s=stale_s, doc=f"along {axis}", source="MT1604P §6",
                )  # fmt: skip
        known: dict[str, Any] = {"stale_s": stale_s, "source": "MT1604P §6.3"}
        self._angles = [
            self.add_signal(name, unit="rad", read_from=["EulerAngles"], doc="orientation", **known)
            for name in ANGLES
        ]
        self._turn = [
            self.add_signal(name, read_from=["Quaternion"], doc="orientation", **known) for name in QUATERNION
        ]
        for name in ("self_test", "filter_valid", "clipping"):
            self.add_signal(name, read_from=["Status"], stale_s=SLOW_S, doc="0 or 1", source="MT1604P §6.2.1")

    @property
    def sends_every_s(self) -> float | None:
        """As the robot's file says."""
        return 1 / self.settings.rate_hz

    def received(self, record: Any, instant: int) -> None:
        """Take orientation, while the sensor says that it is valid, and how the sensor is."""
        match type(record).__name__:
            case "EulerAngles" if self._is_valid:
                for target, name in zip(self._angles, ANGLES, strict=True):
                    target.update(getattr(record, name) * pi / 180, instant)
            case "Quaternion" if self._is_valid:
                for target, name in zip(self._turn, QUATERNION, strict=True):
                    target.update(getattr(record, name), instant)
            case "Status":
                flags = set(record.flags)
                for name in ("self_test", "filter_valid", "clipping"):
                    self.signals[f"{self.name}.{name}"].update(int(name in flags), instant)
                self._is_valid = {"self_test", "filter_valid"} <= flags
                if not self._is_valid:
                    for target in [*self._angles, *self._turn]:
                        target.forget()
                alarms = {name for name in flags if name.startswith("clip_")}
                alarms |= {f"no {name}" for name in ("self_test", "filter_valid") if name not in flags}
                self.emit_alarms(alarms, self._alarms)
                self._alarms = alarms
            case _:
                pass

    def read(self) -> MtiReading:
        """Return acceleration, rate of turn and orientation, in SI units."""

        def values(names: tuple[str, ...]) -> Any:
            signals = [self.signals[f"{self.name}.{name}"] for name in names]
            return None if any(one.is_stale for one in signals) else tuple(one.last for one in signals)

        acceleration, rate = (
            values(tuple(f"{name}_{axis}" for axis in "xyz")) for name in ("acceleration", "rate")
        )
        return MtiReading(acceleration, rate, values(QUATERNION))


EXAMPLE = """
name = "xsens_can"
rate_hz = 50

[buses]
body = { link = "can", protocol = "xsens_can", bitrate = 500_000 }

[devices]
IMU = { driver = "xsens_can", bus = "body", settings = { rate_hz = 100 } }
"""

driver = Driver(
    "xsens_can",
    device=Mti,
    twin=MtiTwin,
    example=EXAMPLE,
    doc="Xsens MTi 600 series on CAN: IMU, VRU, AHRS.",
    source="Xsens MT1604P rev. A",
    settings=described(MtiSettings),
)

__all__ = ["EXAMPLE", "Mti", "MtiReading", "driver"]
