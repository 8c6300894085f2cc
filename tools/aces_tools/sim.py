"""Put a robot's simulated devices on a bus, for programs and people to talk to.

  aces sim hubo2plus                    serves its buses and stands on them;
                                        others join: -i aces -c unix:can0
  aces sim minihubo_1                   its serial line is a pseudo-terminal
  aces sim hubo2plus -i socketcan --bus lower=can0 --bus upper=can1
                                        on buses that are there
  aces sim robot.toml --fault JMC3:silent --fault JMC1:hot
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
from typing import TYPE_CHECKING, Any

from aces_bus.errors import CallerError, UnknownNameError

from .console import say
from .live import LivePatience, parse_duration
from .robot_arg import add_robot_arguments, bus_options, chosen_robot, open_host

if TYPE_CHECKING:
    from aces_bus.device import Robot, Simulation


def add_arguments(parser: argparse.ArgumentParser) -> None:
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
    with ExitStack() as stack:
        patience = stack.enter_context(LivePatience())
        stand = Stand(robot, options, arguments.seed, stack)
        for names, fault, amount in faults:
            for name in names:
                stand.simulation[name].fault(fault, amount)
        _announce(robot, stand, arguments.json)
        end = None if duration is None else time.monotonic_ns() + duration
        while not patience.is_over and (end is None or time.monotonic_ns() < end):
            following = time.monotonic_ns() + 500_000_000
            patience.wait_until(following if end is None else min(following, end))
        stack.callback(_summary, stand, arguments.json)
    return 0


class Stand:
    """A robot's twins on their buses: those of the call, or served ones and pseudo-terminals of our own."""

    def __init__(self, robot: Robot, options: dict[str, dict[str, Any]], seed: int, stack: ExitStack) -> None:
        from aces_bus.assembly import open_gates
        from aces_bus.device import simulate
        from aces_bus.runtime import Loop

        self.loop = stack.enter_context(Loop())
        #: Bus → how others reach it, for people and as options.
        self.reached: dict[str, str] = {}
        used = [name for name in robot.buses if any(device.active for device in robot.devices_on(name))]
        own = [name for name in used if not options[name]]
        lines = self._own_lines(robot, [n for n in own if robot.buses[n].link == "serial"], stack)
        served = self._serve(robot, [n for n in own if robot.buses[n].link == "can"], options, stack)
        for name in own:
            if robot.buses[name].link == "datagram":
                address = robot.buses[name].channel or "127.0.0.1:0"
                options[name]["bind"] = f"127.0.0.1:{address.rpartition(':')[2]}"
                self.reached[name] = f"udp {options[name]['bind']}"
        for name in used:
            if name not in self.reached:
                self.reached[name] = (
                    f"{options[name].get('interface', '')} {options[name]['channel']}".strip()
                )
        gates = open_gates(robot, self.loop, {n: o for n, o in options.items() if n not in lines})
        ports = {name: lines.get(name) or gates[name] for name in used}
        self.simulation: Simulation = simulate(robot, ports, seed=seed)
        stack.callback(self.simulation.close)
        for name, twins in self.simulation.buses.items():
            open_host(name, twins, options[name].get("channel"))
        del served

    def _own_lines(self, robot: Robot, names: list[str], stack: ExitStack) -> dict[str, Any]:
        """A simulated line for each serial bus, with a pseudo-terminal as its other end."""
        if not names:
            return {}
        from aces_bus.assembly import wire_of
        from aces_bus.device.rig import spoken_on
        from aces_bus.hardware import SerialPort
        from aces_bus.hardware.pty import PtyPort
        from aces_bus.runtime import VirtualClock

        found: dict[str, Any] = {}
        for name in names:
            wire: Any = wire_of(robot.buses[name], spoken_on(robot)[name], VirtualClock(time.monotonic_ns()))
            pty = stack.enter_context(PtyPort(wire))
            found[name] = SerialPort(wire, name=name)
            self.reached[name] = (
                f"{pty.path} at {wire.baud} baud{', half duplex' if wire.half_duplex else ''}"
            )
        return found

    def _serve(
        self, robot: Robot, names: list[str], options: dict[str, dict[str, Any]], stack: ExitStack
    ) -> Any:
        """A served bus for each CAN bus."""
        if not names:
            return None
        import threading

        from aces_bus.hardware.served.channel import ServedChannel
        from aces_bus.hardware.served.server import BusServer

        channels = {
            name: ServedChannel(
                robot.buses[name].channel or name, bitrate=robot.buses[name].bitrate or 1_000_000
            )
            for name in names
        }
        server = BusServer(list(channels.values()), unix="", tcp=None, socketcand=None, said=say)
        thread = threading.Thread(target=server.serve, name="buses", daemon=True)
        thread.start()

        def end() -> None:
            server.stop()
            thread.join(5.0)
            server.close()

        stack.callback(end)
        for name, channel in channels.items():
            address = server.addresses[channel.name][0]
            options[name].update(interface="aces", channel=address)
            self.reached[name] = f"-i aces -c {address}"
        return server


