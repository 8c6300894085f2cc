"""Lines of blank-separated words, as the description files of other programs have them.

1. Every word knows its file and line. Nothing is guessed from a line that is not understood: it is a problem.
2. Sizes are limited; only regular files are read.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from aces_bus.errors import CallerError
from aces_bus.robot import RobotFileProblem

#: Bytes of a description file; those of the sources have 7 kB at most.
LARGEST: Final = 2**20
#: Problems of a description; then it is given up.
MOST: Final = 1000
_WORD: Final = re.compile(r'"([^"]*)"|([^\s"#]+)|(#.*)|(")')


class WordLine(NamedTuple):
    """A line that has words."""

    file: str
    number: int
    words: tuple[str, ...]

    def problem(self, key: str, text: str) -> RobotFileProblem:
        return RobotFileProblem(self.file, self.number, key, text)


def read_lines(path: Path) -> list[WordLine]:
    """The lines of a file that have words; `#` begins a comment, quotes keep blanks. Raises `CallerError`."""
    try:
        if path.exists() and not path.is_file():
            raise CallerError(f"{path}: not a file")
        data = path.read_bytes() if path.stat().st_size <= LARGEST else None
    except (OSError, ValueError) as error:
        raise CallerError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    if data is None:
        raise CallerError(f"{path}: larger than a description may be ({LARGEST >> 20} MB)")
    if b"\0" in data:
        raise CallerError(f"{path}: not a text file")
    found: list[WordLine] = []
    for number, text in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        words = tuple(_words(text))
        if words:
            found.append(WordLine(str(path), number, words))
    return found


def _words(text: str) -> Iterator[str]:
    for match in _WORD.finditer(text):
        if match[3] is not None:
            return
        yield match[1] if match[1] is not None else match[2] or match[4]


def whole(word: str) -> int:
    """A whole number as C reads it, in any of its bases. Raises `ValueError`."""
    if len(word) > 20 or "_" in word:
        raise ValueError
    text = word.lstrip("+-")
    if len(text) > 1 and text[0] == "0" and text.isdigit():
        return (-1 if word[0] == "-" else 1) * int(text, 8)
    return int(word, 0)


def decimal_number(word: str) -> int:
    """A whole number in decimal, zeros in front or not. Raises `ValueError`."""
    if len(word) > 20 or "_" in word:
        raise ValueError
    return int(word, 10)


def plausible_number(word: str) -> float:
    """A number of a size that occurs. Raises `ValueError`."""
    if len(word) > 40 or "_" in word:
        raise ValueError
    value = float(word)
    if not abs(value) <= 1e12 or 0 < abs(value) < 1e-12:
        raise ValueError
    return value


def take(
    line: WordLine,
    key: str,
    words: Sequence[str],
    read: Callable[[str], Any],
    count: int,
    problems: list[RobotFileProblem],
) -> list[Any] | None:
    """`count` values of a line; None, and a problem, when they are not there."""
    what = (
        "a number"
        if read is plausible_number
        else "a whole number"
        if read in (whole, decimal_number)
        else "a word"
    )
    if len(words) == count:
        try:
            return [read(word) for word in words]
        except (ValueError, KeyError):
            pass
    wanted = what if count == 1 else f"{count} values, each {what}"
    problems.append(line.problem(key, f"expected {wanted}, not {' '.join(words)[:60]!r}"))
    return None
