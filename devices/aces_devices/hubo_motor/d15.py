"""The driver `hubo_d15` and its twin: a motor board of DRC-HUBO+ (dialect D15), two channels at most.

1. What the source does not state is not done: gains, parameters, currents, limits of the board.
2. References go out while the board is enabled, from where the joints are; a set-point before that is dropped and reported.
3. A board that has switched control off by itself gets nothing more until it is enabled again.
4. The twin answers what RoboWorld2018 reads, as the spec has it; how a search goes is not stated there: it runs to 0, then
   says 6. Control off lets a motor turn freely; a board that was off has forgotten control, home and modes, not where it is.

Facts: RoboWorld2018, as the spec has them (`aces_protocols/hubo/d15.py`). The order of switching on is D12's: driver,
then control (hubo-ach).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from aces_bus.device import UNKNOWN, Driver, HostLoss, Job, MotorDevice, Poll, Steps, Twin, on, together
from aces_bus.device.config import Joint
from aces_bus.device.host import Host
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError, DeviceError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_protocols.hubo.d15 import NUMBERS, POWER

from ..joint_model import AMBIENT, MotorJoint, MotorModel
from ..scanning import scan_numbers
from .axis import MotorAxis

REPLIES = ("StatusD15", "StatusShortD15")
STATUS_S, TEMPERATURE_S = 0.1, 1.0
#: Signals of a joint's status: name → what it is.
STATUS: Mapping[str, str] = {
    "errors": "error bits, by name",
    "driver_on": "whether the motor's driver is on",
    "control_on": "whether the motor is controlled",
    "homed": "whether home was found",
}
#: Seconds that a search may take by default.
HOME_S = 20.0
#: How often a search is looked at (ns).
LOOK_NS = 100_000_000


class HuboMotorD15(MotorDevice[MotorAxis]):
    """Signals of each joint: position (set, read), temperature, errors, driver_on, control_on, homed; the board's
    temperature.
    """

    protocol = "hubo"
    when_host_is_lost = HostLoss(
        "goes on", "RoboWorld2018 states no time-out", detail="its joints stay at the last reference"
    )
    streams = ("ReferenceD15",)
    actions: ClassVar = {
        "enable": "drivers and control on, holding where the joints are",
        "disable": "control off, drivers off",
        "home": "search home as stored in the board (joint=NAME for one); it moves",
        "clear_errors": "clear error bits (joint=NAME for one)",
        "position_mode": "what set-points count from: mode=absolute or mode=incremental",
        "board_info": "ask for the board's period and firmware",
    }

    def setup(self) -> None:
        """Add the signals of the board's joints, and the polls."""
        self.axes = [MotorAxis(joint.channel, joint, joint.name) for joint in self.joints]
        self.is_enabled = False
        temperature: dict[str, Any] = {"unit": "°C", "stale_s": 5 * TEMPERATURE_S}
        for joint, axis in zip(self.joints, self.axes, strict=True):
            if axis.channel > 1:
                raise CallerError(f"{self.name}: a board of D15 has channels 0 and 1")
            if joint.counts_per_unit is None:
                raise CallerError(
                    f"{self.name}: {joint.name} needs gear or harmonic, and encoder, for its counts"
                )
            axis.position = self.add_signal(
                "position",
                owner=joint.name,
                unit="rad",
                of=f"EncoderD15.position.{axis.channel}",
                set=f"ReferenceD15.position.{axis.channel}",
                to_si=axis.to_rad,
                from_si=axis.to_counts,
                lower=joint.lower,
                upper=joint.upper,
                source="RoboWorld2018",
            )
            of = f"TemperatureD15.motor.{axis.channel}"
            self.add_signal("temperature", owner=joint.name, of=of, source="RoboWorld2018", **temperature)
            for name, doc in STATUS.items():
                axis.signals[name] = self.add_signal(
                    name, owner=joint.name, stale_s=5 * STATUS_S, doc=doc, read_from=REPLIES
                )
        self.add_signal(
            "temperature", of="TemperatureD15.board_temperature", doc="the board's", **temperature
        )
        self.polls = (
            Poll("SendEncoderD15", reply="EncoderD15", fields={"mode": "once"}),
            Poll("SendStatusD15", reply=REPLIES, every_s=STATUS_S),
            Poll("SendTemperatureD15", reply="TemperatureD15", every_s=TEMPERATURE_S),
        )

    def want(self, message: str, path: str, value: FieldValue) -> None:
        """Queue a set-point; drop and report it while the board is not enabled."""
        if self.is_enabled:
            super().want(message, path, value)
        else:
            (axis,) = self.axes_of(path[-1])
            self.emit_event("not sent", f"{axis.name} is not enabled: the set-point is dropped")

    def takes(self, signal: Signal) -> bool | None:
        """Return whether the board is enabled: set-points go out then."""
        return super().takes(signal) if self.is_enabled else False

    def default_of(self, message: str, path: str) -> Any:
        """Return a channel that was never given a set-point stays where it is; one without a joint is 0."""
        for axis in self.axes:
            if axis.channel == int(path[-1]):
                return self._here(axis)
        return 0

    @staticmethod
    def _here(axis: MotorAxis) -> int | None:
        """Return the count at which a joint is; None: not known."""
        assert axis.position is not None
        return None if axis.position.last is UNKNOWN else axis.to_counts(axis.position.last)

    def _hold_here(self, axes: Sequence[MotorAxis]) -> None:
        self.epoch += 1
        for axis in axes:
            self.want("ReferenceD15", f"position.{axis.channel}", self._here(axis))

    def completed(self, message: str, fields: dict[str, Any]) -> dict[str, Any]:
        """Fill both slots, also for a board with one joint."""
        held = [*fields["position"], None, None][:2]
        for channel, count in enumerate(held):
            if count is None:
                held[channel] = self.default_of(message, f"position.{channel}")
        return {"position": held}

    # ------------------------------------------------------------------ up

    def received(self, record: Record, instant: int) -> None:
        """Take the status: switches, home, errors."""
        if type(record).__name__ not in REPLIES:
            return
        for axis in self.axes:
            if axis.channel >= len(record.motor):
                continue
            motor, before = record.motor[axis.channel], axis.failed
            axis.drive, axis.failed = frozenset(motor.drive), frozenset(motor.errors)
            axis.was_homed = motor.home == "homed"
            axis.show("errors", ", ".join(motor.errors), instant)
            axis.show("driver_on", "driver_on" in axis.drive, instant)
            axis.show("control_on", "control_on" in axis.drive, instant)
            axis.show("homed", axis.was_homed, instant)
            self.emit_alarms(axis.failed, before, f"{axis.name}: ")
        if self.is_enabled and any("control_on" not in axis.drive for axis in self.axes):
            self._end()
            if not any(axis.failed for axis in self.axes):
                self.rebooted("control went off without a command")

    def _end(self) -> None:
        self.is_enabled = False
        self.drop("ReferenceD15")

    # ------------------------------------------------------------------ actions

    def _status(self) -> Any:
        return self.ask("SendStatusD15", reply=REPLIES)

    def enable(self) -> Job:
        """Switch drivers on, then control, with references where the joints are. Fails with `DeviceError`
        when it stays off.
        """
        self.is_driven = True

        def steps(job: Job) -> Steps:
            yield self.ask("SendEncoderD15", reply="EncoderD15", mode="once")
            for axis in self.axes:
                yield self.send("DriverSwitchD15", channel=axis.channel + 1, state="on")
                yield self.send("ControlD15", channel=axis.channel + 1, state="on")
            yield 10_000_000
            yield self._status()
            off = [axis.name for axis in self.axes if not {"driver_on", "control_on"} <= axis.drive]
            if off:
                errors = sorted({error for axis in self.axes for error in axis.failed})
                raise DeviceError(
                    f"{self.name}: {', '.join(off)} stays off" + (f": {', '.join(errors)}" if errors else "")
                )
            self.is_enabled = True
            self._hold_here(self.axes)

        return self.lead("enable", steps)

    def disable(self) -> Job:
        """Switch control off, then drivers."""
        return self._off("disable", is_driver_too=True)

    def stop_motion(self) -> Job:
        """Switch control off."""
        return self._off("stop", is_driver_too=False)

    def confirm_stopped(self) -> Job:
        """Ask the board's status."""
        return self.confirm_off(
            self._status, lambda: [axis.name for axis in self.axes if "control_on" in axis.drive]
        )

    def _off(self, name: str, *, is_driver_too: bool) -> Job:
        self.end_led()
        self._end()
        states: list[Any] = [
            self.send_now("ControlD15", channel=axis.channel + 1, state="off") for axis in self.axes
        ]
        if is_driver_too:
            states += [
                self.send("DriverSwitchD15", channel=axis.channel + 1, state="off") for axis in self.axes
            ]

        return together(self.clock, f"{self.name} {name}", states)

    def home(self, joint: str | None = None, timeout_s: float = HOME_S) -> Job:
        """Search home; enables before. Raises `DeviceError` when the board reports errors, or does not find it in time."""
        axes = self.axes_of(joint)
        self.is_driven = True

        def steps(job: Job) -> Steps:
            if not self.is_enabled:
                yield self.enable()
            for axis in self.in_turn(job, axes):
                self.hold("ReferenceD15", timeout_s)
                self._given.get("ReferenceD15", {}).pop(f"position.{axis.channel}", None)
                yield self.send("HomeD15", channel=axis.channel + 1)
                yield LOOK_NS
                yield from self._searched(axis, timeout_s)
            yield self.ask("SendEncoderD15", reply="EncoderD15", mode="once")
            self._hold_here(axes)
            self.hold("ReferenceD15", 0)

        return self.lead("home", steps)

    def _searched(self, axis: MotorAxis, timeout_s: float) -> Steps:
        end = self.clock.now() + round(timeout_s * 1e9)
        while True:
            yield self._status()
            if axis.was_homed:
                return
            if axis.failed or "control_on" not in axis.drive:
                errors = ", ".join(sorted(axis.failed)) or "control went off"
                raise DeviceError(f"{self.name}: {axis.name} has not found home: {errors}")
            if self.clock.now() >= end:
                raise DeviceError(f"{self.name}: {axis.name} has not found home in {timeout_s:g} s")
            yield LOOK_NS

    def clear_errors(self, joint: str | None = None) -> Job:
        """Clear error bits."""
        axes = self.axes_of(joint)

        def steps(job: Job) -> Steps:
            for axis in axes:
                yield self.send("ClearErrorD15", channel=axis.channel + 1)
            yield 10_000_000
            yield self._status()

        return self.job("clear errors", steps)

    def position_mode(self, mode: str, joint: str | None = None) -> Job:
        """Return what set-points count from. Only while disabled: the same number would mean another place."""
        if mode not in ("absolute", "incremental"):
            raise CallerError(f"{self.name}: mode is absolute or incremental, not {mode!r}")
        axes = self.axes_of(joint)

        def steps(job: Job) -> Steps:
            if self.is_enabled:
                raise DeviceError(f"{self.name} is enabled: disable it, then change its position mode")
            for axis in axes:
                yield self.send("PositionModeD15", channel=axis.channel + 1, mode=mode)

        return self.job("position mode", steps)

    def board_info(self) -> Any:
        """Return the board's period (ms) and firmware version."""
        return self.ask("GetBoardInfoD15", reply="BoardInfoD15")


