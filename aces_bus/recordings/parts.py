"""One large log in parts, for several processes to read beside each other.

1. Parts are in order and without gaps, each of whole lines: read one after the other they are the file.
"""

from __future__ import annotations

from .base import CanRecording
from .candump.reader import CandumpCapture
from .open import open_recording
from .source import ByteSource, split_lines

#: Bytes of a part that are worth another process.
LEAST = 1 << 16
#: First byte, and the one behind the last.
Span = tuple[int, int]


def split_capture(path: str, pieces: int) -> list[Span] | None:
    """That many parts of about the same size, none smaller than `LEAST`.

    None for what can only be read from its start: packed files, pipes, other formats.

    Raises `CaptureError` when the file cannot be opened or is no CAN capture.
    """
    with open_recording(path, link="can") as capture:
        if capture.live or not isinstance(capture, CandumpCapture):
            return None
    spans = split_lines(path, pieces, LEAST)
    return spans if len(spans) > 1 else None


def open_part(path: str, span: Span) -> CanRecording:
    """The frames of a part; lines are counted from its start."""
    capture = CandumpCapture(ByteSource(path, span=span))
    capture.is_known = True  # by the file's start: a part may well begin with what nobody can read
    return capture


__all__ = ["Span", "open_part", "split_capture"]
