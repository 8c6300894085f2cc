"""Common lines of a candump log as columns: `(1436509052.249713) can0 044#2A366C2BBA R`, many at once.

1. What is given here is what `line.py` gives, to the last digit. Every other line is left to it.
2. Nothing is believed: every byte of a line is checked against its layout, or the line is left.
3. Memory is that of one block, whatever it holds.

A layout says where things are in a line: digits of the seconds and of their fraction, length of the name, 3 or 8
digits of the identifier. A log has a few of them, so all lines of one layout are read together, each of their columns
as one array. Layouts are learnt from the lines themselves. When all lines of a block are as long as the first, their
columns are views into the block (the fast path, checked like the other); otherwise lines are found by their ends and
those of one layout are gathered.

Hexadecimal digits of all lines are decoded by one `unhexlify`, which checks them too; digits behind the data of a line
are overwritten by zeros before. Decimal digits go through tables of pairs, by their place; the first eight digits of
the seconds seldom change within a block and are then read once.

Measured (60 identifiers, a file of 400,000 lines): 50 ns a line where all are equally long, 110 ns where lengths, names
and widths are mixed, 280 ns for CAN FD; a C program that believes what it reads takes 27 and 36 ns. Some 50 lines of one
layout outweigh its calls.
"""

from __future__ import annotations

import re
from binascii import unhexlify
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ...frame_table import Channels, FrameFlag, FrameTable, Ints
from ...frames import FD_LENGTHS
from ..base import keep_freed_memory
from ..merge import Merge
from .line import NAME

#: Fewer lines of one layout cost more here than line by line.
FEW = 48
#: Layouts that are kept, lines of a block that are asked for a new one, names that are distinguished in one layout.
_LAYOUTS, _SAMPLES, _NAMES = 16, 16, 64
#: Bytes of the shortest common line, so that blocks of shorter ones cost no more memory than others.
_SHORTEST = len(b"(1.5) a 123#\n")
#: No window reaches further behind the start of a line.
_SLACK = 512

_LF, _CR, _HASH, _BLANK = 0x0A, 0x0D, 0x23, 0x20
_FIRST = re.compile(
    rb"\(([0-9]{1,10}+)\.([0-9]{1,9}+)(\) {1,32}+" + NAME + rb"+ )"
    rb"([0-7][0-9A-Fa-f]{2}|[01][0-9A-Fa-f]{7})#(#?)"
)
_GAP = re.compile(rb"\) {1,32}+(" + NAME + rb"+) ")


@cache
def _weighted(pair: bool, zeros: int) -> Ints:
    """One or two ASCII digits, read as a little-endian word → the number that they and so many zeros say.

    Anything else → a negative number that no sum of others makes up for.
    """
    table = np.full(1 << 16 if pair else 1 << 8, -1 << 40, np.int64)
    for value in range(100 if pair else 10):
        digits = b"%02d" % value if pair else b"%d" % value
        table[int.from_bytes(digits, "little")] = value * 10**zeros
    return table


def _kept() -> Ints:
    """Return masks for 16 words of digits: masks[word, n] keeps those of `word` that are among the first n of all."""
    digit, number = np.arange(128)[None, :], np.arange(129)[:, None]
    masks: Ints = (
        np.where(digit < number, 0xFF, 0).astype(np.uint8).view("<u8")
    )  # rows of n, columns of words
    return np.ascontiguousarray(masks.T)


def _digits(layout: _Layout, sizes: Ints, bad: npt.NDArray[np.bool_]) -> Ints:
    """Return how many digits of data each line has; mark lines that have an odd number or too many as bad."""
    digits = sizes - np.uint16(layout.data_at)  # too few wrap around to too many
    wrong = digits > (128 if layout.fd else 16)
    wrong |= (digits & np.uint16(1)).astype(bool)
    if wrong.any():
        bad |= wrong
        digits[wrong] = 0
    return digits


def _hex_words(layout: _Layout, window: _Window, digits: Ints, words: int) -> Ints:
    """Return the digits of identifier and data as words of eight, filled with the digit 0 behind the data."""
    hexes = np.empty((window.count, 1 + words), np.uint64)
    identifier = window.word(layout.hash_at - 8)
    if layout.wide:
        hexes[:, 0] = identifier
    else:
        np.bitwise_or(identifier & _LAST_THREE, _FIVE_ZEROS, out=hexes[:, 0])
    is_cut = int(digits.min()) < 8 * words
    for k in range(words):
        word = window.word(layout.data_at + 8 * k)
        if is_cut:
            word = word ^ _ZEROS
            word &= _KEPT[k].take(digits)
            word ^= _ZEROS
        hexes[:, 1 + k] = word
    return hexes


