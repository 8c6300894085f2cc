"""Finds whole packets in a large chunk at once, with NumPy.

1. `Finder` proposes, the rule disposes: what it gives are exactly the candidates that are whole (and whose check holds,
   where running sums tell), in order; which are accepted, and what becomes of the bytes between, is decided as ever.
2. It looks only where everything is decidable: before the first candidate that is still incomplete.
3. `Survey` decides: it gives the packets that the rule accepts, and what each byte between them is lost as.

What a byte that no packet claims is lost as depends on what follows it alone: a header whose length or check fails is
malformed, everything else skipped. So nothing has to be read in turn, but where candidates overlap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..columns.packet_checks import LENGTH, CheckColumns, number_at
from ..columns.packet_rows import take_rows
from ..declare.checks import Check, Sum
from ..declare.framing import Framing

Array = npt.NDArray[Any]


class PacketFinder:
    """The whole packets of one framing; for framings with sync bytes whose size is fixed or in a header field."""

    def __init__(self, framing: Framing, cover: int | None) -> None:
        self.framing = framing
        check = framing.check
        #: Where the covered bytes start, when running sums answer the check; None: candidates come unchecked.
        self.cover = cover if check is not None and check.kind != "crc" else None
        #: The running sums of the last `find`, and how many bytes they cover.
        self.sums: tuple[Any, Any] = ((), ())
        self.summed = 0

    def find(self, buffer: bytes) -> tuple[list[int], list[int], int]:
        """(starts, ends, stop): whole packets that start before `stop`, where something is incomplete."""
        framing = self.framing
        self.summed = 0
        data = np.frombuffer(buffer, dtype=np.uint8)
        sync = framing.sync
        reach = len(sync) + (1 if framing.not_next else 0)
        if framing.affine is not None:
            reach = max(reach, framing.affine.length.offset + framing.affine.length.size)
        last = len(data) - reach
        if last <= 0:
            return [], [], 0
        hits = data[:last] == sync[0]
        for offset in range(1, len(sync)):
            hits &= data[offset : last + offset] == sync[offset]
        for byte in framing.not_next:
            hits &= data[len(sync) : last + len(sync)] != byte
        starts = np.flatnonzero(hits)
        ends = starts + self._sizes(data, starts)
        sizes = ends - starts
        possible = (sizes >= framing.min_size) & (sizes <= framing.max_size)
        if not possible.all():
            starts, ends = starts[possible], ends[possible]
        cut = np.flatnonzero(ends > len(data))
        stop = last
        if len(cut):
            # Starts rise: what stands before the first incomplete one is decided.
            stop = int(starts[cut[0]])
            starts, ends = starts[: cut[0]], ends[: cut[0]]
        if framing.check is not None and self.cover is not None and len(starts):
            data = data[: int(ends.max())]
            good = self._checked(data, framing.check, starts + self.cover, ends - framing.check_size)
            starts, ends = starts[good], ends[good]
        return starts.tolist(), ends.tolist(), stop

    def _sizes(self, data: Any, starts: Any) -> Any:
        affine = self.framing.affine
        if affine is None:
            return self.framing.fixed_size
        head = affine.length
        if head.size == 1:
            return data[starts + head.offset] * np.int64(affine.factor) + affine.constant
        number = np.zeros(len(starts), dtype=np.int64)
        for index in range(head.size):
            shift = 8 * (index if head.order == "little" else head.size - 1 - index)
            number |= data[starts + head.offset + index].astype(np.int64) << shift
        return number * affine.factor + affine.constant

    def _checked(self, data: Any, check: Check, starts: Any, ends: Any) -> Any:
        """Whether the number that stands at `ends` is that of the bytes before it, from running sums."""
        self.summed = len(data)
        if check.kind == "xor":
            running = _before(np.bitwise_xor, data, np.uint8)
            self.sums = running, ()
            return (running[ends] ^ running[starts]) == data[ends]
        sums = _before(np.add, data, np.int64)
        self.sums = sums, ()
        total = sums[ends] - sums[starts]
        if isinstance(check, Sum):
            number = ~total if check.inverted else total
            if check.bytes < 8:
                number = number & check.mask
        else:
            double = _before(np.add, sums[1:], np.int64)
            self.sums = sums, double
            second = double[ends] - double[starts] - (ends - starts) * sums[starts]
            number = total & 0xFF | (second & 0xFF) << 8
        if check.bytes == 1:
            return number == data[ends]
        stored = np.zeros(len(ends), dtype=np.int64)
        good = np.ones(len(ends), bool)
        for index in range(check.bytes):
            place = index if check.order == "little" else check.bytes - 1 - index
            if place < 8:
                stored |= data[ends + index].astype(np.int64) << 8 * place
            else:  # a sum of a chunk's bytes does not reach these
                good &= data[ends + index] == (0xFF if isinstance(check, Sum) and check.inverted else 0)
        return good & (number == stored)


def _before(fold: Any, data: Any, kind: Any) -> Any:
    """The running value before each position, and after the last."""
    running = np.empty(len(data) + 1, dtype=kind)
    running[0] = 0
    fold.accumulate(data, dtype=kind, out=running[1:])
    return running


@dataclass(frozen=True)
class Decided:
    """What a buffer is, up to `stop`; arrays are int64, positions in the buffer, rising.

    Packets stand at `starts` and have `sizes` bytes; `rows`, where they had to be made, are `rows_of` them. At `bad` stand
    headers that are lost, each one byte, for the reason in `codes` (of `packet_checks`); `bad_ends` is how far one had to
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
        """Where the packets end."""
        return self.starts + self.sizes


