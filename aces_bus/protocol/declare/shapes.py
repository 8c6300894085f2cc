"""The shapes of a message whose fields are there by bits: which are there, and how many bytes they take.

Each field is there as a bit of a number before it says, a mask, which may itself be there by a bit of another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import construct as c

from ...errors import SpecError
from .fields import Present, innermost, wire_number
from .normalise import sizes

if TYPE_CHECKING:
    from .message import Message


class Shapes:
    """The shapes of one message; raises `SpecError` where the place of a deciding number is not known."""

    def __init__(self, message: Message) -> None:
        self.message = message
        payload = message.payload
        assert isinstance(payload, c.Struct)
        self.items = [
            (item, item.subcon if isinstance(item, c.Renamed) else item) for item in payload.subcons
        ]
        #: The names of the numbers that decide.
        self.masks = {body.selector for _, body in self.items if isinstance(body, Present)}
        self.heads = [head for head in message.heads_written if head.name in self.masks]
        #: The least and the greatest size of each field, in bytes.
        self.sizes = [sizes(body) for body in self.bodies]
        #: Of the fields that decide, what they are on the wire.
        self.wires = [
            wire_number(innermost(body)) if item.name in self.masks else None
            for (item, _), body in zip(self.items, self.bodies, strict=True)
        ]
        last = max((n for n, (item, _) in enumerate(self.items) if item.name in self.masks), default=-1)
        for (item, _), (least, most), wire in zip(
            self.items[: last + 1], self.sizes, self.wires, strict=False
        ):
            if least != most or (item.name in self.masks and (wire is None or wire.kind != "uint")):
                name = item.name or "constant"
                raise SpecError(
                    f"{message.place.of_field(name)}: {name!r}: what decides which fields are there is an unsigned integer"
                    " of whole bytes, behind fields of fixed size"
                )

    def size_of(self, packet: bytes) -> int | None:
        """Return how many bytes the header and the payload of a packet that begins so take, without stuffing; None while the
        bytes that say it are not there, or where no bytes do.
        """
        numbers: dict[str | None, int] = {}
        at = self.message.payload_start
        known = max((head.offset + head.size for head in self.heads), default=0)
        for head in self.heads:
            numbers[head.name] = int.from_bytes(packet[head.offset : head.offset + head.size], head.order)
        for (item, body), (least, most), wire in zip(self.items, self.sizes, self.wires, strict=True):
            if isinstance(body, Present) and not numbers[body.selector] >> body.bit & 1:
                numbers[item.name] = 0
                continue
            if most != least:
                return None
            if wire is not None:
                numbers[item.name] = int.from_bytes(packet[at : at + wire.size], wire.order)
                known = at + wire.size
            at += least
        return at if known <= len(packet) else None

    @property
    def all_items(self) -> list[c.Construct]:
        """The payload with all of its fields."""
        return [
            c.Renamed(body.body, newname=item.name, newdocs=item.docs) if isinstance(body, Present) else item
            for item, body in self.items
        ]

    @property
    def bodies(self) -> list[c.Construct]:
        """The payload's fields, whether or not they are there."""
        return [body.body if isinstance(body, Present) else body for _, body in self.items]


def has_shapes(message: Message) -> bool:
    """Return whether fields of a message are there by bits."""
    payload = message.payload
    return isinstance(payload, c.Struct) and any(
        isinstance(item.subcon if isinstance(item, c.Renamed) else item, Present) for item in payload.subcons
    )
