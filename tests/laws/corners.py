"""Invented protocols that visit the corners of the spec language: what the real ones do not happen to use.

Each corner is here because a law could break there and nowhere else.
"""

from __future__ import annotations

from construct import (
    Adapter,
    Array,
    Byte,
    Bytes,
    Const,
    Default,
    Float16b,
    Float32b,
    Float32l,
    Float64l,
    GreedyBytes,
    GreedyRange,
    If,
    IfThenElse,
    Int8sb,
    Int8sl,
    Int16sb,
    Int16ub,
    Int16ul,
    Int24ub,
    Int24ul,
    Int32ul,
    Int64ub,
    Pass,
    Prefixed,
    PrefixedArray,
    Rebuild,
    Struct,
    Switch,
    VarInt,
    ZigZag,
    len_,
    this,
)

from aces_bus.protocol import (
    BitLayout,
    Counter,
    Crc,
    DataIds,
    Enumeration,
    Escaped,
    Extra,
    Flags,
    Fletcher,
    IdBytes,
    IdField,
    InvertedSum,
    Multiplexed,
    Protocol,
    Quantity,
    Reserved,
    SignMagnitude,
    Split,
    Sum,
    Text,
    Tuple,
    Xor,
    bits,
)

# ---------------------------------------------------------------------- CAN: floats, signs, overlaps, requests, modes

can_corners = Protocol(
    "can_corners",
    link="can",
    dialects={"old": "two channels", "new": "three"},
    dialect="new",
    configurations={
        "small": {"kind": {0: "a", 1: "b", 2: "a"}},
        "large": {"kind": {n: "ab"[n % 2] for n in range(32)}},
    },
    broadcast={"node": 31},
)
Node = IdField("node", range(32))
kind = can_corners.configured("kind", by="node")

