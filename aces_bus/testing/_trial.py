"""One scene before the laws: what scanner, reference and construct say of it, each asked once and only when a law asks.

1. A trial is a pure function of bench, scene and cuts; laws that judge the same trial share what was played.
2. What breaks a law is a `LawError`, with everything that it takes to show and repeat it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import Any, NoReturn, TypeVar
from zlib import crc32

from ..protocol.declare.message import Message
from ..protocol.record import Unknown
from ._bench import Bench
from ._play import ScannedItem, as_heard, copy_item, image_of, play, told_by
from ._scenes import Scene, Way

T = TypeVar("T")

#: The laws by number.
NAMES = {
    1: "round trip",
    2: "oracle",
    3: "chunking",
    4: "resynchronisation",
    5: "no false accept",
    6: "accounting",
    7: "bounded",
    8: "calm",
    9: "unambiguous",
}


class LawError(AssertionError):
    """A law does not hold. `text` says what was expected and what came; `scene` and `cuts` repeat it."""

    def __init__(self, number: int, trial: Trial, text: str, *, with_scene: bool = True) -> None:
        self.number, self.law, self.text = number, NAMES[number], text
        self.wire, self.direction = trial.bench.wire, trial.bench.direction
        self.label = trial.bench.label
        self.scene, self.cuts = trial.scene, trial.cuts
        where = f"\n  scene: {scene_source(trial.scene)}" if with_scene else ""
        super().__init__(
            f"law {number} ({self.law}) of {self.label}, direction {self.direction!r}: {text}{where}"
        )


def scene_source(scene: Scene) -> str:
    """A scene as it is written in a test."""
    if isinstance(scene.words, bytes):
        words = f"bytes.fromhex({scene.words.hex(' ').upper()!r})"
        sent = tuple((at, f"bytes.fromhex({word.hex(' ').upper()!r})") for at, word in scene.sent_at)
        return f"Scene({words}, idle_at={scene.idle_at}, sent_at={sent})"
    return f"Scene(({', '.join(map(repr, scene.words))},), sent_at={scene.sent_at!r})"


class Trial:
    """A scene, cut at `cuts`, before a bench.

    `thorough` has laws look at every packet of a scene, `columns` has them read it as columns, too: both cost more than
    all the rest. A fuzzer does that now and then, and always for what has failed.
    """

    def __init__(
        self,
        bench: Bench,
        scene: Scene,
        cuts: Iterable[int] = (),
        *,
        thorough: bool = True,
        columns: bool = True,
    ) -> None:
        self.bench, self.scene = bench, scene
        self.cuts = tuple(sorted(cuts))
        self.thorough, self.columns = thorough, columns

    @property
    def direction(self) -> Way:
        return self.bench.direction

    def fail(self, number: int, text: str, *, with_scene: bool = True) -> NoReturn:
        """Raise `LawError`."""
        raise LawError(number, self, text, with_scene=with_scene)

    def sample(self, items: Sequence[T]) -> Sequence[T]:
        """All of them; of a trial that is not thorough, one."""
        if self.thorough or len(items) < 2:
            return items
        at = self.turn % len(items)
        return items[at : at + 1]

    @cached_property
    def turn(self) -> int:
        """A number that a scene has from its words: what is looked at when not everything is."""
        words = self.scene.words
        if isinstance(words, bytes):
            return crc32(words)
        return sum(crc32(frame.data, frame.arbitration_id) for frame in words)

    # ------------------------------------------------------------------ played

    @cached_property
    def _whole(self) -> tuple[list[Any], dict[str, Any], int]:
        scanner = self.bench.scanner()
        given = play(scanner, self.scene)
        return given, copy_item(scanner.counts), scanner.counts.balance

    @property
    def given(self) -> list[Any]:
        """What a scanner gives of the whole scene: raw records and all losses."""
        return self._whole[0]

    @property
    def counts(self) -> dict[str, Any]:
        """Its counts."""
        return self._whole[1]

    @cached_property
    def heard(self) -> list[ScannedItem]:
        """The same for comparison."""
        return as_heard(self.given, self.bench.is_can)

    @cached_property
    def cut_up(self) -> tuple[list[Any], dict[str, Any], int]:
        """What the scanner gives of the scene in pieces, its counts, and by how much they do not balance."""
        scanner = self.bench.scanner()
        given = play(scanner, self.scene, self.cuts)
        return given, copy_item(scanner.counts), scanner.counts.balance

    @cached_property
    def physical(self) -> list[ScannedItem]:
        """What a scanner for physical values gives of the whole scene."""
        return as_heard(play(self.bench.scanner(raw=False), self.scene), self.bench.is_can)

    @cached_property
    def told(self) -> list[ScannedItem]:
        """What the reference says of it."""
        return told_by(self.bench.reference(), self.scene)

    def accepted(self) -> Iterator[tuple[Message, bytes, dict[str, Any]]]:
        """Message, image and request's fields of each record that the scanner gave."""
        names = self.bench.by_name
        for number, record in enumerate(self.given):
            if isinstance(record, Unknown):
                continue
            message = names[record._protocol, type(record).__name__]
            image = image_of(self.scene.words[number]) if message.framing is None else record.meta.raw
            yield message, image, {name: getattr(record, name) for name in message.request_fields}


__all__ = ["NAMES", "LawError", "Trial", "scene_source"]
