"""The toolkit itself is fuzzed: protocols that nobody wrote keep the laws."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings

from aces_bus import make_scanner
from aces_bus.protocol import Protocol
from aces_bus.testing import Fuzzer, strategies
from aces_bus.testing.source import spread
from aces_bus.testing.specs import Link, draw_spec, protocol_of
from tests.laws.drawn import wires_of

#: Specs in the short run and in the long one: each is compiled, which costs more than fuzzing it.
SHORT, LONG = 6, 300


@pytest.mark.slow
def test_drawn_protocols_keep_the_laws() -> None:
    """Whatever fields, layouts, captures, checks and lengths: no law fails."""
    links: tuple[Link, ...] = ("can", "serial")
    for seed in range(1, LONG if settings().max_examples > 100 else SHORT):
        text = draw_spec(spread(seed), links[seed % 2])
        fuzzer = Fuzzer([protocol_of(text)], seed=seed)
        found = fuzzer.run(32 * len(fuzzer.benches), most=1)
        assert [str(failure) for failure in found] == [], f"spec {seed}:\n{text}"


@pytest.mark.slow
def test_drawn_protocols_are_of_many_kinds() -> None:
    """Among some dozens there is every kind of link, framing, check, pattern and field."""
    texts = "\n".join(draw_spec(spread(seed, 2000)) for seed in range(1, 60))
    words = (
        'link="can"',
        'link="serial"',
        "size=this.length",
        "stuffing=Slip()",
        "stuffing=Cobs()",
        "Crc(",
        "Fletcher(",
        "IdField(",
        "extended=True",
        "fd=True",
        "BitLayout(",
        "Split(",
        "signed=True",
        "SignMagnitude(",
        "Quantity(",
        "Enumeration(",
        "Flags(",
        "Multiplexed(",
        "Array(",
        "GreedyBytes",
        "direction=",
    )
    assert [word for word in words if word not in texts] == []


@settings(max_examples=10)
@given(strategies.protocols())
def test_a_drawn_protocol_is_one(protocol: Any) -> None:
    """It has messages, and a scanner."""
    assert isinstance(protocol, Protocol)
    assert protocol.declared
    for variant, way in wires_of(protocol):
        scanner: Any = make_scanner([variant], direction=way)
        assert scanner.feed([] if protocol.link == "can" else b"") == []


def test_a_spec_is_what_its_source_gives() -> None:
    """The same source of choices draws the same text, and nothing left draws the simplest."""
    assert draw_spec(spread(7)) == draw_spec(spread(7))
    simplest = protocol_of(draw_spec(spread(0, 0), "can"))
    assert [message.name for message in simplest.declared] == ["M0"]
