"""The enable chain of a robot's file: e-stop inputs, what clearing them does not do, brakes and homing, reduced speed."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
import textwrap
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from aces_bus import load_protocol
from aces_bus.controller import IGNORE, Controller
from aces_bus.errors import AcesError, CallerError, DeviceError
from aces_bus.hardware.ports import port_of
from aces_bus.robot import ActLog, Runner, VirtualRobot, parse_robot, run_virtual
from aces_bus.robot.file import print_robot
from aces_bus.robot.rig import Rig
from aces_tools.main import main

CELL = """
name = "cell"
rate_hz = 100
[buses]
io = {{ link = "can", protocol = "canopen", bitrate = 500_000 }}
arm = {{ link = "can", protocol = "odrive", dialect = "0.6", bitrate = 500_000 }}
[devices]
IO = {{ driver = "cia401", bus = "io", credentials = {{ node = 17 }}, settings = {{ every_s = 0.05 }} }}
HIP = {{ driver = "odrive", bus = "arm", credentials = {{ node = 1 }} }}
WHEEL = {{ driver = "odrive", bus = "arm", credentials = {{ node = 2 }} }}
[joints]
hip = {{ device = "HIP", lower = -2, upper = 2, max_speed = 2{hip} }}
wheel = {{ device = "WHEEL", type = "continuous", command = "speed", max_speed = 4 }}
{more}
"""
PANEL = "[estop]\npanel = { signal = 'IO.di1', clear = true, stale_after_s = 0.2 }\n"


def cell(more: str = PANEL, hip: str = "") -> VirtualRobot:
    robot, problems = parse_robot(CELL.format(more=more, hip=hip))
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=100)


@pytest.fixture
def panel() -> Iterator[VirtualRobot]:
    """The cell with its e-stop clear, enabled and moving."""
    with cell() as robot:
        robot.twins["IO"].put("di1", True)
        robot.advance(0.5)
        robot.rig.each("enable").wait(5)
        robot["hip"].set(1.5)
        robot["wheel"].set(3.0)
        robot.advance(0.3)
        yield robot


def is_off(robot: VirtualRobot, *names: str) -> bool:
    return not any(robot.twins[name].state == "closed_loop" for name in names or ("HIP", "WHEEL"))


# ---------------------------------------------------------------------- what counts as pressed


def test_a_pressed_input_stops_all_and_bars_the_way(panel: VirtualRobot) -> None:
    """Within 20 ms of the module's PDO both axes are idle; neither set-points nor enabling nor a release pass."""
    panel.twins["IO"].put("di1", False)
    panel.advance(0.02)
    assert is_off(panel)
    (event,) = panel.events.of("estop")
    assert str(event).endswith("panel: estop: IO.di1 reads False")
    here = panel["hip"].value
    with pytest.raises(CallerError, match=r"hip.position: e-stop panel: IO.di1 reads False"):
        panel["hip"].set(0.0)
    with pytest.raises(DeviceError, match=r"^enable is refused: e-stop panel: IO.di1 reads False$"):
        panel.rig.each("enable").wait(1)
    with pytest.raises(DeviceError, match=r"HIP: enable is refused: e-stop panel"):
        panel.devices["HIP"].enable().wait(1)  # behind the rig's back
    with pytest.raises(DeviceError, match=r"calibrate is refused"):
        panel.devices["HIP"].calibrate().wait(1)
    with pytest.raises(CallerError, match=r"nothing can be released: e-stop panel"):
        panel.rig.door.release()
    panel.advance(0.5)
    assert panel["hip"].value == pytest.approx(here, abs=0.05)  # it coasts
    assert is_off(panel)


def test_what_a_controller_gave_up_is_forgotten_by_its_release(panel: VirtualRobot) -> None:
    """A set-point of before is not where the next one begins: its owner has left while the way was barred."""
    door = panel.rig.door
    panel.twins["IO"].put("di1", False)
    panel.advance(0.1)
    door.claim("wheel.velocity", "walk", is_supervised=True)
    door.writer("wheel.velocity")(3.0)
    assert door.given("wheel.velocity") == 3.0
    door.give_up("walk")
    assert "wheel.velocity" in door.tripped
    panel.twins["IO"].put("di1", True)
    panel.advance(0.1)
    door.release()
    assert door.tripped == {}
    assert door.given("wheel.velocity") is None


