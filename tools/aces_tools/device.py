"""Talk to one device, joint or sensor of a robot: read, set, watch, do things.

  aces device -r hubo2plus              its devices, their joints and sensors
  aces device RHY                       what one has: signals, actions
  aces device RHY get                   all its values, once, as others ask
  aces device RHY get --ask             the same, asked for by itself
  aces device RHY get position velocity
  aces device RHY watch position        kept up to date; in a pipe a line each
  aces device RHY home --tx             an action, with its progress
  aces device RHY set position=0.2 --enable --for 3s --tx
  aces device RHY set position=30deg --enable --tx
  aces device RHY set_gains kp=200 ki=0 kd=500 --tx
  aces device RHY stop                  stop it; any program may drive it
  aces device -p dynamixel --bus /dev/ttyUSB0 --id 1 get
                                        one device, without a robot's file
  aces device fuzz RHY --virtual        search for what breaks it ('aces device
                                        fuzz --help')

The robot is that of --robot or of the variable ACES_ROBOT. With --virtual
simulated devices answer, in virtual time, and nothing else is needed. A joint
moves to a position at its nominal speed, within its limits. On real buses
`get` and `watch` listen to what another program asks, unless --ask has them
ask; whatever changes a device needs --tx. A device of -p is asked on a serial
line, which no other program can have; its joint is called 'joint'. One program
of a machine asks and drives on a bus: a second is refused. Values are in SI
units. A joint's name is enough: its device is found. Nothing is sent to other
devices.
"""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from typing import Any

from aces_bus.device import Device, Robot
from aces_bus.device.config import DeviceConfig
from aces_bus.device.config import alone as alone
from aces_bus.errors import CallerError, NotStoppedError, UnknownNameError

from .console import say
from .device_do import Doing, checked, signals_of
from .device_text import parse_pairs
from .devices import show_device, show_devices
from .options import ASK, EVERY, FOR, JSON, TX, Arguments, argument, flag
from .patience import Patience
from .robot_arg import (
    ACTS,
    KIND,
    REDUCED,
    ROBOT_OR_TWINS,
    at_reduced_speed,
    bus_options,
    chosen_kind,
    chosen_pose,
    open_robot,
)

#: The rate of the host where the robot's file says none (Hz).
RATE = 50.0
#: Between two lines of `watch`.
EVERY_NS = 100_000_000
#: What every device can: these ask, and change nothing, but for `set` and `stop`.
VERBS = ("get", "watch", "set", "stop")

SUMMARY = "read, set, watch, enable, home a device; motion only with --tx"

EPILOG = """\
exit status:
  0  done
  1  a value stayed unknown, a set-point was limited or cannot have been
     followed, an action failed or was interrupted, a device was NOT switched
     off at the end, or --tx is missing
  2  a wrong call, or a bus that cannot be opened
"""


USAGE = "%(prog)s [NAME [ACTION] [SIGNAL|NAME=VALUE …]] [options]"
ARGUMENTS: Arguments = (
    argument("name", nargs="?", metavar="NAME", help="a device, joint or sensor of the robot"),
    argument("action", nargs="?", metavar="ACTION", help="get, set, watch, stop, or an action of the device"),
    argument(
        "values", nargs="*", metavar="SIGNAL|NAME=VALUE", help="signals to read; values to set; arguments"
    ),
    TX.but(help="really change something; nothing else makes it"),
    ASK.but(help="get, watch: ask the device; without, only listen to what other programs ask"),
    flag("--enable", help="set: enable the device before, and stop it after"),
    flag("--unhomed", help="set: a joint that is not homed, too: where it says it is, it is not"),
    FOR.but(
        help="set: keep it up for this time (default: until it is there, and 2s); watch: end after this time"
    ),
    EVERY.but(help="watch: between two lines (default: 0.1s)"),
    REDUCED,
    ACTS,
    *KIND,
    JSON.but(help="JSON; watch: an object a line"),
    ROBOT_OR_TWINS,
)


