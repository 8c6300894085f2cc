"""The half of a simulated motor board that is asked: power-up, faults, encoders, currents, status.

1. Between two requests nothing is computed; each request catches up with its own channels (see `joint_model`).
2. What a board stores survives a reboot; where its motors are and whether they are homed does not.

Each joint is in `world.joints`, with its true angle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.errors import CallerError
from aces_protocols.hubo.spec import hubo

from .channel import MotorChannel, board_defaults
from .shapes import SHAPES, Shape

#: Largest counts of encoder replies of two bytes.
_HALF, _WORD = 0x8000, 0x10000


class _Place:
    """A joint as other twins see it."""

    __slots__ = ("_channel",)

    def __init__(self, channel: MotorChannel) -> None:
        self._channel = channel

    def position(self, now: int) -> float:
        """Its true angle (rad), 0 where calibration says so, whatever the encoder counts from."""
        self._channel.sync(now)
        return self._channel.joint.q


class Reporting(Twin):
    """One motor board. Faults with an amount are of motor 1, 2, … (0: of all; default 1)."""

    protocol = hubo
    channels: list[MotorChannel]

    faults: ClassVar[Mapping[str, str]] = {
        "jam": "the motor is blocked where it is",
        "hot": "the motor is too hot (95 °C is told, temperature error)",
        "saturated": "the PWM counts as saturated",
        "no_switch": "the home switch never closes",
        "no_index": "the encoder's index never comes",
        "encoder_fail": "the encoder stands still and the status says so",
        "fet_fault": "the driver has failed: no current, driver off",
        "motor_fail_0": "the status has motor fail 0",
        "motor_fail_1": "the status has motor fail 1",
        "overspeed": "the status has a velocity error",
        "over_acceleration": "the status has an acceleration error",
        "can_error": "off the bus: neither hears nor says anything",
        "amnesia": "loses its home flags, as after a brown-out",
    }

    def setup(self) -> None:
        """Power-up."""
        now = self.clock.now()
        if "channels" in self.__dict__:
            for channel in self.channels:
                channel.sync(now)
                channel.powered(now)
            return
        self._listening = self._handlers
        #: The last word of some replies, and the fields it was made of.
        self._words: dict[str, tuple[dict[str, Any], Any]] = {}
        dialect = self.variant.dialect or "D12"
        kind = self.config.kind if isinstance(self.config.kind, (int, str)) else self.config.channels
        found = SHAPES.get((dialect, kind)) if kind is not None else None
        if found is None or kind is None:
            raise CallerError(f"{self.name}: {dialect} has no motor board of kind {kind!r}")
        self.dialect, self.kind, self.shape = dialect, kind, found
        self.board = board_defaults(kind)
        #: What was heard: beeps (ns, s), alarms (ns, sound).
        self.beeps: list[tuple[int, float]] = []
        self.alarms: list[tuple[int, str]] = []
        self.gain_override: tuple[list[int], int] | None = None
        by_channel = {joint.channel: joint for joint in self.joints}
        self.channels = [
            MotorChannel(n, by_channel.get(n), kind, now, self.random.uniform(-0.05, 0.05))
            for n in range(found.channels)
        ]
        for channel in self.channels:
            channel.board = self.board
            if channel.own is not None:
                self.world.joints[channel.own.name] = _Place(channel)
        self._frozen: dict[int, int] = {}
        self._encode: Callable[[], None] = self._make_encoder(found)

    # ------------------------------------------------------------------ faults

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """As all twins; those of motors take effect at once."""
        super().fault(name, amount, on=on)
        # Off the bus nothing is heard.
        self._handlers = {} if "can_error" in self.active_faults else self._listening
        now = self.clock.now()
        for channel in self.channels:
            channel.sync(now)
            mine = frozenset(
                fault
                for fault, of in self.active_faults.items()
                if fault in self.faults and (of == 0 or round(of) == channel.number + 1)
            )
            channel.faults = mine
            channel.joint.jammed = "jam" in mine
            if "jam" in mine:
                channel.joint.v = 0.0
            if "encoder_fail" in mine:
                self._frozen.setdefault(channel.number, channel.count(now))
            else:
                self._frozen.pop(channel.number, None)
            if "amnesia" in mine:
                channel.home = 0
                channel.found = dict.fromkeys(channel.found, "none")
            if "fet_fault" in mine:
                channel.switch(now, driver=False)

    # ------------------------------------------------------------------ encoders, currents, status

    def _make_encoder(self, shape: Shape) -> Callable[[], None]:
        """What answers a request for encoder positions: chosen once."""
        first, second = (self.channels + self.channels)[:2]
        if self.kind == "neck":
            from math import pi, tau

            def neck() -> None:
                now = self.clock.now()
                codes = [min(4095, max(0, self._count(channel, now))) for channel in self.channels]
                self.reply("EncoderNeck", position=[code * tau / 4096 - pi for code in codes])

            return neck
        if shape.channels == 1:

            def one() -> None:
                self.reply("Encoder", position=[self._count(first, self.clock.now()), 0])

            return one
        if shape.channels == 2:

            def two() -> None:
                now = self.clock.now()
                self.reply("Encoder", position=[self._count(first, now), self._count(second, now)])

            return two

        def three() -> None:
            now = self.clock.now()
            self.reply("Encoder3", position=[_short(self._count(c, now)) for c in self.channels])

        return three

    def _count(self, channel: MotorChannel, now: int) -> int:
        if self._frozen:
            channel.sync(now)
            return (
                self._frozen.get(channel.number, 0) if channel.number in self._frozen else channel.count(now)
            )
        return channel.count(now)

    @on("SendEncoder")
    def send_encoder(self, request: Any) -> None:
        """Positions; `upper` are channels 3 and 4 of five."""
        if self.shape.channels < 5:
            self._encode()
            return
        now = self.clock.now()
        upper = request.selector == "upper"
        chosen = self.channels[3:] if upper else self.channels[:3]
        counts = [_short(self._count(channel, now)) for channel in chosen]
        self.reply("Encoder5Upper" if upper else "Encoder5", position=counts)

    @on("SendEncoderD08")
    def send_encoder_d08(self, request: Any) -> None:
        """Positions."""
        if self.shape.encoders:
            self._encode()

    def repeat(self, message: str, **fields: Any) -> None:
        """Reply, with the word of the last time where the fields are the same: most status replies are."""
        if self.active_faults or not self.is_powered:
            self.reply(message, **fields)
            return
        known = self._words.get(message)
        if known is None or known[0] != fields:
            known = self._words[message] = (fields, self.twins.word(self, message, fields))
        self._transmit(known[1], self.reply_delay_ns)

    @on("SendCurrent")
    def send_current(self, request: Any) -> None:
        """Magnitudes of the currents, within what the field holds; the temperature of the hottest motor."""
        current = self.shape.current
        if current is None:
            return
        now = self.clock.now()
        for channel in self.channels:
            channel.sync(now)
        amps = [abs(channel.joint.current) for channel in self.channels]
        if not self.shape.current_unit:
            # The unit is not known: mA, signed, is this twin's choice.
            signed = [round(1000 * channel.joint.current * channel.direction) for channel in self.channels]
            self.reply(current.reply[0], current=[*signed, 0][:2])
            return
        most = {1: 10.23, 2: 10.23, 5: 0.255}.get(self.kind if isinstance(self.kind, int) else 0, 1.02)
        told = [min(most, round(one, 3)) for one in amps]
        if self.shape.channels == 5:
            self.repeat(current.reply[0], current=told)
            return
        heat = 95.0 if "hot" in self.active_faults else max(c.joint.temperature for c in self.channels)
        wide = told if self.shape.channels > 2 else [*told, 0.0][:2]
        self.repeat(current.reply[0], current=wide, temperature=min(255, int(heat)))

    @on("SendStatus")
    def send_status(self, request: Any) -> None:
        """Switches, home flags, errors; or how home searches went (D08)."""
        status = self.shape.status
        if status is None:
            return
        now = self.clock.now()
        looked = [channel.look(now, self.board) for channel in self.channels]
        if not self.shape.reports_drive:
            self._status_d08(status.reply[0])
            return
        motors: list[Any] = []
        if self.shape.has_home_flag:
            for channel, errors in zip(self.channels, looked, strict=True):
                home = "homed" if channel.home == 6 else channel.home
                motors.append({"drive": channel.drive_flags(), "home": home, "errors": sorted(errors)})
            if len(motors) == 1:
                motors.append({"drive": [], "home": 0, "errors": []})
        else:
            for channel, errors in zip(self.channels, looked, strict=True):
                short = [
                    name for name in ("jam", "saturated", "big_error", "encoder_error") if name in errors
                ]
                motors.append(channel.drive_flags() + short)
        self.repeat(status.reply[0], motor=motors)

    def _status_d08(self, message: str) -> None:
        found = [dict(channel.found) for channel in self.channels]
        if message == "StatusD08":
            none = {"origin": "none", "limit_switch": "none", "encoder": "none"}
            # What the first five bytes say is not known.
            self.reply(
                message, board_state=0, motor_state=[0, 0], motor_control=[0, 0], motor=[*found, none][:2]
            )
        elif message == "Status3D08X":
            self.reply(message, state=bytes(5), motor=found)
        else:
            none = {"origin": "none", "limit_switch": "none", "encoder": "none"}
            self.reply(message, state=bytes(6), motor=[*found, none][:2])

    @on("SendPm")
    def send_pm(self, request: Any) -> None:
        """The index of the first two motors, within its turn (D08)."""
        phases = [round(channel.index % channel.turn) for channel in self.channels[:2]]
        self.reply("Pm", z_phase=[*phases, 0][:2])


def _short(count: int) -> int:
    """A count in two bytes, which it runs around in."""
    return (count + _HALF) % _WORD - _HALF
