"""UDS (unified diagnostic services) on CAN: sessions, values by identifier, trouble codes, seed and key.

1. A request goes to one ECU or, by the message `…All`, to all of them. With `suppress` an ECU does nothing but it, and says
   so only when it refuses.
2. Values are a list: identifier, value, identifier, value. An identifier that is not in the table ends what is known of it:
   how long its value is the vehicle's maker knows alone.
3. Seeds and keys are bytes; what makes a key of a seed is each maker's secret.
4. A request of a service or of a form that is not declared here is `Other`: its service and its bytes.

Sources: ISO 14229-1 (services, identifiers, refusals), ISO 14229-3 and ISO 15765-4 (on CAN), as generally known;
udsoncan 1.26, whose requests and answers are compared in tests.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from construct import (
    Byte,
    BytesInteger,
    Const,
    Construct,
    Default,
    GreedyBytes,
    GreedyRange,
    Int16ub,
    Struct,
    this,
)

from aces_bus.protocol import BitLayout, Enumeration, Flags, Items, Protocol, Quantity, Text, bits

from ..diagnostics import ALL, ALL_ECUS, KINDS, ONE_ECU, REFUSALS, LongCode, for_all

uds = Protocol(
    "uds",
    link="can",
    bitrate=500_000,
    doc="Unified diagnostic services (UDS) by ISO-TP on CAN.",
    source="ISO 14229-1; ISO 15765-4",
)
STANDARD = "ISO 14229-1"

SESSIONS = {"default": 1, "programming": 2, "extended": 3, "safety": 4}
RESETS = {"hard": 1, "key_off_on": 2, "soft": 3, "enable_rapid_power_off": 4, "disable_rapid_power_off": 5}
#: Bits of a trouble code's status (ISO 14229-1, annex D).
STATUS = {
    "failed": 0, "failed_this_cycle": 1, "pending": 2, "confirmed": 3, "not_tested_since_clear": 4,
    "failed_since_clear": 5, "not_tested_this_cycle": 6, "lamp": 7,
}  # fmt: skip
SERVICES = {
    "change_session": 0x10, "reset": 0x11, "clear_codes": 0x14, "read_codes": 0x19, "read_data": 0x22,
    "security": 0x27, "write_data": 0x2E, "control_routine": 0x31, "begin_download": 0x34, "transfer_data": 0x36,
    "end_transfer": 0x37, "tester_present": 0x3E,
    # Those that are not taken apart here.
    "read_memory": 0x23, "read_scaling": 0x24, "control_communication": 0x28, "authenticate": 0x29,
    "read_periodically": 0x2A, "define_identifier": 0x2C, "control_outputs": 0x2F, "begin_upload": 0x35,
    "transfer_file": 0x38, "write_memory": 0x3D, "access_timing": 0x83, "secured_data": 0x84,
    "control_code_setting": 0x85, "respond_on_event": 0x86, "control_link": 0x87,
}  # fmt: skip
#: What each request asks for, by the names of messages: what a refusal of it names.
SERVICE_OF: dict[str, str] = {}
#: All requests, which an ECU may refuse.
_ASKED: list[Any] = []
ROUTINE_ACTIONS = {"start": 1, "stop": 2, "results": 3}
#: Identifiers whose values are known, by name: number and form (ISO 14229-1, annex C). 0xF400 + PID is a live value.
IDENTIFIERS: dict[str, tuple[int, Construct]] = {
    "session": (0xF186, Enumeration(Byte, SESSIONS)),
    "vin": (0xF190, Text(17)),
    **{name: (0xF400 + pid, form) for name, (pid, form) in KINDS.items()},
}
NUMBERS = {name: number for name, (number, _) in IDENTIFIERS.items()}


def _asks(
    name: str,
    service: int,
    payload: Construct | None = None,
    *,
    doc: str,
    examples: list[tuple[Any, dict[str, Any]]],
    to_all: bool = True,
    prefix: Struct | None = None,
    match: Mapping[str, Any] = MappingProxyType({}),
) -> tuple[Any, ...]:
    """Return a request to one ECU, and the same to all unless that makes no sense; `prefix` goes between service and
    payload.
    """
    head = Struct("service" / Byte, *(() if prefix is None else prefix.subcons))
    known: dict[str, Any] = {"prefix": head, "source": STANDARD, "direction": "to device"}
    fields: dict[str, Any] = {"match": {"service": service, **match}}
    if payload is not None:
        fields["payload"] = payload
    SERVICE_OF[name] = next(service_name for service_name, number in SERVICES.items() if number == service)
    message = uds.family(transport=ONE_ECU, overrides="Other", **known)(
        name, doc=doc, examples=examples, **fields
    )
    _ASKED.append(message)
    if not to_all:
        return (message,)
    everyone = uds.family(transport=ALL_ECUS, id=ALL, overrides="OtherAll", **known)(
        f"{name}All", doc=f"{name} of all ECUs.", examples=for_all(examples), **fields
    )
    _ASKED.append(everyone)
    return message, everyone


def _says(name: str, service: int, *fields: Construct, to: tuple[Any, ...], **more: Any) -> None:
    """Declare an ECU's answer."""
    uds.message(
        name, transport=ONE_ECU, direction="from device", payload=Struct(Const(0x40 | service, Byte), *fields),
        reply_to=to, source=STANDARD, **more,
    )  # fmt: skip


