"""Sub-frames: what a moteus frame is made of, one after the other up to its end.

1. Every byte is in one sub-frame. What cannot be read, or would be built as other bytes, is bytes with the reason.
2. Values are in the unit of their register, by name; NaN is NaN in each type.
3. What does not fit its type is refused, never cut off: a torque limit that was saturated would be another one.

A sub-frame on registers has the `kind` `write_f32`, `reply_i16` … and the values by the registers' names as `data`;
`read_i8` has the names alone. The registers of one sub-frame follow one another by number. `_long` at the end of a kind
says that their count stands in a byte of its own though it would fit into the first one.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, BinaryIO, ClassVar

import construct as c

from aces_bus.errors import FieldError
from aces_bus.frames import FD_LENGTHS
from aces_bus.protocol import ItemList

from .registers import BY_NAME, BY_NUMBER, TYPES, Quantum, register_at, register_named

#: Fills a frame up to a legal length.
NOP = 0x50
#: The first byte of sub-frames on registers: two bits of type at 2, two of count at 0.
OPERATIONS = {"write": 0x00, "read": 0x10, "reply": 0x20}
#: A frame has no room for the answer to more.
MOST = 64

#: Other sub-frames: the first byte, and the fields behind it. `varuint`, `byte`, `register`, or `bytes` behind their size.
OTHERS: Mapping[str, tuple[int, Mapping[str, str]]] = {
    "write_error": (0x30, {"register": "register", "error": "varuint"}),
    "read_error": (0x31, {"register": "register", "error": "varuint"}),
    "stream_to_device": (0x40, {"channel": "varuint", "data": "bytes"}),
    "stream_from_device": (0x41, {"channel": "varuint", "data": "bytes"}),
    "poll_stream": (0x42, {"channel": "varuint", "most": "varuint"}),
    "flow_from_device": (0x43, {"channel": "varuint", "packet": "byte", "data": "bytes"}),
    "poll_flow": (0x44, {"channel": "varuint", "packet": "byte", "most": "varuint"}),
}
#: The kinds of sub-frames on registers: operation, type, whether their count stands in a byte of its own without need.
KINDS = {
    f"{operation}_{kind}{long}": (operation, kind, bool(long))
    for operation in OPERATIONS
    for kind in TYPES
    for long in ("", "_long")
}
_OTHER_TAGS = {tag: kind for kind, (tag, _) in OTHERS.items()}
_WIDTHS = {kind: struct.calcsize(form) for kind, form in TYPES.items()}


class _Cut(Exception):
    """The bytes end within a sub-frame."""


class _Reader:
    """Bytes, and how far they are read. `is_plain`: what was read is built again as the same bytes."""

    def __init__(self, data: bytes, at: int) -> None:
        self.data, self.at, self.is_plain = data, at, True

    def take(self, size: int) -> bytes:
        end = self.at + size
        if end > len(self.data):
            raise _Cut
        part, self.at = self.data[self.at : end], end
        return part

    def varuint(self) -> int:
        number = 0
        for place in range(5):
            byte = self.take(1)[0]
            number |= (byte & 0x7F) << 7 * place
            if byte < 0x80:
                if not byte and place:
                    self.is_plain = False
                return number
        raise _Cut


def varuint(number: int) -> bytes:
    """Return a number in groups of seven bits, lowest first; the top bit says that more follow.

    >>> varuint(0x20).hex(), varuint(0x101).hex()
    ('20', '8102')
    """
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes((*out, number))


def register_values(subframes: Iterable[Any]) -> dict[str, Any]:
    """Return the values by name of the registers that a record's sub-frames write or answer; the last one counts."""
    found: dict[str, Any] = {}
    for subframe in subframes:
        if subframe.reason is None and str(subframe.kind).partition("_")[0] in ("write", "reply"):
            if hasattr(subframe.data, "__struct_fields__"):
                found.update((name, getattr(subframe.data, name)) for name in subframe.data.__struct_fields__)
    return found


