"""What every format of a log does: rows in, all of them or none; nothing kept back.

1. When `append` returns, its rows are with the operating system: a process that is killed loses none of them. When it
   raises, none of them is in the file, and the next ones may be tried.
2. What a reader finds at any moment is a log: the file's head is written when it is made.
3. The same rows and the same `About` give the same values, and in text the same bytes.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from typing import ClassVar

import msgspec

from .columns import LogColumn

#: A row: ns since the log's start, and the values, NaN where unknown.
Row = tuple[int, list[float]]


class About(msgspec.Struct, frozen=True):
    """What a log says of itself. `wall_ns` is ns since 1970 at its start; None where the clock knows none (virtual time)."""

    columns: tuple[LogColumn, ...]
    rate_hz: float = 0.0
    robot: str = ""
    clock: str = ""
    start_ns: int = 0
    wall_ns: int | None = None

    @property
    def names(self) -> list[str]:
        """Of the columns, the time left out."""
        return [column.name for column in self.columns]

    @property
    def base_ns(self) -> int:
        """What stands for the start in formats whose times are absolute."""
        return self.start_ns if self.wall_ns is None else self.wall_ns

    def to_json(self) -> str:
        """As formats with metadata keep it."""
        return msgspec.json.encode(self).decode()


def about_of(text: str | bytes) -> About | None:
    """What `to_json` gave; None for anything else."""
    try:
        return msgspec.json.decode(text, type=About)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


class LogSink(ABC):
    """A log that is being written; making one replaces what is at `path`. Raises `OSError` when that cannot be."""

    format: ClassVar[str]

    def __init__(self, path: str, about: About) -> None:
        self.path, self.about = path, about

    @abstractmethod
    def append(self, rows: Sequence[Row]) -> None:
        """Write rows (rule 1)."""

    def sync(self) -> None:  # noqa: B027 - a format may have nothing to do
        """Have the operating system bring what was appended to the disk."""

    @abstractmethod
    def close(self) -> None:
        """Write what stands at the end, and close; afterwards nothing but `path` is left. Raises `OSError`."""


class AppendFile:
    """A file that grows by pieces, each of them whole or not there."""

    def __init__(self, path: str) -> None:
        flags = os.O_CREAT | os.O_TRUNC | os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0)
        self._file = os.open(path, flags, 0o666)
        self.path = path
        #: Bytes so far.
        self.size = 0

    def write(self, data: bytes) -> None:
        """All of it, or `OSError` and nothing."""
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
        """To the disk."""
        os.fsync(self._file)

    def close(self) -> None:
        """Twice does nothing."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def seconds_text(ns: int) -> str:
    """Nanoseconds as exact decimal seconds.

    >>> seconds_text(1_500_000_000), seconds_text(-7), seconds_text(0)
    ('1.5', '-0.000000007', '0')
    """
    sign, ns = ("-", -ns) if ns < 0 else ("", ns)
    whole, rest = divmod(ns, 1_000_000_000)
    return f"{sign}{whole}.{rest:09d}".rstrip("0").rstrip(".")
