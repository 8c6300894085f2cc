"""A whole robot in virtual time: its hosts, its twins and the wires between them, from one seed.

1. One clock, no thread: `advance` lets the robot live, as fast as the machine can.
2. The same robot, seed and calls give the same words on the wires.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ..device import Robot
from ..device.coalesce import CoalescingRule
from ..device.config import Bus
from ..device.drivers import Driver, load_driver
from ..device.host import BUDGET
from ..hardware.ports import port_of
from ..hardware.simulated.bus import NO_FAULTS, Faults, SimulatedBus
from ..hardware.simulated.datagrams import SimulatedDatagrams
from ..hardware.simulated.serial_line import Noise, SimulatedSerialLine
from ..protocol import Protocol
from ..runtime import VirtualClock
from .buses import is_half_duplex
from .rig import Rig, Simulation, connect, simulate, spoken_on

AnyWire = SimulatedBus | SimulatedSerialLine | SimulatedDatagrams


def wire_of(
    bus: Bus,
    protocol: Protocol,
    clock: VirtualClock,
    *,
    faults: Faults = NO_FAULTS,
    noise: Noise | None = None,
) -> AnyWire:
    """The simulated wire of a robot's bus, as fast as its file or its protocol says."""
    if bus.link == "can":
        return SimulatedBus(clock, bitrate=bus.bitrate or protocol.bitrate or 1_000_000, faults=faults)
    if bus.link == "serial":
        baud = bus.baud or protocol.baud or 115_200
        return SimulatedSerialLine(clock, baud=baud, half_duplex=is_half_duplex(bus, protocol), noise=noise)
    return SimulatedDatagrams(clock)


class VirtualRobot:
    """Hosts and twins of a robot on virtual wires.

    with VirtualRobot(load_robot("hubo2plus"), rate_hz=200) as robot:
        robot.advance(1.0)
        robot["RHY.position"].value

    `faults` and `noise` (bus → what its wire does wrong). The other options are those of `connect` and `simulate`.
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
        self.rig: Rig = connect(
            robot, self.ports("host"), rate_hz=rate_hz, budget=budget, rules=rules, load=load
        )
        self.simulation: Simulation = simulate(robot, self.ports("twins"), seed=seed, load=load)

    def ports(self, name: str) -> dict[str, Any]:
        """A port of each wire for one more station."""
        return {bus: port_of(wire, name=f"{bus} {name}") for bus, wire in self.wires.items()}

    def __getitem__(self, name: str) -> Any:
        """The signal "RHY.position"."""
        return self.rig[name]

    @property
    def devices(self) -> Any:
        """The devices, by name."""
        return self.rig.devices

    @property
    def twins(self) -> Any:
        """The twins, by name."""
        return self.simulation.twins

    @property
    def events(self) -> Any:
        """What happened to devices."""
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
