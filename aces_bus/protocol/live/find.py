"""Finds whole packets in a large chunk at once, with NumPy.

1. `PacketFinder` gives candidates that are whole (and whose check holds, where running sums say so), in order: all of them,
   but where fields say the size those inside another. Which are accepted, and what becomes of the bytes between, is decided
   by the scanner.
2. It looks only where everything is decidable: before the first candidate that is still incomplete.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from ..declare.checks import Check, Sum
from ..declare.framing import BitSize, FieldSize, Framing

Array = npt.NDArray[Any]


def number_at(data: Array, at: Array, size: int, order: str) -> Array:
    """Return the unsigned numbers of `size` bytes at `at`, as int64 (uint64 of 8 bytes, uint8 of one); what reaches behind
    the data is any.
    """
    if size == 1:
        return data.take(at, mode="clip")
    number = np.zeros(len(at), np.int64 if size < 8 else np.uint64)
    for index in range(size):
        shift = 8 * (index if order == "little" else size - 1 - index)
        number |= data.take(at + index, mode="clip").astype(number.dtype) << number.dtype.type(shift)
    return number


class PacketHeaders:
    """Where packets of a framing may begin, and what their headers say of their sizes; for framings with sync bytes whose
    size is fixed, in a header field or in bits of the header."""

    def __init__(self, framing: Framing) -> None:
        self.framing = framing
        #: How many bytes tell whether a header is one, and how long its packet.
        self.reach = len(framing.sync) + (1 if framing.not_next else 0)
        affine, measure = framing.affine, framing.measure
        #: What header bytes add to the size, by their offset.
        self._tables: list[tuple[int, Array]] = []
        if affine is not None:
            self.reach = max(self.reach, affine.length.offset + affine.length.size)
            if affine.length.size == 1:
                self._tables = [(affine.length.offset, np.arange(256) * affine.factor + affine.constant)]
        elif isinstance(measure, BitSize):
            self.reach = max(self.reach, measure.reach)
            self._tables = [(offset, np.array(table, np.int64)) for offset, table in measure.tables]
            self._tables[0] = self._tables[0][0], self._tables[0][1] + measure.constant

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
        if self._tables:
            (offset, table), *more = self._tables
            number = table.take(data[offset:].take(starts))
            for offset, table in more:
                number = number + table.take(data[offset:].take(starts))
            return number
        if affine is None:
            return np.full(len(starts), self.framing.fixed_size, np.int64)
        head = affine.length
        number = number_at(data[head.offset :], starts, head.size, head.order).astype(np.int64)
        number *= affine.factor
        number += affine.constant
        return number


class PacketFinder(PacketHeaders):
    """The whole packets of one framing."""

    def __init__(
        self, framing: Framing, cover: int | None, measure: Callable[[bytes, int, int], int | None] | None
    ) -> None:
        super().__init__(framing)
        #: Where fields say the size: what measures a packet, see `measure_of`.
        self._measure = measure if isinstance(framing.measure, FieldSize) else None
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
        if self._measure is not None:
            starts, ends = self._measured(self._measure, buffer, starts)
        else:
            sizes = self.sizes(data, starts)
            ends = starts + sizes
            possible = (sizes >= framing.min_size) & (sizes <= framing.max_size)
            if framing.multiple > 1:
                possible &= sizes % framing.multiple == 0
            if not possible.all():
                starts, ends = starts[possible], ends[possible]
        cut = np.flatnonzero(ends > len(data))
        stop = last
        if len(cut):
            # Starts rise: what is before the first incomplete one is decided.
            stop = int(starts[cut[0]])
            starts, ends = starts[: cut[0]], ends[: cut[0]]
        if framing.check is not None and self.cover is not None and len(starts):
            if self._measure is None:
                data = data[
                    : int(ends.max())
                ]  # else candidates inside a failed one may end behind all of these
            good = self._checked(data, framing.check, starts + self.cover, ends - framing.check_size)
            starts, ends = starts[good], ends[good]
        return starts.tolist(), ends.tolist(), stop

    def _measured(
        self, measure: Callable[[bytes, int, int], int | None], buffer: bytes, headers: Array
    ) -> tuple[Array, Array]:
        """Return (starts, ends) of packets whose fields say their size, where that is possible. A packet that does not say
        it yet ends behind the buffer; inside a packet none is looked for.
        """
        least, most, end = self.framing.min_size, self.framing.max_size, len(buffer)
        starts: list[int] = []
        ends: list[int] = []
        at = 0
        for start in headers.tolist():
            if start >= at:
                size = measure(buffer, start, end) or end - start + 1
                if least <= size <= most:
                    at = start + size
                    starts.append(start)
                    ends.append(at)
        return np.array(starts, np.int64), np.array(ends, np.int64)

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
