"""A motor on CAN as its manual has it: requests and answers by a command in byte 0."""

from __future__ import annotations

from construct import Byte, Float32l, Int16sl, Int16ul, Int32sl, Int32ul, Struct

from aces_bus.protocol import Enumeration, Flags, IdField, Protocol, Quantity, Reserved

rmd = Protocol("rmd", link="can", bitrate=1_000_000, source="Motor Motion Protocol V4.2")
Motor = IdField("id", range(1, 33))
ERRORS = {"stall": 1, "low_voltage": 2, "over_voltage": 3, "over_current": 4}
ask = rmd.family(id=0x140 + Motor, direction="to device", prefix=Struct("command" / Byte))
tell = rmd.family(id=0x240 + Motor, direction="from device", prefix=Struct("command" / Byte))

GetStatus = ask("GetStatus", command=0x9A, payload=Struct("zero" / Reserved(7)))
tell(
    "Status",
    command=0x9A,
    reply_to=GetStatus,
    payload=Struct(
        "temperature" / Quantity(Byte, unit="°C"),
        "zero" / Reserved(1),
        "brake" / Enumeration(Byte, locked=0, released=1),
        "voltage" / Quantity(Int16ul, unit="V", scale=0.1, range=(0, 60)),
        "errors" / Flags(Int16ul, ERRORS),
    ),
    examples=[
        (
            "241#9A 32 00 01 E5 01 04 00",
            {"temperature": 50, "brake": "released", "voltage": 48.5, "errors": ["low_voltage"]},
        )
    ],
)
GetMotion = ask("GetMotion", command=0x9C, payload=Struct("zero" / Reserved(7)))
tell(
    "Motion",
    command=0x9C,
    reply_to=GetMotion,
    payload=Struct(
        "temperature" / Quantity(Byte, unit="°C"),
        "current" / Quantity(Int16sl, unit="A", scale=0.01, range=(-40, 40)),
        "speed" / Quantity(Int16sl, unit="°/s"),
        "position" / Quantity(Int16sl, unit="°"),
    ),
)
SetSpeed = ask(
    "SetSpeed",
    command=0xA2,
    payload=Struct("zero" / Reserved(3), "speed" / Quantity(Int32sl, unit="°/s", scale=0.01)),
    examples=[("141#A2 00 00 00 10 27 00 00", {"id": 1, "speed": 100.0})],
)
tell(
    "SpeedSet",
    command=0xA2,
    reply_to=SetSpeed,
    payload=Struct(
        "temperature" / Quantity(Byte, unit="°C"),
        "current" / Quantity(Int16sl, unit="A", scale=0.01),
        "speed" / Quantity(Int16sl, unit="°/s"),
        "encoder" / Int16ul,
    ),
)
GetAngle = ask("GetAngle", command=0x92, payload=Struct("zero" / Reserved(7)))
tell(
    "Angle",
    command=0x92,
    reply_to=GetAngle,
    payload=Struct("zero" / Reserved(3), "angle" / Quantity(Int32sl, unit="°", scale=0.01)),
)
GetGain = ask(
    "GetGain",
    command=0x30,
    payload=Struct(
        "gain" / Enumeration(Byte, current_kp=1, current_ki=2, speed_kp=4, speed_ki=5, position_kp=7),
        "zero" / Reserved(6),
    ),
)
tell(
    "Gain",
    command=0x30,
    reply_to=GetGain,
    payload=Struct(
        "gain" / Enumeration(Byte, current_kp=1, current_ki=2, speed_kp=4, speed_ki=5, position_kp=7),
        "zero" / Reserved(2),
        "value" / Float32l,
    ),
    examples=[("241#30 01 00 00 00 00 C0 3F", {"gain": "current_kp", "value": 1.5})],
)
GetRunTime = ask("GetRunTime", command=0xB1, payload=Struct("zero" / Reserved(7)))
tell(
    "RunTime",
    command=0xB1,
    reply_to=GetRunTime,
    payload=Struct("zero" / Reserved(3), "time" / Quantity(Int32ul, unit="ms")),
)
