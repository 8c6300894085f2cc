"""`-p`: names, dialects, configurations, files."""

from __future__ import annotations

from pathlib import Path

import pytest

from aces_bus import load_protocol
from aces_bus.errors import AcesError, CallerError, UnknownNameError
from aces_tools.protocols_arg import named_protocol, parse_protocols, read_configuration


def refusal(text: str) -> str:
    with pytest.raises(AcesError) as raised:
        named_protocol(text).variant()
    return str(raised.value)


def test_an_installed_protocol() -> None:
    """A name is an installed protocol in its default dialect and configuration."""
    assert named_protocol("robotis").variant() is load_protocol("robotis").variant()


def test_dialect_and_configuration() -> None:
    """NAME:DIALECT and NAME:DIALECT@CONFIGURATION choose."""
    hubo = load_protocol("hubo")
    assert named_protocol("hubo:D08").variant() is hubo.variant("D08")
    assert named_protocol("hubo:D08@hubo2").variant() is hubo.variant("D08", "hubo2")
    assert named_protocol("hubo@hubo2").variant() is hubo.variant(None, "hubo2")


@pytest.mark.parametrize("text", ["nosuch", "hubo:D99", "hubo@nosuch", "robotis:x"])
def test_an_unknown_name_lists_those_that_exist(text: str) -> None:
    """Of protocols, dialects and configurations."""
    with pytest.raises(UnknownNameError, match="there are:"):
        named_protocol(text).variant()


@pytest.mark.parametrize("text", ["", ":", "@x", "hubo:", "hubo@", "a:b:c"])
def test_what_cannot_be_read_says_how_it_is_written(text: str) -> None:
    """Anything else names the forms."""
    assert "NAME:DIALECT" in refusal(text)


#: A database with a message that cannot be used.
CAR = """VERSION ""
BU_: A
BO_ 100 Speed: 8 A
 SG_ speed : 0|16@1+ (0.01,0) [0|0] "km/h" A
BO_ 101 Broken: 8 A
 SG_ gone : 0|16@1+ (0.01,0 [0|0] "" A
"""


def test_a_database_file_is_a_protocol(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """What cannot be used of it is said once, with its line, however often it is named."""
    path = tmp_path / "Car.DBC"
    path.write_text(CAR)
    (one,) = parse_protocols([str(path), str(path)])
    assert sorted(one.messages) == ["Broken", "Speed"]
    said = capfd.readouterr().err.splitlines()
    assert said == [f"aces: {path}: 1 of 6 statements was left out; first: {said[0].partition('first: ')[2]}"]
    assert "line 6: " in said[0]


def test_several_problems_are_listed_elsewhere(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The one line names the command that lists them all."""
    path = tmp_path / "car.dbc"
    path.write_text(CAR + "BO_ nonsense\n")
    parse_protocols([str(path)])
    assert capfd.readouterr().err.endswith(f" (all: aces protocols {path})\n")


def test_a_file_that_declares_nothing_is_told_from_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A database without its suffix is found, and a capture is not a protocol."""
    monkeypatch.chdir(tmp_path)
    Path("car.dbc").write_text(CAR)
    Path("walk.log").write_text("(1.0) can0 123#\n")
    assert "the file of that name: -p car.dbc" in refusal("car")
    assert "has one of the suffixes .py .dbc .kcd" in refusal("walk.log")


def test_a_database_can_be_for_one_channel(tmp_path: Path) -> None:
    """CHANNEL=FILE, also with an installed protocol; a file whose name has an equals sign is that file."""
    path = tmp_path / "car.dbc"
    path.write_text(CAR)
    assert [v.channel for v in parse_protocols([f"can0={path}", f"can1={path}", "can2=hubo"])] == [
        "can0",
        "can1",
        "can2",
    ]


def test_a_database_has_no_dialects(tmp_path: Path) -> None:
    """Nor configurations; and it must be there."""
    path = tmp_path / "car.dbc"
    path.write_text(CAR)
    assert "neither dialects nor configurations" in refusal(f"{path}:D08")
    assert "neither dialects nor configurations" in refusal(f"{path}@robot.toml")
    assert "no such file" in refusal("nowhere/car.kcd")


def test_a_protocol_given_twice_counts_once() -> None:
    """The order of -p is kept."""
    names = [variant.name for variant in parse_protocols(["robotis", "hubo", "robotis"])]
    assert names == ["robotis", "hubo"]


# ---------------------------------------------------------------------- Python files

ONE = "from aces_bus.protocol import Protocol\nmine = Protocol('mine', link='can', dialects={'a': '', 'b': ''})\n"


def test_a_file_with_one_protocol(tmp_path: Path) -> None:
    """The name may be left out; what follows is a dialect."""
    (tmp_path / "my_spec.py").write_text(ONE)
    assert named_protocol(f"{tmp_path / 'my_spec.py'}").variant().label == "mine:a"
    assert named_protocol(f"{tmp_path / 'my_spec.py'}:b").variant().label == "mine:b"
    assert named_protocol(f"{tmp_path / 'my_spec.py'}:mine:b").variant().label == "mine:b"


def test_a_file_with_several_needs_the_name(spec: Path) -> None:
    """And lists them."""
    assert named_protocol(f"{spec}:line").protocol.name == "line"
    assert "my_spec.py:arm" in refusal(str(spec))
    assert "there are: arm, line" in refusal(f"{spec}:amr")


def test_protocols_that_a_file_imports_do_not_count(tmp_path: Path) -> None:
    """Where it declares one of its own."""
    path = tmp_path / "my_spec.py"
    path.write_text("from aces_protocols.robotis.spec import robotis\n" + ONE)
    assert named_protocol(str(path)).protocol.name == "mine"
    path = tmp_path / "again.py"
    path.write_text("from aces_protocols.robotis.spec import robotis as r\n")
    assert named_protocol(str(path)).protocol is load_protocol("robotis")


def test_a_file_may_import_what_stands_beside_it(tmp_path: Path) -> None:
    """As it may when it is run; in a package, relatively too."""
    (tmp_path / "boards_beside.py").write_text("BOARDS = range(3)\n")
    (tmp_path / "my_spec.py").write_text("from boards_beside import BOARDS\n" + ONE)
    assert named_protocol(str(tmp_path / "my_spec.py")).protocol.name == "mine"
    package = tmp_path / "outer_pkg" / "inner_pkg"
    package.mkdir(parents=True)
    for folder in (package, package.parent):
        (folder / "__init__.py").write_text("")
    (package / "boards.py").write_text("BOARDS = range(3)\n")
    (package / "spec.py").write_text("from .boards import BOARDS\n" + ONE)
    assert named_protocol(str(package / "spec.py")).protocol.name == "mine"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = 1\n", "declares no Protocol"),
        ("x = (\n", "bad.py:1: "),
        ("import no_such_module_at_all\n", "bad.py:1: ModuleNotFoundError"),
        ("\n\nx = 1 / 0\n", "bad.py:3: ZeroDivisionError"),
        (ONE + "mine.message('A', id=0x900)\n", "bad.py:3: "),
    ],
)
def test_a_file_that_fails_says_where(tmp_path: Path, text: str, said: str) -> None:
    """File, line and reason, whatever it raises; and so again the next time."""
    path = tmp_path / "bad.py"
    path.write_text(text)
    assert said in refusal(str(path))
    assert said in refusal(str(path))


