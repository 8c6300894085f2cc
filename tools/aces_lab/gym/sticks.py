"""A mechanism as sticks: a line from each joint to the next, drawn by matplotlib in a fixed view from the right and ahead.

The ground is a grid at the height of what is lowest with all joints at 0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from aces_bus.errors import CallerError
from aces_bus.kinematics.body import Floats
from aces_lab.urdf import Dynamics, UrdfModel

if TYPE_CHECKING:
    from matplotlib.lines import Line2D

#: From where it is looked at (rad): about z from x, and above the ground.
AZIMUTH, ELEVATION = math.radians(-50), math.radians(18)


class Sticks:
    """Pictures of a mechanism. `size` is (width, height) in pixels. Raises `CallerError` without matplotlib."""

    def __init__(self, model: UrdfModel, size: tuple[int, int] = (480, 480)) -> None:
        try:
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure
        except ImportError as error:
            raise CallerError(f"pictures need matplotlib: pip install 'aces-bus[plot]' ({error})") from error
        self.model, self._dynamics = model, Dynamics(model)
        figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100)
        self._canvas: Any = FigureCanvasAgg(figure)
        self._axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._begin()

    def _begin(self) -> None:
        """Fix the view, and draw the ground."""
        at_zero = self._places(np.zeros(len(self.model.moving)))
        middle = (at_zero.min(axis=0) + at_zero.max(axis=0)) / 2
        reach = {self.model.root: 0.0}
        for joint in self.model.order:
            reach[joint.child] = reach[joint.parent] + math.hypot(*joint.origin.xyz)
        half = 1.1 * max(*reach.values(), 1e-3)
        floor, steps = float(at_zero[:, 2].min()), np.linspace(-half, half, 9)
        right, up = _view(middle)
        self._axes.set(xlim=(right - half, right + half), ylim=(up - half, up + half), aspect="equal")
        self._axes.axis("off")
        for way in steps:
            for line in (((way, -half), (way, half)), ((-half, way), (half, way))):
                ends = np.array([(middle[0] + x, middle[1] + y, floor) for x, y in line])
                self._axes.plot(*_view(ends), color="0.85", linewidth=0.8, zorder=0)
        self._lines: list[Line2D] = []

    def _places(self, angles: Floats) -> Floats:
        return np.array([frame[:3, 3] for frame in self._dynamics.frames(angles).values()])

    def picture(self, angles: Mapping[str, float] | Floats) -> npt.NDArray[np.uint8]:
        """Return a pose (rad, m) as (height, width, 3) bytes of red, green and blue."""
        while self._lines:
            self._lines.pop().remove()
        frames = self._dynamics.frames(angles)
        for joint in self.model.order:
            ends = np.array([frames[joint.parent][:3, 3], frames[joint.child][:3, 3]])
            self._lines += self._axes.plot(*_view(ends), color="#1f4e79", linewidth=4, solid_capstyle="round")
            if joint.kind != "fixed":
                self._lines += self._axes.plot(*_view(ends[1]), "o", color="#d9822b", markersize=6, zorder=3)
        self._canvas.draw()
        return np.array(self._canvas.buffer_rgba(), dtype=np.uint8)[:, :, :3].copy()


def _view(places: Floats) -> Floats:
    """Return where places (…, 3) are in the picture: right and up, (2, …), in m."""
    x, y, z = places[..., 0], places[..., 1], places[..., 2]
    c, s = math.cos(AZIMUTH), math.sin(AZIMUTH)
    return np.stack((c * y - s * x, math.cos(ELEVATION) * z - math.sin(ELEVATION) * (c * x + s * y)))
