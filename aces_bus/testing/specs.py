"""Draws whole protocols, as Python source of random specs.

1. What is drawn is text, run line by line: a failing one can be read, saved and fuzzed like any spec.
2. A line that the language refuses (two messages that nothing tells apart, a field too many) is left out, and only such a
   line: whatever else is raised is a fault of ours.
3. Every protocol has at least one message.
"""

from __future__ import annotations

import linecache
from collections.abc import Iterator
from typing import Any, Literal

from ..errors import SpecError
from ..protocol.protocol import Protocol
from .source import ChoiceSource

Link = Literal["can", "serial"]
HEAD = "from construct import *\nfrom aces_bus.protocol import *\n"

_INTEGERS = (
    "Byte",
    "Int8sb",
    "Int16ul",
    "Int16ub",
    "Int16sl",
    "Int16sb",
    "Int24ub",
    "Int32ul",
    "Int32sb",
    "Int64sl",
)
_SIZES = {
    "Byte": 1,
    "Int8sb": 1,
    "Int16": 2,
    "Int24": 3,
    "Int32": 4,
    "Int64": 8,
    "Float16": 2,
    "Float32": 4,
    "Float64": 8,
}
_CRCS = (
    ("CRC8-SAE-J1850", 1),
    ("CRC8-AUTOSAR", 1),
    ("CRC16-MODBUS", 2),
    ("CRC16-IBM-3740", 2),
    ("CRC32-ISO-HDLC", 4),
)


def draw_spec(source: ChoiceSource, link: Link | None = None) -> str:
    """Return the source text of a protocol named `drawn`."""
    link = link or source.choice(("can", "serial"))
    lines = [f'drawn = Protocol("drawn", link="{link}")']
    space: dict[str, Any] = {}
    _run(HEAD + lines[0], space)
    for line in _can(source) if link == "can" else _serial(source):
        try:
            _run(line, space)
        except SpecError:
            continue
        lines.append(line)
    if not space["drawn"].declared:  # each line was refused
        lines.append(
            'drawn.message("Last", id=0x7ff, payload=Struct("x" / Byte))'
            if link == "can"
            else 'drawn.framing(sync=b"\\x02", size=3, max_size=3)("Last", payload=Struct("x" / Int16ub))'
        )
    return HEAD + "\n" + "\n".join(lines) + "\n"


def protocol_of(text: str) -> Protocol:
    """Return the protocol `drawn` of a source text."""
    space: dict[str, Any] = {}
    _run(text, space)
    made: Protocol = space["drawn"]
    return made


def _run(text: str, space: dict[str, Any]) -> None:
    name = f"<drawn spec {hash(text) & 0xFFFFFFFF:08x}>"
    if len(linecache.cache) > 4000:
        linecache.cache.clear()
    linecache.cache[name] = (len(text), None, text.splitlines(keepends=True), name)
    exec(compile(text, name, "exec"), space)  # the text is ours, drawn from the words below


# ---------------------------------------------------------------------- payloads


class _Names:
    """Names of fields, each once."""

    def __init__(self) -> None:
        self._count = 0

    def next(self) -> str:
        self._count += 1
        return f"f{self._count}"


def _size(con: str) -> int:
    return next(size for name, size in _SIZES.items() if con.startswith(name))


def _number(source: ChoiceSource, room: int) -> tuple[str, int]:
    """Return a construct of a number of at most `room` bytes, and its size."""
    fitting = [
        name for name in (*_INTEGERS, "Float32l", "Float32b", "Float16b", "Float64l") if _size(name) <= room
    ]
    con = source.choice(fitting)
    return con, _size(con)


