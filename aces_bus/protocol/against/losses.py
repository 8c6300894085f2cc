"""Parts of a recording that are not messages: undeclared identifiers and opcodes, lengths and constants that differ, checks
that fail.

1. What occurs once or twice may be noise or another protocol's: a note. What occurs again and again contradicts the spec.
2. Losses are grouped as they come, in a bounded number of groups, each with a few samples.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from construct import ConstructError

from ...errors import AcesError
from ...frames import EXTENDED, FD, REMOTE
from ..declare.framing import Framing
from ..declare.message import Direction, Message
from ..declare.packet import error_text
from ..declare.place import SourceLine
from ..declare.protocol import Variant
from ..lint.finding import Level
from .fields import AGAIN, SHARE
from .finding import Moment, Observation

#: Share of a stream's bytes that may be lost without a finding.
LOST = 0.1
GROUPS, SAMPLES = 512, 16
#: Findings of one kind that are listed one by one.
LISTED = 8
IDENTIFIER = 0x1FFF_FFFF
#: How scanners give the reason of a frame that is too short or too long.
_BY_LENGTH = re.compile(r"malformed: length \d+, (?P<name>\w+) has .*", re.DOTALL)


@dataclass
class LostGroup:
    """Frames or packets that are lost in the same way; `key` and `length` are a frame's."""

    reason: str
    first: Moment
    key: int = 0
    length: int = 0
    count: int = 0
    samples: list[bytes] = field(default_factory=list[bytes])

    @property
    def identifier(self) -> str:
        """As the sheet writes it."""
        return f"0x{self.key & IDENTIFIER:0{8 if self.key & EXTENDED else 3}X}"


class Losses:
    """Groups of what was not decoded."""

    def __init__(self) -> None:
        self.groups: dict[tuple[object, ...], LostGroup] = {}
        #: What found no room among the groups.
        self.others = 0

    def add(self, group: tuple[object, ...], reason: str, data: bytes, moment: Moment, key: int = 0) -> None:
        """Add one more loss of a group."""
        found = self.groups.get(group)
        if found is None:
            if len(self.groups) >= GROUPS:
                self.others += 1
                return
            found = self.groups[group] = LostGroup(reason, moment, key, len(data))
        found.count += 1
        if len(found.samples) < SAMPLES and data not in found.samples:
            found.samples.append(data)


# ---------------------------------------------------------------------- CAN


def lost_frames(
    losses: Losses, variants: Sequence[Variant], seen: Mapping[tuple[str, str], int]
) -> Iterator[Observation]:
    """Yield what lost frames say; `seen` counts the messages that were decoded, by protocol and name."""
    messages = [(variant, message) for variant in variants for message in variant.messages.values()]
    undeclared: list[LostGroup] = []
    for group in losses.groups.values():
        if group.reason in ("error frame", "pending") or group.reason.startswith(
            ("unknown: needs request", "control")
        ):
            continue
        named = [(v, m) for v, m in messages if _is_named(m, group.key)]
        if any(m.transport is not None for _, m in named):
            continue  # a frame of a packet: what is in it, one frame does not say
        if named:
            yield from _of_named(group, named, seen)
        else:
            undeclared.append(group)
    lost = [group.key for group in losses.groups.values()]
    never = [
        message
        for variant, message in messages
        if not seen.get((variant.name, message.name)) and not any(_is_named(message, key) for key in lost)
    ]
    yield from _of_undeclared(undeclared, never, variants[0].protocol.place)


def _is_named(message: Message, key: int) -> bool:
    kinds = bool(key & EXTENDED), bool(key & REMOTE)
    return (
        (message.extended, message.remote) == kinds
        and bool(key & FD) in message.formats
        and message.identifier.match(key & IDENTIFIER) is not None
    )


