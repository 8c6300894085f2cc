"""Keys of CAN frames as small numbers, whole columns at once.

1. A key has one number for as long as the table lives, whatever keys come later.

A multiplication scatters the keys that are known over a table without two in one place; a look-up is then a
multiplication and two reads, where a search in a sorted list takes as many steps as its length has bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .table import Array

#: Multipliers that are tried: odd, with bits all over (of the golden ratio and of a linear congruence behind it).
_TRIES = 64
#: So many keys are looked at first.
_SAMPLE = 4096


class KeyNumbers:
    """Numbers for keys, from 0 on, in the order in which they first came."""

    def __init__(self) -> None:
        #: The keys by their numbers, uint32.
        self.known: Array = np.empty(0, np.uint32)
        self._multiplier, self._shift = np.uint32(1), np.uint32(31)
        #: By place: the key there and its number; one that is not there has a key that scatters elsewhere.
        self._there: Array = np.empty(0, np.uint32)
        self._number: Array = np.empty(0, np.int32)
        self._is_scattered = False

    def __len__(self) -> int:
        return len(self.known)

    @property
    def room(self) -> int:
        """Bound of `places`: all are below."""
        return len(self._there) if self._is_scattered else len(self.known)

    def by_place(self, values: Array) -> Array:
        """Return what is given by the numbers of the known keys, by their `places`."""
        return values.take(self._number) if self._is_scattered else values

    def of(self, keys: Array) -> Array:
        """Return the numbers of keys, int32 (n,)."""
        places = self.places(keys)
        found: Array = self._number.take(places) if self._is_scattered else places
        return found

    def places(self, keys: Array) -> Array:
        """Return places of keys, below `room` (n,): each key has its own, until a new key comes."""
        keys = keys.astype(np.uint32, copy=False)
        if not self._is_scattered and not len(self.known):
            self._learn(keys[:_SAMPLE])  # most are among them, and few are sorted quickly
        if self._is_scattered:
            places = ((keys * self._multiplier) >> self._shift).astype(np.intp)
            is_there = self._there.take(places) == keys
            if is_there.all():
                return places
            self._learn(keys[~is_there])
            return self.places(keys)
        self._learn(keys)
        if self._is_scattered:
            return self.places(keys)
        order = np.argsort(self.known)
        return order[np.searchsorted(self.known[order], keys)].astype(np.int32)

    def _learn(self, keys: Array) -> None:
        """Give numbers to those of some keys that have none."""
        new = np.setdiff1d(keys, self.known)
        if len(new):
            self.known = np.concatenate([self.known, new])
            self._scatter()

    def _scatter(self) -> None:
        """Look for a multiplier that gives each key a place of its own."""
        known = self.known
        bits = max(4, (len(known) ** 2 // 2).bit_length()) if len(known) < 256 else 18
        multiplier = 0x9E37_79B1
        for _ in range(_TRIES):
            self._multiplier, self._shift = np.uint32(multiplier), np.uint32(32 - min(bits, 18))
            places = (known * self._multiplier) >> self._shift
            if len(np.unique(places)) == len(known):
                size = 1 << min(bits, 18)
                # A place without a key has one that belongs elsewhere: no key that scatters there is equal to it.
                self._there, self._number = np.full(size, known[0], np.uint32), np.zeros(size, np.int32)
                if places[0] != places[-1]:
                    self._there[places[0]] = known[-1]
                self._there[places] = known
                self._number[places] = np.arange(len(known))
                self._is_scattered = True
                return
            multiplier = (multiplier * 0x19660D + 0x3C6EF35F) % (1 << 32) | 1
        self._is_scattered = False


class FewKeys(NamedTuple):
    """Keys that differ in at most eight bits side by side: the number of each, uint8 (n,), and the key of every number."""

    numbers: Array
    keys: Array

    def present(self) -> Array:
        """Return the keys that occur."""
        some = np.bincount(self.numbers[:_SAMPLE], minlength=len(self.keys))
        return self.keys[some > 0 if some.all() else np.bincount(self.numbers, minlength=len(self.keys)) > 0]


def few_keys(keys: Array) -> FewKeys | None:
    """Return keys as numbers made of the bits in which they differ; None if these bits span more than eight.

    0x181, 0x182, 0x183 differ in bits 0 and 1: their numbers are 1, 2, 3, and the keys by number 0x180 … 0x183.
    """
    if not len(keys):
        return None
    differing = int(np.bitwise_or.reduce(keys ^ keys[:1]))
    lowest = max(0, (differing & -differing).bit_length() - 1)
    width = (differing >> lowest).bit_length()
    if width > 8:
        return None
    mask = (1 << width) - 1
    numbers = (keys >> np.uint32(lowest)).astype(np.uint8) & np.uint8(mask)
    shared = np.uint32(int(keys[0]) & ~(mask << lowest))
    return FewKeys(numbers, shared | np.arange(mask + 1, dtype=np.uint32) << np.uint32(lowest))
