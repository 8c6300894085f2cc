"""`aces spec check`: what it finds, where it says it is, and its exit status."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from aces_bus.protocol import Message, Protocol
from aces_bus.protocol.lint.finding import Finding
from aces_tools.authoring import check
from aces_tools.authoring.check import LEAST, example_numbers

from .conftest import Aces

HEAD = "from construct import *\nfrom aces_bus.protocol import *\n"
SOUND = f"""{HEAD}p = Protocol("sound", link="can")
p.message("A", id=5, payload=Struct("x" / Byte), examples=[("005#07", {{"x": 7}})])
"""
DOUBTFUL = f"""{HEAD}p = Protocol("doubt", link="can")
p.message("A", id=5,
    payload=Struct(
        "x" / Quantity(Int16ul, unit="raad")))
"""


#: What looks right to every rule, and is not: what is decoded is not what was encoded.
CROOKED = f"""{HEAD}
class Off(Adapter):
    def _decode(self, obj, context, path):
        return obj + 1
    def _encode(self, obj, context, path):
        return obj
p = Protocol("crooked", link="can")
p.message("A", id=5, payload=Struct("x" / Byte))
p.message("B", id=6, payload=Struct("x" / Off(Byte)))
"""


@pytest.fixture(autouse=True)
def _rules_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The laws take their time: here they are asked where a test says so."""
    monkeypatch.setattr(check, "SECONDS", 0.0)


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that is the working one, as a user's is."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_ships_is_clean(aces: Aces) -> None:
    """Nothing but notes, counted; shown when asked for."""
    result = aces("spec", "check", "robotis")
    assert (result.status, result.out) == (0, "robotis: ok: 8 messages, 1 note (--notes shows them)\n")
    shown = aces("spec", "check", "robotis", "--notes").out
    assert "note: Status: bytes alone do not tell it from Ping" in shown
    assert shown.endswith("robotis: ok: 8 messages, 1 note\n")


def test_a_finding_has_file_and_line(aces: Aces, written: Path) -> None:
    """As compilers say it, with the rule's name; the status says that there is something."""
    Path("doubt.py").write_text(DOUBTFUL)
    result = aces("spec", "check", "doubt.py")
    assert result.status == 1
    assert result.out.splitlines()[0] == (
        "doubt.py:6: warning: A.x: 'raad' is not a unit; is it 'rad'? [unit]"
    )
    (told,) = json.loads(aces("spec", "check", "doubt.py", "--json").out)
    note, finding = told["findings"]
    assert (note["level"], note["rule"]) == ("note", "example")
    assert (finding["line"], finding["level"], finding["rule"], finding["message"]) == (
        6,
        "warning",
        "unit",
        "A",
    )
    assert (told["ok"], told["counts"]) == (False, {"error": 0, "warning": 1, "note": 1})


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("x = (\n", 1, "'(' was never closed [spec]"),
        ("import nothing_of_that_name\n", 1, "ModuleNotFoundError"),
        ("\ndef f():\n    return 1 / 0\nf()\n", 3, "ZeroDivisionError: division by zero"),
        (SOUND + 'p.message("B", id=5, payload=Struct("y" / Byte))\n', 5, "both accept 005#00"),
        (SOUND + 'p.message("B", id=0x800)\n', 5, "is it extended=True?"),
        (SOUND + 'p.message("B", id=6, payload=BitLayout(1, "a" / bits(6), "b" / bits(3)))\n', 5, "past the layout"),
        (SOUND + 'p.message("B", id=6, payload=BitLayout(1, "a" / bits(6), "b" / bits(3, 4)))\n', 5, "overlaps 'a'"),
        (SOUND + 'p.message("B", id=6, payload=Struct("a" / Quantity(Byte, scale=0)))\n', 5, "not zero"),
    ],
)  # fmt: skip
def test_a_spec_that_fails_while_it_is_read_is_one_finding(
    aces: Aces, written: Path, text: str, line: int, says: str
) -> None:
    """With its line, and without a traceback; the other files are checked all the same."""
    Path("broken.py").write_text(text)
    Path("sound.py").write_text(SOUND)
    result = aces("spec", "check", "broken.py", "sound.py")
    assert result.status == 1
    first, *_, last = result.out.splitlines()
    assert first.startswith(f"broken.py:{line}: error: ")
    assert says in first
    assert "broken.py: 1 error" in result.out
    assert last == "sound.py: ok: 1 message"


