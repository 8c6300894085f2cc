"""SAE J1939, as an engine's control unit speaks it: identifiers of 29 bits, 250 kbit/s, lowest byte first.

1. An identifier is priority, parameter group, source. Groups below F000 go to one address, which stands in the low byte of
   the group; the others to all. `ecu` is the control unit, `tool` whoever asks it: each message says which of them sends.
2. The highest values of a number are not numbers: FE is an error, FF is not available (J1939-71, 5.1.4). Both are None.
   What is not declared is sent as ones.
3. More than eight bytes come in sessions (J1939-21): faults of several, the vehicle's number.

Sources: SAE J1939-21 (requests, acknowledgements, sessions), -71 (engine), -73 (faults), -81 (names), as can-j1939 2.0.12
and CSS Electronics' J1939 database have them; README.md says what is confirmed by whom.
"""

from __future__ import annotations

from typing import Any

from construct import (
    Byte,
    Bytes,
    BytesInteger,
    Construct,
    Default,
    GreedyBytes,
    GreedyRange,
    Int16ul,
    Int32ul,
    Struct,
)

from aces_bus.protocol import (
    BitLayout,
    Enumeration,
    IdField,
    J1939Transport,
    Protocol,
    Quantity,
    Split,
    bits,
    top,
)

#: Parameter groups by the names of their messages.
GROUPS = {
    "EngineController1": 0xF004, "EngineController2": 0xF003, "VehicleSpeed": 0xFEF1, "EngineTemperature": 0xFEEE,
    "EngineFluids": 0xFEEF, "FuelEconomy": 0xFEF2, "VehiclePower": 0xFEF7, "EngineHours": 0xFEE5, "ActiveFaults": 0xFECA,
    "VehicleIdentification": 0xFEEC, "AddressClaimed": 0xEE00,
}  # fmt: skip

j1939 = Protocol(
    "j1939",
    link="can",
    bitrate=250_000,
    doc="SAE J1939: an engine's control unit: values, requests, name, faults.",
    source="SAE J1939-21, -71, -73, -81",
)
Priority, Ecu, Tool = IdField("priority", range(8)), IdField("ecu", range(254)), IdField("tool", range(254))
_long = J1939Transport()
_percent_of_torque = Quantity(Byte, unit="%", offset=-125, unknown=top(2))
_percent = Quantity(Byte, unit="%", scale=0.4, unknown=top(2))
_celsius = Quantity(Byte, unit="°C", offset=-40, unknown=top(2))
_oil = Quantity(Int16ul, unit="°C", scale=1 / 32, offset=-273, unknown=top(2, bits=8))
_pressure = Quantity(Byte, unit="kPa", scale=4, unknown=top(2))


def _ones(name: str, size: int) -> Construct:
    """Declare bytes that are not declared here: ones when they are sent."""
    return name / Default(Bytes(size), b"\xff" * size)


def _group(name: str, *fields: Construct, doc: str, source: str, **more: Any) -> Any:
    """Declare a parameter group that the control unit sends to all."""
    return j1939.message(
        name,
        id=Priority << 26 | GROUPS[name] << 8 | Ecu,
        extended=True,
        direction="from device",
        payload=Struct(*fields),
        doc=doc,
        source=source,
        **more,
    )


# ---------------------------------------------------------------------- what an engine sends