def _of_named(
    group: LostGroup, named: Sequence[tuple[Variant, Message]], seen: Mapping[tuple[str, str], int]
) -> Iterator[Observation]:
    """Yield frames whose identifier is declared: another length, another constant, a check that fails."""
    _, message = next(
        ((v, m) for v, m in named if m.lengths is not None and group.length in m.lengths), named[0]
    )
    decoded = sum(seen.get((v.name, m.name), 0) for v, m in named)
    total = decoded + group.count
    level: Level = "warning" if group.count >= max(AGAIN, SHARE * total) else "note"
    names = _some(dict.fromkeys(m.name for _, m in named), " or ")
    frames = f"{group.count} frames {group.identifier} of {total}"
    by_length = _BY_LENGTH.fullmatch(group.reason)
    if by_length is not None:
        message = next((m for _, m in named if m.name == by_length["name"]), message)
        names, over = message.name, group.length - max(message.lengths or (0,))
        text = f"{names}: {frames} have {group.length} bytes, and its fields take {message.describe_lengths}"
        remedy = (
            f"declare the {over} bytes that are left over"
            if over > 0
            else "declare the shorter form, or length={…}"
        )
        yield _lost(level, "size", message.place, text, group, total, remedy, message)
    elif group.reason == "malformed: checksum":
        text = f"{message.name}: the check does not hold in {frames}"
        yield _lost(
            level,
            "check",
            message.place,
            text,
            group,
            total,
            "correct what the check covers, or its kind",
            message,
        )
    elif group.reason.startswith("malformed: "):
        text = f"{names}: {frames} cannot be read: {group.reason.removeprefix('malformed: ')}"
        yield _lost(
            level,
            "content",
            message.place,
            text,
            group,
            total,
            "correct the field, or declare another message",
            message,
        )
    else:
        constants = (
            "; ".join(dict.fromkeys(_differences(group, [m for _, m in named])))
            or "their bytes are none of its"
        )
        text = f"{names}: {frames} have that identifier and are not a message: {constants}"
        yield _lost(
            level,
            "undeclared",
            message.place,
            text,
            group,
            total,
            "correct the constant, or declare a message for them",
            message,
        )


def _differences(group: LostGroup, messages: Iterable[Message]) -> Iterator[str]:
    for message in messages:
        for constant in message.plan.constants:
            found = {
                data[constant.offset] & constant.mask for data in group.samples if len(data) > constant.offset
            }
            if found and constant.value not in found:
                values = ", ".join(f"{value:02X}" for value in sorted(found)[:4])
                yield f"byte {constant.offset} is {values}, of {message.name} {constant.value:02X}"
        data = group.samples[0]
        for head in message.heads:
            if head.pattern is not None and message.outer(data, group.key & IDENTIFIER) is None:
                number = head.number(data) if len(data) >= head.offset + head.size else 0
                if head.pattern.match(number) is None:
                    yield f"{head.name or 'head'} is {number:#04x}"


def _of_undeclared(
    groups: list[LostGroup], never: Sequence[Message], place: SourceLine
) -> Iterator[Observation]:
    """Yield identifiers that no message has: the most frequent ones, then the number of others."""
    groups.sort(key=lambda group: (-group.count, group.key))
    for group in groups[:LISTED]:
        near = _near(never, group)
        hint = (
            f"is it {near.name} ({near.identifier.describe()}), which never occurs? "
            if near is not None
            else ""
        )
        yield _lost(
            "warning" if group.count >= AGAIN else "note",
            "undeclared",
            place if near is None else near.place,
            f"{group.count} frames {group.identifier} of {group.length} bytes are not a message",
            group,
            group.count,
            f"{hint}declare it, or name the protocol that has it",
            near,
        )
    rest = groups[LISTED:]
    if rest:
        count = sum(group.count for group in rest)
        shown = ", ".join(group.identifier for group in rest[:12]) + (", …" if len(rest) > 12 else "")
        yield _lost(
            "warning" if any(group.count >= AGAIN for group in rest) else "note",
            "undeclared",
            place,
            f"{len(rest)} more identifiers ({count} frames) are not a message: {shown}",
            rest[0],
            count,
            "declare them, or name the protocol that has them",
            None,
        )


def _near(never: Sequence[Message], group: LostGroup) -> Message | None:
    """Return the message that never occurs and whose identifier is one slip away: the next number, another bit, a shift."""
    number = group.key & IDENTIFIER
    for other in (
        number + 1,
        number - 1,
        *(number ^ 1 << bit for bit in range(29)),
        number << 1,
        number >> 1,
    ):
        for message in never:
            fits = message.lengths is None or group.length in message.lengths
            if fits and other >= 0 and message.identifier.match(other) is not None:
                return message
    return None


