"""Record lines: one JSON object a line, for programs.

    {"source": "walk.log", "time": 1436509052.249713, "channel": "can0", "direction": null, "id": 99, "extended": false,
     "fd": false, "protocol": "hubo", "message": "Encoder", "fields": {"board": 3, "position": [120, -4]}}

1. Keys are in this order. Streams have "offset" and "size" instead of "id", "extended" and "fd".
2. "bus_direction" ("tx", "rx") is there only when the capture says it; "remote" only when it is true.
3. What is not decoded has "message": null, then "reason" and "raw" instead of "fields".
4. The fields of a record are printed by a function that is generated from its plan, all before them by `JsonLines`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from aces_bus import Unknown
from aces_bus.frames import EXTENDED, FD, REMOTE
from aces_bus.protocol import Record
from aces_bus.protocol.generate.load import OnDemand
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.record import protocol_name_of
from aces_bus.protocol.record_plans import message_of

from .printing import HEADS, LinePrinter, Read, has_few_values
from .shape import OfKind, Plans, json_bytes, json_string, nameless_number, plain_of

BUS: Mapping[bool | None, str] = {True: ', "bus_direction": "rx"', False: ', "bus_direction": "tx"', None: ""}


class JsonLines:
    """`direction` is what the user stated of raw bytes; on CAN, what a frame is not known to be it is not."""

    def __init__(self, plans: Plans, direction: str | None) -> None:
        self._direction = direction
        self._begin = b""
        self._is_can = True
        self._fields = OfKind(lambda kind: FieldsPrinter(kind, plans[kind]).load())
        self._frames = OnDemand(self._frame, most=HEADS)
        self._packets = OnDemand(self._packet, most=HEADS)

    def begin(self, source: str, link: str, start: float | None = None) -> bytes:
        self._begin = f'{{"source": {json_string(source)}, "time": '.encode()
        self._is_can = link == "can"
        return b""

    def items(self, items: Sequence[Any]) -> bytes:
        begin, fields, is_can = self._begin, self._fields, self._is_can
        frames, packets = self._frames, self._packets
        lines: list[bytes] = []
        for item in items:
            kind = type(item)
            if kind is Unknown:
                lines += begin, self._unknown(item)
            elif is_can:
                head = frames[kind, item._channel, item._key, item._rx]
                lines += begin, json_bytes(item._time), head, fields[kind](item)
            else:
                place = b'%d, "size": %d' % (item._key, len(item._raw))
                head = packets[kind, item._channel]
                lines += begin, json_bytes(item._time), head, place, fields[kind](item)
        return b"".join(lines)

    def _frame(self, of: tuple[type[Record], str | None, int, bool | None]) -> bytes:
        kind, channel, key, is_rx = of
        flags = (key & EXTENDED != 0, key & FD != 0, key & REMOTE != 0)
        return frame_head(channel, message_of(kind).direction, key & 0x1FFF_FFFF, flags, is_rx).encode()

    def _packet(self, of: tuple[type[Record], str | None]) -> bytes:
        kind, channel = of
        return packet_head(channel, message_of(kind).direction or self._direction).encode()

    def _unknown(self, item: Unknown) -> bytes:
        meta = item.meta
        if self._is_can:
            flags = (meta.extended, meta.fd, meta.remote)
            head = frame_head(meta.channel, meta.direction, meta.identifier, flags, meta.is_rx)
        else:
            head = packet_head(meta.channel, meta.direction or self._direction)
            head += f'{json_string(meta.offset)}, "size": {json_string(meta.size)}'
        reason, raw = json_string(item.reason), meta.raw.hex()
        lost = f'"protocol": null, "message": null, "reason": {reason}, "raw": "{raw}"'
        return f"{json_string(meta.time)}{head}, {lost}}}\n".encode()


def frame_head(
    channel: str | None,
    direction: str | None,
    identifier: int | None,
    flags: tuple[bool, bool, bool],
    is_rx: bool | None,
) -> str:
    """Return what CAN says of a frame; `flags`: extended, fd, remote."""
    extended, fd, _ = map(json_string, flags)
    head = f', "channel": {json_string(channel)}, "direction": {json_string(direction)}{BUS[is_rx]}'
    head += f', "id": {json_string(identifier)}, "extended": {extended}, "fd": {fd}'
    return head + (', "remote": true' if flags[2] else "")


def packet_head(channel: str | None, direction: str | None) -> str:
    """Return what is said of a packet, up to its offset."""
    return f', "channel": {json_string(channel)}, "direction": {json_string(direction)}, "offset": '


# ---------------------------------------------------------------------- fields


class FieldsPrinter(LinePrinter):
    """Prints the function that writes what a message's records hold, behind what is said of the frame or packet."""

    def __init__(self, kind: type[Record], plan: p.MessagePlan) -> None:
        super().__init__(plan)
        protocol, message = json_string(protocol_name_of(kind)), json_string(kind.__name__)
        parts: list[str | Read] = [f', "protocol": {protocol}, "message": {message}, "fields": {{']
        for number, field in enumerate(plan.fields):
            parts.append(f"{', ' if number else ''}{json_string(field.name)}: ")
            parts += self._value(field, field.name, f"r.{field.name}")
        self.joined([*parts, "}}\n"])

    def _value(self, field: p.PlanField, name: str, value: str) -> list[str | Read]:
        node, is_optional = field.node, field.when is not None
        if not node.is_leaf and not is_optional and self.plan.is_flat:
            is_list = not node.is_record
            parts: list[str | Read] = ["[" if is_list else "{"]
            for step, inner in node.children:
                parts.append(", " if len(parts) > 1 else "")
                parts.append("" if is_list else f"{json_string(step)}: ")
                inside = f"{value}[{step}]" if is_list else f"{value}.{step}"
                parts += self._value(inner, f"{name}_{step}", inside)
            return [*parts, "]" if is_list else "}"]
        number = nameless_number(node)
        if number is not None and number.is_inexact and not has_few_values(node):
            text = number.mended(value)
            if is_optional or number.has_unknown:
                text = f"None if (v := {value}) is None else {number.mended('v')}"
            return [Read(f"json({text})")]
        if node.is_plain and (number is None or not number.is_inexact):
            return [Read(f"json({value})")]
        plain = plain_of(node)
        show = lambda item: msgspec.json.format(json_bytes(plain(item)), indent=0)  # noqa: E731
        return [self.shown(name, node, show, value)]
