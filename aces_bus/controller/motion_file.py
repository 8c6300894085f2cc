"""Trajectories and walking patterns as files: rows of numbers, with a line of names before them or without.

1. A file is untrusted: lines, columns, numbers and bytes are bounded, and whatever is wrong is an error with file:line.
2. Line ends are LF or CRLF, blanks may trail, and the last row needs no line end. Nothing is skipped but blank lines.
3. Numbers are plain decimals; no `nan`, no `inf`, no underscore.

The format is the original framework's `Script` (names first) and `Mini Leg` (none): facts from acesHubo,
orocosScripts. It says neither rate nor unit: the file's name may (`100hz.txt`), else the caller does.
"""

from __future__ import annotations

import math
import os
import re
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Literal

import numpy as np

from ..errors import CallerError
from ..state.errors import raise_first
from .motion import Interpolation, Trajectory
from .number_text import NumberText

#: A row of 1000 numbers, at most.
LONGEST_LINE = 32_768
MOST_COLUMNS = 1_000
#: Numbers in a file: four hours of 60 joints at 50 Hz, 0.8 GB while they are read.
MOST_NUMBERS = 50_000_000
NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
#: What no joint turns to: two turns either way. A file in degrees read as radians is found by it.
MOST_RAD = 4 * math.pi

Unit = Literal["rad", "deg"]
#: Names of the columns: one each ("" for a column to pass over), or a function of how many there are.
Columns = Sequence[str] | Callable[[int], Sequence[str]]


class TrajectoryError(CallerError):
    """A file that is not a trajectory: says file:line and what would do."""


def rate_in_name(name: str) -> float | None:
    """Return the rate that a file's name says: 100hz.txt, walk_50Hz_deg.txt.

    >>> rate_in_name("handwave_100hz_deg.txt"), rate_in_name("test9.txt")
    (100.0, None)
    """
    found = re.search(r"(\d{1,6}(?:\.\d+)?)\s*hz", name, re.IGNORECASE)
    return float(found[1]) if found and float(found[1]) > 0 else None


def read_trajectory(
    file: str | os.PathLike[str] | IO[bytes],
    *,
    rate_hz: float | None = None,
    columns: Columns | None = None,
    unit: Unit = "rad",
    interpolation: Interpolation = "linear",
    most_numbers: int = MOST_NUMBERS,
) -> Trajectory:
    """Read a file of set-points.

    `columns` names the columns of a file that does not; "" passes one over, and fewer names than columns pass over the
    rest of them. With `unit="deg"` the numbers are converted to rad; else they are kept as they are.
    `rate_hz` None takes the rate from the file's name. `TrajectoryError` says file:line.
    """
    if not isinstance(file, (str, os.PathLike)):
        name = str(getattr(file, "name", "trajectory"))
        return _read(file, name, rate_hz, columns, unit, interpolation, most_numbers)
    path = Path(file)
    try:
        with path.open("rb") as stream:
            return _read(stream, str(path), rate_hz, columns, unit, interpolation, most_numbers)
    except OSError as error:
        raise TrajectoryError(f"{path}: {error.strerror or error}") from None


def _names(text: NumberText, number: int, tokens: list[bytes]) -> list[str]:
    """Return the line of names."""
    if any(NUMBER.fullmatch(token) for token in tokens):
        shown = b" ".join(tokens[:6]).decode("ascii", "replace")
        raise text.fault(number, f"names and numbers in one line: {shown!r}")
    names = [token.decode("utf-8", "replace") for token in tokens]
    double = [name for name in dict.fromkeys(names) if names.count(name) > 1]
    text.check(
        number,
        (
            not all(name.isprintable() and "\N{REPLACEMENT CHARACTER}" not in name for name in names),
            "neither numbers nor names: is this a text file?",
        ),
        (bool(double), f"{', '.join(double)} named twice"),
    )
    return names


def _read(
    stream: IO[bytes],
    where: str,
    rate_hz: float | None,
    columns: Columns | None,
    unit: Unit,
    interpolation: Interpolation,
    most_numbers: int,
) -> Trajectory:
    if unit not in ("rad", "deg"):
        raise CallerError(f"unit is 'rad' or 'deg', not {unit!r}")
    text = NumberText(where, TrajectoryError, "trajectory", NUMBER, b"0123456789+-.eE", LONGEST_LINE, True)
    lines = text.lines(stream)
    number, line, _ = next(lines, (0, b"", True))
    if not line:
        raise TrajectoryError(f"{where}: empty")
    tokens = line.split()
    if len(tokens) > MOST_COLUMNS:
        raise text.fault(number, f"more than {MOST_COLUMNS} columns")
    names: Sequence[str]
    numbers = array("d")
    if all(NUMBER.fullmatch(token) for token in tokens):
        names = _given_names(where, columns, len(tokens))
        numbers.extend(text.values(number, tokens))
    else:
        names = _names(text, number, tokens)
        if columns is not None and not callable(columns):
            names = _given_names(where, columns, len(tokens))
    width = len(tokens)
    for number, line, _ in lines:
        tokens = line.split()
        if len(tokens) != width:
            raise text.fault(number, f"{len(tokens)} numbers where the lines before have {width}")
        numbers.extend(text.values(number, tokens))
        if len(numbers) > most_numbers:
            raise text.fault(number, f"more than {most_numbers} numbers")
    if not numbers:
        raise TrajectoryError(f"{where}: names, but no row of numbers")
    rate = rate_hz if rate_hz is not None else rate_in_name(Path(where).name)
    if rate is None:
        raise TrajectoryError(f"{where}: the file does not say its rate: give rate_hz (rows a second)")
    keep = [i for i, name in enumerate(names) if name]
    table = np.frombuffer(numbers).reshape(-1, width)
    made = Trajectory(
        [names[i] for i in keep],
        table[:, keep],
        rate_hz=rate,
        interpolation=interpolation,
        source=Path(where).name,
    )
    return made.scaled(dict.fromkeys(made.names, math.pi / 180)) if unit == "deg" else made


def _given_names(where: str, columns: Columns | None, count: int) -> Sequence[str]:
    if columns is None:
        raise TrajectoryError(f"{where}: {count} columns without names: give columns=[…]")
    names = list(columns(count) if callable(columns) else columns)
    raise_first(
        TrajectoryError,
        (len(names) > count, f"{where}: {len(names)} names for {count} columns"),
        (not any(names), f"{where}: none of its {count} columns has a name"),
    )
    return [*names, *[""] * (count - len(names))]