def test_clearing_starts_nothing(panel: VirtualRobot) -> None:
    """Cleared, all stays off and refuses set-points, until it is enabled and released; then it moves from where it is."""
    panel.twins["IO"].put("di1", False)
    panel.advance(0.1)
    panel.twins["IO"].put("di1", True)
    panel.advance(1.0)
    assert [event.kind for event in panel.events.last if event.kind.startswith("estop")] == [
        "estop",
        "estop clear",
    ]
    assert is_off(panel)
    with pytest.raises(CallerError, match="until it is released"):
        panel["wheel"].set(1.0)
    panel.rig.each("enable").wait(5)
    panel.advance(0.2)
    assert panel["wheel.velocity"].value == pytest.approx(0.0, abs=0.01)
    with pytest.raises(CallerError, match="until it is released"):
        panel["wheel"].set(1.0)
    panel.rig.door.release()
    panel["wheel"].set(1.0)
    panel.advance(0.5)
    assert panel["wheel.velocity"].value == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("fault", ["power", "silent", "cable"])
def test_an_input_that_is_silent_is_pressed(panel: VirtualRobot, fault: str) -> None:
    """Its module without power, its module mute, its bus cut: all off within the stated 0.2 s and a few ticks."""
    if fault == "power":
        panel.twins["IO"].power(False)
    elif fault == "silent":
        panel.twins["IO"].fault("silent")
    else:
        panel.rig.hosts["io"].port.node.is_connected = False  # type: ignore[attr-defined]
    panel.advance(0.1)
    assert not is_off(panel)
    panel.advance(0.2)
    assert is_off(panel)
    assert "IO.di1" in panel.rig.chain.pressed["panel"] or "silent" in panel.rig.chain.pressed["panel"]


def test_what_was_never_received_is_pressed_after_its_time() -> None:
    """Until then nothing passes either; an input that is clear at first opens the way, one that was not does not."""
    for is_there, opens in ((True, True), (False, False)):
        with cell() as robot:
            robot.twins["IO"].put("di1", True)
            robot.twins["IO"].power(is_there)
            with pytest.raises(CallerError, match="nothing was received of it yet"):
                robot["wheel"].set(1.0)
            robot.advance(0.15)
            assert bool(robot.events.of("estop")) is False
            robot.advance(0.35)
            assert bool(robot.rig.door.barred) is not opens
            assert bool(robot.events.of("estop")) is not opens
            if not opens:
                robot.twins["IO"].power(True)
                robot.twins["IO"].put("di1", True)
                robot.advance(3.0)
                assert robot.rig.chain.pressed == {}
                assert robot.rig.door.tripped  # until it is released


def test_an_estop_of_the_drive_itself() -> None:
    """An ODrive that was sent its own e-stop says so in its heartbeat: the other axis stops, too."""
    with cell("[estop]\ndrive = { signal = 'HIP.errors', pressed = 'estop' }") as robot:
        robot.advance(0.5)
        robot.rig.each("enable").wait(5)
        robot.devices["HIP"].estop()
        robot.advance(0.15)
        assert robot.rig.chain.pressed == {"drive": "HIP.errors reads 'estop'"}
        assert is_off(robot)
        robot.devices["HIP"].clear_errors()
        robot.advance(0.3)
        assert robot.rig.chain.pressed == {}
        assert is_off(robot)


def test_a_bit_of_a_statusword() -> None:
    """What a CANopen drive says in its statusword (a maker's bit for STO, here the fault bit) stops the other drive."""
    text = """
name = "two"
rate_hz = 100
[buses]
can = { link = "can", protocol = "canopen" }
[devices]
A = { driver = "cia402", bus = "can", credentials = { node = 1 }, settings = { pdo = "write" } }
B = { driver = "cia402", bus = "can", credentials = { node = 2 }, settings = { pdo = "write" } }
[joints]
a = { device = "A", encoder = 4000, gear = [1, 1] }
b = { device = "B", encoder = 4000, gear = [1, 1] }
[estop]
sto = { signal = "a.status", bit = 3, clear = 0, stale_after_s = 0.2 }
"""
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    with VirtualRobot(robot, rate_hz=100) as two:
        two.clock.wait(lambda: not two.rig.chain.pressed, 5_000_000_000)
        two.rig.each("enable").wait(10)
        assert two["b.state"].value == "operation enabled"
        two.twins["A"].fault("over_voltage")
        two.advance(0.2)
        assert two.rig.chain.pressed == {"sto": "a.status reads 1"}
        assert two["b.state"].value != "operation enabled"
        two.twins["A"].fault("over_voltage", on=False)
        two.devices["A"].reset_fault().wait(10)  # moves nothing: allowed
        two.advance(0.1)
        assert two.rig.chain.pressed == {}


