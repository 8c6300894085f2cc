"""Packets without the check that their transport has added, whole tables at once.

1. A packet passes exactly when `Transport.unwrapped` gives its bytes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..declare.transport import AddedCheck
from ..live.find import number_at
from .checks import CrcColumns
from .table import Array


def without_check(
    check: AddedCheck, extra_of: Callable[[int], bytes], keys: Array, length: Array, data: Array
) -> tuple[Array, Array, Array]:
    """Return which of some packets (bytes in rows of `data`, `length` of each) have the right check, and sizes and
    bytes of these without it. `extra_of` gives the bytes with which a key's check begins."""
    size, (count, width) = check.crc.bytes, data.shape
    long_enough = np.flatnonzero(length >= size)
    sizes = length[long_enough] - size
    starts = long_enough * width
    covered = starts + size if check.is_in_front else starts
    crc = CrcColumns(check.crc)
    register = crc.begin(len(long_enough))
    if check.is_in_front:
        unique, which = np.unique(keys[long_enough], return_inverse=True)
        begun = [
            crc.over(crc.begin(1), np.frombuffer(extra_of(key), np.uint8).reshape(1, -1))
            for key in unique.tolist()
        ]
        register = np.concatenate([register[:0], *begun])[which]
    flat = data.ravel()
    wanted = crc.end(crc.run(register, crc.words(flat), covered, sizes))
    stored = number_at(flat, starts if check.is_in_front else starts + sizes, size, check.crc.order)
    right = stored == wanted
    good = np.zeros(count, bool)
    good[long_enough[right]] = True
    rows = np.zeros((int(np.count_nonzero(good)), width), np.uint8)
    if check.is_in_front:
        rows[:, : width - size] = data[good, size:]
    else:
        rows[:] = data[good]
        rows[np.arange(width) >= sizes[right][:, None]] = 0
    return good, sizes[right], rows
