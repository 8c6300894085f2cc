"""The words of a CAN frame: identifier, kind, length, bytes; and why a template that fits is given up all the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..declare.message import Message
from ..reference import PastRequest, ReferenceItem
from .attempt import FieldRead
from .template import Template

#: Place, text, and of a byte its offset.
Word = tuple[str, str, int | None]


def words_of(frame: Any, data: bytes) -> list[Word]:
    digits = 8 if frame.is_extended_id else 3
    kinds = [
        k for k, given in (("29 bits", frame.is_extended_id), ("remote", frame.is_remote_frame)) if given
    ]
    kinds += ["CAN FD"] if frame.is_fd else []
    words: list[Word] = [("id", f"{frame.arbitration_id:0{digits}X}", None)]
    words += [("kind", ", ".join(kinds), None)] if kinds else []
    words.append(("length", str(len(data)), None))
    return words + [(f"d{at}", f"{byte:02X}", at) for at, byte in enumerate(data)]


def frame_death(template: Template, frame: Any, data: bytes, word: Word) -> tuple[str, str] | None:
    message = template.message
    place, _, offset = word
    if place == "id":
        if message.identifier.match(frame.arbitration_id) is None:
            return "identifier", message.identifier.describe(8 if message.extended else 3)
        is_plain = not (frame.is_extended_id or frame.is_remote_frame or frame.is_fd)
        return ("kind of frame", _kind(message)) if is_plain and not _is_kind(message, frame) else None
    if place == "kind":
        return None if _is_kind(message, frame) else ("kind of frame", _kind(message))
    if place == "length":
        if message.lengths is not None and len(data) not in message.lengths:
            return "length", message.describe_lengths
        return None
    assert offset is not None
    return template.death(data[: offset + 1], None, None)


def _is_kind(message: Message, frame: Any) -> bool:
    kind = (bool(frame.is_extended_id), bool(frame.is_remote_frame))
    return kind == (message.extended, message.remote) and bool(frame.is_fd) in message.formats


def _kind(message: Message) -> str:
    kinds = (("29 bits", message.extended), ("remote", message.remote), ("CAN FD", message.fd))
    return ", ".join(kind for kind, given in kinds if given) or "a plain data frame"


def unchosen(template: Template, found: ReferenceItem, request: PastRequest | None) -> tuple[str, str] | None:
    """Why a template whose bytes fit is not what the frame is."""
    asks = [*template.message.reply_to, *template.message.after]
    if found.message is not None:
        if request is not None and asks:
            return "request", f"what was asked last, {request.name}, gives {found.message}"
        return "order", f"{found.message} is tried first"
    if asks and found.reason.startswith("unknown: needs"):
        names = "|".join(dict.fromkeys(request.message.name for request in asks))
        return "request", f"no {names} was seen that it answers"
    return None


def captures(lead: Template, living: Sequence[Template], frame: Any) -> tuple[FieldRead, ...]:
    raws = lead.message.identifier.match(frame.arbitration_id) or {}
    name = "" if len(living) <= 1 else lead.name
    return tuple(
        FieldRead(name, one.name, one.to_physical(raws[one.name]), one.unit)
        for one in lead.message.identifier.captures
        if one.name in raws
    )


def frame_cell(template: Template, word: Word) -> str:
    place, _, offset = word
    message = template.message
    if place == "id":
        return message.identifier.describe(8 if message.extended else 3)
    if place == "kind":
        return _kind(message)
    if place == "length":
        return message.describe_lengths.removesuffix(" bytes")
    assert offset is not None
    return template.cell(offset, None)
