"""The twin of a moteus: registers in any of their types, position mode with its limits and watchdog, faults.

1. What is written counts when the frame is over, the mode first; what is read is answered in the type that was asked for.
2. The motor follows its command exactly, no faster than the velocity limit; torque is the command's, within its limit. Both
   are choices: nothing here swings, heats or slips.
3. A command lasts until its watchdog; then the controller is in mode 11, which only a stop ends.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import inf, isnan, nan, tau
from random import Random
from struct import calcsize
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.frames import FD_LENGTHS
from aces_bus.protocol import Record
from aces_protocols.moteus.registers import BY_NAME, FAULTS, TYPES
from aces_protocols.moteus.subframes import bytes_of, register_values

#: The watchdog of a command that names none (s), the configured maximum torque (N·m), the fastest the motor turns (turn/s).
TIMEOUT_S, MAX_TORQUE, MAX_VELOCITY = 0.1, 3.0, 20.0
#: What the twin measures besides: V, °C; model, firmware, register map, serial numbers.
FIXED = {
    "voltage": 24.0,
    "temperature": 31.0,
    "motor_temperature": 0.0,
    "model_number": 0x0100,
    "firmware_version": 0x010A,
    "register_map_version": 5,
    "serial_number1": 0x1234,
    "serial_number2": 0x5678,
    "serial_number3": 0x4D4F,
}
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
    """A controller: `mode`, `fault`, `command` (the registers of position mode), `position(now)` of its joint (rad)."""

    protocol = "moteus"
    faults: ClassVar = {
        "jam": "the motor does not turn",
        "trip": "a fault, 38 over-temperature (or the code said), until it is over and the controller is stopped",
    }
    amounts: ClassVar = {"trip": 38}

    def setup(self) -> None:
        """Begin as just powered: stopped, where the motor is."""
        joint = self.joints[0] if self.joints else None
        self._per_rad = (joint.direction if joint else 1) * ((joint.ratio if joint else None) or 1.0) / tau
        self._zero = (joint.zero or 0.0) * (joint.direction if joint else 1) if joint else 0.0
        if "_turns" not in self.__dict__:
            start = self.world.start_of(joint.name) if joint else 0.0
            self._turns, self._at = (start + self._zero) * self._per_rad, self.clock.now()
            if joint is not None:
                self.world.joints[joint.name] = self
        self.mode, self.fault_code = "stopped", 0
        self.command: dict[str, float] = dict(COMMAND)
        #: Where it is led (turns), None: on and on at the speed; how fast (turn/s); the watchdog's end.
        self._goal: float | None = None
        self._speed = 0.0
        self._until: int | None = None

    def draw(self, dice: Random, share: float = 1.0) -> None:
        """Turn it by up to 1000 turns of the motor."""
        self._sync()
        self._turns = dice.uniform(-1000.0, 1000.0) * share

    # ------------------------------------------------------------------ motion

    def _sync(self) -> float:
        """Return where the motor is (turns); what happened since is caught up."""
        now = self.clock.now()
        end = now if self._until is None else min(now, self._until)
        passed = max(0, end - self._at) / 1e9
        if self.mode == "position" and "jam" not in self.active_faults:
            self._turns += self._way(passed)
        if self._until is not None and now >= self._until and self.mode == "position":
            self.mode, self._until = "position_timeout", None
        self._at = now
        return self._turns

    def _limit(self) -> float:
        limit = self.command["command_velocity_limit"]
        return MAX_VELOCITY if isnan(limit) else min(limit, MAX_VELOCITY)

    def _way(self, seconds: float) -> float:
        reach = self._limit() * seconds
        if self._goal is None:
            return max(-reach, min(reach, self._speed * seconds))
        way = self._goal - self._turns
        return max(-reach, min(reach, way))

    def _velocity(self) -> float:
        if self.mode != "position" or "jam" in self.active_faults:
            return 0.0
        limit = self._limit()
        if self._goal is None:
            return max(-limit, min(limit, self._speed))
        way = self._goal - self._turns
        return 0.0 if not way else limit if way > 0 else -limit

    def _torque(self) -> float:
        most = self.command["command_position_max_torque"]
        most = MAX_TORQUE if isnan(most) else min(most, MAX_TORQUE)
        wanted = self.command["command_feedforward_torque"]
        if "jam" in self.active_faults and self._goal is not None and self._goal != self._turns:
            wanted = inf if self._goal > self._turns else -inf
        return max(-most, min(most, wanted)) if self.mode == "position" else 0.0

    def position(self, now: int) -> float:
        """Return where the joint is (rad)."""
        return self._sync() / self._per_rad - self._zero

    # ------------------------------------------------------------------ requests

    @on("Command")
    def take(self, request: Record) -> None:
        """Write registers."""
        self._write(register_values(request.subframes))

    @on("Query")
    def answer(self, request: Record) -> None:
        """Write registers, then answer what is read."""
        self._write(register_values(request.subframes))
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
        self.reply("Reply" if self.credentials["id"] < 8 else "ReplyExtended", subframes=items)

    def _answers(self, form: str, names: Iterable[str]) -> Iterable[dict[str, Any]]:
        """Yield the values of a read, in runs between registers that do not exist."""
        run: dict[str, Any] = {}
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
                return self._turns
            case "velocity" | "encoder_0_velocity":
                return self._velocity()
            case "torque":
                return self._torque()
            case "trajectory_complete":
                return int(self._goal is not None and self._goal == self._turns)
            case "multiplex_id":
                return self.credentials["id"]
            case "millisecond_counter":
                return self.clock.now() // 1_000_000
            case "q_current" | "d_current" | "power" | "home_state":
                return 0.0 if BY_NAME[name].measure else 0
            case _:
                return self.command.get(name, FIXED.get(name))

    def _write(self, values: Mapping[str, Any]) -> None:
        self._sync()
        for name in ("set_output_nearest", "set_output_exact"):
            if name in values:
                self._turns = float(values[name])
        mode = values.get("mode")
        if mode is None:
            self.command.update((name, value) for name, value in values.items() if name in self.command)
            return
        # A command begins with the mode, and what it does not name is as it is by default.
        self.command = {**COMMAND, **{name: value for name, value in values.items() if name in COMMAND}}
        if mode == "stopped":
            code = round(self.active_faults.get("trip", 0))
            self.mode, self.fault_code = ("fault", code) if code else ("stopped", 0)
            self._until = None
        elif self.mode in ("fault", "position_timeout"):
            return
        elif mode not in COMMANDED:
            self.mode, self.fault_code = (
                "fault",
                next(n for n, name in FAULTS.items() if name == "not_configured"),
            )
        elif mode == "position":
            self._begin()
        else:
            self.mode, self._until = str(mode), None

    def _begin(self) -> None:
        """Begin position mode: to the position, or on from the present one, until the watchdog."""
        command = self.command
        place, speed, stop = (
            command[f"command_{name}"] for name in ("position", "velocity", "stop_position")
        )
        if isnan(place):
            held = self._goal if self.mode == "position" and self._goal is not None else self._turns
            self._goal = held if not speed else None if isnan(stop) else stop
        else:
            self._goal = place
        self._speed, self.mode = (0.0 if isnan(speed) else speed), "position"
        seconds = command["command_timeout"]
        self._until = None if isnan(seconds) else self.clock.now() + round(seconds * 1e9)

    # ------------------------------------------------------------------ misbehaving

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """See `Twin.fault`; a trip ends the motion."""
        self._sync()
        super().fault(name, amount, on=on)
        if name == "trip" and on:
            self.mode, self.fault_code, self._until = "fault", round(self.active_faults["trip"]), None

    def power(self, on: bool) -> None:
        """See `Twin.power`: without power the motor stays where it is."""
        self._sync()
        self.mode = "stopped"
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
