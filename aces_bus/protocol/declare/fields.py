"""Fields beyond plain construct: quantities, sign-and-magnitude integers, enumerations, flags, text, reserved bytes.

1. Each one is an ordinary construct, so `struct.parse` and `struct.build` give the scanner's answer.
2. `struct.parse(data, raw=True)` and `struct.build(values, raw=True)` leave out units and names: the numbers on the wire.
3. A value that the wire can carry is never rejected on the way in; ranges bind only what we send.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, BinaryIO, ClassVar, Literal, NamedTuple

import msgspec
from construct import (
    Adapter,
    Array,
    Bytes,
    BytesInteger,
    Construct,
    Container,
    Default,
    FormatField,
    GreedyBytes,
    IntegerError,
    Renamed,
    Struct,
    Subconstruct,
)

from ...errors import FieldError, SpecError
from ..record import FieldValue
from .place import SourceLine, caller

# ---------------------------------------------------------------------- fields that are there only while another has a value


class Multiplexed(Construct):
    """A field that is there only while the field `selector` has (one of) the raw value(s) `when`; else None, no bytes.

    The selector may be multiplexed itself: while it is not there, neither is this field.
    """

    def __init__(self, selector: str, when: int | Collection[int], subcon: Construct) -> None:
        super().__init__()
        self.selector = selector
        self.when = frozenset((when,) if isinstance(when, int) else when)
        self.body = subcon
        self.place = caller()
        self.flagbuildnone = True
        self.enumeration: Enumeration | None = None

    def is_present(self, context: Container) -> bool:
        value = context[self.selector]
        if isinstance(value, str) and self.enumeration is not None:
            value = self.enumeration.names.get(value)
        return value in self.when

    def _parse(self, stream: BinaryIO, context: Container, path: str) -> Any:
        return self.body._parsereport(stream, context, path) if self.is_present(context) else None

    def _build(self, obj: Any, stream: BinaryIO, context: Container, path: str) -> Any:
        if self.is_present(context):
            return self.body._build(obj, stream, context, path)
        if obj is not None:
            raise self.absent(path)
        return None

    def around(self, body: Construct) -> Multiplexed:
        """Return the same condition around another field."""
        made = type(self)(self.selector, self.when, body)
        made.place = self.place
        return made

    def absent(self, path: str) -> FieldError:
        """Return the error for a value that is given while the field is not there."""
        return FieldError(f"{path}: only there while {self.selector} is {number_runs(self.when)}")

    def _sizeof(self, context: Container, path: str) -> Any:
        return self.body._sizeof(context, path) if self.is_present(context) else 0


class Present(Multiplexed):
    """A field that is there only while bit `bit` of the field `selector` is set; else None, no bytes.

    `selector` is an integer field or `Flags` before it in the same `Struct`, or a field of the header. It may be
    `Present` itself: while it is not there, neither is this field. Several in a row stand one behind the other, each
    where those before it end.
    """

    def __init__(self, selector: str, bit: int, subcon: Construct) -> None:
        if not isinstance(bit, int) or not 0 <= bit < 64:  # pyright: ignore[reportUnnecessaryIsInstance]
            raise SpecError(f"{caller()}: a bit has a number from 0 to 63, not {bit!r}")
        super().__init__(selector, 1 << bit, subcon)
        self.bit = bit

    def around(self, body: Construct) -> Present:
        made = Present(self.selector, self.bit, body)
        made.place = self.place
        return made

    def is_present(self, context: Container) -> bool:
        value = context[self.selector] if self.selector in context else context._.get(self.selector)
        return value is not None and bool(int(value) >> self.bit & 1)

    def absent(self, path: str) -> FieldError:
        return FieldError(f"{path}: only there while bit {self.bit} of {self.selector} is set")


def runs_of_numbers(values: Collection[int]) -> list[tuple[int, int]]:
    """Return the first and the last of each run of numbers that follow one another."""
    runs: list[tuple[int, int]] = []
    for value in sorted(values):
        if runs and value == runs[-1][1] + 1:
            runs[-1] = runs[-1][0], value
        else:
            runs.append((value, value))
    return runs


def number_runs(values: Collection[int]) -> str:
    """Numbers as their runs, shortest form: `0…15, 32`."""
    runs = runs_of_numbers(values)
    texts = [
        f"{low}…{high}" if high - low > 1 else str(low) if low == high else f"{low}, {high}"
        for low, high in runs[:12]
    ]
    return ", ".join(texts) + (f", … ({len(values)} values)" if len(runs) > 12 else "")


# ---------------------------------------------------------------------- numbers on the wire: kind, size, byte order, limits


def plain_number(value: FieldValue) -> Any:
    """Return a number of any kind (NumPy's, a fraction) as Python's int or float; None for what is none."""
    if isinstance(value, (int, float)):
        return value
    if isinstance(value, numbers.Integral):
        return int(value)
    return float(value) if isinstance(value, numbers.Real) else None


def innermost(subcon: Construct) -> Construct:
    """Return the construct that touches the bytes, below all names and adapters."""
    while hasattr(subcon, "subcon"):
        subcon = subcon.subcon
    return subcon


class WireNumber(NamedTuple):
    """What a number is on the wire; `size` in bytes."""

    kind: Literal["uint", "int", "float"]
    size: int
    order: Literal["little", "big"]

    @property
    def limits(self) -> tuple[int, int]:
        """The least and the greatest integer of this size."""
        top = 1 << 8 * self.size - 1
        return (-top, top - 1) if self.kind == "int" else (0, 2 * top - 1)


def wire_number(inner: Any) -> WireNumber | None:
    """Return what number an innermost construct reads; None where it is none, or of a size that is not fixed."""
    if isinstance(inner, FormatField) and inner.fmtstr[-1:] in "efdBbHhLlQq":
        mark = inner.fmtstr[-1:]
        order: Literal["little", "big"] = "little" if inner.fmtstr.startswith("<") else "big"
        return WireNumber(
            "float" if mark in "efd" else "int" if mark.islower() else "uint", inner.length, order
        )
    if isinstance(inner, BytesInteger) and isinstance(inner.length, int) and isinstance(inner.swapped, bool):
        return WireNumber(
            "int" if inner.signed else "uint", inner.length, "little" if inner.swapped else "big"
        )
    return None


def is_float(subcon: Construct) -> bool:
    inner = innermost(subcon)
    fmt = getattr(inner, "fmtstr", "")
    return fmt[-1:] in ("e", "f", "d") or bool(getattr(inner, "is_float", False))


def integer_width(subcon: Construct) -> int:
    """Width in bits of an integer construct."""
    inner = innermost(subcon)
    width = getattr(inner, "width", None)
    return width if isinstance(width, int) else int(inner.sizeof()) * 8


def raw_limits(con: Construct) -> tuple[int, int] | None:
    """Return the least and the greatest number that a construct gives; None where it is no integer of fixed size."""
    while isinstance(con, Subconstruct) and not isinstance(con, Adapter):
        con = con.subcon
    wire = wire_number(con)
    if wire is not None:
        return wire.limits if wire.kind != "float" else None
    found: tuple[int, int] | None = getattr(con, "raw_limits", None)
    return found


# ---------------------------------------------------------------------- fields


#: As many values that mean unknown are listed in generated code and tables; more are a range.
MOST_LISTED = 8


def is_raw(context: Container) -> bool:
    """Return whether the outermost call asked for raw values."""
    return bool(context._params.get("raw", False))


class Field(Adapter):
    """An adapter that remembers its line and is transparent in raw mode."""

    place: SourceLine

    def __init__(self, subcon: Construct) -> None:
        super().__init__(subcon)
        self.place = caller()
        self._check_subcon()

    def _check_subcon(self) -> None:
        """Raise `SpecError` where the field is given no number of the wire."""
        mine = next((kind for kind in _OF_NUMBERS if isinstance(self, kind)), None)
        if mine is None:
            return
        inner = self.subcon
        while isinstance(inner, (Renamed, Default)):
            inner = inner.subcon
        others = (*_NO_NUMBERS, SignMagnitude) if mine is SignMagnitude else _NO_NUMBERS
        if isinstance(inner, others):
            other = next(kind for kind in others if isinstance(inner, kind))  # pyright: ignore[reportUnnecessaryIsInstance]
            more = "; names of a quantity are its names={…}" if Quantity in (mine, other) else ""
            raise SpecError(
                f"{self.place}: {mine.__name__} takes a number of the wire, not another {other.__name__}{more}"
            )
        inner = innermost(inner)
        if isinstance(inner, (Bytes, GreedyBytes.__class__, Struct, Array, Text)):
            raise SpecError(f"{self.place}: {mine.__name__} takes a number, not {type(inner).__name__}")
        if mine is not Quantity and is_float(inner):
            raise SpecError(f"{self.place}: {mine.__name__} takes an integer, not a float")
        signed = str(getattr(inner, "fmtstr", "")).endswith(("b", "h", "i", "l", "q"))
        if mine is SignMagnitude and (signed or getattr(inner, "signed", False)):
            raise SpecError(f"{self.place}: SignMagnitude has its sign itself: it takes an unsigned integer")

    def _decode(self, obj: Any, context: Any, path: str) -> Any:
        return obj if is_raw(context) else self.to_physical(obj)

    def _encode(self, obj: FieldValue, context: Container, path: str) -> FieldValue:
        return obj if is_raw(context) else self.to_raw(obj, path)

    def to_physical(self, raw: Any) -> Any:
        """Return the value a record shows, from the number on the wire."""
        raise NotImplementedError

    def to_raw(self, value: Any, path: str = "") -> Any:
        """Return the number on the wire; raises `FieldError` when the value does not fit."""
        raise NotImplementedError


class TopValues(msgspec.Struct, frozen=True):
    """The highest raw values of a number, whatever its width; made by `top`."""

    count: int
    bits: int | None
    place: SourceLine

    def of(self, con: Construct) -> range:
        """Return the values of this construct, the highest first; raises `SpecError` where it has none, or no others."""
        limits = raw_limits(con)
        if limits is None:
            raise SpecError(f"{self.place}: top({self.count}) is of an integer of fixed width")
        low, high = limits
        count = self.count
        if self.bits is not None:
            width = (high - low).bit_length()
            if self.bits > width:
                raise SpecError(f"{self.place}: the highest {self.bits} bits of a number of {width} bits")
            count <<= width - self.bits
        if not 0 < count <= high - low:
            raise SpecError(f"{self.place}: {count} of the {high - low + 1} raw values mean unknown")
        return range(high, high - count, -1)


def top(count: int, *, bits: int | None = None) -> TopValues:
    """Return the `count` highest raw values of a number, whatever its width, for a quantity's `unknown=`.

    With `bits`, those whose highest `bits` bits are the `count` highest. SAE J1939-71 has FE (error) and FF (not available)
    in the highest byte of numbers of 1, 2 and 4 bytes: `top(2, bits=8)`. NMEA 2000 has the highest values themselves.
    """
    return TopValues(count, bits, caller())


def _outside(path: str, value: FieldValue, unit: str, span: str) -> FieldError:
    """Return the error of a value beyond the values that can be sent."""
    unit = unit and f" {unit}"
    return FieldError(f"{path}: {value!r}{unit} is outside {span}{unit}")


class Quantity(Field):
    """A number with a unit: physical = raw × `scale` + `offset`.

    `range` bounds the physical value and `raw_range` the raw one, both inclusive, when building. `unknown` lists raw
    values that mean "not known" (`top` says the highest ones): they decode to None. `names` names raw values that are no
    quantity: they decode to their name. A number that would be sent as one of these is refused. `rounding` says how a
    physical value becomes an integer: "nearest" (ties to even) or "truncate" (toward zero), as the device's sheet has it.
    A quotient that only rounding errors keep from an integer is that integer: what was decoded is sent as it was.
    """

    def __init__(
        self,
        subcon: Construct,
        *,
        unit: str = "",
        scale: float = 1,
        offset: float = 0,
        range: tuple[float, float] | None = None,
        raw_range: tuple[int, int] | None = None,
        unknown: Collection[float] | TopValues = (),
        names: Mapping[str, int] | None = None,
        rounding: str = "nearest",
        doc: str = "",
        source: str = "",
    ) -> None:
        super().__init__(subcon)
        scale, offset = (self._number(value, what) for value, what in ((scale, "scale"), (offset, "offset")))
        if scale == 0 or not math.isfinite(scale) or not math.isfinite(offset):
            raise SpecError(f"{self.place}: a scale must be finite and not zero, and an offset finite")
        if rounding not in ("nearest", "truncate"):
            raise SpecError(f"{self.place}: rounding is 'nearest' or 'truncate', not {rounding!r}")
        self.unit, self.scale, self.offset = unit, scale, offset
        self.range, self.raw_range = self._bounds(range), self._bounds(raw_range)
        #: The raw numbers that can be sent; None: all that the subcon takes.
        self._limits = self.raw_range or raw_limits(subcon)
        if isinstance(unknown, (str, numbers.Real)):
            raise SpecError(f"{self.place}: unknown lists raw values, as in ({unknown!r},)")
        # The subcon shows whether the wire carries a float; found once, when the spec is read.
        self.is_float = is_float(subcon)
        self.unknown = self._unknown_values(unknown.of(subcon) if isinstance(unknown, TopValues) else unknown)
        self._nan_is_unknown = self.is_float and any(value != value for value in self.unknown)
        self.rounding = rounding
        self.docs = doc
        self.source = source
        self.names = dict(names or {})
        self.values = names_by_value(self.names, self.place)
        hidden = next((name for name, value in self.names.items() if value in self.unknown), None)
        if hidden is not None:
            raise SpecError(
                f"{self.place}: {hidden!r} ({self.names[hidden]}) is one of the values that mean unknown"
            )
        if self.names and self.is_float:
            raise SpecError(f"{self.place}: names are for integers, not for floats")
        for name, value in self.names.items() if scale != 1 or offset else ():
            for beside in (value - 1, value + 1):
                if beside * scale + offset == value * scale + offset:
                    raise SpecError(
                        f"{self.place}: {name!r} ({value}) cannot be distinguished from {beside}:"
                        " with this scale and offset both are the same number"
                    )
        #: How far from a bound a decoded edge may lie, as floats are not exact.
        self._slack = 0.0
        if self.range is not None and (scale != 1 or offset):
            reach = max(map(abs, (offset, *(bound for bound in self.range if math.isfinite(bound)))))
            self._slack = 8 * math.ulp(reach)

    def _number(self, value: FieldValue, what: str) -> Any:
        found = plain_number(value)
        if found is None:
            raise SpecError(f"{self.place}: a {what} is a number, not {value!r}")
        return found

    def _unknown_values(self, values: Collection[float]) -> tuple[float, ...] | range:
        """Return the raw values that mean unknown: a range where they are many, such as the highest of 32 bits."""
        if isinstance(values, range) and len(values) > MOST_LISTED and not self.is_float:
            return values
        found = tuple(self._number(value, "value that is unknown") for value in values)
        odd = next((value for value in found if value % 1 != 0), 0)
        if odd != 0 and not self.is_float:
            raise SpecError(f"{self.place}: unknown values are raw: an integer is never {odd}")
        return found

    def _bounds(self, bounds: Any) -> Any:
        if bounds is None:
            return None
        if not isinstance(bounds, Collection) or len(bounds) != 2 or isinstance(bounds, str):
            raise SpecError(f"{self.place}: a range is (least, greatest), not {bounds!r}")
        low, high = (self._number(bound, "bound of a range") for bound in bounds)
        if not low <= high:
            raise SpecError(f"{self.place}: an empty range {bounds}")
        return low, high

    @classmethod
    def span(cls, subcon: Construct, low: float, high: float, *, bits: int, **more: Any) -> Quantity:
        """Return an unsigned `bits`-wide number that spans [`low`, `high`] in 2**bits − 1 steps (MIT motor frames)."""
        return cls(subcon, scale=(high - low) / (2**bits - 1), offset=low, range=(low, high), **more)

    def to_physical(self, raw: Any) -> Any:
        if self.unknown and (raw in self.unknown or (self._nan_is_unknown and raw != raw)):
            return None
        if self.values and raw in self.values:
            return self.values[raw]
        physical = raw * self.scale if self.scale != 1 else raw
        return physical + self.offset if self.offset else physical

    def to_raw(self, value: Any, path: str = "") -> Any:
        if value is None:
            if self.unknown:
                return self.unknown[0]
            raise FieldError(f"{path}: no value given")
        if isinstance(value, str) and self.names:
            return named_number(value, self.names, path)
        given, value = value, plain_number(value)
        if value is None:
            raise FieldError(f"{path}: {given!r} is not a number")
        if self.range is not None:
            low, high = self.range
            if not low - self._slack <= value <= high + self._slack:
                raise _outside(path, value, self.unit, f"{low}…{high}")
        number: Any = value
        try:
            if self.scale != 1 or self.offset:
                number = exact_ratio(value - self.offset, self.scale)
            if not self.is_float and isinstance(number, float):
                number = (
                    round(number)
                    if self.rounding == "nearest"
                    else truncated(number, self.offset / self.scale)
                )
        except (OverflowError, ValueError):  # infinite, NaN, or an integer that no float holds
            raise FieldError(f"{path}: {value!r} cannot be sent with a scale of {self.scale}") from None
        self._refuse_sentinel(number, value, path)
        limits = self._limits
        if limits is not None and not limits[0] <= number <= limits[1]:
            low, high = (edge * self.scale + self.offset for edge in limits)
            raise _outside(path, value, self.unit, f"{low:.10g}…{high:.10g}")
        return number

    def _refuse_sentinel(self, number: Any, value: FieldValue, path: str) -> None:
        """Raise `FieldError` when a number would be read as something else than a number."""
        if self.values and number in self.values:
            raise FieldError(
                f"{path}: {value!r} {self.unit} would be sent as {number}, which means {self.values[number]!r};"
                " give the name if that is meant"
            )
        if self.unknown and self.is_float:
            # What the wire makes of it: a float of fewer bits may come out as the value that means unknown.
            try:
                number = self.subcon.parse(self.subcon.build(number))
            except Exception:  # it does not fit, and building says so
                return
        if number in self.unknown:
            raise FieldError(
                f"{path}: {value!r} {self.unit} would be sent as {number}, which means unknown; give None if that is meant"
            )


def exact_ratio(number: float, scale: float) -> float:
    """Return number ÷ scale: an integer where both are and divide evenly, so that 64 bits survive, else a float."""
    if isinstance(number, int) and isinstance(scale, int) and not number % scale:
        return number // scale
    return number / scale


#: The sum of the rounding errors of scale, offset, value and quotient, relative to quotient and offset.
ROUNDING_ERROR = 2**-49


def truncated(number: float, offset: float) -> int:
    """Return the integer part of a quotient, or the nearest integer where rounding errors alone may lie between.

    `offset` is the quantity's in raw numbers. Raises `OverflowError` and `ValueError` as `int` does.
    """
    nearest = round(number)
    return nearest if abs(number - nearest) <= ROUNDING_ERROR * (abs(number) + abs(offset)) else int(number)


def names_by_value(names: Mapping[str, int], place: SourceLine) -> dict[int, str]:
    """Return the names by their numbers; raises `SpecError` where a number has two."""
    values = {value: name for name, value in names.items()}
    if len(values) == len(names) and {*map(type, values)} <= {int} and {*map(type, names)} <= {str}:
        return values
    values = {}
    for name, value in names.items():
        if not isinstance(name, str) or not isinstance(value, int):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise SpecError(
                f"{place}: names are written name=number or {{name: number}}, not {{{name!r}: {value!r}}}"
            )
        if value in values:
            raise SpecError(
                f"{place}: enumeration value {value} has two names, {values[value]!r} and {name!r}"
            )
        values[value] = name
    return values


def named_number(name: str, names: Mapping[str, int], path: str) -> int:
    """Return the number of a name; raises `FieldError` with the names that there are."""
    if name not in names:
        raise FieldError(f"{path}: no value named {name!r} (there are: {', '.join(names)})")
    return names[name]


class TwoScales(Field):
    """A quantity of two scales: the highest bit of its number chooses, the bits below it are the number in that scale.

    `clear` and `set` are (scale, offset) while that bit is clear and while it is set, both of the one `unit`:
    `TwoScales(Int16ub, (0.1, -1000), (1, 0), unit="m")`. Physical values are floats. What is sent takes the scale that
    comes nearest to the value; where both say it, the finer one. Where another bit chooses, `Split` puts it on top.
    """

    def __init__(
        self,
        subcon: Construct,
        clear: tuple[float, float],
        set: tuple[float, float],
        *,
        unit: str = "",
        doc: str = "",
        source: str = "",
    ) -> None:
        super().__init__(subcon)
        limits = raw_limits(subcon)
        if limits is None or limits[0] or not 1 < limits[1] < 1 << 53:
            raise SpecError(f"{self.place}: TwoScales takes an unsigned integer of 2 to 53 bits")
        self.half = (limits[1] + 1) // 2
        self.unit, self.docs, self.source = unit, doc, source
        #: (scale, offset) while the highest bit is clear, and while it is set.
        self.scales = tuple((float(scale), float(offset)) for scale, offset in (clear, set))
        if not all(scale and math.isfinite(scale) and math.isfinite(offset) for scale, offset in self.scales):
            raise SpecError(f"{self.place}: a scale must be finite and not zero, and an offset finite")

    def to_physical(self, raw: Any) -> float:
        scale, offset = self.scales[raw >= self.half]
        return float(raw % self.half * scale + offset)

    def to_raw(self, value: Any, path: str = "") -> int:
        number = plain_number(value)
        if number is None or not math.isfinite(number):
            raise FieldError(f"{path}: {value!r} is not a number that can be sent")
        raw = raw_of_two(number, self.half, self.scales)
        if raw is None:
            ends = [sorted((offset, (self.half - 1) * scale + offset)) for scale, offset in self.scales]
            raise _outside(path, value, self.unit, " and ".join(f"{low:g}…{high:g}" for low, high in ends))
        return raw


def raw_of_two(value: float, half: int, scales: Sequence[tuple[float, float]]) -> int | None:
    """Return the raw number that says a finite value best in one of two (scale, offset), of which the highest bit, `half`,
    chooses; where both say it, in the finer one. None where neither reaches it.
    """
    found: list[tuple[float, float, int]] = []
    is_inside = False
    for top, (scale, offset) in zip((0, half), scales, strict=True):
        part = round(min(max((value - offset) / scale, -1.0), float(half)))  # which may be infinite
        is_inside |= 0 <= part < half
        part = min(max(part, 0), half - 1)
        miss = abs(part * scale + offset - value)
        is_exact = miss <= 8 * math.ulp(max(abs(value), abs(offset)))
        found.append((0.0 if is_exact else miss, abs(scale), top + part))
    return min(found)[2] if is_inside else None


class SignMagnitude(Field):
    """A sign-and-magnitude integer of `width` bits: the top bit is the sign, the others the magnitude.

    `SignMagnitude(24, "little")` reads three bytes; `SignMagnitude(bits(5))` goes into a `BitLayout`. Negative zero reads
    as 0 and is built as positive zero: the one bit pattern in 2**width that does not survive a round trip.
    """

    def __init__(self, subcon: Construct | int, order: str = "little") -> None:
        if isinstance(subcon, int):
            if subcon % 8 or not 8 <= subcon <= 64:
                raise SpecError(
                    f"{caller()}: {subcon} bits are not 1 to 8 whole bytes; others are SignMagnitude(bits(…)) in a BitLayout"
                )
            self.width = subcon
            subcon = BytesInteger(subcon // 8, swapped=order == "little")
        else:
            self.width = integer_width(subcon)
        super().__init__(subcon)
        self.limit = (1 << self.width - 1) - 1
        self.raw_limits = -self.limit, self.limit

    def _decode(self, obj: Any, context: Any, path: str) -> Any:
        return self.to_physical(obj)

    def _encode(self, obj: Any, context: Container, path: str) -> Any:
        return self.to_raw(obj, path)

    def to_physical(self, raw: Any) -> Any:
        magnitude = raw & self.limit
        return -magnitude if raw > self.limit else magnitude

    def to_raw(self, value: Any, path: str = "") -> Any:
        value = plain_number(value)
        if not isinstance(value, int):
            raise IntegerError(f"{value!r} is not an integer", path=path)
        if abs(value) > self.limit:
            raise IntegerError(f"{value} is outside ±{self.limit}", path=path)
        return value if value >= 0 else (self.limit + 1) | -value


class Enumeration(Field):
    """A number with names. A record shows the name, or the number itself when it has none."""

    def __init__(self, subcon: Construct, names: Mapping[str, int] | None = None, /, **more: int) -> None:
        super().__init__(subcon)
        self.names: dict[str, int] = {**(names or {}), **more}
        self.values = names_by_value(self.names, self.place)

    def to_physical(self, raw: Any) -> Any:
        return self.values.get(raw, raw)

    def to_raw(self, value: Any, path: str = "") -> Any:
        return named_number(value, self.names, path) if isinstance(value, str) else value


class FlagSet(int):
    """The value of a `Flags` field: an int whose bits have names.

    Iterating gives the names of the set bits; each name is a bool attribute; `unknown` are the set bits without a name.
    """

    bits: ClassVar[dict[str, int]] = {}

    def __iter__(self) -> Iterator[str]:
        return (name for name, bit in self.bits.items() if self >> bit & 1)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self.bits and bool(self >> self.bits[name] & 1)

    def __getattr__(self, name: str) -> bool:
        try:
            return bool(self >> type(self).bits[name] & 1)
        except KeyError:
            raise AttributeError(f"no flag named {name!r} (there are: {', '.join(self.bits)})") from None

    @property
    def unknown(self) -> int:
        """The set bits that have no name."""
        named = sum(1 << bit for bit in set(self.bits.values()))
        return int(self) & ~named

    def __repr__(self) -> str:
        names = list(self)
        if self.unknown:
            names.append(f"{self.unknown:#x}")
        return "{" + ", ".join(names) + "}"


class Flags(Field):
    """Named bits, by bit number: `Flags(Byte, overheat=2, overload=5)`. Bits without a name are kept."""

    def __init__(self, subcon: Construct, names: Mapping[str, int] | None = None, /, **more: int) -> None:
        super().__init__(subcon)
        self.names: dict[str, int] = {**(names or {}), **more}
        seen: dict[int, str] = {}
        width = integer_width(subcon)
        for name, bit in self.names.items():
            if not isinstance(name, str) or not isinstance(bit, int):  # pyright: ignore[reportUnnecessaryIsInstance]
                raise SpecError(
                    f"{self.place}: flags are written name=bit or {{name: bit}}, not {{{name!r}: {bit!r}}}"
                )
            if bit in seen:
                raise SpecError(f"{self.place}: flags {seen[bit]!r} and {name!r} share bit {bit}")
            if not 0 <= bit < width:
                raise SpecError(f"{self.place}: flag {name!r} is bit {bit} of a {width}-bit field")
            if hasattr(int, name) or name in ("bits", "unknown"):
                raise SpecError(
                    f"{self.place}: flag {name!r} hides a method of the value; choose another name"
                )
            seen[bit] = name
        self.type: type[FlagSet] = type("FlagSet", (FlagSet,), {"bits": self.names, "__slots__": ()})

    def to_physical(self, raw: Any) -> Any:
        return self.type(raw)

    def to_raw(self, value: Any, path: str = "") -> Any:
        if isinstance(value, int):
            return int(value)
        if isinstance(value, str):
            value = [value] if value else []
        number = 0
        for name in value:
            if name not in self.names:
                raise FieldError(f"{path}: no flag named {name!r} (there are: {', '.join(self.names)})")
            number |= 1 << self.names[name]
        return number

    def _build(self, obj: Any, stream: BinaryIO, context: Container, path: str) -> int:
        super()._build(obj, stream, context, path)
        return int(
            self.to_raw(obj, path)
        )  # what is present by its bits reads the number, however it was given


class Counter(Field):
    """A rolling counter: each packet of a device is `modulo` arithmetic one more than the last.

    In the header of a framing it counts the packets of all its messages. Scanners count what it says was missed
    (`counts.missed`); a stateful encoder, drivers and twins fill it in, a plain encoder takes 0.
    """

    def __init__(self, subcon: Construct, modulo: int | None = None) -> None:
        super().__init__(subcon)
        self.modulo = modulo if modulo is not None else 1 << integer_width(subcon)
        self.raw_limits = raw_limits(subcon)
        self.flagbuildnone = True

    def _encode(self, obj: Any, context: Container, path: str) -> Any:
        return self.to_raw(obj, path)

    def to_physical(self, raw: Any) -> Any:
        return raw

    def to_raw(self, value: Any, path: str = "") -> Any:
        return 0 if value is None else value


class Text(Field):
    """A text of `size` bytes, or of what is left, padded with NUL. Each byte is one character (Latin-1), so all survive.

    With `ends`, a text of `size` bytes stops at the first of these bytes, and is padded with the first one of them.
    """

    def __init__(self, size: int | None = None, *, ends: bytes = b"") -> None:
        super().__init__(GreedyBytes if size is None else Bytes(size))
        if ends and size is None:
            raise SpecError(f"{self.place}: a text of open size ends with its packet; ends= takes a size")
        self.size, self.ends = size, ends.decode("latin-1")

    def to_physical(self, raw: Any) -> Any:
        text = raw.decode("latin-1")
        return text if self.size is None else text_until(text, self.ends)

    def to_raw(self, value: Any, path: str = "") -> Any:
        try:
            data = value.encode("latin-1")
        except (AttributeError, UnicodeEncodeError):
            raise FieldError(f"{path}: {value!r} is not Latin-1 text") from None
        if self.size is None:
            return data
        if len(data) > self.size:
            raise FieldError(f"{path}: {value!r} is longer than {self.size} bytes")
        if text_until(value, self.ends) != value and self.ends:
            raise FieldError(
                f"{path}: {value!r} would be read as {text_until(value, self.ends)!r}, which ends there"
            )
        return data.ljust(self.size, self.ends[:1].encode("latin-1") or b"\0")


def text_until(text: str, ends: str) -> str:
    """Return a text up to the first of these characters; without any, the text without the NULs at its end."""
    if not ends:
        return text.rstrip("\0")
    for end in ends:
        text = text.partition(end)[0]
    return text


#: The fields that take integers, an outer one of a pair first.
_OF_NUMBERS = (SignMagnitude, TwoScales, Enumeration, Flags, Counter, Quantity)
_NO_NUMBERS = (Quantity, TwoScales, Enumeration, Flags, Text)


def Reserved(size: int) -> Construct:
    """Declare `size` bytes without a meaning: zero when we send, kept as they are when we receive."""
    if size < 0:
        raise SpecError(f"{caller()}: Reserved takes a number of bytes, not {size}")
    return Default(Bytes(size), bytes(size))
