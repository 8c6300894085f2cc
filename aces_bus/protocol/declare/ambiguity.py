"""Whether two messages can be told apart (law 9), with a witness when they cannot.

1. CAN is decided exactly over identifier × flags × length × constants; checks count as true. Where construct alone reads
   a payload, a frame is shown only when both constructs accept it.
2. Streams are first intersected without checks: no common packet is a proof. Otherwise a witness is looked for, and the
   construct of both messages must confirm it; none found is `undecided`, which a spec settles with `overrides=`.
3. What a spec says beside the bytes (direction, dialect, configuration, request) separates two messages only when no
   situation has both.
4. Messages are tried as declared, but one goes before those it overrides (`ordered`).
"""

from __future__ import annotations

import random
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import msgspec
from construct import ConstructError

from ...errors import AcesError, SpecError
from .framing import Framing
from .message import Message, Request, may_coexist, share_dialect
from .packet import WrongCheckError, can_image
from .pattern import IdPattern, meet
from .place import SourceLine

if TYPE_CHECKING:
    from ..plan.nodes import Constant


class Conflict(msgspec.Struct, frozen=True):
    """Two messages that accept the same packet. `witness` is one (identifier None on streams); None: undecided."""

    one: Message
    other: Message
    witness: bytes | None
    identifier: int | None = None

    @property
    def how(self) -> str:
        if self.witness is None:
            return (
                "undecided: their templates do not tell them apart, and no packet was found that decides it"
            )
        if self.identifier is None:
            return f"both accept {self.witness.hex(' ').upper()}"
        return f"both accept {self.identifier:03X}#{self.witness.hex().upper()}"


class Neighbours:
    """The messages on CAN that are declared so far, by those bits of their identifiers that never vary: with whom a new
    one may share an identifier is found without trying them all."""

    def __init__(self) -> None:
        self._count = 0
        #: By the bits that never vary in a message, and those of them that never vary in another one.
        self._tables: dict[int, dict[int, dict[int, list[tuple[int, Message]]]]] = {}

    def add(self, message: Message) -> None:
        """Know one more message."""
        mask, constant = message.identifier.fixed & _BITS, message.identifier.constant
        numbered = (self._count, message)
        self._count += 1
        for shared, table in self._tables.setdefault(mask, {mask: {}}).items():
            table.setdefault(constant & shared, []).append(numbered)

    def of(self, pattern: IdPattern) -> list[Message]:
        """Return the messages that a glance does not show to be apart from `pattern`, as declared."""
        found: list[tuple[int, Message]] = []
        for mask, tables in self._tables.items():
            shared = mask & pattern.fixed
            if shared not in tables:
                table: dict[int, list[tuple[int, Message]]] = {}
                for numbered in (message for some in tables[mask].values() for message in some):
                    table.setdefault(numbered[1].identifier.constant & shared, []).append(numbered)
                tables[shared] = table
            found += tables[shared].get(pattern.constant & shared, ())
        return [message for _, message in sorted(found, key=lambda pair: pair[0])]


_BITS = 0x1FFF_FFFF


class StreamNeighbours:
    """The messages on a stream that are declared so far, by framing, dialects and the number in the header that selects
    them: with whom a new one may share a packet is found without trying them all."""

    def __init__(self) -> None:
        self._count = 0
        #: By framing and dialects, then by number; None: of any number.
        self._groups: dict[_Group, dict[int | None, list[tuple[int, Message]]]] = {}

    def add(self, message: Message) -> None:
        """Know one more message."""
        group = self._groups.setdefault((message.framing, message.dialects), {})
        for number in _selected(message) or (None,):
            group.setdefault(number, []).append((self._count, message))
        self._count += 1

    def of(self, message: Message) -> list[Message]:
        """Return the messages that a glance does not show to be apart from `message`, as declared."""
        found: dict[int, Message] = {}
        numbers = _selected(message)
        for (framing, dialects), group in self._groups.items():
            if dialects is not None and message.dialects is not None and not dialects & message.dialects:
                continue
            is_same = framing is message.framing and numbers is not None
            for some in (group.get(n, ()) for n in (*(numbers or ()), None)) if is_same else group.values():
                found.update(some)
        return [found[place] for place in sorted(found)]


