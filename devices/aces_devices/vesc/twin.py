"""The twin of a VESC: set-points with their time-out, status messages, packets in pieces.

1. Every set-point, and ALIVE, restarts the time-out; when it is over the motor is released (vedderb/bldc timeout.c).
2. Speed follows each kind of set-point with a time constant of its own; no load, no friction. These are choices.
"""

from __future__ import annotations

from math import tau
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_devices.wheel_model import TurningWheel
from aces_protocols.vesc.buffers import Buffers, can_pieces
from aces_protocols.vesc_uart.packets import PacketReader, packet_of
from aces_protocols.vesc_uart.spec import FAULTS, VALUES

#: Without a set-point for so long the motor is released (s): the factory's.
TIMEOUT_S = 1.0
#: The motor: rad/s at full duty, rad/s a A when nothing holds it, s to follow.
SPEED, PER_AMPERE = 600.0, 30.0
DRIVEN_S, PUSHED_S, BRAKED_S, FREE_S = 0.05, 0.5, 0.1, 0.5
#: Volts of the supply; °C.
SUPPLY, WARM = 48.2, 31.0
#: How often status messages are sent where the robot's file says so (s): the first group's default.
STATUS_S = 0.02
#: Firmware 6.05 on hardware "60".
FIRMWARE = {"major": 6, "minor": 5, "hardware": "60", "more": bytes(range(12)) + bytes(7)}


