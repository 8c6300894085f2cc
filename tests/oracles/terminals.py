"""Twins at the end of a pseudo-terminal, for programs that open serial ports: `with twins_at_a_terminal(robot) as made`."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from aces_bus import load_protocol
from aces_bus.device import Robot, Twin
from aces_bus.hardware.ports import SerialPort
from aces_bus.hardware.simulated.serial_line import PtyPort
from aces_bus.robot.buses import wire_of
from aces_bus.robot.rig import simulate
from aces_bus.runtime import VirtualClock


@dataclass
class Terminal:
    """A simulated line with a pseudo-terminal as its other end: `port.path` is what programs open, `port.lock` is held by
    who touches what is on the line. `passed` are all bytes that passed on it."""

    line: Any
    port: PtyPort
    passed: list[bytes]
    twins: dict[str, Twin] = field(default_factory=dict[str, Twin])


@contextmanager
def a_terminal(robot: Robot, bus: str, *, whole: bool = False) -> Generator[Terminal]:
    """A robot's bus as a terminal, nothing on it yet; with `whole` packets arrive at once, as by USB."""
    line: Any = wire_of(
        robot.buses[bus], load_protocol(robot.buses[bus].protocol), VirtualClock(time.monotonic_ns())
    )
    passed: list[bytes] = []
    line.attach("listener", lambda data, instant: passed.append(data), whole=True)
    with PtyPort(line, whole=whole) as port:
        yield Terminal(line, port, passed)


@contextmanager
def twins_at_a_terminal(robot: Robot, bus: str, *, whole: bool = False) -> Generator[Terminal]:
    """The same with the robot's twins on it."""
    with a_terminal(robot, bus, whole=whole) as made:
        with made.port.lock:
            simulation = simulate(robot, {bus: SerialPort(made.line, name=bus)})
            simulation.open()
        made.twins = dict(simulation.twins)
        try:
            yield made
        finally:
            with made.port.lock:
                simulation.close()
