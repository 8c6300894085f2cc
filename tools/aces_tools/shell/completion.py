"""Print the script that completes `aces` in a shell: verbs, options, names.

  eval "$(aces completion bash)"                    in ~/.bashrc
  aces completion zsh > ~/.zfunc/_aces              a folder of your fpath
  aces completion fish > ~/.config/fish/completions/aces.fish

Packages of a system, and those in /usr/local, need none of this: the scripts
are installed with aces, below share/, where shells look. Protocols, drivers,
robots, devices and buses are completed by name, those of other packages too.
"""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import entry_points
from importlib.resources import files
from itertools import pairwise

from aces_bus.errors import CallerError

from ..options import Arguments, argument
from . import SCRIPTS

EPILOG = """\
exit status: 0; 2 a wrong call
"""


def run(arguments: argparse.Namespace) -> int:
    if (arguments.shell is None) == (arguments.list is None):
        raise CallerError(f"of which shell? {', '.join(SCRIPTS)}")
    if arguments.list is not None:
        print("".join(f"{name}\n" for name in NAMES[arguments.list](arguments.words)), end="")
        return 0
    print(
        (files("aces_tools.shell") / "files" / SCRIPTS[arguments.shell]).read_text(encoding="utf-8"), end=""
    )
    return 0


# ---------------------------------------------------------------------- names


def _points(group: str) -> Callable[[str], Iterable[str]]:
    return lambda words: sorted({point.name for point in entry_points(group=group)})


def _robots(words: str) -> Iterable[str]:
    from aces_bus.robot import list_robots

    return list_robots()


def _devices(words: str) -> Iterable[str]:
    """Devices, joints and sensors of the robot that the line names, or that $ACES_ROBOT does."""
    from aces_bus.errors import AcesError
    from aces_bus.robot import load_robot

    from ..robot_arg import VARIABLE

    try:
        typed = shlex.split(words)
    except ValueError:  # a quote that is still open
        typed = words.split()
    named = [value for option, value in pairwise(typed) if option in ("-r", "--robot")]
    name = named[-1] if named else os.environ.get(VARIABLE)
    try:
        robot = load_robot(name or "")
    except AcesError:  # not yet typed to its end, or wrong
        return []
    return sorted({*robot.devices, *robot.joints, *robot.sensors})


def _buses(words: str) -> Iterable[str]:
    from ..bus_arg import buses_here

    return buses_here()


#: Kinds of names → those that there are; given is what has been typed so far.
NAMES: Mapping[str, Callable[[str], Iterable[str]]] = {
    "protocols": _points("aces_bus.protocols"),
    "drivers": _points("aces_bus.devices"),
    "robots": _robots,
    "devices": _devices,
    "buses": _buses,
}

ARGUMENTS: Arguments = (
    argument("shell", nargs="?", choices=list(SCRIPTS), metavar="{bash,zsh,fish}", help="the shell"),
    argument(
        "--list", choices=list(NAMES), metavar="KIND", help=f"names, as the scripts ask: {', '.join(NAMES)}"
    ),
    argument(
        "--words", default="", metavar="LINE", help="devices: the line so far, which may name the robot"
    ),
)
