"""Numbers, bytes and conditions that stand for all their values at once, and the search through the paths of a function.

1. A symbolic value that is not understood raises `NotProvable`; none is ever taken for a concrete one.
2. An integer is a signed bit-vector with room for every value that it can have, so that it never wraps, as in Python.
3. A float is never computed: it is the integer, or the bits, that it comes from, with the operations in their order.
   Two floats are the same when both are the same.
4. `Search.run` executes a function once for each path. A condition that the bytes decide either way splits a path in two.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, NoReturn, TypeAlias

import z3
import z3.z3util


class NotProvable(Exception):
    """A construct, an operation or a size that the proof does not cover; the argument says which."""


class NoAnswer(Exception):
    """The solver gave no answer within its limits."""


class Refuted(Exception):
    """A claim that fails; `model` is the solver's counterexample."""

    def __init__(self, what: str, model: z3.ModelRef) -> None:
        super().__init__(what)
        self.model = model


class PathSearch:
    """All paths of a function that runs on symbolic values, with a limit in seconds of processor time."""

    current: PathSearch

    def __init__(self, seconds: float = 60.0, most_paths: int = 20000) -> None:
        self.until = time.process_time() + seconds
        self.most_paths = most_paths
        self.paths = 0
        self.solver: z3.Solver = z3.SimpleSolver()
        # The solver's clock is the wall's: other programs may have the processor most of the time.
        self.solver.set("timeout", max(1, int(3000 * seconds)))
        #: What was decided on this path, and what was to be at its beginning: truths, and numbers that were picked.
        self._prefix: list[int] = []
        self._trail: list[int] = []
        self._known: dict[int, bool] = {}
        self._kept: list[z3.BoolRef] = []
        self._open: list[list[int]] = []
        #: Variables that have one value on this path.
        self._fixed: list[tuple[z3.BitVecRef, z3.BitVecNumRef]] = []
        #: For whoever searches: the last length that is done, and how many paths were accepted.
        self.reached, self.accepted = -1, 0
        #: Conditions on this path under which bytes need not come back: negative zero.
        self.exempt: list[z3.BoolRef] = []

    def run(self, body: Callable[[], None], given: Sequence[z3.BoolRef] = ()) -> int:
        """Execute `body` on every path on which the conditions `given` hold; return the number of paths."""
        PathSearch.current = self
        self._open = [[]]
        count = 0
        while self._open:
            self._prefix, self._trail = self._open.pop(), []
            self._known, self._kept, self._fixed, self.exempt = {}, [], [], []
            count += 1
            self.paths += 1
            if self.paths > self.most_paths:
                raise NotProvable(f"more than {self.most_paths} paths")
            self.solver.push()
            try:
                self.solver.add(*given)
                body()
            finally:
                self.solver.pop()
        return count

    def check(self, condition: z3.BoolRef) -> bool:
        """Return whether a condition can hold on this path; raise `Unknown` when the solver cannot say."""
        left = self.until - time.process_time()
        if left <= 0:
            raise NoAnswer("time limit")
        found = self.solver.check(condition)
        if found == z3.unknown:
            raise NoAnswer(f"the solver gave no answer ({self.solver.reason_unknown()})")
        return bool(found == z3.sat)

    def decide(self, condition: z3.BoolRef) -> bool:
        """Return the truth of a condition on this path; where both are possible, the other one is left for later."""
        condition = z3.simplify(condition)
        if z3.is_true(condition):
            return True
        if z3.is_false(condition):
            return False
        known = self._known.get(condition.get_id())
        if known is not None:
            return known
        step = len(self._trail)
        if step < len(self._prefix):
            chosen = bool(self._prefix[step])
        elif not self.check(condition):
            chosen = False
        else:
            chosen = True
            if self.check(z3.Not(condition)):
                self._open.append([*self._trail, False])
        self._trail.append(chosen)
        self._known[condition.get_id()] = chosen
        self._kept.append(condition)  # its number stays its own while it is kept
        self.solver.add(condition if chosen else z3.Not(condition))
        return chosen

    def value_of(self, term: z3.BitVecRef) -> int:
        """Return the signed number that a term has on this path, splitting the path by its values."""
        for _ in range(4096):
            known = z3.simplify(z3.substitute(term, *self._fixed))
            if z3.is_bv_value(known):
                return int(known.as_signed_long())
            step = len(self._trail)
            if step < len(self._prefix):  # the number that was picked before: models need not come back
                value = self._prefix[step]
            elif not self.check(z3.BoolVal(True)):
                raise NotProvable("a path without inputs")
            else:
                value = int(self.solver.model().eval(term, model_completion=True).as_signed_long())
            self._trail.append(value)
            if self.decide(term == value):
                self._fix(term)
                return value
        raise NotProvable("a number of more than 4096 values decides where bytes are")

    def _fix(self, term: z3.BitVecRef) -> None:
        """Note the variables of a decided term that have one value now."""
        if not self.check(z3.BoolVal(True)):
            raise NotProvable("a path without inputs")
        model = self.solver.model()
        for variable in z3.z3util.get_vars(term):
            value = model.eval(variable, model_completion=True)
            if z3.is_bv_value(value) and not self.check(variable != value):
                self._fixed.append((variable, value))

    def claim(self, condition: z3.BoolRef, what: str) -> None:
        """Prove a condition on this path; raise `Refuted` with a counterexample otherwise."""
        condition = z3.simplify(condition)
        if z3.is_true(condition) or not self.check(z3.Not(condition)):
            return
        raise Refuted(what, self.solver.model())

    def fail(self, what: str) -> NoReturn:
        """Raise `Refuted` with some input of this path."""
        if not self.check(z3.BoolVal(True)):
            raise NotProvable("a path without inputs")
        raise Refuted(what, self.solver.model())


