"""DBC files as protocols: what they say is taken over, what cannot be is listed."""

from __future__ import annotations

from pathlib import Path

import pytest

from aces_bus import Frame, Unknown
from aces_bus.errors import FieldError
from aces_bus.protocol.draw.table import FieldRow
from aces_bus.protocol.plan.flatten import flatten
from tests.protocol.imported import ABOVE, CAR, MUX, decoded, imported, laws_hold, reasons
from tests.protocol.test_dbc_equal import agree

pytest.importorskip("cantools")

# ---------------------------------------------------------------------- what a DBC says


def test_a_message_says_what_the_database_says(tmp_path: Path) -> None:
    """Unit, scale, names, comments, sender, receivers and cycle time."""
    found = imported(tmp_path, CAR)
    assert found.problems == ()
    assert found.summary == ""
    speed = found.protocol["Speed"]
    assert speed.doc == "How fast it goes.\nOn every road.\nsent by ECU; to Gate; every 50 ms"
    assert speed.place.line == ABOVE + 1
    assert str(speed.place).endswith(f"car.dbc:{ABOVE + 1}")
    rows = {row.name: row for row in FieldRow.table(flatten(speed))}
    assert (rows["speed"].unit, rows["speed"].scale, rows["speed"].range) == ("km/h", "0.01", "0…250")
    assert rows["speed"].doc == 'measured at the "left" wheel'
    assert rows["temperature"].names == "255=not available, 254=error"
    (record,) = decoded(found, Frame(100, bytes.fromhex("1027000064")))
    assert (record.speed, record.gear, record.temperature) == (90.0, "neutral", -40)


def test_numbers_stay_whole_where_the_factors_are(tmp_path: Path) -> None:
    """As in cantools: an integer factor and offset make an integer."""
    found = imported(tmp_path, CAR)
    (record,) = decoded(found, Frame(200, bytes(19) + b"\x05", is_fd=True))
    assert (record.late, type(record.late)) == (11, int)


def test_names_and_numbers_of_a_scaled_signal(tmp_path: Path) -> None:
    """A signal with factor and value table shows the name where there is one; both are sent, ranges bind numbers, and a
    number that would be read as a name is refused."""
    found = imported(tmp_path, CAR)
    (named, number) = decoded(
        found, Frame(100, bytes.fromhex("00000000ff")), Frame(100, bytes.fromhex("0000000050"))
    )
    assert (named.temperature, number.temperature) == (-40, -40)
    (named, number) = decoded(
        found, Frame(100, bytes.fromhex("000000ff00")), Frame(100, bytes.fromhex("0000005000"))
    )
    assert (named.temperature, number.temperature) == ("not available", 0)
    protocol = found.protocol
    sent = protocol.encode("Speed", speed=0, gear="reverse", temperature="error")
    assert bytes(sent.data).hex() == "e80307fe00"
    assert bytes(protocol.encode("Speed", speed=0, gear=-4, temperature=86.5).data).hex() == "e80304fd00"
    with pytest.raises(FieldError, match="temperature: 87 °C would be sent as 254, which means 'error'"):
        protocol.encode("Speed", speed=0, gear=0, temperature=87)
    with pytest.raises(FieldError, match=r"temperature: 88 °C is outside -40…87 °C"):
        protocol.encode("Speed", speed=0, gear=0, temperature=88)
    with pytest.raises(FieldError, match="no value named 'broken'"):
        protocol.encode("Speed", speed=0, gear=0, temperature="broken")


def test_longer_frames_keep_what_is_behind(tmp_path: Path) -> None:
    """As cantools reads them; a shorter frame is malformed, and says what the message has."""
    found = imported(tmp_path, CAR)
    longer, shorter = decoded(found, Frame(100, bytes(5) + b"\x07\x08"), Frame(100, bytes(4)))
    assert longer.trailing == b"\x07\x08"
    assert isinstance(shorter, Unknown)
    assert shorter.reason == "malformed: length 4, Speed has 5…8 bytes"
    rebuilt = found.protocol.encode("Speed", speed=0, gear=0, temperature=0, trailing=b"\1")
    assert len(rebuilt.data) == 6
    with pytest.raises(FieldError, match="9 bytes"):
        found.protocol.encode("Speed", speed=0, gear=0, temperature=0, trailing=bytes(4))


def test_the_laws_hold(tmp_path: Path) -> None:
    """A protocol from a file is a protocol like any other."""
    laws_hold(imported(tmp_path, CAR))


# ---------------------------------------------------------------------- multiplexers


