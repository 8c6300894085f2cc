"""Which request an answer of an ECU answers: by its service, and by what it repeats of the request."""

from __future__ import annotations

from typing import Any

from aces_bus.device import Ticket
from aces_bus.protocol import Record
from aces_protocols.uds.spec import SERVICE_OF

#: How many bytes behind its service an answer repeats of its request: a sub-function, an identifier, both (ISO 14229-1).
REPEATED = {
    "Session": 1,
    "ResetBegins": 1,
    "Security": 1,
    "DataTransferred": 1,
    "DataWritten": 2,
    "Routine": 3,
}


def _content(packet: Any) -> bytes:
    """Return what a request says, as far as its first frame has it: its service and what follows (ISO 15765-2)."""
    data: bytes = (packet[0] if isinstance(packet, tuple) else packet).data
    return data[2:] if data[0] >> 4 else data[1 : 1 + data[0]]


def is_answer(record: Record, ticket: Ticket) -> bool:
    """Return whether a record answers a request: by the service, and by what an answer repeats of its request."""
    name = type(record).__name__
    if name == "Refused":
        return bool(SERVICE_OF[ticket.message] == record.service)
    if name not in ticket.reply:
        return False
    said, asked = record.meta.raw, _content(ticket.packet)
    if ticket.message == "ReadData":
        return said[1:3] in [asked[at : at + 2] for at in range(1, len(asked), 2)]
    size = REPEATED.get(name, 0)
    return bool(said[1 : 1 + size] == asked[1 : 1 + size])


def late_text(record: Record) -> str:
    """Return an answer that is too late, in few words."""
    name = type(record).__name__
    return (
        f"{record.service} was refused: {record.reason}"
        if name == "Refused"
        else f"{name} {record.meta.raw[1:4].hex(' ').upper()}"
    )
