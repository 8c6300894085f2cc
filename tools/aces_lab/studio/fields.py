"""Fields that are drawn over the bits of a message: where their bits are, and what their values were.

1. A bit is named as plans name it: 8 × byte + bit, bit 0 being the least significant of its byte.
2. A field is `length` bits from its lowest one, `start`. "little" goes on in the byte behind, "big" in the one before.
"""

from __future__ import annotations

import keyword
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from aces_bus.errors import CallerError

from .capture import Columns
from .pictures import Array

BitOrder = Literal["little", "big"]


@dataclass(frozen=True)
class DrawnField:
    """A number in a message: value = raw × `scale` + `offset`, in `unit`."""

    name: str
    start: int
    length: int
    order: BitOrder = "little"
    signed: bool = False
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""

    @property
    def positions(self) -> tuple[int, ...]:
        """The numbers of its bits, lowest first.

        >>> DrawnField("a", 12, 8).positions, DrawnField("a", 12, 8, "big").positions
        ((12, 13, 14, 15, 16, 17, 18, 19), (12, 13, 14, 15, 0, 1, 2, 3))
        """
        if self.order == "little":
            return tuple(range(self.start, self.start + self.length))
        first = as_written(self.start)
        return tuple(as_written(first - bit) for bit in range(self.length))

    @property
    def place(self) -> str:
        """The place of the field for people: `byte 2 bit 4, 12 bits big`."""
        order = f" {self.order}" if self.length > 8 or len({at // 8 for at in self.positions}) > 1 else ""
        bits = "bit" if self.length == 1 else "bits"
        return f"byte {self.start // 8} bit {self.start % 8}, {self.length} {bits}{order}"

    def check(self, size: int) -> None:
        """Raise `CallerError` for a field that cannot be in a message of `size` bytes."""
        if not self.name.isidentifier() or keyword.iskeyword(self.name):
            raise CallerError(f"{self.name!r} is not a name: write letters, digits and _, such as speed_left")
        if not 1 <= self.length <= 64:
            raise CallerError(f"{self.name}: {self.length} bits; a field has 1 to 64")
        if min(self.positions) < 0 or max(self.positions) >= 8 * size:
            raise CallerError(f"{self.name}: {self.place} goes beyond the message's {size} bytes")
        if not np.isfinite((self.scale, self.offset)).all() or not self.scale:
            raise CallerError(f"{self.name}: scale {self.scale:g}, offset {self.offset:g}: a scale is not 0")

    def values(self, columns: Columns) -> Array:
        """Return the values in frames, float64; NaN where a frame is too short to have it."""
        raw = np.zeros(len(columns), np.uint64)
        width = columns.data.shape[1]
        for to, at in enumerate(self.positions):
            if at // 8 < width:
                bit = columns.data[:, at // 8] >> np.uint8(at % 8) & np.uint8(1)
                raw |= bit.astype(np.uint64) << np.uint64(to)
        if self.signed:
            shift = np.uint64(64 - self.length)
            numbers = ((raw << shift).view(np.int64) >> np.int64(64 - self.length)).astype(np.float64)
        else:
            numbers = raw.astype(np.float64)
        found: Array = numbers * self.scale + self.offset
        found[columns.lengths.astype(np.int64) * 8 <= max(self.positions)] = np.nan
        return found


def as_written(bit: int) -> int:
    """Return a bit's number when bits are counted as they are written, highest of a byte first; and the other way."""
    return bit // 8 * 8 + 7 - bit % 8


def dragged(first: int, last: int, order: BitOrder) -> tuple[int, int]:
    """Return start and length of the field from one bit to another that the mouse was drawn over.

    From the first bit of a byte, as it is written, to the last one of another these are whole bytes, in either order.

    >>> dragged(15, 16, "big"), dragged(15, 16, "little"), dragged(12, 17, "little"), dragged(3, 0, "little")
    ((16, 16), (8, 16), (12, 6), (0, 4))
    """
    upper, lower = sorted((first, last), key=as_written)
    if order == "big":
        return lower, as_written(lower) - as_written(upper) + 1
    if upper // 8 == lower // 8:
        return lower, upper - lower + 1
    if upper % 8 == 7 and lower % 8 == 0:  # whole bytes
        upper, lower = upper - 7, lower + 7
    return upper, lower - upper + 1


def in_order(field: DrawnField, order: BitOrder) -> DrawnField:
    """Return a field of whole bytes in the other order, at the same bytes; another one as it is, in that order."""
    bytes_ = sorted({at // 8 for at in field.positions})
    if bytes_ and order != field.order and field.length == 8 * len(bytes_):
        return replace(field, order=order, start=8 * (bytes_[0] if order == "little" else bytes_[-1]))
    return replace(field, order=order)
