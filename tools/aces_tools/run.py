"""Run controllers on a robot: on its buses, in virtual time, or on a recording.

  aces run -r hubo2plus wave.py --virtual          with simulated devices
  aces run -r hubo2plus walk_100hz.txt --virtual --log walk.csv
  aces run -r quadruped trot.py --virtual --physics mujoco:quadruped.xml
  aces run -r hubo2plus walk.py -i socketcan       listens, and sends nothing
  aces run -r hubo2plus walk.py -i socketcan --ask asks, and sends no set-points
  aces run -r hubo2plus walk.py -i socketcan --tx  and now it moves
  aces run -r hubo2plus walk.py --replay walk.blf  what it would have done
  aces run -r minihubo_1 wave.py --virtual --real-time --foxglove
  aces run -r hubo2plus walk.py:knee hold.py --for 10s --log a.mcap:L*,LFFT.fz

A CONTROLLER is a Python file, of which every controller is run (FILE.py:NAME
takes one, or calls a function that makes it), or a file of set-points: a
trajectory or a walking pattern, which is played from where the joints are. A
Python file is executed with your rights: name only what you trust.

The run ends when everything that has an end has been played, after --for, or
with Ctrl-C. Then, always and in this order, motion is stopped, controllers are
ended, buses and logs are closed; --at-end hold leaves the robot standing.
"""

from __future__ import annotations

import argparse

from aces_bus.errors import CallerError

from .live_view import wants_view
from .options import (
    ASK,
    FOR,
    LOOP,
    QUIET,
    RATE,
    TX,
    Arguments,
    Group,
    argument,
    duration,
    flag,
    positive,
    several,
)
from .robot_arg import ACTS, REDUCED, ROBOT_OR_TWINS, at_reduced_speed, chosen_robot

SUMMARY = "run controllers on a robot, simulated, real (--tx) or recorded"

EPILOG = """\
exit status:
  0    done
  1    a controller was stopped or only waited, a device did not answer or was
       NOT switched off, a log is not whole, or closing did not succeed
  2    a wrong call, or a bus that cannot be opened
  130  interrupted before it ran, or twice
"""


USAGE = "%(prog)s -r ROBOT CONTROLLER… [options]"
ARGUMENTS: Arguments = (
    argument("items", nargs="*", metavar="CONTROLLER", help="FILE.py, FILE.py:NAME, or a file of set-points"),
    TX.but(help="really move it; without, set-points are shown and not sent"),
    ASK,
    argument("--replay", metavar="FILE", help="take a recording (CAN) for its buses; nothing is sent"),
    FOR.but(help="run for this time: 10s, 2min (default: to the end)"),
    RATE.but(metavar="HZ", help="of buses, players and logs (default: the robot's)"),
    several(
        "--log",
        metavar="FILE[:STATE,…]",
        help="record states (default: those of the controllers) into .csv, .txt, .db, .parquet, .mcap",
    ),
    REDUCED,
    ACTS.but(
        help="append who did what, a line each: enabled, stopped, limits, e-stop (with --tx and --log: beside the log)"
    ),
    flag("--home", help="make driven joints find their home position first"),
    flag("--unhomed", help="drive joints that are not homed, too: where they say they are, they are not"),
    argument(
        "--no-enable", dest="enable", action="store_false", help="do not enable the driven devices first"
    ),
    several(
        "--on-trip",
        metavar="[KIND[@SOURCE,…]=]REACTION",
        help="what a fault leads to: hold, park (the run ends as with --at-end park), disable, ignore, degrade[:NAME],"
        " or a function of a FILE.py; without KIND, all others (default: disable)",
    ),
    argument(
        "--hold-for",
        dest="hold_ns",
        type=duration,
        metavar="T",
        help="switch off held joints after this time",
    ),
    argument(
        "--at-end",
        choices=("disable", "hold", "park"),
        default="disable",
        help="hold: leave the robot enabled, where it is; park: lead it to the pose of its file first, slowly; Ctrl-C then"
        " stops it (default: disable)",
    ),
    flag(
        "--real-time",
        help="buses: priority SCHED_FIFO where the system allows it; --virtual, --replay: not faster than real",
    ),
    QUIET.but(help="no panel and no lines meanwhile"),
    Group(
        "files of set-points",
        (
            LOOP.but(help="play them this many times; 0: until the end (default: 1)"),
            argument("--speed", type=positive, default=1.0, metavar="X", help="play them X times as fast"),
            argument(
                "--rows-hz", type=positive, metavar="N", help="rows a second, where the file does not say"
            ),
            flag("--degrees", help="they are in degrees, not in rad"),
            several(
                "--rename",
                metavar="COLUMN=JOINT",
                help="play a column on another joint; COLUMN= leaves it out",
            ),
        ),
    ),
    ROBOT_OR_TWINS,
)


def run(arguments: argparse.Namespace) -> int:
    from .running.loading import load_controllers, make_loggers

    if arguments.virtual and arguments.replay:
        raise CallerError("choose one of --virtual and --replay")
    if arguments.virtual and (arguments.bus or arguments.interface):
        raise CallerError("--virtual has no buses; leave --bus and -i away")
    if arguments.replay and arguments.interface:
        raise CallerError(
            "--replay opens no bus; leave -i away (--bus BUS=CHANNEL: the recording's channel of a bus)"
        )
    if arguments.replay and (arguments.tx or arguments.home or arguments.ask):
        raise CallerError("--replay moves nothing; leave --tx, --ask and --home away")
    for what in ("pose", "physics"):
        if getattr(arguments, what) and not arguments.virtual:
            raise CallerError(f"--{what} is for twins: add --virtual, or give it to aces sim")
    robot = at_reduced_speed(chosen_robot(arguments.robot, arguments.driver), arguments.reduced)
    rate = arguments.rate or robot.rate_hz or 100.0
    controllers = load_controllers(arguments.items, robot, rate, arguments)
    if not controllers and not arguments.log and not wants_view("run", arguments):
        raise CallerError("nothing to run: name a controller (FILE.py, a trajectory), or what to --log")
    loggers = make_loggers(arguments.log, controllers, robot, rate)
    from .running.session import Session

    return Session(arguments, robot, controllers, loggers, rate).run()
