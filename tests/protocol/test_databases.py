"""Databases as they are found: damaged, careless, very large, of parameter groups, of both frame formats."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from aces_bus import Frame, FrameTable, Unknown, make_column_scanner, make_scanner
from aces_bus.errors import CallerError, SpecError
from aces_bus.protocol import Protocol
from aces_bus.protocol.exchange import load_database
from aces_bus.protocol.record import field_names
from tests.protocol.imported import CAR, EDS, imported, laws_hold, reasons

cantools = pytest.importorskip("cantools")

J1939 = 'BA_DEF_ "ProtocolType" STRING ;\nBA_DEF_DEF_ "ProtocolType" "";\nBA_ "ProtocolType" "J1939";\n'


def told(protocol: Protocol, *frames: Frame) -> list[tuple[str, dict[str, Any]]]:
    """Message (or reason) and fields of each frame: live, and asserted to be the same as columns."""
    records = make_scanner([protocol.variant()], include_unknown=True).feed(frames)
    scanner = make_column_scanner([protocol.variant()], include_unknown=True)
    tables = scanner.feed(FrameTable.from_frames(list(frames))) + scanner.close()
    rows = {
        row: (table.message, {name: table[name].to_list()[place] for name in table.names})
        for table in tables
        for place, row in enumerate(table.row.tolist())
    }
    found: list[tuple[str, dict[str, Any]]] = []
    for number, record in enumerate(records):
        if isinstance(record, Unknown):
            assert rows[number][0] == ""
            found.append((record.reason, {}))
            continue
        fields = {name: getattr(record, name) for name in field_names(type(record))}
        assert rows[number] == (record.meta.message, fields)
        found.append((type(record).__name__, fields))
    return found


# ---------------------------------------------------------------------- what cannot be used


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("BO_ 3182918790 M: 8 X\n", "an identifier that no frame has"),
        ("BO_ 1 M: 4294967295 X\n", "a message of 4294967295 bytes"),
        ("BO_ 1 M: 8 X\n SG_\n SG_ : 1|2\nBO_ x\n", ""),
        ("BO_ M\n", "cannot be read"),
    ],
)
def test_a_database_without_a_message_is_refused_with_the_reason(
    tmp_path: Path, body: str, reason: str
) -> None:
    """The file has nothing but that, not even a version."""
    path = tmp_path / "only.dbc"
    path.write_text(body, encoding="utf-8")
    if not reason:
        assert load_database(path).losses
        return
    with pytest.raises(CallerError, match=r"no message in it can be used; first: line 1: .*" + reason):
        load_database(path)


def _whole(kind: str) -> str:
    """A file of each kind, with something of everything."""
    from cantools.database import Database

    database: Any = Database()
    database.add_dbc_string('VERSION "1"\n\nBU_: ECU Gate\n\n' + CAR)
    if kind == "kcd":
        return str(database.as_kcd_string())
    if kind == "sym":
        return str(database.as_sym_string())
    return _ARXML


_ARXML = """<?xml version="1.0" encoding="UTF-8"?>
<AUTOSAR xmlns="http://autosar.org/schema/r4.0" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
 xsi:schemaLocation="http://autosar.org/schema/r4.0 AUTOSAR_4-3-0.xsd"><AR-PACKAGES><AR-PACKAGE>
