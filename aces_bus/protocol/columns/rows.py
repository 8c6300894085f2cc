"""Columns from rows of bytes: the plan of a message carried out on thousands of packets at once.

1. What a column shows is what the generated decoder shows of each row, bit for bit and to the last digit of a float64.
2. Numbers are computed in the order of the generated decoder: raw × scale, then + offset, in float64 where it does.
3. What this cannot carry out is said in `reason`; the message is then decoded one record at a time.

A field is read as what it is on the wire where that is a whole number of NumPy's; every other one is cut out of 64-bit
words, little- or big-endian, whichever needs fewer cuts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from msgspec.structs import replace

from ..declare.bits import runs_of, whole_bits
from ..declare.fields import text_until
from ..declare.message import Message
from ..declare.shapes import Shapes
from ..plan import nodes as p
from .checks import can_compute, check_holds
from .lists import ListColumns
from .shaped import MovedFields, ShapedRows, WideRows
from .table import Array, ByteColumn, Column, ColumnKind, cells_of, dtype_of, kinds_of

T = TypeVar("T")

#: Integers up to here are exact in float64.
EXACT = 1 << 53


class PacketRows:
    """Packets of one message: `data` uint8 (n, width) with zeros behind each length, `lengths`, `keys`, all of n.

    `keys` are CAN keys or offsets. Words are made when a field asks for them.
    """

    def __init__(self, data: Array | MovedFields, lengths: Array, keys: Array) -> None:
        self._moved = data if isinstance(data, MovedFields) else None
        self._data = _padded(data) if isinstance(data, np.ndarray) else None
        self.lengths = lengths
        self.keys = keys
        self._words: dict[tuple[int, str], Array] = {}
        self._kept: dict[Any, Any] = {}

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def data(self) -> Array:
        """The bytes; those of fields that are there by bits are moved to fixed places when they are first asked for."""
        if self._data is None:
            assert self._moved is not None
            self._data = _padded(self._moved.spread())
        return self._data

    def word(self, index: int, order: str) -> Array:
        """Return the 64-bit word of bytes 8·index to 8·index + 7, read in this byte order; uint64 (n,)."""
        found = self._words.get((index, order))
        if found is None:
            words = self.data.view(np.uint64)[:, index]
            if self.data.shape[1] > 8:
                words = np.ascontiguousarray(words)
            found = words if (order == "little") == _IS_LITTLE else words.byteswap()
            self._words[index, order] = found
        return found

    def kept(self, key: Any, make: Callable[[], T]) -> T:
        """Return what `make` gives, made once for these rows."""
        if key not in self._kept:
            self._kept[key] = make()
        found: T = self._kept[key]
        return found

    def whole(self, dtype: Any, offset: int) -> Array:
        """Return the numbers at a byte offset, as they stand in the rows; a view, but of fields that are there by bits."""
        if self._moved is not None:
            return self._moved.whole(dtype, offset)
        width = self.data.shape[1]
        return np.ndarray((len(self.data),), dtype, self.data, offset, (width,))

    def reaching(self, end: int) -> PacketRows:
        """Return the rows, at least `end` bytes wide."""
        if self.data.shape[1] >= end:
            return self
        wide = np.zeros((len(self), end), np.uint8)
        wide[:, : self.data.shape[1]] = self.data
        return PacketRows(wide, self.lengths, self.keys)

    def take(self, which: Any) -> PacketRows:
        """Return some of the rows."""
        return PacketRows(self.data[which], self.lengths[which], self.keys[which])


def _padded(data: Array) -> Array:
    """Return rows whose width words of 64 bits divide."""
    if data.shape[1] % 8:
        wide = np.zeros((len(data), -(-data.shape[1] // 8) * 8), np.uint8)
        wide[:, : data.shape[1]] = data
        data = wide
    return np.ascontiguousarray(data)


_IS_LITTLE = bool(np.frombuffer(b"\x01\x00", np.uint16)[0] == 1)

Read = Callable[[PacketRows], Array]


class RowDecoder:
    """Which rows are the message, and its columns. `reason` is why it cannot be carried out on rows, else empty.

    With `message` the message's own check is verified too.
    """

    def __init__(self, plan: p.MessagePlan, *, raw: bool = False, message: Message | None = None) -> None:
        self.plan = plan
        self.raw = raw
        self.kinds = kinds_of(plan, raw)
        self.message = message
        #: Where the last field of fixed size ends; rows must reach there. Fields that are there only for some values of
        #: a selector may stand behind the end of any packet.
        self.extent = extent_of(plan)
        #: Of fields that are there by bits: what makes rows in which each has a fixed place, and what decodes these.
        self._shaped: ShapedRows | None = None
        self._wide: RowDecoder | None = None
        self.reason = self._why_not()
        #: Columns of numbers of the wire that show 0 as 0, and never as absent.
        self.keeps_zero = {leaf.path for leaf in plan.columns if _keeps_zero(leaf, raw=raw)}
        #: The field of the message that a column is of, or in.
        self._fields = {leaf.path: leaf.field.name for leaf in plan.columns}
        self._columns: dict[str, Callable[[ColumnKind, PacketRows], Column]] = {}
        if self.reason or self._wide is not None:
            return
        lists: dict[str, ListColumns] = {}
        for leaf in plan.columns:
            if isinstance(leaf.node, p.ListNode):
                lists[leaf.path] = ListColumns(
                    leaf.node, plan.name, plan.tail, raw=raw, make=lambda inner: RowDecoder(inner, raw=raw)
                )
                self._columns[leaf.path] = _given(lists[leaf.path].whole)
            elif leaf.is_inside:
                self._columns[leaf.path] = _given(next(reversed(lists.values())).inside(leaf))
            else:
                self._columns[leaf.path] = self._column(leaf.node, leaf.whens)

    def _why_not(self) -> str:
        plan = self.plan
        if plan.all_fields is not None and self.message is not None:
            if reason := self._shape(self.message, plan.all_fields):
                return reason
        elif plan.opaque:
            return plan.opaque
        if plan.split is not None:
            return "delimited text"
        if plan.needs_request:
            return "shows fields of its request"
        if plan.is_checked:
            if self.message is None or self.message.check is None:
                return "a check of its own"
            if not can_compute(self.message.check):
                return f"the check {self.message.check.describe}"
        return ""

    def _shape(self, message: Message, plan: p.MessagePlan) -> str:
        """Make the decoder of the wide rows. Return the reason where rows cannot be decoded so, else an empty text."""
        self._shaped = ShapedRows(Shapes(message), plan)
        constants = tuple(constant for constant in plan.constants if constant not in self.plan.constants)
        inside = replace(
            plan, constants=constants, one_of=(), sync=0, lengths=None, least=0, is_checked=False
        )
        self._wide = RowDecoder(inside, raw=self.raw)
        return self._shaped.reason or self._wide.reason

    def _wide_rows(self, rows: PacketRows) -> WideRows:
        shaped = self._shaped
        assert shaped is not None
        return rows.kept("wide", lambda: shaped.of(rows))

    # ------------------------------------------------------------------ which rows

    def accepts(self, rows: PacketRows) -> Array | None:
        """Return which rows are the message: a boolean array, or None when all are. Identifier and framing fit already."""
        plan = self.plan
        tests: list[Array] = []
        lengths = rows.lengths
        low, high = (int(lengths.min()), int(lengths.max())) if len(lengths) else (0, 0)
        if plan.lengths is None:
            if low < plan.least:
                tests.append(lengths >= plan.least)
        elif low != high or low not in plan.lengths:
            is_right = np.zeros(high + 1, bool)
            is_right[[length for length in plan.lengths if length <= high]] = True
            tests.append(is_right.take(lengths))
        if tests and not tests[0].any():
            return tests[0]
        if plan.lengths_by is not None:
            selector, table, other = plan.lengths_by
            chosen = number_reader(selector.number)(rows)
            wanted = np.full(len(rows), other, np.int64)
            for value, length in table:
                wanted[chosen == value] = length
            tests.append(lengths == wanted)
        for constant in plan.constants[plan.sync :]:
            if constant.offset >= rows.data.shape[1]:
                tests.append(np.zeros(len(rows), bool))
                continue
            cell = rows.data[:, constant.offset]
            if constant.mask != 0xFF:
                cell = cell & np.uint8(constant.mask)
            tests.append(cell == constant.value)
        for choice in plan.one_of:
            tests.append(among(number_reader(choice.number)(rows), choice.values))
        if self._wide is not None:
            wide = self._wide_rows(rows)
            good = self._wide.accepts(wide.rows)
            tests += [wide.fits] if good is None else [wide.fits, good]
        for _, node in plan.lists:
            if isinstance(node, p.Repeated):
                left = lengths.astype(np.int64) - (node.offset + plan.tail)
                if node.count is None:
                    tests.append(left % node.width == 0)
                else:
                    tests.append(number_reader(node.count)(rows).astype(np.int64) * node.width == left)
        if plan.is_checked:
            assert self.message is not None
            tests.append(check_holds(self.message, rows.data, rows.lengths, rows.keys))
        if not tests:
            return None
        good = tests[0]
        for test in tests[1:]:
            good = good & test
        return None if good.all() else good

    # ------------------------------------------------------------------ columns

    def column(self, kind: ColumnKind, rows: PacketRows) -> Column:
        """Return the column of this kind."""
        if self._wide is not None:
            wide = self._wide_rows(rows)
            found = self._wide.column(kind, wide.rows)
            there = wide.there.get(self._fields[kind.name], True)
            if there is True:
                return found
            gone = there == 0 if isinstance(there, np.ndarray) else np.ones(len(rows), bool)
            if kind.name in self._wide.keeps_zero:
                return Column(kind, found.values, gone)
            return _without(found, gone)
        return self._columns[kind.name](kind, rows)

    def present(self, when: p.When, rows: PacketRows) -> Array:
        """Return where a condition holds: the selector has one of the values, and is there itself."""
        found = among(number_reader(when.selector.number)(rows), when.values)
        outer = when.selector.when
        return found if outer is None else found & self.present(outer, rows)

    def _column(self, node: p.Node, whens: Sequence[p.When]) -> Callable[[ColumnKind, PacketRows], Column]:
        if isinstance(node, p.Scalar) and node.is_bytes and not whens:
            if node.kind == "bytes" or self.raw:
                where = node.offset, node.size, self.plan.tail
                return lambda kind, rows: ByteColumn(kind, rows.data, rows.lengths, *where)
        values = self._values(node)

        def column(kind: ColumnKind, rows: PacketRows) -> Column:
            found, absent = values(rows)
            for when in whens:
                missing = ~self.present(when, rows)
                absent = missing if absent is None else absent | missing
            return _without(Column(kind, found, None), absent)

        return column

    def _values(self, node: p.Node) -> Callable[[PacketRows], tuple[Array, Array | None]]:
        if isinstance(node, p.Scalar) and node.is_bytes:
            return self._bytes(node)
        if isinstance(node, p.Rest):
            return self._rest(node)
        assert isinstance(node, (p.Scalar, p.FromIdentifier))
        number = number_reader(node) if isinstance(node, p.Scalar) else self._captured(node)
        return _stepped(number, node.steps, dtype_of(node, self.raw), raw=self.raw)

    def _bytes(self, scalar: p.Scalar) -> Callable[[PacketRows], tuple[Array, Array | None]]:
        start, size, tail = scalar.offset, scalar.size, self.plan.tail
        is_text = scalar.kind == "text" and not self.raw

        def read(rows: PacketRows) -> tuple[Array, None]:
            out = np.empty(len(rows), object)
            if size is None and (not len(rows) or int(rows.lengths.max()) - tail <= start):
                out[:] = "" if is_text else b""
                return out, None
            cells = cells_of(rows.data, rows.lengths, start, size, tail)
            if is_text:
                texts = [cell.decode("latin-1") for cell in cells]
                out[:] = [text_until(text, scalar.ends) for text in texts] if size is not None else texts
            else:
                out[:] = cells
            return out, None

        return read

    def _rest(self, node: p.Rest) -> Callable[[PacketRows], tuple[Array, Array | None]]:
        full = (1 << 8 * node.size) - 1
        masks = {value: full & ~claimed for value, claimed in node.claimed}
        dtype = dtype_of(node, self.raw)
        bits = whole_bits(node.offset, node.size, "little")
        scalar = p.Scalar("uint", node.offset, node.size, "little", bits)
        number = number_reader(scalar) if node.size <= 8 else _long(node.offset, node.size)

        def read(rows: PacketRows) -> tuple[Array, None]:
            word = number(rows)
            kind = np.uint64 if dtype is not None else object
            mask: Any = np.full(len(rows), masks[None], kind)
            if node.selector is not None:
                chosen = number_reader(node.selector.number)(rows)
                for value, some in masks.items():
                    if value is not None:
                        mask[chosen == value] = some
            for selector, table in node.more:
                chosen = number_reader(selector.number)(rows)
                there = None if selector.when is None else self.present(selector.when, rows)
                for value, some in table:
                    here = chosen == value if there is None else (chosen == value) & there
                    mask[here] &= mask.dtype.type(full & ~some) if dtype is not None else full & ~some
            left = word.astype(kind) & mask
            return left.astype(dtype) if dtype is not None else left, None

        return read

    def _captured(self, node: p.FromIdentifier) -> Read:
        inner = number_reader(node.number) if node.number is not None else None
        constant, shift, mask = node.constant, node.shift, (1 << node.width) - 1

        def read(rows: PacketRows) -> Array:
            number = (inner(rows) if inner is not None else rows.keys).astype(np.int64)
            if node.is_alone:
                return (number - constant) >> shift
            return (number >> shift) & mask

        return read


def _without(column: Column, absent: Array | None) -> Column:
    """Return a column without the values that are absent."""
    if absent is None or not absent.any():
        return column
    values = column.values
    if column.absent is not None:
        absent = absent | column.absent
    if values.dtype == object:
        values = values.copy()
        values[absent] = None
        return Column(column.kind, values, absent)
    bits = np.dtype(f"u{values.dtype.itemsize}")  # by bits, as a choice costs ten times as much
    return Column(column.kind, np.multiply(values.view(bits), ~absent, dtype=bits).view(values.dtype), absent)


def _keeps_zero(leaf: p.NodePath, *, raw: bool) -> bool:
    """Return whether a column is of numbers of the wire, shows 0 as 0, and always shows a number."""
    node = leaf.node
    if leaf.is_inside or leaf.whens or not isinstance(node, p.Scalar) or not node.format:
        return False
    scales = [step for step in node.steps if isinstance(step, p.Scale | p.ScaleByBit)]
    return raw or all(isinstance(step, p.Scale) and not step.offset and not step.unknown for step in scales)


@lru_cache(maxsize=4096)
def row_decoder(message: Message, *, raw: bool) -> RowDecoder:
    """Return the decoder of a message's rows, which scanners share."""
    return RowDecoder(message.plan, raw=raw, message=message)


