"""The one place that reads: a path, standard input or an open file becomes blocks of bytes.

1. A live source (pipe, terminal, socket, device) hands over what is there; it never waits to fill a block.
2. A line is never longer than `MAX_LINE` for those who ask for lines: memory stays bounded whatever arrives.
3. Whatever the system refuses is a `CaptureError` that names the source.
"""

from __future__ import annotations

import difflib
import os
import select
import stat
import sys
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO

from ..errors import CaptureError

BLOCK = 1 << 16
#: A longer line is cut to one byte more than this, and is unreadable by that.
MAX_LINE = 4096

PathSource = str | os.PathLike[str]


class Source:
    """Bytes of one capture, once, from where the source stands.

    `live` says that the bytes may still be in the making. The file is closed at its end, or by `close`, when it was
    opened here; standard input and files of the caller stay open.
    """

    def __init__(self, source: PathSource | BinaryIO, name: str | None = None) -> None:
        self._owned = False
        self._head: list[bytes] = []
        self._ended = False
        if isinstance(source, (str, os.PathLike)):
            path = os.fspath(source)
            self.name = path if name is None else name
            self._file: Any = _standard_input() if path == "-" else self._open(path)
        else:
            given = getattr(source, "name", None)
            self.name = name if name is not None else given if isinstance(given, str) else "<stream>"
            self._file = getattr(source, "buffer", source)  # a text file brings its bytes along
        read = getattr(self._file, "read1", None) or getattr(self._file, "read", None)
        if read is None:
            kind = type(source).__name__
            raise CaptureError(f"{self.name}: {kind} cannot be read; give a path, '-' or an open file")
        self._read: Callable[[int], Any] = read
        self.live = _is_live(self._file)

    def _open(self, path: str) -> BinaryIO:
        try:
            file = open(path, "rb", buffering=0)  # noqa: SIM115 - `close` closes it
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            raise CaptureError(f"{self.name}: {_why(path, error)}") from error
        self._owned = True
        return file

    def head(self) -> bytes:
        """What has been looked at so far, kept for `blocks`: the first block, or of a live source what was there."""
        if not self._head:
            self.look_further()
        return b"".join(self._head)

    def look_further(self) -> bool:
        """Read some more for `head`; False at the end of the source."""
        wanted = BLOCK
        while wanted > 0 and (data := self._next(wanted)):
            self._head.append(data)
            wanted = 0 if self.live else wanted - len(data)
        return not self._ended

    def blocks(self) -> Iterator[bytes]:
        """All bytes, in blocks of at most 64 KiB as they come."""
        if self._head:
            head = b"".join(self._head)
            self._head.clear()
            for start in range(0, len(head), BLOCK):
                yield head[start : start + BLOCK]
        while data := self._next(BLOCK):
            yield data
        self.close()

    def lines(self) -> Iterator[bytes]:
        """All lines, in blocks of whole ones, each ended by LF; the last one too. A byte order mark is left out."""
        kept, skipping, first = b"", False, True
        for block in self.blocks():
            if skipping:  # the rest of a line that was too long
                end = block.find(b"\n")
                if end < 0:
                    continue
                block, skipping = block[end + 1 :], False
            end = block.rfind(b"\n") + 1
            if end:
                whole, kept = kept + block[:end], block[end:]
                yield whole.removeprefix(b"\xef\xbb\xbf") if first else whole
                first = False
            else:
                kept += block
            if len(kept) > MAX_LINE + 3:
                yield kept[: MAX_LINE + 4] + b"\n"
                kept, skipping, first = b"", True, False
        if first:
            kept = kept.removeprefix(b"\xef\xbb\xbf")
        if kept:
            yield kept + b"\n"

    def _next(self, size: int) -> bytes:
        if self._ended:
            return b""
        try:
            while (data := self._read(size)) is None:  # non-blocking, and nothing there yet
                select.select([self._file], [], [])
        except (OSError, ValueError) as error:  # ValueError: closed by the caller
            self._ended = True
            self.close()
            raise CaptureError(f"{self.name}: reading stopped: {_said(error)}") from error
        if not isinstance(data, bytes):
            kind = type(data).__name__
            raise CaptureError(f"{self.name}: gives {kind}, not bytes; open it in binary mode ('rb')")
        if not data:
            self._ended = True
        return data

    def close(self) -> None:
        """Close what was opened here."""
        self._ended = True
        if self._owned:
            self._file.close()


def _standard_input() -> BinaryIO:
    file: BinaryIO | None = getattr(sys.stdin, "buffer", None)
    if file is None:
        raise CaptureError("-: standard input is closed; pipe a capture into it or name a file")
    return file


def _is_live(file: Any) -> bool:
    """Whether waiting for more bytes may take longer than reading a disk."""
    try:
        return not stat.S_ISREG(os.fstat(file.fileno()).st_mode)
    except (AttributeError, OSError, ValueError):
        return False  # in memory


def _said(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error)


def _why(path: str, error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        folder, base = os.path.split(path)
        try:
            near = difflib.get_close_matches(base, os.listdir(folder or "."), n=1)
        except OSError:
            return f"no such file; there is no folder {folder!r} either"
        hint = f"; did you mean {os.path.join(folder, near[0])!r}?" if near else "; check the path"
        return f"no such file{hint}"
    if isinstance(error, IsADirectoryError):
        return "this is a folder; name the capture files in it"
    if isinstance(error, PermissionError):
        return "permission denied; ask its owner, or for a device join the group that owns it"
    return f"cannot be opened: {_said(error)}"
