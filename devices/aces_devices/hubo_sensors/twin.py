"""What the simulated sensor boards have in common: zeros, noise, faults, and the answers to set-up commands.

1. A reading is: truth × gain of the fault + drift − zero + noise, held at the ends of 16 bits.
2. Zeros live in the board: a null sets them, a reboot and an initialisation forget them.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import radians
from typing import ClassVar

from aces_bus.device import Twin, on
from aces_bus.protocol import Record

from .body import BodyPose, body_of

#: The ends of a 16-bit field.
LOW, HIGH = -32768, 32767


class Axes:
    """Readings that belong together. `noise` is the standard deviation, `hot` the offset at 1 K too much, both in the
    field's own steps; fields are 16 bits."""

    def __init__(self, size: int, noise: float, hot: float) -> None:
        self.noise, self.hot = noise, hot
        self.zero = [0.0] * size
        self.nulled = list(range(size))


class SensorTwin(Twin):
    """A simulated board. `feed`, when it is set, is asked for the true values in place of the model."""

    protocol = "hubo"
    faults: ClassVar = {
        "saturated": "every axis is at the end of its range",
        "hot": "too warm by 20 K (or as said): readings are off",
        "drift": "readings wander by 1 % of their range a minute (or as said)",
    }
    amounts: ClassVar = {"hot": 20.0}
    body: BodyPose

    def setup(self) -> None:
        """Begin as a board that was just powered: nothing nulled, period unknown."""
        self.body = body_of(self.world, self.robot)
        self.period_ms = 0
        self.da_value = 0
        self.averages = False
        self._since: dict[str, int] = {}
        self.groups: dict[str, Axes] = {}

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """See `Twin.fault`."""
        super().fault(name, amount, on=on)
        if on:
            self._since.setdefault(name, self.clock.now())
        else:
            self._since.pop(name, None)

    def read(self, group: Axes, truth: Sequence[float]) -> list[int]:
        """Return what the board reads where the truth is this, all in steps of the field."""
        gauss, noise = self.random.gauss, group.noise
        faults = self.active_faults
        if faults:
            truth = self._faulty(group, truth)
        out: list[int] = []
        for value, zero in zip(truth, group.zero, strict=True):
            step = round(value - zero + gauss(0.0, noise))
            out.append(LOW if step < LOW else HIGH if step > HIGH else step)
        return [HIGH if step >= 0 else LOW for step in out] if "saturated" in faults else out

    def _faulty(self, group: Axes, truth: Sequence[float]) -> list[float]:
        faults, more = self.active_faults, 0.0
        if "hot" in faults:
            more += faults["hot"] * group.hot
        if "drift" in faults:
            minutes = (self.clock.now() - self._since.get("drift", self.clock.now())) / 60e9
            more += faults["drift"] / 100 * HIGH * minutes
        return [value + more for value in truth]

    def truth(self, name: str, now: int) -> list[float]:
        """Return the true values of a group, in steps of its field."""
        raise NotImplementedError

    def sample(self, name: str) -> list[int]:
        """Return a reading of a group, now."""
        return self.read(self.groups[name], self.truth(name, self.clock.now()))

    def null(self, name: str, axes: Sequence[int] | None = None) -> None:
        """Take the present readings of a group (or of some of its axes) for zero."""
        group = self.groups[name]
        present = self.sample(name)
        for axis in group.nulled if axes is None else axes:
            group.zero[axis] += present[axis]

    # ------------------------------------------------------------------ set-up

    @on("GetBoardInfo")
    def send_info(self, request: Record) -> None:
        """Set the period that the request carries, and report it."""
        self.period_ms = request.period
        self.reply("SensorBoardInfo", period=self.period_ms)

    @on("InitSensor")
    def initialise(self, request: Record) -> None:
        """Forget what was nulled."""
        for group in self.groups.values():
            group.zero = [0.0] * len(group.zero)

    @on("NameInfoSensor")
    def send_name(self, request: Record) -> None:
        """Send the period, and limits of 0: the sensor has none."""
        self.period_ms = request.period
        self.reply("NameInfoReply", period=self.period_ms, limit=[0, 0])

    @on("SetPeriod")
    def take_period(self, request: Record) -> None:
        """Keep the period; it does not make the board speak by itself (nothing is known of that)."""
        self.period_ms = request.period

    @on("DaOut")
    def put_out(self, request: Record) -> None:
        """Set the analogue value, which the D/A offsets show."""
        self.da_value = min(HIGH, request.value)

    @on("DataType")
    def take_type(self, request: Record) -> None:
        """Choose the kind of reading: an average of four readings has half the noise."""
        wanted = request.type == "average"
        if wanted != self.averages:
            self.averages = wanted
            for group in self.groups.values():
                group.noise *= 0.5 if wanted else 2.0

    @on("DaOffsetQuery")
    def send_da(self, request: Record) -> None:
        """Send the same offset for all axes."""
        self.reply("DaOffset", mx=self.da_value, my=self.da_value, fz=self.da_value)

    @on("AdOffsetQuery")
    def send_ad(self, request: Record) -> None:
        """Send the nulled offsets."""
        mx, my, fz = self._zeros()
        self.reply("AdOffset", mx=mx, my=my, fz=fz)

    @on("OffsetQuery")
    def send_pair(self, request: Record) -> None:
        """Send both offsets of one axis."""
        axis = ("mx", "my", "fz").index(str(request.axis)) if str(request.axis) in ("mx", "my", "fz") else 0
        self.reply("OffsetPair", ad=self._zeros()[axis], da=self.da_value)

    def _zeros(self) -> list[int]:
        zero = next(iter(self.groups.values())).zero[:3]
        return [max(LOW, min(HIGH, round(value))) for value in zero]


#: Steps a rad and a rad/s of fields in 1/100 °.
CENTIDEGREES = 100 / radians(1)
