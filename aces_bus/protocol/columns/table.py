"""Decoded messages as columns: one table a message.

1. A column holds raw numbers where they have names or flags (the names come with it), physical values where they have a
   scale. `to_list` gives what records show, value for value.
2. Tables are slices of a capture, in its order; `row` says which frame or packet of the capture each line was.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ...frame_table import NO_TIME, Channels

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
        """The values as records have them: names for numbers, None where absent; flags as plain numbers."""
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
        """The values as float64, NaN where absent: for plots and arithmetic. Raises `TypeError` for texts and bytes."""
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


@dataclass(frozen=True)
class MessageTable:
    """The messages of one kind in a piece of a capture.

    `time`: int64, ns, `NO_TIME` where unknown. `channel`: number in `channels`. `key`: uint32, the CAN identifier with the
    flags of `aces_bus.protocol.keys`; of a stream int64, the packet's offset in bytes. `row`: int64, the frame's number in
    the capture from 0; of a stream the same as `key`. `rx`: uint8, 1 received, 0 sent, 2 not said.

    Columns are computed when asked for, and kept.
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
            self._made[name] = self.make(self._by_name[name])
        return self._made[name]

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def columns(self, names: Sequence[str] | None = None) -> Iterator[Column]:
        """The columns, all or those named."""
        return (self[name] for name in (self.names if names is None else names))

    def take(self, which: Any) -> MessageTable:
        """The lines `which`: an index array, a boolean array or a slice. Columns that are not computed yet stay so."""

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
        )

    @cached_property
    def seconds(self) -> Array:
        """Time as float64 seconds, NaN where unknown."""
        whole, rest = np.divmod(self.time, 1_000_000_000)
        seconds: Array = whole + rest / 1e9
        seconds[self.time == NO_TIME] = np.nan
        return seconds

    @classmethod
    def concat(cls, tables: Sequence[MessageTable]) -> MessageTable:
        """One table of several of the same message and capture, in order. All columns are computed."""
        first = tables[0]
        if len(tables) == 1:
            return first
        made: dict[str, Column] = {}
        for kind in first.kinds:
            columns = [table[kind.name] for table in tables]
            absent = None
            if any(column.absent is not None for column in columns):
                absent = np.concatenate(
                    [c.absent if c.absent is not None else np.zeros(len(c), bool) for c in columns]
                )
            made[kind.name] = Column(kind, np.concatenate([c.values for c in columns]), absent)
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
            lambda kind: made[kind.name],
            first.doc,
            None if first.size is None else np.concatenate([t.size for t in tables if t.size is not None]),
        )
