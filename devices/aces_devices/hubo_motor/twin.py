"""A simulated motor board: it answers as the facts say, and moves motors that have torque, friction, heat and stops.

1. It receives bytes and sends bytes; what a kind of board sends is in the same `shapes` as the driver's.
2. Between two requests nothing is computed; each request catches up with its own channels (see `joint_model`).
3. What a board stores survives a reboot; where its motors are and whether they are homed does not.

Each joint is in `world.joints`, with its true angle.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi, tau
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.device.config import Joint
from aces_bus.protocol import Record
from aces_protocols.hubo.spec import hubo

from .channel import MotorChannel, counts_of
from .parameters import BOARD_BLOCKS, WRITES, block_fields, board_defaults, selector
from .shapes import shape_of

#: What selector asks for which block of which channel.
_BLOCKS = {selector(channel, block): (channel, block) for channel in range(5) for block in range(1, 7)}


class _Place:
    """A joint as other twins see it."""

    __slots__ = ("_channel",)

    def __init__(self, channel: MotorChannel) -> None:
        self._channel = channel

    def position(self, now: int) -> float:
        """Return its true angle (rad), 0 where calibration says so, whatever the encoder counts from."""
        self._channel.sync(now)
        return self._channel.joint.q


class HuboMotorTwin(Twin):
    """One motor board. Faults with an amount are of motor 1, 2, … (0: of all; default 1)."""

    protocol = hubo
    channels: list[MotorChannel]

    faults: ClassVar[Mapping[str, str]] = {
        "jam": "the motor is blocked where it is",
        "no_errors": "the status has no error bits, whatever is wrong: as the older firmware, which reports none",
        "hot": "the motor is too hot (95 °C is reported, temperature error)",
        "saturated": "the PWM counts as saturated",
        "no_switch": "the home switch never closes",
        "no_index": "the encoder's index never comes",
        "encoder_fail": "the encoder's count does not change, and the status says so",
        "fet_fault": "the driver has failed: no current, driver off",
        "motor_fail_0": "the status has motor fail 0",
        "motor_fail_1": "the status has motor fail 1",
        "overspeed": "the status has a velocity error",
        "over_acceleration": "the status has an acceleration error",
        "can_error": "off the bus: neither receives nor sends anything",
        "amnesia": "loses its home flags, as after a brown-out",
    }

    def setup(self) -> None:
        """Power up."""
        now = self.clock.now()
        if "channels" in self.__dict__:
            for channel in self.channels:
                channel.sync(now)
                channel.powered(now)
            return
        self._listening = self._handlers
        #: The last frame of some replies, and the fields it was made of.
        self._frames: dict[str, tuple[dict[str, Any], Any]] = {}
        self.dialect, self.kind, self.shape = shape_of(self)
        #: Whether its encoder replies have two bytes a channel.
        self._is_short = self.shape.channels > 2 and self.kind != "neck"
        self.board = board_defaults(self.kind)
        self.board.board_type = self.shape.channels
        #: What was received: beeps (ns, s), alarms (ns, sound).
        self.beeps: list[tuple[int, float]] = []
        self.alarms: list[tuple[int, str]] = []
        self.gain_override: tuple[list[int], int] | None = None
        by_channel = {joint.channel: joint for joint in self.joints}
        self.channels = [
            MotorChannel(n, own, self.kind, self.board, now, self._start_of(own))
            for n, own in ((n, by_channel.get(n)) for n in range(self.shape.channels))
        ]
        for channel in self.channels:
            if channel.own is not None:
                self.world.joints[channel.own.name] = _Place(channel)
                channel.joint.controller = channel.step_search
                channel.joint.join(self.world, channel.own.name)
                if self.world.homed:
                    channel.be_homed()
        self._frozen: dict[int, int] = {}

    def _start_of(self, own: Joint | None) -> float:
        """Return where a joint is at first (rad)."""
        somewhere = self.random.uniform(-0.05, 0.05)
        if self.world.homed:
            somewhere = 0.0
        return somewhere if own is None else self.world.start_of(own.name, somewhere)

    # ------------------------------------------------------------------ faults

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """Do what all twins do; those of motors take effect at once."""
        super().fault(name, amount, on=on)
        # Off the bus nothing is received.
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

    def _counts(self, channels: list[MotorChannel]) -> list[int]:
        """Return what the encoders say; on a board of 16 bits they run around."""
        return counts_of(channels, self.clock.now(), self._frozen, self._is_short)

    @on("SendEncoder", "SendEncoderD08")
    def send_encoder(self, request: Record) -> None:
        """Send positions; `upper` are channels 3 and 4 of five."""
        channels, asked = self.shape.channels, self.shape.encoders
        if not asked:
            return
        if channels == 5:
            is_upper = request.selector == "upper"
            chosen = self.channels[3:] if is_upper else self.channels[:3]
            self.reply("Encoder5Upper" if is_upper else "Encoder5", position=self._counts(chosen))
            return
        counts: list[Any] = self._counts(self.channels)
        if self.kind == "neck":
            counts = [min(4095, max(0, count)) * tau / 4096 - pi for count in counts]
        self.reply(asked[0].reply[0], position=[*counts, 0] if channels == 1 else counts)

    def repeat(self, message: str, **fields: Any) -> None:
        """Reply, with the frame of the last time where the fields are the same: most status replies are."""
        if self.active_faults or not self.is_powered:
            self.reply(message, **fields)
            return
        known = self._frames.get(message)
        if known is None or known[0] != fields:
            known = self._frames[message] = (fields, self.twins.packet(self, message, fields))
        self._transmit(known[1], self.reply_delay_ns)

    @on("SendCurrent")
    def send_current(self, request: Record) -> None:
        """Send magnitudes of the currents, within what the field holds; the temperature of the hottest motor."""
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
        reported = [min(most, round(amp, 3)) for amp in amps]
        if self.shape.channels == 5:
            self.repeat(current.reply[0], current=reported)
            return
        heat = 95.0 if "hot" in self.active_faults else max(c.joint.temperature for c in self.channels)
        wide = reported if self.shape.channels > 2 else [*reported, 0.0][:2]
        self.repeat(current.reply[0], current=wide, temperature=min(255, int(heat)))

    @on("SendStatus")
    def send_status(self, request: Record) -> None:
        """Send switches, home flags, errors; or how home searches went (D08)."""
        status = self.shape.status
        if status is None:
            return
        now = self.clock.now()
        looked = [channel.look(now) for channel in self.channels]
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
        none = dict.fromkeys(found[0], "none")
        if message == "StatusD08":
            # What the first five bytes say is not known.
            self.reply(
                message, board_state=0, motor_state=[0, 0], motor_control=[0, 0], motor=[*found, none][:2]
            )
        elif message == "Status3D08X":
            self.reply(message, state=bytes(5), motor=found)
        else:
            self.reply(message, state=bytes(6), motor=[*found, none][:2])

    @on("SendPm")
    def send_pm(self, request: Record) -> None:
        """Send the index of the first two motors, within its turn (D08)."""
        phases = [round(channel.index % channel.turn) for channel in self.channels[:2]]
        self.reply("Pm", z_phase=[*phases, 0][:2])

    # ------------------------------------------------------------------ what it is

    @on("GetBoardInfo")
    def get_board_info(self, request: Record) -> None:
        """Set the period and report it."""
        self.board.period = request.period
        self.reply("BoardInfo", period=request.period)

    @on("NameInfo", "NameInfo3", "NameInfo5")
    def name_info(self, request: Record) -> None:
        """Send period and search limits (D08)."""
        self.board.period = request.period
        limits = list(getattr(request, "limit", (0, 0)))
        for channel, turns in zip(self.channels, limits, strict=False):
            if turns:
                channel.stored.search_limit = turns
        self.reply("NameInfoReply", period=request.period, limit=limits)

    # ------------------------------------------------------------------ references and duties

    @on("Reference", "Reference3D08")
    def reference(self, request: Record) -> None:
        """Take positions in counts."""
        now = self.clock.now()
        for channel, count in zip(self.channels, request.position, strict=False):
            channel.refer(now, count * 0.01 if channel.mode == "current" else count)

    @on("ReferenceHand", "ReferenceHandPosition")
    def reference_hand(self, request: Record) -> None:
        """Take wrist roll in counts; fingers in A, or in steps of 64 counts: the unit is not known."""
        now = self.clock.now()
        unit = 64 if type(request).__name__ == "ReferenceHandPosition" else 1
        self.channels[0].refer(now, request.position)
        for channel, finger in zip(self.channels[1:], request.finger, strict=True):
            channel.refer(now, unit * finger)

    @on("ReferenceNeck")
    def reference_neck(self, request: Record) -> None:
        """Set servo angles: servos hold what they are set to."""
        now = self.clock.now()
        for channel, angle in zip(self.channels, request.position, strict=True):
            channel.driver_on = channel.control_on = True
            channel.refer(now, round((angle + pi) * 4096 / tau))

    @on("PwmFine", "Pwm3", "PwmFingers", "PwmD08", "Pwm3D08", "PwmFingersD08", "Pwm")
    def pwm(self, request: Record) -> None:
        """Take open-loop duties; mode `off` ends them."""
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
    def driver_switch(self, request: Record) -> None:
        """Switch FETs on or off; a failed one stays off."""
        now = self.clock.now()
        for channel in self.channels:
            channel.switch(now, driver=request.state == "on" and "fet_fault" not in channel.faults)

    @on("ControlOn", "ControlOff")
    def control(self, request: Record) -> None:
        """Begin control where the joints are; off: no control, no search, no duty."""
        now = self.clock.now()
        for channel in self.channels:
            channel.switch(now, control=type(request).__name__ == "ControlOn")

    @on("ControlMode", "ControlModeD08")
    def control_mode(self, request: Record) -> None:
        """Choose the meaning of references; in `hybrid` the fingers of a hand take currents."""
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
                channel.reference = 0.0 if new == "current" else float(channel.count(now))
                channel.apply(now)

    @on("SwitchingMode", "CurrentLimit")
    def noted(self, request: Record) -> None:
        """Keep a setting; the motor model knows no difference."""
        if hasattr(request, "limit"):
            for channel in self.channels:
                channel.stored.max_current = request.limit

    @on("PositionGainA", "PositionGainB", "TorqueGainA", "TorqueGainB")
    def gains(self, request: Record) -> None:
        """Set gains of the motors that this message is for; ki is kept and does nothing."""
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

    @on("EncoderZero", "EncoderZeroD08")
    def encoder_zero(self, request: Record) -> None:
        """Zero encoders at the present place and clear errors. D08 counts motors from 1."""
        is_d12 = type(request).__name__ == "EncoderZero"
        which = str(request.channel if is_d12 else request.motor)
        now = self.clock.now()
        for channel in self.channels:
            if which == "all" or int(which[-1]) - (not is_d12) == channel.number:
                channel.zero_here(now)

    # ------------------------------------------------------------------ home

    @on("Home")
    def search_home(self, request: Record) -> None:
        """Search with the stored settings; the drivers switch themselves on."""
        now = self.clock.now()
        chosen = request.motor
        for channel in self.channels:
            if chosen == "all" or chosen == f"motor_{channel.number + 1}":
                channel.driver_on = "fet_fault" not in channel.faults
                if channel.driver_on:
                    channel.begin_search(now)

    @on("HomeD08", "HomeD08X", "GoHome")
    def search_home_d08(self, request: Record) -> None:
        """Search home with one motor; the other stays in run state."""
        way, _, plain = str(request.motor).partition("_without_")
        number = int(way[-1]) - 1 if way.startswith("motor") else 0
        if number < len(self.channels):
            offsets = getattr(request, "offset", None)
            self.channels[number].begin_search(
                self.clock.now(),
                offset=None if offsets is None else offsets[number],
                side=1 if request.direction == "ccw" else -1,
                index=not plain,
            )

    @on("Home3D08", "Home3D08X")
    def search_home_3(self, request: Record) -> None:
        """Search home with the first motor, which has the switch; the others become zero at their present place."""
        now = self.clock.now()
        side = 1 if request.direction == "ccw" else -1
        self.channels[0].begin_search(now, offset=-side * request.pulses, side=side)
        for channel in self.channels[1:]:
            channel.zero_here(now)

    @on("Home5D08")
    def search_home_5(self, request: Record) -> None:
        """Drive the fingers to their stop."""
        for channel in self.channels:
            channel.driver_on = True
            channel.begin_search(self.clock.now())

    # ------------------------------------------------------------------ what is stored (D12)

    @on("GetParameters")
    def get_parameters(self, request: Record) -> None:
        """Send one block; a selector without a meaning is not answered."""
        number = request.selector
        self.board.number = self.credentials["board"]
        if number in BOARD_BLOCKS:
            fields = {name: getattr(self.board, name) for name in BOARD_BLOCKS[number]}
            self.reply(f"Parameters{number}", selector=number, **fields)
        elif number in _BLOCKS and _BLOCKS[number][0] < len(self.channels):
            channel, block = _BLOCKS[number]
            fields = block_fields(self.channels[channel].stored, block)
            self.reply(f"Parameters{block}", selector=number, **fields)

    @on(*WRITES)
    def store(self, request: Record) -> None:
        """Store parameters of one motor, or of the board."""
        number = getattr(request, "channel", 0)
        if number < len(self.channels):
            channel = self.channels[number]
            channel.sync(self.clock.now())
            for name, field in WRITES[type(request).__name__].items():
                kept = channel.stored if hasattr(channel.stored, name) else self.board
                setattr(kept, name, getattr(request, field))

    @on("LowerLimit", "UpperLimit")
    def store_limit(self, request: Record) -> None:
        """Store a limit of one motor."""
        if request.channel < len(self.channels):
            kept = self.channels[request.channel].stored
            side = "lower" if type(request).__name__ == "LowerLimit" else "upper"
            setattr(kept, f"{side}_limit_enabled", "enable" in request.options)
            if "update" in request.options:
                setattr(kept, f"{side}_limit", request.limit)

    @on("GainOverride")
    def override_gains(self, request: Record) -> None:
        """Set gains of channels 0 and 1 in %, at once: how the board gets there is not modelled."""
        now = self.clock.now()
        self.gain_override = (list(request.gain), request.time)
        for channel, percent in zip(self.channels, request.gain, strict=False):
            channel.sync(now)
            channel.apply_gains()
            channel.joint.stiffness *= percent / 100

    @on("InitBoard")
    def init_board(self, request: Record) -> None:
        """Load the defaults, and start as after power-up."""
        now = self.clock.now()
        self.board = board_defaults(self.kind)
        self.board.board_type = self.shape.channels
        for channel in self.channels:
            channel.sync(now)
            channel.board, channel.stored = self.board, channel.defaults()
            channel.powered(now)

    @on("SetBoardNumber")
    def set_board_number(self, request: Record) -> None:
        """Answer to another board number from now on."""
        self.board.period = request.period
        self.twins.renumber(self, board=request.number)
        self._frames.clear()

    @on("Beep")
    def beep(self, request: Record) -> None:
        """Note a beep."""
        self.beeps.append((self.clock.now(), request.time))

    @on("Alarm")
    def alarm(self, request: Record) -> None:
        """Note an alarm."""
        self.alarms.append((self.clock.now(), request.sound))
