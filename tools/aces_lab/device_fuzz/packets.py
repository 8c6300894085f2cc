"""What is sent to a device that is fuzzed: valid packets by its spec, edges of their fields, damaged and random ones.

1. Packets carry this device's credentials. What others on the bus would take for theirs does not pass `SendRules`.
2. Whatever was drawn or made simpler, `SendRules` look at the packet itself, as a receiver would: not at how it was made.
3. The same source gives the same packets.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import construct as c

from aces_bus import Frame, make_scanner
from aces_bus import Unknown as UnknownRecord
from aces_bus.errors import AcesError, CallerError, UnknownNameError
from aces_bus.protocol import Message, Record, Variant
from aces_bus.protocol.declare.pattern import IdPattern
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.plan.nodes import NodePath
from aces_bus.protocol.record import FieldValue
from aces_bus.testing.packets import DrawnPacket, UndrawableError, draw_values, image_frame
from aces_bus.testing.scenes import Cast, Damage
from aces_bus.testing.source import ChoiceSource

#: A frame, the frames of one packet, or bytes.
AnyPacket = Any
#: Tries until a draw gives up.
ATTEMPTS = 20


# ---------------------------------------------------------------------- what may be sent


@dataclass(frozen=True)
class LeftOut:
    """Messages that are not sent: by name, or only those whose field has one of some values."""

    message: str
    field: str | None = None
    #: Numbers as (least, greatest), names as they are.
    values: tuple[tuple[float, float] | str, ...] = ()

    @classmethod
    def parse(cls, text: str, variant: Variant) -> LeftOut:
        """`Write`, `Write.address=3`, `Write.address=0..8,64`, `SetMode.mode=boot`.

        Raises `CallerError` for what is no such text, `UnknownNameError` for a message or field that there is not.
        """
        whole, equals, given = text.partition("=")
        name, point, field = whole.partition(".")
        if name not in variant.messages:
            raise UnknownNameError(
                f"message of {variant.label}", name, [m.name for m in variant.messages_for("to device")]
            )
        if not point and not equals:
            return cls(name)
        if not field or not given:
            raise CallerError(f"{text}: write MESSAGE, or MESSAGE.FIELD=VALUE, such as {name}.address=0..8")
        if field not in variant.messages[name].fields:
            raise UnknownNameError(f"field of {name}", field, variant.messages[name].fields)
        return cls(name, field, tuple(map(_value, given.split(","))))

    def covers(self, record: Record) -> bool:
        """Return whether a record is such a message."""
        if type(record).__name__ != self.message:
            return False
        if self.field is None:
            return True
        value = getattr(record, self.field)
        return any(
            value == wanted
            if isinstance(wanted, str)
            else isinstance(value, (int, float)) and wanted[0] <= value <= wanted[1]
            for wanted in self.values
        )


def _value(text: str) -> tuple[float, float] | str:
    low, dots, high = text.partition("..")
    try:
        return float(int(low, 0)), float(int(high if dots else low, 0))
    except ValueError:
        return text


class SendRules:
    """Which packets may be sent to a device.

    `allowed` are the messages (None: all of its own); `left_out` those that are not. `strictly`: a packet may be sent only
    when all that a receiver could take it for is allowed, as it must be where something can move; one of no known message is
    not.
    """

    def __init__(
        self,
        variant: Variant,
        credentials: Mapping[str, int],
        *,
        allowed: Collection[str] | None = None,
        left_out: Sequence[LeftOut] = (),
        fixed: Mapping[str, Mapping[str, Collection[Any]]] | None = None,
        strictly: bool = False,
    ) -> None:
        self.variant, self.credentials = variant, dict(credentials)
        self.left_out, self.strictly = tuple(left_out), strictly
        #: By message: fields that have one of these values only.
        self.fixed = dict(fixed or {})
        own = [m for m in variant.messages_for("to device") if is_for(m, self.credentials)]
        if strictly:
            own = [m for m in own if m.name in (allowed or ()) or self._is_only_ours(m)]
        self.messages = [m for m in own if allowed is None or m.name in allowed]
        whole = {exclusion.message for exclusion in self.left_out if exclusion.field is None}
        self.messages = [m for m in self.messages if m.name not in whole]
        self._names = {m.name for m in self.messages}
        self._scanner = make_scanner([variant], direction="to device", include_unknown=True)
        self._everything = variant.messages_for("to device")

    def _is_only_ours(self, message: Message) -> bool:
        """Return whether no other device of the protocol takes a message for its own."""
        return not self.credentials or any(name in message.fields for name in self.credentials)

    def admit(self, packet: AnyPacket) -> bool:
        """Return whether a packet may be sent."""
        self._scanner.reset()
        if isinstance(packet, bytes):
            assert isinstance(self._scanner, StreamScanner)
            records = self._scanner.datagram(packet)
        else:
            records = self._scanner.feed(list(packet) if isinstance(packet, tuple) else [packet])
        whole = [record for record in records if record.__class__ is not UnknownRecord]
        if any(exclusion.covers(record) for exclusion in self.left_out for record in whole):
            return False
        if not all(self._is_allowed(record) for record in whole):
            return False
        if not self.strictly or (whole and len(whole) == len(records)):
            return True
        if isinstance(packet, bytes):
            return self._is_refused_by_all(records)
        return not whole and not isinstance(packet, tuple) and self._is_harmless(packet)

    def _is_allowed(self, record: Record) -> bool:
        name = type(record).__name__
        if name not in self._names:
            return not self.strictly and name not in {m.name for m in self._everything}
        if any(getattr(record, n, v) != v for n, v in self.credentials.items()):
            return False
        return all(getattr(record, field) in values for field, values in self.fixed.get(name, {}).items())

    def _is_refused_by_all(self, records: Sequence[Any]) -> bool:
        """Return whether no receiver that looks at the check takes bytes for a packet of another message."""
        is_checked = all(m.framing is not None and m.framing.check is not None for m in self._everything)
        reasons = [record.reason for record in records if record.__class__ is UnknownRecord]
        return is_checked and not any(reason.startswith("unknown") for reason in reasons)

    def _is_harmless(self, frame: Frame) -> bool:
        """Return whether all that a receiver may take a frame for, if it does not look at its length, is allowed."""
        possible = [m for m in self._everything if _may_be_taken_for(m, frame)]
        return bool(possible) and all(m.name in self._names and m.name not in self.fixed for m in possible)


def _may_be_taken_for(message: Message, frame: Frame) -> bool:
    """Return whether identifier, heads and constants of a frame are a message's, as far as the frame goes."""
    if message.identifier.match(frame.arbitration_id) is None or message.extended != frame.is_extended_id:
        return False
    data = frame.data
    for head in message.heads:
        if head.pattern is not None and head.offset + head.size <= len(data):
            if head.pattern.match(head.number(data)) is None:
                return False
    return all(
        data[at : at + len(wanted)] == wanted[: max(0, len(data) - at)] for at, wanted in message.constants
    )


