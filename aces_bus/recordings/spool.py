"""A capture as a file on disk, for formats that are read from here and there and not from front to back.

1. A plain file is used where it is; what comes from a pipe, from memory or unpacked is written to a temporary file first.
2. That file is bounded, and it is gone when reading ends, whatever happens.
"""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Generator
from contextlib import contextmanager

from ..errors import CaptureError
from .source import ByteSource

#: A hostile archive may unpack to any size.
LIMIT = 16 << 30


@contextmanager
def on_disk(source: ByteSource) -> Generator[tuple[str, str]]:
    """The path of the capture, and that of a folder for temporary files, which is empty or holds just the capture.

    Raises `CaptureError` when the source is longer than `LIMIT` or cannot be written to disk.
    """
    with tempfile.TemporaryDirectory(prefix="aces-", ignore_cleanup_errors=True) as folder:
        path = _path_of(source)
        if path is None:
            path = os.path.join(folder, "capture")
            size = 0
            try:
                with open(path, "wb") as file:
                    for block in source.blocks():
                        size += len(block)
                        if size > LIMIT:
                            raise CaptureError(
                                f"{source.name}: more than {LIMIT >> 30} GiB that would have to be kept on disk while"
                                " they are read; unpack it to a file and name that"
                            )
                        file.write(block)
            except OSError as error:
                raise CaptureError(
                    f"{source.name}: cannot be kept in {folder} while it is read: {error.strerror or error};"
                    " set TMPDIR to a folder with more room, or name a plain file"
                ) from error
        yield path, folder


def _path_of(source: ByteSource) -> str | None:
    """Where the very bytes of the source are, if that is a plain file."""
    name = getattr(source._file, "name", None)
    if source.live or not isinstance(source._file, io.FileIO) or not isinstance(name, str):
        return None
    try:
        with open(name, "rb") as file:
            head = source.head()
            return os.path.abspath(name) if file.read(len(head)) == head else None
    except OSError:
        return None