def test_a_name_that_is_never_read_is_an_error() -> None:
    """An input that could never trip is not taken for one."""
    with pytest.raises(
        CallerError, match=r"estop drive: no value of HIP.errors named 'e_stop'; did you mean 'estop'\?"
    ):
        cell("[estop]\ndrive = { signal = 'HIP.errors', pressed = 'e_stop' }")


def test_a_field_of_a_message_that_no_device_here_sends() -> None:
    """A node that is not a device of the robot: its heartbeat is an input, and stops all when it ceases."""
    more = "[estop]\nmate = { bus = 'arm', message = 'Heartbeat.state', credentials = { node = 9 }, clear = 'idle' }"
    with cell(more) as robot:
        variant = load_protocol("odrive").variant("0.6")
        mate = port_of(robot.wires["arm"], name="mate")
        mate.open(lambda frame, instant: None)

        def beat(state: str) -> None:
            fields = {"node": 9, "error": [], "result": "success", "trajectory_done": 0, "reserved": 0}
            mate.send(variant.encoder.encode("Heartbeat", state=state, **fields))
            robot.advance(0.1)

        for _ in range(3):
            beat("idle")
        robot.rig.each("enable").wait(5)
        for _ in range(3):
            beat("idle")
        assert not is_off(robot)
        beat("closed_loop")
        assert robot.rig.chain.pressed == {"mate": "estop mate.value reads 'closed_loop'"}
        assert is_off(robot)
        beat("idle")
        assert robot.rig.chain.pressed == {}
        robot.advance(0.6)
        assert "old" in robot.rig.chain.pressed["mate"]
        mate.close()


# ---------------------------------------------------------------------- runs


class Swing(Controller):
    """Gives one set-point for each of both joints, for ever."""

    def __init__(self) -> None:
        super().__init__("swing", rate_hz=100, writes=["hip", "wheel"])

    def step(self, now_ns: int) -> Mapping[str, float]:
        return {"hip": 1.0, "wheel": 2.0}


def test_an_e_stop_ends_parking_at_once() -> None:
    """Pressed on the way to the pose: both axes are off within 20 ms, short of it, and the joints are named."""
    world = cell(PANEL + "[park]\npose = { hip = -1.0 }\nspeed = 0.5\nwithin = 0.5\n")
    run: Runner = run_virtual(world, [Swing()], on_trip="hold", at_end="park")
    world.twins["IO"].put("di1", True)
    run.open()
    run.do("enable")
    run.start()
    world.advance(1.0)
    seen: list[bool] = []
    run.clock.call_in(500_000_000, lambda: world.twins["IO"].put("di1", False))
    run.clock.call_in(490_000_000, lambda: seen.append(is_off(world, "HIP")))
    run.clock.call_in(520_000_000, lambda: seen.append(is_off(world)))
    ended = run.stop()
    assert seen == [False, True]
    assert ended.parked == []
    assert "e-stop panel" in ended.not_parked["hip"]
    assert world["hip"].value > 0.0


def test_an_e_stop_before_the_end_leaves_no_joint_unnamed() -> None:
    """Pressed before the run ends: nothing is parked, and every driven joint is named with the e-stop."""
    world = cell(PANEL + "[park]\npose = { hip = -1.0 }\nspeed = 0.5\nwithin = 0.5\n")
    run: Runner = run_virtual(world, [Swing()], on_trip="hold", at_end="park")
    world.twins["IO"].put("di1", True)
    run.open()
    run.do("enable")
    run.start()
    world.advance(0.5)
    world.twins["IO"].put("di1", False)
    world.advance(0.1)
    ended = run.stop()
    assert ended.parked == []
    assert set(ended.not_parked) == {"hip", "wheel"}
    assert all("e-stop panel" in why for why in ended.not_parked.values())


