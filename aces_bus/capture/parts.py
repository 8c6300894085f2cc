"""One large log in parts, for several processes to read beside each other.

1. Parts are in order and without gaps, each of whole lines: read one after the other they are the file.
"""

from __future__ import annotations

import os

from ._source import Source, split_lines
from .base import CanCapture
from .candump import CandumpCapture
from .open import open_capture

#: First byte, and the one behind the last.
Span = tuple[int, int]


def split_capture(path: str, size: int) -> list[Span] | None:
    """Parts of about `size` bytes; None for what can only be read from its start: packed files, pipes, other formats.

    Raises `CaptureError` when the file cannot be opened or is no CAN capture.
    """
    with open_capture(path, link="can") as capture:
        if capture.live or not isinstance(capture, CandumpCapture):
            return None
    pieces = max(1, os.path.getsize(path) // size)
    spans = split_lines(path, pieces, min(size, 1 << 20))
    return spans if len(spans) > 1 else None


def open_part(path: str, span: Span) -> CanCapture:
    """The frames of a part; lines are counted from its start."""
    capture = CandumpCapture(Source(path, span=span))
    capture.is_known = True  # by the file's start: a part may well begin with what nobody can read
    return capture


__all__ = ["Span", "open_part", "split_capture"]
