"""DBC, KCD, SYM and ARXML files, read through cantools; a DBC statement by statement where cantools refuses the whole.

1. A file that cantools loads is loaded once. Of one that it refuses, statements are tried alone, then together.
2. Work is bounded: by the file's size, by the number of tries and by time.
"""

from __future__ import annotations

import gc
import os
import re
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from ..._lazy import import_only_modules
from ...errors import CallerError
from .import_build import build
from .import_statements import (
    MESSAGE,
    Statement,
    grouped,
    join_statements,
    resplit,
    safe_statements,
    split_statements,
    usable,
)
from .names import PythonNames
from .problems import ImportedProtocol, ImportProblem, ProblemText, quiet

#: Bytes of the largest file that is read.
MOST_BYTES = 64 * 1024 * 1024
#: Messages and signals of the largest database that is read: a car has a few thousand messages.
MOST_MESSAGES, MOST_SIGNALS = 32_768, 524_288
#: Statements that cantools can parse but not use are searched for so often, and so many seconds; statements that it cannot
#: parse, so many seconds.
MOST_SEARCHES, MOST_SECONDS, MOST_PARSING = 50, 30.0, 120.0


def load_dbc(path: str) -> ImportedProtocol:
    """Return a DBC, KCD, SYM or ARXML file as a protocol; raises `CallerError` when nothing can be read."""
    with _no_collector():
        return _load(path, os.path.splitext(path)[1].lower()[1:])


@contextmanager
def _no_collector() -> Generator[None, None, None]:
    """Disable the garbage collector: a database is hundreds of thousands of lasting objects, and looking
    through them for cycles takes longer than making them.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def _load(path: str, kind: str) -> ImportedProtocol:
    text = read_text(path, kind)
    problems: list[ImportProblem] = []
    lines: Callable[[Any, Any], int]
    if kind == "dbc":
        database, problems, count, lines = _load_dbc(path, text)
    else:
        database = _load_whole(path, text, kind)
        count = len(database.messages)
        lines = _Search(text)
    protocol, more = build(database, protocol_name(path), path, lines)
    _check_any(path, protocol.declared, [*problems, *more])
    return ImportedProtocol(protocol, tuple(sorted([*problems, *more])), count, path)


def protocol_name(path: str) -> str:
    """Return what the protocol of a file is called: the file's name without its suffix, as a Python name."""
    name = os.path.basename(path)
    return PythonNames.unused(name.rpartition(".")[0] or name, set())


def read_text(path: str, kind: str) -> str:
    """Return the text of a file: UTF-8 where it is that, else Windows-1252, in which most tools write DBC and SYM files."""
    try:
        if os.path.isdir(path):
            raise CallerError(f"{path}: a folder, not a {kind.upper()} file")
        with open(path, "rb") as file:
            if (size := os.fstat(file.fileno()).st_size) > MOST_BYTES:
                raise CallerError(
                    f"{path}: {size:,} bytes; at most {MOST_BYTES:,} are read as a {kind.upper()} file"
                )
            data = file.read(MOST_BYTES + 1)
    except FileNotFoundError:
        raise CallerError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise CallerError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


def _try(text: str, kind: str) -> Any:
    """Return the database; raises whatever cantools raises."""
    # Its package imports python-can, which reading a database does not need: a third of the time to start.
    import_only_modules("cantools")
    import cantools.database

    with quiet("cantools"):
        # Not strict: what overlaps or does not fit is for `build` to say, signal by signal.
        return cantools.database.load_string(text, database_format=kind, strict=False)


#: What says where and how long signals and messages are, in the formats that are read as a whole.
_NUMBERS = {
    "kcd": r"""\b(?:offset|length|endOffset)\s*=\s*["'](\d{6,})["']""",
    "sym": r"""(?m)^\s*(?:Sig|Var|Mux|Len|DLC)\s*=\s*(?:"[^"\n]*")?[^"/\n]*?(?<![\w.])(\d{6,})\b""",
    "arxml": r"<[\w:-]*(?:LENGTH|POSITION|OFFSET)[^<>]*>\s*(\d{6,})\s*<",
}
_RANGE = re.compile(r"(?m)^\s*ID\s*=\s*([0-9A-Fa-f]+)h\s*-\s*([0-9A-Fa-f]+)h")
#: Identifiers of one message of a SYM file.
MOST_IDENTIFIERS = 2048


def _check_size(path: str, text: str, kind: str) -> None:
    """Raise `CallerError` for numbers, places and lengths that would cost memory or time beyond measure."""
    messages, signals = (sum(1 for _ in re.finditer(begin, text)) for begin in _BEGINS[kind])
    _check_count(path, messages, signals)
    for found in re.finditer(_NUMBERS[kind], text):
        line = text.count("\n", 0, found.start(1)) + 1
        raise CallerError(f"{path}:{line}: {found[1][:20]} is not a place and no length in a message")
    for found in _RANGE.finditer(text) if kind == "sym" else ():
        if int(found[2], 16) - int(found[1], 16) >= MOST_IDENTIFIERS:
            line = text.count("\n", 0, found.start(1)) + 1
            raise CallerError(f"{path}:{line}: a message of more than {MOST_IDENTIFIERS:,} identifiers")


