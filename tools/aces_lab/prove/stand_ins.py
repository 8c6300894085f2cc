"""What takes the place of a generated function's globals: `struct`, tables, record types, and the like, for symbolic values.

1. The code that runs is the code object that scanners run; only what it calls by name is replaced, by what it is (a bound
   method of a `Struct`, of a dict, a record type), never by what the plan says.
2. Each stand-in gives what the real one gives; tests hold them against each other over all values of small widths.
3. A global that has no stand-in, and is not a plain value, raises `NotProvable`.
"""

from __future__ import annotations

import builtins
import struct
import types
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from aces_bus.errors import FieldError
from aces_bus.protocol import Enumeration, Flags, Message, Quantity
from aces_bus.protocol.declare.fields import truncated
from aces_bus.protocol.declare.head import Head
from aces_bus.protocol.declare.pattern import IdPattern
from aces_bus.protocol.generate.load import OnDemand

from .scales import shift_of
from .symbols import (
    Among,
    ConstantBytes,
    IntegerType,
    NotProvable,
    PathSearch,
    SymbolicBytes,
    SymbolicFlags,
    SymbolicFloat,
    SymbolicInt,
    SymbolicName,
    SymbolicReal,
    SymbolicRecord,
    one_of_values,
)

_SIZES = {
    "b": 1,
    "B": 1,
    "h": 2,
    "H": 2,
    "i": 4,
    "I": 4,
    "l": 4,
    "L": 4,
    "q": 8,
    "Q": 8,
    "e": 2,
    "f": 4,
    "d": 8,
}


class SymbolicStruct:
    """A `struct.Struct` of standard sizes (`<` or `>`)."""

    def __init__(self, format: str) -> None:
        self.format = format
        mark, rest = format[0], format[1:]
        if mark not in "<>":
            raise NotProvable(f"the struct format {format!r}")
        self.order = "little" if mark == "<" else "big"
        self.items: list[tuple[str, int]] = []
        count = ""
        for char in rest:
            if char.isdigit():
                count += char
                continue
            if char == "s":
                self.items.append(("s", int(count or 1)))
            elif char == "x":
                self.items += [("x", 1)] * int(count or 1)
            elif char in _SIZES:
                self.items += [(char, _SIZES[char])] * int(count or 1)
            else:
                raise NotProvable(f"the struct format {format!r}")
            count = ""
        self.size = sum(size for _, size in self.items)

    def unpack(self, data: SymbolicBytes) -> tuple[Any, ...]:
        if len(data) != self.size:
            raise struct.error(f"unpack requires a buffer of {self.size} bytes")
        return self.unpack_from(data)

    def unpack_from(self, data: SymbolicBytes, at: int = 0) -> tuple[Any, ...]:
        if at < 0 or len(data) - at < self.size:
            raise struct.error(f"unpack_from requires a buffer of at least {self.size} bytes")
        values: list[Any] = []
        for char, size in self.items:
            part = data[at : at + size]
            at += size
            if char == "s":
                values.append(part)
            elif char in "efd":
                values.append(SymbolicReal(SymbolicFloat(part.number(self.order, signed=True).term)))
            elif char != "x":
                values.append(part.number(self.order, signed=char.islower()))
        return tuple(values)

    def pack(self, *values: Any) -> SymbolicBytes:
        left = list(values)
        cells: list[Any] = []
        if len(left) != sum(char != "x" for char, _ in self.items):
            raise struct.error("pack expected another number of items")
        for char, size in self.items:
            if char == "x":
                cells += SymbolicBytes.of(b"\0").cells  # type: ignore[union-attr]
                continue
            cells += self._packed(char, size, left.pop(0)).cells
        return SymbolicBytes(cells)

    def _packed(self, char: str, size: int, value: Any) -> SymbolicBytes:
        if char == "s":
            data = SymbolicBytes.of(value)
            if data is None:
                raise struct.error("argument for 's' must be a bytes object")
            padded: SymbolicBytes = (data + bytes(max(0, size - len(data))))[:size]
            return padded
        if char in "efd":
            if type(value) is SymbolicReal and not value.steps and type(value.base) is SymbolicFloat:
                if value.base.size == 8 * size:
                    if char != "d":  # a signalling NaN becomes a quiet one on its way through Python's float
                        PathSearch.current.exempt.append(value.base.is_signalling)
                    return SymbolicInt(value.base.bits).cut(size, self.order)
            raise NotProvable("a float of the wire that is computed")
        number = SymbolicInt.of(value)
        if number is None:
            raise struct.error("required argument is not an integer")
        try:
            return number.to_bytes(size, self.order, signed=char.islower())
        except OverflowError:
            raise struct.error("argument out of range") from None


def from_bytes(data: Any, order: str = "big", *, signed: bool = False) -> SymbolicInt:
    """Return the number in some bytes, as `int.from_bytes`."""
    cells = SymbolicBytes.of(data)
    assert cells is not None
    return cells.number(order, signed=signed)


