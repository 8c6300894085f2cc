"""A robot's buses: the gates that its file or its user names, or simulated wires with its twins in virtual time.

1. `VirtualRobot` has one clock and no thread: `advance` lets the robot live, as fast as the machine can.
2. The same robot, seed and calls give the same frames on the wires.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ..device.coalesce import CoalescingRule
from ..device.config import Bus, Robot
from ..device.drivers import Driver, load_driver
from ..device.events import EventLog
from ..device.host import BUDGET
from ..device.physics import Physics
from ..device.port import Port
from ..device.signals import Signal
from ..errors import CallerError
from ..hardware.can import CanGate
from ..hardware.datagram import DatagramGate
from ..hardware.lock import BusLock
from ..hardware.ports import port_of
from ..hardware.serial import SerialGate
from ..hardware.served.address import ServedAddress
from ..hardware.simulated.bus import NO_FAULTS, Faults, SimulatedBus
from ..hardware.simulated.datagrams import SimulatedDatagrams
from ..hardware.simulated.serial_line import Noise, SimulatedSerialLine
from ..protocol import Protocol
from ..runtime import VirtualClock
from ..runtime.loop import Loop
from .physics import chosen_physics
from .rig import Rig, Simulation, connect, simulate, spoken_on

#: python-can's interfaces of buses that only one process has, unless their channel is an address.
IN_PROCESS = ("aces", "virtual")


def is_half_duplex(bus: Bus, protocol: Protocol) -> bool:
    """Return whether all on a robot's bus share one pair of wires."""
    return protocol.half_duplex if bus.half_duplex is None else bus.half_duplex


def gate_of(
    bus: Bus, protocol: Protocol, options: Mapping[str, Any] | None = None, *, listen_only: bool = False
) -> CanGate | SerialGate | DatagramGate:
    """Return the gate of a robot's bus. `options` are python-can's (CAN), `channel` and `baud` (serial), or `channel`
    HOST:PORT.

    They take precedence over what the file says; a datagram bus with `bind` (HOST:PORT) waits there for the first
    sender. It sends what the file allows. Raises `CallerError` when neither says where the bus is.
    """
    chosen = dict(options or {})
    channel = chosen.pop("channel", None) or bus.channel
    bind = chosen.pop("bind", None)
    if channel is None and bind is None:
        raise CallerError(f"bus {bus.name}: which channel? The robot's file does not say; give one")
    if bus.link == "can":
        rate = bus.bitrate or protocol.bitrate
        interface = bus.interface or ("aces" if ServedAddress.is_served(channel) else None)
        whole = {"channel": channel, **({"interface": interface} if interface else {})}
        if rate:
            whole["bitrate"] = rate
        if protocol.has_fd:
            whole["fd"] = True
            if bus.data_bitrate:
                whole["data_bitrate"] = bus.data_bitrate
        return CanGate({**whole, **chosen}, name=bus.name, listen_only=listen_only, **_allowed(bus))
    if bus.link == "serial":
        baud = int(chosen.pop("baud", None) or bus.baud or protocol.baud or 115_200)
        half = is_half_duplex(bus, protocol)
        return SerialGate(
            str(channel), baud=baud, half_duplex=half, name=bus.name, listen_only=listen_only, **chosen
        )
    if bind is not None:
        return DatagramGate(_address(bus, bind), name=bus.name, listen_only=listen_only)
    return DatagramGate(peer=_address(bus, str(channel)), name=bus.name, listen_only=listen_only)


def _allowed(bus: Bus) -> dict[str, Any]:
    """Return what may be sent on a CAN bus, as an option of gates and ports; none where it is all."""
    if bus.allow is None:
        return {}
    from ..recordings.filters import parse_filter  # NumPy: slow to import

    return {"allow": parse_filter(*bus.allow)}


