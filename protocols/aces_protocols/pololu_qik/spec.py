"""Pololu qik dual motor drivers in the multi-drop format ("Pololu protocol"), without a check byte.

1. Only the first byte of a command has its high bit set: a device number or argument of 0x80 or more is not a command.
2. An answer is one bare byte: the request before says what it means and whose it is, so one asks at a time.
3. Motor commands are never answered.

Sources: acesHubo `omnibot`, which used the 7-bit commands and parsed no answer; Pololu 0J25, the *Qik 2s9v1 User's Guide*,
for answers, error bits and the 8-bit range.
"""

from __future__ import annotations

from construct import Byte, Const, Struct

from aces_bus.protocol import Enumeration, Flags, IdField, Protocol, Text

#: Numbers of devices and arguments: seven bits.
SEVEN = range(128)

pololu_qik = Protocol(
    "pololu_qik",
    link="serial",
    baud=38_400,  # with the fixed-baud jumper; without it 1200 to 38 400, found from the first byte, which is AA
    doc="Pololu qik dual motor drivers, several on one serial line.",
    source="acesHubo omnibot; Pololu 0J25 (Qik 2s9v1 User's Guide)",
)

#: A longer pause inside a command is a host that went away. The guide names no such time.
GAP = 0.1
_HEADER = Struct("id" / Byte, "command" / Byte)

# Answers stand first: while a request is open the next byte is its answer, be it AA.
reply = pololu_qik.framing(name="reply", size=1)
bare = pololu_qik.framing(name="bare", sync=b"\xaa", header=_HEADER, size=3, gap=GAP)
one = pololu_qik.framing(name="one argument", sync=b"\xaa", header=_HEADER, size=4, gap=GAP)
setting = pololu_qik.framing(name="setting", sync=b"\xaa", header=_HEADER, size=7, gap=GAP)

Motor = IdField("motor", range(2), doc="motor M0 or M1")
_PARAMETERS = {"device_id": 0, "pwm": 1, "shutdown_on_error": 2, "serial_timeout": 3}

# ---------------------------------------------------------------------- requests

GetFirmware = bare(
    "GetFirmware",
    direction="to device",
    match={"id": SEVEN, "command": 0x01},
    doc="Ask for the firmware's version.",
    source="acesHubo omnibot; Pololu 0J25 5.a",
    examples=[("AA 01 01", {"id": 1})],
)
GetError = bare(
    "GetError",
    direction="to device",
    match={"id": SEVEN, "command": 0x02},
    doc="Ask for the errors since they were last asked for; asking clears them.",
    source="acesHubo omnibot; Pololu 0J25 5.b",
    examples=[("AA 02 02", {"id": 2})],
)
GetConfiguration = one(
    "GetConfiguration",
    direction="to device",
    match={"id": SEVEN, "command": 0x03},
    payload=Struct("parameter" / Enumeration(Byte, _PARAMETERS)),
    doc="Ask for a parameter.",
    source="acesHubo omnibot; Pololu 0J25 5.c",
    examples=[("AA 01 03 03", {"id": 1, "parameter": "serial_timeout"})],
)
SetConfiguration = setting(
    "SetConfiguration",
    direction="to device",
    match={"id": SEVEN, "command": 0x04, "value": SEVEN},
    prefix=Struct("parameter" / Enumeration(Byte, _PARAMETERS), "value" / Byte),
    payload=Struct(Const(b"\x55\x2a")),
    doc="Set a parameter, which survives power-off; takes 4 ms. A new `pwm` stops the motors.",
    source="acesHubo omnibot; Pololu 0J25 5.c",
    examples=[("AA 01 04 00 05 55 2A", {"id": 1, "parameter": "device_id", "value": 5})],
)

# ---------------------------------------------------------------------- motors

Coast = bare(
    "Coast",
    direction="to device",
    match={"id": SEVEN, "command": 0x06 + Motor},
    doc="Let a motor turn freely.",
    source="acesHubo omnibot; Pololu 0J25 5.d",
    examples=[("AA 01 06", {"id": 1, "motor": 0}), ("AA 01 07", {"id": 1, "motor": 1})],
)
SetSpeed = one(
    "SetSpeed",
    direction="to device",
    match={
        "id": SEVEN,
        "command": 0x08
        | Motor << 2
        | IdField("reverse", range(2), doc="1: backwards") << 1
        | IdField("high", range(2), doc="1: 128 more, in the 8-bit range"),
        "speed": SEVEN,
    },
    prefix=Struct("speed" / Byte),
    doc="Drive a motor at a share of the supply: of 127 (`high` has no meaning), or of 255 in the 8-bit range. 0 brakes.",
    source="acesHubo omnibot; Pololu 0J25 5.e",
    examples=[
        ("AA 01 0A 32", {"id": 1, "motor": 0, "reverse": 1, "high": 0, "speed": 50}),
        ("AA 02 0C 7F", {"id": 2, "motor": 1, "reverse": 0, "high": 0, "speed": 127}),
        ("AA 01 09 7F", {"id": 1, "motor": 0, "reverse": 0, "high": 1, "speed": 127}),
    ],
)

# ---------------------------------------------------------------------- answers

#: An answer comes at once, after SetConfiguration 4 ms later; the rest is for adapters that collect bytes.
WITHIN = 0.1

Firmware = reply(
    "Firmware",
    direction="from device",
    reply_to=GetFirmware.where(id=SEVEN),
    within=WITHIN,
    payload=Struct("version" / Text(1)),
    doc="The firmware's version, a character: 1 or 2 so far.",
    source="Pololu 0J25 5.a",
    examples=[("31", {"id": 1, "version": "1"}, "AA 01 01")],
)
Errors = reply(
    "Errors",
    direction="from device",
    reply_to=GetError.where(id=SEVEN),
    within=WITHIN,
    payload=Struct("errors" / Flags(Byte, overrun=3, frame=4, crc=5, format=6, timeout=7)),
    doc="What went wrong since the errors were last asked for.",
    source="Pololu 0J25 5.b",
    examples=[("C0", {"id": 2, "errors": ["format", "timeout"]}, "AA 02 02")],
)
Configuration = reply(
    "Configuration",
    direction="from device",
    reply_to=GetConfiguration.where(id=SEVEN),
    within=WITHIN,
    payload=Struct("value" / Byte),
    doc="A parameter's value; 0xFF for a parameter that does not exist.",
    source="Pololu 0J25 5.c",
    examples=[("05", {"id": 1, "value": 5}, "AA 01 03 00")],
)
ConfigurationSet = reply(
    "ConfigurationSet",
    direction="from device",
    reply_to=SetConfiguration.where(id=SEVEN),
    within=WITHIN,
    payload=Struct("result" / Enumeration(Byte, ok=0, bad_parameter=1, bad_value=2)),
    doc="Whether a parameter was set.",
    source="Pololu 0J25 5.c",
    examples=[
        ("00", {"id": 1, "result": "ok"}, "AA 01 04 00 05 55 2A"),
        ("01", {"id": 1, "result": "bad_parameter"}, "AA 01 04 00 05 55 2A"),
        ("02", {"id": 1, "result": "bad_value"}, "AA 01 04 00 05 55 2A"),
    ],
)
