"""A DBC file as a list of statements: where each begins, and which of them must not be loaded.

1. Every line belongs to one statement; a `BO_` has its `SG_` lines inside.
2. Nothing here depends on cantools: it is what makes its refusal of a whole file a refusal of one statement.
3. Statements that would cost memory or time beyond measure (a message of a billion bytes, multiplexers of millions of
   combinations) are taken out before they are read.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

import msgspec

from .problems import ImportProblem, ProblemText

#: Words that begin a statement, at a line's start.
# fmt: off
KEYWORDS = (
    "BA_DEF_DEF_REL_", "BA_DEF_DEF_", "BA_DEF_REL_", "BA_DEF_SGTYPE_", "BA_DEF_", "BA_REL_",
    "BA_SGTYPE_", "BA_", "BO_TX_BU_", "BO_", "BS_", "BU_", "CAT_DEF_", "CAT_", "CM_", "ENVVAR_DATA_",
    "EV_DATA_", "EV_", "FILTER", "NS_DESC_", "NS_", "SGTYPE_VAL_", "SGTYPE_", "SG_MUL_VAL_", "SG_",
    "SIG_GROUP_", "SIG_TYPE_REF_", "SIG_VALTYPE_", "SIGTYPE_VALTYPE_", "VAL_TABLE_", "VAL_", "VERSION",
)
# fmt: on
_START = re.compile(rf"[ \t]*({'|'.join(KEYWORDS)})(?![A-Za-z0-9_])")
_QUOTES = re.compile(r'\\"|"')
MESSAGE = re.compile(r"\s*BO_\s+(\d+)\s+(\w+)\s*:\s*(\d+)")
_SIGNAL = re.compile(r"\s*SG_\s+(\w+)\s*(?:(\w+)\s*)?:\s*(\d+)\s*\|\s*(\d+)\s*@\s*(\d+)")
_REFERENCE = re.compile(r"\s*(?:VAL_|SIG_VALTYPE_)\s+(\d+)\s+(\w+)")
#: What a statement is of, by its identifier.
_REFERRED = re.compile(
    r"""(\s*(?:BO_|BO_TX_BU_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|SIG_GROUP_|SIG_TYPE_REF_
    |CM_\s+(?:BO_|SG_)|BA_\s+"[^"]*"\s+(?:BO_|SG_)
    |BA_REL_\s+"[^"]*"\s+(?:BU_BO_REL_\s+\w+|BU_SG_REL_\s+\w+\s+SG_))\s+)(\d{1,11})\b""",
    re.VERBOSE,
)
_MUX = re.compile(r"\s*SG_MUL_VAL_\s+(\d+)\s+(\w+)\s+(\w+)\s+(.*?);", re.DOTALL)
_DEFINITION = re.compile(r'\s*BA_DEF_(?:REL_)?\s+(?:\w+\s+)?"([^"]*)"')
_ATTRIBUTE = re.compile(r'\s*(?:BA_|BA_REL_|BA_DEF_DEF_|BA_DEF_DEF_REL_)\s+"([^"]*)"')
_STRING = re.compile(r'"(?:\\"|[^"])*"')
_FRACTION = re.compile(r"\d\.|\d[eE]")
_MARKER = re.compile(r"M|m\d{1,9}M?")
_RANGE = re.compile(r"(\d+)\s*-\s*(\d+)")

#: Bytes of a message: CAN FD has 64, a J1939 transport session 1,785 (SAE J1939-21).
MOST_BYTES = 1785
#: Combinations of multiplexer values of one message.
MOST_COMBINATIONS = 8192


class Statement(msgspec.Struct):
    """One statement: the line it begins on (from 1), its word, its text with line ends. `inner` are the signals."""

    line: int
    word: str
    text: str
    inner: list[Statement] = msgspec.field(default_factory=list)

    @property
    def whole(self) -> str:
        return self.text + "".join(statement.whole for statement in self.inner)

    def problem(self, reason: str, fault: tuple[int, int] | None = None) -> ImportProblem:
        """Return what is wrong with it; `fault` is the line (from 1) and the column of its text where."""
        lines = self.text.split("\n")
        line, column = fault if fault is not None else (1, 0)
        if not (
            1 <= line <= len(lines) and 1 <= column <= len(lines[line - 1]) + 1 and lines[line - 1].strip()
        ):
            line, column = 1, len(lines[0]) - len(lines[0].lstrip()) + 1
        return ImportProblem(self.line + line - 1, reason, ProblemText.excerpt(self.text), column=column)


