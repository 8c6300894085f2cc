"""Patterns of unsigned numbers: CAN identifiers, command bytes, header fields.

1. A pattern is a constant plus captures: number = constant + Σ (capture << shift). A captured part is a field of the
   record like any other.
2. Matching is exact and invertible: one number gives one set of captures, and captures give one number back.

Written as arithmetic, as the vendor's sheet has it: `0x060 + Board`, `Node << 5 | 0x09`,
`Priority << 26 | 0xFECA << 8 | Source`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from functools import cached_property, reduce
from operator import or_
from typing import Any

import msgspec
from msgspec.structs import force_setattr, replace

from ...errors import FieldError, SpecError
from .fields import Enumeration, Quantity
from .place import caller


class Arithmetic:
    """The operators that make a `IdPattern` out of captures and constants."""

    def as_pattern(self) -> IdPattern:
        """Return the pattern that this is by itself."""
        raise NotImplementedError

    def __add__(self, other: int | Arithmetic) -> IdPattern:
        return self.as_pattern().joined(other)

    def __radd__(self, other: int) -> IdPattern:
        return self.as_pattern().joined(other)

    def __or__(self, other: int | Arithmetic) -> IdPattern:
        return self.as_pattern().united(other)

    def __ror__(self, other: int) -> IdPattern:
        return self.as_pattern().united(other)

    def __lshift__(self, bits: int) -> IdPattern:
        return self.as_pattern().shifted(bits)


class IdField(Arithmetic, msgspec.Struct, frozen=True, eq=False):
    """A part of a number that becomes the field `name`, with the raw values that it may take.

    `unit`, `scale` and `offset` make it a quantity (a torque inside an identifier), `names` an enumeration (a status).
    """

    name: str
    values: Collection[int]
    unit: str = ""
    scale: float = 1
    offset: float = 0
    names: Mapping[str, int] | None = None
    doc: str = ""
    shift: int = 0
    quantity: Quantity | Enumeration | None = None

    def __post_init__(self) -> None:
        if not self.values or bounds(self.values)[0] < 0:
            raise SpecError(f"{caller()}: capture {self.name!r} needs values, none of them negative")
        if self.quantity is None and (self.unit or self.scale != 1 or self.offset):
            from construct import Int64ub

            made = Quantity(Int64ub, unit=self.unit, scale=self.scale, offset=self.offset)
            force_setattr(self, "quantity", made)
        if self.quantity is None and self.names is not None:
            from construct import Int64ub

            force_setattr(self, "quantity", Enumeration(Int64ub, self.names))

    @cached_property
    def width(self) -> int:
        """Number of bits of the largest value."""
        return max(1, bounds(self.values)[1].bit_length())

    @property
    def bits(self) -> int:
        """The bits that are set in some of its values, as a mask."""
        return (1 << self.width) - 1 if len(self.values) > 4096 else reduce(or_, self.values)

    def only(self, values: Collection[int]) -> IdField:
        """Return the same capture over fewer values."""
        kept = [v for v in self.values if v in values]
        if kept and kept == list(range(kept[0], kept[-1] + 1)):
            return replace(self, values=range(kept[0], kept[-1] + 1))
        return replace(self, values=tuple(kept))

    def as_pattern(self) -> IdPattern:
        return IdPattern(0, (self,))

    def to_physical(self, raw: int) -> Any:
        return raw if self.quantity is None else self.quantity.to_physical(raw)

    def to_raw(self, value: Any, path: str) -> int:
        raw = value if self.quantity is None else self.quantity.to_raw(value, path)
        if isinstance(raw, bool) or not isinstance(raw, int) or raw not in self.values:
            raise FieldError(f"{path}: {value!r} is not one of {describe_values(self.values)}")
        return raw


class IdPattern(Arithmetic, msgspec.Struct, frozen=True, eq=False):
    """A constant plus captures; see the module."""

    constant: int
    captures: tuple[IdField, ...] = ()

    def as_pattern(self) -> IdPattern:
        return self

    def joined(self, other: int | Arithmetic) -> IdPattern:
        if isinstance(other, int):
            return replace(self, constant=self.constant + other)
        more = other.as_pattern()
        captures = self.captures + more.captures
        names = [c.name for c in captures]
        for name in names:
            if names.count(name) > 1:
                raise SpecError(f"{caller()}: {name!r} is declared twice in one pattern")
        return IdPattern(self.constant + more.constant, captures)

    def united(self, other: int | Arithmetic) -> IdPattern:
        """Return the parts side by side, as `|` says: raises `SpecError` where they share bits, which adding would carry."""
        shared = self.bits & (other if isinstance(other, int) else other.as_pattern().bits)
        if shared:
            named = [str(bit) for bit in range(shared.bit_length()) if shared >> bit & 1]
            shown = other if isinstance(other, int) else other.as_pattern()
            text = f"{shown:#x}" if isinstance(shown, int) else shown.describe()
            raise SpecError(
                f"{caller()}: {self.describe()} | {text} share bit{'s' if len(named) > 1 else ''} {', '.join(named)};"
                " shift them apart, or write + where numbers are added"
            )
        return self.joined(other)

    @property
    def bits(self) -> int:
        """The bits that are set in some number that matches, as a mask."""
        found = self.constant
        for capture in self.captures:
            found |= capture.bits << capture.shift
        return found

    def shifted(self, bits: int) -> IdPattern:
        return IdPattern(
            self.constant << bits, tuple(replace(c, shift=c.shift + bits) for c in self.captures)
        )

    def check(self) -> None:
        """Raise `SpecError` when numbers cannot be read back: two parts that share bits."""
        if len(self.captures) < 2:
            return
        taken = self.constant
        for capture in self.captures:
            mask = ((1 << capture.width) - 1) << capture.shift
            if taken & mask:
                raise SpecError(
                    f"{caller()}: capture {capture.name!r} shares bits with another part of its pattern"
                )
            taken |= mask

    def match(self, number: int) -> dict[str, int] | None:
        """Return the raw captures of `number`, or None when it does not match."""
        found: dict[str, int] = {}
        if len(self.captures) == 1:
            capture = self.captures[0]
            rest = number - self.constant
            if rest < 0 or rest & ((1 << capture.shift) - 1) or rest >> capture.shift not in capture.values:
                return None
            return {capture.name: rest >> capture.shift}
        rest = number
        for capture in self.captures:
            value = number >> capture.shift & ((1 << capture.width) - 1)
            if value not in capture.values:
                return None
            found[capture.name] = value
            rest -= value << capture.shift
        return found if rest == self.constant else None

    @cached_property
    def fixed(self) -> int:
        """The bits that are those of `constant` in every number that matches, as a mask (negative: all higher ones)."""
        varying = reduce(or_, (((1 << capture.width) - 1) << capture.shift for capture in self.captures), 0)
        if varying & self.constant:  # adding may carry
            return (1 << min(capture.shift for capture in self.captures)) - 1
        return ~varying

    def is_apart(self, other: IdPattern) -> bool:
        """Return whether a glance shows that no number matches both; False says nothing."""
        return bool((self.constant ^ other.constant) & self.fixed & other.fixed)

    def number(self, captures: Mapping[str, int]) -> int:
        """Return the number with these raw captures."""
        return self.constant + sum(captures[c.name] << c.shift for c in self.captures)

    def __len__(self) -> int:
        """Return how many numbers match."""
        total = 1
        for capture in self.captures:
            total *= len(capture.values)
        return total

    def __iter__(self) -> Iterator[int]:
        """Return every number that matches (mind `len` first)."""
        numbers = [self.constant]
        for capture in self.captures:
            numbers = [n + (v << capture.shift) for n in numbers for v in capture.values]
        return iter(numbers)

    @property
    def largest(self) -> int:
        return self.constant + sum(bounds(c.values)[1] << c.shift for c in self.captures)

    def only(self, name: str, values: Collection[int]) -> IdPattern | None:
        """Return the pattern with capture `name` limited to `values`; None when nothing is left."""
        captures = []
        for capture in self.captures:
            if capture.name == name:
                if not any(v in values for v in capture.values):
                    return None
                capture = capture.only(values)
            captures.append(capture)
        return replace(self, captures=tuple(captures))

    def describe(self, digits: int = 3) -> str:
        """Return it as the sheet would write it: `0x060 + board`."""
        parts = [f"{c.name} << {c.shift}" if c.shift else c.name for c in self.captures]
        if self.constant or not parts:
            parts.insert(0, f"0x{self.constant:0{digits}X}")
        return (" | " if any(c.shift for c in self.captures) else " + ").join(parts)


def as_pattern(value: int | IdField | IdPattern | Collection[int], name: str = "") -> IdPattern:
    """Return a pattern from what a spec may write: a number, a set of numbers (kept under `name`), a capture, a pattern."""
    if isinstance(value, bool):
        value = int(value)
    if isinstance(value, int):
        if value < 0:
            raise SpecError(
                f"{caller()}: {value} is negative; identifiers and head fields are matched as unsigned numbers"
            )
        return IdPattern(value)
    if isinstance(value, Arithmetic):
        pattern = value.as_pattern()
        pattern.check()
        return pattern
    if not isinstance(value, Collection) or not value or not all(isinstance(number, int) for number in value):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise SpecError(f"{caller()}: {value!r} is not a number, set of numbers or pattern of captures")
    return IdPattern(0, (IdField(name, tuple(sorted(value))),))


def bounds(values: Collection[int]) -> tuple[int, int]:
    """Return the least and the greatest of some values; a range, however long, is not walked."""
    if isinstance(values, range):
        return min(values[0], values[-1]), max(values[0], values[-1])
    return min(values), max(values)


def describe_values(values: Collection[int]) -> str:
    """Return `0…47` or `1, 2, 5`; only a few values are ever sorted."""
    count = len(values)
    if count > 2:
        low, high = bounds(values)
        if high - low == count - 1:
            return f"{low}…{high}"
        if count > 12:
            return f"{count} values in {low}…{high}"
    return ", ".join(map(str, sorted(values)))


def meet(one: IdPattern, other: IdPattern, width: int) -> int | None:
    """Return a number below 2**width that both patterns match, or None: exact.

    Walks the bits from the top, keeping a prefix only while each pattern can still be completed.
    """
    if one is other and one.largest < 1 << width:
        return one.constant + sum(bounds(capture.values)[0] << capture.shift for capture in one.captures)
    if one.is_apart(other):
        return None
    if len(one) > len(other):
        one, other = other, one
    if len(one) <= 4096:
        return next((n for n in one if other.match(n) is not None), None)
    stack = [(0, width)]
    while stack:
        prefix, low = stack.pop()
        if not (_possible(one, prefix, low) and _possible(other, prefix, low)):
            continue
        if low == 0:
            return prefix
        low -= 1
        stack += [(prefix | 1 << low, low), (prefix, low)]
    return None


def _possible(pattern: IdPattern, prefix: int, low: int) -> bool:
    """Return whether some number whose bits from `low` up are those of `prefix` may match (exact when `low` is 0)."""
    if low == 0:
        return pattern.match(prefix) is not None
    if len(pattern.captures) < 2:
        smallest, largest = prefix, prefix + (1 << low) - 1
        if not pattern.captures:
            return smallest <= pattern.constant <= largest
        capture = pattern.captures[0]
        step = 1 << capture.shift
        first = max(0, -((pattern.constant - smallest) // step))
        last = (largest - pattern.constant) // step
        return _any_between(capture.values, first, last)
    fixed = 0
    for capture in pattern.captures:
        fixed |= ((1 << capture.width) - 1) << capture.shift
        bottom = max(low, capture.shift)
        top = capture.shift + capture.width
        known = prefix >> bottom & ((1 << max(0, top - bottom)) - 1) if top > bottom else 0
        unknown_bits = min(top, bottom) - capture.shift
        if not _any_between(capture.values, known << unknown_bits, ((known + 1) << unknown_bits) - 1):
            return False
    return ((prefix ^ pattern.constant) & ~fixed) >> low == 0


def _any_between(values: Collection[int], first: int, last: int) -> bool:
    if isinstance(values, range) and values.step == 1:
        return max(first, values.start) <= min(last, values.stop - 1)
    return any(first <= v <= last for v in values)
