"""Fields that servos' control tables share, whoever makes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from construct import Byte, Construct

from aces_bus.errors import FieldError
from aces_bus.protocol import Enumeration, Field

#: A rate is taken for the nearest setting when it is off by less: what a receiver tolerates (RX-28 manual).
TOLERANCE = 0.03


def from_directed(raw: int, bit: int) -> int:
    """Return the number whose magnitude is below `bit`, and whose sign is `bit`; bits above have no meaning.

    >>> from_directed(0x464, 10)
    -100
    """
    magnitude = raw & (1 << bit) - 1
    return -magnitude if raw >> bit & 1 else magnitude


def to_directed(value: int, bit: int) -> int:
    """Return what `from_directed` undoes, for a magnitude that fits.

    >>> hex(to_directed(-100, 15))
    '0x8064'
    """
    return value if value >= 0 else 1 << bit | -value


class Directed(Field):
    """The bits below `bit` are a magnitude, `bit` set means negative; bits above it have no meaning and are left out.

    Raises `FieldError` for a magnitude that does not fit.

    >>> from construct import Int16ul
    >>> Directed(Int16ul).parse(bytes([0x64, 0x04])), Directed(Int16ul).parse(bytes([0x64, 0x00]))
    (-100, 100)
    >>> Directed(Int16ul, 15).build(-100).hex()
    '6480'
    """

    def __init__(self, subcon: Construct, bit: int = 10) -> None:
        super().__init__(subcon)
        self.bit = bit

    def to_physical(self, raw: Any) -> Any:
        return from_directed(raw, self.bit)

    def to_raw(self, value: Any, path: str = "") -> Any:
        most = (1 << self.bit) - 1
        if not isinstance(value, int) or abs(value) > most:
            raise FieldError(f"{path}: {value!r} is outside ±{most} counts")
        return to_directed(value, self.bit)


class RateTable(Field):
    """A line's speed (baud) as its place in the maker's table.

    A rate is taken for the nearest setting when it is off by less than 3 %. Raises `FieldError` for another.

    >>> RateTable(Byte, (9_600, 57_600)).parse(bytes([1])), RateTable(Byte, (9_600, 57_600)).build(57_000)
    (57600, b'\\x01')
    """

    def __init__(self, subcon: Construct, rates: Sequence[int]) -> None:
        super().__init__(subcon)
        self.rates = tuple(rates)

    def to_physical(self, raw: Any) -> Any:
        return self.rates[raw] if raw < len(self.rates) else raw

    def to_raw(self, value: Any, path: str = "") -> Any:
        if isinstance(value, (int, float)):
            near = min(self.rates, key=lambda rate: abs(rate - value))
            if abs(near - value) < TOLERANCE * value:
                return self.rates.index(near)
        raise FieldError(
            f"{path}: {value!r} is not a rate in baud; there are {', '.join(map(str, self.rates))}"
        )


def switch(off: str = "off", on: str = "on") -> Enumeration:
    """Return a byte that is 0 or 1."""
    return Enumeration(Byte, {off: 0, on: 1})
