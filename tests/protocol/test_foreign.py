"""Files of other tools as protocols: what they say is taken over, what cannot be is listed, nothing of it raises."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from aces_bus.errors import CallerError, FieldError
from aces_bus.frames import Frame
from aces_bus.protocol import Unknown, draw, make_scanner
from aces_bus.protocol.exchange import ImportedProtocol, load_database
from aces_bus.protocol.exchange.import_statements import split_statements
from aces_bus.protocol.exchange.names import python_name
from aces_bus.protocol.exchange.problems import EXCERPT
from aces_bus.protocol.plan.flatten import flatten
from aces_bus.testing import laws
from aces_bus.testing.source import spread
from tests.protocol.test_dbc_equal import agree

cantools = pytest.importorskip("cantools")

HEAD = 'VERSION ""\n\nNS_ :\n\tNS_DESC_\n\tCM_\n\tBA_\n\nBS_:\n\nBU_: ECU Gate\n\n'
#: Lines of HEAD; the first line of what follows is one more.
ABOVE = HEAD.count("\n")


def imported(tmp_path: Path, body: str, name: str = "car.dbc", encoding: str = "utf-8") -> ImportedProtocol:
    path = tmp_path / name
    path.write_bytes((HEAD + body if name.endswith(".dbc") else body).encode(encoding))
    return load_database(path)


def decoded(found: ImportedProtocol, *frames: Frame) -> list[Any]:
    return make_scanner([found.protocol.variant()], include_unknown=True, direction="both").feed(frames)


def reasons(found: ImportedProtocol) -> list[tuple[int, str]]:
    """(line of the body, reason) of each problem."""
    return [(problem.line - ABOVE, problem.reason) for problem in found.problems]


def laws_hold(found: ImportedProtocol, scenes: int = 4) -> None:
    """The laws of CAN on drawn scenes: round trip, oracle and columns, calm, …"""
    variant = found.protocol.variant()
    for law in laws.LAWS:
        if law.streams_only:
            continue
        for seed in range(scenes):
            law(variant, "both", *laws.draw_arguments(law, variant, "both", spread(seed)))


# ---------------------------------------------------------------------- what a DBC says

CAR = """BO_ 100 Speed: 5 ECU
 SG_ speed : 0|16@1+ (0.01,-10) [0|250] "km/h" Gate
 SG_ gear : 16|3@1- (1,0) [0|0] "" Gate
 SG_ temperature : 31|8@0+ (0.5,-40) [-40|87] "°C" Gate
BO_ 200 Large: 20 ECU
 SG_ late : 152|8@1+ (2,1) [0|0] "" Gate
CM_ BO_ 100 "How fast it goes.
On every road.";
CM_ SG_ 100 speed "measured at the \\"left\\" wheel";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 100 50;
VAL_ 100 gear -1 "reverse" 0 "neutral" ;
VAL_ 100 temperature 255 "not available" 254 "error" ;
"""


def test_a_message_says_what_the_database_says(tmp_path: Path) -> None:
    """Unit, scale, names, comments, sender, receivers and cycle time."""
    found = imported(tmp_path, CAR)
    assert found.problems == ()
    assert found.summary == ""
    speed = found.protocol["Speed"]
    assert speed.doc == "How fast it goes.\nOn every road.\nsent by ECU; to Gate; every 50 ms"
    assert speed.place.line == ABOVE + 1
    assert str(speed.place).endswith(f"car.dbc:{ABOVE + 1}")
    rows = {row.name: row for row in draw.field_table(flatten(speed))}
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

MUX = """BO_ 300 Mux: 8 ECU
 SG_ page M : 0|4@1+ (1,0) [0|0] "" Gate
 SG_ first m0 : 8|8@1+ (1,0) [0|0] "" Gate
 SG_ inner m1M : 8|8@1+ (1,0) [0|0] "" Gate
 SG_ deep m2 : 16|32@1- (1,0) [0|0] "" Gate
 SG_ twisted m0 : 17|32@1- (0.5,0) [0|0] "" Gate
