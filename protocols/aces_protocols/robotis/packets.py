"""Packets of Dynamixel protocol 1.0, which Feetech's servos speak too: `declare_packets` gives a protocol its messages.

1. Instruction and status packets look alike; who spoke is known from `direction`, or from the request before (`both`).
2. A packet's bytes decide its length: a SyncWrite whose length is not 4 + n·(size + 1) is not a message.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from construct import Byte, Bytes, Construct, GreedyBytes, GreedyRange, Struct, this

from aces_bus.protocol import Flags, InvertedSum, Message, Protocol

BROADCAST = 0xFE
#: Identifiers of single servos; 0xFF cannot occur.
SERVOS = range(BROADCAST)

#: A message's worked examples: bytes, and what they mean; for an answer perhaps the request.
Examples = Mapping[str, Sequence[Any]]


def declare_packets(
    protocol: Protocol,
    *,
    source: str,
    errors: Mapping[str, int],
    examples: Examples,
    reset: int,
    reads_together: bool,
) -> None:
    """Give a protocol framing and messages.

    `errors` are the bits of a status by name, `reset` is the instruction's number, `reads_together`: there is a SyncRead.
    """
    packet = protocol.framing(
        sync=b"\xff\xff",
        not_next=b"\xff",  # of FF FF FF the last two are the header
        header=Struct("id" / Byte, "length" / Byte),
        size=this.length + 4,
        max_size=259,  # what the length byte allows; the RX-28 itself receives at most 143 bytes of a SyncWrite
        gap=0.1,  # a longer pause inside a packet resets the servo's receiver (RX-28 manual)
        check=InvertedSum(),
    )
    instruction = packet.family(Struct("instruction" / Byte), direction="to device")

    def declare(
        name: str, code: int, official: str, *fields: Construct, doc: str, ids: int | range | None = None
    ) -> Message:
        made: Message = instruction(
            name,
            instruction=code,
            match={} if ids is None else {"id": ids},
            payload=Struct(*fields) if fields else None,
            doc=doc,
            source=f"{source}, {official}",
            examples=examples.get(name, ()),
        )
        return made

    written = "start" / Byte, "data" / GreedyBytes
    ping = declare(
        "Ping", 0x01, "PING", doc="Ask for a status, which comes whatever the status return level."
    )
    asking = [
        declare(
            "Read",
            0x02,
            "READ_DATA",
            "start" / Byte,
            "count" / Byte,
            doc="Ask for `count` bytes of the control table.",
        ),
        declare("Write", 0x03, "WRITE_DATA", *written, doc="Write bytes of the control table."),
        declare("RegWrite", 0x04, "REG_WRITE", *written, doc="Write, held back until Action."),
        declare("Action", 0x05, "ACTION", doc="Carry out what RegWrite held back."),
        declare("Reset", reset, "RESET", doc="Back to factory defaults."),
    ]
    together: list[Message] = []
    if reads_together:
        together.append(
            declare(
                "SyncRead",
                0x82,
                "SYNC_READ",
                "start" / Byte,
                "count" / Byte,
                "ids" / GreedyRange(Byte),
                doc="Ask several servos for the same area; they answer in turn.",
                ids=range(BROADCAST, BROADCAST + 1),  # a field all the same: servos' answers are to it
            )
        )
    declare(
        "SyncWrite",
        0x83,
        "SYNC_WRITE",
        "start" / Byte,
        "size" / Byte,
        "servos" / GreedyRange(Struct("id" / Byte, "data" / Bytes(this._.size))),
        doc="Write the same `size` bytes of the control table in many servos, each its own values. Never answered.",
        ids=BROADCAST,
    )
    packet(
        "Status",
        direction="from device",
        match={"id": SERVOS},
        # A broadcast is not answered, except that a Ping may be, and what asks several.
        reply_to=(ping, *together, *(request.where(id=SERVOS) for request in asking)),
        overrides=tuple(message.name for message in (ping, *asking)),
        # A servo waits 0.5 ms at most; the rest is for 259 bytes at 9600 baud and for adapters that collect bytes.
        within=0.5,
        payload=Struct("error" / Flags(Byte, errors), "parameters" / GreedyBytes),
        doc="A servo's answer: its error bits and the bytes asked for.",
        source=f"{source}, status packet",
        examples=examples["Status"],
    )
