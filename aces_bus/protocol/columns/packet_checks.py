"""The checks of many packets at once: whether the number that stands in each is that of its bytes.

1. A packet passes exactly when `Framing.judge` says so.
2. Sums, xor and Fletcher pairs come from running sums of the buffer, each byte read once; CRCs from `crc_columns`.

Running sums wrap at the size of the check: differences are right all the same. A pair (a, b) of a run of n bytes that
stands behind another is (a₀ + a, b₀ + n·a₀ + b).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ..declare.checks import Check, Crc, Extra, Fletcher, Sum, Xor, xor_of
from ..declare.framing import Framing
from ..declare.head import Head
from .crc import CrcColumns, done_alone
from .packet_rows import packet_rows

Array = npt.NDArray[Any]

#: What is wrong with a candidate: its check, its length, or (from here up) that no message has its number.
GOOD, CHECKSUM, LENGTH, NO_MESSAGE = 0, 1, 2, 3

#: Packets up to this size are checked in rows.
NARROW = 64
#: Every other byte of a word; and what adds up its four 16-bit numbers in the topmost.
_PAIRS, _GATHER = np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0001000100010001)


def reason_of(code: int) -> str:
    """The reason in words, as all scanners give it."""
    if code == LENGTH:
        return "malformed: length"
    if code == CHECKSUM:
        return "malformed: checksum"
    return f"malformed: no message {code - NO_MESSAGE} to check by"


def number_at(data: Array, at: Array, size: int, order: str) -> Array:
    """The unsigned numbers of `size` bytes that stand at `at`, as int64 (uint64 of 8 bytes)."""
    if size == 1:
        return data.take(at)
    number = np.zeros(len(at), np.int64 if size < 8 else np.uint64)
    for index in range(size):
        shift = 8 * (index if order == "little" else size - 1 - index)
        number |= data.take(at + index).astype(number.dtype) << number.dtype.type(shift)
    return number


class CheckColumns:
    """The check of one framing; `why_not` says for which framings there is none."""

    def __init__(self, framing: Framing, extras: Mapping[int, bytes] | None) -> None:
        assert framing.check is not None
        self.check: Check = framing.check
        self.sync = len(framing.sync)
        self._head: Head | None = None
        self._parts: list[slice | bytes | None] = []
        for part in (slice(self.sync, -self.check.size),) if self.check.over is None else self.check.over:
            assert isinstance(part, (slice, bytes, Extra))
            self._parts.append(None if isinstance(part, Extra) else part)
        if extras is not None:
            # The numbers of messages, rising, and their bytes beside them.
            self._head = framing.extra_head
            self._numbers = np.array(sorted(extras), np.int64)
            width = max(map(len, extras.values()), default=0)
            self._rows = np.array([list(extras[n]) for n in sorted(extras)], np.uint8).reshape(-1, width)
        self._crc = CrcColumns(self.check) if isinstance(self.check, Crc) else None
        self._scratch: dict[str, Array] = {}
        self._folded = self._foldable(framing)

    @staticmethod
    def why_not(framing: Framing, extras: Mapping[int, bytes] | None) -> str:
        """Why a framing's check cannot be had in columns; empty when it can."""
        check = framing.check
        if check is None:
            return ""
        if check.text is not None or check.field is not None or check.bytes > 8:
            return "the check is not a number of at most 8 bytes"
        if any(not isinstance(part, (slice, bytes, Extra)) for part in check.over or ()):
            return "the check covers what is not in the packet"
        if type(check) not in (Sum, Xor, Fletcher, Crc) or (
            isinstance(check, Crc) and not CrcColumns.can(check)
        ):
            return "the check is a function of its own"
        if extras is not None and framing.extra_head is None:
            return "nothing in the packet says which extra bytes its check has"
        if extras is not None and len({len(extra) for extra in extras.values()}) > 1:
            return "the check's extra bytes are of several lengths"
        if extras is not None and framing.extra_head is not None and framing.extra_head.size > 4:
            return "the number of the message is wider than 4 bytes"
        return ""

    def judge(
        self, buffer: bytes, starts: Array, sizes: Array
    ) -> tuple[Array | None, Array | None, Array | None]:
        """(which packets pass, None: all; the codes of those that do not; the packets' rows where they were made)."""
        width = self._narrow(sizes) if self._folded is not None else 0
        if not width:
            codes = self._codes(np.frombuffer(buffer, np.uint8), starts, starts + sizes)
            good = codes == GOOD
            return (None, None, None) if good.all() else (good, codes[~good], None)
        long = np.flatnonzero(sizes > width) if int(sizes.max()) > width else None
        some = np.minimum(sizes, width) if long is not None else sizes
        rows: Array | None = packet_rows(buffer, starts, some, width)
        assert rows is not None
        good = self._folds(rows, buffer, starts, some)
        for index in long.tolist() if long is not None else ():
            start, end = int(starts[index]), int(starts[index] + sizes[index])
            packet = buffer[start:end]
            covered = self.check.covered(packet, self.sync, len(packet) - 1)
            good[index] = self.check.compute(covered) == packet[-1]
            if good[index]:
                rows = None
        if good.all():
            return None, None, rows
        return good, np.full(len(good) - int(np.count_nonzero(good)), CHECKSUM), rows

    @staticmethod
    def _narrow(sizes: Array) -> int:
        """The width of rows into which nearly all packets fit without much air; 0: there is none."""
        most = int(sizes.sum()) * 3
        for width in range(8, NARROW + 1, 8):
            if len(sizes) * width > most:
                return 0
            if int(np.count_nonzero(sizes > width)) <= 16 + len(sizes) // 512:
                return width
        return 0

    def _codes(self, data: Array, starts: Array, ends: Array) -> Array:
        codes = np.zeros(len(starts), np.int64)
        extras: Array | None = None
        known: Array | None = None
        if self._head is not None:
            numbers = number_at(data, starts + self._head.offset, self._head.size, self._head.order)
            numbers = numbers.astype(np.int64)
            at = np.minimum(np.searchsorted(self._numbers, numbers), len(self._numbers) - 1)
            is_known = self._numbers.take(at) == numbers
            if not is_known.all():
                codes[~is_known] = NO_MESSAGE + numbers[~is_known]
                known = np.flatnonzero(is_known)
                starts, ends, at = starts[known], ends[known], at[known]
            extras = self._rows[at]
        elif any(part is None for part in self._parts):
            extras = np.zeros((len(starts), 0), np.uint8)
        if self._crc is not None:
            wanted = self._crcs(data, starts, ends, extras)
        else:
            wanted = self._sums(data, starts, ends, extras)
        stored = number_at(data, ends - self.check.size, self.check.bytes, self.check.order)
        bad = wanted != stored.astype(wanted.dtype)
        codes[bad if known is None else known[bad]] = CHECKSUM
        return codes

    # ------------------------------------------------------------------ a byte at the end, over short packets

    def _foldable(self, framing: Framing) -> int | None:
        """The fold of the sync bytes that are not covered, where the check is one byte over all the rest."""
        check, part = self.check, self._parts[0]
        if check.kind not in ("sum", "xor") or check.bytes != 1 or len(self._parts) > 1:
            return None
        if not isinstance(part, slice) or part.stop != -1 or not 0 <= (part.start or 0) <= self.sync:
            return None
        outside = framing.sync[: part.start or 0]
        return xor_of(outside) if check.kind == "xor" else sum(outside) & 0xFF

    def _folds(self, rows: Array, buffer: bytes, starts: Array, sizes: Array) -> Array:
        """Which packets pass: all bytes of each are folded at once, the check's own too, eight at a time."""
        words = rows.view(np.uint64)
        if self.check.kind == "xor":
            folded = np.bitwise_xor.reduce(words, axis=1) if words.shape[1] > 1 else words[:, 0].copy()
            for shift in (32, 16, 8):
                folded ^= folded >> np.uint64(shift)
            passed: Array = folded.astype(np.uint8) == self._folded
            return passed
        total: Array | None = None
        for index in range(words.shape[1]):
            word = words[:, index]
            pairs = word >> np.uint64(8)
            pairs &= _PAIRS
            pairs += word & _PAIRS
            if total is None:
                total = pairs
            else:
                total += pairs
        assert total is not None
        total *= _GATHER
        total >>= np.uint64(48)
        number = total.astype(np.uint8)
        assert isinstance(self.check, Sum)
        assert self._folded is not None
        if self.check.inverted:
            # What is covered and what is stored give 255.
            passed = number == np.uint8((0xFF + self._folded) & 0xFF)
            return passed
        stored = np.frombuffer(buffer, np.uint8).take(starts + sizes - 1)
        passed = number - stored - np.uint8(self._folded) == stored
        return passed

    @staticmethod
    def _span(part: slice, starts: Array, ends: Array) -> tuple[Array, Array]:
        """Where a part of each packet starts and ends in the buffer, as slicing the packet would cut it."""
        low = starts if part.start is None else (starts if part.start >= 0 else ends) + part.start
        high = ends if part.stop is None else (starts if part.stop >= 0 else ends) + part.stop
        low = np.minimum(np.maximum(low, starts), ends)
        return low, np.maximum(np.minimum(high, ends), low)

    # ------------------------------------------------------------------ CRCs

    def _crcs(self, data: Array, starts: Array, ends: Array, extras: Array | None) -> Array:
        crc = self._crc
        assert crc is not None
        out = np.zeros(len(starts), crc.dtype)
        alone = done_alone(ends - starts)
        rest = np.ones(len(starts), bool)
        rest[alone] = False
        for index in alone.tolist():
            packet = data[starts[index] : ends[index]].tobytes()
            extra = extras[index].tobytes() if extras is not None else b""
            covered = self.check.covered(packet, self.sync, len(packet) - self.check.size, extra=extra)
            out[index] = self.check.compute(covered)
        if len(alone) == len(starts):
            return out
        if len(alone):
            starts, ends = starts[rest], ends[rest]
            extras = extras[rest] if extras is not None else None
        register = crc.begin(len(starts))
        source = crc.words(data)
        for part in self._parts:
            if isinstance(part, slice):
                low, high = self._span(part, starts, ends)
                register = crc.run(register, source, low, high - low)
            elif isinstance(part, bytes):
                register = crc.over(register, np.frombuffer(part, np.uint8).reshape(1, -1))
            elif extras is not None:
                register = crc.over(register, extras)
        out[rest] = crc.end(register)
        return out

    # ------------------------------------------------------------------ sums

    def _sums(self, data: Array, starts: Array, ends: Array, extras: Array | None) -> Array:
        check = self.check
        size = 1 if check.kind in ("xor", "fletcher") else check.bytes
        kind = np.dtype(f"u{1 if size == 1 else 2 if size == 2 else 4 if size <= 4 else 8}")
        fold: Any = np.bitwise_xor if check.kind == "xor" else np.add
        first = self._running("first", fold, data, kind)
        second = self._running("second", fold, first[1:], kind) if check.kind == "fletcher" else None
        one: Array = np.zeros(len(starts), kind)
        other: Array = np.zeros(len(starts), kind)
        for part in self._parts:
            if isinstance(part, slice):
                low, high = self._span(part, starts, ends)
                before = first.take(low)
                if check.kind == "xor":
                    one = one ^ first.take(high) ^ before
                    continue
                if second is not None:
                    count = (high - low).astype(kind)
                    other = other + count * one + second.take(high) - second.take(low) - count * before
                one = one + first.take(high) - before
                continue
            rows = np.frombuffer(part, np.uint8).reshape(1, -1) if part is not None else extras
            if rows is None:
                continue
            for column in range(rows.shape[1]):
                one = fold(one, rows[:, column].astype(kind))
                if second is not None:
                    other = other + one
        if second is not None:
            return one.astype(np.uint16) | other.astype(np.uint16) << np.uint16(8)
        if isinstance(check, Sum):
            if check.inverted:
                one = ~one
            if kind.itemsize != size:
                one = one & kind.type(check.mask)
        return one

    def _running(self, name: str, fold: Any, data: Array, kind: Any) -> Array:
        """The running value before each position, and after the last, in memory that is used again."""
        scratch = self._scratch.get(name)
        if scratch is None or len(scratch) <= len(data):
            scratch = self._scratch[name] = np.zeros(len(data) + 1 + len(data) // 8, kind)
        fold.accumulate(data, dtype=kind, out=scratch[1 : len(data) + 1])
        return scratch[: len(data) + 1]


__all__ = ["CHECKSUM", "GOOD", "LENGTH", "NO_MESSAGE", "CheckColumns", "number_at", "reason_of"]