class SymbolicBool:
    """A condition; asking for its truth splits the path."""

    __slots__ = ("term",)

    def __init__(self, term: z3.BoolRef) -> None:
        self.term = term

    def __bool__(self) -> bool:
        return PathSearch.current.decide(self.term)

    def __invert__(self) -> SymbolicBool:
        return SymbolicBool(z3.Not(self.term))


#: What operators of symbolic numbers take.
Number: TypeAlias = "int | float | SymbolicInt | SymbolicReal"


def _refuse(what: str) -> Callable[..., NoReturn]:
    def refuse(self: Any, *arguments: Any) -> NoReturn:
        raise NotProvable(f"{what} of a symbolic {type(self).__name__.removeprefix('Symbolic').lower()}")

    return refuse


def _bits_of(number: int) -> int:
    """Return the bits of a signed bit-vector that holds a number."""
    return (number if number >= 0 else ~number).bit_length() + 1


class _IntegerMeta(type):
    def __instancecheck__(cls, value: object) -> bool:
        return isinstance(value, int)


class IntegerType(int, metaclass=_IntegerMeta):
    """The class that symbolic integers say they have: the name `int` in the code that runs on them."""

    def __new__(cls, value: Any = 0) -> Any:
        kind = type(value)
        if kind is SymbolicFlags:
            return value.number
        if kind is SymbolicReal:
            return value.rounded("truncate")
        return value if kind is SymbolicInt else int(value)


