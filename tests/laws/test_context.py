"""Which request a reply answers: the rule of the design, against a model that keeps one plain list.

Scanner and reference share `Context`, so law 2 says nothing of it. The model: the latest request of the same channel that
agrees in all fields that both have, is not used up and not too old; a mode stays; what was asked of everyone, each
device answers once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest
from construct import ConstructError
from hypothesis import settings

from aces_bus.errors import AcesError
from aces_bus.protocol import Message, Request, StreamScanner, Variant, as_dict
from aces_bus.protocol.declare.ambiguity import needing_context
from aces_bus.protocol.declare.order import ordered
from aces_bus.testing import laws
from aces_bus.testing.packets import draw_packet
from aces_bus.testing.source import spread
from aces_bus.testing.trial import image_of
from tests.laws.wires import PROTOCOLS

IS_LONG = settings().max_examples > 100
#: Scenes of a bus, and of a stream, that are played.
BUS_SCENES, STREAM_SCENES = (15, 59) if IS_LONG else (7, 25)


@dataclass(frozen=True)
class Word:
    """A frame or packet as the rule sees it."""

    image: bytes
    channel: Any = None
    time: float | None = None


@dataclass
class Asked:
    """A request that was heard or sent."""

    name: str
    channel: Any
    time: float | None
    values: Mapping[str, Any]
    used: bool = False
    answered: set[tuple[Any, ...]] = field(default_factory=set)


def outer(message: Message) -> set[str]:
    """The fields of a message outside its payload."""
    names = {capture.name for capture in message.identifier.captures}
    for head in message.heads:
        names |= {capture.name for capture in head.pattern.captures} if head.pattern else {head.name or ""}
    return names - {""}


class Model:
    """The rule, slowly."""

    def __init__(self, variant: Variant, direction: laws.Way) -> None:
        self.broadcast = variant.protocol.broadcast
        self.messages = ordered(variant.messages_for(direction))
        self.bound = needing_context(self.messages)
        needed = [m for m in self.messages if m.name in self.bound]
        self.asking = {r.message.name for m in needed for r in (*m.reply_to, *m.after)}
        self.asked: list[Asked] = []

    def hear(self, name: str | None, values: Mapping[str, Any], word: Word) -> str | None:
        """What a frame is, the scanner having said `name` (which counts only where no request is needed)."""
        fitting = [
            (m, v) for m in self.messages if m.name in self.bound and (v := read(m, word.image)) is not None
        ]
        if fitting:
            chosen = self.resolve(fitting, word)
            name = chosen or (name if name not in self.bound else None)
        found = next((m for m in self.messages if m.name == name), None)
        if (
            found is not None
            and name not in self.bound
            and any(r.message.name in self.asking for r in found.reply_to)
        ):
            self.resolve([(found, values)], word)
        if name in self.asking:
            self.asked.append(Asked(name or "", word.channel, word.time, values))
        return name

    def send(self, variant: Variant, word: Word) -> None:
        """We sent this ourselves."""
        for message in ordered(variant.messages.values()):
            if message.name in self.asking and (values := read(message, word.image)) is not None:
                self.asked.append(Asked(message.name, word.channel, word.time, values))
                return

    def resolve(self, fitting: Sequence[tuple[Message, Mapping[str, Any]]], word: Word) -> str | None:
        for asked in reversed(self.asked):
            links = [
                (message, link, sticky, values)
                for message, values in fitting
                for sticky, links in ((False, message.reply_to), (True, message.after))
                for link in links
                if self.agrees(asked, message, link, values, word)
            ]
            for message, link, sticky, values in links:
                if link.accepts(asked.values):
                    shared = sorted(outer(message) & outer(link.message))
                    own = tuple(values[n] for n in shared)
                    if not sticky and own != tuple(asked.values[n] for n in shared):
                        asked.answered.add(own)
                    else:
                        asked.used = not sticky
                    return message.name
            if links:
                return None
        return None

    def agrees(
        self, asked: Asked, message: Message, link: Request, values: Mapping[str, Any], word: Word
    ) -> bool:
        if asked.used or asked.name != link.message.name or asked.channel != word.channel:
            return False
        shared = sorted(outer(message) & outer(link.message))
        own = tuple(values[n] for n in shared)
        everyone = tuple(self.broadcast.get(n, v) for n, v in zip(shared, own, strict=True))
        if tuple(asked.values[n] for n in shared) not in (own, everyone) or own in asked.answered:
            return False
        if message.within is None or asked.time is None or word.time is None:
            return True
        return bool(word.time - asked.time <= message.within)


def read(message: Message, image: bytes) -> Mapping[str, Any] | None:
    try:
        values: Mapping[str, Any] = message.struct.parse(image, raw=True)
    except (ConstructError, AcesError):
        return None
    return values


@pytest.mark.parametrize("name", ["hubo", "can_corners", "mit_motor"])
@pytest.mark.parametrize("direction", [None, "from device"])
def test_replies_are_told_by_the_rule(name: str, direction: laws.Way) -> None:
    """Frame by frame, the scanner chooses what the model chooses."""
    told = 0
    variants = [v for v in PROTOCOLS[name].variants() if Model(v, direction).bound]
    for variant in variants[-2:]:
        for seed in range(1, BUS_SCENES + 1):
            (scene,) = laws.draw_arguments(laws.LAWS[3], variant, direction, spread(seed), size=700)
            model = Model(variant, direction)
            given = laws.play(laws.scanner_of(variant, direction), scene)
            sent = list(scene.sent_at)
            for number, (frame, record) in enumerate(zip(scene.words, given, strict=True)):
                while sent and sent[0][0] <= number:
                    model.send(variant, _word(sent.pop(0)[1]))
                if frame.is_error_frame:
                    continue
                heard = record.meta.message
                wanted = model.hear(heard, as_dict(record) if heard else {}, _word(frame))
                assert heard == wanted, f"{variant}, seed {seed}, frame {number}: {frame}"
                told += heard in model.bound
    assert told > 20


def _word(frame: Any) -> Word:
    return Word(image_of(frame), frame.channel, frame.timestamp)


@pytest.mark.parametrize("name", ["robotis", "dynamixel2", "modbus_like"])
def test_replies_in_a_stream_are_told_by_the_rule(name: str) -> None:
    """Packet by packet; with requests to everyone, which each device answers."""
    variant = PROTOCOLS[name].variant()
    scanner = laws.scanner_of(variant, "both")
    told = 0
    for seed in range(1, STREAM_SCENES + 1):
        source = spread(seed, 2000)
        model = Model(variant, "both")
        scanner.reset()
        packets: list[laws.DrawnPacket] = []
        for _ in range(12):
            packet = draw_packet(source.choice(variant.messages_for(None)), source.branch(), variant)
            asked = [packet.request] if packet.request is not None and source.integer(0, 3) else []
            packets += [*asked, *[packet] * source.choice((1, 1, 2))]
        for packet in packets:
            assert isinstance(scanner, StreamScanner)
            (record,) = scanner.feed(packet.image) + scanner.idle()
            heard = record.meta.message
            wanted = model.hear(heard, as_dict(record) if heard else {}, Word(packet.image))
            assert heard == wanted, f"seed {seed}: {packet}"
            told += heard in model.bound
    assert told > 20
