"""Robots by name: the files that installed packages bring, declared as entry points of `aces_bus.robots`.

1. An entry point names a package whose folder holds a TOML file a robot: `[project.entry-points."aces_bus.robots"]`.
2. A file is read when its robot is asked for, and not before.
"""

from __future__ import annotations

import os
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Final

from ..device.config import Robot
from ..errors import UnknownNameError
from ..plugins import installed_points, warn
from .file import RobotError, RobotFileProblem, check_robot_file, parse_robot

GROUP: Final = "aces_bus.robots"


def list_robots() -> dict[str, Traversable]:
    """Return the installed robots, in order of names: name → its file.

    Of two packages that bring one name, ours has it, or else the first by name; a `PluginWarning` names the other, and one
    whose folder cannot be found.
    """
    found: dict[str, Traversable] = {}
    for point in installed_points(GROUP):
        try:
            brought = [file for file in files(point.value).iterdir() if file.name.endswith(".toml")]
        except Exception as error:  # whatever another package's import may raise
            warn(f"{point.distribution}: its robots are left out: {error}")
            continue
        for file in brought:
            name = os.path.splitext(file.name)[0]
            if found.setdefault(name, file) is not file:
                warn(f"{point.distribution}: its robot {name!r} is left out: another package has that name")
    return dict(sorted(found.items()))


def robot_text(name: str) -> str:
    """Return the content of an installed robot's file; raises `UnknownNameError` with the names that exist."""
    known = list_robots()
    if name not in known:
        raise UnknownNameError("robot", name, known)
    return known[name].read_text(encoding="utf-8")


def check_robot(
    name: str | os.PathLike[str], *, is_strict: bool = False
) -> tuple[Robot | None, list[RobotFileProblem]]:
    """Return what `parse_robot` gives for an installed robot, by its name, or for a file, by its path (see `is_robot_path`).

    Runs no code: of a protocol in a Python file, which nothing else has run, it says that it was not checked. Raises
    `UnknownNameError` with the names that exist.
    """
    if is_robot_path(name):
        return check_robot_file(name, is_strict=is_strict)
    return parse_robot(robot_text(str(name)), f"{name}.toml", is_strict=is_strict)


def load_robot(name: str | os.PathLike[str]) -> Robot:
    """Return an installed robot by its name, or that of a TOML file by its path (see `is_robot_path`).

    A protocol's Python file that it names below its folder is run; one elsewhere is refused, unless this program has run it
    before (`use_driver_file`, `load_protocol`).

    Raises `UnknownNameError` with the names that exist, and `RobotError`, a `CallerError`, with all that is wrong with a
    file, one line each: `robot.toml:12: joints.RHY.gear: …`.
    """
    robot, problems = (
        check_robot_file(name, runs_protocols=True) if is_robot_path(name) else check_robot(name)
    )
    errors = [problem for problem in problems if not problem.is_warning]
    if robot is None or errors:
        raise RobotError(errors)
    return robot


def is_robot_path(name: str | os.PathLike[str]) -> bool:
    """Return whether this is a file's path, not the name of an installed robot: it ends in `.toml`, or holds a folder."""
    return not isinstance(name, str) or name.lower().endswith(".toml") or len(Path(name).parts) > 1
