"""Run controllers on a robot that `aces robot serve` holds.

  aces robot attach arm wave.py                a controller, in this program
  aces robot attach arm.toml walk_100hz.txt    a file of set-points
  aces robot attach arm elbow=0.4 wrist=0.1    set-points, until Ctrl-C
  aces robot attach arm elbow=0.4 --for 5s --as hand --enable

Controllers read states as the server has them, taken when they are asked for,
and own the joints that they write while they run, unless another client does.
Guards and limits are the server's. At the end, or when this program dies, the
joints stand where they are, enabled. A joint that is handed over to another
client is left to it; when no joint is left, this ends.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping, Sequence

from aces_bus.controller.base import ControllerLike
from aces_bus.device import UNKNOWN, Robot
from aces_bus.errors import AcesError, CallerError, DeviceError
from aces_bus.runtime import RealClock
from aces_bus.state import State
from aces_tools.console import say, say_note
from aces_tools.options import FOR, RATE, Arguments, Group, argument, flag
from aces_tools.robot_arg import DRIVER_FILES
from aces_tools.run import ARGUMENTS as OF_RUN

from .client import ServedRobot
from .serve_verb import chosen_part

SUMMARY = "run controllers on a robot that another program serves"
USAGE = "%(prog)s ROBOT CONTROLLER|JOINT=VALUE … [options]"
ARGUMENTS: Arguments = (
    argument("which", metavar="ROBOT", help="the robot that is served: NAME|FILE[:PART]"),
    argument(
        "items",
        nargs="+",
        metavar="CONTROLLER|JOINT=VALUE",
        help="FILE.py, FILE.py:NAME, a file of set-points, or a set-point (rad, m)",
    ),
    argument("--as", dest="name", metavar="CLIENT", help="what others call it (default: the file's name)"),
    flag("--enable", help="enable the joints first"),
    flag("--wait", help="own nothing: wait until another client hands the joints over"),
    FOR.but(help="for this time: 10s, 2min (default: to the end)"),
    RATE.but(metavar="HZ", help="of files of set-points (default: the robot's)"),
    *(item for item in OF_RUN if isinstance(item, Group) and item.title == "files of set-points"),
    DRIVER_FILES,
)
#: How often the server is asked where nothing is due (s), and how often while waiting for joints.
LOOK_S = 0.1
#: Values of the server that are older (s) are unknown to controllers.
STALE_S = 0.5
#: Modes of controllers that have come to their end.
ENDED = ("ended", "done", "failed")


def run(arguments: argparse.Namespace) -> int:
    """Run them until they end, their joints are another's, --for is over, or Ctrl-C."""
    from aces_tools.running.loading import load_controllers

    robot = chosen_part(arguments.which, arguments.driver)
    rate = arguments.rate or robot.rate_hz or 100.0
    fixed, words = _set_points(robot, arguments.items)
    controllers = load_controllers(words, robot, rate, arguments)
    name = arguments.name or os.path.basename(arguments.items[0]).partition(".")[0].partition("=")[0]
    try:
        with ServedRobot(robot.name, name) as served:
            attached = _Attached(served, robot, fixed, controllers)
            if arguments.wait:
                say_note(f"{name} waits for {', '.join(attached.joints)}")
                attached.wait()
            else:
                served.own(*attached.joints)
            if arguments.enable:
                served.enable()
            attached.run(arguments.duration)
    except KeyboardInterrupt:
        pass
    except DeviceError as error:
        say(str(error))
        return 1
    return 0


def _set_points(robot: Robot, items: Sequence[str]) -> tuple[dict[str, float], list[str]]:
    """Return set-points by joint, and the words that are controllers. Raises `CallerError`."""
    fixed: dict[str, float] = {}
    words: list[str] = []
    for item in items:
        name, equals, value = item.partition("=")
        if not equals or os.path.exists(item):
            words.append(item)
            continue
        try:
            fixed[robot.joint(name).name] = float(value)
        except ValueError:
            raise CallerError(f"{item}: write JOINT=VALUE, such as {next(iter(robot.joints))}=0.4") from None
    return fixed, words


class _Attached:
    """Controllers on a served robot."""

    def __init__(
        self,
        served: ServedRobot,
        robot: Robot,
        fixed: Mapping[str, float],
        controllers: Sequence[ControllerLike],
    ) -> None:
        self.served, self.fixed, self.controllers = served, dict(fixed), list(controllers)
        writes = {name for controller in controllers for name in getattr(controller, "writes", ())}
        #: State that a controller gives → joint.
        self.joint_of = {name: robot.joint(name.partition(".")[0]).name for name in writes}
        self.joints = list(dict.fromkeys([*fixed, *self.joint_of.values()]))
        if not self.joints:
            raise CallerError("the controllers do not say which joints they write: writes=[…]")
        states = dict.fromkeys(name for controller in controllers for name in controller.states)
        self.clock = RealClock()
        self.states = {
            name: State(name, clock=self.clock, history=512, stale_after_s=STALE_S) for name in states
        }
        for controller in controllers:
            controller.bind(self.states)

    def _mine(self) -> set[str]:
        """Return the joints that this client owns now."""
        joints = self.served.status().joints
        return {name for name, of in joints.items() if of.owner == self.served.name}

    def wait(self) -> None:
        """Wait until all joints are this client's."""
        while not set(self.joints) <= self._mine():
            time.sleep(LOOK_S)

    def run(self, duration_ns: int | None) -> None:
        """Step controllers at their rates, and give what they want. Raises `DeviceError` where the server has ended."""
        began = now = self.clock.now()
        due = dict.fromkeys(range(len(self.controllers)), began)
        mine = set(self.joints)
        for controller in self.controllers:
            controller.start(began)
        while duration_ns is None or now - began < duration_ns:
            wanted = dict(self.fixed)
            if self.states:
                for name, value in self.served.read(*self.states).items():
                    self.states[name].push(UNKNOWN if value is None else value, now)
            for number, controller in enumerate(self.controllers):
                if due[number] <= now:
                    period = round(1e9 / controller.rate_hz)
                    due[number] = max(due[number] + period, now)
                    wanted.update(self._step(controller, now))
            try:
                self.served.set({joint: value for joint, value in wanted.items() if joint in mine})
            except CallerError as error:
                left = self._mine() & mine
                if left == mine:
                    raise
                say(f"no longer {self.served.name}'s: {', '.join(sorted(mine - left))} ({error})")
                mine = left
                if not mine:
                    return
            if self.controllers and not self.fixed and all(map(_is_over, self.controllers)):
                return
            now = self.clock.now()
            ahead = (min(due.values(), default=now + round(LOOK_S * 1e9)) - now) / 1e9
            time.sleep(min(max(ahead, 0.0), LOOK_S))
            now = self.clock.now()

    def _step(self, controller: ControllerLike, now: int) -> dict[str, float]:
        """Return a controller's set-points by joint. Raises `CallerError` for what it raises."""
        try:
            given = controller.step(now)
            return {self.joint_of[name]: float(value) for name, value in given.items()}
        except AcesError:
            raise
        except Exception as error:  # the user's own program
            raise CallerError(f"{controller.name} raised {type(error).__name__}: {error}") from error


def _is_over(controller: ControllerLike) -> bool:
    inner = getattr(controller, "controller", controller)
    return getattr(inner, "mode", None) in ENDED
