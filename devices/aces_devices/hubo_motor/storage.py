"""What is stored in a board of D12: its parameters, read and written; limits; and what is dangerous.

1. Parameters and currents come on one identifier, and only the open request tells them apart: while parameters are read,
   currents are not asked for.
2. Halves that the board cuts across blocks are put together here; counts become limits in rad where a joint is known.
3. What can lose a board or its calibration wants `confirm=True`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from aces_bus.device import Job, Steps, Ticket
from aces_bus.errors import CallerError, NoReplyError

from .axis import MotorAxis
from .switching import PAUSE, Switching

#: Block n of a channel, and the board's own.
BLOCKS, BOARD_BLOCKS = (1, 2, 3, 4, 5, 6), (20, 21, 22)
#: A reply may take so long (s): hubo-ach waits 180 ms.
READ_TIMEOUT = 0.18


class ChannelParameters(msgspec.Struct, frozen=True, kw_only=True):
    """What a board has stored of one motor. Counts are the encoder's; gains, speeds, currents in the board's numbers.

    `search_limit` is in motor turns; `home_offset` from index (or switch) to zero, in counts; limits are None while they
    are switched off. `sums` are bytes of unknown meaning.
    """

    kp: int
    ki: int
    kd: int
    resolution: int
    auto_scale: bool
    direction: str
    dead_zone: int
    search_direction: str
    search_mode: str | int
    search_limit: int
    home_offset: int
    lower_limit: int
    lower_limit_enabled: bool
    upper_limit: int
    upper_limit_enabled: bool
    max_acceleration: int
    max_velocity: int
    max_pwm: int
    max_current: int
    kpt: int
    kdt: int
    kft: int
    sums: bytes


class BoardParameters(msgspec.Struct, frozen=True, kw_only=True):
    """What a board has stored, `channels` by joint or `BOARD.n`. `period`, `jam_time`, `saturation_time` are in ms."""

    channels: dict[str, ChannelParameters]
    number: int
    period: int
    board_type: int
    homing_acceleration: float
    velocity_to_switch: int
    velocity_to_offset: int
    jam_time: int
    saturation_time: int
    limit_duty: int
    jam_duty: int
    max_step: int
    max_error: int
    max_encoder_error: int


def selector(channel: int, block: int) -> int:
    """Which number asks for block 1–6 of a channel: 20–22 stay free for the board's blocks (hubo-ach)."""
    return 6 * channel + block + (5 if channel >= 3 else 0)


def channel_parameters(blocks: Mapping[int, Any]) -> ChannelParameters:
    """The six blocks of a channel put together."""
    one, two, three, four, five, six = (blocks[n] for n in BLOCKS)
    return ChannelParameters(
        kp=one.kp,
        ki=one.ki,
        kd=one.kd,
        resolution=one.resolution,
        auto_scale=bool(one.auto_scale),
        direction=one.direction,
        dead_zone=two.dead_zone,
        search_direction=two.search_direction,
        search_mode=two.search_mode,
        search_limit=two.search_limit,
        home_offset=two.home_offset_low + three.home_offset_high,
        lower_limit=three.lower_limit,
        lower_limit_enabled=bool(three.lower_limit_enabled),
        upper_limit=three.upper_limit_low + four.upper_limit_high,
        upper_limit_enabled=bool(three.upper_limit_enabled),
        max_acceleration=four.max_acceleration,
        max_velocity=four.max_velocity,
        max_pwm=four.max_pwm,
        max_current=five.max_current,
        kpt=five.kpt,
        kdt=five.kdt,
        kft=six.kft,
        sums=bytes(six.sums),
    )


