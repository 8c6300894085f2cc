"""Hold a robot, while controllers of other programs come, go and hand over.

  aces robot serve arm.toml                       looks, and sends nothing
  aces robot serve arm.toml --tx                  enables it, and holds it
  aces robot serve so101:follower -i socketcan --tx --no-enable
  aces robot serve quadruped --virtual            twins, at real time's pace

Then, from other terminals and programs of the same user:

  aces robot attach arm wave.py                   a controller, elsewhere
  aces robot attach arm elbow=0.4 --for 5s        set-points
  aces robot served arm                           who owns which joint
  aces robot served arm hand-over wave grasp      without a jerk
  aces stop arm.toml                              stops it, and ends this

A joint is owned by one client; a client that dies or gives no set-points for
0.5 s loses its joints, which stand still where they are, enabled. When this
program dies, the devices' own watchdogs act: what each does is printed at the
start. Its socket lies below XDG_RUNTIME_DIR, for this user only. Clients are
data to it: nothing that they send is run. More: docs/serve.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from aces_bus.device import Robot
from aces_bus.errors import CallerError
from aces_lab.teleop.verb import arguments_of_run
from aces_tools.console import say, say_note
from aces_tools.options import Arguments, argument
from aces_tools.robot_arg import at_reduced_speed, chosen_robot
from aces_tools.run import ARGUMENTS as OF_RUN

SUMMARY = "hold a robot while controllers come, go and hand over; with --tx"
USAGE = "%(prog)s ROBOT [options]"
ARGUMENTS: Arguments = (
    argument(
        "which",
        nargs="?",
        metavar="NAME|FILE[:PART]",
        help="the robot, or a part of it (default: $ACES_ROBOT)",
    ),
    *arguments_of_run(OF_RUN, ("items", "--replay", "--ask", "-r")),
)
#: What `aces run` asks for beside these.
DEFAULTS: dict[str, object] = {"items": [], "replay": None, "ask": False, "robot": None}


def run(arguments: argparse.Namespace) -> int:
    from aces_tools.running.loading import make_loggers

    from .desk import Desk
    from .messages import socket_path
    from .server import RobotServer
    from .session import serve_robot

    robot = at_reduced_speed(chosen_part(arguments.which, arguments.driver), arguments.reduced)
    if arguments.virtual and (arguments.bus or arguments.interface):
        raise CallerError("--virtual has no buses; leave --bus and -i away")
    if arguments.pose and not arguments.virtual:
        raise CallerError("--pose is for twins: add --virtual")
    arguments.real_time = arguments.real_time or arguments.virtual
    rate = arguments.rate or robot.rate_hz or 100.0
    drives = bool(arguments.tx or arguments.virtual)
    desk = Desk(
        robot,
        rate_hz=rate,
        is_enabled=bool(arguments.enable) or not drives,
        reacts=_reacts(robot, arguments.on_trip),
        report=say,
    )
    loggers = make_loggers(arguments.log, [desk], robot, rate)
    server = RobotServer(socket_path(robot.name), desk, drives=drives, report=say_note)
    return serve_robot(arguments, server, loggers, rate)


def chosen_part(text: str | None, drivers: Sequence[str]) -> Robot:
    """Return the robot, or the part of it, that an argument names."""
    name, colon, part = (text or "").rpartition(":")
    robot = chosen_robot((name if colon else text) or None, drivers, how="aces robot serve NAME or FILE.toml")
    return robot.part(part) if colon else robot


def _reacts(robot: Robot, on_trip: Sequence[str]) -> bool:
    """Return whether the robot's file or the call says what a client's death leads to, other than standing still."""
    said = {kind.partition("@")[0]: word for kind, word in robot.reactions.items()}
    said |= {
        kind.partition("@")[0]: word for kind, _, word in (text.partition("=") for text in on_trip) if word
    }
    return said.get("dead-man", "hold") != "hold"
