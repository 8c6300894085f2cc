"""Whether each raw value of a scaled integer comes back: enumerated in vectors, as floats are computed.

1. Up to `MOST` raw values are all computed, with NumPy's float64, which is Python's float; none is left out.
2. Beyond, a bound: a chain × scale + offset and back errs by at most what `error_bound` says, where its premises hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, Literal

import construct as c
import numpy as np

from aces_bus.protocol import BitLayout, Message, Quantity
from aces_bus.protocol.declare.fields import ROUNDING_ERROR
from aces_bus.protocol.declare.normalise import inner_constructs
from aces_bus.protocol.declare.wire_number import raw_limits

MOST = 1 << 24
_PIECE = 1 << 20

Status = Literal["proved", "bounded", "sampled", "refuted"]


def scaled_fields(con: Any, name: str = "") -> Iterator[tuple[str, Quantity]]:
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


def scale_claims(message: Message) -> Iterator[tuple[str, Status, str]]:
    """Yield (field, status, reason) for each scaled integer of a payload: whether each raw value comes back."""
    seen: dict[tuple[Any, ...], tuple[Status, str]] = {}
    for name, quantity in scaled_fields(message.payload):
        limits = raw_limits(quantity.subcon)
        assert limits is not None
        scale, offset = quantity.scale, quantity.offset
        steps: list[tuple[str, float]] = [("*", scale)] if scale != 1 else []
        steps += [("+", offset), ("+", -offset)] if offset else []
        steps += [("/", scale)] if scale != 1 else []
        key = limits, tuple(steps), quantity.rounding
        if key not in seen:
            if all(isinstance(number, int) for _, number in steps):
                seen[key] = "proved", ""  # integers, which Python computes exactly
            elif limits[1] - limits[0] < MOST:
                good = comes_back(*key)
                seen[key] = ("proved", "") if good else ("refuted", _lost_value(*key))
            elif error_bound(limits, tuple(steps)) < 0.5 and quantity.rounding == "nearest":
                bound = error_bound(limits, tuple(steps))
                seen[key] = (
                    "bounded",
                    f"{bound:.1g} of a raw unit of float error over {limits[0]}…{limits[1]}",
                )
            else:
                good = all(comes_back((at, at + 9999), key[1], quantity.rounding) for at in _places(*limits))
                why = f"{limits[0]}…{limits[1]} × {scale} + {offset}, {quantity.rounding}"
                seen[key] = (
                    ("sampled", why) if good else ("refuted", f"{why}: a raw value does not come back")
                )
        yield name, *seen[key]


def _places(low: int, high: int) -> list[int]:
    """Return the starts of the runs of raw values to try: evenly spaced, at both ends and around zero."""
    step = (high - low - 10000) // 500
    return [*range(low, high - 9999, step), high - 9999, max(low, -5000)]


def _lost_value(limits: tuple[int, int], steps: tuple[tuple[str, float], ...], rounding: str) -> str:
    """Return the least raw value that does not come back."""
    low, high = limits
    while high > low:
        middle = (low + high) // 2
        if comes_back((low, middle), steps, rounding):
            low = middle + 1
        else:
            high = middle
    return f"raw {low} does not come back ({rounding})"


@lru_cache(maxsize=4096)
def comes_back(limits: tuple[int, int], steps: tuple[tuple[str, float], ...], rounding: str) -> bool:
    """Return whether rounding the last of `steps` gives every raw number in `limits` again."""
    low, high = limits
    if high - low >= MOST:
        return error_bound(limits, steps) < (0.5 if rounding == "nearest" else 0)
    for start in range(low, high + 1, _PIECE):
        raw: Any = np.arange(start, min(high + 1, start + _PIECE), dtype=np.int64)
        found = raw.astype(np.float64)
        for operation, number in steps:
            if isinstance(number, int):
                number = float(number)
            found = (
                found * number if operation == "*" else found / number if operation == "/" else found + number
            )
        whole = np.rint(found)
        if rounding != "nearest":  # as `truncated` has it
            near = np.abs(found - whole) <= ROUNDING_ERROR * (np.abs(found) + _shift(steps))
            whole = np.where(near, whole, np.trunc(found))
        if not bool((whole == raw).all()):
            return False
    return True


def _shift(steps: tuple[tuple[str, float], ...]) -> float:
    """Return the size of the offset in raw numbers, of steps that end with − offset ÷ scale."""
    numbers = dict(steps)
    return abs(numbers.get("+", 0.0) / numbers.get("/", 1.0))


def error_bound(limits: tuple[int, int], steps: tuple[tuple[str, float], ...]) -> float:
    """Return a bound on how far the last of `steps` is from the raw number, in raw units; infinite where a premise fails.

    Premises: the steps are × scale, + offset, + −offset, ÷ scale; raw numbers below 2**53; no overflow, no subnormal
    number. Each operation errs by at most half a unit in the last place of its result: u = 2**-53 of its magnitude.
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
