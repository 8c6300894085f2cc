"""Draws raw values of constructs by walking their tree.

1. A construct that the walk does not know is drawn as bytes that it parses: slower, and never wrong.
2. Each message's walk is compiled once into closures: a wire of a hundred packets asks no `isinstance`.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import construct as c
from construct import Construct, Container

from ..errors import AcesError, FieldError
from ..protocol.declare.bits import FLOATS, BitLayout, Bits, LayoutSlot
from ..protocol.declare.delimited import (
    AsciiDegrees,
    AsciiEnumeration,
    AsciiField,
    AsciiInteger,
    AsciiNumber,
    Delimited,
)
from ..protocol.declare.fields import Enumeration, Field, Multiplexed, SignMagnitude, Text
from ..protocol.declare.items import Items
from ..protocol.declare.message import Message
from ..protocol.declare.normalise import sizes
from ..protocol.declare.stuffing import CutZeros
from ..protocol.record import FieldValue
from .hints import Hints, hints, is_integer
from .source import ChoiceSource, edge_number, spread

#: How many times bytes are tried that a construct may read.
ATTEMPTS = 60


@dataclass
class Room:
    """How many bytes are left for what has no size of its own; `is_exact` when they must all be used."""

    left: int
    is_exact: bool


Draw = Callable[[ChoiceSource, Container, Room], Any]


# ---------------------------------------------------------------------- the walk


@lru_cache(maxsize=4096)
def drawer(message: Message) -> Draw:
    return _Walk(hints(message), message).of(message.payload)


class _Walk:
    """Compiles constructs into functions that draw their raw values."""

    def __init__(self, hints: Hints, message: Message) -> None:
        self.hints = hints
        self.message = message

    def of(self, con: Any) -> Draw:
        """Return the function that draws values of `con`."""
        while isinstance(con, (c.Renamed, c.Default, c.Hex, c.HexDump)):
            con = con.subcon
        if isinstance(con, SignMagnitude):
            limit = con.limit
            return lambda source, ctx, room: edge_number(source, -limit, limit)
        if isinstance(con, Enumeration):
            return self._enumeration(con)
        if isinstance(con, Field):
            return self.of(con.subcon)
        for kind, method in self._TABLE:
            if isinstance(con, kind):
                return method(self, con)
        return self._parsed(con)

    def _hinted(self, name: str, otherwise: Draw) -> Draw:
        """Draw small numbers often for fields that decide about others, so that these exist and are few."""
        values, is_small = self.hints.values.get(name), name in self.hints.small
        if values is None and not is_small:
            return otherwise

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            if values is not None and source.integer(0, 3):
                return source.choice(values)
            if is_small:
                return source.integer(0, 6 if source.integer(0, 7) else 40)
            return otherwise(source, ctx, room)

        return draw

    # -------------------------------------------------- single values

    def _enumeration(self, con: Enumeration) -> Draw:
        known, any_value = sorted(con.values), self.of(con.subcon)

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            return source.choice(known) if known and source.integer(0, 3) else any_value(source, ctx, room)

        return draw

    def _format(self, con: c.FormatField) -> Draw:
        kind, size = con.fmtstr[-1:], con.length
        if kind in "efd":
            return _float(kind)
        low = -(1 << 8 * size - 1) if kind.islower() else 0
        high = low + (1 << 8 * size) - 1
        return lambda source, ctx, room: edge_number(source, low, high)

    def _integer(self, con: c.BytesInteger) -> Draw:
        def draw(source: ChoiceSource, ctx: Container, room: Room) -> int:
            width = 8 * _asked(con.length, ctx)
            low = -(1 << width - 1) if con.signed and width else 0
            return edge_number(source, low, low + (1 << width) - 1)

        return draw

    def _bits(self, con: Bits) -> Draw:
        if con.is_float:
            return _float(FLOATS[con.width][-1:])
        low = -(1 << con.width - 1) if con.signed else 0
        high = low + (1 << con.width) - 1
        return lambda source, ctx, room: edge_number(source, low, high)

    def _const(self, con: c.Const) -> Draw:
        value = con.value
        return lambda source, ctx, room: value

    def _nothing(self, con: Construct) -> Draw:
        return lambda source, ctx, room: None

    def _varint(self, con: Construct) -> Draw:
        signed = con is c.ZigZag

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> int:
            high = (1 << source.choice((3, 7, 14, 31))) - 1
            return edge_number(source, -high if signed else 0, high)

        return draw

    def _text(self, con: Construct) -> Draw:
        try:
            most = int(con.sizeof())
        except c.ConstructError:
            most = 8

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> str:
            return "".join(
                chr(65 + b % 26) for b in source.bytes(source.integer(0, min(most, 8, max(0, room.left - 1))))
            )

        return draw

    def _mapping(self, con: Any) -> Draw:
        values = list(con.decmapping.values())
        return lambda source, ctx, room: source.choice(values)

    # -------------------------------------------------- runs of bytes

    def _some(self, source: ChoiceSource, room: Room) -> int:
        if room.is_exact:
            return max(0, room.left)
        return source.integer(0, max(0, min(room.left, 8) if source.integer(0, 3) else room.left))

    def _bytes(self, con: c.Bytes) -> Draw:
        def draw(source: ChoiceSource, ctx: Container, room: Room) -> bytes:
            try:
                length = int(_asked(con.length, ctx))
            except (
                KeyError,
                AttributeError,
                TypeError,
            ):  # of a number that is rebuilt from what is drawn here
                length = self._some(source, room)
            return _content(source, max(0, length), self.message)

        return draw

    def _greedy(self, con: Construct) -> Draw:
        return lambda source, ctx, room: _content(source, self._some(source, room), self.message)

    # -------------------------------------------------- several values

    def _struct(self, con: c.Struct) -> Draw:
        items = []
        for item in con.subcons:
            body = item.subcon if isinstance(item, c.Renamed) else item
            low, high = sizes(item)
            draw_inner = self.of(item)
            if is_integer(body) and (item.name in self.hints.values or item.name in self.hints.small):
                draw_inner = self._hinted(item.name, draw_inner)
            items.append((item.name, body, draw_inner, low, high, isinstance(body, c.Rebuild)))
        least = sum(item[3] for item in items)

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            inner = c.Container(
                _=ctx, _params=ctx._params, _root=None, _parsing=False, _building=True, _sizing=False
            )
            values = c.Container()
            left = room.left - least
            for name, body, item, low, high, is_rebuilt in items:
                if is_rebuilt:
                    continue
                value = item(source, inner, Room(left + low, room.is_exact))
                if low != high:
                    left -= _measure(body, value, inner) - low
                if name is not None:
                    values[name] = inner[name] = value
            return values

        return draw

    def _array(self, con: c.Array) -> Draw:
        draw_inner, (low, _) = self.of(con.subcon), sizes(con.subcon)

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            try:
                count = int(_asked(con.count, ctx))
            except (KeyError, AttributeError, TypeError):  # a count that is rebuilt from what is drawn here
                count = source.integer(0, 5)
            if callable(con.count) and low * count > max(0, room.left) + 256:
                raise FieldError(f"{count} items do not fit into {room.left} bytes")
            space = Room(room.left // max(1, count), False)
            return c.ListContainer(draw_inner(source, ctx, space) for _ in range(count))

        return draw

    def _range(self, con: Construct) -> Draw:
        draw_inner, (low, high) = self.of(con.subcon), sizes(con.subcon)

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            items = c.ListContainer()
            if low == high and low:
                most = max(0, room.left) // low
                count = (
                    most
                    if room.is_exact
                    else source.integer(0, min(most, 4) if source.integer(0, 3) else most)
                )
                items.extend(draw_inner(source, ctx, Room(low, True)) for _ in range(count))
                return items
            left = room.left
            for _ in range(source.integer(0, 4)):
                item = draw_inner(source, ctx, Room(left, False))
                left -= max(1, _measure(con.subcon, item, ctx))
                if left < 0:
                    break
                items.append(item)
            return items

        return draw

    def _multiplexed(self, con: Multiplexed) -> Draw:
        draw_inner = self.of(con.body)
        return lambda source, ctx, room: draw_inner(source, ctx, room) if con.is_present(ctx) else None

    def _branch(self, con: c.IfThenElse) -> Draw:
        yes, no = self.of(con.thensubcon), self.of(con.elsesubcon)

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            holds = _asked(con.condfunc, ctx)
            return (yes if holds else no)(source, ctx, room)

        return draw

    def _switch(self, con: c.Switch) -> Draw:
        cases = {key: self.of(case) for key, case in con.cases.items()}
        other = self.of(con.default)

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            key = _asked(con.keyfunc, ctx)
            return cases.get(key, other)(source, ctx, room)

        return draw

    def _prefixed(self, con: Construct) -> Draw:
        draw_inner = self.of(con.subcon)
        return lambda source, ctx, room: draw_inner(source, ctx, Room(max(0, min(room.left - 1, 24)), False))

    def _terminated(self, con: c.NullTerminated) -> Draw:
        mark: bytes = con.term

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> bytes:
            return source.bytes(source.integer(0, max(0, min(room.left - len(mark), 8)))).replace(
                mark[:1], b""
            )

        inner = con.subcon
        while isinstance(inner, c.Subconstruct) and (
            isinstance(inner, Text) or not isinstance(inner, c.Adapter)
        ):
            inner = inner.subcon
        return draw if inner is c.GreedyBytes else self._parsed(con)

    def _sequence(self, con: c.FocusedSeq) -> Draw:
        """Draw a `PrefixedArray`: a count that is rebuilt, and an array of that size."""
        inner = con.subcons[-1]
        inner = inner.subcon if isinstance(inner, c.Renamed) else inner
        if not isinstance(inner, c.Array):
            return self._parsed(con)
        draw_inner, (low, _) = self.of(inner.subcon), sizes(inner.subcon)

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            most = max(0, room.left - 1) // max(1, low)
            count = source.integer(0, min(4, most))
            return c.ListContainer(
                draw_inner(source, ctx, Room(room.left // max(1, count), False)) for _ in range(count)
            )

        return draw

    def _items(self, con: Any) -> Draw:
        """Return a list as it is read: good items of all kinds, unknown ones, and bytes that are none."""
        kinds = [(con.numbers[name], self.of(data)) for name, data in con.data.items()]

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            data, left = b"", max(0, room.left)
            for _ in range(source.integer(0, 5)):
                number, draw_inner = source.choice(kinds)
                value = draw_inner(source, ctx, Room(max(0, min(left - con.head, 24)), False))
                if con.size is not None and source.integer(0, 7) == 7:
                    number, value = source.integer(0, con.tag.limits[1]), source.bytes(source.integer(0, 4))
                out = io.BytesIO()
                try:
                    con._build([{"kind": number, "data": value}], out, ctx, "")
                except (c.ConstructError, AcesError, LookupError, TypeError):
                    continue  # bytes as the data of a known kind
                if len(out.getvalue()) <= left - len(data):
                    data += out.getvalue()
            if room.is_exact:
                data += source.bytes(left - len(data))
            elif source.integer(0, 7) == 7:
                data = (data + source.bytes(source.integer(1, 6)))[:left]
            return con._parsereport(io.BytesIO(data), ctx, "")

        return draw

    def _layout(self, layout: BitLayout) -> Draw:
        draws = [(slot, self._hinted(slot.name, self.of(slot.field))) for slot in layout.slots]
        full = (1 << 8 * layout.size) - 1

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            inner = c.Container(
                _=ctx, _params=ctx._params, _root=None, _parsing=False, _building=True, _sizing=False
            )
            values = c.Container()
            raws: dict[str, int | None] = {}
            word = claimed = 0
            for slot, draw in draws:
                if not slot.is_present(raws):
                    values[slot.name] = inner[slot.name] = raws[slot.name] = None
                    continue
                value = draw(source, inner, room)
                if layout.overlapping or slot.name in layout.selectors:
                    bits = _number_of(slot, value, inner)
                    raws[slot.name] = slot.inner.raw_of(bits)
                    word |= slot.write(bits) & ~claimed
                claimed |= slot.mask
                if slot.name in layout.many:
                    value = c.ListContainer([*values.get(slot.name, ()), value])
                values[slot.name] = inner[slot.name] = value
            if layout.overlapping:
                # Where fields share bits, the first one's count: what all of them then are is read back.
                if layout.has_reserved:
                    word |= edge_number(source, 0, full) & ~claimed if source.integer(0, 1) else 0
                values = layout._parsereport(io.BytesIO(word.to_bytes(layout.size, "little")), ctx, "")
            elif layout.has_reserved:
                values["reserved"] = edge_number(source, 0, full) & ~claimed if source.integer(0, 1) else 0
            if layout.trailing:
                behind = Room(room.left - layout.size, room.is_exact)
                values[layout.trailing] = _content(source, self._some(source, behind), self.message)
            return values

        return draw

    def _delimited(self, con: Delimited) -> Draw:
        banned = {con.separator.decode("latin-1")}
        framing = self.message.framing
        if framing is not None and framing.end:
            banned |= set(framing.end.decode("latin-1"))
        draws = [
            (item.name, _ascii(item.subcon, "".join(ch for ch in _CHARACTERS if ch not in banned)))
            for item in con.fields
        ]

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            values = c.Container()
            count = len(draws)
            if con.least < count and source.integer(0, 1):
                count = source.integer(con.least, count)
            for index, (name, draw) in enumerate(draws):
                values[name] = draw(source) if index < count else None
            if con.more:
                values["more"] = c.ListContainer(
                    "X" * source.integer(0, 3) for _ in range(source.integer(0, 2))
                )
                if count < len(draws):
                    values["more"] = c.ListContainer()
            return values

        return draw

    # -------------------------------------------------- everything else

    def _parsed(self, con: Construct) -> Draw:
        """Draw values of a construct that the walk does not know: bytes that it reads to their end."""
        low, high = sizes(con)

        def draw(source: ChoiceSource, ctx: Container, room: Room) -> Any:
            problem = "none tried"
            for attempt in range(ATTEMPTS):
                use = source if attempt < 4 else spread(source.integer(0, 255) << 8 | attempt)
                top = max(low, min(room.left, 24)) if high is None else high
                data = use.bytes(
                    room.left if room.is_exact and high is None else use.integer(low, max(low, top))
                )
                stream = io.BytesIO(data)
                try:
                    value = con._parsereport(stream, ctx, "")
                except (c.ConstructError, AcesError, ValueError, LookupError, TypeError) as error:
                    problem = str(error)
                    continue
                if not (room.is_exact and high is None and stream.read(1)):
                    return value
            raise FieldError(f"no bytes found that {con!r} reads: {problem}")

        return draw

    _TABLE: tuple[tuple[Any, Callable[[Any, Any], Draw]], ...] = (
        (c.Rebuild, _nothing),
        (c.Const, _const),
        (c.FormatField, _format),
        (c.BytesInteger, _integer),
        (Bits, _bits),
        (c.Bytes, _bytes),
        (type(c.GreedyBytes), _greedy),
        (c.VarInt.__class__, _varint),
        (c.ZigZag.__class__, _varint),
        (c.Pass.__class__, _nothing),
        (c.Terminated.__class__, _nothing),
        (c.StringEncoded, _text),
        (c.Mapping, _mapping),
        (c.FocusedSeq, _sequence),
        (c.Struct, _struct),
        (c.Array, _array),
        (c.GreedyRange, _range),
        (Multiplexed, _multiplexed),
        (c.IfThenElse, _branch),
        (c.Switch, _switch),
        (c.Prefixed, _prefixed),
        (c.NullTerminated, _terminated),
        (BitLayout, _layout),
        (Delimited, _delimited),
        (Items, _items),
    )


def _asked(expression: Any, context: Container) -> Any:
    """Return the value of an expression of other fields, or the plain value."""
    return expression(context) if callable(expression) else expression


def _number_of(slot: LayoutSlot, value: FieldValue, context: Container) -> int:
    """Return the bits of a field with this raw value, as an unsigned number."""
    out = io.BytesIO()
    slot.field._build(value, out, context, "")
    return int.from_bytes(out.getvalue(), "big")


def _measure(con: Construct, value: FieldValue, context: Container) -> int:
    """Return how many bytes a value takes."""
    if value is None:
        return 0
    if isinstance(value, bytes):
        return len(value)
    stream = io.BytesIO()
    try:
        con._build(value, stream, context, "")
    except (c.ConstructError, AcesError, KeyError, TypeError, AttributeError):
        return 0
    return len(stream.getvalue())


def _content(source: ChoiceSource, size: int, message: Message) -> bytes:
    """Draw bytes that may hold what the framing looks for: sync, end, stuffing."""
    data = source.bytes(size)
    framing = message.framing
    if framing is None or size < 2:
        return data
    how = source.integer(0, 7)
    marks = framing.sync or framing.end
    if framing.stuffing is not None and how < 3:
        marks = getattr(framing.stuffing, "pattern", b"\xc0\xdb\x00")
    if how < 4 and marks and not (framing.end and framing.stuffing is None and marks == framing.end):
        at = source.integer(0, max(0, size - len(marks)))
        data = (data[:at] + marks + data[at + len(marks) :])[:size]
    if framing.end and framing.stuffing is None:
        data = data.replace((framing.short_end or framing.end)[:1], b"\x55")
    if isinstance(framing.stuffing, CutZeros) and not data[-1]:
        data = data[:-1] + b"\x55"
    return data


def _float(kind: str) -> Draw:
    size = {"e": 2, "f": 4, "d": 8}[kind]
    unpack = struct.Struct(f"<{kind}").unpack
    plain = [0.0, -0.0, 1.0, -1.5, 0.1, 1e-3, float("inf"), float("-inf"), float("nan"), 6.1e-05, 65504.0]
    plain = [unpack(struct.pack(f"<{kind}", value))[0] for value in plain]

    def draw(source: ChoiceSource, ctx: Container, room: Room) -> float:
        if source.integer(0, 2) == 0:
            return source.choice(plain)
        return float(unpack(source.bytes(size))[0])

    return draw


#: Characters of drawn texts, simplest first.
_CHARACTERS = "0A1Bz9 .-+/_$*#~,;:é\xff\x01"


def _ascii(field: AsciiField, characters: str) -> Callable[[ChoiceSource], str]:
    digits = "0123456789"

    def some(source: ChoiceSource, low: int, high: int, of: str = digits) -> str:
        return "".join(source.choice(of) for _ in range(source.integer(low, high)))

    def draw(source: ChoiceSource) -> str:
        if source.integer(0, 5) == 0:
            return ""
        if isinstance(field, AsciiEnumeration) and field.names and source.integer(0, 3):
            return source.choice(list(field.names.values()))
        if isinstance(field, AsciiInteger):
            return source.choice(("", "-", "+")) + some(source, 1, 6)
        if isinstance(field, AsciiNumber):
            return (
                source.choice(("", "-", "+"))
                + some(source, 1, 6)
                + source.choice(("", ".", "." + some(source, 1, 6)))
            )
        if isinstance(field, AsciiDegrees):
            return some(source, 4, 5) + source.choice(("", "." + some(source, 0, 5)))
        text = some(source, 0, 6, characters)
        return text if field.accepts(text) else ""

    return draw


__all__ = ["Draw", "Room", "drawer"]
