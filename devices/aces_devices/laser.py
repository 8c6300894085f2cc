"""Laser scanners that turn: rounds of points, and the nearest of each, for their drivers; a room for their twins."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple

from aces_bus.device import Device, HostLoss

#: Walls of a twin's room in front of, right of, behind and left of the scanner (m); a choice.
WALLS = (3.0, 2.0, 1.5, 2.5)


class Point(NamedTuple):
    """One distance: clockwise angle (rad), distance (m), quality or intensity, as the scanner has it."""

    angle: float
    distance: float
    quality: int


class LaserScanner(Device):
    """Signals of a round: nearest (m), nearest_angle (rad), points, rate (Hz).

    `round` has all points of the last whole round; `on_round` is called with it, on the bus's loop.
    """

    when_host_is_lost = HostLoss("nothing moves", "a sensor; its motor turns on")
    attributes: ClassVar = Device.attributes | {"settings", "round", "on_round"}

    def add_round(self, message: str, stale_s: float, source: str) -> None:
        """Add the signals of a round that `message` fills; for `setup`."""
        self.round: tuple[Point, ...] = ()
        self.on_round: Callable[[tuple[Point, ...]], None] | None = None
        self._points: list[Point] = []
        self._begun: int | None = None
        known: dict[str, Any] = {"read_from": [message], "stale_s": stale_s, "source": source}
        self.add_signal("nearest", unit="m", doc="least distance of the round", **known)
        self.add_signal("nearest_angle", unit="rad", doc="where that is, clockwise from the front", **known)
        self.add_signal("points", doc="distances of the round that were measured", **known)
        self.add_signal("rate", unit="Hz", doc="rounds a second", **known)

    def take_point(self, degrees: float, millimetres: float, quality: int) -> None:
        """Take a point of the round that has begun; a distance of 0 was not measured."""
        if millimetres and self._begun is not None:
            self._points.append(Point(math.radians(degrees), millimetres / 1000, quality))

    def drop_round(self) -> None:
        """Forget the round that has begun: some of it is missing."""
        self._begun, self._points = None, []

    def end_round(self, instant: int) -> None:
        """Take a round that is over, and begin the next."""
        begun, self._begun = self._begun, instant
        points, self._points = tuple(self._points), []
        if begun is None:
            return  # the first one may have begun before we listened
        self.round = points
        values: dict[str, float | None] = {"points": len(points), "rate": 1e9 / max(1, instant - begun)}
        nearest = min(points, key=lambda point: point.distance, default=None)
        values["nearest"] = None if nearest is None else nearest.distance
        values["nearest_angle"] = None if nearest is None else nearest.angle
        for name, value in values.items():
            signal = self.signals[f"{self.name}.{name}"]
            if value is None:
                signal.forget()
            else:
                signal.update(value, instant)
        if self.on_round is not None:
            self.on_round(points)


def distance_in_room(walls: Sequence[float], angle: float) -> float:
    """Return the distance (m) of the walls of a rectangular room at an angle clockwise from the front (rad)."""
    x, y = math.cos(angle), math.sin(angle)
    front, right, back, left = walls
    ways = [(front if x > 0 else back) / abs(x)] if abs(x) > 1e-9 else []
    ways += [(right if y > 0 else left) / abs(y)] if abs(y) > 1e-9 else []
    return min(ways)


__all__ = ["WALLS", "LaserScanner", "Point", "distance_in_room"]
