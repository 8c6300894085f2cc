"""The simulated X-series servo: what it has beyond what all servos have.

Source: ROBOTIS e-manual, protocol 2.0 and control tables; where it is silent, see the README's choices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, tau
from typing import Any, ClassVar

from aces_bus.device import on
from aces_bus.device.single_motor import JointScale
from aces_bus.protocol import Record
from aces_protocols.dynamixel.control_table import ANGLE, HARDWARE_ERRORS, MODES, SPEED, WATCHDOG_ERROR
from aces_protocols.dynamixel.models import MODEL_NAMES, MODELS
from aces_protocols.dynamixel.spec import BROADCAST, CRC, control_table, packet

from ..joint_model import MotorModel
from ..servos.motion import DRAG, ServoShaft
from ..servos.registers import RegisterCodec
from ..servos.twin import WRITE, RegisterTable, ServoTwin
from .driver import ACCELERATION_STEP, FAR, PWM, TURN, Dynamixel, DynamixelSettings, mode_of

RAM = 64
#: Choices: firmware 46, 12 V (or the middle of what the model takes), 32 °C without load.
FIRMWARE, SUPPLY, WARMTH = 46, 120, 32
#: The stall current as a share of the current limit, or in A where there is none; N·m/A of an XM430-W350; s/rad. Choices.
STALL, STALL_A, TORQUE_CONSTANT, DAMPING = 0.72, 1.4, 1.78, 0.2
#: Counts a second at one count of velocity.
PER_SPEED = SPEED * 6 / ANGLE
#: Counts a second² at one count of acceleration.
PER_ACCELERATION = ACCELERATION_STEP / Dynamixel.count_rad
#: A count of the watchdog (ns).
WATCHDOG_NS = 20_000_000
GOALS = frozenset(("goal_position", "goal_velocity", "goal_current", "goal_pwm"))
#: The bytes of a status without parameters.
STATUS = 11
INSTRUCTION, STATUS_CODE = 7, 0x55


class DynamixelTwin(ServoTwin):
    """One servo. `table` is its memory; `self["goal_position"]` a register's raw number."""

    protocol = "dynamixel"
    settings_type = DynamixelSettings
    settings: DynamixelSettings
    places = RegisterTable(control_table)
    ram_start = RAM
    no_stretch = "data_length"
    status_bytes = STATUS
    faults: ClassVar[Mapping[str, str]] = {
        "hot": "is 5 °C above its highest temperature (or as hot as said, °C)",
        "low_voltage": "has 0.5 V less than its lowest voltage (or as much as said, V)",
        "jam": "cannot turn: where it should, it pushes until it is overloaded",
        "overload": "reports an overload",
    }

    def make(self) -> None:
        """Make it as delivered, with the speed, delay, level and mode that the robot's file means."""
        joint = self.joints[0] if self.joints else None
        self.model = MODEL_NAMES.get(self.config.model or "", MODELS[0])
        self._factory()
        self.tune()
        self["return_delay"] = round(self.settings.return_delay_us / 2)
        self["operating_mode"] = MODES[mode_of(joint, self.settings)]
        scale = JointScale.of(joint, 1.0 / Dynamixel.count_rad)
        start = TURN / 2
        if joint is not None:
            self.world.joints[joint.name] = self
            start = float(self._clipped(round(scale.raw_angle(self.world.start_of(joint.name)))))
        model = self.model
        step = model.current_step_a
        motor = MotorModel(
            speed=model.velocity_limit * SPEED * tau / 60 * (1.0 + DRAG),
            stall_current=STALL_A if step is None else STALL * model.current_limit * step,
            friction=0.008,
            heating=0.1,
            cooling=150.0,
            torque_constant=TORQUE_CONSTANT,
            drag=DRAG,
        )
        self.motion = ServoShaft(self, motor, scale, start, stiffness=1.0, damping=DAMPING)

    def _clipped(self, count: int) -> int:
        low, high = (0, TURN - 1) if self["operating_mode"] == MODES["position"] else (-FAR, FAR)
        return max(low, min(high, count))

    def _factory(self) -> None:
        self.load_defaults(0, RAM)
        model = self.model
        self["model_number"], self["firmware_version"] = model.number, FIRMWARE
        self["temperature_limit"], self["shutdown"] = model.temperature_limit, model.shutdown
        self["min_voltage_limit"], self["max_voltage_limit"] = model.voltages
        self["current_limit"], self["velocity_limit"] = model.current_limit, model.velocity_limit

    def begin(self) -> None:
        """Load the RAM's defaults; goals are the limits, or the present place."""
        now = self.clock.now()
        super().begin()
        #: When it last had an instruction (ns).
        self._instructed_at, self._is_watched = now, False
        self.motion.settle(now)
        self.load_defaults(RAM, len(self.table))
        self["status_return_level"] = self.settings.status_return_level
        for name, value in self.model.gains._asdict().items():
            self[f"{name}_gain"] = value
        self["goal_pwm"], self["goal_current"] = self["pwm_limit"], self["current_limit"]
        if self["operating_mode"] == MODES["pwm"]:
            self["goal_pwm"] = 0
        elif self["operating_mode"] == MODES["current"]:
            self["goal_current"] = 0
        self["goal_position"] = round(self.motion.at)
        self.apply()

    @property
    def last_count(self) -> int:
        """The last position of a turn, in counts of its shaft."""
        return TURN - 1

    # ------------------------------------------------------------------ motion

    def position(self, now: int) -> float:
        """Return the joint's angle (rad)."""
        self._watch(now)
        self.motion.settle(now)
        return self.motion.motor.q

    def before_write(self) -> None:
        """Settle the motion up to now."""
        self.motion.settle(self.clock.now())

    def apply(self) -> None:
        """Apply the registers to the motion."""
        motion, mode, now = self.motion, self["operating_mode"], self.clock.now()
        motion.is_driven = bool(self["torque_enable"])
        motion.is_jammed = "jam" in self.active_faults
        free = self["velocity_limit"] * PER_SPEED
        profile = self["profile_velocity"] * PER_SPEED
        motion.limit = min(free, profile) if profile else free
        motion.acceleration = self["profile_acceleration"] * PER_ACCELERATION or inf
        # PWM for each count of error: raw ÷ 128 (ROBOTIS e-manual); at the joint a rad has as many counts as its ratio says.
        motion.stiffness = self["position_p_gain"] / 128 / PWM * abs(motion.scale.raw_speed(1.0))
        motion.goal = float(self["goal_position"])
        motion.strength = abs(self["goal_pwm"]) / PWM
        motion.speed = motion.duty = motion.current = None
        is_stopped = self["bus_watchdog"] == WATCHDOG_ERROR
        if is_stopped:
            motion.goal = motion.at
        if mode == MODES["velocity"]:
            motion.speed = 0.0 if is_stopped else self["goal_velocity"] * PER_SPEED
        elif mode == MODES["pwm"]:
            motion.strength, motion.duty = 1.0, 0.0 if is_stopped else self["goal_pwm"] / PWM
        elif mode == MODES["current"]:
            motion.current = 0.0 if is_stopped else self["goal_current"] / self._stall
        elif mode == MODES["current_based_position"]:
            motion.strength = min(motion.strength, abs(self["goal_current"]) / self._stall)
        motion.apply(now)

    @property
    def _stall(self) -> float:
        """The stall current, in counts of the model's currents."""
        step = self.model.current_step_a
        return 1000.0 if step is None else self.motion.motor.motor.stall_current / step

    def _keep_watch(self) -> None:
        """Look when the watchdog's time is over, while it is on and the motor driven."""
        steps = self["bus_watchdog"]
        if steps and steps != WATCHDOG_ERROR and self["torque_enable"] and not self._is_watched:
            self._is_watched = True
            end = self._instructed_at + steps * WATCHDOG_NS
            self.clock.call_at(max(end, self.clock.now()) + 1, self._look)

    def _look(self) -> None:
        self._is_watched = False
        self._watch(self.clock.now())
        self._keep_watch()

    def _watch(self, now: int) -> None:
        """Stop when the watchdog's time was over since the last instruction."""
        steps = self["bus_watchdog"]
        end = self._instructed_at + steps * WATCHDOG_NS
        if steps and steps != WATCHDOG_ERROR and self["torque_enable"] and now > end:
            self["bus_watchdog"] = WATCHDOG_ERROR
            self.apply()

    def measure(self) -> int:
        """Bring what is measured up to date; the hardware errors, which stay until it is restarted."""
        now = self.clock.now()
        self._watch(now)
        motion, faults = self.motion, self.active_faults
        if motion.is_jammed is not ("jam" in faults):
            self.apply()
        speed = motion.speed_at(now)
        self["present_position"] = round(motion.at)
        self["present_velocity"] = round(speed / PER_SPEED)
        self["present_pwm"] = round(motion.drive * PWM)
        self["present_current"] = round(motion.load * self._stall)
        self["moving"] = abs(speed) > self["moving_threshold"] * PER_SPEED
        self["registered_instruction"] = self.is_holding
        self["realtime_tick"] = now // 1_000_000 % 0x8000
        lowest, highest = self.model.voltages
        errors = self["hardware_error"] | self.alarms(
            HARDWARE_ERRORS,
            pushes=motion.pushes,
            hottest="temperature_limit",
            lowest="min_voltage_limit",
            highest="max_voltage_limit",
            supply=min(SUPPLY, (lowest + highest) // 2),
            warmth=round(WARMTH + motion.warming),
        )
        self["hardware_error"] = errors
        if errors & self["shutdown"] and self["torque_enable"]:
            self["torque_enable"] = 0
            self.apply()
        return errors

    # ------------------------------------------------------------------ instructions

    def receive(self, record: Record, instant: int) -> None:
        """Carry out an instruction; each of them resets the watchdog."""
        if self.is_powered and self.is_tuned:
            self._watch(self.clock.now())
            self._instructed_at = self.clock.now()
            super().receive(record, instant)
            self._keep_watch()

    def refused(self, why: str) -> Any:
        """Return the number of a refusal, by its name."""
        return {"range": "data_range"}.get(why, why) or "none"

    def with_errors(self, refusal: Any, errors: int) -> Any:
        """Add to a status whether register 70 reports an error."""
        return {"code": refusal, "alert": bool(errors)}

    def wrong_place(self, address: int, codec: RegisterCodec | None) -> str:
        """Read only, of the EEPROM with the torque on, or a goal after the watchdog has stopped it."""
        if (codec is not None and codec.register.access == "read") or (
            address < RAM and self["torque_enable"]
        ):
            return "access"
        if codec is not None and codec.name in GOALS and self["bus_watchdog"] == WATCHDOG_ERROR:
            return "data_range"
        return ""

    def wrong_value(self, name: str, value: int) -> str:
        """Return the error of a value: goals have limits of their own."""
        if why := super().wrong_value(name, value):
            return why
        if name == "operating_mode" and value not in MODES.values():
            return "data_range"
        low, high = -FAR, FAR
        if name == "goal_position" and self["operating_mode"] == MODES["position"]:
            low, high = self["min_position_limit"], self["max_position_limit"]
        elif name in ("goal_velocity", "goal_current", "goal_pwm"):
            high = self[name.replace("goal", "").strip("_") + "_limit"]
            low = -high
        return "" if low <= value <= high else "data_limit"

    def identification(self) -> bytes:
        """Return model and firmware."""
        return bytes(self.table[0:2]) + bytes(self.table[6:7])

    @on("SyncRead")
    def answer_together(self, request: Record) -> None:
        """Answer after the servos that are asked before."""
        self.answer_in_turn([(number, request.start, request.count) for number in request.ids])

    @on("BulkRead")
    def answer_bulk(self, request: Record) -> None:
        """Answer with the servo's own area, after the servos that are asked before it."""
        self.answer_in_turn(_areas(request))

    @on("FastSyncRead")
    def answer_fast(self, request: Record) -> None:
        """Answer with a part of a joint status."""
        self._jointly([(number, request.start, request.count) for number in request.ids])

    @on("FastBulkRead")
    def answer_fast_bulk(self, request: Record) -> None:
        """Answer with a part of a joint status, from the servo's own area."""
        self._jointly(_areas(request))

    def _jointly(self, areas: Sequence[tuple[int, int, int]]) -> None:
        """Send, as the first servo, the parts of all servos in one status; it ends before the first servo
        that is absent.

        A request for more than a packet holds is not answered.

        There is no answer to a request of more than one packet holds.
        """
        if not areas or areas[0][0] != self.credentials["id"]:
            return
        if 10 + sum(4 + count for _, _, count in areas) > packet.max_size:
            return
        present = {
            other.credentials["id"]: other
            for other in self.twins.members.values()
            if isinstance(other, DynamixelTwin) and other.is_powered and other.is_tuned
        }
        length = 1 + sum(4 + count for _, _, count in areas)
        whole = (
            b"\xff\xff\xfd\x00" + bytes((BROADCAST,)) + length.to_bytes(2, "little") + bytes((STATUS_CODE,))
        )
        for number, start, count in areas:
            twin = present.get(number)
            if twin is None:
                break
            errors = twin.measure()
            data = twin.stretch(start, count)
            whole += bytes((bool(errors) << 7, number)) + (bytes(count) if data is None else data)
            whole += CRC.compute(whole).to_bytes(2, "little")
        self.clock.call_in(self.delay_ns, lambda: self.send_raw(whole))

    @on("BulkWrite")
    def obey_bulk(self, request: Record) -> None:
        """Obey the servo's own part of a bulk write."""
        mine = self.credentials["id"]
        for servo in request.servos:
            if servo.id == mine:
                self.put(servo.start, servo.data)

    @on("Reboot")
    def restart(self, request: Record) -> None:
        """Begin as after power-off: full turns are forgotten, too."""
        self.answer(request)
        self.motion.settle(self.clock.now())
        self.motion.at %= TURN
        self.begin()

    @on("Clear")
    def forget_turns(self, request: Record) -> None:
        """Reduce the position to one turn; refused while torque is on."""
        why = "result_fail" if self["torque_enable"] else ""
        self.answer(request, WRITE, why)
        if not why:
            self.before_write()
            self.motion.at %= TURN
            self["goal_position"] = round(self.motion.at)
            self.apply()

    @on("FactoryReset")
    def reset(self, request: Record) -> None:
        """Set all as from the factory; id and speed where they are to be kept."""
        if request.id == BROADCAST and request.keep == "nothing":
            return
        self.answer(request)
        number, baud = self["id"], self["baud_rate"]
        self._factory()
        if request.keep in ("id", "id_and_baud"):
            self["id"] = number
        if request.keep == "id_and_baud":
            self["baud_rate"] = baud
        self.begin()
        self.twins.renumber(self, id=self["id"])

    def not_understood(self, data: bytes, reason: str) -> None:
        """Answer an instruction with a wrong check, or an unknown instruction, with that error."""
        if (
            len(data) < STATUS - 1
            or data[4] != self.credentials["id"]
            or not self.is_powered
            or not self.is_tuned
        ):
            return
        if data[INSTRUCTION] == STATUS_CODE:
            return
        if reason == "malformed: checksum":
            self.answer(None, WRITE, "crc")
        elif reason == "unknown":
            self.answer(None, WRITE, "instruction")


def _areas(request: Record) -> list[tuple[int, int, int]]:
    return [(area.id, area.start, area.count) for area in request.areas]
