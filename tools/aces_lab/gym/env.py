"""A robot's file as an environment of Gymnasium: its twins in virtual time.

1. Actions are set-points, and leave by the robot's own door: limits, rates and guards hold them as they hold a controller's.
2. Observations are what the devices report, as old as that is on a bus; what is unknown ends the episode.
3. Everything random comes from the seed of `reset`: the same seed and actions give the same run, bit by bit.
4. No time passes between steps; a step is one period of `rate_hz`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from aces_bus import load_robot
from aces_bus.controller import Controller
from aces_bus.device import Robot
from aces_bus.device.config import Joint
from aces_bus.device.physics import Physics
from aces_bus.errors import CallerError
from aces_bus.robot import Runner, run_virtual
from aces_bus.robot.physics import physics_of

if TYPE_CHECKING:
    from .sticks import Sticks

Floats = npt.NDArray[np.float64]
Info = dict[str, Any]
#: The action's range where the robot's file states none, by what a set-point is: rad, rad/s, A, the full duty.
USUAL: Mapping[str, float] = {"position": math.pi, "speed": 1.0, "current": 1.0, "duty": 1.0}
#: Seconds in which all joints must be known after a reset.
KNOWN_S = 5.0


class _Policy(Controller):
    """Hands actions down; before the first the joints stay where they are."""

    def __init__(self, env: RobotEnv) -> None:
        super().__init__("policy", rate_hz=env.rate_hz, states=env.signals, writes=env.joints)
        self.rest = [joint.command == "position" for joint in env.driven]
        self.wanted: Mapping[str, float] = {}

    def step(self, now_ns: int) -> Mapping[str, float]:
        if not self.wanted and not self.unknown_states():
            here = [
                self.known(f"{name}.position") if stays else 0.0
                for name, stays in zip(self.writes, self.rest, strict=True)
            ]
            self.wanted = {name: value or 0.0 for name, value in zip(self.writes, here, strict=True)}
        return self.wanted


class RobotEnv(gymnasium.Env[Floats, Floats]):
    """A robot's joints. Made by `aces_env`, which says what the options are.

    Actions and observations are float64 in SI units. An action has a set-point for each of `joints`, an observation the
    values of `signals`: all positions, then all velocities, of joints whose devices report them. `info` has the `time` (s)
    and, at an end, `ended`: why.
    """

    metadata: Info = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012  # as Gymnasium has it

    def __init__(
        self,
        robot: Robot | str = "quadruped",
        *,
        rate_hz: float = 50.0,
        seconds: float = 10.0,
        spread: float = 0.0,
        pose: Mapping[str, float] | None = None,
        reward: Callable[[RobotEnv], float] | None = None,
        is_over: Callable[[RobotEnv], bool] | None = None,
        physics: str | Callable[[Robot], Physics] | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise CallerError(f"render_mode {render_mode!r}: there is rgb_array")
        self.robot = robot if isinstance(robot, Robot) else load_robot(robot)
        self.rate_hz, self.seconds, self.spread, self.render_mode = rate_hz, seconds, spread, render_mode
        self.pose, self.reward, self.is_over, self.options = dict(pose or {}), reward, is_over, options
        self.physics = physics
        self.metadata = {**self.metadata, "render_fps": max(1, round(rate_hz))}
        self.driven: list[Joint] = [joint for joint in self.robot.joints.values() if joint.active]
        self.joints = [joint.name for joint in self.driven]
        if not self.joints:
            raise CallerError(f"{self.robot.name} has no active joint")
        self.run = self._made(0)
        known = self.run.rig.signals
        self.signals = [
            f"{name}.{what}"
            for what in ("position", "velocity")
            for name in self.joints
            if f"{name}.{what}" in known
        ]
        if not self.signals:
            raise CallerError(
                f"no joint of {self.robot.name} reports where it is: there is nothing to observe"
            )
        low, high = np.array([_range(joint) for joint in self.driven]).T
        self.action_space = spaces.Box(low, high, dtype=np.float64)
        self.observation_space = spaces.Box(-np.inf, np.inf, (len(self.signals),), np.float64)
        self.action = np.zeros(len(self.joints))
        self.values: dict[str, float] = {}
        self._policy: _Policy | None = None
        self._sticks: Sticks | None = None
        self._steps = 0

    def _made(self, seed: int, pose: Mapping[str, float] | None = None, *controllers: Controller) -> Runner:
        chosen = self.physics
        body = physics_of(chosen, self.robot) if isinstance(chosen, str) else chosen and chosen(self.robot)
        return run_virtual(self.robot, controllers, seed=seed, pose=pose, physics=body, **self.options)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Floats, Info]:
        """Begin anew: twins powered and enabled, at the pose, or up to `spread` (rad) from it; `options` may have a `pose`.

        Raises `CallerError` for joints that stay unknown.
        """
        super().reset(seed=seed)
        self.close()
        pose = {**self.pose, **(options or {}).get("pose", {})}
        if self.spread:
            apart = self.np_random.uniform(-self.spread, self.spread, len(self.joints))
            for joint, way in zip(self.driven, apart, strict=True):
                value = pose.get(joint.name, 0.0) + float(way)
                pose[joint.name] = min(max(value, _or(joint.lower, value)), _or(joint.upper, value))
        self._policy, self._steps = _Policy(self), 0
        self.run = self._made(int(self.np_random.integers(2**31)), pose, self._policy)
        self.run.open()
        self.run.do("enable")
        self.run.start()
        self.run.world.advance(1 / self.rate_hz)
        while (unknown := self._policy.unknown_states()) and self.run.seconds < KNOWN_S:
            self.run.world.advance(1 / self.rate_hz)
        if unknown:
            raise CallerError(f"not known {KNOWN_S:g} s after the reset: {', '.join(unknown)}")
        self.action = np.array([self._policy.wanted.get(name, 0.0) for name in self.joints])
        return self._observed()[0], {"time": self.run.seconds}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, Info]:
        """Give the set-points, let one period pass, and observe. Raises `CallerError` for an action that is not one."""
        if self._policy is None:
            raise CallerError("reset the environment before its first step")
        self.action = np.array(action, dtype=np.float64)
        if self.action.shape != self.action_space.shape or not np.isfinite(self.action).all():
            raise CallerError(f"an action has {len(self.joints)} finite numbers, not {action!r}")
        self._policy.wanted = dict(zip(self.joints, self.action.tolist(), strict=True))
        self.run.world.advance(1 / self.rate_hz)
        self._steps += 1
        observed, unknown = self._observed()
        ended = ", ".join(self.run.stopped.values()) or (f"unknown: {', '.join(unknown)}" if unknown else "")
        if not ended and self.is_over is not None and self.is_over(self):
            ended = "over"
        reward = 0.0 if self.reward is None else float(self.reward(self))
        info: Info = {"time": self.run.seconds, **({"ended": ended} if ended else {})}
        return observed, reward, bool(ended), self._steps >= round(self.seconds * self.rate_hz), info

    def _observed(self) -> tuple[Floats, list[str]]:
        """Return the observation, and which of its values are unknown: those are the last ones."""
        assert self._policy is not None
        unknown = self._policy.unknown_states()
        self.values |= {name: self._policy.known(name) or 0.0 for name in self.signals if name not in unknown}
        return np.array([self.values[name] for name in self.signals]), unknown

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return the present pose as sticks, (480, 480, 3); None without a render mode. Raises `CallerError` for a robot
        without a body.
        """
        if self.render_mode is None:
            return None
        if self._sticks is None:
            from aces_lab.urdf import model_of_robot

            from .sticks import Sticks

            self._sticks = Sticks(model_of_robot(self.robot))
        angles = {name: self.values.get(f"{name}.position", 0.0) for name in self._sticks.model.moving}
        found: npt.NDArray[np.uint8] = self._sticks.picture(angles)
        return found

    def close(self) -> None:
        """End the run: everything is switched off."""
        if self._policy is not None:
            self._policy = None
            self.run.stop()


