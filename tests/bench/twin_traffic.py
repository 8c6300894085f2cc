"""What twins send, recorded in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np

from aces_bus.device import load_driver
from aces_bus.errors import AcesError
from aces_bus.hardware import ListeningNode, SimulatedBus
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing.conformance import enable

#: Seconds of virtual time that twins are recorded.
TWINS_S = 8.0


def twin_traffic(driver: str) -> Iterator[tuple[str, Any, list[Any]]]:
    """(protocol, wire, what was on it: frames, or (bytes, seconds)) of a driver's example robot that moves."""
    robot_of, _ = parse_robot(load_driver(driver).example, f"{driver}.toml")
    assert robot_of is not None
    robot = VirtualRobot(robot_of, rate_hz=robot_of.rate_hz or 50, seed=1)
    recorders: dict[str, tuple[Any, list[Any]]] = {}
    for name, wire in robot.wires.items():
        heard: list[Any] = []
        if isinstance(wire, SimulatedBus):
            recorders[name] = ListeningNode(wire), heard
        else:
            wire.attach(
                "recorder", lambda data, now, heard=heard: heard.append((data, now * 1e-9)), whole=True
            )
            recorders[name] = None, heard
    with robot:
        robot.advance(0.5)
        enable(robot)
        settable = [
            (one, number_or_zero(one.value))
            for device in robot.devices.values()
            for one in device.signals.values()
            if one.is_writable and not isinstance(one.value, bool) and not isinstance(one.value, str)
        ]
        steps = 60
        for step in range(steps):
            for number, (one, start) in enumerate(settable):
                low = max(start - 0.5, -np.inf if one.lower is None else one.lower)
                high = min(start + 0.5, np.inf if one.upper is None else one.upper)
                with suppress(AcesError):  # a joint that is stopped takes none
                    one.set(type(start)((low + high) / 2 + 0.4 * (high - low) * np.sin(step / 8 + number)))
            robot.advance(TWINS_S / steps)
    for name, (node, heard) in recorders.items():
        yield name, robot, list(node.frames()) if node is not None else heard


def number_or_zero(value: Any) -> Any:
    """A signal's value where it is known."""
    return value if isinstance(value, int | float) else 0.0
