"""Stop a robot that any program drives: at once, confirmed, or named.

  aces stop hubo2plus -i socketcan       all devices of a robot
  aces stop arm.toml                     where its file says where the buses are
  aces stop --bus can0 -i socketcan -p moteus --id 1
  aces stop --bus /dev/ttyUSB0 -p robotis    whatever answers there

Each device gets the stop that its driver declares, as the robot's file has it
(its setting `stop`), and is asked whether it has stopped. What is switched off
falls, where nothing holds it: this is said. Neither --tx nor the bus's lock is
needed. A program that drives the robot is asked to stop it and takes no more
set-points; `aces run` ends. One that is suspended or hangs is passed over.
Without a robot, the variable ACES_ROBOT says which.

This is not a safety function: where people can be hurt, have a switch in the
motors' supply.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from contextlib import ExitStack

from aces_bus import load_protocol
from aces_bus.device import Device, Driver, Robot, load_driver
from aces_bus.device.config import Bus, DeviceConfig
from aces_bus.device.drivers import list_drivers
from aces_bus.errors import AcesError, CallerError, NotStoppedError, UnknownNameError
from aces_bus.protocol.record import PlainValue

from .console import say
from .options import PROTOCOL, Arguments, argument, at_least
from .patience import Patience
from .robot_arg import ROBOT_AND_BUSES, bus_options, check_channels, chosen_robot, use_driver_files

SUMMARY = "stop a robot or device that any program drives; needs no --tx"
#: What a stop leaves of joints, in the order of danger.
LEFT: Mapping[str, str] = {
    "limp": "switched off, and falls where nothing holds it",
    "unknown": "its driver does not say what a stop leaves of it",
    "brakes": "braked to a stand, and may then sink",
    "holds": "held where it is",
}

EPILOG = """\
exit status:
  0  all devices have confirmed that they have stopped
  1  of one it is not confirmed; its name is on stderr
  2  a wrong call
"""

#: What finding devices needs of a call.
DEFAULTS = {"virtual": False}
USAGE = "%(prog)s [ROBOT] [options]"
ARGUMENTS: Arguments = (
    argument(
        "which", nargs="?", metavar="ROBOT", help="a robot that ships, or a file (default: $ACES_ROBOT)"
    ),
    PROTOCOL.but(
        action="store",
        default=None,
        metavar="PROTOCOL|DRIVER",
        help="without a robot: what the devices of the one --bus speak, or their driver",
    ),
    argument(
        "--id",
        dest="number",
        type=at_least(0),
        metavar="N",
        help="with -p: the device of this number (default: all that answer)",
    ),
    ROBOT_AND_BUSES,
)


def run(arguments: argparse.Namespace) -> int:
    if arguments.protocol is None:
        if arguments.number is not None:
            raise CallerError("--id is for -p PROTOCOL; name the robot's devices with aces device NAME stop")
        if arguments.which and arguments.robot:
            raise CallerError("name the robot once: aces stop ROBOT, or -r ROBOT")
        robot = chosen_robot(
            arguments.which or arguments.robot, arguments.driver, how="aces stop ROBOT, --bus … -p PROTOCOL"
        )
    else:
        robot = _robot_on_bus(arguments)
    return stop_now(robot, bus_options(robot, arguments))


def stop_now(robot: Robot, options: Mapping[str, Mapping[str, PlainValue]]) -> int:
    """Stop a robot's devices and say who has stopped; the exit status."""
    from aces_bus.robot import stop_robot

    check_channels(robot, options)

    def begun(leaves: Mapping[str, str]) -> None:
        for left, text in LEFT.items():
            names = [_named(robot, device) for device, leaf in leaves.items() if leaf == left]
            if names:
                say(f"{text}: {', '.join(names)}")

    with Patience() as patience, patience.stopping():
        try:
            stopped = stop_robot(robot, buses=options, begun=begun)
        except NotStoppedError as error:
            for name, why in error.devices.items():
                say(f"NOT confirmed: {_named(robot, name)}: {why}")
            say(f"cut the power of what still moves; not_confirmed={len(error.devices)}")
            return 1
    for bus, who in stopped.by.items():
        say(f"bus {bus}: stopped by {who}, which drives it")
    if not stopped.devices:
        say(f"{robot.name} has no device that can be stopped")
        return 1
    say(f"stopped={len(stopped.devices)} not_confirmed=0", who="")
    return 0