_Group = tuple[Framing | None, frozenset[str] | None]


def _selected(message: Message) -> tuple[int, ...] | None:
    """Return the few numbers that select a message of its framing; None where they are many, or it has none."""
    pattern = message.selecting
    return tuple(pattern) if pattern is not None and len(pattern) <= 16 else None


def check_against(made: Message, declared: Iterable[Message]) -> None:
    """Raise `SpecError` when a new message cannot be told from one declared before."""
    for other in declared:
        if made.framing is None and made.transport != other.transport:
            _check_apart(made, other)
            continue
        found = unresolved(made, other)
        if found is not None:
            raise SpecError(
                f"{made.place}: message {made.name!r} is ambiguous with {other.name!r} ({other.place}): {found.how};"
                " say what tells them apart (direction, dialect, when, reply_to, after)"
                f" or order them with overrides={other.name!r}"
            )


def check_carrier(carried: Message, other: Message, place: SourceLine) -> None:
    """Raise `SpecError` where the frames by which a transport carries a message are another message."""
    if not share_dialect(carried, other):
        return
    for transport in carried.ways:
        if transport is None or transport in other.ways:
            continue
        for pattern, extended in transport.patterns:
            number = meet(pattern, other.identifier, 29 if extended else 11)
            if number is not None and extended == other.extended:
                raise SpecError(
                    f"{place}: identifier {number:#x} of {other.name!r} ({other.place}) is of the frames by which"
                    f" {transport.title} carries {carried.name!r} ({carried.place})"
                )


def _check_apart(made: Message, other: Message) -> None:
    """Raise `SpecError` where one transport would take the frames of another, or of a message that is a frame."""
    if not share_dialect(made, other) or made.extended != other.extended:
        return
    if (number := meet(made.identifier, other.identifier, 29 if made.extended else 11)) is not None:
        named = [
            f"{message.transport.title}" if message.transport is not None else "a frame"
            for message in (made, other)
        ]
        raise SpecError(
            f"{made.place}: identifier {number:#x} of {made.name!r} is {named[0]}, and of {other.name!r} ({other.place})"
            f" {named[1]}: what frames of an identifier are, one of them decides"
        )


def unresolved(one: Message, other: Message) -> Conflict | None:
    """Return the conflict of two messages when neither the bytes nor anything else in the spec settles it."""
    is_apart = None not in (one.direction, other.direction) and one.direction != other.direction
    if is_apart or not may_coexist(one, other) or ordered_by_spec(one, other) or contexts_exclude(one, other):
        return None
    return conflict(one, other)


def ordered_by_spec(one: Message, other: Message) -> bool:
    return other.name in one.overrides or one.name in other.overrides


def contexts_exclude(one: Message, other: Message) -> bool:
    """Return whether no outstanding request, or no sticky mode, allows both."""
    return _exclude(one.reply_to, other.reply_to) or _exclude(one.after, other.after)


def _exclude(mine: Sequence[Request], theirs: Sequence[Request]) -> bool:
    return bool(mine) and bool(theirs) and all(a.excludes(b) for a in mine for b in theirs)


@lru_cache(maxsize=65536)
def conflict(one: Message, other: Message) -> Conflict | None:
    """Return the conflict of two messages by their bytes alone, or None when they are disjoint."""
    if one.framing is None or other.framing is None:
        return _can_conflict(one, other)
    if are_apart(one, other):
        return None
    if one.framing.covers_request or other.framing.covers_request:
        return Conflict(one, other, None)
    found = _search(one, other)
    return Conflict(one, other, found if found is not None else _search(other, one))