can_corners.message(
    "Floats",
    id=0x100 + Node,
    when=kind("a"),
    direction="from device",
    payload=Struct("half" / Float16b, "single" / Quantity(Float32b, scale=0.5, unit="V"), "rest" / Bytes(2)),
)
can_corners.message(
    "Double", id=0x100 + Node, when=kind("b"), direction="from device", payload=Struct("value" / Float64l)
)
can_corners.message(
    "Signs",
    id=0x120 + Node,
    dialect="old",
    payload=BitLayout(
        4,
        "a" / SignMagnitude(bits(5)),
        "b" / Quantity(SignMagnitude(bits(11)), scale=0.25),
        "c" / Split((16, 3), (24, 2), signed=True),
        "d" / Tuple(bits(3, at=19), bits(2, at=22)),
    ),
)
can_corners.message(
    "Signs",
    id=0x120 + Node,
    dialect="new",
    payload=BitLayout(
        4,
        "a" / SignMagnitude(bits(5)),
        "e" / Enumeration(bits(3), off=0, on=1),
        "f" / Flags(bits(6), x=0, y=5),
        order="msb",
    ),
)
can_corners.message(
    "Muxed",
    id=0x140 + Node,
    payload=Struct(
        "which" / Byte,
        "small" / Multiplexed("which", (0, 1), Quantity(Int16sb, scale=0.1)),
        "large" / Multiplexed("which", 2, Int32ul),
        "two" / Multiplexed("which", 2, Byte),
    ),
)
can_corners.message(
    "Laid",
    id=0x160 + Node,
    payload=BitLayout(
        8,
        "which" / bits(2),
        "common" / bits(6, signed=True),
        "p" / Multiplexed("which", 0, bits(20, at=8)),
        "q" / Multiplexed("which", (1, 2), Quantity(bits(13, at=10, order="msb"), scale=2, offset=-7)),
        "r" / Multiplexed("which", 3, SignMagnitude(bits(9, at=40))),
    ),
)
Ask = can_corners.message(
    "Ask", id=0x200 + Node, direction="to device", payload=Struct("selector" / Byte, "pad" / Reserved(1))
)
AskAll = can_corners.message(
    "AskAll", id=0x220 + Node, direction="to device", payload=Struct("selector" / Byte)
)
can_corners.message(
    "AnswerOne",
    id=0x240 + Node,
    direction="from device",
    reply_to=Ask.where(selector={1, 2}),
    within=0.5,
    payload=Struct("value" / Int16ub, "more" / GreedyBytes),
)
can_corners.message(
    "AnswerThree",
    id=0x240 + Node,
    direction="from device",
    reply_to=(Ask.where(selector=3), AskAll),
    length=(2, 5),
    payload=Struct("sign" / SignMagnitude(16, "big"), "tail" / GreedyBytes),
)
SetMode = can_corners.message(
    "SetMode",
    id=0x260 + Node,
    direction="to device",
    payload=Struct("mode" / Enumeration(Byte, plain=0, fancy=1)),
)
can_corners.message(
    "Plain",
    id=0x280 + Node,
    direction="from device",
    after=SetMode.where(mode="plain"),
    payload=Struct("x" / Int24ub),
)
can_corners.message(
    "Fancy",
    id=0x280 + Node,
    direction="from device",
    after=SetMode.where(mode="fancy"),
    payload=Struct("y" / Int8sb, "z" / Int16ub),
)
can_corners.message("Poll", id=0x2A0 + Node, remote=True, direction="to device")
can_corners.message("Empty", id=0x2A0 + Node, direction="from device")
can_corners.message(
    "Wide",
    id=IdField("upper", range(7)) << 26 | IdField("middle", (0, 3, 5, 200)) << 8 | IdField("node", range(32)),
    extended=True,
    fd=True,
    length=(8, 12, 16, 64),
    payload=Struct("stamp" / Int64ub, "blob" / GreedyBytes),
)
can_corners.message(
    "Signed",
    id=0x1000000 | IdField("number", range(1 << 14)) << 2 | 0x1,
    extended=True,
    check=Crc("CRC8-AUTOSAR", over=(IdBytes(4, mask=0xFFFF), slice(1, None), Extra()), field="crc"),
    check_extra=b"\x42",
    payload=BitLayout(
        5, "crc" / bits(8), "turn" / Counter(bits(4)), "value" / bits(12, at=16), "flag" / bits(1, at=39)
    ),
)
can_corners.message(
    "Chosen",
    id=0x2E0 + Node,
    check=Crc(
        "CRC8-AUTOSAR",
        over=(slice(None, 2), slice(3, None), DataIds("turn", bytes(range(7, 21)))),
        field="crc",
    ),
    payload=BitLayout(
        5, "value" / bits(12), "turn" / Counter(bits(4), modulo=14), "crc" / bits(8), "more" / bits(16)
    ),
)
can_corners.message(
    "Nested",
    id=0x300 + Node,
    payload=Struct(
        "pair" / Array(2, Struct("a" / Byte, "b" / BitLayout(1, "lo" / bits(3), "hi" / bits(4)))),
        "kind" / Enumeration(Byte, none=0, some=7),
        "body" / Switch(this.kind, {"some": Int16ub, 7: Int16ub}, default=Byte),
    ),
)

# ---------------------------------------------------------------------- streams: what only construct can read


class Doubled(Adapter):
    """A number stored as its half: an adapter that nobody here knows."""

    def _decode(self, obj: int, context: object, path: str) -> int:
        return 2 * obj

    def _encode(self, obj: int, context: object, path: str) -> int:
        return obj // 2


opaque_corners = Protocol("opaque_corners", link="serial")
_opaque = opaque_corners.framing(
    sync=b"\xaa\x55\xaa",  # overlaps itself
    header=Struct("kind" / Byte, "words" / Int16ub),
    size=this.words * 1 + 8,
    max_size=96,
    gap=0.2,
    check=Sum(2, inverted=True, order="big", over=slice(3, -2)),
)
_opaque("Numbers", match={"kind": 1}, payload=Struct("a" / VarInt, "b" / ZigZag, "c" / Doubled(Byte)))
_opaque(
    "Things",
    match={"kind": 2},
    payload=Struct("things" / PrefixedArray(Byte, Struct("x" / Byte, "y" / Int16ul))),
)
_opaque(
    "Branches",
    match={"kind": 3},
    payload=Struct(
        "flag" / Byte,
        "one" / IfThenElse(this.flag > 3, Int16ub, Byte),
        "two" / If(this.flag == 1, Float32l),
        "three" / Switch(this.flag, {0: Bytes(3), 2: Int32ul}, default=Pass),
    ),
)
_opaque(
    "Prefix",
    match={"kind": 4},
    payload=Struct("text" / Prefixed(Byte, Text()), "tail" / GreedyRange(Int16ub)),
)
_opaque(
    "Counted",
    match={"kind": 5},
    payload=Struct("n" / Rebuild(Byte, len_(this.items)), "items" / Array(this.n, Byte)),
)
_opaque(
    "Sized",
    match={"kind": IdField("size", range(16, 21))},
    payload=Struct("data" / Bytes(this._.size - 16), "end" / Const(b"!")),
)
_opaque("Many", match={"kind": 6}, payload=Struct("many" / Array(70, Byte)))

