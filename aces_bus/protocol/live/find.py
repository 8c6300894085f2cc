"""Finds whole packets in a large chunk at once, with NumPy.

1. `PacketFinder` gives exactly the candidates that are whole (and whose check holds, where running sums say so), in order;
   which are accepted, and what becomes of the bytes between, is decided by the scanner.
2. It looks only where everything is decidable: before the first candidate that is still incomplete.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..declare.checks import Check, Sum
from ..declare.framing import Framing

Array = npt.NDArray[Any]


def number_at(data: Array, at: Array, size: int, order: str) -> Array:
    """Return the unsigned numbers of `size` bytes at `at`, as int64 (uint64 of 8 bytes)."""
    if size == 1:
        return data.take(at)
    number = np.zeros(len(at), np.int64 if size < 8 else np.uint64)
    for index in range(size):
        shift = 8 * (index if order == "little" else size - 1 - index)
        number |= data.take(at + index).astype(number.dtype) << number.dtype.type(shift)
    return number


class PacketHeaders:
    """Where packets of a framing may begin, and what their headers say of their sizes; for framings with sync bytes whose
    size is fixed or in a header field."""

    def __init__(self, framing: Framing) -> None:
        self.framing = framing
        #: How many bytes tell whether a header is one, and how long its packet.
        self.reach = len(framing.sync) + (1 if framing.not_next else 0)
        affine = framing.affine
        self._table: Array | None = None
        if affine is not None:
            self.reach = max(self.reach, affine.length.offset + affine.length.size)
            if affine.length.size == 1:
                self._table = np.arange(256) * affine.factor + affine.constant

    def headers(self, data: Array, last: int) -> Array:
        """Return where a packet may begin, before `last`."""
        sync = self.framing.sync
        hits = data[:last] == sync[0]
        for offset in range(1, len(sync)):
            hits &= data[offset : last + offset] == sync[offset]
        for byte in self.framing.not_next:
            hits &= data[len(sync) : last + len(sync)] != byte
        return np.flatnonzero(hits)

    def sizes(self, data: Array, starts: Array) -> Array:
        """Return the sizes of the packets that begin at `starts`, int64."""
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


class PacketFinder(PacketHeaders):
    """The whole packets of one framing."""

    def __init__(self, framing: Framing, cover: int | None) -> None:
        super().__init__(framing)
        check = framing.check
        #: Where the covered bytes start, when running sums answer the check; None: candidates come unchecked.
        self.cover = cover if check is not None and check.kind != "crc" else None
        #: The running sums of the last `find`, and how many bytes they cover.
        self.sums: tuple[Any, Any] = ((), ())
        self.summed = 0

    def find(self, buffer: bytes) -> tuple[list[int], list[int], int]:
        """Return (starts, ends, stop): whole packets that start before `stop`, where an incomplete one begins."""
        framing = self.framing
        self.summed = 0
        data = np.frombuffer(buffer, dtype=np.uint8)
        last = len(data) - self.reach
        if last <= 0:
            return [], [], 0
        starts = self.headers(data, last)
        sizes = self.sizes(data, starts)
        ends = starts + sizes
        possible = (sizes >= framing.min_size) & (sizes <= framing.max_size)
        if not possible.all():
            starts, ends = starts[possible], ends[possible]
        cut = np.flatnonzero(ends > len(data))
        stop = last
        if len(cut):
            # Starts rise: what is before the first incomplete one is decided.
            stop = int(starts[cut[0]])
            starts, ends = starts[: cut[0]], ends[: cut[0]]
        if framing.check is not None and self.cover is not None and len(starts):
            data = data[: int(ends.max())]
            good = self._checked(data, framing.check, starts + self.cover, ends - framing.check_size)
            starts, ends = starts[good], ends[good]
        return starts.tolist(), ends.tolist(), stop

    def _checked(self, data: Any, check: Check, starts: Any, ends: Any) -> Any:
        """Return whether the number at `ends` is that of the bytes before it, from running sums."""
        self.summed = len(data)
        if check.kind == "xor":
            running = _before(np.bitwise_xor, data, np.uint8)
            self.sums = running, ()
            return (running[ends] ^ running[starts]) == data[ends]
        sums = _before(np.add, data, np.int64)
        self.sums = sums, ()
        total = sums[ends] - sums[starts]
        if isinstance(check, Sum):
            number = check.signed(total)
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
        for index in range(check.bytes):
            place = index if check.order == "little" else check.bytes - 1 - index
            stored |= data[ends + index].astype(np.int64) << 8 * place
        return number == stored


def _before(fold: Any, data: Any, kind: Any) -> Any:
    """Return the running value before each position, and after the last."""
    running = np.empty(len(data) + 1, dtype=kind)
    running[0] = 0
    fold.accumulate(data, dtype=kind, out=running[1:])
    return running
