"""Keys of CAN frames as small numbers, whole columns at once.

1. A key has one number for as long as the table lives, whatever keys come later.

A multiplication scatters the keys that are known over a table without two in one place; a look-up is then a
multiplication and two reads, where a search in a sorted list takes as many steps as its length has bits.
"""

from __future__ import annotations

import numpy as np

from .table import Array

#: Multipliers that are tried: odd, with bits all over (of the golden ratio and of a linear congruence behind it).
_TRIES = 64


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

    def of(self, keys: Array) -> Array:
        """The numbers of keys, int32 (n,)."""
        keys = keys.astype(np.uint32, copy=False)
        if self._is_scattered:
            places = (keys * self._multiplier) >> self._shift
            if (self._there.take(places) == keys).all():
                found: Array = self._number.take(places)
                return found
        new = np.setdiff1d(keys, self.known)
        if len(new):
            self.known = np.concatenate([self.known, new.astype(np.uint32)])
            self._scatter()
            if self._is_scattered:
                return self.of(keys)
        order = np.argsort(self.known)
        return order[np.searchsorted(self.known[order], keys)].astype(np.int32)

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
