"""A spec held against a recording: what is contradicted is said with its evidence, and what is sound is left alone."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from construct import Array as ArrayOf
from construct import (
    Byte,
    Bytes,
    Const,
    Float32b,
    Float32l,
    Int16sb,
    Int16sl,
    Int16ub,
    Int16ul,
    Int32ul,
    Struct,
    this,
)
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.errors import CallerError
from aces_bus.protocol import (
    BitLayout,
    Counter,
    Crc,
    Enumeration,
    IdField,
    Present,
    Protocol,
    Quantity,
    Sum,
    Text,
    Xor,
    bits,
)
from aces_bus.protocol.against import check_recordings
from aces_bus.protocol.against.finding import Observation
from aces_bus.protocol.against.suggest import suggest_examples
from aces_bus.recordings.base import Chunk
from aces_protocols.hubo.spec import hubo
from aces_protocols.minihubo_adc.spec import minihubo_adc
from aces_protocols.robotis.spec import robotis
from tests.specs.catalogue import SPECS

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "captures"


def one_message(payload: Any, **more: Any) -> Protocol:
    protocol = Protocol("one", link="can")
    protocol.message("Only", id=5, payload=payload, **more)
    return protocol


def frames(data: Callable[[int], bytes], count: int = 200, identifier: int = 5) -> list[Frame]:
    return [Frame(identifier, data(n), n * 0.01, "can0") for n in range(count)]


def wave(n: int, amplitude: float) -> int:
    return round(amplitude * math.sin(n / 15))


def rules(found: list[Observation]) -> list[str]:
    return [one.rule for one in found if one.level != "note"]


def held(protocol: Protocol, recording: Any, **more: Any) -> list[Observation]:
    return check_recordings(protocol, [recording], **more)


# ---------------------------------------------------------------------- what is sound


@pytest.mark.parametrize(
    ("protocol", "name", "direction"),
    [
        (hubo, "hubo2plus.log", None),
        (minihubo_adc, "adc.bin", None),
        (robotis, "robotis_session.bin", "both"),
        (robotis, "robotis_session.dxconf.txt", "both"),
    ],
)
def test_what_ships_is_not_contradicted(protocol: Protocol, name: str, direction: Any) -> None:
    """The recordings among the examples say nothing against the protocols that they are of, but notes."""
    capture = open_recording(EXAMPLES / name, link="can" if protocol.link == "can" else "serial")
    assert rules(held(protocol, capture, direction=direction)) == []


@pytest.mark.shared
def test_real_recordings_do_not_contradict_what_ships(shared_captures: Path) -> None:
    """Recordings of real devices say nothing against the shipped protocols, but notes."""
    adc = open_recording(shared_captures / "adc" / "minihubo_adc_part1.bin", link="serial")
    assert rules(held(minihubo_adc, adc)) == []
    names = open_recording(shared_captures / "hubo-can" / "nameinfo_commands.candump", link="can")
    assert rules(check_recordings(hubo.variant("D08"), [names])) == []
    for path in sorted((shared_captures / "robotis").iterdir()):
        way: Any = "from device" if "from-servo" in path.name else "to device"
        assert rules(held(robotis, open_recording(path, link="serial"), direction=way)) == [], path.name


@pytest.mark.shared
def test_another_dialect_is_said_to_be_wrong(shared_captures: Path) -> None:
    """What the boards of one dialect send contradicts the other."""
    names = open_recording(shared_captures / "hubo-can" / "nameinfo_commands.candump", link="can")
    found = [one for one in check_recordings(hubo.variant("D12"), [names]) if one.level != "note"]
    assert [one.rule for one in found] == ["size"]
    assert "11 frames 0x001 of 12 have 8 bytes" in found[0].text


def test_what_is_no_quantity_may_jump() -> None:
    """Noise, bit patterns, an angle that goes around, a set-point that jumps from end to end, large steps are left alone."""
    dice = random.Random(4)
    protocol = one_message(
        Struct(
            "noise" / Int16ub,
            "pattern" / Int16ub,
            "angle" / Quantity(Int16ul, unit="°", scale=360 / 65536),
            "target" / Quantity(Int16sl, scale=0.1),
        )
    )

    def data(n: int) -> bytes:
        pattern = dice.choice((0x0237, 0x1237, 0x0633, 0x0231, 0x0250, 0x021F, 0x0238))
        target = dice.choice((-32768, 32767))
        return (
            dice.randbytes(2)
            + pattern.to_bytes(2, "big")
            + (wave(n, 900) % 65536).to_bytes(2, "little")
            + target.to_bytes(2, "little", signed=True)
        )

    assert rules(held(protocol, frames(data, 400))) == []
    coarse = one_message(Struct("coarse" / Quantity(Int16ub, scale=1 / 256)))
    assert rules(held(coarse, frames(lambda n: bytes([100 + wave(n, 60), 0])))) == []


# ---------------------------------------------------------------------- what is not


@pytest.mark.parametrize(
    ("declared", "written", "rule", "says"),
    [
        (Int16sl, lambda n: wave(n, 9000).to_bytes(2, "big", signed=True), "byte-order", "the other byte order"),
        (Int16sb, lambda n: wave(n, 90).to_bytes(2, "little", signed=True), "byte-order", "the other byte order"),
        (Int32ul, lambda n: (100_000 + wave(n, 90_000)).to_bytes(4, "big"), "byte-order", "the other byte order"),
        (Float32l, lambda n: Float32b.build(20 + wave(n, 9) / 7), "byte-order", "the other byte order"),
        (Int16ul, lambda n: wave(n, 900).to_bytes(2, "little", signed=True), "sign", "two's complement"),
        (Int16sl, lambda n: (32_768 + wave(n, 900)).to_bytes(2, "little"), "sign", "unsigned"),
        (
            Quantity(Int16ul, scale=0.1),
            lambda n: (abs(wave(n, 900)) | 0x8000 * (wave(n, 900) < 0)).to_bytes(2, "little"),
            "sign",
            "SignMagnitude",
        ),
        (
            Quantity(Int16sl, scale=0.1, range=(-50, 50)),
            lambda n: wave(n, 900).to_bytes(2, "little", signed=True),
            "range",
            "-90…90 in",
        ),
        (Enumeration(Byte, off=0, on=1), lambda n: bytes([n // 50]), "enumeration", "is 2, 3 in 100 of 200"),
        (BitLayout(1, "low" / bits(7)), lambda n: bytes([(n // 9) % 2 * 128 + n % 100]), "gap", "bit 0.7"),
    ],
    ids=["big", "big, little is constant", "32 bits", "float", "signed", "unsigned", "magnitude", "range", "names", "gap"],
)  # fmt: skip
def test_a_field_that_is_not_as_declared(declared: Any, written: Any, rule: str, says: str) -> None:
    """Byte order, sign, range, names, bits of no field: found, with numbers and what would be right."""
    payload = declared if isinstance(declared, BitLayout) else Struct("x" / declared)
    (found,) = [one for one in held(one_message(payload), frames(written)) if one.level != "note"]
    assert (found.rule, found.message) == (rule, "Only")
    assert says in f"{found.text} {found.remedy}"
    assert 0 < found.count <= found.total


def test_bits_counted_from_the_other_end() -> None:
    """Numbers of eleven bits that move smoothly only in the other order; in the right one nothing is said."""

    def channels(n: int) -> bytes:
        return sum(wave(n + 40 * k, 700) + 992 << 11 * k for k in range(5)).to_bytes(8, "little")

    def declared(order: Any) -> Protocol:
        return one_message(BitLayout(8, *(f"c{k}" / bits(11) for k in range(5)), order=order))

    (found,) = (one for one in held(declared("msb"), frames(channels)) if one.rule == "bit-order")
    assert (found.level, found.count, found.total) == (
        "warning",
        4,
        4,
    )  # the last one's bits are the layout's reserved ones
    assert rules(held(declared("lsb"), frames(channels))) == []


def test_a_long_gap_that_changes() -> None:
    """More bits than a machine word has, of no field: a layout that ends too early."""
    payload = BitLayout(22, "c" / bits(11), trailing="")
    packets = [b"\xc8" + (wave(n, 700) + 992 << 120 | 5).to_bytes(22, "little") for n in range(100)]
    stream = Protocol("long", link="serial")
    framing = stream.framing(sync=b"\xc8", size=23, max_size=23)
    stream.message("M", framing=framing, payload=payload)
    (found,) = (one for one in held(stream, b"".join(packets)) if one.level != "note")
    assert (found.rule, found.total) == ("gap", 100)
    assert "16.0" in found.text


def test_a_size_of_groups_that_nothing_is_read_by() -> None:
    """It is the width of a group in every message: the next firmware's may be more."""

    def declared(name: str, *more: Any) -> Protocol:
        stream = Protocol("sized", link="serial")
        framing = stream.framing(
            sync=b"\xa5", header=Struct("length" / Byte), size=this.length + 2, max_size=64
        )
        group = Struct("a" / Byte, "b" / Int16ul, *more)
        payload = Struct("count" / Byte, "group_size" / Byte, "groups" / ArrayOf(this.count, group))
        stream.message(name, framing=framing, payload=payload)
        return stream

    packets = [
        bytes([0xA5, 2 + 3 * (1 + n % 3), 1 + n % 3, 3]) + bytes([n % 251, n % 7, 0] * (1 + n % 3))
        for n in range(60)
    ]
    (found,) = (one for one in held(declared("M"), b"".join(packets)) if one.level != "note")
    assert (found.rule, found.remedy) == (
        "size",
        "end each with what it has beyond: Bytes(this._.group_size - 3)",
    )
    assert rules(held(declared("M", "more" / Bytes(this._.group_size - 3)), b"".join(packets))) == []


