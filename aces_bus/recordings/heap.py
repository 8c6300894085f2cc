"""Freed memory stays with the process while blocks are read, instead of going back to the system after each.

1. What is kept is bounded: `_KEPT` at the top of the heap.
2. Where the C library works otherwise, calling this changes nothing.

Reading in blocks makes and drops the same few arrays again and again. glibc gives the top of its heap back when more
than twice its threshold is free, and asks for zeroed pages again with the next block; those page faults took up to
half of the time. The threshold follows the largest block that was ever mapped and freed, so one is: it is never
touched, and costs nothing. *Fact*: mallopt(3), M_MMAP_THRESHOLD, "dynamic mmap threshold".
"""

from __future__ import annotations

import numpy as np

_KEPT = 1 << 24


def keep_freed_memory() -> None:
    """Ask the C library to keep some freed memory."""
    np.empty(_KEPT, np.uint8)
