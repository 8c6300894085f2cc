"""Decoded messages as columns: one table a message.

1. A column holds raw numbers where they have names or flags (the names come with it), physical values where they have a
   scale. `to_list` gives what records show, value for value.
2. Tables are slices of a capture, in its order; `row` says which frame or packet of the capture each line was.
3. `kinds_of` and `dtype_of` decide what a message's columns are; every way of filling them fills the same ones.
4. Packets as rows are uint8 (n, width), zeros behind each one's end, contiguous, their width a multiple of 8, so that they
   are also rows of words.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from ...errors import UnknownNameError
from ...frame_table import NO_TIME, Channels
from ...plain_text import MOST_ROWS, html_table
from ..plan import nodes as p

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class ColumnKind:
    """What is known of a column before any value: its name and meaning. All tables of a message have the same kinds.

    `name` is the value's path in the record (`speed`, `position.0`, `servos.1.id`). `unit` is the sheet's. `names` maps
    the column's numbers to names (an enumeration), `flags` flag names to bit numbers. `is_object` says that values are
    Python objects: bytes, texts, and whatever has no fixed shape. `optional` says that values may be absent.
    """

    name: str
    unit: str = ""
    doc: str = ""
    names: Mapping[float, str] | None = None
    flags: Mapping[str, int] | None = None
    is_object: bool = False
    optional: bool = False


@dataclass(frozen=True)
class Column:
    """The values of one field.

    `values` is an array of length n: integers (unsigned or signed, of any width), float64, or objects. `absent` is a
    boolean array, True where the record has None (its value is then meaningless), or None when every value is there.
    """

    kind: ColumnKind
    values: Array
    absent: Array | None = None

    @property
    def name(self) -> str:
        """The value's path in the record."""
        return self.kind.name

    def __len__(self) -> int:
        return len(self.values)

    def to_list(self) -> list[Any]:
        """Return the values as records have them: names for numbers, None where absent; flags as plain numbers."""
        values: list[Any] = self.values.tolist()
        names = self.kind.names
        if names is not None:
            values = [
                names.get(value, value) if isinstance(value, (int, float)) else value for value in values
            ]
        if self.absent is not None:
            values = [
                None if gone else value for value, gone in zip(values, self.absent.tolist(), strict=True)
            ]
        return values

    def to_float(self) -> Array:
        """Return the values as float64, NaN where absent: for plots and arithmetic. Raises `TypeError` for texts and
        bytes.
        """
        if self.kind.is_object:
            out = np.full(len(self.values), np.nan)
            for index, value in enumerate(self.values.tolist()):
                if isinstance(value, (str, bytes, list, tuple, dict)):
                    raise TypeError(f"{self.name} holds {type(value).__name__}, not numbers")
                if value is not None:
                    out[index] = value
        else:
            out = self.values.astype(np.float64)
        if self.absent is not None:
            out[self.absent] = np.nan
        return out


def object_array(values: Sequence[Any]) -> Array:
    """Return an array of Python objects of any type."""
    array = np.empty(len(values), object)
    array[:] = values
    return array


class _Piece(Protocol):
    @property
    def values(self) -> Array: ...
    @property
    def absent(self) -> Array | None: ...


def join_pieces(pieces: Sequence[_Piece]) -> tuple[Array, Array | None]:
    """Return the values of several pieces of a column, and where they are absent (None: nowhere)."""
    absent: Array | None = None
    if any(piece.absent is not None for piece in pieces):
        absent = np.concatenate(
            [np.zeros(len(piece.values), bool) if piece.absent is None else piece.absent for piece in pieces]
        )
    return np.concatenate([piece.values for piece in pieces]), absent


def concat_columns(kind: ColumnKind, columns: Sequence[Column]) -> Column:
    """Join several columns."""
    return columns[0] if len(columns) == 1 else Column(kind, *join_pieces(columns))


