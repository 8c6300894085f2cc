"""The bytes that numbers are fetched with, and pieces of the text that fetches them."""

from __future__ import annotations

from collections.abc import Sequence

from ..declare.bits import runs_of
from ..plan import nodes as p


def clusters(scalars: Sequence[p.Scalar]) -> list[tuple[int, int, str]]:
    """Byte ranges that the scalars cover, merged where they overlap, with the byte order that suits all in it."""
    spans = sorted(
        (min(s.bits) // 8, max(s.bits) // 8 + 1, "" if in_one_byte(s) else run_order(s)) for s in scalars
    )
    found: list[tuple[int, int, str]] = []
    for start, end, order in spans:
        if found and start < found[-1][1]:
            first, last, other = found[-1]
            if order and other and order != other:
                # Two orders over the same bytes: each reads for itself.
                found.append((start, end, order))
                continue
            found[-1] = (first, max(last, end), other or order)
        else:
            found.append((start, end, order))
    return found


def in_one_byte(scalar: p.Scalar) -> bool:
    bits = scalar.bits
    return bool(bits) and bits[0] // 8 == bits[-1] // 8 and bits == tuple(range(bits[0], bits[0] + len(bits)))


def run_order(scalar: p.Scalar) -> str:
    """The byte order in which the field falls into fewer pieces."""
    little = len(scalar.runs)
    size = scalar.size or 0
    big = len(runs_of([(scalar.offset + size - 1 - b // 8) * 8 + b % 8 for b in scalar.bits]))
    return "big" if big < little else "little"


def is_balanced(text: str) -> bool:
    """Whether the first parenthesis closes at the end."""
    depth = 0
    for index, char in enumerate(text):
        depth += (char == "(") - (char == ")")
        if depth == 0 and index < len(text) - 1:
            return False
    return True


def compact(text: str) -> str:
    """`<hhh` as `<3h`."""
    out, last, count = text[0], "", 0
    for char in text[1:] + "\0":
        if char == last and not char.isdigit():
            count += 1
            continue
        if last:
            out += (str(count) if count > 1 else "") + last
        last, count = char, 1
        if char.isdigit():
            out += char
            last, count = "", 0
    return out
