"""The twin of a D15 motor board: two motors that follow references, a home search, status bits, temperatures.

1. What it answers is RoboWorld2018's, as the spec has it; how a search goes is not stated there: it runs to 0, then says 6.
2. Control off lets a motor turn freely; a board that was off has forgotten control, home and modes, not where it stands.
"""

from __future__ import annotations

from typing import Any, ClassVar

from aces_bus.device import Joint, Twin, on

from ..joint_model import MotorJoint, MotorModel

#: A joint this far (rad) from its reference, and not moving, has a big error.
BIG = 0.1
#: How far and fast a search moves (rad/s), and its end (rad).
SEARCH_SPEED, NEAR = 0.5, 1e-3
VERSION = 20150601


class _Motor:
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
        """Where the joint is (rad)."""
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
        """As just switched on: where it stood, controlling nothing."""
        now = self.clock.now()
        self.motors: dict[int, _Motor] = {}
        for joint in self.joints:
            old = self.world.joints.get(joint.name)
            made = _Motor(joint, now, 0.0 if old is None else old.position(now))
            self.motors[joint.channel] = made
            self.world.joints[joint.name] = made
        self._round = 0
        self._ask_again: Any = None
        self._continuous = 0

    def _one(self, channel: int) -> _Motor | None:
        return self.motors.get(channel - 1)

    # ------------------------------------------------------------------ asked

    @on("SendEncoderD15")
    def encoder(self, request: Any) -> None:
        """The positions; again and again when asked so."""
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
    def status(self, request: Any) -> None:
        """Switches, home, errors, modes."""
        now = self.clock.now()
        told: list[dict[str, Any]] = []
        for number in (0, 1):
            motor = self.motors.get(number)
            if motor is None:
                told.append({"drive": 0, "home": 0, "errors": 0, "modes": 0})
                continue
            self._look(motor, now)
            told.append(
                {
                    "drive": int(motor.is_driven) | int(motor.is_controlled) << 1,
                    "home": 6 if motor.is_homed else 0,
                    "errors": motor.errors,
                    "modes": 0x80 | (int(motor.is_incremental) << 5),
                }
            )
        self.reply("StatusD15", motor=told, rest=b"")

    def _look(self, motor: _Motor, now: int) -> None:
        """What has become of it since it was looked at."""
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
    def temperature(self, request: Any) -> None:
        """Of the board and of both motors."""
        now = self.clock.now()
        found: list[float] = []
        for number in (0, 1):
            motor = self.motors.get(number)
            if motor is not None:
                motor.model.sync(now)
            found.append(
                90.0 if "hot" in self.active_faults else 25.0 if motor is None else motor.model.temperature
            )
        self.reply(
            "TemperatureD15", board_temperature=30.0, motor=[min(one, 6000.0) for one in found], rest=b""
        )

    @on("GetBoardInfoD15")
    def info(self, request: Any) -> None:
        """What it is."""
        self.reply("BoardInfoD15", period=5, unknown=bytes(2), version=VERSION, rest=b"")

    # ------------------------------------------------------------------ told

    @on("ReferenceD15")
    def reference(self, request: Any) -> None:
        """Where to."""
        now = self.clock.now()
        for number, motor in self.motors.items():
            motor.aim(request.position[number], now)

    @on("DriverSwitchD15")
    def driver(self, request: Any) -> None:
        """Driver on or off; without it nothing is controlled."""
        motor = self._one(request.channel)
        if motor is not None:
            motor.is_driven = request.state == "on"
            if not motor.is_driven:
                motor.is_controlled = False
                motor.model.free(self.clock.now())

    @on("ControlD15")
    def control(self, request: Any) -> None:
        """Control on or off."""
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
    def home(self, request: Any) -> None:
        """Search: to 0, which the stored settings stand for."""
        motor = self._one(request.channel)
        if motor is not None and motor.is_controlled:
            motor.is_homed, motor.searching, motor.goal = False, True, 0.0
            motor.model.follow(self.clock.now(), 0.0)

    @on("ClearErrorD15")
    def clear(self, request: Any) -> None:
        """Errors are gone, until there is a reason for them again."""
        motor = self._one(request.channel)
        if motor is not None:
            motor.errors = 0

    @on("PositionModeD15")
    def position_mode(self, request: Any) -> None:
        """What references count from."""
        motor = self._one(request.channel)
        if motor is not None:
            motor.is_incremental = request.mode == "incremental"
