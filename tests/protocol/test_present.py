"""Fields that are there by bits, and packets whose size bits say."""

from __future__ import annotations

import struct
from itertools import product
from typing import Any

import pytest
from construct import (
    Array,
    Byte,
    Float32l,
    GreedyBytes,
    GreedyRange,
    Int16sb,
    Int16sl,
    Int16ul,
    Int64ul,
    Struct,
    this,
)

from aces_bus import Frame, decode
from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import BitLayout, Crc, Flags, Multiplexed, Present, Protocol, Quantity, Sum, bits
from aces_bus.testing import law_tests


def groups() -> Protocol:
    """Groups of fields: a byte says which masks follow, each mask which fields."""
    made = Protocol("groups", link="serial", source="after VectorNav's binary output")
    packet = made.framing(
        sync=b"\xfa",
        header=Struct("groups" / Byte),
        size="fields",
        max_size=200,
        check=Crc("CRC16-XMODEM", order="big"),
    )
    packet(
        "Binary",
        direction="from device",
        payload=Struct(
            "common" / Present("groups", 0, Int16ul),
            "imu" / Present("groups", 2, Int16ul),
            "time" / Present("common", 0, Quantity(Int64ul, unit="s", scale=1e-9)),
            "angles" / Present("common", 3, Array(3, Float32l)),
            "temperature" / Present("imu", 1, Quantity(Int16sl, unit="°C", scale=0.01)),
            "acceleration" / Present("imu", 2, Struct("x" / Float32l, "y" / Float32l)),
        ),
    )
    return made


def frames() -> Protocol:
    """Optional fields of a CAN frame, the last of open size."""
    made = Protocol("frames", link="can", source="drawn")
    payload = Struct(
        "flags" / Flags(Byte, speed=0, load=1, more=7),
        "speed" / Present("flags", 0, Int16ul),
        "load" / Present("flags", 1, Quantity(Byte, unit="%", scale=0.5)),
        "more" / Present("flags", 7, GreedyBytes),
    )
    made.message("State", id=0x10, direction="from device", payload=payload)
    return made


def points() -> Protocol:
    """Five bits of the header count points of three bytes, as the LD06 lidar has it."""
    made = Protocol("points", link="serial", source="after the LD06 development manual")
    packet = made.framing(
        sync=b"\x54",
        header=Struct("kind" / Byte),
        size=(this.kind & 31) * 3 + 5,
        max_size=98,
        check=Crc("CRC8-MAXIM-DOW"),
    )
    point = Struct("distance" / Int16ul, "intensity" / Byte)
    packet("Scan", payload=Struct("speed" / Int16ul, "points" / GreedyRange(point)))
    return made


def chosen() -> Protocol:
    """Layouts of bits whose selectors say what they hold, one of them there by a bit."""
    made = Protocol("chosen", link="serial", source="drawn")
    packet = made.framing(sync=b"\xfb", header=Struct("mask" / Byte), size="fields", max_size=64, check=Sum())

    def layout() -> BitLayout:
        return BitLayout(
            3,
            "page" / bits(2),
            "low" / Multiplexed("page", 1, bits(4, at=2)),
            "high" / Multiplexed("page", (2, 3), Quantity(bits(8, at=2), scale=0.5)),
            "inner" / Multiplexed("page", 3, bits(2, at=10)),
            "deep" / Multiplexed("inner", 1, bits(4, at=12, signed=True)),
        )

    fields = ("a" / Present("mask", 0, Int16ul), "some" / Present("mask", 1, layout()))
    packet("State", payload=Struct(*fields, "always" / layout(), "b" / Present("mask", 2, Float32l)))
    return made


test_groups_obey_the_laws = law_tests(groups(), examples=4)
test_frames_obey_the_laws = law_tests(frames(), examples=4)
test_points_obey_the_laws = law_tests(points(), examples=4)
test_chosen_obey_the_laws = law_tests(chosen(), examples=4)


