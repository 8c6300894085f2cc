"""VESC: packets on a UART and in pieces on CAN; its check is CRC-16/XMODEM with the stop behind it."""

from __future__ import annotations

import random
from typing import Any

import anycrc
import pytest

from aces_bus import Frame, Unknown
from aces_protocols.vesc.buffers import Buffers, can_pieces, check_of
from aces_protocols.vesc.spec import vesc
from aces_protocols.vesc_uart.packets import PacketReader, framed, packet_of
from aces_protocols.vesc_uart.spec import VALUES, mask_of, vesc_uart


def test_its_check_is_that_of_the_catalogue() -> None:
    """The CRC of 24 bits that the spec declares is CRC-16/XMODEM and 03, on any packet."""
    model = anycrc.Model("CRC16-XMODEM")
    assert model.calc(b"123456789") == 0x31C3
    draw = random.Random(1)
    for size in (0, 1, 2, 7, 255, 256, 300, 511):
        data = draw.randbytes(size)
        packet = framed(b"\x14" + data)
        assert packet[-3:] == model.calc(b"\x14" + data).to_bytes(2, "big") + b"\x03"
        (record,) = vesc_uart.scanner(direction="to device" if size < 255 else "from device").feed(packet)
        assert type(record).__name__ == ("Terminal" if size < 255 else "LongAnswer")
        assert record.meta.size == len(packet)


def test_a_wrong_byte_costs_a_packet() -> None:
    """Wherever it is; the next packet is read."""
    good = framed(packet_of("GetSelected", mask=0x81C0))
    for place in range(len(good)):
        bad = bytes(byte ^ 0x40 if n == place else byte for n, byte in enumerate(good))
        scanner = vesc_uart.scanner(direction="to device", include_unknown=True)
        found = [*scanner.feed(bad + good), *scanner.close()]
        assert [type(one).__name__ for one in found if not isinstance(one, Unknown)] == ["GetSelected"], place


def sent(packet: bytes, **who: int) -> list[Frame]:
    """The frames of a packet to or from controller 5."""
    found: list[Frame] = []
    for name, fields in can_pieces(packet, **who):
        more: dict[str, Any] = {**({} if name.startswith("Fill") else {"id": 5}), **fields}
        found.append(vesc.encode(name, **more))
    return found


def test_the_documents_answer_in_pieces() -> None:
    """The worked example: duty, speed, voltage and fault of controller 5 to host C8."""
    values = {"duty": -0.125, "speed": -1500, "voltage": 48.2, "fault": "none"}
    packet = packet_of("Selected", mask=mask_of(*values), **{**dict.fromkeys(VALUES), **values})
    frames = sent(packet, host=0xC8, receiver=0xC8, mode=1)
    assert [(frame.arbitration_id, frame.data.hex(" ")) for frame in frames] == [
        (0x5C8, "00 32 00 00 81 c0 ff 83"),
        (0x5C8, "07 ff ff fa 24 01 e2 00"),
        (0x7C8, "05 01 00 0e e7 97"),
    ]
    buffers = Buffers(0xC8)
    whole = [buffers.take(record) for record in vesc.scanner(direction="from device").feed(frames)]
    assert whole == [None, None, packet]
    record = PacketReader("from device").read(packet)
    assert {name: getattr(record, name) for name in values} == values
    assert record.position is None


@pytest.mark.parametrize("size", [1, 6, 7, 8, 14, 252, 259, 260, 265, 266, 511, 512])
def test_packets_of_any_size(size: int) -> None:
    """One frame up to six bytes, else pieces; offsets from 259 on in two bytes."""
    packet = random.Random(size).randbytes(size)
    frames = sent(packet, host=0xC8, receiver=5)
    assert {frame.arbitration_id >> 8 for frame in frames} <= {5, 6, 7, 8}
    buffers = Buffers(5)
    found = [buffers.take(record) for record in vesc.scanner(direction="to device").feed(frames)]
    assert [one for one in found if one is not None] == [packet]
    assert (len(frames) == 1) == (size <= 6)


def test_lost_and_mixed_pieces_are_no_packet() -> None:
    """A packet that lacks a piece, or whose check does not hold, is none; the next one is."""
    packet = bytes(range(30))
    frames = sent(packet, host=0xC8, receiver=5)
    wrong = vesc.encode("LongRequest", id=5, host=0xC8, mode=0, length=30, crc=check_of(b"other"))
    for some in (frames[1:], [*frames[:2], *frames[3:]], [*frames[:-1], wrong]):
        buffers = Buffers(5)
        records = vesc.scanner(direction="to device").feed([*some, *frames])
        assert [one for one in map(buffers.take, records) if one is not None] == [packet]
