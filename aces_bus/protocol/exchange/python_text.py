"""Python expressions as text, laid out as `ruff format` does with its defaults (and leaves it, with longer lines).

1. Text of others becomes string literals of printable characters; names are given as names by whoever calls.
2. What does not fit on a line is broken one item a line, with a trailing comma, which formatters keep.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

#: Columns of a line.
WIDTH = 88


@dataclass(frozen=True)
class Code:
    """Text that stands as it is: a name, a number in a notation of its own."""

    text: str


@dataclass(frozen=True)
class Call:
    """A call, with positional and keyword arguments."""

    function: str
    arguments: tuple[Expression, ...] = ()
    keywords: tuple[tuple[str, Expression], ...] = ()


@dataclass(frozen=True)
class Sequenced:
    """Items in brackets: a list, a tuple, a set; with `keys` a dictionary."""

    items: tuple[Expression, ...]
    brackets: str = "[]"
    keys: tuple[Expression, ...] = ()


@dataclass(frozen=True)
class Operation:
    """A first operand, then (operator, operand) of one precedence, evaluated from the left."""

    first: Expression
    rest: tuple[tuple[str, Expression], ...]


Expression = Code | Call | Sequenced | Operation


def python_literal(value: Any) -> Expression:
    """A value of Python's own kinds as an expression."""
    if isinstance(value, str):
        return Code(python_string(value))
    if isinstance(value, range):
        first = (value.start,) if value.start or value.step != 1 else ()
        step = (value.step,) if value.step != 1 else ()
        return Call("range", tuple(Code(str(one)) for one in (*first, value.stop, *step)))
    if isinstance(value, Mapping):
        return Sequenced(tuple(map(python_literal, value.values())), "{}", tuple(map(python_literal, value)))
    if isinstance(value, (list, tuple, set, frozenset)):
        is_set = isinstance(value, (set, frozenset))
        items: Iterable[Any] = sorted(value) if is_set else value
        brackets = "{}" if is_set else "[]" if isinstance(value, list) else "()"
        return Sequenced(tuple(map(python_literal, items)), brackets)
    return Code(repr(value))


def python_string(text: str) -> str:
    """A string literal in double quotes, or in single ones where that takes fewer backslashes."""
    quote = "'" if text.count('"') > text.count("'") else '"'
    parts = []
    for character in text:
        if character in (quote, "\\"):
            parts.append(f"\\{character}")
        elif character.isprintable():
            parts.append(character)
        else:
            parts.append(repr(character)[1:-1])
    return quote + "".join(parts) + quote


def flat(one: Expression) -> str:
    """An expression on one line."""
    if isinstance(one, Code):
        return one.text
    if isinstance(one, Operation):
        return flat(one.first) + "".join(f" {operator} {flat(part)}" for operator, part in one.rest)
    if isinstance(one, Call):
        parts = [flat(part) for part in one.arguments]
        parts += [f"{name}={flat(part)}" for name, part in one.keywords]
        return f"{one.function}({', '.join(parts)})"
    if one.keys:
        inner = ", ".join(f"{flat(k)}: {flat(v)}" for k, v in zip(one.keys, one.items, strict=True))
    else:
        inner = ", ".join(map(flat, one.items))
        if one.brackets == "()" and len(one.items) == 1:
            inner += ","
    return one.brackets[0] + inner + one.brackets[1]


def expression_lines(one: Expression, indent: int = 0, before: str = "", after: str = "") -> list[str]:
    """An expression as lines; `before` and `after` stand on its first and its last line."""
    pad = " " * indent
    whole = pad + before + flat(one) + after
    if _columns(whole) <= WIDTH or isinstance(one, Code):
        return [whole]
    if isinstance(one, Operation):
        found = expression_lines(one.first, indent, before)
        for number, (operator, part) in enumerate(one.rest, 1):
            found += expression_lines(part, indent, f"{operator} ", after if number == len(one.rest) else "")
        return found
    if isinstance(one, Call):
        opening, closing = f"{one.function}(", ")"
        items: Sequence[tuple[str, Expression]] = [("", part) for part in one.arguments]
        items = [*items, *((f"{name}=", part) for name, part in one.keywords)]
    else:
        opening, closing = one.brackets[0], one.brackets[1]
        keys = [f"{flat(key)}: " for key in one.keys] or [""] * len(one.items)
        items = list(zip(keys, one.items, strict=True))
    if not items:
        return [whole]
    found = [pad + before + opening]
    for name, part in items:
        found += expression_lines(part, indent + 4, name, ",")
    return [*found, pad + closing + after]


def _columns(line: str) -> int:
    """Columns as formatters count them: wide characters are two."""
    if line.isascii():
        return len(line)
    from unicodedata import combining, east_asian_width

    return sum(0 if combining(ch) else 2 if east_asian_width(ch) in "WF" else 1 for ch in line)


__all__ = [
    "Call",
    "Code",
    "Expression",
    "Operation",
    "Sequenced",
    "expression_lines",
    "flat",
    "python_literal",
    "python_string",
]
