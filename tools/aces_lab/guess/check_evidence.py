"""How much it says that a check holds in rows, in bits.

1. Of a CRC or an exclusive or each linearly independent difference between rows is worth the check's width.
2. Of a sum each further row is worth what a step of the check tells (its entropy).
3. A byte that another byte gives alone is a mirror, not a check: it is worth nothing.
"""

from __future__ import annotations

from math import log2

import numpy as np

from aces_bus.protocol.columns.table import Array
from aces_bus.protocol.declare.checks import Order


def sum_bits(kind: str, own: Array, covered: Array) -> float:
    """Return how much it says that a sum of `covered` gives `own` in all rows; 0 where another byte alone gives it."""
    varying = covered[:, (covered != covered[0]).any(axis=0)]
    if varying.shape[1] < 2:
        return 0.0
    if kind != "fletcher":
        for byte in varying.T:
            for row in own.T:
                if any((mirror == mirror[0]).all() for mirror in (row - byte, row + byte, row ^ byte)):
                    return 0.0
    different = len(np.unique(varying, axis=0))
    steps = np.diff(stored_numbers(own, "little"))
    # How evenly the check's steps are spread, beside what so few of them can be.
    spread = entropy_bits(steps) / log2(max(2, min(len(steps), 1 << 8 * own.shape[1])))
    bits = (different - 1) * 8.0 * own.shape[1] * min(spread, 1.0)
    return float(min(bits, 8.0 * independent_rows(varying)) if kind == "xor" else bits)


def independent_rows(covered: Array) -> int:
    """Return how many differences of rows are linearly independent over the field of two elements, counted up to 64."""
    if not covered.shape[1]:
        return 0
    basis: dict[int, int] = {}
    first = int.from_bytes(covered[0].tobytes(), "big")
    for row in covered[1:]:
        number = int.from_bytes(row.tobytes(), "big") ^ first
        while number:
            top = number.bit_length()
            if top not in basis:
                basis[top] = number
                break
            number ^= basis[top]
        if len(basis) >= 64:
            break
    return len(basis)


def entropy_bits(column: Array) -> float:
    """Return how many bits a value tells."""
    _, counts = np.unique(column, return_counts=True)
    share = counts / counts.sum()
    return float(-(share * np.log2(share)).sum())


def stored_numbers(own: Array, order: Order) -> Array:
    """Return the bytes of checks as numbers, int64."""
    out = np.zeros(len(own), np.int64)
    for byte in own.T if order == "big" else own.T[::-1]:
        out = out << 8 | byte
    return out
