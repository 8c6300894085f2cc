"""Whether two messages can be told apart (law 9), with a witness when they cannot.

1. CAN is decided exactly over identifier × flags × length × constants; checks count as true.
2. Streams are first intersected without checks: no common packet is a proof. Otherwise a witness is looked for, and the
   construct of both messages must confirm it; none found is `undecided`, which a spec settles with `over=`.
3. What a spec says beside the bytes (direction, dialect, configuration, request) separates two messages only when no
   situation has both.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

from construct import ConstructError

from ...errors import AcesError, SpecError
from .framing import Framing
from .message import Message, Request
from .packet import can_image
from .pattern import meet


@dataclass(frozen=True)
class Conflict:
    """Two messages that accept the same packet. `witness` is one (identifier None on streams); None: undecided."""

    one: Message
    other: Message
    witness: bytes | None
    identifier: int | None = None

    @property
    def how(self) -> str:
        if self.witness is None:
            return "nothing in their templates tells them apart, and no packet was found that decides it"
        if self.identifier is None:
            return f"both accept {self.witness.hex(' ').upper()}"
        return f"both accept {self.identifier:03X}#{self.witness.hex().upper()}"


def check_against(made: Message, declared: Sequence[Message]) -> None:
    """Raise `SpecError` when a new message cannot be told from one declared before."""
    for other in declared:
        found = unresolved(made, other)
        if found is not None:
            raise SpecError(
                f"{made.place}: message {made.name!r} is ambiguous with {other.name!r} ({other.place}): {found.how};"
                f" say what tells them apart (direction, dialect, when, reply_to, after) or order them with over={other.name!r}"
            )


def unresolved(one: Message, other: Message) -> Conflict | None:
    """The conflict of two messages when neither the bytes nor the spec's other words settle it."""
    from .protocol import may_coexist

    if one.direction is not None and other.direction is not None and one.direction != other.direction:
        return None
    if not may_coexist(one, other) or ordered_by_spec(one, other) or contexts_exclude(one, other):
        return None
    return conflict(one, other)


def ordered_by_spec(one: Message, other: Message) -> bool:
    return other.name in one.over or one.name in other.over


def contexts_exclude(one: Message, other: Message) -> bool:
    """Whether no outstanding request, or no sticky mode, allows both."""
    return _exclude(one.reply_to, other.reply_to) or _exclude(one.after, other.after)


def _exclude(mine: Sequence[Request], theirs: Sequence[Request]) -> bool:
    return bool(mine) and bool(theirs) and all(a.excludes(b) for a in mine for b in theirs)


@lru_cache(maxsize=65536)
def conflict(one: Message, other: Message) -> Conflict | None:
    """The conflict of two messages by their bytes alone, or None when they are disjoint."""
    if one.framing is None or other.framing is None:
        return _can_conflict(one, other)
    if one.framing is not other.framing:
        return _framings_conflict(one, other)
    return _stream_conflict(one, other)


def opposite_conflict(messages: Iterable[Message]) -> tuple[Message, Message] | None:
    """Two messages of opposite direction that bytes alone cannot tell apart."""
    listed = list(messages)
    for index, one in enumerate(listed):
        for other in listed[:index]:
            if one.direction is not None and other.direction is not None and one.direction != other.direction:
                if conflict(one, other) is not None:
                    return one, other
    return None


def needing_context(messages: Sequence[Message]) -> frozenset[str]:
    """Names of the messages that can only be recognised with their request: bytes alone leave a choice, or the record
    holds fields of the request."""
    found = set()
    for message in messages:
        if not message.reply_to and not message.after:
            continue
        if message.request_fields or any(conflict(message, other) for other in messages if other is not message):
            found.add(message.name)
    return frozenset(found)


# ---------------------------------------------------------------------- CAN


def _fixed(message: Message) -> tuple[dict[int, tuple[int, int]], dict[tuple[int, ...], frozenset[int]]]:
    """Constants by byte (mask, value), and the numbers that must be among some values, by their bits."""
    from ..codegen.flatten import flatten

    plan = flatten(message)
    bytes_: dict[int, tuple[int, int]] = {}
    for constant in plan.constants:
        mask, value = bytes_.get(constant.offset, (0, 0))
        bytes_[constant.offset] = (mask | constant.mask, value | constant.value)
    return bytes_, {one.number.bits: frozenset(one.values) for one in plan.one_of}


