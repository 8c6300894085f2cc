"""The base of writers of recordings: the file, losses of the format, names and numbers of channels.

1. Every loss is counted where it happens, in frames; "channel names" counts names.
2. Two channels stay two: no name and no number is given twice. What a name becomes depends on the names before it and beside
   it in its table, and never changes.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from typing import Any, BinaryIO, ClassVar

import numpy as np

from ...frame_table import NO_TIME, Channels, FrameFlag, FrameTable, Ints
from .text import blocks


class RecordingWriter:
    """Writes a recording into an open file, which it leaves open. `name` is what messages call the file.

    A subclass has `write`, which takes frame tables, or chunks of a serial line, in the order of the recording.
    """

    format: ClassVar[str]
    #: An error frame keeps whether it has 29 bits.
    keeps_error_width: ClassVar[bool] = False

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file, self.name = file, name
        self._lost: dict[str, int] = {}
        self._channels: ChannelMap | None = None

    @property
    def lossy(self) -> dict[str, int]:
        """Losses of the format so far, in words that fit behind a number."""
        names = 0 if self._channels is None else self._channels.lost
        return {**self._lost, "channel names": names} if names else dict(self._lost)

    @property
    def renamed(self) -> dict[str, str]:
        """Channels that are numbers, and the names that they have in the file."""
        return {} if self._channels is None else self._channels.renamed

    def lose(self, kind: str, count: int | np.integer = 1) -> None:
        """Count a loss; nothing when `count` is 0."""
        if count:
            self._lost[kind] = self._lost.get(kind, 0) + int(count)

    def settle(self) -> None:
        """Bring the file into a state that reads back as it is, with all that was given, though more may follow.

        Only formats that need no end can do so: `FormatOut.grows`.
        """

    def close(self) -> None:
        """Write what was kept back."""


class FrameWriter(RecordingWriter, ABC):
    """Writes CAN frames."""

    def write(self, table: FrameTable) -> None:
        """Write the frames, in order."""
        for rows in blocks(len(table)):
            self._file.write(self._encoded(table.take(rows)))

    @abstractmethod
    def _encoded(self, table: FrameTable) -> bytes:
        """Return frames as the file has them; some thousand, and at least one."""

    def lose_fd(self, table: FrameTable) -> None:
        """Count what is lost of CAN FD where a frame is known as one by its more than 8 bytes alone."""
        flags = table.flags
        is_hidden = (flags & FrameFlag.FD != 0) & (table.length <= 8)
        self.lose(
            "CAN FD flags",
            np.count_nonzero(is_hidden | (flags & (FrameFlag.BITRATE_SWITCH | FrameFlag.ERROR_STATE) != 0)),
        )

    def _remote_lengths(self, table: FrameTable) -> Ints:
        """Return the lengths, for remote frames at most 8; what is more is counted."""
        over = (table.flags & FrameFlag.REMOTE != 0) & (table.length > 8)
        if not over.any():
            return table.length
        self.lose("lengths above 8 that remote frames ask for", np.count_nonzero(over))
        return np.where(over, 8, table.length).astype(np.uint8)

    def _epoch_times(self, table: FrameTable) -> Ints:
        """Return times since 1970, ≥ 0, in ns; count the times that are not."""
        time = table.time
        if len(time) and int(time.min()) < 0:
            unknown = time == NO_TIME
            self.lose("unknown times (written as 0)", np.count_nonzero(unknown))
            self.lose("times before 1970 (written as 0)", np.count_nonzero((time < 0) & ~unknown))
            time = np.maximum(time, 0)
        return time


# ---- channels -------------------------------------------------------------------------------------------------------

_DIGITS = re.compile(r"(?:.*[^0-9])?([0-9]{1,5})", re.DOTALL)
#: Names that come back from their number.
_KEPT = re.compile(r"(?:can)?(0|[1-9][0-9]{0,4})")
_UNFIT = re.compile(r"[^!-~\x80-\U0010ffff]")


class ChannelMap:
    """Number of a channel in a table's `channels` → what the file has instead. Tables of several captures may come."""

    def __init__(self) -> None:
        #: Names that the file does not give back.
        self.lost = 0
        #: Numbers that are written as names, which count as the same channel.
        self.renamed: dict[str, str] = {}
        self._known: dict[str | None, Any] = {}
        self._channels: Channels | None = None
        self._row: list[Any] = []

    def number(self, name: str | None) -> Any:
        """Return what a new name becomes."""
        raise NotImplementedError

    def row(self, channels: Channels, highest: int) -> list[Any]:
        """Return what each number of `channels` up to `highest` becomes, in a list by number."""
        if channels is not self._channels:
            self._channels, self._row = channels, []
        names = channels.names[len(self._row) : highest + 1]
        for name in sorted((name for name in names if name not in self._known), key=_claim):
            self._known[name] = self.number(name)
        self._row += [self._known[name] for name in names]
        return self._row


