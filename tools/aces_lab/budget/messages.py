"""What is sent on a bus again and again, and how its nodes queue it.

1. Times are integer ns, rounded up where a bit rate does not divide: a budget never says less than there is.
2. A priority is a number, and the lower one wins: of CAN frames what arbitration compares, of a textbook's set 1, 2, 3.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from aces_bus import Frame
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.frames import FD_LENGTHS
from aces_bus.hardware.simulated.bus import arbitration
from aces_bus.hardware.simulated.frame_time import INTERMISSION, longest_bits

#: How a node gives its frames to the bus: the most urgent first, or in the order in which they were queued.
Queue = Literal["priority", "fifo"]
#: Bits of an error frame and what its receivers add to it, before the bus is idle again (Tindell and Burns 1994, 4).
ERROR_BITS = 31
_SECOND = 1_000_000_000


def bits_ns(bits: int, bitrate: int) -> int:
    """Return how long so many bits are (ns, rounded up). Raises `CallerError` for a rate that is none."""
    _check_rate(bitrate)
    return -(-bits * _SECOND // bitrate)


def _check_rate(rate: int | None) -> None:
    if rate is not None and rate <= 0:
        raise CallerError(f"{rate} bit/s is not a rate of a bus")


def frame_ns(
    size: int,
    bitrate: int,
    *,
    extended: bool = False,
    fd: bool = False,
    bitrate_switch: bool = False,
    data_bitrate: int | None = None,
) -> int:
    """Return the longest that a data frame of `size` bytes can occupy the bus (ns, rounded up), its intermission included.

    Rates are in bit/s; `data_bitrate` counts with `bitrate_switch` only. Raises `CallerError` for what no frame can be.
    """
    if size not in (FD_LENGTHS if fd else range(9)):
        raise CallerError(f"no {'CAN FD' if fd else 'classic CAN'} frame has {size} bytes")
    _check_rate(bitrate)
    _check_rate(data_bitrate)
    found = longest_bits(size, extended=extended, fd=fd, bitrate_switch=bitrate_switch)
    rate = (data_bitrate if bitrate_switch else None) or bitrate
    bits = (found.nominal + INTERMISSION) * rate + found.data * bitrate
    return -(-bits * _SECOND // (bitrate * rate))


@dataclass(frozen=True)
class BusMessage:
    """One message that a node sends again and again.

    It is queued up to `jitter_ns` after each begin of a period, and occupies the bus for `wire_ns` at most; `deadline_ns`
    counts from the begin of the period (None: it is the period). `node` is who sends it; "" are nodes of their own. The
    period of what comes now and then is the shortest time between two. Raises `CallerError` for times that are none.
    """

    name: str
    priority: int
    wire_ns: int
    period_ns: int
    jitter_ns: int = 0
    deadline_ns: int | None = None
    node: str = ""

    def __post_init__(self) -> None:
        if self.wire_ns <= 0 or self.period_ns <= 0:
            raise CallerError(f"{self.name}: time on the wire and period are above 0")
        if self.jitter_ns < 0 or (self.deadline_ns is not None and self.deadline_ns <= 0):
            raise CallerError(f"{self.name}: a jitter is 0 or more, a deadline above 0")

    @property
    def due_ns(self) -> int:
        """When it has to have arrived, from the begin of its period (ns)."""
        return self.period_ns if self.deadline_ns is None else self.deadline_ns


def can_message(
    name: str,
    identifier: int,
    size: int,
    period_ns: int,
    *,
    bitrate: int,
    extended: bool = False,
    fd: bool = False,
    bitrate_switch: bool = False,
    data_bitrate: int | None = None,
    jitter_ns: int = 0,
    deadline_ns: int | None = None,
    node: str = "",
) -> BusMessage:
    """Return a CAN message of `size` data bytes, stuffed as much as can be. Raises `CallerError` for what no frame can be.

    >>> can_message("speed", 0x120, 8, 10_000_000, bitrate=1_000_000).wire_ns
    135000
    """
    wire_ns = frame_ns(
        size,
        bitrate,
        extended=extended,
        fd=fd,
        bitrate_switch=bitrate_switch,
        data_bitrate=data_bitrate,
    )
    frame = Frame(identifier, bytes(size), is_extended_id=extended, is_fd=fd, bitrate_switch=bitrate_switch)
    return BusMessage(name, arbitration(frame), wire_ns, period_ns, jitter_ns, deadline_ns, node)


@dataclass(frozen=True)
class ErrorModel:
    """How often frames are destroyed: `burst` at once, and one each `every_ns` after (Tindell and Burns 1994, 4).

    Each costs `ERROR_BITS` and the longest frame that may have to be sent again. `burst` 0: no errors. Raises `CallerError`.
    """

    burst: int = 0
    every_ns: int = _SECOND

    def __post_init__(self) -> None:
        if self.burst < 0 or self.every_ns <= 0:
            raise CallerError("errors: a burst is 0 or more, the time between two above 0")

    def within(self, window_ns: int) -> int:
        """Return how many there are in a window at most."""
        return self.burst + max(0, -(-window_ns // self.every_ns) - 1) if self.burst else 0


NO_ERRORS = ErrorModel()


@dataclass(frozen=True)
class MessageSet:
    """All that is sent on one bus.

    `bit_ns` is the time of a bit: a frame that is queued so shortly after another has begun still takes part in the
    arbitration. `queues` says of nodes how they queue (default: by priority). Raises `CallerError` where two messages have
    one name, and `UnknownNameError` for a node that sends nothing.
    """

    messages: tuple[BusMessage, ...]
    bit_ns: int
    queues: Mapping[str, Queue] = field(default_factory=dict[str, Queue])
    errors: ErrorModel = NO_ERRORS

    def __post_init__(self) -> None:
        names = [message.name for message in self.messages]
        if len(set(names)) < len(names):
            double = next(name for name in names if names.count(name) > 1)
            raise CallerError(f"two messages have one name: {double}")
        nodes = {message.node for message in self.messages}
        for node in self.queues:
            if node not in nodes or not node:
                raise UnknownNameError("node", node, nodes - {""})

    @property
    def utilisation(self) -> float:
        """The share of time in which the bus is busy, with the longest frames and without errors."""
        return sum(message.wire_ns / message.period_ns for message in self.messages)

    def is_fifo(self, message: BusMessage) -> bool:
        """Return whether a message waits behind others of its node, whatever their priority."""
        return self.queues.get(message.node, "priority") == "fifo"

    def error_ns(self, window_ns: int, frames: Iterable[int]) -> int:
        """Return the time (ns) that errors within a window cost when any of `frames` (durations in ns) may be
        sent again.
        """
        count = self.errors.within(window_ns)
        return count * (ERROR_BITS * self.bit_ns + max(frames, default=0)) if count else 0