# ---------------------------------------------------------------------- streams: checks and heads of every kind

check_corners = Protocol("check_corners", link="serial")
_xor = check_corners.framing(
    name="xor",
    sync=b"\x7e",
    header=Struct("length" / Byte, "kind" / Byte),
    size=this.length * 2 + 5,
    max_size=64,
    check=Xor(),
)
_xor("Xored", match={"kind": (1, 2, 9)}, payload=Struct("words" / GreedyRange(Int16ul), "last" / Byte))
_fixed = check_corners.framing(
    name="fixed",
    sync=b"\x7f\x7f",
    not_next=b"\x7f\x00",
    size=9,
    max_size=9,
    check=Crc("CRC16-IBM-3740", over=slice(0, -2)),
)
_fixed("Fixed", payload=Struct("five" / Bytes(5)))
_fletch = check_corners.framing(
    name="fletcher",
    sync=b"\x75\x65",
    header=Struct("set" / Byte, "length" / Byte),
    size=this.length + 6,
    max_size=261,
    check=Fletcher(over=slice(0, -2)),
)
_fletch("Fields", match={"set": IdField("group", range(4)) + 0x80}, payload=Struct("fields" / GreedyBytes))
_fletch("Ping", match={"set": 0x01})

extra_corners = Protocol("extra_corners", link="serial")
_extra = extra_corners.framing(
    sync=b"\xfe",
    header=Struct("length" / Byte, "sequence" / Default(Byte, 0), "number" / Byte),
    size=this.length + 6,
    max_size=261,
    check=Crc("CRC16-MCRF4XX", over=(slice(1, -2), Extra())),
)
_extra(
    "First",
    match={"number": 0},
    check_extra=b"\x32",
    payload=Struct("value" / Float32l, "signs" / SignMagnitude(8)),
)
_extra(
    "Second",
    match={"number": 0xFE},
    check_extra=b"\x00\x01",
    payload=Struct("text" / Text(4), "rest" / Text()),
)

sum_corner = Protocol("sum_corner", link="serial")
_sum = sum_corner.framing(
    sync=b"\xff\xff",
    header=Struct("id" / Byte, "length" / Byte),
    size=this.length + 4,
    max_size=259,
    gap=0.1,
    check=InvertedSum(),
)
_sum("Any", payload=Struct("data" / GreedyBytes))  # unlike Dynamixel, FF FF FF is not excluded

unchecked_corner = Protocol("unchecked_corner", link="datagram")
_bare = unchecked_corner.framing(
    sync=b"\x00", header=Struct("length" / Byte), size=this.length + 2, max_size=257
)
_bare("Bare", payload=Struct("data" / GreedyBytes))

escaped_corner = Protocol("escaped_corner", link="serial")
_escaped = escaped_corner.framing(
    sync=b"\xa5",
    header=Struct("kind" / Byte, "words" / Byte),
    size=Escaped(this.words * 2 + 5, 3, Int24ul),
    max_size=40,
    check=Crc("CRC16-MODBUS"),
)
_escaped("Long", match={"kind": 1}, payload=Struct("first" / Int16ul, "rest" / GreedyBytes))
_escaped("Pairs", match={"kind": 2}, payload=Struct("pairs" / GreedyRange(Struct("a" / Byte, "b" / Int8sl))))
_escaped("Fixed", match={"kind": 3}, payload=Struct("six" / Array(6, Int16ul), "last" / Bytes(2)))


CORNERS: dict[str, Protocol] = {
    p.name: p
    for p in (
        can_corners,
        opaque_corners,
        check_corners,
        extra_corners,
        sum_corner,
        unchecked_corner,
        escaped_corner,
    )
}