def _single(source: ChoiceSource, names: _Names, room: int) -> tuple[str, int]:
    """Return one field with its name, and its size."""
    name = names.next()
    how = source.integer(0, 11)
    con, size = _number(source, room)
    if how == 1:
        scale = source.choice(("0.1", "0.01", "0.5", "-0.25", "3"))
        offset, more = source.choice(("0", "-40", "0.5")), source.choice(("", ', rounding="truncate"'))
        con = f'Quantity({con}, scale={scale}, offset={offset}, unit="V"{more})'
    elif how == 2:
        con, size = f"Enumeration(Byte, off={source.integer(0, 3)}, on={source.integer(4, 255)})", 1
    elif how == 3:
        con, size = f"Flags(Byte, low={source.integer(0, 3)}, high={source.integer(4, 7)})", 1
    elif how == 4 and room >= 2:
        order = source.choice(("little", "big"))
        con, size = f'SignMagnitude(16, "{order}")', 2
    elif how == 5 and room // size >= 2:
        count = source.integer(2, min(4, room // size))
        con, size = f"Array({count}, {con})", count * size
    elif how == 6:
        size = source.integer(1, min(4, room))
        con = f"Reserved({size})"
    elif how == 7:
        size = source.integer(1, min(6, room))
        con = f"Bytes({size})"
    elif how == 8 and room >= 3:
        con, size = f'Struct("a" / Byte, "b" / {source.choice(("Int16ul", "Int16sb"))})', 3
    elif how == 9:
        con, size = "Counter(Byte)", 1
    elif how == 10 and room >= 2:
        con, size = _layout(source, min(room, 4))
    return f'"{name}" / {con}', size


#: What takes all that is left.
_OPEN = (
    '"rest" / GreedyBytes',
    '"rest" / GreedyRange(Byte)',
    '"rest" / Text()',
    '"rest" / Struct("name" / Text(5, ends=b"\\xff@\\0"), "data" / GreedyBytes)',
    '"rest" / Items(tag=Byte, size=Byte, kinds={"one": (1, Byte), "two": (2, Struct("a" / Int16ub, "b" / GreedyBytes))})',
    '"rest" / Items(tag=Byte, kinds={"one": (1, Quantity(Int16sl, scale=0.1)), "two": (9, Struct("a" / Float32b))})',
)


def _struct(source: ChoiceSource, room: int, *, first: str = "") -> tuple[str, int]:
    """Return a struct of at most `room` bytes."""
    names, parts, left = _Names(), [first] if first else [], room - (1 if first else 0)
    for _ in range(source.integer(1, 6)):
        if left < 1:
            break
        part, size = _single(source, names, left)
        parts.append(part)
        left -= size
    if left >= 3 and source.integer(0, 5) == 0:
        parts += [
            '"which" / Byte',
            f'"one" / Multiplexed("which", {source.integer(0, 2)}, Byte)',
            f'"two" / Multiplexed("which", ({source.integer(3, 5)}, 9), Int16sb)',
        ]
        left -= 3
    elif left >= 1 and source.integer(0, 5) == 0:
        parts.append(source.choice(_OPEN))
        left = 0
    return f"Struct({', '.join(parts)})", room - left


def _layout(source: ChoiceSource, room: int) -> tuple[str, int]:
    """Return a bit layout of at most `room` bytes: fields side by side, with gaps, across bytes."""
    size = source.integer(1, room)
    order = source.choice(("lsb", "msb"))
    at, parts = 0, list[str]()
    while at < 8 * size and len(parts) < 7:
        at += source.choice((0, 0, 0, 1, 3))
        width = min(source.integer(1, 20), 8 * size - at)
        if width < 1:
            break
        how = source.integer(0, 6)
        field = f"bits({width}, at={at})"
        if how == 1 and width >= 2:
            field = f"bits({width}, at={at}, signed=True)"
        elif how == 2:
            field = f"Quantity({field}, scale={source.choice(('0.1', '2'))}, offset={source.integer(-9, 9)})"
        elif how == 3 and width >= 3:
            field = f"SignMagnitude({field})"
        elif how == 4:
            field = f"Enumeration({field}, zero=0, one=1)"
        elif how == 5 and width >= 4:
            half = source.integer(1, width - 1)
            signed = source.choice(("", ", signed=True"))
            field = f"Split(({at + width - half}, {half}), ({at}, {width - half}){signed})"
        parts.append(f'"b{len(parts)}" / {field}')
        at += width
    if not parts:
        parts.append('"b0" / bits(3)')
    return f'BitLayout({size}, {", ".join(parts)}, order="{order}")', size


def _payload(source: ChoiceSource, room: int) -> str:
    if source.integer(0, 3) == 0:
        return _layout(source, min(room, 8))[0]
    return _struct(source, room)[0]


# ---------------------------------------------------------------------- CAN


def _can(source: ChoiceSource) -> Iterator[str]:
    for number in range(source.integer(1, 5)):
        extended, fd = source.integer(0, 3) == 0, source.integer(0, 7) == 0
        limit = 0x1FFF_FFFF if extended else 0x7FF
        base = source.integer(0, limit >> 6) << 6
        how = source.integer(0, 3)
        if how == 0:
            identifier = hex(base + source.integer(0, 63))
        elif how == 1:
            identifier = f'{base:#x} + IdField("node", range({source.integer(1, 48)}))'
        elif how == 2:
            node = f'IdField("node", range({source.integer(1, 16)}))'
            identifier = f"{node} << {source.integer(4, 6)} | {source.integer(0, 15)}"
        else:
            first, second = source.integer(0, 30), source.integer(31, 63)
            identifier = f'{base:#x} + IdField("node", ({first}, {second}))'
        more = ", extended=True" if extended else ""
        more += ", fd=True" if fd else ""
        more += source.choice(("", "", ', direction="to device"', ', direction="from device"'))
        if source.integer(0, 7) == 0:
            payload = 'BitLayout(4, "crc" / bits(8), "turn" / bits(4), "value" / bits(20))'
            name = source.choice([name for name, size in _CRCS if size == 1])
            over = source.choice(("slice(1, None)", "(IdBytes(2), slice(1, None))"))
            more += f', check=Crc("{name}", over={over}, field="crc")'
        else:
            payload = _payload(source, 12 if fd else 8)
        yield f'drawn.message("M{number}", id={identifier}, payload={payload}{more})'


# ---------------------------------------------------------------------- serial lines


def _check(source: ChoiceSource) -> tuple[str, int]:
    """Return a check, and its size."""
    how = source.integer(0, 6)
    if how == 0:
        return "", 0
    if how == 1:
        size = source.choice((1, 2))
        return f"Sum({size})", size
    if how == 2:
        return source.choice(("InvertedSum()", "Sum(negated=True)")), 1
    if how == 3:
        return "Xor()", 1
    if how == 4:
        return "Fletcher()", 2
    name, size = source.choice(_CRCS)
    return f'Crc("{name}", order="{source.choice(("little", "big"))}")', size


def _serial(source: ChoiceSource) -> Iterator[str]:
    check, check_size = _check(source)
    checked = f", check={check}" if check else ""
    sync = source.bytes(source.integer(1, 3))
    how = source.integer(0, 5)
    if how == 0:  # all packets of one size
        room = source.integer(2, 12)
        size = len(sync) + 1 + room + check_size
        yield f"packet = drawn.framing(sync={sync!r}, header=Struct('kind' / Byte), size={size}{checked})"
        for number in range(source.integer(1, 3)):
            body, used = _struct(source, room)
            fill = f", 'fill' / Bytes({room - used})" if room > used else ""
            body = body[:-1] + fill + ")"
            yield f'packet("M{number}", match={{"kind": {source.integer(0, 255)}}}, payload={body})'
        return
    if how == 1:  # to an end mark, perhaps stuffed
        stuffing = source.choice(("Slip()", "Cobs()"))
        end = "b'\\xc0'" if stuffing == "Slip()" else "b'\\x00'"
        framing = (
            f"end={end}, stuffing={stuffing}, header=Struct('kind' / Byte), max_size={source.integer(30, 90)}"
        )
    else:  # a length field
        wide = source.choice(("Byte", "Byte", "Int16ul", "Int16ub"))
        overhead = len(sync) + 1 + _size(wide) + check_size
        offset = source.integer(0, overhead)
        heads = [f"'length' / {wide}", "'kind' / Byte"]
        if source.integer(0, 1):
            heads.reverse()
        not_next = f", not_next={sync[-1:]!r}" if source.integer(0, 3) == 0 else ""
        framing = (
            f"sync={sync!r}{not_next}, header=Struct({', '.join(heads)}), "
            f"size=this.length + {offset}, max_size={source.integer(overhead + 24, 120)}"
        )
    yield f"packet = drawn.framing({framing}{checked})"
    for number in range(source.integer(1, 5)):
        way = source.choice(("", "", ', direction="to device"', ', direction="from device"'))
        kind = source.choice(
            (
                str(source.integer(0, 255)),
                str(source.integer(0, 9)),
                f'0x20 + IdField("node", range({source.integer(2, 9)}))',
            )
        )
        payload = _payload(source, source.integer(1, 20))
        yield f'packet("M{number}", match={{"kind": {kind}}}, payload={payload}{way})'


__all__ = ["Link", "draw_spec", "protocol_of"]
