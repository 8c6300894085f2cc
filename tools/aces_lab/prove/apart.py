"""No two messages of one variant accept the same bytes in one context, and each has bytes that reach it.

1. What a message accepts is a formula: the paths on which its declaration reads the bytes, for each length.
2. Two messages are in one context unless direction, order (`overrides`) or requests (`reply_to`, `after`) keep them apart.
3. A message is unreachable when every packet that it accepts goes to a message that is tried before it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import z3

from aces_bus.protocol import Message, Variant
from aces_bus.protocol.declare.ambiguity import contexts_exclude, ordered, ordered_by_spec
from aces_bus.protocol.live.can import CanDecider

from .account import Outcome
from .decoding import SymbolicPacket, Witness, base_of, drawn, proof_lengths
from .symbols import NoAnswer, NotProvable, PathSearch, SymbolicInt
from .witness import by_reference, image_of

#: Identifiers of a message that are all looked up.
MOST_KEYS = 4096


class Accepted:
    """What one message accepts, by length: a formula on the bytes, and the packet with its key."""

    def __init__(self, message: Message, number: int, seconds: float) -> None:
        self.message = message
        self.packets: dict[int, tuple[SymbolicPacket, z3.BoolRef]] = {}
        search = PathSearch(seconds)
        for size in proof_lengths(message)[0]:
            packet = SymbolicPacket(message, size, prefix=f"m{number}_")
            found: list[z3.BoolRef] = []
            search.run(partial(self._read, packet, search, found), packet.given)
            if found:
                self.packets[size] = packet, z3.Or(*found)

    @staticmethod
    def _read(packet: SymbolicPacket, search: PathSearch, found: list[z3.BoolRef]) -> None:
        if packet.meaning(raw=True) is not None:
            found.append(z3.And(*search.solver.assertions()))


class _Formulas:
    """What messages accept, made where constants do not tell them apart."""

    def __init__(self, messages: Sequence[Message], seconds: float) -> None:
        self._numbers = {message.name: number for number, message in enumerate(messages)}
        self._made: dict[str, Accepted | str] = {}
        self.seconds = seconds

    def of(self, message: Message) -> Accepted | str:
        """Return the formulas of a message, or the reason why it has none."""
        if message.name not in self._made:
            try:
                self._made[message.name] = Accepted(message, self._numbers[message.name], self.seconds)
            except (NoAnswer, NotProvable) as reason:
                self._made[message.name] = str(reason)
        return self._made[message.name]


@dataclass(frozen=True)
class ApartJob:
    """All messages of one variant."""

    variant: Variant
    patience: float = 20.0

    def prove(self, seconds: float) -> list[Outcome]:
        """Prove them apart and reachable."""
        return list(prove_apart(self.variant, seconds))

    def lost(self, reason: str) -> list[Outcome]:
        """Return that nothing was proved."""
        found = [Outcome(self.variant.label, name) for name in self.variant.messages]
        for outcome in found:
            outcome.add("apart", "unknown", reason)
        return found


def prove_apart(variant: Variant, seconds: float = 60.0) -> Iterator[Outcome]:
    """Yield an outcome for each message of a variant: apart from all others, and reachable."""
    messages = ordered(variant.messages.values())
    formulas = _Formulas(messages, seconds)
    for index, message in enumerate(messages):
        outcome = Outcome(variant.label, message.name)
        near = [m for m in messages[:index] if _may_meet(message, m) and not constants_differ(message, m)]
        _apart(outcome, message, near, formulas)
        if outcome.status != "refuted":
            _reached(outcome, variant, message, near, formulas)
        yield outcome


def constants_differ(one: Message, other: Message) -> bool:
    """Return whether heads or constants at one place tell two messages apart."""
    mine, theirs = _fixed(one), _fixed(other)
    return any(place in theirs and values.isdisjoint(theirs[place]) for place, values in mine.items())


def _fixed(message: Message) -> dict[tuple[int, int], frozenset[int]]:
    """Return the numbers that a message may have at places of its bytes: (offset, size), big-endian."""
    found: dict[tuple[int, int], frozenset[int]] = {}
    for head in message.heads_written:
        if head.pattern is not None and len(head.pattern) <= MOST_KEYS:
            numbers = (int.from_bytes(head.bytes(number), "big") for number in head.pattern)
            found[head.offset, head.size] = frozenset(numbers)
    for offset, wanted in message.constants:
        found |= {(offset + i, 1): frozenset({byte}) for i, byte in enumerate(wanted)}
    return found


def _apart(outcome: Outcome, message: Message, near: Sequence[Message], formulas: _Formulas) -> None:
    solver = _solver(formulas)
    undecided: list[str] = []
    for other in near:
        if ordered_by_spec(message, other):
            continue
        mine, theirs = formulas.of(message), formulas.of(other)
        if isinstance(mine, str) or isinstance(theirs, str):
            undecided.append(f"{other.name}: {mine if isinstance(mine, str) else theirs}")
            continue
        for packet, both in _shared(mine, theirs):
            found = solver.check(both)
            if found == z3.sat:
                witness = packet.witness(f"{other.name} accepts it, too", solver.model())
                image = image_of(message, witness)
                if by_reference(message, image) is None or by_reference(other, image) is None:
                    undecided.append(f"{other.name}: {witness.data.hex()}, which running it does not confirm")
                    continue
                outcome.witness = witness
                outcome.add("apart", "refuted", f"{other.name} accepts the same bytes")
                return
            if found == z3.unknown:
                undecided.append(f"{other.name}: the solver gave no answer")
    outcome.add("apart", "unknown" if undecided else "proved", "; ".join(undecided[:3]))


def _solver(formulas: _Formulas) -> z3.Solver:
    solver = z3.Solver()
    solver.set("timeout", int(formulas.seconds * 1000))
    return solver


def _may_meet(one: Message, other: Message) -> bool:
    """Return whether two messages are in one context, on one link, with one kind of frame."""
    if None not in (one.direction, other.direction) and one.direction != other.direction:
        return False
    if contexts_exclude(one, other) or one.framing is not other.framing or one.transport != other.transport:
        return False
    is_apart = one.identifier.is_apart(other.identifier) or set(one.formats).isdisjoint(other.formats)
    return one.framing is not None or not (
        is_apart or (one.extended, one.remote) != (other.extended, other.remote)
    )


def _shared(one: Accepted, other: Accepted) -> Iterator[tuple[SymbolicPacket, z3.BoolRef]]:
    """Yield the formulas of bytes that both accept, by length."""
    for size, (packet, mine) in one.packets.items():
        if size in other.packets:
            theirs, accepts = other.packets[size]
            yield packet, z3.And(mine, accepts, _same_key(packet, theirs))


def _same_key(one: SymbolicPacket, other: SymbolicPacket) -> z3.BoolRef:
    keys = [packet.key & 0x1FFF_FFFF for packet in (one, other)]
    numbers = [SymbolicInt.of(key) for key in keys]
    assert numbers[0] is not None
    return (numbers[0] == numbers[1]).term


def _reached(
    outcome: Outcome, variant: Variant, message: Message, near: Sequence[Message], formulas: _Formulas
) -> None:
    """Enter whether some bytes reach a message, and whether its identifiers lead to it."""
    if variant.link == "can" and len(message.identifier) <= MOST_KEYS:
        decider = CanDecider(variant, None, raw=True)
        for number in message.identifier:
            key = number | base_of(message)
            if message.name not in {m.name for m in decider.candidates(key, message.transport)}:
                outcome.witness = Witness("its identifier does not lead to it", key, b"")
                outcome.add("reached", "refuted", f"identifier {number:#x} does not lead to it")
                return
    first = [other for other in near if not (other.reply_to or other.after)]
    for found in drawn(message, proof_lengths(message)[0], 2000):
        image = image_of(message, found)
        if by_reference(message, image) is not None and all(by_reference(m, image) is None for m in first):
            outcome.add("reached", "proved")  # one packet is enough
            return
    mine = formulas.of(message)
    if isinstance(mine, str) or first:
        outcome.add(
            "reached", "unknown", mine if isinstance(mine, str) else "no packet was drawn that reaches it"
        )
    elif mine.packets:
        outcome.add("reached", "proved")
    else:
        outcome.add("reached", "refuted", "no bytes are this message")
