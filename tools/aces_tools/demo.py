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
import time
from array import array
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from aces_bus.errors import CallerError
from aces_bus.protocol.columns.table import ColumnKind

from .console import say, say_note
from .options import OUTPUT, SEED, Arguments
from .plotting.picture import Picture, PlotLine, PlotPanel
from .plotting.select import ImageFormat, PlotSignal
from .plotting.series import Series, TimeAxis

if TYPE_CHECKING:
    from aces_bus.controller import ViaPath


ROBOT, RATE, SEED_OF_DEMO = "hubo2plus", 200.0, 6
#: The joint that is drawn.
JOINT = "RKN"
PICTURE = "aces-demo.png"
#: How far the knees are bent (rad), one after another; a point that is repeated is a rest. How long each takes (s).
MOVE_S, REST_S = 1.4, 0.7
BENDS = (0.0, 0.9, 0.9, 0.2, 1.3, 1.3, 0.5, 0.9, 0.0, 0.0)

SUMMARY = "a simulated robot follows a trajectory, drawn"

EPILOG = """\
exit status: 0; 1 when the robot did not do it; 2 a wrong call
"""


ARGUMENTS: Arguments = (
    OUTPUT.but(default=PICTURE, help="the picture: .png, .svg, .pdf (default: %(default)s)"),
    SEED.but(default=SEED_OF_DEMO, help="of the simulated devices (default: %(default)s)"),
)


def knee_bends() -> ViaPath:
    """Return knee bends: feet flat and trunk upright, as hip and ankle take half of the knee's angle back each."""
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

    robot = load_robot(ROBOT)
    path = knee_bends()
    player = Player("knee bends", path, rate_hz=RATE)
    log = MemoryLog([JOINT, f"{JOINT}.setpoint"], rate_hz=RATE)
    say_note(
        f"{robot.name} bends its knees for {path.duration_s:.0f} s, simulated with all of its boards and buses …"
    )
    run = run_virtual(robot, [player], rate_hz=RATE, seed=arguments.seed, loggers=[log])
    with run:
        run.do("enable")
        began = time.perf_counter()
        ended = run.run(path.duration_s + 0.5)
        took = time.perf_counter() - began
    joints = sum(joint.active for joint in robot.joints.values())
    frames = sum(wire.load.frames for wire in run.world.wires.values())
    asked, did = log[f"{JOINT}.setpoint"], log[JOINT]
    known = ~(np.isnan(asked) | np.isnan(did))
    furthest = float(np.abs(asked - did)[known].max()) if known.any() else np.nan
    _draw(_picture(log), arguments.output if has_figure else None)
    print(
        f"{robot.name}: {joints} joints on {len(run.rig.devices)} devices, {len(robot.buses)} CAN buses, {frames} frames;"
        f" {ended.seconds:.1f} s in {took:.1f} s"
    )
    print(f"{JOINT}: {len(asked)} cycles at {RATE:g} Hz, furthest from its set-point {furthest:.3f} rad")
    for name, reason in ended.tripped.items():
        say(f"{name} was stopped: {reason}")
    return 1 if ended.tripped or run.missing or not furthest < 0.3 else 0


def _can_draw(path: str) -> bool:
    """Return whether there will be a picture; raises `CallerError` for a path that cannot be one."""
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


def _picture(log: MemoryLog) -> Picture:
    seconds, asked, did = log.seconds, log[f"{JOINT}.setpoint"], log[JOINT]
    return Picture(
        [
            panel_of("right knee", "rad", seconds, {"set-point": (asked, "--"), "actual": (did, "-")}),
            panel_of("actual − set-point", "rad", seconds, {"difference": (did - asked, "-")}),
        ],
        TimeAxis(0, is_set=True),
        "Hubo 2+, simulated: set-point and actual",
    )


def _draw(picture: Picture, path: str | None) -> None:
    from .plotting import figure, terminal

    terminal.print_picture(picture, None, 120, 4)
    if path is not None:
        figure.save_figure(picture, path)
        print(f"the same as a picture: {path}")


# ---------------------------------------------------------------------- a log in memory, and curves of it

Array = npt.NDArray[np.float64]


class MemoryLog:
    """Samples states at a rate, for a `Runner`; `log["RKN"]` is an array, `log.seconds` when (s since the start)."""

    def __init__(self, states: Sequence[str], *, rate_hz: float, name: str = "log") -> None:
        self.name, self.rate_hz, self.states = name, rate_hz, tuple(states)
        self._bound: list[Any] = []
        self._rows = array("d")
        self._began = 0

    def bind(self, states: Mapping[str, Any]) -> None:
        """Take the states; raises `UnknownNameError`."""
        self._bound = [states[name] for name in self.states]

    def start(self, now: int) -> None:
        """Begin anew at `now` (ns)."""
        self._began = now
        self._rows = array("d")

    def step(self, now: int) -> None:
        """Sample once."""
        row = self._rows
        row.append((now - self._began) / 1e9)
        for state in self._bound:
            value = state[0]
            row.append(float(value) if isinstance(value, int | float) else np.nan)

    def stop(self, now: int) -> None:
        """Close nothing."""

    def _table(self) -> Array:
        return np.array(self._rows, np.float64).reshape(-1, 1 + len(self.states))

    @property
    def seconds(self) -> Array:
        """When each sample was taken, in s since the start."""
        return self._table()[:, 0]

    def __getitem__(self, name: str) -> Array:
        """Return the samples of a state."""
        return self._table()[:, 1 + self.states.index(name)]


def panel_of(title: str, unit: str, seconds: Array, curves: Mapping[str, tuple[Array, str]]) -> PlotPanel:
    """Return a panel with these curves, values and line style by label, over one time axis (s)."""
    lines = [
        PlotLine(
            Series(PlotSignal("run", title, label, label, ColumnKind(label, unit)), ()),
            ImageFormat(line=style),
            seconds,
            values,
            label,
        )
        for label, (values, style) in curves.items()
    ]
    return PlotPanel("numbers", [lines], title, [unit], [""], [(None, None)])