@dataclass(frozen=True, repr=False)
class MessageTable:
    """The messages of one kind in a piece of a capture.

    `time`: int64, ns, `NO_TIME` where unknown. `channel`: number in `channels`. `key`: uint32, the CAN identifier with the
    flags of `aces_bus.frames`; of a stream int64, the packet's offset in bytes. `row`: int64, the frame's number in
    the capture from 0; of a stream the same as `key`. `rx`: uint8, 1 received, 0 sent, 2 not said.

    Columns are computed when asked for, and kept; `table["speed"]` raises `UnknownNameError` with the nearest name.
    """

    protocol: str
    message: str
    direction: str | None
    is_stream: bool
    time: Array
    channel: Array
    channels: Channels
    key: Array
    row: Array
    rx: Array
    kinds: tuple[ColumnKind, ...]
    make: Callable[[ColumnKind], Column]
    doc: str = ""
    #: Packet sizes in bytes (streams).
    size: Array | None = None
    #: Of packets that a transport carried: how many frames they came in, and the instant of the first one (ns).
    frames: Array | None = None
    first_time: Array | None = None
    _made: dict[str, Column] = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        return len(self.row)

    @cached_property
    def _by_name(self) -> dict[str, ColumnKind]:
        return {kind.name: kind for kind in self.kinds}

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the columns, in the order of the record's fields."""
        return tuple(kind.name for kind in self.kinds)

    def __getitem__(self, name: str) -> Column:
        if name not in self._made:
            if name not in self._by_name:
                raise UnknownNameError(f"column of {self.message}", str(name), self.names)
            self._made[name] = self.make(self._by_name[name])
        return self._made[name]

    def __repr__(self) -> str:
        names = ", ".join(self.names[:8]) + (", …" if len(self.names) > 8 else "")
        return f"<{self.protocol} {self.message}: {len(self)} rows of {len(self.names)} columns ({names})>"

    def _repr_html_(self) -> str:
        head = self.take(slice(MOST_ROWS))
        heads = [kind.name + (f" ({kind.unit})" if kind.unit else "") for kind in self.kinds]
        cells = [[str(value) for value in column.to_list()] for column in head.columns()]
        times = ["" if np.isnan(second) else f"{second:.6f}" for second in head.seconds]
        rows = list(zip(times, *cells, strict=True))
        return html_table(f"{self.protocol} {self.message}", ["time (s)", *heads], rows, len(self))

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def columns(self, names: Sequence[str] | None = None) -> Iterator[Column]:
        """Return the columns, all or those named."""
        return (self[name] for name in (self.names if names is None else names))

    def take(self, which: Any) -> MessageTable:
        """Return the lines `which`: an index array, a boolean array or a slice. Columns that are not computed yet stay
        so.
        """

        def make(kind: ColumnKind) -> Column:
            column = self[kind.name]
            return Column(kind, column.values[which], None if column.absent is None else column.absent[which])

        return MessageTable(
            self.protocol,
            self.message,
            self.direction,
            self.is_stream,
            self.time[which],
            self.channel[which],
            self.channels,
            self.key[which],
            self.row[which],
            self.rx[which],
            self.kinds,
            make,
            self.doc,
            None if self.size is None else self.size[which],
            None if self.frames is None else self.frames[which],
            None if self.first_time is None else self.first_time[which],
        )

    def plot(self, *columns: str) -> list[Axes]:
        """Draw columns over time, or all numbers: a pair of axes for each unit, which are returned from top to bottom.

        The figure is pyplot's; lines are broken where a value is absent and where messages pause for more than ten times
        their usual period. Raises `UnknownNameError` for a column that does not exist, `TypeError` for one of texts or
        bytes, `CallerError` where nothing is a number or matplotlib is not installed.
        """
        from .plot import plot_signals

        return plot_signals([(self, name) for name in columns or (None,)])

    @cached_property
    def seconds(self) -> Array:
        """Time as float64 seconds, NaN where unknown."""
        whole, rest = np.divmod(self.time, 1_000_000_000)
        seconds: Array = whole + rest / 1e9
        seconds[self.time == NO_TIME] = np.nan
        return seconds

    @classmethod
    def concat(cls, tables: Sequence[MessageTable], *, is_lazy: bool = False) -> MessageTable:
        """Join several tables of one message and capture, in order. All columns are computed, unless `is_lazy`."""
        first = tables[0]
        if len(tables) == 1:
            return first

        def make(kind: ColumnKind) -> Column:
            return concat_columns(kind, [table[kind.name] for table in tables])

        if is_lazy:
            take: Callable[[ColumnKind], Column] = make
        else:
            made = {kind.name: make(kind) for kind in first.kinds}
            take = lambda kind: made[kind.name]  # noqa: E731  (holds none of the parts)
        return cls(
            first.protocol,
            first.message,
            first.direction,
            first.is_stream,
            np.concatenate([t.time for t in tables]),
            np.concatenate([t.channel for t in tables]),
            first.channels,
            np.concatenate([t.key for t in tables]),
            np.concatenate([t.row for t in tables]),
            np.concatenate([t.rx for t in tables]),
            first.kinds,
            take,
            first.doc,
            _together([t.size for t in tables]),
            _together([t.frames for t in tables]),
            _together([t.first_time for t in tables]),
        )


def _together(parts: Sequence[Array | None]) -> Array | None:
    """Return columns of several tables as one; None where they have none."""
    some = [part for part in parts if part is not None]
    return np.concatenate(some) if len(some) == len(parts) else None


def by_message(tables: Iterable[MessageTable]) -> list[list[MessageTable]]:
    """Return the tables that have lines, those of a message together."""
    found: dict[tuple[str, str], list[MessageTable]] = {}
    for table in tables:
        if len(table):
            found.setdefault((table.protocol, table.message), []).append(table)
    return list(found.values())


