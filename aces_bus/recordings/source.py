"""The one place that reads: a path, standard input or an open file becomes blocks of bytes.

1. A live source (pipe, terminal, socket, device) hands over what is there; it never waits to fill a block.
2. A line is never longer than `MAX_LINE` for those who ask for lines: memory stays bounded whatever arrives.
3. Whatever the system refuses is a `CaptureError` that names the source.
4. What is packed (gzip, zstandard; recognised by content) is unpacked here, and nothing behind this knows.
5. `on_disk` uses a plain file where it is; what comes from a pipe, from memory or unpacked goes into a temporary file,
   which is bounded, and gone when reading ends.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import select
import stat
import sys
from collections.abc import Callable, Generator, Iterator
from typing import Any, BinaryIO

from ..errors import CallerError, CaptureError
from .unpack import MAGIC, Unpacker, may_be_packed, packing

BLOCK = 1 << 16
#: A longer line is cut to one byte more than this, and is unreadable by that.
MAX_LINE = 4096

PathSource = str | os.PathLike[str]


def _small() -> int:
    return BLOCK


class ByteSource:
    """Bytes of one capture, once, from the present position of the source.

    `live` says that the bytes may still be in the making. The file is closed at its end, or by `close`, when it was
    opened here; standard input and files of the caller stay open.

    `span` are the first and the last but one byte to read of a plain file: a part that begins and ends where lines do
    (`split_lines`). A file that is open already gives the part, and nothing else.
    """

    def __init__(
        self, source: PathSource | BinaryIO, name: str | None = None, *, span: tuple[int, int] | None = None
    ) -> None:
        self._owned = False
        self._head: list[bytes] = []
        self._ended = False
        self._failure: CaptureError | None = None
        self._unpacker: Unpacker | None = None
        self._looked = False  # whether it is packed
        self._pushed = b""  # what was read to tell
        self._dry = False  # nothing more is stored; some of it may wait to be unpacked
        self._left: int | None = None  # of a span
        self._inside = False
        #: The last line that `lines` gave had no end: the file may have been cut within it.
        self.is_open_ended = False
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
        if span is not None:
            self._narrow(span)

    def _narrow(self, span: tuple[int, int]) -> None:
        start, end = span
        if self.live:
            self.close()
            raise CallerError(f"{self.name}: only of a plain file can a part be read")
        if not 0 <= start <= end:
            self.close()
            raise CallerError(f"{self.name}: bytes {start} to {end} are not a part of a file")
        if self._owned:
            self._file.seek(start)
        self._left = end - start
        self._inside = start > 0
        self._looked = self._inside

    @property
    def packing(self) -> str:
        """ "gzip" or "zstandard" when that is how the bytes are stored, otherwise ""."""
        self.head()
        return "" if self._unpacker is None else self._unpacker.kind

    def _open(self, path: str) -> BinaryIO:
        try:
            file = open(path, "rb", buffering=0)  # noqa: SIM115 - `close` closes it
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            raise CaptureError(f"{self.name}: {_why(path, error)}") from error
        self._owned = True
        return file

    def head(self) -> bytes:
        """Return what has been looked at so far, kept for `blocks`: the first block, or of a live source what was there."""
        if not self._head:
            self.look_further()
        return b"".join(self._head)

    def look_further(self) -> bool:
        """Read some more for `head`; False at the end of the source, or of what can be read of it."""
        wanted = BLOCK
        try:
            while wanted > 0 and (data := self._next(wanted)):
                self._head.append(data)
                wanted = 0 if self.live else wanted - len(data)
        except CaptureError as failure:
            if not self._head:
                raise
            self._failure = failure  # what was read is given first
            return False
        return not self._ended

    def blocks(self, size: Callable[[], int] = _small) -> Iterator[bytes]:
        """Yield all bytes, in blocks as they come, of at most 64 KiB or what `size` says before each."""
        if self._head:
            head = b"".join(self._head)
            self._head.clear()
            for start in range(0, len(head), BLOCK):
                yield head[start : start + BLOCK]
        while data := self._next(size()):
            yield data
        self.close()

    def lines(self, size: Callable[[], int] = _small) -> Iterator[bytes]:
        """Yield all lines, in blocks of whole ones, each ended by LF; the last one too. A byte order mark is left out.

        Of a line in which reading fails nothing is given.
        """
        kept, skipping, first = b"", False, not self._inside
        for block in self.blocks(size):
            if skipping:  # the rest of a line that was too long
                end = block.find(b"\n")
                if end < 0:
                    continue
                block, skipping = block[end + 1 :], False
            end = block.rfind(b"\n") + 1
            if end:
                whole, kept = b"".join((kept, memoryview(block)[:end])), block[end:]
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
            self.is_open_ended = True
            yield kept + b"\n"

    def _next(self, size: int) -> bytes:
        """Return the next bytes, at most so many; none at the end."""
        if self._failure is not None:
            raise self._failure
        if self._ended:
            return b""
        try:
            if not self._looked:
                self._look()
            if self._pushed:
                data, self._pushed = self._pushed[:size], self._pushed[size:]
                return data
            data = self._stored(size) if self._unpacker is None else self._unpacker.read(size)
        except CaptureError:
            self.close()
            raise
        self._ended = not data
        return data

    def _look(self) -> None:
        """Find out by the first bytes whether the source is packed."""
        self._looked = True
        head = self._stored(BLOCK)
        while may_be_packed(head) and (more := self._stored(MAGIC)):
            head += more
        self._pushed = head
        if not (kind := packing(head)):
            return
        again = self._stored_again if self._owned and not self.live and hasattr(os, "pread") else None
        self._unpacker = Unpacker(kind, self.name, head, self._stored, again)
        self._pushed = inner = b""
        try:
            while len(inner) < MAGIC and (more := self._unpacker.read(BLOCK)):
                inner += more
        except CaptureError:
            if not inner:
                raise
        if twice := packing(inner):
            raise CaptureError(f"{self.name}: {twice} data within {kind} data; unpack it once before")
        self._pushed = inner

    def _stored(self, size: int) -> bytes:
        """Return bytes as they are stored; none at the end."""
        if self._dry or self._ended:
            return b""
        if self._left is not None:
            size = min(size, self._left)
        try:
            while (data := self._read(size)) is None:  # non-blocking, and nothing there yet
                select.select([self._file], [], [])
        except (OSError, ValueError) as error:  # ValueError: closed by the caller
            raise CaptureError(f"{self.name}: reading stopped: {_said(error)}") from error
        if not isinstance(data, bytes):
            kind = type(data).__name__
            raise CaptureError(f"{self.name}: gives {kind}, not bytes; open it in binary mode ('rb')")
        if self._left is not None:
            self._left -= len(data)
        self._dry = not data
        return data

    def _stored_again(self, place: int, size: int) -> bytes:
        """Return bytes of a file as they are stored, once more."""
        try:
            return os.pread(self.fileno(), size, place)
        except OSError as error:
            raise CaptureError(f"{self.name}: reading stopped: {_said(error)}") from error

    def fileno(self) -> int:
        """Return the system's number of the file; raises `OSError` where there is none."""
        number: int = self._file.fileno()
        return number

    def close(self) -> None:
        """Close what was opened here."""
        self._ended = True
        if self._owned:
            self._file.close()

    def plain_path(self) -> str | None:
        """Return where the very bytes of the source are, if that is a plain file."""
        name = getattr(self._file, "name", None)
        if self.live or not isinstance(self._file, io.FileIO) or not isinstance(name, str):
            return None
        try:
            with open(name, "rb") as file:
                head = self.head()
                return os.path.abspath(name) if file.read(len(head)) == head else None
        except OSError:
            return None


