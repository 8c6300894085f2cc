"""The driver `hubo_d15`: a motor board of DRC-HUBO+ (dialect D15), two channels at most.

1. What the source does not state is not done: gains, parameters, currents, limits of the board.
2. References go out while the board is enabled, from where the joints are; a set-point before that is dropped and told.
3. A board that has switched control off by itself gets nothing more until it is enabled again.

Facts: RoboWorld2018, as the spec has them (`aces_protocols/hubo/d15.py`). The order of switching on is D12's: driver,
then control (hubo-ach).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from aces_bus.device import UNKNOWN, Device, Driver, Host, Job, Joint, Poll, Steps, together
from aces_bus.device.config import DeviceConfig
from aces_bus.errors import CallerError, DeviceError
from aces_protocols.hubo.d15 import NUMBERS, POWER

from .d15_twin import HuboMotorD15Twin

REPLIES = ("StatusD15", "StatusShortD15")
STATUS_S, TEMPERATURE_S = 0.1, 1.0
#: Seconds that a search may take, when nobody says otherwise.
HOME_S = 20.0
#: How often a search is looked at (ns).
LOOK = 100_000_000


class D15Axis:
    """One channel: its joint, how its counts are rad, and what was last said of it."""

    def __init__(self, device: HuboMotorD15, joint: Joint) -> None:
        counts = joint.counts_per_unit
        if counts is None:
            raise CallerError(f"{device.name}: {joint.name} needs gear, harmonic and encoder for its counts")
        self.joint, self.channel = joint, joint.channel
        self.sign, self.counts, self.zero = joint.direction, counts, joint.zero or 0.0
        self.drive: frozenset[str] = frozenset()
        self.errors: frozenset[str] = frozenset()
        self.is_homed = False

    def to_si(self, raw: float) -> float:
        """The angle (rad) of a count."""
        return self.sign * (raw / self.counts - self.zero)

    def from_si(self, angle: float) -> int:
        """The count of an angle, cut off as the sheet does."""
        return int((self.sign * angle + self.zero) * self.counts)


class HuboMotorD15(Device):
    """Signals of each joint: position (set, read), temperature, errors, driver_on, control_on, homed; the board's
    temperature.
    """

    protocol = "hubo"
    streams = ("ReferenceD15",)
    actions: ClassVar = {
        "enable": "drivers and control on, holding where the joints are",
        "disable": "control off, drivers off",
        "stop_motion": "control off, at once",
        "home": "search home as stored in the board (joint=NAME for one); it moves",
        "clear_errors": "clear error bits (joint=NAME for one)",
        "position_mode": "what set-points count from: mode=absolute or mode=incremental",
        "board_info": "ask for the board's period and firmware",
    }

    def setup(self) -> None:
        """A board's joints; the polls."""
        self.axes = [D15Axis(self, joint) for joint in self.joints]
        if any(axis.channel > 1 for axis in self.axes):
            raise CallerError(f"{self.name}: a board of D15 has channels 0 and 1")
        self.is_enabled = False
        #: Jobs that lead joints somewhere: stopping and disabling end them.
        self._led: list[Job] = []
        for axis in self.axes:
            joint = axis.joint
            self.add_signal(
                "position",
                owner=joint.name,
                unit="rad",
                of=f"EncoderD15.position.{axis.channel}",
                set=f"ReferenceD15.position.{axis.channel}",
                to_si=axis.to_si,
                from_si=axis.from_si,
                lower=joint.lower,
                upper=joint.upper,
                source="RoboWorld2018",
            )
            self._guard(joint.name)
            self.add_signal(
                "temperature",
                owner=joint.name,
                unit="°C",
                of=f"TemperatureD15.motor.{axis.channel}",
                stale_s=5 * TEMPERATURE_S,
                source="RoboWorld2018",
            )
            for name, doc in (
                ("errors", "error bits, by name"),
                ("driver_on", "whether the motor's driver is on"),
                ("control_on", "whether the motor is controlled"),
                ("homed", "whether home was found"),
            ):
                self.readable.add(self.add_signal(name, owner=joint.name, stale_s=5 * STATUS_S, doc=doc).name)
        self.add_signal(
            "temperature",
            unit="°C",
            of="TemperatureD15.board_temperature",
            stale_s=5 * TEMPERATURE_S,
            doc="the board's",
        )
        self.polls = (
            Poll("SendEncoderD15", reply="EncoderD15", fields={"mode": "once"}),
            Poll("SendStatusD15", reply=REPLIES, every_s=STATUS_S),
            Poll("SendTemperatureD15", reply="TemperatureD15", every_s=TEMPERATURE_S),
        )

    def _guard(self, joint: str) -> None:
        """Set-points of a board that is not enabled are dropped, and that is told."""
        signal = self.signals[f"{joint}.position"]
        give = signal.setter
        assert give is not None

        def guarded(value: Any) -> None:
            if self.is_enabled:
                give(value)
            else:
                self.tell_event("not sent", f"{joint} is not enabled: the set-point is dropped")

        signal.setter = guarded

    def default_of(self, message: str, path: str) -> Any:
        """A channel that was never given a set-point stays where it is; one without a joint is 0."""
        channel = int(path[-1])
        for axis in self.axes:
            if axis.channel == channel:
                angle = self.signals[f"{axis.joint.name}.position"].last
                return None if angle is UNKNOWN else axis.from_si(angle)
        return 0

    def completed(self, message: str, fields: dict[str, Any]) -> dict[str, Any]:
        """Both slots, also of a board with one joint."""
        held = list(fields["position"])
        for channel in (0, 1):
            if channel >= len(held):
                held.append(None)
            if held[channel] is None:
                held[channel] = self.default_of(message, f"position.{channel}")
        return {"position": held}

    # ------------------------------------------------------------------ up

    def heard(self, record: Any, instant: int) -> None:
        """The status: switches, home, errors."""
        if type(record).__name__ not in REPLIES:
            return
        for axis in self.axes:
            if axis.channel >= len(record.motor):
                continue
            motor = record.motor[axis.channel]
            before = axis.errors
            axis.drive, axis.errors = frozenset(motor.drive), frozenset(motor.errors)
            axis.is_homed = motor.home == "homed"
            owner = axis.joint.name
            self.signals[f"{owner}.errors"].update(", ".join(motor.errors), instant)
            self.signals[f"{owner}.driver_on"].update("driver_on" in axis.drive, instant)
            self.signals[f"{owner}.control_on"].update("control_on" in axis.drive, instant)
            self.signals[f"{owner}.homed"].update(axis.is_homed, instant)
            if axis.errors - before:
                self.tell_event("alarm", f"{owner}: {', '.join(sorted(axis.errors))}")
            elif before and not axis.errors:
                self.tell_event("alarm over", f"{owner}: {', '.join(sorted(before))}")
        if self.is_enabled and any("control_on" not in axis.drive for axis in self.axes):
            self._end()
            if not any(axis.errors for axis in self.axes):
                self.rebooted("control is off, and nobody has switched it off")

    def _end(self) -> None:
        self.is_enabled = False
        self.drop("ReferenceD15")

    # ------------------------------------------------------------------ actions

    def _axes(self, joint: str | None) -> list[D15Axis]:
        found = [axis for axis in self.axes if joint in (None, axis.joint.name, *axis.joint.aliases)]
        if not found:
            raise CallerError(
                f"{self.name} has no joint {joint!r} (it has: {', '.join(a.joint.name for a in self.axes)})"
            )
        return found

    def _leading(self, name: str, steps: Callable[[Job], Steps]) -> Job:
        made = self.job(name, steps)
        self._led = [job for job in self._led if not job.is_over] + [made]
        return made

    def _status(self) -> Any:
        return self.ask("SendStatusD15", reply=REPLIES)

    def enable(self) -> Job:
        """Drivers on, control on, references from where the joints are. Fails with `DeviceError` when it stays off."""
        self.is_driven = True

        def steps(job: Job) -> Steps:
            yield self.ask("SendEncoderD15", reply="EncoderD15", mode="once")
            for axis in self.axes:
                yield self.tell("DriverSwitchD15", channel=axis.channel + 1, state="on")
                yield self.tell("ControlD15", channel=axis.channel + 1, state="on")
            yield 10_000_000
            yield self._status()
            off = [axis.joint.name for axis in self.axes if not {"driver_on", "control_on"} <= axis.drive]
            if off:
                errors = sorted({error for axis in self.axes for error in axis.errors})
                raise DeviceError(
                    f"{self.name}: {', '.join(off)} stays off" + (f": {', '.join(errors)}" if errors else "")
                )
            self.is_enabled = True
            for axis in self.axes:  # hold
                here = self.default_of("ReferenceD15", f"position.{axis.channel}")
                self.want("ReferenceD15", f"position.{axis.channel}", here)

        return self._leading("enable", steps)

    def disable(self) -> Job:
        """Control off, drivers off."""
        return self._off("disable", is_driver_too=True)

    def stop_motion(self) -> Job:
        """Control off."""
        return self._off("stop", is_driver_too=False)

    def confirm_stopped(self) -> Job:
        """By the board's status."""

        def steps(job: Job) -> Steps:
            yield self._status()
            on = [axis.joint.name for axis in self.axes if "control_on" in axis.drive]
            if on:
                raise DeviceError(f"its status says that {', '.join(on)} is still on")

        return self.job("look whether it is off", steps)

    def _off(self, name: str, *, is_driver_too: bool) -> Job:
        for job in self._led:
            job.cancel()
        self._end()
        told: list[Any] = [
            self.tell_now("ControlD15", channel=axis.channel + 1, state="off") for axis in self.axes
        ]
        if is_driver_too:
            told += [
                self.tell("DriverSwitchD15", channel=axis.channel + 1, state="off") for axis in self.axes
            ]

        return together(self.clock, f"{self.name} {name}", told)

    def home(self, joint: str | None = None, timeout_s: float = HOME_S) -> Job:
        """Search home; enables before. Fails with `DeviceError` when the board tells errors, or does not find it in time."""
        axes = self._axes(joint)
        self.is_driven = True

        def steps(job: Job) -> Steps:
            if not self.is_enabled:
                yield self.enable()
            for number, axis in enumerate(axes):
                job.text = axis.joint.name
                self.hold("ReferenceD15", timeout_s)
                self._given.get("ReferenceD15", {}).pop(f"position.{axis.channel}", None)
                yield self.tell("HomeD15", channel=axis.channel + 1)
                yield LOOK
                yield from self._searched(axis, timeout_s)
                job.progress = (number + 1) / len(axes)
            yield self.ask("SendEncoderD15", reply="EncoderD15", mode="once")
            for axis in axes:
                here = self.default_of("ReferenceD15", f"position.{axis.channel}")
                self.want("ReferenceD15", f"position.{axis.channel}", here)
            self.hold("ReferenceD15", 0)

        return self._leading("home", steps)

    def _searched(self, axis: D15Axis, timeout_s: float) -> Steps:
        end = self.clock.now() + round(timeout_s * 1e9)
        while True:
            yield self._status()
            if axis.is_homed:
                return
            if axis.errors or "control_on" not in axis.drive:
                errors = ", ".join(sorted(axis.errors)) or "control went off"
                raise DeviceError(f"{self.name}: {axis.joint.name} has not found home: {errors}")
            if self.clock.now() >= end:
                raise DeviceError(f"{self.name}: {axis.joint.name} has not found home in {timeout_s:g} s")
            yield LOOK

    def clear_errors(self, joint: str | None = None) -> Job:
        """Clear error bits."""
        axes = self._axes(joint)

        def steps(job: Job) -> Steps:
            for axis in axes:
                yield self.tell("ClearErrorD15", channel=axis.channel + 1)
            yield 10_000_000
            yield self._status()

        return self.job("clear errors", steps)

    def position_mode(self, mode: str, joint: str | None = None) -> Job:
        """What set-points count from. Only while disabled: the same number would mean another place."""
        if mode not in ("absolute", "incremental"):
            raise CallerError(f"{self.name}: mode is absolute or incremental, not {mode!r}")
        axes = self._axes(joint)

        def steps(job: Job) -> Steps:
            if self.is_enabled:
                raise DeviceError(f"{self.name} is enabled: disable it, then change its position mode")
            for axis in axes:
                yield self.tell("PositionModeD15", channel=axis.channel + 1, mode=mode)

        return self.job("position mode", steps)

    def board_info(self) -> Any:
        """The board's period (ms) and firmware version."""
        return self.ask("GetBoardInfoD15", reply="BoardInfoD15")


