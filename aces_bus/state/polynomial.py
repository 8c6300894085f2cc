"""The polynomial through a few samples, by their real instants: its value and its slope (Neville's scheme).

1. Instants are exact integers; only their differences to the asked instant become floats.
2. n + 1 samples give order n; samples of a polynomial of that order are met exactly, evenly spaced or not.
"""

from __future__ import annotations

from collections.abc import Sequence


def value_at(instants: Sequence[int], values: Sequence[float], instant: int) -> float:
    """Return the polynomial through (instants, values) at `instant`, all in ns.

    >>> value_at([0, 10, 30], [0.0, 100.0, 900.0], 20)   # t²
    400.0
    """
    size = len(values)
    if size == 4:  # cubic: the same, written out, in half the time
        a, b, c, d = instants
        a, b, c, d = a - instant, b - instant, c - instant, d - instant
        p, q, r, s = values
        p, q, r = (b * p - a * q) / (b - a), (c * q - b * r) / (c - b), (d * r - c * s) / (d - c)
        p, q = (c * p - a * q) / (c - a), (d * q - b * r) / (d - b)
        return (d * p - a * q) / (d - a)
    ahead = [sampled - instant for sampled in instants]
    column = list(values)
    for step in range(1, size):
        for i in range(size - step):
            left, right = ahead[i], ahead[i + step]
            column[i] = (right * column[i] - left * column[i + 1]) / (right - left)
    return column[0]


def slope_at(instants: Sequence[int], values: Sequence[float], instant: int) -> float:
    """Return its derivative there, per second.

    >>> slope_at([0, 10**9, 3 * 10**9], [0.0, 1.0, 9.0], 2 * 10**9)
    4.0
    """
    ahead = [(sampled - instant) / 1e9 for sampled in instants]
    column = list(values)
    slopes = [0.0] * len(column)
    size = len(column)
    for step in range(1, size):
        for i in range(size - step):
            left, right = ahead[i], ahead[i + step]
            slopes[i] = (right * slopes[i] - left * slopes[i + 1] + column[i + 1] - column[i]) / (
                right - left
            )
            column[i] = (right * column[i] - left * column[i + 1]) / (right - left)
    return slopes[0]