def is_for(message: Message, credentials: Mapping[str, int]) -> bool:
    """Return whether a message can carry these credentials: not one of boards with other numbers."""
    patterns: list[IdPattern] = [message.identifier]
    patterns += [head.pattern for head in message.heads if head.pattern is not None]
    return all(
        capture.name not in credentials or credentials[capture.name] in capture.values
        for pattern in patterns
        for capture in pattern.captures
    )


# ---------------------------------------------------------------------- what is drawn


class DevicePackets:
    """Draws packets for one device. Raises `CallerError` where there is no message to be sent."""

    def __init__(self, rules: SendRules) -> None:
        self.rules, self.variant = rules, rules.variant
        self.is_can = self.variant.link == "can"
        self.has_fd = self.variant.protocol.has_fd
        if not rules.messages:
            raise CallerError(f"{self.variant.label}: there is no message that may be sent to this device")
        self._cast = Cast.of(self.variant, "to device")

    def draw(self, source: ChoiceSource) -> tuple[str, AnyPacket]:
        """Return how it was made, and a packet that may be sent: a frame, frames of a packet, or bytes."""
        for _ in range(ATTEMPTS):
            found = self._draw(source)
            if found is not None and self.rules.admit(found[1]):
                return found
        for _ in range(ATTEMPTS):
            drawn = self.valid(source.choice(self.rules.messages), source)
            packet = None if drawn is None else self.packet_of(drawn, source)
            if packet is not None and self.rules.admit(packet):
                return "valid", packet
        raise CallerError(f"{self.variant.label}: no packet was found that may be sent to this device")

    def _draw(self, source: ChoiceSource) -> tuple[str, AnyPacket] | None:
        how = source.integer(0, 15)
        if how == 15:
            packet = self._random(source)
            return None if packet is None else ("random", packet)
        drawn = self.valid(source.choice(self.rules.messages), source)
        if drawn is None:
            return None
        if how < 7:
            return "valid", self.packet_of(drawn, source)
        if how < 11:
            edged = at_an_edge(drawn, source)
            return None if edged is None else ("boundary", self.packet_of(edged, source))
        packet = self._damaged(drawn, source)
        return None if packet is None else ("mutated", packet)

    def valid(self, message: Message, source: ChoiceSource) -> DrawnPacket | None:
        """Return a valid packet of a message with the device's credentials."""
        fixed: dict[str, FieldValue] = {
            n: v for n, v in self.rules.credentials.items() if n in message.fields
        }
        try:
            values = draw_values(message, source, fixed)
            return DrawnPacket(message, values, bytes(message.struct.build(values, raw=True)))
        except (AcesError, c.ConstructError, UndrawableError):
            return None

    def packet_of(self, drawn: DrawnPacket, source: ChoiceSource) -> AnyPacket:
        """Return a drawn packet as it is sent."""
        if not self.is_can:
            return drawn.image
        if drawn.message.transport is None:
            return image_frame(drawn.image)
        carried = tuple(drawn.carried(source.integer(0, 3)))
        return _one_or_all(carried)

    def _damaged(self, drawn: DrawnPacket, source: ChoiceSource) -> AnyPacket | None:
        if not self.is_can:
            return Damage.packet(drawn, source.integer(0, Damage.OF_PACKET - 1), source) or None
        packet = self.packet_of(drawn, source)
        if isinstance(packet, tuple):
            at = source.integer(0, len(packet) - 1)
            how = source.integer(0, 3)
            if how == 0:
                return _one_or_all((*packet[:at], *packet[at + 1 :]))
            if how == 1:
                return (*packet[: at + 1], *packet[at:])
            made = self._damaged_frame(packet[at], drawn.message, source)
            return None if made is None else (*packet[:at], made, *packet[at + 1 :])
        return self._damaged_frame(packet, drawn.message, source)

    def _damaged_frame(self, frame: Frame, message: Message, source: ChoiceSource) -> Frame | None:
        made = Damage.frame(frame, message, source.integer(0, Damage.OF_FRAME - 1), source)
        return None if made.is_fd and not self.has_fd else made

    def _random(self, source: ChoiceSource) -> AnyPacket | None:
        if not self.is_can:
            return Damage.garbage(self._cast, source)
        drawn = self.valid(source.choice(self.rules.messages), source)
        if drawn is None:
            return None
        frame = image_frame(drawn.image[:5])
        return Frame(
            frame.arbitration_id, source.bytes(source.integer(0, 8)), is_extended_id=frame.is_extended_id
        )


