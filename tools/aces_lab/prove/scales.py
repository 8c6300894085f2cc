"""Whether each raw value of a scaled integer comes back: enumerated in vectors, as floats are computed.

1. Up to `MOST` raw values are all computed, with NumPy's float64, which is Python's float; none is left out.
2. Beyond, a bound: a chain × scale + offset and back errs by at most what `error_bound` says, where its premises hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Literal, NamedTuple

import construct as c
import numpy as np

from aces_bus.protocol import BitLayout, Message, Quantity
from aces_bus.protocol.declare.fields import ROUNDING_ERROR, raw_limits
from aces_bus.protocol.declare.normalise import inner_constructs

MOST = 1 << 24
_PIECE = 1 << 20

Limits = tuple[int, int]
#: Operations (× and ÷ as * and /) with their numbers, in order.
Steps = tuple[tuple[str, float], ...]
Status = Literal["proved", "bounded", "sampled", "refuted"]


def scaled_fields(con: c.Construct, name: str = "") -> Iterator[tuple[str, Quantity]]:
    """Yield the scaled integers in a construct, with their names."""
    if isinstance(con, c.Renamed):
        name = con.name or name
    if isinstance(con, Quantity):
        if (con.scale != 1 or con.offset) and raw_limits(con.subcon) is not None:
            yield name, con
    elif isinstance(con, BitLayout):
        for slot in con.slots:
            yield from scaled_fields(slot.field, slot.name)
    else:
        for inner in inner_constructs(con):
            yield from scaled_fields(inner, name)


class ScaleClaim(NamedTuple):
    """Whether each raw value of a field comes back, and the least that does not."""

    field: str
    status: Status
    reason: str = ""
    raw: int | None = None


def scale_claims(message: Message) -> Iterator[ScaleClaim]:
    """Yield a claim for each scaled integer of a payload; equal types and scales are computed once."""
    seen: dict[tuple[Limits, Steps, str], ScaleClaim] = {}
    for name, quantity in scaled_fields(message.payload):
        limits = raw_limits(quantity.subcon)
        assert limits is not None
        scale, offset = quantity.scale, quantity.offset
        steps: list[tuple[str, float]] = [("*", scale)] if scale != 1 else []
        steps += [("+", offset), ("+", -offset)] if offset else []
        steps += [("/", scale)] if scale != 1 else []
        key = limits, tuple(steps), quantity.rounding
        if key not in seen:
            seen[key] = _claim(name, *key)
        claim = seen[key]
        yield claim._replace(field=name, reason=claim.reason and f"{name}: {claim.reason}")


def _claim(name: str, limits: Limits, steps: Steps, rounding: str) -> ScaleClaim:
    """Return whether the raw values of one type, scale and rounding come back."""
    low, high = limits
    if all(isinstance(number, int) for _, number in steps):
        return ScaleClaim(name, "proved")  # integers, which Python computes exactly
    if high - low < MOST:
        if comes_back(limits, steps, rounding):
            return ScaleClaim(name, "proved")
        raw = _lost_value(limits, steps, rounding)
        return ScaleClaim(name, "refuted", f"raw {raw} does not come back ({rounding})", raw)
    bound = error_bound(limits, steps)
    if bound < 0.5:
        return ScaleClaim(name, "bounded", f"{bound:.1g} of a raw unit of float error over {low}…{high}")
    why = f"{low}…{high} {' '.join(f'{operation} {number}' for operation, number in steps)}, {rounding}"
    for at in _places(low, high):
        run = at, at + 9999
        if not comes_back(run, steps, rounding):
            raw = _lost_value(run, steps, rounding)
            return ScaleClaim(name, "refuted", f"{why}: raw {raw} does not come back", raw)
    return ScaleClaim(name, "sampled", why)


def _places(low: int, high: int) -> list[int]:
    """Return the starts of the runs of raw values to try: evenly spaced, at both ends and around zero."""
    step = (high - low - 10000) // 500
    return [*range(low, high - 9999, step), high - 9999, max(low, -5000)]


def _lost_value(limits: Limits, steps: Steps, rounding: str) -> int:
    """Return the least raw value that does not come back."""
    low, high = limits
    while high > low:
        middle = (low + high) // 2
        if comes_back((low, middle), steps, rounding):
            low = middle + 1
        else:
            high = middle
    return low


@lru_cache(maxsize=4096)
def comes_back(limits: Limits, steps: Steps, rounding: str) -> bool:
    """Return whether rounding the last of `steps` gives every raw number in `limits` again."""
    low, high = limits
    if high - low >= MOST:
        return (
            error_bound(limits, steps) < 0.5
        )  # so small an error `truncated` rounds away, too; see `error_bound`
    for start in range(low, high + 1, _PIECE):
        raw = np.arange(start, min(high + 1, start + _PIECE), dtype=np.int64)
        found = raw.astype(np.float64)
        for operation, number in steps:
            if isinstance(number, int):
                number = float(number)
            found = (
                found * number if operation == "*" else found / number if operation == "/" else found + number
            )
        whole = np.rint(found)
        if rounding != "nearest":  # as `truncated` has it
            near = np.abs(found - whole) <= ROUNDING_ERROR * (np.abs(found) + shift_of(steps))
            whole = np.where(near, whole, np.trunc(found))
        if not bool((whole == raw).all()):
            return False
    return True


def shift_of(steps: Steps) -> float:
    """Return the size of the offset in raw numbers, of steps that end with − offset ÷ scale."""
    numbers = dict(steps)
    return abs(numbers.get("+", 0.0) / numbers.get("/", 1.0))


def error_bound(limits: Limits, steps: Steps) -> float:
    """Return a bound on how far the last of `steps` is from the raw number, in raw units; infinite where a premise fails.

    Premises: the steps are × scale, + offset, + −offset, ÷ scale; raw numbers below 2**53; no overflow, no subnormal
    number. Each operation errs by at most half a unit in the last place of its result: u = 2**-53 of its magnitude.
    For one raw number r the error is below 5 u (|r| + |offset ÷ scale|), a third of what `truncated` takes for rounding
    error (`ROUNDING_ERROR`, 16 u): where the bound is below one half, truncating gives r as rounding does.
    """
    most = float(max(abs(limits[0]), abs(limits[1])))
    if most > 1 << 53:
        return math.inf
    operations = [operation for operation, _ in steps]
    numbers = [number for _, number in steps]
    if operations == ["*", "/"]:
        scale, offset = numbers[0], 0.0
        if numbers[1] != scale:
            return math.inf
    elif operations == ["*", "+", "+", "/"]:
        scale, offset = numbers[0], numbers[1]
        if numbers[2] != -offset or numbers[3] != scale:
            return math.inf
    elif operations == ["+", "+"] and numbers[0] == -numbers[1]:
        scale, offset = 1.0, numbers[0]
    else:
        return math.inf
    unit = 2.0**-53
    product = most * abs(scale)
    total = product + abs(offset)
    if not abs(scale) > 1e-250 or not total * 4 < 1e300:
        return math.inf
    absolute = (
        2 * unit * (product + total + total + unit * total * 4)
    )  # of the product, the sum, the difference; doubled
    return absolute / abs(scale) * (1 + 4 * unit) + 2 * unit * most
