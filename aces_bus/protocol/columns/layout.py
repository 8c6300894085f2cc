"""What the columns of a message's dataset are, and a table's values put into them.

1. A layout hangs on the message alone, never on the values of a piece: all pieces of a capture fit one schema.
2. `Layout.block` copies what it takes: what holds a block holds no table, and no array that a table was cut from.
3. Nothing here needs pyarrow or pandas.

A dataset begins with the transport's columns. CAN: `time`, `channel`, `id`, `extended`, `rx`. Streams: `time`,
`offset`, `size`, `rx`. Then come the fields under the names of their paths; one that is named like a column of the
transport has an underscore behind its name.

What a column of Python objects holds is said by the plan (`objects_of`): bytes, texts, and

    integer   of no stated width: 64 bits, and null where that is too narrow (counted in `Layout.too_wide`)
    wide      an integer of more than 64 bits: its decimal digits as text
    json      whatever has no fixed shape: JSON text, bytes in it as hexadecimal
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from ...frame_table import NO_TIME, Channels
from ...frames import EXTENDED, FD, REMOTE
from ..declare.protocol import Variant
from ..plan import nodes as p
from ..record import FieldValue
from .table import Array, Column, ColumnKind, MessageTable, dtype_of, join_pieces, kinds_of, object_array

Holds = Literal["number", "bool", "time", "label", "bytes", "text", "integer", "wide", "json"]
Role = Literal["source", "time", "channel", "id", "extended", "fd", "remote", "offset", "size", "rx", "field"]

CAN: tuple[Role, ...] = ("time", "channel", "id", "extended", "rx")
STREAM: tuple[Role, ...] = ("time", "offset", "size", "rx")
#: Of frames that were not decoded: everything that distinguishes them.
LOST: tuple[Role, ...] = ("time", "channel", "id", "extended", "fd", "remote", "rx")
_RESERVED = frozenset([*CAN, *STREAM, *LOST, "source"])

_TRANSPORT: Mapping[str, tuple[Holds, str, str]] = {
    "source": ("label", "", "the recording"),
    "time": ("time", "ns", "when; null where the capture does not say"),
    "channel": ("label", "", "the bus"),
    "id": ("number", "", "the CAN identifier, 11 or 29 bits"),
    "extended": ("bool", "", "whether the identifier has 29 bits"),
    "fd": ("bool", "", "whether it is a CAN FD frame"),
    "remote": ("bool", "", "whether it is a remote frame"),
    "offset": ("number", "bytes", "where the packet begins in the stream"),
    "size": ("number", "bytes", "size of the packet on the wire"),
    "rx": ("bool", "", "true: received, false: sent, null: the capture does not say"),
}
_DTYPES: Mapping[str, Any] = {"id": np.dtype("u4"), "offset": np.dtype("i8"), "size": np.dtype("i8")}

#: Absolute times are later than this, in ns since 1970 (1973-03-03); others count from whenever the recorder started.
ABSOLUTE_NS = 10**17


class ColumnValues(NamedTuple):
    """A piece of a column: an array, and where it holds nothing (None: nowhere)."""

    values: Array
    absent: Array | None


Block = list[ColumnValues]


class Labels:
    """Names by number, as dictionary columns have them; numbers go up as names come, -1 is not a name."""

    def __init__(self, names: Iterable[str] = ()) -> None:
        self.names: list[str] = []
        self._numbers: dict[str, int] = {}
        for name in names:
            self.number(name)

    def number(self, name: str | None) -> int:
        """Return the number of a name, a new one when it is new."""
        if name is None:
            return -1
        found = self._numbers.get(name)
        if found is None:
            found = self._numbers[name] = len(self.names)
            self.names.append(clean_name(name))
        return found

    def codes(self, channels: Channels, numbers: Array) -> Array:
        """Return a table's channel numbers as numbers of these labels."""
        codes = np.array([self.number(name) for name in channels.names] or [-1], np.int32)
        return codes[numbers] if len(channels.names) > 1 else np.full(len(numbers), codes[0], np.int32)


@dataclass(frozen=True)
class DatasetColumn:
    """One column of a dataset. `dtype` is that of numbers; `kind` is there for fields."""

    name: str
    role: Role
    holds: Holds
    dtype: Any = None
    kind: ColumnKind | None = None
    unit: str = ""
    doc: str = ""


