"""Inverse kinematics: damped least squares within joint limits, with a report.

1. The answer never leaves the limits, and never says `converged` unless its forward kinematics agrees within the tolerances.
2. Deterministic: no random restart. A start that is stuck (straight legs, a wrong bend) is nudged towards the body's
   `posture`, a little more each time.
3. What is not reached is answered with the nearest pose that was found and the reason; nothing raises but a wrong call.

Theory: the step is Δq = Jᵀ(JJᵀ + λ²I)⁻¹e over the joints that are free to move (one at a limit that would be pushed outwards
is not); λ falls while steps help and grows when one does not (Levenberg, Marquardt). Position and rotation errors are
weighed by `rotation_weight`, metres to a radian.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.kinematics.body import Angles, Body, Floats, Prismatic, Revolute

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Goal:
    """Where a tip is to be: `position` (m) or None for anywhere; `rotation` (3, 3) or None.

    `level` asks for the tip's z axis to be the base's (a sole flat on the ground), whatever its heading.
    """

    tip: str
    position: Sequence[float] | Floats | None = None
    rotation: Floats | Sequence[Sequence[float]] | None = None
    level: bool = False


@dataclass(frozen=True)
class Solution:
    """The answer: `angles` by joint and as `vector`, and how good it is.

    `position_error` m and `rotation_error` rad are the largest of any goal; `steps` were taken, `nudges` got it unstuck;
    `at_limit` are joints at a limit. `reason` says why it has not converged.
    """

    angles: dict[str, float]
    vector: Floats
    converged: bool
    position_error: float
    rotation_error: float
    steps: int
    nudges: int
    at_limit: tuple[str, ...]
    reason: str = ""


def rotation_error(goal: Floats, now: Floats) -> Floats:
    """Return the rotation from `now` to `goal` as a vector in the base: axis times angle (0 … π)."""
    r = goal @ now.T
    skew = 0.5 * np.array((r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]))
    sine = float(np.linalg.norm(skew))
    cosine = 0.5 * (float(np.trace(r)) - 1.0)
    if sine > 1e-7:
        return skew * (math.atan2(sine, cosine) / sine)
    if cosine > 0:
        return skew
    # Half a turn: the axis is the largest column of r + 1.
    column = (r + np.eye(3))[:, int(np.argmax(np.diag(r)))]
    return column * (math.pi / float(np.linalg.norm(column)))


def level_error(now: Floats) -> Floats:
    """Return the smallest turn that makes the tip's z axis the base's, its two components in the base's x and y."""
    x, y, z = now[:, 2].tolist()
    sine = math.hypot(x, y)
    if sine < 1e-12:
        return np.array((0.0, 0.0) if z > 0 else (math.pi, 0.0))
    factor = math.atan2(sine, z) / sine
    return np.array((y * factor, -x * factor))


@dataclass(frozen=True)
class _Look:
    """Where angles lead: the weighed errors, their Jacobian and squared sum, the largest errors (m, rad)."""

    q: Floats
    error: Floats
    jacobian: Floats
    square: float
    position_error: float
    rotation_error: float

    def is_within(self, position: float, rotation: float) -> bool:
        """Return whether every goal is met."""
        return self.position_error <= position and self.rotation_error <= rotation


class _Task:
    """The goals as one error vector and its Jacobian."""

    def __init__(self, body: Body, goals: Sequence[Goal], weight: float) -> None:
        self.body, self.weight = body, weight
        self.goals: list[tuple[str, Floats | None, Floats | None, bool]] = []
        for goal in goals:
            body.tip(goal.tip)
            position = None if goal.position is None else np.array(goal.position, dtype=np.float64)
            rotation = None if goal.rotation is None else np.array(goal.rotation, dtype=np.float64)
            if position is not None and (position.shape != (3,) or not np.isfinite(position).all()):
                raise CallerError(
                    f"the goal of {goal.tip} needs three finite numbers (m), not {goal.position!r}"
                )
            if rotation is not None and (
                rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
            ):
                raise CallerError(f"the goal of {goal.tip} needs a rotation matrix (3, 3)")
            if position is None and rotation is None and not goal.level:
                raise CallerError(f"the goal of {goal.tip} asks for nothing")
            self.goals.append((goal.tip, position, rotation, goal.level and rotation is None))
        if not self.goals:
            raise CallerError("no goal")
        chains = [body.chains[tip] for tip, *_ in self.goals]
        joints = {
            step.joint for chain in chains for step in chain.steps if isinstance(step, (Revolute, Prismatic))
        }
        self.moving: Mask = np.array([joint in joints for joint in body.joints])

    def look(self, q: Floats) -> _Look:
        """Return errors and Jacobian for angles."""
        errors: list[Floats] = []
        rows: list[Floats] = []
        far = turned = 0.0
        for tip, position, rotation, level in self.goals:
            pose, jacobian = self.body.pose_and_jacobian(q, tip)
            if position is not None:
                error = position - pose.position
                far = max(far, float(error @ error))
                errors.append(error)
                rows.append(jacobian[:3])
            if rotation is not None or level:
                error = (
                    level_error(pose.rotation)
                    if rotation is None
                    else rotation_error(rotation, pose.rotation)
                )
                turned = max(turned, float(error @ error))
                errors.append(self.weight * error)
                rows.append(self.weight * (jacobian[3:5] if rotation is None else jacobian[3:]))
        all_errors = np.concatenate(errors)
        return _Look(
            q,
            all_errors,
            np.concatenate(rows),
            float(all_errors @ all_errors),
            math.sqrt(far),
            math.sqrt(turned),
        )