def test_texts_with_control_characters() -> None:
    """A text that begins a byte too early; padding is none."""
    shifted = frames(lambda n: bytes([1 + n % 3]) + b"ABC\0\0\0\0")
    assert rules(held(one_message(Struct("name" / Text(8))), shifted)) == ["text"]
    right = one_message(Struct("kind" / Byte, "name" / Text(7)))
    assert rules(held(right, shifted)) == []


def test_a_counter_that_begins_anew_is_a_warning() -> None:
    """Of the payload and of a stream's header, where it tells no devices apart; one that never ends may be a total."""
    counted = frames(lambda n: bytes([n % 256, wave(n, 50) & 0xFF]), count=600)
    payload = Struct("count" / Byte, "x" / Byte)
    assert rules(held(one_message(payload), counted)) == ["counter"]
    assert rules(held(one_message(Struct("count" / Counter(Byte), "x" / Byte)), counted)) == []
    assert rules(held(one_message(payload), counted[:200])) == []
    stream = Protocol("headed", link="serial")
    framing = stream.framing(sync=b"\xa5", header=Struct("count" / Byte), size=4, max_size=4)
    stream.message("M", framing=framing, payload=Struct("x" / Int16sl))
    data = b"".join(
        bytes([0xA5, n % 256]) + wave(n, 9000).to_bytes(2, "little", signed=True) for n in range(600)
    )
    assert rules(held(stream, data)) == ["counter"]


