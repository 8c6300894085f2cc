"""What is drawn is what it says: valid by construction, every message, and small when it shrinks."""

from __future__ import annotations

import random
import subprocess
import sys
from typing import Any

import pytest
from construct import Byte, Check, Struct, this
from hypothesis import find, given, settings
from hypothesis import strategies as st

from aces_bus import Unknown, make_scanner
from aces_bus.protocol import CanScanner, Message, Protocol
from aces_bus.protocol.live.scanner import Scanner
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.testing import LAWS, Scene, laws, strategies
from aces_bus.testing.packets import DrawnPacket, UndrawableError
from aces_bus.testing.source import Entropy
from aces_bus.testing.trial import as_given, comparable
from tests.laws.drawn import drawn_arguments, drawn_packet
from tests.laws.wires import PROTOCOLS, REGISTERED

IS_LONG = settings().max_examples > 100


@pytest.mark.parametrize("name", PROTOCOLS)
def test_every_message_is_drawn_and_heard(name: str) -> None:
    """A scanner that hears nothing but a drawn packet, its request having been sent, hears that message."""
    heard = set[Message]()
    for variant in PROTOCOLS[name].variants():
        scanner = make_scanner([variant], direction=laws.directions(variant)[0], include_unknown=True)
        for message in variant.messages_for(None):
            # One that several dialects and configurations have is drawn often once.
            for seed in range(6 if IS_LONG else 1 if message in heard else 3):
                packet = drawn_packet(message, seed, variant)
                scanner.reset()
                assert [type(r).__name__ for r in _hear(scanner, packet)] == [message.name], variant.label
            heard.add(message)


def _hear(scanner: Scanner, packet: DrawnPacket) -> list[Any]:
    if isinstance(scanner, CanScanner):
        if packet.request is not None:
            for frame in packet.request.as_sent:
                scanner.sent(frame)
        return scanner.feed(packet.as_sent)
    assert isinstance(scanner, StreamScanner)
    if packet.request is not None:
        scanner.sent(packet.request.image)
    return scanner.feed(packet.image) + scanner.idle()


@pytest.mark.parametrize("name", [*REGISTERED, "opaque_corners", "can_corners"])
@settings(max_examples=30 if IS_LONG else 12)
@given(st.data())
def test_strategies_draw_valid_packets(name: str, data: st.DataObject) -> None:
    """`packets` and `fields` give what `message.struct` builds and reads."""
    variant = PROTOCOLS[name].variant()
    packet = data.draw(strategies.packets(variant))
    request = packet.request.values if packet.request is not None else packet.values
    read = comparable(packet.message.struct.parse(packet.image, raw=True, request=request))
    wanted = comparable(packet.values)
    assert as_given(read, wanted) == wanted
    values = data.draw(strategies.fields(packet.message))
    assert set(values) <= set(packet.message.fields)


@pytest.mark.parametrize("name", REGISTERED)
def test_scenes_are_mostly_readable_and_never_only_that(name: str) -> None:
    """Among some scenes there are records, losses of several kinds, and our own transmissions where replies need them."""
    variant = PROTOCOLS[name].variant()
    for direction in laws.directions(variant):
        scanner = make_scanner([variant], direction=direction, include_unknown=True)
        reasons: set[str] = set()
        decoded = total = 0
        for seed in range(1, 20 if IS_LONG else 5):
            (scene,) = drawn_arguments(LAWS[3], variant, direction, seed)
            scanner.reset()
            given = laws.play(scanner, scene)
            reasons |= {item.kind for item in given if isinstance(item, Unknown)}
            decoded += scanner.counts.decoded
            total += scanner.counts.total
        # Where every byte alone is a packet nothing is skipped or malformed, and noise weighs as much as a packet.
        bare = any(m.framing is not None and m.framing.max_size == 1 for m in variant.messages_for(direction))
        # A frame that is lost or wrong takes along all frames of its packet.
        carried = any(m.transport is not None for m in variant.messages_for(direction))
        assert (0.2 if bare or carried else 0.3) < decoded / total < 0.95
        assert len(reasons) >= (1 if bare else 2)


@pytest.mark.slow
def test_a_wire_shrinks_to_little() -> None:
    """What breaks a law is shown small: here, one packet of the message looked for."""
    variant = PROTOCOLS["robotis"].variant()

    def has_reset(scene: Scene) -> bool:
        return any(p.message.name == "Reset" for p in scene.packets)

    # One seed in the short profile: most of the time goes into the shrinking of what is found.
    for seed in (1, 2, 3) if IS_LONG else (3,):
        scene = find(
            strategies.streams(variant, "to device"),
            has_reset,
            settings=settings(max_examples=2000),
            random=random.Random(seed),
        )
        assert len(scene.packets) <= 2
        assert len(scene.traffic) <= 40


def test_a_dry_source_gives_the_simplest() -> None:
    """Lows, firsts and zeros, for ever."""
    source = Entropy(b"")
    assert source.is_dry
    assert [source.integer(3, 9), source.choice("ab"), source.bytes(3), source.bytes(9)] == [
        3,
        "a",
        bytes(3),
        bytes(9),
    ]


def test_what_cannot_be_drawn_says_so() -> None:
    """A message that contradicts itself is named with its line."""
    made = Protocol("never", link="can")
    message = made.message("Never", id=1, payload=Struct("a" / Byte, "b" / Check(this.a > 300)))
    with pytest.raises(
        UndrawableError, match=r"message never\.Never.*test_strategies\.py:\d+.*no valid packet found"
    ):
        drawn_packet(message, 1)


@pytest.mark.slow
def test_without_hypothesis_the_extra_is_named() -> None:
    """The strategies say what to install; the laws need nothing."""
    program = (
        "import sys; sys.modules['hypothesis'] = None\n"
        "from aces_bus.testing import laws\n"
        "for name in ('strategies', 'pytest_laws'):\n"
        "    try:\n"
        "        __import__('aces_bus.testing.' + name)\n"
        "    except ImportError as error:\n"
        "        assert 'aces-bus[testing]' in str(error), error\n"
        "    else:\n"
        "        raise SystemExit(name)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
