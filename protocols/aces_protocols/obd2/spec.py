"""OBD-II on CAN: live values with units, trouble codes as text, the vehicle's number.

1. A request goes to one ECU or, by the message `…All`, to all of them; each that has something to say answers for itself.
2. An answer of live values is a list: PID, value, PID, value. A PID that is not in the table ends what is known of it: how
   long its value is the bytes do not say.

Sources: SAE J1979 / ISO 15031-5 (services and values), SAE J2012 (codes); ELM Electronics' ELM327 data sheet, as public
decoders quote it (the examples of `engine_speed`, `coolant_temperature`, `Vin`). The README says which were at hand.
"""

from __future__ import annotations

from typing import Any

from construct import Byte, Const, Construct, GreedyRange, Int32ub, PrefixedArray, Struct

from aces_bus.protocol import Enumeration, Flags, Items, Protocol, Text

from ..diagnostics import ALL, ALL_ECUS, KINDS, ONE_ECU, REFUSALS, Code, for_all

obd2 = Protocol(
    "obd2",
    link="can",
    bitrate=500_000,
    doc="On-board diagnostics of cars (OBD-II, EOBD) by ISO-TP on CAN.",
    source="SAE J1979 / ISO 15031-5; ISO 15765-4; ELM327 data sheet",
)
J1979, ELM = "SAE J1979", "SAE J1979; ELM327 data sheet"


def _asks(
    name: str,
    service: int,
    *fields: Construct,
    doc: str,
    examples: list[tuple[str, dict[str, Any]]],
    source: str = J1979,
) -> tuple[Any, Any]:
    """Return a request to one ECU, and the same to all."""
    shared: dict[str, Any] = {
        "direction": "to device", "payload": Struct(Const(service, Byte), *fields), "source": source,
    }  # fmt: skip
    message = obd2.message(name, transport=ONE_ECU, doc=doc, examples=examples, **shared)
    everyone = obd2.message(
        f"{name}All",
        transport=ALL_ECUS,
        id=ALL,
        doc=f"{name} of all ECUs.",
        examples=for_all(examples),
        **shared,
    )
    return message, everyone


def _says(
    name: str, service: int, *fields: Construct, to: tuple[Any, Any], source: str = J1979, **more: Any
) -> None:
    """Declare an ECU's answer."""
    obd2.message(
        name, transport=ONE_ECU, direction="from device", payload=Struct(Const(0x40 | service, Byte), *fields),
        reply_to=to, source=source, **more,
    )  # fmt: skip


_live = _asks(
    "ReadLive",
    0x01,
    "pids" / GreedyRange(Byte),
    doc="Ask for live values: up to six PIDs.",
    source=ELM,
    examples=[
        ("7E0#02 01 00 00 00 00 00 00", {"ecu": 0, "pids": [0x00]}),
        ("7E0#02 01 0C 00 00 00 00 00", {"ecu": 0, "pids": [0x0C]}),
    ],
)
_says(
    "Live",
    0x01,
    "values" / Items(tag=Byte, kinds=KINDS),
    to=_live,
    doc="Live values, or which there are.",
    source=ELM,
    examples=[
        ("7E8#03 41 05 7B 00 00 00 00", {"ecu": 0, "values": [{"kind": "coolant_temperature", "data": 83}]}),
        ("7E8#04 41 0C 1A F8 00 00 00", {"ecu": 0, "values": [{"kind": "engine_speed", "data": 1726}]}),
    ],
)

# ---------------------------------------------------------------------- trouble codes

for _name, _service, _which in (
    ("StoredCodes", 0x03, "stored: the lamp is on for them"),
    ("PendingCodes", 0x07, "pending: seen in this or the last drive"),
    ("PermanentCodes", 0x0A, "permanent: `ClearCodes` leaves them"),
):
    _says(
        _name,
        _service,
        "codes" / PrefixedArray(Byte, Code),
        to=_asks(
            f"Read{_name}",
            _service,
            doc=f"Ask for trouble codes that are {_which}.",
            examples=[(f"7E0#01 {_service:02X} 00 00 00 00 00 00", {"ecu": 0})],
        ),
        doc=f"Trouble codes that are {_which}.",
        source=ELM,
        examples=[(f"7E8#04 {_service | 0x40:02X} 01 01 33 00 00 00", {"ecu": 0, "codes": ["P0133"]})],
    )
_says(
    "CodesCleared",
    0x04,
    to=_asks(
        "ClearCodes",
        0x04,
        doc="Clear trouble codes, freeze frames and the results of tests.",
        examples=[("7E0#01 04 00 00 00 00 00 00", {"ecu": 0})],
    ),
    doc="Codes were cleared.",
    examples=[("7E8#01 44 00 00 00 00 00 00", {"ecu": 0})],
)

# ---------------------------------------------------------------------- the vehicle

_info = _asks(
    "ReadInfo",
    0x09,
    "what" / Enumeration(Byte, supported=0x00, vin=0x02, calibrations=0x04, ecu_name=0x0A),
    doc="Ask what the vehicle and the ECU are.",
    source=ELM,
    examples=[("7E0#02 09 02 00 00 00 00 00", {"ecu": 0, "what": "vin"})],
)
_says(
    "SupportedInfo",
    0x09,
    Const(0x00, Byte),
    "types" / Flags(Int32ub, vin=30, calibrations=28, ecu_name=22),
    to=_info,
    doc="What can be asked for: the highest bit is number 1.",
    examples=[("7E8#06 49 00 50 40 00 00 00", {"ecu": 0, "types": ["vin", "calibrations", "ecu_name"]})],
)
_says(
    "Vin",
    0x09,
    Const(0x02, Byte),
    Const(1, Byte),
    "vin" / Text(17),
    to=_info,
    doc="The vehicle's identification number.",
    source=ELM,
    examples=[
        (
            ["7E8#10 14 49 02 01 31 44 34", "7E8#21 47 50 30 30 52 35 35", "7E8#22 42 31 32 33 34 35 36"],
            {"ecu": 0, "vin": "1D4GP00R55B123456"},
        )
    ],
)
_says(
    "Calibrations",
    0x09,
    Const(0x04, Byte),
    "names" / PrefixedArray(Byte, Text(16)),
    to=_info,
    doc="The names of its software and its data.",
    examples=[
        (
            ["7E8#10 13 49 04 01 4A 4D 42", "7E8#21 2A 33 36 37 36 31 35", "7E8#22 30 30 00 00 00 00 00"],
            {"ecu": 0, "names": ["JMB*36761500"]},
        )
    ],
)
_says(
    "EcuName",
    0x09,
    Const(0x0A, Byte),
    Const(1, Byte),
    "name" / Text(20),
    to=_info,
    doc="The ECU's short and long name, with a zero byte and a hyphen between them.",
    examples=[
        (
            [
                "7E8#10 17 49 0A 01 45 43 4D",
                "7E8#21 00 2D 45 6E 67 69 6E",
                "7E8#22 65 43 6F 6E 74 72 6F",
                "7E8#23 6C 00 00 00 00 00 00",
            ],
            {"ecu": 0, "name": "ECM\0-EngineControl"},
        )
    ],
)
obd2.message(
    "Refused",
    transport=ONE_ECU,
    direction="from device",
    payload=Struct(Const(0x7F, Byte), "service" / Byte, "reason" / Enumeration(Byte, REFUSALS)),
    doc="An ECU refuses a request, or asks for patience (`response_pending`).",
    source="SAE J1979; ISO 14229-1",
    examples=[
        ("7E8#03 7F 09 12 00 00 00 00", {"ecu": 0, "service": 9, "reason": "subfunction_not_supported"})
    ],
)
