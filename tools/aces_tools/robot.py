"""Robots as TOML files: check, show, import from other programs' descriptions.

  aces robot list                     the robots that ship
  aces robot show hubo2plus           its buses, devices, joints and sensors
  aces robot check robot.toml         everything that is wrong, each with its
                                      line; 1 when something is an error
  aces robot import Hubo2Plus.dd > robot.toml
                                      from a HuboCan tree
  aces robot import arm.urdf -o arm.toml
                                      from a URDF: joints, limits, its body;
                                      a device of one driver for each joint
  aces robot import x.joint.table x.sensor.table x.home -o robot.toml
                                      from hubo-ach's tables; a .home alone is
                                      laid over a robot that ships (--base)

A name is a robot that ships; what ends in .toml is a file. The file says which
board is what too: aces decode walk.log -p hubo@robot.toml

Checking and showing a robot runs no code. Other commands run the Python file of
a protocol that a robot's file names, if it lies below the file's folder; one
that lies elsewhere is used only when you name it with --driver.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from aces_bus.errors import AcesError, CallerError
from aces_bus.plain_text import printable
from aces_bus.protocol.record import FieldValue, PlainValue

from .console import check_suffix, counted, print_json, say, say_note, write_text
from .options import COLOR, JSON, OUTPUT, STRICT, Arguments, argument
from .robot_arg import DRIVER_FILES, use_driver_files

if TYPE_CHECKING:
    from aces_bus.device import Robot

#: The tick (Hz) of robots whose file states none, where it decides how long a watchdog waits.
USUAL_RATE_HZ = 100.0

SUMMARY = "robots as files: check, show, list; import from other programs"

ARGUMENTS: Arguments = (
    argument("what", choices=["check", "list", "show", "import"], help="what to do"),
    argument("robots", nargs="*", metavar="NAME|FILE", help="robots; import: description files"),
    JSON,
    STRICT.but(
        help="check: what is not installed or looks wrong is an error; joints that no watchdog stops are named"
    ),
    OUTPUT.but(metavar="FILE.toml", help="import: write there (default: standard output)"),
    argument(
        "--base",
        metavar="NAME|FILE",
        help="import: the robot that a .home table changes, or whose devices a URDF's joints have",
    ),
    argument(
        "--device",
        metavar="DRIVER",
        help="import: what drives each joint of a URDF, without --base (default: damiao)",
    ),
    argument("--name", metavar="NAME", help="import: the name of the robot"),
    DRIVER_FILES,
    COLOR,
)


def run(arguments: argparse.Namespace) -> int:
    what, names = arguments.what, list[str](arguments.robots)
    for option, verbs in {
        "strict": ("check",),
        "output": ("import",),
        "base": ("import",),
        "device": ("import",),
        "name": ("import",),
    }.items():
        if getattr(arguments, option) and what not in verbs:
            raise CallerError(f"--{option} belongs to 'aces robot {verbs[0]}'")
    use_driver_files(arguments.driver)
    if what == "list":
        if names:
            raise CallerError("'aces robot list' takes no names; 'aces robot show NAME' shows one")
        return _list(arguments)
    if not names:
        raise CallerError(
            f"name {'a description file' if what == 'import' else 'a robot or a file'}: aces robot {what} …"
        )
    if what == "import":
        return _import(names, arguments)
    return _check(names, arguments) if what == "check" else _show(names, arguments)


# ---------------------------------------------------------------------- check


def _check(names: Sequence[str], arguments: argparse.Namespace) -> int:
    """Problems on stdout, as they are the result; the status says whether one is an error."""
    from aces_bus.robot.installed import check_robot

    status, objects = 0, list[dict[str, PlainValue]]()
    for name in names:
        robot, problems = check_robot(name, is_strict=arguments.strict)
        is_right = robot is not None
        without = _without_watchdog(robot) if robot is not None and arguments.strict else {}
        status = status if is_right else 1
        objects.append(
            {
                "robot": name,
                "ok": is_right,
                "counts": _counts(robot) if robot is not None else None,
                "without_watchdog": without,
                "problems": [
                    {
                        "file": problem.file,
                        "line": problem.line,
                        "key": problem.key,
                        "text": problem.text,
                        "level": "warning" if problem.is_warning else "error",
                    }
                    for problem in problems
                ],
            }
        )
        if not arguments.json:
            for problem in problems:
                print(problem)
            for device, text in without.items():
                print(f"{name}: {device}: no watchdog of its own: without its host it {text}")
            errors = sum(not problem.is_warning for problem in problems)
            facts = _facts(robot) if robot is not None else counted(errors, "error")
            print(f"{name}: {'ok: ' if is_right else ''}{facts}")
    if arguments.json:
        print_json(objects)
    return status


def _without_watchdog(robot: Robot) -> dict[str, str]:
    """Return the devices with joints that nothing stops when the host is gone: name → what they do then.

    Empty where its drivers are not installed, or are files that are not run here; a note says so.
    """
    from aces_bus.robot import VirtualRobot

    try:
        rig = VirtualRobot(robot, rate_hz=robot.rate_hz or USUAL_RATE_HZ).rig
    except AcesError as error:
        say_note(f"{robot.name}: whether its devices have watchdogs is not known: {error}")
        return {}
    return {
        device.name: f"{device.host_loss} ({', '.join(joint.name for joint in device.joints)})"
        for device in rig.devices.values()
        if device.joints and device.host_loss.lacks_watchdog
    }


def _counts(robot: Any) -> dict[str, int]:
    return {
        "joints": len(robot.joints),
        "devices": len(robot.devices),
        "sensors": len(robot.sensors),
        "buses": len(robot.buses),
    }


def _facts(robot: Any) -> str:
    singular = {"joints": "joint", "devices": "device", "sensors": "sensor", "buses": "bus"}
    return ", ".join(counted(number, singular[what]) for what, number in _counts(robot).items() if number)


# ---------------------------------------------------------------------- list, show


def _page(arguments: argparse.Namespace) -> Any:
    from .output.columns import Page

    return Page(arguments.color)


def _list(arguments: argparse.Namespace) -> int:
    from aces_bus import list_robots, load_robot

    status, found = 0, list[Any]()
    for name in list_robots():
        try:
            found.append(load_robot(name))
        except AcesError as error:
            say(str(error))
            status = 1
    if arguments.json:
        print_json(
            [
                {
                    "name": robot.name,
                    "doc": robot.doc,
                    "source": robot.source,
                    "protocols": list(robot.protocols),
                    **_counts(robot),
                }
                for robot in found
            ]
        )
        return status
    _page(arguments).table(
        ("robot", "speaks", "has", ""),
        [
            (
                robot.name,
                ", ".join(
                    _joined(name, dialect) for name, some in robot.protocols.items() for dialect in some
                ),
                _facts(robot),
                robot.doc or "",
            )
            for robot in found
        ],
    )
    return status


def _show(names: Sequence[str], arguments: argparse.Namespace) -> int:
    robots = [_looked_at(name) for name in names]
    if arguments.json:
        shown = [msgspec.to_builtins(robot) for robot in robots]
        print_json(shown[0] if len(shown) == 1 else shown)
        return 0
    page = _page(arguments)
    for index, robot in enumerate(robots):
        if index:
            page.lines([""])
        facts = [robot.doc, f"source: {robot.source}" if robot.source else None, _facts(robot)]
        if robot.rate_hz is not None:
            facts.append(f"{robot.rate_hz:g} Hz")
        page.beside(robot.name, [fact for fact in facts if fact], "message")
        for head, rows in _tables(robot):
            if rows:
                page.lines([""])
                page.table(head, rows)
    return 0


def _looked_at(name: str) -> Robot:
    """Return a robot without running the Python files that it names; raises `RobotError`."""
    from aces_bus.robot.file import RobotError
    from aces_bus.robot.installed import check_robot

    robot, problems = check_robot(name)
    if robot is None:
        raise RobotError([problem for problem in problems if not problem.is_warning])
    return robot


def _tables(robot: Any) -> Iterable[tuple[Sequence[str], list[tuple[str, ...]]]]:
    """Yield the tables of `show`: head and rows; what is unknown is an empty cell."""
    yield (
        ("bus", "link", "protocol", "speed", "channel"),
        [
            tuple(
                map(printable, (b.name, b.link, _joined(b.protocol, b.dialect), _speed(b), b.channel or ""))
            )
            for b in robot.buses.values()
        ],
    )
    yield (
        ("device", "driver", "bus", "identified by", "channels", "kind", "", "joints and sensors"),
        [
            tuple(
                map(
                    printable,
                    (
                        d.name,
                        d.driver,
                        d.bus,
                        ", ".join(f"{key} {number:#04x}" for key, number in d.credentials.items()),
                        _cell(d.channels),
                        _cell(d.kind),
                        _inactive(d),
                        " ".join(part.name for part in (*robot.joints_of(d.name), *robot.sensors_of(d.name))),
                    ),
                )
            )
            for d in robot.devices.values()
        ],
    )
    yield (
        (
            "joint",
            "device",
            "channel",
            "command",
            "gear",
            "harmonic",
            "encoder",
            "direction",
            "zero",
            "lower",
            "upper",
            "",
            "max speed",
            "also",
        ),
        [
            tuple(
                map(
                    printable,
                    (
                        j.name,
                        j.device,
                        str(j.channel),
                        "" if j.command == "position" else j.command,
                        "" if j.gear is None else f"{j.gear[0]:g}/{j.gear[1]:g}",
                        _cell(j.harmonic),
                        _cell(j.encoder),
                        f"{j.direction:+d}",
                        _cell(j.zero),
                        _cell(j.lower),
                        _cell(j.upper),
                        ""
                        if j.lower is None and j.upper is None
                        else "m"
                        if j.type == "prismatic"
                        else "rad",
                        _cell(j.max_speed),
                        " ".join([*j.aliases, *filter(None, [_inactive(j)])]),
                    ),
                )
            )
            for j in robot.joints.values()
        ],
    )
    yield (
        ("sensor", "device", "kind", "signs", ""),
        [
            tuple(
                map(
                    printable,
                    (s.name, s.device, s.kind, " ".join(f"{n:+d}" for n in s.signs or ()), _inactive(s)),
                )
            )
            for s in robot.sensors.values()
        ],
    )
    yield (
        ("state", "estimator", "interpolation", "history", "asked every", "stale after"),
        [
            tuple(
                map(
                    printable,
                    (
                        s.name,
                        s.estimator or ("" if s.kalman is None else f"kalman, {s.kalman.model}"),
                        _cell(s.interpolation),
                        f"{s.history_s:g} s" if s.history_s is not None else _cell(s.history),
                        "" if s.period_s is None else f"{s.period_s:g} s",
                        "" if s.stale_after_s is None else f"{s.stale_after_s:g} s",
                    ),
                )
            )
            for s in robot.states.values()
        ],
    )
    yield (
        ("input", "reads", "bit", "clear", "pressed", "stale after"),
        [
            tuple(
                map(
                    printable,
                    (
                        " ".join(path),
                        entry.signal or entry.message or f"key {entry.key}",
                        _cell(entry.bit),
                        _cell(entry.clear),
                        _cell(entry.pressed),
                        "" if entry.key else f"{entry.stale_after_s:g} s",
                    ),
                )
            )
            for path, entry in robot.inputs.items()
        ],
    )
    yield (
        ("reduced speed", "active"),
        [
            (
                f"{reduced.scale:.3g} of every limit",
                "yes"
                if reduced.active
                else "--reduced"
                if reduced.input is None
                else "--reduced, or by its input",
            )
            for reduced in (robot.reduced,)
            if reduced is not None
        ],
    )
    yield (
        ("bus, device, controller", "rate", "priority"),
        [
            (
                printable(owner.name),
                "" if owner.rate_hz is None else f"{owner.rate_hz:g} Hz",
                _cell(owner.priority),
            )
            for owner in (*robot.buses.values(), *robot.devices.values(), *robot.controllers.values())
            if owner.rate_hz is not None or owner.priority is not None
        ],
    )


def _cell(value: FieldValue) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_cell(item)}" for key, item in value.items())
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def _inactive(part: Any) -> str:
    return "" if part.active else "inactive"


def _joined(protocol: str, dialect: str | None) -> str:
    return f"{protocol}:{dialect}" if dialect else protocol


def _speed(bus: Any) -> str:
    if bus.bitrate is not None:
        data = f", data {bus.data_bitrate / 1000:g}" if bus.data_bitrate is not None else ""
        return f"{bus.bitrate / 1000:g}{data} kbit/s"
    return f"{bus.baud} baud" if bus.baud is not None else ""


# ---------------------------------------------------------------------- import


def _import(paths: Sequence[str], arguments: argparse.Namespace) -> int:
    from aces_bus.robot.file import print_robot
    from aces_devices.robots import import_robot

    check_suffix("--output", arguments.output, ".json" if arguments.json else ".toml")
    imported = import_robot(paths, base=arguments.base, name=arguments.name, device=arguments.device)
    robot = imported.robot
    if robot.body is not None and robot.body in paths:
        robot = msgspec.structs.replace(robot, body=_beside(arguments.output, robot.body))
    for note in imported.notes:
        say_note(note)
    for warning in imported.warnings:
        if "is not installed" not in warning.text:
            say(str(warning))
    if arguments.json:
        text = json.dumps(msgspec.to_builtins(robot), ensure_ascii=False, indent=2) + "\n"
    else:
        text = print_robot(
            robot,
            [
                f"Made by `aces robot import` from {robot.source}.",
                *(imported.notes if robot.body else ()),
                "What those files do not say is not here: the power board, for one.",
            ],
        )
    write_text(arguments.output, text, paths, is_quiet=True)
    return 0


def _beside(output: str | None, body: str) -> str:
    """Return a body's path from the folder of the robot's file; a note says when the body has to be copied there."""
    folder = os.path.dirname(output or "") if output != "-" else ""
    found = os.path.relpath(body, folder or ".")
    if not found.startswith(os.pardir):
        return found
    say_note(f"copy {body} to the folder of the robot's file, which names it")
    return os.path.basename(body)
