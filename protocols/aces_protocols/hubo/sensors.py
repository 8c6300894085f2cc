"""Sensor boards: requests (identifier 0x002), set-up commands, and what the boards send.

1. Requests and data carry the sensor id, commands the board number, which is 0x2F more.
2. A request names what it asks for, so each kind is a message: asking for tilt does not change how force comes.
"""

from __future__ import annotations

from construct import Array, Byte, Int16sl, Int16ul, Struct

from aces_bus.protocol import Enumeration, Quantity

from .base import D08, Off, Sensor, command, hubo, sensors

# ---------------------------------------------------------------------- requests

SensorRequestD08 = hubo.message(
    "SensorRequestD08",
    id=0x002,
    direction="to device",
    dialect=D08,
    payload=Struct("mode" / Enumeration(Byte, all=0)),
    doc="Ask every sensor; other values hold one sensor's number and type, but the sheet is cut off there.",
    source="X2; acesHubo",
    examples=[("002#00", {"mode": "all"})],
)

#: Requests of D12: which sensor (0xFF is all of them) and which form of its data.
request = hubo.family(
    Struct(
        "sensor" / Byte,
        "mode"
        / Enumeration(
            Byte,
            digital=0x00,
            scaled=0x02,
            scaled_tilt_digital=0x03,
            digital_tilt_scaled=0x04,
            ft_digital=0x11,
            ft_scaled=0x12,
            tilt_digital=0x21,
            tilt_scaled=0x22,
            gyro=0x13,
        ),
    ),
    id=0x002,
    direction="to device",
    dialect="D12",
)
SensorRequest = request(
    "SensorRequest",
    mode=(0x00, 0x02, 0x03, 0x04),
    doc="Ask for force/torque and acceleration (tilt) together.",
    source="hubo-ach; RoboWorld2018 (sensor 0xFF)",
    examples=[("002#FF 02", {"sensor": 0xFF, "mode": "scaled"})],
)
ForceTorqueRequest = request(
    "ForceTorqueRequest",
    mode=(0x11, 0x12),
    doc="Ask for force and torque.",
    source="hubo-ach; HuboCan",
    examples=[("002#01 12", {"sensor": 1, "mode": "ft_scaled"})],
)
TiltRequest = request(
    "TiltRequest",
    mode=(0x21, 0x22),
    doc="Ask for the acceleration (tilt) of a foot.",
    source="hubo-ach; HuboCan",
    examples=[("002#02 22", {"sensor": 2, "mode": "tilt_scaled"})],
)
GyroRequest = request(
    "GyroRequest",
    mode=0x13,
    doc="Ask for gyro and temperature; the form of the answer is not known.",
    source="hubo-ach",
    examples=[("002#03 13", {"sensor": 3})],
)
ImuRequest = request(
    "ImuRequest",
    mode=0x00,
    payload=Struct("select" / Enumeration(Byte, imu=1)),
    doc="Ask an IMU: the third byte distinguishes its request from a force/torque one.",
    source="hubo-ach; HuboCan",
    examples=[("002#03 00 01", {"sensor": 3, "select": "imu"})],
)

# ---------------------------------------------------------------------- 0x81–0x89: set-up

