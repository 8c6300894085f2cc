"""Law 9's checker: it finds what is planted, proves what is apart, and on CAN is exact."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from typing import Any

import pytest
from construct import Array, Byte, Bytes, Const, GreedyBytes, Int16ub, Int16ul, Int32ul, Struct, this

from aces_bus.errors import SpecError
from aces_bus.protocol import Cobs, Crc, IdField, InvertedSum, Message, Multiplexed, Protocol
from aces_bus.protocol.declare.ambiguity import conflict
from aces_bus.protocol.declare.packet import can_image
from aces_bus.testing import laws
from tests.laws.wires import PROTOCOLS

Declare = Callable[[Protocol], None]


# ---------------------------------------------------------------------- every pair of every wire


@pytest.mark.parametrize("name", PROTOCOLS)
def test_no_pair_is_ambiguous(name: str) -> None:
    """Exhaustive: every pair of messages of every wire is told apart by its bytes or by what the spec says."""
    for variant, direction in laws.wires(PROTOCOLS[name]):
        found = laws.conflicts(variant, direction)
        assert [f"{variant} {direction}: {c.one.name} and {c.other.name}: {c.how}" for c in found] == []


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_witness_is_one(name: str) -> None:
    """What the checker shows for messages that share packets (and are told apart by other means) is accepted by both."""
    pairs: dict[tuple[Message, Message], None] = {}
    for variant, direction in laws.wires(PROTOCOLS[name]):
        pairs |= dict.fromkeys(itertools.combinations(variant.messages_for(direction), 2))
    for one, other in pairs:
        found = conflict(one, other)
        if found is None or found.witness is None:
            continue
        image = found.witness
        if found.identifier is not None:
            image = can_image(found.identifier, image, extended=one.extended, remote=one.remote, fd=one.fd)
        for message in (one, other):
            if message.check is None:  # a check counts as true
                part = laws.part_accepted(message, image)
                assert part is not None, f"{message.name} does not accept the witness {found.how}"


# ---------------------------------------------------------------------- planted: CAN


def overlapping_identifiers(p: Protocol) -> None:
    p.message("One", id=0x100 + IdField("node", range(0x30)), payload=Struct("a" / Int16ul))
    p.message("Two", id=0x12F, payload=Struct("b" / Int16ul))


def overlapping_bit_layouts(p: Protocol) -> None:
    p.message("One", id=IdField("node", range(64)) << 5 | 0x09, payload=Struct("a" / Byte))
    p.message("Two", id=IdField("low", range(32)) | 0x20, payload=Struct("b" / Byte))


def open_lengths(p: Protocol) -> None:
    p.message("One", id=5, payload=Struct("a" / Byte, "more" / GreedyBytes))
    p.message("Two", id=5, payload=Struct("b" / Bytes(8)))


def a_constant_against_anything(p: Protocol) -> None:
    p.message("One", id=5, payload=Struct(Const(7, Byte), "a" / Byte))
    p.message("Two", id=5, payload=Struct("b" / Int16ub))


def sets_that_meet(p: Protocol) -> None:
    head = Struct("op" / Byte)
    p.message("One", id=5, prefix=head, match={"op": (1, 2, 3)}, payload=Struct("a" / Byte))
    p.message("Two", id=5, prefix=head, match={"op": (3, 4)}, payload=Struct("b" / Byte))


def a_rare_selector(p: Protocol) -> None:
    p.message("One", id=5, payload=Struct("which" / Int16ul, "a" / Multiplexed("which", 1000, Int16ul)))
    p.message("Two", id=5, payload=Struct("b" / Int32ul))


def a_selector_of_other_values(p: Protocol) -> None:
    p.message(
        "One", id=5, payload=Struct("which" / Byte, "a" / Multiplexed("which", tuple(range(1, 256)), Byte))
    )
    p.message("Two", id=5, payload=Struct("b" / Byte))


def replies_to_the_same_request(p: Protocol) -> None:
    ask = p.message("Ask", id=4, payload=Struct("which" / Byte))
    p.message("One", id=5, reply_to=ask.where(which={1, 2}), payload=Struct("a" / Byte))
    p.message("Two", id=5, reply_to=ask.where(which={2, 3}), payload=Struct("b" / Byte))


def dialects_that_share_one(p: Protocol) -> None:
    p.message("One", id=5, dialect=("old", "new"), payload=Struct("a" / Byte))
    p.message("Two", id=5, dialect="new", payload=Struct("b" / Byte))


# ---------------------------------------------------------------------- planted: streams


def _framed(p: Protocol, **more: Any) -> Any:
    return p.framing(
        sync=b"\xa5",
        header=Struct("op" / Byte, "size" / Byte),
        size=this.size + 4,
        max_size=64,
        check=InvertedSum(),
        **more,
    )


def payloads_that_look_alike(p: Protocol) -> None:
    packet = _framed(p)
    packet("One", payload=Struct("a" / Int16ul))
    packet("Two", payload=Struct("b" / Array(2, Byte)))


def a_tail_that_takes_anything(p: Protocol) -> None:
    packet = _framed(p)
    packet("One", match={"op": 1}, payload=Struct("a" / Int16ul))
    packet("Two", payload=Struct("rest" / GreedyBytes))


def framings_that_begin_alike(p: Protocol) -> None:
    p.framing(name="short", sync=b"\xa5", size=4)("One", payload=Struct("a" / Bytes(3)))
    p.framing(name="long", sync=b"\xa5", size=8)("Two", payload=Struct("b" / Bytes(7)))


def stuffing_that_moves_bytes(p: Protocol) -> None:
    """The kind of One is its second byte on the wire, where Two may have anything."""
    head = Struct("kind" / Byte)
    cobs = p.framing(
        name="cobs", header=head, end=b"\0", stuffing=Cobs(), max_size=32, check=Crc("CRC8-AUTOSAR")
    )
    cobs("One", match={"kind": 1}, payload=Struct("a" / Byte))
    p.framing(name="plain", header=head, size=6)("Two", match={"kind": 5}, payload=Struct("b" / Bytes(5)))


@pytest.mark.parametrize(
    ("link", "declare"),
    [
        ("can", overlapping_identifiers),
        ("can", overlapping_bit_layouts),
        ("can", open_lengths),
        ("can", a_constant_against_anything),
        ("can", sets_that_meet),
        ("can", a_rare_selector),
        ("can", a_selector_of_other_values),
        ("can", replies_to_the_same_request),
        ("can", dialects_that_share_one),
        ("serial", payloads_that_look_alike),
        ("serial", a_tail_that_takes_anything),
        ("serial", framings_that_begin_alike),
        ("serial", stuffing_that_moves_bytes),
    ],
    ids=lambda value: getattr(value, "__name__", value),
)
def test_a_planted_ambiguity_is_refused(link: Any, declare: Declare) -> None:
    """The second message fails at its declaration, naming both."""
    made = Protocol("planted", link=link, dialects={"old": "", "new": ""})
    with pytest.raises(SpecError, match=r"message 'Two' is ambiguous with 'One'"):
        declare(made)


# ---------------------------------------------------------------------- what is apart


def same_identifier_other_length(p: Protocol) -> None:
    p.message("One", id=5, payload=Struct("a" / Byte))
    p.message("Two", id=5, payload=Struct("b" / Int16ul))


def other_constants(p: Protocol) -> None:
    p.message("One", id=5, payload=Struct("a" / Byte, Const(1, Byte)))
    p.message("Two", id=5, payload=Struct("b" / Byte, Const(2, Byte)))


def other_flags(p: Protocol) -> None:
    p.message("One", id=5, payload=Struct("a" / Byte))
    p.message("Two", id=5, extended=True, payload=Struct("b" / Byte))
    p.message("Three", id=5, remote=True)
    p.message("Four", id=5, fd=True, payload=Struct("d" / Byte))


def sets_that_do_not_meet(p: Protocol) -> None:
    head = Struct("op" / Byte)
    p.message(
        "One", id=5, prefix=head, match={"op": IdField("n", range(16)) + 0x30}, payload=Struct("a" / Byte)
    )
    p.message(
        "Two", id=5, prefix=head, match={"op": IdField("n", range(16)) + 0x40}, payload=Struct("b" / Byte)
    )


def a_selector_whose_lengths_differ(p: Protocol) -> None:
    p.message("One", id=5, payload=Struct("which" / Byte, "a" / Multiplexed("which", (1, 2), Byte)))
    p.message("Two", id=5, payload=Struct(Const(3, Byte), "b" / Byte))


def a_wide_head_of_many_values(p: Protocol) -> None:
    head = Struct("op" / Int16ul)
    p.message(
        "One", id=5, prefix=head, match={"op": IdField("n", range(0, 60000, 10))}, payload=Struct("a" / Byte)
    )
    p.message(
        "Two", id=5, prefix=head, match={"op": IdField("n", range(5, 60000, 10))}, payload=Struct("b" / Byte)
    )


def opposite_directions(p: Protocol) -> None:
    p.message("One", id=5, direction="to device", payload=Struct("a" / Byte))
    p.message("Two", id=5, direction="from device", payload=Struct("b" / Byte))


def one_before_the_other(p: Protocol) -> None:
    p.message("One", id=5, payload=Struct(Const(7, Byte)))
    p.message("Two", id=5, payload=Struct("b" / Byte))


def other_syncs(p: Protocol) -> None:
    p.framing(name="one", sync=b"\xa5\x01", size=4)("One", payload=Struct("a" / Int16ul))
    p.framing(name="two", sync=b"\xa5\x02", size=8)("Two", payload=Struct("b" / Bytes(6)))


def other_lengths_of_a_line(p: Protocol) -> None:
    line = p.framing(end=b"\n", max_size=16)
    line("One", payload=Struct("a" / Bytes(2)))
    line("Two", payload=Struct("b" / Bytes(3)))


@pytest.mark.parametrize(
    ("link", "declare"),
    [
        ("can", same_identifier_other_length),
        ("can", other_constants),
        ("can", other_flags),
        ("can", sets_that_do_not_meet),
        ("can", a_selector_whose_lengths_differ),
        ("can", a_wide_head_of_many_values),
        ("can", opposite_directions),
        ("serial", other_syncs),
        ("serial", other_lengths_of_a_line),
    ],
    ids=lambda value: getattr(value, "__name__", value),
)
def test_what_is_apart_is_let_pass(link: Any, declare: Declare) -> None:
    """No false alarm: the spec needs nothing more."""
    made = Protocol("planted", link=link)
    declare(made)
    assert laws.conflicts(made.variant(), None) == ()


def test_order_settles_an_ambiguity() -> None:
    """What is ambiguous passes when the spec says which one goes first."""
    made = Protocol("planted", link="can")
    made.message("Any", id=5, payload=Struct("a" / Byte))
    made.message("Seven", id=5, overrides="Any", payload=Struct(Const(7, Byte)))
    scanner = made.scanner()
    frames = [made.encode("Any", a=n) for n in (6, 7)]
    assert [type(record).__name__ for record in scanner.feed(frames)] == ["Any", "Seven"]


# ---------------------------------------------------------------------- exact


def _random_message(made: Protocol, name: str, rng: random.Random) -> Message:
    """A message over identifiers 0…7 and at most two bytes, of which the second matters only up to 2."""
    identifier = rng.choice(
        (
            rng.randrange(8),
            IdField("n", range(rng.randrange(1, 5))) + rng.randrange(4),
            IdField("n", (0, 1)) << 2 | 1,
        )
    )
    values = tuple(sorted(rng.sample(range(6), rng.randrange(1, 4))))
    kind = rng.randrange(5)
    prefix: Struct | None = None
    match: dict[str, Any] = {}
    if kind == 0:
        payload = Struct(Const(rng.randrange(4), Byte), "a" / GreedyBytes)
    elif kind == 1:
        payload = Struct("a" / Byte, Const(rng.randrange(3), Byte))
    elif kind == 2:
        payload = Struct("w" / Byte, "a" / Multiplexed("w", values, Byte))
    elif kind == 3:
        prefix, match = Struct("op" / Byte), {"op": values}
        payload = Struct("a" / Bytes(rng.randrange(2)))
    else:
        prefix, match = Struct("op" / Byte), {"op": IdField("k", range(3)) << 1 | rng.randrange(2)}
        payload = Struct("a" / GreedyBytes)
    length: int | tuple[int, ...] | None = None
    if kind in (0, 4) and rng.randrange(2):
        length = rng.randrange(1, 3)
    if kind in (0, 4) and length is None:
        length = (1, 2)
    return made.message(name, id=identifier, prefix=prefix, match=match, length=length, payload=payload)


@pytest.mark.parametrize("seed", range(40))
def test_frames_are_decided_exactly(seed: int) -> None:
    """The checker's verdict on two random messages is that of trying every frame."""
    rng = random.Random(seed)
    one = _random_message(Protocol("one", link="can"), "One", rng)
    other = _random_message(Protocol("other", link="can"), "Other", rng)
    datas = [b"", *(bytes([a]) for a in range(256)), *(bytes([a, b]) for a in range(256) for b in range(3))]
    shared = any(
        laws.part_accepted(one, image) is not None and laws.part_accepted(other, image) is not None
        for identifier in range(8)
        if one.identifier.match(identifier) is not None and other.identifier.match(identifier) is not None
        for data in datas
        for image in [can_image(identifier, data)]
    )
    found = conflict(one, other)
    assert (found is not None) == shared
    if found is not None:
        assert found.witness is not None
        assert found.identifier is not None
        image = can_image(found.identifier, found.witness)
        assert laws.part_accepted(one, image) == laws.part_accepted(other, image) == image