#: What begins a message and a signal in the formats that are read as a whole.
_BEGINS = {
    "kcd": (r"<(?:\w+:)?Message\b", r"<(?:\w+:)?Signal\b"),
    "sym": (r"(?m)^\s*ID\s*=", r"(?m)^\s*(?:Sig|Var)\s*="),
    "arxml": (r"<(?:\w+:)?CAN-FRAME>", r"<(?:\w+:)?I-SIGNAL>"),
}


def _load_whole(path: str, text: str, kind: str) -> Any:
    _check_size(path, text, kind)
    try:
        return _try(text, kind)
    except Exception as error:  # whatever a parser of a damaged file may raise
        raise CallerError(f"{path}: not a {kind.upper()} file that can be read: {_reason(error)}") from error


def _reason(error: BaseException) -> str:
    """Return what went wrong, in one line, without the names of classes."""
    cause = error.__cause__ if type(error).__name__ == "UnsupportedDatabaseFormatError" else None
    cause = cause or error
    text = " ".join(str(cause).split())
    if isinstance(cause, KeyError):
        text = f"{text} is not there"
    elif isinstance(cause, RecursionError):
        text = "it refers to itself"
    text = re.sub(r"^(line \d+, column \d+|Invalid syntax at line \d+, column \d+): ?", "", text)
    marked = re.search(r">>!<<(.{0,20})", text)
    if marked:
        near = marked[1].strip().split(" ")[0]
        text = f"cannot be read at {near!r}" if near else "ends too soon"
    return ProblemText.excerpt(text) or type(cause).__name__


def _check_count(path: str, messages: int, signals: int) -> None:
    """Raise `CallerError` for a file of more than is read."""
    for number, most, what in ((messages, MOST_MESSAGES, "messages"), (signals, MOST_SIGNALS, "signals")):
        if number > most:
            raise CallerError(f"{path}: {number:,} {what}; at most {most:,} are read from one file")


def _check_any(path: str, messages: Sequence[Any], problems: Sequence[ImportProblem]) -> None:
    if not messages:
        first = f"; first: {min(problems)}" if problems else ""
        raise CallerError(f"{path}: no message in it can be used{first}")


# ---------------------------------------------------------------------- DBC


def _load_dbc(path: str, text: str) -> tuple[Any, list[ImportProblem], int, _Declared]:
    """Return the database, what is not in it, how many statements and signals there were, and where."""
    text = text.replace("\0", " ")
    statements = split_statements(text)
    if not any(statement.word for statement in statements):
        raise CallerError(f"{path}: not a DBC file: no line of it begins a statement")
    count = sum(1 + len(statement.inner) for statement in statements)
    _check_count(
        path,
        sum(statement.word == "BO_" for statement in statements),
        sum(len(statement.inner) for statement in statements),
    )
    kept, problems = safe_statements(statements)
    try:
        return _try(join_statements(kept), "dbc"), problems, count, _Declared(kept)
    except Exception:  # whatever a parser of a damaged file may raise
        pass
    # From the beginning: what an open string hides comes to light first, then what speaks of what has gone goes, too.
    kept, problems = _parsed(path, split_statements(text))
    for check in (safe_statements, usable, safe_statements):
        kept, more = check(kept)
        problems += more
    database, kept = _searched(path, kept, problems)
    count = max(count, len(problems) + sum(1 + len(statement.inner) for statement in kept))
    return database, problems, count, _Declared(kept)


class _Complaint(NamedTuple):
    """Why a text cannot be parsed, and where in it."""

    reason: str
    line: int
    column: int


def _parsed(path: str, statements: list[Statement]) -> tuple[list[Statement], list[ImportProblem]]:
    """Return the statements that cantools can parse, and why not the others."""
    from cantools.database.can.formats.dbc.dbc_loader import DbcParser

    parser: Any = DbcParser()
    kept: list[Statement] = []
    problems: list[ImportProblem] = []

    def complaint(text: str) -> _Complaint | None:
        try:
            parser.parse(text)
        except Exception as error:  # as above
            return _Complaint(_reason(error), getattr(error, "line", 1), getattr(error, "column", 0))
        return None

    pending = statements[::-1]
    until = time.monotonic() + MOST_PARSING
    while pending:
        if time.monotonic() > until:
            raise CallerError(
                f"{path}: it has statements that cannot be read, and to find them takes more than {MOST_PARSING:g} s;"
                f" at line {pending[-1].line:,} of it: {len(problems):,} found"
            )
        statement = pending.pop()
        if not statement.word and not statement.text.strip():
            continue
        found = None if statement.word == "NS_" else complaint(statement.whole)
        if found is None:
            kept.append(statement)
            continue
        if statement.word == "BO_" and statement.inner and not complaint(statement.text):
            behind = _parsed_signals(statement, complaint, problems)
            kept.append(statement)
        else:
            first, *behind = resplit(statement)
            inside = f", and with it its {len(statement.inner)} signals" if statement.inner else ""
            problems.append(first.problem(found.reason + inside, (found.line, found.column)))
        if behind:
            while pending and pending[-1].word == "SG_":
                behind.append(pending.pop())
            pending += grouped(behind)[::-1]
    return kept, problems


