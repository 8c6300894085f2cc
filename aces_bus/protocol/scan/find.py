"""Finds whole packets in a large chunk at once, with NumPy.

1. It proposes, the rule disposes: what it gives are exactly the candidates that are whole (and whose check holds, where
   running sums tell), in order; which are accepted, and what becomes of the bytes between, is decided as ever.
2. It looks only where everything is decidable: before the first candidate that is still incomplete.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..spec.checks import Check, Sum
from ..spec.framing import Framing


class Finder:
    """The whole packets of one framing; for framings with sync bytes whose size is fixed or in a header field."""

    def __init__(self, framing: Framing, cover: int | None) -> None:
        self.framing = framing
        check = framing.check
        #: Where the covered bytes start, when running sums answer the check; None: candidates come unchecked.
        self.cover = cover if check is not None and check.kind != "crc" and check.bytes <= 4 else None
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
            number = (~total if check.inverted else total) & check.mask
        else:
            double = _before(np.add, sums[1:], np.int64)
            self.sums = sums, double
            second = double[ends] - double[starts] - (ends - starts) * sums[starts]
            number = total & 0xFF | (second & 0xFF) << 8
        if check.bytes == 1:
            return number == data[ends]
        stored = np.zeros(len(ends), dtype=np.int64)
        for index in range(check.bytes):
            shift = 8 * (index if check.order == "little" else check.bytes - 1 - index)
            stored |= data[ends + index].astype(np.int64) << shift
        return number == stored


def _before(fold: Any, data: Any, kind: Any) -> Any:
    """The running value before each position, and after the last."""
    running = np.empty(len(data) + 1, dtype=kind)
    running[0] = 0
    fold.accumulate(data, dtype=kind, out=running[1:])
    return running