_KEPT = _kept()
_ZEROS = np.uint64(0x3030_3030_3030_3030)
_LAST_THREE, _FIVE_ZEROS = np.uint64(0xFFFF_FF00_0000_0000), np.uint64(0x0000_0030_3030_3030)
_HEX = np.full(256, 0xFF, np.uint8)
for _digit in b"0123456789ABCDEFabcdef":
    _HEX[_digit] = int(chr(_digit), 16)
_FD_FLAGS = np.array(
    [
        FrameFlag.FD | (flags & 1) * FrameFlag.BITRATE_SWITCH | (flags >> 1 & 1) * FrameFlag.ERROR_STATE
        for flags in range(256)
    ],
    np.uint8,
)
_FD_LENGTH = np.isin(np.arange(65), FD_LENGTHS)


#: Which lines of a block were read, and their frames in order.
ReadLines = tuple[Ints, FrameTable]


@dataclass(frozen=True, slots=True)
class _Layout:
    whole: int
    fraction: int
    gap: int  # from the bracket to the identifier: ") can0 "
    wide: bool
    fd: bool

    @property
    def gap_at(self) -> int:
        return 2 + self.whole + self.fraction

    @property
    def hash_at(self) -> int:
        return self.gap_at + self.gap + (8 if self.wide else 3)

    @property
    def data_at(self) -> int:
        return self.hash_at + (3 if self.fd else 1)

    @property
    def reach(self) -> int:
        """Bytes of a line that are looked at, without its end."""
        return self.data_at + (128 if self.fd else 16)


class _Window:
    """The same bytes of many lines; a column is a view."""

    __slots__ = ("_bytes", "_step", "count")

    def __init__(self, data: Ints, step: int, count: int) -> None:
        self._bytes, self._step, self.count = data, step, count

    def byte(self, column: int) -> Ints:
        return np.ndarray((self.count,), np.uint8, self._bytes, column, (self._step,))

    def pair(self, column: int) -> Ints:
        return np.ndarray((self.count,), "<u2", self._bytes, column, (self._step,))

    def word(self, column: int) -> Ints:
        return np.ndarray((self.count,), "<u8", self._bytes, column, (self._step,))