def _or(limit: float | None, otherwise: float) -> float:
    return otherwise if limit is None else limit


def _range(joint: Joint) -> tuple[float, float]:
    """Return the lowest and highest set-point of a joint."""
    if joint.command == "position":
        return _or(joint.lower, -math.pi), _or(joint.upper, math.pi)
    most = {"speed": joint.max_speed, "current": joint.max_current, "duty": joint.max_duty}[joint.command]
    return -_or(most, USUAL[joint.command]), _or(most, USUAL[joint.command])


def aces_env(robot: Robot | str, **options: Any) -> RobotEnv:
    """Return the environment of a robot that is installed, by name, or of a file of yours, by its path.

    `rate_hz` of actions (50); `seconds` until an episode is truncated (10); `pose` (joint → rad, m) at a reset, and `spread`
    (rad, m) by which joints are away from it, drawn from the seed; `reward` and `is_over`, functions of the environment
    (`values`, `action`, `run`): none means 0 and never; `physics`, the body that its motors move, as of `--physics` ("urdf",
    "mujoco:arm.xml") or a function of the robot; `render_mode` "rgb_array". Others: those of `run_virtual`.

    Raises as `aces_bus.load_robot`, and `CallerError` for a robot that has nothing to drive or to observe.
    """
    return RobotEnv(robot, **options)


# For `gymnasium.make("aces_lab.gym.env:aces/Robot-v0", robot="quadruped")`, which imports this module first.
gymnasium.register("aces/Robot-v0", entry_point="aces_lab.gym.env:RobotEnv")
