"""What of a foreign file could not be taken over: never silently, always with its line."""

from __future__ import annotations

import logging
from collections.abc import Generator
from contextlib import contextmanager

import msgspec

from ..protocol import Protocol

#: Characters of an excerpt.
EXCERPT = 80


class ImportProblem(msgspec.Struct, frozen=True, order=True):
    """Something that was left out, or (`is_note`) taken over differently: another name, shared bits.

    `line` counts from 1; 0 where no line can be named. `column` counts from 1 within it; 0 where only the line is known.
    """

    line: int
    reason: str
    excerpt: str = ""
    is_note: bool = False
    column: int = 0

    def __str__(self) -> str:
        where = f"line {self.line}: " if self.line else ""
        return f"{where}{self._said}"

    def of(self, path: str) -> str:
        """Return it as compilers say it: `file:line:column: …`."""
        place = ":".join(str(number) for number in (self.line, self.column) if number)
        return f"{path}:{place}: {self._said}" if self.line else f"{path}: {self._said}"

    @property
    def _said(self) -> str:
        # A name in it may have line ends: the problem stays one line.
        return ProblemText.one_line(self.reason) + (
            f" ({ProblemText.one_line(self.excerpt)})" if self.excerpt else ""
        )


class Loss(msgspec.Struct, frozen=True):
    """What another form cannot say of a field ("" for the whole message), of a message ("" for all), and what is done."""

    message: str
    field: str
    reason: str

    def __str__(self) -> str:
        where = ".".join(filter(None, (self.message, self.field)))
        return ProblemText.one_line(f"{where}: {self.reason}" if where else self.reason)


class ImportedProtocol(msgspec.Struct, frozen=True):
    """A foreign file as a protocol. `statements` counts what the file consists of: of a DBC statements and signals, of
    an EDS sections, of the others messages."""

    protocol: Protocol
    problems: tuple[ImportProblem, ...]
    statements: int
    path: str = ""

    @property
    def losses(self) -> list[ImportProblem]:
        """Problems that left something out of the protocol."""
        return [problem for problem in self.problems if not problem.is_note]

    @property
    def summary(self) -> str:
        """One line for people; empty when everything was taken over as it is."""
        lost, noted = self.losses, len(self.problems) - len(self.losses)
        if not self.problems:
            return ""
        parts = []
        if lost:
            verb = "was" if len(lost) == 1 else "were"
            count = f"{self.statements:,} statement{'' if self.statements == 1 else 's'}"
            # Where a statement is a whole message, several fields of it may be lost.
            what = f"{len(lost):,} of" if len(lost) <= self.statements else f"{len(lost):,} parts of"
            parts.append(f"{what} {count} {verb} left out")
        if noted:
            parts.append(f"{noted:,} {'is' if noted == 1 else 'are'} taken over differently")
        first = (lost or list(self.problems))[0]
        return f"{self.path}: {', '.join(parts)}; first: {first}"


@contextmanager
def quiet(library: str) -> Generator[None, None, None]:
    """Silence a library's log: what it says of a file is said better here."""
    logger = logging.getLogger(library)
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)


class ProblemText:
    """Texts of other files and libraries, as a problem shows them."""

    @staticmethod
    def of_error(error: Exception) -> str:
        """Return a complaint without the `file:line: ` of the program that declared it."""
        text = str(error)
        head, separator, rest = text.partition(": ")
        return rest if separator and head.rpartition(":")[2].isdigit() else text

    @staticmethod
    def excerpt(text: str) -> str:
        """Return the beginning of a statement, on one line."""
        flat = " ".join(ProblemText.clean(text).split())
        return flat if len(flat) <= EXCERPT else flat[: EXCERPT - 1] + "…"

    @staticmethod
    def clean(text: str) -> str:
        """Return a text from elsewhere without characters that do not print; lines stay lines."""
        if text.isprintable():
            return text.strip()
        return "".join(ch if ch.isprintable() or ch == "\n" else " " for ch in text).strip()

    @staticmethod
    def one_line(text: str) -> str:
        """Return a text from elsewhere as part of a comment: printable, without line ends."""
        return ProblemText.clean(" ".join(text.split()))
