"""Park a robot before it is switched off: its joints go to the pose that its file names, slowly, and under watch.

1. A joint begins at its last commanded target, never where it was measured; one that is further from it, and one of the
   device whose fault it is, is not parked.
2. It moves through the door, no faster than the file says. The first stop of any program or supervisor ends all set-points.
3. The first joint that leaves its set-points or is switched off ends it for all: they are switched off where they are.
4. While it is not known where one of them is, all stand still: answers are late on a busy machine. One that stays unknown
   for `LOST_NS` ends it for all, or is not parked if it had not set out.
5. All of it runs on the clock's thread, once in `PERIOD_NS`; `is_over` only tells.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ..device.device import Device
from ..device.reading import UNKNOWN
from ..errors import AcesError, CallerError
from .rig import Rig

#: Seconds beyond what the way takes at its speed.
MARGIN_S = 2.0
#: Joints are looked at so often (ns), and one of which it is not known where it is has so long to answer.
PERIOD_NS, LOST_NS = 10_000_000, 1_000_000_000
LOST = "it is not known where it is"


class Parking:
    """One way to the pose. Made before the run, so that what it cannot do is known then."""

    def __init__(self, rig: Rig) -> None:
        """Raise `CallerError` if the robot's file names no pose."""
        if rig.robot.park is None:
            raise CallerError(
                f"{rig.robot.name}: its file names no pose to park in: park = {{ pose = {{ JOINT = 0.0 }}, speed = 0.2 }}"
            )
        self.rig, self.park = rig, rig.robot.park
        self.parked: list[str] = []
        self.failed: dict[str, str] = {}
        #: The joints on their way, and their signals; those that have set out; since when it is not known where one is.
        self._moving: dict[str, str] = {}
        self._begun: set[str] = set()
        self._lost: dict[str, int] = {}
        self._is_over = False

    def unable(self, devices: Iterable[Device]) -> dict[str, str]:
        """Return the joints of these devices that cannot be parked, with why."""
        return {joint.name: why for d in devices for joint in d.joints if (why := self._lack(d, joint.name))}

    def _lack(self, device: Device, joint: str) -> str:
        if joint not in self.park.pose:
            return "the pose does not name it"
        if self.rig.robot.joints[joint].command != "position":
            return "it is not commanded by position"
        whole = self.rig.whole(joint)
        return "" if whole in device.readable else "its position is not read"

    def begin(self, left: Mapping[str, str]) -> float:
        """Set out, on the clock's thread, without the devices in `left` (→ why); the seconds that it may take."""
        door, longest = self.rig.door, 0.0
        for device in self.rig.devices.values():
            for joint in device.joints if device.is_driven or device.name in left else ():
                why = left.get(device.name) or self._lack(device, joint.name)
                if not why and (measured := self._measured(device, joint.name)) is not None:
                    why = self._astray(device, joint.name, measured)
                if why:
                    self.failed[joint.name] = why
                    continue
                whole = self._moving[joint.name] = self.rig.whole(joint.name)
                away = abs(self.park.pose[joint.name] - (door.given(whole) or 0.0))
                longest = max(longest, away / self.park.speed)
        self._look()
        return longest + MARGIN_S

    def is_over(self) -> bool:
        """Return whether all have arrived, or it has ended."""
        return self._is_over

    def refuse(self, why: str) -> None:
        """Name every joint that is driven: none of them is parked."""
        driven = (device for device in self.rig.devices.values() if device.is_driven)
        self.failed.update({joint.name: why for device in driven for joint in device.joints})

    def give_up(self, why: str) -> None:
        """Name those that have not arrived."""
        self._is_over = True
        self.failed.update({joint: why for joint in self._moving if joint not in self.parked})

    # ------------------------------------------------------------------ on the clock's thread

    def _measured(self, device: Device, joint: str) -> float | None:
        """Return where a joint is (rad or m); None while that is not known."""
        measured = self.rig[joint].value
        return None if device.is_silent or measured is UNKNOWN else measured

    def _astray(self, device: Device, joint: str, measured: float) -> str:
        """Say why a joint that was measured there does not follow its set-points; "" while it does."""
        signal = self.rig[joint]
        given = self.rig.door.given(signal.name)
        if device.takes(signal) is False:
            return "it is switched off"
        if given is None:
            return "it has no set-point since it was enabled"
        if abs(measured - given) > self.park.within:
            return f"it is at {measured:.3g}, {abs(measured - given):.2g} from its target {given:.3g}"
        return ""

    def _look(self) -> None:
        """Lead the joints on, or have them wait, or end it; and look again."""
        if self._is_over:
            return
        rig, now = self.rig, self.rig.door.clock.now()
        end = f"stopped by {rig.stopped_by}" if rig.stopped_by else rig.door.barred
        was_lost, places = bool(self._lost), dict[str, float]()
        for joint in [] if end else [*self._moving]:
            device = rig.device(joint)
            measured = self._measured(device, joint)
            if measured is None:
                why = LOST if now - self._lost.setdefault(joint, now) > LOST_NS else ""
            else:
                self._lost.pop(joint, None)
                places[joint] = measured
                why = self._astray(device, joint, measured)
            if why and joint not in self._begun:
                self._leave(joint, why)
            elif why:
                end = f"{joint}: {why}"
                break
        if not end and not self._lost:
            end = self._lead(places, is_anew=was_lost)
        elif not end and not was_lost:
            for joint in self._begun:
                rig.door.hold(self._moving[joint])
        if end:
            self.give_up(end)
        self._is_over = self._is_over or len(self.parked) == len(self._moving)
        if not self._is_over:
            rig.door.clock.call_in(PERIOD_NS, self._look)

    def _leave(self, joint: str, why: str) -> None:
        self.failed[joint] = why
        self._lost.pop(joint, None)
        del self._moving[joint]

    def _lead(self, places: Mapping[str, float], *, is_anew: bool) -> str:
        """Give the pose to joints that have not set out, or have waited (`is_anew`); note those that have arrived.

        Return why the way has to end, or "".
        """
        door = self.rig.door
        for joint, whole in list(self._moving.items()):
            if joint not in self._begun or is_anew:
                try:
                    door.pace(whole, self.park.speed)
                    door.writer(whole)(self.park.pose[joint])
                except AcesError as error:
                    if joint in self._begun:
                        return str(error)
                    self._leave(joint, str(error))
                else:
                    self._begun.add(joint)
            elif joint not in self.parked and door.goal(whole) is None:
                if abs(places[joint] - self.park.pose[joint]) <= self.park.within:
                    self.parked.append(joint)
        return ""
