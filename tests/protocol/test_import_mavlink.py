"""MAVLink dialect files as protocols: what they say is taken over, what cannot be is listed, and no file can do harm.

1. Worked bytes are pymavlink's (ArduPilot/pymavlink); tests/oracles/test_mavlink.py asks pymavlink itself.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import pytest
from construct import Byte, Struct, this

from aces_bus import make_scanner
from aces_bus.errors import CallerError, FieldError, SpecError
from aces_bus.protocol import Crc, CutZeros, Protocol, Trailer
from aces_bus.protocol.exchange import load_database
from aces_bus.protocol.exchange.problems import ImportedProtocol
from aces_bus.testing import LAWS
from aces_lab.exchange import print_dissector
from tests.lab.exchange.test_export_wireshark import compare, needs_tshark, pcap_file, tshark
from tests.laws.drawn import drawn_arguments

FOLDER = Path(__file__).parents[1] / "data" / "mavlink"

#: ATTITUDE of system 1, component 1, number 5: 1 s, 0.1, -0.2, 1.5 rad, and three rates of 0.
V1 = (
    bytes.fromhex("FE 1C 05 01 01 1E E8 03 00 00 CD CC CC 3D CD CC 4C BE 00 00 C0 3F")
    + bytes(12)
    + b"\x33\x4f"
)
V2 = bytes.fromhex("FD 10 00 00 05 01 01 1E 00 00 E8 03 00 00 CD CC CC 3D CD CC 4C BE 00 00 C0 3F AE 0A")
#: HEARTBEAT, signed with the key 00…1F, link 3, time 123456789.
SIGNED = bytes.fromhex(
    "FD 09 01 00 05 01 01 00 00 00 00 00 00 00 02 03 51 03 03 77 CC 03 15 CD 5B 07 00 00 D6 60 97 10 88 99"
)
#: ATTITUDE, all zero: the first byte of a message is always there.
EMPTY = bytes.fromhex("FD 01 00 00 00 01 01 1E 00 00 00 01 BE")


@cache
def rover() -> Protocol:
    imported = load_database(FOLDER / "rover.xml")
    assert not imported.losses
    assert [str(one) for one in imported.problems] == ["line 31: field DOCKED.class is called class_ here"]
    return imported.protocol


def dialect(tmp_path: Path, messages: str, *, more: str = "", name: str = "own.xml") -> ImportedProtocol:
    path = tmp_path / name
    path.write_text(f"<mavlink>{more}\n<messages>\n{messages}\n</messages></mavlink>", encoding="utf-8")
    return load_database(path)


GOOD = '<message id="1" name="GOOD"><field type="uint8_t" name="a"/></message>'


def decoded(data: bytes, **how: Any) -> list[Any]:
    scanner = rover().scanner(include_unknown=True, **how)
    found = scanner.feed(data)
    return [*found, *scanner.close()]


def changed(fields: dict[str, Any], **others: Any) -> dict[str, Any]:
    return {**fields, **others}


def test_worked_packets_of_both_versions() -> None:
    """Zeros that were cut are there again; and the same values give the same bytes."""
    for data, version in ((V1, "v1"), (V2, "v2")):
        (record,) = decoded(data, dialect=version)
        assert (record.system, record.component, record.packet_sequence) == (1, 1, 5)
        assert (record.time_boot_ms, record.yaw, record.rollspeed, record.yawspeed) == (1000, 1.5, 0.0, 0.0)
        fields: dict[str, Any] = {
            name: getattr(record, name) for name in rover().variant(version)["ATTITUDE"].fields
        }
        assert rover().encode("ATTITUDE", dialect=version, **fields) == data
    (record,) = decoded(EMPTY)
    assert record.yaw == 0.0
    assert record.trailing == b""


def test_both_versions_on_one_wire() -> None:
    """A scanner of both dialects reads packets of both, and of one alone what is of the other is lost visibly."""
    both = make_scanner([rover().variant("v2"), rover().variant("v1")])
    assert [record.meta.size for record in both.feed(V1 + V2 + SIGNED + V1)] == [36, 28, 34, 36]
    assert both.counts.unknown == 0
    assert [type(one).__name__ for one in decoded(V1 + V2)] == ["Unknown", "ATTITUDE"]


def test_a_signature_is_kept_and_a_damaged_packet_refused() -> None:
    """It stands at the end of `trailing`; to send one takes its 13 bytes."""
    (record,) = decoded(SIGNED)
    assert record.incompat_flags == 1
    assert record.trailing == SIGNED[-13:]
    fields: dict[str, Any] = {name: getattr(record, name) for name in rover().variant()["HEARTBEAT"].fields}
    assert rover().encode("HEARTBEAT", **fields) == SIGNED
    with pytest.raises(FieldError, match="13 bytes are behind its check"):
        rover().encode("HEARTBEAT", **changed(fields, trailing=b"short"))
    with pytest.raises(FieldError, match="zeros at its end are not sent"):
        rover().encode("HEARTBEAT", **changed(fields, incompat_flags=0, trailing=b"\1\0"))
    spoiled = SIGNED[:12] + b"\xff" + SIGNED[13:]
    assert all(type(one).__name__ == "Unknown" for one in decoded(spoiled))


def test_flags_that_are_not_known_are_not_decoded() -> None:
    """A packet of which more is incompatible than a signature is not a message."""
    check = rover().framings[0].check
    assert check is not None
    body = b"\xfd\x01\x02" + EMPTY[3:-2]
    (lost,) = decoded(body + check.encode(body[1:] + bytes([39])))
    assert lost.reason == "unknown"


def test_fields_that_a_sender_does_not_know_yet_and_those_that_we_do_not() -> None:
    """Extensions are zero where they are not sent; what is behind the known fields is kept; zeros may be uncut."""
    message = rover().variant()["WHEELS"]
    fields: dict[str, Any] = {
        "system": 1,
        "component": 1,
        "time_boot_ms": 5,
        "speed": [1, None, -3, 4],
        "mode": "ROVER_MODE_DRIVE",
        "faults": ["ROVER_FAULT_LOW_BATTERY"],
        "label": "front",
        "data": b"\1\2\3",
        "heading": 0,
        "slip": 0,
    }
    short = rover().encode("WHEELS", **fields)
    assert short[1] == 23
    (record,) = decoded(short)
    assert (record.heading, record.slip, record.label) == (0.0, 0.0, "front")
    assert record.speed == (1, None, -3, 4)
    assert list(record.faults) == ["ROVER_FAULT_LOW_BATTERY"]
    assert record.mode == "ROVER_MODE_DRIVE"
    (record,) = decoded(rover().encode("WHEELS", **changed(fields, heading=90.0, slip=0.4, trailing=b"new")))
    assert record.heading == pytest.approx(90.0)
    assert record.slip == pytest.approx(0.4)
    assert record.trailing == b"new"
    check = message.framing.check if message.framing is not None else None
    assert check is not None
    body = short[:1] + bytes([28]) + short[2:-2] + bytes(5)
    (record,) = decoded(body + check.encode(body[1:] + message.check_extra))
    assert record.trailing == b""
    assert (record.heading, record.label) == (0.0, "front")


def test_what_a_dialect_says_of_its_fields() -> None:
    """Units, sentinels, names and bits; enumerations go on in the file that includes another."""
    leaves = {leaf.path: leaf.node for leaf in rover().variant()["WHEELS"].plan.leaves}
    assert leaves["heading"].unit == "°"
    assert leaves["slip"].scale is not None
    assert leaves["slip"].scale.scale == pytest.approx(0.2)
    assert leaves["speed.0"].scale is not None
    assert leaves["speed.0"].scale.unknown == (0x7FFF,)
    assert leaves["mode"].value_names == {0: "ROVER_MODE_IDLE", 1: "ROVER_MODE_DRIVE", 3: "ROVER_MODE_DOCK"}
    assert leaves["faults"].flags == {
        "ROVER_FAULT_HOT": 0,
        "ROVER_FAULT_LOW_BATTERY": 3,
        "ROVER_FAULT_STUCK": 6,
    }
    assert {m.name for m in rover().variant("v1").messages.values()} == {"HEARTBEAT", "ATTITUDE", "WHEELS"}
    assert rover().variant("v1")["WHEELS"].fields[-1] == "data"
    assert rover().variant()["DOCKED"].place.line == 28


@pytest.mark.slow
def test_the_laws_hold() -> None:
    """On drawn packets of both versions, signed ones among them: round trip, oracle, chunking, accounting, …"""
    for version in ("v2", "v1"):
        variant = rover().variant(version)
        for law in LAWS:
            for seed in range(4):
                law(variant, "both", *drawn_arguments(law, variant, "both", seed))


@needs_tshark
def test_wireshark_gives_the_zeros_back(tmp_path: Path) -> None:
    """Its dissector shows what the scanner decodes, of signed packets, too."""
    variant = rover().variant()
    source, losses = print_dissector(variant)
    assert not losses
    packets = [V2, SIGNED, EMPTY]
    shown = tshark(
        tmp_path,
        source,
        pcap_file(tmp_path, packets),
        "-o",
        'uat:user_dlts:"User 0 (DLT=147)","rover","0","","0",""',
    )
    for packet, found in zip(packets, shown, strict=True):
        (raw,), (physical,) = rover().scanner(raw=True).feed(packet), rover().scanner().feed(packet)
        assert compare(variant, raw, physical, found[0]) > 5


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<mavlink><messages>", r"own.xml:1: not XML that can be read: no element found"),
        ("nothing", r"own.xml:1: not XML that can be read: syntax error"),
        ("<KeyConfig/>", r"own.xml:1: not a MAVLink dialect: it begins with <KeyConfig>"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><mavlink/>', r"own.xml:1: a dialect file has no document type"),
        (
            '<!DOCTYPE x SYSTEM "http://localhost/x"><mavlink/>',
            r"own.xml:1: a dialect file has no document type",
        ),
        ("<mavlink>" + "<a>" * 40, r"own.xml:1: elements in one another, 32 deep"),
        ("<mavlink/>", r"own.xml: no message in it can be used"),
        ("<mavlink>&other;</mavlink>", r"own.xml:1: not XML that can be read: undefined entity"),
    ],
)
def test_files_that_are_refused(tmp_path: Path, text: str, said: str) -> None:
    """With file and line; entities are not even declared, and nothing is fetched."""
    path = tmp_path / "own.xml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CallerError, match=said):
        load_database(path)


@pytest.mark.parametrize(
    ("include", "said"),
    [
        ("../own.xml", "<include>../own.xml</include> is not a file beside this one"),
        ("/etc/passwd", "<include>/etc/passwd</include> is not a file beside this one"),
        ("http://localhost/x.xml", "<include>http://localhost/x.xml</include> is not a file beside this one"),
        ("..", "<include>..</include> is not a file beside this one"),
        ("missing.xml", "missing.xml: no such file: not included"),
        ("broken.xml", "broken.xml:1: not XML that can be read: syntax error: not included"),
    ],
)
def test_only_files_beside_it_are_included(tmp_path: Path, include: str, said: str) -> None:
    """One that cannot be costs itself."""
    (tmp_path / "broken.xml").write_text("<", encoding="utf-8")
    imported = dialect(tmp_path, GOOD, more=f"<include>{include}</include>")
    (problem,) = imported.losses
    assert said in problem.reason.replace("no element found", "syntax error").replace(
        "unclosed token", "syntax error"
    )
    assert "GOOD" in imported.protocol.messages


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ('<message id="2" name="A"><field type="uint8_t[256]" name="a"/></message>', "field a has 256 items"),
        ('<message id="2" name="A"><field type="u128" name="a"/></message>', "field 'a' of type 'u128'"),
        ('<message id="x" name="A"/>', "a message has a name and a number"),
        ('<message id="-2" name="A"/>', "-2 is not a number of a message"),
        ('<message id="16777216" name="A"/>', "16777216 is not a number of a message"),
        ('<message id="1" name="A"/>', "GOOD has its number 1"),
        ('<message id="2" name="A"><field type="double[40]" name="a"/></message>', "320 bytes of fields"),
    ],
)
def test_a_message_that_cannot_be_costs_itself(tmp_path: Path, message: str, said: str) -> None:
    imported = dialect(tmp_path, f"{GOOD}\n{message}")
    (problem,) = imported.losses
    assert problem.line == 4
    assert said in problem.reason
    assert set(imported.protocol.messages) == {"GOOD"}


def test_a_meaning_that_cannot_be_said_costs_itself(tmp_path: Path) -> None:
    """The field stays a number, with a note."""
    imported = dialect(
        tmp_path,
        '<message id="1" name="A"><field type="uint8_t" name="a" enum="NONE"/>'
        '<field type="float" name="b" multiplier="many" units="V"/>'
        '<field type="int8_t" name="c" invalid="never"/></message>',
    )
    assert [str(one).partition("A.")[2] for one in imported.problems] == [
        "a: its enumeration NONE is not there",
        "b: its multiplier 'many' is not a number",
        "c: what it says of invalid values (never) is only in its text",
    ]
    assert not imported.losses


def test_slips_in_a_spec_with_cut_zeros() -> None:
    """A framing that cuts zeros must know each message by its header; a trailer needs both."""
    protocol = Protocol("slip", link="serial")
    check = Crc("CRC16-MCRF4XX", over=(slice(1, -2),))
    header = Struct("size" / Byte, "flags" / Byte, "kind" / Byte)
    shape: dict[str, Any] = {"sync": b"\xaa", "header": header, "size": this.size + 6, "max_size": 261}
    framing = protocol.framing(**shape, check=check, stuffing=CutZeros())
    with pytest.raises(SpecError, match="match the header's kind"):
        framing("A", payload=Struct("x" / Byte))
    framing("B", match={"kind": 1}, payload=Struct("x" / Byte), direction="to device")
    with pytest.raises(SpecError, match="two messages 1 of 1 and 2 bytes"):
        framing("C", match={"kind": 1}, payload=Struct("x" / Byte, "y" / Byte), direction="from device")
    with pytest.raises(SpecError, match=r"there by a bit of a header field \(there are: size, flags, kind\)"):
        protocol.framing(**shape, check=check, stuffing=CutZeros(), trailer=Trailer(4, "none"))
    with pytest.raises(SpecError, match=r"a trailer is for packets with stuffing=CutZeros\(\)"):
        protocol.framing(**shape, check=check, trailer=Trailer(4, "flags"))
    with pytest.raises(SpecError, match="a trailer follows a CRC"):
        protocol.framing(**shape, stuffing=CutZeros(), trailer=Trailer(4, "flags"))
