"""A control unit that says its faults to all, and its device: packets of J1939 that devices and twins send."""

from __future__ import annotations

from typing import Any, ClassVar

from aces_bus.device import Device, Driver, Robot, Twin, on, signal
from aces_bus.protocol import Protocol
from aces_bus.robot import parse_robot
from tests.specs.j1939_long import j1939_long

FAULT = {"low": 1, "high": 0, "mode": 2, "count": 3, "conversion": 0, "reserved": 0}
#: What the unit says: 18 bytes, in an announcement and three data frames.
FAULTS: dict[str, Any] = {"priority": 6, "lamps": 7, "faults": [FAULT] * 4}


class UnitDevice(Device):
    """Reads the lamps."""

    protocol: ClassVar[str | Protocol] = j1939_long
    provides = (signal("lamps", of="ActiveFaults.lamps"),)


class UnitTwin(Twin):
    """Says its faults once a second, and has those that its device has said last."""

    protocol: ClassVar[str | Protocol] = j1939_long

    def setup(self) -> None:
        self.noted: Any = None
        self.every(1.0, self.say)

    def say(self) -> None:
        self.reply("ActiveFaults", **FAULTS)

    @on("ActiveFaults")
    def note(self, record: Any) -> None:
        self.noted = record


ROBOT = """
name = "truck"
rate_hz = 20
[buses]
line = { link = "can", protocol = "j1939_long" }
[devices]
A = { driver = "unit", bus = "line", credentials = { source = 16 } }
"""
DRIVER = Driver("unit", UnitDevice, UnitTwin, ROBOT, doc="A control unit", source="invented for tests")
LOAD = {"unit": DRIVER}.__getitem__


def robot_of_unit() -> Robot:
    """A robot with one."""
    robot, problems = parse_robot(ROBOT, "truck")
    assert robot is not None, problems
    return robot