def test_a_counter_of_all_packets_is_found_in_the_header() -> None:
    """Packets of each message alone skip counts; declared as a Counter, it is a finding no longer."""

    def spec(count: Any) -> Protocol:
        stream = Protocol("several", link="serial")
        framing = stream.framing(sync=b"\xa5", header=Struct("count" / count, "kind" / Byte), size=5)
        for kind in range(3):
            framing(f"M{kind}", match={"kind": kind}, payload=Struct("x" / Int16sl))
        return stream

    numbers = [(n % 256, n * n % 7 % 3, wave(n, 9000)) for n in range(600)]
    data = b"".join(
        bytes([0xA5, count, kind]) + x.to_bytes(2, "little", signed=True) for count, kind, x in numbers
    )
    assert rules(held(spec(Byte), data)) == ["counter"]
    assert rules(held(spec(Counter(Byte)), data)) == []


def test_fields_that_bits_say_are_watched() -> None:
    """Ranges and steps of fields that are not always there."""
    payload = Struct(
        "mask" / Byte,
        "warm" / Present("mask", 0, Quantity(Int16sl, unit="°C", range=(-40, 80))),
        "x" / Present("mask", 1, Int16sb),
    )
    given = frames(
        lambda n: (
            bytes([3 if n % 2 else 2])
            + (wave(n, 100).to_bytes(2, "little", signed=True) if n % 2 else b"")
            + wave(n, 9000).to_bytes(2, "little", signed=True)
        )
    )
    assert sorted(rules(held(one_message(payload), given))) == ["byte-order", "range"]