def split_statements(text: str) -> list[Statement]:
    """Return the statements of a file, in order."""
    return grouped(_flat(text.splitlines(keepends=True), 1))


def grouped(statements: Iterable[Statement]) -> list[Statement]:
    """Return the statements with each `SG_` inside the `BO_` that it follows, a line of something unknown between them
    or not.
    """
    found: list[Statement] = []
    host: Statement | None = None
    for statement in statements:
        if statement.word == "SG_" and host is not None:
            host.inner.append(statement)
            continue
        found.append(statement)
        if statement.word not in ("?", "") or "\n" in statement.text.strip():
            host = statement if statement.word == "BO_" else None
    return found


def _flat(lines: list[str], first: int) -> Iterator[Statement]:
    begun: Statement | None = None
    in_string = in_list = False
    parts: list[str] = []
    for number, line in enumerate(lines, first):
        start = None if in_string else _START.match(line)
        # What follows NS_ is a list of words that begin statements elsewhere; it is indented.
        if start is not None and in_list and line[:1] in " \t":
            start = None
        # A signal or a message's head is one line: a word in the first column behind it begins something unknown.
        is_unknown = start is None and not in_string and begun is not None and begun.word in ("BO_", "SG_")
        is_unknown = is_unknown and line[:1].isalpha()
        if start is not None or is_unknown or begun is None:
            if begun is not None:
                begun.text = "".join(parts)
                yield begun
            word = start[1] if start is not None else "?" * is_unknown
            begun, parts = Statement(number, word, ""), []
            in_list = word == "NS_"
        parts.append(line)
        if '"' in line and sum(mark == '"' for mark in _QUOTES.findall(line)) % 2:
            in_string = not in_string
    if begun is not None:
        begun.text = "".join(parts)
        yield begun


def resplit(statement: Statement) -> list[Statement]:
    """Return a statement that cannot be read, taken apart at the words that begin one inside it: a string was not closed."""
    lines = statement.text.splitlines(keepends=True)
    for index in range(1, len(lines)):
        if _START.match(lines[index]):
            first = Statement(statement.line, statement.word, "".join(lines[:index]))
            return [first, *_flat(lines[index:], statement.line + index)]
    return [statement]


def join_statements(statements: Iterable[Statement]) -> str:
    return "".join(statement.whole for statement in statements)


def safe_statements(statements: list[Statement]) -> tuple[list[Statement], list[ImportProblem]]:
    """Return the statements without those that must not be loaded, and why not each of them."""
    problems = _widened(statements)
    kept: list[Statement] = []
    signals: dict[str, set[str]] = {}
    for statement in statements:
        if statement.word == "BO_":
            reason = _unsafe_message(statement)
            if reason:
                problems.append(statement.problem(f"{reason}: the message is left out"))
                continue
            for signal in list(statement.inner):
                reason = _unsafe_signal(signal)
                if reason:
                    statement.inner.remove(signal)
                    problems.append(signal.problem(f"{reason}: left out"))
            if head := MESSAGE.match(statement.text):
                known = signals.setdefault(str(int(head[1])), set())
                known.update(m[1] for inner in statement.inner if (m := _SIGNAL.match(inner.text)))
        kept.append(statement)
    crowded = _crowded(kept)
    left: list[Statement] = []
    for statement in kept:
        head = MESSAGE.match(statement.text) if statement.word == "BO_" else None
        reference = _REFERENCE.match(statement.text) if statement.word in ("VAL_", "SIG_VALTYPE_") else None
        if head is not None and str(int(head[1])) in crowded:
            problems.append(
                statement.problem(
                    f"its multiplexers have {crowded[str(int(head[1]))]:,} combinations"
                    f" (at most {MOST_COMBINATIONS:,}): the message is left out"
                )
            )
        elif reference is not None and reference[2] not in signals.get(str(int(reference[1])), ()):
            problems.append(statement.problem("of a signal that is not there: left out"))
        elif (m := _MUX.match(statement.text)) is not None and str(int(m[1])) in crowded:
            pass  # goes with its message
        elif reference is not None and str(int(reference[1])) in crowded:
            pass
        else:
            left.append(statement)
    return left, problems