#: What `set_parameters` takes: the message that writes it, its other fields, and whether it is a channel's.
_WRITES: Mapping[str, tuple[str, bool]] = {
    "dead_zone": ("DeadZone", True),
    "search_limit": ("HomeSearch", True),
    "search_direction": ("HomeSearch", True),
    "home_offset": ("HomeSearch", True),
    "resolution": ("EncoderResolution", True),
    "auto_scale": ("EncoderResolution", True),
    "direction": ("EncoderResolution", True),
    "max_acceleration": ("MaxSpeed", True),
    "max_velocity": ("MaxSpeed", True),
    "homing_acceleration": ("HomingSpeed", True),
    "velocity_to_switch": ("HomingSpeed", True),
    "velocity_to_offset": ("HomingSpeed", True),
    "search_mode": ("HomingSpeed", True),
    "homing_duty": ("HomingSpeed", True),
    "jam_time": ("JamLimits", False),
    "saturation_time": ("JamLimits", False),
    "limit_duty": ("JamLimits", False),
    "jam_duty": ("JamLimits", False),
    "max_step": ("ErrorBounds", False),
    "max_error": ("ErrorBounds", False),
    "temperature_warning": ("ErrorBounds", False),
}
#: Names of ours → fields of the messages, where they differ.
_FIELDS: Mapping[str, str] = {
    "search_limit": "limit",
    "search_direction": "direction",
    "home_offset": "offset",
    "homing_acceleration": "acceleration",
    "search_mode": "mode",
    "homing_duty": "duty",
    "max_acceleration": "acceleration",
    "max_velocity": "velocity",
    "temperature_warning": "temperature",
}
#: What cannot be read back, and stands for what nobody gave.
_USUAL: Mapping[str, Any] = {"homing_duty": 30, "temperature_warning": 80}


