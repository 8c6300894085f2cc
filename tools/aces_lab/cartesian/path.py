"""From a Cartesian path to set-points: path → inverse kinematics → joints (the chain that the paper announces).

1. A cycle's angles start from the last cycle's, so the joints go along one branch; a step of a joint larger than
   `largest_step` is not given: the path fails, and the last set-points stay.
2. What is not reached within the tolerance is not given either; `error` and `reason` say by how much and why.
3. Bounded: at most `most_steps` steps of the inverse a cycle.

4. Nothing jumps: where the path begins elsewhere, the joints go to its first angles first, gently and all together.

The motion's names are tip and axis: "LF.x", "LF.y", "LF.z" (m, in the body's frame), and for its orientation "LF.roll",
"LF.pitch", "LF.yaw" (rad; `rotation_of` says which turn comes first). What of a tip the motion does not name is as it is at
the start; so are tips that only `hold` names.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import numpy as np

from aces_bus.controller import ControlEvent, Controller, Limits, Trajectory, ViaPath
from aces_bus.controller.base import NOTHING, known_value
from aces_bus.controller.motion import Motion
from aces_bus.controller.player import GENTLE
from aces_bus.errors import CallerError
from aces_bus.kinematics.body import Body, Floats, Pose, roll_pitch_yaw, rotation_of

from .inverse import Goal, Solution, solve

Orientation = Literal["free", "level", "fixed"]
#: What of a tip a motion may name: its place, then its orientation.
AXES = ("x", "y", "z", "roll", "pitch", "yaw")
#: Joints that are so near (rad) to the path's first angles need no approach.
NEAR = 1e-3


class CartesianPath(Controller):
    """Moves tips of a body along a motion.

    `orientation` by tip that has no path of it: "free", "level" (its z axis up) or "fixed" (as it is at the start; the
    default). `relative`: the motion's values are added to the tips' places at the start and turn their orientations, about
    the body's axes. `locked` joints stay. `approach` "first": the joints go to where the path begins, within `gentle` limits
    (rad/s, rad/s²; of the joints, not along a line of the tips); None: a path that begins elsewhere fails. Lengths m, angles
    rad. `mode` is "waiting" (for joint positions), "approaching", "running", "ended" or "failed".
    """

    def __init__(
        self,
        name: str,
        body: Body,
        motion: Motion,
        *,
        rate_hz: float,
        hold: Iterable[str] = (),
        orientation: Mapping[str, Orientation] | None = None,
        relative: bool = False,
        approach: Literal["first"] | None = "first",
        gentle: Limits = GENTLE,
        locked: Iterable[str] = (),
        tolerance_m: float = 1e-4,
        tolerance_rad: float = 1e-3,
        largest_step: float = 0.2,
        most_steps: int = 30,
    ) -> None:
        self._places: dict[str, list[int | None]] = {}
        for column, label in enumerate(motion.names):
            tip, dot, axis = label.rpartition(".")
            if not dot or axis not in AXES:
                raise CallerError(
                    f"path {name!r}: {label!r} is not a tip and its axis, such as {body.tips[0]}.x or {body.tips[0]}.yaw"
                )
            self._places.setdefault(body.tip(tip), [None] * len(AXES))[AXES.index(axis)] = column
        self.tips = tuple(dict.fromkeys([*self._places, *map(body.tip, hold)]))
        for tip in orientation or {}:
            if tip not in self.tips:
                raise CallerError(f"path {name!r}: {tip!r} has an orientation, but neither a path nor hold")
            if any(column is not None for column in self._places.get(tip, ())[3:]):
                raise CallerError(
                    f"path {name!r}: {tip!r} has a path of its orientation; leave orientation away"
                )
        self._orientation: dict[str, Orientation] = dict.fromkeys(self.tips, "fixed")
        self._orientation.update(orientation or {})
        self.locked = tuple(locked)
        chains = [body.chains[tip] for tip in self.tips]
        used = {
            joint
            for chain in chains
            for joint in (getattr(step, "joint", None) for step in chain.steps)
            if joint
        }
        joints = [joint for joint in body.joints if joint in used]
        moved = [joint for joint in joints if joint not in self.locked]
        super().__init__(name, rate_hz=rate_hz, states=joints, writes=moved)
        self.body, self.motion, self.relative = body, motion, relative
        self.tolerance_m, self.tolerance_rad = tolerance_m, tolerance_rad
        self.largest_step, self.most_steps = largest_step, most_steps
        self.approach, self.gentle = approach, gentle
        self.mode: Literal["waiting", "approaching", "running", "ended", "failed"] = "waiting"
        self.reason = ""
        self.solution: Solution | None = None
        self.error = (0.0, 0.0)
        self._start_poses: dict[str, Pose] = {}
        self._q = np.zeros(len(body.joints))
        self._given: Mapping[str, float] = NOTHING
        self._way: ViaPath | None = None
        self._began = 0

    def start(self, now: int) -> None:
        """Begin a run from the present joint angles."""
        super().start(now)
        self.mode, self.reason, self._given = "waiting", "", NOTHING
        self.started_ns = None

    def begin(self, angles: Mapping[str, float]) -> None:
        """Start from these angles (rad); joints that no tip needs are taken as 0."""
        self._q = np.array([angles.get(joint, 0.0) for joint in self.body.joints])
        self._start_poses = self.body.forward(self._q, self.tips)
        self.mode, self.reason = "running", ""

    def goals(self, seconds: float) -> list[Goal]:
        """Return where the tips are to be, `seconds` after the start."""
        values = self.motion.at(seconds)
        out: list[Goal] = []
        for tip in self.tips:
            here = self._start_poses[tip]
            position = here.position.tolist()
            for axis, column in enumerate(self._places.get(tip, ())[:3]):
                if column is not None:
                    position[axis] = values[column] + (position[axis] if self.relative else 0.0)
            kept = self._orientation[tip]
            turned = self._turned(here.rotation, self._places.get(tip, ())[3:], values)
            if turned is None and kept == "fixed":
                turned = here.rotation
            out.append(Goal(tip, position, turned, level=turned is None and kept == "level"))
        return out

    def _turned(
        self, at_start: Floats, columns: Sequence[int | None], values: Sequence[float]
    ) -> Floats | None:
        """Return a tip's orientation where the motion has one."""
        if all(column is None for column in columns):
            return None
        usual = (0.0, 0.0, 0.0) if self.relative else roll_pitch_yaw(at_start)
        angles = (
            own if column is None else values[column] for own, column in zip(usual, columns, strict=True)
        )
        rotation = rotation_of(*angles)
        return rotation @ at_start if self.relative else rotation

    def solve(self, seconds: float) -> Solution:
        """Return the angles for an instant of the path, near the last ones; raises nothing, says how good they are."""
        return solve(
            self.body,
            self.goals(seconds),
            self._q,
            locked=self.locked,
            tolerance_m=0.1 * self.tolerance_m,
            tolerance_rad=0.1 * self.tolerance_rad,
            most_steps=self.most_steps,
            most_nudges=0 if seconds > 0 else 4,
        )

    def advance(self, seconds: float) -> dict[str, float] | None:
        """Return the set-points for an instant of the path; None when it fails (`reason`)."""
        found = self.solve(seconds)
        self.solution, self.error = found, (found.position_error, found.rotation_error)
        if found.position_error > self.tolerance_m or found.rotation_error > self.tolerance_rad:
            self.mode = "failed"
            limits = f"; at their limits: {', '.join(found.at_limit)}" if found.at_limit else ""
            self.reason = (
                f"{seconds:.3f} s: {found.position_error * 1e3:.2f} mm and {found.rotation_error:.4f} rad "
                f"from the path{limits}"
            )
            return None
        steps = np.abs(found.vector - self._q)
        worst = int(np.argmax(steps))
        if steps[worst] > self.largest_step:
            self.mode = "failed"
            self.reason = f"{seconds:.3f} s: {self.body.joints[worst]} would jump by {steps[worst]:.3f} rad"
            if not self._given:
                self.reason += " (the path begins elsewhere; see relative, or approach='first')"
            return None
        self._q = found.vector
        return {joint: found.angles[joint] for joint in self.writes}

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Return the set-points of this cycle; the last ones again when the path is at its end or has failed."""
        if self.mode == "waiting":
            present = {joint: known_value(self.bound.get(joint)) for joint in self.states}
            self.waiting = ", ".join(joint for joint, value in present.items() if value is None)
            if self.waiting:
                return NOTHING
            self.begin({joint: value for joint, value in present.items() if value is not None})
            self._plan_approach(now_ns)
        if self.mode == "approaching":
            return self._go(now_ns)
        if self.mode != "running":
            return self._given
        seconds = self.seconds(now_ns)
        given = self.advance(min(seconds, self.motion.duration_s))
        if given is None:
            self.listeners.emit(ControlEvent("failed", now_ns, self.name, self.reason))
            return self._given
        self._given = given
        if seconds >= self.motion.duration_s - 1e-9:
            self.mode = "ended"
        return given

    def _plan_approach(self, now: int) -> None:
        """Plan a way to the first angles of the path, unless they are the present ones; out of reach,
        `advance` fails.
        """
        present = self._q
        found = self.solve(0.0)
        apart = np.abs(found.vector - present)
        is_reached = found.position_error <= self.tolerance_m and found.rotation_error <= self.tolerance_rad
        if self.approach is None or apart.max() <= NEAR or not is_reached:
            return
        places = [self.body.index[joint] for joint in self.writes]
        self._way = ViaPath(
            self.writes, [present[places], found.vector[places]], self.gentle, shape="quintic"
        )
        self._q, self._began, self.mode = found.vector, now, "approaching"

    def _go(self, now: int) -> Mapping[str, float]:
        """Lead the joints to where the path begins; it begins at the instant at which the way ends."""
        assert self._way is not None
        seconds = (now - self._began) / 1e9
        if seconds >= self._way.duration_s:
            self.mode, self.started_ns = "running", self._began + round(self._way.duration_s * 1e9)
            return self.step(now)
        self._given = dict(zip(self.writes, self._way.at(seconds), strict=True))
        return self._given

    def to_trajectory(self, angles: Mapping[str, float], *, rate_hz: float | None = None) -> Trajectory:
        """Return the whole path at once, as joint angles, from a start; `CallerError` with the instant where it fails.

        It begins with the path's first row; a `Player` approaches that.
        """
        rate = rate_hz or self.rate_hz
        self.begin(angles)
        if self.approach is not None:
            self._q = self.solve(0.0).vector
        rows: list[list[float]] = []
        for n in range(math.ceil(self.motion.duration_s * rate - 1e-6) + 1):
            given = self.advance(min(n / rate, self.motion.duration_s))
            if given is None:
                raise CallerError(f"path {self.name!r} fails at {self.reason}")
            rows.append([given[joint] for joint in self.writes])
        self.mode = "waiting"
        return Trajectory(self.writes, rows, rate_hz=rate, source=self.name)
