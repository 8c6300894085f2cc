"""What the numbers of an MDF 4 channel mean: its conversion.

1. A number is converted as the file says, or it is not a number: NaN is what has no meaning here. The number in the
   record is never used in its place.
2. A conversion that is not read has a `fault`, and signals that depend on it are refused. Formulas are never
   evaluated: they are programs from an unknown source.

Read are: none, linear, rational, tables of values (with and without interpolation), tables of ranges, and tables of texts
where a text is a number or one of `WORDS`. Not read are formulas, conversions of texts, and bit fields as texts.

*Facts*: the kinds and their parameters as ASAM describes MDF 4.1. Without interpolation the nearest key counts, of two the
lower; tables are clamped at both ends. A range ends with its upper limit, for floating-point numbers just before it.
asammdf gives the default for whole numbers inside of a range (8.8.28), so the tests hold ranges against their definition.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from aces_bus.frame_table import Ints

IDENTITY, LINEAR, _RATIONAL, _INTERPOLATED, _NEAREST, _RANGES, _TEXTS, _TEXT_RANGES = 0, 1, 2, 4, 5, 6, 7, 8
_NOT_READ = {
    3: "a formula as its conversion",
    9: "a conversion from text to numbers",
    10: "a conversion from text to text",
    11: "a bit field with texts as its conversion",
}
_FLAGS = {"false": 0, "true": 1, "no": 0, "yes": 1, "off": 0, "on": 1}
#: Texts that are understood, by the last part of a channel's name.
WORDS: Mapping[str, Mapping[str, int]] = {
    "Dir": {"rx": 0, "tx": 1},
    "IDE": {"standard": 0, "extended": 1, **_FLAGS},
    "EDL": _FLAGS,
    "BRS": _FLAGS,
    "ESI": _FLAGS,
}


class ChannelConversion(NamedTuple):
    """A conversion: its kind and parameters as in the file. `fault` is why it is not read, "" when it is."""

    kind: int = IDENTITY
    parameters: Ints = np.zeros(0)
    texts: tuple[str, ...] = ()
    fault: str = ""


def conversion_of(kind: int, values: Ints, texts: Sequence[str]) -> ChannelConversion:
    """Return the conversion of a kind with parameters; `texts` are those it refers to, "" for what is not text."""
    fault = _NOT_READ.get(kind, f"a conversion of kind {kind}")
    if kind in _IS_WHOLE:
        fault = "" if _IS_WHOLE[kind](values, len(values), len(texts)) else "a damaged conversion"
    return ChannelConversion(kind, values, tuple(texts), fault)


def _go_up(lower: Ints, upper: Ints) -> bool:
    return bool((lower <= upper).all() and (upper[:-1] <= lower[1:]).all())


#: Kind → whether its parameters, n of them, and so many texts are all that it needs.
_IS_WHOLE: Mapping[int, Callable[[Ints, int, int], bool]] = {
    IDENTITY: lambda values, n, texts: True,
    LINEAR: lambda values, n, texts: n >= 2,
    _RATIONAL: lambda values, n, texts: n >= 6,
    **dict.fromkeys(
        (_INTERPOLATED, _NEAREST),
        lambda values, n, texts: n >= 2 and not n % 2 and bool((np.diff(values[::2]) > 0).all()),
    ),
    _RANGES: lambda values, n, texts: n >= 4 and n % 3 == 1 and _go_up(values[:-1:3], values[1:-1:3]),
    _TEXTS: lambda values, n, texts: 0 < n <= texts,
    _TEXT_RANGES: lambda values, n, texts: (
        n >= 2 and not n % 2 and texts >= n // 2 and _go_up(values[::2], values[1::2])
    ),
}


def conversion_meaning(text: str, part: str) -> float:
    """Return the number that a text is for the part of a frame; NaN where it is not understood."""
    word = text.strip().lower()
    if word.isascii() and word.isdigit() and len(word) < 16:
        return float(word)
    return float(WORDS.get(part, {}).get(word, np.nan))


def convert_values(conversion: ChannelConversion, numbers: Ints, part: str) -> Ints:
    """Return the numbers of a channel for that part of a frame, converted, as float64; NaN where they mean nothing.

    The conversion has no fault.
    """
    kind = conversion.kind
    values: Any = conversion.parameters
    x: Any = numbers.astype(np.float64)
    with np.errstate(all="ignore"):
        if kind == IDENTITY:
            return np.asarray(x)
        if kind == LINEAR:
            return np.asarray(x * values[1] + values[0])
        if kind == _RATIONAL:
            a, b, c, d, e, f = values[:6]
            return np.asarray((a * x * x + b * x + c) / (d * x * x + e * x + f))
        if kind == _INTERPOLATED:
            return np.asarray(np.interp(x, values[::2], values[1::2]))
        if kind == _NEAREST:
            keys = values[::2]
            above = np.minimum(np.searchsorted(keys, x), len(keys) - 1)
            below = np.maximum(above - 1, 0)
            nearest = np.where(np.abs(x - keys[below]) <= np.abs(x - keys[above]), below, above)
            return np.asarray(np.where(np.isnan(x), np.nan, values[1::2][nearest]))
    means = np.array([conversion_meaning(text, part) for text in conversion.texts], np.float64)
    if kind == _TEXTS:
        count = len(values)
        order = np.argsort(values, kind="stable")
        place = order[np.minimum(np.searchsorted(values, x, sorter=order), count - 1)]
        inside = values[place] == x
    else:
        step = 3 if kind == _RANGES else 2
        lower, upper = values[: len(values) // step * step : step], values[1::step]
        count = len(lower)
        place = np.maximum(np.searchsorted(lower, x, side="right") - 1, 0)
        is_below_end = x <= upper[place] if numbers.dtype.kind in "iub" else x < upper[place]
        inside = (x >= lower[place]) & is_below_end
        if kind == _RANGES:
            return np.asarray(np.where(inside, values[2::3][place], values[-1]))
    default = means[count] if len(means) > count else np.nan
    return np.asarray(np.where(inside, means[place], default))
