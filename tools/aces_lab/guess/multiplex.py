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
#: An opcode in the first byte: the share of messages whose opcode occurs often enough, and the share of all bits (in each
#: kind of message) that never change in their kind, though they do in others.
USUAL, STILL = 0.9, 0.15


def selector_of(sample: Rows, plain: Sequence[FieldGuess]) -> FieldGuess | None:
    """Return the multiplexer among the bytes, the nibbles and the counters of a message; None where none explains the rest.

    `plain` are fields that are known: counters and checks, whose changes need no explanation.
    """
    if sample.steps < 4 * STEPS:
        return None
    explained = np.zeros(8 * sample.size, bool)
    for field in plain:
        explained[list(field.positions)] = True
    opcode = _opcode(sample, explained)
    if opcode is not None:
        return opcode
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


def _opcode(sample: Rows, explained: Array) -> FieldGuess | None:
    """Return the first byte where it says which kind of message it is: kinds follow each other at once, and bits that change
    in one never do in another. Rare kinds have no fields of their own.
    """
    values = sample.bytes[:, 0]
    numbers, counts = np.unique(values, return_counts=True)
    usual = numbers[counts >= STEPS]
    before, after = sample.pairs(values)
    if (
        explained[:8].any()
        or not 2 <= len(usual) <= NUMBERS
        or counts[counts >= STEPS].sum() < USUAL * len(values)
        or (before != after).mean() < CHANGES
    ):
        return None
    others = sample.varies & ~explained
    others[:8] = False
    bits = sample.bits[:, others]
    still = np.array([(own == own[0]).all(axis=0) for own in (bits[values == number] for number in usual)])
    if not STILL <= (still.mean() if still.size else 0) < 1:
        return None
    said = f"{len(usual)} values; {still.mean():.0%} of other bits never change in messages of one value, and do in others"
    return FieldGuess(0, 8, "little", "multiplexer", 0.9, said, values=tuple(usual.tolist()))


def _candidates(sample: Rows, plain: Sequence[FieldGuess], explained: Array) -> list[FieldGuess]:
    found = [field for field in plain if field.kind == "counter" and field.length <= 8]
    for byte in range(sample.size):
        for start, length in ((0, 8), (0, 4), (4, 4)):
            bits = range(8 * byte + start, 8 * byte + start + length)
            if sample.varies[bits].any() and not explained[bits].any():
                found.append(FieldGuess(bits[0], length, "little", "multiplexer", 0.0, ""))
                break
    return sorted(found, key=lambda field: field.start)