_NONE = np.zeros(0, np.int64)


class Survey:
    """Decides whole buffers of one framing alone on its wire; `why_not` says for which framings it can."""

    def __init__(self, framing: Framing, extras: Mapping[int, bytes] | None) -> None:
        self.framing = framing
        self._check = CheckColumns(framing, extras) if framing.check is not None else None
        #: How many bytes tell whether a header is one, and how long its packet.
        self._reach = len(framing.sync) + (1 if framing.not_next else 0)
        affine = framing.affine
        self._table: Array | None = None
        if affine is not None:
            self._reach = max(self._reach, affine.length.offset + affine.length.size)
            if affine.length.size == 1:
                self._table = np.arange(256) * affine.factor + affine.constant

    @staticmethod
    def why_not(framing: Framing, extras: Mapping[int, bytes] | None) -> str:
        """Why a framing cannot be surveyed; empty when it can."""
        if not framing.sync:
            return "no sync bytes"
        if framing.affine is None and framing.fixed_size is None:
            return "packets do not say their size"
        if framing.affine is not None and framing.affine.length.size > 4:
            return "the length is wider than 4 bytes"
        if framing.stuffing is not None:
            return "stuffed"
        return CheckColumns.why_not(framing, extras)

    def decide(self, buffer: bytes, size: int) -> Decided:
        """What everything in the first `size` bytes is that can be told before more come; what stands behind is air."""
        framing = self.framing
        data = np.frombuffer(buffer, np.uint8, size)
        stop = max(len(data) - self._reach + 1, 0)
        starts = self._headers(data, stop)
        if not len(starts):
            return Decided(starts, starts, _NONE, _NONE, _NONE, stop)
        sizes = self._sizes(data, starts)
        bad: list[tuple[Array, Array, Array]] = []
        if int(sizes.min()) < framing.min_size or int(sizes.max()) > framing.max_size:
            wrong = (sizes < framing.min_size) | (sizes > framing.max_size)
            lost = starts[wrong]
            bad.append((lost, lost + self._reach, np.full(len(lost), LENGTH)))
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
            chosen = _untangled(starts, ends, waits)
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

    def _headers(self, data: Array, last: int) -> Array:
        """Where a packet may begin, before `last`."""
        sync = self.framing.sync
        hits = data[:last] == sync[0]
        for offset in range(1, len(sync)):
            hits &= data[offset : last + offset] == sync[offset]
        for byte in self.framing.not_next:
            hits &= data[len(sync) : last + len(sync)] != byte
        return np.flatnonzero(hits)

    def _sizes(self, data: Array, starts: Array) -> Array:
        affine = self.framing.affine
        if affine is None:
            return np.full(len(starts), self.framing.fixed_size, np.int64)
        head = affine.length
        if self._table is not None:
            return self._table.take(data[head.offset :].take(starts))
        number = number_at(data[head.offset :], starts, head.size, head.order).astype(np.int64)
        number *= affine.factor
        number += affine.constant
        return number


def _untangled(starts: Array, ends: Array, waits: Array) -> Array:
    """The rule where candidates overlap: the lowest is accepted, what begins inside it is none. Which stay.

    What begins behind an incomplete candidate that nobody covers is not decided; it may stay, the caller leaves it out.
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
    """The failed candidates that stand before `stop` and in no packet: (where, how far to look, code), rising."""
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
