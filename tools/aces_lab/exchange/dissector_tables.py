"""What of a spec is a table in a printed dissector: bits, sets of numbers, identifiers, transports."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any

from aces_bus.protocol import Crc, Transport
from aces_bus.protocol.declare.bits import runs_of, whole_bits
from aces_bus.protocol.declare.pattern import IdPattern
from aces_bus.protocol.declare.transport import FrameKind, FrameNumber
from aces_bus.protocol.record import PlainValue


def bit_pieces(bits: Sequence[int]) -> list[list[int]]:
    """Return bits as the program reads them: {byte, shift, width, place in the number}."""
    found: list[list[int]] = []
    for first, at, width in runs_of(bits):
        while width:
            part = min(width, 8 - first % 8)
            found.append([first // 8, first % 8, part, at])
            first, width, at = first + part, width - part, at + part
    return found


def id_pattern(pattern: IdPattern) -> dict[str, PlainValue]:
    return {
        "constant": pattern.constant,
        "parts": [
            {
                "name": capture.name,
                "shift": capture.shift,
                "width": capture.width,
                "values": value_set(capture.values),
            }
            for capture in pattern.captures
        ],
    }


def value_set(values: Collection[int]) -> dict[Any, Any]:
    """Return numbers as {low, high, step} where they are a range, else as a set."""
    if isinstance(values, range) and values.step > 0:
        return {"low": values[0], "high": values[-1], "step": values.step}
    listed: Iterable[int] = sorted(values)
    low, high = min(listed, default=0), max(listed, default=-1)
    if values and high - low == len(values) - 1:
        return {"low": low, "high": high, "step": 1}
    return dict.fromkeys(listed, True)


def crc_table(crc: Crc) -> dict[str, PlainValue]:
    """Return the parameters of a CRC by their names."""
    return dict(zip(("width", "poly", "init", "refin", "refout", "xorout"), crc.parameters, strict=True))


def is_a_table(transport: Transport) -> bool:
    """Return whether a transport is what the table of its frames' kinds says, and has no packets that are acknowledged."""
    has_own_rule = type(transport).part is not Transport.part or transport.has_conversations
    adds = type(transport).unwrapped is not Transport.unwrapped and transport.added_check is None
    return not (has_own_rule or adds or any(map(_has_gaps, _numbers(transport))))


def _numbers(transport: Transport) -> Iterable[FrameNumber]:
    for kind in transport.kinds:
        yield from (bits for bits, _ in kind.match)
        yield from (
            number for number in (kind.size, kind.number, kind.sequence, kind.last) if number is not None
        )


def _has_gaps(number: FrameNumber) -> bool:
    return number.mask != ((1 << number.width) - 1) << number.shift


def transport_table(transport: Transport, number: int) -> dict[str, Any]:
    """Return a transport of which `is_a_table` is true, the dissector's `number`th."""
    table: dict[str, Any] = {
        "number": number,
        "title": transport.title,
        "fd": transport.fd,
        "address": transport.address,
        "timeout": transport.timeout_s,
        "senders": transport.senders,
        "max_size": transport.max_size,
        "most_bytes": transport.longest + transport.overhead,
        "modulo": transport.modulo,
        "first_number": transport.first_number,
        "any_order": transport.any_order,
        "full": dict.fromkeys(transport.lengths(), True),
        "following": {"head": transport.following.head, "tail": transport.following.tail},
        "patterns": [{**id_pattern(pattern), "extended": is_long} for pattern, is_long in transport.patterns],
        "kinds": [_kind(kind) for kind in transport.kinds],
    }
    if (added := transport.added_check) is not None:
        table["check"] = {
            **crc_table(added.crc),
            "size": added.crc.size,
            "pieces": bit_pieces(whole_bits(0, added.crc.size, added.crc.order)),
            "is_in_front": added.is_in_front,
        }
    return table


def _kind(kind: FrameKind) -> dict[str, PlainValue]:
    return {
        "role": kind.role,
        "name": kind.name,
        "match": [[_number(bits), value] for bits, value in kind.match],
        "head": kind.head,
        "tail": kind.tail,
        "sized": _number(kind.size),
        "least": kind.least,
        "most": kind.most,
        "number": _number(kind.number),
        "sequence": _number(kind.sequence),
        "last": _number(kind.last),
        "over": kind.over,
    }


def _number(bits: FrameNumber | None) -> dict[str, PlainValue] | None:
    if bits is None:
        return None
    return {
        "byte": bits.byte,
        "size": bits.size,
        "is_big": bits.order == "big",
        "shift": bits.shift,
        "width": bits.width,
    }
