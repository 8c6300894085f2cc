"""DroneCAN (UAVCAN v0), the part of speed controllers (ESCs): throttles for all, a status of each, who a node is.

1. A transfer is one frame of up to seven bytes and a tail byte, or several with a CRC-16 in front, which begins with the
   signature of the data type: who does not know the type cannot check it. `node` is the controller, `host` who commands.
2. Bits are filled from the highest of each byte; a number wider than eight bits goes with its low byte first, and its last
   piece has the bits that are left.
3. Throttles are one list for all controllers of a bus, each knowing its place. Its length follows from the transfer's, so
   that lists of 1 to 20 are messages of their own here.

Sources: DroneCAN's DSDL (`uavcan/equipment/esc`, `uavcan/protocol`) and specification 4.1, as dronecan 1.0.27 has them,
whose bytes the worked examples are.
"""

from __future__ import annotations

from typing import Any

from construct import Byte, Bytes, Float16l, GreedyBytes, Int16ul, Int32ul, Int64ul, Struct

from aces_bus.protocol import (
    BitLayout,
    Enumeration,
    IdField,
    Protocol,
    Quantity,
    Split,
    TailByte,
    Tuple,
    bits,
)

#: Throttles of a list at most, and the numbers of full throttle, forward and back (RawCommand.uavcan).
MOST_ESCS, FORWARD, BACK = 20, 8191, -8192

dronecan = Protocol(
    "dronecan",
    link="can",
    bitrate=1_000_000,
    doc="DroneCAN (UAVCAN v0): speed controllers (ESCs), who a node is and how it is.",
    source="dronecan.github.io, DSDL uavcan/equipment/esc",
)
Priority, Node, Host = (
    IdField("priority", range(32)),
    IdField("node", range(1, 128)),
    IdField("host", range(1, 128)),
)
_transfer = TailByte(version=0, max_size=400)
#: Signatures of data types.
STATUS, ESC_STATUS, RAW_COMMAND, NODE_INFO = (
    number.to_bytes(8, "little")
    for number in (0x0F0868D0C1A7C6F1, 0xA9AF28AEA2FBB254, 0x217F5C87D7EC951D, 0xEE468A8121C46A9E)
)
_common: dict[str, Any] = {"transport": _transfer, "extended": True}


def raw_command(count: int) -> str:
    """Return the message that has throttles for so many controllers."""
    return f"RawCommand{count}"


def _throttle(place: int) -> Any:
    """Declare 14 bits of a list: eight low ones, then six high ones."""
    return Split((14 * place, 8), (14 * place + 8, 6), signed=True)


#: dronecan's bytes of four throttles: forward, back, 1000 and none.
_FOUR = [
    (["0804060A#FF 7C 02 0E 80 C0 00 C0"], {"priority": 8, "host": 10, "commands": [8191, -8192, 1000, 0]})
]
for _count in range(1, MOST_ESCS + 1):
    dronecan.message(
        raw_command(_count),
        id=Priority << 24 | 1030 << 8 | Host,
        check_extra=RAW_COMMAND,
        direction="to device",
        payload=BitLayout(
            (14 * _count + 7) // 8,
            "commands" / (Tuple(*map(_throttle, range(_count))) if _count > 1 else _throttle(0)),
            order="msb",
        ),
        doc=f"Throttles of controllers 0 to {_count - 1}: −8192 … 8191, 0 stops{'' if _count > 1 else '; one number'}.",
        source="equipment/esc/1030.RawCommand",
        examples=_FOUR if _count == 4 else (),
        **_common,
    )
dronecan.message(
    "EscStatus",
    id=Priority << 24 | 1034 << 8 | Node,
    check_extra=ESC_STATUS,
    direction="from device",
    payload=Struct(
        "errors" / Int32ul,
        "voltage" / Quantity(Float16l, unit="V"),
        "current" / Quantity(Float16l, unit="A"),
        "temperature" / Quantity(Float16l, unit="K"),
        "motor"
        / BitLayout(
            4,
            "speed" / Quantity(Split((0, 8), (8, 8), (16, 2), signed=True), unit="rpm"),
            "power" / Quantity(bits(7, at=18), unit="%"),
            "index" / bits(5, at=25),
            order="msb",
        ),
    ),
    doc="What a controller measures; `index` is its place in the list of throttles.",
    source="equipment/esc/1034.Status",
    examples=[(["10040A14#6F F2 01 00 00 00 00 83", "10040A14#4E 00 43 B0 5C 50 FB 23", "10040A14#D0 88 43"],
        {"priority": 16, "node": 20, "errors": 1, "voltage": 24.0, "current": 3.5, "temperature": 300.0,
            "motor": {"speed": -1200, "power": 33, "index": 2}})],
    **_common,
)  # fmt: skip
_status = (
    "uptime" / Quantity(Int32ul, unit="s"),
    "state"
    / BitLayout(
        1,
        "health" / Enumeration(bits(2, at=6), ok=0, warning=1, error=2, critical=3),
        "mode"
        / Enumeration(bits(3, at=3), operational=0, initialising=1, maintenance=2, update=3, offline=7),
        "sub_mode" / bits(3, at=0),
    ),
    "vendor_code" / Int16ul,
)
dronecan.message(
    "NodeStatus",
    id=Priority << 24 | 341 << 8 | Node,
    check_extra=STATUS,
    direction="from device",
    payload=Struct(*_status),
    doc="That a node is there, and how it is; at least once a second.",
    source="protocol/341.NodeStatus",
    examples=[(["1401552A#0A 00 00 00 00 34 12 C7"],
        {"priority": 20, "node": 42, "uptime": 10, "state": {"health": "ok"}, "vendor_code": 0x1234})],
    **_common,
)  # fmt: skip
GetNodeInfo = dronecan.message(
    "GetNodeInfo",
    id=Priority << 24 | 1 << 16 | 1 << 15 | Node << 8 | 0x80 | Host,
    check_extra=NODE_INFO,
    direction="to device",
    payload=Struct(),
    doc="Ask a node who it is.",
    source="protocol/1.GetNodeInfo",
    examples=[(["1E01AAFF#C1"], {"priority": 30, "node": 42, "host": 127})],
    **_common,
)
dronecan.message(
    "NodeInfo",
    id=Priority << 24 | 1 << 16 | Host << 8 | 0x80 | Node,
    check_extra=NODE_INFO,
    direction="from device",
    reply_to=GetNodeInfo,
    payload=Struct(
        *_status,
        "software_major" / Byte,
        "software_minor" / Byte,
        "software_flags" / Byte,
        "software_commit" / Int32ul,
        "software_crc" / Int64ul,
        "hardware_major" / Byte,
        "hardware_minor" / Byte,
        "unique_id" / Bytes(16),
        "rest" / GreedyBytes,
    ),
    doc="Versions of a node; `rest` is a byte with the size of its certificate, the certificate, and its name.",
    source="protocol/1.GetNodeInfo",
    **_common,
)

__all__ = ["BACK", "FORWARD", "MOST_ESCS", "dronecan", "raw_command"]
