"""Robots from other programs' descriptions: HuboCan's `.dd` trees, hubo-ach's tables, files with bodies (URDF).

1. What a file is, its content says; of a file with a body its suffix. Several files make one robot: a joint table, a
   sensor table, a .home table.
2. The robot is checked as one of ours is; what is wrong names the file and line that it came from.
3. Nothing is made up: what the files do not say is absent. A .home table alone is laid over a robot that ships. A file with
   a body says nothing of devices: they are another robot's, or one of one driver for each joint, as a note says.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from aces_bus import list_robots
from aces_bus.device import Robot, load_driver
from aces_bus.errors import CallerError
from aces_bus.kinematics.bodies import BodyFormat, body_format
from aces_bus.robot.file import RobotError, RobotFileProblem, make_robot
from aces_bus.robot.installed import robot_text

from . import _hubo_ach, _hubocan
from ._description import RobotDescription, read_lines

#: A table of a robot's file, and what is in it.
Tables = dict[str, Any]


class ImportedRobot(NamedTuple):
    """A robot, and what is worth saying about how it was read."""

    robot: Robot
    notes: tuple[str, ...]
    warnings: tuple[RobotFileProblem, ...]


def import_robot(
    paths: Sequence[str | Path],
    *,
    base: str | None = None,
    name: str | None = None,
    device: str | None = None,
) -> ImportedRobot:
    """Return the robot that these files describe.

    `base` is what a .home table is laid over (a robot that ships), or what has the devices of a body's joints (also a file);
    `name` is what the robot is to be called, `device` the driver of a body's joints where there is no `base`.
    Raises `RobotError` with all that is wrong, and `CallerError` for files that are not descriptions or do not go together.
    """
    if (bodies := body_format(str(paths[0]))) is not None:
        return _with_body([str(path) for path in paths], bodies, base, name, device)
    if device is not None:
        raise CallerError(
            "--device is for a file with a body, such as arm.urdf: the others say which devices there are"
        )
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


#: The driver of a body's joints where nobody names one: motors that are driven by position, speed and torque.
USUAL_DEVICE: Final = "damiao"
#: Devices on a bus, where each joint gets one: what 1 Mbit/s carries at 200 Hz, and every protocol has numbers for.
PER_BUS: Final = 8


def _with_body(
    paths: Sequence[str], found: BodyFormat, base: str | None, name: str | None, device: str | None
) -> ImportedRobot:
    """Return a robot with a file's joints, whose body is the file."""
    (path, *others) = paths
    if others:
        raise CallerError(f"{path} is a whole robot: leave {', '.join(others)} away")
    if base is not None and device is not None:
        raise CallerError("--base and --device both say what drives the joints: name one")
    joints = {joint: dict(keys) for joint, keys in found.robot_joints(path).items()}
    notes: list[str] = []
    content: Tables = {
        "name": Path(path).stem.partition(".")[0],
        "buses": {},
        "devices": {},
        "joints": {},
    }
    if base is not None:
        content |= tomllib.loads(_text_of(base))
        own = content["joints"]
        for joint in joints.keys() & own.keys():
            own[joint] |= joints[joint]
        others = [joint for joint in joints if joint not in own]
        if len(others) == len(joints):
            raise CallerError(f"{base} has none of the joints of {path}: {', '.join(others[:12])}")
        if others:
            notes.append(f"{base} has no {', '.join(others[:12])}, which {path} has: left out")
    else:
        content |= _devices_for(joints, device or USUAL_DEVICE)
        notes.append(
            f"{path} does not say what drives its joints: a {device or USUAL_DEVICE} for each, numbered in their order,"
            " eight a bus, is a choice (--device DRIVER, --base ROBOT choose)"
        )
    content["body"] = path
    sources = [content["source"]] if "source" in content else []
    content["source"] = ", ".join([*sources, Path(path).name])
    if name is not None:
        content["name"] = name
    robot, said = make_robot(content, lambda key: (path, 1))
    if robot is None:
        raise RobotError([problem for problem in said if not problem.is_warning])
    return ImportedRobot(robot, tuple(notes), tuple(said))


def _text_of(base: str) -> str:
    """Return the text of a robot that ships, or of a file."""
    if not base.lower().endswith(".toml"):
        return robot_text(base)
    try:
        return Path(base).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise CallerError(f"{base}: {getattr(error, 'strerror', None) or error}") from error


def _devices_for(joints: Mapping[str, Tables], driver: str) -> Tables:
    """Return a device for each joint, as the driver's example has one, on as few buses as carry them; credentials are
    numbers from 1 on each bus.
    """
    example = tomllib.loads(load_driver(driver).example)
    first = next(entry for entry in example["devices"].values() if entry["driver"] == driver)
    bus = {
        key: value
        for key, value in example["buses"][first["bus"]].items()
        if key not in ("channel", "interface")
    }
    kept = {key: value for key, value in first.items() if key in ("driver", "model", "dialect", "protocol")}
    made: Tables = {"buses": {}, "devices": {}, "joints": {}, "rate_hz": 100.0}
    for place, (joint, keys) in enumerate(joints.items()):
        on, number = divmod(place, PER_BUS)
        name = f"bus{on + 1}" if len(joints) > PER_BUS else "bus"
        made["buses"][name] = bus
        credentials = dict.fromkeys(first.get("credentials", ()), number + 1)
        made["devices"][f"M{place + 1}"] = {**kept, "bus": name, "credentials": credentials, "channels": 1}
        made["joints"][joint] = {"device": f"M{place + 1}", **keys}
    return made


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
        " a joint.table, sensor.table or .home of hubo-ach, or a file that ends in the suffix of a body's format (.urdf)"
    )


def _base(homes: Path, base: str | None, notes: list[str]) -> Tables:
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
