"""Put a robot's simulated devices on a bus, for programs and people to talk to.

  aces sim hubo2plus                    serves its buses and stands on them;
                                        others join: -i aces -c unix:can0
  aces sim minihubo_1                   its serial line is a pseudo-terminal
  aces sim hubovia --bus pc=127.0.0.1:12000      datagrams are received there
  aces sim hubo2plus --bus lower=unix:left       served under another name, or
                                        joined where that is served already
  aces sim hubo2plus -i socketcan --bus lower=can0 --bus upper=can1
                                        on buses that are there
  aces sim robot.toml --fault JMC3:silent --fault JMC1:late=0.2
  aces sim hubo2plus --list-faults      how its devices can misbehave

The devices answer as the real ones do, and nothing moves before a program says
so. On buses of others they transmit: they answer what they are asked.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

from aces_bus.errors import CallerError, UnknownNameError

from .console import say
from .live import LivePatience, parse_duration
from .robot_arg import add_robot_arguments, bus_options, chosen_robot

if TYPE_CHECKING:
    from aces_bus.device import Robot

    from .sim_stand import SimulatedRobot

EPILOG = """\
exit status: 0; 2 a wrong call, or a bus that cannot be served or opened
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.epilog = EPILOG
    parser.add_argument("robot", nargs="?", metavar="NAME|FILE", help="a robot that ships, or a file")
    add_robot_arguments(parser, named=False, virtual=False)
    add = parser.add_argument
    add(
        "--fault",
        action="append",
        default=[],
        metavar="DEVICE:FAULT[=AMOUNT]",
        help="have a device misbehave; * for all; may be said more than once",
    )
    add("--list-faults", action="store_true", help="how the devices can misbehave")
    add("--seed", type=int, default=0, metavar="N", help="of noise and chance (default: 0)")
    add("--for", dest="duration", metavar="DURATION", help="end after so long (default: Ctrl-C)")
    add("--json", action="store_true", help="the buses, and at the end the counts, as JSON")


def run(arguments: argparse.Namespace) -> int:
    robot = chosen_robot(arguments.robot)
    if arguments.list_faults:
        return _list_faults(robot, arguments.json)
    duration = None if arguments.duration is None else parse_duration("--for", arguments.duration)
    faults = [parse_fault(robot, text) for text in arguments.fault]
    options = bus_options(robot, arguments)
    from .sim_stand import SimulatedRobot

    with ExitStack() as stack:
        patience = stack.enter_context(LivePatience())
        stand = SimulatedRobot(robot, options, arguments.seed, stack)
        for names, fault, amount in faults:
            for name in names:
                stand.simulation[name].fault(fault, amount)
        stack.callback(_summary, stand, arguments.json)  # however it ends
        _announce(robot, arguments.robot, stand, arguments.json)
        end = None if duration is None else time.monotonic_ns() + duration
        while not patience.is_over and (end is None or time.monotonic_ns() < end):
            following = time.monotonic_ns() + 500_000_000
            patience.wait_until(following if end is None else min(following, end))
    return 0


# ---------------------------------------------------------------------- faults


def parse_fault(robot: Robot, text: str) -> tuple[list[str], str, float | None]:
    """`JMC3:late=0.1` as devices, fault and amount; raises `UnknownNameError` for what there is not."""
    device, colon, rest = text.partition(":")
    fault, equals, amount = rest.partition("=")
    if not colon or not fault or (equals and not amount):
        raise CallerError(
            f"--fault {text}: write DEVICE:FAULT[=AMOUNT], such as JMC3:silent or JMC3:late=0.2"
        )
    active = [name for name, config in robot.devices.items() if config.active]
    names = active if device == "*" else [device]
    if not set(names) <= set(active):
        raise UnknownNameError(f"device of {robot.name}", device, active)
    able = [name for name in names if fault in fault_names(robot, name)]
    if not able:
        raise UnknownNameError(f"fault of {names[0]}", fault, fault_names(robot, names[0]))
    try:
        return able, fault, float(amount) if amount else None
    except ValueError:
        raise CallerError(f"--fault {text}: {amount!r} is no number") from None


def fault_names(robot: Robot, device: str) -> dict[str, str]:
    """How a device can misbehave: name → what it does."""
    from aces_bus.device import load_driver
    from aces_bus.device.twin import FAULTS

    return {**FAULTS, **load_driver(robot.devices[device].driver).twin.faults}


def _list_faults(robot: Robot, as_json: bool) -> int:
    from .device_text import aligned_rows

    by_driver: dict[str, tuple[list[str], dict[str, str]]] = {}
    for name, config in robot.devices.items():
        if config.active:
            by_driver.setdefault(config.driver, ([], fault_names(robot, name)))[0].append(name)
    if as_json:
        found = {driver: {"devices": names, "faults": f} for driver, (names, f) in by_driver.items()}
        print(json.dumps(found, ensure_ascii=False, indent=2))
        return 0
    for driver, (names, faults) in by_driver.items():
        print("\n".join(aligned_rows([(f"{driver}:", ", ".join(names))], "")))
        print("\n".join(aligned_rows(list(faults.items()))))
    return 0


# ---------------------------------------------------------------------- what is said


def _announce(robot: Robot, given: str | None, stand: SimulatedRobot, as_json: bool) -> None:
    """How to join each bus, on stdout: programs and people read it."""
    if as_json:
        print(json.dumps({"robot": robot.name, "buses": stand.reached}, ensure_ascii=False))
    else:
        for name in stand.simulation.buses:
            print(f"{name}: {stand.listen_with(name, given or robot.name)}")
        print(f"aces device -r {given or robot.name} {stand.device_options}")
    if sys.stdout is not None:
        sys.stdout.flush()
    say(f"{robot.name}: {len(stand.simulation.twins)} devices are there; Ctrl-C ends it")


def _summary(stand: SimulatedRobot, as_json: bool) -> None:
    twins = stand.simulation.twins
    requests = sum(twin.requests for twin in twins.values())
    replies = sum(twin.replies for twin in twins.values())
    unknown = sum(bus.unknown + bus.others for bus in stand.simulation.buses.values())
    if as_json:
        counts = {name: {"requests": twin.requests, "replies": twin.replies} for name, twin in twins.items()}
        print(json.dumps({"requests": requests, "replies": replies, "others": unknown, "devices": counts}))
    say(f"requests={requests} replies={replies} others={unknown}", who="")