def test_multiplexers_in_multiplexers(tmp_path: Path) -> None:
    """A signal is there while its multiplexer is there and has one of its values, single or in ranges."""
    found = imported(tmp_path, MUX)
    assert found.problems == ()
    mux = [
        decoded(found, Frame(300, bytes.fromhex(data)))[0]
        for data in (
            "0005000000000000",
            "0405000080bf0000",
            "05c80000c03f0000",
            "0501000080bf0000",
            "0600000000000000",
        )
    ]
    assert [(r.first, r.inner, r.deep, r.twisted) for r in mux] == [
        (5, None, None, None),
        (None, 5, -1.0, None),
        (None, 200, 1.5, None),
        (None, 1, None, None),
        (None, None, None, 0.0),
    ]
    assert agree(tmp_path / "car.dbc", frames=60, seed=3) > 40
    laws_hold(found)


def test_a_value_that_no_signal_is_for(tmp_path: Path) -> None:
    """The others decode all the same; what a selector excludes cannot be sent."""
    found = imported(tmp_path, MUX)
    (record,) = decoded(found, Frame(301, bytes.fromhex("9000000000000007")))
    assert (record.which, record.one, record.two, record.always) == (9, None, None, 7)
    with pytest.raises(FieldError, match="only there while which is 2"):
        found.protocol.encode("Simple", which="one", one=1, two=2, always=0)


# ---------------------------------------------------------------------- signals that do not fit


def test_signals_that_share_bits(tmp_path: Path) -> None:
    """All of them decode; what is sent must agree about the shared bits; it is listed as a note, not as a loss."""
    found = imported(
        tmp_path,
        """BO_ 1 Both: 8 ECU
 SG_ whole : 0|16@1+ (1,0) [0|0] "" Gate
 SG_ part : 4|8@1+ (1,0) [0|0] "" Gate
 SG_ motorola : 7|12@0- (1,0) [0|0] "" Gate
""",
    )
    (note,) = found.problems
    assert note.is_note
    assert "share" in str(note) or "overlaps" in str(note)
    assert found.losses == []
    (record,) = decoded(found, Frame(1, bytes.fromhex("3412000000000000")))
    assert (record.whole, record.part, record.motorola) == (0x1234, 0x23, 0x341)
    assert (
        bytes(found.protocol.encode("Both", whole=0x1234, part=0x23, motorola=0x341).data) == record.meta.raw
    )
    with pytest.raises(FieldError, match="contradicts"):
        found.protocol.encode("Both", whole=0x1234, part=0x24, motorola=0x341)
    laws_hold(found)


def test_a_signal_that_cannot_be_is_left_out_alone(tmp_path: Path) -> None:
    """Past the end, without bits, with a factor of 0: the others of its message stay."""
    found = imported(
        tmp_path,
        """BO_ 1 Some: 2 ECU
 SG_ past : 9|8@1+ (1,0) [0|0] "" Gate
 SG_ past_too : 8|9@0+ (1,0) [0|0] "" Gate
 SG_ nothing : 0|0@1+ (1,0) [0|0] "" Gate
 SG_ constant : 0|4@1+ (0,3) [0|0] "" Gate
 SG_ third : 4|24@1+ (1,0) [0|0] "" Gate
 SG_ good : 0|8@1+ (1,0) [0|0] "" Gate
 SG_ half : 0|9@1+ (1,0) [0|0] "" Gate
SIG_VALTYPE_ 1 half : 1;
""",
    )
    assert [(line, reason.split(": ")[-2]) for line, reason in reasons(found)] == [
        (2, "it ends at bit 16, past the 2 bytes of its message"),
        (3, "it ends at bit 23, past the 2 bytes of its message"),
        (4, "a signal of 0 bits"),
        (5, "a factor of 0"),
        (6, "it ends at bit 27, past the 2 bytes of its message"),
        (8, "a float of 9 bits"),
    ]
    assert found.protocol["Some"].fields == ("good", "reserved", "trailing")


def test_names_that_records_or_python_have(tmp_path: Path) -> None:
    """They get an underscore, and a note; what generated code calls its own is no message's name."""
    found = imported(
        tmp_path,
        """BO_ 1 Record: 2 ECU
 SG_ class : 0|1@1+ (1,0) [0|0] "" Gate
 SG_ meta : 1|1@1+ (1,0) [0|0] "" Gate
 SG_ reserved : 2|1@1+ (1,0) [0|0] "" Gate
 SG_ _x : 3|1@1+ (1,0) [0|0] "" Gate
 SG_ x_ : 4|1@1+ (1,0) [0|0] "" Gate
BO_ 2 Struct: 0 ECU
BO_ 3 None: 0 ECU
BO_ 4 len: 1 ECU
 SG_ data : 0|4@1+ (1,0) [0|0] "" Gate
 SG_ key : 4|4@1+ (1,0) [0|0] "" Gate
""",
    )
    assert [m.name for m in found.protocol.declared] == ["Record_", "Struct_", "None_", "len_"]
    assert found.protocol["Record_"].fields[:5] == ("class_", "meta_", "reserved_", "x_", "x__")
    assert all(problem.is_note for problem in found.problems)
    laws_hold(found, scenes=2)


