"""A robot's mechanism as a file of another format: joints, limits, inertias.

  aces robot export arm.toml > arm.urdf       as its body's file and the
                                              limits of its own file have it
  aces robot export minihubo_1 -o body.urdf   from a body that is installed

URDF is the only format yet. Shapes are left out; a body without inertias is
written without. More: docs/urdf.md.
"""

from __future__ import annotations

import argparse

from aces_bus.errors import CallerError
from aces_tools.console import check_suffix, counted, say_note, write_text
from aces_tools.options import OUTPUT, Arguments, argument
from aces_tools.robot_arg import DRIVER_FILES, chosen_robot

SUMMARY = "a robot's mechanism as URDF: joints, limits, inertias"

ARGUMENTS: Arguments = (
    argument(
        "robot",
        nargs="?",
        metavar="ROBOT",
        help="a robot that is installed, or its file (default: $ACES_ROBOT)",
    ),
    argument("--format", choices=["urdf"], default="urdf", help="the format (default: %(default)s)"),
    OUTPUT.but(metavar="FILE.urdf", help="write there (default: standard output)"),
    DRIVER_FILES,
)


def run(arguments: argparse.Namespace) -> int:
    """Write the robot's mechanism; say what it has."""
    from .robots import model_of_robot
    from .write import urdf_text

    check_suffix("--output", arguments.output, ".urdf")
    robot = chosen_robot(arguments.robot, arguments.driver, how="aces robot export NAME or FILE.toml")
    model = model_of_robot(robot)
    lost = [name for name in robot.joints if name not in model.joints]
    if lost and len(lost) == len(robot.joints):
        raise CallerError(
            f"{robot.name}: its body {robot.body} has none of its joints: {', '.join(lost[:6])}"
        )
    if lost:
        say_note(f"not in its body, and left out: {', '.join(lost[:12])}{', …' if len(lost) > 12 else ''}")
    bare = sum(link.inertia is None for link in model.links.values())
    say_note(
        f"{counted(len(model.moving), 'joint')}, {counted(len(model.links), 'link')}"
        + (f", {bare} of them without inertia" if bare else "")
    )
    write_text(arguments.output, urdf_text(model), [], is_quiet=True)
    return 0