def _one_or_all(frames: Sequence[Frame]) -> AnyPacket:
    """Return a frame alone, or the frames of a packet."""
    return tuple(frames) if len(frames) > 1 else frames[0]


def at_an_edge(packet: DrawnPacket, source: ChoiceSource) -> DrawnPacket | None:
    """Return the packet with one number at an edge: of its declared range, a little beside it, of its bits. None: it
    has none.
    """
    message = packet.message
    edges = _edges(message)
    if not edges:
        return None
    for _ in range(4):
        way, numbers = source.choice(edges)
        values = _with(packet.values, way, source.choice(numbers))
        if values is None:
            continue
        try:
            return DrawnPacket(message, values, bytes(message.struct.build(values, raw=True)))
        except (AcesError, c.ConstructError):
            continue
    return None


@lru_cache(maxsize=4096)
def _edges(message: Message) -> tuple[tuple[tuple[str | int, ...], tuple[int, ...]], ...]:
    """Return the ways to the whole numbers of a message's payload, with their raw edges."""
    found: list[tuple[tuple[str | int, ...], tuple[int, ...]]] = []
    for leaf in message.plan.leaves if message.plan.is_flat else ():
        ends, way = leaf.node.raw_range, plain_way(leaf)
        if ends is None or way is None or way[0] in message.outer_names:
            continue
        numbers = {ends[0], ends[1], ends[0] + 1, ends[1] - 1, 0, 1}
        scale = leaf.node.scale
        if scale is not None and scale.limits is not None:
            for limit in scale.limits:
                raw = round((limit - scale.offset) / scale.scale)
                numbers |= {raw - 1, raw, raw + 1}
        found.append((way, tuple(sorted(n for n in numbers if ends[0] <= n <= ends[1]))))
    return tuple(found)


def plain_way(leaf: NodePath) -> tuple[str | int, ...] | None:
    """Return the steps to a leaf's value in a record; None for what is inside of a list."""
    steps = [step for step in leaf.way if isinstance(step, (str, int))]
    return tuple(steps) if len(steps) == len(leaf.way) else None


def _with(values: Any, way: Sequence[str | int], number: int) -> Any:
    """Return values with another number at a place; None where there is no number."""
    if not way:
        return number if isinstance(values, int) else None
    step, *rest = way
    try:
        inner = _with(values[step], rest, number)
    except (LookupError, TypeError):
        return None
    if inner is None:
        return None
    made: Any = c.ListContainer(values) if isinstance(step, int) else c.Container(values)
    made[step] = inner
    return made


__all__ = ["AnyPacket", "DevicePackets", "LeftOut", "SendRules", "at_an_edge", "is_for", "plain_way"]
