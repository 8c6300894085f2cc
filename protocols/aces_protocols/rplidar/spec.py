"""SLAMTEC RPLIDAR A1 and A2: a laser that turns and measures distances, on a serial line.

1. Requests begin with A5; those from 0x80 on carry data, its size and an xor. An answer begins with A5 5A, what a scan sends
   has no mark: a measurement of five bytes has a bit, the same bit inverted, and a bit that is always set.
2. The angle of a measurement has seven bits beside that last bit, and eight in the byte behind: the payload begins in the
   header.
3. Measurements and the packets of an express scan are told apart by the dialect: bytes alone do not always do.
4. The motor is started and stopped by DTR (A1) or by `SetMotor` through the accessory board (A2); DTR is not the protocol's.

Source: SLAMTEC, "RPLIDAR Interface Protocol and Application Notes" (A1 & A2 rev. 1.1; A2 2019), figure by figure.
"""

from __future__ import annotations

from typing import Any

from construct import Byte, Bytes, Default, GreedyBytes, Int16ul, Int24ul, Int32ul, Struct, this

from aces_bus.protocol import (
    BitLayout,
    Check,
    Enumeration,
    Message,
    Protocol,
    Quantity,
    Split,
    Tuple,
    Xor,
    bits,
)

#: Measurements in a packet of an express scan; bytes of its cabins, each of two (figure 4-12).
EXPRESS, CABIN = 32, 5
#: mm and ° of a count (figures 4-4, 4-12, 4-13).
MILLIMETRE, ANGLE, COMPENSATION = 0.25, 1 / 64, 1 / 8

rplidar = Protocol(
    "rplidar",
    link="serial",
    baud=115_200,
    dialects={
        "standard": "scans are measurements of five bytes",
        "express": "scans are packets of 32 distances",
    },
    dialect="standard",
    doc="SLAMTEC RPLIDAR A1, A2: distances by angle, device information, health.",
    source="SLAMTEC, RPLIDAR Interface Protocol",
)


class NibbleXor(Check):
    """The xor of a packet's bytes in the lower halves of two bytes, A and 5 in the upper ones (figure 4-12)."""

    def compute(self, data: bytes) -> int:
        """Return both bytes as a number, the first one lowest."""
        number = 0
        for byte in data:
            number ^= byte
        return 0x50A0 | number & 15 | number >> 4 << 8

    @property
    def describe(self) -> str:
        """Kind of check, in words."""
        return "xor in two halves"


# ---------------------------------------------------------------------- requests (figures 2-4, 4-1)

_short = rplidar.framing(
    header=Struct("start" / Byte, "command" / Byte),
    match={"start": {0xA5}, "command": range(0x80)},
    size=2,
    name="requests",
)
_long = rplidar.framing(
    header=Struct("start" / Byte, "command" / Byte, "size" / Byte),
    match={"start": {0xA5}, "command": range(0x80, 0x100)},
    size=this.size + 4,
    max_size=64,
    gap=0.1,
    check=Xor(over=slice(0, -1)),
    name="requests with data",
)


def _request(name: str, command: int, figure: str, doc: str, examples: Any = ()) -> Message:
    return _short(
        name, match={"command": command}, direction="to device", doc=doc,
        source=f"figure {figure}", examples=examples,
    )  # fmt: skip


_request("Stop", 0x25, "4-2", "End the scan; there is no answer.", [("A5 25", {})])
_request("Reset", 0x40, "4-3", "Begin as switched on; there is no answer.", [("A5 40", {})])
_scan = _request("Scan", 0x20, "4-4", "Measure; measurements come until Stop.", [("A5 20", {})])
_force = _request("ForceScan", 0x21, "4-8", "Measure, whether or not the motor turns.", [("A5 21", {})])
_info = _request("GetInfo", 0x50, "4-16", "Ask for model, versions and serial number.", [("A5 50", {})])
_health = _request("GetHealth", 0x52, "4-18", "Ask for the health.", [("A5 52", {})])
_rate = _request("GetSampleRate", 0x59, "4-30", "Ask for the time of a measurement.", [("A5 59", {})])
_express = _long(
    "ExpressScan", match={"command": 0x82}, direction="to device", source="figures 4-9, 4-14",
    payload=Struct("mode" / Byte, "flags" / Int16ul, "parameter" / Int16ul),
    doc="Measure as fast as it can; mode 0: legacy.",
    examples=[("A5 82 05 00 00 00 00 00 22", {"mode": 0, "flags": 0, "parameter": 0})],
)  # fmt: skip
_configuration = _long(
    "GetConfiguration", match={"command": 0x84}, direction="to device", source="figure 4-32",
    payload=Struct("entry" / Int32ul, "data" / GreedyBytes), doc="Ask for an entry of the configuration.",
)  # fmt: skip
_long(
    "SetMotor", match={"command": 0xF0}, direction="to device", source="A2, accessory board; rplidar 0.9.2",
    payload=Struct("duty" / Quantity(Int16ul, raw_range=(0, 1023))), doc="Turn the motor: 0 (stop) … 1023.",
    examples=[("A5 F0 02 94 02 C1", {"duty": 660})],
)  # fmt: skip

# ---------------------------------------------------------------------- measurements

