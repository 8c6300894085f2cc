"""Files wherever fsspec reaches them: this machine's, `s3://`, `sftp://`, `http://` and others.

1. A file of this machine is named by its absolute path, any other by its URI. No credentials travel: each machine has its
   own (environment, fsspec's configuration).
2. A file that is put is there as a whole or not at all. Object stores do so by themselves; elsewhere it is written beside
   its place and renamed.
3. What a store refuses is a `StoreError` after `WAITS_S`; what it says is not there is one at once. An answer that does not
   come within `ANSWER_S` and the time for its bytes is asked for once more.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from datetime import datetime
from functools import partial
from importlib import import_module
from queue import Empty, SimpleQueue
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

from aces_bus.errors import CallerError

T = TypeVar("T")

#: Seconds before each further attempt of what a store has refused.
WAITS_S = (0.2, 1.0, 4.0)
#: Seconds that an answer of a store of other machines may take: so many, and one more for so many bytes; and a
#: listing, or the manifest.
ANSWER_S, SLOWEST, LISTING_S = 60.0, 100_000, 3600.0
#: Times that an answer is waited for so long.
STALLS = 2
#: Bytes that are asked of a store at once.
BLOCK = 4 << 20
#: Stores in which a file appears when its last byte is there.
_AT_ONCE = {"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "memory"}
#: What stores call the version of a file, or when it was written.
_STAMPS = (
    "ETag",
    "etag",
    "Content-MD5",
    "md5",
    "mtime",
    "LastModified",
    "last_modified",
    "Last-Modified",
    "created",
)
_FINAL = (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError, NotImplementedError)


class StoreError(CallerError):
    """A store refuses: says of which file and why."""


class StoredFile(NamedTuple):
    """A file of a store. `stamp` is what changes with its contents, as the store says it: an entity tag or a time."""

    uri: str
    size: int
    stamp: str


def load_fsspec() -> ModuleType:
    """Return the library; raises `CallerError` with how to install it."""
    try:
        fsspec = import_module("fsspec")
        for part in ("core", "implementations.local"):
            import_module(f"fsspec.{part}")
    except ImportError as missing:
        raise CallerError(f"fleets need fsspec: pip install 'aces-bus[fleet]' ({missing})") from missing
    return fsspec


class _StallError(TimeoutError):
    """A store does not answer."""


def patiently(name: str, call: Callable[[], T], limit_s: float | None = None) -> T:
    """Return what a call to a store gives, after some attempts; raises `StoreError` that names the file. With
    `limit_s` an attempt ends after so many seconds, and the call is left to itself."""
    stalls = 0
    for wait in (*WAITS_S, None):
        try:
            return call() if limit_s is None else _within(limit_s, call)
        except Exception as error:  # each store raises its own
            stalls += isinstance(error, _StallError)
            if isinstance(error, _FINAL) or wait is None or stalls >= STALLS:
                raise StoreError(f"{name}: {cause_of(error)}") from error
        time.sleep(wait)
    raise AssertionError


def _within(limit_s: float, call: Callable[[], T]) -> T:
    """Return what a call gives on a thread of its own; raises `_StallError`, and then the thread is not waited for."""
    answers: SimpleQueue[tuple[Exception | None, Any]] = SimpleQueue()

    def ask() -> None:
        try:
            answers.put((None, call()))
        except Exception as error:
            answers.put((error, None))

    threading.Thread(target=ask, name="store", daemon=True).start()
    try:
        error, value = answers.get(timeout=limit_s)
    except Empty:
        raise _StallError(f"the store has not answered for {limit_s:.0f} s") from None
    if error is not None:
        raise error
    given: T = value
    return given


def cause_of(error: BaseException) -> str:
    """Return what a store's exception says, in one line."""
    if isinstance(error, FileNotFoundError):
        return "no such file"
    text = (isinstance(error, OSError) and error.strerror) or " ".join(str(error).split())
    return text or type(error).__name__


def stamp_of(info: Mapping[str, Any]) -> str:
    """Return what changes with a file's contents; empty where the store does not say."""
    for name in _STAMPS:
        if (
            found := info.get(name)
        ) is not None:  # a time may be a number in a listing, and none in a file's own entry
            return str(found.timestamp() if isinstance(found, datetime) else found)
    return ""


