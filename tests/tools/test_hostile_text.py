"""Text of files: no escape sequence of theirs reaches a terminal, no cell of a sheet is a formula."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from aces_bus.plain_text import cell_text, printable
from aces_tools.main import main

pytest.importorskip("cantools")

EVIL = "\x1b]0;title\x07\x1b[31m"
DATABASE = f"""VERSION "{EVIL}"
BU_: A
BO_ 1 Some: 3 A
 SG_ plain : 0|8@1+ (1,0) [0|0] "{EVIL}" A
 SG_ name : 8|8@1+ (1,0) [0|0] "" A
 SG_ scaled : 16|8@1+ (0.5,0) [0|0] "V" A
CM_ BO_ 1 "{EVIL}about";
CM_ SG_ 1 name "{EVIL}about";
VAL_ 1 name 1 "{EVIL}one" 2 "=1+1" 3 "-2+3" 4 "-5" ;
VAL_ 1 scaled 1 "{EVIL}one" 2 "@SUM(A1)" ;
BO_ 2 Bad{EVIL}: 8 A
"""
LOG = "(1.0) can0 001#010101\n(1.1) can0 001#020202\n(1.2) can0 001#030403\n"


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str]:
    """A database and a recording whose names and texts are hostile."""
    database, log = tmp_path / f"a{EVIL}.dbc", tmp_path / f"a{EVIL}.log"
    database.write_text(DATABASE, encoding="utf-8")
    log.write_text(LOG, encoding="utf-8")
    return str(database), str(log)


def test_no_command_prints_an_escape_sequence_of_a_file(
    files: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Whether it succeeds or complains: on stdout and on stderr."""
    database, log = files
    for command in (
        ["decode", log, "-p", database],
        ["decode", log, "-p", database, "--where", "name=nothing"],
        ["protocols", database],
        ["protocols", database, "Some"],
        ["spec", "check", database, "--for", "0.2"],
        ["spec", "show", database],
        ["decode", f"{log}.none", "-p", database],
    ):
        main(command)
        said = capsys.readouterr()
        assert said.out + said.err
        assert not set("\x1b\x07") & set(said.out + said.err), command


def test_cells_that_would_be_formulas_are_quoted(
    tmp_path: Path, files: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """In both forms of CSV; numbers stay numbers, also where a name is one."""
    database, log = files
    main(["decode", log, "-p", database, "--format", "csv", "--message", "Some"])
    lines = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    pytest.importorskip("pyarrow")
    main(["decode", log, "-p", database, "-o", f"{tmp_path / 'out.csv'}/"])
    capsys.readouterr()
    with open(tmp_path / "out.csv" / "Some.csv", encoding="utf-8", newline="") as file:
        again = list(csv.DictReader(file))
    for rows in (lines, again):
        assert [row["name"] for row in rows] == ["\\x1b]0;title\\x07\\x1b[31mone", "'=1+1", "-5"]
        assert [row["scaled"] for row in rows] == ["\\x1b]0;title\\x07\\x1b[31mone", "'@SUM(A1)", "1.5"]


@pytest.mark.parametrize(
    ("text", "cell"),
    [
        *(("=1", "'=1"), ("+a", "'+a"), ("-", "'-"), ("@x", "'@x"), ("\tx", "'\tx"), ("\r", "'\r")),
        *(
            ("-5", "-5"),
            ("+1.5e-3", "+1.5e-3"),
            (".5", ".5"),
            ("a=1", "a=1"),
            ("", ""),
            ("-5\n=1", "'-5\n=1"),
        ),
    ],
)
def test_which_texts_are_quoted(text: str, cell: str) -> None:
    """What begins like a formula and is not a number."""
    assert cell_text(text) == cell


def test_a_robots_name_can_be_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Else the file is refused, with its line."""
    path = tmp_path / "robot.toml"
    path.write_text('name = "x\\u001b]0;y\\u0007"\n[buses]\nb = { link = "can", protocol = "hubo" }\n')
    assert main(["robot", "check", str(path)]) != 0
    said = "".join(capsys.readouterr())
    assert "robot.toml:1: name: a name has no control characters" in said
    assert said == "\n".join(map(printable, said.split("\n")))
