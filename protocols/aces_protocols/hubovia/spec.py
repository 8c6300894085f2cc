"""HuboVia: one datagram a joint command, to the Windows control PC of a Hubo 2.

1. An angle is a sign, whole degrees and hundredths, three fields as they stand: −87.73° is 87 and 73, negative.
2. The check is the sum of motor, degrees and hundredths; the sheet multiplies it by the number of motors, always 1.

Source: acesHubo `huboVia`, `huboTxPacket`.
"""

from __future__ import annotations

from construct import Byte, Struct

from aces_bus.protocol import BitLayout, Protocol, Quantity, Sum, bits

hubovia = Protocol(
    "hubovia",
    link="datagram",
    doc="Joint commands to the control PC of a Hubo 2: UDP, fire and forget.",
    source="acesHubo huboVia, huboTxPacket",
)

datagram = hubovia.framing(
    sync=b"\xff\x41",  # start, 'A': advanced mode
    size=8,
    check=Sum(over=slice(3, 7)),
)

Joint = datagram(
    "Joint",
    direction="to device",
    prefix=Struct("motors" / Byte, "motor" / Byte),
    match={"motors": 1},
    payload=Struct(
        "angle"
        / BitLayout(
            3,
            "negative" / bits(1),
            "degrees" / Quantity(bits(15), unit="°"),
            "hundredths" / Quantity(bits(8), scale=0.01, unit="°", range=(0, 0.99)),
            order="msb",
        ),
    ),
    doc="Move a motor's joint to an angle.",
    source="acesHubo huboVia",
    examples=[
        (
            "FF 41 01 23 80 57 49 43",
            {"motor": 35, "angle": {"negative": 1, "degrees": 87, "hundredths": 0.73}},
        ),
        (
            "FF 41 01 1E 00 2D 32 7D",
            {"motor": 30, "angle": {"negative": 0, "degrees": 45, "hundredths": 0.5}},
        ),
        (
            "FF 41 01 1E 01 2C 19 64",
            {"motor": 30, "angle": {"negative": 0, "degrees": 300, "hundredths": 0.25}},
        ),
    ],
)
