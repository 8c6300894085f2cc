"""Worked examples: how they are written, and that a spec which contradicts one is found out."""

from __future__ import annotations

from typing import Any

import pytest
from construct import Array, Byte, Int16sb, Int16sl, Struct

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
    Xor,
)
from aces_bus.protocol.declare.examples import parse_packet
from aces_bus.protocol.lint import check_protocol
from tests.laws.wires import REGISTERED


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
    "dronecan": {"NodeInfo", *(f"RawCommand{count}" for count in range(1, 21) if count != 4)},
    "rplidar": {"Configuration", "ExpressMeasurements", "GetConfiguration"},
    "sbf": {"ReceiverSetupRevision1", "ReceiverSetupRevision2", "ReceiverSetupRevision3"},
    "vectornav_text": {
        "ACC", "DTV", "Error", "GPE", "GPS", "GYR", "IMU", "INE", "INS", "ISE", "ISL", "KnownAccelerationDisturbance",
        "KnownMagneticDisturbance", "MAG", "MAR", "QMR", "QTN", "ReadRegister", "Reset", "RestoreFactorySettings",
        "SendByItself", "SetGyroBias", "Tare", "WriteRegister", "WriteSettings", "YBA", "YIA", "YMR", "YPR",
    },
}  # fmt: skip


@pytest.mark.parametrize("name", [name for name in REGISTERED if name not in WITHOUT_EXAMPLES])
def test_every_message_that_ships_has_an_example(name: str) -> None:
    """So that a slip in a shipped spec is found by checking it."""
    without = {m.name for m in REGISTERED[name].declared if not m.examples}
    assert without == UNWORKED.get(name, set())


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
