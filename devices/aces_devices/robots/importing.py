"""Robots from other programs' descriptions: HuboCan's `.dd` trees, hubo-ach's tables.

1. What a file is, its content says. Several files make one robot: a joint table, a sensor table, a .home table.
2. The robot is checked as one of ours is; what is wrong names the file and line that it came from.
3. Nothing is made up: what the files do not say is absent. A .home table alone is laid over a robot that ships.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from aces_bus import list_robots
from aces_bus.device import Robot
from aces_bus.errors import CallerError
from aces_bus.robot.file import RobotError, RobotFileProblem, make_robot
from aces_bus.robot.installed import robot_text

from . import _hubo_ach, _hubocan
from ._description import RobotDescription, read_lines


class ImportedRobot(NamedTuple):
    """A robot, and what is worth saying about how it was read."""

    robot: Robot
    notes: tuple[str, ...]
    warnings: tuple[RobotFileProblem, ...]


def import_robot(
    paths: Sequence[str | Path], *, base: str | None = None, name: str | None = None
) -> ImportedRobot:
    """Return the robot that these files describe.

    `base` is a robot that ships, for what a .home table is laid over; `name` is what the robot is to be called.
    Raises `RobotError` with all that is wrong, and `CallerError` for files that are not descriptions or do not go together.
    """
    kinds: dict[str, list[Path]] = {}
    for given in paths:
        path = Path(given)
        kinds.setdefault(_kind(path), []).append(path)
    for kind, found in kinds.items():
        if len(found) > 1:
            raise CallerError(f"{found[0]} and {found[1]} are both a {kind}: name one")
    if "tree" in kinds and {"joint table", "sensor table"} & kinds.keys():
        raise CallerError("a .dd tree and a table both say which joints and sensors there are: name one")
    homes = next(iter(kinds.get("home table", ())), None)
    tables = [path for kind in ("joint table", "sensor table") for path in kinds.get(kind, ())]
    made = RobotDescription({"name": Path(paths[0]).name.partition(".")[0]}, str(paths[0]))
    if base is not None and (tables or "tree" in kinds):
        raise CallerError("--base is for a .home table alone: the other files say which joints there are")
    if "tree" in kinds:
        (tree,) = kinds["tree"]
        made.content["name"] = tree.stem
        made.finish(_hubocan.read_tree(tree, made))
    elif tables:
        for path in kinds.get("joint table", ()):
            _hubo_ach.read_joints(path, made)
        for path in kinds.get("sensor table", ()):
            _hubo_ach.read_sensors(path, made)
        made.finish()
    elif homes is not None:
        made.content = _base(homes, base, made.notes)
    if homes is not None:
        _hubo_ach.read_homes(homes, made)
    sources = [made.content["source"]] if "source" in made.content else []
    made.content["source"] = ", ".join([*sources, *(Path(path).name for path in paths)])
    if name is not None:
        made.content["name"] = name
    robot, said = make_robot(made.content, made.place)
    errors = [*made.problems, *(problem for problem in said if not problem.is_warning)]
    if errors or robot is None:
        raise RobotError(sorted(set(errors)))
    return ImportedRobot(robot, tuple(made.notes), tuple(p for p in said if p.is_warning))


def _kind(path: Path) -> str:
    """Return what a file is; raises `CallerError` when it is not a description that is known."""
    lines = read_lines(path)
    words: tuple[str, ...] = lines[0].words if lines else ()
    if words[:1] in (("begin",), ("include",)):
        return "tree"
    if words[:1] == ("JointName",) or (len(words) == 7 and words[6] in ("raw", "rad")):
        return "home table"
    if len(words) == len(_hubo_ach.JOINT_COLUMNS):
        return "joint table"
    if len(words) == len(_hubo_ach.SENSOR_COLUMNS):
        return "sensor table"
    raise CallerError(
        f"{path}: not a description that can be read: a .dd tree of HuboCan (begin TYPE …),"
        " or a joint.table, sensor.table or .home of hubo-ach"
    )


def _base(homes: Path, base: str | None, notes: list[str]) -> dict[str, Any]:
    """Return the file of a robot that ships, which has the joints of a .home table."""
    if base is not None:
        return tomllib.loads(robot_text(base))
    wanted = {line.words[0] for line in read_lines(homes)} - {"JointName"}
    for robot in list_robots():
        content = tomllib.loads(robot_text(robot))
        if wanted <= RobotDescription(content, "").names().keys() and any(
            b.get("protocol") == "hubo" for b in content["buses"].values()
        ):
            notes.append(f"{homes} is laid over {robot}, which has all its joints (--base chooses another)")
            return content
    raise CallerError(
        f"{homes}: no installed robot has all its joints; name --base ROBOT ({', '.join(list_robots())}),"
        " or a joint table too"
    )