def solve(
    body: Body,
    goals: Iterable[Goal],
    start: Angles,
    *,
    locked: Iterable[str] = (),
    tolerance_m: float = 1e-7,
    tolerance_rad: float = 1e-6,
    most_steps: int = 200,
    most_nudges: int = 4,
    rotation_weight: float = 0.1,
) -> Solution:
    """Return angles that bring the tips to their goals, near `start`.

    `locked` joints keep their angle. Bounded: at most `most_steps` steps in all. See `Solution` for the report.
    """
    task = _Task(body, list(goals), rotation_weight)
    free = np.ones(len(body.joints), dtype=bool)
    for joint in locked:
        if joint not in body.index:
            raise UnknownNameError(f"joint of {body.name}", joint, body.joints)
        free[body.index[joint]] = False
    q = body.vector(start)
    if not np.isfinite(q).all():
        raise CallerError(f"{body.name}: the start must be finite angles")
    q = np.where(free, np.clip(q, body.lower, body.upper), q)
    best, least = q, math.inf
    steps = nudges = 0
    here = task.look(q)
    if body.posture is not None and _is_singular(here, free, (tolerance_m, tolerance_rad)):
        # Which way a straight knee bends would be left to rounding.
        nudges, steps = 1, 1
        here = task.look(np.where(free, _nudged(body, q, 0.15, task.moving), q))
    reason = "too many steps"
    converged = False
    while True:
        here, taken = _descend(task, here, free, (tolerance_m, tolerance_rad), most_steps - steps)
        steps += taken
        if here.square < least:
            best, least = here.q, here.square
        converged = here.is_within(tolerance_m, tolerance_rad)
        if converged or steps >= most_steps:
            best = here.q if converged else best
            break
        if nudges >= most_nudges:
            reason = "stuck: out of reach, or held back by limits"
            break
        nudges += 1
        steps += 1
        here = task.look(np.where(free, _nudged(body, best, 0.15 * nudges, task.moving), best))
    look = here if best is here.q else task.look(best)
    at = (best <= body.lower) | (best >= body.upper)
    return Solution(
        dict(zip(body.joints, best.tolist(), strict=True)),
        best,
        converged,
        look.position_error,
        look.rotation_error,
        steps,
        nudges,
        tuple(joint for joint, here in zip(body.joints, at.tolist(), strict=True) if here),
        "" if converged else reason,
    )


def _is_singular(here: _Look, free: Mask, tolerances: tuple[float, float]) -> bool:
    """Return whether the start is away from its goals and cannot move in every direction that they ask for."""
    if here.is_within(*tolerances):
        return False
    jacobian = here.jacobian * free
    values = np.linalg.eigvalsh(jacobian @ jacobian.T)
    return bool(values[0] < 1e-6 * values[-1])


def _nudged(body: Body, q: Floats, part: float, moving: Mask) -> Floats:
    """Return a little towards the posture; without one, by a pattern that is not a symmetry of any robot (golden section).

    Only joints that move one of the tips take part.
    """
    if body.posture is not None:
        away = body.posture - q
        moved = q + part * np.where(np.abs(away) > 1e-3, away, 0.0)
    else:
        moved = q + part * (np.modf(0.618034 * np.arange(1, len(q) + 1))[0] - 0.3)
    return np.where(moving, np.clip(moved, body.lower, body.upper), q)


def _descend(
    task: _Task, here: _Look, free: Mask, tolerances: tuple[float, float], most: int
) -> tuple[_Look, int]:
    """Step until every goal is met or no step helps; return the last look and the number of steps."""
    body, damping = task.body, 1e-4
    for step in range(most):
        if here.is_within(*tolerances):
            return here, step
        q, error = here.q, here.error
        push = here.jacobian.T @ error
        blocked = ((q >= body.upper) & (push > 0)) | ((q <= body.lower) & (push < 0))
        moving = free & ~blocked
        if float(np.abs(push * moving).max()) < 1e-12 * max(1.0, math.sqrt(here.square)):
            return here, step
        j = here.jacobian * moving
        gram = j @ j.T
        for _ in range(12):
            damped = gram.copy()
            damped.flat[:: len(error) + 1] += damping * damping
            delta = j.T @ np.linalg.solve(damped, error)
            largest = float(np.abs(delta).max())
            if largest > 0.5:  # further than the Jacobian can be believed
                delta *= 0.5 / largest
            # `delta` of a joint that is not free is 0, but its angle may lie outside of the limits.
            inside = np.minimum(np.maximum(q + delta, body.lower), body.upper)
            trial = task.look(np.where(free, inside, q))
            if trial.square < here.square:
                break
            damping = max(damping, 1e-6) * 8
        else:
            return here, step
        damping = max(damping * 0.2, 1e-9)
        crawls = trial.square > here.square * (1 - 1e-6) and trial.square > 1e-20
        here = trial
        if crawls:
            return here, step + 1
    return here, most