@lru_cache(maxsize=65536)
def are_apart(one: Message, other: Message) -> bool:
    """Return whether their bytes alone tell two messages apart. Looks for no packet of both, as `conflict` does."""
    if one.framing is None or other.framing is None:
        return conflict(one, other) is None
    if one.framing.covers_request or other.framing.covers_request:
        return False  # bytes alone do not even say whether a check holds
    if one.framing is not other.framing:
        return _are_framings_apart(one, other)
    return _are_packets_apart(one, other)


def opposite_conflicts(messages: Iterable[Message]) -> Iterator[tuple[Message, Message]]:
    """Yield the pairs of messages of opposite direction that bytes alone cannot tell apart."""
    listed = [message for message in messages if message.direction is not None]
    for index, message in enumerate(listed):
        for other in listed[:index]:
            if message.direction != other.direction and not are_apart(message, other):
                yield message, other


def needing_context(messages: Sequence[Message]) -> frozenset[str]:
    """Return the names of messages that only their request identifies: the bytes leave a choice, or the
    record holds fields of the request.
    """
    return frozenset(
        message.name
        for message in messages
        if (message.reply_to or message.after)
        and (
            message.request_fields
            or any(not are_apart(message, other) for other in messages if other is not message)
        )
    )


def unmarked_answers(messages: Iterable[Message], contextual: Collection[str]) -> list[Message]:
    """Return the messages that only a pending request tells from other bytes: all messages of their framing need their
    request, and no byte marks where its packets begin, or its check covers the request.
    """
    framed = [message for message in messages if message.framing is not None]
    others = {message.framing for message in framed if message.name not in contextual}
    return [
        message
        for message in framed
        if (framing := message.framing) is not None
        and framing not in others
        and (framing.covers_request or not (framing.sync or framing.match))
    ]


def framings_in_order(messages: Iterable[Message], unmarked: Collection[Message]) -> list[Framing]:
    """Return the framings of messages in order of trial: those of answers that only a pending request tells go first, but
    for those of messages that override such an answer.
    """
    framed = [message for message in messages if message.framing is not None]
    names = {message.name for message in unmarked}
    first = {message.framing for message in framed if message in unmarked or names & {*message.overrides}}
    found = dict.fromkeys(message.framing for message in framed if message.framing is not None)
    return sorted(found, key=lambda framing: framing not in first)


def request_names(
    messages: Sequence[Message], contextual: Collection[str]
) -> tuple[frozenset[str], frozenset[str]]:
    """Return the names of the messages that `contextual` ones need, and of those that need no request but use
    one up: otherwise it would stay open for a later reply.
    """
    asked = frozenset(
        request.message.name
        for message in messages
        if message.name in contextual
        for request in (*message.reply_to, *message.after)
    )
    answers = frozenset(
        message.name
        for message in messages
        if message.name not in contextual and any(r.message.name in asked for r in message.reply_to)
    )
    return asked, answers


# ---------------------------------------------------------------------- CAN


class _Choice(NamedTuple):
    """The number in `bits` (lowest first) is one of `values`, or with `excluded` none of them."""

    bits: tuple[int, ...]
    values: Collection[int]
    excluded: bool = False


class Demands(NamedTuple):
    """What a template demands of bytes: bits that are fixed, by their canonical number, and choices."""

    fixed: dict[int, int]
    choices: list[_Choice]


def demands(message: Message, length: int | None) -> Demands | None:
    """Return what a message demands of its bytes: bits that are fixed, and choices. None when it never has `length`
    bytes.
    """
    plan = message.plan
    fixed: dict[int, int] = {}
    for constant in plan.constants:
        if length is not None and constant.offset >= length:
            return None
        for bit in range(8):
            if constant.mask >> bit & 1:
                fixed[8 * constant.offset + bit] = constant.value >> bit & 1
    choices = [
        _Choice(
            choice.number.bits,
            choice.values if isinstance(choice.values, range) else frozenset(choice.values),
        )
        for choice in plan.one_of
    ]
    if plan.lengths_by is not None and length is not None:
        selector, table, other = plan.lengths_by
        bits = selector.number.bits
        known = {value & ((1 << len(bits)) - 1): size for value, size in table}
        excluded = other == length
        values = frozenset(v for v, size in known.items() if (size == length) is not excluded)
        choices.append(_Choice(bits, values, excluded=excluded))
    return Demands(fixed, choices)


