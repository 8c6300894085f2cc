"""What a piece of a payload is, by what its values do: counter, text, float, flag, enumeration, number; and its sign.

1. A counter is what has the next number in almost every message, bit by bit from the lowest: nothing else looks like it.
2. Thresholds are shares of messages, and the same for every recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from aces_bus._lazy import np

from .checks import checks_of
from .fields import STEPS, Array, ByteOrder, FieldGuess, FieldKind, Rows, above, positions_of
from .keyed_checks import keyed_checks

#: Different values from which on something may be said, and from which on of a sign.
VALUES, SIGNED = 12, 5
#: The share of steps that a counter counts, and that its higher bits are wrong in.
COUNTS, SLIPS = 0.8, 0.2
#: Shares of steps between which a bit that changes may be noise.
NOISY = 0.35, 0.9
#: Values of an enumeration, and its bits.
NAMES, NAME_BITS = 10, 8
#: Characters of a text, and the share of them that must be some.
CHARACTERS, PRINTABLE = 3, 0.95
#: Exponents of float32 of what devices measure: 2^-30 … 2^34, and how far those of one field may lie apart.
EXPONENTS, SPREAD = (97, 161), 12


def plain_fields(sample: Rows, rows: Array | None, prefix: bytes | Array) -> list[FieldGuess]:
    """Find checks, text, counters and floats: fields known without their neighbours. Checks are sought in `rows`."""
    found: list[FieldGuess] = []
    free = np.ones(8 * sample.size, bool)
    for make in (
        lambda *_: _checks(rows, prefix),
        _texts,
        _counters,
        lambda *_: _keyed_checks(rows, found),
        _floats,
    ):
        for field in make(sample, free):
            if free[list(field.positions)].all():
                found.append(field)
                free[list(field.positions)] = False
    return found


def _keyed_checks(rows: Array | None, found: list[FieldGuess]) -> Iterator[FieldGuess]:
    """Yield the check whose id a counter chooses, where there is a counter and no other check."""
    if rows is None or any(field.kind == "check" for field in found):
        return
    for counter in [field for field in found if field.kind == "counter"][:2]:
        yield from keyed_checks(rows, counter)


def _checks(rows: Array | None, prefix: bytes | Array) -> Iterator[FieldGuess]:
    for field in checks_of(rows, prefix) if rows is not None else ():
        order: ByteOrder = "big" if field.size > 1 and field.check.order == "big" else "little"
        start = 8 * (field.offset + (field.size - 1 if order == "big" else 0))
        yield FieldGuess(start, 8 * field.size, order, "check", field.confidence, field.evidence, check=field)


# ---------------------------------------------------------------------- text


def _texts(sample: Rows, free: Array) -> Iterator[FieldGuess]:
    data = sample.bytes
    printable = ((data >= 32) & (data < 127)) | np.isin(data, (0, 9, 10, 13))
    letters = ((data | 32) >= 97) & ((data | 32) <= 122) | ((data >= 48) & (data <= 57)) | (data == 32)
    good = (printable.mean(axis=0) >= PRINTABLE) & (letters.mean(axis=0) >= 0.3)
    byte = 0
    while byte < sample.size:
        end = byte
        while end < sample.size and good[end]:
            end += 1
        if end - byte >= CHARACTERS and letters[:, byte:end].mean() > 0.6 and _is_various(data[:, byte:end]):
            example = "".join(chr(c) if 32 <= c < 127 else "·" for c in data[0, byte:end].tolist())
            evidence = f"characters, {example!r} first"
            sure = 0.8 * sample.total / (sample.total + 4)
            yield FieldGuess(8 * byte, 8 * (end - byte), "little", "text", sure, evidence)
        byte = max(end, byte + 1)


def _is_various(data: Array) -> bool:
    """Return whether there are letters, and more different ones than numbers in a small range would be."""
    is_letter = ((data | 32) >= 97) & ((data | 32) <= 122)
    return bool(is_letter.mean() > 0.2 and len(np.unique(data)) >= CHARACTERS + 2)


# ---------------------------------------------------------------------- counters


def _counters(sample: Rows, free: Array) -> Iterator[FieldGuess]:
    if sample.steps < STEPS:
        return
    for bit in np.flatnonzero(sample.varies & (sample.rates >= COUNTS)).tolist():
        grown = [_grown(sample, bit, order) for order in _ORDERS]
        positions, step, order = max(grown, key=lambda run: len(run[0]))
        if len(positions) < 2:
            continue
        before, after = sample.pairs(sample.values(positions))
        span = np.uint64((1 << len(positions)) - 1)
        right = float(((after - before & span) == np.uint64(step)).mean())
        shown = step if step <= int(span) // 2 else step - int(span) - 1
        evidence = f"counts by {shown:+d} in {right:.1%} of {sample.steps} steps"
        yield FieldGuess(
            bit, len(positions), order if positions[0] // 8 != positions[-1] // 8 else "little",
            "counter", min(0.99, right * sample.steps / (sample.steps + 2)), evidence, value=shown,
            modulus=_modulus(before, after) if shown == 1 else 0,
        )  # fmt: skip


def _modulus(before: Array, after: Array) -> int:
    """Return the number at which a counter begins anew at 0; 0 where it never does, or not always there."""
    highest = before.max()
    return (
        int(highest) + 1
        if len(before) and highest == after.max() and (after[before == highest] == 0).mean() > COUNTS
        else 0
    )


_ORDERS: tuple[ByteOrder, ...] = ("little", "big")


def _grown(sample: Rows, bit: int, order: ByteOrder) -> tuple[list[int], int, ByteOrder]:
    """Return a counter from its lowest bit: every further bit changes where those below carry into it."""
    positions, step = [bit], 1
    while len(positions) < 64:
        nxt = above(positions[-1], order)
        if not 0 <= nxt < len(sample.varies) or not sample.varies[nxt]:
            break
        width = len(positions)
        before, _ = sample.pairs(sample.values(positions))
        carries = (before + np.uint64(step) >> np.uint64(width)) & np.uint64(1) == 1
        old, new = sample.pairs(sample.bits[:, nxt])
        flips = old != new
        if carries.sum() < 2 or carries.all():
            break
        if flips[carries].mean() >= COUNTS and flips[~carries].mean() <= SLIPS:
            pass
        elif flips[carries].mean() <= SLIPS and flips[~carries].mean() >= COUNTS:
            step += 1 << width
        else:
            break
        positions.append(nxt)
    return positions, step, order


# ---------------------------------------------------------------------- floats


def _floats(sample: Rows, free: Array) -> Iterator[FieldGuess]:
    at = 0
    while at + 4 <= sample.size:
        found = None
        if free[8 * at : 8 * at + 32].all() and sample.varies[8 * at : 8 * at + 32].any():
            found = max(
                (_float_at(sample, at, order) for order in _ORDERS), key=lambda guess: guess.confidence
            )
        if found is not None and found.confidence > 0:
            yield found
            at += 4
        else:
            at += 1


def _float_at(sample: Rows, byte: int, order: ByteOrder) -> FieldGuess:
    start = 8 * byte if order == "little" else 8 * (byte + 3)
    positions = positions_of(start, 32, order)
    words = sample.values(positions).astype(np.uint32)
    exponents = (words >> 23 & 0xFF)[words << np.uint32(1) != 0]
    nothing = FieldGuess(start, 32, order, "float", 0.0, "")
    if len(np.unique(words)) < VALUES or len(exponents) < STEPS:
        return nothing
    low, high = np.quantile(exponents, (0.02, 0.98))
    fits = ((exponents >= EXPONENTS[0]) & (exponents <= EXPONENTS[1])).mean()
    mantissa = sample.varies[list(positions[:23])].mean()
    if (
        fits < 0.98
        or high - low > SPREAD
        or mantissa < 0.6
        or not sample.varies[list(positions[20:31])].any()
    ):
        return nothing
    numbers = words.view(np.float32).astype(np.float64)
    before, after = sample.pairs(numbers)
    size = np.median(np.abs(numbers)) + 1e-30
    smooth = float(np.median(np.abs(after - before)) / size) if len(before) else 0.0
    rates = sample.rates[list(positions)]
    falling = rates[:16].mean() > rates[16:23].mean() > rates[23:31].mean()
    if smooth > 0.5 or not (falling or (rates[:8] == 0).all()):
        return nothing
    evidence = f"IEEE 754 numbers from {numbers.min():.4g} to {numbers.max():.4g}"
    evidence += f", exponents {low - 127:.0f} to {high - 127:.0f}"
    return FieldGuess(start, 32, order, "float", 0.9 if smooth < 0.2 else 0.7, evidence, signed=True)


# ---------------------------------------------------------------------- what is left


def classified(sample: Rows, piece: tuple[list[int], ByteOrder]) -> FieldGuess:
    """Return bits that belong together as the kind of field that their values suggest."""
    positions, order = piece
    width, start = len(positions), positions[0]
    if width > 64:
        return FieldGuess(start, width, order, "number", 0.1, "changes like nothing that is known")
    words = sample.values(positions)
    before, after = sample.pairs(words)
    moves = int((before != after).sum())
    if width == 1:
        evidence = f"one bit, changes in {moves} of {sample.steps} steps"
        # Where it is another in every second message it may be the lowest bit of something.
        is_noise = NOISY[0] * sample.steps < moves < NOISY[1] * sample.steps
        return FieldGuess(start, 1, order, "flag", 0.9 if moves and not is_noise else 0.5, evidence)
    different = np.unique(words)
    if sample.steps < STEPS:
        return FieldGuess(
            start, width, order, "number", 0.2, f"{len(different)} values in {sample.total} messages"
        )
    kind, confidence, evidence = _kind(width, different, before, after, moves, sample.steps)
    signed, why = False, ""
    if kind == "number" and len(different) >= SIGNED:
        signed, why = _sign(words, before, after, width)
    return FieldGuess(
        start, width, order, kind, confidence, f"{evidence}{why}", signed,
        values=tuple(different.tolist()) if kind == "enumeration" else (),
    )  # fmt: skip


def with_all_values(field: FieldGuess, rows: Array) -> FieldGuess:
    """Return an enumeration with the values that it has in all rows, not in a sample only; with too many of them it is
    a number.
    """
    if field.kind != "enumeration":
        return field
    seen = np.zeros(len(rows), np.int64)
    for to, at in enumerate(field.positions):
        seen |= (rows[:, at // 8] >> at % 8 & 1).astype(np.int64) << to
    values = tuple(np.flatnonzero(np.bincount(seen)).tolist())
    if len(values) > NAMES:
        return replace(
            field, kind="number", values=(), evidence=f"{len(values)} values, of which few occur often"
        )
    return replace(field, values=values)


def _kind(
    width: int, different: Array, before: Array, after: Array, moves: int, steps: int
) -> tuple[FieldKind, float, str]:
    said = f"{len(different)} values, changes in {moves} of {steps} steps"
    if width <= NAME_BITS and len(different) <= NAMES:
        span = (1 << width) - 1
        step = (after - before & np.uint64(span)).astype(np.int64)
        near = np.minimum(step, span + 1 - step)[before != after]
        is_slow = moves <= 0.3 * max(1, steps)
        if len(different) <= 4 or (is_slow and (not len(near) or (near > 1).mean() > 0.2)):
            return "enumeration", 0.7 if is_slow else 0.5, said
    return "number", 0.8 if len(different) >= VALUES else 0.5, said


def _sign(words: Array, before: Array, after: Array, width: int) -> tuple[bool, str]:
    """Return whether a number is signed: it passes from its lowest values to its highest, and never through the middle."""
    if width < 4:
        return False, ""
    quarters = np.bincount((words >> np.uint64(width - 2)).astype(np.int64), minlength=4)[:4] / max(
        1, len(words)
    )
    if not (quarters[0] and quarters[3]):
        return False, ""
    plain, turned = _length(before, after, width, False), _length(before, after, width, True)
    middle = float(quarters[1] + quarters[2])
    if plain - turned > 1.5 * width or (middle < 0.02 and min(quarters[0], quarters[3]) > 0.005):
        return True, f"; signed: goes through 0, {quarters[2] + quarters[3]:.0%} of the values are below"
    return False, ""


def _length(before: Array, after: Array, width: int, signed: bool) -> float:
    """Return the way that a number goes in all, in bits, read with or without a sign."""
    old, new = before.astype(np.float64), after.astype(np.float64)
    if signed:
        half, span = 2.0 ** (width - 1), 2.0**width
        old, new = np.where(old >= half, old - span, old), np.where(new >= half, new - span, new)
    return float(np.log2(1 + np.abs(new - old)).sum())
