"""Where numbers stand in the bytes: whole, in runs of bits, side by side; and the pieces of text that fetch them."""

from __future__ import annotations

from collections.abc import Sequence

from ..plan import nodes as p

FORMATS = {
    ("uint", 1): "B",
    ("uint", 2): "H",
    ("uint", 4): "I",
    ("uint", 8): "Q",
    ("int", 1): "b",
    ("int", 2): "h",
    ("int", 4): "i",
    ("int", 8): "q",
    ("float", 2): "e",
    ("float", 4): "f",
    ("float", 8): "d",
}


def struct_format(scalar: p.Scalar) -> str:
    """The `struct` format of a whole number of usual size, else empty."""
    if scalar.size is None or (scalar.kind, scalar.size) not in FORMATS:
        return ""
    is_plain = not scalar.bits if scalar.kind == "float" else scalar.is_whole
    if not is_plain:
        return ""
    return FORMATS[scalar.kind, scalar.size]


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
    little = len(runs_of(list(scalar.bits)))
    size = scalar.size or 0
    big = len(runs_of([(scalar.offset + size - 1 - b // 8) * 8 + b % 8 for b in scalar.bits]))
    return "big" if big < little else "little"


def runs_of(positions: Sequence[int]) -> list[tuple[int, int, int]]:
    """Contiguous runs: (position of the lowest bit, its place in the number, width)."""
    runs: list[tuple[int, int, int]] = []
    for to, at in enumerate(positions):
        if runs and runs[-1][0] + runs[-1][2] == at:
            first, place, width = runs[-1]
            runs[-1] = (first, place, width + 1)
        else:
            runs.append((at, to, 1))
    return runs


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
