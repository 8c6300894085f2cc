"""What Hubo's sensor boards have in common: two numbers each, two dialects, null, set-up and offsets.

1. Commands go to the board's number, requests and data carry the sensor id: both are credentials.
2. D12 asks each sensor for each kind of its data; D08 asks all of them with one frame, which the host sends once a tick.
3. Nothing is nulled or set up by itself: a null takes whatever load there is for zero.

An axis of the robot's file: value = sign × (matrix · digits), or sign × what the board has scaled itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any, ClassVar

import msgspec
from msgspec import Meta

from aces_bus.device import Device, HostLoss, Job, Poll, Steps, Ticket
from aces_bus.device.config import DeviceConfig, Sensor
from aces_bus.device.host import Host
from aces_bus.device.settings import settings_of
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError, DeviceError
from aces_bus.protocol.record import FieldValue

#: The NameInfo tail of the hands' boards, of unknown meaning (acesHubo config.ops).
HAND_TAIL = bytes.fromhex("0038721200")
HANDS = (0x35, 0x36)
#: How often a null is sent in D08 (acesHubo: "several times"), and how far apart (ns).
NULLS, APART_NS = 3, 10_000_000
#: What attitude is made of; a tilt sensor has the first two.
MOTION = (("roll", "rad"), ("pitch", "rad"), ("roll_rate", "rad/s"), ("pitch_rate", "rad/s"))


class SensorSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The drivers' own keys in a robot file."""

    period_ms: Annotated[
        float | None,
        Meta(
            description="the board's period, which `init` and `set_period` give it; the robot's rate when absent"
        ),
    ] = None
    name_info_tail: Annotated[
        str | None, Meta(description="five bytes, hexadecimal, at the end of a D08 board's NameInfo")
    ] = None


class SensorBoard(Device):
    """A board of sensors."""

    protocol = "hubo"
    when_host_is_lost = HostLoss("nothing moves", "a sensor")
    actions: ClassVar = {
        "null": "take the present readings for zero (unload the sensor before)",
        "init": "set the board up anew",
        "set_period": "set the board's period: a number of ms, by default the robot file's",
        "offsets": "ask for the D/A and A/D offsets (D08)",
    }
    asking: ClassVar = ("offsets",)

    #: Where the meaning of its signals comes from.
    facts: ClassVar[str]
    #: Faults that have been reported and are not over.
    alarms: set[str]
    #: What makes signals of all digits of a message together, by its name.
    made_of: dict[str, Callable[[Sequence[int], int], None]]

    @property
    def is_old(self) -> bool:
        """True if the board speaks D08, in either reading."""
        return self.variant.dialect != "D12"

    def motion_of_old(self, sensor: Sensor | None) -> None:
        """Add acceleration and rotation, which D08 sends in digits; a matrix turns them into rad and rad/s."""
        names = ("acceleration.0", "acceleration.1", "gyro.0", "gyro.1")
        short = ("acc1", "acc2", "gyro1", "gyro2")
        turned = sensor is None or sensor.matrix is None
        self.axes(
            sensor, "ImuD08", [(s, n, "", 1.0) for s, n in zip(short, names, strict=True)], turned=turned
        )
        if sensor is not None and sensor.matrix is not None:
            self.products(sensor, "ImuD08", MOTION[: len(sensor.matrix)])

    def lacks(self, *actions: str) -> None:
        """Offer fewer actions than the class: these mean nothing to this board."""
        vars(self)["actions"] = {name: doc for name, doc in self.actions.items() if name not in actions}

    def ask_for(self, *polls: Poll) -> None:
        """Poll for these, and let values be stale after five polls."""
        self.settings = settings_of(self.name, SensorSettings, self.config.settings)
        self.polls = polls
        self.alarms, self.made_of = set(), {}
        if not self.is_old:
            self.lacks("offsets")
        every = max((p.every_s for p in polls if p.every_s), default=None)
        period = every or (1 / self.host.rate_hz if self.host.rate_hz else 0.0)
        #: How old a value may be (s).
        self.fresh_s = max(0.1, 5 * period)

    def polls_of(self, name: str) -> list[Poll]:
        """Return the polls of a signal: in D08 one request asks for several messages."""
        return list(self.polls) if self.is_old and name in self.readable else super().polls_of(name)

    def sensor_of(self, *kinds: str) -> Sensor | None:
        """Return the board's sensor of this kind, if the robot's file has one."""
        return next((sensor for sensor in self.sensors if sensor.kind in kinds), None)

    def axes(
        self,
        sensor: Sensor | None,
        message: str,
        named: Sequence[tuple[str, str, str, float]],
        *,
        turned: bool = True,
    ) -> None:
        """Add a signal for each (name, field, unit, factor to SI) of a message, `turned` by the sensor's signs."""
        signs: Sequence[int] = (1,) * len(named)
        if turned and sensor is not None and sensor.signs is not None:
            signs = sensor.signs
        if len(signs) < len(named):
            raise CallerError(f"{self.name}: {len(named)} axes need as many signs, not {list(signs)}")
        for (name, path, unit, factor), sign in zip(named, signs, strict=False):
            self.add_signal(
                name,
                unit=unit,
                of=f"{message}.{path}",
                to_si=_times(sign * factor),
                owner=sensor.name if sensor is not None else None,
                stale_s=self.fresh_s,
                source=self.facts,
            )

    def products(self, sensor: Sensor, message: str, named: Sequence[tuple[str, str]]) -> None:
        """Add a signal for each (name, unit), computed from all digits of a message by the sensor's matrix."""
        matrix = sensor.matrix or ()
        if len(matrix) != len(named):
            raise CallerError(f"{self.name}: {sensor.name} needs a matrix of {len(named)} rows")
        signs = sensor.signs or (1,) * len(named)
        rows: list[tuple[tuple[float, ...], Signal]] = []
        for (name, unit), row, sign in zip(named, matrix, signs, strict=False):
            made = self.add_signal(
                name,
                unit=unit,
                owner=sensor.name,
                stale_s=self.fresh_s,
                read_from=(message,),
                source=self.facts,
            )
            rows.append((tuple(sign * factor for factor in row), made))

        def update(digits: Sequence[int], instant: int) -> None:
            for row, made in rows:
                made.update(sum(f * d for f, d in zip(row, digits, strict=False)), instant)

        self.made_of[message] = update

    def alarm(self, what: str, is_on: bool) -> None:
        """Tell a fault when it begins and when it is over."""
        if is_on and what not in self.alarms:
            self.alarms.add(what)
            self.emit_event("alarm", what)
        elif not is_on and what in self.alarms:
            self.alarms.discard(what)
            self.emit_event("alarm over", what)

    # ------------------------------------------------------------------ actions

    def null(self) -> Job:
        """Take the present readings for zero."""
        return self.nulled(("NullSensor", {"what": "force_torque"}))

    def nulled(self, *requests: tuple[str, dict[str, FieldValue]]) -> Job:
        """Send null commands: in D08 three times each, as its programs do, in D12 once."""

        def steps(job: Job) -> Steps:
            for turn in range(NULLS if self.is_old else 1):
                if turn:
                    yield APART_NS
                for message, fields in requests:
                    yield self.send(message, **fields)

        return self.job("null", steps)

    @property
    def period_ms(self) -> int:
        """The board's period as the robot's file has it: its `period_ms`, or the robot's rate."""
        rate = self.host.rate_hz or self.robot.rate_hz or 200
        return max(1, min(255, round(self.settings.period_ms or 1000 / rate)))

    def set_period(self, period_ms: int | None = None) -> Ticket:
        """Set the board's period (ms). In D12 the answer says what the board took; in D08 nothing is answered."""
        period = self.period_ms if period_ms is None else period_ms
        if self.is_old:
            return self.send("SetPeriod", period=period)
        return self.ask("GetBoardInfo", reply="SensorBoardInfo", period=period)

    def init(self) -> Ticket | Job:
        """Set the board up anew: 0xFA in D12, NameInfo in D08."""
        if not self.is_old:
            return self.send("InitSensor")
        tail = self.settings.name_info_tail
        if tail is None and self.credentials["board"] not in HANDS:
            return self.refused(
                "init", "nothing is known of the NameInfo of this board; give its settings name_info_tail"
            )
        raw = HAND_TAIL if tail is None else bytes.fromhex(tail)
        return self.ask("NameInfoSensor", reply="NameInfoReply", period=self.period_ms, tail=raw)

    def refused(self, name: str, why: str) -> Job:
        """Return a job that fails at once."""

        def steps(job: Job) -> Steps:
            raise DeviceError(f"{self.name}: {why}")
            yield

        return self.job(name, steps)

    def offsets(self) -> Job:
        """Ask for the offsets of the converters (D08): the job's result is {"da": record, "ad": record}."""

        if not self.is_old:
            return self.refused("offsets", "only boards of D08 report their offsets")

        def steps(job: Job) -> Steps:
            da = yield self.ask("DaOffsetQuery", reply="DaOffset")
            ad = yield self.ask("AdOffsetQuery", reply="AdOffset")
            return {"da": da, "ad": ad}

        return self.job("offsets", steps)