def test_a_run_is_stopped_whatever_is_declared() -> None:
    """No reactions, hold on trips and at the end: an e-stop ends motion, and a release is refused until it is clear."""
    world = cell()
    run: Runner = run_virtual(world, [Swing()], reactions={"*": IGNORE}, on_trip="hold", at_end="hold")
    world.twins["IO"].put("di1", True)
    run.open()
    run.do("enable")
    run.clock.call_in(300_000_000, lambda: world.twins["IO"].put("di1", False))
    run.start()
    world.advance(0.35)
    assert is_off(world)
    assert run.stopped == {"swing": "e-stop panel: IO.di1 reads False"}
    with pytest.raises(CallerError, match="swing cannot be released: e-stop panel"):
        run.release("swing")
    world.twins["IO"].put("di1", True)
    world.advance(0.5)
    assert is_off(world)
    run.release("swing")
    world.advance(0.3)
    assert is_off(world)  # not enabled
    ended = run.stop()
    assert ended.not_stopped == {}
    assert ended.held == []


def test_a_run_does_not_begin_while_an_input_is_pressed() -> None:
    """Enabling fails with what is missing; without enabling the controller's set-points stay here."""
    world = cell()
    run: Runner = run_virtual(world, [Swing()])
    with run:
        with pytest.raises(DeviceError, match=r"enable is refused: e-stop panel: IO.di1 reads False"):
            run.do("enable")
        ended = run.run(0.2)
        assert ended.reason == "every controller was stopped"
        assert ended.tripped == {"swing": "e-stop panel: IO.di1 reads False"}
    assert world["hip"].last == pytest.approx(0.0, abs=0.01)


def test_a_stop_that_is_not_confirmed_is_repeated(panel: VirtualRobot) -> None:
    """A drive that was cut off when the e-stop was pressed is stopped when its bus is back."""
    cable: Any = panel.rig.hosts["arm"].port
    cable.node.is_connected = False
    panel.twins["IO"].put("di1", False)
    panel.advance(4.0)
    assert not is_off(panel)
    assert panel.events.count("not stopped", "HIP")
    cable.node.is_connected = True
    panel.advance(2.5)
    assert is_off(panel)


# ---------------------------------------------------------------------- the chain


def test_the_chain_says_all_that_is_missing() -> None:
    """E-stop, then homing, then brakes, in one message; what is mended is no longer in it."""
    text = """
name = "leg"
rate_hz = 100
[buses]
io = { link = "can", protocol = "canopen" }
leg = { link = "can", protocol = "hubo", dialect = "D12" }
[devices]
IO = { driver = "cia401", bus = "io", credentials = { node = 17 }, settings = { every_s = 0.05 } }
JMC0 = { driver = "hubo_motor", bus = "leg", credentials = { board = 0 }, channels = 1 }
[joints.HIP]
device = "JMC0"
gear = [10, 25]
encoder = 4000
brake = { signal = "IO.di2", clear = true }
[estop]
panel = { signal = "IO.di1", clear = true }
"""
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    with VirtualRobot(robot, rate_hz=100, homed=False) as leg:
        leg.advance(0.6)

        def missing(action: str = "enable") -> list[str]:
            return leg.rig.chain.missing(list(leg.devices.values()), action)

        assert missing() == [
            "e-stop panel: IO.di1 reads False",
            "HIP is not homed (action home)",
            "brake of HIP: IO.di2 reads False",
        ]
        with pytest.raises(
            DeviceError, match=r"enable is refused: e-stop panel: .*; HIP is not homed .*; brake of HIP: "
        ):
            leg.rig.each("enable").wait(1)
        with pytest.raises(DeviceError, match="home is refused: e-stop panel: "):
            leg.devices["JMC0"].home().wait(1)
        leg.twins["IO"].put("di1", True)
        leg.twins["IO"].put("di2", True)
        leg.advance(0.1)
        assert missing("home") == []
        assert missing() == ["HIP is not homed (action home)"]
        leg.rig.each("home").wait(60)
        leg.advance(1.0)
        assert missing() == []
        leg.rig.each("enable").wait(5)


# ---------------------------------------------------------------------- reduced speed


def fastest(robot: VirtualRobot, name: str, seconds: float) -> float:
    """The largest speed (rad/s) of a joint's twin in the time that passes."""
    model, most = robot.simulation.world.joints[name], 0.0
    before = model.position(robot.clock.now())
    for _ in range(round(seconds * 100)):
        robot.advance(0.01)
        now = model.position(robot.clock.now())
        assert before is not None
        assert now is not None
        most, before = max(most, abs(now - before) / 0.01), now
    return most