class SymbolicDict:
    """A table by number or name: `get`, `in` and look-up for symbolic keys."""

    def __init__(self, table: Mapping[Any, Any]) -> None:
        self.table = table

    def __contains__(self, key: Any) -> bool:
        if type(key) is SymbolicInt:
            return bool(one_of_values(key, [number for number in self.table if isinstance(number, int)]))
        if type(key) is SymbolicReal:
            raise NotProvable("a float that has names")
        return key in self.table

    def __getitem__(self, key: Any) -> Any:
        return self.get(key) if type(key) is SymbolicInt else self.table[key]

    def get(self, key: Any, default: Any = None) -> Any:
        if type(key) is SymbolicInt:
            if default is key or all(isinstance(value, str) for value in self.table.values()):
                return SymbolicName(key, self.table)
            for known, value in self.table.items():  # masks and lengths: one path for each
                if key == known:
                    return value
            return default
        if type(key) is SymbolicName:
            import z3

            # A name goes to its number, a number without a name to itself.
            width = max([key.number.width, *(n.bit_length() + 1 for n in key.names)])
            term = key.number.wide(width)
            for n, name in key.names.items():
                number = self.table.get(name, name)
                if not isinstance(number, int):
                    raise NotProvable(f"{name!r} has no number")
                if number != n:
                    wide = max(width, number.bit_length() + 1)
                    term, width = z3.SignExt(wide - width, term), wide
                    term = z3.If((key.number == n).term, z3.BitVecVal(number, wide), term)
            return SymbolicInt(term)
        if type(key) in (SymbolicReal, SymbolicFlags):
            return default
        return self.table.get(key, default)


class SymbolicList:
    """A table by index; it has a value for each number that its index can be."""

    def __init__(self, values: list[Any]) -> None:
        self.values = values

    def __getitem__(self, index: Any) -> Any:
        if type(index) is not SymbolicInt:
            return self.values[index]
        if not (index >= 0) or not (index < len(self.values)):
            raise IndexError("list index out of range")
        return SymbolicName(index, dict(enumerate(self.values)))


class _SymbolicFlagTable:
    def __init__(self, bits: Mapping[str, int]) -> None:
        self.bits = bits

    def __getitem__(self, number: Any) -> SymbolicFlags:
        return SymbolicFlags(number, self.bits)


class _BytesType(type):
    def __instancecheck__(cls, value: object) -> bool:
        return isinstance(value, bytes)


class _Bytes(metaclass=_BytesType):
    """The name `bytes` in generated code: a type to ask for, and to call."""

    def __new__(cls, value: Any = b"") -> Any:
        return value if type(value) is SymbolicBytes else bytes(value)


_BUILTINS = {**vars(builtins), "bytes": _Bytes, "int": IntegerType}


class StandIns:
    """The globals of one message's generated functions, replaced."""

    def __init__(self, message: Message, holds: Callable[[Any, Any], bool] | None = None) -> None:
        self.message, self.holds = message, holds
        self._made: dict[int, dict[str, Any]] = {}

    def function(self, real: types.FunctionType) -> types.FunctionType:
        """Return the same code over stand-ins for its globals."""
        given = real.__globals__
        space = self._made.setdefault(id(given), {"__builtins__": _BUILTINS, "__name__": given["__name__"]})
        code, names = code_with_constants(real.__code__)
        made = types.FunctionType(code, space, real.__name__, real.__defaults__)
        if given.get(real.__name__) is real:
            space[real.__name__] = made
        for name in names:
            if name in given and name not in space:
                space[name] = self.of(name, given[name])
        return made

    def of(self, name: str, value: Any) -> Any:
        """Return the stand-in of a global; a global without one raises when it is called."""
        real: Any = value
        if isinstance(value, types.BuiltinMethodType | types.MethodType):
            owner = value.__self__
            if isinstance(owner, struct.Struct):
                return getattr(SymbolicStruct(owner.format), value.__name__)
            if isinstance(owner, dict) and value.__name__ == "get":
                return SymbolicDict(owner).get
            if value == int.from_bytes:
                return from_bytes
        if isinstance(value, type) and issubclass(value, msgspec.Struct):
            return recorder(value)
        if isinstance(value, OnDemand):
            return _SymbolicFlagTable(vars(value)["_make"].bits)
        if isinstance(value, dict):
            return SymbolicDict({key: self._inside(item) for key, item in value.items()})
        if isinstance(value, list):
            return SymbolicList(value)
        if isinstance(value, range | tuple):
            return constant(value) if isinstance(value, tuple) else _SymbolicRange(value)
        if name.startswith("holds_") and self.holds is not None:
            return self.holds
        if name.startswith("capture_") and hasattr(value, "__wrapped__"):
            return self._capture(name, value)
        if isinstance(value, types.FunctionType):
            if name.startswith("head_"):
                return self._head(name)
            if real.__globals__.get(name) is real and real.__code__.co_filename.startswith("<aces "):
                return self.function(real)
        if value is truncated:
            return rounded_down
        if value is struct.Struct:
            return SymbolicStruct
        if isinstance(value, type) and issubclass(value, Exception):
            return value
        if isinstance(value, int | float | str | bytes | None):
            return value
        return _Missing(name)

    def _inside(self, value: Any) -> Any:
        """Return a table's value: the functions of a list's kinds are generated, too."""
        if isinstance(value, tuple) and any(isinstance(item, types.FunctionType) for item in value):
            return tuple(
                self.of(item.__name__, item) if isinstance(item, types.FunctionType) else item
                for item in value
            )
        return value

    def _capture(self, name: str, value: Any) -> Any:
        """Return what makes the raw number of a part of an identifier."""
        field = value.__wrapped__.func.__self__

        def to_raw(given: Any) -> Any:
            raw = number_of(field.quantity, given)
            if type(raw) is not SymbolicInt or not one_of_values(raw, field.values):
                raise FieldError(f"{field.name}: not one of its values")
            return raw

        return to_raw

    def _head(self, name: str) -> Any:
        """Return what writes a head field of several values."""
        wanted = name.removeprefix(f"head_{self.message.name}_")
        head = next(h for h in self.message.heads_written if h.name == wanted)

        def write(fields: Mapping[str, Any]) -> SymbolicBytes:
            number = head_number(head, fields)
            if head.pattern is not None and not number_fits(head.pattern, number):
                raise FieldError(f"{head.name}: not one of its values")
            return number.to_bytes(head.size, head.order)

        return write


