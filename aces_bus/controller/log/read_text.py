"""Logs as text, read back: the original's of every age, ours, and CSV.

1. A file is untrusted: lines, columns and numbers are bounded, and what is wrong is an error with file:line.
2. The last line may be cut, as by a writer that was killed: then it is left out, and noted. Nothing else is skipped but
   blank lines.

*Facts*: old logs have bare names, new ones `Name(attribute)`; lines may end in blanks, and in CR LF.
"""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterator
from typing import IO

import numpy as np

from ...plain_text import text_of_cell
from .base import About
from .columns import MOST_COLUMNS
from .table import MOST_NUMBERS, Log, LogError, made_log, named_columns

#: 2,000 names, at their longest; a row of as many numbers is a tenth of it.
LONGEST_LINE = 1 << 19
NUMBER = re.compile(rb"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|nan|inf)", re.IGNORECASE)

Line = tuple[int, bytes, bool]


def _lines(stream: IO[bytes], where: str) -> Iterator[Line]:
    """Line numbers, lines and whether they end, without blank ones."""
    number = 0
    while line := stream.readline(LONGEST_LINE + 1):
        number += 1
        if len(line) > LONGEST_LINE:
            raise LogError(f"{where}:{number}: more than {LONGEST_LINE} characters in a line: no log")
        if number == 1:
            line = line.removeprefix(b"\xef\xbb\xbf")
        if text := line.strip():
            yield number, text, line.endswith(b"\n")


def _cells(text: bytes, is_csv: bool) -> list[bytes]:
    return [cell.strip() for cell in text.split(b",")] if is_csv else text.split()


def _head(where: str, number: int, text: bytes, is_csv: bool) -> list[str]:
    """The names in the first line, the time's left out."""
    try:
        line = text.decode("utf-8")
    except UnicodeDecodeError:
        raise LogError(f"{where}:{number}: not a text: is this a log?") from None
    if is_csv:
        try:
            names = [text_of_cell(cell) for cell in next(csv.reader([line], strict=True))]
        except csv.Error as error:
            raise LogError(f"{where}:{number}: no line of names: {error}") from None
    else:
        names = line.split()
    first, *names = names
    if first.strip() not in ("0", "time", "time_s"):
        wanted = "'time'" if is_csv else "'0'"
        raise LogError(f"{where}:{number}: a log's line of names begins with {wanted}, not {first[:24]!r}")
    if not names:
        raise LogError(f"{where}:{number}: no column beside the time")
    if len(names) > MOST_COLUMNS:
        raise LogError(f"{where}:{number}: more than {MOST_COLUMNS} columns")
    if not is_csv and all(NUMBER.fullmatch(name.encode()) for name in names):
        raise LogError(f"{where}:{number}: numbers where a log has its names")
    return names


def _numbers(where: str, number: int, cells: list[bytes], is_csv: bool) -> list[float]:
    """A row. What `float` takes beyond plain numbers is told apart only where it could be."""
    if is_csv:
        cells = [cell or b"nan" for cell in cells]
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        values = []
    joined = b"".join(cells)
    if not values or b"_" in joined or b"infinity" in joined.lower():
        for column, cell in enumerate(cells, 1):
            if not NUMBER.fullmatch(cell):
                shown = cell[:24].decode("ascii", "replace")
                raise LogError(f"{where}:{number}: column {column}: {shown!r} is no number")
    if values[0] != values[0]:
        raise LogError(f"{where}:{number}: no time")
    return values


def read_text_log(stream: IO[bytes], where: str, *, is_csv: bool, most_numbers: int = MOST_NUMBERS) -> Log:
    """Read a log from its beginning."""
    lines = _lines(stream, where)
    first = next(lines, None)
    if first is None:
        raise LogError(f"{where}: empty")
    columns = named_columns(f"{where}:{first[0]}", _head(where, first[0], first[1], is_csv))
    width = 1 + len(columns)
    numbers = array("d")
    notes: list[str] = []
    for number, text, is_ended in lines:
        cells = _cells(text, is_csv)
        if len(cells) != width:
            if not is_ended:
                notes.append(f"{where}:{number}: the last line is cut, and left out")
                break
            raise LogError(f"{where}:{number}: {len(cells)} numbers where the line of names has {width}")
        try:
            numbers.extend(_numbers(where, number, cells, is_csv))
        except LogError:
            if is_ended:
                raise
            notes.append(f"{where}:{number}: the last line is cut, and left out")
            break
        if not is_ended:
            notes.append(f"{where}:{number}: the last line has no end; its last number may be cut")
        if len(numbers) > most_numbers:
            raise LogError(f"{where}:{number}: more than {most_numbers} numbers")
    table = np.array(numbers, np.float64).reshape(-1, width)
    return made_log(where, "csv" if is_csv else "text", About(columns), table, notes)
