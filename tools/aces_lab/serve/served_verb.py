"""Look at a robot that `aces robot serve` holds, or have it do something.

  aces robot served arm                            who owns which joint
  aces robot served arm enable shoulder elbow      joints that nobody owns
  aces robot served arm hand-over wave grasp elbow from wave to grasp
  aces robot served arm park                       to the pose of its file
  aces robot served arm stop                       all off; the server stays

The robot is named as its server names it. hand-over without joints hands over
all. What was enabled or parked stays held by the server. 'aces stop' stops the
robot, too, and ends the server.
"""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING

import msgspec

from aces_bus.errors import CallerError, DeviceError
from aces_bus.plain_text import printable
from aces_tools.console import print_json, say
from aces_tools.options import JSON, Arguments, argument

if TYPE_CHECKING:
    from .messages import ServedStatus

SUMMARY = "a robot that is served: who owns what, enable, hand over, park, stop"
USAGE = "%(prog)s NAME [WORD] [NAME …] [options]"
ARGUMENTS: Arguments = (
    argument("robot", metavar="NAME", help="the robot, as its server calls it"),
    argument(
        "word",
        nargs="?",
        choices=("status", "enable", "hand-over", "park", "stop"),
        default="status",
        help="what to do (default: status)",
    ),
    argument("names", nargs="*", metavar="NAME", help="hand-over: two clients; then joints"),
    JSON,
)


def run(arguments: argparse.Namespace) -> int:
    """Ask the server; 1 where a device did not do it."""
    from .client import ServedRobot

    word, names = arguments.word, list[str](arguments.names)
    if word == "hand-over" and len(names) < 2:
        raise CallerError(
            "hand-over from whom to whom? aces robot served NAME hand-over CLIENT CLIENT [JOINT …]"
        )
    if word == "enable" and not names:
        raise CallerError("enable which joints? aces robot served NAME enable JOINT …")
    if word in ("status", "park", "stop") and names:
        raise CallerError(f"{word} takes no names: {' '.join(names)}")
    name = f"aces-{os.getpid()}" if word == "enable" else ""
    try:
        with ServedRobot(arguments.robot, name) as robot:
            if word == "status":
                _show(robot.status(), as_json=arguments.json)
            elif word == "enable":
                robot.own(*names)
                robot.enable(*names)
            elif word == "hand-over":
                given = robot.hand_over(names[1], *names[2:], owner=names[0])
                say(f"{names[1]} owns {', '.join(given)}")
            elif word == "park":
                say(f"on their way: {', '.join(robot.park())}")
            else:
                robot.stop()
    except DeviceError as error:
        say(str(error))
        return 1
    return 0


def _show(status: ServedStatus, *, as_json: bool) -> None:
    """Print who owns what, a line for each joint."""
    if as_json:
        print_json(msgspec.to_builtins(status))
        return
    from aces_tools.device_text import aligned_rows

    rows: list[tuple[str, ...]] = [("joint", "owner", "enabled", "set-point", "measured")]
    for joint, of in status.joints.items():
        numbers = ["-" if value is None else f"{value:.4f}" for value in (of.wanted, of.measured)]
        rows.append((joint, printable(of.owner or "-"), "yes" if of.enabled else "no", *numbers))
    print("\n".join(aligned_rows(rows)))
    print(f"attached: {', '.join(map(printable, status.clients)) or 'nobody'}")