def sub(name: str, names: dict[str, int] | None = None, **more: Any) -> BitLayout:
    """Return a sub-function, and the bit that wants no positive answer."""
    form = bits(7, at=0) if names is None else Enumeration(bits(7, at=0), names)
    return BitLayout(1, name / form, "suppress" / Default(bits(1, at=7), 0), **more)


# ---------------------------------------------------------------------- what is not declared below

#: Numbers of requests (ISO 14229-1, table 2): those of the standard, and those of suppliers.
REQUESTS = (*range(0x10, 0x3F), *range(0x83, 0x89), *range(0xBA, 0xBF))
_ways: tuple[tuple[str, dict[str, Any]], ...] = (
    ("Other", {"transport": ONE_ECU}),
    ("OtherAll", {"transport": ALL_ECUS, "id": ALL}),
)
for _name, _carried in _ways:
    _other = uds.message(
        _name,
        direction="to device",
        prefix=Struct("service" / Enumeration(Byte, SERVICES)),
        match={"service": REQUESTS},
        payload=Struct("data" / GreedyBytes),
        doc="A request of another service, or in another form, than is declared here.",
        source=STANDARD,
        examples=(for_all if _name.endswith("All") else list)(
            [("7E0#03 28 03 01 00 00 00 00", {"ecu": 0, "service": "control_communication", "data": b"\3\1"})]
        ),
        **_carried,
    )
    _ASKED.append(_other)

# ---------------------------------------------------------------------- sessions

_says(
    "Session",
    0x10,
    "session" / Enumeration(Byte, SESSIONS),
    "answers_within" / Quantity(Int16ub, unit="s", scale=0.001),
    "patience" / Quantity(Int16ub, unit="s", scale=0.01),
    to=_asks(
        "ChangeSession",
        0x10,
        sub("session", SESSIONS),
        doc="Begin a session; one that is not the default ends after 5 s without requests.",
        examples=[("7E0#02 10 03 00 00 00 00 00", {"ecu": 0, "session": "extended", "suppress": 0})],
    ),
    doc="A session has begun; how soon answers begin (P2), and how soon after `response_pending` (P2*).",
    examples=[
        (
            "7E8#06 50 03 00 32 01 F4 00",
            {"ecu": 0, "session": "extended", "answers_within": 0.05, "patience": 5.0},
        )
    ],
)
_says(
    "ResetBegins",
    0x11,
    "kind" / Enumeration(Byte, RESETS),
    "more" / GreedyBytes,
    to=_asks(
        "Reset",
        0x11,
        sub("kind", RESETS),
        doc="Boot anew.",
        examples=[("7E0#02 11 01 00 00 00 00 00", {"ecu": 0, "kind": "hard"})],
    ),
    doc="It boots; `more` is the time until it is off (s), of `enable_rapid_power_off` alone.",
    examples=[("7E8#02 51 01 00 00 00 00 00", {"ecu": 0, "kind": "hard", "more": b""})],
)
_says(
    "TesterSeen",
    0x3E,
    "none" / Byte,
    to=_asks(
        "TesterPresent",
        0x3E,
        sub("none"),
        doc="Keep the session.",
        examples=[("7E0#02 3E 80 00 00 00 00 00", {"ecu": 0, "none": 0, "suppress": 1})],
    ),
    doc="The session is kept.",
    examples=[("7E8#02 7E 00 00 00 00 00 00", {"ecu": 0, "none": 0})],
)
_says(
    "Security",
    0x27,
    "step" / Byte,
    "data" / GreedyBytes,
    to=_asks(
        "AccessSecurity",
        0x27,
        sub("step", trailing="data"),
        doc="An odd step asks for a seed, the next one sends its key in `data`.",
        examples=[("7E0#04 27 02 A5 5A 00 00 00", {"ecu": 0, "step": 2, "data": b"\xa5\x5a"})],
    ),
    doc="The seed (zeros: it is unlocked), or, without data, that the key is right.",
    examples=[("7E8#04 67 01 36 57 00 00 00", {"ecu": 0, "step": 1, "data": b"\x36\x57"})],
)

