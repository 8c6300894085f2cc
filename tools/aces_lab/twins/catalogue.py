"""Faults on purpose: what each does to a bus or a device, and which assumption of a program breaks by it.

1. A fault hits answers by number: one, some, or all; a lasting one goes on from the first that it hits.
2. The same seed, the same fault: what it draws depends on nothing else.
3. What a program may make of a fault is said with it (`may`): pass, refuse by an error of its own, or only end.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

from aces_bus import Frame
from aces_bus.device import Twin
from aces_bus.device.twin import Twins
from aces_bus.errors import UnknownNameError

from .lines import Line, SerialLine
from .tap import Answers, Sendings, flipped, shortened

#: How long a second packet comes behind the first (ns).
BEHIND_NS = 500_000
#: How long a device is off in a brown-out, and a packet of a line is interrupted (ns).
OFF_NS, PAUSE_NS = 100_000_000, 20_000_000
#: Delays of late answers that are drawn (ns): a busy adapter, a busy machine, longer than most programs wait.
DELAYS_NS = (30_000_000, 120_000_000, 400_000_000)


@dataclass(frozen=True)
class Hit:
    """An answer that is hit: what an effect may know and touch."""

    packet: Any
    #: The answer before this one; None: it is the first.
    before: Frame | bytes | None
    dice: random.Random
    line: Line
    twins: Twins
    answers: Answers


Effect = Callable[[Hit], Sendings | None]


def _loses(hit: Hit) -> Sendings:
    return ()


def _late(hit: Hit) -> Sendings:
    return ((hit.dice.choice(DELAYS_NS), hit.packet),)


def _twice(hit: Hit) -> Sendings:
    return ((0, hit.packet), (BEHIND_NS, hit.packet))


def _garbled(hit: Hit) -> Sendings:
    return ((0, flipped(hit.packet, hit.dice)),)


def _short(hit: Hit) -> Sendings:
    return ((0, shortened(hit.packet)),)


def _wrong_number(hit: Hit) -> Sendings | None:
    other = hit.answers.of_another(hit.answers.with_other_values(hit.packet) or hit.packet)
    return None if other is None else ((0, other),)


def _others(hit: Hit) -> Sendings | None:
    other = hit.answers.of_another(hit.answers.with_other_values(hit.packet) or hit.packet)
    return None if other is None else ((0, other), (BEHIND_NS, hit.packet))


def _stale(hit: Hit) -> Sendings | None:
    old = hit.answers.with_other_values(hit.packet)
    return None if old is None else ((0, hit.packet), (BEHIND_NS, old))


def _overdue(hit: Hit) -> Sendings | None:
    old = None if hit.before is None else hit.answers.with_other_values(hit.before)
    return None if old is None else ((0, old), (BEHIND_NS, hit.packet))


def _noise(hit: Hit) -> Sendings:
    return ((0, bytes(hit.dice.randrange(256) for _ in range(3))), (0, hit.packet))


def _split(hit: Hit) -> Sendings | None:
    data = hit.packet
    if isinstance(data, Frame) or len(data) < 2:
        return None
    at = hit.dice.randrange(1, len(data))
    return ((0, data[:at]), (PAUSE_NS, data[at:]))


def _reboot(hit: Hit) -> Sendings:
    clock = hit.line.port.clock
    for twin in hit.twins.members.values():
        clock.call_soon(partial(twin.power, False))
        clock.call_in(OFF_NS, partial(twin.power, True))
    return ()


def _bus_off(hit: Hit) -> Sendings:
    hit.line.port.clock.call_soon(hit.line.go_bus_off)
    return ()


@dataclass(frozen=True)
class Fault:
    """A fault: `what` it does, and the `assumption` of a program that it breaks.

    `may`: what a program may make of it: "pass" (the right answer comes all the same), "refuse" (pass, or raise an error of
    its own), "end" (anything, in time). `effect` None: it is done when the twins are made, see `prepare`.
    """

    name: str
    what: str
    assumption: str
    effect: Effect | None
    links: tuple[str, ...] = ("can", "serial")
    may: Literal["pass", "refuse", "end"] = "refuse"
    is_lasting: bool = False


CATALOGUE: dict[str, Fault] = {
    fault.name: fault
    for fault in (
        Fault("values", "states are drawn over their whole range", "states have the values of the test", None, may="pass"),
        Fault("others", "before each answer another device answers", "every frame is of the device asked", _others,
              links=("can",), may="pass"),
        Fault("loses", "an answer is lost", "every request is answered", _loses),
        Fault("late", "an answer comes late", "an answer comes at once", _late),
        Fault("twice", "an answer comes twice", "every request has one answer", _twice),
        Fault("stale", "an old answer comes behind a new one", "what comes next is the answer to the last request", _stale),
        Fault("overdue", "the answer before comes again, before the right one", "an answer says what it answers", _overdue),
        Fault("wrong_number", "another device answers instead", "an answer is of the device asked", _wrong_number),
        Fault("short", "an answer is a byte short", "an answer is as long as it should be", _short),
        Fault("garbled", "a bit of an answer is wrong", "an answer arrives as it was sent", _garbled, links=("serial",)),
        Fault("noise", "noise stands before an answer", "the first byte is an answer's", _noise, links=("serial",)),
        Fault("split", "an answer comes in two parts", "an answer is read at once", _split, links=("serial",)),
        Fault("reboot", "the device restarts in the middle", "the device stays powered", _reboot),
        Fault("silent", "the device falls silent", "the device is there", _loses, is_lasting=True),
        Fault("bus_off", "the program's controller goes bus-off", "the bus takes what is sent", _bus_off, links=("can",)),
        Fault("baud", "the device has another speed than the program", "both have one speed", None, links=("serial",)),
    )
}  # fmt: skip


def chosen(names: str) -> list[Fault]:
    """Return the faults that `--aces-faults` means: `all`, or names with commas. Raises `UnknownNameError`."""
    if names == "all":
        return list(CATALOGUE.values())
    unknown = [name for name in names.split(",") if name not in CATALOGUE]
    if unknown:
        raise UnknownNameError("fault", unknown[0], ["all", *CATALOGUE])
    return [CATALOGUE[name] for name in names.split(",")]


class Mirrored(random.Random):
    """Draws the other end of what `random.Random` draws."""

    def random(self) -> float:
        """Return 1 less what would be drawn."""
        return 1.0 - super().random()


@dataclass
class Injection:
    """A fault in one run: the answers that it hits (None: all), the seed, and the share of a range that values have."""

    fault: Fault
    hits: frozenset[int] | None = None
    seed: int = 0
    share: float = 1.0
    #: Whether a lasting fault has begun.
    _began: bool = field(default=False, init=False)

    def dice(self, *about: object) -> random.Random:
        """Return what draws for one purpose: others change nothing of it."""
        if self.fault.name != "values":
            return random.Random(f"{self.seed} {self.fault.name} {about}")
        # Two runs draw values that mirror one another: both halves of a range are met, and both signs.
        kind = Mirrored if self.seed % 2 else random.Random
        return kind(f"{self.seed // 2} {about}")

    def is_hit(self, number: int) -> bool:
        """Return whether the answer of this number is hit."""
        if self.hits is None:
            return True
        if self.fault.is_lasting:
            self._began = self._began or number in self.hits
            return self._began
        return number in self.hits

    def prepare(self, line: Line, twins: Twins) -> Callable[[int, Any], tuple[str, Sendings] | None] | None:
        """Do what is done at the beginning; return what alters answers, for `TwinTap.alter`."""
        fault, self._began = self.fault, False
        if line.link not in fault.links:
            return None
        if fault.name == "values":
            for name, twin in twins.members.items():
                twin.draw(self.dice(name), self.share)
        if fault.name == "baud" and isinstance(line, SerialLine):
            line.wire.baud = round(line.wire.baud * 0.5)
        effect = fault.effect
        if effect is None:
            return None
        answers = Answers(twins)
        before: Frame | bytes | None = None

        def alter(number: int, packet: Frame | bytes) -> tuple[str, Sendings] | None:
            nonlocal before
            last, before = before, packet if number >= 0 else before
            if not self.is_hit(number):
                return None
            sendings = effect(Hit(packet, last, self.dice(number), line, twins, answers))
            return None if sendings is None else (fault.name, sendings)

        return alter

    def __str__(self) -> str:
        if self.fault.name == "values":
            return f"{self.fault.what}, {self.share:.3g} of it" if self.share < 1 else self.fault.what
        if self.hits is None or self.fault.effect is None:
            return self.fault.what
        return f"{self.fault.what}: number {', '.join(str(n + 1) for n in sorted(self.hits))}"


def injections(
    faults: Iterable[Fault], answers: int, links: Sequence[str], *, most: int, seed: int
) -> list[Injection]:
    """Return the runs of a test in which `answers` answers came: each fault at up to `most` places."""
    found: list[Injection] = []
    for fault in faults:
        if not set(fault.links) & set(links):
            continue
        if fault.effect is None or fault.may == "pass":
            runs = most if fault.name == "values" else 1
            found += [Injection(fault, None, seed + number) for number in range(runs)]
            continue
        places = list(range(answers))
        if answers > most:
            dice = random.Random(f"{seed} {fault.name}")
            step = answers / most
            places = [min(answers - 1, int(step * (n + dice.random()))) for n in range(most)]
        found += [Injection(fault, frozenset((place,)), seed) for place in places]
    return found


def smaller(injection: Injection, answers: int) -> Iterable[Injection]:
    """Yield what is less than an injection: one answer instead of all, a smaller share of a range."""
    fault = injection.fault
    if fault.name == "values":
        for share in (0.01, 0.1, 0.3, 0.6):
            if share < injection.share:
                yield Injection(fault, None, injection.seed, share)
    elif injection.hits is None and fault.effect is not None:
        for place in range(min(answers, 12)):
            yield Injection(fault, frozenset((place,)), injection.seed)


def driver_faults(twins: Iterable[Twin]) -> dict[str, str]:
    """Return the error states of these devices, beyond what all can have."""
    return {name: what for twin in twins for name, what in type(twin).faults.items()}


__all__ = ["CATALOGUE", "Fault", "Injection", "chosen", "driver_faults", "injections", "smaller"]
