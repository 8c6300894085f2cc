"""What a log is: what it says of itself, a file that is being written, and columns of numbers that were read.

1. When `LogSink.append` returns, its rows are with the operating system: a killed process loses none of them. When it
   raises, none of them is in the file, and the next ones may be tried.
2. What a reader finds at any moment is a log: the file's head is written when it is made.
3. The same rows and the same `About` give the same values, and in text the same bytes.
4. In a `Log` unknown is NaN, whatever the file has for it; `notes` say what is odd about the file, one sentence each.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from ...errors import CallerError, UnknownNameError
from .columns import LogColumn, parse_column

#: A row: ns since the log's start, and the values, NaN where unknown.
Row = tuple[int, list[float]]
Floats = npt.NDArray[np.float64]


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
        """The start in formats whose times are absolute."""
        return self.start_ns if self.wall_ns is None else self.wall_ns

    def to_json(self) -> str:
        """Return it as formats with metadata keep it."""
        return msgspec.json.encode(self).decode()

    @staticmethod
    def parse(text: str | bytes) -> About | None:
        """Return what `to_json` gave; None for anything else."""
        try:
            return msgspec.json.decode(text, type=About)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            return None


class LogSink(ABC):
    """A log that is being written; making one replaces what is at `path`.

    A subclass sets `_file`, which has `sync` and `close`. All raise `OSError` or `sqlite3.Error` for what cannot be written.
    """

    _file: Any

    def __init__(self, path: str, about: About) -> None:
        self.path, self.about = path, about

    @abstractmethod
    def append(self, rows: Sequence[Row]) -> None:
        """Write rows (rule 1)."""

    def sync(self) -> None:
        """Wait until what was appended is on the disk."""
        self._file.sync()

    def close(self) -> None:
        """Write the end, and close; afterwards there is one file, at `path`."""
        self._file.close()


def seconds_text(ns: int) -> str:
    """Return nanoseconds as exact decimal seconds.

    >>> seconds_text(1_500_000_000), seconds_text(-7), seconds_text(0)
    ('1.5', '-0.000000007', '0')
    """
    sign, ns = ("-", -ns) if ns < 0 else ("", ns)
    whole, rest = divmod(ns, 1_000_000_000)
    return f"{sign}{whole}.{rest:09d}".rstrip("0").rstrip(".")


class LogError(CallerError):
    """A file that is not a log: says file:line, or where in the file, and what is wrong."""


@dataclass(frozen=True)
class Log:
    """`time_s`: (rows,) seconds since the start; `values`: (rows, columns) float64, NaN where unknown.

    `log["RHY"]` is a column, and so is `log["RHY(rate)"]`; `units` are "" where the file has none. `about` has the
    robot, the rate and the start, where the file does.
    """

    path: str
    format: str
    columns: tuple[LogColumn, ...]
    time_s: Floats
    values: Floats
    about: About
    notes: list[str] = field(default_factory=list)

    @property
    def names(self) -> list[str]:
        """Of the columns, the time left out."""
        return [column.name for column in self.columns]

    @property
    def units(self) -> dict[str, str]:
        """The units, by column."""
        return {column.name: column.unit for column in self.columns}

    def __len__(self) -> int:
        return len(self.time_s)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._place(name) is not None

    def __getitem__(self, name: str) -> Floats:
        """Return a column's values; raises `UnknownNameError` with those that exist."""
        place = self._place(name)
        if place is None:
            raise UnknownNameError(f"column of {self.path}", name, self.names)
        return self.values[:, place]

    def _place(self, name: str) -> int | None:
        names = self.names
        if name in names:
            return names.index(name)
        try:
            same = parse_column(name).name  # RHY(value), RHY(diff)
        except CallerError:
            return None
        return names.index(same) if same in names else None

    def __str__(self) -> str:
        long = f"{self.time_s[-1] - self.time_s[0]:g} s" if len(self) else "empty"
        return f"{self.path}: {self.format}, {len(self)} rows × {len(self.columns)} columns, {long}"

    #: Numbers that a log may have, 0.4 GB: four days of 60 states at 200 Hz have 4 × 10⁹, and are read in a database.
    MOST_NUMBERS = 50_000_000
    NOT_CLOSED = "{}: the log was not closed, and is read as far as it was written"

    @staticmethod
    def of_table(
        path: str, format: str, about: About, table: Any, notes: list[str], time_s: Any = None
    ) -> Log:
        """Return a log of a table (rows, 1 + columns) whose first column is the time, or of `time_s` beside the columns."""
        if time_s is None:
            time_s, table = table[:, 0], table[:, 1:]
        return Log(path, format, about.columns, time_s, table, about, notes)


def about_columns(path: str, text: str | bytes, names: list[str]) -> About:
    """Return what a file says of itself, or its columns' names alone where it says nothing about just these."""
    about = About.parse(text)
    return about if about is not None and about.names == names else About(named_columns(path, names))


def named_columns(where: str, names: list[str]) -> tuple[LogColumn, ...]:
    """Return columns of a file's names, which may be anything; raise `LogError` for names that no column can have."""
    columns: list[LogColumn] = []
    for name in names:
        try:
            column = parse_column(name)
        except CallerError:
            column = LogColumn(name)  # an attribute that we do not know is a part of the name
        if not name or not name.isprintable():
            raise LogError(f"{where}: {name[:40]!r} is not a name of a column: is this a log?")
        columns.append(column)
    found = [column.name for column in columns]
    double = [name for name in dict.fromkeys(found) if found.count(name) > 1]
    if double:
        raise LogError(f"{where}: {', '.join(double)[:200]} named twice")
    return tuple(columns)