class Place:
    """A file, folder or pattern, in the store that its URI names. Raises `CallerError` for a store that is not known."""

    def __init__(self, uri: str) -> None:
        fsspec = load_fsspec()
        try:
            self.fs, self.path = fsspec.core.url_to_fs(uri)
        except (ImportError, ValueError) as error:
            raise CallerError(f"{uri}: {cause_of(error)}") from error
        except Exception as error:  # a store that connects at once
            raise StoreError(f"{uri}: {cause_of(error)}") from error
        self.is_local = isinstance(self.fs, fsspec.implementations.local.LocalFileSystem)
        #: The URI's part that is not the path: `sftp://user@host:22`.
        self._before = ""
        if not self.is_local:
            self.path = str(self.path)
            text = uri.rstrip("/")
            self._before = text[: len(text) - len(self.path.rstrip("/"))]
            if not text.endswith(self.path.rstrip("/")):
                self._before = f"{uri.partition('://')[0]}://"
        protocols = {self.fs.protocol} if isinstance(self.fs.protocol, str) else set(self.fs.protocol)
        self._is_at_once = bool(protocols & _AT_ONCE)

    def uri_of(self, path: str) -> str:
        """Return the name of a path in this store."""
        return path if self.is_local or "://" in path else f"{self._before}{path}"

    @property
    def uri(self) -> str:
        return self.uri_of(self.path)

    def join(self, *names: str) -> str:
        """Return a path below."""
        return "/".join([self.path.rstrip("/"), *names])

    def ask(self, path: str, call: Callable[[], T], size: int = 0, seconds: float | None = None) -> T:
        """Make a call about a file of so many bytes; return what it gives. Raises `StoreError`. Files of this machine are
        waited for.
        """
        limit_s = None if self.is_local else (ANSWER_S if seconds is None else seconds) + size / SLOWEST
        return patiently(self.uri_of(path), call, limit_s)

    def files(self) -> Iterator[StoredFile]:
        """Yield the files that a pattern (`*`, `**`, `?`, `[ab]`) names, or the one; raises `StoreError` where there
        is none.
        """
        if not any(mark in self.path for mark in "*?[") or (self.is_local and os.path.isfile(self.path)):
            yield self.file()
            return

        def found() -> dict[str, dict[str, Any]]:
            self.fs.invalidate_cache()
            some: dict[str, dict[str, Any]] = self.fs.glob(self.path, detail=True)
            return some

        for path, info in sorted(self.ask(self.path, found, seconds=LISTING_S).items()):
            if info.get("type") == "directory":
                continue
            if info.get("size") is None:  # a listing that does not say it
                info = self.ask(path, partial(self.fs.info, path))
            yield StoredFile(self.uri_of(path), int(info.get("size") or 0), stamp_of(info))

    def file(self) -> StoredFile:
        """Return the one file, as the store has it now; raises `StoreError` where there is none."""

        def asked() -> dict[str, Any]:
            self.fs.invalidate_cache()
            info: dict[str, Any] = self.fs.info(self.path)
            return info

        info = self.ask(self.path, asked)
        if info.get("type") == "directory":
            raise StoreError(f"{self.uri}: is a folder; name its files: {self.uri.rstrip('/')}/**/*.mf4")
        return StoredFile(self.uri, int(info.get("size") or 0), stamp_of(info))

    def read(self, path: str) -> bytes:
        """Return all bytes of a small file."""
        data: bytes = self.ask(path, lambda: self.fs.cat_file(path), seconds=LISTING_S)
        return data

    def names(self, path: str) -> list[str]:
        """Return what a folder holds; nothing where there is none."""

        def listed() -> list[str]:
            try:
                self.fs.invalidate_cache()
                return [
                    str(entry["name"]).rstrip("/").rpartition("/")[2]
                    for entry in self.fs.ls(path, detail=True)
                ]
            except FileNotFoundError:
                return []

        return self.ask(path, listed, seconds=LISTING_S)

    def exists(self, path: str) -> bool:
        """Return whether there is such a file."""

        def asked() -> bool:
            self.fs.invalidate_cache()
            return bool(self.fs.exists(path))

        return self.ask(path, asked)

    def put(self, file: str, path: str) -> None:
        """Move a file of this machine to its place in the store."""
        folder, _, name = path.rpartition("/")

        def once() -> None:
            if self._is_at_once:
                self.fs.put_file(file, path)
                return
            self.fs.makedirs(folder, exist_ok=True)
            beside = f"{folder}/.{name}.{secrets.token_hex(4)}.part"
            try:
                if self.is_local:
                    self._move_here(file, beside, path)
                else:
                    self.fs.put_file(file, beside)
                    self.fs.mv(beside, path)
            except BaseException:
                with suppress(Exception):
                    self.fs.rm_file(beside)
                raise

        self.ask(path, once, size=os.path.getsize(file))

    def _move_here(self, file: str, beside: str, path: str) -> None:
        try:
            os.replace(file, path)
        except FileNotFoundError:
            if os.path.exists(file):
                raise
            return  # an attempt before this one has moved it
        except OSError:  # on another disk
            self.fs.put_file(file, beside)
            os.replace(beside, path)

    def write(self, path: str, data: bytes) -> None:
        """Write a small file in one operation."""
        folder, _, name = path.rpartition("/")

        def once() -> None:
            if self._is_at_once:
                self.fs.pipe_file(path, data)
                return
            self.fs.makedirs(folder, exist_ok=True)
            beside = f"{folder}/.{name}.{secrets.token_hex(4)}.part"
            self.fs.pipe_file(beside, data)
            if self.is_local:
                os.replace(beside, path)
            else:
                self.fs.mv(beside, path)

        self.ask(path, once, size=len(data))

    def remove(self, path: str) -> None:
        """Remove a file; do nothing if it does not exist."""

        def once() -> None:
            with suppress(FileNotFoundError):
                self.fs.rm_file(path)

        self.ask(path, once)


