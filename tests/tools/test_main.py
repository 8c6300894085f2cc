"""`aces` itself: verbs, versions, complaints, and how quick it is to start."""

from __future__ import annotations

import argparse
import errno
import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from aces_bus.version import __version__
from aces_tools.main import main
from aces_tools.options import add_arguments
from aces_tools.verbs import options_of, top_verbs, verbs

from .conftest import Aces

#: What only the verbs may import.
HEAVY = (
    "construct",
    "numpy",
    "can",
    "rich",
    "msgspec",
    "importlib.metadata",
    "aces_bus.protocol",
    "aces_bus.recordings",
)


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"], ["help"]])
def test_help_lists_every_verb(aces: Aces, arguments: list[str]) -> None:
    """Without a verb, and when asked, `aces` lists the verbs."""
    result = aces(*arguments)
    assert result.status == 0
    assert all(f"  {verb} " in result.out for verb in top_verbs())
    assert max(map(len, result.out.splitlines())) <= 80


def test_discover_has_another_name(aces: Aces) -> None:
    """`aces scan` is `aces discover`."""
    assert aces("scan", "--help").out == aces("discover", "--help").out


def test_python_runs_the_package() -> None:
    """`python -m aces_tools` is `aces`."""
    done = subprocess.run(
        [sys.executable, "-m", "aces_tools", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith(f"aces {__version__} (")


def test_one_word_for_one_thing() -> None:
    """An option has one spelling and one letter in all verbs, and a letter one meaning."""
    spellings: dict[str, set[str]] = {}
    for name, verb in verbs().items():
        parser = argparse.ArgumentParser(add_help=False)
        add_arguments(parser, verb.load().ARGUMENTS)
        for module in options_of(name):
            add_arguments(parser, module.ARGUMENTS)
        for action in parser._actions:
            for option in action.option_strings:
                spellings.setdefault(option, set()).add(" ".join(sorted(action.option_strings)))
    several = {option: words for option, words in spellings.items() if len(words) > 1}
    assert not several


def test_version(aces: Aces) -> None:
    """`aces --version` prints the version of the package, and whether it was compiled."""
    status, printed, _ = aces("--version")
    assert (status, printed) in [
        (0, f"aces {__version__} ({build})\n") for build in ("pure Python", "compiled")
    ]


@pytest.mark.parametrize("arguments", [["--help"], ["--version"]])
def test_nothing_heavy_is_imported_for_help(arguments: list[str]) -> None:
    """Help and version import none of the dependencies, nor the protocols."""
    program = (
        "import sys; from aces_tools.main import main; status = main(sys.argv[2:]); "
        "print(*(n for n in sys.argv[1].split(',') if n in sys.modules)); sys.exit(status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, ",".join(HEAVY), *arguments],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == ""


DATABASE = """VERSION ""

BO_ 256 Lamp: 2 ECU
 SG_ brightness : 0|8@1+ (2,0) [0|0] "%" ECU
"""


@pytest.mark.slow
def test_a_few_frames_with_a_database_take_neither_numpy_nor_python_can(tmp_path: Path) -> None:
    """Text of a short candump log is decoded without what only columns, packed files and buses need; cantools is there as
    a whole for the program, as ever."""
    (tmp_path / "lamp.dbc").write_text(DATABASE)
    (tmp_path / "lamp.log").write_text("(1.000000) can0 100#0A00\n")
    program = (
        "import sys; from aces_tools.main import main; status = main(['decode', 'lamp.log', '-p', 'lamp.dbc']); "
        "print(*(n for n in ('numpy', 'can', 'xml.sax', 'sqlite3') if n in sys.modules)); "
        "import cantools; print(cantools.tester.Tester.__name__, cantools.Error.__name__); sys.exit(status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    _, frame, loaded, names = done.stdout.splitlines()
    assert frame.split()[3:] == ["Lamp", "brightness=20", "%"]
    assert (loaded, names) == ("", "Tester Error")


def test_an_unknown_verb_names_those_that_exist(aces: Aces) -> None:
    """A verb that does not exist is one line with the verbs, and status 2."""
    for arguments in (["dcode"], ["help", "dcode"]):
        result = aces(*arguments)
        assert result.status == 2
        assert result.err.count("\n") == 1
        assert "did you mean 'decode'?" in result.err
        assert "there are: decode, " in result.err


def test_an_action_without_its_verb_is_found(aces: Aces) -> None:
    """`aces serve` and `aces guess` say which verb has that action."""
    assert "did you mean 'bus serve'?" in aces("serve").err
    assert "did you mean 'spec guess'?" in aces("guess").err


def test_a_wrong_choice_names_those_that_exist(aces: Aces) -> None:
    """A slip in an action or in a format is reported as one in a name is."""
    assert "no argument of 'aces bus' named 'serv'; did you mean 'serve'?" in aces("bus", "serv").err
    result = aces("decode", "-", "--format", "jsnl")
    assert result.status == 2
    assert "no --format named 'jsnl'; did you mean 'jsonl'?" in result.err


@pytest.mark.parametrize("arguments", [["--help"], ["protocols"], ["protocols", "--json"]])
def test_a_full_disk_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    """What a verb prints and cannot be written ends it with status 2, and with no traceback."""

    class Full(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(sys, "stdout", Full())
    assert main(arguments) == 2
    assert capsys.readouterr().err == "aces: standard output: writing stopped: No space left on device\n"


def test_an_unknown_option_names_those_that_exist(aces: Aces) -> None:
    """So is an option."""
    result = aces("--versoin")
    assert result.status == 2
    assert "--version" in result.err


@pytest.mark.parametrize("verb", [*verbs(), *(verb for verb in top_verbs() if verb not in verbs())])
def test_every_verb_explains_itself(aces: Aces, verb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """`aces VERB --help` and `aces help VERB` print what the verb is for, on a terminal of 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")
    result = aces(*verb.split(), "--help")
    assert result.status == 0
    assert f"usage: aces {verb}" in result.out
    assert max(map(len, result.out.splitlines())) <= 80
    assert " " in verb or aces("help", verb).out == result.out


@pytest.mark.parametrize(
    "arguments", [["convert"], ["decode", "x", "-p"], ["spec"], ["decode", "x", "-p", "y", "--nope"]]
)
def test_a_wrong_call_is_one_line(aces: Aces, arguments: list[str]) -> None:
    """What argparse complains of is one line that names the help, and status 2."""
    result = aces(*arguments)
    assert result.status == 2
    assert result.err.startswith("aces: ")
    assert result.err.count("\n") == 1
    assert "--help" in result.err


def test_main_returns_and_never_exits() -> None:
    """A program can call `main`."""
    assert main(["decode", "--no-such-option"]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["sniff", "--help"], ["protocols", "hubo", "Encoder"]])
def test_an_output_without_unicode(arguments: list[str]) -> None:
    """Drawings and signs are written with what ASCII has, and nothing is a traceback."""
    program = "import sys; from aces_tools.main import main; sys.exit(main())"
    marks = set[int]()
    for encoding in ("ascii", "utf-8"):
        done = subprocess.run(
            [sys.executable, "-c", program, *arguments],
            capture_output=True,
            check=False,
            env={**os.environ, "PYTHONIOENCODING": encoding},
        )
        assert (done.returncode, done.stderr) == (0, b"")
        marks.add(done.stdout.count(b"?"))
    assert len(marks) == 1


def test_files_behind_two_dashes(
    aces: Aces, log: Path, arm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A name that begins like an option is one of a file there."""
    log.rename(tmp_path / "-walk.log")
    monkeypatch.chdir(tmp_path)
    result = aces("decode", "-q", "-p", arm, "--", "-walk.log")
    assert (result.status, result.summary["frames"]) == (0, 12)


def test_quiet_is_valid_everywhere_and_switches_notes_off(
    aces: Aces, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every verb takes -q; with it, or with ACES_NOTES=off, no notes are printed, and what is wrong still is."""
    for name in verbs():
        assert "  -q, --quiet" in aces(*name.split(), "--help").out, name
    monkeypatch.chdir(tmp_path)
    assert aces("spec", "new", "one", "--link", "can").messages[0] == "wrote one/one.py"
    assert aces("spec", "new", "two", "--link", "can", "-q").err == ""
    monkeypatch.setenv("ACES_NOTES", "off")
    assert aces("spec", "new", "three", "--link", "can").err == ""
    assert "aces: no protocol named" in aces("protocols", "nonesuch", "-q").err
    monkeypatch.delenv("ACES_NOTES")
    assert aces("spec", "new", "four", "--link", "can").messages != []
