"""A simulated motor board: it answers as the facts say, and moves motors that have torque, friction, heat and stops.

1. It hears bytes and says bytes; what a kind of board says stands in the same `shapes` as the driver's.
2. Between two requests nothing is computed; each request catches up with its own channels (see `joint_model`).
3. What a board stores survives a reboot; where its motors are and whether they are homed does not.

Each joint is in `world.joints`, with its true angle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.errors import CallerError

from .channel import BoardStored, Channel
from .shapes import SHAPES, Shape
from .storage import selector

#: Largest counts of encoder replies of two bytes.
_HALF, _WORD = 0x8000, 0x10000
#: What selector asks for which block of which channel.
_BLOCKS = {selector(channel, block): (channel, block) for channel in range(5) for block in range(1, 7)}


class _Place:
    """A joint as other twins see it."""

    __slots__ = ("_channel",)

    def __init__(self, channel: Channel) -> None:
        self._channel = channel

    def position(self, now: int) -> float:
        """Its true angle (rad), 0 where calibration says so, whatever the encoder counts from."""
        self._channel.sync(now)
        return self._channel.joint.q


class HuboMotorTwin(Twin):
    """One motor board. Faults with an amount are of motor 1, 2, … (0: of all; default 1)."""

    protocol = "hubo"
    faults: ClassVar[dict[str, str]] = {
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
        self._listening = self._handlers
        if "channels" in self.__dict__:
            for channel in self.channels:
                channel.sync(now)
                channel.powered(now)
            return
        dialect = self.variant.dialect or "D12"
        kind = self.config.kind if isinstance(self.config.kind, (int, str)) else self.config.channels
        found = SHAPES.get((dialect, kind)) if kind is not None else None
        if found is None or kind is None:
            raise CallerError(f"{self.name}: {dialect} has no motor board of kind {kind!r}")
        self.dialect, self.kind, self.shape = dialect, kind, found
        self.board = BoardStored()
        #: What was heard: beeps (ns, s), alarms (ns, sound).
        self.beeps: list[tuple[int, float]] = []
        self.alarms: list[tuple[int, str]] = []
        self.gain_override: tuple[list[int], int] | None = None
        by_channel = {joint.channel: joint for joint in self.joints}
        self.channels = [
            Channel(n, by_channel.get(n), kind, now, self.random.uniform(-0.05, 0.05))
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

    def _count(self, channel: Channel, now: int) -> int:
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
            self.reply(current.reply[0], current=(signed + [0])[:2])
            return
        most = {1: 10.23, 2: 10.23, 5: 0.255}.get(self.kind if isinstance(self.kind, int) else 0, 1.02)
        told = [min(most, one) for one in amps]
        if self.shape.channels == 5:
            self.reply(current.reply[0], current=told)
            return
        heat = 95.0 if "hot" in self.active_faults else max(c.joint.temperature for c in self.channels)
        wide = told if self.shape.channels > 2 else (told + [0.0])[:2]
        self.reply(current.reply[0], current=wide, temperature=min(255, int(heat)))

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
        self.reply(status.reply[0], motor=motors)

    def _status_d08(self, message: str) -> None:
        found = [dict(channel.found) for channel in self.channels]
        if message == "StatusD08":
            none = {"origin": "none", "limit_switch": "none", "encoder": "none"}
            # What the first five bytes say is not known.
            self.reply(
                message, board_state=0, motor_state=[0, 0], motor_control=[0, 0], motor=(found + [none])[:2]
            )
        elif message == "Status3D08X":
            self.reply(message, state=bytes(5), motor=found)
        else:
            none = {"origin": "none", "limit_switch": "none", "encoder": "none"}
            self.reply(message, state=bytes(6), motor=(found + [none])[:2])

    @on("SendPm")
    def send_pm(self, request: Any) -> None:
        """The index of the first two motors, within its turn (D08)."""
        phases = [round(channel.index % channel.turn) for channel in self.channels[:2]]
        self.reply("Pm", z_phase=(phases + [0])[:2])

    # ------------------------------------------------------------------ what it is

    @on("GetBoardInfo")
    def get_board_info(self, request: Any) -> None:
        """The period is set, and told."""
        self.board.period = request.period
        self.reply("BoardInfo", period=request.period)

    @on("NameInfo", "NameInfo3", "NameInfo5")
    def name_info(self, request: Any) -> None:
        """Period and search limits (D08)."""
        self.board.period = request.period
        limits = list(getattr(request, "limit", (0, 0)))
        for channel, turns in zip(self.channels, limits, strict=False):
            if turns:
                channel.stored.search_limit = turns
        self.reply("NameInfoReply", period=request.period, limit=limits)

    # ------------------------------------------------------------------ references and duties

    @on("Reference", "Reference3D08")
    def reference(self, request: Any) -> None:
        """Positions in counts."""
        now = self.clock.now()
        for channel, count in zip(self.channels, request.position, strict=False):
            if channel.mode == "current":
                channel.refer(now, count * 0.01, self.board)
            else:
                channel.refer(now, count, self.board)

    @on("ReferenceHand")
    def reference_hand(self, request: Any) -> None:
        """Wrist roll in counts, fingers in A."""
        now = self.clock.now()
        self.channels[0].refer(now, request.position, self.board)
        for channel, amps in zip(self.channels[1:], request.finger, strict=True):
            channel.refer(now, amps, self.board)

    @on("ReferenceHandPosition")
    def reference_hand_position(self, request: Any) -> None:
        """Wrist roll in counts, fingers in steps of 64 counts: the unit is not known."""
        now = self.clock.now()
        self.channels[0].refer(now, request.position, self.board)
        for channel, steps in zip(self.channels[1:], request.finger, strict=True):
            channel.refer(now, 64 * steps, self.board)

    @on("ReferenceNeck")
    def reference_neck(self, request: Any) -> None:
        """Servo angles: servos hold whatever they are told."""
        from math import pi, tau

        now = self.clock.now()
        for channel, angle in zip(self.channels, request.position, strict=True):
            channel.driver_on = channel.control_on = True
            channel.refer(now, round((angle + pi) * 4096 / tau), self.board)

    @on("PwmFine", "Pwm3", "PwmFingers", "PwmD08", "Pwm3D08", "PwmFingersD08", "Pwm")
    def pwm(self, request: Any) -> None:
        """Open-loop duties; mode `off` ends them."""
        shape, now = self.shape, self.clock.now()
        duties = list(request.duty)
        if hasattr(request, "direction"):
            minus = "ccw" if self.dialect == "D12" else "minus"
            duties = [-d if way == minus else d for d, way in zip(duties, request.direction, strict=True)]
            sign = 1
        else:
            sign = shape.positive
        is_off = getattr(request, "mode", "on") == "off"
        whole = 100 if self.dialect == "D12" else shape.largest_duty
        for channel, duty in zip(self.channels, duties, strict=False):
            channel.drive(now, None if is_off else sign * duty / whole)

    # ------------------------------------------------------------------ switches

    @on("DriverSwitch")
    def driver_switch(self, request: Any) -> None:
        """FETs on or off; what has failed stays off."""
        now = self.clock.now()
        for channel in self.channels:
            channel.switch(now, driver=request.state == "on" and "fet_fault" not in channel.faults)

    @on("ControlOn")
    def control_on(self, request: Any) -> None:
        """Control begins where the joints are."""
        now = self.clock.now()
        for channel in self.channels:
            channel.switch(now, control=True)

    @on("ControlOff")
    def control_off(self, request: Any) -> None:
        """No control, no search, no duty."""
        now = self.clock.now()
        for channel in self.channels:
            channel.switch(now, control=False)

    @on("ControlMode", "ControlModeD08")
    def control_mode(self, request: Any) -> None:
        """What references mean; `hybrid`: the fingers of a hand get currents."""
        now = self.clock.now()
        mode = request.mode
        for channel in self.channels:
            channel.sync(now)
            new = (
                "current"
                if mode in ("current", "torque") or (mode == "hybrid" and channel.number)
                else "position"
            )
            if new != channel.mode:
                channel.mode = new
                channel.reference = 0 if new == "current" else channel.count(now)
                channel.apply(now)

    @on("SwitchingMode", "CurrentLimit")
    def noted(self, request: Any) -> None:
        """Kept; the motor model knows no difference."""
        if hasattr(request, "limit"):
            for channel in self.channels:
                channel.stored.max_current = request.limit

    @on("PositionGainA", "PositionGainB", "TorqueGainA", "TorqueGainB")
    def gains(self, request: Any) -> None:
        """Gains of the motors that this message is for; ki is kept and does nothing."""
        name = type(request).__name__
        is_torque = name.startswith("Torque")
        table = self.shape.torque_gains if is_torque else self.shape.gains
        now = self.clock.now()
        for channel, message in zip(self.channels, table, strict=False):
            if message != name:
                continue
            channel.sync(now)
            if is_torque:
                channel.stored.kpt, channel.stored.kdt = request.kp, request.kd
            else:
                channel.stored.kp, channel.stored.ki, channel.stored.kd = request.kp, request.ki, request.kd
                channel.apply_gains()
            channel.apply(now)

    @on("EncoderZero")
    def encoder_zero(self, request: Any) -> None:
        """Encoders are zero here; errors are gone."""
        self._zero(None if request.channel == "all" else int(request.channel[-1]))

    @on("EncoderZeroD08")
    def encoder_zero_d08(self, request: Any) -> None:
        """Encoders are zero here."""
        self._zero(None if request.motor == "all" else int(request.motor[-1]) - 1)

    def _zero(self, number: int | None) -> None:
        now = self.clock.now()
        for channel in self.channels:
            if number in (None, channel.number):
                channel.zero_here(now)

    # ------------------------------------------------------------------ home

    @on("Home")
    def search_home(self, request: Any) -> None:
        """Search with the stored settings; the drivers switch themselves on."""
        now = self.clock.now()
        chosen = request.channel
        for channel in self.channels:
            if chosen == "all" or chosen == f"channel_{channel.number}":
                channel.driver_on = "fet_fault" not in channel.faults
                if channel.driver_on:
                    channel.begin_search(now)

    @on("HomeD08", "HomeD08X", "GoHome")
    def search_home_d08(self, request: Any) -> None:
        """One motor; the other stays in run state."""
        way, _, plain = str(request.motor).partition("_without_")
        number = int(way[-1]) if way.startswith("channel") else 0
        if number < len(self.channels):
            offsets = getattr(request, "offset", None)
            self.channels[number].begin_search(
                self.clock.now(),
                offset=None if offsets is None else offsets[number],
                side=1 if request.direction == "ccw" else -1,
                index=not plain,
            )

    @on("Home3D08", "Home3D08X")
    def search_home_3(self, request: Any) -> None:
        """The first motor has the switch; the others are zero where they are."""
        now = self.clock.now()
        side = 1 if request.direction == "ccw" else -1
        self.channels[0].begin_search(now, offset=-side * request.pulses, side=side)
        for channel in self.channels[1:]:
            channel.zero_here(now)

    @on("Home5D08")
    def search_home_5(self, request: Any) -> None:
        """Fingers go to their stop."""
        for channel in self.channels:
            channel.driver_on = True
            channel.begin_search(self.clock.now())

    # ------------------------------------------------------------------ what is stored (D12)

    @on("GetParameters")
    def get_parameters(self, request: Any) -> None:
        """One block; a selector that means nothing is not answered."""
        number = request.selector
        board = self.board
        if number == 20:
            self.reply(
                "Parameters20",
                selector=number,
                number=self.credentials["board"],
                period=board.period,
                board_type=self.shape.channels,
                homing_acceleration=board.homing_acceleration,
            )
        elif number == 21:
            keys = ("velocity_to_switch", "velocity_to_offset", "jam_time", "saturation_time")
            self.reply("Parameters21", selector=number, **{key: getattr(board, key) for key in keys})
        elif number == 22:
            keys = ("limit_duty", "jam_duty", "max_step", "max_error", "max_encoder_error")
            self.reply("Parameters22", selector=number, **{key: getattr(board, key) for key in keys})
        elif number in _BLOCKS and _BLOCKS[number][0] < len(self.channels):
            channel, block = _BLOCKS[number]
            self.reply(f"Parameters{block}", selector=number, **_block(self.channels[channel].known(), block))

    @on("DeadZone", "HomeSearch", "EncoderResolution", "MaxSpeed", "LowerLimit", "UpperLimit", "HomingSpeed")
    def store(self, request: Any) -> None:
        """A parameter of one motor."""
        if request.channel >= len(self.channels):
            return
        channel, name = self.channels[request.channel], type(request).__name__
        channel.sync(self.clock.now())
        kept = channel.stored
        if name == "DeadZone":
            kept.dead_zone = request.dead_zone
        elif name == "HomeSearch":
            kept.search_limit, kept.search_direction = request.limit, request.direction
            kept.home_offset = request.offset
        elif name == "EncoderResolution":
            kept.resolution, kept.auto_scale = request.resolution, request.auto_scale
            kept.direction = request.direction
        elif name == "MaxSpeed":
            kept.max_acceleration, kept.max_velocity = request.acceleration, request.velocity
        elif name == "HomingSpeed":
            kept.search_mode, kept.homing_duty = request.mode, request.duty
            self.board.homing_acceleration = request.acceleration
            self.board.velocity_to_switch = request.velocity_to_switch
            self.board.velocity_to_offset = request.velocity_to_offset
        else:
            side = "lower" if name == "LowerLimit" else "upper"
            setattr(kept, f"{side}_limit_enabled", int("enable" in request.options))
            if "update" in request.options:
                setattr(kept, f"{side}_limit", request.limit)

    @on("JamLimits")
    def jam_limits(self, request: Any) -> None:
        """When a motor counts as jammed or saturated."""
        self.board.jam_time, self.board.saturation_time = request.jam_time, request.saturation_time
        self.board.limit_duty, self.board.jam_duty = request.limit_duty, request.jam_duty

    @on("ErrorBounds")
    def error_bounds(self, request: Any) -> None:
        """Largest step, largest error, temperature of the warning."""
        self.board.max_step, self.board.max_error = request.max_step, request.max_error
        self.board.temperature = request.temperature

    @on("GainOverride")
    def override_gains(self, request: Any) -> None:
        """Gains of channels 0 and 1 in %, at once: how the board gets there is not modelled."""
        now = self.clock.now()
        self.gain_override = (list(request.gain), request.time)
        for channel, percent in zip(self.channels, request.gain, strict=False):
            channel.sync(now)
            channel.apply_gains()
            channel.joint.stiffness *= percent / 100

    @on("InitBoard")
    def init_board(self, request: Any) -> None:
        """Defaults, and as after power-up."""
        now = self.clock.now()
        fresh = BoardStored(period=self.board.period)
        for key, value in asdict(fresh).items():
            setattr(self.board, key, value)
        for channel in self.channels:
            channel.sync(now)
            channel.stored = channel.defaults()
            channel.powered(now)

    @on("SetBoardNumber")
    def set_board_number(self, request: Any) -> None:
        """It answers to another number from now on."""
        self.board.period = request.period
        self.twins.renumber(self, board=request.number)

    @on("Beep")
    def beep(self, request: Any) -> None:
        """Noted."""
        self.beeps.append((self.clock.now(), request.time))

    @on("Alarm")
    def alarm(self, request: Any) -> None:
        """Noted."""
        self.alarms.append((self.clock.now(), request.sound))


def _short(count: int) -> int:
    """A count in two bytes, which it runs around in."""
    return (count + _HALF) % _WORD - _HALF


def _block(known: dict[str, Any], block: int) -> dict[str, Any]:
    """The fields of a parameter block of one motor."""
    if block == 1:
        keys = ("kp", "ki", "kd", "resolution", "auto_scale", "direction")
    elif block == 2:
        keys = ("dead_zone", "search_direction", "search_mode", "search_limit")
        low = known["home_offset"] & 0xFFFF
        return {**{key: known[key] for key in keys}, "home_offset_low": low}
    elif block == 3:
        offset, upper = known["home_offset"], known["upper_limit"]
        return {
            "home_offset_high": offset - (offset & 0xFFFF),
            "lower_limit_enabled": known["lower_limit_enabled"],
            "lower_limit": known["lower_limit"] & ~1,
            "upper_limit_enabled": known["upper_limit_enabled"],
            "upper_limit_low": upper & 0xFFFE,
        }
    elif block == 4:
        upper = known["upper_limit"]
        keys = ("max_acceleration", "max_velocity", "max_pwm")
        return {**{key: known[key] for key in keys}, "upper_limit_high": upper - (upper & 0xFFFF)}
    elif block == 5:
        keys = ("max_current", "kpt", "kdt")
    else:
        return {"kft": known["kft"], "sums": bytes(6)}
    return {key: known[key] for key in keys}