@pytest.mark.parametrize("is_active", [False, True])
def test_reduced_speed_of_the_file(is_active: bool) -> None:
    """Positions are led at a quarter of the joint's speed, set-points of speed end at a quarter of it."""
    with cell(f"[reduced]\nscale = 0.25\nactive = {str(is_active).lower()}") as robot:
        robot.advance(0.5)
        robot.rig.each("enable").wait(5)
        robot["hip"].set(1.5)
        robot["wheel"].set(90.0)
        assert fastest(robot, "hip", 0.5) == pytest.approx(0.5 if is_active else 2.0, rel=0.1)
        assert robot["wheel.velocity"].value == pytest.approx(1.0 if is_active else 4.0, abs=0.05)


@pytest.mark.parametrize("is_active", [False, True])
def test_reduced_speed_of_a_joint_that_is_set_by_torque(is_active: bool) -> None:
    """A torque drives it up to its speed and no further: to a quarter of it where that is reduced."""
    text = CELL.format(more=f"[reduced]\nscale = 0.25\nactive = {str(is_active).lower()}", hip="")
    robot, _ = parse_robot(text.replace('command = "speed"', 'command = "current"'))
    assert robot is not None
    with VirtualRobot(robot, rate_hz=100) as torque:
        torque.advance(0.5)
        torque.rig.each("enable").wait(5)
        torque["wheel.torque"].set(0.5)
        assert fastest(torque, "wheel", 1.0) == pytest.approx(1.0 if is_active else 4.0, rel=0.2)


def test_reduced_speed_by_an_input() -> None:
    """Not clear, or silent: what moves slows down in that tick; clear again, it goes on at full speed."""
    switch = "[reduced]\nscale = 0.25\ninput = { signal = 'IO.di2', clear = true, stale_after_s = 0.2 }"
    with cell(switch) as robot:
        io = robot.twins["IO"]
        io.put("di2", True)
        robot.advance(0.5)
        robot.rig.each("enable").wait(5)
        robot["hip"].set(2.0)
        robot["wheel"].set(4.0)
        robot.advance(0.3)
        assert robot["wheel.velocity"].value == pytest.approx(4.0, abs=0.1)
        io.put("di2", False)
        robot.advance(0.1)
        assert fastest(robot, "hip", 0.2) == pytest.approx(0.5, rel=0.1)
        assert robot["wheel.velocity"].value == pytest.approx(1.0, abs=0.05)
        io.put("di2", True)
        robot.advance(0.1)
        assert fastest(robot, "hip", 0.2) == pytest.approx(2.0, rel=0.1)
        assert robot["wheel.velocity"].value == pytest.approx(1.0, abs=0.05)  # until it is set anew
        io.power(False)
        robot.advance(0.4)
        assert robot.rig.door.scale == 0.25
        assert [event.kind for event in robot.events.last if event.device == "reduced"] == [
            *("full speed", "reduced", "full speed", "reduced"),
        ]


# ---------------------------------------------------------------------- who did what


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_acts_are_written_a_line_each(tmp_path: Path) -> None:
    """Owners, enabling, limits, e-stop, stops; who, program, pid and time; and not every tick."""
    path = tmp_path / "acts.jsonl"
    path.write_text('{"what": "kept"}\n{"cut off')
    world = cell()
    run: Runner = run_virtual(world, [Swing()])
    world.twins["IO"].put("di1", True)
    with ActLog(path, "test") as acts:
        acts.keep(run)
        run.open()
        run.do("enable")
        run.rig.door.pace("hip", 1.0)
        run.rig.door.pace("hip", 1.0)  # no change: no second line
        run.clock.call_in(1_000_000_000, lambda: world.twins["IO"].put("di1", False))
        run.run(2.0)
    text = path.read_text()
    assert text.startswith('{"what": "kept"}\n{"cut off\n{')
    lines = [json.loads(line) for line in text.splitlines()[2:]]
    assert {line["pid"] for line in lines} == {os.getpid()}
    assert {line["program"] for line in lines} == {"test"}
    assert all(line["time"].endswith("+00:00") and line["user"] for line in lines)
    told = [(line["what"], line.get("who"), line.get("detail", "")) for line in lines]
    begin = [
        ("owner", "HIP", "hip.position: swing"),
        ("owner", "WHEEL", "wheel.velocity: swing"),
        ("enable", "HIP", ""),
        ("enable", "WHEEL", ""),
        ("limits", "HIP", "hip.position: at most 1 rad/s"),
        ("stop", "IO", ""),
        ("stop", "HIP", ""),
    ]
    assert told[: len(begin)] == begin
    assert ("estop", "panel", "IO.di1 reads False") in told
    assert any(what == "trip" and who == "swing" and "panel" in detail for what, who, detail in told)
    assert lines[2]["owner"] == "swing"
    assert len(lines) < 25


