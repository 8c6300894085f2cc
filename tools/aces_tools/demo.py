"""A robot moves, without one: Hubo 2+ bends its knees in virtual time, drawn.

  aces demo                             draws here, and into aces-demo.png
  aces demo -o knees.svg                the picture elsewhere; .svg, .pdf

A trajectory is played on six joints of the legs at 200 Hz. Set-points go down
through guard, devices, protocol and two simulated CAN buses of 1 Mbit/s to the
simulated boards and motors; encoders come back the same way. Drawn is the
right knee: what was asked for, what it did (the paper's figure 6), and the
difference.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from aces_bus.errors import CallerError

from .console import Output, say, terminal_width, wants_colour

if TYPE_CHECKING:
    from aces_bus.controller import ViaPath

    from .plotting.picture import Picture
    from .running.replay_log import Tape

ROBOT, RATE, SEED = "hubo2plus", 200.0, 6
#: The joint that is drawn.
JOINT = "RKN"
PICTURE = "aces-demo.png"
#: How far the knees are bent (rad), one after another; a point that is repeated is a rest. How long each takes (s).
MOVE_S, REST_S = 1.4, 0.7
BENDS = (0.0, 0.9, 0.9, 0.2, 1.3, 1.3, 0.5, 0.9, 0.0, 0.0)

EPILOG = """\
exit status: 0; 1 when the robot did not do it; 2 a wrong call
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.epilog = EPILOG
    parser.add_argument(
        "--output",
        "-o",
        default=PICTURE,
        metavar="FILE",
        help="the picture: .png, .svg, .pdf (default: %(default)s)",
    )
    parser.add_argument(
        "--seed", type=int, default=SEED, metavar="N", help="of the twins (default: %(default)s)"
    )


def knee_bends() -> ViaPath:
    """Knee bends: feet flat and trunk upright, as hip and ankle take half of the knee's angle back each."""
    from aces_bus.controller import Limits, ViaPath

    names = [side + joint for side in "RL" for joint in ("HP", "KN", "AP")]
    points = [[part * bend for _ in "RL" for part in (-0.5, 1.0, -0.5)] for bend in BENDS]
    rests = [0.0]
    for before, after in pairwise(BENDS):
        rests.append(rests[-1] + (REST_S if before == after else MOVE_S))
    return ViaPath(names, points, Limits(velocity=2.0, acceleration=6.0), times=rests, shape="quintic")


def run(arguments: argparse.Namespace) -> int:
    has_figure = _can_draw(arguments.output)
    from aces_bus import load_robot
    from aces_bus.controller import Player
    from aces_bus.robot import run_virtual

    from .running.replay_log import Tape

    robot = load_robot(ROBOT)
    path = knee_bends()
    player = Player("knee bends", path, rate_hz=RATE)
    tape = Tape([JOINT, f"{JOINT}.setpoint"], rate_hz=RATE)
    say(
        f"{robot.name} bends its knees for {path.duration_s:.0f} s, simulated with all of its boards and buses …"
    )
    run = run_virtual(robot, [player], rate_hz=RATE, seed=arguments.seed, loggers=[tape])
    with run:
        run.do("enable")
        began = time.perf_counter()
        ended = run.run(path.duration_s + 0.5)
        took = time.perf_counter() - began
    joints = sum(joint.active for joint in robot.joints.values())
    frames = sum(wire.load.frames for wire in run.world.wires.values())
    asked, did = tape[f"{JOINT}.setpoint"], tape[JOINT]
    known = ~(np.isnan(asked) | np.isnan(did))
    furthest = float(np.abs(asked - did)[known].max()) if known.any() else np.nan
    _draw(_picture(tape), arguments.output if has_figure else None)
    print(
        f"{robot.name}: {joints} joints on {len(run.rig.devices)} devices, {len(robot.buses)} CAN buses, {frames} frames;"
        f" {ended.seconds:.1f} s in {took:.1f} s"
    )
    print(f"{JOINT}: {len(asked)} cycles at {RATE:g} Hz, furthest from its set-point {furthest:.3f} rad")
    for name, reason in ended.tripped.items():
        say(f"{name} was stopped: {reason}")
    return 1 if ended.tripped or run.missing or not furthest < 0.3 else 0


def _can_draw(path: str) -> bool:
    """Whether there will be a picture; raises `CallerError` for a path that cannot be one."""
    from .plotting import figure

    suffix = os.path.splitext(path)[1].lower()
    if suffix not in figure.SUFFIXES:
        raise CallerError(f"-o {path}: the suffix says the format, one of {', '.join(figure.SUFFIXES)}")
    try:
        figure.load_matplotlib()
    except CallerError:
        say(
            f"no {path}: pictures are drawn by matplotlib: pip install 'aces-bus[plot]'; here is the plot alone"
        )
        return False
    figure.check_output(path)
    return True


def _picture(tape: Tape) -> Picture:
    from .plotting.formats import ImageFormat
    from .plotting.picture import Picture
    from .plotting.series import TimeAxis
    from .running.replay_log import Curve, panel_of

    seconds, asked, did = tape.seconds, tape[f"{JOINT}.setpoint"], tape[JOINT]
    return Picture(
        [
            panel_of(
                "right knee",
                "rad",
                seconds,
                [
                    Curve("set-point", asked, ImageFormat(line="--")),
                    Curve("actual", did, ImageFormat(line="-")),
                ],
            ),
            panel_of(
                "actual − set-point",
                "rad",
                seconds,
                [Curve("difference", did - asked, ImageFormat(line="-"))],
            ),
        ],
        TimeAxis(0, is_set=True),
        "Hubo 2+, simulated: set-point and actual",
    )


def _draw(picture: Picture, path: str | None) -> None:
    from .plotting import terminal

    output = Output(None)
    paint: Any = terminal.make_plot_paint() if wants_colour(None, output.is_terminal) else None
    height = None
    if output.is_terminal:
        try:
            height = os.get_terminal_size(sys.stdout.fileno()).lines - 4
        except (OSError, ValueError, AttributeError):
            pass
    text = terminal.draw_terminal(
        picture, min(terminal_width(), 120), paint=paint, height=height, encoding=output.encoding
    )
    output.write(text.encode(output.encoding, "replace"))
    output.close()
    if path is not None:
        from .plotting import figure

        figure.save_figure(picture, path)
        print(f"the same as a picture: {path}")
