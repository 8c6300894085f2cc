"""Have a follower arm go where a leader arm is moved by hand.

  aces teleop so101:leader so101:follower --virtual --for 5s
  aces teleop so101:leader so101:follower --tx
  aces teleop leader.toml follower.toml --tx --log session.csv
  aces teleop leader.toml follower.toml --tx --bus leader_line=/dev/ttyACM1

LEADER and FOLLOWER are robots, by name or file; ROBOT:PART takes a bus,
device or joint of one. Their joints are paired by name. The leader is only
read, and switched off at the end as all of a run is. The follower is led to
where the leader is at its joints' largest speed (--reduced: at the robot's
reduced speed), within its limits, and stops when nothing is known of the
leader any more.

It runs as 'aces run' does, and ends as it does; --log records both arms, for
'python -m lerobot_robot_aces.convert' too.
"""

from __future__ import annotations

import argparse

from aces_bus.device import Robot
from aces_bus.errors import CallerError
from aces_tools.options import Argument, Arguments, Group, argument
from aces_tools.robot_arg import at_reduced_speed, chosen_robot
from aces_tools.run import ARGUMENTS as OF_RUN

from .arms import Follow, joined

SUMMARY = "have an arm follow another that is moved by hand; with --tx"
USAGE = "%(prog)s LEADER FOLLOWER [options]"
#: Arguments of `aces run` that are not for this.
_LEFT_OUT = ("items", "--replay", "--ask", "-r")


def arguments_of_run(arguments: Arguments, left_out: tuple[str, ...] = _LEFT_OUT) -> Arguments:
    """Return arguments of `aces run` without some, and without its files of set-points."""
    found: list[Argument | Group] = []
    for item in arguments:
        if isinstance(item, Group):
            if item.title != "files of set-points":
                kept = tuple(a for a in item.arguments if a.names[0] not in left_out)
                found.append(Group(item.title, kept))
        elif isinstance(item, Argument) and item.names[0] not in left_out:
            found.append(item)
    return tuple(found)


ARGUMENTS: Arguments = (
    argument("leader", metavar="LEADER", help="the arm that is moved by hand: NAME|FILE[:PART]"),
    argument("follower", metavar="FOLLOWER", help="the arm that follows: NAME|FILE[:PART]"),
    *arguments_of_run(OF_RUN),
)
#: What `aces run` asks for beside these.
DEFAULTS: dict[str, object] = {"items": [], "replay": None, "ask": False, "robot": None}


def run(arguments: argparse.Namespace) -> int:
    from aces_tools.running.loading import make_loggers
    from aces_tools.running.session import Session

    leader = _chosen(arguments.leader, arguments)
    follower = at_reduced_speed(_chosen(arguments.follower, arguments), arguments.reduced)
    robot, pairs = joined(leader, follower)
    if arguments.virtual and (arguments.bus or arguments.interface):
        raise CallerError("--virtual has no buses; leave --bus and -i away")
    if arguments.pose and not arguments.virtual:
        raise CallerError("--pose is for twins: add --virtual")
    rate = arguments.rate or follower.rate_hz or 100.0
    follow = Follow(pairs, rate)
    loggers = make_loggers(arguments.log, [follow], robot, rate)
    return Session(arguments, robot, [follow], loggers, rate, verb="teleop").run()


def _chosen(text: str, arguments: argparse.Namespace) -> Robot:
    """Return the robot, or the part of it, that an argument names."""
    name, colon, part = text.rpartition(":")
    robot = chosen_robot(name if colon else text, arguments.driver)
    return robot.part(part) if colon else robot
