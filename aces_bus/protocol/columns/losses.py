"""What a decided buffer lost, as runs and as a table: many losses at once.

1. Runs are those of the live scanner: neighbouring bytes lost for one reason are one run, a whole packet is always its own.
2. Bytes are copied when somebody asks for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...frame_table import Channels, to_ns
from ..live.find import Decided
from .packet_checks import reason_of
from .scanner import LOST
from .table import Array, Column, ColumnKind, MessageTable


@dataclass(frozen=True)
class LossRuns:
    """Runs of lost bytes, rising: where in the buffer, how many, and the number of the reason in `reasons`."""

    starts: Array
    sizes: Array
    numbers: Array
    reasons: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.starts)

    def by_reason(self, some: slice = slice(None)) -> dict[str, int]:
        """Bytes by reason."""
        totals = (
            np.bincount(self.numbers[some], self.sizes[some], len(self.reasons)).astype(np.int64).tolist()
        )
        return {reason: total for reason, total in zip(self.reasons, totals, strict=True) if total}

    def item(self, index: int, base: int, buffer: bytes) -> tuple[int, int, str, bytes]:
        """One run: offset in the stream, size, reason, bytes."""
        start, size = int(self.starts[index]), int(self.sizes[index])
        return base + start, size, self.reasons[int(self.numbers[index])], buffer[start : start + size]

    def table(
        self, some: slice, base: int, buffer: bytes, time: float | None, channels: Channels
    ) -> MessageTable:
        """Some of the runs as the table that `lost_table` makes."""
        starts, sizes, numbers = self.starts[some], self.sizes[some], self.numbers[some]

        def make(kind: ColumnKind) -> Column:
            if kind.name == "reason":
                words = np.empty(len(self.reasons), object)
                words[:] = self.reasons
                return Column(kind, words[numbers])
            raw = np.empty(len(starts), object)
            pairs = zip(starts.tolist(), sizes.tolist(), strict=True)
            raw[:] = [buffer[start : start + size] for start, size in pairs]
            return Column(kind, raw)

        n = len(starts)
        keys = starts + base
        return MessageTable(
            "",
            "",
            None,
            True,
            np.full(n, to_ns(time), np.int64),
            np.full(n, channels.number(None), np.uint16),
            channels,
            keys,
            keys,
            np.full(n, 2, np.uint8),
            LOST,
            make,
            size=sizes,
        )


def totals_of(decided: Decided, unknown: Array, why: Sequence[str]) -> dict[str, int]:
    """Only how many bytes were lost, by reason."""
    lost = len(decided.bad)
    totals = {"skipped": decided.stop - int(decided.sizes.sum()) - lost}
    if lost:
        codes, numbers = np.unique(decided.codes, return_counts=True)
        totals.update((reason_of(code), n) for code, n in zip(codes.tolist(), numbers.tolist(), strict=True))
    for reason, size in zip(why, decided.sizes[unknown].tolist(), strict=True):
        totals[reason] = totals.get(reason, 0) + size
    return {reason: total for reason, total in totals.items() if total}


def losses_of(decided: Decided, unknown: Array, why: Sequence[str]) -> LossRuns:
    """The runs between the packets, and the packets `unknown` that are no message, with the reason of each."""
    ends = decided.ends
    gaps, behind = np.append(0, ends), np.append(decided.starts, decided.stop)
    some = np.flatnonzero(gaps < behind)
    gaps, behind = gaps[some], behind[some]
    codes, kinds = np.unique(decided.codes, return_inverse=True)
    words = tuple(dict.fromkeys(why))
    reasons = ("skipped", *(reason_of(code) for code in codes.tolist()), *words)
    bad = decided.bad
    starts = np.concatenate([gaps, bad + 1, bad])
    numbers = np.concatenate([np.zeros(len(gaps) + len(bad), np.int64), kinds + 1])
    # Of what begins at one place the skipped ones come first, and turn out to be empty.
    order = np.argsort(starts, kind="stable")
    starts, numbers = starts[order], numbers[order]
    if len(starts):
        limits = behind[np.searchsorted(gaps, starts, "right") - 1]
        sizes = np.minimum(np.append(starts[1:], limits[-1:]), limits) - starts
    else:
        sizes = starts
    whole = len(codes) + 1
    if len(unknown):
        number_of = {word: whole + index for index, word in enumerate(words)}
        starts = np.concatenate([starts, decided.starts[unknown]])
        sizes = np.concatenate([sizes, decided.sizes[unknown]])
        numbers = np.concatenate([numbers, np.array([number_of[word] for word in why], np.int64)])
    some = np.flatnonzero(sizes > 0)
    some = some[np.argsort(starts[some], kind="stable")]
    starts, sizes, numbers = starts[some], sizes[some], numbers[some]
    if len(starts) > 1:
        goes_on = (
            (starts[1:] == starts[:-1] + sizes[:-1]) & (numbers[1:] == numbers[:-1]) & (numbers[1:] < whole)
        )
        first = np.flatnonzero(np.append(True, ~goes_on))
        sizes = np.add.reduceat(sizes, first)
        starts, numbers = starts[first], numbers[first]
    return LossRuns(starts, sizes, numbers, reasons)
