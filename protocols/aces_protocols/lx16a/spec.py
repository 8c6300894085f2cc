"""Hiwonder LX-16A and its like: bus servos on one half-duplex line, a command number for each thing that is set or asked.

1. A question and its answer have the same command number and differ in their length, and in who speaks.
2. What is written is never answered. An answer comes from one servo; whoever asks all of them at once must have one.

Source: pylx16a 1.1.1 (its packets, as facts); Hiwonder's LX-16A bus communication protocol.
"""

from __future__ import annotations

from typing import Any

from construct import Byte, Const, Construct, Int8sl, Int16sl, Int16ul, Struct, this

from aces_bus.protocol import Enumeration, Flags, InvertedSum, Protocol, Quantity

BROADCAST = 0xFE
#: Identifiers of single servos.
SERVOS = range(BROADCAST)
#: ° of a count; counts of the whole range, 240°.
ANGLE, TURN = 0.24, 1000
#: The longest time of a move (ms).
LONGEST_MS = 30_000

lx16a = Protocol(
    "lx16a",
    link="serial",
    baud=115_200,
    half_duplex=True,
    broadcast={"id": BROADCAST},
    doc="Hiwonder LX-16A bus servos: half-duplex TTL, several servos on one line.",
    source="pylx16a 1.1.1; Hiwonder LX-16A protocol",
)
packet = lx16a.framing(
    sync=b"\x55\x55",
    header=Struct("id" / Byte, "length" / Byte),
    size=this.length + 3,
    max_size=10,  # of the longest command; the length byte would allow 258
    gap=0.1,
    check=InvertedSum(),
)
told = packet.family(Struct("command" / Byte), direction="to device")
answered = packet.family(Struct("command" / Byte), direction="from device")


def _writes(name: str, command: int, *fields: Construct, doc: str, examples: Any = ()) -> Any:
    return told(
        name,
        command=command,
        payload=Struct(*fields) if fields else None,
        doc=doc,
        source=f"pylx16a, command {command}",
        examples=examples,
    )


def _reads(name: str, command: int, *fields: Construct, doc: str, examples: Any = ()) -> None:
    """Declare the question `GetName`, and its answer `Name`."""
    asked = _writes(f"Get{name}", command, doc=f"Ask for {doc}.")
    answered(
        name,
        command=command,
        match={"id": SERVOS},
        reply_to=asked,
        within=0.1,  # a servo answers at once; the rest is for adapters that collect bytes
        payload=Struct(*fields),
        doc=f"{doc[0].upper()}{doc[1:]}.",
        source=f"pylx16a, command {command}",
        examples=examples,
    )


def _angle(name: str) -> Any:
    return name / Quantity(Int16ul, unit="°", scale=ANGLE, range=(0, 240))


_time = "time" / Quantity(Int16ul, unit="ms", range=(0, LONGEST_MS))
_switch = Enumeration(Byte, off=0, on=1)
_lamp = Enumeration(Byte, on=0, off=1)
_alarms = Flags(Byte, temperature=0, voltage=1, stalled=2)
_millivolts = Quantity(Int16ul, unit="V", scale=0.001)
_mode = ("mode" / Enumeration(Byte, position=0, motor=1), Const(b"\0"), "speed" / Int16sl)

# ---------------------------------------------------------------------- motion

_writes("Move", 1, _angle("angle"), _time, doc="Go to an angle within a time; 0: as fast as it can.",
    examples=[("55 55 01 07 01 F4 01 E8 03 16", {"id": 1, "angle": 120.0, "time": 1000})])  # fmt: skip
_reads("LastMove", 2, _angle("angle"), _time, doc="the move that was commanded last")
_writes("MoveLater", 7, _angle("angle"), _time, doc="A move that is held back until MoveStart.")
_writes("MoveStart", 11, doc="Begin the move that was held back.")
_writes("MoveStop", 12, doc="Stop where it is, and hold.", examples=[("55 55 01 03 0C EF", {"id": 1})])
_writes("SetMode", 29, *_mode, doc="Follow angles, or turn without end at a share of full drive (−1000 … 1000).",
    examples=[("55 55 03 07 1D 01 00 0C FE CD", {"id": 3, "mode": "motor", "speed": -500})])  # fmt: skip
_reads("Mode", 30, *_mode, doc="what it follows")
_writes("SetTorque", 31, "torque" / _switch, doc="Drive the motor, or let it give way.",
    examples=[("55 55 01 04 1F 00 DB", {"id": 1, "torque": "off"})])  # fmt: skip
_reads("Torque", 32, "torque" / _switch, doc="whether the motor is driven")

# ---------------------------------------------------------------------- measured

_reads("Temperature", 26, "temperature" / Quantity(Byte, unit="°C"), doc="the temperature inside")
_reads("Voltage", 27, "voltage" / _millivolts, doc="the supply voltage",
    examples=[("55 55 01 05 1B 2C 1D 95", {"id": 1, "voltage": 7.468}, "55 55 01 03 1B E0")])  # fmt: skip
_reads("Position", 28, "angle" / Quantity(Int16sl, unit="°", scale=ANGLE), doc="the angle where it is",
    examples=[("55 55 01 05 1C F4 01 E8", {"id": 1, "angle": 120.0}, "55 55 01 03 1C DF")])  # fmt: skip

# ---------------------------------------------------------------------- what survives power-off

_writes("SetId", 13, "new_id" / Byte, doc="Another number, for good.")
_reads("Id", 14, "own_id" / Byte, doc="the number of a servo")
_writes("SetOffset", 17, "offset" / Quantity(Int8sl, unit="°", scale=ANGLE, range=(-30, 30)),
    doc="Shift its angles, until power-off.")  # fmt: skip
_writes("SaveOffset", 18, doc="Keep the offset for good.")
_reads("Offset", 19, "offset" / Quantity(Int8sl, unit="°", scale=ANGLE), doc="the offset of its angles")
_writes("SetLimits", 20, _angle("lower"), _angle("upper"), doc="The least and the greatest angle.")
_reads("Limits", 21, _angle("lower"), _angle("upper"), doc="the least and the greatest angle")
_writes(
    "SetVoltageLimits",
    22,
    "lowest" / _millivolts,
    "highest" / _millivolts,
    doc="Supply voltages, 4.5 to 12 V.",
)
_reads(
    "VoltageLimits",
    23,
    "lowest" / _millivolts,
    "highest" / _millivolts,
    doc="the limits of the supply voltage",
)
_writes("SetTemperatureLimit", 24, "highest" / Quantity(Byte, unit="°C", range=(50, 100)),
    doc="Above it the motor is not driven.")  # fmt: skip
_reads("TemperatureLimit", 25, "highest" / Quantity(Byte, unit="°C"), doc="the highest temperature")
_writes("SetLed", 33, "led" / _lamp, doc="The LED.")
_reads("Led", 34, "led" / _lamp, doc="whether the LED is on")
_writes("SetAlarms", 35, "alarms" / _alarms, doc="At what the LED flashes.")
_reads("Alarms", 36, "alarms" / _alarms, doc="at what the LED flashes")

__all__ = ["ANGLE", "BROADCAST", "SERVOS", "TURN", "lx16a"]
