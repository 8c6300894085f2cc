"""The quick loop: scenes from a seed, all laws on each, what they reached, and the smallest scene that breaks one.

1. An example is a scene before all the laws that were asked for. It is a pure function of the wires, the seed and its
   number, so that any one can be had alone: `Fuzzer.example(number)`.
2. Examples come in blocks of `BLOCK`, all of one wire; the last of a block is the *train* of the others, end to end: long
   enough for the scanner's long strides, and judged with columns, which cost more than all the rest.
3. A law that has failed on a protocol is not asked there again: one fault should not be reported a hundred times.
4. Nothing prints, reads a clock or writes a file here.

>>> from aces_bus.testing import Fuzzer
>>> from aces_protocols.minihubo_adc.spec import minihubo_adc
>>> fuzzer = Fuzzer([minihubo_adc], seed=1)
>>> fuzzer.run(64)
[]
>>> fuzzer.examples, fuzzer.coverage.never()
(64, [])
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ..errors import CallerError
from ..protocol.declare.protocol import Variant
from ..protocol.protocol import Protocol
from .bench import Bench
from .coverage import Coverage
from .laws import LAWS, Law, wires
from .packets import UndrawableError
from .scenes import Scene, Way, Wire, adversary, draw_cuts, draw_frames, draw_stream
from .shrinking import Calls, shrunk
from .source import Dice
from .trial import LawError, Trial

#: Examples of one wire in a row.
BLOCK = 32
#: Sizes of scenes, in bytes: mostly short, because what breaks a law is. Short packets make short scenes.
SIZES = (8, 16, 24, 32, 32, 48, 64, 96)
#: Bytes of a stream of false headers.
ADVERSARY = 1200
#: Cuts of a scene of a thousand bytes.
LONG_CUTS = 24


@dataclass(frozen=True)
class Failure:
    """A law that does not hold, and the smallest scene found that shows it.

    `example` is the number of the example that began it, None for a scene that was given. `first` is the scene as drawn.
    """

    law: Law
    wire: Wire
    direction: Way
    text: str
    scene: Scene
    cuts: tuple[int, ...]
    label: str
    example: int | None = None
    first: Scene | None = field(default=None, repr=False)
    tried: int = 0

    def __str__(self) -> str:
        return (
            f"law {self.law.number} ({self.law.name}) of {self.label}, "
            f"direction {self.direction!r}: {self.text}"
        )


def judged(law: Law, trial: Trial) -> str:
    """Return what breaks a law in a trial; empty when it holds. Whatever the scanner raises breaks the law that met it."""
    try:
        law.judges(trial)
    except LawError as error:
        return error.text
    except UndrawableError:
        raise
    except Exception as error:  # a fault of any kind is what we look for
        return f"raised {type(error).__name__}: {error}"
    return ""


class Fuzzer:
    """Laws on scenes of some wires: those of whole protocols, or pairs of a wire and a direction.

    `laws` are the laws asked for (all of them by default). Raises `CallerError` when there is nothing to do.
    """

    def __init__(
        self,
        wanted: Iterable[Protocol | tuple[Wire, Way]],
        *,
        seed: int = 0,
        laws: Sequence[Law] = LAWS,
    ) -> None:
        places: list[tuple[Wire, Way]] = []
        for wanted_name in wanted:
            places += wires(wanted_name) if isinstance(wanted_name, Protocol) else [wanted_name]
        self.benches = [
            Bench(wire, direction, remembers=True)
            for wire, direction in places
            if _has_messages(wire, direction)
        ]
        self.laws = tuple(laws)
        if not self.benches:
            raise CallerError("nothing to fuzz: no protocol given declares a message")
        if not self.laws:
            raise CallerError("nothing to fuzz: no law is asked for")
        self.seed = seed
        self.coverage = Coverage()
        for bench in self.benches:
            self.coverage.expects(bench)
        self.failures: list[Failure] = []
        #: Scenes judged; laws asked of them; bytes and frames in them.
        self.examples = self.checks = self.bytes_and_frames = 0
        #: Scenes that reached something new, while `keeps` is set.
        self.keeps = False
        self.kept: list[tuple[Bench, Scene, tuple[int, ...]]] = []
        self._silenced: set[tuple[int, str]] = set()
        self._block: tuple[int, list[Scene]] = (-1, [])

    # ------------------------------------------------------------------ examples

    def example(self, number: int) -> tuple[Bench, Scene, tuple[int, ...]]:
        """Return the bench, scene and cuts of an example, by its number."""
        block, place = divmod(number, BLOCK)
        bench = self.benches[block % len(self.benches)]
        if self._is_train(number):
            known, scenes = self._block
            if known != block or len(scenes) != place:
                scenes = [self._draw(bench, block, n)[0] for n in range(place)]
            scene = joined_scenes(scenes)
            return bench, scene, _few(draw_cuts(scene, Dice(f"{self.seed}/{block}/cuts")))
        scene, cuts = self._draw(bench, block, place)
        if self._block[0] != block:
            self._block = (block, [])
        if len(self._block[1]) == place:
            self._block[1].append(scene)
        return bench, scene, cuts

    def _is_train(self, number: int) -> bool:
        block, place = divmod(number, BLOCK)
        return place == BLOCK - 1 and block // len(self.benches) % 2 == 0

    def _draw(self, bench: Bench, block: int, place: int) -> tuple[Scene, tuple[int, ...]]:
        dice = Dice(f"{self.seed}/{block}/{place}")
        size = round(dice.choice(SIZES) * bench.share)
        if bench.is_can:
            scene = draw_frames(bench.wire, bench.direction, dice, size=max(1, size // 12))
        elif place == BLOCK - 2 and block % 4 == 0:
            scene = Scene(adversary(bench.wire, bench.direction, dice, size=ADVERSARY))
            return scene, _few(draw_cuts(scene, dice))
        else:
            scene = draw_stream(bench.wire, bench.direction, dice, size=size)
        return scene, draw_cuts(scene, dice)

    # ------------------------------------------------------------------ running

    def run(self, examples: int, first: int = 0, *, most: int | None = None) -> list[Failure]:
        """Judge `examples` examples from number `first` on; gives the failures among them. It ends with `most` failures."""
        before = len(self.failures)
        for number in range(first, first + examples):
            if most is not None and len(self.failures) >= most:
                break
            bench, scene, cuts = self.example(number)
            self.judge(bench, scene, cuts, number=number, thorough=False, columns=self._is_train(number))
        return self.failures[before:]

    def judge(
        self,
        bench: Bench,
        scene: Scene,
        cuts: tuple[int, ...] = (),
        *,
        number: int | None = None,
        thorough: bool = True,
        columns: bool = True,
    ) -> None:
        """Ask all laws of a scene; what fails is shrunk and kept in `failures`."""
        trial = Trial(bench, scene, cuts, thorough=thorough, columns=columns)
        self.examples += 1
        self.bytes_and_frames += len(scene)
        has_raised = False
        name = bench.variants[0].name
        for law in self.laws:
            if (law.number, name) in self._silenced or (law.streams_only and bench.is_can):
                continue
            self.checks += 1
            if said := judged(law, trial):
                self._silenced.add((law.number, name))
                if said.startswith("raised"):
                    if has_raised:
                        continue  # the same, met by another law
                    has_raised = True
                self.failures.append(shrink(law, trial, said, number))
        try:
            is_new = self.coverage.note(trial)
        except Exception:  # a scanner that raises has been reported by the laws
            return
        if is_new and self.keeps:
            self.kept.append((bench, scene, cuts))


def shrink(law: Law, trial: Trial, said: str, number: int | None = None, calls: int = 4000) -> Failure:
    """Return the failure of a law in a trial, with the smallest scene that `calls` trials can find."""
    # A bench of its own: what a faulty construct said before must not stand in the way, nor a scanner's state.
    bench = Bench(trial.bench.wire, trial.bench.direction)
    counted = Calls(calls)
    text = said

    def fails(scene: Scene, cuts: tuple[int, ...]) -> bool:
        nonlocal text
        if found := judged(law, Trial(bench, scene, cuts)):
            text = found
            return True
        return False

    start = replace(trial.scene)
    scene, cuts = start, trial.cuts
    if fails(scene, cuts):
        scene, cuts = shrunk(bench, scene, cuts, fails, counted)
        fails(scene, cuts)
    return Failure(
        law,
        trial.bench.wire,
        trial.bench.direction,
        text,
        scene,
        cuts if law.takes_cuts else (),
        trial.bench.label,
        number,
        start,
        counted.made,
    )


def _few(cuts: tuple[int, ...]) -> tuple[int, ...]:
    """Return not more cuts than a long scene can be played with in reasonable time."""
    return cuts if len(cuts) <= LONG_CUTS else cuts[:: len(cuts) // LONG_CUTS + 1]


def joined_scenes(scenes: Sequence[Scene]) -> Scene:
    """Join scenes end to end."""
    idle_at: list[int] = []
    sent_at: list[tuple[int, Any]] = []
    packets: list[Any] = []
    at = 0
    for scene in scenes:
        idle_at += [at + offset for offset in scene.idle_at]
        sent_at += [(at + offset, packet) for offset, packet in scene.sent_at]
        packets += scene.packets
        at += len(scene)
    is_stream = isinstance(scenes[0].traffic, bytes)
    traffic: Any = (
        b"".join(s.traffic for s in scenes)
        if is_stream
        else tuple(frame for s in scenes for frame in s.traffic)
    )
    return Scene(traffic, tuple(dict.fromkeys(idle_at)), tuple(sent_at), tuple(packets))


def _has_messages(wire: Wire, direction: Way) -> bool:
    variants = (wire,) if isinstance(wire, Variant) else tuple(wire)
    return any(variant.messages_for(direction) for variant in variants)


__all__ = ["BLOCK", "Failure", "Fuzzer", "joined_scenes", "judged", "shrink"]
