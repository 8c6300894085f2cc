"""A run of aces-bus as LeRobot's `Robot` and `Teleoperator`.

1. Actions and observations are positions, rad or m, named `JOINT.pos`; LeRobot takes any unit.
2. What LeRobot sends leaves by the door as a controller's set-points do: limits, rates, one owner, and a dead-man.
3. A joint whose position is not known is an error, not a number: a recording never has values that were not measured.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from lerobot.robots.robot import Robot
from lerobot.teleoperators.teleoperator import Teleoperator

from .config import AcesConfig, AcesLeaderConfig, AcesRobotConfig

if TYPE_CHECKING:
    from aces_bus.robot import Runner
    from aces_lab.teleop.given import GivenSetpoints

#: How long it may take until joints are known (s), and how far virtual time may fall behind real time (s).
KNOWN_S, BEHIND_S = 5.0, 0.2


class Arm:
    """The joints of a robot's file that have positions, and a run while it is open."""

    def __init__(self, config: AcesConfig, *, drives: bool) -> None:
        from aces_bus import load_robot
        from aces_bus.errors import CallerError

        if not config.robot:
            raise CallerError(
                "which robot? Say its name or file: --robot.robot=so101 (a leader: --teleop.robot=so101)"
            )
        whole = load_robot(config.robot)
        self.robot = whole.part(config.part) if config.part else whole
        self._config, self._drives = config, drives
        self.joints = [
            joint.name for joint in self.robot.joints.values() if joint.active and joint.command == "position"
        ]
        if not self.joints:
            raise CallerError(f"{self.robot.name} has no joint that takes positions")
        self.run: Runner | None = None
        self.given: GivenSetpoints | None = None
        self._advanced = 0.0

    @property
    def features(self) -> dict[str, type]:
        """Names and types of an observation and of an action."""
        return {f"{name}.pos": float for name in self.joints}

    def open(self) -> None:
        """Open the buses, or twins; enable what is driven."""
        from aces_bus.errors import CallerError
        from aces_bus.robot import run_real, run_virtual
        from aces_lab.teleop.given import GivenSetpoints

        config, rate = self._config, self.robot.rate_hz or 100.0
        controllers: list[GivenSetpoints] = []
        if isinstance(config, AcesRobotConfig):
            if not (config.tx or config.virtual):
                raise CallerError(
                    "nothing was sent: moving a robot takes --robot.tx=true (or --robot.virtual=true)"
                )
            self.given = GivenSetpoints("lerobot", self.joints, rate_hz=rate, dead_man_s=config.dead_man_s)
            controllers.append(self.given)
        if config.virtual:
            run = run_virtual(self.robot, controllers, rate_hz=rate, seed=config.seed, pose=config.pose)
        else:
            said: dict[str, dict[str, str]] = {name: {} for name in self.robot.buses}
            for name, channel in config.buses.items():
                said.setdefault(name, {})["channel"] = channel
            for name, bus in self.robot.buses.items():
                if bus.link == "can" and config.interface:
                    said[name]["interface"] = config.interface
            run = run_real(
                self.robot, controllers, buses=said, rate_hz=rate, transmit=self._drives, passive=False
            )
        self.run = run
        try:
            run.open()
            if isinstance(config, AcesRobotConfig) and config.enable:
                run.do("enable", devices=self.joints)
            run.start()
            self._advanced = time.monotonic()
            run.clock.wait(lambda: all(math.isfinite(p) for p in self._read().values()), round(KNOWN_S * 1e9))
        except BaseException:
            self.close()
            raise

    def _read(self) -> dict[str, float]:
        assert self.run is not None
        found = {name: self.run.rig.signals[f"{name}.position"].value for name in self.joints}
        return {name: value if isinstance(value, float) else math.nan for name, value in found.items()}

    def _pass_time(self) -> None:
        """Let virtual time pass as real time has."""
        if self._config.virtual and self.run is not None:
            now = time.monotonic()
            passed, self._advanced = min(now - self._advanced, BEHIND_S), now
            self.run.clock.wait(lambda: False, round(passed * 1e9))

    def positions(self) -> dict[str, float]:
        """Return where the joints are; raise `DeviceError` naming those that are not known, or why motion was stopped."""
        from aces_bus.errors import DeviceError

        run = self._running()
        self._pass_time()
        if run.stopped:
            raise DeviceError("; ".join(f"{name} was stopped: {why}" for name, why in run.stopped.items()))
        found = self._read()
        if unknown := [name for name, value in found.items() if math.isnan(value)]:
            raise DeviceError(f"{self.robot.name}: nothing is known of {', '.join(unknown)}")
        return found

    def set(self, goals: Mapping[str, float]) -> dict[str, float]:
        """Give set-points; return them within their joints' limits, as they are carried out."""
        assert self.given is not None
        self._running()
        limited: dict[str, float] = {}
        for name, value in goals.items():
            joint = self.robot.joint(name)
            low = -math.inf if joint.lower is None else joint.lower
            limited[name] = min(max(value, low), math.inf if joint.upper is None else joint.upper)
        self.given.give(limited)
        self._pass_time()
        return limited

    def _running(self) -> Runner:
        from aces_bus.errors import CallerError

        if self.run is None:
            raise CallerError(f"{self.robot.name} is not connected: connect() comes first")
        return self.run

    def close(self) -> None:
        """Stop what moves, and close the buses; twice does nothing. Raises `NotStoppedError`."""
        from aces_bus.errors import NotStoppedError

        run, self.run = self.run, None
        if run is not None and (left := run.stop().not_stopped):
            raise NotStoppedError(left)


