"""Put a robot's simulated devices on a bus, for programs and people to talk to.

  aces sim -p moteus --id 1           one device, without a robot's file:
                                      prints the line that a program takes
  aces sim -p feetech --id 1,2 --model STS3215
  aces sim -r hubo2plus               serve its buses, with its devices on them;
                                      others join with -i aces -c unix:can0
  aces sim -r minihubo_1              its serial line is a pseudo-terminal
  aces sim -r hubovia --bus pc=127.0.0.1:12000   receive datagrams there
  aces sim -r hubo2plus --bus lower=unix:left    serve a bus under another name,
                                      or join it where it is served already
  aces sim -r hubo2plus -i socketcan --bus lower=can0 --bus upper=can1
                                      on buses that exist
  aces sim -r robot.toml --fault JMC3:silent --fault JMC1:late=0.2
  aces sim -r hubo2plus --pose RKN=30deg         where a joint is at first
  aces sim -r quadruped --physics mujoco:quadruped.xml    they move this body
  aces sim -r minihubo_1 --foxglove              where its joints are, live
  aces sim -r hubo2plus --list-faults            how its devices can misbehave

The devices answer as the real ones do, and move only when a program commands
it. On a bus that exists they transmit: they answer every request.
"""

from __future__ import annotations

import argparse
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any

from aces_bus.errors import CallerError, UnknownNameError

from .console import ENDLESS, counted, print_json, say, say_note
from .live_view import live_view, show_bus, show_bus_event
from .options import FOR, JSON, SEED, Arguments, flag, several
from .patience import Patience
from .robot_arg import (
    KIND,
    PHYSICS,
    POSE,
    ROBOT_AND_BUSES,
    bus_options,
    check_channels,
    chosen_kind,
    chosen_pose,
    open_host,
)

if TYPE_CHECKING:
    from aces_bus.device import Robot
    from aces_bus.device.twin import JointModel
    from aces_bus.robot.rig import Simulation

    from .live_view import LiveView


SUMMARY = "put a robot's simulated devices on a bus"

EPILOG = """\
exit status: 0; 2 a wrong call, or a bus that cannot be served or opened
"""


ARGUMENTS: Arguments = (
    *KIND,
    several(
        "--fault", metavar="DEVICE:FAULT[=AMOUNT]", help="make a device misbehave; * for all; may be repeated"
    ),
    flag("--list-faults", help="list how the devices can misbehave"),
    FOR.but(help="end after this time (default: Ctrl-C)"),
    SEED,
    POSE,
    PHYSICS,
    flag("--unhomed", help="joints are as after power-up: what needs homing is not homed"),
    JSON.but(help="the buses, and at the end the counts, as JSON"),
    ROBOT_AND_BUSES,
)


def run(arguments: argparse.Namespace) -> int:
    robot = chosen_kind(arguments)
    if arguments.list_faults:
        return _list_faults(robot, arguments.json)
    duration = arguments.duration
    faults = [parse_fault(robot, text) for text in arguments.fault]
    options = bus_options(robot, arguments)

    with ExitStack() as stack:
        patience = stack.enter_context(Patience())
        pose = chosen_pose(robot, arguments.pose)
        view = stack.enter_context(live_view("sim", arguments, f"{robot.name}, simulated"))
        homed, physics = not arguments.unhomed, arguments.physics
        stand = SimulatedRobot(
            robot, options, arguments.seed, stack, pose, view, homed=homed, physics=physics
        )
        for names, fault, amount in faults:
            for name in names:
                stand.simulation[name].fault(fault, amount)
        stack.callback(_summary, stand, arguments.json)  # however it ends
        _announce(robot, arguments, stand)
        end = None if duration is None else time.monotonic_ns() + duration
        while not patience.is_over and (end is None or time.monotonic_ns() < end):
            following = time.monotonic_ns() + 500_000_000
            patience.wait_until(following if end is None else min(following, end))
    return 0


# ---------------------------------------------------------------------- faults


def parse_fault(robot: Robot, text: str) -> tuple[list[str], str, float | None]:
    """Parse `JMC3:late=0.1` as devices, fault and amount; raise `UnknownNameError` for an unknown fault."""
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
        raise CallerError(f"--fault {text}: {amount!r} is not a number") from None