def _merge(one: Message, other: Message, length: int | None) -> dict[int, int] | None:
    """Return bytes that satisfy both messages' templates (by offset), or None when there are none: exact.

    `length` is that of a frame's data; None leaves it open.
    """
    mine, theirs = demands(one, length), demands(other, length)
    if mine is None or theirs is None or any(theirs[0].get(b, v) != v for b, v in mine[0].items()):
        return None
    choices = sorted([*mine[1], *theirs[1]], key=lambda c: (c.excluded, len(c.values)))
    bits = solved({**mine[0], **theirs[0]}, choices)
    if bits is None:
        return None
    found: dict[int, int] = {}
    for bit, value in bits.items():
        found[bit // 8] = found.get(bit // 8, 0) | value << bit % 8
    return found


def solved(fixed: dict[int, int], choices: Sequence[_Choice]) -> dict[int, int] | None:
    """Return bits that satisfy every choice, with those in `fixed` given; None when there are none."""
    if not choices:
        return fixed
    first, rest = choices[0], choices[1:]
    for number in _numbers(first, fixed):
        found = solved({**fixed, **{bit: number >> i & 1 for i, bit in enumerate(first.bits)}}, rest)
        if found is not None:
            return found
    return None


def _numbers(choice: _Choice, fixed: Mapping[int, int]) -> Iterator[int]:
    """Yield the numbers that a choice allows and that agree with the bits already fixed."""
    known = {i: fixed[bit] for i, bit in enumerate(choice.bits) if bit in fixed}
    if len(known) == len(choice.bits):
        number = sum(value << i for i, value in known.items())
        if (number in choice.values) is not choice.excluded:
            yield number
        return
    if not choice.excluded:
        yield from (
            n for n in sorted(choice.values) if all(n >> i & 1 == value for i, value in known.items())
        )
        return
    base = sum(value << i for i, value in known.items())
    free = [i for i in range(len(choice.bits)) if i not in known]
    for count in range(1 << len(free)):
        number = base | sum((count >> k & 1) << i for k, i in enumerate(free))
        if number not in choice.values:
            yield number


def _can_conflict(one: Message, other: Message) -> Conflict | None:
    if (
        one.transport != other.transport
        or (one.extended, one.remote) != (other.extended, other.remote)
        or set(one.formats).isdisjoint(other.formats)
        or one.identifier.is_apart(other.identifier)
        or _are_constants_apart(one.plan.constants, other.plan.constants)
    ):
        return None
    lengths: Sequence[int]
    mine, others = one.lengths or (), other.lengths or ()
    if isinstance(mine, range) and isinstance(others, range) and mine.step == others.step == 1:
        lengths = range(min(mine[-1], others[-1]), max(mine[0], others[0]) - 1, -1)
    else:
        lengths = sorted(set(mine) & set(others), reverse=True)
    if one.transport is not None and one.plan.lengths_by is None and other.plan.lengths_by is None:
        # Behind the last constant one length is like another.
        reach = max((c.offset for m in (one, other) for c in m.plan.constants), default=0) + 1
        lengths = [*lengths[:1], *(length for length in lengths[1:][-reach - 1 :] if length <= reach)]
    identifier = meet(one.identifier, other.identifier, 29 if one.extended else 11) if lengths else None
    if identifier is None:
        return None
    is_found = False
    for size in lengths:
        fixed = _merge(one, other, size)
        if fixed is None:
            continue
        is_found = True
        witness = _confirmed(one, other, identifier, fixed, size)
        if witness is not None:
            return Conflict(one, other, witness, identifier)
    return Conflict(one, other, None) if is_found else None


def _are_constants_apart(mine: Sequence[Constant], others: Sequence[Constant]) -> bool:
    """Return whether constants differ where both messages have one: no packet of any length has both."""
    theirs = {constant.offset: constant for constant in others}
    return any(
        (other := theirs.get(constant.offset)) is not None
        and (constant.value ^ other.value) & constant.mask & other.mask
        for constant in mine
    )


def _confirmed(
    one: Message, other: Message, identifier: int, fixed: Mapping[int, int], size: int
) -> bytes | None:
    """Return a frame's data of this size that both messages accept, checks aside; None when none was found."""
    opaque = [message for message in (one, other) if not message.plan.is_flat or message.plan.lists]
    rng = random.Random(0)
    for fill in ("zero", "one", *("any",) * 10) if opaque else ("zero",):
        data = bytes(
            fixed.get(i, 0 if fill == "zero" else 1 if fill == "one" else rng.randrange(256))
            for i in range(size)
        )
        image = can_image(identifier, data, extended=one.extended, remote=one.remote, fd=one.fd)
        if all(_accepts(message, image) for message in opaque):
            return data
    return None


# ---------------------------------------------------------------------- streams


def _are_framings_apart(one: Message, other: Message) -> bool:
    """Return whether two messages of different framings have no packet in common."""
    a, b = one.framing, other.framing
    assert isinstance(a, Framing)
    assert isinstance(b, Framing)
    # Stuffing of whole packets moves their bytes: then only the bytes on the wire can be compared.
    moved = any(f.stuffing is not None and not f.stuffing.is_inside for f in (a, b))
    if not moved and _merge(one, other, None) is None:
        return True
    shared = min(len(a.sync), len(b.sync))
    if a.sync[:shared] != b.sync[:shared]:
        return True
    return any(
        bool(first.not_next)
        and len(second.sync) > len(first.sync)
        and second.sync[len(first.sync)] in first.not_next
        for first, second in ((a, b), (b, a))
    )


def _are_packets_apart(one: Message, other: Message) -> bool:
    """Return whether two messages of a framing have no packet in common, checks aside."""
    if _merge(one, other, None) is None:
        return True
    lengths, others = one.plan.lengths, other.plan.lengths
    if lengths is not None and others is not None and not set(lengths) & set(others):
        return True
    return any(
        mine is not None and max(mine) < theirs
        for mine, theirs in ((lengths, other.plan.least), (others, one.plan.least))
    )


def _search(one: Message, other: Message) -> bytes | None:
    """Return a packet that both constructs accept, or of which `other` accepts a beginning."""
    framing = one.framing
    assert framing is not None
    fixed = _merge(one, other, None) or {}
    rng = random.Random(0)
    for size in [*range(24), 32, 48, 64]:
        for attempt in range(12):
            head = bytes(
                fixed.get(framing.head_end - sum(h.size for h in framing.heads) + i, 0)
                for i in range(sum(h.size for h in framing.heads))
            )
            body = bytes(
                fixed.get(
                    framing.head_end + i, 0 if attempt == 0 else 0x2C if attempt == 1 else rng.randrange(256)
                )
                for i in range(size)
            )
            try:
                packet = one.struct.framed(framing, head, body)
            except AcesError:
                continue
            if _accepts(one, packet) and any(_accepts(other, packet[:n]) for n in (len(packet),)):
                return packet
    return None


def _accepts(message: Message, packet: bytes) -> bool:
    """Return whether the message's construct accepts the packet, whatever its request."""
    try:
        message.struct.parse(packet, raw=True)
    except WrongCheckError:
        return message.framing is None  # on CAN checks count as true
    except (ConstructError, AcesError):
        return False
    return True


def ordered(messages: Iterable[Message]) -> list[Message]:
    """Return the messages in the order of trial."""
    left = list(messages)
    if not any(message.overrides for message in left):
        return left
    names = {m.name for m in left}
    done: list[Message] = []
    placed: set[str] = set()
    while left:
        # The first one that nothing left has to go before.
        for message in left:
            if not any(message.name in other.overrides for other in left if other is not message):
                break
        else:
            message = left[0]
        left.remove(message)
        done.append(message)
        placed.add(message.name)
    assert placed == names
    return done
