"""Drivers, robot files, stops and carried ports, in parts that no user imports."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, load_protocol
from aces_bus.device import MotorDevice, load_driver
from aces_bus.device.carried_port import CarriedPort
from aces_bus.device.drivers import DRIVERS, list_drivers
from aces_bus.device.motor import age_on_bus
from aces_bus.device.stopping import STOP_NS, wait_stopped
from aces_bus.device.ticket import Awaited
from aces_bus.errors import DeviceError, NotStoppedError, SpecError
from aces_bus.plugins import PluginWarning
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.robot.checks import addresses
from aces_bus.robot.file import check_robot_file
from aces_bus.robot.rig import bus_variants, simulate
from aces_bus.robot.toml_lines import KeyLines
from aces_tools.main import main
from tests.device.fan import ROBOT, fan, robot_of
from tests.device.test_robot import LANTERN as LANTERN
from tests.device.test_robot import SPEC as SPEC
from tests.device.test_stopping import Asked as Asked
from tests.device.test_stopping import load as load
from tests.device.test_stopping import robot as robot
from tests.device.test_stopping import stop as stop
from tests.specs.sdo_like import sdo_like


def installed(folder: Path, **points: str) -> str:
    """Have a folder hold a package that registers these drivers; return its path."""
    for number, (name, value) in enumerate(points.items()):
        place = folder / f"brings{number}_{name}-1.0.dist-info"
        place.mkdir(parents=True)
        (place / "METADATA").write_text(f"Name: brings{number}-{name}\nVersion: 1.0\n")
        (place / "entry_points.txt").write_text(f"[{DRIVERS.group}]\n{name.strip('_')} = {value}\n")
    return str(folder)


def test_two_claims_on_a_name_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A name that two packages claim is refused with both places, ours stay ours; so is an entry that is not a driver."""
    with monkeypatch.context() as patch:
        patch.syspath_prepend(installed(tmp_path / "clash", blower="one:driver", blower_="two:driver"))
        with pytest.raises(SpecError, match="one:driver and two:driver"):
            load_driver("blower")
        assert load_driver("hubo_motor").name == "hubo_motor"
    with monkeypatch.context() as patch:
        patch.syspath_prepend(installed(tmp_path / "taken", hubo_motor="one:driver"))
        with pytest.warns(PluginWarning, match="^brings0-hubo-motor: .* aces-bus keeps it"):
            assert list_drivers()["hubo_motor"].distribution == "aces-bus"
    monkeypatch.syspath_prepend(installed(tmp_path / "wrong", blower="math:pi"))
    with pytest.raises(SpecError, match="not a Driver but float"):
        load_driver("blower")
    monkeypatch.syspath_prepend(installed(tmp_path / "named", ventilator="tests.device.fan:FAN"))
    with pytest.raises(SpecError, match="calls itself 'fan'"):
        load_driver("ventilator")


