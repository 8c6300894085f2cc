"""Worked examples: how they are written, and that a spec which contradicts one is found out."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest
from construct import Array, Byte, Int16sb, Int16sl, Int16ul, Struct, this

from aces_bus import as_dict, make_scanner
from aces_bus.errors import SpecError
from aces_bus.protocol import (
    AsciiInteger,
    AsciiNumber,
    Delimited,
    Enumeration,
    Flags,
    IdField,
    Protocol,
    Quantity,
    Sum,
    Xor,
)
from aces_bus.protocol.declare.examples import Example, parse_packet
from aces_bus.protocol.lint import check_protocol
from aces_bus.protocol.lint.examples import agree, example_frame, failure
from tests.laws.wires import PROTOCOLS, REGISTERED


def spoken(**changed: Any) -> Protocol:
    """A small protocol with a worked example; keywords are what a slip of the pen changes."""
    p = Protocol("probe", link="can")
    p.message(
        "State",
        id=changed.get("id", 0x100 + IdField("node", range(8))),
        payload=Struct(
            "mode" / Enumeration(Byte, changed.get("names", {"off": 0, "on": 1})),
            "error" / Flags(Byte, changed.get("flags", {"hot": 0, "cold": 3})),
            "speed"
            / Quantity(changed.get("number", Int16sl), unit="rad/s", scale=changed.get("scale", 0.01)),
            "raw" / Array(2, Byte),
        ),
        examples=[
            ("103#01 09 2E FB 05 06", {"node": 3, "mode": "on", "error": ["hot", "cold"], "speed": -12.34})
        ],
    )
    return p


def said(protocol: Protocol) -> str:
    (text,) = (one.text for one in check_protocol(protocol) if one.rule == "example" and one.level == "error")
    return text


def test_a_right_example_says_nothing() -> None:
    """Bytes that give the fields, fields that give the bytes; fields left out are not compared."""
    assert not [one for one in check_protocol(spoken()) if one.rule == "example"]


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"number": Int16sb}, "speed is read as 120.27, and should be -12.34"),
        ({"scale": 0.1}, "speed is read as -123.4"),
        ({"number": Byte}, "its length does not go with"),
        ({"id": 0x110 + IdField("node", range(8))}, "it is not State: another identifier"),
        ({"id": 0x0FF + IdField("node", range(8))}, "node is read as 4, and should be 3"),
        ({"names": {"off": 1, "on": 2}}, "mode is read as 'off', and should be 'on'"),
        ({"flags": {"hot": 0, "cold": 2}}, "error is read as"),
    ],
)
def test_a_slip_of_the_pen_is_found(changed: dict[str, Any], says: str) -> None:
    """Byte order, scale, width, identifier, names and bits: each contradicts the example."""
    assert says in said(spoken(**changed))


def test_a_field_that_does_not_exist() -> None:
    """An example that names no field says which there are."""
    p = Protocol("probe", link="can")
    p.message("A", id=1, payload=Struct("x" / Byte), examples=[("001#05", {"y": 5})])
    assert "there is no field 'y' (there are: x)" in said(p)


def test_an_example_of_a_stream() -> None:
    """A packet with a wrong check is not this message; the right one holds."""
    for text, holds in (("A5 01 07 08", True), ("A5 01 07 09", False)):
        p = Protocol("probe", link="serial")
        framing = p.framing(
            sync=b"\xa5", header=Struct("length" / Byte), size=this.length + 3, max_size=258, check=Sum()
        )
        made = framing("A", payload=Struct("x" / Byte), examples=[(text, {"x": 7})])
        assert (failure(made, made.examples[0]) is None) is holds


def test_an_example_with_its_request() -> None:
    """A reply that hangs on a request is recognised with it; a request that is none, or the wrong one, is said."""
    p = Protocol("probe", link="can")
    ask = p.message("Ask", id=1, payload=Struct("what" / Byte))
    for name, what in (("A", 1), ("B", 2)):
        p.message(name, id=2, reply_to=ask.where(what=what), payload=Struct("x" / Int16ul))
    a, b = p["A"], p["B"]
    packet, fields = parse_packet("002#0102", is_can=True), {"x": 0x201, "what": 1}
    assert failure(a, Example(packet, fields, parse_packet("001#01", is_can=True))) is None
    assert failure(a, Example(packet, {"x": 0x201})) is None, "without its request it cannot be recognised"
    assert "is none of Ask(what=2)" in (
        failure(b, Example(packet, {}, parse_packet("001#01", is_can=True))) or ""
    )
    assert "answers none" in (failure(ask, Example(parse_packet("001#01", is_can=True), {}, packet)) or "")


def test_a_message_that_another_takes_is_said() -> None:
    """An example that scanners give to another message does not hold."""
    p = Protocol("probe", link="can")
    p.message("Second", id=1, payload=Struct("x" / Byte), examples=[("001#05", {"x": 5})])
    p.message("First", id=1, overrides="Second", payload=Struct("y" / Byte))
    assert "in probe it is read as First" in said(p)


@pytest.mark.parametrize(
    "given",
    [
        "001#05",
        ("001#05",),
        ("001#05", {"x": 1}, {"y": 2}),
        ("nonsense", {}),
        ("001#0", {}),
        ("FFF#", {}),
        ("001#" + "00" * 9, {}),
    ],
)
def test_what_is_no_example_fails_at_import(given: Any) -> None:
    """The message names the line and how an example is written."""
    p = Protocol("probe", link="can")
    with pytest.raises(SpecError, match=r"test_lint_examples.py:\d+: (an )?example"):
        p.message("A", id=1, payload=Struct("x" / Byte), examples=[given])


def test_frames_of_every_kind_can_be_written() -> None:
    """11 and 29 bits, remote and CAN FD, as candump writes them."""
    kinds = {
        "12#": (0x12, False),
        "00000012#01": (0x12, True),
        "123##011 22": (0x123, False),
        "123#R": (0x123, False),
    }
    for text, (identifier, extended) in kinds.items():
        packet = parse_packet(text, is_can=True)
        assert (packet.identifier, packet.extended) == (identifier, extended)
        assert parse_packet(str(packet), is_can=True) == packet


#: Specs that ship without worked examples, with the reason.
WITHOUT_EXAMPLES = {
    "lx16a": "worked bytes of its sheet are not at hand; pylx16a drives its twin in tests/oracles/test_lx16a.py"
}

#: Messages of which no worked bytes are public; tests/oracles holds them against other implementations where there are such.
UNWORKED = {
    "crsf": {
        "Airspeed", "BaroVario", "GpsExtended", "GpsTime", "Heartbeat", "ParameterEntry", "ParameterRead", "ParameterWrite",
        "ReceiverLink", "Rpm", "SpeedAnswer", "Temperatures", "Timing", "TransmitterLink", "Vario", "VideoTransmitter",
        "Voltages",
    },
    "rplidar": {"Configuration", "ExpressMeasurements", "GetConfiguration"},
}  # fmt: skip


@pytest.mark.parametrize("name", [name for name in REGISTERED if name not in WITHOUT_EXAMPLES])
def test_every_message_that_ships_has_an_example(name: str) -> None:
    """So that a slip in a shipped spec is found by checking it."""
    without = {m.name for m in REGISTERED[name].declared if not m.examples}
    assert without == UNWORKED.get(name, set())


@pytest.mark.parametrize(
    "name", [name for name, p in PROTOCOLS.items() if any(m.examples for m in p.declared)]
)
def test_scanners_and_encoders_agree_with_the_examples(name: str) -> None:
    """What is generated reads and writes each worked example as its source has it, in some dialect and configuration."""
    protocol = PROTOCOLS[name]
    for message in protocol.declared:
        for example in message.examples:
            assert failure(message, example) is None
            assert any(_scanned(variant, message, example) for variant in protocol.variants()), message


@cache
def _scanner(variant: Any, direction: Any) -> Any:
    return make_scanner([variant], direction=direction)


def _scanned(variant: Any, message: Any, example: Example) -> bool:
    if message.name not in variant.messages:
        return False
    scanner = _scanner(variant, message.direction if variant.link != "can" else None)
    scanner.reset()
    if variant.link == "can":
        before = [] if example.request is None else [example.request]
        records = scanner.feed(
            [example_frame(packet) for packet in [*before, *(example.frames or (example.packet,))]]
        )
        records = records[len(before) :]
    else:
        if example.request is not None:
            scanner.sent(example.request.data)
        records = scanner.feed(example.packet.data) + scanner.close()
    if [type(record).__name__ for record in records] != [message.name]:
        return False
    values = as_dict(records[0])
    if message.transport is not None:
        # The example has some sequence number.
        packets = (variant.encoder.numbered(number, message.name, **values) for number in range(32))
        shown = [frame.data for frame in example.frames]
        same = any(
            [bytes(frame.data) for frame in (made if isinstance(made, list) else [made])] == shown
            for made in packets
        )
    else:
        made = variant.encoder.encode(message.name, **values)
        same = (
            made == example.packet.data if variant.link != "can" else bytes(made.data) == example.packet.data
        )
        if str(example.packet).startswith("b"):
            # Numbers as characters may have more or fewer decimals than we would write, if they read the same.
            again = as_dict(scanner.feed(made)[0])
            same = all(agree(again[field], value) for field, value in values.items())
    return same and agree(values, example.fields)


# ---------------------------------------------------------------------- characters


def sentence(line: bytes, **fields: Any) -> Protocol:
    """A protocol of sentences, with an example that is written as characters."""
    p = Protocol("probe", link="serial")
    framing = p.framing(sync=b"$", end=b"\n", check=Xor(text="*{:02X}"), max_size=40)
    payload = Delimited(",", "level" / AsciiNumber(digits=2, unit="m"), "count" / AsciiInteger())
    framing("Level", payload=payload, examples=[(line, fields)])
    return p


def test_an_example_of_characters() -> None:
    """Bytes stand for themselves; a number may have more or fewer decimals than we would write, if it reads the same."""
    for line in (b"$1.50,7*01\n", b"$1.5,7*31\n"):
        assert not [one for one in check_protocol(sentence(line, level=1.5, count=7)) if one.level == "error"]
    assert "level is read as 1.5, and should be 2.5" in said(sentence(b"$1.5,7*31\n", level=2.5))
    with pytest.raises(SpecError, match=r"is not hexadecimal bytes .*; characters are written b'…'"):
        sentence("$1.5,7*31\n")  # type: ignore[arg-type]
    with pytest.raises(SpecError, match="is not a frame"):
        Protocol("probe", link="can").message("A", id=1, examples=[(b"001#", {})])


def test_a_wrong_check_says_which_it_would_be() -> None:
    """Sentences are shown as characters, and both checks are told: was it the example or the spec?"""
    found = said(sentence(b"$1.5,7*30\n"))
    assert "example b'$1.5,7*30\\n'" in found
    assert "checksum 2A 33 30; by the spec it is 2A 33 31" in found
