"""Worked examples: bytes and the fields that they mean, as the sheet prints them beside each other.

1. An example is data: it is read when the message is declared, and holds or fails elsewhere (`lint.examples`, the laws).
2. Its bytes are written out by the author of the spec, from the sheet or a recording; bytes that the spec itself built
   would prove nothing.

    examples=[("001#00 07 C8 00 00 00 F4 01", {"board": 0, "kp": 200, "ki": 0, "kd": 500})]       CAN: identifier#data
    examples=[("FF FF 01 02 00 FC", {"id": 1, "error": [], "parameters": b""})]                   a stream: the packet
    examples=[(b"$GPHDT,274.07,T*03\\r\\n", {"heading": 274.07})]                                     characters
    examples=[("1C0#22 00 29 09", {"current": [1.37, 0.02], "temperature": 41}, "001#00 04")]     with its request
    examples=[(["7E8#10 09 62 F1 90 31 32 33", "7E8#21 34 35 36"], {"did": 0xF190})]    in the frames of a transport

Identifiers of 29 bits have eight digits, CAN FD has `##`, a remote frame `#R`, as candump writes them. Fields are in the
sheet's units, enumerations by name, flags as a list of names; fields left out are not compared.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec

from ...errors import SpecError
from ...frames import EXTENDED
from ..record import FieldValue
from .place import SourceLine
from .transport import Transport

_FRAME = re.compile(
    r"(?P<id>[0-9A-Fa-f]{1,8})#(?:(?P<fd>#)(?P<flags>[0-9A-Fa-f])?(?P<long>[0-9A-Fa-f \t]*)"
    r"|(?P<remote>R)\d?|(?P<data>[0-9A-Fa-f \t]*))"
)
_LONGEST_ID = 3


class ExampleFrame(msgspec.Struct, frozen=True):
    """What was on the wire: a packet, or with an identifier a CAN frame."""

    data: bytes
    identifier: int | None = None
    extended: bool = False
    remote: bool = False
    fd: bool = False

    @property
    def image(self) -> bytes:
        """Bytes that `message.struct` parses."""
        from .packet import can_image

        if self.identifier is None:
            return self.data
        return can_image(self.identifier, self.data, extended=self.extended, remote=self.remote, fd=self.fd)

    def __str__(self) -> str:
        if self.identifier is not None:
            return frame_text(self)
        # Sentences read better as characters.
        is_text = (
            len(self.data) > 3 and self.data.isascii() and self.data.decode("ascii").rstrip().isprintable()
        )
        return repr(self.data) if is_text else self.data.hex(" ").upper()


class Example(msgspec.Struct, frozen=True):
    """A packet or frame, (some of) the fields that it means, and the request that it answers.

    `frames` are those that a transport carried it in; `packet` is then the packet that they are.
    """

    packet: ExampleFrame
    fields: Mapping[str, FieldValue]
    request: ExampleFrame | None = None
    frames: tuple[ExampleFrame, ...] = ()


def frame_text(frame: Any) -> str:
    """Return `063#78 00`, from anything with `identifier`, `data`, `extended`, `remote` and `fd`."""
    digits = 8 if frame.extended else _LONGEST_ID
    data = "R" if frame.remote else frame.data.hex(" ").upper()
    return f"{frame.identifier:0{digits}X}#{'#0' if frame.fd else ''}{data}"


def parse_packet(text: str | bytes, *, is_can: bool) -> ExampleFrame:
    """Return a frame or packet as the module writes them; raises `ValueError` saying what is wrong."""
    if isinstance(text, bytes):
        if is_can:
            raise ValueError(f"{text!r} is not a frame such as '063#78 00 FC'")
        return ExampleFrame(text)
    if not is_can:
        try:
            return ExampleFrame(bytes.fromhex(text))
        except ValueError:
            raise ValueError(
                f"{text!r} is not hexadecimal bytes such as 'FF FF 01 02'; characters are written b'…'"
            ) from None
    found = _FRAME.fullmatch(text.strip())
    if found is None:
        raise ValueError(f"{text!r} is not a frame such as '063#78 00 FC' or '18FEEE31#00'")
    identifier = int(found["id"], 16)
    extended = len(found["id"]) > _LONGEST_ID
    if identifier > (0x1FFF_FFFF if extended else 0x7FF):
        raise ValueError(f"{text!r}: identifier {identifier:#x} has more than {29 if extended else 11} bits")
    try:
        data = bytes.fromhex(found["long"] or found["data"] or "")
    except ValueError:
        raise ValueError(f"{text!r}: an odd number of digits is not a whole number of bytes") from None
    if len(data) > (64 if found["fd"] else 8):
        raise ValueError(f"{text!r}: {len(data)} bytes are more than a frame has")
    return ExampleFrame(data, identifier, extended, found["remote"] is not None, found["fd"] is not None)


def as_examples(
    given: Iterable[Any],
    place: SourceLine,
    *,
    is_can: bool,
    transport: Transport | None = None,
    extra: bytes = b"",
) -> tuple[Example, ...]:
    """Return what a spec wrote after `examples=`; raises `SpecError` for what is none. `transport` carries the message, with
    `extra` in its check."""
    found: list[Example] = []
    for item in given:
        if isinstance(item, Example):
            found.append(item)
            continue
        if (
            not isinstance(item, (tuple, list))
            or not 2 <= len(item) <= 3
            or not (
                isinstance(item[0], (str, bytes)) or (transport is not None and isinstance(item[0], Sequence))
            )
            or not isinstance(item[1], Mapping)
            or not (len(item) == 2 or isinstance(item[2], (str, bytes)))
        ):
            raise SpecError(
                f"{place}: an example is (bytes as text, {{field: value}}) or with the bytes of its request"
                f" behind, not {item!r}"
            )
        try:
            written: Any = item[0]
            request = parse_packet(item[2], is_can=is_can) if len(item) == 3 else None
            if transport is not None:
                texts: Iterable[Any] = [written] if isinstance(written, (str, bytes)) else written
                frames = tuple(parse_packet(text, is_can=True) for text in texts)
                packet = _packet_of(frames, transport, extra)
                found.append(Example(packet, dict(item[1]), request, frames))
            else:
                found.append(Example(parse_packet(written, is_can=is_can), dict(item[1]), request))
        except ValueError as error:
            raise SpecError(f"{place}: example {error}") from None
    return tuple(found)


def _packet_of(frames: Sequence[ExampleFrame], transport: Transport, extra: bytes) -> ExampleFrame:
    """Return the packet that some frames are; raises `ValueError` where they are none."""
    from .packet_rule import PacketRule, packet_image

    rule = PacketRule(transport)
    said = "they are not a whole packet"
    for number, frame in enumerate(frames):
        key = (frame.identifier or 0) | (EXTENDED if frame.extended else 0)
        for decided in rule.decide(_Silent(), number, key, frame.data):
            image = packet_image(transport, decided, extra) if not decided.reason else None
            if image is not None and len(decided.frames) == len(frames):
                return ExampleFrame(image[5:], decided.key & 0x1FFF_FFFF, bool(decided.key & EXTENDED))
            said = decided.reason or "its check does not hold" if image is None else said
    raise ValueError(f"{', '.join(map(str, frames))}: by {transport.title}, {said}")


class _Silent(msgspec.Struct, frozen=True):
    """What the rule of packets asks of a frame beside its bytes."""

    channel: str | None = None
    timestamp: float | None = None
