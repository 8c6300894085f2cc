"""What the fields of decoded messages say: values without names, beyond their range, that never change, that jump.

1. Values are raw, as on the wire; whatever scale, name or range the spec gives them is what they are held against.
2. Of what occurs a field keeps counts, a few values, and the first instant of each kind: memory is bounded.
3. Values follow each other by device: same channel, same identifier, same captured fields.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterator, Sequence
from itertools import pairwise
from typing import Any
from zlib import crc32

import numpy as np
from construct import Array as ArrayOf
from construct import GreedyRange

from ..columns.table import Array, Column, MessageTable
from ..declare.fields import Counter, text_until
from ..declare.message import Message
from ..declare.normalise import sizes
from ..lint.finding import Level
from ..plan import nodes as p
from .bit_order import BitOrder
from .finding import Moment, Observation
from .numbers import IntegerSteps, Suspicion, steps_of

#: Devices of a message whose values are followed; of further ones only the values themselves are judged.
DEVICES = 256
#: Values without a name that are listed.
UNNAMED = 8
#: What occurs so often, and in this share of all messages, is not an accident.
AGAIN, SHARE = 3, 0.02
#: Messages from which on it means something that a field never changes.
ENOUGH = 20

#: Names of fields that say how long something is.
_SIZE = re.compile(r"size|len", re.IGNORECASE)
#: Characters that no text has: control characters, but for tabs and ends of lines.
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]")

#: From a row of a table to its place in the recording.
Locate = Callable[[MessageTable, int], Moment]


class _Found:
    """How often something was seen, and where first."""

    def __init__(self) -> None:
        self.count = 0
        self.first: Moment | None = None

    def add(self, which: Array, table: MessageTable, locate: Locate) -> None:
        """Count the rows `which` (indices), if there are any."""
        if len(which):
            self.count += len(which)
            if self.first is None:
                self.first = locate(table, int(which[0]))


class _Followed:
    """The rows of a table in the order of devices, so that neighbours are one device's."""

    def __init__(self, devices: Array) -> None:
        self.order = np.argsort(devices, kind="stable")
        ordered = devices[self.order]
        self.same = (ordered[1:] == ordered[:-1]) & (ordered[1:] >= 0)
        starts = np.flatnonzero(np.diff(ordered, prepend=np.int64(-2))).tolist()
        #: (device, first and last of its rows in that order)
        self.runs: list[tuple[int, int, int]] = [
            (int(ordered[start]), start, end - 1)
            for start, end in pairwise([*starts, len(ordered)])
            if ordered[start] >= 0
        ]

    def pairs(self, values: Array, last: dict[int, Any]) -> tuple[Array, Array]:
        """Return (before, after) of all values that follow each other; `last` has each device's value before these."""
        values = values[self.order]
        before, after = values[:-1][self.same], values[1:][self.same]
        carried = [(last[device], values[start]) for device, start, _ in self.runs if device in last]
        for device, _, end in self.runs:
            last[device] = values[end]
        if carried:
            old, new = zip(*carried, strict=True)
            before = np.concatenate([before, np.array(old, values.dtype)])
            after = np.concatenate([after, np.array(new, values.dtype)])
        return before, after