@dataclass
class DatasetLayout:
    """The columns of one message's dataset."""

    protocol: str
    message: str
    direction: str | None
    is_stream: bool
    doc: str
    kinds: tuple[ColumnKind, ...]
    slots: tuple[DatasetColumn, ...]
    #: Values of `integer` columns that 64 bits do not hold, by column.
    too_wide: dict[str, int] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        table: MessageTable,
        objects: Mapping[str, Holds] | None = None,
        *,
        columns: Sequence[str] | None = None,
        float32: bool = False,
        with_source: bool = False,
    ) -> DatasetLayout:
        """Return the layout for a message's tables. `objects` says what columns of objects hold (`objects_of`);
        without it they are JSON texts. `columns` limits the fields to those named."""
        if table.message == "":
            objects = {"reason": "text", "raw": "bytes"}
        roles: tuple[Role, ...] = STREAM if table.is_stream else CAN if table.message else LOST
        slots = [_transport("source")] if with_source else []
        slots += [_transport(role) for role in roles]
        for kind in table.kinds:
            if columns is not None and kind.name not in columns:
                continue
            holds: Holds = (objects or {}).get(kind.name, "json") if kind.is_object else "number"
            dtype = None
            if holds == "number":
                dtype = table[kind.name].values.dtype
                if float32 and dtype == np.float64 and kind.names is None:
                    dtype = np.dtype(np.float32)
            elif holds == "integer":
                dtype = np.dtype(np.int64)
            name = f"{kind.name}_" if kind.name in _RESERVED else kind.name
            slots.append(DatasetColumn(name, "field", holds, dtype, kind, kind.unit, kind.doc))
        return cls(
            table.protocol,
            table.message,
            table.direction,
            table.is_stream,
            table.doc,
            table.kinds,
            tuple(slots),
        )

    def fits(self, table: MessageTable) -> bool:
        """Return whether a table of the same name is of the same message in the same dialect."""
        return self.is_stream == table.is_stream and (
            self.kinds is table.kinds or tuple(self.kinds) == tuple(table.kinds)
        )

    def block(self, table: MessageTable, labels: Labels, sources: Labels, source: str | None = None) -> Block:
        """Return a table's values, one piece a slot."""
        return [self._values(slot, table, labels, sources, source) for slot in self.slots]

    def _values(
        self, slot: DatasetColumn, table: MessageTable, labels: Labels, sources: Labels, source: str | None
    ) -> ColumnValues:
        role = slot.role
        if role == "field":
            assert slot.kind is not None
            column = table[slot.kind.name]
            if slot.kind.is_object:
                return self._objects(slot, column.values.tolist(), column.absent)
            values = column.values
            if values.dtype != slot.dtype:
                with np.errstate(over="ignore"):
                    values = values.astype(slot.dtype)
            return ColumnValues(own(values), None if column.absent is None else own(column.absent))
        if role == "time":
            absent = table.time == NO_TIME
            return ColumnValues(own(table.time), absent if absent.any() else None)
        if role == "channel":
            codes = labels.codes(table.channels, table.channel)
            absent = codes < 0
            return ColumnValues(codes, absent if absent.any() else None)
        if role == "source":
            return ColumnValues(np.full(len(table), sources.number(source), np.int32), None)
        if role == "rx":
            absent = table.rx == 2
            return ColumnValues(table.rx == 1, absent if absent.any() else None)
        if role == "id":
            return ColumnValues(table.key.astype(np.uint32) & np.uint32(0x1FFF_FFFF), None)
        if role == "offset":
            return ColumnValues(table.key.astype(np.int64), None)
        if role == "size":
            size = table.size if table.size is not None else np.zeros(len(table), np.int64)
            return ColumnValues(size.astype(np.int64), None)
        flag = {"extended": EXTENDED, "fd": FD, "remote": REMOTE}[role]
        return ColumnValues((table.key & np.uint32(flag)) != 0, None)

    def _objects(self, slot: DatasetColumn, values: list[Any], absent: Array | None) -> ColumnValues:
        gone = [value is None for value in values]
        if absent is not None:
            gone = [is_gone or other for is_gone, other in zip(gone, absent.tolist(), strict=True)]
        if slot.holds == "integer":
            for index, value in enumerate(values):
                if gone[index]:
                    values[index] = 0
                elif not isinstance(value, int) or not -(1 << 63) <= value < 1 << 63:
                    self.too_wide[slot.name] = self.too_wide.get(slot.name, 0) + 1
                    values[index], gone[index] = 0, True
            made: Array = np.array(values, np.int64)
        else:
            convert = _CONVERSIONS[slot.holds]
            made = object_array(
                [None if away else convert(value) for value, away in zip(values, gone, strict=True)]
            )
        return ColumnValues(made, np.array(gone, bool) if any(gone) else None)


def _transport(role: Role) -> DatasetColumn:
    holds, unit, doc = _TRANSPORT[role]
    return DatasetColumn(role, role, holds, _DTYPES.get(role), None, unit, doc)


def own(values: Array) -> Array:
    """Return the array itself when it owns its bytes, else a copy: a view would keep alive what it looks at."""
    return values if values.base is None else values.copy()