def _named(values: Mapping[str, Any]) -> dict[str, float]:
    return {name.removesuffix(".pos"): float(value) for name, value in values.items()}


class AcesRobot(Robot):
    """A robot of aces-bus: `--robot.type=aces --robot.robot=so101 --robot.part=follower --robot.tx=true`."""

    config_class = AcesRobotConfig
    name = "aces"

    def __init__(self, config: AcesRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self.arm = Arm(config, drives=True)
        self.cameras: dict[str, Any] = {}

    @property
    def observation_features(self) -> dict[str, type]:
        """Positions of joints, rad or m."""
        return self.arm.features

    @property
    def action_features(self) -> dict[str, type]:
        """Goals of joints, rad or m."""
        return self.arm.features

    @property
    def is_connected(self) -> bool:
        """True while its buses are open."""
        return self.arm.run is not None

    @property
    def is_calibrated(self) -> bool:
        """True: zeros and directions are in the robot's file."""
        return True

    def connect(self, calibrate: bool = True) -> None:
        """Open the buses, and enable the joints."""
        self.arm.open()

    def calibrate(self) -> None:
        """Do nothing: a robot's file has what calibration finds."""

    def configure(self) -> None:
        """Do nothing: a robot's file has its settings."""

    def get_observation(self) -> dict[str, float]:
        """Return where the joints are."""
        return {f"{name}.pos": value for name, value in self.arm.positions().items()}

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Give goals; return them within their limits."""
        return {f"{name}.pos": value for name, value in self.arm.set(_named(action)).items()}

    def disconnect(self) -> None:
        """Stop what moves, and close the buses."""
        self.arm.close()


class AcesLeader(Teleoperator):
    """An arm of aces-bus that is moved by hand: `--teleop.type=aces_leader --teleop.robot=so101 --teleop.part=leader`."""

    config_class = AcesLeaderConfig
    name = "aces_leader"

    def __init__(self, config: AcesLeaderConfig) -> None:
        super().__init__(config)
        self.config = config
        self.arm = Arm(config, drives=False)

    def _names(self) -> dict[str, str]:
        return {name: f"{name.removeprefix(self.config.prefix)}.pos" for name in self.arm.joints}

    @property
    def action_features(self) -> dict[str, type]:
        """Goals for a follower's joints, rad or m."""
        return dict.fromkeys(self._names().values(), float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """Nothing is fed back."""
        return {}

    @property
    def is_connected(self) -> bool:
        """True while its buses are open."""
        return self.arm.run is not None

    @property
    def is_calibrated(self) -> bool:
        """True: zeros and directions are in the robot's file."""
        return True

    def connect(self, calibrate: bool = True) -> None:
        """Open the buses; its motors stay as they are."""
        self.arm.open()

    def calibrate(self) -> None:
        """Do nothing: a robot's file has what calibration finds."""

    def configure(self) -> None:
        """Do nothing: the leader is only read."""

    def get_action(self) -> dict[str, float]:
        """Return where its joints are."""
        names = self._names()
        return {names[name]: value for name, value in self.arm.positions().items()}

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing: the leader is only read."""

    def disconnect(self) -> None:
        """Close the buses."""
        self.arm.close()
