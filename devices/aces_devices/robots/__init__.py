"""The robots that ship, as TOML files beside this one, and other programs' descriptions read as robots.

A file says what its sources say; what they do not say is listed in its head, and is not in it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

from aces_bus.device import Robot
from aces_bus.errors import UnknownNameError
from aces_bus.robot import RobotError, parse_robot
from aces_bus.robot import load_robot as load_file

from .importing import ImportedRobot as ImportedRobot
from .importing import import_robot as import_robot


def list_robots() -> Mapping[str, str]:
    """The robots that ship: name → content of its file, in order of names."""
    found = {entry.name: entry for entry in files(__name__).iterdir() if entry.name.endswith(".toml")}
    return {name.removesuffix(".toml"): found[name].read_text(encoding="utf-8") for name in sorted(found)}


def load_robot_by_name(name: str | os.PathLike[str]) -> Robot:
    """A robot that ships, by name, or that of a file, by its path (whatever ends in `.toml`, or holds a folder).

    Raises `UnknownNameError` with the names that exist, and `RobotError` with all that is wrong with a file.
    """
    if is_path(name):
        return load_file(name)
    texts = list_robots()
    if name not in texts:
        raise UnknownNameError("robot", str(name), texts)
    robot, problems = parse_robot(texts[str(name)], f"{name}.toml")
    if robot is None:
        raise RobotError([problem for problem in problems if not problem.is_warning])
    return robot


def is_path(name: str | os.PathLike[str]) -> bool:
    """Whether this names a file rather than a robot that ships."""
    return not isinstance(name, str) or name.lower().endswith(".toml") or len(Path(name).parts) > 1
