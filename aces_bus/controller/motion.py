"""Motions: set-points as a function of time, and the tables that most of them come from.

1. A motion has names, a duration and `at(seconds)`; before its start and after its end it stands still.
2. A `Trajectory` is a table at a fixed rate. At the instant of a row every interpolation gives the row itself.
3. Both are frozen: what changes one gives a new one.

Cubic is Catmull-Rom: through every row, with a continuous velocity, and no further than the neighbours' slopes lead it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from ..errors import CallerError, UnknownNameError
from ..state.errors import raise_first

Interpolation = Literal["hold", "linear", "cubic"]
Floats = npt.NDArray[np.float64]
#: So near a row (in rows) is at it.
NEAR = 1e-5


class Motion(Protocol):
    """Set-points as a function of time."""

    @property
    def names(self) -> tuple[str, ...]:
        """The states, in the order of `at`."""
        ...

    @property
    def duration_s(self) -> float:
        """Seconds from the first to the last value."""
        ...

    @property
    def row_s(self) -> float:
        """Seconds that one row takes; for a motion without rows, what a single step is to take."""
        ...

    def at(self, seconds: float) -> list[float]:
        """Return the values `seconds` after the start."""
        ...


class Trajectory:
    """A table of set-points at a fixed rate.

    `rows`: array (number of rows, number of names), rad (or whatever unit the states have); `rate_hz`: rows a second.

    >>> ramp = Trajectory(["LKP"], [[0.0], [1.0], [0.0]], rate_hz=10)
    >>> ramp.duration_s, ramp.at(0.05), ramp.at(0.1), ramp.at(9)
    (0.2, [0.5], [1.0], [0.0])
    """

    __slots__ = ("_at", "_last", "interpolation", "names", "rate_hz", "rows", "source")

    def __init__(
        self,
        names: Iterable[str],
        rows: Any,
        *,
        rate_hz: float,
        interpolation: Interpolation = "linear",
        source: str = "",
    ) -> None:
        self.names = tuple(names)
        try:
            self.rows: Floats = np.array(rows, dtype=np.float64, ndmin=2)
        except (TypeError, ValueError) as error:
            raise CallerError(
                f"{source or 'trajectory'}: rows are numbers, as many in each: {error}"
            ) from error
        self.rows.setflags(write=False)
        self.rate_hz = float(rate_hz)
        self.interpolation = interpolation
        self.source = source
        where = source or "trajectory"
        double = [name for name in dict.fromkeys(self.names) if self.names.count(name) > 1]
        raise_first(
            CallerError,
            (not 0 < self.rate_hz <= 1e6, f"{where}: rate_hz = {rate_hz!r} is not a rate"),
            (
                self.rows.ndim != 2 or self.rows.shape[1] != len(self.names) or not len(self.rows),
                f"{where}: {len(self.names)} names need rows of as many numbers, not {self.rows.shape}",
            ),
            (bool(double), f"{where}: {', '.join(double)} named twice"),
        )
        if not np.isfinite(self.rows).all():
            row, column = (int(index) for index in np.argwhere(~np.isfinite(self.rows))[0])
            raise CallerError(f"{where}: row {row + 1} of {self.names[column]} is not finite")
        ways: dict[str, Callable[[float], list[float]]] = {
            "hold": self._hold,
            "linear": self._linear,
            "cubic": self._cubic,
        }
        if interpolation not in ways:
            raise UnknownNameError("interpolation", interpolation, ways)
        self._at = ways[interpolation]
        self._last = len(self.rows) - 1

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        where = f" of {self.source}" if self.source else ""
        return f"<Trajectory{where}: {len(self)} rows × {len(self.names)} at {self.rate_hz:g} Hz>"

    @property
    def duration_s(self) -> float:
        """Seconds from the first row to the last."""
        return self._last / self.rate_hz

    @property
    def row_s(self) -> float:
        """Seconds from row to row."""
        return 1.0 / self.rate_hz

    def at(self, seconds: float) -> list[float]:
        """Return the values `seconds` after the first row, interpolated."""
        position = seconds * self.rate_hz
        # A nanosecond of a 200 Hz cycle is 2e-7 of a row: what is that near a row is the row. NaN is before the start.
        if not position > NEAR:
            return self.rows[0].tolist()  # type: ignore[no-any-return]
        if position > self._last - NEAR:
            return self.rows[self._last].tolist()  # type: ignore[no-any-return]
        near = round(position)
        if -NEAR < position - near < NEAR:
            position = float(near)
        return self._at(position)

    def _hold(self, position: float) -> list[float]:
        return self.rows[int(position)].tolist()  # type: ignore[no-any-return]

    def _linear(self, position: float) -> list[float]:
        index = int(position)
        part = position - index
        if not part:
            return self.rows[index].tolist()  # type: ignore[no-any-return]
        return interpolate(self.rows[index].tolist(), self.rows[index + 1].tolist(), part)

    def _cubic(self, position: float) -> list[float]:
        index = int(position)
        u = position - index
        if not u:
            return self.rows[index].tolist()  # type: ignore[no-any-return]
        rows, last = self.rows, self._last
        before, low = rows[max(index - 1, 0)].tolist(), rows[index].tolist()
        high, after = rows[index + 1].tolist(), rows[min(index + 2, last)].tolist()
        # At the ends the difference spans one row, not two.
        left = 1.0 if index == 0 else 0.5
        right = 1.0 if index + 1 == last else 0.5
        square = u * u
        cube = square * u
        h0, h1 = 2 * cube - 3 * square + 1, 3 * square - 2 * cube
        s0, s1 = (cube - 2 * square + u) * left, (cube - square) * right
        return [
            h0 * b + h1 * c + s0 * (c - a) + s1 * (d - b)
            for a, b, c, d in zip(before, low, high, after, strict=True)
        ]

    # ---- other tables of it ----------------------------------------------------------------------------------------

    def _with(self, **changes: Any) -> Trajectory:
        arguments: dict[str, Any] = {
            "names": self.names,
            "rows": self.rows,
            "rate_hz": self.rate_hz,
            "interpolation": self.interpolation,
            "source": self.source,
            **changes,
        }
        return Trajectory(**arguments)

    def interpolated(self, interpolation: Interpolation) -> Trajectory:
        """Return the same rows, joined another way."""
        return self._with(interpolation=interpolation)

    def renamed(self, names: Mapping[str, str]) -> Trajectory:
        """Return the columns under other names (`{"LEB": "LEP"}`); unknown names are ignored: one table
        serves many files.
        """
        return self._with(names=[names.get(name, name) for name in self.names])

    def only(self, names: Iterable[str]) -> Trajectory:
        """Return the trajectory of some columns, in the order asked for."""
        wanted = self._known(names)
        return self._with(names=wanted, rows=self.rows[:, [self.names.index(name) for name in wanted]])

    def _known(self, names: Iterable[str]) -> list[str]:
        """Return the names as a list; raises `UnknownNameError` for one that is not a column."""
        wanted = list(names)
        for name in wanted:
            if name not in self.names:
                raise UnknownNameError("column", name, self.names)
        return wanted

    def without(self, names: Iterable[str]) -> Trajectory:
        """Return all columns but these."""
        gone = set(names)
        return self.only([name for name in self.names if name not in gone])

    def scaled(self, factors: Mapping[str, float]) -> Trajectory:
        """Return the columns times a factor; -1 for a joint that turns the other way."""
        self._known(factors)
        return self._with(rows=self.rows * [factors.get(name, 1.0) for name in self.names])

    def shifted(self, offsets: Mapping[str, float]) -> Trajectory:
        """Return the columns plus an offset."""
        self._known(offsets)
        return self._with(rows=self.rows + [offsets.get(name, 0.0) for name in self.names])

    def mirrored(self, pairs: Mapping[str, str], flipped: Iterable[str] = ()) -> Trajectory:
        """Exchange left and right: each column goes to its pair; columns in `flipped` (by their new name)
        change sign.

        Which joints change sign is a property of a robot's conventions, so it is said, not guessed.
        """
        both = {**{right: left for left, right in pairs.items()}, **pairs}
        names = [both.get(name, name) for name in self.names]
        signs = set(flipped)
        return self._with(names=names, rows=self.rows * [-1.0 if name in signs else 1.0 for name in names])

    def resampled(self, rate_hz: float) -> Trajectory:
        """Return the motion at another rate, by its own interpolation; the last row is kept if it falls on the new grid."""
        count = math.floor(self.duration_s * rate_hz + 1e-6) + 1
        return self._with(rows=[self.at(n / rate_hz) for n in range(count)], rate_hz=rate_hz)

    def rates(self) -> Floats:
        """Return the largest velocity, acceleration and jerk of each column: array (3, names), per s, s², s³, from
        differences.
        """
        out = np.zeros((3, len(self.names)))
        steps: Floats = np.asarray(self.rows)
        for order in range(3):
            steps = np.diff(steps, axis=0) * self.rate_hz
            if not len(steps):
                break
            out[order] = np.abs(steps).max(axis=0)
        return out


def sampled(motion: Motion, rate_hz: float) -> Trajectory:
    """Return any motion as a table, with its last value."""
    count = math.ceil(motion.duration_s * rate_hz - 1e-6) + 1
    return Trajectory(motion.names, [motion.at(n / rate_hz) for n in range(count)], rate_hz=rate_hz)


def smooth_step(u: float) -> float:
    """Return 0 to 1 over 0 ≤ u ≤ 1, without velocity and acceleration at the ends: the quintic 10u³ − 15u⁴ + 6u⁵.

    Its largest velocity is 1.875, its largest acceleration 5.7735, its largest jerk 60.
    """
    if u <= 0.0:
        return 0.0
    if u >= 1.0:
        return 1.0
    return u * u * u * (10.0 + u * (6.0 * u - 15.0))


def interpolate(low: Sequence[float], high: Sequence[float], part: float) -> list[float]:
    """Return the values `part` (0 … 1) of the way."""
    return [a + (b - a) * part for a, b in zip(low, high, strict=True)]