def test_no_such_file(tmp_path: Path) -> None:
    """A missing file and a folder are said."""
    assert "no such file" in refusal(str(tmp_path / "none.py"))
    (tmp_path / "folder.py").mkdir()
    assert "folder" in refusal(str(tmp_path / "folder.py"))


def test_a_name_that_is_a_file_without_its_suffix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file is hinted at."""
    (tmp_path / "my_spec.py").write_text(ONE)
    monkeypatch.chdir(tmp_path)
    assert "-p my_spec.py" in refusal("my_spec")


# ---------------------------------------------------------------------- configuration files


def test_tables_of_a_file(spec: Path, tmp_path: Path) -> None:
    """Keys are numbers of any base; tables that the protocol does not know are left alone."""
    robot = tmp_path / "robot.toml"
    robot.write_text('title = "x"\n[channels]\n0x00 = 2\n"1" = 3\n0b10 = 2\n03 = 3\n[devices]\nneck = "y"\n')
    arm = named_protocol(f"{spec}:arm").protocol
    assert read_configuration(str(robot), arm)[0] == {"channels": {0: 2, 1: 3, 2: 2, 3: 3}}
    assert named_protocol(f"{spec}:arm@{robot}").variant().configuration == "custom"


def test_a_base_is_changed_entry_by_entry(spec: Path, tmp_path: Path) -> None:
    """With `base` only what differs is written; the shipped tables stay as they are."""
    robot = tmp_path / "robot.toml"
    robot.write_text('base = "two"\n[channels]\n0x01 = 3\n')
    arm = named_protocol(f"{spec}:arm").protocol
    assert read_configuration(str(robot), arm)[0] == {"channels": {0: 2, 1: 3, 2: 3}}
    assert arm.configurations["two"]["channels"] == {0: 2, 1: 2, 2: 3}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[channels\n", "not a TOML file"),
        ("[chanels]\n0 = 1\n", r"needs a table [channels] (the file has: [chanels])"),
        ("channels = 3\n", "is a table"),
        ("[channels]\nneck = 3\n", "'neck' is not a number"),
        ("[channels]\n0x10 = 3\n16 = 2\n", "twice"),
        ('base = "four"\n', "there are: three, two"),
        ("base = [3]\n", "there are: three, two"),
    ],
)
def test_a_wrong_configuration_file_says_what(spec: Path, tmp_path: Path, text: str, said: str) -> None:
    """File, entry and what would work."""
    robot = tmp_path / "robot.toml"
    robot.write_text(text)
    message = refusal(f"{spec}:arm@{robot}")
    assert said in message
    assert "robot.toml" in message


def test_a_configuration_file_that_cannot_be_used(tmp_path: Path) -> None:
    """A missing or binary file, and a protocol that takes none."""
    assert "No such file" in refusal(f"hubo@{tmp_path / 'no.toml'}")
    (tmp_path / "bin.toml").write_bytes(b"\xff\xfe\x00")
    assert "not a TOML file" in refusal(f"hubo@{tmp_path / 'bin.toml'}")
    (tmp_path / "x.toml").write_text("")
    with pytest.raises(CallerError, match="takes no configuration"):
        named_protocol(f"robotis@{tmp_path / 'x.toml'}").variant()
