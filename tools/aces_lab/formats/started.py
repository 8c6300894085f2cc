"""What writers of formats with a start and records share: times from the start, length codes, records of several sizes.

1. A start that a header states is settled with the first frames, and stays.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from aces_bus import FrameTable
from aces_bus.frame_table import NO_TIME, FrameFlag, Ints
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.write.base import ChannelNumbers, FrameWriter
from aces_bus.recordings.write.text import blocks

#: The length code (DLC) by length 0…255, uint8: the lowest code that has room; 15 past 64 (ISO 11898-1).
DLC_OF_LENGTH = np.minimum(np.searchsorted(np.array(FD_LENGTHS), np.arange(256)), 15).astype(np.uint8)
#: Times before it (1990) count from something else than 1970; files that state a start then start at zero.
EARLIEST = 631_152_000_000_000_000


class StartedWriter(FrameWriter):
    """Writes frames with their times from a start, which the file's header states; channels by number.

    Such formats have no direction of an error frame, and none but "received" for a frame that does not say.
    """

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        self._numbers = self._channels = self._numbering()
        self._is_begun = False
        #: What the header states, ns since 1970, and the highest offset so far.
        self._start: int | None = None
        self._last = 0
        self._offsets: Ints = np.empty(0, np.int64)

    def _numbering(self) -> ChannelNumbers:
        return ChannelNumbers()

    @abstractmethod
    def _settled(self, first: int) -> int:
        """Return the instant that a header can state, of the earliest time of the first frames (ns since 1970)."""

    def _begin(self) -> None:
        """Write the header, once the start is known or the file ends without a frame."""

    def _count(self, table: FrameTable, offsets: Ints) -> None:
        """Count the losses that are the format's own."""

    def write(self, table: FrameTable) -> None:
        """Write the frames, in order."""
        if not len(table):
            return
        offsets = self._times(table)
        self._begin_once()
        is_error, has_way = (
            table.flags & FrameFlag.ERROR != 0,
            table.flags & (FrameFlag.RX | FrameFlag.TX) != 0,
        )
        self.lose("unknown directions (written as received)", np.count_nonzero(~(is_error | has_way)))
        self.lose("directions of error frames", np.count_nonzero(is_error & has_way))
        self.lose(
            "CAN FD flags of error frames", np.count_nonzero(is_error & (table.flags & FrameFlag.FD != 0))
        )
        self._count(table, offsets)
        for rows in blocks(len(table)):
            self._offsets = offsets[rows]
            self._file.write(self._encoded(table.take(rows)))

    def close(self) -> None:
        """Write the header, where there was no frame."""
        self._begin_once()

    def _begin_once(self) -> None:
        if not self._is_begun:
            self._is_begun = True
            self._begin()

    def _error_classes(self, table: FrameTable) -> None:
        """Count error frames that say more than that there was one."""
        more = (table.flags & FrameFlag.ERROR != 0) & ((table.id != 0) | (table.length != 0))
        self.lose("classes and data of error frames", np.count_nonzero(more))

    def _times(self, table: FrameTable) -> Ints:
        """Return ns from the start, ≥ 0; earlier and unknown times are counted and become 0."""
        time = table.time
        known = time != NO_TIME
        self.lose("unknown times (written as the start)", np.count_nonzero(~known))
        if self._start is None:  # from now on the header is fixed, also where no time is known yet
            first = int(time[known].min()) if known.any() else 0
            self._start = self._settled(first) if first >= EARLIEST else 0
        early = known & (time < self._start)
        self.lose("times before the start of the file (written as the start)", np.count_nonzero(early))
        offsets = np.where(known & ~early, time, self._start) - self._start
        self._last = max(self._last, int(offsets.max()))
        return offsets


def rows_by_kind(table: FrameTable) -> tuple[Ints, Ints, Ints]:
    """Return the rows of classic frames, of CAN FD frames and of error frames."""
    is_error = table.flags & FrameFlag.ERROR != 0
    is_fd = (table.flags & FrameFlag.FD != 0) & ~is_error
    return np.flatnonzero(~(is_fd | is_error)), np.flatnonzero(is_fd), np.flatnonzero(is_error)


def records_in_order(n: int, parts: Sequence[tuple[Ints, npt.NDArray[Any]]]) -> bytes:
    """Join records of several sizes in one order: each part has its rows' numbers, which are all of 0…n-1 together."""
    parts = [part for part in parts if len(part[0])]
    if len(parts) == 1:
        return parts[0][1].tobytes()
    width = max(records.itemsize for _, records in parts)
    text, sizes = np.zeros((n, width), np.uint8), np.empty(n, np.intp)
    for rows, records in parts:
        text[rows, : records.itemsize] = records.view(np.uint8).reshape(len(rows), -1)
        sizes[rows] = records.itemsize
    return text[np.arange(width) < sizes[:, None]].tobytes()
