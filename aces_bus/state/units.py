"""Units as text, multiplied and divided.

1. A unit is a product of symbols with whole exponents: "rad/s", "N·m", "kg*m^2", "m/s²", "1/s". Whatever does not read like
   that ("counts per turn") is one symbol.
2. "" is dimensionless; None says that the unit is not stated, and spreads.
3. Symbols are compared, not understood: N·m·rad/s is not simplified to W, and mm is not m.
"""

from __future__ import annotations

import re
from functools import lru_cache

_FACTOR = re.compile(r"([^\W\d_⁰¹²³⁴⁵⁶⁷⁸⁹]+|[°%][^\W\d_⁰¹²³⁴⁵⁶⁷⁸⁹]*)(?:\^?(-?\d+)|([⁻]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+))?")
_RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_RAISE = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")

Powers = dict[str, int]


@lru_cache(maxsize=256)
def _parsed(unit: str) -> tuple[tuple[str, int], ...]:
    powers: Powers = {}
    over, *under = unit.strip().split("/")
    for sign, part in [(1, over), *((-1, part) for part in under)]:
        for text in re.split(r"[·*\s]+", part.strip().strip("()")):
            if text in ("", "1"):
                continue
            found = _FACTOR.fullmatch(text)
            if found is None or len(text) > 64:
                return ((unit.strip(), 1),)
            symbol, plain, raised = found.groups()
            power = int(plain or (raised or "1").translate(_RAISED))
            powers[symbol] = powers.get(symbol, 0) + sign * power
    return tuple((symbol, power) for symbol, power in powers.items() if power)


def _printed(powers: Powers) -> str:
    def one(symbol: str, power: int) -> str:
        return symbol if power == 1 else symbol + str(power).translate(_RAISE)

    over = "·".join(one(symbol, power) for symbol, power in powers.items() if power > 0)
    under = [one(symbol, -power) for symbol, power in powers.items() if power < 0]
    if not under:
        return over
    below = "·".join(under)
    return f"{over or 1}/{f'({below})' if len(under) > 1 else below}"


def multiplied(left: str | None, right: str | None, power: int = 1) -> str | None:
    """Return the unit of left × right to the `power`.

    >>> multiplied("N·m", "rad/s"), multiplied("rad/s", "s", -1), multiplied("m/s", "s")
    ('N·m·rad/s', 'rad/s²', 'm')
    """
    if left is None or right is None:
        return None
    powers = dict(_parsed(left))
    for symbol, exponent in _parsed(right):
        powers[symbol] = powers.get(symbol, 0) + power * exponent
    return _printed({symbol: exponent for symbol, exponent in powers.items() if exponent})


def raise_unit(unit: str | None, power: float) -> str | None:
    """Return the unit to a power; None where that is not a whole one.

    >>> raise_unit("m/s", 2), raise_unit("m²", 0.5), raise_unit("m", 0.5)
    ('m²/s²', 'm', None)
    """
    if unit is None:
        return None
    powers = {symbol: exponent * power for symbol, exponent in _parsed(unit)}
    if any(exponent != int(exponent) for exponent in powers.values()):
        return None
    return _printed({symbol: int(exponent) for symbol, exponent in powers.items() if exponent})


def are_same(left: str | None, right: str | None) -> bool:
    """Return whether two units may be added: the same symbols with the same powers, in any order, or one is not stated.

    >>> are_same("N·m", "m*N"), are_same("rad", "deg"), are_same("rad", None)
    (True, False, True)
    """
    return left is None or right is None or dict(_parsed(left)) == dict(_parsed(right))