class FieldWatch:
    """One single value of a message."""

    def __init__(self, message: Message, leaf: p.NodePath) -> None:
        self.message = message
        self.leaf = leaf
        self.steps = steps_of(leaf.node)
        self.is_unnamed = leaf.node.is_unclaimed
        self.total = 0
        self._first_value: Any = None
        self._changes = False
        #: Bits that are not always the same; of numbers without places none.
        self._varying = 0
        self._vary = _Found()
        self._last: dict[int, Any] = {}
        self._beyond = _Found()
        #: Texts with characters that are none.
        self.is_text = getattr(leaf.node, "kind", "") == "text"
        self._odd = _Found()
        self._least, self._most = np.inf, -np.inf
        self._unnamed: dict[int, _Found] = {}
        node = leaf.node
        scale = node.scale
        self._limits = scale.limits if scale is not None else None
        self._exempt = [*scale.unknown, *(raw for raw, _ in scale.names)] if scale is not None else []
        self._names = node.enumerated

    def take(
        self, column: Column, table: MessageTable, devices: Array, locate: Locate, shared: _Followed
    ) -> None:
        """Take a field's values of a piece of the recording; `shared` is for columns that every row has."""
        values, rows = column.values, None
        if column.absent is not None:
            rows = np.flatnonzero(~column.absent)
            values = values[rows]
        if not len(values):
            return
        if values.dtype == object:
            self._take_objects(values, rows, table, locate)
            return
        self.total += len(values)
        if self._first_value is None:
            self._first_value = values[0]
        others = values != self._first_value
        if others.any():
            self._changes = True
            if values.dtype.kind in "iu":
                flipped = int(np.bitwise_or.reduce(values[others] ^ values.dtype.type(self._first_value)))
                self._varying |= flipped
                if self.is_unnamed:
                    which = np.flatnonzero(others)
                    self._vary.add(which if rows is None else rows[which], table, locate)
        self._judge(values, rows, table, locate)
        if self.steps is not None:
            followed = shared if rows is None else _Followed(devices[rows])
            self.steps.take(values, *followed.pairs(values, self._last))

    def _take_objects(self, values: Array, rows: Array | None, table: MessageTable, locate: Locate) -> None:
        self.total += len(values)
        if self.is_unnamed:
            first = values[0] if self._first_value is None else self._first_value
            others = [n for n, value in enumerate(values.tolist()) if value != first]
            for n in others:
                self._varying |= values[n] ^ first
            which = np.array(others, np.int64)
            self._vary.add(which if rows is None else rows[which], table, locate)
        if self.is_text:
            ends = getattr(self.leaf.node, "ends", "")
            odd = [n for n, value in enumerate(values.tolist()) if _CONTROL.search(_text_of(value, ends))]
            which = np.array(odd, np.int64)
            self._odd.add(which if rows is None else rows[which], table, locate)
        if not self._changes:
            if self._first_value is None:
                self._first_value = values[0]
            self._changes = any(value != self._first_value for value in values.tolist())

    def _judge(self, values: Array, rows: Array | None, table: MessageTable, locate: Locate) -> None:
        scale = self.leaf.node.scale
        if self._limits is not None and scale is not None:
            low, high = self._limits
            physical = values.astype(np.float64) * scale.scale + scale.offset
            slack = abs(scale.scale) / 2
            with np.errstate(invalid="ignore"):
                beyond = (physical < low - slack) | (physical > high + slack)
            if self._exempt:
                beyond &= ~np.isin(values, self._exempt)
            if beyond.any():
                which = np.flatnonzero(beyond)
                self._least = min(self._least, float(physical[which].min()))
                self._most = max(self._most, float(physical[which].max()))
                self._beyond.add(which if rows is None else rows[which], table, locate)
        if self._names:
            foreign = ~np.isin(values, self._names)
            for value in np.unique(values[foreign])[:UNNAMED].tolist() if foreign.any() else ():
                if value in self._unnamed or len(self._unnamed) < UNNAMED:
                    which = np.flatnonzero(values == value)
                    found = self._unnamed.setdefault(value, _Found())
                    found.add(which if rows is None else rows[which], table, locate)

    # ------------------------------------------------------------------ what it comes to

    @property
    def never_changes(self) -> bool:
        """True if there were enough messages, and all had one value."""
        return self.total >= ENOUGH and not self._changes

    @property
    def value(self) -> Any:
        """The first value."""
        return self._first_value

    def observations(self) -> Iterator[Observation]:
        """Yield what the recording says of this field."""
        name = f"{self.message.name}.{self.leaf.path}"
        if self.is_unnamed:
            yield from self._of_unnamed_bits()
            return
        if self._beyond.count and self._limits is not None:
            low, high = self._limits
            yield self._observation(
                "warning" if self._beyond.count >= min(AGAIN, self.total) else "note",
                "range",
                f"{name} is {_span(self._least, self._most)}{self._unit} in {self._beyond.count} of {self.total} messages;"
                f" its range is {low:g}…{high:g}",
                self._beyond,
                "check sign, scale and byte order; if they are right, widen the range",
            )
        if self._odd.count >= max(AGAIN, SHARE * self.total):
            yield self._observation(
                "warning",
                "text",
                f"{name} has control characters in {self._odd.count} of {self.total} messages: it is no text, or not there",
                self._odd,
                "check where it begins; if they are right, read it as Bytes",
            )
        if self._unnamed:
            values = ", ".join(map(str, sorted(self._unnamed)))
            whole = _Found()
            whole.count = sum(found.count for found in self._unnamed.values())
            whole.first = next(iter(self._unnamed.values())).first
            yield self._observation(
                "warning" if whole.count >= max(AGAIN, SHARE * self.total) else "note",
                "enumeration",
                f"{name} is {values} in {whole.count} of {self.total} messages, which has no name",
                whole,
                f"give {'it' if len(self._unnamed) == 1 else 'them'} a name, or check where the field is",
            )
        suspicion = self.steps.suspicion() if self.steps is not None else None
        if suspicion is not None:
            yield self._of_suspicion(name, suspicion)
        elif self.counts_up:
            whole = _Found()
            whole.count = self.total
            wraps = isinstance(self.steps, IntegerSteps) and self.steps.wraps
            yield self._observation(
                "warning" if wraps else "note",
                "counter",
                f"{name} counts up by one from message to message{', and begins anew' if wraps else ''}",
                whole,
                "if it is a rolling counter, declare it as Counter: then missing messages are counted",
            )

    @property
    def counts_up(self) -> bool:
        """True if the field is a counter that the spec does not name."""
        node = self.leaf.node
        return (
            isinstance(self.steps, IntegerSteps)
            and self.steps.counts_up
            and not node.unit
            and self.leaf.path not in self.message.counters
            and not any(isinstance(h.field, Counter) and h.name == self.leaf.path for h in self.message.heads)
        )

    def _of_suspicion(self, name: str, suspicion: Suspicion) -> Observation:
        whole = _Found()
        whole.count = suspicion.count
        rule = "byte-order" if suspicion.remedy.startswith("read it") else "sign"
        return self._observation(
            "warning", rule, f"{name} {suspicion.text}", whole, suspicion.remedy, total=suspicion.total
        )

    def _of_unnamed_bits(self) -> Iterator[Observation]:
        places = self.leaf.node.value_bits
        bits = [places[bit] for bit in range(self._varying.bit_length()) if self._varying >> bit & 1]
        if not bits:
            return
        shown = ", ".join(f"{bit // 8}.{bit % 8}" for bit in bits[:8]) + (", …" if len(bits) > 8 else "")
        yield self._observation(
            "warning",
            "gap",
            f"{self.message.name}: {'bit' if len(bits) == 1 else 'bits'} {shown} (byte.bit) belong to no field, and change:"
            f" {self._vary.count} of {self.total} messages",
            self._vary,
            "declare the field that they are, or make its neighbour longer",
        )

    @property
    def _unit(self) -> str:
        unit = self.leaf.node.unit
        return f" {unit}" if unit else ""

    def _observation(
        self, level: Level, rule: str, text: str, found: _Found, remedy: str, *, total: int | None = None
    ) -> Observation:
        place = self.message.place.of_field(self.leaf.field.name)
        if found.first is not None:
            text = f"{text}; first at {found.first}"
        return Observation(
            level,
            rule,
            place,
            text,
            self.message.name,
            count=found.count,
            total=self.total if total is None else total,
            first=found.first,
            remedy=remedy,
        )


