"""Whether a number moves as a quantity does, or as if its bytes, its parts or its sign were read the wrong way.

1. Nothing is assumed of the quantity but that it is smooth: from one message of a device to the next it mostly moves little.
2. A number is suspect only when another reading of the same bits is far smoother, on most of its steps, over many values.
   What jumps in every reading (noise, bit fields, checks) is left alone.
3. Steps are summed up as they come: memory does not grow with the recording.

A step's size is its bits, log2(1 + |step|): a byte in the wrong place costs 8 of them. A sign that is read wrongly shows
where the number passes zero, as a jump over almost all of its range; the quarters of the range before and after it say which
sign would be right.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..columns.table import Array
from ..declare.bits import runs_of
from ..plan import nodes as p

#: Fewer steps, or fewer different values, say nothing.
STEPS, VALUES = 16, 12
#: How many bits smaller the steps of another reading must be, and on which share of them.
GAP_BITS, SHARE = 3.0, 0.75
#: The share of long jumps that another sign must explain.
EXPLAINED = 0.9
#: Different values on each side of a jump that a sign explains.
SIDES = 3
#: Different values that are remembered.
KEPT = 64
#: So many powers of two a float must jump more than in the other byte order.
FACTOR_BITS = 12.0


class BitReading(NamedTuple):
    """Another way to read the bits of a number: in words, and as a function of its bits (uint64) to float64."""

    words: str
    read: Callable[[Array], Array]


@dataclass(frozen=True)
class Suspicion:
    """What a number's steps say: how many of how many, in words, and what would be right."""

    count: int
    total: int
    text: str
    remedy: str


def bits_of(node: p.Node, values: Array) -> Array:
    """Return raw integers as the bits on the wire, uint64."""
    width = len(node.place)
    if node.is_magnitude:
        numbers = values.astype(np.int64)
        return np.abs(numbers).astype(np.uint64) | np.where(
            numbers < 0, np.uint64(1 << width - 1), np.uint64(0)
        )
    return (
        values.astype(np.int64).astype(np.uint64) & _mask(width)
        if values.dtype.kind == "i"
        else values.astype(np.uint64)
    )


def as_numbers(node: p.Node, words: Array) -> Array:
    """Return bits as the numbers that the spec makes of them, float64."""
    width = len(node.place)
    if node.is_magnitude:
        return _magnitude(words, width)
    return _signed(words, width) if is_signed(node) else words.astype(np.float64)


def is_signed(node: p.Node) -> bool:
    """Return whether raw values of a number may be negative."""
    return node.raw_range is not None and node.raw_range[0] < 0


def _mask(width: int) -> np.uint64:
    return np.uint64((1 << width) - 1)


def _signed(words: Array, width: int) -> Array:
    numbers = words.astype(np.float64)
    return np.where(words >> np.uint64(width - 1), numbers - 2.0**width, numbers)


def _magnitude(words: Array, width: int) -> Array:
    numbers = (words & _mask(width - 1)).astype(np.float64)
    return np.where(words >> np.uint64(width - 1), -numbers, numbers)