class VescTwin(Twin):
    """A controller: `mode`, `given` (what the last set-point said), `fault_name`, `position(now)` of its joint (rad)."""

    protocol = "vesc"
    faults: ClassVar = {
        "trip": "reports a fault, over_temperature_fet (or the number said), and releases the motor while it lasts",
        "jam": "the motor does not turn, and takes what current it is given",
        "deaf": "answers, and takes no set-points",
    }
    amounts: ClassVar = {"trip": FAULTS["over_temperature_fet"]}

    def setup(self) -> None:
        """Just powered: released. The motor stays where it is; counters begin at 0."""
        now = self.clock.now()
        joint = self.joints[0] if self.joints else None
        self._direction = joint.direction if joint else 1
        self._zero = (joint.zero or 0.0) if joint else 0.0
        self._ratio = (joint.ratio if joint else None) or 1.0
        self.pole_pairs = int(self.config.settings.get("pole_pairs", 7))
        if "motor" not in self.__dict__:
            self.motor = TurningWheel(now)
            if joint is not None:
                start = self._direction * self.world.start_of(joint.name) + self._zero
                self.motor.place(now, start * self._ratio)
                self.world.joints[joint.name] = self
        self._start = self.motor.position(now)
        #: No two controllers are equally warm (°C).
        self.warm = round(WARM + self.random.uniform(-3.0, 3.0), 1)
        self.mode, self.given = "free", 0.0
        self.credentials["receiver"] = self.credentials["id"]
        self.buffers = Buffers(self.credentials["id"])
        self.reader = PacketReader("to device")
        self._late: Any = None
        self._lead()
        if self.config.settings.get("values") == "status":
            self.every(STATUS_S, self.tell_status)

    # ------------------------------------------------------------------ motion

    def position(self, now: int) -> float:
        """Where the joint is (rad)."""
        return self._direction * (self.motor.position(now) / self._ratio - self._zero)

    @property
    def fault_name(self) -> str:
        """The fault that it reports."""
        number = round(self.active_faults.get("trip", 0))
        return next((name for name, one in FAULTS.items() if one == number), "none")

    def _lead(self) -> None:
        """Have the motor do what the last set-point said."""
        now, given = self.clock.now(), self.given
        mode = "free" if "trip" in self.active_faults else self.mode
        match mode:
            case "duty":
                self.motor.lead(now, SPEED * given, DRIVEN_S)
            case "current":
                speed = max(-SPEED, min(SPEED, PER_AMPERE * given))
                self.motor.lead(now, speed, PUSHED_S if given else FREE_S)
            case "speed":
                self.motor.lead(now, given * tau / 60 / self.pole_pairs, DRIVEN_S)
            case "position":
                turn = (given / 360 * tau - self.motor.position(now) + tau / 2) % tau - tau / 2
                self.motor.place(now, self.motor.position(now) + turn)
            case "brake" | "hold":
                self.motor.lead(now, 0.0, BRAKED_S)
            case _:
                self.motor.lead(now, 0.0, FREE_S)
        if "jam" in self.active_faults:
            self.motor.block(now)

    def _take(self, mode: str, given: float) -> None:
        """A set-point."""
        if "deaf" in self.active_faults:
            return
        self.mode, self.given = mode, given
        self._lead()
        self._alive()

    def _alive(self) -> None:
        if self._late is not None:
            self._late.cancel()
        self._late = self.clock.call_in(round(TIMEOUT_S * 1e9), self._timed_out)

    def _timed_out(self) -> None:
        self._late = None
        self.mode, self.given = "free", 0.0
        self._lead()

    def current(self) -> float:
        """The motor current (A), as far as there is one."""
        if self.fault_name != "none" or self.mode not in ("current", "brake", "hold"):
            return 0.0
        if self.mode == "current":
            return self.given
        speed = self.motor.speed(self.clock.now())
        return -self.given if speed > 1.0 else self.given if speed < -1.0 else 0.0

    # ------------------------------------------------------------------ set-points

    @on("SetDuty")
    def take_duty(self, request: Any) -> None:
        """A share of the supply; 0 shorts the motor."""
        self._take("duty", request.duty)

    @on("SetCurrent")
    def take_current(self, request: Any) -> None:
        """A motor current; 0 releases the motor."""
        self._take("current", request.current)

    @on("SetBrakeCurrent")
    def take_brake(self, request: Any) -> None:
        """A current against the motion."""
        self._take("brake", request.current)

    @on("SetHandbrake")
    def take_handbrake(self, request: Any) -> None:
        """A current that holds."""
        self._take("hold", request.current)

    @on("SetSpeed")
    def take_speed(self, request: Any) -> None:
        """Turns of the field a minute."""
        self._take("speed", request.speed)

    @on("SetPosition")
    def take_position(self, request: Any) -> None:
        """An angle of the encoder (°); it is there at once."""
        self._take("position", request.position)

    # ------------------------------------------------------------------ who it is, and how

    @on("Ping")
    def pong(self, request: Any) -> None:
        """It is there."""
        self.reply("Pong", host=request.host, hardware="vesc")

    @on("PollPosition")
    def tell_position(self, request: Any) -> None:
        """The rotor's angle."""
        self.reply("RotorPosition", position=self.values["position"])

    @property
    def values(self) -> dict[str, Any]:
        """What it measures now, by the names of VALUES."""
        now = self.clock.now()
        turned = self.motor.position(now)
        speed = self.motor.speed(now)
        count = round((turned - self._start) / tau * 6 * self.pole_pairs)
        found: dict[str, Any] = dict.fromkeys(VALUES, 0)
        found |= {
            "fet_temperature": self.warm,
            "motor_temperature": self.warm,
            "motor_current": self.current(),
            "duty": max(-1.0, min(1.0, speed / SPEED)),
            "speed": round(speed * 60 / tau * self.pole_pairs),
            "voltage": SUPPLY,
            "tachometer": count,
            "tachometer_abs": abs(count),
            "fault": self.fault_name,
            "position": turned / tau * 360 % 360,
            "controller": self.credentials["id"],
            "mosfet_temperatures": [self.warm] * 3,
        }
        return found

    def tell_status(self) -> None:
        """Send status messages 1, 4 and 5."""
        values = self.values
        self.reply("Status", speed=values["speed"], current=values["motor_current"], duty=values["duty"])
        names = ("fet_temperature", "motor_temperature", "input_current", "position")
        self.reply("Status4", **{name: values[name] for name in names})
        self.reply("Status5", tachometer=values["tachometer"], voltage=values["voltage"], reserved=0)

    # ------------------------------------------------------------------ packets

    @on("ShortRequest", "LongRequest", "FillBuffer", "FillBufferFar")
    def take_piece(self, request: Any) -> None:
        """A piece of a packet; a whole one is carried out."""
        packet = self.buffers.take(request)
        if packet is None:
            return
        record = self.reader.read(packet)
        answer = None if record is None else self._answer(record)
        if answer is None or request.mode == 2:
            return
        for message, fields in can_pieces(answer, host=request.host, receiver=request.host, mode=1):
            self.reply(message, **fields)

    def _answer(self, request: Any) -> bytes | None:
        match type(request).__name__:
            case "GetSelected":
                wanted = [name for bit, name in enumerate(VALUES) if request.mask >> bit & 1]
                values = self.values
                return packet_of(
                    "Selected",
                    mask=request.mask,
                    **{name: values[name] if name in wanted else None for name in VALUES},
                )
            case "GetValues":
                return packet_of("Values", **self.values)
            case "GetFirmware":
                return packet_of("Firmware", **FIRMWARE)
            case "Alive":
                self._alive()
            case "SetDuty":
                self._take("duty", request.duty)
            case "SetCurrent":
                self._take("current", request.current)
            case "SetBrakeCurrent":
                self._take("brake", request.current)
            case "SetHandbrake":
                self._take("hold", request.current)
            case "SetSpeed":
                self._take("speed", request.speed)
            case "SetPosition":
                self._take("position", request.position)
            case _:
                pass
        return None

    # ------------------------------------------------------------------ misbehaving

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """See `Twin.fault`."""
        super().fault(name, amount, on=on)
        self._lead()

    def power(self, on: bool) -> None:
        """See `Twin.power`; without power the motor runs out."""
        if not on:
            self.mode, self.given = "free", 0.0
            self._lead()
            self.stop()
        super().power(on)

    def stop(self) -> None:
        """End what repeats."""
        if self._late is not None:
            self._late.cancel()
        super().stop()