def test_selectors_beside_fields_that_are_there_by_bits() -> None:
    """Each selector says what its own layout holds; in one that is not there nothing is."""
    made = chosen()
    for mask, page, inner in product(range(8), range(4), range(4)):
        word = page | 0x15 << 2 | inner << 10 | 0x9 << 12
        body = bytes([mask]) + bytes(2 * (mask & 1)) + word.to_bytes(3, "little") * (mask >> 1 & 1)
        body += word.to_bytes(3, "little") + bytes(4 * (mask >> 2))
        (record,) = made.scanner().feed(b"\xfb" + body + bytes([sum(body) & 0xFF]))
        assert (record.some is not None, record.b is not None) == (bool(mask & 2), bool(mask & 4))
        for part in (record.always, *([record.some] if mask & 2 else [])):
            assert (part.page, part.low) == (page, 5 if page == 1 else None)
            assert part.high == (((word >> 2 & 0xFF) / 2) if page > 1 else None)
            assert part.inner == (inner if page == 3 else None)
            assert part.deep == (-7 if page == 3 and inner == 1 else None)


def test_every_combination_of_bits() -> None:
    """A packet is what plain struct makes of the fields whose bits are set, and is read as them."""
    made = groups()
    scanner = made.scanner()
    for common, imu in product(range(16), (None, 0, 2, 4, 6)):
        given: dict[str, Any] = {"groups": 1 if imu is None else 5, "common": common, "imu": imu}
        body = struct.pack("<BH", given["groups"], common) + (b"" if imu is None else struct.pack("<H", imu))
        if common & 1:
            given["time"], body = 1.5, body + struct.pack("<Q", 1_500_000_000)
        if common & 8:
            given["angles"], body = (1.0, 2.0, 3.0), body + struct.pack("<3f", 1, 2, 3)
        if imu and imu & 2:
            given["temperature"], body = -20.5, body + struct.pack("<h", -2050)
        if imu and imu & 4:
            given["acceleration"], body = {"x": 0.5, "y": -1.0}, body + struct.pack("<2f", 0.5, -1)
        packet = b"\xfa" + body + struct.pack(">H", Crc("CRC16-XMODEM").compute(body))
        assert made.encode("Binary", **given) == packet
        for _ in range(4):  # enough for a shape that comes rarely to become one that is printed
            (record,) = scanner.feed(packet)
            for name in made["Binary"].fields:
                value: Any = getattr(record, name)
                if name == "acceleration" and value is not None:
                    value = {"x": value.x, "y": value.y}
                assert value == given.get(name), (
                    common, imu, name,
                )  # fmt: skip


def test_a_candidate_inside_a_failed_one_may_end_behind_it() -> None:
    """All bytes are accounted for where sums, as the check, were made of the longer packets alone."""
    scanner = chosen().scanner()
    data = b"\xfb" * 1170
    assert [*scanner.feed(data), *scanner.close()] == []
    assert sum(scanner.counts.reasons.values()) + scanner.counts.pending == len(data)


def test_values_beside_their_bits_are_refused() -> None:
    """A field whose bit is not set is not sent in silence, and one whose bit is set is not left out."""
    made = frames()
    with pytest.raises(FieldError, match="load: only there while bit 1 of flags is set"):
        made.encode("State", flags=1, speed=5, load=3)
    with pytest.raises(FieldError, match="speed"):
        made.encode("State", flags=1)
    with pytest.raises(FieldError, match=r"by its bits a packet has 8 bytes .*, these fields make 11"):
        points().encode("Scan", kind=0x21, speed=1, points=[{"distance": 1, "intensity": 2}] * 2)


def test_flags_that_say_what_is_there_are_given_by_name() -> None:
    """Names of flags are their number, before the fields and in the header."""
    made = frames()
    assert made.encode("State", flags=["speed"], speed=5).data == made.encode("State", flags=1, speed=5).data
    stream = Protocol("stream", link="serial")
    packet = stream.framing(
        sync=b"$", header=Struct("flags" / Flags(Byte, a=0, b=3)), size="fields", max_size=9
    )
    packet("M", payload=Struct("a" / Present("flags", 0, Byte), "b" / Present("flags", 3, Int16ul)))
    assert stream.encode("M", flags=["b"], b=7) == stream.encode("M", flags=8, b=7) == b"$\x08\x07\x00"


