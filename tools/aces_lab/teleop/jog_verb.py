"""Move the joints of a robot one by one, from the keyboard or a gamepad.

  aces jog -r hubo2plus --virtual          twins, at the pace of real time
  aces jog -r so101 gripper wrist_roll --tx
  aces jog -p dynamixel --id 1 --bus /dev/ttyUSB0 --speed 0.2 --tx
  aces jog -r so101 --gamepad --tx         needs 'aces-bus[gamepad]'

keys: → l + and ← h - move the chosen joint while they are held; ↓ j Tab and
↑ k choose another; blank stops; q ends. A terminal does not report that a key
was let go: motion ends 0.15 s after its last repeat.
gamepad: hold the left shoulder button, and tilt the left stick up or down; the
cross chooses. Letting go of either stops, and so does losing the gamepad.

A joint moves at --speed, within its limits. It runs as 'aces run' does, and
ends as it does: the joints are switched off, or held with --at-end hold.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Generator
from contextlib import contextmanager

from aces_bus.device import Robot
from aces_bus.errors import CallerError
from aces_tools.console import say_note
from aces_tools.options import Arguments, argument, positive
from aces_tools.robot_arg import KIND, at_reduced_speed, chosen_kind
from aces_tools.run import ARGUMENTS as OF_RUN

from .given import commanded
from .verb import arguments_of_run

SUMMARY = "move joints one by one from the keyboard or a gamepad; with --tx"
USAGE = "%(prog)s [JOINT …] [options]"
#: Speed of a joint (rad/s, m/s), unless its file's largest is lower.
USUAL_SPEED = 0.25
ARGUMENTS: Arguments = (
    argument(
        "joints", nargs="*", metavar="JOINT", help="which joints (default: all that take positions or speeds)"
    ),
    argument(
        "--speed",
        type=positive,
        default=USUAL_SPEED,
        metavar="V",
        help="how fast: rad/s, m/s (default: %(default)s, or the joint's largest)",
    ),
    argument(
        "--gamepad",
        nargs="?",
        const="",
        metavar="PATH",
        help="by a gamepad: /dev/input/event3 (default: the first)",
    ),
    *KIND,
    *arguments_of_run(OF_RUN, ("items", "--replay", "--ask")),
)
DEFAULTS: dict[str, object] = {"items": [], "replay": None, "ask": False}


def run(arguments: argparse.Namespace) -> int:
    from aces_tools.running.loading import make_loggers
    from aces_tools.running.session import Session

    from .jog import GamepadReader, Jog, KeyReader, open_gamepad

    robot = at_reduced_speed(chosen_kind(arguments, joint=True), arguments.reduced)
    if arguments.virtual and (arguments.bus or arguments.interface):
        raise CallerError("--virtual has no buses; leave --bus and -i away")
    if arguments.pose and not arguments.virtual:
        raise CallerError("--pose is for twins: add --virtual")
    rate = arguments.rate or robot.rate_hz or 100.0
    jog = Jog(*_chosen(robot, arguments), rate_hz=rate)
    arguments.real_time = arguments.real_time or arguments.virtual
    loggers = make_loggers(arguments.log, [jog], robot, rate)

    def chose(joint: str) -> None:
        say_note(f"{joint}")

    session = Session(arguments, robot, [jog], loggers, rate, verb="jog")
    session.is_ended = lambda: jog.is_over
    if arguments.gamepad is not None:
        pad = open_gamepad(arguments.gamepad)
        say_note(f"{jog.chosen}; hold the left shoulder button and tilt the left stick; the cross chooses")
        with GamepadReader(pad, jog, chose):
            return session.run()
    if sys.stdin is None or not sys.stdin.isatty():
        raise CallerError("aces jog reads keys: standard input must be a terminal, or --gamepad")
    say_note(f"{jog.chosen}; ← → move, ↑ ↓ choose, blank stops, q ends")
    with _single_keys(sys.stdin.fileno()), KeyReader(sys.stdin.fileno(), jog, chose):
        return session.run()


def _chosen(robot: Robot, arguments: argparse.Namespace) -> tuple[dict[str, str], dict[str, float]]:
    """Return by joint its state and its speed. Raises `UnknownNameError`, `CallerError`."""
    wanted = arguments.joints or [
        joint.name
        for joint in robot.joints.values()
        if joint.active and joint.command in ("position", "speed")
    ]
    states = commanded(robot, wanted)
    for name in states:
        if robot.joints[name].command not in ("position", "speed"):
            raise CallerError(
                f"{name} is commanded by {robot.joints[name].command}: jog moves positions and speeds"
            )
    largest = {name: robot.joints[name].max_speed for name in states}
    return states, {name: min(arguments.speed, most or arguments.speed) for name, most in largest.items()}


@contextmanager
def _single_keys(file: int) -> Generator[None]:
    """Have a terminal report each key at once, and not show it."""
    import termios
    import tty

    before = termios.tcgetattr(file)
    try:
        tty.setcbreak(file)
        yield
    finally:
        termios.tcsetattr(file, termios.TCSADRAIN, before)
