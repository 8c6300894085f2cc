"""The robots that ship, as TOML files beside this one, and other programs' descriptions read as robots.

1. A file is read when its robot is asked for, and not before.
2. A file says what its sources say; what they do not say is listed in its head, and is not in it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
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
    found = [entry for entry in files(__name__).iterdir() if entry.name.endswith(".toml")]
    return _Texts({entry.name.removesuffix(".toml"): entry.name for entry in found})


class _Texts(Mapping[str, str]):
    """The files' contents by name, each read when it is asked for."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self._files = dict(sorted(names.items()))

    def __getitem__(self, name: str) -> str:
        return files(__name__).joinpath(self._files[name]).read_text(encoding="utf-8")

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)


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
