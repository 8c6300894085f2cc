"""What everything in a buffer is: its packets, and what each byte between them is lost as; many losses at once.

1. `Survey` decides: it gives the packets that the rule accepts.
2. Runs of losses are those of the live scanner: neighbouring bytes lost for one reason are one run, a whole packet is always
   its own. Bytes are copied when they are asked for.

What a byte that no packet claims is lost as depends on what follows it alone: a header whose length or check fails is
malformed, everything else skipped. So nothing has to be read in turn, but where candidates overlap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...frame_table import Channels, to_ns
from ..declare.framing import FieldSize, Framing
from ..live.find import PacketHeaders
from .checks import LENGTH, CheckColumns, reason_of
from .shaped import FieldPlaces
from .table import Array, MessageTable, lost_table, object_array, take_rows


@dataclass(frozen=True)
class Decided:
    """What a buffer is, up to `stop`; arrays are int64, positions in the buffer, rising.

    Packets begin at `starts` and have `sizes` bytes; `rows`, where they had to be made, are `rows_of` them. At `bad` stand
    headers that are lost, each one byte, for the reason in `codes` (of `checks`); `bad_ends` is how far one had to
    look to know. Every other byte is skipped.
    """

    starts: Array
    sizes: Array
    bad: Array
    bad_ends: Array
    codes: Array
    stop: int
    rows: Array | None = None

    @property
    def ends(self) -> Array:
        """Ends of the packets."""
        return self.starts + self.sizes


_NONE = np.zeros(0, np.int64)


class Survey(PacketHeaders):
    """Decides whole buffers of one framing alone on its wire; `why_not` says for which framings it can."""

    def __init__(self, framing: Framing, extras: Mapping[int, bytes] | None) -> None:
        super().__init__(framing)
        self._places: FieldPlaces | None = None
        if isinstance(framing.measure, FieldSize):
            assert framing.measure.shapes is not None
            self._places, self._behind = FieldPlaces(framing.measure.shapes), framing.measure.behind
            self.reach = max(self.reach, self._places.reach)
        self._check = CheckColumns(framing, extras) if framing.check is not None else None

    @staticmethod
    def why_not(framing: Framing, extras: Mapping[int, bytes] | None) -> str:
        """Say why a framing cannot be surveyed; empty when it can."""
        if not framing.sync:
            return "no sync bytes"
        if framing.end or framing.is_silent:
            return "packets do not say their size"
        if framing.affine is not None and framing.affine.length.size > 4:
            return "the length is wider than 4 bytes"
        if framing.stuffing is not None:
            return "stuffed"
        return CheckColumns.why_not(framing, extras)

    def _sizes(self, data: Array, starts: Array) -> tuple[Array, Array | int]:
        """Return sizes, and how many bytes of each packet say it: where there are less, the packet is not whole."""
        if self._places is None:
            return self.sizes(data, starts), self.reach
        _, end, known = self._places.of(data, starts)
        size = np.broadcast_to(end + self._behind, len(starts))
        left = len(data) - starts
        return np.where((known > left) & (left < self.framing.max_size), self.framing.max_size, size), known

    def decide(self, buffer: bytes, size: int) -> Decided:
        """Return what everything in the first `size` bytes is that can be decided before more come; behind are only
        zeros.
        """
        framing = self.framing
        data = np.frombuffer(buffer, np.uint8, size)
        stop = max(len(data) - self.reach + 1, 0)
        starts = self.headers(data, stop)
        if not len(starts):
            return Decided(starts, starts, _NONE, _NONE, _NONE, stop)
        sizes, reach = self._sizes(data, starts)
        bad: list[tuple[Array, Array, Array]] = []
        step = framing.multiple
        if (
            int(sizes.min()) < framing.min_size
            or int(sizes.max()) > framing.max_size
            or (step > 1 and (sizes % step).any())
        ):
            wrong = (sizes < framing.min_size) | (sizes > framing.max_size) | (sizes % step > 0)
            lost = starts[wrong]
            looked = reach[wrong] if isinstance(reach, np.ndarray) else reach
            bad.append((lost, lost + looked, np.full(len(lost), LENGTH)))
            starts, sizes = starts[~wrong], sizes[~wrong]
        # Only the last ones can be incomplete.
        tail = int(np.searchsorted(starts, len(data) - framing.max_size))
        open_ = starts[tail:] + sizes[tail:] > len(data)
        waits = starts[tail:][open_]
        if len(waits):
            first = tail + int(np.argmax(open_))
            if len(waits) == len(starts) - first:
                starts, sizes = starts[:first], sizes[:first]
            else:
                starts = np.append(starts[:tail], starts[tail:][~open_])
                sizes = np.append(sizes[:tail], sizes[tail:][~open_])
        rows: Array | None = None
        if self._check is not None and len(starts):
            good, codes, rows = self._check.judge(buffer, starts, sizes)
            if good is not None and codes is not None:
                failed, chosen = np.flatnonzero(~good), np.flatnonzero(good)
                lost = starts.take(failed)
                bad.append((lost, lost + sizes.take(failed), codes))
                starts, sizes = starts.take(chosen), sizes.take(chosen)
                rows = take_rows(rows, chosen) if rows is not None else None
        ends = starts + sizes
        if (starts[1:] < ends[:-1]).any():
            chosen = _untangled(starts, ends)
            starts, sizes, ends = starts[chosen], sizes[chosen], ends[chosen]
            rows = take_rows(rows, chosen) if rows is not None else None
        for wait in waits.tolist():
            before = int(np.searchsorted(starts, wait))
            if not before or int(ends[before - 1]) <= wait:
                stop = wait
                starts, sizes, ends = starts[:before], sizes[:before], ends[:before]
                rows = rows[:before] if rows is not None else None
                break
        if len(ends):
            stop = max(stop, int(ends[-1]))
        return Decided(starts, sizes, *_outside(bad, starts, ends, stop), stop, rows)


def _untangled(starts: Array, ends: Array) -> Array:
    """Return the rule where candidates overlap: the lowest is accepted, what begins inside it is none. Which stay.

    What begins behind an incomplete candidate that no packet covers is not decided; it may stay, the caller leaves it out.
    """
    clash = starts[1:] < np.maximum.accumulate(ends)[:-1]
    stay = np.ones(len(starts), bool)
    stay[1:] &= ~clash
    stay[:-1] &= ~clash
    # Only those that overlap are taken in turn.
    doubtful = np.flatnonzero(~stay)
    reached = -1
    pairs = zip(starts[doubtful].tolist(), ends[doubtful].tolist(), strict=True)
    for index, (start, end) in zip(doubtful.tolist(), pairs, strict=True):
        if start >= reached:
            stay[index] = True
            reached = end
    return np.flatnonzero(stay)


def _outside(
    bad: Sequence[tuple[Array, Array, Array]], starts: Array, ends: Array, stop: int
) -> tuple[Array, Array, Array]:
    """Return the failed candidates that stand before `stop` and in no packet: (where, how far to look, code), rising."""
    if not bad:
        return _NONE, _NONE, _NONE
    at, end, code = bad[0] if len(bad) == 1 else (np.concatenate(some) for some in zip(*bad, strict=True))
    keep = at < stop
    if len(starts):
        before = np.searchsorted(starts, at, "right") - 1
        keep &= (before < 0) | (at >= ends[before])
    chosen = np.flatnonzero(keep)
    if len(bad) > 1:
        chosen = chosen[np.argsort(at[chosen])]
    return at[chosen], end[chosen], code[chosen]


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
        """Return lost bytes by reason."""
        totals = (
            np.bincount(self.numbers[some], self.sizes[some], len(self.reasons)).astype(np.int64).tolist()
        )
        return {reason: total for reason, total in zip(self.reasons, totals, strict=True) if total}

    def item(self, index: int, base: int, buffer: bytes) -> tuple[int, int, str, bytes]:
        """Return a run: offset in the stream, size, reason, bytes."""
        start, size = int(self.starts[index]), int(self.sizes[index])
        return base + start, size, self.reasons[int(self.numbers[index])], buffer[start : start + size]

    def table(
        self, some: slice, base: int, buffer: bytes, time: float | None, channels: Channels
    ) -> MessageTable:
        """Return some of the runs as the table that `lost_table` makes."""
        starts, sizes, numbers = self.starts[some], self.sizes[some], self.numbers[some]

        def raw() -> Array:
            pairs = zip(starts.tolist(), sizes.tolist(), strict=True)
            return object_array([buffer[start : start + size] for start, size in pairs])

        n = len(starts)
        keys = starts + base
        return lost_table(
            object_array(self.reasons)[numbers],
            raw,
            is_stream=True,
            time=np.full(n, to_ns(time), np.int64),
            channel=np.full(n, channels.number(None), np.uint16),
            channels=channels,
            key=keys,
            row=keys,
            rx=np.full(n, 2, np.uint8),
            size=sizes,
        )


def totals_of(decided: Decided, unknown: Array, why: Sequence[str]) -> dict[str, int]:
    """Return how many bytes were lost, by reason."""
    lost = len(decided.bad)
    totals = {"skipped": decided.stop - int(decided.sizes.sum()) - lost}
    if lost:
        codes, numbers = np.unique(decided.codes, return_counts=True)
        totals.update((reason_of(code), n) for code, n in zip(codes.tolist(), numbers.tolist(), strict=True))
    for reason, size in zip(why, decided.sizes[unknown].tolist(), strict=True):
        totals[reason] = totals.get(reason, 0) + size
    return {reason: total for reason, total in totals.items() if total}


def losses_of(decided: Decided, unknown: Array, why: Sequence[str]) -> LossRuns:
    """Return the runs between the packets, and the packets `unknown` without a message, each with its reason."""
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
