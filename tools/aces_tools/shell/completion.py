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
from importlib.resources import files
from inspect import signature
from itertools import pairwise
from typing import TYPE_CHECKING

from aces_bus.errors import AcesError, CallerError
from aces_bus.plugins import installed_points

from ..main import parser_of
from ..options import Arguments, argument
from ..verbs import actions_of
from . import SCRIPTS

if TYPE_CHECKING:
    from aces_bus.device import Device, Robot

SUMMARY = "print what completes aces in bash, zsh and fish"

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
    return lambda words: sorted({point.name for point in installed_points(group)})


def _robots(words: str) -> Iterable[str]:
    from aces_bus import list_robots

    return list_robots()


def _typed(words: str) -> list[str]:
    """Return the words of a line."""
    try:
        return shlex.split(words)
    except ValueError:  # a quote that is still open
        return words.split()


def _placed(words: str, verb: str) -> list[str]:
    """Return what stands in a verb's places so far, without options, their values, and the word that is being typed."""
    typed = iter(_typed(words if words[-1:].isspace() else words.rpartition(" ")[0])[1 + len(verb.split()) :])
    valued = {
        name
        for argument in parser_of(verb).arguments
        if argument.nargs != 0
        for name in argument.option_strings
    }
    found: list[str] = []
    for word in typed:
        if word in valued:
            next(typed, None)
        elif not word.startswith("-"):
            found.append(word)
    return found


def _robot(words: str) -> Robot | None:
    """Return the robot that the line names, or that $ACES_ROBOT does."""
    from aces_bus.robot.installed import check_robot

    from ..robot_arg import VARIABLE

    named = [value for option, value in pairwise(_typed(words)) if option in ("-r", "--robot")]
    try:
        return check_robot(named[-1] if named else os.environ.get(VARIABLE, ""))[0]
    except AcesError:  # not yet typed to its end, or wrong
        return None


def _devices(words: str) -> Iterable[str]:
    """Return devices, joints and sensors of the robot; for `fuzz --twin` drivers; beside devices what `aces
    device` does else.
    """
    typed, robot = _typed(words), _robot(words)
    is_action = typed[2:3] == ["fuzz"]
    if is_action and "--twin" in typed:
        return NAMES["drivers"](words)
    names = {*robot.devices, *robot.joints, *robot.sensors} if robot is not None else set[str]()
    return sorted(names) + ([] if is_action else list(actions_of("device")))


def _device(words: str) -> tuple[Device, str | None] | None:
    """Return the device of the line, on no bus, and the joint or sensor that is meant."""
    from aces_bus.protocol.files import python_file

    from ..device import config_of, described_device

    placed, robot = _placed(words, "device"), _robot(words)
    if not placed or robot is None or any(python_file(name)[0] for name in robot.protocols):
        return None  # a line that is typed runs no file
    try:
        config = config_of(robot, placed[0])
        return described_device(robot, config.name), None if placed[0] == config.name else placed[0]
    except AcesError:
        return None


def _actions(words: str) -> Iterable[str]:
    """Yield the actions of the device that the line names."""
    from ..device import VERBS

    found = _device(words)
    return [] if found is None else [*VERBS, *found[0].actions]


def _values(words: str) -> Iterable[str]:
    """Return signals to read, signals to set, or arguments of the action of the line."""
    from ..device_do import signals_of

    found, placed = _device(words), _placed(words, "device")
    if found is None or len(placed) < 2:
        return []
    (device, part), action = found, placed[1]
    signals = {signal.name.partition(".")[2]: signal for signal in signals_of(device, part)}
    if action in ("get", "watch"):
        return [name for name, signal in signals.items() if signal.name in device.readable]
    if action == "set":
        return [f"{name}=" for name, signal in signals.items() if signal.is_writable]
    if action not in device.actions:
        return []
    parameters = signature(getattr(device, action)).parameters.values()
    return [
        f"{parameter.name}="
        for parameter in parameters
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
        and not (parameter.name == "joint" and part)
    ]


def _buses(words: str) -> Iterable[str]:
    from ..bus_arg import buses_here

    return buses_here()


#: Kinds of names → those that there are; given is what has been typed so far.
NAMES: Mapping[str, Callable[[str], Iterable[str]]] = {
    "protocols": _points("aces_bus.protocols"),
    "drivers": _points("aces_bus.devices"),
    "robots": _robots,
    "devices": _devices,
    "actions": _actions,
    "values": _values,
    "buses": _buses,
}

ARGUMENTS: Arguments = (
    argument("shell", nargs="?", choices=list(SCRIPTS), metavar="{bash,zsh,fish}", help="the shell"),
    argument(
        "--list", choices=list(NAMES), metavar="KIND", help=f"names, as the scripts ask: {', '.join(NAMES)}"
    ),
    argument("--words", default="", metavar="LINE", help="the line so far, which may name robot and device"),
)