def test_frames_that_are_no_message() -> None:
    """An identifier, a constant and a length that nobody declared, with the declared message that is one slip away."""
    protocol = Protocol("three", link="can")
    protocol.message("Here", id=0x10, payload=Struct("x" / Byte))
    protocol.message("There", id=0x21, payload=Struct("x" / Byte))
    protocol.message("Coded", id=0x30, payload=Struct(Const(b"\x07"), "x" / Byte))
    recording = [
        *frames(lambda n: bytes([n % 5, 1]), 50, 0x10),
        *frames(lambda n: b"\x01", 50, 0x20),
        *frames(lambda n: bytes([8, n]), 50, 0x30),
    ]
    texts = {one.rule: one for one in held(protocol, recording) if one.level != "note"}
    assert "50 frames 0x010 of 50 have 2 bytes, and its fields take 1 bytes" in texts["size"].text
    assert texts["size"].remedy == "declare the 1 bytes that are left over"
    found = [one for one in held(protocol, recording) if one.rule == "undeclared"]
    assert any(one.remedy.startswith("is it There (0x021), which never occurs?") for one in found)
    assert any("byte 0 is 08, of Coded 07" in one.text for one in found)
    assert found[0].witness is not None


@pytest.mark.parametrize(
    "check", [Sum(), Xor(), Crc("CRC8-SAE-J1850"), Crc("CRC16-MODBUS")], ids=lambda c: c.describe
)
def test_a_check_that_is_not_declared(check: Any) -> None:
    """A byte that every frame's other bytes give is said to be a check, and which; bytes that mirror others are none."""
    dice = random.Random(1)
    size = check.bytes
    protocol = one_message(Struct("a" / Bytes(5), "b" / Bytes(size)))

    def checked(n: int) -> bytes:
        body = dice.randbytes(5)
        return body + bytes(check.encode(body))

    (found,) = [one for one in held(protocol, frames(checked)) if one.level != "note"]
    assert found.rule == "check"
    assert check.describe.split(",")[0] in found.text.replace("exclusive or", "xor")

    def mirrored(n: int) -> bytes:
        half = dice.randbytes(2)
        return (half + half + half + half)[: 5 + size]

    assert rules(held(protocol, frames(mirrored))) == []


def test_a_message_that_went_the_other_way() -> None:
    """What a recorder sent that says that it is the host, and declared as from the device; who only listens is not asked."""
    protocol = Protocol("ways", link="can")
    for number, way in enumerate(("to device", "from device", "from device", "from device")):
        protocol.message(f"M{number}", id=number, direction=way)  # type: ignore[arg-type]
    sent = [Frame(n, b"", k / 10, is_rx=n in (1, 2)) for k in range(9) for n in range(4)]
    (found,) = [one for one in held(protocol, sent) if one.level != "note"]
    assert (found.rule, found.message, found.remedy) == ("direction", "M3", "direction='to device'")
    assert (
        rules(held(protocol, [Frame(n, b"", k / 10, is_rx=True) for k in range(9) for n in range(4)])) == []
    )


