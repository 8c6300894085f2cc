"""The shapes of a message whose fields are there by bits: which are there, and how many bytes they take.

1. A shape is found once and remembered by the bits that decide it; a packet then costs a look-up for each level (bits that
   say which masks follow, masks that say which fields follow).
2. Memory is bounded: of more than `MOST` shapes the oldest ones go.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import construct as c
import msgspec

from ...errors import SpecError
from .fields import Present, innermost, wire_number
from .normalise import sizes

if TYPE_CHECKING:
    from .message import Message

#: Shapes that are remembered.
MOST = 1024


class PayloadShape(msgspec.Struct, frozen=True):
    """The payload's fields that are there, in order, and their bytes (None: as many as there are)."""

    items: tuple[c.Construct, ...]
    size: int | None


class DecidingBits(msgspec.Struct, frozen=True):
    """Bits of a packet that decide which fields are there: those of `mask` in the number at `offset` of the packet."""

    name: str
    offset: int
    size: int
    order: Literal["little", "big"]
    mask: int

    def of(self, packet: bytes) -> int:
        return int.from_bytes(packet[self.offset : self.offset + self.size], self.order) & self.mask


class ShapeLevel(msgspec.Struct):
    """What is to be looked at next, and what comes of it."""

    bits: tuple[DecidingBits, ...]
    #: The bytes that are needed for it.
    reach: int
    known: dict[str, int]
    found: dict[tuple[int, ...], ShapeLevel | PayloadShape]

    def key(self, packet: bytes) -> tuple[int, ...]:
        """Return the deciding numbers of a packet."""
        return tuple([bits.of(packet) for bits in self.bits])


class Shapes:
    """The shapes of one message; raises `SpecError` where the place of a deciding number is not known."""

    def __init__(self, message: Message) -> None:
        self.message = message
        payload = message.payload
        assert isinstance(payload, c.Struct)
        self.items = [
            (item, item.subcon if isinstance(item, c.Renamed) else item) for item in payload.subcons
        ]
        self.masks: dict[str, int] = {}
        for _, body in self.items:
            if isinstance(body, Present):
                self.masks[body.selector] = self.masks.get(body.selector, 0) | 1 << body.bit
        #: The least and the greatest size of each field, in bytes.
        self.sizes = [sizes(body) for body in self.bodies]
        last = max((n for n, (item, _) in enumerate(self.items) if item.name in self.masks), default=-1)
        for (item, _), body, (least, most) in zip(
            self.items[: last + 1], self.bodies, self.sizes, strict=False
        ):
            wire = wire_number(innermost(body))
            if least != most or (item.name in self.masks and (wire is None or wire.kind != "uint")):
                name = item.name or "constant"
                raise SpecError(
                    f"{message.place.of_field(name)}: {name!r}: what decides which fields are there is an unsigned integer"
                    " of whole bytes, behind fields of fixed size"
                )
        self._count = 0
        self.root = self._from({})

    def of(self, packet: bytes) -> PayloadShape | None:
        """Return the shape of a packet that begins so, without stuffing; None while the bits that decide are not there."""
        level = self.root
        while isinstance(level, ShapeLevel):
            if len(packet) < level.reach:
                return None
            key = level.key(packet)
            found = level.found.get(key)
            if found is None:
                found = self.after(level, key)
                if self._count > MOST:
                    self._count, self.root = 0, self._from({})
                else:
                    self._count += 1
                    level.found[key] = found
            level = found
        return level

    def after(self, level: ShapeLevel, key: tuple[int, ...]) -> ShapeLevel | PayloadShape:
        """Return what the deciding numbers `key` of a level lead to."""
        names = [bits.name for bits in level.bits]
        return self._from({**level.known, **dict(zip(names, key, strict=True))})

    def size_of(self, packet: bytes) -> int | None:
        """Return how many bytes the header and the payload of a packet that begins so take; None while it is not known."""
        shape = self.of(packet)
        return None if shape is None or shape.size is None else self.message.payload_start + shape.size

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

    def _from(self, known: dict[str, int]) -> ShapeLevel | PayloadShape:
        """Return what the deciding numbers that are known lead to: the next ones to look at, or the shape."""
        message = self.message
        places: dict[str, DecidingBits] = {}
        for head in message.heads_written:
            if head.name in self.masks:
                places[head.name] = DecidingBits(
                    head.name, head.offset, head.size, head.order, self.masks[head.name]
                )
        offset: int | None = message.payload_start
        there: list[c.Construct] = []
        absent: set[str] = set()
        for (item, body), (low, high) in zip(self.items, self.sizes, strict=True):
            if isinstance(body, Present):
                if body.selector not in absent and body.selector not in known:
                    bits = tuple(place for name, place in places.items() if name not in known)
                    reach = max(place.offset + place.size for place in bits)
                    return ShapeLevel(bits, reach, known, {})
                if body.selector in absent or not known[body.selector] >> body.bit & 1:
                    if item.name is not None:
                        absent.add(item.name)
                    continue
                body = body.body
                item = c.Renamed(body, newname=item.name, newdocs=item.docs)
            if item.name in self.masks:
                places[item.name] = self._place(item.name, body, offset)
            there.append(item)
            offset = offset + low if offset is not None and low == high else None
        return PayloadShape(tuple(there), None if offset is None else offset - message.payload_start)

    def _place(self, name: str, body: c.Construct, offset: int | None) -> DecidingBits:
        wire = wire_number(innermost(body))
        assert wire is not None
        assert offset is not None
        return DecidingBits(name, offset, wire.size, wire.order, self.masks[name])


def has_shapes(message: Message) -> bool:
    """Return whether fields of a message are there by bits."""
    payload = message.payload
    return isinstance(payload, c.Struct) and any(
        isinstance(item.subcon if isinstance(item, c.Renamed) else item, Present) for item in payload.subcons
    )
