"""A simulated motor board: it answers as the facts say, and moves motors that have torque, friction, heat and stops.

1. It hears bytes and says bytes; what a kind of board says stands in the same `shapes` as the driver's.
2. Here is what it is told: set-points, switches, searches, parameters. What it is asked is in `reporting`.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from aces_bus.device import on

from .channel import board_defaults
from .reporting import Reporting
from .storage import selector

#: What selector asks for which block of which channel.
_BLOCKS = {selector(channel, block): (channel, block) for channel in range(5) for block in range(1, 7)}

#: What stands in the board's blocks 21 and 22.
_TIMES = ("velocity_to_switch", "velocity_to_offset", "jam_time", "saturation_time")
_BOUNDS = ("limit_duty", "jam_duty", "max_step", "max_error", "max_encoder_error")


class HuboMotorTwin(Reporting):
    """One motor board. Faults with an amount are of motor 1, 2, … (0: of all; default 1)."""

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
            self.reply("Parameters21", selector=number, **{key: getattr(board, key) for key in _TIMES})
        elif number == 22:
            self.reply("Parameters22", selector=number, **{key: getattr(board, key) for key in _BOUNDS})
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
        for key, value in asdict(board_defaults(self.kind)).items():
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
        self._words.clear()

    @on("Beep")
    def beep(self, request: Any) -> None:
        """Noted."""
        self.beeps.append((self.clock.now(), request.time))

    @on("Alarm")
    def alarm(self, request: Any) -> None:
        """Noted."""
        self.alarms.append((self.clock.now(), request.sound))


def _block(known: dict[str, Any], block: int) -> dict[str, Any]:
    """The fields of a parameter block of one motor."""
    keys: tuple[str, ...]
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