_distance = Quantity(bits(16), unit="mm", scale=MILLIMETRE, doc="0: nothing measured")
_node = rplidar.framing(
    header=Struct("first" / Byte, "second" / Byte),
    match={"first": [n for n in range(256) if n & 3 in (1, 2)], "second": range(1, 256, 2)},
    size=5,
    name="measurements",
)
_node(
    "Measurement",
    dialect="standard",
    direction="from device",
    payload_from="first",
    payload=BitLayout(
        5,
        "turn" / Enumeration(bits(2), begins=1, goes_on=2),
        "quality" / bits(6),
        "check" / Default(bits(1), 1),
        "angle" / Quantity(bits(15), unit="°", scale=ANGLE),
        "distance" / _distance,
    ),
    doc="One distance; `turn` begins with the first one of each round.",
    source="figures 4-4, 4-5",
    examples=[
        ("3E 01 5A 20 4E", {"turn": "goes_on", "quality": 15, "angle": 180.0, "distance": 5000.0}),
        ("3D 21 03 00 00", {"turn": "begins", "quality": 15, "angle": 6.25, "distance": 0.0}),
    ],
)
_capsule = rplidar.framing(
    header=Struct("mark" / Int16ul),
    size=84,
    gap=0.1,
    check=NibbleXor(2, field="mark", over=slice(2, None)),
    name="express scans",
)
_places = [8 * (2 + CABIN * cabin) for cabin in range(EXPRESS // 2)]
_capsule(
    "ExpressMeasurements",
    dialect="express",
    direction="from device",
    payload=BitLayout(
        82,
        "angle" / Quantity(bits(15), unit="°", scale=ANGLE),
        "begins" / bits(1),
        "distances" / Tuple(*[Quantity(bits(14, at=at + n), unit="mm") for at in _places for n in (2, 18)]),
        "compensations"
        / Tuple(
            *[
                Quantity(Split((at + low, 4), (at + high, 2), signed=True), unit="°", scale=COMPENSATION)
                for at in _places
                for low, high in ((32, 0), (36, 16))
            ]
        ),
    ),
    doc="32 distances from `angle` on; `begins`: the first packet of a scan.",
    source="figures 4-11 to 4-13",
)

# ---------------------------------------------------------------------- answers (figures 2-7, 2-8)

_answer = rplidar.framing(
    sync=b"\xa5\x5a",  # an express packet may begin so, too, where its xor is A5: then its angle would be the length
    header=Struct("length" / Int32ul, "kind" / Byte),  # the two highest bits of the length say: once
    size=this.length + 7,
    max_size=128,
    gap=0.1,
    name="answers",
)
_descriptor = rplidar.framing(
    sync=b"\xa5\x5a",
    header=Struct("length" / Int24ul, "mode" / Byte, "kind" / Byte),
    size=7,
    name="descriptors",
)


def _answered(
    name: str,
    kind: int,
    request: Any,
    *fields: Any,
    figure: str,
    doc: str,
    length: int = 0,
    examples: Any = (),
) -> None:
    """Declare an answer that comes once, with `length` bytes of data, or any number (0)."""
    match = {"kind": kind, **({"length": length} if length else {})}
    _answer(
        name, match=match, direction="from device", reply_to=request, payload=Struct(*fields), doc=doc,
        source=f"figure {figure}", examples=examples, overrides="ExpressMeasurements",
    )  # fmt: skip


_answered("Info", 0x04, _info, "model" / Byte, "firmware_minor" / Byte, "firmware_major" / Byte, "hardware" / Byte,
    "serial" / Bytes(16), figure="4-16", length=20, doc="Model, versions and serial number.",
    examples=[("A5 5A 14 00 00 00 04 18 0F 01 00 64 E6 99 F3 C7 E5 9A F0 A2 E6 9D F8 F1 37 35 00", {"model": 24,
        "firmware_minor": 15, "firmware_major": 1, "hardware": 0,
        "serial": bytes.fromhex("64E699F3C7E59AF0A2E69DF8F1373500")}, "A5 50")])  # fmt: skip
_answered("Health", 0x06, _health, "status" / Enumeration(Byte, good=0, warning=1, error=2), "error" / Int16ul,
    figure="4-18", length=3, doc="Health; in the state `error` it does not measure.",
    examples=[("A5 5A 03 00 00 00 06 00 00 00", {"status": "good", "error": 0}, "A5 52")])  # fmt: skip
_answered("SampleRate", 0x15, _rate, "standard" / Quantity(Int16ul, unit="µs"), "express" / Quantity(Int16ul, unit="µs"),
    figure="4-31", length=4, doc="The time of a measurement, by the kind of scan.",
    examples=[("A5 5A 04 00 00 00 15 F8 01 FC 00", {"standard": 504, "express": 252}, "A5 59")])  # fmt: skip
_answered("Configuration", 0x20, _configuration, "entry" / Int32ul, "data" / GreedyBytes, figure="4-33",
    doc="An entry of the configuration.")  # fmt: skip
_descriptor("ScanStarted", match={"length": 5, "mode": 0x40, "kind": 0x81}, direction="from device", source="figure 4-4",
    reply_to=(_scan, _force), overrides="ExpressMeasurements", doc="Measurements follow.",
    examples=[("A5 5A 05 00 00 40 81", {}, "A5 20")])  # fmt: skip
_descriptor("ExpressStarted", match={"length": 84, "mode": 0x40, "kind": 0x82}, direction="from device",
    source="figure 4-14", reply_to=_express, overrides="ExpressMeasurements", doc="Packets of 32 distances follow.",
    examples=[("A5 5A 54 00 00 40 82", {}, "A5 82 05 00 00 00 00 00 22")])  # fmt: skip

__all__ = ["EXPRESS", "NibbleXor", "rplidar"]
