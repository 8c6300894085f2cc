"""Robots of one kind of device, made of a driver's name and numbers: `aces sim -p feetech --id 1,2`, and twins for tests.

1. With no number it is the first device of the driver's example, as it stands there: its settings and its joints are there.
2. With numbers a device has these, and what the call says; nothing of the example but its bus.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec

from aces_bus.device import Driver, Robot, load_driver
from aces_bus.device.config import Joint
from aces_bus.device.drivers import list_drivers
from aces_bus.errors import AcesError, CallerError, UnknownNameError
from aces_bus.robot import parse_robot
from aces_bus.robot.file import make_robot

#: What may be said of a robot's bus and of its devices.
BUS_KEYS = ("bitrate", "data_bitrate", "baud", "dialect", "half_duplex")
DEVICE_KEYS = ("model", "channels", "kind", "settings")


def driver_of(name: str, *, fd: bool = False) -> Driver:
    """Return the driver of this name, or the only one of a protocol of this name; `fd`: its kin on CAN FD, where it has one.

    Raises `UnknownNameError`, and `CallerError` where several drivers speak the protocol.
    """
    known = list_drivers()
    if fd and f"{name}_fd" in known:
        name = f"{name}_fd"
    if name in known:
        return load_driver(name)
    speakers = [driver for driver in map(load_driver, known) if driver.protocol == name]
    if not speakers:
        raise UnknownNameError("driver or protocol with a driver", name, known)
    if len(speakers) > 1:
        raise CallerError(
            f"{name} is spoken by several kinds of devices; name one: {', '.join(d.name for d in speakers)}"
        )
    return speakers[0]


def robot_of(
    driver: str | Driver, numbers: Mapping[str, Any] | None = None, *, fd: bool = False, **said: Any
) -> Robot:
    """Return a robot of one bus with devices of this driver.

    `numbers` are credentials, each an int, or a sequence of them under its name or its plural (`ids=[1, 2]`); `id` means the
    only credential that the driver has. `said` are keys of a bus or of a device in a robot's file (`BUS_KEYS`,
    `DEVICE_KEYS`). Raises `CallerError` for what it cannot be.
    """
    made = driver if isinstance(driver, Driver) else driver_of(driver, fd=fd)
    example, problems = parse_robot(made.example)
    if example is None:
        raise CallerError(f"driver {made.name}: its example is wrong: {problems[0]}")
    unknown = set(said) - {*BUS_KEYS, *DEVICE_KEYS}
    if unknown:
        raise UnknownNameError(f"option of {made.name}", min(unknown), [*BUS_KEYS, *DEVICE_KEYS])
    first = next(device for device in example.devices.values() if device.driver == made.name)
    if said.get("model"):
        first = next((d for d in example.devices.values() if d.model == said["model"]), first)
    each = list(_credentials(made.name, list(first.credentials), numbers or {}))
    bus = {k: v for k, v in _stated(example.buses[first.bus]).items() if k != "channel"}
    bus |= {key: said[key] for key in BUS_KEYS if said.get(key) is not None}
    if fd and not made.name.endswith("_fd") and bus["link"] != "can":
        raise CallerError(f"{made.name} speaks on a {bus['link']} line, which has no CAN FD")
    devices: dict[str, Any] = {}
    joints: dict[str, Any] = {}
    for place, credentials in enumerate(each, 1):
        own: dict[str, Any] = {"driver": made.name, "bus": made.name}
        if not numbers:
            own |= {k: v for k, v in _stated(first).items() if k not in ("driver", "bus")}
            joints = {joint.name: _stated(joint) for joint in example.joints_of(first.name)}
        elif credentials:
            own["credentials"] = credentials
        own |= {key: said[key] for key in DEVICE_KEYS if said.get(key) is not None}
        devices[first.name if not numbers else f"{made.name.upper()}{place}"] = own
    content = {"name": made.name, "buses": {made.name: bus}, "devices": devices, "joints": joints}
    robot, wrong = make_robot(content, lambda path: ("", 0))
    if robot is None:
        raise CallerError("; ".join(problem.text for problem in wrong if not problem.is_warning))
    return robot


def with_joints(robot: Robot) -> Robot:
    """Return the robot with a joint for each device that has none, where its kind can do without gear and encoder.

    It is called `joint`, or `joint1`, `joint2` …; it has no limits but those of its device, and the door leads it at its
    usual speed.
    """
    from aces_bus.robot import VirtualRobot

    bare = [name for name in robot.devices if not robot.joints_of(name)]
    names = ["joint"] if len(bare) == 1 else [f"joint{place}" for place in range(1, len(bare) + 1)]
    joints = {joint: Joint(name=joint, device=device) for joint, device in zip(names, bare, strict=True)}
    made = msgspec.structs.replace(robot, joints={**robot.joints, **joints})
    try:
        rig = VirtualRobot(made).rig
    except AcesError:  # its driver needs more than that
        return robot
    return made if all(f"{joint}.position" in rig.signals for joint in joints) else robot


def _stated(struct: msgspec.Struct) -> dict[str, Any]:
    """Return what a part of a robot's file says, without what is its default."""
    found: dict[str, Any] = {}
    for field in msgspec.structs.fields(type(struct)):
        value = getattr(struct, field.name)
        if field.name == "name" or value is None or value == {} or value == field.default:
            continue
        found[field.name] = (
            _stated(value) if isinstance(value, msgspec.Struct) else msgspec.to_builtins(value)
        )
    return found


def _credentials(driver: str, names: Sequence[str], numbers: Mapping[str, Any]) -> Iterable[dict[str, int]]:
    """Yield the credentials of each device that the numbers mean."""
    columns: dict[str, list[int]] = {}
    for given, value in numbers.items():
        name = given if given in names else given.removesuffix("s")
        if name == "id" and len(names) == 1:
            name = names[0]
        if name not in names:
            raise UnknownNameError(f"number of a {driver}", given, [*names, *(f"{one}s" for one in names)])
        columns[name] = [value] if isinstance(value, int) else list(value)
    sizes = {len(column) for column in columns.values()}
    if len(sizes) > 1 or 0 in sizes:
        raise CallerError(f"{driver}: {columns} are not as many numbers of each kind")
    missing = [name for name in names if name not in columns]
    if columns and missing:
        raise CallerError(
            f"{driver}: its devices are told apart by {', '.join(names)} too; say {missing[0]}=…"
        )
    return (
        [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        if columns
        else [{}]
    )


__all__ = ["driver_of", "robot_of", "with_joints"]