def _parsed_signals(
    message: Statement, complaint: Callable[[str], _Complaint | None], problems: list[ImportProblem]
) -> list[Statement]:
    """Leave a message the signals that can be parsed; return what was found inside the others: a string that
    was not closed has taken in what follows.
    """
    waiting = message.inner[::-1]
    message.inner = []
    behind: list[Statement] = []
    while waiting:
        signal = waiting.pop()
        found = complaint(message.text + signal.text)
        if found is None:
            message.inner.append(signal)
            continue
        first, *rest = resplit(signal)
        line = found.line - message.text.count("\n")
        problems.append(first.problem(found.reason, (line, found.column)))
        own = next(
            (n for n, statement in enumerate(rest) if statement.word not in ("SG_", "?", "")), len(rest)
        )
        if own < len(rest):
            # Another message begins inside: what follows is that one's.
            behind = [*rest[own:], *waiting[::-1]]
            waiting = []
        waiting += rest[:own][::-1]
    return behind


def _searched(
    path: str, statements: list[Statement], problems: list[ImportProblem]
) -> tuple[Any, list[Statement]]:
    """Return the database of the statements without those that cantools parses and then refuses, found by halving and
    added to the problems."""
    until = time.monotonic() + MOST_SECONDS
    for _ in range(MOST_SEARCHES):
        _check_any(path, [statement for statement in statements if statement.word == "BO_"], problems)
        try:
            return _try(join_statements(statements), "dbc"), statements
        except Exception as error:  # as above
            reason = _reason(error)
        good, bad = 0, len(statements)  # the first `good` load, the first `bad` do not
        while bad - good > 1 and time.monotonic() < until:
            middle = (good + bad) // 2
            try:
                _try(join_statements(statements[:middle]), "dbc")
                good = middle
            except Exception as error:  # as above
                bad, reason = middle, _reason(error)
        if time.monotonic() >= until:
            break
        problems.append(statements[bad - 1].problem(reason))
        statements = [statement for index, statement in enumerate(statements) if index != bad - 1]
    # Too many to find one by one: the messages alone, with what is said of them at all.
    essential = [
        statement
        for statement in statements
        if statement.word in ("BO_", "BU_", "SG_MUL_VAL_", "SIG_VALTYPE_")
    ]
    try:
        database = _try(join_statements(essential), "dbc")
    except Exception as error:  # as above
        raise CallerError(f"{path}: not a DBC file that can be read: {_reason(error)}") from error
    dropped = [statement for statement in statements if statement not in essential and statement.word]
    problems += [statement.problem("left out: too much of this file cannot be read") for statement in dropped]
    return database, essential


_PLACED = re.compile(r"\s*SG_\s+(\w+)[^:]*:\s*(\d+)\s*\|\s*(\d+)\s*@")
#: Characters of the names that cantools may have replaced by longer ones (attributes of the database say which).
_SHORTENED = 32


class _Declared:
    """Where messages and signals of a DBC were declared."""

    def __init__(self, statements: Sequence[Statement]) -> None:
        self._messages: dict[int, list[tuple[str, Statement]]] = {}
        for statement in statements:
            found = MESSAGE.match(statement.text) if statement.word == "BO_" else None
            if found is not None:
                self._messages.setdefault(int(found[1]), []).append((found[2], statement))
        #: Of the message asked about last: the lines of its signals by place, with their names.
        self._signals: tuple[Statement | None, dict[tuple[int, int], list[tuple[str, int]]]] = (None, {})

    def __call__(self, message: Any, signal: Any) -> int:
        number = message.frame_id | (1 << 31 if message.is_extended_frame else 0)
        blocks = self._messages.get(number, [])
        named = [candidate for name, candidate in blocks if name == message.name] or [
            candidate for _, candidate in blocks
        ]
        if not named:
            return 0
        block = named[0]
        if signal is None:
            return block.line
        if self._signals[0] is not block:
            places: dict[tuple[int, int], list[tuple[str, int]]] = {}
            for statement in block.inner:
                found = _PLACED.match(statement.text)
                if found is not None:
                    places.setdefault((int(found[2]), int(found[3])), []).append((found[1], statement.line))
            self._signals = block, places
        at_its_place = self._signals[1].get((signal.start, signal.length), ())
        lines = (line for name, line in at_its_place if name == signal.name or len(name) >= _SHORTENED)
        return next(lines, block.line)


class _Search:
    """The first line of a text that has a message's name; signals are looked for behind it."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __call__(self, message: Any, signal: Any) -> int:
        at = max(0, self._text.find(message.name))
        if signal is not None:
            at = max(at, self._text.find(signal.name, at))
        return self._text.count("\n", 0, at) + 1 if at else 0