# ---------------------------------------------------------------------- the twin

#: A joint this far (rad) from its reference, and not moving, has a big error.
BIG = 0.1
#: A search ends this near to 0 (rad).
NEAR = 1e-3
VERSION = 20150601


class _SimulatedMotor:
    """One channel."""

    def __init__(self, joint: Joint, now: int, position: float) -> None:
        self.joint = joint
        self.counts = joint.counts_per_unit or 1.0
        lower = -1e9 if joint.lower is None else joint.lower - 0.2
        upper = 1e9 if joint.upper is None else joint.upper + 0.2
        self.model = MotorJoint(MotorModel(), now, position=position, lower=lower, upper=upper)
        self.is_driven = self.is_controlled = self.is_homed = self.is_incremental = False
        self.searching = False
        self.errors = 0
        self.goal = position

    def raw(self, now: int) -> int:
        return round(
            (self.joint.direction * self.model.position(now) + (self.joint.zero or 0.0)) * self.counts
        )

    def aim(self, raw: int, now: int) -> None:
        angle = self.joint.direction * (raw / self.counts - (self.joint.zero or 0.0))
        self.goal = self.goal + angle if self.is_incremental else angle
        if self.is_controlled and not self.searching:
            self.model.follow(now, self.goal)

    def position(self, now: int) -> float:
        """Return where the joint is (rad)."""
        return self.model.position(now)