<SHORT-NAME>Car</SHORT-NAME><ELEMENTS>
<CAN-CLUSTER><SHORT-NAME>Bus</SHORT-NAME><CAN-CLUSTER-VARIANTS><CAN-CLUSTER-CONDITIONAL><BAUDRATE>500000</BAUDRATE>
<PHYSICAL-CHANNELS><CAN-PHYSICAL-CHANNEL><SHORT-NAME>Ch</SHORT-NAME><FRAME-TRIGGERINGS><CAN-FRAME-TRIGGERING>
<SHORT-NAME>T</SHORT-NAME><FRAME-REF DEST="CAN-FRAME">/Car/Speed</FRAME-REF><IDENTIFIER>100</IDENTIFIER>
</CAN-FRAME-TRIGGERING></FRAME-TRIGGERINGS></CAN-PHYSICAL-CHANNEL></PHYSICAL-CHANNELS>
</CAN-CLUSTER-CONDITIONAL></CAN-CLUSTER-VARIANTS></CAN-CLUSTER>
<CAN-FRAME><SHORT-NAME>Speed</SHORT-NAME><FRAME-LENGTH>8</FRAME-LENGTH><PDU-TO-FRAME-MAPPINGS><PDU-TO-FRAME-MAPPING>
<SHORT-NAME>Map</SHORT-NAME><PDU-REF DEST="I-SIGNAL-I-PDU">/Car/Pdu</PDU-REF><START-POSITION>0</START-POSITION>
</PDU-TO-FRAME-MAPPING></PDU-TO-FRAME-MAPPINGS></CAN-FRAME>
<I-SIGNAL-I-PDU><SHORT-NAME>Pdu</SHORT-NAME><LENGTH>8</LENGTH><I-SIGNAL-TO-PDU-MAPPINGS><I-SIGNAL-TO-I-PDU-MAPPING>
<SHORT-NAME>M</SHORT-NAME><I-SIGNAL-REF DEST="I-SIGNAL">/Car/speed</I-SIGNAL-REF>
<PACKING-BYTE-ORDER>MOST-SIGNIFICANT-BYTE-LAST</PACKING-BYTE-ORDER><START-POSITION>4</START-POSITION>
</I-SIGNAL-TO-I-PDU-MAPPING></I-SIGNAL-TO-PDU-MAPPINGS></I-SIGNAL-I-PDU>
<I-SIGNAL><SHORT-NAME>speed</SHORT-NAME><LENGTH>12</LENGTH>
<SYSTEM-SIGNAL-REF DEST="SYSTEM-SIGNAL">/Car/sys</SYSTEM-SIGNAL-REF></I-SIGNAL>
<SYSTEM-SIGNAL><SHORT-NAME>sys</SHORT-NAME></SYSTEM-SIGNAL>
</ELEMENTS></AR-PACKAGE></AR-PACKAGES></AUTOSAR>
"""


@pytest.mark.parametrize("kind", ["kcd", "sym", "arxml", "dcf"])
def test_damaged_files_of_every_kind_are_read_or_refused(tmp_path: Path, kind: str) -> None:
    """Bytes changed, pieces dropped, doubled or moved, numbers grown: a protocol with problems, or one clear error."""
    if kind == "dcf":
        pytest.importorskip("canopen")
    path = tmp_path / f"damaged.{kind}"
    whole = (EDS + "[DeviceComissioning]\nNodeID=4\n" if kind == "dcf" else _whole(kind)).encode()
    path.write_bytes(whole)
    assert load_database(path).protocol.messages
    rng = random.Random(12)
    refused = named = 0
    for _ in range(50):
        data = bytearray(whole)
        for _ in range(rng.randint(1, 4)):
            at = rng.randrange(len(data))
            size = rng.randrange(60)
            how = rng.randrange(5)
            if how == 0:
                data[at] = rng.choice(b"\"';:<>/=|@ \n\0aZ9-(\xff[]{}")
            elif how == 1:
                del data[at : at + size]
            elif how == 2:
                data[at:at] = data[at : at + size]
            elif how == 3:
                data[at:at] = rng.choice((b"4294967296", b"-1", b"1e9", b"\x1b[2J", b"99999999999999999999"))
            else:
                to = rng.randrange(len(data))
                data[at:at] = data[to : to + size]
        path.write_bytes(bytes(data))
        try:
            found = load_database(path)
        except CallerError as error:
            refused += 1
            named += str(error).startswith(str(path))
            continue
        make_scanner([found.protocol.variant()]).feed([Frame(100, bytes(5)), Frame(0x185, bytes(8))])
    assert named == refused  # every refusal says which file
    assert refused or kind == "dcf"  # of which hardly a line is needed


# ---------------------------------------------------------------------- identifiers


def test_an_identifier_of_29_bits_needs_no_mark(tmp_path: Path) -> None:
    """It is taken for one, with a note, and so is whatever is said of the message; another with the mark keeps its own."""
    found = imported(
        tmp_path,
        """BO_ 318291879 Wide: 8 ECU
 SG_ state : 0|8@1+ (1,0) [0|0] "" Gate
 SG_ which M : 8|8@1+ (1,0) [0|0] "" Gate
 SG_ one m1 : 16|32@1- (1,0) [0|0] "" Gate