def test_what_is_installed_meanwhile_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package that is installed while a program runs is there at the next look, and gone when it is removed."""
    monkeypatch.syspath_prepend(str(tmp_path))
    assert "blower" not in list_drivers()
    installed(tmp_path, blower="one:driver")
    assert "blower" in list_drivers()
    shutil.rmtree(tmp_path / "brings0_blower-1.0.dist-info")
    assert "blower" not in list_drivers()


def test_a_protocol_may_be_a_file_beside_the_robot_s(tmp_path: Path) -> None:
    """A Python file, by its path from the robot's folder: it is checked and found as an installed protocol is."""
    (tmp_path / "specs").mkdir()
    (tmp_path / "specs" / "lantern.py").write_text(SPEC.format(name="robots_lantern", link="can"))
    (tmp_path / "robot.toml").write_text(LANTERN)
    robot, problems = check_robot_file(tmp_path / "robot.toml", runs_protocols=True)
    assert robot is not None, problems
    assert [p.key for p in problems] == ["devices.L1.driver"]
    assert robot.buses["upper"].protocol == "robots_lantern"
    (variant,) = bus_variants(robot, "upper")
    assert variant.protocol is load_protocol(str(tmp_path / "specs" / "lantern.py"))
    (tmp_path / "robot.toml").write_text(LANTERN.replace("node = 2", "node = 7"))
    _, problems = check_robot_file(tmp_path / "robot.toml", runs_protocols=True)
    assert [p.key for p in problems if not p.is_warning] == ["devices.L1.credentials.node"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "no such file"),
        ("made = 1\n", "declares no Protocol"),
        ("1 / 0\n", "ZeroDivisionError"),
        (SPEC.format(name="hubo", link="can"), "another protocol is named 'hubo' already"),
        (SPEC.format(name="robots_serial", link="datagram"), "spec|link"),
    ],
)
def test_a_protocol_s_file_that_is_none_is_said_with_its_line(
    tmp_path: Path, content: str | None, said: str
) -> None:
    """Absent, without a protocol, broken, under a name that another one has."""
    (tmp_path / "specs").mkdir()
    if content is not None:
        (tmp_path / "specs" / "lantern.py").write_text(content)
    (tmp_path / "robot.toml").write_text(LANTERN)
    robot, problems = check_robot_file(tmp_path / "robot.toml", runs_protocols=True)
    assert robot is None
    assert any(p.key == "buses.upper.protocol" and p.line == 4 and re.search(said, p.text) for p in problems)


def test_addresses_of_protocols() -> None:
    """Captures limit a credential; else its bytes do; the number that addresses everybody is nobody's."""
    robotis = addresses(load_protocol("robotis"))["id"]
    assert [robotis.holds(number) for number in (0, 253, 254, 255)] == [True, True, False, False]
    hubo = addresses(load_protocol("hubo"))
    assert hubo["board"].holds(0x3F)
    assert not hubo["sensor"].holds(0xFF)


@given(st.one_of(st.text(max_size=200), st.text("[]{}=\"'\\#.,\n ab1", max_size=80)))
def test_no_text_makes_trouble(text: str) -> None:
    """Whatever a file holds: an answer, no exception, no endless loop, and lines that exist."""
    KeyLines(text)
    robot, problems = parse_robot(text)
    assert robot is None
    assert all(1 <= problem.line <= text.count("\n") + 1 for problem in problems)


def test_lines_of_keys() -> None:
    """Tables, dotted keys, inline tables, strings and arrays over several lines, comments."""
    text = '''\
# a = 1
"a b".c = """
x = 1
[no]"""
[one."t\\"wo"]  # [three]
list = [ # ]
  "]", { x = [1], y = 2 }, 3,
]
in.line = { p = '#', "q.r" = { s = 1 } }
[[many]]
deep = 1
'''
    lines = KeyLines(text)
    assert lines.of(("a b", "c")) == 2
    assert lines.of(("x",)) == 1  # not there: the file's first
    assert lines.of(("one", 't"wo')) == 5
    assert lines.of(("one", 't"wo', "list")) == 6
    assert lines.of(("one", 't"wo', "in", "line", "q.r", "s")) == 9
    assert lines.of(("many", "deep")) == 11
    assert lines.of(("many", "deep", "deeper")) == 11
    assert KeyLines(text.replace("\n", "\r\n")).of(("many", "deep")) == 11


VALUES = [
    "1",
    '"]{"',
    "'''\n[x]\n'''",
    '"""\n\\"""\n"""',
    "[1,\n# ]\n[2]]",
    "{ a = { b = [ '}' ] } }",
    "2021-01-01 07:00:00",
]


@given(st.lists(st.tuples(st.booleans(), st.sampled_from(VALUES), st.integers(0, 2)), max_size=12))
def test_every_key_has_its_line(statements: list[tuple[bool, str, int]]) -> None:
    """However values and blank lines stand between them."""
    text, table, expected = "", "", dict[tuple[str, ...], int]()
    for number, (is_table, value, blank) in enumerate(statements):
        text += "\n" * blank
        line = text.count("\n") + 1
        if is_table:
            table = f"t{number}"
            text += f"[{table}] # k = 1\n"
            expected[table,] = line
        else:
            text += f"  k{number} = {value} # [x]\n"
            expected[(*filter(None, [table]), f"k{number}")] = line
    lines = KeyLines(text)
    assert {path: lines.of(path) for path in expected} == expected


