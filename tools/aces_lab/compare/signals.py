"""What the decoded messages of each device are like: how often they come, and which values their signals have.

1. A message of each device (what the protocol captures from the identifier, a servo's id) is a subject of its own.
2. Of a signal at most `MOST_VALUES` values are kept; of further ones the lowest, the highest, and that there were more.
3. A value that is absent counts as one where it means "not known", and not where other messages of the kind carry it.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from aces_bus.protocol import Variant
from aces_bus.protocol.columns.table import Array, Column, ColumnKind, MessageTable, kinds_of
from aces_tools.reading.device_columns import is_device_column
from aces_tools.reading.traffic import ArrivalCount, rows_of_each

#: Values of a signal that are kept one by one.
MOST_VALUES = 256
#: Messages × devices that have a profile.
MOST_SUBJECTS = 4096


class DeviceMessage(NamedTuple):
    """A message of one device: `("hubo", "Encoder", "can0", (("board", "3"),))`."""

    protocol: str
    message: str
    channel: str | None
    device: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        inside = ",".join(f"{name}={value}" for name, value in self.device)
        return self.message + (f"[{inside}]" if inside else "")


@dataclass
class ValueCount:
    """One value: how often it came, how often it began, and in which windows (a bit each)."""

    count: int = 0
    visits: int = 0
    windows: int = 0


@dataclass
class SignalValues:
    """The values of a signal on one side. `low` and `high` are of all numbers, whether their values are kept or not."""

    kind: ColumnKind
    count: int = 0
    changes: int = 0
    #: Changes to a higher value.
    rises: int = 0
    low: float | None = None
    high: float | None = None
    values: dict[Hashable, ValueCount] = field(default_factory=dict)
    is_more: bool = False
    _last: Any = None
    _is_begun: bool = False

    def add(self, values: Array, windows: Array) -> None:
        """Add values in order, numbers or objects, and the window of each."""
        if not len(values):
            return
        names: list[Hashable] | None = None
        if values.dtype == object:
            index: dict[Hashable, int] = {}
            texts = [value if isinstance(value, Hashable) else repr(value) for value in values.tolist()]
            values = np.fromiter((index.setdefault(text, len(index)) for text in texts), np.int64, len(texts))
            names = list(index)
            first, last = texts[0], texts[-1]
        else:
            first, last = values[0].item(), values[-1].item()
            low, high = values.min().item(), values.max().item()
            self.low = low if self.low is None else min(self.low, low)
            self.high = high if self.high is None else max(self.high, high)
            self.rises += int(np.count_nonzero(values[1:] > values[:-1]))
            self.rises += bool(self._is_begun and first > self._last)
        starts = np.flatnonzero(values[1:] != values[:-1]) + 1
        goes_on = self._is_begun and first == self._last
        self.changes += len(starts) + (self._is_begun and not goes_on)
        self.count += len(values)
        self._is_begun, self._last = True, last
        if not self.is_more:
            self._keep(values, windows, np.concatenate(([0], starts)), goes_on, names)

    def _keep(
        self, values: Array, windows: Array, starts: Array, goes_on: bool, names: list[Hashable] | None
    ) -> None:
        """Count each value; `starts` are the places where runs of equal ones begin, `names` what numbers stand for."""
        sizes = np.diff(np.append(starts, len(values)))
        distinct, inverse = np.unique(values[starts], return_inverse=True)
        visits = np.bincount(inverse, minlength=len(distinct))
        visits[inverse[0]] -= goes_on
        counts = np.bincount(inverse, sizes, len(distinct)).astype(np.int64)
        present = np.unique(windows).tolist()
        for place, value in enumerate(distinct.tolist()):
            key = value if names is None else names[value]
            if key not in self.values and len(self.values) >= MOST_VALUES:
                self.is_more = True
                return
            found = self.values.setdefault(key, ValueCount())
            found.count += int(counts[place])
            found.visits += int(visits[place])
            for window in present:
                if len(present) == 1 or (values[windows == window] == value).any():
                    found.windows |= 1 << window

    def add_absent(self, windows: Array) -> None:
        """Add messages in which the value is not known."""
        if len(windows):
            found = self.values.setdefault(None, ValueCount())
            self.count += len(windows)
            found.count += len(windows)
            found.visits += 1
            for window in np.unique(windows).tolist():
                found.windows |= 1 << window

    @property
    def is_monotone(self) -> bool:
        """True if the value only rises or only falls, as a clock or an odometer does."""
        return self.changes >= 4 and self.rises in (0, self.changes)

    def text(self, value: Any) -> str:
        """Return a value in words."""
        if value is None:
            return "none"
        if isinstance(value, (int, float)) and self.kind.names is not None and value in self.kind.names:
            return self.kind.names[value]
        if isinstance(value, bytes):
            return value.hex(" ").upper() or "empty"
        return f"{value:.6g}" if isinstance(value, float) else str(value)


class MessageTraffic(ArrivalCount):
    """A message of one device on one side."""

    def __init__(self, subject: DeviceMessage, kinds: Mapping[str, ColumnKind]) -> None:
        super().__init__()
        self.subject = subject
        self.signals = {name: SignalValues(kind) for name, kind in kinds.items()}


@dataclass(frozen=True)
class _Layout:
    """The columns of a message: those of its devices, and those that are compared."""

    devices: tuple[str, ...]
    signals: Mapping[str, ColumnKind]
    #: Signals that other messages of the kind carry: their absence says nothing.
    conditional: frozenset[str]


class MessageProfile:
    """The messages of one side."""

    def __init__(self, variants: Sequence[Variant]) -> None:
        self.frames = 0
        self.beyond = 0
        self.subjects: dict[DeviceMessage, MessageTraffic] = {}
        self._variants = {variant.name: variant for variant in variants}
        self._layouts: dict[tuple[str, str], _Layout] = {}

    def add(self, table: MessageTable, windows: Array) -> None:
        """Add decoded messages; `windows` has the window of each message, -1 where it is in none."""
        if not (windows >= 0).all():
            rows = np.flatnonzero(windows >= 0)
            table, windows = table.take(rows), windows[rows]
        if not len(table):
            return
        self.frames += len(table)
        layout = self._layout(table)
        for subject, rows in _devices(table, layout.devices):
            found = self.subjects.get(subject)
            if found is None:
                if len(self.subjects) >= MOST_SUBJECTS:
                    self.beyond += len(rows)
                    continue
                found = self.subjects[subject] = MessageTraffic(subject, layout.signals)
            found.arrive(table.time[rows], windows[rows])
            for name, signal in found.signals.items():
                _take(signal, table, rows, windows[rows], is_conditional=name in layout.conditional)

    def _layout(self, table: MessageTable) -> _Layout:
        key = table.protocol, table.message
        if key not in self._layouts:
            plan = self._variants[table.protocol].messages[table.message].plan
            leaves = plan.columns
            devices = tuple(leaf.path for leaf in leaves if is_device_column(leaf))
            signals: dict[str, ColumnKind] = {}
            conditional: set[str] = set()
            for kind, leaf in zip(kinds_of(plan), leaves, strict=True):
                if leaf.path in devices:
                    continue
                if leaf.whens or leaf.is_inside:
                    conditional |= {kind.name, *(f"{kind.name}.{flag}" for flag in kind.flags or ())}
                if kind.flags:
                    signals |= {
                        f"{kind.name}.{flag}": ColumnKind(kind.name, flags={flag: bit})
                        for flag, bit in kind.flags.items()
                    }
                else:
                    signals[kind.name] = kind
            self._layouts[key] = _Layout(devices, signals, frozenset(conditional))
        return self._layouts[key]


def _take(
    signal: SignalValues, table: MessageTable, rows: Array, windows: Array, *, is_conditional: bool
) -> None:
    column = table[signal.kind.name]
    values = column.values[rows]
    if signal.kind.flags:
        (bit,) = signal.kind.flags.values()
        if values.dtype == object:
            values = np.array([0 if v is None else int(v) >> bit & 1 for v in values.tolist()], np.uint8)
        else:
            values = (values.astype(np.int64) >> bit & 1).astype(np.uint8)
    there = _there(column, values, rows)
    if not there.all():
        if not is_conditional:
            signal.add_absent(windows[~there])
        values, windows = values[there], windows[there]
    signal.add(values, windows)


def _there(column: Column, values: Array, rows: Array) -> Array:
    there: Array = np.ones(len(values), bool) if column.absent is None else ~column.absent[rows]
    if values.dtype.kind == "f":
        there = there & ~np.isnan(values)
    return there


def _devices(table: MessageTable, names: Sequence[str]) -> Iterator[tuple[DeviceMessage, Array]]:
    """Yield the rows of each device on each channel, in order."""
    columns: list[Array] = [table.channel, *(_codes(table[name]) for name in names)]
    code = np.zeros(len(table), np.int64)
    for column in columns:
        _, inverse = np.unique(column, return_inverse=True)
        code = np.unique(code * (int(inverse.max()) + 1) + inverse, return_inverse=True)[1]
    shown = {name: table[name] for name in names}
    for rows in rows_of_each(code):
        first = int(rows[0])
        device = tuple((name, str(_one(column, first))) for name, column in shown.items())
        channel = table.channels.names[int(table.channel[first])]
        yield DeviceMessage(table.protocol, table.message, channel, device), rows


def _codes(column: Column) -> Array:
    if column.kind.is_object or column.absent is not None:
        return np.array([str(value) for value in column.to_list()])
    return column.values


def _one(column: Column, row: int) -> Any:
    if column.absent is not None and column.absent[row]:
        return None
    value = column.values[row : row + 1].tolist()[0]
    return (column.kind.names or {}).get(value, value)