@pytest.mark.slow
def test_acts_survive_the_end_of_their_program(tmp_path: Path) -> None:
    """What was noted before kill -9 is in the file, and another program goes on behind it."""
    path = tmp_path / "acts.jsonl"
    program = f"""
        import os, signal
        from aces_bus.robot import ActLog
        acts = ActLog({str(path)!r}, "first")
        for number in range(3):
            acts.note("enable", f"D{{number}}", "line\\nend \\x1b[2J")
        os.kill(os.getpid(), signal.SIGKILL)
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=False)
    with ActLog(path, "second") as acts:
        acts.note("stop", "D0")
    assert [(line["program"], line["who"]) for line in lines_of(path)] == [
        *(("first", f"D{number}") for number in range(3)),
        ("second", "D0"),
    ]


def test_acts_need_a_file_that_can_be_appended_to(tmp_path: Path) -> None:
    """A folder, a pipe and a missing folder are refused by name; a full disk is said, and stops nothing."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe", tmp_path / "none" / "acts.jsonl"):
        with pytest.raises(CallerError, match=str(path)):
            ActLog(path)
    acts: Any = ActLog(tmp_path / "acts.jsonl")
    os.close(acts._file)
    acts._file = os.open("/dev/full", os.O_WRONLY)
    acts.note("stop", "D0")
    assert "No space left" in str(acts)
    acts.close()


# ---------------------------------------------------------------------- the command line


