"""A part of Xbus, the protocol of Xsens motion trackers.

What it asks of the language: a length of one byte whose value 255 means that one of two bytes follows; a sum as its two's
complement; requests and answers told by their number.

Source: Xsens, MT low-level communication protocol documentation (general knowledge): EXT LEN is at most 2048; all bytes
behind the preamble and the check add up to 0.
Deviations: the items of MTData2 are bytes.
"""

from __future__ import annotations

from construct import Byte, GreedyBytes, Int16ub, Int32ub, Struct, this

from aces_bus.protocol import Escaped, Protocol, Sum, Text

xbus_like = Protocol(
    "xbus_like",
    link="serial",
    baud=115_200,
    doc="Motion trackers.",
    source="Xsens MT low-level communication protocol",
)
packet = xbus_like.framing(
    sync=b"\xfa\xff",  # preamble, and the bus identifier of a device alone
    header=Struct("mid" / Byte, "length" / Byte),
    size=Escaped(this.length + 5, 255, Int16ub),
    max_size=2055,  # 2048 bytes of data
    gap=0.1,
    check=Sum(negated=True, over=slice(1, -1)),
)
packet("GoToMeasurement", match={"mid": 0x10}, direction="to device", doc="Begin to measure.", source="§4")
packet("GoToConfig", match={"mid": 0x30}, direction="to device", doc="Stop measuring.", source="§4")
packet("ReqDid", match={"mid": 0x00}, direction="to device", doc="Ask for the device's number.", source="§4")
packet(
    "DeviceId",
    match={"mid": 0x01},
    direction="from device",
    payload=Struct("device" / Int32ub),
    doc="The device's number.",
    source="§4",
)
packet(
    "FirmwareText",
    match={"mid": 0x13},
    direction="from device",
    payload=Struct("major" / Byte, "minor" / Byte, "text" / Text()),
    doc="The firmware's version, and what it says of itself.",
    source="§4",
)
packet(
    "MtData2",
    match={"mid": 0x36},
    direction="from device",
    payload=Struct("items" / GreedyBytes),
    doc="Measured values.",
    source="§4",
)
