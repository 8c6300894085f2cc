"""The driver `hubo_motor`: one board of 1, 2, 3 or 5 motors, with what is stored in it (D12): parameters, limits.

1. A board lists only the actions that its kind and dialect have.
2. Parameters and currents come on one identifier, and only the open request tells them apart: while parameters are read,
   currents are not asked for.
3. Halves that the board cuts across blocks are put together here; counts become limits in rad where a joint is known.
4. What can lose a board or its calibration wants `confirm=True`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from aces_bus.device import Job, Steps, Ticket
from aces_bus.errors import CallerError, NoReplyError

from .board import MotorAxis
from .homing import Homing
from .parameters import (
    BOARD_BLOCKS,
    CHANNEL_BLOCKS,
    OF_BOARD,
    WRITES,
    BoardParameters,
    ChannelParameters,
    channel_parameters,
    selector,
)
from .switching import PAUSE_NS

#: A reply may take so long (s): hubo-ach waits 180 ms.
READ_TIMEOUT_S = 0.18
#: Parameter → the command that writes it.
_COMMAND_OF = {name: message for message, names in WRITES.items() for name in names}
#: Defaults of what cannot be read back.
_USUAL: Mapping[str, Any] = {"homing_duty": 30, "temperature_warning": 80}

_ALWAYS = {
    "enable": "follow set-points, from where the joints are",
    "disable": "control off, drivers off",
}
_GAINS = {"set_gains": "position gains of a joint, kp= ki= kd=, or torque=True"}
_HOME = {"home": "search the home of a joint, or of all; it moves"}
_ZERO = {"zero_encoder": "make the present position the encoder's zero"}
_MODE = {"set_control_mode": "position, current or torque, hybrid"}
_D12 = {
    "clear_errors": "clear error bits; also sets the encoder to zero",
    "parameters": "read all that is stored in the board",
    "set_parameters": "write stored parameters of a joint or the board, name=value",
    "set_limits": "the board's own position limits, lower= upper= (rad)",
    "override_gains": "scale the gains of the first two motors, in %",
    "switching_mode": "free_wheeling=True: the motor turns freely",
    "beep": "beep for some seconds",
    "alarm": "alarm sound 1 to 4; 0 is silence",
    "initialise": "load the board's defaults, confirm=True; its calibration is lost",
    "set_board_number": "give the board another number, confirm=True",
}
_INFO = {"board_info": "ask the board what it is; sets its period"}
_COMPLIANCE = {"set_compliance": "let the joints give way (on), or be rigid again (off)"}


class HuboMotor(Homing):
    """One motor board."""

    asking = ("parameters",)

    def setup(self) -> None:
        """Set up what `shapes` declares; the actions that this board has."""
        super().setup()
        shape = self.shape
        actions = dict(_ALWAYS)
        if shape.gains:
            actions |= _GAINS | _MODE
        if shape.home is not None:
            actions |= _HOME
        if shape.encoders and self.kind != "neck":
            actions |= _ZERO
        if self.dialect == "D12" and self.kind != "neck":
            actions |= _D12
        if self.knows_name():
            actions |= _INFO
        soft = [axis.joint.compliance is not None for axis in self.axes if axis.joint is not None]
        if (
            self.dialect == "D12"
            and self.kind in (1, 2)
            and soft
            and all(soft)
            and self.set_message == "Reference"
        ):
            actions |= _COMPLIANCE
        self.actions = actions  # type: ignore[misc]

    def parameters(self) -> Job:
        """Read all that the board has stored; the job's result is a `BoardParameters` (D12)."""
        self.only_d12("parameters that can be read")
        axes = self.axes_of(None)

        def steps(job: Job) -> Steps:
            whole = len(CHANNEL_BLOCKS) * len(axes) + len(BOARD_BLOCKS)
            channels: dict[str, ChannelParameters] = {}
            for number, axis in enumerate(axes):
                blocks: dict[int, Any] = {}
                for block in CHANNEL_BLOCKS:
                    asked = selector(axis.channel, block)
                    blocks[block] = yield from self._block(asked, f"Parameters{block}")
                    job.progress = (number * len(CHANNEL_BLOCKS) + block) / whole
                channels[axis.name] = channel_parameters(blocks)
            found: dict[str, Any] = {}
            for block, names in BOARD_BLOCKS.items():
                record = yield from self._block(block, f"Parameters{block}")
                found |= {name: getattr(record, name) for name in names}
            return BoardParameters(channels=channels, **found)

        return self.job("parameters", steps)

    def _block(self, number: int, name: str) -> Steps:
        """One block, with no request for currents open beside it."""
        for attempt in range(3):
            self.host.postpone(self, "SendCurrent", 2 * READ_TIMEOUT_S)
            while any(ticket.message == "SendCurrent" for ticket in self.awaiting):
                yield PAUSE_NS
            try:
                # Once a try: a repeated request could meet the late answer to the first.
                record = yield self.ask(
                    "GetParameters", reply=name, selector=number, timeout_s=READ_TIMEOUT_S, retries=0
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
        axis = None if joint is None else self.axes_of(joint)[0]
        commands: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            if name not in _COMMAND_OF:
                raise CallerError(f"{self.name}: cannot write {name!r}; there are {', '.join(_COMMAND_OF)}")
            if axis is None and _COMMAND_OF[name] not in OF_BOARD:
                raise CallerError(f"{self.name}: {name} is a joint's; say which")
            commands.setdefault(_COMMAND_OF[name], {})[name] = value

        def steps(job: Job) -> Steps:
            for message, given in commands.items():
                known = dict(_USUAL)
                if WRITES[message].keys() - given.keys() - known.keys():
                    known |= yield from self._known(axis)
                fields = {field: given.get(name, known.get(name)) for name, field in WRITES[message].items()}
                if axis is not None and message not in OF_BOARD:
                    fields["channel"] = axis.channel
                yield self.send(message, **fields)
                yield PAUSE_NS

        return self.job("set parameters", steps)

    def _known(self, axis: MotorAxis | None) -> Steps:
        """Return what is stored now, by our names."""
        stored: BoardParameters = yield self.parameters()
        known = msgspec.structs.asdict(stored)
        return known if axis is None else known | msgspec.structs.asdict(stored.channels[axis.name])

    def set_limits(
        self,
        joint: str | None = None,
        *,
        lower: float | None = None,
        upper: float | None = None,
        enabled: bool = True,
    ) -> Job:
        """Position limits (rad) that the board itself keeps; None: the robot file's, and an unknown limit is left as it is.

        The stored word's bit 0 is the enable flag, so limits are even counts (RoboWorld2018).
        """
        self.only_d12("limits of its own")
        axes = self.axes_of(joint)

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
                        yield self.send(message, channel=axis.channel, options=options, limit=count)
                        yield PAUSE_NS

        return self.job("set limits", steps)

    # ------------------------------------------------------------------ dangerous

    def initialise(self, confirm: bool) -> Ticket:
        """Load the board's default parameters (0xFA): gains, offsets and limits of this robot are lost (D12)."""
        self.only_d12("defaults")
        self._confirmed(confirm, "its gains, home offsets and limits will be lost")
        self.quiet()
        return self.send("InitBoard")

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
        self._confirmed(confirm, "two boards with one number cannot be distinguished again")
        self.quiet()
        ticket = self.send("SetBoardNumber", number=number, period=period_ms)
        self.host.renumber(self, board=number)
        return ticket

    def _confirmed(self, confirm: bool, why: str) -> None:
        if confirm is not True:
            raise CallerError(f"{self.name}: say confirm=True; {why}")
