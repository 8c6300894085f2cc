"""The twin of a moteus: registers in any of their types, position mode with its limits and watchdog, faults.

1. What is written counts when the frame is over, the mode first; what is read is answered in the type that was asked for.
2. A goal moves within the limits of velocity and acceleration, and a motor (`joint_model`) follows it with stiffness and
   damping, with no more torque than the command allows. Its sizes are choices.
3. A command lasts until its watchdog; then the controller is in mode 11, where it only damps, and which only a stop ends.
4. Above 75 °C or below 10 V it is in a fault (servo.fault_temperature; the least voltage is a choice).
5. It obeys its configuration at once, which the tunnelled console reads, writes and stores (`console.py`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import inf, isnan, nan, tau
from random import Random
from struct import calcsize
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.device.single_motor import JointScale
from aces_bus.frames import FD_LENGTHS
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_protocols.moteus.registers import BY_NAME, FAULTS, MODES, TYPES
from aces_protocols.moteus.subframes import bytes_of, register_values, varuint

from ..joint_model import AMBIENT, JAM, MotorModel, PacedGoal, jam, joint_of
from .configuration import CURRENT, MAX_VELOCITY, TIMEOUT_MODES, TIMEOUT_S, TORQUE_CONSTANT, Configuration
from .console import CHANNEL, Console, Fields

#: The supply without load (V) and its resistance (ohm); the least voltage (V).
SUPPLY, RESISTANCE, LEAST_VOLTAGE = 24.0, 0.05, 10.0
#: What else the twin has: model, firmware, register map, serial numbers.
FIXED = {
    "model_number": 0x0100,
    "firmware_version": 0x010A,
    "register_map_version": 5,
    "serial_number1": 0x1234,
    "serial_number2": 0x5678,
    "serial_number3": 0x4D4F,
}
#: The commit that it is of, and when that was made (s): none, it is no firmware.
GIT: Fields = {"hash": ("u8", (0,) * 20), "dirty": ("bool", (0,)), "timestamp": ("u64", (0,))}
#: Set-points that are "not given" until a frame gives them: the reference's defaults.
COMMAND = {
    "command_position": 0.0,
    "command_velocity": 0.0,
    "command_feedforward_torque": 0.0,
    "command_kp_scale": 1.0,
    "command_kd_scale": 1.0,
    "command_position_max_torque": nan,
    "command_stop_position": nan,
    "command_timeout": TIMEOUT_S,
    "command_velocity_limit": nan,
    "command_accel_limit": nan,
    "command_fixed_voltage_override": nan,
    "command_ilimit_scale": 1.0,
    "command_fixed_current_override": nan,
    "command_ignore_position_bounds": 0,
}
#: Modes that a host may command here; others end in a fault of the configuration.
COMMANDED = frozenset(("stopped", "position", "zero_velocity", "brake"))
#: The answer to so many registers fits into a frame, whatever their types.
SURE = 8
#: Codes of errors are the device's own affair; the reference names none.
NO_REGISTER = 1


class MoteusTwin(Twin):
    """A controller: `mode`, `fault`, `command` (the registers of position mode), `position(now)` of its joint (rad).

    `configuration` has its values by name; `stored` those that outlive power-off.
    """

    protocol = "moteus"
    faults: ClassVar = {
        **JAM,
        "hot": "the motor is at 100 °C (or as hot as said), and cools",
        "brown_out": "the supply has 8 V (or as much as said): a fault, 40 under-voltage, until it is back and stopped",
        "trip": "a fault, 38 over-temperature (or the code said), until it is over and the controller is stopped",
    }
    amounts: ClassVar = {"trip": 38, "hot": 100.0, "brown_out": 8.0}
    stored: dict[str, float] | None = None

    def setup(self) -> None:
        """Begin as just powered: stopped, where the motor is, with the stored configuration."""
        self.configuration = Configuration(self.credentials["id"])
        self._load()
        self.console = Console(
            self.configuration,
            {"firmware": self._firmware, "git": lambda: GIT, "servo_stats": self._stats},
            self._debug,
            self._load,
            self._store,
        )
        self.scale = scale = JointScale.of(self.joints[0] if self.joints else None, 1 / tau)
        self.motor = joint_of(
            self,
            MotorModel(
                speed=abs(scale.speed(MAX_VELOCITY)),
                time_constant=0.1,
                stall_current=CURRENT,
                friction=0.003,
                heating=0.005,
                cooling=120.0,
                torque_constant=TORQUE_CONSTANT * scale.ratio,
            ),
        )
        self.mode, self.fault_code = "stopped", 0
        self.command: dict[str, float] = dict(COMMAND)
        #: What is added to the motor's turns, as its position was set; it is lost without power.
        self.offset = 0.0
        self._law: PacedGoal | None = None
        self._until: int | None = None
        self._watch = self.clock.call_in(0, self._late)

    def draw(self, dice: Random, share: float = 1.0) -> None:
        """Turn it by up to 1000 turns of the motor."""
        self.motor.place(self.clock.now(), self.scale.angle(dice.uniform(-1000.0, 1000.0) * share))

    # ------------------------------------------------------------------ motion

    def _sync(self) -> float:
        """Return where the motor is (turns); what happened since is caught up."""
        now, motor = self.clock.now(), self.motor
        motor.sync(now)
        if self.temperature > self.configuration["servo.fault_temperature"]:
            self._trip("over_temperature")
        elif self.voltage < LEAST_VOLTAGE:
            self._trip("under_voltage")
        return self._turns()

    def _turns(self) -> float:
        """Return where the motor is said to be (turns)."""
        return self.scale.raw_angle(self.motor.q) + self._shift()

    def _shift(self) -> float:
        """Return what is added to the motor's turns."""
        return self.configuration["motor_position.output.offset"] + self.offset

    def _late(self) -> None:
        """End position mode, if its watchdog's time is over."""
        now = self.clock.now()
        if self._until is not None and now >= self._until and self.mode == "position":
            self._passive(now, TIMEOUT_MODES[round(self.configuration["servo.timeout_mode"])])
            self.mode, self._until = "position_timeout", None

    def _passive(self, now: int, mode: str) -> None:
        """Have the motor do what a mode without a goal does: free, shorted, or damped."""
        if mode == "stopped":
            self.motor.free(now)
        elif mode == "brake":
            self.motor.drive(now, 0.0)
        else:
            self._damp(now)

    def _damp(self, now: int) -> None:
        """Hold no position, resist motion: mode zero velocity, and what is left after the watchdog."""
        self._law = self._law_of(nan, None, 0.0)
        self._law.stiffness = 0.0
        self.motor.obey(now, self._law)

    def _trip(self, fault: str) -> None:
        if self.mode != "fault":
            self._fail(next(code for code, name in FAULTS.items() if name == fault))

    def _fail(self, code: int) -> None:
        self.mode, self.fault_code, self._until = "fault", code, None
        self.motor.free(self.clock.now())

    @property
    def temperature(self) -> float:
        """The temperature of the board (°C): half as far above its surroundings as the winding's."""
        return (self.motor.temperature + AMBIENT) / 2

    @property
    def voltage(self) -> float:
        """The supply (V), which sinks with the current that is drawn."""
        motor = self.motor
        drawn = max(0.0, motor.duty * motor.current)
        return self.active_faults.get("brown_out", SUPPLY) - RESISTANCE * drawn

    def _most_torque(self) -> float:
        most = self.command["command_position_max_torque"]
        configured = self.configuration["servo.max_current_A"] * TORQUE_CONSTANT
        return configured if isnan(most) else min(most, configured)

    def _bounds(self) -> tuple[float, float]:
        """Return the least and the greatest position that a goal may have (turns)."""
        names = ("servopos.position_min", "servopos.position_max")
        least, most = (self.configuration[name] for name in names)
        if self.command["command_ignore_position_bounds"]:
            return -inf, inf
        return (-inf if isnan(least) else least), (inf if isnan(most) else most)

    def _limit(self, name: str) -> float:
        """Return the limit of the command, else the configured one; NaN for none."""
        given = self.command[f"command_{name}"]
        return self.configuration[f"servo.default_{name}"] if isnan(given) else given

    def _law_of(self, goal: float, target: float | None, speed: float) -> PacedGoal:
        """Return what a command has the motor do: from `goal` to `target` (turns), or on at `speed` (turn/s)."""
        scale, command, motor, values = self.scale, self.command, self.motor, self.configuration
        limit, rise, shift = self._limit("velocity_limit"), self._limit("accel_limit"), self._shift()
        fastest = min(inf if isnan(limit) else limit, values["servo.max_velocity"])
        whole = motor.motor.stall_torque
        return PacedGoal(
            goal=motor.q if isnan(goal) else scale.angle(goal - shift),
            target=None if target is None else scale.angle(target - shift),
            pace=abs(scale.speed(fastest))
            if target is not None
            else scale.speed(max(-fastest, min(fastest, speed))),
            acceleration=inf if isnan(rise) or rise <= 0.0 else abs(scale.speed(rise)),
            stiffness=scale.gain(values["servo.pid_position.kp"] / tau) * command["command_kp_scale"] / whole,
            damping=scale.gain(values["servo.pid_position.kd"] / tau) * command["command_kd_scale"] / whole,
            feed=scale.torque(command["command_feedforward_torque"]) / whole,
            limit=abs(scale.torque(self._most_torque())) / whole,
            emf=1.0 / motor.motor.speed,
        )

    def position(self, now: int) -> float:
        """Return where the joint is (rad)."""
        self._sync()
        return self.motor.q

    # ------------------------------------------------------------------ requests

    @on("Command")
    def take(self, request: Record) -> None:
        """Write registers."""
        self._write(register_values(request.subframes))
        self._listen(request)

    @on("Query")
    def answer(self, request: Record) -> None:
        """Write registers, then answer what is read."""
        self._write(register_values(request.subframes))
        self._listen(request)
        self._sync()
        # An error is what a controller answers; sent to one, it asks for nothing.
        reads = [
            subframe
            for subframe in request.subframes
            if str(subframe.kind).startswith("read_")
            and subframe.kind != "read_error"
            and subframe.reason is None
        ]
        items = [item for read in reads for item in self._answers(str(read.kind).split("_")[1], read.data)]
        if sum(len(read.data) for read in reads) > SURE:
            while len(bytes_of(items)) > FD_LENGTHS[-1]:
                items.pop()  # a frame has no room for more
        for poll in request.subframes:
            if poll.kind == "poll_stream" and poll.reason is None:
                channel = poll.data.channel
                room = FD_LENGTHS[-1] - len(bytes_of(items)) - 2 - len(varuint(channel))
                if room >= 0:
                    text = self.console.give(min(room, poll.data.most)) if channel == CHANNEL else b""
                    items.append({"kind": "stream_from_device", "data": {"channel": channel, "data": text}})
        self.reply("Reply" if self.credentials["id"] < 8 else "ReplyExtended", subframes=items)

    def _listen(self, request: Record) -> None:
        """Give the console what a frame has for it."""
        for subframe in request.subframes:
            if (
                subframe.kind == "stream_to_device"
                and subframe.reason is None
                and subframe.data.channel == CHANNEL
            ):
                self.console.take(subframe.data.data)

    def _answers(self, form: str, names: Iterable[str]) -> Iterable[dict[str, FieldValue]]:
        """Yield the values of a read, in runs between registers that do not exist."""
        run: dict[str, FieldValue] = {}
        for name in names:
            value = self.value_of(name)
            if value is not None:
                run[name] = in_type(name, form, value)
                continue
            if run:
                yield {"kind": f"reply_{form}", "data": run}
            run = {}
            yield {"kind": "read_error", "data": {"register": name, "error": NO_REGISTER}}
        if run:
            yield {"kind": f"reply_{form}", "data": run}

    def value_of(self, name: str) -> Any:
        """Return the value of a register in its unit; None where the twin has none."""
        match name:
            case "mode":
                return self.mode
            case "fault":
                return self.fault_code
            case "position" | "abs_position" | "encoder_0_position":
                return self._turns()
            case "velocity" | "encoder_0_velocity":
                return self.scale.raw_speed(self.motor.v)
            case "torque":
                return self.scale.raw_torque(self.motor.torque)
            case "q_current":
                return self.scale.direction * self.motor.current
            case "power":
                return SUPPLY * self.motor.duty * self.motor.current
            case "voltage":
                return self.voltage
            case "temperature":
                return self.temperature
            case "motor_temperature":
                return self.motor.temperature
            case "trajectory_complete":
                return int(self.mode == "position" and self._law is not None and self._law.is_steady)
            case "multiplex_id":
                return self.credentials["id"]
            case "millisecond_counter":
                return self.clock.now() // 1_000_000
            case "d_current" | "home_state":
                return 0.0 if BY_NAME[name].measure else 0
            case _:
                return self.command.get(name, FIXED.get(name))

    def _write(self, values: Mapping[str, Any]) -> None:
        turns = self._sync()
        for name in ("set_output_nearest", "set_output_exact"):
            if name in values:
                self.offset += float(values[name]) - turns
                turns = float(values[name])
        mode = values.get("mode")
        if mode is None:
            self.command.update((name, value) for name, value in values.items() if name in self.command)
            return
        # A command begins with the mode, and what it does not name is as it is by default.
        usual = {**COMMAND, "command_timeout": self.configuration["servo.default_timeout_s"]}
        self.command = usual | {name: value for name, value in values.items() if name in COMMAND}
        now = self.clock.now()
        if mode == "stopped":
            code = round(self.active_faults.get("trip", 0))
            self.mode, self.fault_code = ("fault", code) if code else ("stopped", 0)
            self._until = None
            self.motor.free(now)
            self._sync()
        elif self.mode in ("fault", "position_timeout"):
            return
        elif mode not in COMMANDED:
            self._fail(next(n for n, name in FAULTS.items() if name == "not_configured"))
        elif mode == "position":
            self._begin(turns)
        else:
            self.mode, self._until = str(mode), None
            self._passive(now, self.mode)

    def _begin(self, turns: float) -> None:
        """Begin position mode: to the position, or on from the present one, until the watchdog."""
        command, law = self.command, self._law if self.mode == "position" else None
        place, speed, stop = (
            command[f"command_{name}"] for name in ("position", "velocity", "stop_position")
        )
        speed = 0.0 if isnan(speed) else speed
        least, most = self._bounds()
        if self.mode != "position" and not least <= turns <= most:
            self._trip("start_outside_limit")
            return
        goal = turns if law is None else self.scale.raw_angle(law.goal) + self._shift()
        target: float | None = place
        if isnan(place):
            target = goal if not speed else None if isnan(stop) else stop
        if target is None and inf > (bound := most if speed > 0 else least) > -inf:
            target, command["command_velocity_limit"] = bound, abs(speed)
        if target is not None:
            target = max(least, min(most, target))
        made = self._law_of(goal, target, speed)
        made.rate = 0.0 if law is None else law.rate
        self._law, self.mode = made, "position"
        self.motor.obey(self.clock.now(), made)
        seconds = command["command_timeout"]
        self._until = None
        if not isnan(seconds):
            self._until = self.clock.now() + round(seconds * 1e9)
            self._watch.cancel()
            self._watch = self.clock.call_at(self._until, self._late)

    # ------------------------------------------------------------------ the console

    def _load(self) -> None:
        self.configuration.update(self.stored or {})

    def _store(self) -> None:
        self.stored = dict(self.configuration)

    def _debug(self, command: str, numbers: Sequence[float]) -> bool:
        """Carry out a command of the group `d`; return False for one that the twin does not know."""
        match command, len(numbers):
            case "stop", _:
                self._write({"mode": "stopped"})
            case "brake", _:
                self._write({"mode": "brake"})
            case "cfg-set-output", 1:
                self.configuration["motor_position.output.offset"] += numbers[0] - self._sync()
            case (("rezero" | "nearest"), 1):
                self._write({"set_output_nearest": numbers[0]})
            case "exact", 1:
                self._write({"set_output_exact": numbers[0]})
            case _:
                return False
        return True

    def _firmware(self) -> Fields:
        serial = tuple(FIXED[f"serial_number{place}"] for place in (1, 2, 3))
        return {
            "version": ("u32", (FIXED["firmware_version"],)),
            "serial_number": ("u32", serial),
            "model": ("u32", (FIXED["model_number"],)),
        }

    def _stats(self) -> Fields:
        """Return what moteus_tool reads of the servo: turns, turn/s, N·m, A, V, °C."""
        position = self._sync()
        code = next(number for number, name in MODES.items() if name == self.mode)
        numbers = {
            "position": position,
            "velocity": self.value_of("velocity"),
            "torque_Nm": self.value_of("torque"),
            "q_A": self.value_of("q_current"),
            "d_A": 0.0,
            "filt_bus_V": self.voltage,
            "fet_temp_C": self.temperature,
            "motor_temp_C": self.motor.temperature,
        }
        return {
            "mode": ("i32", (code,)),
            "fault": ("i32", (self.fault_code,)),
            **{name: ("f32", (value,)) for name, value in numbers.items()},
        }

    # ------------------------------------------------------------------ misbehaving

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """See `Twin.fault`; a trip ends the motion."""
        self._sync()
        super().fault(name, amount, on=on)
        jam(self, self.motor)
        if name == "trip" and on:
            self._fail(round(self.active_faults["trip"]))
        elif name == "hot" and on:
            self.motor.temperature = self.active_faults["hot"]
            del self.active_faults["hot"]  # from here on it cools
        self._sync()

    def power(self, on: bool) -> None:
        """See `Twin.power`: without power the motor turns freely."""
        self._sync()
        self.mode, self._until = "stopped", None
        self.motor.free(self.clock.now())
        super().power(on)


def in_type(name: str, form: str, value: Any) -> Any:
    """Return a value as the type can hold it: measured ones end at its end, plain numbers lose their upper bits."""
    if form == "f32" or isinstance(value, str) or isnan(value):
        return value
    limit = 1 << 8 * calcsize(TYPES[form]) - 1
    step = BY_NAME[name].step(form)
    if step is None:
        return (int(value) + limit) % (2 * limit) - limit
    return max((1 - limit) * step, min((limit - 1) * step, value))