def _lost(
    level: Level,
    rule: str,
    place: SourceLine,
    text: str,
    group: LostGroup,
    total: int,
    remedy: str,
    message: Message | None,
) -> Observation:
    witness = None
    if group.samples and not group.first.is_stream:
        digits = 8 if group.key & EXTENDED else 3
        data = "R" if group.key & REMOTE else group.samples[0].hex().upper()
        witness = f"{group.key & IDENTIFIER:0{digits}X}#{'#0' if group.key & FD else ''}{data}"
    elif group.samples:
        witness = f"hex:{group.samples[0][:256].hex().upper()}"
    return Observation(
        level,
        rule,
        place,
        f"{text}; first at {group.first}",
        message.name if message is not None else None,
        witness,
        count=group.count,
        total=total,
        first=group.first,
        remedy=remedy,
    )


# ---------------------------------------------------------------------- streams


class Opcodes:
    """What tells the packets of a framing apart: the head fields of its messages, or else their first constants."""

    def __init__(self, messages: Iterable[Message]) -> None:
        self.messages = tuple(messages)
        self._places: dict[Framing, dict[tuple[int, int], str]] = {}
        for message in self.messages:
            framing = message.framing
            if framing is None:
                continue
            places = self._places.setdefault(framing, {})
            for head in message.heads_written:
                if head.name is not None and head.name not in framing.derived:
                    places[head.offset, head.size] = head.name
        for message in self.messages:
            places = self._places[message.framing] if message.framing is not None else {}
            for offset, data in message.constants:
                if offset == message.payload_start and all(
                    name.startswith("byte ") for name in places.values()
                ):
                    places[offset, len(data)] = f"byte {offset}"

    def owner(self, data: bytes) -> Message | None:
        """Return the message whose head a packet has, whatever is behind it."""
        framing = self.framing_of(data)
        return next((m for m in self.messages if m.framing is framing and m.outer(data, 0) is not None), None)

    def framing_of(self, data: bytes) -> Framing | None:
        """Return the framing whose sync bytes a packet has, the longest ones."""
        fitting = [
            place for place in self._places if data.startswith(place.sync) and len(data) >= place.head_end
        ]
        return max(fitting, key=lambda place: len(place.sync), default=None)

    def of(self, data: bytes) -> dict[str, bytes]:
        """Return what of a packet says which message it is."""
        framing = self.framing_of(data)
        if framing is None:
            return {}
        return {
            name: data[offset : offset + size]
            for (offset, size), name in sorted(self._places[framing].items())
            if offset + size <= len(data) - framing.check_size
        }

    def group(self, reason: str, data: bytes) -> tuple[object, ...]:
        """Return the group of a lost packet: its reason and, where its framing is right, its opcode."""
        return (reason, *self.of(data).items()) if reason.startswith("unknown") else (reason,)


def _some(names: Iterable[str], between: str = ", ") -> str:
    """Return a few names for a sentence."""
    names = list(names)
    return between.join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def lost_packets(
    losses: Losses,
    opcodes: Opcodes,
    variants: Sequence[Variant],
    seen: Mapping[tuple[str, str], int],
    way: Direction | Literal["both"] | None,
) -> Iterator[Observation]:
    """Yield what packets say that went `way` and are lost; `seen` counts what was decoded, by protocol and name."""
    place = variants[0].protocol.place
    packets = sum(seen.values())
    never = [m.name for v in variants for m in v.messages_for(way) if not seen.get((v.name, m.name))]
    groups = sorted(losses.groups.values(), key=lambda group: -group.count)
    unknown = [group for group in groups if group.reason == "unknown"]
    yield from _of_opcodes(unknown[:LISTED], opcodes, never, place, packets)
    rest = unknown[LISTED:]
    if rest:
        count = sum(group.count for group in rest)
        yield _lost(
            "warning" if any(group.count >= AGAIN for group in rest) else "note",
            "undeclared",
            place,
            f"{len(rest)} more kinds of packets ({count}) are not a message:"
            f" {_some(_opcode_text(opcodes, group) for group in rest)}",
            rest[0],
            count,
            "declare them",
            None,
        )
    for group in groups:
        if group.reason.startswith("unknown: needs request"):
            continue
        framing = opcodes.framing_of(group.samples[0])
        total = packets + group.count
        if group.reason.startswith("malformed: "):
            level: Level = "warning" if group.count >= max(AGAIN, 2 * SHARE * total) else "note"
            why = group.reason.removeprefix("malformed: ")
            rule = "check" if why == "checksum" else "size" if why in ("length", "no end") else "content"
            where = framing.place if framing is not None else place
            text, remedy = (
                f"{group.count} packets of {total} are malformed: {why}",
                _REMEDIES.get(why, "correct the field, or declare another message"),
            )
            fitting = (
                _fitting_check(framing, group.samples) if why == "checksum" and framing is not None else ""
            )
            yield _lost(level, rule, where, text, group, total, fitting or remedy, None)