def code_with_constants(code: types.CodeType) -> tuple[types.CodeType, set[str]]:
    """Return a code object with its constants replaced (in inner functions too), and the names that it uses."""
    names = set(code.co_names)
    consts: list[Any] = []
    for value in code.co_consts:
        if isinstance(value, types.CodeType):
            value, more = code_with_constants(value)
            names |= more
        consts.append(constant(value))
    return code.replace(co_consts=tuple(consts)), names


def rounded_down(number: SymbolicReal, offset: float) -> SymbolicInt:
    """Return the integer part of a quotient, as `truncated`: of a quantity whose offset in raw numbers is this."""
    if abs(offset) != shift_of(number.steps):
        raise NotProvable(f"truncated by an offset of {offset}")
    return number.rounded("truncate")


def number_of(quantity: Any, given: Any) -> Any:
    """Return the raw number of a value of an enumeration or a quantity; None of neither."""
    if isinstance(quantity, Enumeration):
        return SymbolicDict(quantity.names).get(given, given)
    if isinstance(quantity, Quantity):
        if quantity.range or quantity.raw_range or quantity.unknown or quantity.names:
            raise NotProvable("a quantity with limits in a head or identifier")
        if quantity.scale != 1 or quantity.offset:
            given = (given - quantity.offset) / quantity.scale
            return given.rounded(quantity.rounding)
    return given


def head_number(head: Head, fields: Mapping[str, Any]) -> SymbolicInt:
    """Return the number in a head, from the values of a message's fields."""
    if head.pattern is not None and not head.is_own:
        number: Any = SymbolicInt.of(head.pattern.constant)
        for capture in head.pattern.captures:
            raw = number_of(capture.quantity, fields[capture.name])
            if not one_of_values(raw, capture.values):
                raise FieldError(f"{capture.name}: not one of its values")
            number = number + (raw << capture.shift)
        return number  # type: ignore[no-any-return]
    value, field = fields[head.name or ""], head.field
    while not isinstance(field, Enumeration | Quantity) and hasattr(field, "subcon"):
        field = field.subcon
    if isinstance(field, Flags):
        raise NotProvable("flags in a head")
    raw = number_of(field, value)
    if type(raw) is SymbolicFlags:
        raw = raw.number
    if type(raw) is SymbolicBytes:
        return raw.number(head.order)
    if type(raw) is not SymbolicInt:
        raise NotProvable(f"{head.name}: a head that is not an integer")
    return raw


def number_fits(pattern: IdPattern, number: SymbolicInt) -> bool:
    """Return whether a number is of a pattern, on this path."""
    if len(pattern) > 65536:
        raise NotProvable("a head of more than 65536 values")
    return bool(one_of_values(number, list(pattern)))


class _SymbolicRange:
    def __init__(self, values: range) -> None:
        self.values = values

    def __contains__(self, number: Any) -> bool:
        return (
            bool(one_of_values(number, self.values)) if type(number) is SymbolicInt else number in self.values
        )


class _Missing:
    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, *arguments: Any) -> Any:
        raise NotProvable(f"{self.name} has no stand-in")

    __getitem__ = __contains__ = __call__


def constant(value: Any) -> Any:
    """Return a constant of a code object: sets in which a symbolic number may be, bytes that may begin with such."""
    if type(value) is bytes:
        return ConstantBytes(value)
    if isinstance(value, tuple | frozenset) and value and all(isinstance(one, int | float) for one in value):
        return Among(value)
    return value


def recorder(kind: type[msgspec.Struct]) -> Callable[..., SymbolicRecord]:
    """Return what makes a record of symbolic values."""
    fields = kind.__struct_fields__

    def record(*values: Any) -> SymbolicRecord:
        if len(values) != len(fields):
            raise TypeError(f"{kind.__name__} takes {len(fields)} values, not {len(values)}")
        return SymbolicRecord(kind.__name__, dict(zip(fields, values, strict=True)))

    return record
