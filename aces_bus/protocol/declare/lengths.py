"""How long the frames or packets of a message are, and whether its fields have room in them."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import construct as c

from ...errors import SpecError
from ...frames import FD_LENGTHS
from .multiplexed import Multiplexed
from .normalise import sizes
from .pattern import describe_values
from .present import Present
from .transport import Transport

if TYPE_CHECKING:
    from .message import Message


def lengths_of(message: Message, length: int | Collection[int] | None) -> Collection[int] | None:
    """Return the numbers of data bytes that a message's frames or packets may have, of those that its spec states as
    `length`.

    None on streams; raises `SpecError` where its fields do not go with them.
    """
    low, high = sizes(message.payload)
    low += message.payload_start
    if message.framing is not None:
        if length is not None:
            raise SpecError(
                f"{message.place}: length is for CAN; a stream's packets end as their framing says"
            )
        return None
    if message.transport is not None:
        return _packet_lengths(message, message.transport, length, low, high)
    top = 64 if message.fd else 8
    high = top if high is None else high + message.payload_start
    if message.remote and high:
        raise SpecError(
            f"{message.place}: a remote frame carries no data, so {message.name} can have no fields in it"
        )
    if low > top:
        raise SpecError(
            f"{message.place}: {message.name} has {low} bytes of fields;"
            f" a {'CAN FD' if message.fd else 'classic CAN'} frame has {top}"
        )
    possible = [n for n in (FD_LENGTHS if message.fd else range(9)) if low <= n <= high]
    if length is None:
        if not possible:
            raise SpecError(
                f"{message.place}: {message.name} has {low} bytes of fields, which no CAN FD frame has; add Reserved bytes"
            )
        return (
            range(possible[0], possible[-1] + 1) if not message.fd and len(possible) > 1 else tuple(possible)
        )
    wanted = (length,) if isinstance(length, int) else tuple(sorted(length))
    for number in wanted:
        if not low <= number <= high:
            raise SpecError(
                f"{message.place}: length {number} does not go with the fields of {message.name}, which take {low}"
                + (f"…{high}" if high > low else "")
                + " bytes"
            )
        if number not in (FD_LENGTHS if message.fd else range(9)):
            raise SpecError(
                f"{message.place}: no {'CAN FD' if message.fd else 'classic CAN'} frame has {number} bytes"
            )
    return wanted


def _packet_lengths(
    message: Message, transport: Transport, length: int | Collection[int] | None, low: int, high: int | None
) -> Collection[int]:
    """Return how long packets are that a transport carries."""
    if message.fd or message.remote or message.any_format:
        raise SpecError(
            f"{message.place}: fd, remote and any_format are of frames; those of {message.name} are made by its transport"
        )
    most = transport.longest
    low = max(low, transport.min_size)
    top = most if high is None else min(most, high + message.payload_start)
    wanted = range(low, top + 1) if length is None else (length,) if isinstance(length, int) else length
    if not wanted or min(wanted) < low or max(wanted) > top:
        end = None if high is None else high + message.payload_start
        more = "…" if end is None else f"…{end}" if end > low else ""
        given = (
            "" if length is None else f"length {describe_values(wanted)} does not go with {message.name}: "
        )
        raise SpecError(
            f"{message.place}: {given}its fields take {low}{more} bytes, and packets of {transport.title} have"
            f" {most} at most"
        )
    fitting = [size for size in wanted if transport.carries(size)]
    if not fitting:
        near = next((n for n in range(min(wanted), most + 1) if transport.carries(n)), None)
        more = "" if near is None else f"; {near} would: end its fields with Reserved({near - min(wanted)})"
        raise SpecError(
            f"{message.place}: {describe_values(wanted)} bytes, as {message.name} has them, fill no frames of"
            f" {transport.title}{more}"
        )
    if len(fitting) < len(wanted):
        return tuple(sorted(fitting))
    return wanted if isinstance(wanted, range) else tuple(sorted(wanted))


def check_room(message: Message) -> None:
    """Raise `SpecError` where no packet would be read, or a multiplexed field has no room in any frame."""
    framing = message.framing
    if framing is not None and framing.end and message.payload_start == len(framing.sync):
        if not framing.check_size and sizes(message.payload)[1] == 0:
            raise SpecError(
                f"{message.place}: with nothing before its end a packet of {message.name} is none"
            )
    if message.lengths is None or not isinstance(message.payload, c.Struct):
        return
    most = max(message.lengths)
    items = [(i.name, i.subcon if isinstance(i, c.Renamed) else i) for i in message.payload.subcons]
    always = message.payload_start + sum(sizes(body)[0] for _, body in items)
    for name, body in items:
        if not isinstance(body, Multiplexed) or isinstance(body, Present):
            continue
        beside = [o for _, o in items if isinstance(o, Multiplexed) and o.selector == body.selector]
        least = min(
            (
                always + sum(sizes(field.body)[0] for field in beside if value in field.when)
                for value in body.when
            ),
            default=always,
        )
        if least > most:
            raise SpecError(
                f"{message.place.of_field(name or '')}: with field {name!r} {message.name} has {least} bytes of data,"
                f" and its frames have {most} at most: the field would never be there"
            )