class HuboMotorD15Twin(Twin):
    """A board with its motors."""

    protocol = "hubo"
    faults: ClassVar = {
        "jammed": "its joints are blocked",
        "hot": "its motors are at 90 °C, and it says so",
        "encoder_fail": "its encoders fail: an error, and control goes off",
        "no_home": "a home search finds nothing",
    }

    def setup(self) -> None:
        """Begin as just switched on: where it stood, controlling nothing."""
        now = self.clock.now()
        self.motors: dict[int, _SimulatedMotor] = {}
        for joint in self.joints:
            old = self.world.joints.get(joint.name)
            place = self.world.start_of(joint.name) if old is None else old.position(now)
            made = _SimulatedMotor(joint, now, place)
            made.is_homed = old is None and self.world.homed
            made.model.join(self.world, joint.name)
            self.motors[joint.channel] = made
            self.world.joints[joint.name] = made
        self._continuous = 0

    def _one(self, channel: int) -> _SimulatedMotor | None:
        return self.motors.get(channel - 1)

    # ------------------------------------------------------------------ asked

    @on("SendEncoderD15")
    def encoder(self, request: Record) -> None:
        """Send the positions, repeatedly if the request says so."""
        self._continuous += 1
        self._say()
        if request.mode == "continuous":
            self._go_on(self._continuous)

    def _go_on(self, number: int) -> None:
        def again() -> None:
            if number == self._continuous and self.is_powered:
                self._say()
                self._go_on(number)

        self.clock.call_in(5_000_000, again)

    def _say(self) -> None:
        now = self.clock.now()
        here = [self.motors[n].raw(now) if n in self.motors else 0 for n in (0, 1)]
        self.reply("EncoderD15", position=here)

    @on("SendStatusD15")
    def status(self, request: Record) -> None:
        """Send switches, home, errors, modes."""
        now = self.clock.now()
        states = [{"drive": 0, "home": 0, "errors": 0, "modes": 0} for _ in range(2)]
        for number, motor in self.motors.items():
            self._look(motor, now)
            states[number] = {
                "drive": int(motor.is_driven) | int(motor.is_controlled) << 1,
                "home": 6 if motor.is_homed else 0,
                "errors": motor.errors,
                "modes": 0x80 | (int(motor.is_incremental) << 5),
            }
        self.reply("StatusD15", motor=states, rest=b"")

    def _look(self, motor: _SimulatedMotor, now: int) -> None:
        """Advance a motor to `now`, and raise the errors of its faults."""
        faults = self.active_faults
        motor.model.jammed = "jammed" in faults
        angle = motor.model.position(now)
        if "hot" in faults:
            motor.errors |= 0x80
        if "encoder_fail" in faults:
            motor.errors |= 0x20
            motor.is_controlled = False
            motor.model.free(now)
        if motor.searching:
            if "no_home" in faults:
                motor.errors |= 0x01
                motor.searching = False
            elif abs(angle) <= NEAR:
                motor.searching, motor.is_homed, motor.goal = False, True, angle
        elif motor.is_controlled and abs(angle - motor.goal) > BIG and abs(motor.model.v) < 1e-6:
            motor.errors |= 0x04

    @on("SendTemperatureD15")
    def temperature(self, request: Record) -> None:
        """Send the temperatures of the board and of both motors."""
        now = self.clock.now()
        found = [90.0 if "hot" in self.active_faults else AMBIENT] * 2
        for number, motor in self.motors.items():
            motor.model.sync(now)
            if "hot" not in self.active_faults:
                found[number] = min(motor.model.temperature, 6000.0)
        self.reply("TemperatureD15", board_temperature=30.0, motor=found, rest=b"")

    @on("GetBoardInfoD15")
    def info(self, request: Record) -> None:
        """Answer with the board's version."""
        self.reply("BoardInfoD15", period=5, unknown=bytes(2), version=VERSION, rest=b"")

    # ------------------------------------------------------------------ reported

    @on("ReferenceD15")
    def reference(self, request: Record) -> None:
        """Take references: the positions to move to."""
        now = self.clock.now()
        for number, motor in self.motors.items():
            motor.aim(request.position[number], now)

    @on("DriverSwitchD15")
    def driver(self, request: Record) -> None:
        """Switch the driver on or off; without it nothing is controlled."""
        motor = self._one(request.channel)
        if motor is not None:
            motor.is_driven = request.state == "on"
            if not motor.is_driven:
                motor.is_controlled = False
                motor.model.free(self.clock.now())

    @on("ControlD15")
    def control(self, request: Record) -> None:
        """Switch control on or off."""
        motor = self._one(request.channel)
        if motor is None:
            return
        now = self.clock.now()
        motor.is_controlled = request.state == "on" and motor.is_driven
        motor.searching = False
        if motor.is_controlled:
            motor.goal = motor.model.position(now)
            motor.model.follow(now, motor.goal)
        else:
            motor.model.free(now)

    @on("HomeD15")
    def home(self, request: Record) -> None:
        """Search: to 0, which the stored settings stand for."""
        motor = self._one(request.channel)
        if motor is not None and motor.is_controlled:
            motor.is_homed, motor.searching, motor.goal = False, True, 0.0
            motor.model.follow(self.clock.now(), 0.0)

    @on("ClearErrorD15")
    def clear(self, request: Record) -> None:
        """Clear errors, until there is a reason for them again."""
        motor = self._one(request.channel)
        if motor is not None:
            motor.errors = 0

    @on("PositionModeD15")
    def position_mode(self, request: Record) -> None:
        """Choose whether references are absolute or count from the present place."""
        motor = self._one(request.channel)
        if motor is not None:
            motor.is_incremental = request.mode == "incremental"


# ---------------------------------------------------------------------- what is registered


_boards = scan_numbers(
    "hubo_d15",
    "B",
    "board",
    [number for number in NUMBERS if number != POWER],
    "GetBoardInfoD15",
    reply="BoardInfoD15",
    timeout_s=0.01,
    protocol="hubo",
)


def _scan(host: Host, job: Job) -> Steps:
    """Ask every board number what it is, on a bus that speaks D15."""
    return (yield from _boards(host, job)) if host.variants["hubo"].dialect == "D15" else []


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
