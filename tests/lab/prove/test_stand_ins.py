"""Symbolic stand-ins give what the real `struct`, integers and tables give, over all values of small widths."""

from __future__ import annotations

import operator
import struct
from collections.abc import Callable
from typing import Any

import pytest

z3 = pytest.importorskip("z3")
pytestmark = pytest.mark.slow

from aces_bus.protocol import Crc, Fletcher, Sum, Xor  # noqa: E402
from aces_lab.prove.meaning import check_number_of  # noqa: E402
from aces_lab.prove.stand_ins import SymbolicDict, SymbolicList, SymbolicStruct, from_bytes  # noqa: E402
from aces_lab.prove.symbols import (  # noqa: E402
    PathSearch,
    SymbolicBytes,
    SymbolicInt,
    SymbolicName,
    SymbolicReal,
    one_of_values,
)


def number(name: str, width: int, *, signed: bool = False) -> Any:
    term = z3.BitVec(name, width)
    return SymbolicInt(term) if signed else SymbolicInt.unsigned(term)


def value(found: Any, **given: tuple[int, int]) -> Any:
    """The value of a symbolic integer or condition when variables have these (width, value)."""
    term = found.term
    pairs = [(z3.BitVec(n, width), z3.BitVecVal(v, width)) for n, (width, v) in given.items()]
    term = z3.simplify(z3.substitute(term, *pairs))
    return z3.is_true(term) if z3.is_bool(term) else term.as_signed_long()


BINARY: list[Callable[[Any, Any], Any]] = [
    operator.add, operator.sub, operator.mul, operator.and_, operator.or_, operator.xor,
    operator.eq, operator.ne, operator.lt, operator.le, operator.gt, operator.ge,
]  # fmt: skip


@pytest.mark.parametrize("operate", BINARY, ids=lambda f: f.__name__)
def test_integers_compute_as_pythons(operate: Callable[[Any, Any], Any]) -> None:
    """All pairs of a signed 4-bit and an unsigned 3-bit number, and a constant on either side."""
    a, b = number("a", 4, signed=True), number("b", 3)
    both, right, left = operate(a, b), operate(a, 5), operate(-3, a)
    for x in range(-8, 8):
        assert value(right, a=(4, x)) == operate(x, 5)
        assert value(left, a=(4, x)) == operate(-3, x)
        for y in range(8):
            assert value(both, a=(4, x), b=(3, y)) == operate(x, y)


def test_shifts_negation_and_membership_are_pythons() -> None:
    """All signed 5-bit numbers, shifted by up to 7 bits; sets with gaps, ranges, floats among integers."""
    a = number("a", 5, signed=True)
    for x in range(-16, 16):
        for by in range(8):
            assert value(a << by, a=(5, x)) == x << by
            assert value(a >> by, a=(5, x)) == x >> by
        assert value(-a, a=(5, x)) == -x
        assert value(~a, a=(5, x)) == ~x
        for values in ((1, 2, 3, 9), (-5.0, 2.5, 7), range(-3, 9), range(-9, 9, 3), ()):
            assert value(one_of_values(a, values), a=(5, x)) == (x in values)


@pytest.mark.parametrize("format", ["<b", ">B", "<h", ">h", "<H", ">H", "<Bxb", ">bxB", "<BH", ">3B"])
def test_struct_reads_as_struct(format: str) -> None:
    """All values of each byte, the others at three values; lengths that do not fit raise the same error."""
    real, size = struct.Struct(format), struct.calcsize(format)
    found = SymbolicStruct(format).unpack(SymbolicBytes.named("c", size))
    for at in range(size):
        for byte in range(256):
            for others in (0x5A,) if size > 2 else (0, 0x5A, 0xFF):
                data = bytes(byte if i == at else others for i in range(size))
                given = {f"c{i}": (8, data[i]) for i in range(size)}
                assert tuple(value(one, **given) for one in found) == real.unpack(data)
    with pytest.raises(struct.error):
        SymbolicStruct(format).unpack(SymbolicBytes.named("c", size + 1))
    with pytest.raises(struct.error):
        SymbolicStruct(format).unpack_from(SymbolicBytes.named("c", size), 1)


