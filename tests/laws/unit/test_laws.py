"""The laws themselves: drawn packets, exemptions, what they compare."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest
from construct import Byte, Construct, Float16l, Float32l, Struct, VarInt
from hypothesis import given, settings

from aces_bus import Frame, load_protocol, make_scanner
from aces_bus.protocol import Message, Protocol, SignMagnitude
from aces_bus.protocol.declare.ambiguity import needing_context
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.reference import Reference
from aces_bus.testing import LAWS, Fuzzer, Scene, laws, strategies
from aces_bus.testing.bench import Bench
from aces_bus.testing.exemptions import KINDS, Kind, are_excused
from aces_bus.testing.packets import draw_packet
from aces_bus.testing.saved import load_scene, save_scene
from aces_bus.testing.source import spread
from aces_bus.testing.specs import Link, draw_spec, protocol_of
from aces_bus.testing.trial import comparable, items_by
from tests.laws.drawn import ORACLE, drawn_arguments, wires_of
from tests.laws.test_exemptions import DAMIAO as DAMIAO
from tests.laws.test_exemptions import LISTED as LISTED
from tests.laws.wires import PROTOCOLS, REGISTERED
from tests.specs.catalogue import SPECS
from tests.testing.test_law_tests import a_bus as a_bus

POSITIONS = ("GGA", "RMC", "GSA", "GSV", "VTG", "GLL", "GNS", "GST", "ZDA")


IS_LONG = settings().max_examples > 100


#: Scenes of a bus, and of a stream, that are played.
BUS_SCENES, STREAM_SCENES = (15, 59) if IS_LONG else (7, 25)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hubo", "can_corners", "mit_motor"])
@pytest.mark.parametrize("direction", [None, "from device"])
def test_replies_follow_the_rule(name: str, direction: laws.Way) -> None:
    """Frame by frame, the scanner chooses what the reference chooses."""
    told = 0
    needing = {v: needing_context(v.messages_for(direction)) for v in PROTOCOLS[name].variants()}
    variants = [variant for variant, names in needing.items() if names]
    for variant in variants[-2:]:
        for seed in range(1, BUS_SCENES + 1):
            (scene,) = drawn_arguments(LAWS[3], variant, direction, seed, size=700)
            scanned = laws.scanned_items(laws.scanner_of(variant, direction, raw=False), scene)
            wanted = items_by(Reference([variant], direction=direction), scene)
            assert scanned == wanted, f"{variant}, seed {seed}"
            told += sum(item.message in needing[variant] for item in scanned)
    assert told > 20


@pytest.mark.parametrize("name", ["robotis", "dynamixel2", "modbus_like"])
def test_replies_in_a_stream_follow_the_rule(name: str) -> None:
    """Packet by packet; with requests to everyone, which each device answers."""
    variant = PROTOCOLS[name].variant()
    bound = needing_context(variant.messages_for("both"))
    scanner = laws.scanner_of(variant, "both")
    told = 0
    for seed in range(1, STREAM_SCENES + 1):
        source = spread(seed, 2000)
        scanner.reset()
        packets: list[laws.DrawnPacket] = []
        for _ in range(12):
            packet = draw_packet(source.choice(variant.messages_for(None)), source.branch(), variant)
            asked = [packet.request] if packet.request is not None and source.integer(0, 3) else []
            packets += [*asked, *[packet] * source.choice((1, 1, 2))]
        heard: list[Any] = []
        ends: list[int] = []
        for packet in packets:
            assert isinstance(scanner, StreamScanner)
            (record,) = scanner.feed(packet.image) + scanner.idle()
            heard.append(record.meta.message)
            ends.append((ends[-1] if ends else 0) + len(packet.image))
        data = b"".join(packet.image for packet in packets)
        wanted = Reference([variant], direction="both").stream(data, idle_at=ends)
        assert heard == [item.message for item in wanted], f"seed {seed}"
        told += sum(message in bound for message in heard)
    assert told > 20


def test_before_a_request_that_is_too_old_there_is_none() -> None:
    """A request of an unknown time does not answer for a later one that is too old; alone it fits."""
    variant = PROTOCOLS["can_corners"].variant()
    ask, answer = b"\x01\0", b"\x12\x34\x56"  # of three bytes: AnswerThree has two or five
    untimed, old = Frame(0x203, ask), Frame(0x203, ask, 1.0)
    for heard, found in (((untimed, old), None), ((untimed,), "AnswerOne"), ((old, untimed), "AnswerOne")):
        scene = Scene((*heard, Frame(0x243, answer, 2.0)))
        ORACLE(variant, None, scene)
        assert laws.scanned_items(laws.scanner_of(variant, None), scene)[-1].message == found


#: Protocols all of whose single-precision floats are such fields, by their guides: kind → how many.
COUNTED: dict[str, dict[str, int]] = {"sbf": {"signalling NaN": 225}, "vectornav": {"signalling NaN": 64}}


@pytest.mark.parametrize("name", [*REGISTERED, *SPECS])
def test_exceptions_are_listed(name: str) -> None:
    """No field of a protocol loses bytes that this list does not name."""
    protocol = {**REGISTERED, **SPECS}[name]
    found: dict[str, set[str]] = {}
    for message in protocol.declared:
        for exemption in laws.exemptions(message):
            found.setdefault(exemption.kind.name, set()).add(f"{message.name}.{exemption.field}")
    if name in COUNTED:
        assert {kind: len(fields) for kind, fields in found.items()} == COUNTED[name]
    else:
        assert found == LISTED.get(name, {})


#: Of each kind: a field, bytes that do not survive, and what comes back.
SHOWN: dict[str, tuple[Construct, bytes, bytes]] = {
    "negative zero": (SignMagnitude(16), b"\x00\x80", b"\x00\x00"),
    "signalling NaN": (Float32l, struct.pack("<I", 0x7F80_0001), struct.pack("<I", 0x7FC0_0001)),
    "NaN of half precision": (Float16l, b"\x01\x7e", b"\x00\x7e"),
    "overlong number": (VarInt, b"\x85\x00", b"\x05"),
}


def _message(field: Construct) -> Message:
    made = Protocol("shown", link="can")
    return made.message("Shown", id=1, payload=Struct("field" / field, "other" / Byte))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_each_exception_is_needed(kind: Kind) -> None:
    """The bytes shown really do not survive, and what comes back reads the same."""
    field, before, after = SHOWN[kind.name]
    message = _message(field)
    head = bytes((0, 0, 0, 1, 0))
    image, rebuilt = head + before + b"\x2a", head + after + b"\x2a"
    assert [e.kind.name for e in laws.exemptions(message)] == [kind.name]
    parsed = message.struct.parse(image, raw=True)
    assert message.struct.build(parsed, raw=True) == rebuilt
    assert are_excused(message, image, rebuilt)


def test_the_case_of_a_check_is_excused() -> None:
    """A check in lower-case hexadecimal is read and written back in upper case; no other byte may differ."""
    message = REGISTERED["nmea0183"]["ZDA"]
    sentence = b"$GNZDA,103607.00,06,03,2021,00,00*%b\r\n"
    lower, upper = sentence % b"7f", sentence % b"7F"
    assert message.struct.build(message.struct.parse(lower, raw=True), raw=True) == upper
    assert are_excused(message, lower, upper)
    assert not are_excused(message, lower, upper.replace(b"2021", b"2022"))


def test_nothing_else_is_excused() -> None:
    """A difference outside the listed bits is a fault, also in a message that has an exception."""
    message = _message(SignMagnitude(16))
    head = bytes((0, 0, 0, 1, 0))
    assert are_excused(message, head + b"\x00\x80\x2a", head + b"\x00\x00\x2a")
    assert not are_excused(message, head + b"\x00\x80\x2a", head + b"\x00\x00\x2b")
    assert not are_excused(message, head + b"\x00\x80\x2a", head + b"\x00\x00")
    assert not are_excused(_message(Byte), head + b"\x00\x2a", head + b"\x01\x2a")


@pytest.mark.parametrize("made", [a_bus(), load_protocol("robotis")], ids=lambda p: p.name)
def test_a_saved_scene_is_read_back_to_the_bit(made: Protocol, tmp_path: Path) -> None:
    """Traffic, silences, transmissions, cuts, and the packets with their values."""
    direction = laws.directions(made.variant())[0]
    bench = Bench(made.variant(), direction)
    for seed in range(1, 20):
        (scene,) = drawn_arguments(LAWS[0], made.variant(), direction, seed, size=120)
        loaded = load_scene(save_scene(tmp_path, made.variant(), direction, scene, (1, 2), law=2).scene)
        assert (loaded.law, loaded.cuts, loaded.protocol) == (2, (1, 2), made.name)
        again = loaded.scene(bench)
        assert (again.traffic, again.sent_at) == (scene.traffic, scene.sent_at)
        assert again.idle_at == tuple(sorted(scene.idle_at))
        assert [p.image for p in again.packets] == [p.image for p in scene.packets]
        assert [comparable(p.values) for p in again.packets] == [comparable(p.values) for p in scene.packets]


#: Specs in the short run and in the long one: each is compiled, which costs more than fuzzing it.
SHORT, LONG = 6, 300


@pytest.mark.slow
def test_drawn_protocols_keep_the_laws() -> None:
    """Whatever fields, layouts, captures, checks and lengths: no law fails."""
    links: tuple[Link, ...] = ("can", "serial")
    for seed in range(1, LONG if settings().max_examples > 100 else SHORT):
        text = draw_spec(spread(seed), links[seed % 2])
        fuzzer = Fuzzer([protocol_of(text)], seed=seed)
        found = fuzzer.run(32 * len(fuzzer.benches), most=1)
        assert [str(failure) for failure in found] == [], f"spec {seed}:\n{text}"


@pytest.mark.slow
def test_drawn_protocols_are_of_many_kinds() -> None:
    """Among some dozens there is every kind of link, framing, check, pattern and field."""
    texts = "\n".join(draw_spec(spread(seed, 2000)) for seed in range(1, 60))
    words = (
        'link="can"',
        'link="serial"',
        "size=this.length",
        "stuffing=Slip()",
        "stuffing=Cobs()",
        "Crc(",
        "Fletcher(",
        "IdField(",
        "extended=True",
        "fd=True",
        "BitLayout(",
        "Split(",
        "signed=True",
        "SignMagnitude(",
        "Quantity(",
        "Enumeration(",
        "Flags(",
        "Multiplexed(",
        "Array(",
        "GreedyBytes",
        "direction=",
    )
    assert [word for word in words if word not in texts] == []


@settings(max_examples=10)
@given(strategies.protocols())
def test_a_drawn_protocol_is_one(protocol: Any) -> None:
    """It has messages, and a scanner."""
    assert isinstance(protocol, Protocol)
    assert protocol.declared
    for variant, way in wires_of(protocol):
        scanner: Any = make_scanner([variant], direction=way)
        assert scanner.feed([] if protocol.link == "can" else b"") == []


def test_a_spec_is_what_its_source_gives() -> None:
    """The same source of choices draws the same text, and nothing left draws the simplest."""
    assert draw_spec(spread(7)) == draw_spec(spread(7))
    simplest = protocol_of(draw_spec(spread(0, 0), "can"))
    assert [message.name for message in simplest.declared] == ["M0"]