class SymbolicInt:
    """An integer: a signed bit-vector that is wide enough."""

    __slots__ = ("term",)

    def __init__(self, term: z3.BitVecRef) -> None:
        self.term = term

    @classmethod
    def of(cls, value: Any) -> SymbolicInt | None:
        """Return an integer as a symbolic one; None for anything else."""
        if type(value) is SymbolicInt:
            return value
        if isinstance(value, int) and type(value) in (int, bool):
            return cls(z3.BitVecVal(value, _bits_of(value)))
        return None

    @classmethod
    def unsigned(cls, term: z3.BitVecRef) -> SymbolicInt:
        """Return the number whose unsigned bits are `term`."""
        return cls(z3.ZeroExt(1, term))

    @property  # type: ignore[misc]
    def __class__(self) -> type:  # pyright: ignore[reportIncompatibleMethodOverride]
        return IntegerType

    @property
    def width(self) -> int:
        return int(self.term.size())

    def limits(self) -> tuple[int, int]:
        """Return bounds of the number on this path: those of the least number of bits that holds it."""
        term, size = z3.simplify(self.term), self.width
        if z3.is_bv_value(term):
            value = int(term.as_signed_long())
            return value, value
        if z3.is_app_of(term, z3.Z3_OP_CONCAT) and z3.is_bv_value(term.arg(0)) and not term.arg(0).as_long():
            return 0, (1 << size - int(term.arg(0).size())) - 1
        low, high = 1, size
        while low < high:
            middle = (low + high) // 2
            if PathSearch.current.check(z3.SignExt(size - middle, z3.Extract(middle - 1, 0, term)) != term):
                low = middle + 1
            else:
                high = middle
        return -(1 << low - 1), (1 << low - 1) - 1

    def wide(self, width: int) -> z3.BitVecRef:
        """Return the number in at least `width` bits."""
        return z3.SignExt(width - self.width, self.term) if width > self.width else self.term

    def _with(self, other: Any, more: int, operate: Callable[[Any, Any], Any]) -> Any:
        number = SymbolicInt.of(other)
        if number is None:
            return NotImplemented
        width = max(self.width, number.width) + more
        return SymbolicInt(z3.simplify(operate(self.wide(width), number.wide(width))))

    def __add__(self, other: Number) -> Any:
        if isinstance(other, float):
            return SymbolicReal(self) + other
        return self._with(other, 1, lambda a, b: a + b)

    __radd__ = __add__

    def __sub__(self, other: Number) -> Any:
        if isinstance(other, float):
            return SymbolicReal(self) - other
        return self._with(other, 1, lambda a, b: a - b)

    def __rsub__(self, other: Number) -> Any:
        return self._with(other, 1, lambda a, b: b - a)

    def __mul__(self, other: Number) -> Any:
        if isinstance(other, float):
            return SymbolicReal(self) * other
        number = SymbolicInt.of(other)
        return self._with(
            other, min(self.width, number.width) if number is not None else 0, lambda a, b: a * b
        )

    __rmul__ = __mul__

    def __truediv__(self, other: Number) -> Any:
        return SymbolicReal(self) / other

    def over(self, divisor: int) -> SymbolicInt:
        """Return the quotient by a number that divides this one on the whole path, as the float of it rounds."""
        width = max(self.width, _bits_of(divisor))
        wide, by = self.wide(width), z3.BitVecVal(divisor, width)
        if width > 53 or PathSearch.current.check(z3.SRem(wide, by) != 0):
            raise NotProvable(f"rounding a quotient by {divisor}")
        return SymbolicInt(z3.simplify(wide / by))

    def __neg__(self) -> SymbolicInt:
        found: SymbolicInt = 0 - self
        return found

    def __invert__(self) -> SymbolicInt:
        return SymbolicInt(~self.term)

    def __and__(self, other: Number) -> Any:
        if type(other) is int and other >= 0:  # a mask: as many bits as it has
            width = other.bit_length()
            if width == 0:
                return 0
            low = z3.Extract(width - 1, 0, self.wide(width))
            return SymbolicInt.unsigned(z3.simplify(low & z3.BitVecVal(other, width)))
        return self._with(other, 0, lambda a, b: a & b)

    __rand__ = __and__

    def __or__(self, other: Number) -> Any:
        return self._with(other, 0, lambda a, b: a | b)

    __ror__ = __or__

    def __xor__(self, other: Number) -> Any:
        return self._with(other, 0, lambda a, b: a ^ b)

    __rxor__ = __xor__

    def __lshift__(self, other: Number) -> Any:
        if type(other) is not int:
            raise NotProvable("a shift by a symbolic number")
        return SymbolicInt(z3.Concat(self.term, z3.BitVecVal(0, other))) if other else self

    def __rshift__(self, other: Number) -> Any:
        if type(other) is not int:
            raise NotProvable("a shift by a symbolic number")
        top = self.width - 1
        return SymbolicInt(z3.simplify(z3.Extract(top, min(other, top), self.term)))

    def __mod__(self, other: Number) -> Any:
        if type(other) is int and other > 0 and not other & (other - 1):
            return self & (other - 1)
        raise NotProvable("a remainder of a symbolic number")

    def _compare(self, other: Any, test: Callable[[Any, Any], Any]) -> Any:
        number = SymbolicInt.of(other)
        if number is None:
            if type(other) is float:
                if not other.is_integer():
                    raise NotProvable(f"a comparison of an integer with {other}")
                return self._compare(int(other), test)
            return NotImplemented
        width = max(self.width, number.width)
        return SymbolicBool(test(self.wide(width), number.wide(width)))

    def __eq__(self, other: object) -> Any:
        return self._compare(other, lambda a, b: a == b)

    def __ne__(self, other: object) -> Any:
        return self._compare(other, lambda a, b: a != b)

    def __lt__(self, other: Any) -> Any:
        return self._compare(other, lambda a, b: a < b)

    def __le__(self, other: Any) -> Any:
        return self._compare(other, lambda a, b: a <= b)

    def __gt__(self, other: Any) -> Any:
        return self._compare(other, lambda a, b: a > b)

    def __ge__(self, other: Any) -> Any:
        return self._compare(other, lambda a, b: a >= b)

    def __bool__(self) -> bool:
        return PathSearch.current.decide(self.term != 0)

    def __round__(self) -> SymbolicInt:
        return self

    __hash__ = _refuse("hash")
    __index__ = _refuse("index")
    __int__ = _refuse("int()")
    __float__ = _refuse("float()")
    __divmod__ = __floordiv__ = __pow__ = _refuse("arithmetic")

    def bit_length(self) -> NoReturn:
        raise NotProvable("bit_length of a symbolic number")

    def to_bytes(self, size: int, order: str = "big", *, signed: bool = False) -> SymbolicBytes:
        """Return the number as bytes; raise `OverflowError` on the paths where it does not fit."""
        low = -(1 << 8 * size - 1) if signed else 0
        if not (self >= low) or not (self <= low + (1 << 8 * size) - 1):
            raise OverflowError("int too big to convert")
        return self.cut(size, order)

    def cut(self, size: int, order: str) -> SymbolicBytes:
        """Return the lowest `size` bytes of the number."""
        word = self.wide(8 * size)
        cells = [z3.simplify(z3.Extract(8 * i + 7, 8 * i, word)) for i in range(size)]
        return SymbolicBytes(cells if order == "little" else cells[::-1])


