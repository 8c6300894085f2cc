"""VectorNav's binary output against a decoder by plain struct, and the manual's worked frame.

The decoder here follows the tables of UM001 v2.22 (§4.3.6 for sizes, §4.4 to §4.9 for types) and of UM005 v2.22 (groups
4, 6, 7), field by field as they are printed: a format of struct for each bit of each group. It knows nothing of the spec.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from random import Random
from typing import Any

import pytest

from aces_bus import Unknown, as_dict
from aces_bus.errors import FieldError
from aces_bus.protocol.lint import check_protocol
from aces_protocols.vectornav.spec import vectornav

#: A format for each bit: groups 1 to 7.
FORMATS = (
    ("Q", "Q", "Q", "3f", "4f", "3f", "3d", "3f", "3f", "6f", "5f", "7f", "H", "I", "Q"),
    ("Q", "Q", "Q", "H", "Q", "Q", "bBBBBBH", "I", "I", "B", "1s"),
    ("H", "3f", "3f", "3f", "f", "f", "4f", "3f", "3f", "3f", "3f", "H", "40s"),
    ("bBBBBBH", "Q", "H", "B", "B", "3d", "3d", "3f", "3f", "3f", "f", "f", "Bb", "7f"),
    ("H", "3f", "4f", "9f", "3f", "3f", "3f", "3f", "3f", "12s", "28s", "24s", "12s"),
    ("H", "3d", "3d", "3f", "3f", "3f", "3f", "3f", "3f", "f", "f", "68s", "64s"),
    ("bBBBBBH", "Q", "H", "B", "B", "3d", "3d", "3f", "3f", "3f", "f", "f", "Bb", "7f"),
)
#: Sizes, as the table of §4.3.6 prints them (without the last two of groups 4 and 7, which hold lists).
SIZES = (
    (8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8),
    (8, 8, 8, 2, 8, 8, 8, 4, 4, 1, 1),
    (2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2, 40),
    (8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 2, 28),
    (2, 12, 16, 36, 12, 12, 12, 12, 12, 12, 28, 24, 12),
    (2, 24, 24, 12, 12, 12, 12, 12, 12, 4, 4, 68, 64),
    (8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 2, 28),
)
NAMES = ("common", "time", "imu", "gps", "attitude", "ins", "gps2")
#: The frame of example case 1 (§4.3.7).
CASE_1 = bytes.fromhex("FA 01 08 00 93 50 2E 42 83 3E F1 3F 48 B5 04 BB 92 88")

#: The frame that the vendor's C library passes to itself (vnproglib 1.1, c/examples/uart_protocol): time and angles.
VENDOR = bytes.fromhex("FA 01 09 00 70 05 00 03 0A 00 00 00 48 0E 2C 42 08 4C 37 C1 10 38 8B C2 D4 CB")


def crc(data: bytes) -> int:
    """The manual's CRC (§3.5): CCITT, begun with 0, over all behind the sync byte."""
    value = 0
    for byte in data:
        value = (value >> 8) | (value << 8) & 0xFFFF
        value ^= byte
        value ^= (value & 0xFF) >> 4
        value ^= (value << 12) & 0xFFFF
        value ^= (value & 0xFF) << 5
    return value


def packet(masks: dict[int, int], values: list[Any]) -> bytes:
    """A packet of these groups (number → mask) and the fields' values in order."""
    groups = sum(1 << number for number in masks)
    head = bytes((groups,)) + b"".join(struct.pack("<H", mask) for _, mask in sorted(masks.items()))
    formats = "".join(FORMATS[number][bit] for number, bit in set_bits(masks))
    body = head + struct.pack(f"<{formats}", *values)
    return b"\xfa" + body + struct.pack(">H", crc(body))


def set_bits(masks: dict[int, int]) -> Iterator[tuple[int, int]]:
    """The fields of these masks, in their order: group, bit."""
    for number, mask in sorted(masks.items()):
        yield from ((number, bit) for bit in range(len(FORMATS[number])) if mask >> bit & 1)


def decoded(data: bytes) -> dict[tuple[int, int], tuple[Any, ...]]:
    """The fields of a packet by the tables."""
    groups, at = data[1], 2
    masks: dict[int, int] = {}
    for number in range(7):
        if groups >> number & 1:
            (masks[number],) = struct.unpack_from("<H", data, at)
            at += 2
    found: dict[tuple[int, int], tuple[Any, ...]] = {}
    for number, bit in set_bits(masks):
        layout = f"<{FORMATS[number][bit]}"
        found[number, bit] = struct.unpack_from(layout, data, at)
        at += struct.calcsize(layout)
    assert at == len(data) - 2
    return found


def numbers_of(value: Any) -> list[Any]:
    """The numbers of a field in their order; bits of a layout as they are."""
    if isinstance(value, dict):
        return [number for inner in value.values() for number in numbers_of(inner)]
    if isinstance(value, list | tuple):
        return [number for inner in value for number in numbers_of(inner)]
    return [value]