BO_ 2048 Clash: 8 ECU
BO_ 2147485696 Marked: 8 ECU
CM_ BO_ 318291879 "BO_ 318291879 in a comment";
CM_ SG_ 318291879 state "what it does";
VAL_ 318291879 state 1 "on" 0 "off" ;
SIG_VALTYPE_ 318291879 one : 1;
SG_MUL_VAL_ 318291879 one which 1-3;
""",
    )
    assert sorted(found.protocol.messages) == ["Marked", "Wide"]
    (note,) = [one for one in found.problems if one.is_note]
    assert note.reason.startswith(
        "message Wide: identifier 12F8BFA7h has more than 11 bits: taken for one of 29 bits"
    )
    (lost,) = found.losses
    assert lost.line == reasons(found)[-1][0] + 12 or "Clash" in lost.excerpt
    assert found.protocol["Wide"].doc.startswith("BO_ 318291879 in a comment")
    frame = Frame(318291879, bytes.fromhex("0103000020c10000"), is_extended_id=True)
    ((name, fields),) = told(found.protocol, frame)
    assert name == "Wide"
    assert (fields["state"], fields["which"], fields["one"]) == ("on", 3, -10.0)


def test_a_declared_identifier_goes_before_the_pattern_of_its_group(tmp_path: Path) -> None:
    """Several messages of one parameter group are told by source address; no frame is taken for a neighbour's."""
    found = imported(
        tmp_path,
        """BO_ 2566833152 FromEngine: 8 ECU
 SG_ temperature : 0|16@1+ (0.1,0) [0|0] "" Gate
BO_ 2566833203 FromBody: 8 ECU
 SG_ door : 0|1@1+ (1,0) [0|0] "" Gate
"""
        + J1939,
    )
    assert not found.losses
    (note,) = found.problems
    assert "(0FEC4h): FromEngine, FromBody: distinguished by" in note.reason
    data = bytes.fromhex("0102030405060708")
    identifiers = (0x18FEC400, 0x18FEC433, 0x0CFEC433, 0x18FEC455)
    names = [
        name for name, _ in told(found.protocol, *(Frame(n, data, is_extended_id=True) for n in identifiers))
    ]
    assert names == ["FromEngine", "FromBody", "FromBody", "unknown"]
    laws_hold(found, scenes=2)


def test_messages_of_a_group_that_are_alike_leave_other_sources_to_the_first(tmp_path: Path) -> None:
    """What it means is certain then, and who sent it is in the record."""
    found = imported(
        tmp_path,
        "".join(
            f'BO_ {0x98F00400 | source} Engine{source}: 8 ECU\n SG_ speed : 24|16@1+ (0.125,0) [0|0] "rpm" Gate\n'
            for source in (0, 1)
        )
        + J1939,
    )
    frames = [Frame(0x18F00400 | source, bytes(range(8)), is_extended_id=True) for source in (0, 1, 7)]
    got = told(found.protocol, *frames)
    assert [(name, fields["source"]) for name, fields in got] == [
        ("Engine0", 0),
        ("Engine1", 1),
        ("Engine0", 7),
    ]