def test_a_wrong_call_is_told_from_a_wrong_spec(aces: Aces, written: Path) -> None:
    """A name that is nowhere, a file that is missing or ends the program: status 2, and the rest is checked."""
    Path("ends.py").write_text("import sys\nsys.exit(3)\n")
    Path("sound.py").write_text(SOUND)
    result = aces("spec", "check", "nix", "missing.py", "ends.py", "sound.py")
    assert result.status == 2
    assert "no protocol or robot named 'nix'" in result.err
    assert "missing.py: no such file" in result.err
    assert "ends.py: the file ends the program" in result.err
    assert result.out == "sound.py: ok: 1 message\n"


def test_protocols_named_together_share_a_bus(aces: Aces, written: Path) -> None:
    """A frame that two of them claim is shown, with the command that explains it; `--apart` says that they do not."""
    Path("sound.py").write_text(SOUND)
    other = 'q = Protocol("other", link="can")\nq.message("B", id=5, payload=Struct("y" / Byte))\n'
    Path("other.py").write_text(HEAD + other)
    result = aces("spec", "check", "sound.py", "other.py")
    assert result.status == 1
    assert "other B collides with sound A (sound.py:4) if they share a bus: both accept 005#00" in result.out
    assert "to see it: aces spec explain sound.py other.py '005#00'" in result.out
    assert aces("spec", "check", "sound.py", "other.py", "--apart").status == 0
    Path("both.py").write_text(SOUND + other)
    assert "collides" in aces("spec", "check", "both.py").out


@pytest.mark.slow
def test_a_robot_is_checked_bus_by_bus(aces: Aces, written: Path) -> None:
    """The protocols of a robot's file; what is wrong with the file itself comes with its line."""
    assert aces("spec", "check", "hubo2plus").status == 0
    Path("arm.toml").write_text(
        'name = "arm"\n[buses]\nupper = { link = "can", protocol = "hubo" }\n[devices]\n'
        'A = { driver = "x", bus = "uper", credentials = { board = 8 } }\n'
    )
    result = aces("spec", "check", "arm.toml")
    assert result.status == 1
    assert "arm.toml:5: error: devices.A.bus: no bus named 'uper'" in result.out


def test_a_database_is_checked(aces: Aces, written: Path) -> None:
    """What could not be taken over is a warning with its line; a strange unit only a note."""
    pytest.importorskip("cantools")
    Path("car.dbc").write_text(
        'VERSION ""\nBU_: A\nBO_ 5 State: 2 A\n SG_ speed : 0|8@1+ (1,0) [0|0] "furlong/fortnight" A\n'
        ' SG_ far : 60|8@1+ (1,0) [0|0] "" A\n'
    )
    result = aces("spec", "check", "car.dbc", "--notes")
    assert result.status == 1
    assert "car.dbc:5: warning: " in result.out
    assert "note: State.speed: 'furlong/fortnight' is not a unit" in result.out
    assert "held on" in aces("spec", "check", "car.dbc", "--for", "0.001").messages[-1]


def test_the_laws_are_asked(aces: Aces, written: Path) -> None:
    """Of the code of a sound spec they hold, and it is said on how many scenes; with 0 seconds they are not asked."""
    Path("sound.py").write_text(SOUND)
    result = aces("spec", "check", "sound.py", "--for", "0.001")
    assert (result.status, result.out) == (0, "sound.py: ok: 1 message\n")
    assert result.messages == [f"sound.py: the nine laws held on {LEAST} scenes"]
    assert aces("spec", "check", "sound.py", "--for", "0").messages == []
    assert "'-1' is not a duration" in aces("spec", "check", "sound.py", "--for=-1").err


