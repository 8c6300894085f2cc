"""LDROBOT LD06, LD14P, LD19, STL19P: laser scanners that send without being asked, twelve distances a packet.

1. Five low bits of the byte behind the mark count the points of three bytes, and with them say the size. They are always 12
   (manual): packets with others are whole, and unknown.
2. The angles of the points are spread evenly from the first to the last one, clockwise.

Source: LDROBOT, "LD06 LiDAR Development Manual", chapter 3 (packet, example); motor commands of the LD14P as lds2d 0.7.0
has them.
"""

from __future__ import annotations

from construct import Array, Byte, Int16ul, Struct, this

from aces_bus.protocol import Crc, Protocol, Quantity, Reserved

#: Points of a packet.
POINTS = 12

ld06 = Protocol(
    "ld06",
    link="serial",
    baud=230_400,
    doc="LDROBOT LD06, LD14P, LD19, STL19P: distances by angle, twelve a packet.",
    source="LDROBOT, LD06 LiDAR Development Manual",
)
_packet = ld06.framing(
    sync=b"\x54",
    header=Struct("points_counted" / Byte),
    size=(this.points_counted & 31) * 3 + 11,
    max_size=104,  # of 31 points
    gap=0.1,
    check=Crc(width=8, poly=0x4D, over=slice(0, -1)),
)
_angle = Quantity(Int16ul, unit="°", scale=0.01)
_packet(
    "Measurements",
    match={"points_counted": 0x20 | POINTS},
    direction="from device",
    payload=Struct(
        "speed" / Quantity(Int16ul, unit="°/s"),
        "start_angle" / _angle,
        "points" / Array(POINTS, Struct("distance" / Quantity(Int16ul, unit="mm"), "intensity" / Byte)),
        "end_angle" / _angle,
        "time" / Quantity(Int16ul, unit="ms", doc="begins again at 30,000"),
    ),
    doc="Twelve distances from start_angle to end_angle; a distance of 0 was not measured.",
    source="manual, chapter 3",
    # the manual's example
    examples=[("54 2C 68 08 AB 7E E0 00 E4 DC 00 E2 D9 00 E5 D5 00 E3 D3 00 E4 D0 00 E9 CD 00 E4 CA 00 E2 C7 00 E9 C5 00 E5"
        " C2 00 E5 C0 00 E5 BE 82 3A 1A 50", {"speed": 2152, "start_angle": 324.27, "end_angle": 334.7, "time": 6714,
        "points": [{"distance": d, "intensity": i} for d, i in (
            (224, 228), (220, 226), (217, 229), (213, 227), (211, 228), (208, 233), (205, 228), (202, 226), (199, 233),
            (197, 229), (194, 229), (192, 229))]})],
)  # fmt: skip

# ---------------------------------------------------------------------- motor of the LD14P

_command = ld06.framing(
    sync=b"\x54",
    header=Struct("command" / Byte, "size" / Byte),
    size=8,
    gap=0.1,
    check=Crc(width=8, poly=0x4D, over=slice(0, -1)),
    name="commands",
)
_command("Start", match={"command": 0xA0, "size": 4}, payload=Struct("reserved" / Reserved(4)), direction="to device",
    doc="Turn, and measure.", source="lds2d 0.7.0", examples=[("54 A0 04 00 00 00 00 5E", {})])  # fmt: skip
_command("Stop", match={"command": 0xA1, "size": 4}, payload=Struct("reserved" / Reserved(4)), direction="to device",
    doc="Stand still.", source="lds2d 0.7.0", examples=[("54 A1 04 00 00 00 00 4A", {})])  # fmt: skip
_command("SetSpeed", match={"command": 0xA2, "size": 4}, direction="to device", source="lds2d 0.7.0",
    payload=Struct("speed" / Quantity(Int16ul, unit="°/s", range=(720, 2880)), "reserved" / Reserved(2)),
    doc="Turn at another speed, 2 to 8 rounds a second.",
    examples=[("54 A2 04 70 08 00 00 A1", {"speed": 2160})])  # fmt: skip

__all__ = ["POINTS", "ld06"]
