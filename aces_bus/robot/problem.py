"""What is wrong in a robot's file: where, under which key, and what is expected there.

1. A problem names file, line and key; an error makes the file unusable, a warning does not.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from ..errors import CallerError


class RobotFileProblem(msgspec.Struct, frozen=True, order=True):
    """One complaint. `line` counts from 1; `key` is the dotted path in the file, "" for the file as a whole."""

    file: str
    line: int
    key: str
    text: str
    is_warning: bool = False

    def __str__(self) -> str:
        key = f"{self.key}: " if self.key else ""
        return f"{self.file}:{self.line}: {'warning: ' if self.is_warning else ''}{key}{self.text}"


class RobotError(CallerError):
    """A robot's file that cannot be used: the message has one line a problem, all of them."""

    def __init__(self, problems: Sequence[RobotFileProblem]) -> None:
        super().__init__("\n".join(map(str, problems)))
        self.problems = tuple(problems)