def one_of_values(number: SymbolicInt, values: Collection[Any]) -> SymbolicBool:
    """Return the condition that a number is one of `values`; floats among them count where they are whole."""
    if isinstance(values, range) and len(values):
        low, high, step = min(values[0], values[-1]), max(values[0], values[-1]), abs(values.step)
        if step == 1:
            return SymbolicBool(z3.And((number >= low).term, (number <= high).term))
        if len(values) > 4096:
            raise NotProvable(f"a number among {len(values)} values apart")
    whole = sorted({int(value) for value in values if value == value and value % 1 == 0})
    runs: list[list[int]] = []
    for value in whole:
        if runs and runs[-1][1] == value - 1:
            runs[-1][1] = value
        else:
            runs.append([value, value])
    return SymbolicBool(
        z3.Or(
            *[
                (number == a).term if a == b else z3.And((number >= a).term, (number <= b).term)
                for a, b in runs
            ]
        )
    )


class Among(tuple[Any, ...]):
    """Values of which a number may be one: membership is one condition."""

    def __contains__(self, number: object) -> bool:
        if type(number) is SymbolicInt:
            return bool(one_of_values(number, self))
        if type(number) is SymbolicReal:
            return any(number == value for value in self)
        return super().__contains__(number)


class SymbolicBytes:
    """Bytes, each of 8 symbolic bits, of known length."""

    __slots__ = ("cells",)

    def __init__(self, cells: Sequence[z3.BitVecRef]) -> None:
        self.cells = list(cells)

    @classmethod
    def named(cls, name: str, size: int) -> SymbolicBytes:
        """Return bytes that may be anything."""
        return cls([z3.BitVec(f"{name}{i}", 8) for i in range(size)])

    @classmethod
    def of(cls, value: Any) -> SymbolicBytes | None:
        """Return bytes as symbolic ones; None for anything else."""
        if type(value) is SymbolicBytes:
            return value
        if isinstance(value, bytes | bytearray):
            return cls([z3.BitVecVal(byte, 8) for byte in value])
        return None

    @property  # type: ignore[misc]
    def __class__(self) -> type:  # pyright: ignore[reportIncompatibleMethodOverride]
        return bytes

    def __len__(self) -> int:
        return len(self.cells)

    def __getitem__(self, at: Any) -> Any:
        if isinstance(at, slice):
            bounds = [concrete(bound) for bound in (at.start, at.stop, at.step)]
            return SymbolicBytes(self.cells[slice(*bounds)])
        return SymbolicInt.unsigned(self.cells[concrete(at)])

    def __iter__(self) -> Iterator[SymbolicInt]:
        return (SymbolicInt.unsigned(cell) for cell in self.cells)

    def __add__(self, other: Any) -> Any:
        more = SymbolicBytes.of(other)
        return NotImplemented if more is None else SymbolicBytes(self.cells + more.cells)

    def __radd__(self, other: Any) -> Any:
        more = SymbolicBytes.of(other)
        return NotImplemented if more is None else SymbolicBytes(more.cells + self.cells)

    def same(self, other: SymbolicBytes) -> z3.BoolRef:
        """Return the condition that both are the same bytes."""
        if len(self) != len(other):
            return z3.BoolVal(False)
        return z3.And(*[a == b for a, b in zip(self.cells, other.cells, strict=True)])

    def __eq__(self, other: object) -> Any:
        more = SymbolicBytes.of(other)
        return NotImplemented if more is None else SymbolicBool(self.same(more))

    def __ne__(self, other: object) -> Any:
        more = SymbolicBytes.of(other)
        return NotImplemented if more is None else SymbolicBool(z3.Not(self.same(more)))

    def __bool__(self) -> bool:
        return bool(self.cells)

    __hash__ = _refuse("hash")

    def number(self, order: str, *, signed: bool = False) -> SymbolicInt:
        """Return the number in these bytes."""
        cells = self.cells if order == "big" else self.cells[::-1]
        if not cells:
            return SymbolicInt(z3.BitVecVal(0, 1))
        word = z3.Concat(*cells) if len(cells) > 1 else cells[0]
        return SymbolicInt(word) if signed else SymbolicInt.unsigned(word)

    def startswith(self, start: bytes, at: int = 0, end: int | None = None) -> SymbolicBool:
        part = self[at : len(self) if end is None else end][: len(start)]
        return SymbolicBool(part.same(SymbolicBytes.of(start)))

    def find(self, wanted: bytes, start: int = 0, end: int | None = None) -> int:
        """Return the first place of some bytes, or -1; a path for each."""
        stop = len(self) if end is None else min(len(self), concrete(end))
        places = range(concrete(start), stop - len(wanted) + 1)
        return next((at for at in places if self.startswith(wanted, at)), -1)

    def decode(self, encoding: str = "utf-8") -> SymbolicText:
        if encoding != "latin-1":
            raise NotProvable(f"text in {encoding}")
        return SymbolicText(self)


