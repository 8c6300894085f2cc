"""Which robot a command works on, and where its buses are: the options that `device`, `discover`, `sim` and `run` share.

    --robot hubo2plus                    a robot that ships, or FILE.toml; or the variable ACES_ROBOT
    --bus lower=can0 --bus upper=can1    where its buses are (default: what the file says)
    --bus servos=/dev/ttyUSB0            a serial line; HOST:PORT for datagrams
    -i socketcan                         python-can's interface of its CAN buses
    -i aces                              those that `aces sim` serves: can0 is unix:can0
    --virtual                            no bus at all: its twins, here, in virtual time
    --driver fan.py                      drivers that are in a file of yours, and not installed

1. Nothing is opened before everything else about the call is known to be right.
2. What a bus says when it cannot be opened becomes one line, with the bus's name and what to write.
"""

from __future__ import annotations

import argparse
import math
import os
import re
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from aces_bus.errors import AcesError, CallerError, UnknownNameError
from aces_bus.hardware.served.address import ServedAddress
from aces_bus.protocol.record import PlainValue

from .bus_arg import near_buses, served_address
from .options import SEED, Argument, Group, argument, at_least, flag, several

if TYPE_CHECKING:
    from aces_bus.device import Robot
    from aces_bus.robot import VirtualRobot
    from aces_bus.robot.rig import Rig
    from aces_bus.runtime.clock import EventClock

VARIABLE = "ACES_ROBOT"


def _numbers(text: str) -> list[int]:
    """Read numbers with commas, decimal or hexadecimal. Raises `ValueError`."""
    return [int(part, 0) for part in text.split(",")]


#: What names devices of one kind in place of a robot.
KIND: tuple[Argument, ...] = (
    argument(
        "-p",
        "--protocol",
        metavar="DRIVER",
        help="devices of one kind in place of a robot: a name of `aces devices`, or a protocol that one of them speaks",
    ),
    argument(
        "--id",
        type=_numbers,
        metavar="N[,N]",
        help="with -p: their numbers (default: as the driver's example)",
    ),
    argument("--model", metavar="MODEL", help="with -p: which model"),
    flag("--fd", help="with -p: the kind that speaks CAN FD, where there are two"),
)
DRIVER_FILES = several(
    "--driver",
    metavar="FILE.py",
    help="use the drivers, twins and protocols of a Python file, too; it is run with your rights",
)
_TITLE = "the robot and its buses"
#: What `sim` takes, and the others.
ROBOT_AND_BUSES = Group(
    _TITLE,
    (
        argument(
            "-r",
            "--robot",
            metavar="NAME|FILE",
            help=f"a robot that ships, or a file; protocols in Python below its folder are run (default: ${VARIABLE})",
        ),
        several(
            "--bus",
            metavar="NAME=CHANNEL",
            help="where a bus is: can0, unix:can0, /dev/ttyUSB0, HOST:PORT (default: what the file says)",
        ),
        argument("-i", "--interface", metavar="INTERFACE", help="python-can's, of its CAN buses"),
        DRIVER_FILES,
        argument(
            "--baud", type=at_least(1), metavar="N", help="speed of its serial lines (default: the file's)"
        ),
    ),
)
POSE = several(
    "--pose", metavar="JOINT=ANGLE", help="where a twin's joint is at first: 0.3 (rad, m) or 20deg"
)
PHYSICS = argument(
    "--physics",
    metavar="NAME[:MODEL]",
    help="what the twins' motors move, such as mujoco:quadruped.xml, or none (default: as the robot's file says)",
)
ROBOT_OR_TWINS = Group(
    _TITLE,
    (
        *ROBOT_AND_BUSES.arguments,
        flag("--virtual", help="on no bus: with simulated devices (twins), here, in virtual time"),
        SEED.but(help="of the twins (default: %(default)s)"),
        POSE,
        PHYSICS,
    ),
)
REDUCED = flag("--reduced", help="at the reduced speed that the robot's file states")
#: Where what is done is written.
ACTS = argument(
    "--acts", metavar="FILE", help="append who did what, a line each: enabled, stopped, limits, e-stop"
)


