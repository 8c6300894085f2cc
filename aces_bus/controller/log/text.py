"""Logs as text: the original's of every age, and CSV.

1. A number is the shortest text that reads back as the same float; seconds are exact to the nanosecond.
2. Neither format has a place for units, robot or date; that is what the others are for.
3. A file that is read is not trusted: lines, columns and numbers are bounded, and what is wrong is an error with file:line.
4. The last line may be cut, as by a writer that was killed: it is left out then, and noted. Nothing else is skipped but
   blank lines.

*Facts* (acesHubo, logger.*): the first line is `0 ` and then `Name(attribute) ` for each column; every other line is the
seconds since the start and the values, each followed by a blank. The original wrote six significant digits, which
`digits=6` gives. Old logs have bare names; lines may end in blanks, and in CR LF. *Choice*: unknown is `nan` there, and an
empty cell in CSV.
"""

from __future__ import annotations

import csv
import io
import re
from array import array
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ...export.files import AppendFile
from ...plain_text import cell_text, text_of_cell
from ..number_text import NumberText
from .base import About, Log, LogError, LogSink, Row, named_columns, seconds_text
from .columns import MOST_COLUMNS, LogColumn

#: 2,000 names, at their longest; a row of as many numbers is a tenth of it.
LONGEST_LINE = 1 << 19
NUMBER = re.compile(rb"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|nan|inf)", re.IGNORECASE)


def shortest(value: float) -> str:
    """Return the shortest text of a float, as C++ streams write whole numbers.

    >>> shortest(-2.0), shortest(0.1), shortest(-0.0), shortest(1e22)
    ('-2', '0.1', '-0', '1e+22')
    """
    text = repr(value)
    return text[:-2] if text.endswith(".0") else text


def shortest_row(values: Iterable[float], mark: str) -> str:
    """Return the shortest texts of many floats at once, `mark` behind each.

    >>> shortest_row([-2.0, 0.5, 10.0], ",")
    '-2,0.5,10,'
    """
    return f"{mark.join(map(repr, values))}{mark}".replace(f".0{mark}", mark)


class TextSink(LogSink):
    """`walk.txt`, as the original writes it."""

    def __init__(self, path: str, about: About, digits: int | None = None) -> None:
        super().__init__(path, about)
        self._number: Callable[[float], str] = shortest if digits is None else f"%.{digits}g".__mod__
        self._seconds = seconds_text if digits is None else lambda ns: self._number(ns / 1e9)
        self._file = AppendFile(path)
        names = "".join(f"{column.original} " for column in about.columns)
        self._file.write(f"0 {names}\n".encode())

    def append(self, rows: Sequence[Row]) -> None:
        """Write a line for each row."""
        seconds, number = self._seconds, self._number
        lines = [f"{seconds(ns)} {' '.join(map(number, values))} \n" for ns, values in rows]
        self._file.write("".join(lines).encode())


class CsvSink(LogSink):
    """`walk.csv`: a line of names (`time` in seconds, then the columns), a line each row."""

    def __init__(self, path: str, about: About) -> None:
        super().__init__(path, about)
        self._file = AppendFile(path)
        head = io.StringIO()
        csv.writer(head, lineterminator="\n").writerow(["time", *map(cell_text, about.names)])
        self._file.write(head.getvalue().encode())

    def append(self, rows: Sequence[Row]) -> None:
        """Write a line for each row; an unknown value is an empty cell."""
        lines = [
            f"{seconds_text(ns)},{shortest_row(values, ',').replace('nan,', ',')[:-1]}\n"
            for ns, values in rows
        ]
        self._file.write("".join(lines).encode())


def _names(text: NumberText, number: int, line: bytes, is_csv: bool) -> list[str]:
    """Return the names in the first line, the time's left out."""
    try:
        names = line.decode("utf-8").split()
        if is_csv:
            names = [text_of_cell(cell) for cell in next(csv.reader([line.decode()], strict=True))]
    except UnicodeDecodeError:
        raise text.fault(number, "not a text: is this a log?") from None
    except csv.Error as error:
        raise text.fault(number, f"no line of names: {error}") from None
    first, *names = names
    wanted = "'time'" if is_csv else "'0'"
    text.check(
        number,
        (
            first.strip() not in ("0", "time", "time_s"),
            f"a log's line of names begins with {wanted}, not {first[:24]!r}",
        ),
        (not names, "no column beside the time"),
        (len(names) > MOST_COLUMNS, f"more than {MOST_COLUMNS} columns"),
        (
            not is_csv and all(NUMBER.fullmatch(name.encode()) for name in names),
            "numbers where a log has its names",
        ),
    )
    return names


def read_text_log(path: str, most_numbers: int) -> Log:
    """Read the original's text, or CSV, which its first line says."""
    text = NumberText(path, LogError, "log", NUMBER, b"0123456789+-.eEnNaAiIfF", LONGEST_LINE)
    numbers = array("d")
    notes: list[str] = []
    width, is_csv = 0, False
    columns: tuple[LogColumn, ...] = ()
    with open(path, "rb") as stream:
        for number, line, is_ended in text.lines(stream):
            if not width:
                is_csv = line.startswith((b"time,", b'"time",', b"time_s,", b"0,"))
                columns = named_columns(f"{path}:{number}", _names(text, number, line, is_csv))
                width = 1 + len(columns)
                continue
            try:
                cells = [cell.strip() or b"nan" for cell in line.split(b",")] if is_csv else line.split()
                if len(cells) != width:
                    raise text.fault(number, f"{len(cells)} numbers where the line of names has {width}")
                values = text.values(number, cells)
                if values[0] != values[0]:
                    raise text.fault(number, "no time")
            except LogError:
                if is_ended:
                    raise
                notes.append(f"{path}:{number}: the last line is cut, and left out")
                break
            numbers.extend(values)
            if not is_ended:
                notes.append(f"{path}:{number}: the last line has no end; its last number may be cut")
            if len(numbers) > most_numbers:
                raise text.fault(number, f"more than {most_numbers} numbers")
    if not width:
        raise LogError(f"{path}: empty")
    table = np.array(numbers, np.float64).reshape(-1, width)
    return Log.of_table(path, "csv" if is_csv else "text", About(columns), table, notes)