SG_MUL_VAL_ 300 first page 0-0;
SG_MUL_VAL_ 300 inner page 1-1, 3-5;
SG_MUL_VAL_ 300 deep inner 2-9, 200-200;
SG_MUL_VAL_ 300 twisted page 6-6;
SIG_VALTYPE_ 300 deep : 1;
SIG_VALTYPE_ 300 twisted : 1;
BO_ 301 Simple: 8 ECU
 SG_ which M : 7|4@0+ (1,0) [0|0] "" Gate
 SG_ one m1 : 15|16@0- (0.1,0) [0|0] "V" Gate
 SG_ two m2 : 15|8@0+ (1,0) [0|0] "" Gate
 SG_ always : 56|8@1+ (1,0) [0|0] "" Gate
VAL_ 301 which 1 "one" 2 "two" 3 "nothing" ;
"""


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


def test_a_plain_name_stays() -> None:
    """Only what cannot be a Python name changes."""
    assert [python_name(n) for n in ("Speed", "1st gear", "_x", "a-b", "", "__", "größe")] == [
        "Speed",
        "n1st_gear",
        "x_",
        "a_b",
        "unnamed",
        "unnamed_",
        "gr__e",
    ]


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
    """Said to all or to one address, beside those of one frame; the frames that carry them are no messages."""
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


# ---------------------------------------------------------------------- damaged files


def test_a_statement_that_cannot_be_read_costs_itself(tmp_path: Path) -> None:
    """Whatever it is: the line and the reason are listed, the rest works."""
    body = """BO_ 1 First: 8 ECU
 SG_ good : 0|8@1+ (1,0) [0|0] "" Gate
 SG_ bad : 8|8@1+ (1,0 [0|0] "" Gate
 SG_ also_good : 16|8@1+ (1,0) [0|0] "" Gate
FOO_ 12 "what is this";
BO_ Second: 8 ECU
 SG_ lost : 0|8@1+ (1,0) [0|0] "" Gate
BO_ 3 Third: 8 ECU
CM_ BO_ 1 "a comment; BO_ 7 in it
BO_ 8 Not: 8 ECU";
CM_ SG_ 1 good "too many quotes""\" ;
BA_ "Undefined" BO_ 1 5;
VAL_ 1 nowhere 1 "x" ;
SIG_VALTYPE_ 77 nowhere : 1;
EV_ broken
"""
    found = imported(tmp_path, body)
    assert [line for line, _ in reasons(found)] == [3, 5, 6, 11, 12, 13, 14, 15]
    assert [m.name for m in found.protocol.declared] == ["First", "Third"]
    assert found.protocol["First"].fields == ("good", "also_good", "reserved")
    assert found.protocol["First"].doc.startswith("a comment; BO_ 7 in it\nBO_ 8 Not")
    assert found.summary.startswith(f"{tmp_path / 'car.dbc'}: 8 of ")
    assert all(len(problem.excerpt) <= EXCERPT and problem.excerpt for problem in found.problems)


def test_an_open_string_does_not_swallow_the_file(tmp_path: Path) -> None:
    """The statements behind it are found again."""
    found = imported(
        tmp_path,
        """BO_ 1 First: 8 ECU
 SG_ a : 0|8@1+ (1,0) [0|0] "V Gate
 SG_ b : 8|8@1+ (1,0) [0|0] "A" Gate
BO_ 2 Second: 8 ECU
 SG_ c : 8|8@1+ (1,0) [0|0] "A" Gate
CM_ BO_ 1 "never closed;
BO_ 3 Third: 8 ECU
 SG_ d : 8|8@1+ (1,0) [0|0] "A" Gate
""",
    )
    assert {m.name for m in found.protocol.declared} == {"First", "Second", "Third"}
    assert found.protocol["Second"].fields == ("c", "reserved")
    assert found.protocol["Third"].fields == ("d", "reserved")


@pytest.mark.slow
def test_no_message_gets_the_signals_of_another(tmp_path: Path) -> None:
    """However the quotes are broken: what an open string takes in is given back to whom it belongs."""
    rng = random.Random(11)
    for _ in range(12):
        lines: list[str] = []
        for n in range(1, 7):
            lines.append(f"BO_ {n} M{n}: 8 ECU")
            lines += [f' SG_ s{n}_{k} : {8 * k}|8@1+ (1,0) [0|0] "V" Gate' for k in range(4)]
            lines.append(rng.choice(("", 'FOO_ "x";', f'CM_ BO_ {n} "a comment";')))
        for at in rng.sample(range(len(lines)), 5):
            lines[at] = lines[at].replace('"', "", 1)
        found = imported(tmp_path, "\n".join(lines) + "\n")
        for message in found.protocol.declared:
            assert {f.partition("_")[0][1:] for f in message.fields if f[0] == "s"} <= {message.name[1:]}


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("BO_ 1 Huge: 4000000000 ECU\n", "a message of 4000000000 bytes"),
        ('BO_ 1 X: 8 ECU\n SG_ s : 0|4000000000@1+ (1,0) [0|0] "" Gate\n', "a signal of 4000000000 bits"),
        ('BO_ 1 X: 8 ECU\n SG_ s : 4000000000|4@1+ (1,0) [0|0] "" Gate\n', "at bit 4000000000"),
        ("BO_ 536870912 X: 8 ECU\n", "an identifier that no frame has"),
        ("BO_ 99999999999999999999 X: 8 ECU\n", "an identifier that no frame has"),
        (
            'BO_ 1 X: 8 ECU\n SG_ m M : 0|32@1+ (1,0) [0|0] "" Gate\n SG_ s m0 : 32|4@1+ (1,0) [0|0] "" Gate\n'
            "SG_MUL_VAL_ 1 s m 0-4294967295;\n",
            "its multiplexers have 4,294,967,296 combinations",
        ),
        (
            'BO_ 1 X: 8 ECU\n SG_ a M : 0|8@1+ (1,0) [0|0] "" Gate\n SG_ b m0M : 8|8@1+ (1,0) [0|0] "" Gate\n'
            ' SG_ c m0M : 16|8@1+ (1,0) [0|0] "" Gate\n SG_ d m0 : 24|8@1+ (1,0) [0|0] "" Gate\n'
            "SG_MUL_VAL_ 1 b a 0-255;\nSG_MUL_VAL_ 1 c b 0-255;\nSG_MUL_VAL_ 1 d c 0-255;\n",
            "combinations",
        ),
    ],
)
def test_what_would_cost_memory_or_time_is_not_loaded(tmp_path: Path, body: str, reason: str) -> None:
    """It is left out before anybody makes room for it."""
    found = imported(tmp_path, "BO_ 5 Fine: 1 ECU\n" + body)
    assert reason in str(found.problems[0])
    assert "Fine" in found.protocol.messages


@pytest.mark.parametrize(
    "body",
    [
        ' SG_ a M : 0|8@1+ (1,0) [0|0] "" Gate\n SG_ b m1 : 8|8@1+ (1,0) [0|0] "" Gate\nSG_MUL_VAL_ 1 a a 0-3;\n',
        ' SG_ a m0M : 0|8@1+ (1,0) [0|0] "" Gate\n SG_ b m0M : 8|8@1+ (1,0) [0|0] "" Gate\n'
        "SG_MUL_VAL_ 1 a b 0-3;\nSG_MUL_VAL_ 1 b a 0-3;\n",
        ' SG_ a : 0|8@1+ (1,0) [0|0] "" Gate\n SG_ b m1 : 8|8@1+ (1,0) [0|0] "" Gate\n',
        ' SG_ a M : 0|32@1- (1,0) [0|0] "" Gate\n SG_ b m1 : 32|8@1+ (1,0) [0|0] "" Gate\nSIG_VALTYPE_ 1 a : 1;\n',
        ' SG_ a M : 0|2@1+ (1,0) [0|0] "" Gate\n SG_ b m9 : 32|8@1+ (1,0) [0|0] "" Gate\n',
    ],
)
def test_multiplexers_that_make_no_sense(tmp_path: Path, body: str) -> None:
    """One that multiplexes itself, a ring of them, none at all, a float, a value it cannot have: something is listed."""
    found = imported(tmp_path, "BO_ 5 Fine: 1 ECU\nBO_ 1 X: 8 ECU\n" + body)
    assert found.losses or "b" in found.protocol["X"].fields
    assert "Fine" in found.protocol.messages
    laws_hold(found, scenes=1)


def test_text_of_a_file_is_never_code(tmp_path: Path) -> None:
    """Comments, units and names stand in generated source as text, whatever they hold."""
    evil = "\\\\'''\\\\\\\\ \0 \x0c \u2028 {x} %s \\N{DASH} \\n"
    found = imported(
        tmp_path,
        f"""BO_ 1 Some: 1 ECU
 SG_ s : 0|4@1+ (0.5,0) [0|0] "{evil}" Gate
CM_ BO_ 1 "{evil}\\"\\"\\"
raise SystemExit";
CM_ SG_ 1 s "{evil}\\"\\"\\"";
VAL_ 1 s 1 "{evil}\\"\\"\\"" ;
""",
    )
    (record,) = decoded(found, Frame(1, b"\1"))
    assert record.s.startswith("\\")
    assert found.protocol.variant().encoder.source
    laws_hold(found, scenes=1)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    """UTF-8 with or without a mark, Windows-1252, UTF-16."""
    found = imported(tmp_path, CAR, encoding=encoding)
    rows = draw.field_table(flatten(found.protocol["Speed"]))
    assert [row.unit for row in rows if row.name == "temperature"] == ["°C"]


def test_line_ends(tmp_path: Path) -> None:
    """Those of other systems are line ends, too, and lines are counted alike."""
    path = tmp_path / "car.dbc"
    path.write_bytes((HEAD + CAR).replace("\n", "\r\n").encode())
    assert load_database(path).protocol["Large"].place.line == ABOVE + 5


@pytest.mark.parametrize("name", ["x.dbc", "x.kcd", "x.sym", "x.arxml", "x.eds", "x.dcf"])
@pytest.mark.parametrize(
    "content", [b"", b"\0" * 100, b"hello\n", b"<xml>", bytes(range(256)) * 4, b"[1000]\n"]
)
def test_a_file_of_something_else(tmp_path: Path, name: str, content: bytes) -> None:
    """One clear line that names the file."""
    path = tmp_path / name
    path.write_bytes(content)
    if content == b"[1000]\n" and name.endswith(("eds", "dcf")):
        assert load_database(path).losses
        return
    with pytest.raises(CallerError) as raised:
        load_database(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)


def test_what_is_no_file(tmp_path: Path) -> None:
    """A missing file, a folder, a suffix of something else, one too large."""
    (tmp_path / "folder.dbc").mkdir()
    large = tmp_path / "large.dbc"
    with large.open("wb") as file:
        file.truncate(1 << 30)
    for path, said in (
        ("none.dbc", "no such file"),
        ("folder.dbc", "a folder"),
        ("car.txt", "not a database file"),
        ("large.dbc", "at most 67,108,864 are read"),
    ):
        with pytest.raises(CallerError, match=said):
            load_database(tmp_path / path)


@pytest.mark.slow
def test_damaged_files_never_raise_anything_else(tmp_path: Path) -> None:
    """Cut anywhere, bytes flipped, lines dropped: a protocol with problems, or one clear error."""
    whole = (HEAD + CAR + MUX).encode()
    rng = random.Random(5)
    path = tmp_path / "damaged.dbc"
    for _ in range(40):
        data = bytearray(whole)
        how = rng.randrange(3)
        if how == 0:
            del data[rng.randrange(len(data)) :]
        elif how == 1:
            for _ in range(rng.randint(1, 6)):
                data[rng.randrange(len(data))] = rng.choice(b'";:|@ \n\0aZ9-(\xff')
        else:
            at = rng.randrange(len(data))
            del data[at : at + rng.randrange(40)]
        path.write_bytes(bytes(data))
        try:
            found = load_database(path)
        except CallerError:
            continue
        make_scanner([found.protocol.variant()]).feed([Frame(100, bytes(5)), Frame(300, bytes(8))])


def test_every_line_is_in_a_statement() -> None:
    """Splitting loses nothing, not even of nonsense."""
    rng = random.Random(1)
    pieces = [*(HEAD + CAR + MUX).splitlines(keepends=True), '"\n', "x\n", "\n", "SG_ \n", 'CM_ "\n']
    for _ in range(50):
        text = "".join(rng.choice(pieces) for _ in range(30))
        lines = "".join(one.whole for one in split_statements(text)).splitlines()
        assert sorted(lines) == sorted(text.splitlines())


# ---------------------------------------------------------------------- other formats


@pytest.mark.parametrize("kind", ["kcd", "sym"])
def test_other_formats_say_the_same(tmp_path: Path, kind: str) -> None:
    """What cantools writes as KCD or SYM decodes as the DBC does."""
    # Floats need a length of 32 or 64 there, too; the extended multiplexers are the DBC's own.
    body = CAR.replace("200 Large: 20", "200 Large: 8").replace("152|8", "56|8")
    dbc = imported(tmp_path, body)
    database = cantools.database.load_file(str(tmp_path / "car.dbc"))
    text = database.as_kcd_string() if kind == "kcd" else database.as_sym_string()
    other = imported(tmp_path, text, f"car.{kind}")
    assert {m.name for m in other.protocol.declared} == {m.name for m in dbc.protocol.declared}
    frames = [Frame(100, bytes([n, 3, n % 7, 255 - n, 0])) for n in range(0, 256, 5)]
    for one, same in zip(decoded(dbc, *frames), decoded(other, *frames), strict=True):
        assert (one.speed, one.gear, one.temperature) == (same.speed, same.gear, same.temperature)


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        ("sym", 'Sig="speed" 0', 'Sig="speed" 4000000000'),
        ("sym", 'Sig="gear" signed 3', 'Sig="gear" signed 400000000'),
        ("sym", "Len=5", "Len=4000000000"),
        ("sym", "ID=064h", "ID=064h-1FFFFFFFh"),
        ("kcd", 'length="5"', 'length="4000000000"'),
        ("kcd", 'offset="16"', 'offset="4000000000"'),
    ],
)
def test_sizes_beyond_measure_are_refused(tmp_path: Path, kind: str, old: str, new: str) -> None:
    """Formats that are read as a whole are refused with the line, before anybody makes room."""
    database = cantools.database.load_string(
        HEAD + CAR.replace("200 Large: 20", "200 Large: 8").replace("152|8", "56|8"), "dbc"
    )
    text = database.as_kcd_string() if kind == "kcd" else database.as_sym_string()
    assert old in text
    imported(tmp_path, text, f"car.{kind}")
    with pytest.raises(CallerError, match=rf"car\.{kind}:\d+: "):
        imported(tmp_path, text.replace(old, new, 1), f"car.{kind}")


def test_a_container_is_listed(tmp_path: Path) -> None:
    """AUTOSAR's messages of several messages are none that we hold; nor is one without identifier and length of ours."""
    from cantools.database import Database
    from cantools.database.can import Message

    from aces_bus.protocol.exchange.import_build import build

    inner = Message(1, "Inner", 8, [], header_id=5)
    database = Database([Message(2, "Outer", 64, [], contained_messages=[inner], is_fd=True), inner])
    protocol, problems = build(database, "car", "car.arxml", lambda message, signal: 3)
    assert [m.name for m in protocol.declared] == ["Inner"]
    assert [str(p) for p in problems] == ["line 3: message Outer: a container of other messages: left out"]


EDS = """[DeviceInfo]
VendorName=Nobody
[1800]
ParameterName=TPDO1
ObjectType=9
[1800sub1]
ParameterName=COB-ID
DataType=7
AccessType=rw
DefaultValue=$NODEID+0x40000180
[1A00]
ParameterName=Mapping
ObjectType=9
[1A00sub0]
ParameterName=Entries
DataType=5
AccessType=rw
DefaultValue=4
[1A00sub1]
ParameterName=a
DataType=7
AccessType=rw
DefaultValue=0x60410010
[1A00sub2]
ParameterName=b
DataType=7
AccessType=rw
DefaultValue=0x00010003
[1A00sub3]
ParameterName=c
DataType=7
AccessType=rw
DefaultValue=0x60640015
[1A00sub4]
ParameterName=d
DataType=7
AccessType=rw
DefaultValue=0x20000110
[6041]
ParameterName=Status word
DataType=6
AccessType=ro
[6064]
ParameterName=Position
DataType=4
AccessType=ro
[2000]
ParameterName=Other
ObjectType=9
[2000sub1]
ParameterName=Current
DataType=3
AccessType=ro
[1400]
ParameterName=RPDO1
ObjectType=9
[1400sub1]
ParameterName=COB-ID
DataType=7
AccessType=rw
DefaultValue=0x80000200
[1600]
ParameterName=Mapping
ObjectType=9
[1600sub0]
ParameterName=Entries
DataType=5
AccessType=rw
DefaultValue=1
[1600sub1]
ParameterName=a
DataType=7
AccessType=rw
DefaultValue=0x60640020
"""


def test_mapped_objects_become_fields(tmp_path: Path) -> None:
    """Of any node; types below 20h are bits that mean nothing; what is switched off is listed."""
    pytest.importorskip("canopen")
    found = imported(tmp_path, EDS, "drive.eds")
    assert [p.reason for p in found.problems] == [
        "RPDO1: it is switched off (bit 31 of its COB-ID): left out"
    ]
    word = 0x1234 | 5 << 16 | (-2 & 0x1FFFFF) << 19 | (-3 & 0xFFFF) << 40
    pdo, heartbeat, alarm = decoded(
        found,
        Frame(0x185, word.to_bytes(7, "little")),
        Frame(0x705, b"\x05"),
        Frame(0x085, bytes.fromhex("1023010000000000")),
    )
    assert (pdo.node, pdo.Status_word, pdo.Position, pdo.Other_Current) == (5, 0x1234, -2, -3)
    assert pdo.meta.direction == "from device"
    assert (heartbeat.node, heartbeat.state, alarm.code) == (5, "operational", 0x2310)
    laws_hold(found, scenes=2)


def test_a_dcf_knows_its_node(tmp_path: Path) -> None:
    """Its identifiers are those of that node; what is set counts, not the default."""
    pytest.importorskip("canopen")
    text = EDS.replace("DefaultValue=0x80000200", "DefaultValue=0x80000200\nParameterValue=0x0000027F")
    found = imported(tmp_path, "[DeviceComissioning]\nNodeID=0x10\nBaudrate=250\n" + text, "drive.dcf")
    assert found.problems == ()
    assert found.protocol.bitrate == 250_000
    identifiers = {m.name: m.identifier.constant for m in found.protocol.declared}
    assert (identifiers["TPDO1"], identifiers["RPDO1"], identifiers["Heartbeat"]) == (0x190, 0x27F, 0x710)
    assert found.protocol["RPDO1"].direction == "to device"


@pytest.mark.slow
def test_damaged_eds_files_never_raise_anything_else(tmp_path: Path) -> None:
    """Cut anywhere, bytes changed, lines dropped: a protocol with problems, or one clear error."""
    pytest.importorskip("canopen")
    rng = random.Random(9)
    path = tmp_path / "damaged.eds"
    whole = (EDS + "[DeviceComissioning]\nNodeID=4\nBaudrate=500\n").encode()
    for _ in range(60):
        data = bytearray(whole)
        for _ in range(rng.randint(1, 8)):
            at = rng.randrange(len(data))
            if rng.randrange(3):
                data[at] = rng.choice(b"0123456789abcdefx$[]=;\n -")
            else:
                del data[at : at + rng.randrange(30)]
        path.write_bytes(bytes(data))
        try:
            found = load_database(path)
        except CallerError:
            continue
        decoded(found, Frame(0x185, bytes(7)), Frame(0x184, bytes(8)), Frame(0x204, bytes(4)))


def test_a_damaged_eds(tmp_path: Path) -> None:
    """Lines and objects that cannot be read cost themselves."""
    pytest.importorskip("canopen")
    text = EDS.replace("DataType=6\n", "DataType=six\n") + "[6041]\nParameterName=Again\nnonsense\n"
    found = imported(tmp_path, text, "drive.eds")
    said = [problem.reason.partition(":")[0] for problem in found.losses]
    assert "an object that cannot be read" in said
    assert "a section that is there already" in said
    (pdo,) = decoded(found, Frame(0x185, bytes(7)))
    assert pdo.x6041_0 == 0
    assert pdo.Position == 0


# ---------------------------------------------------------------------- size


def test_a_large_database_is_quick(tmp_path: Path) -> None:
    """Messages are told apart by a glance at their identifiers, and compiled when they are first seen."""
    body = "".join(f'BO_ {n} M{n}: 8 ECU\n SG_ a : 0|8@1+ (0.5,0) [0|0] "" Gate\n' for n in range(1, 400))
    found = imported(tmp_path, body)
    assert len(found.protocol.declared) == 399
    from aces_bus.protocol.declare import ambiguity

    assert ambiguity.conflict.cache_info().currsize < 60_000
    (record,) = decoded(found, Frame(7, b"\x03" + bytes(7)))
    assert record.a == 1.5
