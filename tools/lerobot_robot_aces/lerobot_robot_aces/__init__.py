"""Robots and leader arms of aces-bus for LeRobot, which imports this package when it is installed. Imports nothing heavy.

*Source*: LeRobot 0.4.4, `utils/import_utils.py` (`register_third_party_plugins`, `make_device_from_device_class`): a package
whose distribution begins with `lerobot_robot_` is imported; the class of a device is its configuration's name without
`Config`, in the package above the configuration's module.
"""

from __future__ import annotations

from .config import AcesLeaderConfig, AcesRobotConfig
from .devices import AcesLeader, AcesRobot

__all__ = ["AcesLeader", "AcesLeaderConfig", "AcesRobot", "AcesRobotConfig"]