def parse_fault(robot: Robot, text: str) -> tuple[list[str], str, float | None]:
    """`JMC3:late=0.1` as devices, fault and amount; raises `UnknownNameError` for what there is not."""
    device, colon, rest = text.partition(":")
    fault, _, amount = rest.partition("=")
    if not colon or not fault:
        raise CallerError(f"--fault {text}: write DEVICE:FAULT, such as JMC3:silent")
    active = [name for name, config in robot.devices.items() if config.active]
    names = active if device == "*" else [device]
    if not set(names) <= set(active):
        raise UnknownNameError(f"device of {robot.name}", device, active)
    for name in names:
        known = faults_of(robot, name)
        if fault not in known:
            raise UnknownNameError(f"fault of {name}", fault, known)
    try:
        return names, fault, float(amount) if amount else None
    except ValueError:
        raise CallerError(f"--fault {text}: {amount!r} is no number") from None


def faults_of(robot: Robot, device: str) -> dict[str, str]:
    """How a device can misbehave: name → what it does."""
    from aces_bus.device import load_driver
    from aces_bus.device.twin import FAULTS

    return {**FAULTS, **load_driver(robot.devices[device].driver).twin.faults}


def _list_faults(robot: Robot, as_json: bool) -> int:
    by_driver: dict[str, tuple[list[str], dict[str, str]]] = {}
    for name, config in robot.devices.items():
        if config.active:
            by_driver.setdefault(config.driver, ([], faults_of(robot, name)))[0].append(name)
    if as_json:
        print(
            json.dumps({d: {"devices": names, "faults": f} for d, (names, f) in by_driver.items()}, indent=2)
        )
        return 0
    for driver, (names, faults) in by_driver.items():
        print(f"{driver}: {', '.join(names)}")
        width = max(map(len, faults))
        for fault, doc in faults.items():
            print(f"  {fault:<{width}}  {doc}")
    return 0


def _announce(robot: Robot, stand: Stand, as_json: bool) -> None:
    """Where the buses are, on stdout: programs read it."""
    if as_json:
        print(json.dumps({"robot": robot.name, "buses": stand.reached}))
    else:
        for name, twins in stand.simulation.buses.items():
            print(f"{name}: {stand.reached[name]}  ({', '.join(twins.members)})")
    if sys.stdout is not None:
        sys.stdout.flush()
    say(f"{robot.name}: {len(stand.simulation.twins)} devices are there; Ctrl-C ends it")


def _summary(stand: Stand, as_json: bool) -> None:
    twins = stand.simulation.twins
    requests = sum(twin.requests for twin in twins.values())
    replies = sum(twin.replies for twin in twins.values())
    unknown = sum(bus.unknown + bus.others for bus in stand.simulation.buses.values())
    if as_json:
        counts = {name: {"requests": twin.requests, "replies": twin.replies} for name, twin in twins.items()}
        print(json.dumps({"requests": requests, "replies": replies, "others": unknown, "devices": counts}))
    say(f"requests={requests} replies={replies} others={unknown}", who="")
