"""Framings, kinds of packets and drafts of byte streams of which nothing is known."""

from __future__ import annotations

import random
import struct
from itertools import pairwise
from math import sin
from pathlib import Path
from typing import Any

import pytest

from aces_bus.protocol import Check, Cobs, Crc, Fletcher, InvertedSum, Protocol, Slip, Sum
from aces_lab.guess import StreamGuess, StreamTraffic, stream_source
from aces_lab.guess.checked import checked_draft

DICE = random.Random("streams")


def body(size: int) -> bytes:
    return DICE.randbytes(size)


def guess_of(*pieces: bytes, times: list[float] | None = None) -> StreamGuess:
    """What is guessed of bytes in pieces, with no protocol tried first."""
    traffic = StreamTraffic()
    for number, piece in enumerate(pieces):
        traffic.add(piece, times[number] if times is not None else None)
    return traffic.guess(known=False)


def drafted(guess: StreamGuess) -> Protocol:
    """The protocol that the draft of a guess declares."""
    made: dict[str, Any] = {}
    exec(compile(stream_source(guess, "draft", ["it.bin"]), "draft.py", "exec"), made)
    protocol = made["draft"]
    assert isinstance(protocol, Protocol)
    return protocol


def servo(count: int = 80) -> bytes:
    """Two header bytes, a number, a length, an instruction, a complement of the sum."""
    out = b""
    for number in range(count):
        code, size = [(2, 2), (3, 3), (5, 8)][number % 3]
        inner = bytes([number % 4 + 1, size + 2, code]) + body(size)
        out += b"\xff\xff" + inner + InvertedSum().encode(inner)
    return out


def test_a_length_a_check_and_an_instruction_are_found() -> None:
    """The draft decodes every byte, and its messages are told apart by the instruction."""
    data = servo()
    guess = guess_of(data)
    (framing,) = guess.framings
    assert framing.sync == b"\xff\xff"
    assert framing.length is not None
    assert (framing.length.offset, framing.length.width, framing.length.constant) == (3, 1, 4)
    assert framing.check is not None
    assert framing.check.declared == "InvertedSum(over=slice(2, -1))"
    assert framing.opcode == (4, 1)
    assert {one.opcode for one in guess.packets} == {b"\x02", b"\x03", b"\x05"}
    assert guess.decoded == len(data)
    scanner = drafted(guess).scanner()
    records = [*scanner.feed(data), *scanner.close()]
    assert len(records) == 80
    assert scanner.counts.decoded == len(data)
    assert records[0].meta.message == "Packet_02"


@pytest.mark.slow
def test_what_is_broken_or_between_packets_is_left_over() -> None:
    """Every byte is in a packet or unknown; packets do not overlap."""
    data = bytearray(b"\x07\x08" + servo() + b"\x09")
    data[40] ^= 0x10
    guess = guess_of(bytes(data))
    (spans,) = guess.spans
    assert guess.decoded == sum(span.end - span.start for span in spans) < len(data)
    assert all(one.end <= other.start for one, other in pairwise(spans))
    assert len(spans) == 79


@pytest.mark.parametrize("order", ["little", "big"])
def test_lengths_of_two_bytes_in_either_order(order: str) -> None:
    """With a CRC of 16 bits over header and data."""
    data = b""
    for number in range(40):
        size = DICE.choice([5, 40, 300])
        inner = bytes([number % 3]) + size.to_bytes(2, order) + body(size)  # type: ignore[arg-type]
        data += b"\xaa\x55" + inner + Crc("CRC16-MODBUS").encode(b"\xaa\x55" + inner)
    (framing,) = guess_of(data).framings
    assert framing.sync == b"\xaa\x55"
    assert framing.length is not None
    assert framing.length == (3, 2, order, 7)
    assert framing.check is not None
    assert framing.check.check.describe == "CRC16-MODBUS"


@pytest.mark.slow
def test_packets_of_one_size_without_a_check() -> None:
    """As converters stream: what repeats is the header, and which bytes it has cannot hide behind multiples of the size."""
    data, value = b"", 2000
    for _ in range(300):
        value += DICE.choice([-1, 0, 1])
        data += (
            b"\xff\xff"
            + value.to_bytes(2, "big")
            + (3000 - value).to_bytes(2, "big")
            + bytes([8, DICE.randrange(9)])
        )
    (framing,) = guess_of(data[5:]).framings
    assert (framing.kind, framing.sync, framing.size, framing.check) == ("fixed", b"\xff\xff", 8, None)
    assert framing.confidence <= 0.9