_group(
    "EngineController1",
    "mode" / BitLayout(1, "torque_mode" / bits(4), "torque_eighths" / bits(4)),
    "demanded_torque" / _percent_of_torque,
    "torque" / _percent_of_torque,
    "speed" / Quantity(Int16ul, unit="rpm", scale=0.125, unknown=top(2, bits=8)),
    _ones("rest", 3),
    doc="EEC1: speed of the engine, torque in % of its reference torque.",
    source="J1939-71, PGN 61444: SPN 899, 4154, 512, 513, 190",
    examples=[("0CF00400#FF FF A5 E0 2E FF FF FF",
        {"priority": 3, "ecu": 0, "demanded_torque": None, "torque": 40, "speed": 1500.0})],
)  # fmt: skip
_group(
    "EngineController2",
    _ones("switches", 1),
    "pedal" / _percent,
    "load" / Quantity(Byte, unit="%", unknown=top(2)),
    _ones("rest", 5),
    doc="EEC2: position of the accelerator pedal; load at this speed.",
    source="J1939-71, PGN 61443: SPN 91, 92",
    examples=[("0CF00300#FF 64 32 FF FF FF FF FF", {"pedal": 40.0, "load": 50})],
)
_group(
    "VehicleSpeed",
    _ones("switches", 1),
    "speed" / Quantity(Int16ul, unit="km/h", scale=1 / 256, unknown=top(2, bits=8)),
    _ones("rest", 5),
    doc="CCVS: speed by the wheels.",
    source="J1939-71, PGN 65265: SPN 84",
    examples=[("18FEF100#FF 80 3E FF FF FF FF FF", {"priority": 6, "speed": 62.5})],
)
_group(
    "EngineTemperature",
    "coolant" / _celsius,
    "fuel" / _celsius,
    "oil" / _oil,
    "turbo_oil" / _oil,
    "intercooler" / _celsius,
    _ones("rest", 1),
    doc="ET1: temperatures of the engine.",
    source="J1939-71, PGN 65262: SPN 110, 174, 175, 176, 52",
    examples=[
        ("18FEEE00#7D 46 00 2E FF FF FF FF", {"coolant": 85, "fuel": 30, "oil": 95.0, "turbo_oil": None})
    ],
)
_group(
    "EngineFluids",
    "fuel_pressure" / _pressure,
    _ones("blow_by", 1),
    "oil_level" / _percent,
    "oil_pressure" / _pressure,
    _ones("rest", 4),
    doc="EFL/P1: pressures of fuel and oil, level of the oil.",
    source="J1939-71, PGN 65263: SPN 94, 98, 100",
    examples=[
        ("18FEEF00#FF FF FA 64 FF FF FF FF", {"fuel_pressure": None, "oil_level": 100.0, "oil_pressure": 400})
    ],
)
_group(
    "FuelEconomy",
    "rate" / Quantity(Int16ul, unit="l/h", scale=0.05, unknown=top(2, bits=8)),
    _ones("economy", 4),
    "throttle" / _percent,
    _ones("rest", 1),
    doc="LFE: fuel that flows, position of the throttle.",
    source="J1939-71, PGN 65266: SPN 183, 51",
    examples=[("18FEF200#C8 00 FF FF FF FF 7D FF", {"rate": 10.0, "throttle": 50.0})],
)
_group(
    "VehiclePower",
    _ones("currents", 4),
    "battery" / Quantity(Int16ul, unit="V", scale=0.05, unknown=top(2, bits=8)),
    _ones("rest", 2),
    doc="VEP1: voltage of the battery.",
    source="J1939-71, PGN 65271: SPN 168",
    examples=[("18FEF700#FF FF FF FF 18 01 FF FF", {"battery": 14.0})],
)
_group(
    "EngineHours",
    "running" / Quantity(Int32ul, unit="h", scale=0.05, unknown=top(2, bits=8)),
    "revolutions" / Quantity(Int32ul, scale=1000, unknown=top(2, bits=8)),
    doc="HOURS: how long the engine has run, and its revolutions; on request.",
    source="J1939-71, PGN 65253: SPN 247, 249",
    examples=[("18FEE500#A0 86 01 00 FF FF FF FF", {"running": 5000.0, "revolutions": None})],
)

# ---------------------------------------------------------------------- faults, and who it is

