"""A log that was read: columns of numbers by name.

1. Unknown is NaN, whatever the file has for it.
2. `notes` say what is odd about the file, one sentence each: a writer that was killed, a last line that is cut.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ...errors import CallerError, UnknownNameError
from .base import About
from .columns import LogColumn, parse_column

Floats = npt.NDArray[np.float64]

#: Numbers that a log may have, 0.4 GB: four days of 60 states at 200 Hz have 4 × 10⁹, and are read in a database.
MOST_NUMBERS = 50_000_000


class LogError(CallerError):
    """A file that is no log: says file:line, or where in the file, and what is wrong."""


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
        """By column."""
        return {column.name: column.unit for column in self.columns}

    def __len__(self) -> int:
        return len(self.time_s)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._place(name) is not None

    def __getitem__(self, name: str) -> Floats:
        """A column's values; raises `UnknownNameError` with those that exist."""
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


def made_log(path: str, format: str, about: About, table: Any, notes: list[str], time_s: Any = None) -> Log:
    """A log of a table (rows, 1 + columns) whose first column is the time, or of `time_s` beside the columns."""
    if time_s is None:
        time_s, table = table[:, 0], table[:, 1:]
    return Log(path, format, about.columns, time_s, table, about, notes)


def named_columns(where: str, names: list[str]) -> tuple[LogColumn, ...]:
    """Columns of a file's names, which may be anything; raises `LogError` for what cannot be named."""
    columns: list[LogColumn] = []
    for name in names:
        try:
            column = parse_column(name)
        except CallerError:
            column = LogColumn(name)  # an attribute that we do not know is a part of the name
        if not name or not name.isprintable():
            raise LogError(f"{where}: {name[:40]!r} is no name of a column: is this a log?")
        columns.append(column)
    found = [column.name for column in columns]
    double = [name for name in dict.fromkeys(found) if found.count(name) > 1]
    if double:
        raise LogError(f"{where}: {', '.join(double)[:200]} named twice")
    return tuple(columns)