def fault_names(robot: Robot, device: str) -> dict[str, str]:
    """Return how a device can misbehave: name → what it does."""
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
        print_json(found)
        return 0
    for driver, (names, faults) in by_driver.items():
        print("\n".join(aligned_rows([(f"{driver}:", ", ".join(names))], "")))
        print("\n".join(aligned_rows(list(faults.items()))))
    return 0


# ---------------------------------------------------------------------- what is said


def _announce(robot: Robot, arguments: argparse.Namespace, stand: SimulatedRobot) -> None:
    """Print how to join each bus to stdout, for programs and people."""
    given = arguments.robot or robot.name
    if arguments.protocol is not None and not arguments.json:
        for way in stand.reached.values():
            baud = f"   ({way['baud']} bit/s)" if way.get("baud") else ""
            of_can = f"   (python-can: interface {way['interface']})" if way.get("interface") else ""
            print(f"{'port' if way['kind'] == 'serial' else 'channel'}: {way['address']}{baud}{of_can}")
    elif arguments.json:
        print_json({"robot": robot.name, "buses": stand.reached}, None)
    else:
        for name in stand.simulation.buses:
            print(f"{name}: {stand.listen_with(name, given)}")
        drivers = [f"--driver {file}" for file in arguments.driver]
        print(" ".join(["aces device -r", given, stand.device_options, *drivers]))
    if sys.stdout is not None:
        sys.stdout.flush()
    number = len(stand.simulation.twins)
    say_note(f"{robot.name}: {counted(number, 'device')} {'is' if number == 1 else 'are'} there; {ENDLESS}")


def _summary(stand: SimulatedRobot, as_json: bool) -> None:
    twins = stand.simulation.twins
    requests = sum(twin.requests for twin in twins.values())
    replies = sum(twin.replies for twin in twins.values())
    unknown = sum(bus.unknown + bus.others for bus in stand.simulation.buses.values())
    if as_json:
        counts = {name: {"requests": twin.requests, "replies": twin.replies} for name, twin in twins.items()}
        print_json({"requests": requests, "replies": replies, "others": unknown, "devices": counts}, None)
    say(f"requests={requests} replies={replies} others={unknown}", who="")


# ---------------------------------------------------------------------- where the twins are


#: Where a system has no Unix sockets or no pseudo-terminals, buses and lines are served at TCP ports of this machine.
HAS_UNIX = hasattr(socket, "AF_UNIX")