def _given(
    values: Callable[[PacketRows], tuple[Array, Array | None]],
) -> Callable[[ColumnKind, PacketRows], Column]:
    return lambda kind, rows: Column(kind, *values(rows))


@lru_cache(maxsize=65536)
def number_reader(scalar: p.Scalar) -> Read:
    """Return a function from rows to the number of each, as an integer or float array of any width."""
    if scalar.kind == "float" and scalar.bits:
        return _float_bits(scalar)
    if scalar.format:
        kind = {"float": "f", "int": "i", "uint": "u"}[scalar.kind]
        dtype = np.dtype(f"{'<' if _is_little(scalar) else '>'}{kind}{scalar.size}")
        if kind == "f":
            return lambda rows: _doubled(rows.whole(dtype, scalar.offset))
        return lambda rows: rows.whole(dtype, scalar.offset)
    if len(scalar.bits) > 64:
        return _wide(scalar)
    return _cut(scalar)


def _is_little(scalar: p.Scalar) -> bool:
    return scalar.order == "little" if scalar.kind == "float" else scalar.bits[0] == 8 * scalar.offset


def _cut(scalar: p.Scalar) -> Read:
    """Return a number of up to 64 bits, cut out of words."""
    plans = []
    for order in ("little", "big"):
        cuts: list[tuple[int, int, int, int]] = []  # word, shift in it, place in the number, width
        positions = [
            b if order == "little" else (b // 64) * 64 + (7 - b % 64 // 8) * 8 + b % 8 for b in scalar.bits
        ]
        for at, to, width in runs_of(positions):
            while width:
                part = min(width, 64 - at % 64)
                cuts.append((at // 64, at % 64, to, part))
                at, to, width = at + part, to + part, width - part
        plans.append((len(cuts), order != "little", order, cuts))
    _, _, order, cuts = min(plans)
    signed = scalar.kind == "int"
    bits = len(scalar.bits)

    if len(cuts) == 1:
        index, shift, _, width = cuts[0]
        if signed:
            up, down = np.uint64(64 - shift - width), np.int64(64 - width)
            return lambda rows: (rows.word(index, order) << up).view(np.int64) >> down
        if width == 64:
            return lambda rows: rows.word(index, order)
        low, mask = np.uint64(shift), np.uint64((1 << width) - 1)
        if shift + width == 64:
            return lambda rows: (rows.word(index, order) >> low).view(np.int64)
        if not shift:
            return lambda rows: (rows.word(index, order) & mask).view(np.int64)

        def one(rows: PacketRows) -> Array:
            out = rows.word(index, order) >> low
            out &= mask
            return out.view(np.int64)

        return one

    def many(rows: PacketRows) -> Array:
        out = np.zeros(len(rows), np.uint64)
        for index, shift, place, width in cuts:
            piece = rows.word(index, order) >> np.uint64(shift)
            if shift + width < 64:
                piece &= np.uint64((1 << width) - 1)
            out |= piece << np.uint64(place)
        if signed:
            up = np.uint64(64 - bits)
            return (out << up).view(np.int64) >> np.int64(64 - bits)
        return out if bits == 64 else out.view(np.int64)

    return many


def _float_bits(scalar: p.Scalar) -> Read:
    """Return a float whose bits stand anywhere."""
    size = len(scalar.bits) // 8
    number = number_reader(p.Scalar("uint", scalar.offset, scalar.size, "little", scalar.bits))
    return lambda rows: _doubled(number(rows).astype(f"u{size}").view(f"f{size}"))


def _doubled(numbers: Array) -> Array:
    """Return floats as float64; a signalling NaN silently becomes a quiet one."""
    with np.errstate(invalid="ignore"):
        return numbers.astype(np.float64)


def _long(offset: int, size: int) -> Read:
    """Return a little-endian number of more than 64 bits, as Python integers."""

    def read(rows: PacketRows) -> Array:
        width = rows.data.shape[1]
        raw = rows.data.tobytes()
        out = np.empty(len(rows), object)
        out[:] = [
            int.from_bytes(raw[at : at + size], "little")
            for at in range(offset, offset + len(rows) * width, width)
        ]
        return out

    return read


def _wide(scalar: p.Scalar) -> Read:
    """Return a number of more than 64 bits, as Python integers."""
    bits = scalar.bits
    first, last = min(bits) // 8, max(bits) // 8 + 1
    whole = _long(first, last - first)
    runs = runs_of([b - 8 * first for b in bits])
    top = 1 << len(bits) - 1

    def read(rows: PacketRows) -> Array:
        word = whole(rows)
        out: Any = np.zeros(len(rows), object)
        for at, to, width in runs:
            out |= (word >> at & (1 << width) - 1) << to
        if scalar.kind == "int":
            out = (out ^ top) - top
        whole_numbers: Array = out
        return whole_numbers

    return read


def _stepped(
    number: Read, steps: Sequence[p.Step], dtype: Any, *, raw: bool
) -> Callable[[PacketRows], tuple[Array, Array | None]]:
    """Return the number after its steps, as `dtype` (None: objects), and where it is unknown."""
    scales = [step for step in steps if isinstance(step, p.Scale | p.ScaleByBit)] if not raw else []
    magnitude = next((step for step in steps if isinstance(step, p.Magnitude)), None)

    def read(rows: PacketRows) -> tuple[Array, Array | None]:
        value = number(rows)
        absent = None
        if magnitude is not None:
            half = 1 << magnitude.width - 1
            value = value.astype(np.int64) if magnitude.width < 64 else value.astype(object)
            value = np.where(value < half, value, half - value)
        for scale in scales:
            if isinstance(scale, p.ScaleByBit):
                clear, set_ = (value % scale.half * part.scale + part.offset for part in scale.scales)
                value = np.where(value < scale.half, clear, set_)
                continue
            if scale.unknown:
                gone = among(value, scale.unknown)
                absent = gone if absent is None else absent | gone
            value = _scaled(value, scale, dtype)
        if dtype is None:
            return value.astype(object), absent
        return (value if value.dtype == dtype else value.astype(dtype)), absent

    return read


def _scaled(value: Array, step: p.Scale, dtype: Any) -> Array:
    scale, offset = step.scale, step.offset
    if scale == 1 and not offset:
        return value
    if value.dtype.kind in "iu":
        is_float = isinstance(scale, float) and scale != 1.0
        if not is_float and (dtype is None or value.dtype.itemsize == 8 or abs(scale) > 1 << 20):
            return _exact(value, scale, offset)
        if not is_float and not isinstance(offset, float):
            value = value.astype(np.int64)
            return value * int(scale) + int(offset) if scale != 1 else value + int(offset)
    elif value.dtype == object:
        return _exact(value, scale, offset)
    # Floats of the wire may be infinite, signalling, or too large when scaled: so are they in records.
    with np.errstate(over="ignore", invalid="ignore"):
        if scale != 1:
            out = np.multiply(value, scale, dtype=np.float64)
            if offset:
                out += offset
            return out
        return np.add(value, offset, dtype=np.float64)


def _exact(value: Array, scale: float, offset: float) -> Array:
    """Multiply integers: in 64 bits where these hold every step, else as Python's own."""
    if value.dtype != object and len(value):
        reach = (
            max(abs(int(value.min())), abs(int(value.max()))) * max(1, abs(int(scale))) + abs(int(offset)) + 1
        )
        if reach < EXACT:
            value = value.astype(np.int64)
            if scale != 1:
                value = value * int(scale)
            return value + offset if isinstance(offset, float) and offset else value + int(offset)
    value = value.astype(object)
    if scale != 1:
        value = value * scale
    return value + offset if offset else value


def extent_of(plan: p.MessagePlan) -> int:
    """Return where the last field of fixed size ends."""
    ends = [0]
    for node in (leaf.node for leaf in plan.leaves):
        if isinstance(node, (p.Scalar, p.Rest)) and node.size is not None:
            ends.append(node.offset + node.size)
        if isinstance(node, p.Scalar) and node.bits:
            ends.append(max(node.bits) // 8 + 1)
    return max(ends)


def among(numbers: Array, values: Sequence[float] | range) -> Array:
    """Return where a number is one of `values`; NaN is NaN."""
    if isinstance(values, range) and len(values) > 16:
        (least, most), step = sorted((values[0], values[-1])), abs(values.step)
        inside: Array = (numbers >= least) & (numbers <= most)
        if step != 1:
            inside &= (numbers - least) % step == 0
        return inside
    if len(values) > 16 and all(value == value for value in values):
        found: Array = np.isin(numbers, np.array(list(values)))
        return found
    found = np.zeros(len(numbers), bool)
    for value in values:
        found |= numbers != numbers if value != value else numbers == value
    return found