def _named(robot: Robot, device: str) -> str:
    """Return a device with its joints."""
    joints = ", ".join(joint.name for joint in robot.joints_of(device) if joint.active)
    return f"{device} ({joints})" if joints and joints != device else device


# ---------------------------------------------------------------------- without a robot


def _robot_on_bus(arguments: argparse.Namespace) -> Robot:
    """Return the devices that the call names, or that answer, as a robot."""
    if arguments.which or arguments.robot:
        raise CallerError("a robot names the protocols; leave --protocol out")
    if len(arguments.bus) != 1:
        raise CallerError("which bus? One --bus: can0 -i socketcan, unix:can0, /dev/ttyUSB0")
    use_driver_files(arguments.driver)
    name, _, dialect = arguments.protocol.partition(":")
    drivers = _drivers_of(name)
    protocol = load_protocol(drivers[0].protocol)
    protocol.variant(dialect or None)  # raises for one that does not exist
    bus = Bus(
        name="bus",
        link=protocol.link,
        protocol=protocol.name,
        dialect=dialect or None,
        bitrate=protocol.bitrate if protocol.link == "can" else None,
        baud=arguments.baud or protocol.baud if protocol.link == "serial" else None,
    )
    robot = Robot(name=name, buses={"bus": bus}, devices={}, joints={}, sensors={})
    configs = (
        _answering(robot, drivers, arguments)
        if arguments.number is None
        else [_numbered(drivers, arguments.number)]
    )
    devices = {config.name: config for config in configs}
    if not devices:
        raise CallerError(f"no device answers on {arguments.bus[0]}: say which is to be stopped, --id N")
    return Robot(name=name, buses={"bus": bus}, devices=devices, joints={}, sensors={})


def _drivers_of(name: str) -> list[Driver]:
    """Return the driver of this name, or those that stop devices of a protocol. Raises `UnknownNameError`."""
    installed = list_drivers()
    if name in installed:
        return [load_driver(name)]
    drivers: list[Driver] = []
    for driver_name in installed:
        try:
            drivers.append(load_driver(driver_name))
        except AcesError as error:  # a broken driver stops nothing, and keeps no other from it
            say(str(error))
    found = [
        driver
        for driver in drivers
        if driver.protocol == name and driver.device.stop_motion is not Device.stop_motion
    ]
    if not found:
        stop = {driver.protocol for driver in drivers if driver.device.stop_motion is not Device.stop_motion}
        raise UnknownNameError(
            "protocol whose devices can be stopped, or driver", name, sorted({*stop, *installed})
        )
    return found


def _numbered(drivers: Sequence[Driver], number: int) -> DeviceConfig:
    """Return the device of one driver that has this number. Raises `CallerError` where a number does not say which it is."""
    from aces_bus.robot import parse_robot

    if len(drivers) > 1:
        raise CallerError(
            f"which driver? {drivers[0].protocol} has {', '.join(candidate.name for candidate in drivers)}: -p DRIVER"
        )
    driver = drivers[0]
    example, _ = parse_robot(driver.example)
    devices = (
        ()
        if example is None
        else [device for device in example.devices.values() if device.driver == driver.name]
    )
    like = next(iter(devices), None)
    if like is None or len(like.credentials) != 1:
        raise CallerError(
            f"{driver.name}: one number does not say which device; write a robot's file, or leave --id away"
        )
    (credential,) = like.credentials
    return DeviceConfig(
        name=f"{driver.name} {number}",
        driver=driver.name,
        bus="bus",
        credentials={credential: number},
        channels=like.channels,
        kind=like.kind,
    )


def _answering(robot: Robot, drivers: Sequence[Driver], arguments: argparse.Namespace) -> list[DeviceConfig]:
    """Return the devices that answer, found beside the program that drives the bus.

    Raises `CallerError` where they cannot be found.
    """
    from .discover import open_hosts, scan_bus

    able = [driver for driver in drivers if driver.scan is not None]
    if not able:
        raise CallerError(f"{drivers[0].name}: its devices cannot be found: say which, --id N")
    with ExitStack() as stack:
        patience = stack.enter_context(Patience())
        (host,) = open_hosts(robot, arguments, stack, is_locked=False).values()
        return [config for driver in able for config in scan_bus("bus", host, driver, patience) or ()]
