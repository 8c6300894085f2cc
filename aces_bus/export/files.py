"""Files that are written: beside their place until they are whole, by whole pieces, or many with few open handles.

1. Under the name of a `Staging` there is the whole export or what was there before, never a part.
2. When `AppendFile.write` returns, the piece is with the operating system, and a process that is killed does not lose it;
   when it raises, nothing of the piece is in the file.
3. However many files a `FilePool` writes, at most `OPEN` of them are open.
"""

from __future__ import annotations

import io
import os
import secrets
import shutil
import sqlite3
from collections import OrderedDict
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from threading import Lock
from typing import IO

from ..errors import CallerError

#: Handles that a pool keeps open. Systems allow 256 (macOS) to 1024 for a process.
OPEN = 64


@contextmanager
def telling(path: str) -> Generator[None, None, None]:
    """Raise what the system or SQLite refuses as a `CallerError` that names the file."""
    try:
        yield
    except (OSError, sqlite3.Error) as error:
        raise CallerError(
            f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}"
        ) from error


class AppendFile:
    """A file that grows by pieces, each of which is in it as a whole or not at all."""

    def __init__(self, path: str) -> None:
        flags = os.O_CREAT | os.O_TRUNC | os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0)
        self._file = os.open(path, flags, 0o666)
        self.path = path
        #: Bytes so far.
        self.size = 0

    def write(self, data: bytes) -> None:
        """Append all of `data`, or raise `OSError` and append nothing."""
        left = memoryview(data)
        try:
            while left:
                left = left[os.write(self._file, left) :]
        except OSError:
            with suppress(OSError):  # a pipe or a device keeps nothing
                os.ftruncate(self._file, self.size)
            raise
        self.size += len(data)

    def sync(self) -> None:
        """Wait until the disk has it."""
        os.fsync(self._file)

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


class Staging:
    """A temporary name beside a path, which takes its place by `commit` or goes by `discard`.

    `is_ours` says of the names in a folder that is at the path already whether all are from an earlier export: only
    then is it replaced. Raises `CallerError` when the path cannot be used.
    """

    def __init__(self, path: str, *, is_folder: bool, is_ours: Callable[[str], bool] | None = None) -> None:
        self.path = os.path.abspath(path)
        self.is_folder = is_folder
        self._is_done = False
        parent, base = os.path.split(self.path)
        if not os.path.isdir(parent):
            raise CallerError(f"{path}: cannot be written: there is no folder {parent!r}")
        if os.path.isdir(self.path):
            self._check_folder(path, is_ours)
        elif os.path.lexists(self.path) and not os.path.isfile(self.path):
            raise CallerError(f"{path}: is not a file; choose another name")
        self.temporary = os.path.join(parent, f".{base[:100]}.{secrets.token_hex(4)}.part")
        with telling(path):
            if is_folder:
                os.mkdir(self.temporary)
            else:
                open(self.temporary, "xb").close()

    def _check_folder(self, path: str, is_ours: Callable[[str], bool] | None) -> None:
        if is_ours is None:
            raise CallerError(f"{path}: is a folder; choose another name")
        with telling(path), os.scandir(self.path) as entries:
            for entry in entries:
                if not (_is_table(entry) and is_ours(entry.name)):
                    raise CallerError(
                        f"{path}: is a folder that holds other files ({entry.name}); choose another name"
                    )

    def commit(self) -> None:
        """Move the written files to their place."""
        if self._is_done:
            return
        with telling(self.path):
            if os.path.isdir(self.path) or (self.is_folder and os.path.lexists(self.path)):
                aside = f"{self.temporary}.old"
                os.rename(self.path, aside)
                try:
                    os.rename(self.temporary, self.path)
                except OSError:
                    os.rename(aside, self.path)
                    raise
                _remove(aside)
            else:
                os.replace(self.temporary, self.path)
        self._is_done = True

    def discard(self) -> None:
        """Remove the written files."""
        if not self._is_done:
            self._is_done = True
            _remove(self.temporary)