_lamp = Enumeration(bits(2), off=0, on=1, error=2, none=3)
_group(
    "ActiveFaults",
    "lamps" / BitLayout(1, "protect" / _lamp, "amber_warning" / _lamp, "red_stop" / _lamp, "malfunction" / _lamp),
    "flash" / Default(Byte, 0xFF),
    "faults"
    / GreedyRange(
        BitLayout(4, "spn" / Split((0, 16), (21, 3)), "fmi" / bits(5, at=16), "count" / bits(7, at=24), "method" / bits(1))
    ),
    "padding" / Default(GreedyBytes, b"\xff\xff"),
    transport=_long,
    doc="DM1: lamps, and each active fault by its parameter (SPN), kind (FMI) and count; none is an SPN of 0. One fault is"
    " a frame with two bytes of padding; several come in a session, without.",
    source="J1939-73, PGN 65226",
    examples=[
        ("18FECA00#04 FF 6E 00 00 03 FF FF", {"lamps": {"amber_warning": "on", "malfunction": "off"},
            "faults": [{"spn": 110, "fmi": 0, "count": 3}], "padding": b"\xff\xff"}),
        # an SPN of 19 bits: can-j1939's DTC(spn=520192 + 5, fmi=31, oc=1)
        ("18FECA00#40 FF 05 F0 FF 01 FF FF", {"lamps": {"malfunction": "on"},
            "faults": [{"spn": 0x7F005, "fmi": 31, "count": 1}]}),
    ],
)  # fmt: skip
_group(
    "VehicleIdentification",
    "number" / GreedyBytes,
    transport=_long,
    doc="VI: the vehicle's number, closed by an asterisk; on request.",
    source="J1939-71, PGN 65260",
    # sent by can-j1939
    examples=[(["1CECFF00#20 12 00 03 FF EC FE 00", "1CEBFF00#01 31 58 4B 44 44 34 39",
        "1CEBFF00#02 58 30 41 4A 31 32 33", "1CEBFF00#03 34 35 36 2A FF FF FF"],
        {"priority": 7, "ecu": 0, "number": b"1XKDD49X0AJ123456*"})],
)  # fmt: skip
_name = BitLayout(
    8,
    "identity" / bits(21), "manufacturer" / bits(11), "ecu_instance" / bits(3), "function_instance" / bits(5),
    "function" / bits(8), "system" / bits(7, at=49), "system_instance" / bits(4),
    "industry" / Enumeration(bits(3), any=0, on_highway=1, agriculture=2, construction=3, marine=4, process=5),
    "arbitrary_address" / bits(1),
)  # fmt: skip
j1939.message(
    "AddressClaimed",
    id=Priority << 26 | 0xEEFF << 8 | Ecu,
    extended=True,
    direction="from device",
    payload=_name,
    doc="Who uses this address: of two the one with the lower name keeps it.",
    source="J1939-81, PGN 60928",
    # built by can-j1939's Name
    examples=[("18EEFF80#87 D6 52 53 08 80 00 D0", {"ecu": 0x80, "identity": 1234567, "manufacturer": 666,
        "function_instance": 1, "function": 128, "industry": "process", "arbitrary_address": 1})],
)  # fmt: skip

# ---------------------------------------------------------------------- requests

_pgn = "pgn" / BytesInteger(3, swapped=True)
j1939.message(
    "Request",
    id=Priority << 26 | 0xEA << 16 | Ecu << 8 | Tool,
    extended=True,
    direction="to device",
    payload=Struct(_pgn),
    doc="Ask a control unit for a parameter group.",
    source="J1939-21, PGN 59904",
    examples=[("18EA00F9#EC FE 00", {"priority": 6, "ecu": 0, "tool": 0xF9, "pgn": 65260})],
)
j1939.message(
    "RequestAll",
    id=Priority << 26 | 0xEAFF << 8 | Tool,
    extended=True,
    direction="to device",
    payload=Struct(_pgn),
    doc="Ask all for a parameter group; who does not have it is silent.",
    source="J1939-21, PGN 59904",
    examples=[("18EAFFF9#00 EE 00", {"tool": 0xF9, "pgn": 60928})],
)
j1939.message(
    "Acknowledgement",
    id=Priority << 26 | 0xE8FF << 8 | Ecu,
    extended=True,
    direction="from device",
    payload=Struct(
        "control" / Enumeration(Byte, done=0, refused=1, denied=2, busy=3),
        _ones("group_function", 1),
        _ones("reserved", 2),
        "address" / Default(Byte, 0xFF),
        _pgn,
    ),
    doc="That a request was carried out, or not: `address` is who asked.",
    source="J1939-21, PGN 59392",
    examples=[("18E8FF00#01 FF FF FF F9 EC FE 00", {"control": "refused", "address": 0xF9, "pgn": 65260})],
)

__all__ = ["GROUPS", "Ecu", "Priority", "Tool", "j1939"]
