"""Draws whole messages: the fields of identifier, head and payload, and the request that a reply answers.

1. Values are valid by construction; what only `build` can know (a packet too long, an end mark inside) is drawn again.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import construct as c

from ..errors import AcesError, FieldError
from ..frames import EXTENDED, Frame
from ..protocol.declare.framing import BitSize
from ..protocol.declare.head import Head
from ..protocol.declare.message import Message, Request
from ..protocol.declare.protocol import Variant
from ..protocol.record import FieldValue
from .constructs import Room, drawer
from .hints import Hints, hints
from .source import ChoiceSource, edge_number, spread

#: How often a message is drawn again when its packet cannot be built.
ATTEMPTS = 60


class UndrawableError(AcesError, AssertionError):
    """No valid packet of a message was found: its spec contradicts itself, or its strategy must be given."""


@dataclass(frozen=True)
class DrawnPacket:
    """A valid packet of a message: its raw fields, its image (`message.struct` parses it), the request before it."""

    message: Message
    values: Mapping[str, FieldValue]
    image: bytes
    request: DrawnPacket | None = None

    @property
    def as_sent(self) -> list[Any]:
        """Packet as a scanner is fed: frames (CAN; several where a transport carries it), or bytes."""
        return [self.image] if self.message.framing is not None else self.carried()

    def carried(self, sequence: int = 0, **more: Any) -> list[Frame]:
        """Return its frames, the `sequence`th packet of its sender; `more` of all of them."""
        size = len(self.image) - 5
        # A packet of one frame comes by its own transport alone.
        ways = [
            way for way in self.message.ways[: 1 if size <= 8 else 2] if way is None or size <= way.longest
        ]
        transport = ways[sequence % len(ways)]
        if transport is None:
            return [image_frame(self.image, **more)]
        key = int.from_bytes(self.image[:4], "big")
        return [
            Frame(
                identifier & 0x1FFF_FFFF,
                data,
                is_extended_id=bool(identifier & EXTENDED),
                is_fd=transport.fd,
                **more,
            )
            for identifier, data in transport.split(key, self.image[5:], sequence, self.message.check_extra)
        ]


def image_frame(image: bytes, **more: Any) -> Frame:
    """Return the frame of a CAN image."""
    word = int.from_bytes(image[:4], "big")
    return Frame(
        word & 0x1FFF_FFFF,
        image[5:],
        is_extended_id=bool(word >> 31),
        is_remote_frame=bool(word >> 30 & 1),
        is_fd=bool(image[4] & 4),
        **more,
    )


# ---------------------------------------------------------------------- messages


def draw_packet(message: Message, source: ChoiceSource, variant: Variant | None = None) -> DrawnPacket:
    """Return a valid packet of `message`; when it answers requests of `variant`, one of those too.

    Raises `UndrawableError` when none is found.
    """
    problem = ""
    occasions = _occasions(message, variant) if variant is not None else ()
    for attempt in range(ATTEMPTS):
        use = source if attempt == 0 else spread(source.integer(0, 255) << 8 | attempt)
        request = None
        try:
            if occasions:
                occasion = use.choice(occasions)
                values = draw_values(
                    message, use, {name: _member(v, use) for name, v in occasion.shared if v is not None}
                )
                request = _draw_request(values, occasion, use)
                for name, _ in occasion.shared:
                    values[name] = request.values[name]
                for name in message.request_fields:
                    values[name] = request.values.get(name)
                values.update(_payload(message, values, use))
            else:
                values = draw_values(message, use)
            return DrawnPacket(message, values, bytes(message.struct.build(values, raw=True)), request)
        except (FieldError, c.ConstructError) as error:
            problem = str(error)
    raise UndrawableError(f"{message!r} ({message.place}): no valid packet found; the last try: {problem}")


@dataclass(frozen=True)
class Occasion:
    """An occasion for a reply: the link, the request as the variant has it, and the fields that both have, with the
    numbers that both allow (None: any)."""

    link: Request
    asked: Message
    shared: tuple[tuple[str, Collection[int] | None], ...]


@lru_cache(maxsize=4096)
def _occasions(message: Message, variant: Variant) -> tuple[Occasion, ...]:
    found: list[Occasion] = []
    for link in (*message.reply_to, *message.after):
        asked = variant.messages.get(link.message.name)
        if asked is None:
            continue
        shared: dict[str, Collection[int] | None] = {}
        for name in sorted(message.outer_names & asked.outer_names):
            limits = [_allowed(message, name), _allowed(asked, name), dict(link.values).get(name)]
            sets = [frozenset(limit) for limit in limits if limit is not None]
            shared[name] = tuple(sorted(frozenset.intersection(*sets))) if sets else None
        if all(values is None or values for values in shared.values()):
            found.append(Occasion(link, asked, tuple(shared.items())))
    return tuple(found)


def _allowed(message: Message, name: str) -> Collection[int] | None:
    """Return the numbers that a field of identifier or head may have; None when any."""
    captures = list(message.identifier.captures)
    for head in message.heads:
        captures += head.pattern.captures if head.pattern is not None else ()
    return next((capture.values for capture in captures if capture.name == name), None)


def draw_values(
    message: Message, source: ChoiceSource, fixed: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Draw raw values of all fields of a message; those in `fixed` are taken from there."""
    given = fixed or {}
    values: dict[str, Any] = {}
    for capture in message.identifier.captures:
        values[capture.name] = given.get(capture.name, _member(capture.values, source))
    if message.request_fields:
        links = (*message.reply_to, *message.after)
        wanted = dict(source.choice(links).values)
        for name in message.request_fields:
            values[name] = source.choice(sorted(wanted[name])) if name in wanted else None
    known = hints(message)
    for head in message.heads:
        if head.pattern is not None and not head.is_own:
            for capture in head.pattern.captures:
                values[capture.name] = given.get(capture.name, _member(capture.values, source))
        elif head.name is not None and not head.is_constant:
            if head.name in given:
                values[head.name] = given[head.name]
                continue
            if head.pattern is not None:
                raw = _member(head.pattern.captures[0].values, source)
                raw = head.pattern.number({head.pattern.captures[0].name: raw})
            else:
                raw = _head_number(head, known, source)
            values[head.name] = head.field.parse(head.bytes(raw), raw=True)
    values.update(_payload(message, values, source))
    for name, value in given.items():
        if name in values:
            values[name] = value
    return values


