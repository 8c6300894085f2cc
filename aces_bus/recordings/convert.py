"""Recordings from one format to another.

1. `aces convert` does more: filters, windows of time, channels renamed, several files merged.
"""

from __future__ import annotations

import os
import warnings

from ..errors import CallerError
from .base import CanRecording
from .open import open_recording
from .source import PathSource
from .write import open_writer, writer_format


def convert(source: PathSource, target: PathSource) -> None:
    """Write a recording in another format, which the suffix of `target` says, also before `.gz` or `.zst`.

    A warning tells each loss: frames that the format cannot hold, lines of the source that cannot be read. The file appears
    when it is whole. Raises `CaptureError` for what is no recording, `CallerError` for a target that names no format, holds
    other traffic (CAN frames, bytes of a serial line) or cannot be written.

    >>> import tempfile
    >>> packed = f"{tempfile.mkdtemp()}/walk.log.gz"
    >>> convert("examples/captures/hubo2plus.log", packed)
    >>> with open_recording(packed) as recording:
    ...     print(recording.packing, recording.format)
    gzip candump
    """
    path = os.fspath(target)
    if path == "-":
        raise CallerError("convert writes a file; `aces convert` writes to standard output")
    link = writer_format(path).link
    with (
        open_recording(source, link=link) as recording,
        open_writer(path, inputs=[os.fspath(source)]) as writer,
    ):
        for item in recording.tables() if isinstance(recording, CanRecording) else recording:
            writer.write(item)
    told = [f"{path}: {writer.format} does not hold {count} {kind}" for kind, count in writer.lossy.items()]
    told += [f"{recording.name}: {count} {kind} are left out" for kind, count in recording.others.items()]
    if recording.lines_unreadable:
        told.append(
            f"{recording.name}: {recording.lines_unreadable} lines cannot be read: {recording.problems[0]}"
        )
    for text in told:
        warnings.warn(text, stacklevel=2)


__all__ = ["convert"]
