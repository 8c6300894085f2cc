"""C as text: names, numbers, tests and statements, and what says that C cannot have something."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from aces_bus.protocol.declare.fields import runs_of_numbers
from aces_bus.protocol.exchange.names import PythonNames
from aces_bus.protocol.exchange.problems import ProblemText

from .dissector_tables import bit_pieces

#: Values that a test lists one by one.
LISTED = 64
_WORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register restrict
return short signed sizeof static struct switch typedef union unsigned void volatile while bool true false asm typeof
alignas alignof and bitand bitor class compl delete explicit export friend mutable namespace new not operator or private
protected public template this throw try using virtual xor
"""
#: What C and C++ keep for themselves, and the headers that are included.
KEYWORDS = frozenset(_WORDS.split())


class NotInC(Exception):
    """C does not say this message; the argument is why."""


def c_name(text: str, taken: set[str]) -> str:
    made = PythonNames.snake(text)
    made = f"n{made}" if made[:1].isdigit() or not made.strip("_") else made
    while made in taken or made in KEYWORDS:
        made += "_"
    taken.add(made)
    return made


def unsigned_bits(width: int) -> int:
    """Return the bits of the C integer that holds `width` bits."""
    return next(size for size in (8, 16, 32, 64) if size >= width)


def c_hex(number: int) -> str:
    """Return an unsigned number, as wide as it needs."""
    return f"{number:#x}{'ull' if number > 0xFFFF_FFFF else 'u'}"


def is_among(name: str, values: Collection[int], most: int | None = None) -> str:
    """Return the test that an unsigned number is one of these; empty where they are all up to `most`."""
    runs = runs_of_numbers(values)
    if len(runs) > LISTED:
        raise NotInC(f"a number among {len(values)} values")
    tests: list[str] = []
    for low, high in runs:
        parts = [f"{name} >= {low}u"] if low else []
        parts += [f"{name} <= {high}u"] if high != most else []
        tests.append(f"{name} == {low}u" if low == high else " && ".join(parts))
    return (
        tests[0] if len(tests) == 1 else " || ".join(f"({test})" if "&&" in test else test for test in tests)
    )


def comment(text: str) -> str:
    """Return a text as it may stand in a comment, where compilers warn of a mark that begins one."""
    return ProblemText.one_line(text).replace("*/", "* /").replace("/*", "/ *")


def refuse_if(test: str, depth: int = 1) -> list[str]:
    """Return statements that end a function with -1."""
    indent = "    " * depth
    return [f"{indent}if ({test}) {{", f"{indent}    return -1;", f"{indent}}}"]


def outside(name: str, limits: tuple[float, float]) -> list[str]:
    """Return tests for values outside the limits, and for NaN."""
    low, high = limits
    parts = [f"{name} >= {c_float(low)}"] if math.isfinite(low) else []
    parts += [f"{name} <= {c_float(high)}"] if math.isfinite(high) else []
    return [f"!({' && '.join(parts)})"] if parts else []


def c_float(number: float) -> str:
    return repr(float(number))


def word_of(bits: Sequence[int]) -> str:
    """Return the unsigned type that computes with so many bits."""
    return "uint64_t" if len(bits) > 32 else "uint32_t"


def terms_of(bits: Sequence[int]) -> str:
    """Return the unsigned number of these bits, out of `data`."""
    word = word_of(bits)
    found: list[str] = []
    for byte, shift, width, place in bit_pieces(bits):
        text = f"data[{byte}]" if not shift else f"(data[{byte}] >> {shift})"
        text = f"({word})({text} & {c_hex((1 << width) - 1)})" if shift + width < 8 else f"({word}){text}"
        found.append(f"{text} << {place}" if place else text)
    return " | ".join(found)


def written(bits: Sequence[int]) -> list[str]:
    """Return statements that put `raw` into these bits of `data`, which are 0."""
    found: list[str] = []
    for byte, shift, width, place in bit_pieces(bits):
        text = f"raw >> {place}" if place else "raw"
        if width < 8:
            text = f"({text} & {c_hex((1 << width) - 1)})"
            text = f"{text} << {shift}" if shift else text
        found.append(f"data[{byte}] |= (uint8_t)({text});")
    return found
