"""A leader and a follower as one robot, and the controller by which the follower goes where the leader is moved.

1. The leader is only read; its joints are no controller's.
2. Joints are paired by name: the leader's has the follower's name, or ends in _ and that name. What has no partner stays.
3. A joint whose leader is not known is not given; when no joint is, the run's dead-man stops the follower.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from aces_bus.controller import Controller
from aces_bus.controller.base import NOTHING
from aces_bus.device import Robot
from aces_bus.errors import CallerError

#: Before names of the leader that the follower has, too.
PREFIX = "leader_"


def joined(leader: Robot, follower: Robot) -> tuple[Robot, dict[str, str]]:
    """Return one robot of what is active of both, and by joint of the follower the leader's. Raises `CallerError`.

    Buses, devices and joints of the leader whose name the follower has, too, begin with `leader_`.
    """
    names: dict[str, str] = {}
    for known, others in ((_used(leader), _used(follower)), (_active(leader), _active(follower))):
        names.update({name: PREFIX + name for name in known if name in others and name not in names})
    replace = msgspec.structs.replace

    def renamed(name: str) -> str:
        return names.get(name, name)

    buses = {name: bus for name, bus in follower.buses.items() if name in _used(follower)}
    buses |= {
        renamed(name): replace(bus, name=renamed(name)) if hasattr(bus, "name") else bus
        for name, bus in leader.buses.items()
        if name in _used(leader)
    }
    devices = {name: device for name, device in follower.devices.items() if device.active}
    devices |= {
        renamed(name): replace(device, name=renamed(name), bus=renamed(device.bus))
        for name, device in leader.devices.items()
        if device.active
    }
    mine = {name: joint for name, joint in follower.joints.items() if joint.active}
    theirs = {
        PREFIX + name if name in mine else name: joint
        for name, joint in leader.joints.items()
        if joint.active
    }
    pairs: dict[str, str] = {}
    for name, joint in mine.items():
        if joint.command != "position":
            continue
        partner = next((other for other in theirs if other.endswith(f"_{name}")), None)
        if partner is not None:
            pairs[name] = partner
    if not pairs:
        raise CallerError(
            f"no joint of {follower.name} ({', '.join(mine)}) has a partner among those of the leader"
            f" ({', '.join(theirs)}): the leader's has the same name, or ends in _ and that name"
        )
    joints = dict(mine)
    for name, joint in theirs.items():
        joints[name] = replace(joint, name=name, device=renamed(joint.device), aliases=())
    together = replace(follower, buses=buses, devices=devices, joints=joints)
    return together, pairs


def _used(robot: Robot) -> list[str]:
    """Return the buses that have active devices."""
    return list(dict.fromkeys(device.bus for device in robot.devices.values() if device.active))


def _active(robot: Robot) -> list[str]:
    """Return the devices that are active."""
    return [name for name, device in robot.devices.items() if device.active]


class Follow(Controller):
    """Gives each joint of the follower where the leader's is (rad, m)."""

    def __init__(self, pairs: Mapping[str, str], rate_hz: float) -> None:
        super().__init__("teleop", rate_hz=rate_hz, states=[*pairs, *pairs.values()], writes=pairs)
        self.pairs = dict(pairs)

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Return the positions of the leader's joints that are known."""
        found = {name: self.known(partner) for name, partner in self.pairs.items()}
        return {name: value for name, value in found.items() if value is not None} or NOTHING
