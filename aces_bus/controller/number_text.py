"""Text files of numbers in lines, for logs and trajectories.

1. A file is not trusted: a line is bounded, and whatever is wrong is an error with file:line.
2. `float` reads numbers; what it takes beyond plain ones is found by a character that these do not have.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import IO

from ..errors import CallerError
from ..state.errors import raise_first


@dataclass(frozen=True)
class NumberText:
    """How the numbers of a kind of file are written, and how its errors are raised.

    `characters` are all that a number may have; `number` matches a whole one. `what` is a kind of file ("log").
    """

    where: str
    error: type[CallerError]
    what: str
    number: re.Pattern[bytes]
    characters: bytes
    longest: int
    is_finite: bool = False

    def fault(self, line: int, said: str) -> CallerError:
        """Return the error about a line."""
        return self.error(f"{self.where}:{line}: {said}")

    def check(self, line: int, *faults: tuple[bool, str]) -> None:
        """Raise the first fault of a line that is there, of pairs (whether it is there, text)."""
        raise_first(self.error, *((is_there, f"{self.where}:{line}: {said}") for is_there, said in faults))

    def lines(self, stream: IO[bytes]) -> Iterator[tuple[int, bytes, bool]]:
        """Yield number, stripped text, and whether it ends with LF, of each line that is not blank."""
        number = 0
        while line := stream.readline(self.longest + 1):
            number += 1
            if len(line) > self.longest:
                raise self.fault(number, f"more than {self.longest} characters in a line: no {self.what}")
            if number == 1:
                line = line.removeprefix(b"\xef\xbb\xbf")
            if text := line.strip():
                yield number, text, line.endswith(b"\n")

    def values(self, line: int, cells: Sequence[bytes]) -> list[float]:
        """Return the numbers in the cells of a line."""
        try:
            values = [float(cell) for cell in cells]
        except ValueError:
            values = []
        if (
            not values
            or b"".join(cells).translate(None, self.characters)
            or (self.is_finite and not math.isfinite(sum(values)))
        ):
            for column, cell in enumerate(cells, 1):
                if not self.number.fullmatch(cell) or (self.is_finite and math.isinf(float(cell))):
                    shown = cell[:24].decode("ascii", "replace")
                    raise self.fault(line, f"column {column}: {shown!r} is not a number")
        return values