@pytest.mark.slow
def test_a_broken_law_is_an_error(aces: Aces, written: Path) -> None:
    """With the message and its line, the smallest frame that breaks it, and the command that repeats it."""
    Path("crooked.py").write_text(CROOKED)
    result = aces("spec", "check", "crooked.py", "--for", "0.001")
    assert result.status == 1
    assert result.out.startswith("crooked.py:11: error: B: law 1 (round trip) of crooked, direction None: ")
    assert re.search(r"\[law\]\n +0  006#", result.out)
    assert "do not all hold, on" in result.messages[0]
    again = re.search(r"again: aces (fuzz crooked.py --law 1 --seed 0:\d+)\n", result.out)
    assert again is not None
    assert aces(*again[1].split(), "--failures", written / "failures").status == 1
    (told,) = json.loads(aces("spec", "check", "crooked.py", "--for", "0.001", "--json").out)
    assert next(
        (one["rule"], one["message"], one["line"]) for one in told["findings"] if one["level"] == "error"
    ) == ("law", "B", 11)


def test_scenes_are_the_same_each_time() -> None:
    """Each example comes once, those of all benches in turn."""
    asked = [number for number, _ in zip(example_numbers(3), range(192), strict=False)]
    assert sorted(asked) == list(range(192))
    assert asked[:4] == [0, 32, 64, 1]


@pytest.mark.parametrize("wanted", ["rules", "laws"])
def test_no_check_ends_in_a_traceback(
    aces: Aces, written: Path, monkeypatch: pytest.MonkeyPatch, wanted: str
) -> None:
    """Whatever is raised while a spec is looked at is a finding, with the message that was in hand and its line."""
    Path("sound.py").write_text(SOUND)

    def stumble(protocol: Protocol) -> list[Finding]:
        for message in protocol.declared:
            assert isinstance(message, Message)
            raise RuntimeError("out of\n order")
        return []

    def of_laws(places: list[Protocol], **_: object) -> None:
        stumble(places[0])

    if wanted == "rules":
        monkeypatch.setattr(check, "check_protocol", stumble)
    else:
        monkeypatch.setattr("aces_bus.testing.fuzz.Fuzzer", of_laws)
    result = aces("spec", "check", "sound.py", "--for", "0" if wanted == "rules" else "1")
    assert result.status == 1
    said = "cannot be checked" if wanted == "rules" else "the generated code cannot be made or run"
    assert result.out.startswith(f"sound.py:4: error: A: {said}: RuntimeError: out of order [law]\n")


def test_an_expression_that_asks_the_wrong_struct_is_told_which(aces: Aces, written: Path) -> None:
    """`this.x` of a payload for a field of the identifier: what to write is said, not KeyError."""
    Path("outer.py").write_text(
        f"""{HEAD}p = Protocol("outer", link="can")
p.message("A", id=0x100 + IdField("n", range(4)), payload=Struct("y" / Byte, "z" / If(this.n & 1, Int16ul)))
"""
    )
    result = aces("spec", "check", "outer.py", "--for", "0.001")
    assert result.status == 1
    assert (
        "an expression asks for this.n, and no field 'n' is read before it in its own struct;"
        " fields of the identifier and the header are this._.n in a payload [law]" in result.out
    )


def test_colour_only_where_it_is_wanted(aces: Aces, written: Path) -> None:
    """Plain in a pipe, coloured when asked for."""
    Path("doubt.py").write_text(DOUBTFUL)
    assert "\x1b[" not in aces("spec", "check", "doubt.py").out
    assert "\x1b[" in aces("spec", "check", "doubt.py", "--color").out


