"""Run controllers on a robot: on its buses, in virtual time, or on a recording.

  aces run hubo2plus wave.py --virtual          no robot at hand: its twins
  aces run hubo2plus walk_100hz.txt --virtual --log walk.csv
  aces run hubo2plus walk.py -i socketcan       looks, and sends no set-points
  aces run hubo2plus walk.py -i socketcan --tx  and now it moves
  aces run hubo2plus walk.py --replay walk.blf  what it would have done
  aces run hubo2plus walk.py:knee hold.py --for 10s --log a.mcap:L*,LFFT.fz

A CONTROLLER is a Python file, of which every controller is run (FILE.py:NAME
takes one, or calls a function that makes it), or a file of set-points: a
trajectory or a walking pattern, which is played from where the joints are. A
Python file is a program: it runs with your rights, so run none that you would
not run yourself.

It ends when all that has an end has been played, when its time is up, or with
Ctrl-C; whatever ends it, motion is stopped, buses and logs are closed, in this
order. A second Ctrl-C waits for nothing more, but motion is told to stop all
the same.
"""

from __future__ import annotations

import argparse
import math
import os

from aces_bus.errors import CallerError

from .live import parse_duration
from .robot_arg import VARIABLE, add_robot_arguments, chosen_robot

EPILOG = """\
exit status: 0; 1 when a controller was stopped, a device was not heard, a log
is not whole or the end was not clean; 2 a wrong call, or a bus that cannot be
opened; 130 when interrupted before it ran, or twice
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.usage = "%(prog)s ROBOT CONTROLLER… [options]"
    parser.epilog = EPILOG
    add = parser.add_argument
    add(
        "items",
        nargs="+",
        metavar="ROBOT CONTROLLER…",
        help=f"a robot that ships, or FILE.toml (left out: ${VARIABLE}); then controllers",
    )
    add("--tx", action="store_true", help="really move it; without, set-points are shown and not sent")
    add("--replay", metavar="FILE", help="take a recording (CAN) for its buses; nothing is sent")
    add("--for", dest="duration", metavar="DURATION", help="run so long: 10s, 2min (default: to the end)")
    add("--rate", type=float, metavar="HZ", help="of buses, players and logs (default: the robot's)")
    add(
        "--log",
        action="append",
        default=[],
        metavar="FILE[:STATE,…]",
        help="record states (default: those of the controllers) into .csv, .txt, .db, .parquet, .mcap",
    )
    add("--home", action="store_true", help="have what is driven find its home position first")
    add(
        "--enable",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="enable what is driven before (default: yes)",
    )
    add(
        "--real-time",
        action="store_true",
        help="buses: priority SCHED_FIFO where the system allows it; --virtual, --replay: not faster than real",
    )
    add("--quiet", action="store_true", help="no panel and no lines meanwhile")
    group = parser.add_argument_group("files of set-points")
    group.add_argument("--loop", action="store_true", help="play them again and again")
    group.add_argument("--speed", type=float, default=1.0, metavar="X", help="play them X times as fast")
    group.add_argument(
        "--rows-hz", type=float, metavar="N", help="rows a second, where the name does not say"
    )
    group.add_argument("--degrees", action="store_true", help="they are in degrees, not in rad")
    group.add_argument(
        "--rename",
        action="append",
        default=[],
        metavar="COLUMN=JOINT",
        help="play a column on another joint; COLUMN= leaves it out",
    )
    add_robot_arguments(parser, named=False)


def run(arguments: argparse.Namespace) -> int:
    from .running.loading import load_controllers, make_loggers

    for option, value in (
        ("--rate", arguments.rate),
        ("--rows-hz", arguments.rows_hz),
        ("--speed", arguments.speed),
    ):
        if value is not None and not (math.isfinite(value) and 0 < value <= 1e6):
            raise CallerError(f"{option} {value:g}: give a number above 0")
    if arguments.virtual and arguments.replay:
        raise CallerError("choose one of --virtual and --replay")
    if (arguments.virtual or arguments.replay) and (arguments.bus or arguments.interface):
        raise CallerError(
            f"{'--virtual' if arguments.virtual else '--replay'} has no buses; leave --bus and -i away"
        )
    if arguments.replay and (arguments.tx or arguments.home):
        raise CallerError("--replay moves nothing; leave --tx and --home away")
    duration = None if arguments.duration is None else parse_duration("--for", arguments.duration)
    items = list(arguments.items)
    name = None
    if not (os.environ.get(VARIABLE) and _is_controller(items[0])):
        name = items.pop(0)
    robot = chosen_robot(name)
    rate = arguments.rate or robot.rate_hz or 100.0
    controllers = load_controllers(items, robot, rate, arguments)
    if not controllers and not arguments.log:
        raise CallerError("what is to run? name a controller (FILE.py, a trajectory), or what to --log")
    loggers = make_loggers(arguments.log, controllers, robot, rate)
    from .running.session import Session

    return Session(arguments, robot, controllers, loggers, rate, duration).run()


def _is_controller(item: str) -> bool:
    path = item.rpartition(":")[0] if ".py:" in item else item
    return os.path.isfile(path) and not path.endswith(".toml")
