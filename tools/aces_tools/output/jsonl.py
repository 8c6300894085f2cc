"""Record lines: one JSON object a line, for programs.

    {"source": "walk.log", "time": 1436509052.249713, "channel": "can0", "direction": null, "id": 99, "extended": false,
     "fd": false, "protocol": "hubo", "message": "Encoder", "fields": {"board": 3, "position": [120, -4]}}

1. Keys stand in this order. Streams have "offset" and "size" instead of "id", "extended" and "fd".
2. "bus_direction" ("tx", "rx") is there only when the capture says it; "remote" only when it is true.
3. What is not decoded has "message": null, then "reason" and "raw" instead of "fields".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import Any

import msgspec
from msgspec import UNSET, UnsetType

from aces_bus.protocol import Record, Unknown
from aces_bus.protocol.keys import EXTENDED, FD, REMOTE
from aces_bus.protocol.plan.nodes import MessagePlan
from aces_bus.protocol.record import message_of, protocol_name_of

from .shape import OfKind, Plans, is_single_value, json_value


class CanLine(msgspec.Struct, gc=False):
    source: str
    time: float | None
    channel: str | None
    direction: str | None
    bus_direction: str | UnsetType
    id: int | None
    extended: bool
    fd: bool
    remote: bool | UnsetType
    protocol: str | None
    message: str | None
    fields: dict[str, Any] | UnsetType = UNSET
    reason: str | UnsetType = UNSET
    raw: str | UnsetType = UNSET


class StreamLine(msgspec.Struct, gc=False):
    source: str
    time: float | None
    channel: str | None
    direction: str | None
    offset: int | None
    size: int | None
    protocol: str | None
    message: str | None
    fields: dict[str, Any] | UnsetType = UNSET
    reason: str | UnsetType = UNSET
    raw: str | UnsetType = UNSET


BUS: Mapping[bool | None, str | UnsetType] = {True: "rx", False: "tx", None: UNSET}


Convert = Callable[[Any], CanLine | StreamLine]


class JsonLines:
    """`direction` is what the user stated of raw bytes; on CAN, what a frame is not known to be it is not."""

    def __init__(self, plans: Plans, direction: str | None) -> None:
        self._plans = plans
        self._direction = direction
        self._encode = msgspec.json.Encoder(enc_hook=json_value).encode
        self._lines: OfKind[Convert]

    def begin(self, source: str, link: str, start: float | None = None) -> bytes:
        is_can = link == "can"
        plans = self._plans
        self._lines = OfKind(lambda kind: self._line(kind, plans[kind], source, is_can=is_can))
        self._lines[Unknown] = self._unknown(source, is_can=is_can)
        return b""

    def items(self, items: Sequence[Any]) -> bytes:
        encode, form, lines = self._encode, msgspec.json.format, self._lines
        out = [form(encode(lines[type(item)](item)), indent=0) for item in items]
        out.append(b"")
        return b"\n".join(out)

    def _line(self, kind: type[Record], plan: MessagePlan, source: str, *, is_can: bool) -> Convert:
        """The line of a record. The transport's fields are read from the record: `meta` costs as much as all else."""
        names = tuple(field.name for field in plan.fields)
        special = tuple(field.name for field in plan.fields if not is_single_value(field.node))
        protocol, message, direction = (
            protocol_name_of(kind),
            kind.__name__,
            message_of(kind).direction or (None if is_can else self._direction),
        )
        get = attrgetter("_time", "_channel", "_key", "_raw", "_rx", *names)

        def fields(values: list[Any]) -> dict[str, Any]:
            found = dict(zip(names, values, strict=True))
            for name in special:
                found[name] = json_value(found[name])
            return found

        def can(record: Any) -> CanLine:
            time, channel, key, _, is_rx, *values = get(record)
            return CanLine(
                source,
                time,
                channel,
                direction,
                BUS[is_rx],
                key & 0x1FFF_FFFF,
                key & EXTENDED != 0,
                key & FD != 0,
                True if key & REMOTE else UNSET,
                protocol,
                message,
                fields(values),
            )

        def stream(record: Any) -> StreamLine:
            time, channel, offset, raw, _, *values = get(record)
            return StreamLine(
                source, time, channel, direction, offset, len(raw), protocol, message, fields(values)
            )

        return can if is_can else stream

    def _unknown(self, source: str, *, is_can: bool) -> Convert:
        def can(item: Unknown) -> CanLine:
            meta = item.meta
            return CanLine(
                source,
                meta.time,
                meta.channel,
                meta.direction,
                BUS[meta.is_rx],
                meta.identifier,
                meta.extended,
                meta.fd,
                True if meta.remote else UNSET,
                None,
                None,
                reason=item.reason,
                raw=meta.raw.hex(),
            )

        def stream(item: Unknown) -> StreamLine:
            meta = item.meta
            direction = meta.direction or self._direction
            return StreamLine(
                source,
                meta.time,
                meta.channel,
                direction,
                meta.offset,
                meta.size,
                None,
                None,
                reason=item.reason,
                raw=meta.raw.hex(),
            )

        return can if is_can else stream
