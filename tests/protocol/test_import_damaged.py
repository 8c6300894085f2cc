"""Damaged database files: what cannot be read is listed with its line, the rest is taken, nothing is raised."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from aces_bus import Frame, make_scanner
from aces_bus.errors import CallerError
from aces_bus.protocol.draw.table import FieldRow
from aces_bus.protocol.exchange import load_database
from aces_bus.protocol.exchange.import_statements import split_statements
from aces_bus.protocol.exchange.problems import ImportedProtocol, ImportProblem
from aces_bus.protocol.plan.flatten import flatten
from tests.protocol.imported import ABOVE, CAR, HEAD, MUX, decoded, imported, laws_hold, reasons

pytest.importorskip("cantools")


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
    assert all(len(problem.excerpt) <= 80 and problem.excerpt for problem in found.problems)


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
    rows = FieldRow.table(flatten(found.protocol["Speed"]))
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


def test_a_message_of_which_several_fields_are_lost_is_one_statement() -> None:
    """Never "3 of 1 statements"."""
    problems = tuple(ImportProblem(line, "its type is not known") for line in (1, 2, 3))
    protocol: Any = None
    assert ImportedProtocol(protocol, problems, 1, "a.xml").summary.startswith(
        "a.xml: 3 parts of 1 statement were left out; first: "
    )
    assert ImportedProtocol(protocol, problems[:1], 1, "a.xml").summary.startswith(
        "a.xml: 1 of 1 statement was left out; first: "
    )