def _of_opcodes(
    groups: Iterable[LostGroup], opcodes: Opcodes, never: Sequence[str], place: SourceLine, packets: int
) -> Iterator[Observation]:
    """Yield packets whose framing is right and that match no message."""
    hint = f"is it one of {_some(never)}, which never occur? " if never else ""
    for group in groups:
        owner = opcodes.owner(group.samples[0])
        level: Level = "warning" if group.count >= AGAIN else "note"
        if owner is not None and opcodes.of(group.samples[0]):
            yield _lost(
                level,
                "content",
                owner.place,
                f"{owner.name}: {group.count} packets have its head and cannot be read: {_why(owner, group.samples[0])}",
                group,
                packets + group.count,
                "correct its fields: one too many or too few, or another size",
                owner,
            )
            continue
        yield _lost(
            level,
            "undeclared",
            place,
            f"{group.count} packets with {_opcode_text(opcodes, group)} are not a message",
            group,
            packets + group.count,
            f"{hint}declare it, or correct the opcode",
            None,
        )


def _why(message: Message, packet: bytes) -> str:
    """Say why a packet is not a message, as its construct says it."""
    try:
        message.struct.parse(packet)
    except (ConstructError, AcesError) as error:
        return error_text(error)
    except Exception as error:  # whatever foreign bytes make a construct raise
        return type(error).__name__
    return "another message, dialect or request has it"


def _opcode_text(opcodes: Opcodes, group: LostGroup) -> str:
    """Return an opcode in words: `kind 05`, `type 47 53 56 (GSV)`."""
    found: list[str] = []
    for name, data in opcodes.of(group.samples[0]).items():
        text = data.decode("ascii") if len(data) > 1 and data.isascii() else ""
        shown = f" ({text})" if text.isalnum() else ""
        found.append(f"{name} {data.hex(' ').upper()}{shown}")
    return ", ".join(found) or f"{len(group.samples[0])} bytes and a valid check"


def lost_bytes(
    variants: Sequence[Variant], skipped: int, size: int, framings: Sequence[Framing]
) -> Iterator[Observation]:
    """Yield what it says that `skipped` of `size` bytes of a stream begin no packet."""
    if size and skipped > max(LOST * size, max((framing.max_size for framing in framings), default=0)):
        yield Observation(
            "warning",
            "skipped",
            framings[0].place if framings else variants[0].protocol.place,
            f"{skipped} of {size} bytes begin no packet",
            count=skipped,
            total=size,
            remedy="check the sync bytes, the size, and whether the recording is of this protocol and direction",
        )


_REMEDIES = {
    "checksum": "check the size of packets, and what the check covers and how it is computed",
    "length": "check the size and max_size of packets",
    "no end": "check max_size, and the bytes that end a packet",
}


def _fitting_check(framing: Framing, samples: Sequence[bytes]) -> str:
    """Return where a check of the declared kind would hold on most samples: another first byte, or another size."""
    check = framing.check
    if check is None or framing.stuffing is not None or check.text is not None or framing.check_head:
        return ""
    best, words = 2, ""
    for more in (0, 1, -1, 2, -2):
        for start in range(5):
            held = 0
            for sample in samples:
                judged = _size_of(framing, sample)
                end = judged + more - check.size if judged else 0
                held += (
                    end > start
                    and len(sample) >= end + check.size
                    and (check.encode(sample[start:end]) == sample[end : end + check.size])
                )
            if held > best and held > len(samples) // 2:
                size = (
                    f"packets are {abs(more)} byte{'s' if abs(more) > 1 else ''} {'longer' if more > 0 else 'shorter'}, and "
                    if more
                    else ""
                )
                best, words = (
                    held,
                    f"{size}the check holds over the bytes from {start} on (in {held} of {len(samples)} samples)",
                )
    return words


def _size_of(framing: Framing, sample: bytes) -> int:
    if framing.affine is None:
        return framing.fixed_size or 0
    head = framing.affine.length
    if len(sample) < head.offset + head.size:
        return 0
    return framing.affine.factor * head.number(sample) + framing.affine.constant