class Storage(Switching):
    """Parameters and limits."""

    def parameters(self) -> Job:
        """Read all that the board has stored; the job's result is a `BoardParameters` (D12)."""
        self.only_d12("parameters that can be read")
        axes = self.chosen(None)

        def steps(job: Job) -> Steps:
            asked = 0
            whole = len(BLOCKS) * len(axes) + len(BOARD_BLOCKS)
            channels: dict[str, ChannelParameters] = {}
            for axis in axes:
                blocks: dict[int, Any] = {}
                for block in BLOCKS:
                    blocks[block] = yield from self._block(
                        selector(axis.channel, block), f"Parameters{block}"
                    )
                    asked += 1
                    job.progress = asked / whole
                channels[axis.name] = channel_parameters(blocks)
            board: list[Any] = []
            for block in BOARD_BLOCKS:
                board.append((yield from self._block(block, f"Parameters{block}")))
            first, second, third = board
            return BoardParameters(
                channels=channels,
                number=first.number,
                period=first.period,
                board_type=first.board_type,
                homing_acceleration=first.homing_acceleration,
                velocity_to_switch=second.velocity_to_switch,
                velocity_to_offset=second.velocity_to_offset,
                jam_time=second.jam_time,
                saturation_time=second.saturation_time,
                limit_duty=third.limit_duty,
                jam_duty=third.jam_duty,
                max_step=third.max_step,
                max_error=third.max_error,
                max_encoder_error=third.max_encoder_error,
            )

        return self.job("parameters", steps)

    def _block(self, number: int, name: str) -> Steps:
        """One block, with no request for currents open beside it."""
        for attempt in range(3):
            self.host.postpone(self, "SendCurrent", 2 * READ_TIMEOUT)
            while any(ticket.message == "SendCurrent" for ticket in self.awaiting):
                yield PAUSE
            try:
                # Once a try: a repeated request could meet the late answer to the first.
                record = yield self.ask(
                    "GetParameters", reply=name, selector=number, timeout_s=READ_TIMEOUT, retries=0
                )
            except NoReplyError:
                if attempt == 2:
                    raise
            else:
                return record

    # ------------------------------------------------------------------ writing

    def set_parameters(self, joint: str | None = None, **values: Any) -> Job:
        """Write parameters of a joint or of the board, by the names of `ChannelParameters` and `BoardParameters`.

        Also `homing_duty` (%) and `temperature_warning` (°C), which cannot be read back. A command writes several
        parameters at once: those that were not given are read first and written as they are. Gains: `set_gains`; limits:
        `set_limits`. Raises `CallerError` for a name that cannot be written, or a channel's without `joint`.
        """
        self.only_d12("parameters that can be written")
        axis = self.axis(joint)
        commands: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            if name not in _WRITES:
                raise CallerError(f"{self.name}: cannot write {name!r}; there are {', '.join(_WRITES)}")
            message, of_channel = _WRITES[name]
            if of_channel and axis is None:
                raise CallerError(f"{self.name}: {name} is a joint's; say which")
            commands.setdefault(message, {})[name] = value

        def steps(job: Job) -> Steps:
            for message, given in commands.items():
                fields = [name for name, (m, _) in _WRITES.items() if m == message]
                known = dict(_USUAL)
                if set(fields) - set(given) - set(known):
                    known |= yield from self._known(axis)
                tagged = {_FIELDS.get(name, name): given.get(name, known.get(name)) for name in fields}
                if axis is not None and _WRITES[fields[0]][1]:
                    tagged["channel"] = axis.channel
                yield self.tell(message, **tagged)
                yield PAUSE

        return self.job("set parameters", steps)

    def _known(self, axis: MotorAxis | None) -> Steps:
        """What is stored now, by our names."""
        stored: BoardParameters = yield self.parameters()
        known = {name: getattr(stored, name) for name in stored.__struct_fields__ if name != "channels"}
        if axis is not None:
            channel = stored.channels[axis.name]
            known |= {name: getattr(channel, name) for name in channel.__struct_fields__}
        return known

    def set_limits(
        self,
        joint: str | None = None,
        *,
        lower: float | None = None,
        upper: float | None = None,
        enabled: bool = True,
    ) -> Job:
        """Position limits (rad) that the board itself keeps; None: the robot file's, and a limit nobody knows is left.

        The stored word's bit 0 is the enable flag, so limits are even counts (RoboWorld2018).
        """
        self.only_d12("limits of its own")
        axes = self.chosen(joint)

        def steps(job: Job) -> Steps:
            for axis in axes:
                own = axis.joint
                ends = [
                    lower if lower is not None or own is None else own.lower,
                    upper if upper is not None or own is None else own.upper,
                ]
                if axis.direction < 0:
                    ends.reverse()
                for message, end in zip(("LowerLimit", "UpperLimit"), ends, strict=True):
                    if end is not None:
                        options = ["enable", "update"] if enabled else ["update"]
                        count = int(axis.to_counts(end) / 2) * 2
                        yield self.tell(message, channel=axis.channel, options=options, limit=count)
                        yield PAUSE

        return self.job("set limits", steps)

    # ------------------------------------------------------------------ dangerous

    def initialise(self, confirm: bool) -> Ticket:
        """Load the board's default parameters (0xFA): gains, offsets and limits of this robot are lost (D12)."""
        self.only_d12("defaults")
        self._confirmed(confirm, "its gains, home offsets and limits will be lost")
        self.quiet()
        return self.tell("InitBoard")

    def set_board_number(self, number: int, confirm: bool, period_ms: int = 5) -> Ticket:
        """Give the board another number (0xF0); this device talks to that one from then on (D12)."""
        self.only_d12("a number that can be changed")
        if number not in range(0x30):
            raise CallerError(f"{self.name}: motor boards have the numbers 0x00 to 0x2f, not {number:#04x}")
        table = self.variant.tables.get("channels", {})
        if table.get(number) != self.kind:
            raise CallerError(
                f"{self.name}: the robot's file must list board {number:#04x} (inactive) with kind {self.kind}, or its"
                " answers will not be understood"
            )
        self._confirmed(confirm, "two boards with one number cannot be told apart again")
        self.quiet()
        ticket = self.tell("SetBoardNumber", number=number, period=period_ms)
        self.host.renumber(self, board=number)
        return ticket

    def _confirmed(self, confirm: bool, why: str) -> None:
        if confirm is not True:
            raise CallerError(f"{self.name}: say confirm=True; {why}")