def _address(bus: Bus, text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit():
        raise CallerError(f"bus {bus.name}: {text!r} is not HOST:PORT")
    return host, int(port)


def lock_of(bus: Bus, options: Mapping[str, Any]) -> BusLock | None:
    """Return the lock of who drives a robot's bus, not taken; `options` as of `gate_of`. None: it is within this process."""
    channel = str(options.get("channel") or bus.channel or options.get("bind"))
    is_inside = options.get("interface", bus.interface) in IN_PROCESS and not ServedAddress.is_served(channel)
    return None if is_inside else BusLock(channel, bus.name)


def open_gates(
    robot: Robot,
    loop: Loop,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    *,
    passive: bool = False,
    is_locked: bool = True,
    load: Callable[[str], Driver] = load_driver,
) -> dict[str, Port]:
    """Return a port for each bus of a robot that has active devices; `options` by bus, see `gate_of`. Nothing is opened yet.

    They are for who drives: opening one takes the bus's `BusLock`. `passive` ones only listen, and take it for serial lines,
    which have one reader. Buses within this process have no lock. `is_locked` False takes none: for stops.
    """
    ports: dict[str, Port] = {}
    for name, protocol in spoken_on(robot, load).items():
        bus = robot.buses[name]
        said = (options or {}).get(name) or {}
        gate = gate_of(bus, protocol, said, listen_only=passive)
        if is_locked and (bus.link == "serial" or not passive):
            gate.lock = lock_of(bus, said)
        ports[name] = port_for(gate, bus, loop)
    return ports


def port_for(gate: CanGate | SerialGate | DatagramGate, bus: Bus, loop: Loop) -> Any:
    """Return the port of a bus's gate, which knows what packets cost."""
    more: dict[str, Any] = {}
    if isinstance(gate, CanGate):
        more = {"bitrate": bus.bitrate, "data_bitrate": bus.data_bitrate}
    elif isinstance(gate, SerialGate):
        more = {"baud": gate.baud, "half_duplex": gate.half_duplex}
    return port_of(gate, loop, **more)


# ---------------------------------------------------------------------- simulated

AnyWire = SimulatedBus | SimulatedSerialLine | SimulatedDatagrams


def wire_of(
    bus: Bus,
    protocol: Protocol,
    clock: VirtualClock,
    *,
    faults: Faults = NO_FAULTS,
    noise: Noise | None = None,
) -> AnyWire:
    """Return the simulated wire of a robot's bus, as fast as its file or its protocol says."""
    if bus.link == "can":
        rate = bus.bitrate or protocol.bitrate or 1_000_000
        return SimulatedBus(clock, bitrate=rate, data_bitrate=bus.data_bitrate, faults=faults)
    if bus.link == "serial":
        baud = bus.baud or protocol.baud or 115_200
        return SimulatedSerialLine(clock, baud=baud, half_duplex=is_half_duplex(bus, protocol), noise=noise)
    return SimulatedDatagrams(clock)


class VirtualRobot:
    """Hosts and twins of a robot on virtual wires.

    with VirtualRobot(load_robot("hubo2plus"), rate_hz=200) as robot:
        robot.advance(1.0)
        robot["RHY.position"].value

    `faults` and `noise` (bus → what its wire does wrong); `pose` (joint → rad: where its twin is at first); `homed` False:
    as after power-up, what needs homing is not homed; `physics`: the body that the twins' motors move, or its name
    (`"mujoco:arm.xml"`, `"none"`; when absent what the robot's file says). `rate_hz` is the tick of buses whose rate the
    file does not state, when absent the file's own; 0: no ticks. The other options are those of `connect` and `simulate`.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        rate_hz: float | None = None,
        seed: int = 0,
        budget: float = BUDGET,
        rules: Mapping[str, CoalescingRule] | None = None,
        clock: VirtualClock | None = None,
        faults: Mapping[str, Faults] | None = None,
        noise: Mapping[str, Noise] | None = None,
        pose: Mapping[str, float] | None = None,
        homed: bool = True,
        physics: Physics | str | None = None,
        load: Callable[[str], Driver] = load_driver,
    ) -> None:
        self.robot = robot
        self.clock = clock if clock is not None else VirtualClock()
        self.wires: dict[str, Any] = {
            name: wire_of(
                robot.buses[name],
                protocol,
                self.clock,
                faults=(faults or {}).get(name, NO_FAULTS),
                noise=(noise or {}).get(name),
            )
            for name, protocol in spoken_on(robot, load).items()
        }
        rate_hz = (robot.rate_hz if rate_hz is None else rate_hz) or None
        self.rig: Rig = connect(
            robot, self.ports("host"), rate_hz=rate_hz, budget=budget, rules=rules, load=load
        )
        twins = {bus: port_of(wire, name=f"{bus} twins") for bus, wire in self.wires.items()}
        self.simulation: Simulation = simulate(
            robot, twins, seed=seed, pose=pose, homed=homed, physics=chosen_physics(robot, physics), load=load
        )

    def ports(self, name: str) -> dict[str, Any]:
        """Return a port of each wire for one more host: it sends what the robot's file allows."""
        return {
            bus: port_of(wire, name=f"{bus} {name}", **_allowed(self.robot.buses[bus]))
            for bus, wire in self.wires.items()
        }

    def __getitem__(self, name: str) -> Signal:
        """Return the signal of this name ("RHY.position"); raises `UnknownNameError`."""
        return self.rig[name]

    @property
    def devices(self) -> Mapping[str, Any]:
        """The devices, by name."""
        return self.rig.devices

    @property
    def twins(self) -> Mapping[str, Any]:
        """The twins, by name."""
        return self.simulation.twins

    @property
    def events(self) -> EventLog:
        """Events of the devices."""
        return self.rig.events

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self.clock.advance(round(seconds * 1e9))

    def open(self) -> VirtualRobot:
        """Power the twins and open the hosts."""
        self.simulation.open()
        self.rig.open()
        return self

    def close(self) -> None:
        """Close the hosts, then the twins."""
        self.rig.close()
        self.simulation.close()

    def __enter__(self) -> VirtualRobot:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()