class Subframes(ItemList):
    """The sub-frames of a frame, see above. Built, they are filled up with `nop` to a length that CAN FD has."""

    values: ClassVar = {
        quantum.name: (quantum.number, quantum.unit, None if quantum.measure else quantum.names)
        for quantum in BY_NUMBER.values()
    }

    # ------------------------------------------------------------------ reading

    def _parse(self, stream: BinaryIO, context: c.Container, path: str) -> c.ListContainer:
        raw = bool(context._params.get("raw", False))
        data: bytes = c.stream_read_entire(stream, path)
        found, at = c.ListContainer(), 0
        while at < len(data):
            reader = _Reader(data, at)
            try:
                item = _read(reader, raw)
                if not reader.is_plain:
                    reason = "malformed: it would be sent as other bytes"
                    item = c.Container(kind=data[at], data=data[at + 1 : reader.at], reason=reason)
            except _Cut:
                item = c.Container(kind=None, data=data[at:], reason="malformed: cut off")
                reader.at = len(data)
            found.append(item)
            at = reader.at
        return found

    # ------------------------------------------------------------------ building

    def _build(self, obj: Any, stream: BinaryIO, context: c.Container, path: str) -> Any:
        data = bytes_of(obj, path, raw=bool(context._params.get("raw", False)))
        size = next((n for n in FD_LENGTHS if n >= len(data)), None)
        if size is None:
            raise FieldError(f"{path}: {len(data)} bytes of sub-frames; a frame has {FD_LENGTHS[-1]}")
        stream.write(data.ljust(size, bytes((NOP,))))
        return obj


def bytes_of(subframes: Iterable[Any], path: str = "subframes", *, raw: bool = False) -> bytes:
    """Return sub-frames as they are sent, not filled up. Raises `FieldError`."""
    items = list(subframes)
    out = bytearray()
    for number, item in enumerate(items):
        where = f"{path}.{number}"
        if not isinstance(item, Mapping) or not {"kind", "data"} <= item.keys():
            raise FieldError(f"{where}: a sub-frame is {{'kind': …, 'data': …}}, not {item!r}")
        if item["kind"] is None and number < len(items) - 1:
            raise FieldError(f"{where}: only the last sub-frame may be bytes without a kind")
        out += _built(item, where, raw)
    return bytes(out)


def _read(reader: _Reader, raw: bool) -> c.Container:
    """Return the next sub-frame."""
    tag = reader.take(1)[0]
    if tag == NOP:
        count = 1
        while reader.data[reader.at : reader.at + 1] == bytes((NOP,)):
            reader.at, count = reader.at + 1, count + 1
        return c.Container(kind="nop", data=count, reason=None)
    operation = next((name for name, base in OPERATIONS.items() if tag & 0xF0 == base), None)
    if operation is not None:
        return _read_registers(reader, tag, operation, raw)
    other = _OTHER_TAGS.get(tag)
    if other is None:
        return c.Container(kind=tag, data=reader.take(len(reader.data) - reader.at), reason="unknown")
    data = c.Container()
    for name, form in OTHERS[other][1].items():
        if form == "byte":
            data[name] = reader.take(1)[0]
        elif form == "bytes":
            data[name] = reader.take(reader.varuint())
        else:
            number = reader.varuint()
            data[name] = register_at(number).name if form == "register" else number
    return c.Container(kind=other, data=data, reason=None)


def _read_registers(reader: _Reader, tag: int, operation: str, raw: bool) -> c.Container:
    kind, short = list(TYPES)[tag >> 2 & 3], tag & 3
    count = short or reader.varuint()
    name = f"{operation}_{kind}" + ("_long" if not short and count <= 3 else "")
    start = reader.at
    first = reader.varuint() if count else 0
    if count > MOST:
        reader.at = start
        rest = reader.take(len(reader.data) - start)
        reason = f"malformed: {count} registers are more than a frame can have"
        return c.Container(
            kind=None, data=reader.data[start - len(varuint(count)) - 1 : start] + rest, reason=reason
        )
    registers = [register_at(first + n) for n in range(count)]
    if operation == "read":
        return c.Container(
            kind=name, data=c.ListContainer(register.name for register in registers), reason=None
        )
    values = c.Container()
    width = _WIDTHS[kind]
    numbers = struct.unpack(f"<{count}{TYPES[kind][1]}", reader.take(count * width))
    for place, (register, number) in enumerate(zip(registers, numbers, strict=True)):
        if kind == "f32" and (
            number != number or (register.names and number == 0)
        ):  # a signalling NaN, or -0 with a name
            at = reader.at - (count - place) * width
            same = struct.pack("<f", 0.0 if number == 0 else number)
            reader.is_plain &= same == reader.data[at : at + width]
        values[register.name] = number if raw else _physical(register, kind, number)
    return c.Container(kind=name, data=values, reason=None)


def _physical(register: Quantum, kind: str, number: Any) -> Any:
    step = register.step(kind)
    if step is None:
        return register.names.get(number, number)
    return math.nan if number == -1 << 8 * _WIDTHS[kind] - 1 else number * step


