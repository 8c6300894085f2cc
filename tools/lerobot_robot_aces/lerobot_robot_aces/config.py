"""What LeRobot's command line says of a robot (`--robot.type=aces`) and of a leader (`--teleop.type=aces_leader`)."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.robots.config import RobotConfig
from lerobot.teleoperators.config import TeleoperatorConfig


@dataclass(kw_only=True)
class AcesConfig:
    """What both have.

    `robot` is a name or file, `part` a bus, device or joint of it ("" all), `buses` where buses are (default: as the file
    says), `interface` python-can's, `virtual`: twins answer, at the pace of real time, `pose` where twins are at first (rad,
    m).
    """

    robot: str = ""
    part: str = ""
    buses: dict[str, str] = field(default_factory=dict)
    interface: str = ""
    virtual: bool = False
    seed: int = 0
    pose: dict[str, float] = field(default_factory=dict)


@RobotConfig.register_subclass("aces")
@dataclass(kw_only=True)
class AcesRobotConfig(AcesConfig, RobotConfig):
    """A robot that is moved. Nothing is sent without `tx`, but to twins.

    `enable` enables its joints at first; `dead_man_s` is the silence after which they stand still.
    """

    tx: bool = False
    enable: bool = True
    dead_man_s: float = 0.5


@TeleoperatorConfig.register_subclass("aces_leader")
@dataclass(kw_only=True)
class AcesLeaderConfig(AcesConfig, TeleoperatorConfig):
    """An arm that is moved by hand and only read.

    `prefix` is left out of its joints' names: `leader_gripper` is `gripper`.
    """

    prefix: str = "leader_"
