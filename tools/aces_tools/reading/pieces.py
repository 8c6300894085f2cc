"""What scanners are fed of a recording: frames in pieces that are worth decoding, bytes of each direction.

1. Where reading fails, what was read before is decoded first.
2. Each direction of a serial line is a stream of its own, and a reply may hang on a request of the other.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

from aces_bus import FrameTable, open_recording
from aces_bus.errors import CallerError, CaptureError
from aces_bus.frame_table import joined_tables
from aces_bus.protocol import Variant
from aces_bus.protocol.counts import ScanCounts
from aces_bus.protocol.declare.message import Direction as OneWay
from aces_bus.recordings.base import CanRecording, Chunk, SerialRecording
from aces_bus.recordings.serial.raw import RawCapture

if TYPE_CHECKING:
    from aces_bus.protocol.columns.can import CanColumns
    from aces_bus.protocol.columns.can_channels import ChannelColumns

T = TypeVar("T")
Direction = Literal["to device", "from device", "both"]

#: Frames that are decoded at once, at least, where they need not be waited for.
PIECE = 1 << 18


def pieces_of(tables: Iterable[FrameTable], *, is_live: bool) -> Iterator[FrameTable]:
    """Yield tables joined until they are worth decoding: the cost of a piece for each message is paid less often."""
    return joined_tables(tables, PIECE, is_live=is_live)


def frame_runs(tables: Iterable[FrameTable], size: int) -> Iterator[FrameTable]:
    """Yield tables of `size` frames each, but for the last: the same ones for all readers, however the bytes
    come. Where reading stops with an error, what was read before comes first.
    """
    rest: FrameTable | None = None
    reading = CaptureReading(tables)
    for table in reading:
        rest = table if rest is None else FrameTable.concat([rest, table])
        while len(rest) >= size:
            yield rest.take(slice(size))
            rest = rest.take(slice(size, None))
    if rest is not None and len(rest):
        yield rest
    reading.check()


def make_can_scanner(
    variants: Sequence[Variant], *, direction: Direction | None, include_unknown: bool, defer: bool
) -> CanColumns | ChannelColumns:
    """Return a column scanner of CAN that shares a recording with others: with `defer`, frames that hang on those of
    other pieces are left to `hand_over`; without, it is the one that adopts them, piece by piece."""
    from aces_bus.protocol.columns.can import CanColumns
    from aces_bus.protocol.columns.can_channels import ChannelColumns

    kind: Any = ChannelColumns if any(v.channel is not None for v in variants) else CanColumns
    made: CanColumns | ChannelColumns = kind(
        variants, direction=direction, include_unknown=include_unknown, defer=defer
    )
    return made


class CaptureReading(Generic[T]):
    """The items of a capture up to where reading fails: what has come is finished before `check` raises the failure."""

    def __init__(self, items: Iterable[T]) -> None:
        self._items = items
        self._failure: CaptureError | None = None

    def __iter__(self) -> Iterator[T]:
        try:
            yield from self._items
        except CaptureError as failure:
            self._failure = failure

    def check(self) -> None:
        """Raise what has failed, if anything has."""
        if self._failure is not None:
            raise self._failure


class Requests:
    """What went to the device, for decoding what came from it: where a capture says which way bytes went, each way is
    a stream of its own, and a reply may hang on a request of the other."""

    def __init__(self, variants: Sequence[Variant]) -> None:
        self._scanner: Any = None
        if any(map(has_requests, variants)):
            from aces_bus import make_scanner

            self._scanner = make_scanner(variants, direction="to device")

    def of(self, data: bytes, time: float | None) -> list[tuple[bytes, float | None]]:
        """Return the packets that these bytes complete, with their times."""
        if self._scanner is None:
            return []
        return [(record.meta.raw, record.meta.time) for record in self._scanner.feed(data, time)]


class SerialWays:
    """The scanners of a serial recording, one a direction, made as directions occur.

    `make` makes one; `feed(scanner, data, time)` says how it is fed: what it gives (records, tables) is handed on.
    """

    def __init__(
        self,
        variants: Sequence[Variant],
        direction: Direction | None,
        make: Callable[[Direction | None], Any],
        feed: Callable[[Any, bytes, float | None], Any],
    ) -> None:
        self._variants, self._make, self._feed = variants, make, feed
        self._direction: Direction | None = direction
        self._used: dict[Direction | None, Any] = {}
        self._requests = Requests(variants)

    def chunks(self, capture: SerialRecording) -> Iterable[Chunk]:
        """Return the chunks to feed; of a live line also empty ones, when it is silent."""
        return capture.with_silence(self._gap) if isinstance(capture, RawCapture) else capture

    def _gap(self) -> float:
        return max(getattr(scanner, "gap", 0.0) for scanner in self._used.values())

    def _of(self, direction: Direction | None) -> Any:
        if direction not in self._used:
            check_direction(self._variants, direction)
            self._used[direction] = self._make(direction)
        return self._used[direction]

    def feed(self, chunk: Chunk) -> Iterator[Any]:
        """Yield what a chunk gives; an empty one says that nothing that is incomplete will go on."""
        if not chunk.data:
            for used in self._used.values():
                yield used.idle()
            return
        direction: Direction | None = self._direction or chunk.direction
        scanner = self._of(direction)
        if direction == "to device" and self._direction is None:
            replies = self._of("from device")
            for packet, time in self._requests.of(chunk.data, chunk.time):
                yield replies.sent(packet, time) or []
        yield self._feed(scanner, chunk.data, chunk.time)

    def close(self) -> Iterator[Any]:
        """Yield what the end of the recording gives."""
        for scanner in self._used.values():
            yield scanner.close()

    @property
    def counts(self) -> list[ScanCounts]:
        """Counts of each direction's bytes by their outcome."""
        return [scanner.counts for scanner in self._used.values()]


def open_any(name: str) -> CanRecording | SerialRecording:
    """Open a recording of either link; a file of none of the formats that say what they are is raw bytes."""
    try:
        return open_recording(name)
    except CaptureError:
        if name == "-" or not os.path.isfile(name):
            raise
        return open_recording(name, link="serial")


def has_requests(variant: Variant) -> bool:
    """Return whether some message of the protocol hangs on another."""
    return any(message.reply_to or message.after for message in variant.messages.values())


def check_direction(variants: Sequence[Variant], direction: OneWay | Direction | None) -> None:
    """Raise `CallerError` where bytes of a stream have two meanings unless their direction is known."""
    for variant in variants if direction is None else ():
        clash = variant.direction_conflict
        if clash is not None and variant.link != "can":
            raise CallerError(
                f"{variant.name}: bytes alone do not tell {clash[0].name} from {clash[1].name};"
                " say which way they went: --direction to (to the device), from, or both"
            )
