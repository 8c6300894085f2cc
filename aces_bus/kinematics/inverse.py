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

from ..errors import CallerError, UnknownNameError
from .body import Angles, Body, Floats, Pose, Slide, Turn

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
    """The rotation from `now` to `goal` as a vector in the base: axis times angle (0 … π)."""
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
    """The smallest turn that makes the tip's z axis the base's, its two components in the base's x and y."""
    x, y, z = now[:, 2].tolist()
    sine = math.hypot(x, y)
    if sine < 1e-12:
        return np.array((0.0, 0.0) if z > 0 else (math.pi, 0.0))
    factor = math.atan2(sine, z) / sine
    return np.array((y * factor, -x * factor))


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
        joints = {step.joint for chain in chains for step in chain.steps if isinstance(step, (Turn, Slide))}
        self.moving: Mask = np.array([joint in joints for joint in body.joints])

    def _error(self, pose: Pose, goal: tuple[str, Floats | None, Floats | None, bool]) -> list[Floats]:
        _, position, rotation, level = goal
        parts: list[Floats] = []
        if position is not None:
            parts.append(position - pose.position)
        if rotation is not None:
            parts.append(self.weight * rotation_error(rotation, pose.rotation))
        elif level:
            parts.append(self.weight * level_error(pose.rotation))
        return parts

    def error(self, q: Floats) -> Floats:
        poses = self.body.forward(q, [goal[0] for goal in self.goals])
        return np.concatenate([part for goal in self.goals for part in self._error(poses[goal[0]], goal)])

    def error_and_jacobian(self, q: Floats) -> tuple[Floats, Floats]:
        errors: list[Floats] = []
        rows: list[Floats] = []
        for goal in self.goals:
            pose, jacobian = self.body.pose_and_jacobian(q, goal[0])
            errors += self._error(pose, goal)
            if goal[1] is not None:
                rows.append(jacobian[:3])
            if goal[2] is not None:
                rows.append(self.weight * jacobian[3:])
            elif goal[3]:
                rows.append(self.weight * jacobian[3:5])
        return np.concatenate(errors), np.concatenate(rows)

    def worst(self, q: Floats) -> tuple[float, float]:
        """The largest position error (m) and rotation error (rad) of any goal."""
        poses = self.body.forward(q, [goal[0] for goal in self.goals])
        position = rotation = 0.0
        for tip, where, turned, level in self.goals:
            if where is not None:
                position = max(position, float(np.linalg.norm(where - poses[tip].position)))
            if turned is not None:
                rotation = max(rotation, float(np.linalg.norm(rotation_error(turned, poses[tip].rotation))))
            elif level:
                rotation = max(rotation, float(np.linalg.norm(level_error(poses[tip].rotation))))
        return position, rotation


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
    """Angles that bring the tips to their goals, near `start`.

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
    best, best_norm = q, math.inf
    steps = nudges = 0
    if body.posture is not None and _is_singular(task, q, free, (tolerance_m, tolerance_rad)):
        # Which way a straight knee bends would be left to rounding.
        nudges, steps = 1, 1
        q = np.where(free, _nudged(body, q, 0.15, task.moving), q)
    reason = "too many steps"
    converged = False
    while steps < most_steps:
        q, taken, converged = _descend(task, q, free, (tolerance_m, tolerance_rad), most_steps - steps)
        steps += taken
        norm = float(np.linalg.norm(task.error(q)))
        if norm < best_norm:
            best, best_norm = q, norm
        if converged:
            break
        if nudges >= most_nudges:
            reason = "stuck: out of reach, or held back by limits"
            break
        nudges += 1
        q = np.where(free, _nudged(body, best, 0.15 * nudges, task.moving), best)
        steps += 1
    position, rotation = task.worst(best)
    at = (best <= body.lower) | (best >= body.upper)
    return Solution(
        dict(zip(body.joints, best.tolist(), strict=True)),
        best,
        converged,
        position,
        rotation,
        steps,
        nudges,
        tuple(joint for joint, here in zip(body.joints, at.tolist(), strict=True) if here),
        "" if converged else reason,
    )


def _is_singular(task: _Task, q: Floats, free: Mask, tolerances: tuple[float, float]) -> bool:
    """Whether the start is away from its goals and cannot move in every direction that they ask for."""
    position, rotation = task.worst(q)
    if position <= tolerances[0] and rotation <= tolerances[1]:
        return False
    jacobian = task.error_and_jacobian(q)[1] * free
    values = np.linalg.eigvalsh(jacobian @ jacobian.T)
    return bool(values[0] < 1e-6 * values[-1])


def _nudged(body: Body, q: Floats, part: float, moving: Mask) -> Floats:
    """A little towards the posture; without one, by a pattern that is no symmetry of any robot (golden section).

    Only joints that move one of the tips take part.
    """
    if body.posture is not None:
        away = body.posture - q
        moved = q + part * np.where(np.abs(away) > 1e-3, away, 0.0)
    else:
        moved = q + part * (np.modf(0.618034 * np.arange(1, len(q) + 1))[0] - 0.3)
    return np.where(moving, np.clip(moved, body.lower, body.upper), q)


def _descend(
    task: _Task, q: Floats, free: Mask, tolerances: tuple[float, float], most: int
) -> tuple[Floats, int, bool]:
    """Steps until it converges or nothing helps: angles, number of steps, whether it converged."""
    body, damping = task.body, 1e-4
    error, jacobian = task.error_and_jacobian(q)
    square = float(error @ error)
    for step in range(most):
        # A weighed error below both tolerances is enough to look closer.
        if square < (tolerances[0] + task.weight * tolerances[1]) ** 2 * len(error):
            position, rotation = task.worst(q)
            if position <= tolerances[0] and rotation <= tolerances[1]:
                return q, step, True
        push = jacobian.T @ error
        blocked = ((q >= body.upper) & (push > 0)) | ((q <= body.lower) & (push < 0))
        j = jacobian * (free & ~blocked)
        if float(np.abs(j.T @ error).max()) < 1e-12 * max(1.0, math.sqrt(square)) or square == 0.0:
            return q, step, False
        gram = j @ j.T
        trial, fine = q, False
        for _ in range(12):
            delta = j.T @ np.linalg.solve(gram + damping * damping * np.eye(len(error)), error)
            largest = float(np.abs(delta).max())
            if largest > 0.5:  # further than the Jacobian can be believed
                delta *= 0.5 / largest
            trial = np.where(free, np.clip(q + delta, body.lower, body.upper), q)
            new = task.error(trial)
            if float(new @ new) < square:
                fine = True
                break
            damping = max(damping, 1e-6) * 8
        if not fine:
            return q, step, False
        damping = max(damping * 0.2, 1e-9)
        q = trial
        error, jacobian = task.error_and_jacobian(q)
        now = float(error @ error)
        if now > square * (1 - 1e-6) and now > 1e-20:
            return q, step + 1, False  # crawling
        square = now
    position, rotation = task.worst(q)
    return q, most, position <= tolerances[0] and rotation <= tolerances[1]
