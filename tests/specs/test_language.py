"""Corners of the language that these specs brought up."""

from __future__ import annotations

import pytest
from construct import Byte, Const, GreedyRange, If, Int16ul, Int32ul, Struct, this

from aces_bus import Frame, Unknown, as_dict
from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import Crc, Extra, IdField, Multiplexed, Protocol, Xor
from aces_bus.protocol.live.stream import StreamScanner


def test_a_captured_part_may_have_names() -> None:
    """Names of a captured number: shown, sent and refused as those of an enumeration."""
    protocol = Protocol("named", link="can")
    kind = IdField("kind", range(16), names={"command": 1, "status": 2})
    protocol.message("Any", id=IdField("node", range(8)) << 4 | kind)
    scanner = protocol.scanner()
    assert [r.kind for r in scanner.feed([Frame(0x31), Frame(0x32), Frame(0x3F)])] == [
        "command",
        "status",
        15,
    ]
    assert protocol.encode("Any", node=3, kind="status").arbitration_id == 0x32
    assert protocol.encode("Any", node=3, kind=15).arbitration_id == 0x3F
    with pytest.raises(FieldError, match="no value named 'stop'"):
        protocol.encode("Any", node=3, kind="stop")


def test_a_long_range_is_not_walked() -> None:
    """The bounds of a range are its ends: a capture of 29 bits costs what one of 8 does."""
    whole = IdField("id", range(1 << 29))
    assert whole.width == 29
    assert (whole + 0).largest == (1 << 29) - 1


def test_constants_before_what_is_not_flat_tell_messages_apart() -> None:
    """Two lists behind different first bytes are not ambiguous, though construct reads them."""
    protocol = Protocol("lists", link="serial")
    packet = protocol.framing(
        sync=b"\xaa", header=Struct("length" / Byte), size=this.length + 3, max_size=64, check=Xor()
    )
    for name, code in (("Ones", 1), ("Twos", 2)):
        packet(
            name, payload=Struct(Const(code, Byte), "values" / GreedyRange(Struct("a" / Byte, "b" / Byte)))
        )
    scanner = protocol.scanner()
    values = [{"a": 1, "b": 2}]
    records = scanner.feed(
        protocol.encode("Ones", values=values) + protocol.encode("Twos", values=values * 2)
    )
    assert [type(r).__name__ for r in records] == ["Ones", "Twos"]


def test_a_constant_that_is_not_always_there_is_no_template() -> None:
    """A constant inside a multiplexed field holds only while the field is there."""
    protocol = Protocol("sometimes", link="can")
    protocol.message(
        "Reply",
        id=0x10,
        payload=Struct(
            "ok" / Byte, "value" / Multiplexed("ok", 1, Struct(Const(b"\x55"), "number" / Int16ul))
        ),
    )
    records = protocol.scanner(include_unknown=True).feed(
        [Frame(0x10, b"\x00"), Frame(0x10, b"\x01\x55\x02\x00"), Frame(0x10, b"\x01\x54\x02\x00")]
    )
    assert [None if isinstance(r, Unknown) else as_dict(r)["value"] for r in records] == [
        None,
        {"number": 2},
        None,
    ]
    assert [isinstance(r, Unknown) for r in records] == [False, False, True]


def test_an_optional_tail_has_no_fixed_size() -> None:
    """`If` on a field gives a message of several lengths, on CAN too."""
    protocol = Protocol("tail", link="can")
    message = protocol.message(
        "Reading", id=0x10, payload=Struct("more" / Byte, "time" / If(this.more, Int32ul))
    )
    assert message.lengths is not None
    assert set(message.lengths) >= {1, 5}
    scanner = protocol.scanner(include_unknown=True)
    records = scanner.feed([Frame(0x10, b"\0"), Frame(0x10, b"\1\2\0\0\0"), Frame(0x10, b"\1\2")])
    assert [None if isinstance(r, Unknown) else r.time for r in records] == [None, 2, None]
    assert isinstance(records[2], Unknown)


def test_a_check_counts_from_the_packet_s_end_when_building_too() -> None:
    """A slice with a negative end covers the same bytes in the encoder as in the scanner."""
    protocol = Protocol("ends", link="serial")
    packet = protocol.framing(
        sync=b"\xaa",
        header=Struct("length" / Byte),
        size=this.length + 2,
        max_size=64,
        check=Crc("CRC16-MODBUS", over=slice(0, -2)),
    )
    packet("Number", payload=Struct("value" / Int32ul))
    data = protocol.encode("Number", value=0x01020304)
    assert int.from_bytes(data[-2:], "little") == Crc("CRC16-MODBUS").compute(data[:-2])
    assert [r.value for r in protocol.scanner().feed(data)] == [0x01020304]


def test_a_seeded_check_needs_its_seed() -> None:
    """A framing whose check ends with bytes of the message is refused messages without."""
    protocol = Protocol("seeded", link="serial")
    packet = protocol.framing(
        sync=b"\xaa",
        header=Struct("kind" / Byte),
        size=5,
        check=Crc("CRC16-MODBUS", over=(slice(1, -2), Extra())),
    )
    packet("One", match={"kind": 1}, check_extra=b"\x11", payload=Struct("value" / Byte))
    with pytest.raises(SpecError, match="give Two its check_extra"):
        packet("Two", match={"kind": 2}, payload=Struct("value" / Byte))
    with pytest.raises(SpecError, match="is seeded by kind; match it"):
        packet("Three", check_extra=b"\x33", payload=Struct("value" / Byte))
    scanner = protocol.scanner(include_unknown=True)
    assert isinstance(scanner, StreamScanner)
    good = protocol.encode("One", value=7)
    scanner.feed(good[:1] + b"\x02" + good[2:] + good)
    scanner.close()
    assert scanner.counts.reasons["malformed: no message 2 to check by"] == 1
    assert scanner.counts.decoded == 5
