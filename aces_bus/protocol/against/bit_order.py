"""Finds layouts whose bits are counted from the wrong end: their numbers jump, and are smooth in the other order.

1. A number of whole bytes is left to `numbers`; here are those that begin or end inside a byte.
2. Steps are summed up as they come, a number of the layout in both orders of bits.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..columns.table import Array, MessageTable
from ..plan import nodes as p
from .numbers import GAP_BITS, KEPT, STEPS, VALUES, as_numbers, bits_of, step_bits

if TYPE_CHECKING:
    from ..declare.message import Message


class _Pairs(Protocol):
    def pairs(self, values: Array, last: dict[int, Any]) -> tuple[Array, Array]: ...


class _Number:
    """A number in both orders: sums of the bits of its steps, and how many different values it had."""

    def __init__(self, leaf: p.NodePath, other: tuple[int, ...]) -> None:
        self.leaf, self.other = leaf, other
        self.steps, self.bits = 0, np.zeros(2)
        self.values: set[int] = set()
        self.last: tuple[dict[int, Any], dict[int, Any]] = ({}, {})


class BitOrder:
    """The numbers of a message that begin or end inside a byte."""

    def __init__(self, message: Message) -> None:
        #: All numbers whose bits are known, and of them those that are read in the other order, too.
        self._leaves = [
            leaf for leaf in message.plan.leaves if leaf.node.is_number and leaf.node.place and not leaf.whens
        ]
        self._numbers: list[_Number] = []
        for leaf in self._leaves if message.plan.is_flat else ():
            place = leaf.node.place
            other = _other_order(place)
            if other and not leaf.node.is_whole and not leaf.node.is_captured and 4 <= len(place) <= 32:
                self._numbers.append(_Number(leaf, other))

    def take(self, table: MessageTable, followed: _Pairs) -> None:
        """Take the messages of a piece of the recording."""
        if not self._numbers:
            return
        bits: dict[int, Array] = {}
        for leaf in self._leaves:
            values = table[leaf.path].values
            if values.dtype.kind in "iu":
                words = bits_of(leaf.node, values)
                bits.update(
                    (bit, words >> np.uint64(n) & np.uint64(1)) for n, bit in enumerate(leaf.node.place)
                )
        for number in self._numbers:
            if not all(bit in bits for bit in number.other):
                continue
            for which, place in enumerate((number.leaf.node.place, number.other)):
                words = sum(
                    (bits[bit] << np.uint64(n) for n, bit in enumerate(place)),
                    np.zeros(len(table), np.uint64),
                )
                before, after = followed.pairs(words, number.last[which])
                moved = before != after
                read = (as_numbers(number.leaf.node, some[moved]) for some in (before, after))
                number.bits[which] += step_bits(*read).sum()
                if not which:
                    number.steps += int(moved.sum())
                    if len(number.values) < KEPT:
                        number.values.update(np.unique(words)[:KEPT].tolist())

    def smoother(self) -> tuple[int, int] | None:
        """Return how many numbers are much smoother in the other order, of how many that move; None where not most are."""
        moving = [n for n in self._numbers if n.steps >= STEPS and len(n.values) >= VALUES]
        better = sum(bool(n.bits[0] - n.bits[1] >= GAP_BITS * n.steps) for n in moving)
        return (better, len(moving)) if len(moving) > 1 and 2 * better > len(moving) else None


def _other_order(place: Iterable[int]) -> tuple[int, ...]:
    """Return the bits of a number whose layout counts them from the other end of each byte; empty where that is no order."""
    place = tuple(place)
    mirrored = [bit ^ 7 for bit in place]
    if place == tuple(range(place[0], place[0] + len(place))):
        return tuple(reversed(mirrored))
    if mirrored == list(range(mirrored[0], mirrored[0] - len(mirrored), -1)):
        return tuple(reversed(mirrored))
    return ()