def _merge(one: Message, other: Message, length: int | None) -> dict[int, int] | None:
    """Bytes that satisfy the constants of both (by offset), or None when they contradict each other."""
    mine, my_sets = _fixed(one)
    theirs, their_sets = _fixed(other)
    found: dict[int, int] = {}
    for offset in mine.keys() | theirs.keys():
        if length is not None and offset >= length:
            continue
        mask_a, value_a = mine.get(offset, (0, 0))
        mask_b, value_b = theirs.get(offset, (0, 0))
        if (value_a ^ value_b) & mask_a & mask_b:
            return None
        found[offset] = value_a | value_b
    for bits in my_sets.keys() | their_sets.keys():
        wanted = my_sets.get(bits, their_sets.get(bits, frozenset()))
        if bits in my_sets and bits in their_sets:
            wanted = my_sets[bits] & their_sets[bits]
        number = next((n for n in sorted(wanted) if _agrees(n, bits, mine, theirs)), None)
        if number is None:
            return None
        for index, position in enumerate(bits):
            byte = position // 8
            found[byte] = found.get(byte, 0) & ~(1 << position % 8) | (number >> index & 1) << position % 8
    return found


def _agrees(number: int, bits: Sequence[int], *sides: dict[int, tuple[int, int]]) -> bool:
    for index, position in enumerate(bits):
        for fixed in sides:
            mask, value = fixed.get(position // 8, (0, 0))
            if mask >> position % 8 & 1 and (value >> position % 8 ^ number >> index) & 1:
                return False
    return True


def _can_conflict(one: Message, other: Message) -> Conflict | None:
    if (one.extended, one.remote, one.fd) != (other.extended, other.remote, other.fd):
        return None
    lengths = sorted(set(one.lengths or ()) & set(other.lengths or ()))
    if not lengths:
        return None
    fixed = _merge(one, other, None)
    if fixed is None:
        return None
    identifier = meet(one.identifier, other.identifier, 29 if one.extended else 11)
    if identifier is None:
        return None
    size = lengths[-1]
    data = bytes(fixed.get(i, 0) for i in range(size))
    if _is_split_by_selector(one, other, identifier, lengths):
        return None
    return Conflict(one, other, data, identifier)


def _is_split_by_selector(one: Message, other: Message, identifier: int, lengths: Sequence[int]) -> bool:
    """Whether multiplexed lengths leave no common length: asked of the constructs, over every selector value they name."""
    from ..codegen.flatten import flatten

    if flatten(one).lengths_by is None and flatten(other).lengths_by is None:
        return False
    rng = random.Random(0)
    fixed = _merge(one, other, None) or {}
    for size in lengths:
        for attempt in range(256):
            data = bytes(fixed.get(i, attempt if rng.random() < 0.5 else rng.randrange(256)) for i in range(size))
            image = can_image(identifier, data, extended=one.extended, remote=one.remote, fd=one.fd)
            if _accepts(one, image) and _accepts(other, image):
                return False
    return True


# ---------------------------------------------------------------------- streams


def _framings_conflict(one: Message, other: Message) -> Conflict | None:
    a, b = one.framing, other.framing
    assert isinstance(a, Framing) and isinstance(b, Framing)
    if _merge(one, other, None) is None:
        return None
    shared = min(len(a.sync), len(b.sync))
    if a.sync[:shared] != b.sync[:shared]:
        return None
    for first, second in ((a, b), (b, a)):
        if first.not_next and len(second.sync) > len(first.sync) and second.sync[len(first.sync)] in first.not_next:
            return None
    for message, against in ((one, other), (other, one)):
        witness = _search(message, against)
        if witness is not None:
            return Conflict(one, other, witness)
    return Conflict(one, other, None)


def _stream_conflict(one: Message, other: Message) -> Conflict | None:
    from ..codegen.flatten import flatten

    if _merge(one, other, None) is None:
        return None
    lengths, others = flatten(one).lengths, flatten(other).lengths
    if lengths is not None and others is not None and not set(lengths) & set(others):
        return None
    for mine, theirs in ((lengths, flatten(other).least), (others, flatten(one).least)):
        if mine is not None and max(mine) < theirs:
            return None
    witness = _search(one, other) or _search(other, one)
    return Conflict(one, other, witness)


def _search(one: Message, other: Message) -> bytes | None:
    """A packet that both constructs accept, or of which `other` accepts a beginning."""
    framing = one.framing
    assert framing is not None
    fixed = _merge(one, other, None) or {}
    rng = random.Random(0)
    for size in [*range(24), 32, 48, 64]:
        for attempt in range(12):
            head = bytes(fixed.get(framing.head_end - sum(h.size for h in framing.heads) + i, 0) for i in range(sum(h.size for h in framing.heads)))
            body = bytes(
                fixed.get(framing.head_end + i, 0 if attempt == 0 else 0x2C if attempt == 1 else rng.randrange(256)) for i in range(size)
            )
            try:
                packet = one.struct.framed(framing, head, body)
            except AcesError:
                continue
            if _accepts(one, packet) and any(_accepts(other, packet[:n]) for n in (len(packet),)):
                return packet
    return None


def _accepts(message: Message, packet: bytes) -> bool:
    """Whether the message's construct accepts the packet, whatever its request."""
    try:
        message.struct.parse(packet, raw=True)
    except (ConstructError, AcesError):
        return False
    return True
