"""Commands of ROS 2 programs: what is carried out, by whom, what is refused, and when motion ends.

All in one process and in virtual time: DDS hands messages between participants of one process on at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest

from aces_bus.errors import CallerError
from aces_bus.robot import Runner, parse_robot, run_virtual
from aces_lab.ros2.commands import COMMANDS_TOPIC, TRAJECTORY_TOPIC, Ros2Commands
from aces_lab.ros2.view import Ros2View
from tests.robot.leg import ROBOT, Wish
from tests.ros2.domains import DOMAINS
from tests.ros2.peer import Peer, idl, stamped

pytestmark = pytest.mark.filterwarnings("error")


def command(
    names: list[str], position: Any = (), velocity: Any = (), effort: Any = (), stamp: Any = None
) -> Any:
    return idl("sensor_msgs/msg/JointState")(
        stamped() if stamp is None else stamp, names, list(position), list(velocity), list(effort)
    )


def point(seconds: float, positions: Any, velocities: Any = (), effort: Any = ()) -> Any:
    time = idl("builtin_interfaces/msg/Duration")(int(seconds), round(seconds % 1 * 1e9))
    return idl("trajectory_msgs/msg/JointTrajectoryPoint")(
        list(positions), list(velocities), [], list(effort), time
    )


def trajectory(names: list[str], *points: Any, stamp: Any = None) -> Any:
    return idl("trajectory_msgs/msg/JointTrajectory")(
        stamped() if stamp is None else stamp, names, list(points)
    )


class Stage:
    """The leg in virtual time, a view that takes commands, and a peer that gives them."""

    def __init__(self, others: list[Wish] | None = None) -> None:
        robot, problems = parse_robot(ROBOT)
        assert robot is not None, problems
        self.said: list[str] = []
        domain = next(DOMAINS)
        self.view = Ros2View(domain, name="leg", commands=True, report=self.said.append)
        try:
            found = self.view.controllers(robot, 200, others or [])
            assert isinstance(found[0], Ros2Commands)
            self.commands: Ros2Commands = found[0]
            logger = self.view.states(200, None)
            self.run: Runner = run_virtual(robot, [*(others or []), self.commands], loggers=[logger])
            self.run.open()
            self.run.do("enable")
            self.run.start()
            self.wait(0.05)
            self.peer = Peer(domain)
            self.states = self.peer.reader("/joint_states", "sensor_msgs/msg/JointState")
            self.command = self.peer.writer(COMMANDS_TOPIC, "sensor_msgs/msg/JointState").write
            self.trajectories = self.peer.writer(TRAJECTORY_TOPIC, "trajectory_msgs/msg/JointTrajectory")
            self.trajectory = self.trajectories.write
        except BaseException:
            self.view.close()
            raise

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.run.clock.wait(lambda: False, round(seconds * 1e9))

    def position(self, name: str) -> float:
        """Where a joint is."""
        return float(self.run.rig.signals[f"{name}.position"].value)

    def close(self) -> None:
        self.run.stop()
        del self.states, self.command, self.trajectories, self.trajectory, self.peer
        self.view.close()


@pytest.fixture
def stage() -> Iterator[Stage]:
    made = Stage()
    yield made
    with suppress(AttributeError):
        made.close()


def test_a_trajectory_is_followed_to_its_end(stage: Stage) -> None:
    """Through its points at their times, then it rests there, and another writer may command."""
    stage.trajectory(trajectory(["HIP", "KNEE"], point(0.5, [0.4, 0.3]), point(1.0, [-0.2, 0.8])))
    stage.wait(0.55)
    assert stage.position("HIP") == pytest.approx(0.4, abs=0.1)
    stage.wait(0.8)
    assert stage.position("HIP") == pytest.approx(-0.2, abs=0.01)
    assert stage.position("KNEE") == pytest.approx(0.8, abs=0.01)
    assert stage.commands.is_idle
    assert stage.said == []
    seen = stage.states.take(1000)
    assert seen[-1].name == ["HIP", "ROLL", "KNEE"]
    assert seen[-1].position[0] == pytest.approx(-0.2, abs=0.01)


def test_a_cubic_where_points_have_velocities(stage: Stage) -> None:
    """Half way between two points at rest it has gone half the way, and a quarter of the time is 5/32 of it."""
    stage.trajectory(trajectory(["HIP"], point(0.0, [0.0], [0.0]), point(1.0, [0.8], [0.0])))
    stage.wait(0.26)
    assert stage.run.given["HIP"] == pytest.approx(0.8 * 5 / 32, abs=0.01)


def test_joints_are_commanded_one_by_one_while_commands_come(stage: Stage) -> None:
    """A goal far away is led at the joint's rate, and the joint stands still half a second after the last command."""
    for _ in range(10):
        stage.command(command(["HIP"], [0.3]))
        stage.wait(0.05)
    assert stage.position("HIP") == pytest.approx(0.3, abs=0.02)
    stage.wait(0.6)
    assert stage.commands.is_idle
    assert "no command for 0.5 s: standing" in stage.said[0]
    before = stage.position("HIP")
    stage.wait(0.5)
    assert stage.position("HIP") == pytest.approx(before, abs=1e-3)


def test_a_trajectory_stops_when_its_writer_leaves(stage: Stage) -> None:
    """What nobody watches over any more does not go on."""
    stage.trajectory(trajectory(["HIP"], point(4.0, [0.9])))
    stage.wait(1.0)
    stage.trajectories.__del__()
    stage.wait(0.2)
    stood = stage.position("HIP")
    stage.wait(3.5)
    assert stage.position("HIP") == pytest.approx(stood, abs=0.01)
    assert stood < 0.4
    assert "the writer left" in stage.said[0]