NullSensor = command(
    "NullSensor",
    opcode=0x81,
    payload=Struct("what" / Enumeration(Byte, force_torque=0, mx=1, my=2, fz=3, tilt=4)),
    doc="Take the present reading as zero; `tilt` is of D12, single axes are of D08.",
    source="X1; acesHubo; hubo-ach; HuboCan; RoboWorld2018",
    examples=[
        ("001#30 81 00", {"board": 0x30, "what": "force_torque"}),
        ("001#30 81 04", {"board": 0x30, "what": "tilt"}),
    ],
)
NullImu = command(
    "NullImu",
    opcode=0x81,
    dialect="D12",
    doc="Take the present reading of an IMU as zero.",
    source="hubo-ach; HuboCan; RoboWorld2018",
    examples=[("001#32 81", {"board": 0x32})],
)
SetPeriod = command(
    "SetPeriod",
    opcode=0x82,
    dialect=D08,
    payload=Struct("period" / Byte),
    doc="Set the sending period.",
    source="X2",
    examples=[("001#30 82 0A", {"board": 0x30, "period": 10})],
)
SetSample = command(
    "SetSample",
    opcode=0x83,
    dialect=D08,
    payload=Struct("sample" / Int16ul),
    doc="Set the sampling.",
    source="X2",
    examples=[
        ("001#30 83 2C 01", {"board": 0x30, "sample": 300}),
        ("001#30 83 FF FF", {"board": 0x30, "sample": 65535}),
    ],
)
AdRead = command(
    "AdRead",
    opcode=0x84,
    dialect=D08,
    payload=Struct("state" / Off),
    doc="Switch analogue reading.",
    source="X2",
    examples=[("001#30 84 01", {"board": 0x30, "state": "on"})],
)
DaOut = command(
    "DaOut",
    opcode=0x85,
    dialect=D08,
    payload=Struct("value" / Int16ul),
    doc="Put out an analogue value.",
    source="X2",
    examples=[
        ("001#30 85 2C 01", {"board": 0x30, "value": 300}),
        ("001#30 85 FF FF", {"board": 0x30, "value": 65535}),
    ],
)
DataType = command(
    "DataType",
    opcode=0x86,
    dialect=D08,
    payload=Struct("type" / Enumeration(Byte, raw=0, average=1)),
    doc="Send raw or averaged data.",
    source="X2",
    examples=[("001#30 86 01", {"board": 0x30, "type": "average"})],
)
DaOffsetQuery = command(
    "DaOffsetQuery",
    opcode=0x87,
    dialect=D08,
    doc="Ask for the D/A offsets.",
    source="X2",
    examples=[("001#30 87", {"board": 0x30})],
)
AdOffsetQuery = command(
    "AdOffsetQuery",
    opcode=0x88,
    dialect=D08,
    doc="Ask for the A/D offsets.",
    source="X2",
    examples=[("001#30 88", {"board": 0x30})],
)
OffsetQuery = command(
    "OffsetQuery",
    opcode=0x89,
    dialect=D08,
    payload=Struct("axis" / Enumeration(Byte, mx=1, my=2, fz=3)),
    doc="Ask for both offsets of one axis.",
    source="X2",
    examples=[("001#30 89 03", {"board": 0x30, "axis": "fz"})],
)

# ---------------------------------------------------------------------- 0x040, 0x050: data