class CandumpColumns:
    """Reads blocks of whole lines; what it learns of one serves the next."""

    def __init__(self, channels: Channels) -> None:
        keep_freed_memory()
        self._channels = channels
        self._buffer: Ints = np.zeros(_SLACK, np.uint8)
        self._layouts: list[_Layout] = []
        self._gaps: dict[bytes, int | None] = {}

    def read(self, block: bytes) -> ReadLines:
        """Return which lines are common, and their frames in a table. A block ends with LF."""
        size = len(block)
        if len(self._buffer) < size + _SLACK:
            self._buffer = np.zeros(size + size // 8 + _SLACK, np.uint8)
        buffer = self._buffer
        buffer[:size] = np.frombuffer(block, np.uint8)
        buffer[size : size + _SLACK] = 0
        return self._even(block, buffer) or self._mixed(block, buffer)

    def _even(self, block: bytes, buffer: Ints) -> ReadLines | None:
        """Return all lines, when they are equally long, of one layout and common; None when they are not."""
        step = block.find(b"\n") + 1
        lines, rest = divmod(len(block), step)
        if rest or not (buffer[step - 1 : len(block) : step] == _LF).all():
            return None
        layout = _learn(block[:step])
        if layout is None:
            return None
        ends = np.arange(step - 1, len(block), step)
        sizes, ways = _tails(buffer, ends, np.full(lines, min(step - 1, 0xFFFF), np.uint16))
        table, good = self._table(layout, _Window(buffer, step, lines), sizes, ways)
        return (np.ones(lines, bool), table) if good is None else None

    def _mixed(self, block: bytes, buffer: Ints) -> ReadLines:
        """Read the lines of a block that has several layouts: for each layout all lines that fit it at once."""
        ends = np.flatnonzero(buffer[: len(block)] == _LF)
        lines = len(ends)
        usual = np.zeros(lines, bool)
        if lines * _SHORTEST > len(block):
            return usual, FrameTable.empty(self._channels)
        starts = np.empty_like(ends)
        starts[0] = 0
        np.add(ends[:-1], 1, out=starts[1:])
        sizes, ways = _tails(buffer, ends, np.minimum(ends - starts, 0xFFFF).astype(np.uint16))

        found: list[tuple[Ints, FrameTable]] = []
        #: Layout → number of lines that were read by it.
        read_by: dict[_Layout, int] = {}

        def read_lines(layout: _Layout) -> None:
            unread = np.flatnonzero(~usual)
            begins = starts[unread]
            places = unread[
                (buffer[begins + layout.hash_at] == _HASH)
                & ((buffer[begins + (layout.hash_at + 1)] == _HASH) == layout.fd)
                & (sizes[unread] >= layout.data_at)
            ]
            read_by[layout] = 0
            if len(places) < FEW:
                return
            window = _gathered(buffer, starts[places], layout.reach)
            table, good = self._table(layout, window, sizes[places], ways[places])
            if good is not None:
                places, table = places[good], table.take(good)
            if len(places):
                found.append((places, table))
                usual[places] = True
                read_by[layout] = len(places)

        # First the layouts of the block before, then layouts that are learnt from unread lines here and there.
        for layout in self._layouts:
            if lines - np.count_nonzero(usual) >= FEW:
                read_lines(layout)
        for sample in range(_SAMPLES):
            unread = np.flatnonzero(~usual)
            if len(unread) < FEW:
                break
            place = unread[len(unread) * sample // _SAMPLES]
            learnt = _learn(block[starts[place] : min(ends[place], starts[place] + _SLACK)])
            if learnt is not None and learnt not in read_by:
                read_lines(learnt)
        counts = {**dict.fromkeys(self._layouts, 0), **read_by}
        self._layouts = sorted(counts, key=lambda layout: -counts[layout])[:_LAYOUTS]
        if not found:
            return usual, FrameTable.empty(self._channels)
        return usual, Merge.in_order(lines, [places for places, _ in found], [table for _, table in found])

    def _table(
        self, layout: _Layout, window: _Window, sizes: Ints, ways: Ints
    ) -> tuple[FrameTable, Ints | None]:
        """Return the columns of lines that may have this layout, and which of them do; None for all."""
        count = window.count
        bad = window.byte(0) != 0x28
        bad |= window.byte(1 + layout.whole) != 0x2E
        bad |= window.byte(layout.hash_at) != _HASH
        time = _time(layout, window, bad)
        channel = self._channel(layout, window, bad)

        digits = _digits(layout, sizes, bad)
        words = max(2, -(-int(digits.max()) // 8))
        raw = _unhex(_hex_words(layout, window, digits, words), bad)

        width = 4 * (1 + words)
        ids = np.ndarray((count,), ">u4", raw, 0, (width,)).astype(np.uint32)
        bad |= ids > (0x1FFF_FFFF if layout.wide else 0x7FF)
        rows = _data(raw, count, words, 64 if layout.fd else 8)
        length = (digits >> 1).astype(np.uint8)
        flags = ways | np.uint8(FrameFlag.EXTENDED) if layout.wide else ways
        if layout.fd:
            bad |= window.byte(layout.hash_at + 1) != _HASH
            bad |= ~_FD_LENGTH[length]
            given = _HEX[window.byte(layout.hash_at + 2)]
            bad |= given == 0xFF
            flags = flags | _FD_FLAGS[given]
        table = FrameTable(time, channel, ids, flags, length, rows, self._channels)
        return table, ~bad if bad.any() else None

    def _channel(self, layout: _Layout, window: _Window, bad: Ints) -> Ints:
        """Return the numbers of the channels; marks lines whose gap is not a name between blanks."""
        words: list[Ints] = []
        for start in range(0, layout.gap, 8):
            word = window.word(layout.gap_at + start)
            over = start + 8 - layout.gap
            words.append(word & np.uint64((1 << 64 - 8 * over) - 1) if over > 0 else word)
        out: Ints | None = None
        left: Ints = np.empty(0, bool)
        for _ in range(_NAMES):
            row = 0 if out is None else int(left.argmax())
            gap = b"".join(word[row].tobytes() for word in words)[: layout.gap]
            number = self._number(gap)
            same = words[0] == words[0][row]
            for word in words[1:]:
                same &= word == word[row]
            if number is None:
                bad |= same
            if out is None:
                out = np.full(window.count, number or 0, np.uint16)
                left = ~same
            else:
                out[same] = number or 0
                left &= ~same
            if not left.any():
                return out
        assert out is not None
        bad |= left
        return out

    def _number(self, gap: bytes) -> int | None:
        if gap not in self._gaps:
            if len(self._gaps) >= 1024:
                self._gaps.clear()
            found = _GAP.fullmatch(gap)
            self._gaps[gap] = (
                self._channels.number(found[1].decode("utf-8", "backslashreplace")) if found else None
            )
        return self._gaps[gap]


def _learn(line: bytes) -> _Layout | None:
    found = _FIRST.match(line)
    if found is None:
        return None
    whole, fraction, gap, digits, second = map(len, found.groups())
    return _Layout(whole, fraction, gap, digits == 8, second == 1)


def _tails(buffer: Ints, ends: Ints, sizes: Ints) -> tuple[Ints, Ints]:
    """Sizes of lines without carriage return and direction, and the flags RX and TX."""
    last = buffer[ends - 1]
    returns = last == _CR
    if returns.any():
        sizes = sizes - returns
        ends = ends - returns
        last = buffer[ends - 1]
    received, sent = last == 0x52, last == 0x54
    if not (received.any() or sent.any()):
        return sizes, np.zeros(len(ends), np.uint8)
    blank = buffer[ends - 2] == _BLANK
    received &= blank
    sent &= blank
    ways = received * np.uint8(FrameFlag.RX) | sent * np.uint8(FrameFlag.TX)
    return sizes - (received | sent) * np.uint16(2), ways


def _gathered(buffer: Ints, starts: Ints, width: int) -> _Window:
    """So many bytes from each start, one after the other."""
    lines: Any = np.ndarray((len(buffer) - width,), np.dtype((np.void, width)), buffer, 0, (1,))[starts]
    return _Window(lines.view(np.uint8), width, len(starts))


def _time(layout: _Layout, window: _Window, bad: Ints) -> Ints:
    """Nanoseconds; marks lines whose digits are none, or too many seconds for 63 bits."""
    column, left, top = 1, layout.whole, 0
    if layout.whole >= 8:
        word = window.word(1)
        if (word == word[0]).all() and (digits := word[0].tobytes()).isdigit():
            column, left = 9, layout.whole - 8
            top = int(digits) * 10**left
    if layout.whole == 10:
        bad |= window.byte(1) > 0x38
    out = _decimal(window, column, left, 0)
    if isinstance(out, int):
        out = np.full(window.count, top, np.int64)
    else:
        bad |= out < 0
        out += top
    out *= 1_000_000_000
    fraction = _decimal(window, 2 + layout.whole, layout.fraction, 9 - layout.fraction)
    bad |= fraction < 0
    out += fraction
    instants: Ints = out
    return instants


def _decimal(window: _Window, column: int, digits: int, zeros: int) -> Any:
    """Return the number that so many digits and then zeros say; negative where they are not digits. 0 without any digit."""
    out: Any = 0
    while digits:
        pair = digits > 1
        digits -= 2 if pair else 1
        table = _weighted(pair, digits + zeros)
        # `take` is twice as fast as an index here: it makes places of small numbers at once.
        value = table.take(window.pair(column) if pair else window.byte(column))
        out = value if isinstance(out, int) else np.add(out, value, out=out)
        column += 2
    return out


def _unhex(hexes: Ints, bad: Ints) -> bytes:
    """Return the bytes of rows of digits; marks rows that hold something else."""
    try:
        return unhexlify(hexes.data)
    except ValueError:
        wrong = (_HEX[hexes.view(np.uint8)] == 0xFF).any(axis=1)
        bad |= wrong
        hexes[wrong] = _ZEROS
        return unhexlify(hexes.data)


def _data(raw: bytes, count: int, words: int, width: int) -> Ints:
    """Return the data bytes of rows that begin with four bytes of identifier and go on with four for each word."""
    if width == 8:
        return np.ndarray((count,), "<u8", raw, 4, (12,)).copy().view(np.uint8).reshape(count, 8)
    data = np.zeros((count, width), np.uint8)
    data[:, : 4 * words] = np.frombuffer(raw, np.uint8).reshape(count, 4 + 4 * words)[:, 4:]
    return data