def _times(factor: float) -> Callable[[Any], Any]:
    return lambda value: value * factor


# ---------------------------------------------------------------------- finding


#: What a board is asked that may be there: message, answer, fields.
_QUESTIONS: Mapping[str, tuple[str, str, Mapping[str, Any]]] = {
    "old": ("DaOffsetQuery", "DaOffset", {}),
    "imu": ("ImuRequest", "Imu", {"select": "imu"}),
    "force": ("ForceTorqueRequest", "ForceTorque", {"mode": "ft_scaled"}),
}


def scan_of(driver: str, kinds: Sequence[str], *, timeout_s: float = 0.03) -> Callable[[Host, Job], Steps]:
    """Return what finds the sensor boards of `kinds`, for `Driver(scan=…)`."""
    return partial(_scan, driver, kinds, timeout_s)


def _scan(driver: str, kinds: Sequence[str], timeout_s: float, host: Host, job: Job) -> Steps:
    """Ask every sensor board whether it is there; the list of those of `kinds` that answer.

    Nothing is set: D12 boards are asked for data, D08 boards for their D/A offsets. What kind a board number is, the
    protocol's table knows.
    """
    variant = host.variants["hubo"]
    old = variant.dialect != "D12"
    if old and "DaOffsetQuery" not in variant.messages:
        return []  # D15: how its sensors are asked for by number is not known
    table = variant.protocol.configurations[variant.protocol.configuration or ""]["channels"]
    boards = [board for board, kind in table.items() if kind in kinds]
    found: list[DeviceConfig] = []
    for number, board in enumerate(boards):
        who = {"board": board, "sensor": board - 0x2F}
        message, reply, fields = _QUESTIONS["old" if old else "imu" if table[board] == "imu" else "force"]
        answer = yield from host.answers("hubo", who, message, reply=reply, timeout_s=timeout_s, **fields)
        job.progress = (number + 1) / len(boards)
        if answer is None:
            continue
        found.append(
            DeviceConfig(
                name=f"{'IMU' if driver == 'hubo_imu' else 'FT'}_{board:02X}",
                driver=driver,
                bus=host.name,
                credentials=who,
                kind=table[board],
            )
        )
    return found
