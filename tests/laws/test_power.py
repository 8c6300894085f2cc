# Faults are planted in private parts.
# pyright: reportPrivateUsage=false
"""Each law can fail: a fault of the kind that it is about is planted, and found.

A law that passes on a broken scanner proves nothing. Every fault here is one line of somebody's bad day: a check left
out, a byte skipped too many, a buffer thrown away.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from construct import Byte, Const, GreedyBytes, Int16sl, Int16ul, Struct, this
from hypothesis import settings

from aces_bus.protocol import (
    BitLayout,
    Cobs,
    Crc,
    Flags,
    IdField,
    InvertedSum,
    Protocol,
    Quantity,
    SignMagnitude,
    Sum,
    bits,
)
from aces_bus.protocol.counts import ScanCounts
from aces_bus.protocol.declare import ambiguity, checks, fields
from aces_bus.protocol.generate import load
from aces_bus.protocol.live import can, find, stream
from aces_bus.protocol.live.decide import Decider
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.testing import LAWS, laws
from aces_bus.testing.scenes import Way
from aces_bus.testing.trial import Law
from tests.laws.drawn import drawn_arguments

IS_LONG = settings().max_examples > 100
Plant = Callable[[pytest.MonkeyPatch], None]


def a_stream() -> Protocol:
    """Packets with a sum, some of them with a length that its field could exceed."""
    made = Protocol("victim", link="serial")
    packet = made.framing(
        sync=b"\xff\xff",
        not_next=b"\xff",
        header=Struct("id" / Byte, "length" / Byte),
        size=this.length + 4,
        max_size=60,
        check=InvertedSum(),
    )
    packet(
        "Move",
        payload=Struct(
            Const(1, Byte), "speed" / Quantity(Int16sl, scale=0.5), "flags" / Flags(Byte, a=0, b=3)
        ),
    )
    packet("Text", payload=Struct(Const(2, Byte), "data" / GreedyBytes))
    return made


def a_bus() -> Protocol:
    """Frames with unused bits, signs, a check, a request with its answers."""
    made = Protocol("victim", link="can")
    node = IdField("node", range(8))
    made.message(
        "Layout",
        id=0x10 + node,
        payload=BitLayout(2, "a" / bits(5), "b" / Quantity(bits(6, at=8), scale=0.5)),
    )
    made.message("Sign", id=0x20 + node, payload=Struct("value" / SignMagnitude(16)))
    made.message(
        "Checked",
        id=0x30 + node,
        check=Crc("CRC8-AUTOSAR", over=slice(1, None), field="crc"),
        payload=BitLayout(3, "crc" / bits(8), "value" / bits(16)),
    )
    ask = made.message("Ask", id=0x40 + node, direction="to device", payload=Struct("which" / Byte))
    made.message(
        "One",
        id=0x50 + node,
        direction="from device",
        reply_to=ask.where(which=1),
        payload=Struct("x" / Int16ul),
    )
    made.message(
        "Two",
        id=0x50 + node,
        direction="from device",
        reply_to=ask.where(which=2),
        payload=Struct("y" / Int16sl),
    )
    made.message("Exact", id=0x60, payload=Struct(Const(b"\x01"), "rest" / Byte), overrides="General")
    made.message("General", id=0x60, payload=Struct("all" / Int16ul))
    return made


def fails(law: Law, made: Protocol, direction: Way = None, tries: int = 120) -> str:
    """What the law says of the first scene that breaks it; empty when none does."""
    variant = made.variant()
    for number in range(1, tries):
        given = drawn_arguments(law, variant, direction, number, entropy=400)
        try:
            law(variant, direction, *given)
        except AssertionError as error:
            return str(error)
    return ""


@pytest.mark.parametrize("make", [a_stream, a_bus])
@pytest.mark.parametrize("law", LAWS, ids=str)
def test_the_victims_are_healthy(law: Law, make: Callable[[], Protocol]) -> None:
    """Without a fault the laws hold: what follows is due to the faults."""
    assert fails(law, make(), tries=20 if IS_LONG else 4) == ""


# ---------------------------------------------------------------------- the faults


def unused_bits_are_dropped(patch: pytest.MonkeyPatch) -> None:
    good = BitLayout._build
    patch.setattr(BitLayout, "_build", lambda self, obj, *more: good(self, {**obj, "reserved": 0}, *more))


def signs_are_lost_in_building(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(fields.SignMagnitude, "to_raw", lambda self, value, path="": abs(value))


def _printed(patch: pytest.MonkeyPatch, module: Any, name: str, old: str, new: str) -> None:
    """Change the text of a generated function."""
    good = getattr(module, name)

    def bad(*args: Any, **more: Any) -> str:
        text: str = good(*args, **more)
        assert old in text, f"the printed text has changed; mend this test: no {old!r} in\n{text}"
        return text.replace(old, new)

    patch.setattr(module, name, bad)


def a_scale_is_wrong(patch: pytest.MonkeyPatch) -> None:
    good = load.print_decoder
    patch.setattr(load, "print_decoder", lambda *args, **more: good(*args, **more).replace("0.5 *", "0.25 *"))


def _decided(patch: pytest.MonkeyPatch, spoil: Callable[[Any, bytes], Any]) -> None:
    """Spoil what every decision gives."""
    good = Decider.decide

    def decide(self: Decider, messages: Any, **more: Any) -> Any:
        decode = good(self, messages, **more)
        return lambda data, *rest: spoil(decode(data, *rest), data)

    patch.setattr(Decider, "decide", decide)


def a_message_is_overlooked(patch: pytest.MonkeyPatch) -> None:
    _decided(patch, lambda record, data: None if data and data[-1] % 4 == 1 else record)


def held_bytes_are_thrown_away(patch: pytest.MonkeyPatch) -> None:
    good = StreamScanner.advance

    def advance(self: StreamScanner, data: bytes, *args: Any, **more: Any) -> Any:
        self.base += len(self.buffer)
        self.buffer = b""
        return good(self, data, *args, **more)

    patch.setattr(StreamScanner, "advance", advance)


def each_batch_loses_its_last_frame(patch: pytest.MonkeyPatch) -> None:
    good = can.CanScanner._make_feed

    def make(self: can.CanScanner) -> Any:
        feed = good(self)
        return lambda frames: feed(frames[:-1])

    patch.setattr(can.CanScanner, "_make_feed", make)


def a_bad_header_costs_a_packet(patch: pytest.MonkeyPatch) -> None:
    _printed(patch, stream, "print_stream", "i += 1\n", "i += 6\n")


def checks_are_not_looked_at(patch: pytest.MonkeyPatch) -> None:
    _printed(patch, stream, "print_stream", "if not good:\n            ", "if False:\n            ")
    patch.setattr(find.PacketFinder, "_checked", lambda self, data, check, starts, ends: starts >= 0)


def checks_of_frames_are_not_looked_at(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(load, "_holds", lambda message: lambda data, key: True)


def losses_are_counted_short(patch: pytest.MonkeyPatch) -> None:
    good = ScanCounts.lose
    patch.setattr(ScanCounts, "lose", lambda self, size, reason: good(self, size - (size > 3), reason))


def error_frames_are_not_counted(patch: pytest.MonkeyPatch) -> None:
    good = ScanCounts.lose
    patch.setattr(
        ScanCounts,
        "lose",
        lambda self, size, reason: None if reason == "error frame" else good(self, size, reason),
    )


def sums_are_made_anew_for_each_candidate(patch: pytest.MonkeyPatch) -> None:
    def fail(self: checks.Sums, fresh: bytes, start: int) -> None:
        self.work += len(fresh)

    patch.setattr(checks.Sums, "fail", fail)


def any_length_is_waited_for(patch: pytest.MonkeyPatch) -> None:
    _printed(patch, stream, "print_stream", "<= size <= 60", "<= size <= 6000")


def some_bytes_raise(patch: pytest.MonkeyPatch) -> None:
    def spoil(record: Any, data: bytes) -> Any:
        if data[-1:] == b"\x07":
            raise ZeroDivisionError
        return record

    _decided(patch, spoil)


def the_checker_is_blind(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(laws, "are_apart", lambda one, other: True)


@pytest.mark.parametrize(
    ("number", "make", "fault"),
    [
        (1, a_bus, unused_bits_are_dropped),
        (1, a_bus, signs_are_lost_in_building),
        (2, a_stream, a_scale_is_wrong),
        (2, a_bus, a_scale_is_wrong),
        (2, a_stream, a_message_is_overlooked),
        (2, a_bus, a_message_is_overlooked),
        (2, a_stream, checks_are_not_looked_at),
        (2, a_stream, a_bad_header_costs_a_packet),
        (3, a_stream, held_bytes_are_thrown_away),
        (3, a_bus, each_batch_loses_its_last_frame),
        (4, a_stream, a_bad_header_costs_a_packet),
        (4, a_bus, a_message_is_overlooked),
        (5, a_stream, checks_are_not_looked_at),
        (5, a_bus, checks_of_frames_are_not_looked_at),
        (6, a_stream, losses_are_counted_short),
        (6, a_stream, held_bytes_are_thrown_away),
        (6, a_bus, error_frames_are_not_counted),
        (7, a_stream, sums_are_made_anew_for_each_candidate),
        (7, a_stream, any_length_is_waited_for),
        (8, a_stream, some_bytes_raise),
        (8, a_bus, some_bytes_raise),
        (9, a_bus, the_checker_is_blind),
    ],
    ids=lambda value: getattr(value, "__name__", str(value)),
)
def test_a_law_finds_the_fault(
    number: int, make: Callable[[], Protocol], fault: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The law says so, and its message names the law and the protocol."""
    fault(monkeypatch)
    said = fails(LAWS[number - 1], make())
    assert said, "the law holds in spite of the fault"
    assert said.startswith(f"law {number} ({LAWS[number - 1].name}) of victim, direction None: ")


