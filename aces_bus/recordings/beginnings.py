r"""How recordings begin: magic numbers, and first lines that are one format's own.

1. What is here needs no reader, so that the one reader that is needed is imported.
2. A text says what it is in its first 16 KiB; its patterns are compiled when a file is held against them.
"""

from __future__ import annotations

import re
from collections.abc import Callable

SQLITE = b"SQLite format 3\x00"
PYTHON_CAN_CSV = b"timestamp,arbitration_id,extended,remote,error,dlc,data"

_LOOKED_AT = 1 << 14


def begins(*beginnings: bytes, after_blanks: bool = False) -> Callable[[bytes], bool]:
    """Return whether a file begins with one of these."""
    return lambda head: (head.lstrip() if after_blanks else head).startswith(beginnings)


def has_line(pattern: bytes, flags: int = 0) -> Callable[[bytes], bool]:
    """Return whether there is a line of this form among the first ones."""
    return lambda head: re.search(pattern, head[:_LOOKED_AT], flags) is not None


is_python_can_csv = has_line(rb"\A\s*" + PYTHON_CAN_CSV + rb"\s*(?:\n|\Z)")