def test_a_status_that_came_late_says_how_old_it_is(robot: VirtualRobot) -> None:
    """What waited in an adapter or a server since the bus had it is not news; a clock that is another's says nothing."""
    now = robot.clock.now() / 1e9
    scanner = fan.scanner()

    def status(stamp: float | None) -> Any:
        (record,) = scanner.feed([Frame(0x121, bytes(5), timestamp=stamp)])
        return record

    assert [age_on_bus(status(stamp), robot.clock) for stamp in (None, now + 1, now - 1e6)] == [None] * 3
    asked = Awaited(robot.clock)
    asked.finish(status(now - 0.2))
    board: Any = robot.devices["A"]
    with pytest.raises(
        DeviceError, match=r"its status \(0\.2 s old: its answers come late\) says that LHP is still on"
    ):
        MotorDevice.confirm_off(board, lambda: asked, lambda: ["LHP"]).wait()


@pytest.mark.parametrize("is_deaf", [True, False])
def test_one_answer_does_not_confirm_two_devices(robot: VirtualRobot, is_deaf: bool) -> None:
    """Two devices have answered as one: the stop is repeated for its time and named, whatever one of them says then."""
    second = simulate(robot_of(ROBOT), robot.ports("second"), load=load)
    second.buses["line"].remove("B")
    other: Any = second.twins["A"]
    other.reply_delay_ns += 3_000_000  # frames that begin together would destroy each other
    with second:
        robot.advance(0.2)
        other.is_powered = not is_deaf  # turns on, and receives nothing
        robot.advance(2.0)
        assert "two devices with node 0x01" in robot.events.of("two devices")[0].detail
        began = robot.clock.now()
        with pytest.raises(NotStoppedError) as failed:
            wait_stopped(stop(robot))
        assert robot.clock.now() - began == pytest.approx(STOP_NS, rel=0.05)
        why = "two devices answer as node 0x01: one that is off says nothing of the other"
        assert failed.value.devices == {"A": why}
        assert (robot.twins["A"].left, robot.twins["B"].left) == (0, 0)
        assert bool(other.left) is is_deaf


class FakePort:
    """A port that keeps what is sent."""

    def __init__(self, sent: list[Frame]) -> None:
        self.sent = sent

    def send(self, frame: Any, *_: Any, **options: Any) -> bool:
        self.sent.append(frame)
        return True


def test_transfers_in_segments_are_not_sent(capsys: pytest.CaptureFixture[str]) -> None:
    """Neither by `aces send` nor by devices: nothing leaves, and the reason is said; single frames go."""
    what = ["send", "Write", "node=5", "sized=1", "index=8192", "subindex=0", "data=hex:0102"]
    on = ["-p", "tests/specs/sdo_like.py", "-i", "aces", "-c", "sdo", "--bus-kwargs", "physics=False"]
    assert main([*what, *on, "--tx"]) != 0
    assert "each of its frames waits for an answer" in capsys.readouterr().err
    sent: list[Frame] = []
    said: list[tuple[str, str]] = []
    port = CarriedPort(cast("Any", FakePort(sent)), [sdo_like.variant()], lambda key, data: True)
    long = sdo_like.encode("Write", node=5, sized=1, index=0x2000, subindex=0, data=bytes(9))
    assert not port.send(tuple(long), report=lambda fate, why: said.append((fate, why)))
    assert (sent, said[0][0], port.failed) == ([], "dropped", 1)
    short = sdo_like.encode("Read", node=5, index=0x2000, subindex=0)
    assert port.send(tuple(short))
    assert len(sent) == 1
