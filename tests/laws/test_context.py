"""Which request a reply answers: the scanner against the reference, which has the rule written out, over wires with many
requests and replies."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import settings

from aces_bus import Frame
from aces_bus.protocol.declare.ambiguity import needing_context
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.reference import Reference
from aces_bus.testing import LAWS, Scene, laws
from aces_bus.testing.packets import draw_packet
from aces_bus.testing.source import spread
from aces_bus.testing.trial import items_by
from tests.laws.drawn import ORACLE, drawn_arguments
from tests.laws.wires import PROTOCOLS

IS_LONG = settings().max_examples > 100
#: Scenes of a bus, and of a stream, that are played.
BUS_SCENES, STREAM_SCENES = (15, 59) if IS_LONG else (7, 25)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hubo", "can_corners", "mit_motor"])
@pytest.mark.parametrize("direction", [None, "from device"])
def test_replies_follow_the_rule(name: str, direction: laws.Way) -> None:
    """Frame by frame, the scanner chooses what the reference chooses."""
    told = 0
    needing = {v: needing_context(v.messages_for(direction)) for v in PROTOCOLS[name].variants()}
    variants = [variant for variant, names in needing.items() if names]
    for variant in variants[-2:]:
        for seed in range(1, BUS_SCENES + 1):
            (scene,) = drawn_arguments(LAWS[3], variant, direction, seed, size=700)
            scanned = laws.scanned_items(laws.scanner_of(variant, direction, raw=False), scene)
            wanted = items_by(Reference([variant], direction=direction), scene)
            assert scanned == wanted, f"{variant}, seed {seed}"
            told += sum(item.message in needing[variant] for item in scanned)
    assert told > 20


@pytest.mark.parametrize("name", ["robotis", "dynamixel2", "modbus_like"])
def test_replies_in_a_stream_follow_the_rule(name: str) -> None:
    """Packet by packet; with requests to everyone, which each device answers."""
    variant = PROTOCOLS[name].variant()
    bound = needing_context(variant.messages_for("both"))
    scanner = laws.scanner_of(variant, "both")
    told = 0
    for seed in range(1, STREAM_SCENES + 1):
        source = spread(seed, 2000)
        scanner.reset()
        packets: list[laws.DrawnPacket] = []
        for _ in range(12):
            packet = draw_packet(source.choice(variant.messages_for(None)), source.branch(), variant)
            asked = [packet.request] if packet.request is not None and source.integer(0, 3) else []
            packets += [*asked, *[packet] * source.choice((1, 1, 2))]
        heard: list[Any] = []
        ends: list[int] = []
        for packet in packets:
            assert isinstance(scanner, StreamScanner)
            (record,) = scanner.feed(packet.image) + scanner.idle()
            heard.append(record.meta.message)
            ends.append((ends[-1] if ends else 0) + len(packet.image))
        data = b"".join(packet.image for packet in packets)
        wanted = Reference([variant], direction="both").stream(data, idle_at=ends)
        assert heard == [item.message for item in wanted], f"seed {seed}"
        told += sum(message in bound for message in heard)
    assert told > 20


def test_before_a_request_that_is_too_old_there_is_none() -> None:
    """A request of an unknown time does not answer for a later one that is too old; alone it fits."""
    variant = PROTOCOLS["can_corners"].variant()
    ask, answer = b"\x01\0", b"\x12\x34\x56"  # of three bytes: AnswerThree has two or five
    untimed, old = Frame(0x203, ask), Frame(0x203, ask, 1.0)
    for given, found in (((untimed, old), None), ((untimed,), "AnswerOne"), ((old, untimed), "AnswerOne")):
        scene = Scene((*given, Frame(0x243, answer, 2.0)))
        ORACLE(variant, None, scene)
        assert laws.scanned_items(laws.scanner_of(variant, None), scene)[-1].message == found
