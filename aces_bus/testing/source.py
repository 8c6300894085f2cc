"""Where drawn numbers come from: one set of draw functions, three sources of choices.

1. Every value that a test draws is a pure function of what its source gives.
2. The smallest choice is the simplest: a source that has run dry gives lows, firsts and zeros, so that shrinking works.

`Entropy` interprets a string of bytes, as fuzzers do: one draw of Hypothesis makes a whole wire, cheaply, and shrinks
byte by byte. `Drawn` asks Hypothesis for each number: dearer, and shrinks best. `Dice` is for `aces fuzz`, which works
without Hypothesis, and would take more than twice the time for a scene with it (1.7 ms against 0.7 ms).
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

T = TypeVar("T")


class ChoiceSource(Protocol):
    """Gives choices."""

    def integer(self, low: int, high: int) -> int:
        """Return a number in `low`…`high`, both included."""
        ...

    def choice(self, items: Sequence[T]) -> T:
        """Return one of `items`."""
        ...

    def bytes(self, size: int) -> bytes:
        """Return `size` bytes."""
        ...

    @property
    def is_dry(self) -> bool:
        """True if only the simplest choices are left."""
        ...

    def branch(self) -> ChoiceSource:
        """Return a source for one part of a whole."""
        ...


class Entropy:
    """Choices out of a string of bytes."""

    def __init__(self, data: bytes) -> None:
        # Zeros at the end are what a dry source gives anyway: without them it is dry sooner, and a scene shorter.
        self._data = data.rstrip(b"\0")
        self._at = 0

    @property
    def is_dry(self) -> bool:
        return self._at >= len(self._data)

    def _take(self, size: int) -> int:
        at = self._at
        self._at = at + size
        return int.from_bytes(self._data[at : at + size], "little")

    def integer(self, low: int, high: int) -> int:
        span = high - low + 1
        if span <= 1:
            return low
        if span <= 256:
            return low + self._take(1) % span
        return low + self._take(((span - 1).bit_length() + 7) // 8) % span

    def choice(self, items: Sequence[T]) -> T:
        return items[self.integer(0, len(items) - 1)]

    def branch(self) -> Entropy:
        """Return a source of its own for one part of a whole, for three bytes: parts can be dropped and simplified one
        by one.
        """
        seed = self._take(3)
        return spread(seed, 512) if seed else Entropy(b"")

    def bytes(self, size: int) -> bytes:
        if size <= 4:
            return self._take(size).to_bytes(size, "little")
        # A long run costs three bytes: a seed that is spread out; seed 0 is all zeros.
        seed = self._take(3)
        return random.Random(seed).randbytes(size) if seed else bytes(size)


class Drawn:
    """Choices of Hypothesis; `integers(low, high)` and `binary(size)` are what it is asked for."""

    is_dry = False

    def __init__(self, integers: Callable[[int, int], int], binary: Callable[[int], bytes]) -> None:
        self._integers, self._binary = integers, binary

    def branch(self) -> Drawn:
        return self

    def integer(self, low: int, high: int) -> int:
        return self._integers(low, high) if low < high else low

    def choice(self, items: Sequence[T]) -> T:
        return items[self.integer(0, len(items) - 1)]

    def bytes(self, size: int) -> bytes:
        return self._binary(size) if size else b""


class Dice:
    """Choices of a seeded generator, without an end: the quickest source. What shrinks is the scene, not the choices."""

    is_dry = False

    def __init__(self, seed: str | int) -> None:
        self._random = random.Random(seed)
        self._float = self._random.random

    def branch(self) -> Dice:
        return self

    def integer(self, low: int, high: int) -> int:
        span = high - low + 1
        if span <= 1:
            return low
        if span > 1 << 32:  # more than a float can tell apart
            return low + self._random.getrandbits(span.bit_length() + 8) % span
        return low + int(self._float() * span)

    def choice(self, items: Sequence[T]) -> T:
        return items[int(self._float() * len(items))]

    def bytes(self, size: int) -> bytes:
        return self._random.randbytes(size)


def spread(seed: int, size: int = 4096) -> Entropy:
    """Return a source that is the same for the same seed."""
    return Entropy(random.Random(seed).randbytes(size))


def edge_number(source: ChoiceSource, low: int, high: int) -> int:
    """Return a number in `low`…`high` that is often an edge, near zero or a power of two."""
    how = source.integer(0, 7)
    if how < 4:
        return source.integer(low, high)
    if how == 4:
        return source.choice((low, high))
    if how == 5:
        return min(max(source.integer(-2, 2), low), high)
    if how == 6:
        power = 1 << source.integer(0, max(0, high.bit_length() - 1))
        return min(max(power - source.integer(0, 1), low), high)
    return source.choice((max(low, high - 1), min(high, low + 1)))
