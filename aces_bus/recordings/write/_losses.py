"""What all formats share about what they cannot hold: counting it, and times.

1. Every loss is counted where it happens, in frames.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...frame_table import ERROR, FD, NO_TIME, REMOTE, RX, TX, FrameTable, Ints

UNKNOWN_TIMES = "unknown times (written as the start)"
UNKNOWN_DIRECTIONS = "unknown directions (written as received)"
ERROR_DIRECTIONS = "directions of error frames"
ERROR_FD = "CAN FD flags of error frames"
ERROR_CLASSES = "classes and data of error frames"


class WriteLosses:
    """Counts by kind, in words."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}

    def add(self, kind: str, count: int | np.integer) -> None:
        """Count some more; nothing when there are none."""
        if count:
            self.counts[kind] = self.counts.get(kind, 0) + int(count)

    def with_names(self, names: int) -> dict[str, int]:
        """All counts, with the names of channels that do not come back."""
        return {**self.counts, "channel names": names} if names else dict(self.counts)

    def directions(self, table: FrameTable) -> None:
        """Count frames that do not say which way they went, and error frames that do: in these formats they go neither."""
        is_error, has_way = table.flags & ERROR != 0, table.flags & (RX | TX) != 0
        self.add(UNKNOWN_DIRECTIONS, np.count_nonzero(~(is_error | has_way)))
        self.add(ERROR_DIRECTIONS, np.count_nonzero(is_error & has_way))

    def error_fd(self, table: FrameTable) -> None:
        """Count error frames in CAN FD."""
        is_error = table.flags & ERROR != 0
        if is_error.any():
            self.add(ERROR_FD, np.count_nonzero(is_error & (table.flags & FD != 0)))

    def error_classes(self, table: FrameTable) -> None:
        """Count error frames that say more than that there was one."""
        is_error = table.flags & ERROR != 0
        if is_error.any():
            self.add(ERROR_CLASSES, np.count_nonzero(is_error & ((table.id != 0) | (table.length != 0))))

    def remote_lengths(self, table: FrameTable) -> Ints:
        """The lengths, for remote frames at most 8; what is more is counted."""
        over = (table.flags & REMOTE != 0) & (table.length > 8)
        if not over.any():
            return table.length
        self.add("lengths above 8 that remote frames ask for", np.count_nonzero(over))
        return np.where(over, 8, table.length).astype(np.uint8)


def epoch_times(table: FrameTable, losses: WriteLosses) -> Ints:
    """Times from 1970 on, ≥ 0 in ns; those that are not are counted."""
    time = table.time
    if len(time) and int(time.min()) < 0:
        unknown = time == NO_TIME
        losses.add("unknown times (written as 0)", np.count_nonzero(unknown))
        losses.add("times before 1970 (written as 0)", np.count_nonzero((time < 0) & ~unknown))
        time = np.maximum(time, 0)
    return time


#: Times before it (1990) count from something else than 1970; files that state a start then start at zero.
EARLIEST = 631_152_000_000_000_000


class StartTime:
    """The start that a file's header states, and times from there on.

    `settle` makes an instant that the header can state out of the earliest time of the first frames, ns from 1970. Where
    this lies before 1990, the start is zero.
    """

    def __init__(self, losses: WriteLosses, settle: Callable[[int], int]) -> None:
        self.start: int | None = None
        #: The highest offset so far.
        self.last = 0
        self._losses, self._settle = losses, settle

    def offsets(self, table: FrameTable) -> Ints:
        """ns from the start, ≥ 0; earlier and unknown times are counted and are 0."""
        time = table.time
        known = time != NO_TIME
        if not known.all():
            self._losses.add(UNKNOWN_TIMES, np.count_nonzero(~known))
        if self.start is None:  # from now on the header stands, also where no time is known yet
            first = int(time[known].min()) if known.any() else 0
            self.start = self._settle(first) if first >= EARLIEST else 0
        start = self.start
        early = known & (time < start)
        if early.any():
            self._losses.add(
                "times before the start of the file (written as the start)", np.count_nonzero(early)
            )
        offsets = np.where(known & ~early, time, start) - start
        if len(offsets):
            self.last = max(self.last, int(offsets.max()))
        return offsets