@pytest.mark.slow
def test_the_page_shows_what_happens(aces: Aces, written: Path) -> None:
    """Each command of docs/checking.md, on the spec that the page begins with, prints what the page shows."""
    page = (Path(__file__).resolve().parents[2] / "docs" / "checking.md").read_text(encoding="utf-8")
    spec, rest = page.partition("```python\n")[2].split("```\n", 1)
    Path("lamp.py").write_text(spec)
    (recorder,) = re.findall(r"```python\n(# evening.py\n.*?)```", rest, re.DOTALL)
    exec(recorder)
    blocks = re.findall(r"```console\n\$ aces ([^\n]*)\n(.*?)```", rest, re.DOTALL)
    assert len(blocks) == 7
    for command, shown in blocks:
        assert aces(*shlex.split(command)).out == shown, command


def recorded(value: int) -> str:
    """A recording of the sound protocol's message, as candump writes it."""
    return "".join(f"(1.{n:06d}) can0 005#{value + n % 3:02X}\n" for n in range(40))


def test_a_recording_that_agrees_is_no_fault(aces: Aces, written: Path) -> None:
    """Nothing is said of it but notes, and the status is 0; what of it cannot be read is said."""
    Path("sound.py").write_text(SOUND)
    Path("walk.log").write_text(recorded(7) + "gibberish\n")
    result = aces("spec", "check", "sound.py", "--against", "walk.log")
    assert result.status == 0
    assert result.out.splitlines()[-1] == "sound.py against walk.log: ok: nothing speaks against it"
    assert "walk.log:41: " in result.err


def test_a_recording_that_contradicts_is_a_warning(aces: Aces, written: Path) -> None:
    """With count, instant and remedy, also as JSON; several recordings are read one after the other; the status is 1."""
    Path("sound.py").write_text(SOUND)
    Path("walk.log").write_text(recorded(7))
    Path("run.log").write_text(recorded(7).replace("005#", "006#"))
    call = ("spec", "check", "sound.py", "--against", "walk.log", "--against", "run.log")
    result = aces(*call)
    assert result.status == 1
    assert "40 frames 0x006 of 1 bytes are not a message; first at frame 0 (0.000 s) of run.log" in result.out
    assert "\n    → declare it, or name the protocol that has it\n" in result.out
    (finding,) = [one for part in json.loads(aces(*call, "--json").out) for one in part["findings"]]
    assert (finding["rule"], finding["count"], finding["witness"]) == ("undeclared", 40, "006#07")
    assert finding["first"] == {"source": "run.log", "row": 0, "time": 0.0}


@pytest.mark.slow
def test_protocols_that_share_a_bus_are_held_against_it_together(aces: Aces, written: Path) -> None:
    """What one of them declares is not a fault of the other, unless they are apart."""
    Path("sound.py").write_text(SOUND)
    Path("other.py").write_text(
        SOUND.replace('"sound"', '"other"').replace("id=5", "id=6").replace("005#", "006#")
    )
    Path("walk.log").write_text(recorded(7) + recorded(7).replace("005#", "006#"))
    call = ("spec", "check", "sound.py", "other.py", "--against", "walk.log")
    assert aces(*call).status == 0
    assert aces(*call, "--apart").status == 1


def test_a_recording_that_is_none_is_a_wrong_call(aces: Aces, written: Path) -> None:
    """Status 2, and the spec is checked all the same."""
    Path("sound.py").write_text(SOUND)
    for option in ("--against", "--suggest"):
        result = aces("spec", "check", "sound.py", option, "nowhere.log")
        assert (result.status, "nowhere.log: no such file" in result.err) == (2, True)


def test_suggested_examples_are_printed(aces: Aces, written: Path) -> None:
    """As source for the spec; nothing is checked."""
    Path("doubt.py").write_text(DOUBTFUL)
    Path("walk.log").write_text("(1.0) can0 005#0203\n")
    result = aces("spec", "check", "doubt.py", "--suggest", "walk.log")
    assert (result.status, result.out) == (
        0,
        '# doubt.py:4: A, 1 of 1; confirm it by the sheet\nexamples=[\n    ("005#02 03", {"x": 770}),\n],\n',
    )
