"""Where every frame and byte of several recordings went.

1. The bins of a link sum to what was read, whatever options leave out: a row that is refused moves, it does not go.
"""

from __future__ import annotations

from typing import Any

import msgspec

from aces_bus._lazy import np
from aces_bus.protocol.counts import ScanCounts
from aces_bus.recordings.base import Link

#: What scanners count.
_COUNTED = ("total", "decoded", "control", "unknown", "malformed", "skipped", "errors", "pending", "records")


class Totals(msgspec.Struct):
    """The bins of one kind of link, over all files: frames of CAN, bytes of serial lines."""

    bins: dict[str, int] = msgspec.field(default_factory=dict)
    lines_unreadable: int = 0
    missed: int = 0
    dropped: int = 0

    def add(self, name: str, number: int) -> None:
        """Put so many into a bin; fewer than none takes them out."""
        self.bins[name] = self.bins.get(name, 0) + number

    def __getitem__(self, name: str) -> int:
        return self.bins.get(name, 0)

    def count(self, counts: ScanCounts) -> None:
        """Add what a scanner counted."""
        for name in _COUNTED:
            self.add(name, getattr(counts, name))
        self.missed += counts.missed

    def join(self, other: Totals) -> None:
        """Add what was counted elsewhere."""
        for name, number in other.bins.items():
            self.add(name, number)
        self.lines_unreadable += other.lines_unreadable
        self.missed += other.missed
        self.dropped += other.dropped

    def reject(self, table: Any) -> None:
        """Move the rows of a `MessageTable` from their bins to `filtered`."""
        sizes: Any = table.size if table.size is not None else table.frames
        if sizes is None:
            sizes = np.ones(len(table), np.int64)
        total = int(sizes.sum())
        self.add("filtered", total)
        if table.message:
            self.add("decoded", -total)
            self.add("records", -len(table))
            return
        for reason, size in zip(table["reason"].values.tolist(), sizes.tolist(), strict=True):
            self.add("errors" if reason == "error frame" else reason.partition(":")[0], -size)

    def line(self, link: Link) -> str:
        """Return the summary line."""
        if link == "can":
            names = ("decoded", "unknown", "malformed", "filtered", "errors")
            # Only transports have frames that steer, and frames of packets that are not whole.
            more = [f"{n}={self[n]}" for n in ("control", "pending") if self[n]]
            parts = [
                f"frames={self['total']}",
                *(f"{n}={self[n]}" for n in names),
                *more,
                f"lines_unreadable={self.lines_unreadable}",
            ]
            return " ".join(parts)
        bins = ("decoded", "unknown", "malformed", "skipped", "filtered", "pending", "records")
        text = " ".join([f"bytes={self['total']}", *(f"{n}={self[n]}" for n in bins)])
        return f"{text} lines_unreadable={self.lines_unreadable}" if self.lines_unreadable else text

    @property
    def faults(self) -> list[str]:
        """Faults that --strict does not allow."""
        found = [f"{self[n]} {n}" for n in ("unknown", "malformed", "skipped", "pending") if self[n]]
        if self.lines_unreadable:
            found.append(f"{self.lines_unreadable} unreadable line{'s' if self.lines_unreadable > 1 else ''}")
        return found
