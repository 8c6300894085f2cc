"""Names of channels and numbers of channels, for formats that have only one of the two.

1. Two channels stay two: no name and no number is given twice.
2. What a name becomes depends on the names before it and beside it in its table, and never changes.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from ...frame_table import Channels, FrameTable, Ints

_DIGITS = re.compile(r"(?:.*[^0-9])?([0-9]{1,5})", re.DOTALL)
#: Names that come back from their number.
_KEPT = re.compile(r"(?:can)?(0|[1-9][0-9]{0,4})")
_UNFIT = re.compile(r"[^!-~\x80-\U0010ffff]")


class _Map:
    """Number of a channel in a table's `channels` → what the file has instead. Tables of several captures may come."""

    def __init__(self) -> None:
        #: Names that the file does not give back.
        self.lost = 0
        self._known: dict[str | None, Any] = {}
        self._channels: Channels | None = None
        self._row: list[Any] = []

    def _of(self, name: str | None) -> Any:
        raise NotImplementedError

    def row(self, channels: Channels, highest: int) -> list[Any]:
        """What each number of `channels` up to `highest` becomes, in a list by number."""
        if channels is not self._channels:
            self._channels, self._row = channels, []
        names = channels.names[len(self._row) : highest + 1]
        for name in sorted((name for name in names if name not in self._known), key=_claim):
            self._known[name] = self._of(name)
        self._row += [self._known[name] for name in names]
        return self._row


def _claim(name: str | None) -> int:
    """Of names that come together, those that have a right to a number go first."""
    return 2 if name is None else 0 if _KEPT.fullmatch(name) else 1 if _DIGITS.fullmatch(name) else 2


class ChannelNumbers(_Map):
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

    def _of(self, name: str | None) -> int:
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
        """uint16: the number of each frame's channel in the file."""
        highest = int(table.channel.max()) if len(table) else 0
        return np.array(self.row(table.channels, highest) or [0], np.uint16)[table.channel]


class WrittenChannels(_Map):
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

    def _of(self, name: str | None) -> str:
        if name is not None and _KEPT.fullmatch(name):
            wanted = name if name.startswith("can") else f"can{name}"
            self.lost += wanted in self._taken
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