class SimulatedRobot:
    """A robot's twins on their buses, open. What is to be closed is put on `stack`. Raises `CallerError`."""

    def __init__(
        self,
        robot: Robot,
        options: dict[str, dict[str, Any]],
        seed: int,
        stack: ExitStack,
        pose: Mapping[str, float] | None = None,
        view: LiveView | None = None,
        *,
        homed: bool = True,
        physics: str | None = None,
    ) -> None:
        from aces_bus.robot.buses import gate_of, port_for
        from aces_bus.robot.physics import chosen_physics
        from aces_bus.robot.rig import simulate, spoken_on
        from aces_bus.runtime.loop import Loop

        self.robot = robot
        self.loop = stack.enter_context(Loop())
        #: Bus → how others reach it: `kind`, `address`, and what tools take as options.
        self.reached: dict[str, dict[str, Any]] = {}
        used = [name for name in robot.buses if any(device.active for device in robot.devices_on(name))]
        links = {name: robot.buses[name].link for name in used}
        lines = self._own_lines(
            [n for n in used if links[n] == "serial" and not options[n].get("channel")], stack
        )
        self._serve({n: self._wanted(n, options[n]) for n in used if links[n] == "can"}, options, stack)
        for name in used:
            if links[name] == "datagram":
                self._bind(name, options[name])
        check_channels(robot, {n: {"channel": "ours"} if n in lines else o for n, o in options.items()})
        ports = dict(lines)
        for name, protocol in spoken_on(robot).items():
            if name not in lines:
                bus = robot.buses[name]
                ports[name] = port_for(gate_of(bus, protocol, options[name]), bus, self.loop)
        self.simulation: Simulation = simulate(
            robot, ports, seed=seed, pose=pose, homed=homed, physics=chosen_physics(robot, physics)
        )
        stack.callback(self.simulation.close)
        if view is not None:
            self._show_live(view)
        for name, twins in self.simulation.buses.items():
            channel = options[name].get("channel") or robot.buses[name].channel
            open_host(name, twins, self.reached[name]["address"] if name in self.reached else channel)
            if name not in self.reached:
                self.reached[name] = {"kind": links[name], "address": str(channel), **options[name]}

    def _show_live(self, view: LiveView) -> None:
        """Show the robot's joints, and the traffic of its buses."""
        from aces_bus.kinematics import load_body

        for name, twins in self.simulation.buses.items():
            show_bus(view, name, twins, is_host=False)
            twins.port.on_event(partial(show_bus_event, view, name))
        body, loop = self.robot.body, self.loop
        period_ns = round(1e9 / (self.robot.rate_hz or 100.0))
        states = view.states(1e9 / period_ns, None if body is None else load_body(body))
        joints = self.simulation.world.joints

        def reader(joint: JointModel) -> Callable[[], float]:
            return lambda: joint.position(loop.now())

        kinds = {name: joint.type for name, joint in self.robot.joints.items()}
        units = {name: "m" if kinds.get(name) == "prismatic" else "rad" for name in joints}
        states.read({name: (units[name], reader(joint)) for name, joint in joints.items()})

        def again(due: int) -> None:
            now = loop.now()
            states.step(now)
            following = max(due + period_ns, now)
            loop.call_at(following, partial(again, following))

        loop.call_soon(partial(again, loop.now()))

    # ------------------------------------------------------------------ serial lines

    def _own_lines(self, names: list[str], stack: ExitStack) -> dict[str, Any]:
        """Return a simulated line for each of these buses, with a pseudo-terminal as its other end."""
        if not names:
            return {}
        from aces_bus.hardware.ports import SerialPort
        from aces_bus.hardware.simulated.serial_line import PtyPort
        from aces_bus.hardware.simulated.tcp_port import TcpPort
        from aces_bus.robot.buses import wire_of
        from aces_bus.robot.rig import spoken_on
        from aces_bus.runtime import VirtualClock

        found: dict[str, Any] = {}
        for name in names:
            protocol = spoken_on(self.robot)[name]
            wire: Any = wire_of(self.robot.buses[name], protocol, VirtualClock(time.monotonic_ns()))
            pty = PtyPort(wire, whole=True) if hasattr(os, "openpty") else TcpPort(wire)
            stack.callback(pty.close)
            found[name] = SerialPort(wire, name=name)
            self.reached[name] = {
                "kind": "serial",
                "address": pty.path,
                "baud": wire.baud,
                "half_duplex": wire.half_duplex,
            }
        return found

    # ------------------------------------------------------------------ CAN

    def _wanted(self, name: str, options: Mapping[str, Any]) -> str | None:
        """Return the served bus's address for a CAN bus, `unix:NAME`; None: it is a bus that is there."""
        from aces_bus.hardware.served.address import ServedAddress

        written = self.robot.buses[name].channel or name
        if not options and not written.startswith("tcp:"):
            return written if ServedAddress.is_served(written) else f"unix:{written}"
        channel = str(options.get("channel", ""))
        is_ours = channel.startswith("unix:") and options.get("interface") == "aces"
        return channel if is_ours else None

    def _serve(
        self, wanted: Mapping[str, str | None], options: dict[str, dict[str, Any]], stack: ExitStack
    ) -> None:
        """Serve a bus for each address that is not served yet; one that the call names and that is served is joined."""
        from aces_bus.hardware.served.address import ServedAddress
        from aces_bus.hardware.served.channel import ServedChannel
        from aces_bus.hardware.served.server import BusServer
        from aces_bus.robot.rig import spoken_on

        for name, text in wanted.items():
            if text is None:
                continue
            is_served = HAS_UNIX and _answers(ServedAddress.parse(text))
            if is_served and not options[name]:
                other = f"{self.robot.name}_{name}"
                raise CallerError(
                    f"bus {name}: {text} is served already; --bus {name}={text} joins it, --bus {name}=unix:{other} is"
                    " another"
                )
            if is_served:
                self._joined(name, options[name], text)
                continue
            protocol = spoken_on(self.robot)[name]
            bus = self.robot.buses[name]
            bitrate = bus.bitrate or protocol.bitrate or 1_000_000
            _warm()
            plain = text.removeprefix("unix:")
            is_path = "/" in plain
            # Devices acknowledge one another, and all twins are one node here: what they send by themselves is to arrive.
            channel = ServedChannel(
                name if is_path else plain,
                bitrate=bitrate,
                data_bitrate=bus.data_bitrate,
                fd=protocol.has_fd,
                acknowledge=True,
            )
            unix = (plain if is_path else "") if HAS_UNIX else None
            tcp = None if HAS_UNIX else ("127.0.0.1", 0)
            server = BusServer([channel], unix=unix, tcp=tcp, socketcand=None, said=say)
            self._joined(name, options[name], text if HAS_UNIX else server.addresses[channel.name][0])
            stack.callback(server.close)
            thread = threading.Thread(target=server.serve, name=f"bus {name}", daemon=True)
            thread.start()
            stack.callback(thread.join, 5.0)
            stack.callback(server.stop)

    def _joined(self, name: str, options: dict[str, Any], address: str) -> None:
        options.update(interface="aces", channel=address)
        self.reached[name] = {"kind": "can", "interface": "aces", "address": address}

    # ------------------------------------------------------------------ datagrams

    def _bind(self, name: str, options: dict[str, Any]) -> None:
        """Receive where the call says, else on the port of the robot's file, of this machine only."""
        given = options.pop("channel", None)
        text = str(given or self.robot.buses[name].channel or "127.0.0.1:0")
        host, _, port = text.rpartition(":")
        if not port.isdecimal() or int(port) > 65_535 or (given is not None and not host):
            raise CallerError(
                f"--bus {name}={text}: datagrams are received at HOST:PORT, such as {name}=127.0.0.1:11000"
            )
        options["bind"] = text if given is not None else f"127.0.0.1:{port}"
        self.reached[name] = {"kind": "datagram", "address": options["bind"]}

    # ------------------------------------------------------------------ how others join

    def listen_with(self, name: str, robot: str) -> str:
        """Return a command line that shows what happens on a bus; a serial line, which has one other end, is scanned."""
        from aces_bus import list_protocols
        from aces_bus.protocol.files import python_file
        from aces_bus.robot.rig import spoken_on

        protocol = spoken_on(self.robot)[name]
        device = next(d for d in self.robot.devices_on(name) if d.active)
        dialect = self.robot.protocol_of(device)[1]
        file, _ = python_file(list_protocols()[protocol.name].value)  # of a driver that is not installed
        said = file or protocol.name
        said += f":{dialect}" if dialect and dialect != protocol.dialect else ""
        if self.robot.tables(protocol):
            said += f"@{robot}"
        way = self.reached[name]
        if way["kind"] == "can":
            interface = f"-i {way['interface']} " if way.get("interface") else ""
            return f"aces sniff {interface}-c {way['address']} -p {said}"
        if way["kind"] == "serial":
            baud = f" --baud {way['baud']}" if way.get("baud") else ""
            return f"aces discover --bus {way['address']}{baud} -p {said}"
        return f"udp {way['address']}, {said}"

    @property
    def device_options(self) -> str:
        """Options with which `aces device`, `scan -r` and `run` reach all buses."""
        said = [f"--bus {name}={self.reached[name]['address']}" for name in self.simulation.buses]
        interface = next((way["interface"] for way in self.reached.values() if way.get("interface")), None)
        if interface not in (None, "aces"):
            said.append(f"-i {interface}")
        return " ".join(said)


def _answers(address: Any) -> bool:
    """Return whether a bus is served there."""
    try:
        address.connect(1.0).close()
    except OSError:
        return False
    return True


def _warm() -> None:
    """Fill the tables of frame times before the first request: it would be answered late."""
    from aces_bus import Frame
    from aces_bus.hardware.simulated.frame_time import frame_bits

    frame_bits(Frame(arbitration_id=0x123, data=bytes(8)))