class StoreReader:
    """The bytes of a stored file from `start` to `stop`, once, front to back, as `open_recording` reads them.

    `digest` hashes what was read. `failure` is what the store refused, after some attempts: then the recording is not
    damaged, and to read it again may help.
    """

    def __init__(self, uri: str, span: tuple[int, int] | None = None) -> None:
        self.name = uri
        self.digest = hashlib.blake2b(digest_size=20)
        self.failure: StoreError | None = None
        self._store = Place(uri)
        self._place: int = 0 if span is None else span[0]
        self._stop: int | None = None if span is None else span[1]
        self._ready = memoryview(b"")
        self._file: Any = self._store.ask(self._store.path, self._opened)

    def _opened(self, place: int | None = None) -> Any:
        file = self._store.fs.open(self._store.path, "rb", block_size=BLOCK)
        if place := self._place if place is None else place:
            file.seek(place)
        return file

    def read(self, size: int = -1) -> bytes:
        """Return at most so many bytes; none at the end. Raises `OSError` where the store refuses."""
        if not self._ready:
            self._ready = memoryview(self._block())
        given = bytes(self._ready if size < 0 else self._ready[:size])
        self._ready = self._ready[len(given) :]
        return given

    def _block(self) -> bytes:
        wanted = BLOCK if self._stop is None else min(BLOCK, self._stop - self._place)
        if wanted <= 0:
            return b""
        ready = [self._file]

        def asked() -> tuple[Any, bytes]:
            file = ready.pop() if ready else self._opened()  # one that has failed or stalls is not used again
            return file, bytes(file.read(wanted))

        try:
            self._file, data = self._store.ask(self._store.path, asked, wanted)
        except StoreError as error:
            self.failure = error
            raise OSError(str(error)) from error
        self._place += len(data)
        self.digest.update(data)
        return data

    def read_at(self, place: int, size: int) -> bytes:
        """Read up to `size` bytes at `place`, apart from the reading front to back; they do not enter the hash."""

        def asked() -> bytes:
            with self._opened(place) as file:
                return bytes(file.read(size))

        return self._store.ask(self._store.path, asked, size)

    def drain(self) -> None:
        """Read what is left, for the hash alone."""
        while self.read(BLOCK):
            pass

    def close(self) -> None:
        """End reading."""
        with suppress(Exception):
            self._file.close()


def hash_of_file(path: str) -> str:
    """Return the hash of a file of this machine, as `StoreReader.digest` gives it."""
    digest = hashlib.blake2b(digest_size=20)
    with open(path, "rb", buffering=0) as file:
        while data := file.read(BLOCK):
            digest.update(data)
    return digest.hexdigest()