@pytest.mark.parametrize("format", ["<b", ">B", "<h", ">H"])
def test_struct_writes_as_struct(format: str) -> None:
    """All numbers of 10 or 17 bits: the same bytes, and refused where struct refuses."""
    width = 10 if format[1] in "bB" else 17
    a = number("a", width, signed=True)
    built: list[tuple[Any, Any]] = []
    search = PathSearch(60)

    def body() -> None:
        conditions = z3.And(*search.solver.assertions())
        try:
            data = SymbolicStruct(format).pack(a)
        except struct.error:
            data = None
        built.append((z3.And(conditions, *search.solver.assertions()), data))

    search.run(body)
    for x in range(-(1 << width - 1), 1 << width - 1):
        if width == 17 and x % 997 and abs(x) not in (32767, 32768, 32769, 65535):
            continue
        try:
            wanted = struct.pack(format, x)
        except struct.error:
            wanted = None
        pair = (z3.BitVec("a", width), z3.BitVecVal(x, width))
        (found,) = [data for path, data in built if z3.is_true(z3.simplify(z3.substitute(path, pair)))]
        if wanted is None:
            assert found is None
        else:
            cells = [z3.simplify(z3.substitute(cell, pair)).as_long() for cell in found.cells]
            assert bytes(cells) == wanted


def test_from_bytes_and_to_bytes_are_pythons() -> None:
    """Two bytes in both orders, all values of one with three of the other."""
    data = SymbolicBytes.named("c", 2)
    for order in ("little", "big"):
        found = from_bytes(data, order)
        for byte in range(256):
            for other in (0, 0x81, 0xFF):
                given = {"c0": (8, byte), "c1": (8, other)}
                assert value(found, **given) == int.from_bytes(bytes([byte, other]), order)


def test_tables_give_what_dicts_and_lists_give() -> None:
    """Names by number and back, for all 4-bit numbers."""
    names: dict[Any, Any] = {1: "one", 7: "seven"}
    numbers: dict[Any, Any] = {"one": 1, "seven": 7}
    a = number("a", 4)
    PathSearch.current = PathSearch(10)
    shown = SymbolicDict(names).get(a, a)
    assert type(shown) is SymbolicName
    assert {n: shown.names.get(n, n) for n in range(16)} == {n: names.get(n, n) for n in range(16)}
    back = SymbolicDict(numbers).get(shown, shown)
    for x in range(16):
        assert value(back, a=(4, x)) == numbers.get(names.get(x, x), x)
    listed = SymbolicList([names.get(n, n) for n in range(16)])
    PathSearch.current.run(lambda: None)
    assert listed[a].names == names


def test_floats_keep_their_operations_in_order() -> None:
    """The float of each 6-bit number is what Python computes, and limits on it are limits on the number."""
    a = number("a", 6)
    real = a * 0.1 + 3
    assert type(real) is SymbolicReal
    for x in range(64):
        assert real.of(x) == x * 0.1 + 3
    PathSearch.current = PathSearch(10)
    for bound in (3.0, 3.3, 4.05, 9.3, 99.0, -1.0):
        for x in range(64):
            assert value(real <= bound, a=(6, x)) == (x * 0.1 + 3 <= bound)
            assert value(real >= bound, a=(6, x)) == (x * 0.1 + 3 >= bound)


@pytest.mark.parametrize(
    "check",
    [
        Sum(),
        Sum(2, inverted=True),
        Sum(negated=True),
        Xor(),
        Fletcher(),
        Crc("CRC8-AUTOSAR"),
        Crc("CRC16-MODBUS"),
        Crc("CRC16-XMODEM"),
    ],
    ids=lambda check: check.describe,
)
def test_checks_are_computed_as_bytes_are(check: Any) -> None:
    """Three bytes: all values of one of them, with eight of the others."""
    data = SymbolicBytes.named("c", 3)
    found = check_number_of(check, list(data))
    for byte in range(0, 256, 5):
        for other in (0, 1, 0x80, 0xFF, 0x35):
            cells = bytes([other, byte, 255 - other])
            assert value(found, **{f"c{i}": (8, cells[i]) for i in range(3)}) == check.compute(cells)
