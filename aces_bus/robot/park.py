"""Park a robot before it is switched off: its joints go to the pose that its file names, slowly, and under watch.

1. A joint begins at its last commanded target, never where it was measured; one that is further from it, and one of the
   device whose fault it is, is not parked.
2. It moves through the door, no faster than the file says. The first stop of any program or supervisor ends all set-points.
3. The first joint that leaves its set-points, goes silent or is switched off ends it for all: they are switched off where
   they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ..device.device import Device
from ..device.reading import UNKNOWN
from ..errors import AcesError, CallerError
from .rig import Rig

#: Seconds beyond what the way takes at its speed.
MARGIN_S = 2.0


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
        self._moving: dict[str, str] = {}

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
                why = why or self._astray(device, joint.name)
                if why:
                    self.failed[joint.name] = why
                else:
                    self._moving[joint.name] = self.rig.whole(joint.name)
        for name, whole in list(self._moving.items()):
            goal, given = self.park.pose[name], door.given(whole)
            try:
                door.pace(whole, self.park.speed)
                door.writer(whole)(goal)
            except AcesError as error:
                self.failed[name] = str(error)
                del self._moving[name]
                continue
            longest = max(longest, abs(goal - (given or 0.0)) / self.park.speed)
        return longest + MARGIN_S

    def _astray(self, device: Device, joint: str) -> str:
        """Say why a joint does not follow its set-points now; "" while it does."""
        signal = self.rig[joint]
        given, measured = self.rig.door.given(signal.name), signal.value
        if device.is_silent or measured is UNKNOWN:
            return "it is not known where it is"
        if device.takes(signal) is False:
            return "it is switched off"
        if given is None:
            return "it has no set-point since it was enabled"
        if abs(measured - given) > self.park.within:
            return f"it is at {measured:.3g}, {abs(measured - given):.2g} from its target {given:.3g}"
        return ""

    def is_over(self) -> bool:
        """Return whether all have arrived, or it has to end."""
        rig, moving = self.rig, self._moving
        end = f"stopped by {rig.stopped_by}" if rig.stopped_by else rig.door.barred
        for joint, whole in moving.items():
            if end:
                break
            why = self._astray(rig.device(joint), joint)
            end = f"{joint}: {why}" if why else ""
            if not why and joint not in self.parked and rig.door.goal(whole) is None:
                if abs(rig[joint].value - self.park.pose[joint]) <= self.park.within:
                    self.parked.append(joint)
        if end:
            self.give_up(end)
        return len(self.parked) == len(moving) or bool(end)

    def refuse(self, why: str) -> None:
        """Name every joint that is driven: none of them is parked."""
        driven = (device for device in self.rig.devices.values() if device.is_driven)
        self.failed.update({joint.name: why for device in driven for joint in device.joints})

    def give_up(self, why: str) -> None:
        """Name those that have not arrived."""
        self.failed.update({joint: why for joint in self._moving if joint not in self.parked})
