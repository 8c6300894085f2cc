"""The examples in which robots move: each shows what it says, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from tests.conftest import PROFILE

Run = Callable[..., list[str]]
Names = Callable[[str], Mapping[str, Any]]


def test_a_driver_of_ones_own(run: Run) -> None:
    """Spec, driver and twin of an ODrive: it turns, is limited, falls silent, and a job stops it."""
    lines = run("own_driver.py")
    text = "\n".join(lines)
    assert "LEFT.position" in lines[0]
    assert "UNKNOWN" in lines[1]
    assert "limited" in text
    assert "silent" in text


@pytest.mark.slow
def test_the_complete_hubo(names_of: Names, capsys: pytest.CaptureFixture[str]) -> None:
    """All joints of Hubo 2+ follow a sine at 200 Hz; set-points share frames, no request is lost."""
    found = names_of("hubo2plus_cycle.py")["main"](3.0 if PROFILE == "long" else 0.2, home=False)
    assert found["missed"] == 0
    assert found["ratio"] < 0.6
    assert "unanswered: 0" in capsys.readouterr().out


@pytest.mark.slow
def test_sines_come_back_within_their_bounds(names_of: Names) -> None:
    """Value, derivative and integral of the test suite's sines are within the stated bounds at every rate."""
    names = names_of("spinner.py")
    for rate in names["RATES"]:
        seconds = min(6.3, (600 if PROFILE == "long" else 200) / rate)
        judge = names["spin"](rate, seconds)
        assert judge.samples > 0.95 * seconds * rate - 3
        for got, most in zip(judge.worst, names["bounds"](rate, seconds), strict=True):
            assert 0 < got <= most


@pytest.mark.slow
def test_the_spinner_logs_as_the_original(run: Run, names_of: Names, tmp_path: Path) -> None:
    """Logs have the original's columns; the same seed gives the same log, byte for byte, at any rate."""
    names = names_of("spinner.py")
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        names["spin"](100, 0.5, folder, seed=7)
        names["spin"](5000, 0.01, folder, seed=7)
    for log, header in (
        ("log100.txt", "0 X(value) Y(value) Z(value)"),
        ("log5000.txt", "X(integral) X(diff)"),
    ):
        first, second = ((folder / log).read_bytes() for folder in folders)
        assert first == second
        assert header in first.decode().splitlines()[0]
        assert len(first.splitlines()) > 50


@pytest.mark.slow
def test_hubo_walks(names_of: Names, capsys: pytest.CaptureFixture[str]) -> None:
    """Hubo 2+ homes, goes to the first row, and follows a stepping pattern within a tenth of a radian."""
    names = names_of("hubo_walk.py")
    worst = names["main"]([])
    assert worst.keys() == set(names["JOINTS"])
    assert 0.01 < max(worst.values()) < 0.1
    said = capsys.readouterr().out
    assert "ended" in said
    assert "nothing went wrong" in said


def test_a_hand_waves(run: Run) -> None:
    """Each joint of the wave turns to where the control PC was told."""
    first, *joints = run("hand_wave.py")
    assert "61 rows" in first
    assert "ended" in first
    assert len(joints) == 4
    assert "motor 31: told -1.20" in joints[0]
    assert "turned -1.20" in joints[0]


@pytest.mark.slow
def test_ankles_give_way(names_of: Names) -> None:
    """Bypassed they are stiff, with the original's gains they give way in its directions, and never beyond its limits."""
    stiff, soft, softest = names_of("ankle_compliance.py")["main"]().values()
    assert all(abs(angle) < 0.001 for angle in stiff.values())
    assert soft["LAP"] < -0.005
    assert soft["RAP"] > 0.005
    assert soft["LAR"] > 0.002
    assert soft["RAR"] > 0.005
    assert 0.05 < -softest["LAP"] < 0.0524  # 3°
    assert 0.05 < softest["RAP"] < 0.0524
    assert 0.06 < softest["RAR"] < 0.0699  # 4°


@pytest.mark.slow
def test_crouching(run: Run) -> None:
    """The machine goes through its phases by what it measures, and ends when the arm is lifted."""
    lines = run("crouch.py")
    assert lines[0] == "stateDiagram-v2"
    trail = [line.partition(" s  ")[2] for line in lines if "→" in line]
    assert trail == ["wait → crouch", "crouch → rise", "rise → crouch", "crouch → stand", "stand → done"]
    assert lines[-1].startswith("done after 11")
    assert lines[-1].endswith("nothing went wrong")