def test_missing_values_beside_fields_that_are_there_by_bits() -> None:
    """A field that is always there and may be unknown is a column that may be absent."""
    made = Protocol("beside", link="can")
    payload = Struct(
        "flags" / Byte,
        "speed" / Quantity(Byte, unit="m/s", unknown=[255]),
        "load" / Present("flags", 0, Byte),
    )
    made.message("State", id=0x10, payload=payload)
    frames = [made.encode("State", flags=0, speed=None), made.encode("State", flags=1, speed=3, load=4)]
    table = decode(frames, made)
    assert table["State"]["speed"].to_list() == [None, 3]
    assert table["State"]["speed"].kind.optional


def test_a_frame_of_another_length_is_malformed() -> None:
    """A frame whose bits say three bytes is not read with four."""
    made = frames()
    scanner = made.scanner(include_unknown=True)
    good, bad = scanner.feed([Frame(0x10, b"\x01\x05\x00"), Frame(0x10, b"\x01\x05\x00\x00")])
    assert (good.speed, good.load, good.more) == (5, None, None)
    assert bad.reason.startswith("malformed: length")


def test_units_and_types_are_known() -> None:
    """Fields that construct places have their unit, their type and the bit that they depend on."""
    from aces_bus.protocol.draw.table import FieldRow

    rows = {row.name: row for row in FieldRow.table(groups()["Binary"].plan)}
    assert (rows["temperature"].unit, rows["temperature"].type, rows["temperature"].place) == (
        "°C",
        "int16 le",
        "if imu bit 1",
    )


def test_what_cannot_be_there_by_bits() -> None:
    """Deciding fields come before, are whole unsigned integers at a known place, and not in a BitLayout."""
    made = Protocol("wrong", link="can")
    with pytest.raises(SpecError, match="multiplexed by 'mask', which is not before it"):
        made.message("A", id=1, payload=Struct("x" / Present("mask", 0, Byte)))
    with pytest.raises(SpecError, match="is an unsigned integer of whole bytes"):
        made.message("B", id=1, payload=Struct("mask" / Int16sb, "x" / Present("mask", 0, Byte)))
    with pytest.raises(SpecError, match="in a BitLayout these stay"):
        BitLayout(2, "mask" / bits(8), "x" / Present("mask", 0, bits(8)))
    with pytest.raises(SpecError, match="a bit has a number from 0 to 63"):
        Present("mask", 64, Byte)
    wire = Protocol("wire", link="serial")
    packet = wire.framing(sync=b"$", header=Struct("m" / Byte), size="fields", max_size=9)
    packet("One", payload=Struct("x" / Present("m", 0, Byte)))
    with pytest.raises(SpecError, match="give Two a framing of its own"):
        packet("Two", payload=Struct("x" / Present("m", 0, Byte)))
    with pytest.raises(SpecError, match="has no fixed size"):
        wire.framing(sync=b"%", header=Struct("m" / Byte), size="fields", max_size=9)(
            "Open", payload=Struct("x" / Present("m", 0, GreedyBytes))
        )
    with pytest.raises(SpecError, match="size='fields' is for a Struct"):
        wire.framing(sync=b"&", size="fields", max_size=9)("Bits", payload=BitLayout(1, "x" / bits(8)))
    payload = Struct("m" / Byte, "x" / Present("m", 0, Byte), "sum" / Byte)
    with pytest.raises(SpecError, match="check field 'sum' has no fixed place"):
        made.message("C", id=2, payload=payload, check=Sum(field="sum"))
    with pytest.raises(SpecError, match="not 'field'"):
        wire.framing(sync=b"!", size="field", max_size=9)
    with pytest.raises(SpecError, match="depend on one header field"):
        wire.framing(sync=b"!", header=Struct("a" / Byte, "b" / Byte), size=this.a * this.b + 4, max_size=9)
