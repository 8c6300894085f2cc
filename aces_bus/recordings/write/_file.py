"""The file that a writer writes into: beside its place until it is whole, or a pipe, packed or not.

1. `commit` or `discard` ends it, and both may be called again without harm.
2. A device or a pipe that has the name is written into; it is never replaced.
"""

from __future__ import annotations

import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Generator, Iterable
from contextlib import contextmanager, suppress
from typing import Any, BinaryIO, cast

from ...errors import CallerError

#: On hexadecimal text level 6 takes twice the time of 3 for a tenth fewer bytes; of zstd, 1 beats 3 in both.
_GZIP_LEVEL = 3
_ZSTD_LEVEL = 1
_STDOUT = "standard output"


class OutFile:
    """`stream` is what to write into. `needs_seek` says that it must be seekable, whatever the output is."""

    def __init__(
        self, target: str | BinaryIO, packing: str | None, needs_seek: bool, inputs: Iterable[str] = ()
    ) -> None:
        self._temporary: str | None = None
        self._owned = False
        self._layers: list[Any] = []  # what is closed before the file, outermost first
        self._spool: Any = None
        self._ended = False
        if not isinstance(target, str):
            given = getattr(target, "name", None)
            self.name = given if isinstance(given, str) else "<stream>"
            self._file: Any = getattr(target, "buffer", target)
        elif target == "-":
            self.name = _STDOUT
            self._file = getattr(sys.stdout, "buffer", None)
            if self._file is None:
                raise CallerError("standard output is closed, or is not one for bytes; name a file")
        else:
            self.name = target
            self._open(target, inputs)
        try:
            self.stream = self._stacked(packing, needs_seek)
        except BaseException:
            self.discard()
            raise

    def _open(self, path: str, inputs: Iterable[str]) -> None:
        try:
            for name in inputs:
                if os.path.exists(path) and os.path.exists(name) and os.path.samefile(path, name):
                    raise CallerError(f"{path} is one of the files to read; choose another name")
            self._final = os.path.realpath(path)  # a link stays, and what it names is replaced
            mode = os.stat(self._final).st_mode if os.path.exists(self._final) else None
            if mode is not None and stat.S_ISDIR(mode):
                raise CallerError(f"{path}: cannot be written: this is a folder")
            if mode is not None and not stat.S_ISREG(mode):
                self._file = open(self._final, "wb")  # noqa: SIM115 - closed by `commit` or `discard`
            else:
                if mode is not None and not os.access(self._final, os.W_OK):
                    raise CallerError(f"{path}: cannot be written: permission denied")
                folder, base = os.path.split(self._final)
                number = 0
                while True:
                    self._temporary = os.path.join(folder, f".{base[:60]}.{os.getpid()}-{number}.part")
                    try:
                        self._file = open(self._temporary, "x+b")  # noqa: SIM115
                        break
                    except FileExistsError:
                        number += 1
                if mode is not None:
                    with suppress(OSError):
                        os.chmod(self._temporary, stat.S_IMODE(mode))
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            self._temporary = None
            said = error.strerror if isinstance(error, OSError) else None
            if isinstance(error, FileNotFoundError):
                said = f"there is no folder {os.path.dirname(path)!r}"
            raise CallerError(f"{path}: cannot be written: {said or error}") from error
        self._owned = True

    def _stacked(self, packing: str | None, needs_seek: bool) -> BinaryIO:
        top = self._file
        if packing == "gzip":
            import gzip

            top = gzip.GzipFile("", "wb", _GZIP_LEVEL, top, mtime=0)
        elif packing == "zstd":
            try:
                import zstandard
            except ImportError as error:
                raise CallerError(
                    f"{self.name}: packing with zstd needs the package zstandard: pip install 'aces-bus[columns]'"
                ) from error
            top = zstandard.ZstdCompressor(level=_ZSTD_LEVEL).stream_writer(top, closefd=False)
        if packing:
            self._layers.append(top)
        if needs_seek and (packing or not self._is_seekable(top)):
            self._spool, self._below = tempfile.TemporaryFile(), top  # noqa: SIM115
            return cast("BinaryIO", self._spool)
        return cast("BinaryIO", top)

    def _is_seekable(self, file: Any) -> bool:
        if self._temporary is not None:
            return True
        if self._owned or self.name == _STDOUT or "a" in str(getattr(file, "mode", "")):
            return False  # what is appended to goes to the end, wherever one seeks
        return bool(getattr(file, "seekable", lambda: False)())

    @contextmanager
    def checked(self) -> Generator[None, None, None]:
        """Raise errors of the system as one line; a pipe without a reader stays a `BrokenPipeError`."""
        try:
            yield
        except BrokenPipeError:
            raise
        except OSError as error:
            raise CallerError(f"{self.name}: writing stopped: {error.strerror or error}") from error

    def flush(self) -> None:
        with self.checked():
            if self._spool is None:
                for layer in (*self._layers, self._file):
                    layer.flush()

    def commit(self) -> None:
        """Give the file its name: all is written."""
        if self._ended:
            return
        self._ended = True
        with self.checked():
            try:
                if self._spool is not None:
                    self._spool.seek(0)
                    shutil.copyfileobj(self._spool, self._below, 1 << 20)
                    self._spool.close()
                for layer in self._layers:
                    layer.close()
                self._file.flush()
                if self._owned:
                    self._file.close()
                if self._temporary is not None:
                    os.replace(self._temporary, self._final)
                    self._temporary = None
            except BaseException:
                self._remove()
                raise

    def discard(self) -> None:
        """Throw away what was written into a file; what went into a pipe is gone."""
        if not self._ended or self._temporary is not None:
            self._ended = True
            self._remove()

    def _remove(self) -> None:
        if self._spool is not None:
            self._spool.close()
        for layer in self._layers:
            if hasattr(layer, "fileobj"):
                layer.fileobj = (
                    None  # or gzip writes an end, as though all were there, into what is thrown away
                )
        if self._owned:
            with suppress(OSError):
                self._file.close()
        if self._temporary is not None:
            with suppress(OSError):
                os.unlink(self._temporary)
            self._temporary = None