def test_the_command_line_is_held_to_the_chain(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A run and a device are refused with what is missing, status 1, and that is on record; --reduced needs its scale."""
    path, acts = tmp_path / "cell.toml", tmp_path / "acts.jsonl"
    path.write_text(CELL.format(more=PANEL, hip=""))
    program = tmp_path / "hold.py"
    program.write_text(
        "from aces_bus.controller import controller\n"
        "@controller(rate_hz=50, writes=['hip'])\ndef hold():\n    return {'hip': 0.0}\n"
    )
    common = ["-r", str(path), "--virtual", "--acts", str(acts)]
    assert main(["run", str(program), "--for", "0.1s", *common]) == 1
    assert "enable is refused: e-stop panel: IO.di1 reads False" in capsys.readouterr().err
    assert main(["device", "hip", "enable", *common]) == 1
    assert "hip enable: HIP: enable is refused: e-stop panel" in capsys.readouterr().err
    lines = lines_of(acts)
    assert {line["program"] for line in lines} == {"aces run", "aces device"}
    assert lines[0]["what"] == "begin"
    assert any("refused" in line.get("detail", "") for line in lines)
    assert main(["device", "hip", "enable", "-r", str(path), "--virtual", "--reduced"]) == 2
    assert "the file of cell states no reduced speed" in capsys.readouterr().err
    path.write_text(CELL.format(more="[reduced]\nscale = 0.25", hip=""))
    move = ["device", "hip", "set", "position=0.2", "--enable", "--reduced", "-r", str(path), "--virtual"]
    assert main([*move, "--for", "0.1s"]) == 1
    assert "only at" in capsys.readouterr().err  # 0.5 rad/s
    assert main(["robot", "show", str(path)]) == 0
    assert "0.25 of every limit" in capsys.readouterr().out


# ---------------------------------------------------------------------- the file


def test_a_file_with_a_chain_is_printed_as_it_is_read() -> None:
    """Inputs, a brake and reduced speed: read again they are equal."""
    more = (
        PANEL
        + "key = { key = 'space', clear = 'c' }\n"
        + "mate = { bus = 'arm', message = 'Heartbeat.state', credentials = { node = 9 }, clear = 'idle' }\n"
        + "[reduced]\nscale = 0.5\nactive = true\ninput = { signal = 'IO.di2', pressed = 0 }\n"
    )
    robot, problems = parse_robot(CELL.format(more=more, hip=", brake = { signal = 'IO.di3', clear = true }"))
    assert robot is not None, problems
    assert problems == []
    assert parse_robot(print_robot(robot)) == (robot, [])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("estop = 5", "estop: expected a table, written as [estop]"),
        ("a = 5", "estop.a: expected an input: a table"),
        ("a = {}", "estop.a: expected one of signal, message and key, not none"),
        (
            "a = { signal = 'IO.di1', key = 'x' }",
            "estop.a: expected one of signal, message and key, not signal and key",
        ),
        ("a = { signal = 'IO.di1' }", "estop.a: expected clear (the value"),
        ("a = { signal = 'IO.di1', clear = 1, pressed = 0 }", "estop.a: expected clear (the value"),
        (
            "a = { signal = 'WHEL.di1', clear = 1 }",
            "estop.a.signal: no device, joint or sensor named 'WHEL'; did you mean 'WHEEL'?",
        ),
        ("a = { signal = 'IO', clear = 1 }", "estop.a.signal: 'IO' is a device; expected one of its signals"),
        ("a = { signal = 'IO.di1', clear = 2, bit = 1 }", "estop.a.clear: a bit is 0 or 1, not 2"),
        ("a = { signal = 'IO.di1', clear = 1, bit = 64 }", "estop.a.bit: expected a whole number from 0"),
        (
            "a = { signal = 'IO.di1', clear = [1] }",
            "estop.a.clear: expected true, false, a number or a text in quotes",
        ),
        ("a = { signal = 'IO.di1', clear = nan }", "estop.a.clear: expected true, false, a number"),
        (
            "a = { signal = 'IO.di1', clear = 1, stale_after_s = 0 }",
            "estop.a.stale_after_s: expected a number above 0",
        ),
        (
            "a = { signal = 'IO.di1', clear = 1, stale_after_s = 5 }",
            "warning: estop.a.stale_after_s: 5 s: so late",
        ),
        ("a = { signal = 'IO.di1', clear = 1, bus = 'io' }", "estop.a.bus: belongs to message"),
        ("a = { key = 'F25', clear = 'c' }", "estop.a.key: no key 'F25' (there are: a character, space"),
        ("a = { key = \"\\u001b\", clear = 'c' }", "estop.a.key: no key"),
        ("a = { key = 'x' }", "estop.a.clear: expected the key that clears it again"),
        ("a = { key = 'x', clear = 'x' }", "estop.a.clear: 'x' is the key that is pressed already"),
        ("a = { key = 'x', clear = 'c', bit = 0 }", "estop.a.bit: belongs to a signal or message"),
        ("a = { message = 'Heartbeat.state', clear = 'idle' }", "estop.a.bus: is missing"),
        (
            "a = { message = 'X.y', bus = 'arm', clear = 1 }",
            "estop.a.message: no message of odrive named 'X'",
        ),
        (
            "a = { message = 'Heartbeat', bus = 'arm', clear = 1 }",
            "estop.a.message: 'Heartbeat' is a message; expected one of",
        ),
        (
            "a = { message = 'Heartbeat.state', bus = 'arm', clear = 'idle' }",
            "estop.a.credentials: expected whose message",
        ),
        (
            "a = { message = 'Heartbeat.state', bus = 'arm', credentials = { node = 99 }, clear = 'idle' }",
            "estop.a.credentials.node: odrive has no node 0x63",
        ),
        ("a = { message = 'Heartbeat.state', bus = 'mars', clear = 1 }", "estop.a.bus: no bus named 'mars'"),
        (
            "a = { singal = 'IO.di1', clear = 1 }",
            "estop.a.singal: an input has no such key; did you mean 'signal'?",
        ),
        ("[reduced]\nscale = 0", "reduced.scale: expected a number above 0, up to 1, not 0"),
        ("[reduced]\nscale = 1.5", "reduced.scale: expected a number above 0, up to 1, not 1.5"),
        ("[reduced]\nactive = true", "reduced.scale: is missing: expected a number above 0, up to 1"),
        ("[reduced]\nscale = 0.5\ninput = 'IO.di1'", "reduced.input: expected an input: a table"),
        (
            "[reduced]\nscale = 0.5\ninput = { signal = 'NO.di1', clear = 1 }",
            "reduced.input.signal: no device",
        ),
        ("[reactions]\nestop = 'ignore'", "reactions.estop: no kind of fault named 'estop'"),
    ],
)
def test_what_is_wrong_with_a_chain_is_said_with_its_line(text: str, problem: str) -> None:
    """Each fault of the file has its key and its line; none is a traceback."""
    head = "" if text.startswith(("[", "estop")) else "[estop]\n"
    whole = CELL.format(more=head + text, hip="")
    if text.startswith("estop"):
        whole = text + whole
    _, problems = parse_robot(whole, "cell.toml")
    found = [str(one) for one in problems]
    assert any(problem in one for one in found), found
    at = next(one for one in found if problem in one)
    assert 1 <= int(at.split(":")[1]) <= whole.count("\n") + 1


def test_hostile_names_do_no_harm() -> None:
    """A signal that the robot has not is refused when it is connected, an inactive device in the file."""
    for signal, said in (("IO.di99", "no signal of IO named 'IO.di99'"), ("hip.nothing", "no signal of hip")):
        with pytest.raises(AcesError, match=said):
            cell(f"[estop]\na = {{ signal = '{signal}', clear = 1 }}")
    text = CELL.format(more=PANEL, hip="").replace("node = 17 }", "node = 17 }, active = false")
    _, problems = parse_robot(text)
    assert any("IO is inactive: this input would always count as pressed" in one.text for one in problems)


def test_a_part_of_the_robot_keeps_its_estop() -> None:
    """Without the input's device nothing could ever be enabled, or all without looking."""
    robot, _ = parse_robot(CELL.format(more=PANEL, hip=""))
    assert robot is not None
    with VirtualRobot(robot.part("hip"), rate_hz=100) as part:
        assert sorted(part.devices) == ["HIP", "IO"]
        part.advance(0.5)
        assert part.rig.chain.pressed == {"panel": "IO.di1 reads False"}


# ---------------------------------------------------------------------- the keyboard

KEYS = """
import sys, time
from aces_bus.robot import VirtualRobot, parse_robot
robot, problems = parse_robot(open(sys.argv[1]).read())
with VirtualRobot(robot, rate_hz=100) as cell:
    cell.advance(0.5)
    print("begin", cell.rig.chain.pressed, flush=True)
    for _ in range(int(sys.argv[2])):
        time.sleep(0.1)
        cell.advance(0.1)
    print("end", [e.kind for e in cell.events.last if e.device == "key"], cell.rig.chain.pressed, flush=True)
"""


@pytest.mark.slow
def test_without_a_terminal_a_key_counts_as_pressed(tmp_path: Path) -> None:
    """A program without a terminal could not notice the key: it enables nothing, and says why."""
    path = tmp_path / "cell.toml"
    path.write_text(CELL.format(more="[estop]\nkey = { key = 'space', clear = 'c' }", hip=""))
    made = subprocess.run(
        [sys.executable, "-c", KEYS, str(path), "0"],
        capture_output=True,
        text=True,
        start_new_session=True,  # which has no terminal
        check=True,
    )
    assert "begin {'key': 'no key can be read: /dev/tty: No such device or address'}" in made.stdout


@pytest.mark.slow
def test_a_key_of_the_terminal_trips_until_another_clears_it(tmp_path: Path) -> None:
    """Space and c, typed into a terminal: one event each; afterwards the terminal is as it was."""
    import termios

    path = tmp_path / "cell.toml"
    path.write_text(CELL.format(more="[estop]\nkey = { key = 'space', clear = 'c' }", hip=""))
    child, terminal = pty.fork()
    if child == 0:  # pragma: no cover  # another process
        os.execv(sys.executable, [sys.executable, "-c", KEYS, str(path), "10"])
    before = termios.tcgetattr(terminal)
    said = b""
    try:
        while b"begin" not in said:
            said += os.read(terminal, 1000)
        os.write(terminal, b"xc ")
        with suppress(OSError):
            while chunk := os.read(terminal, 1000):  # until the program has ended
                said += chunk
        assert b"begin {}" in said
        assert b"['estop'] {'key': 'key space was pressed (c clears it)'}" in said
        assert termios.tcgetattr(terminal)[3] == before[3]
    finally:
        os.close(terminal)
        os.waitpid(child, 0)


def test_a_rig_that_only_looks_stops_nothing() -> None:
    """What is pressed while nothing is driven sends no stop: another program may drive."""
    with cell() as robot:
        robot.twins["IO"].put("di1", True)
        robot.advance(0.5)
        sent: list[str] = []
        robot.rig.events.acts.append(lambda what, who, detail: sent.append(what))
        robot.twins["IO"].put("di1", False)
        robot.advance(0.5)
        assert isinstance(robot.rig, Rig)
        assert robot.events.count("estop") == 1
        assert sent == []