def _scan(host: Host, job: Job) -> Steps:
    """Ask every board number what it is."""
    found: list[DeviceConfig] = []
    if host.variants["hubo"].dialect != "D15":
        return found
    for number in NUMBERS:
        job.progress = number / len(NUMBERS)
        if number == POWER:
            continue
        who = {"board": number}
        if (yield from host.answers("hubo", "GetBoardInfoD15", reply="BoardInfoD15", timeout_s=0.01, **who)):
            found.append(DeviceConfig(name=f"B{number}", driver="hubo_d15", bus=host.name, credentials=who))
    return found


EXAMPLE = """
name = "hubo_d15"
rate_hz = 50

[buses]
lower = { link = "can", protocol = "hubo", dialect = "D15" }

[devices]
B0 = { driver = "hubo_d15", bus = "lower", credentials = { board = 0 } }
B5 = { driver = "hubo_d15", bus = "lower", credentials = { board = 5 } }

[joints]
RHY = { device = "B0", channel = 0, gear = [10, 25], harmonic = 100, encoder = 4000, lower = -1.0, upper = 1.0 }
PAN = { device = "B5", channel = 0, gear = [1, 1], harmonic = 100, encoder = 4000, direction = -1, lower = -2, upper = 2 }
TILT = { device = "B5", channel = 1, gear = [1, 1], harmonic = 100, encoder = 4000, zero = 0.1, lower = -2, upper = 2 }
"""

driver = Driver(
    "hubo_d15",
    device=HuboMotorD15,
    twin=HuboMotorD15Twin,
    example=EXAMPLE,
    doc="Motor board of DRC-HUBO+ (Hubo dialect D15): positions, homing, status, temperatures.",
    source="RoboWorld2018",
    scan=_scan,
)