def at_reduced_speed(robot: Robot, is_wanted: bool) -> Robot:
    """Return the robot at its reduced speed, where that is wanted; raises `CallerError` where its file states none."""
    if not is_wanted:
        return robot
    if robot.reduced is None:
        raise CallerError(
            f"--reduced: the file of {robot.name} states no reduced speed: [reduced] scale = 0.25"
        )
    return replace(robot, reduced=replace(robot.reduced, active=True))


def use_driver_files(paths: Sequence[str]) -> None:
    """Have the drivers of these files beside those that are installed; raises as `use_driver_file`."""
    if paths:
        from aces_bus.device.drivers import use_driver_file

        for path in paths:
            use_driver_file(path)


def chosen_robot(
    name: str | None, driver_files: Sequence[str] = (), *, how: str = "--robot NAME or FILE.toml"
) -> Robot:
    """Return the robot of a name, a file or the variable, whose drivers may be in files. `how` says how one is named.

    Raises `CallerError` when there is none, `RobotError` for a bad file.
    """
    use_driver_files(driver_files)
    from aces_bus import list_robots, load_robot

    wanted = name or os.environ.get(VARIABLE)
    if not wanted:
        raise CallerError(f"which robot? {how}, or the variable {VARIABLE} ({', '.join(list_robots())})")
    return load_robot(wanted)


def chosen_kind(arguments: argparse.Namespace, *, joint: bool = False) -> Robot:
    """Return the robot that the call names, or one of the devices of `-p` (`KIND`).

    `joint`: devices that are given by number have a joint, where their kind needs to know no gear or encoder for it. Raises
    as `chosen_robot` and `robot_of`.
    """
    if arguments.protocol is None:
        for word in ("id", "model", "fd"):
            if getattr(arguments, word):
                raise CallerError(f"--{word} is of the devices of one kind: say which, such as -p moteus")
        return chosen_robot(arguments.robot, arguments.driver)
    from .one_kind import robot_of, with_joints

    if arguments.robot:
        raise CallerError("-p in place of --robot, not beside it")
    use_driver_files(arguments.driver)
    numbers = {"id": arguments.id} if arguments.id else {}
    robot = robot_of(arguments.protocol, numbers, fd=arguments.fd, model=arguments.model)
    return with_joints(robot) if joint else robot


def chosen_pose(robot: Robot, texts: Sequence[str]) -> dict[str, float]:
    """Return where `--pose` puts joints (rad, m); raises `CallerError` for what is no joint's angle."""
    found: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        degrees = value.removesuffix("deg")
        try:
            angle = float(degrees)
        except ValueError:
            angle = math.nan
        if not math.isfinite(angle):
            raise CallerError(
                f"--pose {text}: write JOINT=ANGLE, such as {next(iter(robot.joints), 'RHP')}=20deg"
            )
        found[robot.joint(name).name] = angle if degrees == value else math.radians(angle)
    return found


