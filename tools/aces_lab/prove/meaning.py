"""What a declaration says of bytes, written once more: from `declare/` alone, as arithmetic on bits.

1. Nothing of `plan/`, `generate/` or construct's own parsing is used: constructs are looked at as data.
2. The same code runs on symbolic bytes and on bytes; on bytes it must agree with the reference, which tests say.
3. `None` means that the bytes are not this message. What cannot be said in arithmetic raises `NotProvable` with the reason.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import construct as c
import z3

from aces_bus.protocol import (
    BitLayout,
    Check,
    Counter,
    DataIds,
    Enumeration,
    Extra,
    Field,
    Flags,
    Fletcher,
    IdBytes,
    Items,
    Message,
    Multiplexed,
    Quantity,
    RequestBytes,
    SignMagnitude,
    Sum,
    Text,
    TwoScales,
    Xor,
)
from aces_bus.protocol.declare.bits import Bits, ByteSplit
from aces_bus.protocol.declare.checks import Covered
from aces_bus.protocol.declare.head import Head
from aces_bus.protocol.declare.pattern import IdPattern

from .symbols import (
    NotProvable,
    PathSearch,
    SymbolicBytes,
    SymbolicFlags,
    SymbolicFloat,
    SymbolicInt,
    SymbolicName,
    SymbolicReal,
    concrete,
    one_of_values,
)


class NotThis(Exception):
    """The bytes are not this message."""


def bits_number(data: Any, positions: Sequence[int], *, signed: bool = False) -> Any:
    """Return the number whose bits, lowest first, stand at these places: 8 × byte + bit."""
    if type(data) is not SymbolicBytes:
        number = sum((data[at // 8] >> at % 8 & 1) << weight for weight, at in enumerate(positions))
        return number - (1 << len(positions)) if signed and number >> len(positions) - 1 else number
    cells = [z3.Extract(at % 8, at % 8, data.cells[at // 8]) for at in reversed(positions)]
    word = z3.simplify(z3.Concat(*cells)) if len(cells) > 1 else cells[0]
    return SymbolicInt(word) if signed else SymbolicInt.unsigned(word)


def is_value_of(number: Any, values: Collection[Any]) -> bool:
    """Return whether a number is one of some, on this path."""
    if type(number) is SymbolicInt:
        return bool(one_of_values(number, values))
    if type(number) is SymbolicReal:
        return any(number == value if value == value else number != number for value in values)
    return number in values or (number != number and any(value != value for value in values))


def byte_bits(offset: int, size: int, order: str) -> list[int]:
    """Return the places of the bits of whole bytes, lowest first."""
    cells = list(range(offset, offset + size))
    return [8 * byte + bit for byte in (cells if order == "little" else reversed(cells)) for bit in range(8)]


def slot_bits(layout: BitLayout) -> list[list[int]]:
    """Return the places of the bits of each field of a layout, lowest first, from its pieces and their order."""
    found: list[list[int]] = []
    cursor = 0
    for slot in layout.slots:
        pieces = slot.inner.pieces or ((cursor, slot.inner.width),)
        own: list[int] = []
        for at, width in pieces:
            cursor = at + width
            if (slot.inner.order or layout.order) == "lsb":
                own += range(at, at + width)
            else:  # written high bit first, and counted from the high bit of each byte
                own += [bit // 8 * 8 + 7 - bit % 8 for bit in reversed(range(at, at + width))]
        found.append(own)
    return found


class Reader:
    """A payload's bytes and how far they are read; expressions see what is read before by name."""

    def __init__(self, data: Any, at: int, end: int, *, raw: bool, check_field: str | None = None) -> None:
        self.data, self.at, self.end, self.raw = data, at, end, raw
        self.check_field = check_field

    def take(self, size: Any) -> Any:
        size = concrete(size)
        if type(size) is not int:
            raise NotProvable("a size that is in the request")
        if size < 0 or self.at + size > self.end:
            raise NotThis
        self.at += size
        return self.data[self.at - size : self.at]

    # ------------------------------------------------------------------ constructs

    def read(self, con: c.Construct, context: c.Container) -> Any:
        """Return the value of a construct, which is read from here."""
        match con:
            case c.Renamed():
                return self.read(con.subcon, context)
            case c.Struct():
                return self._struct(con, context)
            case BitLayout():
                return self._layout(con, context)
            case c.Const():
                wanted = con.subcon.build(con.value)
                given = self.take(len(wanted))
                if not given == wanted:
                    raise NotThis
                return con.value if type(con.value) is not bytes else given
            case c.Array():
                return [self.read(con.subcon, context) for _ in range(self._asked(con.count, context))]
            case Multiplexed():
                return self.read(con.body, context) if is_present(con, context) else None
            case Items():
                return self._items(con, context)
            case c.GreedyRange():
                return self._greedy(con, context)
            case c.FocusedSeq():
                return self._focused(con, context)
            case c.Prefixed():
                size = concrete(self.read(con.lengthfield, context))
                if con.includelength:
                    size -= con.lengthfield.sizeof()
                if size < 0 or self.at + size > self.end:
                    raise NotThis
                return self._inside(con.subcon, self.at + size, context)
            case c.IfThenElse():
                chosen = con.condfunc(context) if callable(con.condfunc) else con.condfunc
                return self.read(con.thensubcon if chosen else con.elsesubcon, context)
            case c.Switch():
                return self._switch(con, context)
            case c.Transformed() | c.Restreamed():
                raise NotProvable(f"{type(con).__name__} is not read as arithmetic")
            case Text():
                return self._text(con)
            case Field():
                return self._field(con, context)
            case c.Default() | c.Rebuild():
                return self.read(con.subcon, context)
            case _:
                return self._leaf(con, context)

    def _asked(self, value: Any, context: c.Container) -> Any:
        return concrete(value(context) if callable(value) else value)

    def _leaf(self, con: Any, context: c.Container) -> Any:
        if con is c.GreedyBytes:
            return self.take(self.end - self.at)
        if con is c.Pass:
            return None
        if con is c.Terminated:
            if self.at != self.end:
                raise NotThis
            return None
        if isinstance(con, ByteSplit):
            start = self.at
            self.take(con.bytes)
            places = [8 * start + at + k for at, width in con.pieces or () for k in range(width)]
            return bits_number(self.data, places, signed=con.signed)
        if isinstance(con, c.Bytes):
            return self.take(self._asked(con.length, context))
        if isinstance(con, c.FormatField):
            return self._format(con)
        if isinstance(con, c.BytesInteger):
            size = self._asked(con.length, context)
            start = self.at
            self.take(size)
            swapped = con.swapped(context) if callable(con.swapped) else con.swapped
            order = "little" if swapped else "big"
            return bits_number(self.data, byte_bits(start, size, order), signed=con.signed) if size else 0
        raise NotProvable(f"{type(con).__name__} is not read as arithmetic")

    def _format(self, con: c.FormatField) -> Any:
        mark, kind = con.fmtstr[0], con.fmtstr[-1]
        if mark not in "<>" or len(con.fmtstr) != 2:
            raise NotProvable(f"the format {con.fmtstr!r} is not read as arithmetic")
        size = {"B": 1, "H": 2, "I": 4, "L": 4, "Q": 8, "E": 2, "F": 4, "D": 8}[kind.upper()]
        start = self.at
        part = self.take(size)
        places = byte_bits(start, size, "little" if mark == "<" else "big")
        if kind in "efd":
            if type(part) is bytes:
                return struct.unpack(con.fmtstr, part)[0]
            return SymbolicReal(SymbolicFloat(bits_number(self.data, places, signed=True).term))
        return bits_number(self.data, places, signed=kind.islower())

    def _text(self, con: Text) -> Any:
        if con.ends:
            raise NotProvable("a text that one of several characters ends")
        data = self.take(self.end - self.at if con.size is None else con.size)
        if self.raw:
            return data
        text = data.decode("latin-1")
        return text if con.size is None else text.rstrip("\0")

    def _field(self, con: Field, context: c.Container) -> Any:
        if not isinstance(con, Quantity | TwoScales | SignMagnitude | Enumeration | Flags | Counter):
            raise NotProvable(f"{type(con).__name__} is a field of its own kind")
        return field_value(con, self.read(con.subcon, context), raw=self.raw)

    def _struct(self, con: c.Struct, outer: c.Container) -> c.Container:
        values, context = c.Container(), c.Container(_=outer)
        for item in con.subcons:
            value = self.read(item, context)
            if item.name:
                values[item.name] = context[item.name] = value
        return values

    def _layout(self, layout: BitLayout, context: c.Container) -> c.Container:
        start = self.at
        self.take(layout.size)
        values = c.Container()
        numbers: dict[str, Any] = {}
        claimed: set[int] = set()
        for slot, places in zip(layout.slots, slot_bits(layout), strict=True):
            mux = slot.mux
            if mux is not None:
                chosen = numbers.get(mux.selector)
                if chosen is None or not is_value_of(chosen, mux.when):
                    values[slot.name] = numbers[slot.name] = None
                    continue
            claimed |= set(places)
            positions = [8 * start + place for place in places]
            if slot.inner.is_float:
                bits = bits_number(self.data, positions, signed=True)
                number: Any = (
                    SymbolicReal(SymbolicFloat(bits.term))
                    if type(bits) is SymbolicInt
                    else struct.unpack(
                        {16: "<e", 32: "<f", 64: "<d"}[len(places)],
                        (bits & (1 << len(places)) - 1).to_bytes(len(places) // 8, "little"),
                    )[0]
                )
            else:
                number = numbers[slot.name] = bits_number(self.data, positions, signed=slot.inner.signed)
            value = number
            for adapter in adapters_of(slot.field):
                value = field_value(adapter, value, raw=self.raw)
            values[slot.name] = [*values.get(slot.name, ()), value] if slot.name in layout.many else value
        if layout.has_reserved:
            free = sum(1 << at for at in range(8 * layout.size) if at not in claimed)
            values["reserved"] = (
                bits_number(self.data, [8 * start + at for at in range(8 * layout.size)]) & free
            )
        if layout.trailing:
            values[layout.trailing] = self.take(self.end - self.at)
        return values

    # ------------------------------------------------------------------ what repeats or chooses

    def _greedy(self, con: c.GreedyRange, context: c.Container) -> list[Any]:
        found: list[Any] = []
        while self.at < self.end:
            start = self.at
            try:
                found.append(self.read(con.subcon, context))
            except NotThis:
                self.at = start
                break
            if self.at == start:
                raise NotProvable("a group without bytes")
        return found

    def _focused(self, con: c.FocusedSeq, outer: c.Container) -> Any:
        context = c.Container(_=outer)
        for item in con.subcons:
            context[item.name] = self.read(item, context)
        return context[con.parsebuildfrom]

    def _inside(self, con: c.Construct, stop: int, context: c.Container) -> Any:
        end, self.end = self.end, stop
        try:
            value = self.read(con, context)
        finally:
            self.end = end
        if self.at != stop:
            raise NotProvable("bytes behind what a prefix counts")
        return value

    def _switch(self, con: c.Switch, context: c.Container) -> Any:
        key = con.keyfunc(context)
        key = key.number if type(key) is SymbolicName else key
        for value, case in con.cases.items():
            if isinstance(value, int) and type(value) is not bool and key == value:
                return self.read(case, context)
            if type(key) is not SymbolicInt and key == value:
                return self.read(case, context)
        return self.read(con.default, context)

    def _items(self, con: Items, context: c.Container) -> list[Any]:
        found: list[Any] = []
        while self.at < self.end:
            found.append(self._item(con, context))
        return found

    def _item(self, con: Items, context: c.Container) -> c.Container:
        start, left = self.at, self.end - self.at

        def broken(why: str) -> c.Container:
            self.at = self.end
            return c.Container(kind=None, data=self.data[start : self.end], reason=why)

        if left < con.head:
            return broken(f"malformed: {left} of the {con.head} bytes before an item's data")
        tag = bits_number(self.data, byte_bits(start + con.tag_at, con.tag.size, con.tag.order))
        number = next((n for n in con.names if tag == n), None)
        name = None if number is None else con.names[number]
        if con.size is not None:
            said = bits_number(self.data, byte_bits(start + con.size_at, con.size.size, con.size.order))
            size = concrete(said) - con.counted
            if not 0 <= size <= left - con.head:
                return broken(f"malformed: its size says {size + con.counted}, and {left} bytes are left")
        else:
            fixed = con.fixed_size(name)
            size = left - con.head if fixed is None else min(fixed, left - con.head)
        self.at = start + con.head
        stop = self.at + size
        inside = self.data[self.at : stop]
        if name is None:
            self.at = stop
            return c.Container(kind=tag, data=inside, reason="unknown")
        kind = number if self.raw else name
        inner = Reader(self.data, self.at, stop, raw=self.raw)
        self.at = stop
        try:
            value = inner.read(con.data[name], c.Container(_=context))
            if inner.at == stop:
                return c.Container(kind=kind, data=value, reason=None)
        except NotThis:
            pass
        return c.Container(kind=kind, data=inside, reason=f"malformed: data of size {size} are not a {name}")


def adapters_of(field: c.Construct) -> list[Field]:
    """Return the fields around the bits of a layout, the innermost first."""
    found: list[Field] = []
    while not isinstance(field, Bits):
        if isinstance(field, Field):
            found.insert(0, field)
        elif not isinstance(field, c.Renamed | c.Default):
            raise NotProvable(f"{type(field).__name__} is not read as arithmetic")
        field = field.subcon
    return found


def field_value(field: Field, number: Any, *, raw: bool) -> Any:
    """Return what a field makes of its number; in raw mode only its sign."""
    if isinstance(field, SignMagnitude):
        half = 1 << field.width - 1
        if type(number) is SymbolicInt:
            PathSearch.current.exempt.append((number == half).term)  # negative zero reads as 0
        return number if number < half else half - number
    if raw or isinstance(field, Counter):
        return number
    if isinstance(field, Enumeration):
        return (
            SymbolicName(number, field.values)
            if type(number) is SymbolicInt
            else field.values.get(number, number)
        )
    if isinstance(field, Flags):
        return SymbolicFlags(number, field.names) if type(number) is SymbolicInt else number
    if isinstance(field, TwoScales):
        (scale, offset), (other_scale, other_offset) = field.scales
        if number < field.half:
            return number * scale + offset
        return (number - field.half) * other_scale + other_offset
    if not isinstance(field, Quantity):
        raise NotProvable(f"{type(field).__name__} is a field of its own kind")
    if len(field.unknown) and is_value_of(number, field.unknown):
        return None
    if field.names and is_value_of(number, list(field.values)):
        return SymbolicName(number, field.values) if type(number) is SymbolicInt else field.values[number]
    if field.scale != 1:
        number = number * field.scale
    return number + field.offset if field.offset else number


def is_present(mux: Multiplexed, context: Mapping[str, Any]) -> bool:
    """Return whether a multiplexed field of a `Struct` is there."""
    chosen = context[mux.selector]
    if type(chosen) is SymbolicName:
        chosen = chosen.number
    elif isinstance(chosen, str) and mux.enumeration is not None:
        chosen = mux.enumeration.names.get(chosen)
    return chosen is not None and is_value_of(chosen, mux.when)


# ---------------------------------------------------------------------- a whole message


class Captures:
    """The parts of an identifier: symbolic numbers, each among its values, and the key that they make."""

    def __init__(self, message: Message, base: int, prefix: str = "") -> None:
        self.numbers: dict[str, Any] = {}
        self.variables: list[z3.BitVecRef] = []
        self.given: list[z3.BoolRef] = []
        key: Any = SymbolicInt.of(base + message.identifier.constant)
        for capture in message.identifier.captures:
            self.variables.append(z3.BitVec(f"{prefix}part_{capture.name}", capture.width))
            number = SymbolicInt.unsigned(self.variables[-1])
            self.numbers[capture.name] = number
            self.given.append(one_of_values(number, capture.values).term)
            key = key + (number << capture.shift)
        self.key = key


def fits(pattern: IdPattern, number: Any) -> dict[str, Any] | None:
    """Return the parts of a number of a head, or None when it is not of the pattern."""
    if not pattern.captures:
        return {} if number == pattern.constant else None
    if len(pattern.captures) == 1:
        (capture,) = pattern.captures
        rest = number - pattern.constant
        if not rest >= 0 or (capture.shift and (rest & (1 << capture.shift) - 1) != 0):
            return None
        part = rest >> capture.shift
        return {capture.name: part} if is_value_of(part, capture.values) else None
    found: dict[str, Any] = {}
    total: Any = pattern.constant
    for capture in pattern.captures:
        part = number >> capture.shift & (1 << capture.width) - 1
        if not is_value_of(part, capture.values):
            return None
        found[capture.name] = part
        total = total + (part << capture.shift)
    return found if number == total else None


def head_value(head: Head, data: Any) -> Any:
    """Return the number in a head field."""
    return bits_number(data, byte_bits(head.offset, head.size, head.order))


def meaning(
    message: Message,
    data: Any,
    captures: Mapping[str, Any],
    *,
    raw: bool,
    key: Any = 0,
    request: Any = None,
) -> dict[str, Any] | None:
    """Return the fields that a message has in these bytes, by name; None when they are not this message.

    `data` are a frame's bytes, or a packet's without stuffing, `captures` the raw parts of its identifier. A message's own
    check must hold.
    """
    framing = message.framing
    tail = framing.check_size + len(framing.end) if framing is not None else 0
    end = len(data) - tail
    if message.lengths is not None and len(data) not in message.lengths:
        return None
    if end < message.payload_start:
        return None
    values: dict[str, Any] = {}
    for capture in message.identifier.captures:
        values[capture.name] = _part(capture.quantity, captures[capture.name], raw=raw)
    for name in message.request_fields:
        values[name] = (request or {}).get(name)
    outside = c.Container()
    for head in message.heads_written:
        number = head_value(head, data)
        parts = fits(head.pattern, number) if head.pattern is not None else {}
        if parts is None:
            return None
        if head in message.heads:
            if head.pattern is not None and not head.is_own:
                for capture in head.pattern.captures:
                    values[capture.name] = _part(capture.quantity, parts[capture.name], raw=raw)
            elif head.name is not None and not head.is_constant:
                inner = Reader(data, head.offset, head.offset + head.size, raw=raw)
                values[head.name] = inner.read(head.field, outside)
        if head.name is not None:
            outside[head.name] = number
    outside.update(values)
    for head in message.heads_written:
        if head.name and (head.is_constant or (framing is not None and head.offset < framing.head_end)):
            outside[head.name] = head_value(head, data)
    reader = Reader(data, message.payload_start, end, raw=raw)
    try:
        payload = reader.read(message.payload, outside)
    except NotThis:
        return None
    if reader.at != end:
        return None
    check = message.check
    for name in message.payload_names:
        if check is None or name != check.field:
            values[name] = payload.get(name)
    if check is not None and not holds(message, data, key):
        return None
    return values


def _part(quantity: Any, number: Any, *, raw: bool) -> Any:
    return number if quantity is None else field_value(quantity, number, raw=raw)


def holds(message: Message, data: Any, key: Any) -> bool:
    """Return whether the message's own check holds, on this path: sums and xors as arithmetic."""
    check = message.check
    assert check is not None
    start, size, order = message.check_span
    stored = bits_number(data, byte_bits(start, size, order))
    if type(data) is bytes:
        return bool(stored == check.compute(message.covered(data, key & 0x1FFF_FFFF)))
    cells = covered_cells(message.check_over, data[: len(data) - message.behind], key, message.check_extra)
    return bool(stored == check_number_of(check, cells))


def covered_cells(over: Sequence[Covered], data: Any, key: Any = 0, extra: bytes = b"") -> list[Any]:
    """Return the bytes that a check covers, of a packet and its key."""
    cells: list[Any] = []
    for part in over:
        match part:
            case slice():
                cells += list(data[part])
            case IdBytes():
                number = (key & part.mask) & (1 << 8 * part.size) - 1
                cells += (
                    list(number.cut(part.size, part.order))
                    if type(number) is SymbolicInt
                    else part.bytes(number)
                )
            case Extra():
                cells += list(extra)
            case DataIds() if type(data) is bytes:
                cells += part.bytes(data)
            case DataIds():
                raise NotProvable("a check over a data id that a field chooses")
            case RequestBytes():
                raise NotProvable("a check over the request")
            case _:
                cells += list(part)
    return cells


def check_number_of(check: Check, cells: Sequence[Any]) -> Any:
    """Return the number of a check over bytes, as arithmetic."""
    if isinstance(check, Xor):
        number: Any = 0
        for cell in cells:
            number = number ^ cell
        return number
    if isinstance(check, Sum):
        total: Any = sum(cells)
        return check.signed(total) & check.mask
    if isinstance(check, Fletcher):
        first: Any = 0
        second: Any = 0
        for cell in cells:
            first = first + cell & 0xFF
            second = second + first & 0xFF
        return first | second << 8
    parameters = getattr(check, "parameters", None)
    if parameters is None:
        raise NotProvable(f"the check {check.describe}")
    return _crc(parameters, cells)


def _crc(parameters: tuple[int, int, int, bool, bool, int], cells: Sequence[Any]) -> Any:
    """Return a CRC bit by bit: the register is a list of bits, each the exclusive or of bits."""
    width, poly, init, refin, refout, xorout = parameters
    register: list[Any] = [z3.BitVecVal(init >> bit & 1, 1) for bit in range(width)]
    for cell in cells:
        number = SymbolicInt.of(cell)
        assert number is not None
        byte = number.wide(9)
        for bit in range(8) if refin else range(7, -1, -1):
            carry = z3.simplify(register[-1] ^ z3.Extract(bit, bit, byte))
            register = [z3.BitVecVal(0, 1), *register[:-1]]
            register = [
                z3.simplify(cell ^ carry) if poly >> at & 1 else cell for at, cell in enumerate(register)
            ]
    bits = register[::-1] if not refout else register  # for Concat: the highest first
    word = z3.Concat(*bits) if width > 1 else bits[0]
    return SymbolicInt.unsigned(z3.simplify(word ^ z3.BitVecVal(xorout, width)))
