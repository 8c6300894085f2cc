"""A robot's twins on a pseudo-terminal, for programs that open a serial port; all that is on the line is kept."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

from aces_bus.device import Driver, Twin
from aces_bus.hardware.ports import SerialPort
from aces_bus.hardware.simulated.serial_line import PtyPort, SimulatedSerialLine
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.robot import parse_robot
from aces_bus.robot.buses import wire_of
from aces_bus.robot.rig import simulate, spoken_on
from aces_bus.runtime import VirtualClock


@dataclass
class OpenLine:
    """The twins on a line, and how a program reaches them; use `lock` to touch a twin."""

    path: str
    lock: Any
    twins: dict[str, Twin]
    protocol: Any
    received: bytearray = field(default_factory=bytearray)

    def records(self, direction: Literal["to device", "from device", "both"] = "both") -> list[Any]:
        """All that was on the line so far, as records; what is not a message stands among them as `Unknown`."""
        with self.lock:
            data = bytes(self.received)
        scanner = self.protocol.scanner(direction=direction, include_unknown=True)
        assert isinstance(scanner, StreamScanner)
        found = scanner.feed(data) + scanner.close()
        assert scanner.counts.balance == 0
        return found


@contextmanager
def served_line(robot_file: str, driver: Driver) -> Generator[OpenLine]:
    """The twins of a robot with one serial line, in real time, at a pseudo-terminal."""
    robot, problems = parse_robot(robot_file)
    assert robot is not None, problems
    (name,) = robot.buses
    protocol = spoken_on(robot, {driver.name: driver}.__getitem__)[name]
    wire = wire_of(robot.buses[name], protocol, VirtualClock(time.monotonic_ns()))
    assert isinstance(wire, SimulatedSerialLine)
    with PtyPort(wire) as pty:
        with pty.lock:
            port = SerialPort(wire, name=name)
            simulation = simulate(robot, {name: port}, load={driver.name: driver}.__getitem__)
            line = OpenLine(pty.path, pty.lock, dict(simulation.twins), protocol)
            wire.attach("ear", lambda data, _: line.received.extend(data))
            simulation.open()
        try:
            yield line
        finally:
            with pty.lock:
                simulation.close()
