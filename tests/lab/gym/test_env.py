"""Robots as environments of Gymnasium: its own checker, seeds, limits, ends, pictures."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="Gymnasium is not installed: pip install 'aces-bus[gymnasium]'")

import gymnasium
from gymnasium.utils import env_checker

from aces_bus import load_robot
from aces_bus.errors import CallerError
from aces_lab.gym import RobotEnv, aces_env

ARM = str(Path(__file__).parents[3] / "examples" / "arm.toml")
LEG = ("LF_HAA", "LF_HFE", "LF_KFE")


def leg(**options: Any) -> RobotEnv:
    """A leg of the quadruped: a bus with three motors."""
    return aces_env(load_robot("quadruped").part("LF"), **options)


def check(env: RobotEnv) -> None:
    """Gymnasium's own checker, of which every warning but those of taste is a fault."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings(
            "ignore", message=".*symmetric and normalized.*|.*infinity.*|.*not having a spec.*"
        )
        env_checker.check_env(env)
    env.close()


def test_gymnasiums_checker_passes() -> None:
    """Spaces, seeds, determinism of resets and steps, data that is not used again, pictures: as Gymnasium wants them."""
    check(leg(render_mode="rgb_array"))


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["quadruped", ARM, "so101", "rover"])
def test_gymnasiums_checker_passes_for_whole_robots(robot: str) -> None:
    """Four buses of MIT motors, the arm of four makers, half-duplex servos, wheels that are set by duty."""
    check(aces_env(robot))


def rolled(seed: int, steps: int = 12, **options: Any) -> list[list[float]]:
    """The observations of a run whose actions are drawn from the same seed."""
    env = leg(spread=0.2, **options)
    env.action_space.seed(seed)
    rows = [env.reset(seed=seed)[0].tolist()]
    rows += [
        env.step(np.float64(0.3) * env.action_space.sample().astype(np.float64))[0].tolist()
        for _ in range(steps)
    ]
    env.close()
    return rows


def test_the_same_seed_is_the_same_run() -> None:
    """Bit by bit; another seed is another run."""
    assert rolled(5) == rolled(5)
    assert rolled(5) != rolled(6)


def test_actions_move_the_joints_within_the_robots_limits() -> None:
    """The spaces are the file's limits; joints go to a set-point at the file's speeds; beyond a limit they stay at it."""
    env = leg(pose={"LF_HFE": 0.2})
    assert isinstance(env.action_space, gymnasium.spaces.Box)
    assert env.action_space.low.tolist() == [-0.7, -1.5, -2.6]
    assert env.signals == [f"{name}.{what}" for what in ("position", "velocity") for name in LEG]
    first, info = env.reset(seed=0)
    assert first[:3] == pytest.approx((0.0, 0.2, 0.0), abs=0.02)
    assert info["time"] < 1
    goal = np.array((0.3, 0.8, -0.5))
    last, reward, is_over, is_cut, _ = [env.step(goal) for _ in range(40)][-1]
    assert last[:3] == pytest.approx(goal, abs=0.02)
    assert (reward, is_over, is_cut) == (0.0, False, False)
    env.close()


def test_a_trip_ends_the_episode() -> None:
    """A joint that swings past its limit is switched off, as on the robot; the reason is in `info`."""
    env = leg()
    env.reset(seed=0)
    steps = [env.step(np.array((0.0, 1.5, 0.0))) for _ in range(20)]
    assert steps[-1][2]
    assert "LF_HFE is at 1.6" in steps[-1][4]["ended"]
    env.close()


def test_rewards_and_ends_are_functions_of_the_environment() -> None:
    """A task is a reward and an end; time that is up truncates; what trips the robot ends the episode, with its reason."""
    env = leg(
        seconds=0.2,
        reward=lambda env: -abs(env.values["LF_HAA.position"]),
        is_over=lambda env: env.values["LF_HAA.position"] > 0.1,
    )
    env.reset(seed=0)
    ends = [env.step(np.array((0.6, 0.0, 0.0)))[1:] for _ in range(10)]
    assert [cut for _, _, cut, _ in ends] == [False] * 9 + [True]
    assert [over for _, over, _, _ in ends] == sorted(over for _, over, _, _ in ends)
    assert ends[-1][0] < -0.1
    assert ends[-1][3]["ended"] == "over"
    env.close()


def test_a_device_that_is_lost_ends_the_episode() -> None:
    """Its values are the last ones, and the reason is in `info`."""
    env = leg()
    env.reset(seed=0)
    env.run.world.twins["DM_LF_KFE"].power(False)
    observed, _, is_over, _, info = [env.step(env.action) for _ in range(60)][-1]
    assert is_over
    assert info["ended"]
    assert np.isfinite(observed).all()
    env.close()


def test_a_picture_shows_the_pose() -> None:
    """Bytes of red, green and blue; another pose is another picture, the same pose the same."""
    env = leg(render_mode="rgb_array")
    env.reset(seed=0)
    straight: Any = env.render()
    assert (straight.shape, straight.dtype) == ((480, 480, 3), np.uint8)
    assert (env.render() == straight).all()
    for _ in range(20):
        env.step(np.array((0.0, 1.0, -1.5)))
    assert (env.render() != straight).any()
    env.close()


@pytest.mark.slow
def test_a_robot_with_weight_is_as_deterministic() -> None:
    """`physics` is made anew at each reset: the arm of four makers, with the masses of its URDF."""
    env = aces_env(ARM, physics="urdf", pose={"shoulder": 0.3})
    rows: list[list[float]] = []
    for _ in range(2):
        env.reset(seed=3)
        rows.append([env.step(env.action)[0].tolist() for _ in range(10)][-1])
    env.close()
    assert rows[0] == rows[1]
    assert rows[0][1] > 0.305  # it sags


def test_make_knows_robots() -> None:
    """`gymnasium.make` imports the module that its name says, and finds the environment there."""
    env = gymnasium.make(
        "aces_lab.gym.env:aces/Robot-v0", robot=load_robot("quadruped").part("LF"), seconds=0.1
    )
    env.reset(seed=1)
    assert isinstance(env.unwrapped, RobotEnv)
    env.close()


def test_wrong_calls_are_refused() -> None:
    """A step before a reset, an action of another length or that is not finite, a robot that reports nothing."""
    env = leg()
    with pytest.raises(CallerError, match="reset the environment"):
        env.step(np.zeros(3))
    env.reset(seed=0)
    for action in (np.zeros(2), np.array((0.0, np.nan, 0.0))):
        with pytest.raises(CallerError, match="an action has 3 finite numbers"):
            env.step(action)
    env.close()
    with pytest.raises(CallerError, match="nothing to observe"):
        aces_env("omnibot")
    with pytest.raises(CallerError, match="there is rgb_array"):
        leg(render_mode="human")
    rover = aces_env("rover", render_mode="rgb_array")
    with pytest.raises(CallerError, match="names no body"):
        rover.render()