# ---- as a file on disk, for formats that are read from here and there and not from front to back

#: A hostile archive may unpack to any size.
LIMIT = 16 << 30


@contextlib.contextmanager
def on_disk(source: ByteSource) -> Generator[tuple[str, str]]:
    """Yield the path of the capture, and that of a folder for temporary files, which is empty or holds just the capture.

    Raises `CaptureError` when the source is longer than `LIMIT` or cannot be written to disk.
    """
    from tempfile import TemporaryDirectory

    with TemporaryDirectory(prefix="aces-", ignore_cleanup_errors=True) as folder:
        path = source.plain_path()
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


# ---- in parts


def split_lines(path: PathSource, pieces: int, at_least: int = 1 << 20) -> list[tuple[int, int]]:
    """Split a file of lines into parts to read beside each other: `Source(path, span=part)`, in order and
    without gaps.

    At most `pieces` of them, each of some `at_least` bytes or more. Of what cannot be entered in its middle (a packed
    file, a pipe) there is one. Lines are counted from the start of a part. No part begins with a line that is indented:
    it belongs to the one before.

    Raises `CaptureError` when the file cannot be opened.
    """
    source = ByteSource(path)
    with contextlib.closing(source):
        size = 0 if source.live else os.fstat(source.fileno()).st_size
        if source.live or source.packing:
            return [(0, size)]
        file = source.fileno()

        def read_at(place: int, count: int) -> bytes:
            os.lseek(file, place, os.SEEK_SET)
            return os.read(file, count)

        return cut_lines(read_at, size, pieces, at_least)


def cut_lines(
    read_at: Callable[[int, int], bytes], size: int, pieces: int, at_least: int
) -> list[tuple[int, int]]:
    """Do what `split_lines` does, of `size` bytes that are not packed; `read_at(place, count)` reads some of them."""
    borders = [0]
    pieces = max(1, min(pieces, size // max(at_least, 1)))
    for number in range(1, pieces):
        border = _border(read_at, size * number // pieces)
        if border is not None and border > borders[-1]:
            borders.append(border)
    return list(zip(borders, [*borders[1:], size], strict=True))


def _border(read_at: Callable[[int, int], bytes], place: int) -> int | None:
    """Return where a line begins, from `place` on; None when none does soon."""
    for _ in range(16):
        data = read_at(place, BLOCK)
        if found := re.search(rb"\n(?=[^\t ])", data):
            return place + found.end()
        if len(data) < 2:
            return None
        place += len(data) - 1  # the last byte again: it may be the LF
    return None


def _standard_input() -> BinaryIO:
    file: BinaryIO | None = getattr(sys.stdin, "buffer", None)
    if file is None:
        raise CaptureError("-: standard input is closed; pipe a capture into it or name a file")
    return file


def _is_live(file: Any) -> bool:
    """Return whether waiting for more bytes may take longer than reading a disk."""
    try:
        return not stat.S_ISREG(os.fstat(file.fileno()).st_mode)
    except (AttributeError, OSError, ValueError):
        return False  # in memory


def _said(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error)


def _why(path: str, error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        from difflib import get_close_matches

        folder, base = os.path.split(path)
        try:
            near = get_close_matches(base, os.listdir(folder or "."), n=1)
        except OSError:
            return f"no such file; there is no folder {folder!r} either"
        hint = f"; did you mean {os.path.join(folder, near[0])!r}?" if near else ""
        return f"no such file{hint}"
    if isinstance(error, IsADirectoryError):
        return "this is a folder; name the capture files in it"
    if isinstance(error, PermissionError):
        return "permission denied; ask its owner, or for a device join the group that owns it"
    return f"cannot be opened: {_said(error)}"