def clean_name(text: str) -> str:
    """Return a text that UTF-8 can hold: lone surrogates are spelt out."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return text.encode("utf-8", "backslashreplace").decode()
    return text


def _text(value: FieldValue) -> str:
    return clean_name(value if isinstance(value, str) else str(plain_json(value)))


def _bytes(value: FieldValue) -> bytes:
    return bytes(value) if isinstance(value, (bytes, bytearray, memoryview)) else _json(value).encode()


def _json(value: FieldValue) -> str:
    import msgspec

    return msgspec.json.encode(plain_json(value)).decode()


def plain_json(value: FieldValue) -> Any:
    """Return a value of any shape as what JSON has: bytes as hexadecimal, integers beyond 64 bits as their digits."""
    if value is None or isinstance(value, (bool, float)):
        return value
    if isinstance(value, int):
        return int(value) if -(1 << 63) <= value < 1 << 64 else str(int(value))
    if isinstance(value, (bytes, bytearray, memoryview)):
        return bytes(value).hex()
    if isinstance(value, Mapping):
        return {clean_name(str(key)): plain_json(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain_json(item) for item in value]
    return clean_name(str(value))


_CONVERSIONS: Mapping[str, Any] = {
    "bytes": _bytes,
    "text": _text,
    "wide": lambda value: str(int(value)) if isinstance(value, int) else _json(value),
    "json": _json,
}


def concat(blocks: Sequence[Block]) -> Block:
    """Join several blocks of a layout, in order."""
    if len(blocks) == 1:
        return blocks[0]
    return [ColumnValues(*join_pieces(pieces)) for pieces in zip(*blocks, strict=True)]


def cut_runs(block: Block, start: int, stop: int) -> Block:
    """Return rows `start` to `stop` of a block."""
    return [
        ColumnValues(piece.values[start:stop], None if piece.absent is None else piece.absent[start:stop])
        for piece in block
    ]


def size_of(block: Block) -> int:
    """Return the approximate bytes of memory that a block takes."""
    total = 0
    for values, absent in block:
        total += values.nbytes + (0 if absent is None else absent.nbytes)
        if values.dtype == object:
            total += sum(56 + len(value) for value in values.tolist() if value is not None)
    return total


# ---------------------------------------------------------------------- what objects are, by the plan


def objects_of(plan: p.MessagePlan) -> dict[str, Holds]:
    """Return what the columns of Python objects of a message hold, by the name of the column."""
    return {leaf.path: leaf.node.holds for leaf in plan.columns if dtype_of(leaf.node) is None}


class Objects:
    """`objects_of` for the messages of several variants."""

    def __init__(self, variants: Iterable[Variant] = ()) -> None:
        self._known: dict[tuple[str, str], list[tuple[tuple[ColumnKind, ...], dict[str, Holds]]]] = {}
        for variant in variants:
            for name, message in variant.messages.items():
                plan = message.plan
                found = objects_of(plan)
                if found:
                    self._known.setdefault((variant.name, name), []).append((kinds_of(plan), found))

    def of(self, table: MessageTable) -> dict[str, Holds]:
        """Return what the columns of objects of this table hold; empty when its message is not known."""
        known = self._known.get((table.protocol, table.message), [])
        for kinds, found in known:
            if kinds is table.kinds or kinds == table.kinds:
                return found
        return known[0][1] if len(known) == 1 else {}


def objects_by_values(table: MessageTable) -> dict[str, Holds]:
    """Return what the columns of objects of one table hold, by its values: for a table without its plan."""
    found: dict[str, Holds] = {}
    for kind in table.kinds:
        if kind.is_object:
            types = {type(value) for value in table[kind.name].values.tolist()} - {type(None)}
            if types <= {bytes}:
                found[kind.name] = "bytes" if types else "json"
            elif types <= {str}:
                found[kind.name] = "text"
            elif all(issubclass(kind, int) for kind in types):
                found[kind.name] = "integer"
    return found


def empty_table(variant: Variant, name: str) -> MessageTable:
    """Return a table of a message without rows: what its dataset looks like where the message does not occur."""
    plan = variant.messages[name].plan
    dtypes = {leaf.path: dtype_of(leaf.node) for leaf in plan.columns}
    is_stream = variant.link != "can"
    none = np.zeros(0, np.int64)
    return MessageTable(
        variant.name,
        name,
        variant.messages[name].direction,
        is_stream,
        none,
        np.zeros(0, np.uint16),
        Channels(),
        none if is_stream else np.zeros(0, np.uint32),
        none,
        np.zeros(0, np.uint8),
        kinds_of(plan),
        lambda kind: Column(kind, np.zeros(0, dtypes[kind.name] or object)),
        plan.doc,
        none if is_stream else None,
    )