@pytest.mark.slow
def test_homing(run: Run) -> None:
    """Limbs search in parallel; a failed knee is named, mended and found; a loose contact costs one try."""
    lines = run("homing.py")
    states = [line.partition(" s  ")[2] for line in lines[:-1]]
    assert states[:3] == ["nulling", "hips and ankles", "hip pitch and knees"]
    assert "failed: lower JMC2: RKP found no home in 2 tries" in states
    assert states.index("hip pitch and knees, again") < states.index("arms")
    assert "searching LEB, try 2 of 3: found" in states
    assert states[-2:] == ["switching on", "ready"]
    assert lines[-1].startswith("21 joints, at most 0.000")


@pytest.mark.slow
def test_nobody_mends(names_of: Names) -> None:
    """A joint that stays unfound ends the sequence in a failure that names it; nothing behind it begins."""
    names = names_of("homing.py")
    robot = names["VirtualRobot"](names["load_robot"]("hubo2"))
    said: list[str] = []
    with robot:
        robot.twins["EJMC3"].fault("no_switch")
        job = names["Homing"](robot, said.append, lambda error: False).start()
        with pytest.raises(names["AcesError"], match="WST found no home"):
            job.wait(120)
    assert said[-1].startswith("failed: upper EJMC3: WST")


@pytest.mark.slow
def test_minihubo_walks(names_of: Names, capsys: pytest.CaptureFixture[str]) -> None:
    """Four steps through the inverse kinematics: soles are level in every row, and 21 servos follow."""
    worst = names_of("minihubo_walk.py")["main"]([])
    assert len(worst) == 21
    assert max(worst.values()) < 0.2
    said = capsys.readouterr().out
    assert "soles level to 1e-0" in said
    assert "nothing went wrong" in said
    assert " 0 missing" in said


@pytest.mark.slow
def test_the_arm(names_of: Names, capsys: pytest.CaptureFixture[str]) -> None:
    """It folds itself, joint by joint; with `hold` it says what stays and what would fall."""
    assert names_of("arm.py")["main"]("park") == 0
    folded = capsys.readouterr().out.splitlines()
    assert sorted(folded) == sorted(
        f"{joint}: parked, then off" for joint in ("base", "shoulder", "elbow", "forearm", "wrist", "hand")
    )
    assert names_of("arm.py")["main"]("hold") == 0
    left = capsys.readouterr().out.splitlines()
    assert left[:3] == [f"{name}: left enabled, where it is" for name in ("O3", "X5", "X6")]
    assert [line.partition(":")[0] for line in left[3:]] == ["M1", "M2", "D4"]


@pytest.mark.slow
def test_the_rover(names_of: Names, capsys: pytest.CaptureFixture[str]) -> None:
    """It finds its heading, comes to each place, and stands while its receiver has no fix."""
    near, blind = names_of("rover.py")["main"]([(2.0, 0.0), (2.0, 2.0)], lost_s=1.0)
    assert len(near) == 2
    assert max(near) < 0.4
    assert blind < 0.05
    tour: Any = names_of("rover.py")["Tour"]([(2.0, 0.0)])
    still = {
        "GNSS.north": 0.0,
        "GNSS.east": 0.0,
        "GNSS.horizontal_accuracy": 0.5,
        "GNSS.speed": 0.0,
        "GNSS.course": 0.0,
    }
    tour.bind(
        {name: {0: value} for name, value in still.items()}
        | {f"{w}.position": {0: 0.0} for w in ("FL", "FR", "RL", "RR")}
    )
    speeds = [tour.step(n * 50_000_000)["FL.velocity"] for n in range(120)]
    assert (speeds[0], speeds[-1]) == (10.0, 0.0)
    assert "nothing went wrong" in capsys.readouterr().out


def test_omnibot(run: Run) -> None:
    """The wheels' mix makes of each move a way forward, sideways, or a turn."""
    lines = run("omnibot.py")
    assert lines[0].startswith("told  100 forward")
    assert lines[-1].endswith("nothing went wrong")


