"""What a call of `aces run` names: controllers in files, logs.

1. A Python file is a program of the user's, and runs with the user's rights; nothing else here executes anything.
2. Whatever is wrong is found before a bus is opened, and said in one line with the file's name.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from inspect import isfunction
from typing import Any, cast

from aces_bus.controller import Player, Trajectory, read_trajectory
from aces_bus.controller.base import ControllerLike
from aces_bus.controller.log import Logger
from aces_bus.controller.motion_file import MOST_RAD
from aces_bus.controller.reactions import Reaction
from aces_bus.controller.trip import Action
from aces_bus.device import Robot
from aces_bus.errors import AcesError, CallerError, UnknownNameError
from aces_bus.protocol.files import load_file
from aces_bus.robot.checks import KINDS_OF_FAULTS
from aces_devices.kinematics.minihubo import WALK_HZ, read_walk

#: Columns of the walking patterns that MiniHubo's programs wrote, which have no names.
WALK_COLUMNS = (13, 21, 22)


def load_controllers(
    words: Sequence[str], robot: Robot, rate_hz: float, arguments: argparse.Namespace
) -> list[ControllerLike]:
    """Return the controllers that the words of a call name, in order; raises `CallerError` for what is none."""
    found: list[ControllerLike] = []
    for word in words:
        path, name = _split(word)
        if path.endswith(".py"):
            found += _of_program(path, name)
        else:
            found.append(_player(word, robot, rate_hz, arguments))
    return found


def _split(word: str) -> tuple[str, str]:
    """Split `walk.py:knee` into file and name."""
    path, colon, name = word.rpartition(":")
    return (path, name) if colon and path.endswith(".py") else (word, "")


def _is_controller(item: Any) -> bool:
    return all(
        callable(getattr(item, part, None)) for part in ("bind", "start", "step", "stop")
    ) and not isinstance(item, type)


def _of_program(path: str, name: str) -> list[ControllerLike]:
    module = load_file(path)
    if name:
        if name not in vars(module):
            known = [key for key, item in vars(module).items() if _is_controller(item)]
            raise UnknownNameError(f"controller in {path}", name, known)
        item = getattr(module, name)
        if not _is_controller(item) and callable(item):  # a function or class that makes them
            try:
                item = item()
            except AcesError:
                raise
            except Exception as error:  # the user's own program
                raise CallerError(f"{path}: {name}() raised {type(error).__name__}: {error}") from error
        several: list[Any] = list(cast("list[Any]", item)) if isinstance(item, (list, tuple)) else []
        items: list[Any] = [item] if _is_controller(item) else several
        if not items or not all(map(_is_controller, items)):
            raise CallerError(f"{path}: {name} is not a controller, but {type(item).__name__}")
        return items
    every = {id(item): item for item in vars(module).values() if _is_controller(item)}
    inside = {id(getattr(item, "controller", None)) for item in every.values()}  # a supervisor's own
    items = [item for key, item in every.items() if key not in inside]
    if not items:
        raise CallerError(
            f"{path}: no controller in it: make one with @controller, Equations, StateMachine, Player …, under a name"
        )
    return items


def own_functions(words: Sequence[str]) -> dict[str, Any]:
    """Return the functions of the Python files that a call names, but those of this package: reactions may be any of
    them.
    """
    paths = dict.fromkeys(path for path, _ in map(_split, words) if path.endswith(".py"))
    return {
        name: item
        for path in paths
        for name, item in vars(load_file(path)).items()
        if isfunction(item) and not name.startswith("_") and not item.__module__.startswith("aces_bus.")
    }


def reactions_of(
    texts: Sequence[str], robot: Robot, own: Mapping[str, Any], controllers: Sequence[ControllerLike]
) -> tuple[Action, dict[str, tuple[Reaction, ...]]]:
    """Return what `--on-trip [KIND[@SOURCE,…]=]REACTION` says: how motion stops where nothing else is said, and
    reactions by kind.

    Raises `CallerError` for what is not a reaction, and for kinds and sources that there are not.
    """
    action: Action = "disable"
    words: dict[str, str] = {}
    for text in texts:
        kind, equals, word = text.partition("=")
        if kind in Reaction.ACTION_OF and not equals:
            action = Reaction.ACTION_OF[kind]
        elif equals:
            words[kind] = word
        else:
            words["*"] = kind
    sources = (*robot.buses, *robot.devices, *(controller.name for controller in controllers))
    return action, Reaction.parse(words, kinds=KINDS_OF_FAULTS, sources=sources, own=own)


def _player(path: str, robot: Robot, rate_hz: float, arguments: argparse.Namespace) -> Player:
    trajectory = _trajectory(path, arguments)
    renamed, left_out = _renaming(arguments.rename)
    if left_out:
        unknown = [name for name in left_out if name not in trajectory.names]
        if unknown:
            raise UnknownNameError(f"column of {path}", unknown[0], trajectory.names)
        trajectory = _without(trajectory, left_out)
    known = {*robot.joints, *(alias for joint in robot.joints.values() for alias in joint.aliases)}
    for name in trajectory.names:
        if "." not in renamed.get(name, name) and renamed.get(name, name) not in known:
            raise CallerError(
                f"{path}: {robot.name} has no joint {name}: --rename {name}=JOINT plays it on another, "
                f"--rename {name}= leaves it out"
            )
    commands = {
        name: joint.command for joint in robot.joints.values() for name in (joint.name, *joint.aliases)
    }
    are_angles = all(commands.get(renamed.get(name, name), "") == "position" for name in trajectory.names)
    try:
        return Player(
            os.path.splitext(os.path.basename(path))[0],
            trajectory,
            rate_hz=rate_hz,
            rename=renamed,
            rounds=arguments.loop or None,
            speed=arguments.speed,
            largest=MOST_RAD if are_angles else math.inf,
        )
    except CallerError as error:
        text = str(error).replace("read it with unit='deg'; else say largest=math.inf", "add --degrees")
        raise CallerError(f"{path}: {text}") from error


def _trajectory(path: str, arguments: argparse.Namespace) -> Trajectory:
    if not os.path.isfile(path):
        raise CallerError(f"{path}: {'a folder' if os.path.isdir(path) else 'no such file'}")
    rate = arguments.rows_hz
    with open(path, "rb") as file:
        first = file.readline(32_768).split()
    if len(first) in WALK_COLUMNS and _are_numbers(first):
        return read_walk(path, rate_hz=rate or WALK_HZ)
    try:
        return read_trajectory(path, rate_hz=rate, unit="deg" if arguments.degrees else "rad")
    except CallerError as error:
        text = str(error).replace("give rate_hz (rows a second)", "--rows-hz N (rows a second)")
        text = text.replace("give columns=[…]", "a first line has to name them")
        raise CallerError(text) from error


def _are_numbers(tokens: Iterable[bytes]) -> bool:
    try:
        return all(math.isfinite(float(token)) for token in tokens)
    except ValueError:
        return False


def _renaming(texts: Iterable[str]) -> tuple[dict[str, str], set[str]]:
    renamed: dict[str, str] = {}
    left_out: set[str] = set()
    for text in texts:
        old, equals, new = text.partition("=")
        if not equals or not old:
            raise CallerError(f"--rename {text}: write COLUMN=JOINT, or COLUMN= to leave it out")
        if new:
            renamed[old] = new
        else:
            left_out.add(old)
    return renamed, left_out


def _without(trajectory: Trajectory, names: set[str]) -> Trajectory:
    keep = [number for number, name in enumerate(trajectory.names) if name not in names]
    if not keep:
        raise CallerError("--rename leaves no column")
    how: Any = trajectory.interpolation
    return Trajectory(
        [trajectory.names[number] for number in keep],
        trajectory.rows[:, keep],
        rate_hz=trajectory.rate_hz,
        interpolation=how,
        source=trajectory.source,
    )


# ---------------------------------------------------------------------- logs


def make_loggers(
    texts: Sequence[str], controllers: Sequence[ControllerLike], robot: Robot, rate_hz: float
) -> list[Logger]:
    """Return the logs of `--log FILE[:STATE,…]`; raises `CallerError` for a file that cannot be written."""
    made: list[Logger] = []
    for text in texts:
        path, states = _log_parts(text)
        folder = os.path.dirname(path) or "."
        if not os.path.isdir(folder):
            raise CallerError(f"--log {path}: there is no folder {folder!r}")
        names = _states_of(states, robot) if states else default_states(controllers, robot)
        made.append(Logger(path, names, rate_hz=rate_hz, robot=robot.name))
    paths = [os.path.realpath(logger.path) for logger in made]
    if len(set(paths)) < len(paths):
        raise CallerError("--log: two logs go to one file; say all states behind one colon")
    return made


def _log_parts(text: str) -> tuple[str, list[str]]:
    path, colon, states = text.rpartition(":")
    if not colon or "/" in states or "\\" in states:
        return text, []
    if not path:
        raise CallerError(f"--log {text}: which file? write FILE:STATE,STATE")
    names = [name.strip() for name in states.split(",") if name.strip()]
    if not names:
        raise CallerError(
            f"--log {text}: no state behind the colon; without it, what the controllers use is logged"
        )
    return path, names


def _states_of(patterns: Sequence[str], robot: Robot) -> list[str]:
    """Return names as they are; `*` and `?` stand for joints: `L*`, `L*.setpoint`."""
    joints = [joint.name for joint in robot.joints.values() if joint.active]
    found: dict[str, None] = {}
    for pattern in patterns:
        if "*" not in pattern and "?" not in pattern:
            found[pattern] = None
            continue
        owner, dot, rest = pattern.partition(".")
        some = [joint for joint in joints if fnmatchcase(joint, owner)]
        if not some:
            raise UnknownNameError(f"joint of {robot.name} like", owner, joints)
        found.update(dict.fromkeys(f"{joint}{dot}{rest}" for joint in some))
    return list(found)


def default_states(controllers: Sequence[ControllerLike], robot: Robot) -> list[str]:
    """Return what controllers read and write, beside what they wanted; without any, all joints."""
    written = [name for controller in controllers for name in getattr(controller, "writes", ())]
    read = [name for controller in controllers for name in controller.states]
    if not written and not read:
        return [joint.name for joint in robot.joints.values() if joint.active]
    driven = [state for name in written for state in (name, f"{name}.setpoint")]
    return list(dict.fromkeys([*driven, *read]))
