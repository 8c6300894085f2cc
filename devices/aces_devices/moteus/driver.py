"""mjbots moteus: one controller, one joint, by position or by speed.

1. Every set-point carries the watchdog and the limits: what the device forgets comes again with the next tick.
2. Nothing moves before `enable`, which holds the joint where it is; a fault, a time-out or a reboot ends that, reported.
3. A stop is mode 0 (or the brake), and counts when the device answers that it is in it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from math import inf, nan, tau
from operator import mul
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import Meta

from aces_bus.device import Device, Driver, HostLoss, Job, OutgoingMessage, Poll, Steps, Ticket
from aces_bus.device.coalesce import Setpoint
from aces_bus.device.host_loss import Outcome
from aces_bus.device.settings import described, settings_of
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError, DeviceError
from aces_bus.protocol import Record
from aces_protocols.moteus.registers import BY_NAME
from aces_protocols.moteus.spec import REPLIES
from aces_protocols.moteus.subframes import register_values

from ..scanning import scan_numbers
from .twin import MoteusTwin

#: The watchdog where the robot's file does not say: the controller's own default, or five ticks where they are longer.
WATCHDOG_S, WATCHDOG_TICKS = 0.1, 5
#: The same on a bus without ticks, which repeats nothing: the motor stops then.
UNTICKED_S = 0.5
#: The channel of the console, the text that a frame has room for, and how long a whole answer may take (ns): a choice.
CHANNEL, MOST_TEXT, CONSOLE_NS = 1, 61, 2_000_000_000
#: How long text is waited for when an answer has come (ns).
ANSWER_NS = 50_000_000
#: How long a controller is given to reach a mode (ns), and between two looks.
MODE_NS, LOOK_NS = 500_000_000, 5_000_000
#: Modes in which no torque moves the joint: off, a fault, the windings shorted.
STILL = frozenset(("stopped", "fault", "brake"))
#: What is read in each tick, by type: the least bytes that the wire needs for what a controller of motion wants.
STATE = (
    ("read_i8", ["mode"]),
    ("read_f32", ["position", "velocity", "torque"]),
    ("read_i16", ["voltage", "temperature", "fault"]),
)
#: What is read once in a while, and how often (s).
SLOW, SLOW_S = (("read_i16", ["motor_temperature"]),), 1.0

Item = dict[str, Any]


class MoteusSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    max_torque: (
        Annotated[
            float,
            Meta(
                gt=0,
                description="the greatest torque (N·m at the controller's output), as configured when absent",
            ),
        ]
        | None
    ) = None
    watchdog_s: (
        Annotated[
            float,
            Meta(
                gt=0,
                description="without a set-point for this time the controller stops (s), when absent 0.1 or five ticks",
            ),
        ]
        | None
    ) = None
    kp_scale: Annotated[float, Meta(ge=0, description="share of the configured kp, 1 when absent")] = 1.0
    kd_scale: Annotated[float, Meta(ge=0, description="share of the configured kd, 1 when absent")] = 1.0
    stop: Annotated[
        Literal["release", "brake"],
        Meta(
            description='what a stop does: "release" the motor (default), or "brake" by shorting its windings'
        ),
    ] = "release"


def write(kind: str, **values: Any) -> Item:
    """Return a sub-frame that writes registers."""
    return {"kind": f"write_{kind}", "data": values}


def one_command(wants: Sequence[Setpoint]) -> Iterable[OutgoingMessage]:
    """Send one frame a controller, with all of its set-points."""
    given: dict[Device, dict[str, float]] = {}
    for want in wants:
        given.setdefault(want.device, {})[want.path] = want.value
    for device, values in given.items():
        yield OutgoingMessage(device, "Command", {"subframes": device.motion(values)})  # type: ignore[attr-defined]


class Moteus(Device):
    """Signals: position, velocity, torque of the joint; mode, fault, voltage, temperatures of the controller."""

    protocol = "moteus"
    rules: ClassVar = {"Command": one_command}
    streams = ("Command",)
    actions: ClassVar = {
        "enable": "hold the joint where it is: clear faults, then position mode (a wheel: speed 0)",
        "disable": "end set-points and stop",
        "set_zero": "call where the joint is its zero, until the controller is switched off; only while it is stopped",
        "identify": "ask for model, firmware and serial number",
        "read": "read a value of its configuration by its name, such as servo.max_current_A",
        "configuration": "read its whole configuration",
        "write": "write a value of its configuration, until power-off; confirm=true",
        "save": "keep the configuration for good, while it is stopped; confirm=true",
    }
    asking: ClassVar = ("identify", "read", "configuration")
    when_host_is_lost = HostLoss(
        "brakes", "mjbots/moteus docs, register 0x027 and servo.timeout_mode", WATCHDOG_S,
        "position_timeout: speed 0 without a position (servo.timeout_mode 12, as from the factory), so that a loaded joint"
        " sinks; each set-point sets the watchdog (`watchdog_s`)",
    )  # fmt: skip

    # ------------------------------------------------------------------ declaration

    def setup(self) -> None:
        """Add signals of the joint and of the controller, and the polls."""
        settings = self.settings = settings_of(self.name, MoteusSettings, self.config.settings)
        if len(self.joints) > 1:
            names = ", ".join(joint.name for joint in self.joints)
            raise CallerError(f"{self.name}: a moteus moves one joint, not {names}")
        joint = self.joint = self.joints[0] if self.joints else None
        command = "position" if joint is None else joint.command
        if command not in ("position", "speed"):
            raise CallerError(
                f'{self.name}: {joint.name if joint else ""} is moved by "position" or "speed", not {command!r}:'
                " only these modes have the controller's watchdog"
            )
        self.turns = command == "speed"
        #: Turns of the controller's output for a rad of the joint, with the sign; rad of its zero.
        self.per_rad = (joint.direction if joint else 1) * ((joint.ratio if joint else None) or 1.0) / tau
        self.zero = (joint.zero or 0.0) * (joint.direction if joint else 1) if joint else 0.0
        rate = self.host.rate_hz
        usual = max(WATCHDOG_S, WATCHDOG_TICKS / rate) if rate else UNTICKED_S
        self.watchdog_s = settings.watchdog_s or usual
        self.takes_set_points = False
        self.alarms: frozenset[str] = frozenset()
        #: Text of the console, as it was received and not taken yet.
        self.heard: list[bytes] = []
        queries = [
            {"subframes": [{"kind": kind, "data": names} for kind, names in group]} for group in (STATE, SLOW)
        ]
        self.polls = (Poll("Query", REPLIES, queries[0]), Poll("Query", REPLIES, queries[1], every_s=SLOW_S))
        self._signals(joint.name if joint else self.name)

    def _signals(self, owner: str) -> None:
        joint, per_rad = self.joint, self.per_rad
        self.known: dict[str, tuple[Signal, Any]] = {}

        def add(name: str, of: str, to_si: Any = None, **more: Any) -> Signal:
            made = self.add_signal(name, read_from=REPLIES, source="registers.md", **more)
            self.known[of] = (made, to_si)
            return made

        fast = (joint.max_speed if joint else None) or inf
        self.position = add(
            "position",
            "position",
            lambda turns: turns / per_rad - self.zero,
            unit="rad",
            owner=owner,
            doc="Where the joint is; set: where it is to go.",
            lower=None if self.turns or joint is None else joint.lower,
            upper=None if self.turns or joint is None else joint.upper,
            **(
                {}
                if self.turns
                else {"set": "Command.position", "from_si": lambda rad: (rad + self.zero) * per_rad}
            ),
        )
        add(
            "velocity",
            "velocity",
            lambda turns: turns / per_rad,
            unit="rad/s",
            owner=owner,
            doc="How fast the joint turns.",
            lower=-fast if self.turns and fast < inf else None,
            upper=fast if self.turns and fast < inf else None,
            **({"set": "Command.velocity", "from_si": partial(mul, per_rad)} if self.turns else {}),
        )
        add(
            "torque",
            "torque",
            lambda t: t * per_rad * tau,
            unit="N·m",
            owner=owner,
            doc="Torque of the joint.",
        )
        self.is_enabled = self.add_signal(
            "enabled",
            owner=owner,
            read_from=REPLIES,
            doc="Whether it takes set-points; see the action enable.",
        )
        self.mode = add("mode", "mode", doc="The controller's mode.")
        add("fault", "fault", doc='Why it is in mode fault, or what limits it; "none".')
        add("voltage", "voltage", unit="V", doc="Supply.")
        add("temperature", "temperature", unit="°C", doc="The board's temperature.")
        add(
            "motor_temperature",
            "motor_temperature",
            unit="°C",
            doc="The motor's; 0 without a sensor.",
            stale_s=5 * SLOW_S,
        )

    # ------------------------------------------------------------------ down

    @property
    def host_loss(self) -> HostLoss:
        """As declared, after its watchdog."""
        return replace(self.when_host_is_lost, after_s=self.watchdog_s)

    @property
    def fed_within_s(self) -> float | None:
        """Its watchdog, which every set-point feeds."""
        return self.watchdog_s

    def motion(self, given: dict[str, float]) -> list[Item]:
        """Return the sub-frames of a set-point (turns, turns/s): mode first, then where to, the limits and the watchdog."""
        settings, joint = self.settings, self.joint
        per_rad = abs(self.per_rad)
        values: dict[str, float] = {
            "command_position": given.get("position", nan),
            "command_velocity": given.get("velocity", 0.0),
            "command_timeout": self.watchdog_s,
        }
        if settings.kp_scale != 1.0 or settings.kd_scale != 1.0:
            values |= {"command_kp_scale": settings.kp_scale, "command_kd_scale": settings.kd_scale}
        if settings.max_torque is not None:
            values["command_position_max_torque"] = settings.max_torque
        if joint is not None and joint.max_speed is not None:
            values["command_velocity_limit"] = joint.max_speed * per_rad
        if joint is not None and joint.max_acceleration is not None:
            values["command_accel_limit"] = joint.max_acceleration * per_rad
        return [write("i8", mode="position"), *runs(values)]

    # ------------------------------------------------------------------ up

    def received(self, record: Record, instant: int) -> None:
        """Take values of registers; NaN is not known."""
        for subframe in record.subframes:
            if subframe.reason is not None:
                self.emit_event("malformed", f"a sub-frame of its answer is {subframe.reason}")
            elif subframe.kind == "stream_from_device":
                if subframe.data.channel == CHANNEL:
                    self.heard.append(bytes(subframe.data.data))
            elif subframe.kind == "read_error":
                self.emit_event(
                    "malformed", f"it cannot read {subframe.data.register}: error {subframe.data.error}"
                )
        values = register_values(record.subframes)
        for name, (target, to_si) in self.known.items():
            value = values.get(name)
            if value is None or value != value:
                continue
            target.update(value if to_si is None else to_si(value), instant)
        mode = values.get("mode")
        if mode is None:
            return
        self.is_enabled.update(self.takes_set_points and mode == "position", instant)
        fault = str(values.get("fault", "unknown"))
        before, self.alarms = self.alarms, frozenset((fault,)) if mode == "fault" else frozenset()
        self.emit_alarms(self.alarms, before)
        if not self.takes_set_points or mode == "position":
            return
        self._off()
        if mode == "position_timeout":
            self.emit_event(
                "alarm", f"no set-point came for {self.watchdog_s:g} s: its watchdog has stopped it"
            )
        elif mode != "fault":
            self.rebooted(f"it was enabled, and its mode is {mode}")

    def _off(self) -> None:
        self.takes_set_points = False
        self.drop("Command")

    def _ask(self, *items: Item, reads: Sequence[str] = ("mode", "fault")) -> Ticket:
        """Write, then read whole numbers; the answer is the ticket's record."""
        reading = [{"kind": "read_i32", "data": [name]} for name in reads]
        return self.ask("Query", reply=REPLIES, subframes=[*items, *reading])

    # ------------------------------------------------------------------ actions

    def enable(self) -> Job:
        """Clear faults, then hold: fails with `DeviceError` when the controller does not reach its mode."""

        def steps(job: Job) -> Steps:
            self._off()
            yield self._ask(write("i8", mode="stopped"))
            self.is_driven = True
            hold = self.motion({})
            end = self.clock.now() + MODE_NS
            while True:
                state = register_values((yield self._ask(*hold)).subframes)
                if state.get("mode") == "position":
                    break
                if state.get("mode") == "fault" or self.clock.now() > end:
                    yield self._stop()
                    raise DeviceError(
                        f"{self.name} is in mode {state.get('mode')}, fault {state.get('fault')}"
                    )
                yield LOOK_NS
            self.takes_set_points = True
            if self.turns:
                self.want("Command", "velocity", 0.0)
            else:
                self.want("Command", "position", nan)

        return self.lead("enable", steps)

    def disable(self) -> Job:
        """Stop, and see that it has."""

        def steps(job: Job) -> Steps:
            yield self.stop_motion()
            yield self.confirm_stopped()

        return self.job("disable", steps)

    def stop_motion(self) -> Ticket:
        """End set-points; free or short the motor (setting `stop`)."""
        self.end_led()
        return self._stop()

    def _stop(self) -> Ticket:
        self._off()
        mode = "brake" if self.settings.stop == "brake" else "stopped"
        return self.send_now("Command", subframes=[write("i8", mode=mode)])

    @property
    def stop_leaves(self) -> Outcome:
        """Shorted or free (setting `stop`)."""
        return "brakes" if self.settings.stop == "brake" else "limp"

    def confirm_stopped(self) -> Job:
        """Return whether it says so."""

        def steps(job: Job) -> Steps:
            mode = register_values((yield self._ask()).subframes).get("mode")
            if mode not in STILL:
                raise DeviceError(f"its mode is {mode}")

        return self.job("look whether it has stopped", steps)

    def set_zero(self) -> Job:
        """Call where the joint is its zero. Fails with `DeviceError` while it is not stopped."""

        def steps(job: Job) -> Steps:
            mode = register_values((yield self._ask()).subframes).get("mode")
            if self.takes_set_points or mode not in STILL:
                raise DeviceError(f"{self.name} is in mode {mode}: stop it before its zero is moved")
            yield self._ask(write("f32", set_output_exact=self.zero * self.per_rad))

        return self.job("set zero", steps)

    def identify(self) -> Job:
        """Ask who it is: the result is {register: number}."""

        def steps(job: Job) -> Steps:
            names = ("model_number", "firmware_version", "serial_number1", "serial_number2", "serial_number3")
            return register_values((yield self._ask(reads=names)).subframes)

        return self.job("identify", steps)

    # ------------------------------------------------------------------ the configuration, by the console

    def read(self, name: str) -> Job:
        """Read a value of the configuration by name, in the unit of the reference. Fails with `DeviceError`."""

        def steps(job: Job) -> Steps:
            lines: list[str] = yield from self._say(f"conf get {name}", is_one_line=True)
            return parsed_value(lines[0])

        return self.job(f"read {name}", steps)

    def configuration(self) -> Job:
        """Read the whole configuration: the result is {name: value}, text where a value is no number."""

        def steps(job: Job) -> Steps:
            lines: list[str] = yield from self._say("conf enumerate")
            pairs = (line.partition(" ") for line in lines)
            return {name: parsed_value(text) for name, _, text in pairs}

        return self.job("configuration", steps)

    def write(self, name: str, value: float, confirm: bool) -> Job:
        """Write a value of the configuration, until power-off; it is obeyed at once. Fails with `DeviceError`."""
        if confirm is not True:
            raise CallerError(
                f"{self.name}: say confirm=True; a value of the configuration can move the motor"
            )
        # A whole number stays one: the console refuses 12.0 where it expects an integer.
        text = str(int(value)) if isinstance(value, int) or value == value // 1 else f"{value:.9g}"

        def steps(job: Job) -> Steps:
            yield from self._say(f"conf set {name} {text}")

        return self.job(f"write {name}", steps)

    def save(self, confirm: bool) -> Job:
        """Keep the configuration for good. Fails with `DeviceError` while the controller is not stopped."""
        if confirm is not True:
            raise CallerError(
                f"{self.name}: say confirm=True; what was written so far outlives power-off then"
            )

        def steps(job: Job) -> Steps:
            mode = register_values((yield self._ask()).subframes).get("mode")
            if mode not in STILL:
                raise DeviceError(f"{self.name} is in mode {mode}: stop it before its configuration is saved")
            yield from self._say("conf write")

        return self.job("save the configuration", steps)

    def _say(self, line: str, *, is_one_line: bool = False) -> Steps:
        """Say a line to the console; return the lines of the answer up to `OK`, or its one line.

        Raises `DeviceError` for an answer `ERR …`, and for one that does not end within `CONSOLE_NS`.
        """
        if "\n" in line or not line.isascii():
            raise DeviceError(f"{self.name}: {line!r} is not a line of ASCII text")
        end = self.clock.now() + CONSOLE_NS
        self.heard.clear()
        while (yield from self._poll()):  # an earlier command has left something
            if self.clock.now() > end:
                raise DeviceError(f"{self.name}: its console does not fall silent; say `tel stop` to it")
            yield LOOK_NS
        data = f"{line}\n".encode()
        for start in range(0, len(data), MOST_TEXT):
            part = {"channel": CHANNEL, "data": data[start : start + MOST_TEXT]}
            yield self.send("Command", subframes=[{"kind": "stream_to_device", "data": part}])
        text = b""
        while self.clock.now() <= end:
            text += yield from self._poll()
            *whole, _ = text.decode("latin1").split("\n")
            lines = [each.strip() for each in whole if each.strip()]
            if lines and lines[-1].startswith("ERR"):
                raise DeviceError(f"{self.name}: {line!r} is answered {lines[-1]!r}")
            if lines and is_one_line:
                return lines
            if lines and lines[-1].startswith("OK"):
                return lines[:-1]
            yield LOOK_NS
        raise DeviceError(f"{self.name}: {line!r} is not answered within {CONSOLE_NS / 1e9:g} s")

    def _poll(self) -> Steps:
        """Ask the console for text. Raises `DeviceError` when the answer is lost: the text in it is gone.

        After a lost answer a ticket may be over by the answer to another question: the text is waited for by itself.
        """
        poll = {"kind": "poll_stream", "data": {"channel": CHANNEL, "most": MOST_TEXT}}
        yield self.ask("Query", reply=REPLIES, retries=0, subframes=[poll])
        end = self.clock.now() + ANSWER_NS
        while not self.heard:
            if self.clock.now() > end:
                raise DeviceError(f"{self.name}: an answer of its console was lost; say it again")
            yield LOOK_NS
        return self.heard.pop(0)


