"""A unit that is loaded by packets of J1939 to its address, and its tool: for tests of the handshake of RTS and CTS."""

from __future__ import annotations

from typing import Any, ClassVar

from construct import Byte, Const, GreedyBytes, Struct

from aces_bus.device import Device, Driver, Robot, Twin, on
from aces_bus.protocol import IdField, J1939Transport, Protocol
from aces_bus.robot import parse_robot

crane = Protocol("crane", link="can", bitrate=250_000)
Priority, Unit, Tool = (
    IdField("priority", range(8)),
    IdField("unit", range(254)),
    IdField("tool", range(254)),
)
long = J1939Transport(senders=2)
TO_UNIT, TO_TOOL = (
    Priority << 26 | 0xEF0000 | to << 8 | source for to, source in ((Unit, Tool), (Tool, Unit))
)
Load = crane.message(
    "Load",
    transport=long,
    id=TO_UNIT,
    extended=True,
    direction="to device",
    payload=Struct(Const(1, Byte), "data" / GreedyBytes),
)
crane.message(
    "Stop",
    transport=long,
    id=TO_UNIT,
    extended=True,
    direction="to device",
    payload=Struct(Const(2, Byte), "why" / GreedyBytes),
)
crane.message(
    "Report",
    transport=long,
    id=TO_TOOL,
    extended=True,
    direction="from device",
    reply_to=Load,
    payload=Struct(Const(3, Byte), "data" / GreedyBytes),
)
crane.message(
    "Faults",
    transport=long,
    id=Priority << 26 | 0xFECA00 | Unit,
    extended=True,
    direction="from device",
    payload=Struct("data" / GreedyBytes),
)


class CraneDevice(Device):
    """Loads, and keeps the faults that it is given."""

    protocol: ClassVar[str | Protocol] = crane

    def setup(self) -> None:
        self.noted: list[bytes] = []

    def received(self, record: Any, instant: int) -> None:
        if type(record).__name__ == "Faults":
            self.noted.append(record.data)


class CraneTwin(Twin):
    """Reports what it was loaded with, the other way round."""

    protocol: ClassVar[str | Protocol] = crane

    def setup(self) -> None:
        self.loaded: list[bytes] = []
        self.stopped: list[bytes] = []

    @on("Load")
    def load(self, request: Any) -> None:
        self.loaded.append(request.data)
        self.reply("Report", priority=6, data=request.data[::-1])

    @on("Stop")
    def stop_moving(self, request: Any) -> None:
        self.stopped.append(request.why)


#: Addresses of the units, and of the tool.
A, B, C, TOOL = 0x10, 0x11, 0x12, 0xF9
ROBOT = f"""
name = "yard"
[buses]
line = {{ link = "can", protocol = "crane" }}
[devices]
A = {{ driver = "crane", bus = "line", credentials = {{ unit = {A}, tool = {TOOL} }} }}
B = {{ driver = "crane", bus = "line", credentials = {{ unit = {B}, tool = {TOOL} }} }}
C = {{ driver = "crane", bus = "line", credentials = {{ unit = {C}, tool = {TOOL} }} }}
"""
DRIVER = Driver("crane", CraneDevice, CraneTwin, ROBOT, doc="A crane", source="invented for tests")
LOAD = {"crane": DRIVER}.__getitem__


def robot_of_cranes() -> Robot:
    """A robot with three."""
    robot, problems = parse_robot(ROBOT, "yard")
    assert robot is not None, problems
    return robot
