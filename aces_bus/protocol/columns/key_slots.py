"""What CAN identifiers may be, as small numbers: the slots by which tables of frames are sorted.

What a key is, is asked once; then it is in an array for 11-bit identifiers, in a sorted list for all other keys.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...frame_table import FrameFlag, FrameTable
from ..live.decide import REMEMBERED
from .key_numbers import KeyNumbers, few_keys
from .table import Array

STANDARD = 0x800

#: What a slot's frames are, beside the messages that have decoders.
UNKNOWN, ERROR_FRAME, LIVE = range(3)


class KeySlots:
    """The slots of keys; what each is, `slot_of` says once."""

    def __init__(self, slot_of: Callable[[int], int]) -> None:
        self._slot = slot_of
        #: Slots of 11-bit data frames; −1 not looked up yet.
        self._standard = np.full(STANDARD, -1, np.int32)
        #: All other keys that were looked up, and their slots.
        self._keys = KeyNumbers()
        self._slots = np.empty(0, np.int32)
        self._by_place = self._slots

    def of(self, table: FrameTable) -> Array:
        """Return the slot of each frame, int32 (n,)."""
        flags = table.flags
        any_flags = int(np.bitwise_or.reduce(flags)) if len(flags) else 0
        if len(self._keys) < REMEMBERED and not any_flags & FrameFlag.ERROR and (few := few_keys(table.key)):
            slots = self._other_slots(few.present())
            if (slots == slots[0]).all():
                return np.broadcast_to(slots[0], len(table))
        if not any_flags & FrameFlag.UNUSUAL:
            return self._standard_slots(table.id)
        key = table.key
        if (flags[0] == flags).all() and not any_flags & FrameFlag.ERROR:
            return self._other_slots(key)
        slots = np.empty(len(table), np.int32)
        plain = (flags & FrameFlag.UNUSUAL) == 0
        slots[plain] = self._standard_slots(table.id[plain])
        errors = (flags & FrameFlag.ERROR) != 0
        slots[errors] = ERROR_FRAME
        others = ~(plain | errors)
        if others.any():
            slots[others] = self._other_slots(key[others])
        return slots

    def _standard_slots(self, identifiers: Array) -> Array:
        if len(identifiers) and int(identifiers.max()) >= STANDARD:
            return self._other_slots(identifiers)  # no frame of a bus, but a table may hold it
        slots: Array = self._standard.take(identifiers)
        if len(slots) and int(slots.min()) < 0:
            is_new = np.zeros(STANDARD, bool)
            is_new[identifiers] = True
            for key in np.flatnonzero(is_new & (self._standard < 0)).tolist():
                self._standard[key] = self._slot(key)
            slots = self._standard.take(identifiers)
        return slots

    def _other_slots(self, keys: Array) -> Array:
        if len(self._keys) < REMEMBERED:
            places = self._keys.places(keys)
            if len(new := self._keys.known[len(self._slots) :]):
                slots = [self._slot(key) for key in new.tolist()]
                self._slots = np.concatenate([self._slots, np.array(slots, np.int32)])
                self._by_place = self._keys.by_place(self._slots)
            found: Array = self._by_place.take(places)
            return found
        unique, inverse = np.unique(keys, return_inverse=True)
        return np.array([self._slot(key) for key in unique.tolist()], np.int32)[inverse]


__all__ = ["ERROR_FRAME", "LIVE", "UNKNOWN", "KeySlots"]