def _built(item: Mapping[str, Any], path: str, raw: bool) -> bytes:
    kind, data, reason = item["kind"], item["data"], item.get("reason")
    if reason is not None or not isinstance(kind, str):
        if not isinstance(data, (bytes, bytearray)):
            raise FieldError(f"{path}: what is not a known sub-frame is sent as bytes, not {data!r}")
        return bytes(data) if kind is None else bytes((_tag(kind, path), *data))
    if kind == "nop":
        if not isinstance(data, int) or not 0 < data <= MOST:
            raise FieldError(f"{path}: nop is a number of bytes from 1 to {MOST}, not {data!r}")
        return bytes((NOP,)) * data
    if kind in OTHERS:
        return _built_other(kind, data, path)
    parts = KINDS.get(kind)
    if parts is None:
        known = ", ".join(("write_f32", "read_i16", "reply_i8 …", "nop", *OTHERS))
        raise FieldError(f"{path}: there is no sub-frame {kind!r}; there are {known}")
    return _built_registers(*parts, data, path, raw)


def _tag(kind: Any, path: str) -> int:
    if isinstance(kind, int) and 0 <= kind <= 0xFF:
        return kind
    raise FieldError(
        f"{path}: the first byte of bytes that are not a known sub-frame is a number, not {kind!r}"
    )


def _built_other(kind: str, data: Any, path: str) -> bytes:
    tag, fields = OTHERS[kind]
    if not isinstance(data, Mapping) or set(data) != set(fields):
        raise FieldError(f"{path}: {kind} has {', '.join(fields)}")
    out = bytearray((tag,))
    for name, form in fields.items():
        value = data[name]
        if form == "bytes":
            out += varuint(len(value)) + bytes(value)
        elif form == "register":
            out += varuint(_register(value, path).number)
        elif not isinstance(value, int) or not 0 <= value <= (0xFF if form == "byte" else (1 << 35) - 1):
            raise FieldError(f"{path}: {name} of {kind} cannot be {value!r}")
        else:
            out += bytes((value,)) if form == "byte" else varuint(value)
    return bytes(out)


def _register(name: Any, path: str) -> Quantum:
    found = (BY_NAME.get(name) or register_named(name)) if isinstance(name, str) else None
    if found is None:
        raise FieldError(
            f"{path}: there is no register {name!r}; one without a name is r and its number, such as r0f3"
        )
    return found


def _built_registers(operation: str, kind: str, long: bool, data: Any, path: str, raw: bool) -> bytes:
    if operation == "read" and (isinstance(data, str) or not isinstance(data, Sequence)):
        raise FieldError(f"{path}: a read has the names of registers, not {data!r}")
    if operation != "read" and not isinstance(data, Mapping):
        raise FieldError(f"{path}: a {operation} has values by the names of registers, not {data!r}")
    registers = [_register(name, path) for name in data]
    count = len(registers)
    if count > MOST or (not count and not long):
        raise FieldError(f"{path}: {count} registers in one sub-frame")
    for register, two in pairwise(registers):
        if two.number != register.number + 1:
            raise FieldError(
                f"{path}: {two.name} does not follow {register.name}; a sub-frame has consecutive registers: start another"
            )
    code = OPERATIONS[operation] | list(TYPES).index(kind) << 2
    out = bytearray((code,)) + varuint(count) if long or count > 3 else bytearray((code | count,))
    if count:
        out += varuint(registers[0].number)
    if isinstance(data, Mapping):
        for register, value in zip(registers, data.values(), strict=True):
            out += _number(register, kind, value, f"{path}.{register.name}", raw)
    return bytes(out)


def _number(register: Quantum, kind: str, value: Any, path: str, raw: bool) -> bytes:
    """Return a value as its type has it; raises `FieldError` for what does not fit."""
    if isinstance(value, str) and not raw:
        value = next((number for number, name in register.names.items() if name == value), value)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        known = f"; it is one of {', '.join(register.names.values())}" if register.names else ""
        raise FieldError(f"{path}: {value!r} is not a number{known}")
    number: float = value
    if kind != "f32":
        limit = 1 << 8 * _WIDTHS[kind] - 1
        step = None if raw else register.step(kind)
        if step is not None:
            if math.isnan(value):
                return struct.pack(TYPES[kind], -limit)
            if not abs(value) <= (limit - 0.5) * step:  # infinity neither
                raise FieldError(
                    f"{path}: {value:g} {register.unit} does not fit into {kind}, which ends at {(limit - 1) * step:g}"
                )
            number = max(1 - limit, min(limit - 1, round(value / step)))
        if number != int(number) if math.isfinite(number) else True:
            raise FieldError(f"{path}: {value!r} is not a whole number")
        number = int(number)
        if not -limit <= number < limit:
            raise FieldError(f"{path}: {value!r} is outside {-limit}…{limit - 1}")
    try:
        return struct.pack(TYPES[kind], number)
    except OverflowError:
        raise FieldError(f"{path}: {value!r} is beyond what a float of four bytes holds") from None