def run(arguments: argparse.Namespace) -> int:
    robot = at_reduced_speed(chosen_kind(arguments, joint=True), arguments.reduced)
    if arguments.protocol is not None:
        _shift(robot, arguments)
    if arguments.name is None:
        return show_devices(robot, arguments.json)
    if arguments.name in VERBS:
        raise CallerError(f"whose? The device comes first: aces device NAME {arguments.name} …")
    action: str | None = arguments.action
    name, signal = _split(robot, arguments.name)
    if signal is not None and action in ("get", "watch"):
        arguments.values.insert(0, signal)
    elif signal is not None:
        raise CallerError(f"{name} is the device: aces device {name} {action or 'get'} {signal} …")
    if action == "stop" and not arguments.virtual:
        from .stop import stop_now

        if arguments.values:
            raise CallerError(f"stop takes no values: aces device {name} stop")
        part_of_robot = alone(robot, config_of(robot, name).name)
        return stop_now(part_of_robot, bus_options(part_of_robot, arguments))
    if action == "fuzz":
        raise CallerError(f"the device comes behind it: aces device fuzz {arguments.name} …")
    config = config_of(robot, name)
    described = described_device(robot, config.name)
    part = None if name == config.name else name
    if action is None:
        return show_device(described, config, signals_of(described, part), arguments.json)
    _check_options(arguments, action)
    every, duration = arguments.every or EVERY_NS, arguments.duration
    values: Any = arguments.values if action in ("get", "watch") else parse_pairs(arguments.values)
    checked(described, part, action, values)
    asks = action in ("get", "watch", "stop") or action in described.asking
    if not asks and not arguments.tx and not arguments.virtual:
        say(f"{action!r} changes {config.name}: nothing was sent; add --tx")
        return 1
    passive = action in ("get", "watch") and not (arguments.ask or arguments.tx)
    with (
        ExitStack() as acts,
        Patience(is_driving=not passive and not arguments.virtual) as patience,
        open_robot(
            alone(robot, config.name),
            arguments,
            rate_hz=robot.rate_hz or RATE,
            passive=passive,
            pose=chosen_pose(robot, arguments.pose),
        ) as live,
    ):
        from aces_bus.robot import ActLog

        from .live import DeviceEventLines

        events = DeviceEventLines(live.rig, robot)
        if arguments.acts is not None:
            acts.enter_context(ActLog(arguments.acts, "aces device").keep(live.rig))
        doing = Doing(live, live.rig.devices[config.name], part, arguments, patience, events)
        try:
            match action:
                case "get":
                    return doing.get()
                case "watch":
                    return doing.watch(every, duration)
                case "set":
                    return doing.set(values, duration)
                case "stop":
                    return doing.stop_twin()
                case _:
                    return doing.act(action, values)
        except NotStoppedError as error:
            events.report(last=True)
            say(str(error))
            return 1
        finally:
            events.report(last=True)


def _shift(robot: Robot, arguments: argparse.Namespace) -> None:
    """Read the words of a call with -p: without a name they are an action and its values, for the only device.

    On a serial line `get` and `watch` ask: nobody else can.
    """
    if arguments.name is not None and len(robot.devices) == 1 and not _is_of(robot, arguments.name):
        words = [arguments.name, *([arguments.action] if arguments.action else []), *arguments.values]
        arguments.name, arguments.action, *arguments.values = next(iter(robot.devices)), *words
    elif arguments.name is None and len(robot.devices) == 1:
        arguments.name = next(iter(robot.devices))
    is_line = all(bus.link == "serial" for bus in robot.buses.values())
    arguments.ask = arguments.ask or (is_line and arguments.action in ("get", "watch"))


def _is_of(robot: Robot, name: str) -> bool:
    """Return whether a word names a device, joint or sensor, or a signal of one."""
    return name.partition(".")[0] in (*robot.devices, *robot.joints, *robot.sensors)


def _check_options(arguments: argparse.Namespace, action: str) -> None:
    """Raise `CallerError` for options without a meaning here."""
    if arguments.enable and action != "set":
        raise CallerError(f"--enable is for 'set', not for {action!r}")
    if arguments.unhomed and action != "set":
        raise CallerError(f"--unhomed is for 'set', not for {action!r}")
    if arguments.duration is not None and action not in ("set", "watch"):
        raise CallerError(f"--for is for 'set' and 'watch', not for {action!r}")
    if arguments.ask and action not in ("get", "watch"):
        raise CallerError(f"--ask is for 'get' and 'watch', not for {action!r}")
    if arguments.every is not None and action != "watch":
        raise CallerError(f"--every is for 'watch', not for {action!r}")


# ---------------------------------------------------------------------- which device


def _split(robot: Robot, name: str) -> tuple[str, str | None]:
    """Split `RHY.position` into the joint and its signal; names of devices may have points themselves."""
    if name in robot.devices or name in robot.joints or name in robot.sensors or "." not in name:
        return name, None
    owner, _, signal = name.partition(".")
    return owner, signal


def config_of(robot: Robot, name: str) -> DeviceConfig:
    """Return the device that is meant by its name, a joint's or a sensor's; raises `UnknownNameError`, `CallerError`."""
    parts: dict[str, Any] = {**robot.sensors, **robot.joints}
    aliases = {alias: part.name for part in parts.values() for alias in part.aliases}
    whole = aliases.get(name, name)
    device = name if name in robot.devices else parts[whole].device if whole in parts else whole
    if device not in robot.devices:
        raise UnknownNameError(f"device, joint or sensor of {robot.name}", name, [*robot.devices, *parts])
    if not robot.devices[device].active:
        raise CallerError(f"{device} is listed as inactive in {robot.name}; set active = true in its file")
    return robot.devices[device]


def described_device(robot: Robot, name: str) -> Device:
    """Return the device, on no bus: what it has can be looked at."""
    from aces_bus.robot import VirtualRobot

    device: Device = VirtualRobot(alone(robot, name)).devices[name]
    return device
