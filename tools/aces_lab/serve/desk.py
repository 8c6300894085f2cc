"""Which program commands which joint of a served robot: one controller, whose set-points clients give.

1. A joint has one owner or none. Set-points of an owner are taken as a whole or not at all, and only for its own joints.
2. Each owned joint has a dead-man (`GivenSetpoints`). An owner that leaves or is silent loses its joints; they stand still:
   positions where they are measured, other set-points at 0.
3. An enabled joint always has a set-point: its owner's, else the one at which it stands. Watchdogs are fed; nothing falls.
4. Handing over changes the owner and not the set-point.

It does no I/O; methods may be called on any thread.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping

from aces_bus.controller import ControlEvent, Controller
from aces_bus.controller.base import NOTHING
from aces_bus.device import Robot
from aces_bus.errors import CallerError
from aces_lab.teleop.given import DEAD_MAN_S, GivenSetpoints, commanded

NAME = "serve"
#: The owner of joints that are led to the pose of the robot's file.
PARKING = "parking"


class Desk(Controller):
    """Gives the set-points of all clients. `live` are the joints that are enabled.

    `is_enabled`: the run enables all joints before it starts. `reacts`: an owner that falls silent or dies is also the fault
    "dead-man", for which the robot's file declares a reaction. `report` gets a sentence about each owner that is lost.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        rate_hz: float,
        is_enabled: bool = True,
        dead_man_s: float = DEAD_MAN_S,
        reacts: bool = False,
        report: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.state_of = commanded(robot)
        if not self.state_of:
            raise CallerError(f"{robot.name} has no active joint: there is nothing to serve")
        states = self.state_of.values()
        super().__init__(
            NAME, rate_hz=rate_hz, states=[name for name in states if "." not in name], writes=states
        )
        self.robot, self.dead_man_s = robot, dead_man_s
        self._is_enabled, self._reacts, self._report = is_enabled, reacts, report
        self._lock = threading.RLock()
        self._now = 0
        #: Joint → the name of its owner.
        self.owners: dict[str, str] = {}
        self.live: set[str] = set()
        self._slots: dict[str, GivenSetpoints] = {}
        #: Owned joints that were given a set-point.
        self._moved: set[str] = set()
        #: Joints that are to stand still from the next step on.
        self._to_stand: set[str] = set()
        #: Joint → the set-point that is given in each step.
        self.wanted: dict[str, float] = {}
        #: Joint → where it is parked.
        self._goals: dict[str, float] = {}

    @property
    def is_idle(self) -> bool:
        """True while no joint has a set-point."""
        return not self.wanted

    # ------------------------------------------------------------------ owners

    def joints(self, names: Iterable[str]) -> list[str]:
        """Return joints by name or alias. Raises `UnknownNameError`, and `CallerError` for none and for one named twice."""
        found = [self.robot.joint(name).name for name in names]
        commanded(self.robot, found)
        if not found or len(set(found)) < len(found):
            raise CallerError("no joint is named, or one is named twice")
        return found

    def of(self, owner: str) -> list[str]:
        """Return the joints of an owner."""
        with self._lock:
            return [joint for joint, other in self.owners.items() if other == owner]

    def own(self, owner: str, names: Iterable[str]) -> None:
        """Give joints that nobody owns to `owner`, all or none of them. Its dead-man runs from now on.

        Raises `CallerError` naming the owner that a joint has.
        """
        with self._lock:
            joints = self.joints(names)
            for joint in joints:
                other = self.owners.get(joint, owner)
                if other != owner:
                    raise CallerError(f"{joint} is owned by {other}, which can hand it over to {owner}")
            for joint in joints:
                if joint not in self.owners:
                    self.owners[joint] = owner
                    self._slots[joint] = self._slot(joint)

    def free(self, owner: str, names: Iterable[str] | None = None) -> None:
        """Have joints of `owner` (None: all) stand still, and nobody own them. Raises `CallerError` as `set`."""
        with self._lock:
            for joint in self.of(owner) if names is None else self._owned(owner, self.joints(names)):
                self._release(joint)

    def lost(self, owner: str, why: str) -> None:
        """Take all joints from an owner that is gone."""
        with self._lock:
            joints = self.of(owner)
            for joint in joints:
                self._release(joint)
            if joints:
                self._say_lost(owner, joints, why)

    def keep(self, owner: str) -> None:
        """Begin the dead-man of all joints of an owner anew."""
        with self._lock:
            for joint in self.of(owner):
                if slot := self._slots.get(joint):
                    slot.give({})

    def set(self, owner: str, values: Mapping[str, float]) -> None:
        """Take set-points (rad, m, or the unit of what the joint takes); other joints of this owner keep theirs.

        Raises `CallerError` for a joint that is not its own, one that is not enabled, and a value that is not finite; then
        nothing is taken.
        """
        with self._lock:
            given = {self.robot.joint(name).name: value for name, value in values.items()}
            for joint in self._owned(owner, given):
                if joint not in self.live:
                    raise CallerError(f"{joint} is not enabled: enable it first")
                self._slots[joint].check({self.state_of[joint]: given[joint]})
            self._moved.update(given)
            for joint in self.of(owner):
                self._slots[joint].give({self.state_of[joint]: given[joint]} if joint in given else {})

    def hand_over(self, owner: str, to: str, names: Iterable[str] | None = None) -> list[str]:
        """Make `to` the owner of joints (None: all) of `owner`, and return them. Their set-points stay, the dead-man begins
        anew. Raises `CallerError` as `set`, and where `owner` owns nothing.
        """
        with self._lock:
            joints = self.of(owner) if names is None else self._owned(owner, self.joints(names))
            if not joints or owner == PARKING:
                raise CallerError(f"{owner} owns no joint that can be handed over")
            for joint in joints:
                self.owners[joint] = to
                self._slots[joint].give({})
            return joints

    def _owned(self, owner: str, joints: Iterable[str]) -> list[str]:
        found = list(joints)
        for joint in found:
            other = self.owners.get(joint)
            if other != owner:
                owned = f"is owned by {other}" if other else "is owned by nobody"
                raise CallerError(f"{joint} {owned}, not by {owner or 'a client without a name'}")
        return found

    def _slot(self, joint: str) -> GivenSetpoints:
        made = GivenSetpoints(joint, [self.state_of[joint]], rate_hz=self.rate_hz, dead_man_s=self.dead_man_s)
        made.bound = self.bound
        made.give({})
        return made

    def _release(self, joint: str) -> None:
        """Have nobody own a joint; what moved it ends, and one that was only owned stays where it is held."""
        self.owners.pop(joint, None)
        self._slots.pop(joint, None)
        if joint in self._moved or self._goals.pop(joint, None) is not None:
            self._to_stand.add(joint)
        self._moved.discard(joint)

    def _say_lost(self, owner: str, joints: list[str], why: str, now: int | None = None) -> None:
        text = f"{owner} {why}: {', '.join(joints)} stand{'s' if len(joints) == 1 else ''} still, owned by nobody"
        self._report(text)
        if self._reacts:
            self.listeners.emit(ControlEvent("dead-man", self._now if now is None else now, NAME, text))

    # ------------------------------------------------------------------ what the robot does as a whole

    def enabled(self, joints: Iterable[str]) -> None:
        """Have joints stand where they are, and take set-points, from now on: they were enabled."""
        with self._lock:
            found = [joint for joint in joints if joint in self.state_of and joint not in self.live]
            self.live.update(found)
            self._to_stand.update(found)

    def drop(self) -> None:
        """Give no set-point any more, and have nobody own anything: the robot is being stopped."""
        with self._lock:
            for table in (self.owners, self._slots, self.wanted, self._goals):
                table.clear()
            for joints in (self.live, self._to_stand, self._moved):
                joints.clear()

    def park(self) -> list[str]:
        """Lead enabled joints to the pose of the robot's file at its speed, whoever owned them, and return them.

        Raises `CallerError` where the file names no pose, or none of its joints is enabled.
        """
        park = self.robot.park
        if park is None:
            raise CallerError(f"{self.robot.name}: its file names no pose to park in")
        with self._lock:
            goals = {
                joint: goal
                for joint, goal in park.pose.items()
                if joint in self.live and "." not in self.state_of[joint]
            }
            if not goals:
                raise CallerError(f"{self.robot.name}: no joint that its file parks is enabled")
            for joint in list(self.owners):
                self._release(joint)
            self._goals = goals
            self.owners.update(dict.fromkeys(goals, PARKING))
            return list(goals)

    # ------------------------------------------------------------------ a controller

    def start(self, now: int) -> None:
        """Prepare to be stepped; joints that the run has enabled stand where they are."""
        super().start(now)
        self._now = now
        if self._is_enabled:
            self.enabled(self.state_of)

    def stop(self, now: int) -> None:
        """End: nobody owns anything."""
        super().stop(now)
        self.drop()

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Return the set-points of all enabled joints."""
        with self._lock:
            self._now = now_ns
            silent: dict[str, list[str]] = {}
            for joint in list(self._to_stand):
                self._stand(joint)
            for joint, slot in list(self._slots.items()):
                for value in slot.step(now_ns).values():
                    self.wanted[joint] = value
                if slot.is_idle:
                    silent.setdefault(self.owners[joint], []).append(joint)
                    self._moved.discard(joint)  # it stands by the step above
                    self._release(joint)
            for owner, joints in silent.items():
                self._say_lost(owner, joints, f"gave no set-points for {self.dead_man_s:g} s", now_ns)
            if self._goals:
                self._lead()
            if not self.wanted:
                return NOTHING
            return {self.state_of[joint]: value for joint, value in self.wanted.items()}

    def _stand(self, joint: str) -> None:
        """Take the set-point at which a joint stands still, once that is known."""
        state = self.state_of[joint]
        value = 0.0 if "." in state else self.known(state)
        if joint not in self.live or value is not None:
            self._to_stand.discard(joint)
        if joint in self.live and value is not None:
            self.wanted[joint] = value

    def _lead(self) -> None:
        """Lead joints by one step of the way to where they are parked."""
        assert self.robot.park is not None
        step = self.robot.park.speed / self.rate_hz
        for joint, goal in list(self._goals.items()):
            if joint in self._to_stand or joint not in self.wanted:  # it is not known yet where it is
                continue
            before = self.wanted[joint]
            self.wanted[joint] = max(before - step, min(before + step, goal))
            if self.wanted[joint] == goal:
                del self._goals[joint]
                self.owners.pop(joint, None)