def test_a_second_writer_is_refused(stage: Stage) -> None:
    """While the first one's motion is under way; afterwards it may."""
    other = stage.peer.writer(TRAJECTORY_TOPIC, "trajectory_msgs/msg/JointTrajectory")
    stage.trajectory(trajectory(["HIP"], point(0.5, [0.5])))
    stage.wait(0.1)
    other.write(trajectory(["HIP"], point(0.1, [-0.5])))
    stage.wait(0.7)
    assert stage.position("HIP") == pytest.approx(0.5, abs=0.01)
    assert "another writer commands" in stage.said[0]
    other.write(trajectory(["HIP"], point(0.5, [0.1])))
    stage.wait(0.8)
    assert stage.position("HIP") == pytest.approx(0.1, abs=0.01)


def test_a_trajectory_without_points_ends_the_motion(stage: Stage) -> None:
    """As ros2_control's controller has it."""
    stage.trajectory(trajectory(["HIP"], point(4.0, [0.9])))
    stage.wait(1.0)
    stage.trajectory(trajectory([]))
    stage.wait(1.0)
    assert stage.commands.is_idle
    assert stage.position("HIP") < 0.4


NAN, INF = math.nan, math.inf
REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "NaN": (lambda: command(["HIP"], [NAN]), "not finite"),
    "infinite": (lambda: trajectory(["HIP"], point(1, [INF])), "not finite"),
    "NaN velocity": (lambda: trajectory(["HIP"], point(1, [0.1], [NAN])), "not finite"),
    "too few": (lambda: command(["HIP", "KNEE"], [0.1]), "not of one length"),
    "none": (lambda: command(["HIP"]), "not of one length"),
    "too many": (lambda: trajectory(["HIP"], point(1, [0.1, 0.2])), "not of one length"),
    "one of two points": (
        lambda: trajectory(["HIP"], point(1, [0.1]), point(2, [])),
        "not of one length",
    ),
    "unknown joint": (lambda: command(["HIP", "TAIL"], [0.1, 0.1]), "'TAIL' is not one"),
    "twice": (lambda: command(["HIP", "HIP"], [0.1, 0.2]), "named twice"),
    "nobody": (lambda: command([], []), "no joint is named"),
    "beyond": (lambda: command(["ROLL"], [0.9]), "outside of its limits"),
    "below": (lambda: trajectory(["KNEE"], point(1, [-0.1])), "outside of its limits"),
    "effort": (lambda: command(["HIP"], [0.1], [], [1.0]), "efforts"),
    "speed": (lambda: command(["HIP"], [], [0.1]), "takes no velocities"),
    "both": (lambda: command(["HIP"], [0.1], [0.1]), "give one of them"),
    "old": (lambda: command(["HIP"], [0.1], stamp=stamped(1_000_000_000)), "more than 0.5 s from now"),
    "of tomorrow": (
        lambda: trajectory(["HIP"], point(1, [0.1]), stamp=stamped(2_000_000_000)),
        "more than 0.5 s from now",
    ),
    "times": (lambda: trajectory(["HIP"], point(1, [0.1]), point(1, [0.2])), "times of points must rise"),
    "negative time": (lambda: trajectory(["HIP"], point(-1, [0.1])), "times of points must rise"),
    "an hour": (lambda: trajectory(["HIP"], point(3600, [0.1])), "times of points must rise"),
}


@pytest.fixture(scope="module")
def standing() -> Iterator[Stage]:
    made = Stage()
    yield made
    made.close()


@pytest.mark.parametrize("name", REFUSED)
def test_a_command_is_refused_whole(standing: Stage, name: str) -> None:
    """Nothing of it is carried out, and it is said once what is wrong with it."""
    made, why = REFUSED[name]
    message = made()
    (standing.command if type(message).__name__ == "JointState" else standing.trajectory)(message)
    before = standing.commands.refused.total()
    standing.wait(0.02)
    assert standing.commands.refused.total() == before + 1
    assert any(why in reason for reason in standing.commands.refused), standing.commands.refused
    assert standing.run.given == {}
    assert standing.commands.is_idle


def test_a_stamp_older_than_the_last_is_refused(standing: Stage) -> None:
    """A command that was overtaken by another one comes too late."""

    def now(back: int = 0) -> Any:
        return stamped(*divmod(standing.run.clock.now() + standing.view.epoch_ns - back, 1_000_000_000))

    standing.command(command(["HIP"], [0.0], stamp=now()))
    standing.wait(0.01)
    standing.command(command(["HIP"], [0.1], stamp=now(100_000_000)))
    standing.wait(0.01)
    assert any("older than that of the command before" in why for why in standing.commands.refused)
    assert standing.run.given["HIP"] == 0.0
    standing.wait(0.6)


def test_joints_of_another_controller_are_its_own() -> None:
    """A controller of the run keeps what it writes, and a command for it is refused."""
    stage = Stage([Wish("walk", writes=("HIP",))])
    try:
        stage.command(command(["HIP"], [0.2]))
        stage.wait(0.02)
        assert any("'HIP' is not one" in why for why in stage.commands.refused)
        stage.command(command(["KNEE"], [0.2]))
        stage.wait(0.02)
        assert "KNEE" in stage.run.given
    finally:
        stage.close()


def test_nothing_is_left_to_command() -> None:
    """Where controllers write all joints, it is said at once."""
    with pytest.raises(CallerError, match="no joint is left"):
        Stage([Wish("walk", writes=("HIP", "ROLL", "KNEE"))])