def _items_of(message: Message) -> Sequence[Any]:
    found: Sequence[Any] = getattr(message.payload, "subcons", ())
    return found


def _counts(values: Array) -> bool:
    """Return whether almost every value is the next number: a counter of the header, which tells no devices apart."""
    if len(values) < ENOUGH or values.dtype.kind not in "iu":
        return False
    steps = np.diff(values.astype(np.int64))
    return bool(((steps == 1) | (steps < 0) & (values[1:] == 0)).mean() >= 0.95)


def _text_of(value: Any, ends: str) -> str:
    """Return a raw text without its padding."""
    return text_until(value.decode("latin-1") if isinstance(value, bytes) else str(value), ends)


def _span(least: float, most: float) -> str:
    return f"{least:g}" if least == most else f"{least:g}…{most:g}"


class MessageWatch:
    """A message's fields, and which way it went."""

    def __init__(self, message: Message) -> None:
        self.message = message
        self.total = 0
        #: Frames that the recorder received, and that it sent.
        self.received = self.sent = 0
        self.first: Moment | None = None
        leaves = (message.plan.all_fields or message.plan).leaves
        self.fields = [FieldWatch(message, leaf) for leaf in leaves]
        self._bit_order = BitOrder(message)
        masks = {getattr(getattr(item, "subcon", item), "selector", None) for item in _items_of(message)}
        outer = message.outer_names - masks
        #: What tells one device from another, and one quantity from another.
        self._telling = [
            field.leaf.path
            for field in self.fields
            if field.leaf.path in outer or field.leaf.node.is_of_request or field.leaf.node.value_names
        ]
        self._devices: dict[tuple[Hashable, ...], int] = {}

    def take(self, table: MessageTable, locate: Locate) -> None:
        """Take the messages of a piece of the recording."""
        if self.first is None:
            self.first = locate(table, 0)
            self._telling = [name for name in self._telling if not _counts(table[name].values)]
        self.total += len(table)
        self.received += int((table.rx == 1).sum())
        self.sent += int((table.rx == 0).sum())
        devices = self._devices_of(table)
        shared = _Followed(devices)
        for field in self.fields:
            field.take(table[field.leaf.path], table, devices, locate, shared)
        self._bit_order.take(table, shared)

    def _devices_of(self, table: MessageTable) -> Array:
        """Return the device of each row, numbered; −1 beyond `DEVICES`."""
        parts: list[Array] = [table.channel.astype(np.int64)]
        if not table.is_stream:
            parts.append(table.key.astype(np.int64))
        for name in self._telling:
            column = table[name]
            numbers = column.values
            if numbers.dtype == object:
                texts = (crc32(repr(value).encode()) for value in numbers.tolist())
                numbers = np.fromiter(texts, np.int64, len(numbers))
            parts.append(numbers.astype(np.int64))
        unique, inverse = np.unique(np.stack(parts, axis=1), axis=0, return_inverse=True)
        numbers_of: list[int] = []
        for row in unique.tolist():
            who = tuple(row)
            if who not in self._devices and len(self._devices) < DEVICES:
                self._devices[who] = len(self._devices)
            numbers_of.append(self._devices.get(who, -1))
        found: Array = np.array(numbers_of, np.int64)[inverse.ravel()]
        return found

    def observations(self) -> Iterator[Observation]:
        """Yield what the recording says of this message's fields."""
        for field in self.fields:
            yield from field.observations()
        if (smoother := self._bit_order.smoother()) is not None:
            better, moving = smoother
            yield Observation(
                "warning",
                "bit-order",
                self.message.place,
                f"{self.message.name}: {better} of {moving} numbers that begin or end inside a byte move smoothly only"
                " in the other order of bits",
                self.message.name,
                count=better,
                total=moving,
                first=self.first,
                remedy='order="msb" in its BitLayout, or without it "lsb"',
            )
        yield from self._of_group_sizes()
        outer = self.message.outer_names
        still = [
            field
            for field in self.fields
            if field.never_changes and not field.leaf.node.is_quiet and field.leaf.path not in outer
        ]
        never = [field for field in self.fields if self.total >= ENOUGH and not field.total]
        if still:
            shown = ", ".join(f"{field.leaf.path} ({_shown(field.value)})" for field in still[:8])
            more = f" and {len(still) - 8} more" if len(still) > 8 else ""
            yield self._note(
                "constant",
                f"never changes in {self.total} messages: {shown}{more}",
                "record longer, or move the device",
            )
        if never:
            shown = ", ".join(field.leaf.path for field in never[:8]) + (", …" if len(never) > 8 else "")
            yield self._note(
                "unseen", f"never there in {self.total} messages: {shown}", "check what selects them"
            )

    def _of_group_sizes(self) -> Iterator[Observation]:
        """Yield fields that say how long the groups of a list are, and by which they are not read: later ones may be
        longer.
        """
        watched = {field.leaf.path: field for field in self.fields if _SIZE.search(field.leaf.path)}
        for item in _items_of(self.message) if watched else ():
            body = getattr(item, "subcon", item)
            if not isinstance(body, (ArrayOf, GreedyRange)) or isinstance(getattr(body, "count", None), int):
                continue
            least, most = sizes(body.subcon)
            for name, field in watched.items():
                if field.never_changes and field.value == least == most and f"['{name}']" not in repr(body):
                    yield Observation(
                        "warning",
                        "size",
                        self.message.place.of_field(name),
                        f"{self.message.name}.{name} is {field.value} in all {field.total} messages, the bytes of each of"
                        f" {item.name}, which are read without it",
                        self.message.name,
                        total=field.total,
                        first=self.first,
                        remedy=f"end each with what it has beyond: Bytes(this._.{name} - {field.value})",
                    )

    def _note(self, rule: str, text: str, remedy: str) -> Observation:
        message = self.message
        return Observation(
            "note", rule, message.place, f"{message.name}: {text}", message.name, total=self.total, first=self.first,
            remedy=remedy,
        )  # fmt: skip


def _shown(value: Any) -> str:
    return value.hex(" ").upper() or "no bytes" if isinstance(value, bytes) else str(value)[:40]