def _claim(name: str | None) -> int:
    """Give numbers to names that come together, first to those that have a right to one."""
    return 2 if name is None else 0 if _KEPT.fullmatch(name) else 1 if _DIGITS.fullmatch(name) else 2


class ChannelNumbers(ChannelMap):
    """Names → numbers from 1, the digits at their end plus one; `none` is for frames without a channel, if there is one.

    >>> numbers = ChannelNumbers()
    >>> numbers.row(Channels(["can0", "1", "vcan4", None, "can1"]), 4)
    [1, 2, 5, 4, 3]
    >>> numbers.lost  # vcan4 comes back as 4, None as 3, and can1 as 2, since 1 was there before
    3
    """

    def __init__(self, limit: int = 0xFFFF, none: int | None = None) -> None:
        super().__init__()
        self._limit, self._none = limit, none
        self._taken: set[int] = set()
        self._free = 1

    def number(self, name: str | None) -> int:
        """Return a number for a new name."""
        if name is None and self._none is not None:
            return self._none
        found = _DIGITS.fullmatch(name) if name is not None else None
        number = int(found[1]) + 1 if found else 0
        if not 0 < number <= self._limit or number in self._taken:
            while self._free in self._taken and self._free < self._limit:
                self._free += 1
            number = self._free
            self.lost += 1
        elif name is None or not _KEPT.fullmatch(name):
            self.lost += 1
        self._taken.add(number)
        return number

    def numbers(self, table: FrameTable) -> Ints:
        """Return uint16: the number of each frame's channel in the file."""
        highest = int(table.channel.max()) if len(table) else 0
        return np.array(self.row(table.channels, highest) or [0], np.uint16)[table.channel]


class WrittenChannels(ChannelMap):
    """Names → names without blanks, at most `limit` bytes each: those of interfaces.

    >>> names = WrittenChannels()
    >>> names.row(Channels(["can0", "1", "vcan4", None, "CAN 1"]), 4)
    ['can0', 'can1', 'vcan4', 'can2', 'CAN_1']
    >>> names.lost
    2
    """

    def __init__(self, limit: int = 64) -> None:
        super().__init__()
        self._limit = limit
        self._taken: set[str] = set()

    def number(self, name: str | None) -> str:
        if name is not None and _KEPT.fullmatch(name):
            wanted = name if name.startswith("can") else f"can{name}"
            self.lost += wanted in self._taken
            if wanted != name:
                self.renamed[name] = wanted
        else:
            wanted = _UNFIT.sub("_", name or "")
            while len(wanted.encode("utf-8", "backslashreplace")) > self._limit:
                wanted = wanted[:-1]
            self.lost += not wanted or wanted != name or wanted in self._taken
        stem, number = (wanted, 1) if wanted else ("can", -1)
        while not wanted or wanted in self._taken:
            number += 1
            wanted = f"can{number}" if stem == "can" else f"{stem[: self._limit // 4]}_{number}"
        self._taken.add(wanted)
        return wanted