# ---------------------------------------------------------------------- values

_says(
    "Data",
    0x22,
    "values" / Items(tag=Int16ub, kinds=IDENTIFIERS),
    to=_asks(
        "ReadData",
        0x22,
        Struct("identifiers" / GreedyRange(Int16ub)),
        doc="Ask for values by their identifiers.",
        examples=[("7E0#03 22 F1 90 00 00 00 00", {"ecu": 0, "identifiers": [0xF190]})],
    ),
    doc="Values.",
    examples=[
        (
            ["7E8#10 14 62 F1 90 57 30 4C", "7E8#21 30 30 30 30 34 33 4D", "7E8#22 42 35 34 31 33 32 36"],
            {"ecu": 0, "values": [{"kind": "vin", "data": "W0L000043MB541326"}]},
        )
    ],
)
_says(
    "DataWritten",
    0x2E,
    "identifier" / Int16ub,
    to=_asks(
        "WriteData",
        0x2E,
        Struct("identifier" / Int16ub, "data" / GreedyBytes),
        doc="Write a value: its bytes.",
        examples=[("7E0#05 2E 01 23 A5 5A 00 00", {"ecu": 0, "identifier": 0x123, "data": b"\xa5\x5a"})],
    ),
    doc="It was written.",
    examples=[("7E8#03 6E F1 90 00 00 00 00", {"ecu": 0, "identifier": 0xF190})],
)

# ---------------------------------------------------------------------- routines and downloads

_ROUTINE = BitLayout(
    3,
    "suppress" / Default(bits(1), 0),
    "action" / Enumeration(bits(7), ROUTINE_ACTIONS),
    "routine" / bits(16),
    order="msb",
    trailing="data",
)
_says(
    "Routine",
    0x31,
    "action" / Enumeration(Byte, ROUTINE_ACTIONS),
    "routine" / Int16ub,
    "data" / GreedyBytes,
    to=_asks(
        "ControlRoutine",
        0x31,
        _ROUTINE,
        doc="Start or stop a routine, or ask for its results; what its data are the vehicle's maker knows.",
        examples=[
            (
                "7E0#06 31 01 02 01 A5 5A 00",
                {"ecu": 0, "action": "start", "routine": 0x201, "data": b"\xa5\x5a"},
            )
        ],
    ),
    doc="A routine was started or stopped, or its results.",
    examples=[
        ("7E8#05 71 03 02 01 00 00 00", {"ecu": 0, "action": "results", "routine": 0x201, "data": b"\0"})
    ],
)
_download = _asks(
    "BeginDownload",
    0x34,
    Struct("address" / BytesInteger(this._.widths & 0xF), "size" / BytesInteger(this._.widths >> 4)),
    prefix=Struct("method" / Byte, "widths" / Byte),
    match={"widths": tuple(size << 4 | address for size in range(1, 5) for address in range(1, 6))},
    doc="Announce data for a place in memory. `method`: compression and encryption, 0 for neither. `widths`: how many bytes"
    " size (high nibble) and address (low nibble) have.",
    to_all=False,
    examples=[
        (
            ["7E0#10 09 34 11 33 60 20 00", "7E0#21 00 FF FF 00 00 00 00"],
            {"ecu": 0, "method": 0x11, "widths": 0x33, "address": 0x602000, "size": 0xFFFF},
        )
    ],
)
uds.message(
    "DownloadBegins",
    transport=ONE_ECU,
    direction="from device",
    reply_to=_download,
    prefix=Struct(Const(0x74, Byte), "width" / Byte),
    match={"width": tuple(n << 4 for n in range(1, 9))},
    payload=Struct("longest" / BytesInteger(this._.width >> 4)),
    doc="It takes them, in requests of up to `longest` bytes; the high nibble of `width` says how many bytes that has.",
    source=STANDARD,
    examples=[("7E8#04 74 20 00 81 00 00 00", {"ecu": 0, "width": 0x20, "longest": 0x81})],
)
_says(
    "DataTransferred",
    0x36,
    "number" / Byte,
    "data" / GreedyBytes,
    to=_asks(
        "TransferData",
        0x36,
        Struct("number" / Byte, "data" / GreedyBytes),
        doc="A piece of the data; the first one has number 1, and behind 255 comes 0.",
        to_all=False,
        examples=[("7E0#05 36 01 DE AD BE 00 00", {"ecu": 0, "number": 1, "data": bytes.fromhex("DEADBE")})],
    ),
    doc="The piece has arrived.",
    examples=[("7E8#02 76 01 00 00 00 00 00", {"ecu": 0, "number": 1, "data": b""})],
)
_says(
    "TransferEnded",
    0x37,
    "data" / GreedyBytes,
    to=_asks(
        "EndTransfer",
        0x37,
        Struct("data" / GreedyBytes),
        doc="That was all.",
        to_all=False,
        examples=[("7E0#01 37 00 00 00 00 00 00", {"ecu": 0, "data": b""})],
    ),
    doc="It has all of them.",
    examples=[("7E8#01 77 00 00 00 00 00 00", {"ecu": 0, "data": b""})],
)

