"""Commands of ROS 2 programs as a controller: guard, door, limits and reactions are those of every controller of a run.

1. One writer commands at a time: the first whose command is taken, until it has nothing under way any more. Commands of
   another are refused.
2. The dead-man: joints that are commanded one by one stand still when nothing comes for `DEAD_MAN_S`, and a trajectory when
   its writer leaves. Positions are then held where they are measured, speeds become 0.
3. A command is taken whole or not at all. _Refused are numbers that are not finite, lists of other lengths than the names,
   joints that are unknown or another's, positions outside of a joint's limits, efforts, and stamps further than
   `STAMP_S` from now or older than the writer's last one. A stamp of 0 says "now".

Topics: `/joint_command` (sensor_msgs/JointState: names with positions, or with velocities of joints that take speeds) and
`/joint_trajectory_controller/joint_trajectory` (trajectory_msgs/JointTrajectory), which ros2_control's controller has. A
trajectory begins when it comes, at the first point's time from where its joints are; one without points ends the motion.
Between points it is a cubic where both have velocities, else a line, as in ros2_control (joint_trajectory_controller,
"Trajectory representation").
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from aces_bus.controller import Controller
from aces_bus.controller.base import NOTHING

from .messages import JOINT_STATE, TRAJECTORY, Library

if TYPE_CHECKING:
    from aces_bus.device.config import Joint

    from .view import Ros2View

COMMANDS_TOPIC, TRAJECTORY_TOPIC = "/joint_command", "/joint_trajectory_controller/joint_trajectory"
DEAD_MAN_S = 0.5
#: How far a stamp may be from now (s).
STAMP_S = 0.5
#: A trajectory's points, and its length (s).
MOST_POINTS, MOST_S = 10_000, 600.0
#: Kinds of refusals that are reported.
MOST_REPORTS = 20


class _Refused(Exception):
    """Why a command is not carried out."""


class _Motion:
    """A trajectory on its way: instants (s from its start), positions and velocities by joint."""

    def __init__(
        self,
        names: Sequence[str],
        times: list[float],
        rows: list[list[float]],
        speeds: list[list[float] | None],
    ) -> None:
        self.names, self.times, self.rows, self.speeds = names, times, rows, speeds

    def at(self, seconds: float) -> list[float]:
        """Return the positions at a time from the start; after the end, those of the last point."""
        index = bisect_right(self.times, seconds)
        if index >= len(self.times):
            return self.rows[-1]
        t0, t1 = self.times[index - 1], self.times[index]
        span = t1 - t0
        part = (seconds - t0) / span
        before, after = self.rows[index - 1], self.rows[index]
        v0, v1 = self.speeds[index - 1], self.speeds[index]
        if v0 is None or v1 is None:
            return [a + part * (b - a) for a, b in zip(before, after, strict=True)]
        return [
            a
            + part
            * (span * p + part * (3 * (b - a) - span * (2 * p + q) + part * (2 * (a - b) + span * (p + q))))
            for a, b, p, q in zip(before, after, v0, v1, strict=True)
        ]


class Ros2Commands(Controller):
    """Carries out what comes on the command topics. `taken` counts commands, `refused` by why they were not taken."""

    def __init__(self, view: Ros2View, joints: Mapping[str, Joint], rate_hz: float) -> None:
        positions = [name for name, joint in joints.items() if joint.command == "position"]
        speeds = [name for name, joint in joints.items() if joint.command == "speed"]
        super().__init__(
            "ros2",
            rate_hz=rate_hz,
            states=positions,
            writes=[*positions, *(f"{name}.velocity" for name in speeds)],
        )
        self._view, self._joints = view, dict(joints)
        self._speeds = frozenset(speeds)
        self.taken, self.refused = 0, Counter[str]()
        self._readers = [
            (view.dds.reader(COMMANDS_TOPIC, JOINT_STATE), self._command),
            (view.dds.reader(TRAJECTORY_TOPIC, TRAJECTORY), self._trajectory),
        ]
        #: The writer whose command is under way; the stamp of its last one (ns since 1970).
        self._owner: int | None = None
        self._stamps: dict[int, int] = {}
        #: Until when (ns) what was commanded one by one holds.
        self._until = 0
        self._motion: _Motion | None = None
        self._began = 0
        #: What is given in each step, by state.
        self._wanted: dict[str, float] = {}

    @property
    def is_idle(self) -> bool:
        """True while nobody commands."""
        return self._owner is None

    def start(self, now: int) -> None:
        """Prepare to be stepped; what came before is left out."""
        super().start(now)
        for reader, _ in self._readers:
            while any(True for _ in reader.take()):
                pass

    def stop(self, now: int) -> None:
        """End: nothing is under way."""
        super().stop(now)
        self._release()

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Take what has come, and return the set-points of this cycle."""
        given: dict[str, float] = {}
        for reader, carry_out in self._readers:
            for message, writer in reader.take():
                try:
                    self._accept(message, writer, now_ns)
                    carry_out(message, now_ns)
                except _Refused as refused:
                    self._refuse(str(refused))
                else:
                    self.taken += 1
                    self._owner = writer
        if self._owner is None:
            return NOTHING
        motion = self._motion
        if motion is not None:
            seconds = (now_ns - self._began) / 1e9
            self._wanted = dict(zip(motion.names, motion.at(seconds), strict=True))
            if seconds >= motion.times[-1]:
                given = self._wanted
                self._release()
                return given
        if not self._is_alive(now_ns):
            given = self._standing()
            self._refuse(
                "the writer left" if motion is not None else f"no command for {DEAD_MAN_S:g} s: standing"
            )
            self._release()
            return given
        return dict(self._wanted)

    # ------------------------------------------------------------------ who commands

    def _is_alive(self, now: int) -> bool:
        if self._motion is None:
            return now <= self._until
        return any(self._owner in reader.writers() for reader, _ in self._readers)

    def _release(self) -> None:
        self._owner, self._motion, self._wanted = None, None, {}

    def _standing(self) -> dict[str, float]:
        """Return set-points at which all that moves stands still."""
        found: dict[str, float] = {}
        for name, wanted in self._wanted.items():
            known = self.known(name)
            found[name] = 0.0 if name.endswith(".velocity") else wanted if known is None else known
        return found

    def _refuse(self, why: str) -> None:
        self.refused[why] += 1
        if self.refused[why] == 1 and len(self.refused) <= MOST_REPORTS:
            self._view.report(f"ros2: {why}")
        self._view.status(
            "commands", 1, why, {"taken": str(self.taken), "refused": str(self.refused.total())}
        )

    def _accept(self, message: Library, writer: int, now: int) -> None:
        """Raise `_Refused` for a command of another writer, and for one whose stamp is not of now."""
        if message is None:
            raise _Refused("a message that cannot be read")
        if self._owner not in (None, writer):
            raise _Refused("another writer commands; its motion must end first")
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if not stamp:
            return
        present = now + self._view.epoch_ns
        if abs(present - stamp) > STAMP_S * 1e9:
            raise _Refused(f"a stamp more than {STAMP_S:g} s from now")
        if stamp < self._stamps.get(writer, 0):
            raise _Refused("a stamp older than that of the command before")
        if len(self._stamps) > 64:
            self._stamps.clear()
        self._stamps[writer] = stamp

    # ------------------------------------------------------------------ commands

    def _checked(self, names: Sequence[str]) -> None:
        if not names or len(set(names)) < len(names):
            raise _Refused("no joint is named, or one is named twice")
        for name in names:
            if name not in self._joints:
                raise _Refused(f"joint {name[:80]!r} is not one that is commanded here")

    def _positions(self, names: Sequence[str], values: Sequence[float]) -> list[float]:
        """Return positions within their joints' limits; raise `_Refused`."""
        for name, value in zip(names, _numbers(values, len(names), "positions"), strict=True):
            joint = self._joints[name]
            if joint.command != "position":
                raise _Refused(f"joint {name} takes no positions")
            if not (joint.lower is None or value >= joint.lower) or not (
                joint.upper is None or value <= joint.upper
            ):
                raise _Refused(f"joint {name}: a position outside of its limits")
        return list(values)

    def _command(self, message: Library, now: int) -> None:
        """Take a JointState; raise `_Refused`."""
        names = message.name
        self._checked(names)
        if message.effort:
            raise _Refused("efforts are not taken")
        if message.position and message.velocity:
            raise _Refused("positions and velocities at once: give one of them")
        wanted: dict[str, float]
        if message.velocity:
            speeds = _numbers(message.velocity, len(names), "velocities")
            if other := [name for name in names if name not in self._speeds]:
                raise _Refused(f"joint {other[0]} takes no velocities")
            wanted = {f"{name}.velocity": value for name, value in zip(names, speeds, strict=True)}
        else:
            wanted = dict(zip(names, self._positions(names, message.position), strict=True))
        if self._motion is not None:  # its own trajectory ends
            self._wanted, self._motion = self._standing(), None
        self._wanted.update(wanted)
        self._until = now + round(DEAD_MAN_S * 1e9)

    def _trajectory(self, message: Library, now: int) -> None:
        """Take a JointTrajectory; raise `_Refused`."""
        names, points = message.joint_names, message.points
        if not points:
            self._wanted, self._motion = self._standing(), None
            self._until = now
            return
        self._checked(names)
        if len(points) > MOST_POINTS:
            raise _Refused(f"a trajectory of more than {MOST_POINTS} points")
        times: list[float] = []
        rows: list[list[float]] = []
        speeds: list[list[float] | None] = []
        for point in points:
            if point.effort:
                raise _Refused("efforts are not taken")
            time = point.time_from_start.sec + point.time_from_start.nanosec / 1e9
            if time < 0 or time > MOST_S or (times and time <= times[-1]):
                raise _Refused(f"times of points must rise, from 0 to {MOST_S:g} s")
            times.append(time)
            rows.append(self._positions(names, point.positions))
            speeds.append(_numbers(point.velocities, len(names), "velocities") if point.velocities else None)
            if point.accelerations:
                _numbers(point.accelerations, len(names), "accelerations")
        if times[0] > 0:
            here = [self.known(name) for name in names]
            if None in here:
                raise _Refused(f"joint {names[here.index(None)]}: it is not known where it is")
            times.insert(0, 0.0)
            rows.insert(0, [value for value in here if value is not None])
            speeds.insert(0, None if speeds[0] is None else [0.0] * len(names))
        self._wanted = {}
        self._motion, self._began = _Motion(names, times, rows, speeds), now


def _numbers(values: Sequence[float], number: int, what: str) -> list[float]:
    """Return finite numbers, one for each name; raise `_Refused`."""
    if len(values) != number:
        raise _Refused(f"{what} and names are not of one length")
    if not all(map(math.isfinite, values)):
        raise _Refused(f"{what} that are not finite numbers")
    return list(values)
