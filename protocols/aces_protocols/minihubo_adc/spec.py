"""The analogue-to-digital converter board of MiniHubo: three channels, streaming without being asked.

1. There is no check: what looks like a frame is one. The rule for FF FF FF below is all that keeps the place.

Source: acesHubo `flexscanner/adc` and a recording of the board.
"""

from __future__ import annotations

from construct import Array, Int16ub, Struct

from aces_bus.protocol import Protocol, Quantity

minihubo_adc = Protocol(
    "minihubo_adc",
    link="serial",
    doc="MiniHubo's analogue-to-digital converter board: three channels, free-running.",
    source="acesHubo flexscanner/adc; a recording of the board",
)

frame = minihubo_adc.framing(
    sync=b"\xff\xff",
    # A sample's high byte is at most 0x0F (12 bits), so FF FF FF is a low byte FF and then the header: its last two.
    not_next=b"\xff",
    size=8,
)

Sample = frame(
    "Sample",
    direction="from device",
    payload=Struct("channels" / Array(3, Quantity(Int16ub, unit="count"))),
    doc="One reading of all three channels, as the converter has it: mid-scale is 2048.",
    source="recording of the board",
    examples=[("FF FF 09 0A 0A F2 08 02", {"channels": [2314, 2802, 2050]})],
)
