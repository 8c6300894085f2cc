"""Logs as text: the original's, and CSV.

1. A number is the shortest text that reads back as the same float; seconds are exact to the nanosecond.
2. Neither format has a place for units, robot or date; that is what the others are for.

*Facts* (acesHubo, logger.*): the first line is `0 ` and then `Name(attribute) ` for each column; every other line is the
seconds since the start and the values, each followed by a blank. The original wrote six significant digits, which
`digits=6` gives. *Choice*: unknown is `nan` there, and an empty cell in CSV.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence

from ...plain_text import cell_text
from .base import About, AppendFile, LogSink, Row, seconds_text


def shortest(value: float) -> str:
    """The shortest text of a float, as C++ streams write whole numbers.

    >>> shortest(-2.0), shortest(0.1), shortest(-0.0), shortest(1e22)
    ('-2', '0.1', '-0', '1e+22')
    """
    text = repr(value)
    return text[:-2] if text.endswith(".0") else text


class TextSink(LogSink):
    """`walk.txt`, as the original writes it."""

    format = "text"

    def __init__(self, path: str, about: About, digits: int | None = None) -> None:
        super().__init__(path, about)
        self._number: Callable[[float], str] = shortest if digits is None else f"%.{digits}g".__mod__
        self._digits = digits
        self._file = AppendFile(path)
        names = [column.original for column in about.columns]
        self._file.write(("0 " + "".join(f"{name} " for name in names) + "\n").encode())

    def append(self, rows: Sequence[Row]) -> None:
        """A line each."""
        number, exact = self._number, self._digits is None
        lines = [
            f"{seconds_text(ns) if exact else number(ns / 1e9)} {' '.join(map(number, values))} \n"
            for ns, values in rows
        ]
        self._file.write("".join(lines).encode())

    def sync(self) -> None:
        """To the disk."""
        self._file.sync()

    def close(self) -> None:
        """Close."""
        self._file.close()


class CsvSink(LogSink):
    """`walk.csv`: a line of names (`time` in seconds, then the columns), a line each row."""

    format = "csv"

    def __init__(self, path: str, about: About) -> None:
        super().__init__(path, about)
        self._file = AppendFile(path)
        head = io.StringIO()
        csv.writer(head, lineterminator="\n").writerow(["time", *map(cell_text, about.names)])
        self._file.write(head.getvalue().encode())

    def append(self, rows: Sequence[Row]) -> None:
        """A line each."""
        cells = [
            ",".join([seconds_text(ns), *["" if v != v else shortest(v) for v in values]]) + "\n"
            for ns, values in rows
        ]
        self._file.write("".join(cells).encode())

    def sync(self) -> None:
        """To the disk."""
        self._file.sync()

    def close(self) -> None:
        """Close."""
        self._file.close()