class InPlace:
    """The path itself, for an export that grows; `discard` takes it away, unless `is_kept`.

    Raises `CallerError` when the path cannot be used: what is there already is never written over.
    """

    def __init__(self, path: str, *, is_folder: bool) -> None:
        self.path = self.temporary = os.path.abspath(path)
        #: Something is in it.
        self.is_kept = False
        self._is_done = False
        with telling(path):
            try:
                if is_folder:
                    os.mkdir(self.path)
                else:
                    open(self.path, "xb").close()
            except FileExistsError:
                raise CallerError(f"{path}: there is such a file already; choose another name") from None

    def commit(self) -> None:
        """End: the files are at their place already."""
        self._is_done = True

    def discard(self) -> None:
        """Take it away, as long as nothing is in it."""
        if not (self._is_done or self.is_kept):
            self._is_done = True
            _remove(self.path)


def size_on_disk(path: str) -> int:
    """Return the bytes of a file with its `-wal` file, or of all files of a folder."""
    if not os.path.isdir(path):
        return sum(os.path.getsize(name) for name in (path, f"{path}-wal") if os.path.exists(name))
    return sum(
        os.path.getsize(os.path.join(folder, name)) for folder, _, names in os.walk(path) for name in names
    )


def _is_table(entry: os.DirEntry[str]) -> bool:
    """Return a file, or a folder of the parts that several processes have written."""
    if entry.is_file(follow_symlinks=False):
        return True
    return entry.is_dir(follow_symlinks=False) and all(
        name.startswith("part-") for name in os.listdir(entry.path)
    )


def _remove(path: str) -> None:
    if os.path.isdir(path) and not os.path.islink(path):
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            os.unlink(path)


class FilePool:
    """Files that are appended to, by any thread, of which only the latest used are open. What is refused is said of `name`:
    they have temporary names, which say nothing to a user."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._open: OrderedDict[str, IO[bytes]] = OrderedDict()
        self._lock = Lock()
        self._is_abandoned = False

    def handle(self, path: str) -> IO[bytes]:
        """Return the file, open for appending."""
        found = self._open.get(path)
        if found is not None:
            self._open.move_to_end(path)
            return found
        while len(self._open) >= OPEN:
            self._open.popitem(last=False)[1].close()
        with telling(self._name):
            found = self._open[path] = open(path, "ab")  # noqa: SIM115 - `close` closes it
        return found

    def write(self, path: str, data: bytes | memoryview) -> None:
        """Append to a file; of an abandoned pool there are none: a library may write what it has left when it is freed."""
        with telling(self._name), self._lock:
            if not self._is_abandoned:
                self.handle(path).write(data)

    def release(self, path: str) -> None:
        """Close one file."""
        with telling(self._name), self._lock:
            found = self._open.pop(path, None)
            if found is not None:
                found.close()

    def flush(self) -> None:
        """Hand to the system what was written."""
        with telling(self._name), self._lock:
            for file in self._open.values():
                file.flush()

    def close(self) -> None:
        """Close all files."""
        for path in list(self._open):
            self.release(path)

    def abandon(self) -> None:
        """Close all files, whatever becomes of their bytes."""
        with self._lock:
            self._is_abandoned = True
            while self._open:
                with suppress(OSError):
                    self._open.popitem()[1].close()


class ExportFile(io.RawIOBase):
    """A file of a pool as libraries want one: it is written to, and knows its position."""

    def __init__(self, pool: FilePool, path: str) -> None:
        super().__init__()
        self._pool, self._path, self._place = pool, path, 0

    def writable(self) -> bool:
        """Return True."""
        return True

    def write(self, data: object) -> int:
        """Append."""
        view = memoryview(data).cast("B")  # type: ignore[arg-type]
        self._pool.write(self._path, view)
        self._place += len(view)
        return len(view)

    def tell(self) -> int:
        """Return the number of bytes written so far."""
        return self._place