class ConstantBytes(bytes):
    """Bytes of the text: they may begin with symbolic ones."""

    def startswith(self, start: Any, /, *more: Any) -> Any:
        if type(start) is not SymbolicBytes:
            return super().startswith(start, *more)
        whole = SymbolicBytes([z3.BitVecVal(byte, 8) for byte in self])
        return SymbolicBool(whole[: len(start)].same(start))


class Uncompared:
    """A value that only `same` compares."""

    __eq__ = __hash__ = __bool__ = _refuse("comparison")


class SymbolicText(Uncompared):
    """A Latin-1 text of symbolic bytes; `is_stripped`: without the NULs at its end."""

    def __init__(self, data: SymbolicBytes, is_stripped: bool = False) -> None:
        self.data, self.is_stripped = data, is_stripped

    def rstrip(self, char: str) -> SymbolicText:
        if char != "\0":
            raise NotProvable(f"a text stripped of {char!r}")
        return SymbolicText(self.data, True)


class SymbolicFloat(Uncompared):
    """The bits of a float of the wire."""

    def __init__(self, bits: z3.BitVecRef) -> None:
        self.bits = bits
        size = int(bits.size())
        exponent = {16: 5, 32: 8, 64: 11}[size]
        self.fraction = size - exponent - 1
        self.size = size

    @property
    def is_nan(self) -> z3.BoolRef:
        exponent = z3.Extract(self.size - 2, self.fraction, self.bits)
        return z3.And(exponent == -1, z3.Extract(self.fraction - 1, 0, self.bits) != 0)

    @property
    def is_signalling(self) -> z3.BoolRef:
        """The condition that it is a NaN whose highest bit of the fraction is 0."""
        return z3.And(self.is_nan, z3.Extract(self.fraction - 1, self.fraction - 1, self.bits) == 0)

    def equals(self, value: float) -> z3.BoolRef:
        """Return the condition that the float is this one; a zero is that of either sign."""
        import struct

        mark = {16: "<e", 32: "<f", 64: "<d"}[self.size]
        try:
            packed = struct.pack(mark, value)
        except OverflowError:
            return z3.BoolVal(False)
        if value != value or struct.unpack(mark, packed)[0] != value:
            return z3.BoolVal(False)
        if value == 0:
            return z3.Extract(self.size - 2, 0, self.bits) == 0
        return self.bits == int.from_bytes(packed, "little")