def readings_of(node: p.Node) -> list[BitReading]:
    """Return the other ways to read an integer's bytes or parts, most likely first; the spec's own sign is kept."""
    width = len(node.place)

    def by_bytes(order: tuple[int, ...]) -> Callable[[Array], Array]:
        def read(words: Array) -> Array:
            out = np.zeros_like(words)
            for to, come_from in enumerate(order):
                out |= (words >> np.uint64(8 * come_from) & np.uint64(0xFF)) << np.uint64(8 * to)
            return as_numbers(node, out)

        return read

    def swapped(low: int) -> Callable[[Array], Array]:
        return lambda words: as_numbers(
            node, (words & _mask(low)) << np.uint64(width - low) | words >> np.uint64(low)
        )

    if not node.is_whole:
        first, *others = runs_of(node.place)
        return [BitReading("with its two parts swapped", swapped(first[2]))] if len(others) == 1 else []
    size = width // 8
    if size < 2:
        return []
    found = [BitReading("in the other byte order", by_bytes(tuple(reversed(range(size)))))]
    if size > 2 and not size % 2:
        words = [(2 * n, 2 * n + 1) for n in range(size // 2)]
        for shift in range(1, len(words)):
            order = sum(words[shift:] + words[:shift], ())
            found.append(BitReading(f"with its halves at bit {16 * shift} swapped", by_bytes(order)))
        pairs = sum(((high, low) for low, high in words), ())
        found.append(BitReading("with the bytes of each 16-bit word swapped", by_bytes(pairs)))
    return found


#: (how the spec reads it, the two quarters of the range that neighbours are in): how it should be read, and what must be
#: empty for that. Quarters are those of the bits as an unsigned number.
_SIGNS: dict[tuple[str, tuple[int, int]], tuple[str, tuple[int, ...]]] = {
    ("unsigned", (0, 3)): ("two's complement", (1, 2)),
    ("unsigned", (0, 2)): ("sign and magnitude", (1, 3)),
    ("two's complement", (1, 2)): ("unsigned", ()),
    ("two's complement", (0, 2)): ("sign and magnitude", (1, 3)),
    ("sign and magnitude", (0, 3)): ("two's complement", (1, 2)),
}
_READ: dict[str, Callable[[Array, int], Array]] = {
    "unsigned": lambda words, _: words.astype(np.float64),
    "two's complement": _signed,
    "sign and magnitude": _magnitude,
}
_CONSTRUCTS = {
    "unsigned": "an unsigned construct (Int…u…, bits(…))",
    "two's complement": "a signed construct (Int…s…, bits(…, signed=True))",
    "sign and magnitude": "SignMagnitude",
}


class IntegerSteps:
    """The steps of an integer field."""

    def __init__(self, node: p.Node) -> None:
        self.node = node
        self.width = len(node.place)
        self.sign = (
            "sign and magnitude"
            if node.is_magnitude
            else "two's complement"
            if is_signed(node)
            else "unsigned"
        )
        self.readings = readings_of(node)
        self._steps = 0
        self._bits = np.zeros(1 + len(self.readings))
        self._wins = np.zeros(len(self.readings), np.int64)
        self._values: set[int] = set()
        #: All bits that were ever set.
        self._seen = 0
        self._quarters = np.zeros(4, np.int64)
        self._sides: list[set[int]] = [set(), set(), set(), set()]
        #: Jumps over half the range, and those that another sign would explain, by the quarters (from, to).
        self._long = 0
        self._jumps: dict[tuple[int, int], int] = {}
        #: Steps to the next number, and those of them from the highest number to 0.
        self._rises = self._anew = 0

    def take(self, values: Array, before: Array, after: Array) -> None:
        """Take the raw values of a piece of the recording, and those that follow each other."""
        words = bits_of(self.node, values)
        self._seen |= int(np.bitwise_or.reduce(words)) if len(words) else 0
        if len(self._values) < KEPT:
            self._values.update(np.unique(words)[:KEPT].tolist())
        quarter = (words >> np.uint64(self.width - 2)).astype(np.int64)
        self._quarters += np.bincount(quarter, minlength=4)[:4]
        for number, side in enumerate(self._sides):
            if len(side) < SIDES:
                side.update(np.unique(words[quarter == number])[:SIDES].tolist())
        moved = before != after
        if not moved.any():
            return
        old, new = bits_of(self.node, before[moved]), bits_of(self.node, after[moved])
        self._steps += len(old)
        rises = (new - old & _mask(self.width)) == 1
        self._rises += int(rises.sum())
        self._anew += int((rises & (new == 0)).sum())
        own = step_bits(as_numbers(self.node, old), as_numbers(self.node, new))
        self._bits[0] += own.sum()
        for number, reading in enumerate(self.readings):
            other = step_bits(reading.read(old), reading.read(new))
            self._bits[1 + number] += other.sum()
            self._wins[number] += int((other < own - 1).sum())
        self._long += int((own >= self.width - 1).sum())
        self._take_jumps(old, new)

    def _take_jumps(self, old: Array, new: Array) -> None:
        shift = np.uint64(self.width - 2)
        come_from, to = (old >> shift).astype(np.int64), (new >> shift).astype(np.int64)
        for (sign, (low, high)), (right, _) in _SIGNS.items():
            if sign != self.sign:
                continue
            read = _READ[right]
            small = np.abs(read(new, self.width) - read(old, self.width)) < 2.0 ** (self.width - 3)
            for quarter, other in ((low, high), (high, low)):
                number = int((small & (come_from == quarter) & (to == other)).sum())
                self._jumps[quarter, other] = self._jumps.get((quarter, other), 0) + number

    @property
    def counts_up(self) -> bool:
        """True if almost every message has the next number, and enough messages were seen to rule out chance."""
        return self._steps >= STEPS and self._rises >= 0.95 * self._steps

    @property
    def wraps(self) -> bool:
        """True if a number that counts up has begun anew behind its highest one: then it is no time and no total."""
        return self._anew > 0

    def suspicion(self) -> Suspicion | None:
        """Return what the steps say against the spec; None when they say nothing."""
        return self._of_order() or self._of_sign()

    def _of_order(self) -> Suspicion | None:
        if self._steps < STEPS or len(self._values) < VALUES:
            return None
        mean = self._bits / self._steps
        fitting = [
            number
            for number in range(len(self.readings))
            if mean[0] - mean[1 + number] >= GAP_BITS
            and self._wins[number] >= SHARE * self._steps
            and mean[1 + number] <= self.width - 4
        ]
        if not fitting:
            return None
        best = min(fitting, key=lambda number: mean[1 + number])
        if not self._seen & 0xFF and not self._is_plainly_reversed(best, mean):
            return None
        words, wins = self.readings[best].words, int(self._wins[best])
        return Suspicion(
            wins,
            self._steps,
            f"moves by {_typical(mean[0])} from message to message; {words} by {_typical(mean[1 + best])}",
            f"read it {words}",
        )

    def _is_plainly_reversed(self, best: int, mean: Array) -> bool:
        """Return whether a number whose low byte is always 0 is long and in the other byte order, not one in
        large steps.
        """
        others = np.delete(mean[1:], best)
        return (
            best == 0
            and len(others) > 0
            and bool((others - mean[1] >= 1).all())
            and sum(bool(self._seen >> at & 0xFF) for at in range(0, self.width, 8)) > 1
        )

    def _of_sign(self) -> Suspicion | None:
        for (sign, (low, high)), (right, empty) in _SIGNS.items():
            there, back = self._jumps.get((low, high), 0), self._jumps.get((high, low), 0)
            if (
                sign == self.sign
                and there
                and back
                and there + back >= EXPLAINED * self._long
                and len(self._sides[low]) >= SIDES
                and len(self._sides[high]) >= SIDES
                and not any(self._quarters[quarter] for quarter in empty)
                and self._may_be_signed
                and (right != "sign and magnitude" or self.node.scale is not None)
            ):
                return Suspicion(
                    there + back,
                    self._steps,
                    f"is read as {sign}, and jumps over its range {there + back} times, both ways; as {right} it does not",
                    f"use {_CONSTRUCTS[right]}",
                )
        return None

    @property
    def _may_be_signed(self) -> bool:
        """Not so for short numbers without a scale, which are seldom quantities, and for angles that go around."""
        scale = self.node.scale
        if scale is None:
            return self.width >= 16
        turn = {"°": 360.0, "deg": 360.0, "rad": 2 * math.pi, "turn": 1.0, "rev": 1.0}.get(self.node.unit)
        return turn is None or not math.isclose(abs(scale.scale) * 2.0**self.width, turn, rel_tol=0.01)


def step_bits(old: Array, new: Array) -> Array:
    bits: Array = np.log2(1 + np.abs(new - old))
    return bits


def _typical(bits: float) -> str:
    return f"{max(1.0, 2.0**bits - 1):,.0f}" if bits < 50 else f"2^{bits:.0f}"


class FloatSteps:
    """The steps of a floating-point field, by its magnitude: the exponent of a float whose bytes are reversed is noise."""

    counts_up = False

    def __init__(self, node: p.Node) -> None:
        self._dtype = np.dtype(f"f{len(node.place) // 8}")
        self._values: set[float] = set()
        self._steps = 0
        #: Sums of the changes in magnitude, in bits: as the spec reads it, and in the other byte order.
        self._bits = np.zeros(2)
        self._wins = 0

    def take(self, values: Array, before: Array, after: Array) -> None:
        """Take the values of a piece of the recording, and those that follow each other."""
        if len(self._values) < KEPT:
            self._values.update(np.unique(values)[:KEPT].tolist())
        moved = (before != after) & (before != 0) & (after != 0)
        with np.errstate(over="ignore", invalid="ignore"):
            old, new = before[moved].astype(self._dtype), after[moved].astype(self._dtype)
        own = np.abs(_magnitude_bits(new) - _magnitude_bits(old))
        other = np.abs(_magnitude_bits(new.byteswap()) - _magnitude_bits(old.byteswap()))
        self._steps += len(old)
        self._bits += own.sum(), other.sum()
        self._wins += int((other < own - 1).sum())

    def suspicion(self) -> Suspicion | None:
        """Return what the steps say against the spec; None when they say nothing."""
        if self._steps < STEPS or len(self._values) < VALUES or self._wins < SHARE * self._steps:
            return None
        own, other = self._bits / self._steps
        if own - other < FACTOR_BITS or other > GAP_BITS:
            return None
        return Suspicion(
            self._wins,
            self._steps,
            f"changes 2^{own:.0f}-fold from message to message; in the other byte order 2^{other:.1f}-fold",
            "read it in the other byte order",
        )


def _magnitude_bits(values: Array) -> Array:
    """Return log2 of the size of floats; 0 and what is not a number are as far from all others as can be."""
    with np.errstate(divide="ignore", invalid="ignore"):
        bits = np.log2(np.abs(values.astype(np.float64)))
    found: Array = np.nan_to_num(bits, nan=1024.0, posinf=1024.0, neginf=-1074.0)
    return found


def steps_of(node: p.Node) -> IntegerSteps | FloatSteps | None:
    """Return what watches a field's steps; None for what is not a number, or has names or flags."""
    if not node.is_number or node.is_captured or node.flags or node.enumerated:
        return None
    if node.is_float:
        return FloatSteps(node) if len(node.place) in (32, 64) and node.is_whole else None
    return IntegerSteps(node) if node.raw_range is not None and 4 <= len(node.place) <= 64 else None