def test_groups_that_are_addressed_are_told_by_whatever_tells_them(tmp_path: Path) -> None:
    """The same source to two destinations; a message that is not a parameter group keeps its own identifier."""
    body = "".join(
        f'BO_ {0x80000000 | identifier} {name}: 8 ECU\n SG_ {name}_value : 0|8@1+ (1,0) [0|0] "" Gate\n'
        for identifier, name in (
            (0x18EF1000, "ToBody"),
            (0x18EF2000, "ToEngine"),
            (0x18FF0102, "Own"),
            (0x18FF0100, "Group"),
        )
    )
    kinds = (
        'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
        'BA_DEF_DEF_ "VFrameFormat" "J1939PG";\n'
        f'BA_ "VFrameFormat" BO_ {0x98FF0102} 1;\n'
    )
    found = imported(tmp_path, body + kinds)
    assert not found.losses
    identifiers = (0x18EF1000, 0x1CEF2000, 0x18EF3000, 0x18FF0102, 0x18FF0103, 0x1CFF0102)
    frames = [Frame(n, bytes(8), is_extended_id=True) for n in identifiers]
    names = [name for name, _ in told(found.protocol, *frames)]
    assert names == ["ToBody", "ToEngine", "unknown", "Own", "Group", "Group"]


# ---------------------------------------------------------------------- frame formats


def test_up_to_8_bytes_come_in_both_formats(tmp_path: Path) -> None:
    """Whether the database says a format or not; longer messages are CAN FD, and what is sent is as declared."""
    formats = ",".join(f'"r{n}"' for n in range(14)) + ',"StandardCAN_FD","ExtendedCAN_FD"'
    found = imported(
        tmp_path,
        """BO_ 1 Small: 8 ECU
 SG_ a : 0|16@1+ (0.1,0) [0|0] "" Gate
BO_ 2 Short: 2 ECU
 SG_ b : 0|16@1+ (1,0) [0|0] "" Gate
BO_ 3 Big: 16 ECU
 SG_ c : 64|16@1+ (1,0) [0|0] "" Gate
BO_ 4 Declared: 8 ECU
 SG_ d : 0|16@1+ (1,0) [0|0] "" Gate
BA_DEF_ BO_ "VFrameFormat" ENUM FORMATS;
BA_DEF_DEF_ "VFrameFormat" "r0";
BA_ "VFrameFormat" BO_ 4 14;
BA_ "VFrameFormat" BO_ 3 14;
""".replace("FORMATS", formats),
    )
    assert not found.losses
    frames = [
        *(Frame(n, bytes([1, 2, *range(6)]), is_fd=is_fd) for n in (1, 2, 4) for is_fd in (False, True)),
        *(Frame(3, bytes(16), is_fd=True), Frame(3, bytes(8)), Frame(1, bytes(12), is_fd=True)),
    ]
    got = told(found.protocol, *frames)
    assert [name for name, _ in got] == [
        *("Small", "Small", "Short", "Short", "Declared", "Declared", "Big", "unknown"),
        "malformed: length 12, Small has 8 bytes",
    ]
    sent = (found.protocol.encode("Small", a=1), found.protocol.encode("Declared", d=1))
    assert [bool(frame.is_fd) for frame in sent] == [False, True]
    laws_hold(found, scenes=2)


def test_two_messages_of_one_identifier_keep_their_formats(tmp_path: Path) -> None:
    """Then the format tells them apart."""
    protocol = Protocol("both", link="can")
    from aces_bus.protocol import BitLayout, bits

    protocol.message("Classic", id=1, payload=BitLayout(1, "a" / bits(8)))
    protocol.message("Fd", id=1, fd=True, payload=BitLayout(1, "b" / bits(8)))
    names = [name for name, _ in told(protocol, Frame(1, b"\1"), Frame(1, b"\1", is_fd=True))]
    assert names == ["Classic", "Fd"]
    with pytest.raises(SpecError, match="ambiguous with 'Classic'"):
        protocol.message("Any", id=1, any_format=True, payload=BitLayout(1, "c" / bits(8)))
    with pytest.raises(SpecError, match="any_format is for data frames"):
        protocol.message("Remote", id=2, any_format=True, remote=True)


# ---------------------------------------------------------------------- size