def bus_options(robot: Robot, arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Return by bus what the call says of it; raises `UnknownNameError` for a bus that the robot has not."""
    found: dict[str, dict[str, Any]] = {name: {} for name in robot.buses}
    for text in arguments.bus:
        name, equals, channel = text.partition("=")
        if not equals and len(robot.buses) == 1:
            name, channel = next(iter(robot.buses)), text
        if name not in robot.buses:
            raise UnknownNameError(f"bus of {robot.name}", name, robot.buses)
        if not channel:
            raise CallerError(f"--bus {text}: say where it is, such as {name}=can0")
        found[name]["channel"] = channel
    for name, bus in robot.buses.items():
        channel = str(found[name].get("channel", ""))
        if bus.link == "can" and ServedAddress.is_served(channel):
            found[name]["interface"] = "aces"
        elif bus.link == "can" and arguments.interface:
            found[name]["interface"] = arguments.interface
            if (
                arguments.interface == "aces"
                and not channel
                and bus.channel
                and not ServedAddress.is_served(bus.channel)
            ):
                # A virtual bus within this program would have no other node on it.
                found[name]["channel"] = f"unix:{bus.channel}"
        elif bus.link == "can" and channel and not bus.interface and (address := served_address(channel)):
            found[name].update(interface="aces", channel=address)
        if bus.link == "serial" and arguments.baud:
            found[name]["baud"] = arguments.baud
    return found


@dataclass
class Opened:
    """A robot whose buses are open. `virtual` is None on real buses."""

    robot: Robot
    rig: Rig
    clock: EventClock
    virtual: VirtualRobot | None


@contextmanager
def open_robot(
    robot: Robot,
    arguments: argparse.Namespace,
    *,
    rate_hz: float | None,
    rules: Mapping[str, Any] | None = None,
    passive: bool = False,
    pose: Mapping[str, float] | None = None,
) -> Generator[Opened]:
    """Yield the robot on its buses, or in virtual time with its twins; closed again at the end. `passive`: real buses
    are only listened to. `pose` is where twins are at first.

    Raises `CallerError` naming the bus that cannot be opened.
    """
    physics = getattr(arguments, "physics", None)  # a verb without twins has no such option
    if arguments.virtual:
        from aces_bus.robot import VirtualRobot

        if arguments.bus or arguments.interface:
            raise CallerError("--virtual has no buses; leave --bus and -i away")
        seed = arguments.seed
        with VirtualRobot(robot, rate_hz=rate_hz, seed=seed, rules=rules, pose=pose, physics=physics) as made:
            yield Opened(robot, made.rig, made.clock, made)
        return
    if pose or physics:
        what = "pose" if pose else "physics"
        raise CallerError(f"--{what} is for twins: add --virtual, or give it to aces sim")
    options = bus_options(robot, arguments)
    check_channels(robot, options)
    from aces_bus.robot import connect, open_gates
    from aces_bus.runtime.loop import Loop

    with ExitStack() as stack:
        loop = stack.enter_context(Loop())
        ports = open_gates(robot, loop, options, passive=passive)
        rig = connect(robot, ports, rate_hz=rate_hz, rules=rules, passive=passive)
        stack.callback(rig.close)
        for name, host in rig.hosts.items():
            open_host(name, host, channel_of(robot, name, options))
        yield Opened(robot, rig, loop, None)


def channel_of(robot: Robot, name: str, options: Mapping[str, Mapping[str, Any]]) -> str | None:
    """Return where a bus is: what the call says, else the robot's file."""
    return options[name].get("channel") or robot.buses[name].channel


def check_channels(robot: Robot, options: Mapping[str, Mapping[str, PlainValue]]) -> None:
    """Raise `CallerError` unless the channel of each bus with active devices is known."""
    examples = {"can": "can0", "serial": "/dev/ttyUSB0"}
    for name in dict.fromkeys(config.bus for config in robot.devices.values() if config.active):
        if channel_of(robot, name, options) is None:
            example = examples.get(robot.buses[name].link, "HOST:PORT")
            raise CallerError(
                f"bus {name}: where is it? The robot's file does not say: --bus {name}={example}, or --virtual"
            )


def open_host(name: str, station: Any, channel: str | None) -> None:
    """Open a host or twins; raises `CallerError` for whatever opening raises."""
    try:
        station.open()
    except AcesError:
        raise
    except Exception as error:  # whatever a backend or the system may raise
        said = " ".join(str(error).split()) or type(error).__name__
        more = f" ({near_buses(channel)})" if channel and NO_INTERFACE in said else ""
        raise CallerError(f"bus {name} ({channel}) cannot be opened: {_clearer(said)}{more}") from error


#: python-can, where nothing says which of its interfaces a channel is of.
NO_INTERFACE = 'Unknown interface type "None"'
INTERFACE_HELP = (
    "which interface? -i socketcan for one, -i aces for those of `aces sim` (also CAN_INTERFACE, or"
    " interface = in the robot's file)"
)
#: What backends say when they cannot open a bus, and what helps.
_SAYINGS = (
    (re.compile(NO_INTERFACE), INTERFACE_HELP),
    (re.compile(r"\[Errno \d+\] could not open port \S+ \[Errno \d+\] ([^:]+):.*"), r"\1"),
    (re.compile(r"\[Errno \d+\] (Address family not supported.*)"), r"\1: this system has no SocketCAN"),
    (
        re.compile(r"(unix:\S+: no server answers .*); start one: aces bus serve"),
        r"\1; start one: aces sim -r ROBOT, or aces bus serve",
    ),
)


def _clearer(said: str) -> str:
    """Return what a backend says, without what says nothing, and with what helps."""
    for pattern, instead in _SAYINGS:
        found = pattern.fullmatch(said)
        if found:
            return found.expand(instead)
    return said
