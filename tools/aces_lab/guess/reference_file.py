"""A measured quantity out of a table: the column, the instants of its rows, and its unit.

1. Instants are numbers (seconds, or what the column's name says: `t_ms`, `time [us]`), Unix time in s, ms, µs or ns by its
   size, or dates in ISO 8601; without a zone they are UTC.
2. Rows without a number in the column are left out; the order of rows is that of time. Nothing else is mended.
3. At most `ROWS` rows are read.
"""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

import numpy as np

from aces_bus.errors import CallerError, CaptureError
from aces_bus.protocol.lint.fields import is_unit, suggest

from .fields import Array
from .reference import MeasuredQuantity

#: Rows that are read, and characters of a line.
ROWS, LINE = 2_000_000, 1 << 16
#: Names of columns that have instants, and the units that they may name.
_TIME = re.compile(
    r"(?:rel|abs|unix|utc|log)?[ _]?(?:t|time|times|timestamp|stamp|date|datetime|epoch|seconds|secs)"
)
_UNIT = re.compile(r"\s*(?:[_ ](?P<plain>s|ms|us|µs|ns)|[\[(](?P<unit>[^\])]*)[\])])\s*$")
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
#: Unix time by its size: from so much on it is in that unit (2001 on).
_UNIX = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))


def read_quantity(text: str, time: str | None = None, unit: str = "") -> MeasuredQuantity:
    """Return the quantity that `FILE.csv:COLUMN` names, with the instants of the column `time`, or of the one that is
    named so.

    Raises `CallerError` for a file, a column or a unit that is none, `CaptureError` for a table that cannot be read.
    """
    path, _, wanted = text.rpartition(":")
    if not path or not wanted:
        raise CallerError(f"--reference {text}: not a file and a column; write FILE.csv:COLUMN")
    if unit and not is_unit(unit):
        near = suggest(unit)
        raise CallerError(f"--unit {unit}: not a unit of specs" + (f"; do you mean {near}?" if near else ""))
    try:
        with open(path, encoding="utf-8-sig", newline="", errors="replace") as file:
            head, rows = _table(path, file.readline(LINE), file)
            at = _column(path, head, wanted)
            instants = _time_column(path, head, time)
            times, values = _numbers(path, rows, instants, at)
    except OSError as error:
        raise CallerError(f"{path}: {os.strerror(error.errno or 0)}") from None
    except csv.Error as error:
        raise CaptureError(f"{path}: not a table of comma-separated values: {error}") from None
    if len(values) < 2:
        raise CaptureError(
            f"{path}: column {head[at]!r} has {len(values)} numbers with an instant; two are needed"
        )
    times = times * _seconds(head[instants], times)
    times, first = np.unique(times, return_index=True)
    named = _UNIT.search(head[at])
    own = (named["unit"] if named is not None else None) or ""
    return MeasuredQuantity(_bare(head[at]), unit or (own if is_unit(own) else ""), times, values[first])


def _table(path: str, first: str, lines: Iterator[str]) -> tuple[list[str], Iterator[list[str]]]:
    separator = max(",;\t", key=first.count)
    head = [cell.strip() for cell in next(csv.reader([first], delimiter=separator), [])]
    if len(head) < 2:
        raise CaptureError(
            f"{path}: its first line has no names of two columns, divided by comma, semicolon or tab"
        )
    rows = csv.reader((line[:LINE] for line in lines), delimiter=separator)
    # Where semicolons divide columns, commas are in numbers.
    return head, ([cell.replace(",", ".") for cell in row] for row in rows) if separator == ";" else rows


def _bare(name: str) -> str:
    """Return a column's name without the unit in brackets behind it."""
    found = _UNIT.search(name)
    return name[: found.start()] if found is not None and found["unit"] is not None else name


def _column(path: str, head: Sequence[str], wanted: str) -> int:
    for names in (head, [_bare(name) for name in head]):
        if names.count(wanted) == 1:
            return names.index(wanted)
    raise CallerError(f"{path}: has no column {wanted!r}, or several; there are {', '.join(head)}")


def _time_column(path: str, head: Sequence[str], named: str | None) -> int:
    if named is not None:
        return _column(path, head, named)
    for number, name in enumerate(head):
        if _TIME.fullmatch(_UNIT.sub("", name).strip().lower()):
            return number
    raise CallerError(
        f"{path}: no column is named like time; name it (--time-column COLUMN): {', '.join(head)}"
    )


def _numbers(path: str, rows: Iterator[list[str]], instants: int, at: int) -> tuple[Array, Array]:
    times: list[float] = []
    values: list[float] = []
    for number, row in enumerate(rows, 2):
        if len(times) >= ROWS:
            break
        if len(row) <= max(instants, at):
            continue
        value = _number(row[at])
        if math.isfinite(value):
            time = _instant(row[instants])
            if not math.isfinite(time):
                raise CaptureError(f"{path}:{number}: {row[instants][:40]!r} is not an instant")
            times.append(time)
            values.append(value)
    return np.array(times), np.array(values)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _instant(cell: str) -> float:
    number = _number(cell)
    if math.isfinite(number):
        return number
    try:
        date = datetime.fromisoformat(cell.strip())
    except ValueError:
        return math.nan
    return (date if date.tzinfo is not None else date.replace(tzinfo=UTC)).timestamp()


def _seconds(name: str, times: Array) -> float:
    """Return what an instant of 1 is in seconds, by the column's name or by the size of Unix time."""
    found = _UNIT.search(name)
    unit = (found["plain"] or found["unit"] or "").strip() if found is not None else ""
    if unit in _SECONDS:
        return _SECONDS[unit]
    largest = float(np.max(np.abs(times)))
    return next((factor for least, factor in _UNIX if largest >= least), 1.0)
