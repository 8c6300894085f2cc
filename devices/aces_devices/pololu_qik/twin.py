"""The twin of a Pololu qik: parameters that outlive power-off, errors, two motors with wheels.

1. A command that is not understood is none: the scanner drops it. What the device would make of it (a format error) is
   a fault on request.
2. A motor's speed follows its duty with one time constant, exactly; free, it runs out with another. They are choices.
"""

from __future__ import annotations

from typing import ClassVar

from aces_bus.device import Twin, on
from aces_bus.protocol import Record
from aces_bus.runtime.clock import Timer
from aces_devices.wheel_model import TurningWheel

#: A unit of the serial time-out (s), and how the parameter holds it (Pololu 0J25 5.c).
UNIT_S = 0.262
#: rad/s at full duty; s.
SPEED, DRIVEN, FREE = 20.0, 0.1, 1.0
#: Power-up values of a device from the factory (0J25 5.c); the number is the robot file's.
FACTORY = {"pwm": 0, "shutdown_on_error": 1, "serial_timeout": 0}
#: The largest value of each parameter.
LARGEST = {"device_id": 127, "pwm": 3, "shutdown_on_error": 1, "serial_timeout": 127}
#: Setting a parameter takes so long (ns).
SETTING_NS = 4_000_000
#: Error bits.
OVERRUN, FRAME, FORMAT, TIMEOUT = 8, 16, 64, 128


class Wheel:
    """A motor with what it turns: `drive` or `free` it."""

    __slots__ = ("duty", "position", "speed", "turning")

    def __init__(self, now: int) -> None:
        self.turning = TurningWheel(now)
        self.position, self.speed = self.turning.position, self.turning.speed
        #: The duty that it is driven with, −1…1; None: it turns freely.
        self.duty: float | None = None

    def drive(self, now: int, duty: float) -> None:
        """Drive it at this share of the supply; 0 brakes."""
        self.duty = duty
        self.turning.lead(now, SPEED * duty, DRIVEN)

    def free(self, now: int) -> None:
        """Let it run out."""
        self.duty = None
        self.turning.lead(now, 0.0, FREE)


class _Joint:
    """A wheel as the robot's joint: with its direction."""

    __slots__ = ("_direction", "_wheel")

    def __init__(self, wheel: Wheel, direction: int) -> None:
        self._wheel, self._direction = wheel, direction

    def position(self, now: int) -> float:
        """Return where the joint is (rad)."""
        return self._direction * self._wheel.position(now)


class QikTwin(Twin):
    """A device: `wheels`, `parameters`, `errors` (bits)."""

    protocol = "pololu_qik"
    faults: ClassVar = {
        "overrun": "each command also counts as a data overrun",
        "frame": "each command also counts as a frame error, as at another speed",
    }
    parameters: dict[str, int]

    def setup(self) -> None:
        """Begin as just powered: motors free, no errors. Parameters are as they were left."""
        now = self.clock.now()
        if "parameters" not in self.__dict__:
            self.parameters = {"device_id": self.credentials["id"], **FACTORY}
            self.wheels = (Wheel(now), Wheel(now))
            for joint in self.joints:
                self.world.joints[joint.name] = _Joint(self.wheels[joint.channel], joint.direction)
        self.errors = 0
        self.received_at = now
        self._watch: Timer | None = None
        for wheel in self.wheels:
            wheel.free(now)

    def receive(self, record: Record, instant: int) -> None:
        """Take any command to this device, in time or not."""
        if self.is_powered:
            self.received_at = instant
            self._watch_over()
            if "overrun" in self.active_faults:
                self._failed(OVERRUN)
            if "frame" in self.active_faults:
                self._failed(FRAME)
        super().receive(record, instant)

    # ------------------------------------------------------------------ errors and the serial time-out

    def _failed(self, bit: int) -> None:
        self.errors |= bit
        if self.parameters["shutdown_on_error"]:
            for wheel in self.wheels:
                wheel.free(self.clock.now())

    @property
    def timeout_ns(self) -> int:
        """The serial time-out (ns), 0 for none."""
        code = self.parameters["serial_timeout"]
        return round(UNIT_S * 1e9 * (code & 15) * (1 << (code >> 4)))

    def _watch_over(self) -> None:
        if self._watch is None and self.timeout_ns:
            self._watch = self.clock.call_at(self.received_at + self.timeout_ns, self._is_late)

    def _is_late(self) -> None:
        self._watch = None
        if not self.is_powered or not self.timeout_ns:
            return
        if self.clock.now() - self.received_at >= self.timeout_ns:
            self._failed(TIMEOUT)
        else:
            self._watch_over()

    # ------------------------------------------------------------------ commands

    @on("GetFirmware")
    def send_firmware(self, request: Record) -> None:
        """Send version 1."""
        self.reply("Firmware", version="1")

    @on("GetError")
    def send_errors(self, request: Record) -> None:
        """Send the errors and clear them."""
        bits, self.errors = self.errors, 0
        self.reply("Errors", errors=bits)

    @on("GetConfiguration")
    def send_parameter(self, request: Record) -> None:
        """Send a parameter; for an unknown number send 0xFF, and note a format error."""
        known = self.parameters.get(str(request.parameter))
        if known is None:
            self._failed(FORMAT)
        self.reply("Configuration", value=0xFF if known is None else known)

    @on("SetConfiguration")
    def take_parameter(self, request: Record) -> None:
        """Keep it, or say why not."""
        name, value = str(request.parameter), request.value
        result = "ok"
        if name not in self.parameters:
            result = "bad_parameter"
        elif value > LARGEST[name]:
            result = "bad_value"
        if result != "ok":
            self._failed(FORMAT)
            self.reply("ConfigurationSet", result=result, delay_ns=SETTING_NS)
            return
        self.parameters[name] = value
        if name == "pwm":
            for wheel in self.wheels:
                wheel.drive(self.clock.now(), 0.0)
        self.reply("ConfigurationSet", result=result, delay_ns=SETTING_NS)
        if name == "device_id":
            self.twins.renumber(self, id=value)
        self._watch_over()

    @on("Coast")
    def take_coast(self, request: Record) -> None:
        """Let a motor run out."""
        self.wheels[request.motor].free(self.clock.now())

    @on("SetSpeed")
    def take_speed(self, request: Record) -> None:
        """Drive a motor: of 127 steps, or of 255 in the 8-bit range."""
        duty = (
            (request.speed + 128 * request.high) / 255 if self.parameters["pwm"] & 1 else request.speed / 127
        )
        self.wheels[request.motor].drive(self.clock.now(), -duty if request.reverse else duty)

    def power(self, on: bool) -> None:
        """See `Twin.power`; without power the motors run out."""
        if not on:
            for wheel in self.wheels:
                wheel.free(self.clock.now())
        super().power(on)

    def stop(self) -> None:
        """End what repeats."""
        if self._watch is not None:
            self._watch.cancel()
        super().stop()
