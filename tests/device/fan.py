"""A small device for tests of the device floor: a fan on CAN, polled and set, and its twin; two fans on a serial line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import tau
from typing import Any, ClassVar

from construct import Byte, Int8sl, Int16ul, Struct, this

from aces_bus.device import Device, Driver, Poll, Robot, Ticket, Twin, on, signal
from aces_bus.protocol import Counter, IdField, InvertedSum, Protocol, Quantity
from aces_bus.robot import parse_robot

fan = Protocol("fan", link="can", bitrate=500_000)
Node = IdField("node", range(1, 9))
Speeds = Struct("left" / Quantity(Int16ul, unit="rpm"), "right" / Quantity(Int16ul, unit="rpm"))
fan.message("Ask", id=0x100 + Node, direction="to device")
fan.message("Set", id=0x110 + Node, direction="to device", payload=Speeds)
fan.message(
    "State",
    id=0x120 + Node,
    direction="from device",
    payload=Struct(*Speeds.subcons, "temperature" / Quantity(Int8sl, unit="°C")),
)

RPM = tau / 60


class Fan(Device):
    """Two fans on one board: one set-point frame, one request."""

    protocol: ClassVar[str | Protocol] = fan
    polls: Sequence[Poll] = (Poll("Ask", reply="State"),)
    streams = ("Set",)
    provides = (
        signal("left", unit="rad/s", of="State.left", set="Set.left", scale=RPM, lower=0, upper=300),
        signal("right", unit="rad/s", of="State.right", set="Set.right", scale=RPM, lower=0, upper=300),
        signal("temperature", unit="K", of="State.temperature", offset=273.15),
    )
    actions: ClassVar[Mapping[str, str]] = {"off": "stop both"}

    def off(self) -> Ticket:
        self.drop("Set")
        return self.send("Set", left=0, right=0)

    stop_motion = off


class FanTwin(Twin):
    """A fan that has its speed at once."""

    protocol: ClassVar[str | Protocol] = fan

    def setup(self) -> None:
        self.left = self.right = 0

    @on("Ask")
    def answer(self, request: Any) -> None:
        self.reply("State", left=self.left, right=self.right, temperature=40)

    @on("Set")
    def change(self, request: Any) -> None:
        self.left, self.right = request.left, request.right


ROBOT = """
name = "fans"
rate_hz = 100
[buses]
line = { link = "can", protocol = "fan" }
[devices]
A = { driver = "fan", bus = "line", credentials = { node = 1 } }
B = { driver = "fan", bus = "line", credentials = { node = 2 } }
"""
FAN = Driver("fan", Fan, FanTwin, ROBOT, doc="Two fans on a board", source="invented for tests")

# ---------------------------------------------------------------------- the same on RS-485

serial_fan = Protocol("serial_fan", link="serial", baud=115_200, half_duplex=True)
packet = serial_fan.framing(
    sync=b"\xa5",
    header=Struct("node" / Byte, "length" / Byte),
    size=this.length + 4,
    max_size=32,
    gap=0.05,
    check=InvertedSum(),
)
packet("Ask", direction="to device", prefix=Struct("kind" / Byte), match={"kind": 1})
packet("Set", direction="to device", prefix=Struct("kind" / Byte), match={"kind": 2}, payload=Speeds)
packet(
    "State",
    direction="from device",
    prefix=Struct("kind" / Byte),
    match={"kind": 3},
    payload=Struct(*Speeds.subcons, "temperature" / Quantity(Int8sl, unit="°C")),
)


class SerialFan(Fan):
    """The same registers on a line where one speaks at a time."""

    protocol = serial_fan


class SerialFanTwin(FanTwin):
    """The same twin."""

    protocol = serial_fan


SERIAL_ROBOT = ROBOT.replace('"fan"', '"serial_fan"').replace('"can"', '"serial"')
SERIAL_FAN = Driver(
    "serial_fan",
    SerialFan,
    SerialFanTwin,
    SERIAL_ROBOT,
    doc="Two fans on a board",
    source="invented for tests",
)


# ---------------------------------------------------------------------- a line whose header counts packets

counted_fan = Protocol("counted_fan", link="serial", baud=115_200)
counted = counted_fan.framing(
    sync=b"\xa5",
    header=Struct("node" / Byte, "count" / Counter(Byte), "kind" / Byte, "length" / Byte),
    size=this.length + 6,
    max_size=32,
    gap=0.05,
    check=InvertedSum(),
)
counted("Ask", direction="to device", match={"kind": 1, "node": Node})
counted("Set", direction="to device", match={"kind": 2, "node": Node}, payload=Speeds)
counted(
    "State",
    direction="from device",
    match={"kind": 3, "node": Node},
    payload=Struct(*Speeds.subcons, "temperature" / Quantity(Int8sl, unit="°C")),
)


class CountedFan(Fan):
    """The same registers; each side counts its packets."""

    protocol = counted_fan


class CountedFanTwin(FanTwin):
    """The same twin."""

    protocol = counted_fan


COUNTED_ROBOT = ROBOT.replace('"fan"', '"counted_fan"').replace('"can"', '"serial"')
COUNTED_FAN = Driver(
    "counted_fan",
    CountedFan,
    CountedFanTwin,
    COUNTED_ROBOT,
    doc="Two fans on a board",
    source="invented for tests",
)


def drivers(name: str) -> Driver:
    """The drivers of these robots."""
    return {"fan": FAN, "serial_fan": SERIAL_FAN, "counted_fan": COUNTED_FAN}[name]


def robot_of(text: str) -> Robot:
    """A robot of a text that is right."""
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return robot
