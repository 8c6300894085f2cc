"""The checks of many packets at once: whether the number in each is that of its bytes.

1. A packet passes exactly when `Framing.judge` says so; a message's own check (`check_holds`) when construct does.
2. Sums, xor and Fletcher pairs come from running sums of the buffer, each byte read once; CRCs from `CrcColumns`, which
   gives what `Crc.compute` gives for every CRC of at most 64 bits.
3. Time is bounded by the bytes covered; memory of CRCs by the number of packets.

Running sums wrap at the size of the check: differences are right all the same. A pair (a, b) of a run of n bytes that
follows another is (a₀ + a, b₀ + n·a₀ + b).

The register of a CRC is kept reflected (lowest bit first), whatever the CRC: where bytes go in highest bit first, they are
turned round before, and the result at the end. Then one step is `T[(register ^ word) & 0xFFFF] ^ register >> 16`, with a
table of what sixteen bits of the register become: two bytes a step, all packets at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from ..declare.checks import Check, Crc, DataIds, Extra, Fletcher, IdBytes, Sum, Xor, xor_of
from ..declare.framing import Framing
from ..declare.head import Head
from ..declare.message import Message
from ..live.find import number_at
from .table import Array, packet_rows

#: What is wrong with a candidate: its check, its length, or (from here up) that no message has its number.
GOOD, CHECKSUM, LENGTH, NO_MESSAGE = 0, 1, 2, 3

#: Packets up to this size are checked in rows.
NARROW = 64
#: Every other byte of a word; and what adds up its four 16-bit numbers in the topmost.
_PAIRS, _GATHER = np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0001000100010001)


def reason_of(code: int) -> str:
    """Return the reason in words, as all scanners give it."""
    if code == LENGTH:
        return "malformed: length"
    if code == CHECKSUM:
        return "malformed: checksum"
    return f"malformed: no message {code - NO_MESSAGE} to check by"


class CheckColumns:
    """The check of one framing; `why_not` says for which framings there is none."""

    def __init__(self, framing: Framing, extras: Mapping[int, bytes] | None) -> None:
        assert framing.check is not None
        self.check: Check = framing.check
        self.sync = len(framing.sync)
        self._framing = framing
        self._head: Head | None = None
        self._parts: list[slice | bytes | None] = []
        for part in framing.check_over:
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
        """Say why a framing's check cannot be computed in columns; empty when it can."""
        check = framing.check
        if check is None:
            return ""
        if check.text is not None or check.bytes > 8:
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
        """Return (which packets pass, None: all; the codes of those that do not; the packets' rows where they
        were made).
        """
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
            covered = self._framing.check_covers(packet)
            good[index] = self.check.compute(covered) == packet[-1]
            if good[index]:
                rows = None
        if good.all():
            return None, None, rows
        return good, np.full(len(good) - int(np.count_nonzero(good)), CHECKSUM), rows

    @staticmethod
    def _narrow(sizes: Array) -> int:
        """Return the width of rows into which nearly all packets fit without much air; 0: there is none."""
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
        place = self._framing.check_at
        stored = number_at(data, (starts if place >= 0 else ends) + place, self.check.bytes, self.check.order)
        bad = wanted != stored.astype(wanted.dtype)
        codes[bad if known is None else known[bad]] = CHECKSUM
        return codes

    # ------------------------------------------------------------------ a byte at the end, over short packets

    def _foldable(self, framing: Framing) -> int | None:
        """Return the fold of the sync bytes that are not covered, where the check is one byte over all the rest."""
        check, part = self.check, self._parts[0]
        if check.kind not in ("sum", "xor") or check.bytes != 1 or len(self._parts) > 1:
            return None
        if not isinstance(part, slice) or part.stop != -1 or not 0 <= (part.start or 0) <= self.sync:
            return None
        outside = framing.sync[: part.start or 0]
        return xor_of(outside) if check.kind == "xor" else sum(outside) & 0xFF

    def _folds(self, rows: Array, buffer: bytes, starts: Array, sizes: Array) -> Array:
        """Return which packets pass: all bytes of each are folded at once, the check's own too, eight at a time."""
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
        if self.check.sign:
            # What is covered and what is stored give 255 (the complement) or 0 (the two's complement).
            passed = number == np.uint8((self.check.signed(0) + self._folded) & 0xFF)
            return passed
        stored = np.frombuffer(buffer, np.uint8).take(starts + sizes - 1)
        passed = number - stored - np.uint8(self._folded) == stored
        return passed

    @staticmethod
    def _span(part: slice, starts: Array, ends: Array) -> tuple[Array, Array]:
        """Return where a part of each packet starts and ends in the buffer, as slicing the packet would cut it."""
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
            covered = self._framing.check_covers(packet, extra)
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
            one = check.signed(one)
            if kind.itemsize != size:
                one = one & kind.type(check.mask)
        return one

    def _running(self, name: str, fold: Any, data: Array, kind: Any) -> Array:
        """Return the running value before each position, and after the last, in memory that is used again."""
        scratch = self._scratch.get(name)
        if scratch is None or len(scratch) <= len(data):
            scratch = self._scratch[name] = np.zeros(len(data) + 1 + len(data) // 8, kind)
        fold.accumulate(data, dtype=kind, out=scratch[1 : len(data) + 1])
        return scratch[: len(data) + 1]


#: What a step over all packets costs beside one packet done alone, in microseconds: decides which are done alone.
_STEP, _ALONE = 6.0, 0.8


class CrcColumns:
    """The CRC of runs of bytes in one buffer; `can` says for which CRCs there is one."""

    def __init__(self, check: Crc) -> None:
        width, poly, init, refin, refout, xorout = check.parameters
        self.width = width
        self.is_turned = not refin
        self._turn_out = not refout
        self.dtype = np.dtype(np.uint16 if width <= 16 else np.uint32 if width <= 32 else np.uint64)
        self._bytes, self._words = _tables(width, poly, self.dtype.itemsize)
        self._init = self.dtype.type(_turned(init, width))
        self._xorout = self.dtype.type(xorout)

    @staticmethod
    def can(check: Crc) -> bool:
        """Return whether the CRC fits a machine word."""
        return check.parameters[0] <= 64

    def begin(self, count: int) -> Array:
        """Return the registers of `count` packets before their first byte."""
        return np.full(count, self._init, self.dtype)

    def words(self, data: Array) -> tuple[Array, Array]:
        """Return (bytes, words that start at each byte) of a buffer, as `run` wants them."""
        if self.is_turned:
            data = _TURN.take(data)
        words = np.empty(max(len(data) - 1, 0), np.uint16)
        np.copyto(words, np.ndarray(len(words), "<u2", data.data if len(data) else b"", strides=(1,)))
        return data, words

    def run(self, register: Array, source: tuple[Array, Array], starts: Array, sizes: Array) -> Array:
        """Return the registers after `sizes` bytes from `starts` of the buffer."""
        if not len(register):
            return register
        data, words = source
        most, least = int(sizes.max()), int(sizes.min())
        if most == least:
            at = starts.astype(np.intp)
            for _ in range(most >> 1):
                register = self._word(register, words.take(at))
                at += 2
            return self._byte(register, data.take(at)) if most & 1 else register
        # The longest first: those that are still running are always the first ones.
        order = np.argsort(-sizes, kind="stable")
        register, at, sizes = register[order], starts[order].astype(np.intp), sizes[order]
        left = -(sizes >> 1)
        for count in np.searchsorted(left, -np.arange(most >> 1), "left").tolist():
            register[:count] = self._word(register[:count], words.take(at[:count]))
            at[:count] += 2
        odd = np.flatnonzero(sizes & 1)
        register[odd] = self._byte(register[odd], data.take(at[odd]))
        out = np.empty_like(register)
        out[order] = register
        return out

    def over(self, register: Array, rows: Array) -> Array:
        """Return the registers after the bytes of `rows`, a row a packet (or one row for all)."""
        if self.is_turned:
            rows = _TURN.take(rows)
        for column in range(rows.shape[1]):
            register = self._byte(register, rows[:, column])
        return register

    def end(self, register: Array) -> Array:
        """Return the numbers that stand for these registers in a packet."""
        if self._turn_out:
            # Each byte turned round, and the bytes read the other way.
            octets = _TURN.take(register.astype(self.dtype.newbyteorder("<")).view(np.uint8))
            turned = octets.view(self.dtype.newbyteorder(">")).astype(self.dtype)
            register = turned >> self.dtype.type(8 * self.dtype.itemsize - self.width)
        return register ^ self._xorout

    def _word(self, register: Array, words: Array) -> Array:
        if self.width <= 16:
            found: Array = self._words.take(register ^ words)
            return found
        low = (register ^ words).astype(np.uint16)
        found = self._words.take(low) ^ (register >> self.dtype.type(16))
        return found

    def _byte(self, register: Array, octets: Array) -> Array:
        low = (register ^ octets).astype(np.uint8)
        found: Array = self._bytes.take(low) ^ (register >> self.dtype.type(8))
        return found


def done_alone(sizes: Array) -> Array:
    """Return which packets are better done one by one: the few longest, where a step would be for them alone."""
    order = np.argsort(-sizes, kind="stable")
    steps = np.append(sizes[order] >> 1, 0)
    best = int(np.argmin(_ALONE * np.arange(len(steps)) + _STEP * steps))
    found: Array = order[:best]
    return found


def _turned(number: int, width: int) -> int:
    """Return the lowest `width` bits in reverse."""
    return int(f"{number & ((1 << width) - 1):0{width}b}"[::-1], 2)


_TURN = np.array([_turned(n, 8) for n in range(256)], np.uint8)


@cache
def _tables(width: int, poly: int, size: int) -> tuple[Array, Array]:
    """Return what 8 and what 16 bits of a register become, as numbers of `size` bytes."""
    kind = np.dtype(f"u{size}").type
    reflected, unit = kind(_turned(poly, width)), kind(1)
    octets = np.arange(256, dtype=kind)
    for _ in range(8):
        octets = np.where(octets & unit, octets >> unit ^ reflected, octets >> unit)
    words = np.arange(65536, dtype=kind)
    for _ in range(2):
        words = octets.take(words & kind(0xFF)) ^ words >> kind(8)
    return octets, words


def can_compute(check: Check) -> bool:
    """Return whether `numbers` knows this check."""
    return check.bytes <= 4 and check.text is None


def check_holds(message: Message, data: Array, lengths: Array, keys: Array) -> Array:
    """Return which rows carry the number that their check gives; rows too short for it do not."""
    check = message.check
    assert check is not None
    start, size, order = message.check_span
    good = np.zeros(len(data), bool)
    for length in np.unique(lengths).tolist():
        if length < start + size:
            continue
        some = np.flatnonzero(lengths == length)
        rows = data[some, :length]
        stored = number_at(rows.ravel(), length * np.arange(len(rows)) + start, size, order)
        good[some] = stored == check_numbers(check, _covered(message, rows, keys[some]))
    return good


def _covered(message: Message, rows: Array, keys: Array) -> Array:
    """Return what the check covers, uint8 (n, k), as `Message.covered` gives it."""
    rows = rows[:, : rows.shape[1] - message.behind]
    parts: list[Array] = []
    for part in message.check_over:
        if isinstance(part, slice):
            parts.append(rows[:, part])
        elif isinstance(part, IdBytes):
            number = keys.astype(np.int64) & 0x1FFF_FFFF & part.mask
            places = range(part.size) if part.order == "little" else reversed(range(part.size))
            parts.append(
                np.stack([(number >> 8 * place & 0xFF).astype(np.uint8) for place in places], axis=1)
            )
        elif isinstance(part, DataIds):
            offset, shift, mask = part.place
            ids = np.frombuffer(part.ids, np.uint8)
            parts.append(ids[(rows[:, offset : offset + 1] >> shift & mask) % len(ids)])
        else:
            constant = message.check_extra if isinstance(part, Extra) else part
            assert isinstance(constant, bytes)  # a request is covered by framings' checks alone
            row = np.frombuffer(constant, np.uint8)
            parts.append(np.broadcast_to(row, (len(rows), len(row))))
    return np.concatenate(parts, axis=1)


def check_numbers(check: Check, covered: Array) -> Array:
    """Return the check's number of each row of `covered`, int64."""
    if check.kind == "xor":
        out: Array = np.bitwise_xor.reduce(covered, axis=1, dtype=np.uint8).astype(np.int64)
        return out
    if check.kind == "sum":
        assert isinstance(check, Sum)
        total: Array = covered.sum(axis=1, dtype=np.int64)
        cut: Array = np.bitwise_and(check.signed(total), check.mask)
        return cut
    if check.kind == "fletcher":
        first = covered.sum(axis=1, dtype=np.int64)
        weights: Any = np.arange(covered.shape[1], 0, -1, dtype=np.int64)
        second: Array = covered @ weights & 0xFF
        both: Array = np.bitwise_or(first & 0xFF, second << 8)
        return both
    engine = check.engine
    return np.fromiter((engine(row.tobytes()) for row in covered), np.int64, len(covered))
