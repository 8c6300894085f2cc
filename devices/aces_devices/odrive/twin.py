"""The twin of an ODrive axis: heartbeat, estimates, the state machine, errors, parameters.

1. It speaks by itself as a drive from the factory does: heartbeat every 100 ms, estimates every 10 ms (can-protocol.rst).
2. Its motor moves the joint through the joint's gear; friction and inertia are `joint_model`'s choices.
3. Calibration takes half a second, and where it needs the rotor turns the motor there and back; a drive's takes longer.
4. Parameters are lost when it boots, but for those that were saved; with an endpoint file it has those of the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import tau
from random import Random
from struct import unpack
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.device.single_motor import JointScale
from aces_bus.protocol import Record
from aces_protocols.odrive.spec import RESULTS, STATES, Node

from ..joint_model import JAM, MotorModel, jam, joint_of
from .endpoints import TYPES, WATCHDOG, endpoint_bytes, read_endpoints

HEARTBEAT_S, ESTIMATES_S, CALIBRATION_S = 0.1, 0.01, 0.5
#: Procedures that turn the motor, and how fast (rev/s): choices.
TURNING, TURNING_REV_S = frozenset(("full_calibration", "index_search", "offset_calibration")), 1.0
#: From this firmware on a write is confirmed (ODriveResources can_restore_config.py).
CONFIRMS = (0, 6, 11)
#: How far the motor must have got on the way there for its calibration to succeed (rev).
LEAST_TURN = 0.05
#: What the twin's controllers hold with, at the joint: N·m/rad, N·m·s/rad. Choices.
STIFFNESS, DAMPING = 150.0, 3.0
MOTOR = MotorModel(speed=25.0, stall_current=40.0, torque_constant=0.5)
VOLTAGE = 24.0


class OdriveTwin(Twin):
    """One axis. `parameters` holds what was written over CAN, by endpoint; `stored` what of it outlives power-off."""

    protocol = "odrive"
    faults: ClassVar = {
        **JAM,
        "over_temperature": "the inverter is too hot: the axis disarms, and stays so until errors are cleared",
        "uncalibrated": "does not close its loop until a full calibration has succeeded",
        "no_heartbeat": "sends no heartbeat",
    }

    stored: dict[int, bytes] | None = None

    def setup(self) -> None:
        """Begin idle, without errors, at the present place."""
        self.is_new = self.variant.dialect == "0.6"
        joint = self.joints[0] if self.joints else None
        self.scale = JointScale.of(joint, 1 / tau)
        self.motor = joint_of(self, MOTOR)
        self.state, self.control, self.result = "idle", "position", "success"
        self.errors: frozenset[str] = frozenset()
        self.disarmed_by: frozenset[str] = frozenset()
        #: What is added to the motor's turns, as zero was set.
        self.offset = 0.0
        self.target = 0.0
        self.parameters: dict[int, bytes] = dict(self.stored or {})
        path = self.config.settings.get("endpoints")
        self.endpoints = None if path is None else read_endpoints(self.name, path)
        version = "0.6.10" if self.endpoints is None else self.endpoints.fw_version
        self.firmware = tuple(int(part) for part in version.split("."))
        #: The names of the endpoint file by number.
        self.named = (
            {} if self.endpoints is None else {one.id: name for name, one in self.endpoints.endpoints.items()}
        )
        #: When a message came last (ns), and whether somebody looks how long ago that was.
        self.fed_at, self._is_watched = self.clock.now(), False
        self.every(HEARTBEAT_S, self.beat)
        settings = self.config.settings
        if settings.get("estimates") != "asked":
            self.every(ESTIMATES_S, lambda: self.answer("EncoderEstimates"))

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """See `Twin.fault`."""
        super().fault(name, amount, on=on)
        jam(self, self.motor)

    def draw(self, dice: Random, share: float = 1.0) -> None:
        """Turn it by up to 100 turns of the motor."""
        self.motor.place(self.clock.now(), self.scale.angle(dice.uniform(-100.0, 100.0) * share))

    # ------------------------------------------------------------------ what it says

    @property
    def turns(self) -> float:
        """Position of the motor (rev)."""
        return self.scale.raw_angle(self.motor.position(self.clock.now())) + self.offset

    def beat(self) -> None:
        """Send the heartbeat; a present error disarms."""
        if "over_temperature" in self.active_faults:
            self.fail("inverter_over_temperature" if self.is_new else "over_temperature")
        if "no_heartbeat" in self.active_faults:
            return
        rest: dict[str, Any] = (
            {"result": self.result, "trajectory_done": 1}
            if self.is_new
            else {"motor": [], "encoder": [], "controller": ["trajectory_done"]}
        )
        self.reply("Heartbeat", delay_ns=0, error=sorted(self.errors), state=self.state, **rest)

    def values(self, name: str) -> dict[str, Any] | None:
        """Return the fields of what can be asked for."""
        motor, scale = self.motor, self.scale
        motor.sync(self.clock.now())
        torque = scale.raw_torque(motor.torque)
        power = motor.torque * motor.v
        match name:
            case "EncoderEstimates" | "SensorlessEstimates":
                return {"position": self.turns, "velocity": scale.raw_speed(motor.v)}
            case "EncoderCount":
                count = round(self.turns * 8192)
                return {"shadow": count, "in_cpr": count % 8192}
            case "Iq":
                return {"setpoint": motor.current, "measured": motor.current}
            case "BusVoltageCurrent":
                return {"voltage": VOLTAGE, "current": max(0.0, power) / VOLTAGE}
            case "Temperature":
                return {"inverter": motor.temperature, "motor": motor.temperature}
            case "Torques":
                return {"target": torque, "estimate": torque}
            case "Powers":
                return {"electrical": power, "mechanical": power}
            case "Errors":
                return {"active": sorted(self.errors), "disarm_reason": sorted(self.disarmed_by)}
            case "MotorError" | "EncoderError" | "SensorlessError" | "ControllerError":
                return {"error": 0}
            case "Version":
                major, minor, revision = self.firmware
                return {
                    "protocol_version": 2, "hardware_line": 4, "hardware_version": 4, "hardware_variant": 58,
                    "major": major, "minor": minor, "revision": revision, "unreleased": 0,
                }  # fmt: skip
            case "Address":
                return {
                    "address": self.credentials["node"],
                    "serial_number": 0x306839000000 | self.credentials["node"],
                }
            case _:
                return None

    def answer(self, name: str) -> None:
        """Say what can be asked for."""
        fields = self.values(name)
        if fields is not None:
            self.reply(name, **fields)

    # ------------------------------------------------------------------ its watchdog

    @property
    def watchdog_ns(self) -> int:
        """The time (ns) after which it disarms without a message; 0: its watchdog is off."""
        settings = self.config.settings
        numbers: Sequence[int] | None = settings.get("watchdog_endpoints")
        if numbers is None and self.endpoints is not None:
            known = [self.endpoints.endpoints.get(name) for name in WATCHDOG]
            numbers = [one.id for one in known if one is not None]
        if numbers is None or len(numbers) < 2:
            return round(float(settings.get("watchdog_s", 0.0)) * 1e9)
        wait, is_on = (self.parameters.get(number, bytes(4)) for number in numbers)
        seconds: float = unpack("<f", wait)[0]
        return round(seconds * 1e9) if is_on[0] else 0

    def watch(self) -> None:
        """Look when the watchdog's time is over, as long as the loop is closed: a twin that is off needs no feeding."""
        wait_ns = self.watchdog_ns
        if self._is_watched or not wait_ns or self.state != "closed_loop":
            return
        self._is_watched = True
        self.clock.call_at(max(self.clock.now(), self.fed_at + wait_ns), self._look)

    def _look(self) -> None:
        self._is_watched = False
        if self.state == "closed_loop" and 0 < self.watchdog_ns <= self.clock.now() - self.fed_at:
            self.fail("watchdog")
        self.watch()

    def receive(self, record: Record, instant: int) -> None:
        """See `Twin.receive`; each message feeds the watchdog."""
        self.fed_at = self.clock.now()
        super().receive(record, instant)
        self.watch()

    def received(self, record: Record, instant: int) -> None:
        """Answer any request, by a remote frame or by one without data."""
        name = type(record).__name__
        if name.startswith("Get"):
            self.answer(name.removeprefix("Get").removesuffix("Empty"))

    @on("Discover")
    def discovered(self, request: Record) -> None:
        """Answer, as every node does."""
        self.answer("Address")

    @on("GetAdcVoltage")
    def adc(self, request: Record) -> None:
        """Report a pin at half of 3.3 V."""
        self.reply("AdcVoltage", voltage=1.65)

    # ------------------------------------------------------------------ state and errors

    def fail(self, error: str) -> None:
        """Disarm."""
        self.errors |= {error}
        self.disarmed_by |= {error}
        self.go_idle("disarmed")

    def go_idle(self, result: str = "success") -> None:
        """Let the motor turn freely."""
        self.state, self.result = "idle", result
        self.motor.free(self.clock.now())

    @on("SetAxisState")
    def change_state(self, request: Record) -> None:
        """Enter closed loop, a calibration, or idle."""
        state = str(request.state)
        if state == "closed_loop":
            if self.errors or "uncalibrated" in self.active_faults:
                self.go_idle("not_calibrated")
                if not self.is_new:
                    self.errors |= {"invalid_state"}
                return
            self.state = state
            self.drive()
            self.watch()
        elif state.endswith("calibration") or state == "index_search":
            if self.errors:
                self.go_idle("disarmed")
                return
            self.state, self.result = state, "busy"
            self._began_at = self.turns
            self._turn(TURNING_REV_S)
            half = round(CALIBRATION_S * 0.5e9)
            self.clock.call_in(half, lambda: self._turn_back(state))
            self.clock.call_in(2 * half, lambda: self.calibrated(state))
        else:
            self.go_idle()

    def _turn(self, speed: float) -> None:
        if self.state in TURNING:
            self.motor.impede(self.clock.now(), 0.0, self.scale.speed(speed), 0.0, 4 * DAMPING, 0.0)

    def _turn_back(self, state: str) -> None:
        if self.state == state:
            if state in TURNING and abs(self.turns - self._began_at) < LEAST_TURN:
                self.go_idle("no_response")
                return
            self._turn(-TURNING_REV_S)

    def calibrated(self, state: str) -> None:
        """End a procedure."""
        if self.state == state:
            if state == "full_calibration":
                self.active_faults.pop("uncalibrated", None)
            self.go_idle()

    @on("Estop")
    def stop_now(self, request: Record) -> None:
        """Disarm with an error."""
        self.fail("estop")

    @on("ClearErrors")
    def clear(self, request: Record) -> None:
        """Clear the errors, unless their cause is there."""
        self.errors = frozenset()

    @on("Reboot")
    def boot(self, request: Record) -> None:
        """Boot: off and on; first keep or forget the parameters, if that was said."""
        action = getattr(request, "action", "reboot")
        if action != "reboot":
            self.stored = dict(self.parameters) if action == "save" else None
        self.reboot()

    # ------------------------------------------------------------------ control

    @on("SetControllerModes")
    def change_mode(self, request: Record) -> None:
        """Choose the control mode."""
        self.control = str(request.control)

    @on("SetInputPosition")
    def take_position(self, request: Record) -> None:
        """Go there."""
        self.take("position", request.position)

    @on("SetInputVelocity")
    def take_velocity(self, request: Record) -> None:
        """Turn so fast."""
        self.take("velocity", request.velocity)

    @on("SetInputTorque")
    def take_torque(self, request: Record) -> None:
        """Push so much."""
        self.take("torque", request.torque)

    def take(self, control: str, target: float) -> None:
        """Take a set-point; ignore it if it is for another mode."""
        if control == self.control:
            self.target = target
            self.drive()

    def drive(self) -> None:
        """Do what is controlled."""
        if self.state != "closed_loop":
            return
        now, scale = self.clock.now(), self.scale
        if self.control == "position":
            self.motor.impede(now, scale.angle(self.target - self.offset), 0.0, STIFFNESS, DAMPING, 0.0)
        elif self.control == "velocity":
            self.motor.impede(now, 0.0, scale.speed(self.target), 0.0, 4 * DAMPING, 0.0)
        elif self.control == "torque":
            self.motor.impede(now, 0.0, 0.0, 0.0, 0.0, scale.torque(self.target))

    # ------------------------------------------------------------------ zero, addresses, parameters

    @on("SetAbsolutePosition")
    def set_position(self, request: Record) -> None:
        """Make `position` (rev) the present position."""
        self.offset += request.position - self.turns

    @on("SetLinearCount")
    def set_count(self, request: Record) -> None:
        """Make `count` (8192 per turn) the present position."""
        self.offset += request.count / 8192 - self.turns

    @on("SetNodeId")
    def renumber(self, request: Record) -> None:
        """Take another number, if there is such a number."""
        if request.new_node in Node.values:
            self.twins.renumber(self, node=request.new_node)

    @on("RxSdo")
    def access(self, request: Record) -> None:
        """Read or write a parameter; of what was never written zeros. One that its file has not is not answered."""
        number = request.endpoint
        name = self.named.get(number, "")
        one = self.endpoints.endpoints.get(name) if self.endpoints is not None else None
        if self.endpoints is not None and (one is None or one.type not in TYPES):
            return
        type = one.type if one is not None else ""
        empty = endpoint_bytes(type, 0) if type else bytes(4)
        if request.opcode == "write" and (one is None or "w" in one.access):
            given = bytes(request.value)
            self.parameters[number] = given[: len(empty)].ljust(len(empty), b"\0") if type else given
        measured = self.measured(name)
        if request.opcode == "write" and self.firmware < CONFIRMS:
            return
        value = self.parameters.get(number, empty) if measured is None else endpoint_bytes(type, measured)
        self.reply("TxSdo", opcode=int(request.opcode == "write"), endpoint=number, value=value)

    def measured(self, name: str) -> float | None:
        """Return the value of a parameter that is measured; None for others."""
        match name:
            case "vbus_voltage":
                return VOLTAGE
            case "axis0.current_state":
                return STATES[self.state]
            case "axis0.procedure_result":
                return RESULTS[self.result]
            case _:
                return None