def test_a_law_finds_an_ambiguity_that_slipped_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages that the declaration let pass are found when the law asks."""
    made = Protocol("victim", link="can")
    monkeypatch.setattr(ambiguity, "check_against", lambda made, declared: None)
    made.message("One", id=0x10 + IdField("node", range(8)), payload=Struct("x" / Int16ul))
    made.message("Two", id=0x17, payload=Struct(Const(b"\x05"), "y" / Byte))
    said = fails(LAWS[8], made, tries=2)
    assert "Two and One are ambiguous: both accept 017#05" in said


def test_check_work_is_what_checks_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """`check_work`, which law 7 trusts, is the number of bytes that were in truth summed (in chunks below a stride)."""
    scanner = a_stream().scanner(include_unknown=True)
    assert isinstance(scanner, StreamScanner)
    summed = 0
    names = scanner._scan.__globals__

    def counting_sum(data: bytes) -> int:
        nonlocal summed
        summed += len(data)
        return sum(data)

    def counting_grow(self: checks.Sums, fresh: bytes) -> None:
        nonlocal summed
        summed += len(fresh)
        grow(self, fresh)

    grow = checks.Sums._grow
    names["sum"] = counting_sum
    monkeypatch.setattr(checks.Sums, "_grow", counting_grow)
    law = LAWS[6]
    for number in range(1, 60 if IS_LONG else 25):
        scanner.reset()
        summed = 0
        (scene, _) = drawn_arguments(law, a_stream().variant(), None, number, entropy=400)
        for at in range(0, len(scene.traffic), 50):
            scanner.feed(scene.traffic[at : at + 50])
        scanner.close()
        # The head and the check byte itself are counted with a record, and not read by its check.
        assert abs(scanner.check_work - summed) <= 3 * scanner.counts.records + scanner.counts.unknown


def test_laws_of_packets_that_are_mostly_reserved_or_stuffed_without_a_check() -> None:
    """1,168 bits without a name are asked like any others; false packets of a framing without a check cost no checks."""
    wide = Protocol("wide", link="serial")
    framing = wide.framing(sync=b"\xaa", size=150, check=Sum(), max_size=150)
    wide.message("A", framing=framing, payload=BitLayout(148, "x" / bits(16, 0)))
    bare = Protocol("bare", link="serial")
    ended = bare.framing(header=Struct("id" / Byte), end=b"\0", stuffing=Cobs(), max_size=24)
    bare.message("A", framing=ended, match={"id": 1}, payload=Struct("x" / Int16ul))
    bare.message("B", framing=ended, match={"id": 2}, payload=Struct("x" / GreedyBytes))
    for protocol, law in ((wide, LAWS[1]), (bare, LAWS[6])):
        for seed in range(12):
            law(protocol.variant(), "both", *drawn_arguments(law, protocol.variant(), "both", seed))