def test_a_byte_behind_the_check_becomes_part_of_it() -> None:
    """A closing 03 that no framing can have behind a length: the longer CRC of the draft holds all the same."""
    data = b""
    for number in range(60):
        inner = bytes([number % 3]) + body(3 + 7 * (number % 3))
        data += bytes([2, len(inner)]) + inner + Crc("CRC16-XMODEM", order="big").encode(inner) + b"\x03"
    guess = guess_of(data)
    assert guess.framings[0].tail == b"\x03"
    scanner = drafted(guess).scanner()
    assert len([*scanner.feed(data), *scanner.close()]) == 60
    assert scanner.counts.decoded == len(data)


def test_sentences_with_a_written_check() -> None:
    """Lines that begin with $ and end with * and two digits; each word in front is a message."""
    lines = []
    for number in range(30):
        text = f"{['GPGGA', 'GPRMC'][number % 2]},{number},{DICE.random():.3f}"
        check = 0
        for character in text.encode():
            check ^= character
        lines.append(f"${text}*{check:02X}\r\n")
    data = "".join(lines).encode()
    guess = guess_of(data)
    (framing,) = guess.framings
    assert (framing.kind, framing.sync, framing.end) == ("lines", b"$", b"\r\n")
    assert framing.written is not None
    scanner = drafted(guess).scanner()
    records = [*scanner.feed(data), *scanner.close()]
    assert [record.meta.message for record in records[:2]] == ["GPGGA", "GPRMC"]
    assert scanner.counts.decoded == len(data)


@pytest.mark.parametrize(("name", "stuffing", "mark"), [("COBS", Cobs(), b"\0"), ("SLIP", Slip(), b"\xc0")])
def test_stuffed_packets(name: str, stuffing: Cobs | Slip, mark: bytes) -> None:
    """What never occurs between two marks says how they are kept out; the check is of what was stuffed."""
    check = Crc("CRC16-KERMIT")
    data = b""
    for number in range(80):
        inner = bytes([number % 3, 0, 0xC0, 0xDB]) + body(4 + number % 5)
        data += stuffing.stuff(inner + check.encode(inner)) + mark
    guess = guess_of(data)
    (framing,) = guess.framings
    assert (framing.kind, framing.stuffing, framing.end) == ("enclosed", stuffing, mark), name
    assert framing.check is not None
    assert framing.check.check.describe == "CRC16-KERMIT"
    scanner = drafted(guess).scanner()
    scanner.feed(data)
    scanner.close()
    assert scanner.counts.decoded == len(data)


@pytest.mark.slow
def test_packets_between_silences_need_times() -> None:
    """As Modbus has them: no sync bytes, no length, a CRC at the end."""
    pieces, times, now = [], [], 0.0
    for number in range(60):
        inner = bytes([number % 2 + 1, 3]) + body(2 + number % 6)
        packet = inner + Crc("CRC16-MODBUS").encode(inner)
        pieces += [packet[:3], packet[3:]]
        times += [now, now + 0.001]
        now += 0.02
    guess = guess_of(*pieces, times=times)
    assert guess.framings[0].kind == "silence"
    gap = guess.framings[0].gap_s
    assert gap is not None
    assert 0.001 < gap < 0.019
    assert guess.decoded == sum(map(len, pieces))


@pytest.mark.slow
def test_two_framings_of_one_line() -> None:
    """Sentences between packets, as receivers of satellites send them."""
    data = b""
    for number in range(60):
        inner = bytes([1, number % 4]) + (8).to_bytes(2, "little") + body(8 + 0)
        data += b"\xb5\x62" + inner + Fletcher().encode(inner)
        text = f"GPTXT,{number},some words"
        check = 0
        for character in text.encode():
            check ^= character
        data += f"${text}*{check:02X}\r\n".encode()
    guess = guess_of(data)
    assert {framing.sync[:1] for framing in guess.framings} == {b"\xb5", b"$"}
    assert guess.decoded == len(data)


@pytest.mark.parametrize(
    "data", [b"", b"\0" * 3000, random.Random(2).randbytes(3000), b"\xff\xff\x01\x02\x01\xfb"]
)
def test_noise_is_no_framing(data: bytes) -> None:
    """What chance could give as well is not said; a draft without messages loads nevertheless."""
    guess = guess_of(data)
    assert guess.framings == ()
    assert guess.decoded == 0
    assert "Protocol(" in stream_source(guess)