# ---------------------------------------------------------------------- trouble codes

_MASK = "status" / Flags(Byte, STATUS)


def _asks_codes(name: str, kind: int, doc: str) -> tuple[Any, ...]:
    """Return a request for codes, or how many they are, by their status."""
    return _asks(
        name,
        0x19,
        Struct(Const(kind, Byte), _MASK),
        doc=doc,
        examples=[(f"7E0#03 19 {kind:02X} 08 00 00 00 00", {"ecu": 0, "status": ["confirmed"]})],
    )


_CODES = GreedyRange(Struct("code" / LongCode, "status" / Flags(Byte, STATUS)))
_says(
    "CodeCount",
    0x19,
    Const(0x01, Byte),
    "available" / Flags(Byte, STATUS),
    "format" / Byte,
    "count" / Int16ub,
    to=_asks_codes("CountCodes", 0x01, "How many codes have one of these bits of status?"),
    doc="How many there are; `available` are the bits of status that this ECU has, `format` 1 is ISO 14229-1's.",
    examples=[("7E8#06 59 01 2F 01 00 01 00", {"ecu": 0, "format": 1, "count": 1})],
)
_says(
    "Codes",
    0x19,
    Const(0x02, Byte),
    "available" / Flags(Byte, STATUS),
    "codes" / _CODES,
    to=_asks_codes("ReadCodes", 0x02, "Ask for the codes that have one of these bits of status."),
    doc="Codes with their status.",
    examples=[
        (
            "7E8#07 59 02 FF 03 01 11 09",
            {"ecu": 0, "codes": [{"code": "P0301-11", "status": ["failed", "confirmed"]}]},
        )
    ],
)
_says(
    "KnownCodes",
    0x19,
    Const(0x0A, Byte),
    "available" / Flags(Byte, STATUS),
    "codes" / _CODES,
    to=_asks(
        "ReadKnownCodes",
        0x19,
        Struct(Const(0x0A, Byte)),
        doc="Ask for all codes that it can report.",
        examples=[("7E0#02 19 0A 00 00 00 00 00", {"ecu": 0})],
    ),
    doc="All codes that it can report, with their status.",
    examples=[
        (
            "7E8#07 59 0A FF C1 00 00 50",
            {
                "ecu": 0,
                "codes": [
                    {"code": "U0100-00", "status": ["not_tested_since_clear", "not_tested_this_cycle"]}
                ],
            },
        )
    ],
)
_says(
    "CodesCleared",
    0x14,
    to=_asks(
        "ClearCodes",
        0x14,
        Struct("group" / BytesInteger(3)),
        doc="Clear the codes of a group; 0xFFFFFF: all.",
        examples=[("7E0#04 14 FF FF FF 00 00 00", {"ecu": 0, "group": 0xFFFFFF})],
    ),
    doc="Codes were cleared.",
    examples=[("7E8#01 54 00 00 00 00 00 00", {"ecu": 0})],
)
uds.message(
    "Refused",
    transport=ONE_ECU,
    direction="from device",
    reply_to=tuple(_ASKED),
    payload=Struct(
        Const(0x7F, Byte), "service" / Enumeration(Byte, SERVICES), "reason" / Enumeration(Byte, REFUSALS)
    ),
    doc="An ECU refuses a request, or asks for patience (`response_pending`).",
    source=STANDARD,
    examples=[("7E8#03 7F 22 31 00 00 00 00", {"ecu": 0, "service": "read_data", "reason": "out_of_range"})],
)