def test_messages_with_one_identifier(tmp_path: Path) -> None:
    """The last one is what cantools decodes, and what we keep; the others are listed."""
    found = imported(
        tmp_path,
        """BO_ 1 Old: 8 ECU
 SG_ old : 0|8@1+ (1,0) [0|0] "" Gate
BO_ 1 New: 8 ECU
 SG_ new : 0|8@1+ (1,0) [0|0] "" Gate
BO_ 2147483649 Extended: 8 ECU
""",
    )
    assert reasons(found) == [(1, "message Old has the identifier of New further down: left out")]
    assert [m.name for m in found.protocol.declared] == ["New", "Extended"]


def test_value_tables(tmp_path: Path) -> None:
    """A name that is there twice gets its number; numbers that the signal cannot have are not taken over."""
    found = imported(
        tmp_path,
        """BO_ 1 Some: 1 ECU
 SG_ state : 0|2@1+ (1,0) [0|0] "" Gate
VAL_ 1 state 0 "off" 1 "on" 2 "on" 9 "never" ;
""",
    )
    states = [decoded(found, Frame(1, bytes([n])))[0].state for n in range(4)]
    assert states == ["off", "on", "on_2", 3]


# ---------------------------------------------------------------------- J1939


@pytest.mark.parametrize(
    "attributes",
    [
        'BA_DEF_ "ProtocolType" STRING ;\nBA_DEF_DEF_ "ProtocolType" "";\nBA_ "ProtocolType" "J1939";\n',
        'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
        'BA_DEF_DEF_ "VFrameFormat" "J1939PG";\n',
    ],
)
def test_j1939_messages_are_told_by_their_group(tmp_path: Path, attributes: str) -> None:
    """From any source, with any priority; to any destination where the group is addressed."""
    found = imported(
        tmp_path,
        """BO_ 2364540158 EEC1: 8 ECU
 SG_ rpm : 24|16@1+ (0.125,0) [0|8031.875] "rpm" Gate
BO_ 2565537790 Request: 3 ECU
 SG_ group : 0|24@1+ (1,0) [0|0] "" Gate
"""
        + attributes,
    )
    assert reasons(found) == []
    eec, other, request = decoded(
        found,
        Frame(0x0CF00400, bytes.fromhex("0000002003000000"), is_extended_id=True),
        Frame(0x18F00431, bytes(8), is_extended_id=True),
        Frame(0x18EAFF05, bytes.fromhex("caFE00"), is_extended_id=True),
    )
    assert (eec.priority, eec.source, eec.rpm) == (3, 0, 100.0)
    assert (other.priority, other.source) == (6, 0x31)
    assert (request.source, request.destination, request.group) == (5, 0xFF, 0xFECA)
    sent = found.protocol.encode("Request", priority=6, source=5, destination=255, group=0xFECA)
    assert sent.arbitration_id == 0x18EAFF05


J1939 = 'BA_DEF_ "ProtocolType" STRING ;\nBA_ "ProtocolType" "J1939";\n'


def test_j1939_messages_of_more_than_8_bytes_are_packets(tmp_path: Path) -> None:
    """Said to all or to one address, beside those of one frame; the frames that carry them are not messages."""
    found = imported(
        tmp_path,
        """BO_ 2566843646 Number: 18 ECU
 SG_ first : 0|8@1+ (1,0) [0|0] "" Gate
 SG_ years : 64|16@1+ (1,0) [0|0] "" Gate
 SG_ last : 136|8@1+ (0.5,-10) [0|0] "" Gate
BO_ 2565865470 Own: 12 ECU
 SG_ a : 64|32@1+ (1,0) [0|0] "" Gate
BO_ 2364540158 EEC1: 8 ECU
 SG_ rpm : 24|16@1+ (0.125,0) [0|8031.875] "rpm" Gate
BO_ 2565668862 Connection: 8 ECU
 SG_ control : 0|8@1+ (1,0) [0|0] "" Gate
"""
        + J1939,
    )
    carriers = "message Connection: its frames carry the messages of more than 8 bytes: left out"
    assert reasons(found) == [(9, carriers)]

    def frames(*texts: str) -> list[Frame]:
        parts = (text.split("#") for text in texts)
        return [Frame(int(i, 16), bytes.fromhex(data), is_extended_id=True) for i, data in parts]

    eec, number, own = decoded(
        found,
        *frames("1CECFF00#20120003FFECFE00", "1CEBFF00#0131584B44443439", "0CF00400#0000002003000000"),
        *frames("1CEBFF00#025830414A313233", "1CEBFF00#033435362AFFFFFF"),
        *frames("1CECF900#100D0002FF00EF00", "1CEBF900#0100000000000000", "1CEBF900#0200010000000AFF"),
    )
    assert eec.rpm == 100.0
    assert (number.first, number.years, number.last, number.source) == (0x31, 0x4130, 11.0, 0)
    # A byte more than declared is kept, as of frames.
    assert (own.a, own.destination, own.trailing) == (1, 0xF9, b"\x0a")
    laws_hold(found)
