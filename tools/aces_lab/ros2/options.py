"""`--ros2` of run, sim and sniff: what the command sees for ROS 2 programs, and with `--ros2-commands` what they command.

1. Commands need two words: `--ros2-commands`, and `--tx` on real buses; DDS asks nobody who he is.
2. Who else can see it is said in any case.
"""

from __future__ import annotations

import argparse
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from aces_bus.errors import CallerError
from aces_tools.console import say, say_note
from aces_tools.options import Arguments, argument, flag, several

if TYPE_CHECKING:
    from .view import Ros2View

ARGUMENTS: Arguments = (
    flag(
        "--ros2",
        help="publish joint states, sensors and diagnostics for ROS 2 programs of this machine; needs 'aces-bus[ros2]'",
    ),
    argument("--domain", type=int, metavar="N", help="with --ros2: the domain, ROS_DOMAIN_ID (default: 0)"),
    flag("--ros2-commands", help="with --ros2: take trajectories and commands of joints (run, with --tx)"),
    argument("--ros2-bag", metavar="FILE.mcap", help="with --ros2: write all that is published, as a bag"),
    argument(
        "--ros2-interface", metavar="NAME", help="with --ros2: this network interface in place of loopback"
    ),
    several("--ros2-peer", metavar="HOST", help="with --ros2-interface: a machine that is looked for there"),
)
_OTHERS = ("domain", "ros2_commands", "ros2_bag", "ros2_interface", "ros2_peer")


def is_wanted(arguments: argparse.Namespace) -> bool:
    """Return whether the call says `--ros2`. Raises `CallerError` for words that do not go together."""
    if not arguments.ros2:
        for word in _OTHERS:
            if getattr(arguments, word) not in (None, False, []):
                raise CallerError(f"--{word.replace('_', '-')} is for --ros2: add it")
    elif arguments.ros2_commands:
        if not hasattr(arguments, "replay"):
            raise CallerError("--ros2-commands is for aces run: sim and sniff command nothing")
        if arguments.replay or not (arguments.tx or arguments.virtual):
            raise CallerError("--ros2-commands moves a robot: add --tx, or --virtual for its twins")
    return bool(arguments.ros2)


@contextmanager
def open_view(arguments: argparse.Namespace, name: str) -> Generator[Ros2View]:
    """Open the view. Raises `CallerError` for a missing extra, and a domain or bag that cannot be had."""
    from .view import Ros2View

    view = Ros2View(
        arguments.domain or 0,
        interface=arguments.ros2_interface or "",
        peers=arguments.ros2_peer,
        name=name,
        bag=arguments.ros2_bag,
        commands=arguments.ros2_commands,
        report=say,
    )
    try:
        place = view.dds.interface or "loopback"
        say_note(
            f"ros2: domain {view.dds.domain}, {place}{', takes commands' if arguments.ros2_commands else ''}"
        )
        if view.dds.interface:
            say(
                f"ros2: every program that {place} reaches sees it: nothing is encrypted, and there is no log-in"
            )
            if arguments.ros2_commands:
                say("ros2: and every such program can move the robot")
        yield view
    finally:
        view.close()
        (say if view.dropped else say_note)(str(view))