def test_what_the_spec_allows_is_left_out(tmp_path: Path) -> None:
    """A comment on the line says that it is meant."""
    from aces_bus.protocol.files import protocol_of_file

    text = (
        "from construct import *\nfrom aces_bus.protocol import *\np = Protocol('p', link='can')\n"
        "p.message('Only', id=5, payload=Struct('x' / Enumeration(Byte, off=0)))"
    )
    for number, more in enumerate(("", "  # aces: allow enumeration")):
        path = tmp_path / f"allowing_{number}.py"
        path.write_text(text + more)
        found = held(protocol_of_file(str(path))[0], frames(lambda n: b"\x07"))
        assert ("enumeration" in rules(found)) == (not more)


# ---------------------------------------------------------------------- how it is read


def tables(recording: list[Frame], size: int) -> Iterator[FrameTable]:
    first = FrameTable.from_frames(recording[:1])
    for at in range(0, len(recording), size):
        yield FrameTable.from_frames(recording[at : at + size], first.channels)


@pytest.mark.slow
def test_pieces_say_what_the_whole_says() -> None:
    """However a recording is cut, the observations are the same."""
    node = IdField("node", range(1, 4))
    protocol = Protocol("cut", link="can")
    protocol.message(
        "Place", id=0x10 + node, payload=Struct("x" / Int16sl, "state" / Enumeration(Byte, on=1))
    )
    recording = [
        Frame(
            0x10 + n % 5, wave(n, 3000).to_bytes(2, "big", signed=True) + bytes([n % 7 == 0]), n / 100, "can0"
        )
        for n in range(600)
    ]
    whole = held(protocol, recording)
    assert {"byte-order", "enumeration", "undeclared"} <= set(rules(whole))
    for size in (1, 7, 100):
        pieces = list(tables(recording, size))
        assert check_recordings(protocol, [iter(pieces)]) == whole


@pytest.mark.slow
@given(data=st.lists(st.binary(max_size=64), max_size=40), seed=st.integers(0, 1 << 16))
def test_no_recording_raises(data: list[bytes], seed: int) -> None:
    """Frames and bytes of any kind are data: whatever the spec, observations come out of them."""
    dice = random.Random(seed)
    for protocol in SPECS.values():
        recording: Any = [Chunk(piece, None, None) for piece in data]
        if protocol.link == "can":
            recording = [Frame(dice.randrange(0x800), piece[:8], None) for piece in data]
        for one in held(protocol, recording, direction="both"):
            assert str(one)
            assert one.as_dict()["remedy"]


# ---------------------------------------------------------------------- examples out of recordings


def test_a_suggested_reply_has_its_request() -> None:
    """Where a reply is recognised by its request alone, the one before it is suggested along."""
    protocol = Protocol("asked", link="can")
    ask = protocol.message("Ask", id=1, payload=Struct("what" / Byte))
    for number, name in enumerate(("Speed", "Light")):
        protocol.message(name, id=2, reply_to=ask.where(what=number), payload=Struct(name.lower() / Byte))
    recording = [Frame(1, b"\x01"), Frame(2, b"\x07"), Frame(1, b"\x00"), Frame(2, b"\x09")]
    found = {one.message.name: one.source for one in suggest_examples(protocol, [recording])}
    assert found["Light"] == '("002#07", {"what": 1, "light": 7}, "001#01"),'
    assert found["Speed"] == '("002#09", {"what": 0, "speed": 9}, "001#00"),'


def test_a_recording_of_another_link_is_refused() -> None:
    """Frames are not held against a serial protocol."""
    with (
        open_recording(EXAMPLES / "hubo2plus.log", link="can") as capture,
        pytest.raises(CallerError, match="capture on can"),
    ):
        held(robotis, capture, direction="both")
