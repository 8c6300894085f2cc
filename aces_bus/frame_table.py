"""Many CAN frames as columns: a few arrays instead of an object a frame.

1. Column `i` of every array is frame `i`, in the order of the recording. Arrays are read, not written: tables share them.
2. Data bytes behind a frame's length are zero, so that whole words may be read from the rows.
3. An instant is integer nanoseconds; `NO_TIME` where the capture does not say.

A frame costs 30 bytes here and some 200 as an object. `frames()` and `from_frames` go between the two, and nothing is
lost either way that a `Frame` can hold.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

from ._lazy import np
from .errors import CaptureError
from .frames import EXTENDED, FD, REMOTE, Frame

if TYPE_CHECKING:
    import numpy.typing as npt

#: What `time` holds where the capture gives none.
NO_TIME = -(1 << 63)


class FrameFlag:
    """Bits of `flags`. RX and TX: neither is set where the capture does not say which way a frame went.

    `UNUSUAL` are those that make a frame anything but a standard data frame.
    """

    EXTENDED, REMOTE, FD, ERROR, BITRATE_SWITCH, ERROR_STATE, RX, TX = (1 << bit for bit in range(8))
    UNUSUAL = EXTENDED | REMOTE | FD | ERROR


_KEY_BITS = ((FrameFlag.EXTENDED, EXTENDED), (FrameFlag.REMOTE, REMOTE), (FrameFlag.FD, FD))

Ints: TypeAlias = "npt.NDArray[Any]"


class Channels:
    """Names of channels by number, shared by the tables of one capture. Numbers go up as names appear."""

    def __init__(self, names: Iterable[str | None] = ()) -> None:
        self.names: list[str | None] = []
        self._numbers: dict[str | None, int] = {}
        for name in names:
            self.number(name)

    def number(self, name: str | None) -> int:
        """Return the number of a name, a new one when it is new. Past 65,535 names all share the last number, named "…"."""
        found = self._numbers.get(name)
        if found is None:
            if len(self.names) >= 0xFFFF:
                name = "…"
                if name in self._numbers:
                    return self._numbers[name]
            found = self._numbers[name] = len(self.names)
            self.names.append(name)
        return found


@dataclass(frozen=True)
class FrameTable:
    """Frames as columns, all of length n.

    `time`: int64, nanoseconds. `channel`: uint16, number in `channels`. `id`: uint32, the bare identifier (11 or 29 bits;
    of an error frame its class). `flags`: uint8, the bits above. `length`: uint8, number of data bytes; of a remote frame
    the number it asks for. `data`: uint8 of shape (n, 8), or (n, 64) where a frame is longer; rows are contiguous.
    """

    time: Ints
    channel: Ints
    id: Ints
    flags: Ints
    length: Ints
    data: Ints
    channels: Channels

    def __len__(self) -> int:
        return len(self.time)

    @cached_property
    def key(self) -> Ints:
        """uint32: the identifier with the flags that scanners look messages up by (`aces_bus.frames`)."""
        flags = self.flags
        if not len(flags) or not int(np.bitwise_or.reduce(flags)) & FrameFlag.UNUSUAL:
            return self.id
        if (flags[0] == flags).all():
            some = int(flags[0])
            bits = sum(bit for flag, bit in _KEY_BITS if some & flag)
            return self.id | np.uint32(bits)
        key = self.id.astype(np.uint32)
        for flag, bit in _KEY_BITS:
            key |= (flags & flag).astype(bool) * np.uint32(bit)
        return key

    @classmethod
    def empty(cls, channels: Channels | None = None) -> FrameTable:
        """Return a table without frames."""
        return cls.from_frames((), channels)

    @classmethod
    def from_frames(cls, frames: Iterable[Any], channels: Channels | None = None) -> FrameTable:
        """Return the table of `Frame`s or python-can messages. Give the same `channels` for all tables of a
        capture.

        Seconds become the nanoseconds that their decimal digits say, without a rounding in between.
        """
        rows = frames if isinstance(frames, Sequence) else list(frames)
        channels = channels if channels is not None else Channels()
        n = len(rows)
        number = channels.number
        width = 64 if any(len(frame.data) > 8 for frame in rows) else 8
        return cls(
            np.fromiter((to_ns(frame.timestamp) for frame in rows), np.int64, n),
            np.fromiter((number(_name(frame.channel)) for frame in rows), np.uint16, n),
            np.fromiter((frame.arbitration_id for frame in rows), np.uint32, n),
            np.fromiter(map(_flags, rows), np.uint8, n),
            np.fromiter(map(_length, rows), np.uint8, n),
            np.frombuffer(b"".join(frame.data.ljust(width, b"\0") for frame in rows), np.uint8).reshape(
                n, width
            ),
            channels,
        )

    def frames(self) -> list[Frame]:
        """Return the frames as objects; seconds are the float nearest to the instant."""
        names = self.channels.names
        width = self.data.shape[1]
        raw = self.data.tobytes()
        out: list[Frame] = []
        unusual, received, ways = FrameFlag.UNUSUAL, FrameFlag.RX, FrameFlag.RX | FrameFlag.TX
        rows = zip(
            self.time.tolist(),
            self.channel.tolist(),
            self.id.tolist(),
            self.flags.tolist(),
            self.length.tolist(),
            range(0, len(self) * width, width),
            strict=True,
        )
        for time, channel, identifier, flags, length, start in rows:
            seconds = None if time == NO_TIME else time / 1_000_000_000
            way = None if not flags & ways else bool(flags & received)
            if not flags & unusual:
                out.append(
                    Frame(
                        identifier,
                        raw[start : start + length],
                        seconds,
                        names[channel],
                        False,
                        False,
                        False,
                        False,
                        False,
                        False,
                        way,
                    )
                )
                continue
            remote = bool(flags & FrameFlag.REMOTE)
            out.append(
                Frame(
                    identifier,
                    b"" if remote else raw[start : start + length],
                    seconds,
                    names[channel],
                    bool(flags & FrameFlag.EXTENDED),
                    remote,
                    bool(flags & FrameFlag.ERROR),
                    bool(flags & FrameFlag.FD),
                    bool(flags & FrameFlag.BITRATE_SWITCH),
                    bool(flags & FrameFlag.ERROR_STATE),
                    way,
                    length if remote else None,
                )
            )
        return out

    def __iter__(self) -> Iterator[Frame]:
        return iter(self.frames())

    def take(self, rows: Any) -> FrameTable:
        """Return the frames at `rows`: an index array, a boolean array or a slice."""
        return FrameTable(
            self.time[rows],
            self.channel[rows],
            self.id[rows],
            self.flags[rows],
            self.length[rows],
            self.data[rows],
            self.channels,
        )

    @classmethod
    def concat(cls, tables: Sequence[FrameTable]) -> FrameTable:
        """Join several tables of one capture, in order; they must share their `channels`."""
        if not tables:
            return cls.empty()
        if len(tables) == 1:
            return tables[0]
        width = max(table.data.shape[1] for table in tables)
        return cls(
            np.concatenate([t.time for t in tables]),
            np.concatenate([t.channel for t in tables]),
            np.concatenate([t.id for t in tables]),
            np.concatenate([t.flags for t in tables]),
            np.concatenate([t.length for t in tables]),
            np.concatenate([widened(t.data, width) for t in tables]),
            tables[0].channels,
        )


def joined_tables(tables: Iterable[FrameTable], least: int, *, is_live: bool = False) -> Iterator[FrameTable]:
    """Yield tables joined to at least `least` rows, but for the last; those of a live source as they come.

    Where reading stops with a `CaptureError`, what was read before comes first.
    """
    waiting: list[FrameTable] = []
    rows = 0
    failure: CaptureError | None = None
    try:
        for table in tables:
            waiting.append(table)
            rows += len(table)
            if rows >= least or (rows and is_live):
                whole = FrameTable.concat(waiting)
                waiting, rows = [], 0
                del table
                yield whole
                del whole  # one piece at a time is in memory
    except CaptureError as error:
        failure = error
    if waiting:
        yield FrameTable.concat(waiting)
    if failure is not None:
        raise failure


def rows_at(data: Ints, places: Ints) -> Ints:
    """Return rows of data in another order; rows of eight bytes as words, which is much quicker."""
    if data.shape[1] == 8 and data.flags.c_contiguous:
        words: Ints = data.view(np.uint64).ravel().take(places)
        return words.view(np.uint8).reshape(-1, 8)
    found: Ints = data[places]
    return found


def widened(data: Ints, width: int) -> Ints:
    """Return data rows of at least `width` bytes."""
    if data.shape[1] >= width:
        return data
    wide = np.zeros((len(data), width), np.uint8)
    wide[:, : data.shape[1]] = data
    return wide


def to_ns(seconds: float | None) -> int:
    """Convert seconds to the integer nanoseconds that their decimal digits say; None and what is not a number
    to `NO_TIME`.

    >>> to_ns(1436509052.249713)
    1436509052249713000
    """
    if seconds is None or seconds != seconds or seconds in (float("inf"), float("-inf")):
        return NO_TIME
    text = repr(float(seconds))
    whole, _, fraction = text.partition(".")
    if len(fraction) <= 9 and fraction.isdigit() and whole.isdigit():
        number = int(whole + fraction.ljust(9, "0"))
    else:
        number = int(Decimal(text).scaleb(9).to_integral_value())
    return number if abs(number) < 1 << 63 else NO_TIME


def ns_of(seconds: Ints) -> Ints:
    """Convert many float64 seconds to int64 nanoseconds, as `to_ns` does; `NO_TIME` where they are not an instant.

    Six decimals name a float below 2³² s, and nine one below 2²², without a doubt: floats are closer there than such
    decimals. So whatever comes back from its rounded decimals is these decimals; only the others are printed.

    >>> ns_of(np.array([1436509052.249713, 0.000000001, -1.5])).tolist()
    [1436509052249713000, 1, -1500000000]
    """
    size = np.abs(seconds)
    is_early = size < float(1 << 32)
    safe = np.where(is_early, seconds, 0.0)
    micro = np.rint(safe * 1e6)
    ns = micro.astype(np.int64) * 1000
    rest = np.flatnonzero(~(is_early & (micro / 1e6 == seconds)))
    if len(rest):
        small = np.where(size[rest] < float(1 << 22), seconds[rest], 0.0)
        nano = np.rint(small * 1e9)
        ns[rest] = nano.astype(np.int64)
        rest = rest[~((size[rest] < float(1 << 22)) & (nano / 1e9 == seconds[rest]))]
        ns[rest] = [to_ns(value) for value in seconds[rest].tolist()]
    return ns


def _name(channel: Any) -> str | None:
    return channel if channel is None or isinstance(channel, str) else str(channel)


def _flags(frame: Frame) -> int:
    way = frame.is_rx
    return (
        (FrameFlag.EXTENDED if frame.is_extended_id else 0)
        | (FrameFlag.REMOTE if frame.is_remote_frame else 0)
        | (FrameFlag.FD if frame.is_fd else 0)
        | (FrameFlag.ERROR if frame.is_error_frame else 0)
        | (FrameFlag.BITRATE_SWITCH if frame.bitrate_switch else 0)
        | (FrameFlag.ERROR_STATE if frame.error_state_indicator else 0)
        | (0 if way is None else FrameFlag.RX if way else FrameFlag.TX)
    )


def _length(frame: Frame) -> int:
    return (frame.dlc or 0) if frame.is_remote_frame else len(frame.data)