def parsed_value(text: str) -> float | str:
    """Return a value of the console: a whole number, a number, or text that is none."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def runs(values: dict[str, float]) -> list[Item]:
    """Return values by register as floats, consecutive registers in one sub-frame."""
    found: list[Item] = []
    last = -2
    for name in sorted(values, key=lambda name: BY_NAME[name].number):
        number = BY_NAME[name].number
        if number != last + 1:
            found.append(write("f32"))
        found[-1]["data"][name] = values[name]
        last = number
    return found


#: How long each number is given to answer (s): a controller answers within 1 ms, adapters collect frames.
PATIENCE_S = 0.02


EXAMPLE = """
name = "moteus"
rate_hz = 20

[buses]
can = { link = "can", protocol = "moteus", bitrate = 1_000_000 }

[devices]
KNEE = { driver = "moteus", bus = "can", credentials = { id = 11 }, settings = { stop = "brake", max_torque = 1.5 } }
WHEEL = { driver = "moteus", bus = "can", credentials = { id = 1 } }

[joints]
KNEE_PITCH = { device = "KNEE", lower = -0.1, upper = 2.0, direction = -1, zero = 0.2, gear = [1, 2], max_speed = 3.0 }
DRIVE = { device = "WHEEL", type = "continuous", command = "speed", max_speed = 20.0, direction = -1 }
"""

driver = Driver(
    "moteus",
    device=Moteus,
    twin=MoteusTwin,
    example=EXAMPLE,
    doc="mjbots moteus servo controller on CAN FD: one joint by position or speed.",
    source="mjbots/moteus docs/protocol/can.md, registers.md",
    # Its mode, which changes nothing.
    scan=scan_numbers(
        "moteus",
        "MOTEUS",
        "id",
        range(1, 127),
        "Query",
        reply=REPLIES,
        timeout_s=PATIENCE_S,
        subframes=[{"kind": "read_i8", "data": ["mode"]}],
    ),
    settings=described(MoteusSettings),
)
