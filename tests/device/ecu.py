"""An ECU that is asked by ISO-TP, and its twin: for tests of devices whose messages take several frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from construct import Byte, Bytes, Const, GreedyBytes, Int16ub, Struct

from aces_bus.device import Device, Driver, Poll, Robot, Twin, on, signal
from aces_bus.protocol import IdField, IsoTp, Protocol
from aces_bus.robot import parse_robot

ecu = Protocol("ecu", link="can", bitrate=500_000)
Ecu = IdField("ecu", range(8))
uds = IsoTp(to_device=0x7E0 + Ecu, from_device=0x7E8 + Ecu)
ecu.message("Ask", transport=uds, direction="to device", payload=Struct(Const(0x22, Byte), "what" / Int16ub))
ecu.message(
    "Answer",
    transport=uds,
    direction="from device",
    payload=Struct(Const(0x62, Byte), "what" / Int16ub, "speed" / Int16ub, "text" / Bytes(30)),
)
ecu.message(
    "Write",
    transport=uds,
    direction="to device",
    payload=Struct(Const(0x2E, Byte), "what" / Int16ub, "data" / GreedyBytes),
)
ecu.message(
    "Written", transport=uds, direction="from device", payload=Struct(Const(0x6E, Byte), "what" / Int16ub)
)


class EcuDevice(Device):
    """Asked for its speed again and again."""

    protocol: ClassVar[str | Protocol] = ecu
    polls: Sequence[Poll] = (Poll("Ask", reply="Answer", fields={"what": 1}),)
    provides = (signal("speed", unit="rad/s", of="Answer.speed"),)


class EcuTwin(Twin):
    """Keeps what is written."""

    protocol: ClassVar[str | Protocol] = ecu

    def setup(self) -> None:
        self.written = b""

    @on("Ask")
    def answer(self, request: Any) -> None:
        self.reply("Answer", what=request.what, speed=7, text=bytes(30))

    @on("Write")
    def write(self, request: Any) -> None:
        self.written = request.data
        self.reply("Written", what=request.what)


ROBOT = """
name = "car"
rate_hz = 20
[buses]
line = { link = "can", protocol = "ecu" }
[devices]
A = { driver = "ecu", bus = "line", credentials = { ecu = 1 } }
"""
DRIVER = Driver("ecu", EcuDevice, EcuTwin, ROBOT, doc="An ECU", source="invented for tests")


LOAD = {"ecu": DRIVER}.__getitem__


def robot_of_ecu() -> Robot:
    """A robot with one."""
    robot, problems = parse_robot(ROBOT, "car")
    assert robot is not None, problems
    return robot
