"""The arm of examples/arm.toml, for tests: what moves it, where it truly is, and what its twins do when it is stopped.

Its joints may be commanded in another way each. Of every joint the laws are judged by the twin's own motion, not by what
was measured over the bus.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

from aces_bus.controller import Controller
from aces_bus.device import Robot
from aces_bus.robot import Runner, VirtualRobot, parse_robot

FILE = Path(__file__).parents[2] / "examples" / "arm.toml"
DEVICE_OF = {"base": "M1", "shoulder": "M2", "elbow": "O3", "forearm": "D4", "wrist": "X5", "hand": "X6"}
BUS_OF = {"M1": "lower", "M2": "lower", "O3": "middle", "D4": "upper", "X5": "tip", "X6": "tip"}
MS = 1_000_000
#: Of every joint: its limits (rad) and what it can brake with (rad/s²), from the file.
BOUND, BRAKES = 1.5, 20.0
#: How old what is measured may be: a poll in each tick, and its answer; a set-point leaves with the next tick (s).
POLL_S, REPLY_S, TICK_S = 0.01, 0.005, 0.01
#: What rounding to a servo's count leaves (rad).
COUNT = 0.002
#: As near (counts) as friction lets a servo come to its goal.
NEAR = 4


class Way(NamedTuple):
    """What a joint is set by: the command of the file, the signal, and a large value of it."""

    command: str
    signal: str
    large: float


#: A motor of MIT's law without the stiffness of the file: its torque alone moves it.
FREE = "free"
GAINS = ", gains = { kp = 50, kd = 2 }"
#: By the joint's device: what its driver can be set by. A Damiao motor takes positions and torques in one mode.
WAYS: Mapping[str, tuple[Way, ...]] = {
    "M": (Way("position", "position", 3.0), Way("speed", "velocity", 3.0)),
    "O": (Way("position", "position", 3.0), Way("speed", "velocity", 3.0), Way("current", "torque", 2.0)),
    "D": (Way("position", "position", 3.0), Way("speed", "velocity", 3.0), Way(FREE, "torque", 0.5)),
    "X": (
        Way("position", "position", 3.0),
        Way("speed", "velocity", 3.0),
        Way("current", "current", 1.0),
        Way("duty", "duty", 0.2),
    ),
}


def ways_of(joint: str) -> tuple[Way, ...]:
    """Return what a joint can be set by."""
    return WAYS[DEVICE_OF[joint][0]]


def arm_text(*commands: str) -> str:
    """Return the arm's file, whose joints are commanded so, in their order; "position" where nothing is said, or `FREE`."""
    # The laws are of joints by themselves, and the file is read in other folders, too.
    text = FILE.read_text(encoding="utf-8").replace('physics = "urdf"', "").replace('body = "arm.urdf"', "")
    for joint, command in zip(DEVICE_OF, commands, strict=False):
        if command == FREE:
            assert GAINS in text
            text = text.replace(GAINS, "")
            continue
        text = text.replace(f'\n{joint} = {{ device = "', f'\n{joint} = {{ command = "{command}", device = "')
    if any(command != "position" for command in commands):
        text = (
            text.partition("[park]")[0] + "[buses]" + text.partition("[buses]")[2]
        )  # none but positions park
    return text


@cache
def arm(*commands: str, more: str = "") -> Robot:
    """Return the arm of `arm_text`, with what its file says more."""
    robot, problems = parse_robot(f"{arm_text(*commands)}\n{more}")
    assert robot is not None, problems
    return robot


class Drawn(Controller):
    """Gives what a schedule has it give: by joint a share of its large value, or what is not a number."""

    def __init__(self, ways: Mapping[str, Way]) -> None:
        self.signals = {joint: f"{joint}.{way.signal}" for joint, way in ways.items()}
        self.ways = ways
        super().__init__("drawn", rate_hz=100, writes=list(self.signals.values()))
        self.shares: dict[str, Any] = dict.fromkeys(ways, 0.0)
        self.what = "gives"

    def step(self, now_ns: int) -> Mapping[str, Any]:
        if self.what == "raises":
            raise ZeroDivisionError
        if self.what == "nothing":
            return {}
        return {
            signal: self.shares[joint] * self.ways[joint].large
            for joint, signal in self.signals.items()
            if self.shares[joint] is not None
        }


def is_driving(twin: Any) -> bool:
    """Return whether a twin's motor is given power to go anywhere but where it is."""
    match twin.config.name[0]:
        case "M":
            twin.position(twin.clock.now())  # its watchdog is looked at
            return bool(twin.mode == "position")
        case "O":
            return bool(twin.state == "closed_loop")
        case "D":
            return bool(twin.status == "enabled")
        case _:
            twin.measure()
            motion, now = twin.motion, twin.clock.now()
            if not motion.is_driven:
                return False
            for given in (motion.duty, motion.current, motion.speed):
                if given is not None:
                    return bool(given)
            return bool(abs(motion.goal - motion.position(now)) > NEAR)


class Truth:
    """Where the joints truly are, looked at every 5 ms: how far past their limits, and how fast at most."""

    EVERY_NS = 5 * MS

    def __init__(self, world: VirtualRobot) -> None:
        self.joints = {joint: world.simulation.world.joints[joint] for joint in DEVICE_OF}
        self.clock = world.clock
        self.was = self.now()
        self.past = dict.fromkeys(DEVICE_OF, -inf)
        self.fastest = dict.fromkeys(DEVICE_OF, 0.0)
        self.clock.call_in(self.EVERY_NS, self._look)

    def now(self) -> dict[str, float]:
        """Return where they are (rad)."""
        return {joint: float(one.position(self.clock.now())) for joint, one in self.joints.items()}

    def _look(self) -> None:
        self.clock.call_in(self.EVERY_NS, self._look)
        here = self.now()
        for joint, angle in here.items():
            self.past[joint] = max(self.past[joint], abs(angle) - BOUND)
            speed = abs(angle - self.was[joint]) / (self.EVERY_NS / 1e9)
            self.fastest[joint] = max(self.fastest[joint], speed)
        self.was = here

    def beyond(self, *, but: frozenset[str] | set[str] = frozenset()) -> dict[str, str]:
        """Return the joints that break the law v·(poll + reply + tick) + v²/2a, with how."""
        found: dict[str, str] = {}
        for joint in set(DEVICE_OF) - but:
            v = self.fastest[joint]
            room = v * (POLL_S + REPLY_S + TICK_S) + v * v / (2 * BRAKES) + COUNT
            if self.past[joint] > room:
                found[joint] = (
                    f"{self.past[joint]:.4f} rad past its limit, at most {room:.4f} at {v:.3g} rad/s"
                )
        return found


def kill(run: Runner) -> None:
    """The program is gone: from now on nothing of it comes to any bus."""
    for host in run.rig.hosts.values():
        port: Any = host.port
        port.node.is_connected = False