def _payload(message: Message, values: Mapping[str, FieldValue], source: ChoiceSource) -> dict[str, Any]:
    root = c.Container(raw=True)
    root._params = root
    around = c.Container(_=root, _params=root)
    around.update({k: v for k, v in values.items() if k not in message.payload_names})
    drawn = drawer(message)(source, around, _room(message, values, source))
    found = dict(drawn)
    for head in message.overlaid:
        if head.pattern is not None:  # its bytes are drawn among those that the template has
            capture = head.pattern.captures[:1]
            raws = {part.name: _member(part.values, source) for part in capture}
            at = head.offset - message.payload_start
            body = bytes(message.payload.build({**values, **found}, raw=True))
            body = body[:at] + head.bytes(head.pattern.number(raws)) + body[at + head.size :]
            found = {
                name: value for name, value in message.payload.parse(body, raw=True).items() if name in found
            }
    if message.framing is not None and message.framing.multiple > 1:
        body = bytes(message.payload.build({**values, **found}, raw=True))
        size = message.payload_start + len(body) + message.framing.check_size
        if padding := bytes(-size % message.framing.multiple):  # what is read has the padding that is sent
            again = message.payload.parse(body + padding, raw=True)
            found = {name: value for name, value in again.items() if name in found}
    if message.check is not None and message.check.field is not None:
        found.pop(message.check.field, None)
    return found


def _room(message: Message, values: Mapping[str, FieldValue], source: ChoiceSource) -> Room:
    framing = message.framing
    if framing is None:
        assert message.lengths is not None
        lengths = message.lengths if isinstance(message.lengths, range) else sorted(message.lengths)
        if message.transport is not None and source.integer(0, 7):
            # Long packets are much like shorter ones, and seldom: a scene has room for more of these.
            lengths = lengths[: max(1, min(len(lengths), 40))]
        return Room(source.choice(lengths) - message.payload_start, True)
    rest = message.payload_start + framing.check_size + len(framing.end)
    if framing.fixed_size is not None:
        return Room(framing.fixed_size - rest, True)
    if isinstance(framing.measure, BitSize):
        size = framing.measure.size_of(framing.sync + _head(message, values)) or 0
        if not framing.min_size <= size <= framing.max_size:
            raise FieldError(f"{message.name}: its header says {size} bytes")
        return Room(size - rest, True)
    most = framing.max_size - rest
    if framing.affine is not None:
        wide = framing.affine.wide
        most = min(most, framing.affine.largest - rest) - (wide.size if wide is not None else 0)
    if source.integer(0, 15):
        most = min(most, 12)
    return Room(max(0, most), False)


def _head(message: Message, values: Mapping[str, Any]) -> bytes:
    """Return header and prefix with these raw values."""
    parts: list[bytes] = []
    for head in message.heads_written:
        if head.pattern is not None and not head.is_own:
            raws = {capture.name: values[capture.name] for capture in head.pattern.captures}
            parts.append(head.bytes(head.pattern.number(raws)))
        else:
            parts.append(bytes(head.field.build(values.get(head.name or "", 0), raw=True)))
    return b"".join(parts)


def _draw_request(values: Mapping[str, FieldValue], occasion: Occasion, source: ChoiceSource) -> DrawnPacket:
    """Return a request that the reply answers: fields that both have are equal, those that the link names are as it says."""
    fixed = {name: values[name] for name, _ in occasion.shared}
    for name, allowed in occasion.link.values:
        if fixed.get(name, values.get(name)) not in allowed:
            fixed[name] = source.choice(sorted(allowed))
        else:
            fixed.setdefault(name, values[name])
    drawn = draw_values(occasion.asked, source, fixed)
    return DrawnPacket(occasion.asked, drawn, bytes(occasion.asked.struct.build(drawn, raw=True)))


def _member(values: Any, source: ChoiceSource) -> int:
    if isinstance(values, range):
        return values[edge_number(source, 0, len(values) - 1)]
    return int(source.choice(values if isinstance(values, Sequence) else sorted(values)))


def _head_number(head: Head, known: Hints, source: ChoiceSource) -> int:
    most = (1 << 8 * head.size) - 1
    if head.name is not None and head.name in known.values and source.integer(0, 3):
        return source.choice(known.values[head.name]) & most
    if head.name in known.small:
        return source.integer(0, 6 if source.integer(0, 7) else 40)
    return edge_number(source, 0, most)


__all__ = ["DrawnPacket", "UndrawableError", "draw_packet", "draw_values", "image_frame"]
