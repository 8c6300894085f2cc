"""The twin of an LX-16A: a servo's shaft, registers that survive power-off.

1. A command with a number that does not exist, or an angle beyond the limits, is held to the limits, as the servo does.
2. Above its temperature limit, and beyond its voltages, the motor is not driven. Temperature and supply are choices.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.device.single_motor import JointScale
from aces_protocols.lx16a.spec import ANGLE, SERVOS, TURN

from ..joint_model import MotorModel
from ..servos.motion import DRAG, ServoShaft

#: Full speed without load (counts a second): 60° in 0.16 s at 7.4 V. The angle of a count (rad).
FREE, COUNT_RAD = 60 / 0.16 / ANGLE, math.radians(ANGLE)
#: The motor at 7.4 V: A blocked, N·m/A (17 kg·cm), and its stiffness (duty a rad) and damping (s/rad). Choices.
STALL_A, TORQUE_CONSTANT, STIFFNESS, DAMPING = 2.5, 0.67, 12.0, 0.2
#: Choices: °C without load, V.
WARMTH, SUPPLY = 35, 7.4
FACTORY = {"Offset": 0.0, "Limits": (0.0, 240.0), "VoltageLimits": (4.5, 12.0), "TemperatureLimit": 85}


class Lx16aTwin(Twin):
    """One servo. `kept` is what survives power-off; `shaft` turns in counts."""

    protocol = "lx16a"
    faults: ClassVar = {
        "hot": "is 5 °C above its highest temperature (or as hot as said, °C)",
        "low_voltage": "has 0.5 V less than its lowest voltage (or as much as said, V)",
        "jam": "cannot turn",
    }

    def setup(self) -> None:
        """Begin without torque, at the joint's start."""
        if "kept" not in self.__dict__:
            self.kept: dict[str, Any] = dict(FACTORY)
            joint = self.joints[0] if self.joints else None
            scale = JointScale.of(joint, 1.0 / COUNT_RAD)
            start = TURN / 2
            if joint is not None:
                self.world.joints[joint.name] = self
                start = scale.raw_angle(self.world.start_of(joint.name, scale.angle(start)))
            motor = MotorModel(
                speed=FREE * COUNT_RAD * (1.0 + DRAG),
                stall_current=STALL_A,
                friction=0.008,
                heating=0.15,
                cooling=120.0,
                torque_constant=TORQUE_CONSTANT,
                drag=DRAG,
            )
            start = max(0.0, min(float(TURN), start))
            ratio = scale.ratio
            self.shaft = ServoShaft(
                self, motor, scale, start, stiffness=STIFFNESS * ratio, damping=DAMPING * ratio
            )
        self.mode, self.speed, self.torque, self.led = "position", 0, "off", "on"
        self.alarms = ["temperature", "voltage", "stalled"]
        self.goal, self.time, self.later = round(self.shaft.at), 0, (round(self.shaft.at), 0)
        self._apply()

    def position(self, now: int) -> float:
        """Return the joint's angle (rad)."""
        self.shaft.settle(now)
        return self.shaft.motor.q

    @property
    def temperature(self) -> float:
        """The temperature inside (°C)."""
        if "hot" in self.active_faults:
            return float(self.active_faults["hot"] or self.kept["TemperatureLimit"] + 5)
        return WARMTH + self.shaft.warming

    @property
    def supply(self) -> float:
        """The supply voltage (V)."""
        if "low_voltage" in self.active_faults:
            return float(self.active_faults["low_voltage"] or self.kept["VoltageLimits"][0] - 0.5)
        return SUPPLY

    def _apply(self) -> None:
        """Bring the motion up to what was commanded."""
        shaft, (lowest, highest) = self.shaft, self.kept["VoltageLimits"]
        shaft.settle(self.clock.now())
        fit = self.temperature <= self.kept["TemperatureLimit"] and lowest <= self.supply <= highest
        shaft.is_driven = self.torque == "on" and fit
        shaft.is_jammed = "jam" in self.active_faults
        lower, upper = (angle / ANGLE for angle in self.kept["Limits"])
        shaft.goal = max(lower, min(upper, float(self.goal)))
        away = abs(shaft.goal - shaft.at)
        shaft.limit = min(FREE, away / (self.time / 1000)) if self.time and away else FREE
        shaft.speed = self.speed / 1000 * FREE if self.mode == "motor" else None
        shaft.apply(self.clock.now())

    def receive(self, record: Any, instant: int) -> None:
        """Take a command; what is wrong by then counts."""
        if self.is_powered:
            self._apply()
        super().receive(record, instant)

    # ------------------------------------------------------------------ motion

    @on("Move")
    def take_move(self, request: Any) -> None:
        """Begin a move; without torque it is kept, and does not move."""
        self.goal, self.time = round(request.angle / ANGLE), int(request.time)
        self._apply()

    @on("MoveLater")
    def keep_move(self, request: Any) -> None:
        """Hold a move back."""
        self.later = round(request.angle / ANGLE), int(request.time)

    @on("MoveStart")
    def start_move(self, request: Any) -> None:
        """Begin the move that was held back."""
        (self.goal, self.time) = self.later
        self._apply()

    @on("MoveStop")
    def stop_move(self, request: Any) -> None:
        """Hold where it is."""
        self.goal, self.time = round(self.shaft.at), 0
        self._apply()

    @on("SetMode")
    def take_mode(self, request: Any) -> None:
        """Follow angles, or turn."""
        self.mode, self.speed = str(request.mode), max(-1000, min(1000, request.speed))
        self._apply()

    @on("SetTorque")
    def take_torque(self, request: Any) -> None:
        """Drive the motor or not; driven anew it holds where it is."""
        if self.torque == "off":
            self.goal, self.time = round(self.shaft.at), 0
        self.torque = str(request.torque)
        self._apply()

    # ------------------------------------------------------------------ what it says

    @on("GetLastMove")
    def send_move(self, request: Any) -> None:
        """Send the last move."""
        self.reply("LastMove", angle=self.goal * ANGLE, time=self.time)

    @on("GetMode")
    def send_mode(self, request: Any) -> None:
        """Send its mode."""
        self.reply("Mode", mode=self.mode, speed=self.speed)

    @on("GetTorque")
    def send_torque(self, request: Any) -> None:
        """Send whether it is driven, as it was told."""
        self.reply("Torque", torque=self.torque)

    @on("GetTemperature")
    def send_temperature(self, request: Any) -> None:
        """Send the temperature."""
        self.reply("Temperature", temperature=round(self.temperature))

    @on("GetVoltage")
    def send_voltage(self, request: Any) -> None:
        """Send the supply voltage."""
        self.reply("Voltage", voltage=self.supply)

    @on("GetPosition")
    def send_position(self, request: Any) -> None:
        """Send where it is."""
        self.reply("Position", angle=round(self.shaft.at) * ANGLE)

    @on("GetId")
    def send_id(self, request: Any) -> None:
        """Send its number."""
        self.reply("Id", own_id=self.credentials["id"])

    # ------------------------------------------------------------------ what survives power-off

    @on("SetId")
    def take_id(self, request: Any) -> None:
        """Another number."""
        if request.new_id in SERVOS:
            self.twins.renumber(self, id=request.new_id)

    @on("SetOffset")
    def take_offset(self, request: Any) -> None:
        """Shift its angles: the shaft stays, what it says of it changes."""
        self.kept["Offset"] = request.offset

    @on("GetOffset")
    def send_offset(self, request: Any) -> None:
        """Send the offset."""
        self.reply("Offset", offset=self.kept["Offset"])

    @on("SetLimits")
    def take_limits(self, request: Any) -> None:
        """Keep the limits of the angle."""
        self.kept["Limits"] = (request.lower, request.upper)
        self._apply()

    @on("GetLimits")
    def send_limits(self, request: Any) -> None:
        """Send the limits of the angle."""
        lower, upper = self.kept["Limits"]
        self.reply("Limits", lower=lower, upper=upper)

    @on("SetVoltageLimits")
    def take_voltages(self, request: Any) -> None:
        """Keep the limits of the supply."""
        self.kept["VoltageLimits"] = (request.lowest, request.highest)
        self._apply()

    @on("GetVoltageLimits")
    def send_voltages(self, request: Any) -> None:
        """Send the limits of the supply."""
        lowest, highest = self.kept["VoltageLimits"]
        self.reply("VoltageLimits", lowest=lowest, highest=highest)

    @on("SetTemperatureLimit")
    def take_temperature(self, request: Any) -> None:
        """Keep the highest temperature."""
        self.kept["TemperatureLimit"] = request.highest
        self._apply()

    @on("GetTemperatureLimit")
    def send_temperature_limit(self, request: Any) -> None:
        """Send the highest temperature."""
        self.reply("TemperatureLimit", highest=self.kept["TemperatureLimit"])

    @on("SetLed")
    def take_led(self, request: Any) -> None:
        """Switch the LED."""
        self.led = str(request.led)

    @on("GetLed")
    def send_led(self, request: Any) -> None:
        """Send whether the LED is on."""
        self.reply("Led", led=self.led)

    @on("SetAlarms")
    def take_alarms(self, request: Any) -> None:
        """Keep what the LED flashes at."""
        self.alarms = list(request.alarms)

    @on("GetAlarms")
    def send_alarms(self, request: Any) -> None:
        """Send what the LED flashes at."""
        self.reply("Alarms", alarms=self.alarms)