Step = tuple[str, float]


class SymbolicReal:
    """A float: the integer or float of the wire that it is computed from, and the operations in their order."""

    def __init__(self, base: SymbolicInt | SymbolicFloat, steps: tuple[Step, ...] = ()) -> None:
        self.base, self.steps = base, steps

    @property  # type: ignore[misc]
    def __class__(self) -> type:  # pyright: ignore[reportIncompatibleMethodOverride]
        return float

    def _then(self, operation: str, number: Any) -> Any:
        if type(number) not in (int, float):
            raise NotProvable(f"a float {operation} {type(number).__name__}")
        if type(number) is int and abs(number) <= 1 << 53:
            number = float(number)  # as Python does it, and exact
        if operation == "-":
            operation, number = "+", -number  # the same float, always
        return SymbolicReal(self.base, (*self.steps, (operation, number)))

    def __add__(self, other: Number) -> Any:
        return self._then("+", other)

    def __sub__(self, other: Number) -> Any:
        return self._then("-", other)

    def __mul__(self, other: Number) -> Any:
        return self._then("*", other)

    def __truediv__(self, other: Number) -> Any:
        return self._then("/", other)

    __radd__, __rmul__ = __add__, __mul__

    def of(self, raw: float) -> float:
        """Return the float for one raw number."""
        found = raw
        for operation, number in self.steps:
            found = (
                found * number if operation == "*" else found / number if operation == "/" else found + number
            )
        return found

    def __round__(self) -> Any:
        return self.rounded("nearest")

    def rounded(self, rounding: str) -> SymbolicInt:
        """Return the integer that rounding gives: that of the wire, where all its values were shown to come back."""
        from .scales import comes_back

        if type(self.base) is not SymbolicInt:
            raise NotProvable("a float of the wire as an integer")
        operation, divisor = self.steps[0] if len(self.steps) == 1 else ("", 0)
        if operation == "/" and float(divisor).is_integer() and abs(divisor) > 1:  # of a product of integers
            return self.base.over(int(divisor))
        limits = self.base.limits()
        if not comes_back(limits, self.steps, rounding):
            raise NotProvable(f"rounding back {limits[0]}…{limits[1]}")
        return self.base

    def _compare(self, bound: float, *, above: bool) -> SymbolicBool:
        """Return the condition that the float is at least (`above`) or at most `bound`, as one on the raw integer."""
        if type(self.base) is not SymbolicInt or type(bound) not in (int, float):
            raise NotProvable("a comparison of floats")
        low, high = self.base.limits()

        def holds(raw: int) -> bool:
            return self.of(raw) >= bound if above else self.of(raw) <= bound

        if holds(low) == holds(high):  # rounding keeps the order, so that it is the same between
            return SymbolicBool(z3.BoolVal(holds(low)))
        first = holds(low)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if holds(middle) == first else (low, middle)
        found: SymbolicBool = self.base <= low if first else self.base >= high
        return found

    def __le__(self, other: Any) -> Any:
        return self._compare(other, above=False)

    def __ge__(self, other: Any) -> Any:
        return self._compare(other, above=True)

    def __eq__(self, other: object) -> Any:
        if self.steps or type(self.base) is not SymbolicFloat or not isinstance(other, (int, float)):
            raise NotProvable("a comparison of floats")
        return SymbolicBool(self.base.equals(float(other)))

    def __ne__(self, other: object) -> Any:
        if other is self and type(self.base) is SymbolicFloat and not self.steps:
            return SymbolicBool(self.base.is_nan)
        raise NotProvable("a comparison of floats")

    __hash__ = _refuse("hash")
    __float__ = __int__ = __index__ = __bool__ = _refuse("conversion")