@pytest.mark.slow
def test_known_protocols_come_first() -> None:
    """What an installed protocol decodes is not guessed."""
    traffic = StreamTraffic()
    traffic.add(b"\xff\xff\x09\x0a\x0a\xf2\x08\x02" * 20)
    guess = traffic.guess()
    assert guess.framings == ()
    assert "minihubo_adc" in [one.name for one in guess.known]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("packet", "way"), [("FF FF 01 02 00 FC", "from"), ("FF FF 0C 04 02 00 32 BB", "both")]
)
def test_a_known_protocol_is_tried_in_both_directions(
    packet: str, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Answers of a servo alone are found, with what `aces decode` must be given; what has no check gives way."""
    monkeypatch.setattr("aces_tools.reading.fitting.list_protocols", lambda: ["minihubo_adc", "robotis"])
    traffic = StreamTraffic()
    traffic.add(bytes.fromhex(packet) * 12)
    (known,) = traffic.guess().known
    assert known.options == f"-p robotis --direction {way}"


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "packets", "left"),
    [
        ("mip-imu.part.bin", 1328, 24),
        ("ubx-nav.bin", 28, 0),
        ("nmea-gnss.txt", 57, 0),
        ("nmea-maritime.txt", 15, 0),
    ],
)
def test_recordings_of_others(shared_captures: Path, name: str, packets: int, left: int) -> None:
    """Packets that an independent reader finds, and bytes that are in none."""
    data = (shared_captures / "streams" / name).read_bytes()
    guess = guess_of(data)
    assert sum(framing.packets for framing in guess.framings) == packets
    assert len(data) - guess.decoded == left


def test_a_check_is_as_it_is_written() -> None:
    """Every kind prints as it was made."""
    from aces_lab.guess.checks import check_source

    made: list[tuple[Check, str]] = [
        (Fletcher(over=slice(2, -2)), "Fletcher(over=slice(2, -2))"),
        (Crc("CRC16-MODBUS", order="big"), 'Crc("CRC16-MODBUS", order="big")'),
    ]
    for check, text in made:
        assert check_source(check) == text


def test_a_check_in_front_of_what_it_covers_is_found() -> None:
    """As Septentrio has it: sync, check, an identifier of 16 bits, length; the draft loads and decodes it."""
    crc, data = Crc("CRC16-XMODEM"), b""
    for number in range(60):
        code, size = [(4007, 32), (4006 | 1 << 13, 20), (5914, 12), (4027, 40)][number % 4]
        inner = code.to_bytes(2, "little") + (size + 8).to_bytes(2, "little") + body(size)
        data += b"$@" + crc.compute(inner).to_bytes(2, "little") + inner
    guess = guess_of(data)
    (framing,) = guess.framings
    assert (framing.sync, framing.is_check_in_front, framing.opcode) == (b"$@", True, (4, 2))
    assert framing.check is not None
    assert framing.check.declared == 'Crc("CRC16-XMODEM", order="little", over=slice(4, None))'
    scanner = drafted(guess).scanner()
    assert len([*scanner.feed(data), *scanner.close()]) == 60
    draft = checked_draft(lambda some: stream_source(guess, "draft", [], some), "draft")
    assert not draft.as_bytes
    assert not draft.wrong


@pytest.mark.parametrize("covers_sync", [False, True])
def test_a_sum_to_zero_is_the_last_byte(covers_sync: bool) -> None:
    """Xbus: with its preamble or without; of bytes that all make the sum zero the last one is the check."""
    data = b""
    for number in range(100):
        inner = bytes([0xFF, 0x36, 14, 0, number])
        inner += b"".join(struct.pack(">f", 3 * sin(number / 20 + axis)) for axis in range(3))
        data += b"\xfa" + inner + Sum(negated=True).encode(b"\xfa" * covers_sync + inner)
    guess = guess_of(data)
    (framing,) = guess.framings
    assert framing.check is not None
    assert framing.check.declared == f"Sum(negated=True, over=slice({1 - covers_sync}, -1))"
    assert guess.decoded == len(data)


def test_lines_between_packets_are_a_framing_of_their_own() -> None:
    """A boot message among binary packets: all bytes are in one or the other."""
    lines = [f"[INFO] temp {20 + number / 7:.2f} ok\r\n".encode() for number in range(12)]
    data = b"".join(line + servo(3) for line in lines)
    guess = guess_of(data)
    assert sorted(framing.kind for framing in guess.framings) == ["length", "lines"]
    assert guess.decoded == len(data)