_AXES = Struct("mx" / Int16sl, "my" / Int16sl, "fz" / Int16sl)
ForceTorqueD08 = hubo.message(
    "ForceTorqueD08",
    id=0x040 + Sensor,
    direction="from device",
    dialect=D08,
    reply_to=SensorRequestD08,
    payload=_AXES,
    doc="Force and torque in the sensor's own digits.",
    source="X2; acesHubo",
    examples=[
        ("041#85 FF C8 01 C9 09", {"sensor": 1, "mx": -123, "my": 456, "fz": 2505}),
        ("041#85 FF FF FF FE FF", {"sensor": 1, "mx": -123, "my": -1, "fz": -2}),
    ],
)
ForceTorque = hubo.message(
    "ForceTorque",
    id=0x040 + Sensor,
    direction="from device",
    dialect="D12",
    when=sensors("foot", "ft"),
    after=(
        SensorRequest.where(mode=("scaled", "scaled_tilt_digital")),
        ForceTorqueRequest.where(mode="ft_scaled"),
    ),
    payload=Struct(
        "mx" / Quantity(Int16sl, scale=0.01, unit="N·m"),
        "my" / Quantity(Int16sl, scale=0.01, unit="N·m"),
        "fz" / Quantity(Int16sl, scale=0.1, unit="N"),
    ),
    doc="Force and torque; the same bytes in digits are ForceTorqueDigits, so the request must have been seen.",
    source="hubo-ach; HuboCan",
    examples=[
        ("041#85 FF C8 01 C9 09", {"sensor": 1, "mx": -1.23, "my": 4.56, "fz": 250.5}, "002#01 12"),
        ("041#01 00 FF FF FE FF", {"sensor": 1, "mx": 0.01, "my": -0.01, "fz": -0.2}, "002#01 12"),
    ],
)
ForceTorqueDigits = hubo.message(
    "ForceTorqueDigits",
    id=0x040 + Sensor,
    direction="from device",
    dialect="D12",
    when=sensors("foot", "ft"),
    after=(
        SensorRequest.where(mode=("digital", "digital_tilt_scaled")),
        ForceTorqueRequest.where(mode="ft_digital"),
    ),
    payload=_AXES,
    doc="Force and torque in the sensor's own digits.",
    source="hubo-ach canID.h",
    examples=[("041#85 FF C8 01 C9 09", {"sensor": 1, "mx": -123, "my": 456, "fz": 2505}, "002#01 11")],
)
Tilt = hubo.message(
    "Tilt",
    id=0x050 + Sensor,
    direction="from device",
    dialect="D12",
    when=sensors("foot"),
    after=(
        SensorRequest.where(mode=("scaled", "digital_tilt_scaled")),
        TiltRequest.where(mode="tilt_scaled"),
    ),
    payload=Struct(
        "ax" / Quantity(Int16sl, scale=0.01, unit="deg"),
        "ay" / Quantity(Int16sl, scale=0.01, unit="deg"),
        "az" / Quantity(Int16sl, scale=1 / 750, unit="g"),
    ),
    doc="Tilt of a foot and its vertical acceleration.",
    source="hubo-ach; HuboCan (both also turn `az` from degrees to radians, which makes no sense of g)",
    examples=[
        ("051#7D 00 CE FF EE 02", {"sensor": 1, "ax": 1.25, "ay": -0.5, "az": 1.0}, "002#01 22"),
        ("051#FF FF FE FF FD FF", {"sensor": 1, "ax": -0.01, "ay": -0.02, "az": -0.004}, "002#01 22"),
    ],
)
TiltDigits = hubo.message(
    "TiltDigits",
    id=0x050 + Sensor,
    direction="from device",
    dialect="D12",
    when=sensors("foot"),
    after=(
        SensorRequest.where(mode=("digital", "scaled_tilt_digital")),
        TiltRequest.where(mode="tilt_digital"),
    ),
    payload=Struct("ax" / Int16sl, "ay" / Int16sl, "az" / Int16sl),
    doc="Acceleration of a foot in the sensor's own digits.",
    source="hubo-ach canID.h",
    examples=[
        ("051#7D 00 CE FF EE 02", {"sensor": 1, "ax": 125, "ay": -50, "az": 750}, "002#01 21"),
        ("051#FF FF FE FF FD FF", {"sensor": 1, "ax": -1, "ay": -2, "az": -3}, "002#01 21"),
    ],
)
Imu = hubo.message(
    "Imu",
    id=0x050 + Sensor,
    direction="from device",
    dialect="D12",
    when=sensors("imu"),
    reply_to=ImuRequest,
    payload=Struct(
        "roll" / Quantity(Int16sl, scale=0.01, unit="deg"),
        "pitch" / Quantity(Int16sl, scale=0.01, unit="deg"),
        "roll_rate" / Quantity(Int16sl, scale=0.01, unit="deg/s"),
        "pitch_rate" / Quantity(Int16sl, scale=0.01, unit="deg/s"),
    ),
    doc="Attitude of the body.",
    source="hubo-ach; HuboCan",
    examples=[
        (
            "053#6A FF 4B 00 2E FB 2C 01",
            {"sensor": 3, "roll": -1.5, "pitch": 0.75, "roll_rate": -12.34, "pitch_rate": 3.0},
        ),
        (
            "053#01 00 FF FF 02 00 FE FF",
            {"sensor": 3, "roll": 0.01, "pitch": -0.01, "roll_rate": 0.02, "pitch_rate": -0.02},
        ),
    ],
)
ImuD08 = hubo.message(
    "ImuD08",
    id=0x050 + Sensor,
    direction="from device",
    dialect=D08,
    reply_to=SensorRequestD08,
    payload=Struct("acceleration" / Array(2, Int16sl), "gyro" / Array(2, Int16sl)),
    doc="Acceleration and rotation in the sensor's own digits.",
    source="X2; acesHubo (which forgets the sign here)",
    examples=[
        ("053#6A FF 4B 00 2E FB 2C 01", {"sensor": 3, "acceleration": [-150, 75], "gyro": [-1234, 300]})
    ],
)

# ---------------------------------------------------------------------- 0x310–0x330: offsets

DaOffset = hubo.message(
    "DaOffset",
    id=0x310 + Sensor,
    direction="from device",
    dialect=D08,
    reply_to=DaOffsetQuery,
    payload=_AXES,
    doc="D/A offsets; that they are signed is a guess.",
    source="X2",
    examples=[("311#01 00 FF FF 02 00", {"sensor": 1, "mx": 1, "my": -1, "fz": 2})],
)
AdOffset = hubo.message(
    "AdOffset",
    id=0x320 + Sensor,
    direction="from device",
    dialect=D08,
    reply_to=AdOffsetQuery,
    payload=_AXES,
    doc="A/D offsets; that they are signed is a guess.",
    source="X2",
    examples=[("321#01 00 FF FF 02 00", {"sensor": 1, "mx": 1, "my": -1, "fz": 2})],
)
OffsetPair = hubo.message(
    "OffsetPair",
    id=0x330 + Sensor,
    direction="from device",
    dialect=D08,
    reply_to=OffsetQuery,
    payload=Struct("ad" / Int16sl, "da" / Int16sl),
    doc="Both offsets of the axis that was asked for; that they are signed is a guess.",
    source="X2",
    examples=[
        ("331#01 00 FF FF", {"sensor": 1, "ad": 1, "da": -1}),
        ("331#FF FF 01 00", {"sensor": 1, "ad": -1, "da": 1}),
    ],
)