class SymbolicName(Uncompared):
    """The name of a number where it has one, else the number."""

    def __init__(self, number: SymbolicInt, names: Mapping[int, Any]) -> None:
        self.number = number
        self.names = {n: name for n, name in names.items() if type(name) is not int or name != n}


class SymbolicFlags(Uncompared):
    """A number whose bits have names."""

    def __init__(self, number: SymbolicInt, bits: Mapping[str, int]) -> None:
        self.number, self.bits = number, dict(bits)

    @property  # type: ignore[misc]
    def __class__(self) -> type:  # pyright: ignore[reportIncompatibleMethodOverride]
        return IntegerType


class SymbolicRecord(Uncompared):
    """A record: its type's name and its values by field."""

    def __init__(self, kind: str, values: Mapping[str, Any]) -> None:
        self.kind, self.values = kind, dict(values)


def concrete(number: Any) -> Any:
    """Return the number on this path as Python's own, splitting the path by its values; other values as they are."""
    return PathSearch.current.value_of(number.term) if type(number) is SymbolicInt else number


def same_value(got: Any, want: Any) -> z3.BoolRef | str:
    """Return the condition that two values of a record are the same, or a text that says why they are never."""
    kind = type(want)
    if want is None or got is None or isinstance(want, str) or isinstance(got, str):
        return (
            z3.BoolVal(True)
            if type(got) is kind and got == want
            else f"{shown(got)} instead of {shown(want)}"
        )
    for plain in (SymbolicInt, SymbolicBytes):
        mine, theirs = plain.of(got), plain.of(want)
        if theirs is not None or mine is not None:
            if mine is None or theirs is None:
                return f"{shown(got)} instead of {shown(want)}"
            return (mine == theirs).term
    if type(got) is not kind:
        return f"{shown(got)} instead of {shown(want)}"
    if kind is SymbolicReal:
        if got.steps != want.steps:
            return f"{shown(got)} instead of {shown(want)}"
        return same_value(got.base, want.base)
    if kind is SymbolicFloat:
        return got.bits == want.bits if got.size == want.size else "a float of another size"
    if kind is SymbolicText:
        if got.is_stripped is not want.is_stripped:
            return "a text with its NULs" if want.is_stripped else "a text without its NULs"
        return got.data.same(want.data)
    if kind is SymbolicName:
        differing = [n for n in {**got.names, **want.names} if got.names.get(n, n) != want.names.get(n, n)]
        return z3.And((got.number == want.number).term, z3.Not(one_of_values(want.number, differing).term))
    if kind is SymbolicFlags:
        if got.bits != want.bits:
            return f"flags {got.bits} instead of {want.bits}"
        return (got.number == want.number).term
    return f"a {kind.__name__}, which is not compared" if got is not want else z3.BoolVal(True)


def shown(value: Any) -> str:
    """Return a value of a record in a few words."""
    if type(value) is SymbolicReal:
        return " ".join(["number", *(f"{operation} {number!r}" for operation, number in value.steps)])
    kind = type(value)
    return kind.__name__.removeprefix("Symbolic").lower() if kind.__module__ == __name__ else repr(value)
