"""A number in a message that says what the rest of it means.

1. Messages with the same number follow each other smoothly, where in the order of the recording they jump: that is what a
   multiplexer does, and what is measured. A counter makes its neighbours no smoother.
2. The fields behind it are found among the messages of each number by themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from aces_bus._lazy import np

from .fields import STEPS, Array, FieldGuess, Rows

#: Numbers of a multiplexer, and the share of steps in which it changes.
NUMBERS, CHANGES = 32, 0.15
#: A bit is explained that changes in this share of steps from one number to another, and among messages of one number in so
#: much of that share. So many bits must be, and no more of them may change more often instead.
OFTEN, LEFT, BITS = 0.1, 0.5, 4


def selector_of(sample: Rows, plain: Sequence[FieldGuess]) -> FieldGuess | None:
    """Return the multiplexer among the bytes, the nibbles and the counters of a message; None where none explains the rest.

    `plain` are fields that are known: counters and checks, whose changes need no explanation.
    """
    if sample.steps < 4 * STEPS:
        return None
    explained = np.zeros(8 * sample.size, bool)
    for field in plain:
        explained[list(field.positions)] = True
    best: tuple[float, FieldGuess] | None = None
    for candidate in _candidates(sample, plain, explained):
        others = sample.varies & ~explained
        others[list(candidate.positions)] = False
        values = sample.values(candidate.positions)
        numbers, counts = np.unique(values, return_counts=True)
        before, after = sample.pairs(values)
        if not (
            2 <= len(numbers) <= NUMBERS and counts.min() >= STEPS and (before != after).mean() >= CHANGES
        ):
            continue
        old, new = sample.pairs(sample.bits[:, others])
        usual = (old != new)[before != after].mean(axis=0)
        bits = sample.bits[np.argsort(values, kind="stable")][:, others]
        grouped = (bits[1:] != bits[:-1]).mean(axis=0)
        count = int(((usual >= OFTEN) & (grouped <= LEFT * usual)).sum())
        worse = int((grouped > 1.3 * usual + 0.02).sum())
        gain = float((usual - grouped).sum())
        if (
            count < BITS
            or worse > count / 2
            or (best is not None and gain <= best[0] + 0.05 * float(usual.sum()))
        ):
            continue
        said = f"among messages of one value {count} of {len(usual)} other bits change far less"
        made = replace(
            candidate,
            kind="multiplexer",
            confidence=min(0.95, 0.5 + 0.05 * count),
            evidence=f"{len(numbers)} values; {said}",
            values=tuple(numbers.tolist()),
            value=None,
            modulus=0,
        )
        best = gain, made
    return None if best is None else best[1]


def _candidates(sample: Rows, plain: Sequence[FieldGuess], explained: Array) -> list[FieldGuess]:
    found = [field for field in plain if field.kind == "counter" and field.length <= 8]
    for byte in range(sample.size):
        for start, length in ((0, 8), (0, 4), (4, 4)):
            bits = range(8 * byte + start, 8 * byte + start + length)
            if sample.varies[bits].any() and not explained[bits].any():
                found.append(FieldGuess(bits[0], length, "little", "multiplexer", 0.0, ""))
                break
    return sorted(found, key=lambda field: field.start)