def drawn(dice: Random, share: float) -> bytes:
    """A packet of drawn groups, masks and values."""
    masks = {number: 0 for number in range(7) if dice.random() < 0.5} or {dice.randrange(7): 0}
    values: list[Any] = []
    for number in masks:
        for bit in range(len(FORMATS[number])):
            masks[number] |= (dice.random() < share) << bit
    for number, bit in set_bits(masks):
        layout = f"<{FORMATS[number][bit]}"
        for value in struct.unpack(layout, dice.randbytes(struct.calcsize(layout))):
            values.append(0.5 if value != value else value)
    return packet(masks, values)


def fields_in_order() -> dict[tuple[int, int], str]:
    """Our fields by group and bit: those of a group are declared in the order of its bits."""
    found: dict[tuple[int, int], str] = {}
    for number, name in enumerate(NAMES):
        own = [field for field in vectornav["Binary"].fields if field.startswith(f"{name}_")]
        assert len(own) == len(FORMATS[number])
        found |= {(number, bit): field for bit, field in enumerate(own)}
    return found


def test_the_tables_agree() -> None:
    """Types and sizes of the manual's tables are the same bytes."""
    assert [[struct.calcsize(f"<{layout}") for layout in group] for group in FORMATS] == [
        list(sizes) for sizes in SIZES
    ]


def test_the_manual_s_frame() -> None:
    """Example case 1: yaw, pitch and roll. (The CRC of case 2 is not that of its bytes, with either mask.)"""
    (record,) = vectornav.scanner().feed(CASE_1)
    assert record.common_ypr == pytest.approx((43.578686, 1.8847202, -2.0249654e-3), abs=1e-6)
    assert decoded(CASE_1) == {(0, 3): record.common_ypr}
    assert vectornav.encode("Binary", groups=["common"], common=8, common_ypr=record.common_ypr) == CASE_1
    second = bytes.fromhex("FA 05 08 00 01 00 A4 15 02 42 4D DF EB 3F F6 1A 36 BE BF 2D A4 41 A8 3A")
    assert crc(second[1:-2]) != int.from_bytes(second[-2:], "big")


def test_the_vendor_s_frame() -> None:
    """Of the example of vnproglib: time since startup; yaw, pitch and roll."""
    (record,) = vectornav.scanner().feed(VENDOR)
    assert decoded(VENDOR) == {(0, 0): (0x0A_0300_0570,), (0, 3): record.common_ypr}
    assert record.common_time_startup == 0x0A_0300_0570
    assert record.common_ypr == pytest.approx((43.013947, -11.456062, -69.609497), abs=1e-6)


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_drawn_packets_are_the_same_numbers(share: float) -> None:
    """Every field of drawn masks, raw, with noise between the packets; and the encoder writes the same bytes."""
    dice = Random(f"vectornav {share}")
    packets = [drawn(dice, share) for _ in range(60)]
    fields = fields_in_order()
    variant = vectornav.variant()
    compared = 0
    records = vectornav.scanner(raw=True).feed(b"\x00\x55".join(packets))
    assert [record.meta.raw for record in records] == packets
    for data, record in zip(packets, records, strict=True):
        theirs, ours = decoded(data), as_dict(record)
        assert {key for key, field in fields.items() if ours[field] is not None} == set(theirs)
        for key, values in theirs.items():
            mine = numbers_of(ours[fields[key]])
            if fields[key] in ("common_ins_status", "ins_status"):  # a layout of bits
                mine = [struct.unpack("<H", vectornav_status(ours[fields[key]]))[0]]
            assert mine == list(values), fields[key]
            compared += len(values)
        assert variant.encoder.build(variant["Binary"], ours, raw=True) == data
    assert compared > 60 * 60 * share


def vectornav_status(bits: dict[str, int]) -> bytes:
    """The two bytes of a status, its bits put together by the manual's table."""
    at = {
        "mode": 0,
        "has_fix": 2,
        "imu_error": 4,
        "mag_pressure_error": 5,
        "gnss_error": 6,
        "heading_by_ins": 8,
        "compass": 9,
    }
    return struct.pack("<H", sum(bits[name] << place for name, place in at.items()) | bits["reserved"])


def test_a_field_without_its_bit_is_refused() -> None:
    """Values beside the masks are not sent in silence."""
    with pytest.raises(FieldError, match="bit 4 of common"):
        vectornav.encode(
            "Binary", groups=["common"], common=8, common_ypr=[1, 2, 3], common_quaternion=[1, 0, 0, 0]
        )


def test_lists_of_satellites_are_not_read_wrongly() -> None:
    """SatInfo (bit 14 of GPS) counts what follows inside itself: such a packet is unknown, and the next one is read."""
    body = struct.pack("<BHBBB8s", 8, 1 << 3 | 1 << 14, 7, 1, 0, bytes(8))
    data = b"\xfa" + body + struct.pack(">H", crc(body))
    scanner = vectornav.scanner(include_unknown=True)
    records = [*scanner.feed(data + CASE_1 * 2), *scanner.close()]
    assert [one.meta.raw for one in records if not isinstance(one, Unknown)][-1] == CASE_1
    assert all(isinstance(one, Unknown) or one.meta.raw == CASE_1 for one in records)


def test_the_spec_is_sound() -> None:
    """Nothing of it is an error or a warning."""
    assert [str(found) for found in check_protocol(vectornav) if found.level != "note"] == []