def _widened(statements: list[Statement]) -> list[ImportProblem]:
    """Set bit 31, which marks an identifier of 29 bits, where it is missing from one of more than 11 bits, there and
    wherever the message is referred to; the notes that say so."""
    heads = [
        (int(m[1]), m[2], statement)
        for statement in statements
        if statement.word == "BO_" and (m := MESSAGE.match(statement.text))
    ]
    numbers = {number for number, _, _ in heads}
    wide = {number for number in numbers if 0x7FF < number < 1 << 29 and number | 1 << 31 not in numbers}
    if not wide:
        return []

    def marked(found: re.Match[str]) -> str:
        number = int(found[2])
        return f"{found[1]}{number | 1 << 31}" if number in wide else found[0]

    for statement in statements:
        statement.text = _REFERRED.sub(marked, statement.text, count=1)
    return [
        ImportProblem(
            head.line,
            f"message {ProblemText.clean(name)}: identifier {number:X}h has more than 11 bits: taken for one of 29 bits,"
            " though bit 31 does not say so",
            is_note=True,
        )
        for number, name, head in heads
        if number in wide
    ]


def usable(statements: list[Statement]) -> tuple[list[Statement], list[ImportProblem]]:
    """Return the statements without those that cantools parses and then refuses the file for, as far as a
    glance shows.
    """
    problems: list[ImportProblem] = []
    kept: list[Statement] = []
    defined = {m[1] for statement in statements if (m := _DEFINITION.match(statement.text))}
    for statement in statements:
        reason = ""
        attribute = _ATTRIBUTE.match(statement.text)
        if attribute is not None and attribute[1] not in defined:
            reason = f"the attribute {attribute[1]} is not defined"
        elif statement.word in ("VAL_", "VAL_TABLE_") and _FRACTION.search(_STRING.sub('""', statement.text)):
            reason = "a value table of numbers that are not whole"
        for signal in list(statement.inner):
            place = _SIGNAL.match(signal.text)
            if place is None or not _MARKER.fullmatch(place[2] or "M"):
                statement.inner.remove(signal)
                problems.append(
                    signal.problem("its place or its multiplexer is not a whole number: left out")
                )
        if reason:
            problems.append(statement.problem(f"{reason}: left out"))
        else:
            kept.append(statement)
    return kept, problems


def _unsafe_message(statement: Statement) -> str:
    head = MESSAGE.match(statement.text)
    if head is None:
        return ""
    if len(head[3]) > 5 or int(head[3]) > MOST_BYTES:
        return f"a message of {head[3][:20]} bytes"
    number = int(head[1]) if len(head[1]) < 12 else 1 << 32
    if number >= 1 << 32 or number & 0x7FFF_FFFF >= 1 << 29:
        return "an identifier that no frame has (of 29 bits, with bit 31 set)"
    if 0x7FF < number < 1 << 31:  # not widened
        return "an identifier of more than 11 bits without bit 31, that another message has with it"
    return ""


def _unsafe_signal(statement: Statement) -> str:
    place = _SIGNAL.match(statement.text)
    if place is None:
        return ""
    if len(place[3]) > 6 or len(place[4]) > 6 or int(place[3]) + int(place[4]) > 16 * MOST_BYTES:
        return f"a signal of {place[4][:20]} bits at bit {place[3][:20]}"
    return "a signal of 0 bits" if int(place[4]) == 0 else ""


def _crowded(statements: list[Statement]) -> dict[str, int]:
    """Return messages whose multiplexers have too many combinations of values, with their number."""
    children: dict[str, dict[str, dict[str, int]]] = {}
    for statement in statements:
        found = _MUX.match(statement.text) if statement.word == "SG_MUL_VAL_" else None
        if found is None:
            continue
        count = sum(
            max(0, int(high) - int(low) + 1) if len(high) < 12 else 1 << 40
            for low, high in _RANGE.findall(found[4])
        )
        children.setdefault(str(int(found[1])), {}).setdefault(found[3], {})[found[2]] = count
    crowded: dict[str, int] = {}
    for number, by_parent in children.items():
        tops = set(by_parent) - {name for some in by_parent.values() for name in some}
        total = sum(_combinations(name, by_parent, 0) for name in tops)
        if total > MOST_COMBINATIONS:
            crowded[number] = total
    return crowded


def _combinations(name: str, by_parent: dict[str, dict[str, int]], depth: int) -> int:
    if depth > 16:
        return 1 << 40
    return sum(
        count * (1 + _combinations(child, by_parent, depth + 1))
        for child, count in by_parent.get(name, {}).items()
    )
