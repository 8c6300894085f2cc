"""HuboVia: one datagram a joint command, to the control PC of a Hubo 2.

What it asks of the language: a datagram link; a sum over some of the bytes.

Source: the HuboVia driver of the ACES release. Its check is ((b3 + b4 + b5 + b6) × n) mod 256 with n, the number of
motors, always 1; other n are not accepted. An angle is sign, whole degrees and hundredths, three fields as it stands.
"""

from __future__ import annotations

from construct import Byte, Const, Struct

from aces_bus.protocol import BitLayout, Protocol, Quantity, Sum, bits

hubovia_like = Protocol(
    "hubovia_like", link="datagram", doc="Joint commands over UDP, port 11000.", source="ACES, hubovia"
)

datagram = hubovia_like.framing(sync=b"\xff\x41", size=8, check=Sum(over=slice(3, 7)))

datagram(
    "Joint",
    direction="to device",
    payload=Struct(
        Const(1, Byte),  # number of motors
        "motor" / Byte,
        "angle"
        / BitLayout(
            3,
            "negative" / bits(1),
            "degrees" / Quantity(bits(15), unit="°"),
            "hundredths" / Quantity(bits(8), scale=0.01, unit="°", range=(0, 0.99)),
            order="msb",
        ),
    ),
    doc="Move a joint to an angle.",
    source="ACES, hubovia",
)