@pytest.mark.slow
def test_a_follower_goes_where_the_leader_is_moved(
    names_of: Names, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two SO-101 arms at 100 Hz: each of six joints within two ticks of the leader's, whose torque stays off."""
    names = names_of("teleoperation.py")
    assert names["main"](["1.5"]) < 0.06
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("1.5 s, 906 set-points")
    assert said[-1] == "nothing went wrong"
    assert all(line.endswith(" 0 unanswered") for line in said[1:-1])


@pytest.mark.slow
def test_a_quadruped_trots(names_of: Names, capsys: pytest.CaptureFixture[str]) -> None:
    """Twelve joints follow at 500 Hz, softly where feet swing; every command is answered."""
    found = names_of("quadruped_trot.py")["main"](6.0 if PROFILE == "long" else 1.2)
    assert found["worst"] < 0.2
    assert found["unanswered"] == 0
    assert found["load"] < 0.5
    assert "nothing went wrong" in capsys.readouterr().out


@pytest.mark.slow
def test_an_arm_carries_its_own_weight(names_of: Names) -> None:
    """It hangs still; a push leads the elbow away, where it stays; springs lead it back; switched off it falls."""
    found = names_of("gravity_compensation.py")["main"]()
    (first, high), (still, _) = found["at first"], found["a second later"]
    assert abs(still - first) < 0.005
    assert found["let go"][0] - first > 0.15
    assert abs(found["with springs"][0] - 0.5) < 0.01
    assert found["switched off"][1] < high - 0.1


@pytest.mark.slow
def test_a_quadruped_stands_walks_and_falls_the_same_twice(names_of: Names) -> None:
    """It stands at its height, walks on upright, and lies on the ground once it is switched off; twice to the last bit."""
    pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'aces-bus[physics]'")
    ends = [names_of("quadruped_walk.py")["main"](3.0) for _ in range(2)]
    for found in ends:
        found.pop("ratio")
        assert found["standing"][2] > 0.3
        assert found["walked"][0] - found["standing"][0] > 0.3
        assert found["walked"][2] > 0.28
        assert found["upright"] > 0.95
        assert found["fallen"][2] < 0.15
        assert not found["tripped"]
    assert ends[0] == ends[1]


@pytest.mark.slow
def test_one_controller_on_three_robots(names_of: Names) -> None:
    """The controller's file knows no robot; on CAN and serial it steps, on the recording it gives what it gave."""
    names = names_of("same_controller.py")
    seconds = 2.4 if PROFILE == "long" else 1.8  # its left foot is lifted once
    hubo, mini, replay = names["main"](seconds)
    assert hubo.given == replay.given
    assert hubo.worst == pytest.approx(replay.worst)
    assert len(hubo.given) == round(50 * seconds) + 1
    for notes in (hubo, mini):
        assert 0.8 < max(row["LKP"] for row in notes.given) < 1.2
        assert notes.worst < 0.15
    text = Path(names["__file__"]).with_name("walk_controller.py").read_text(encoding="utf-8")
    assert not any(word in text for word in ("import run_", "aces_devices", "assembly", "minihubo"))


def test_the_example_robot_is_the_shipped_one() -> None:
    """The robot in Hubo's convention is MiniHubo 2 but for five directions: it is as fast."""
    from aces_bus import load_robot

    here = load_robot(Path(__file__).resolve().parents[2] / "examples" / "minihubo_like_hubo.toml")
    there = load_robot("minihubo_2")
    assert list(here.joints) == list(there.joints)
    assert here.devices.keys() == there.devices.keys()
    turned = {name for name, joint in here.joints.items() if joint != there.joints[name]}
    assert turned == {"LHP", "RHP", "LAP", "RAP", "RHR"}
    for name in turned:
        joint = here.joints[name]
        assert replace(joint, direction=-joint.direction) == there.joints[name]


@pytest.mark.shared
@pytest.mark.parametrize(
    ("example", "file"),
    [
        pytest.param("hubo_walk.py", "trajectory/50hz.txt", marks=pytest.mark.long),
        ("hand_wave.py", "trajectory/handwave_100hz_deg.txt"),
    ],
)
def test_recorded_motions(run: Run, shared_captures: Path, example: str, file: str) -> None:
    """The recorded motions play to their end on the robots that they were made for."""
    text = "\n".join(run(example, str(shared_captures / file)))
    assert "ended after" in text
    assert Path(file).name in text
    assert "silent" not in text


@pytest.mark.shared
def test_the_recorded_walk(names_of: Names, shared_captures: Path) -> None:
    """The original's MiniHubo pattern has level soles, and its servos follow its first four seconds."""
    names = names_of("minihubo_walk.py")
    pattern = names["read_walk"](shared_captures / "walk22" / "02_50_HA13.txt")
    assert names["level"](pattern) < 2e-6