#: The columns of the table of what was not decoded, named "" in `include_unknown` mode.
LOST = (
    ColumnKind("reason", doc="why it is not a message", is_object=True),
    ColumnKind("raw", doc="data bytes of the frame, or the bytes of the stream", is_object=True),
)


def lost_table(reasons: Array, raw: Callable[[], Array], **transport: Any) -> MessageTable:
    """Return what was not decoded, as a table; `raw` makes the bytes when they are asked for, `transport` are the
    other arrays.
    """

    def make(kind: ColumnKind) -> Column:
        return Column(kind, reasons if kind.name == "reason" else raw())

    return MessageTable(protocol="", message="", direction=None, kinds=LOST, make=make, **transport)


# ---------------------------------------------------------------------- packets as rows


#: The first n bytes of a little-endian word.
_MASKS = np.array([(1 << 8 * n) - 1 for n in range(9)], np.uint64)


def packet_rows(buffer: bytes, starts: Array, sizes: Array, width: int) -> Array:
    """Return the packets at `starts` as rows of `width` bytes."""
    missing = int(starts[-1]) + width - len(buffer)
    if missing > 0:
        buffer += bytes(missing)
    # One item of `width` bytes a packet: copied as a whole, whatever its alignment.
    items = np.ndarray(len(buffer) - width + 1, f"V{width}", buffer, strides=(1,))
    rows: Array = items[starts].view(np.uint8).reshape(-1, width)
    least, most = int(sizes.min()), int(sizes.max())
    if least < width:
        words = rows.view("<u8")
        for at in range(8 * (least // 8), width, 8):
            if at >= most:
                words[:, at // 8] = 0
            else:
                masks = _MASKS.take(np.clip(np.arange(most + 1) - at, 0, 8))
                words[:, at // 8] &= masks.take(sizes)
    return rows


def take_rows(rows: Array, which: Array) -> Array:
    """Return some of the rows, copied as wholes."""
    width = rows.shape[1]
    found: Array = rows.view(f"V{width}").ravel()[which].view(np.uint8).reshape(-1, width)
    return found


def cells_of(rows: Array, sizes: Array, start: int, size: int | None, tail: int) -> Array:
    """Return bytes of each packet as Python objects: `size` from `start`, or (None) all up to `tail` bytes
    before its end.

    Packets of one length are cut at once.
    """
    found = np.empty(len(rows), object)
    if size is not None:
        found[:] = _cells(rows, start, size)
        return found
    counts = np.bincount(sizes)
    for length in np.flatnonzero(counts).tolist():
        if int(counts[length]) == len(rows):
            found[:] = _cells(rows, start, length - tail - start)
        else:
            some = np.flatnonzero(sizes == length)
            found[some] = _cells(take_rows(rows, some), start, length - tail - start)
    return found


class ByteColumn(Column):
    """A column of bytes that are still where they were: objects are made when `values` is asked for, and kept.

    Made of rows, the sizes of their packets, and where in them the bytes stand (see `cells_of`).
    """

    def __init__(
        self, kind: ColumnKind, rows: Array, sizes: Array, start: int, size: int | None, tail: int
    ) -> None:
        put = object.__setattr__  # a frozen dataclass
        put(self, "kind", kind)
        put(self, "absent", None)
        put(self, "_where", (rows, sizes, start, size, tail))

    @cached_property
    def values(self) -> Array:  # pyright: ignore[reportIncompatibleVariableOverride]  # computed when asked for
        """Bytes objects."""
        where: tuple[Array, Array, int, int | None, int] = self.__dict__["_where"]
        return cells_of(*where)

    def __len__(self) -> int:
        return len(self.__dict__["_where"][1])


def _cells(rows: Array, start: int, size: int) -> Any:
    if size <= 0:
        return b""
    cells = np.ascontiguousarray(rows[:, start : start + size])
    return cells.view(f"V{size}").ravel().astype(object)


@lru_cache(maxsize=4096)
def kinds_of(plan: p.MessagePlan, raw: bool = False) -> tuple[ColumnKind, ...]:
    """Return what the columns of a message are, in the order of its fields."""
    return tuple(_kind(leaf, raw) for leaf in plan.columns)


def _kind(leaf: p.NodePath, raw: bool) -> ColumnKind:
    node, scale = leaf.node, leaf.node.scale
    optional = bool(leaf.whens) or leaf.kind is not None or node.may_be_none or leaf.field.node.may_be_none
    is_object = dtype_of(node, raw) is None
    if raw:
        return ColumnKind(leaf.path, "", leaf.field.doc, None, None, is_object, optional)
    optional = optional or (scale is not None and bool(scale.unknown))
    names = node.names_by_number or None
    return ColumnKind(leaf.path, node.unit, leaf.field.doc, names, node.flags or None, is_object, optional)


def dtype_of(node: p.Node, raw: bool = False) -> Any:
    """Return the dtype of a value's column: the narrowest that holds all that the record may show; None for Python
    objects.
    """
    form = node.number_format(raw=raw)
    return np.dtype(form) if form else None
