"""Text of others made harmless where it goes: to a terminal, into a cell of a spreadsheet, into a page.

1. Nothing is dropped: what cannot go as it is, is spelt out.
2. A page of HTML gets texts as texts: tables that notebooks show are escaped here, and bounded.
3. Our own drawings and signs have look-alikes in ASCII, for terminals and files that have no others (`LOOKALIKES` as the
   `errors` of an encoding).
"""

from __future__ import annotations

import codecs
import re
import unicodedata
from collections.abc import Iterable, Sequence

#: What a spreadsheet takes for the beginning of a formula; a number with its sign is none.
FORMULA = r"^[=+\-@\t\r]"
NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
_FORMULA, _NUMBER = re.compile(FORMULA), re.compile(NUMBER, re.ASCII)


def printable(text: str) -> str:
    """Return a text that is safe to print: control characters, escape sequences with them, are spelt out (`\x1b`)."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _spelt_out(c) for c in text)


def printable_lines(text: str) -> str:
    """Return the same for a text of several lines, which stay lines."""
    return "\n".join(map(printable, text.split("\n")))


def without_controls(text: str) -> str:
    """Return a text to be compared, without control characters; spaces of every kind stay."""
    if text.isprintable():
        return text
    return "".join(_spelt_out(c) if unicodedata.category(c)[0] == "C" else c for c in text)


def _spelt_out(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode()


#: Signs that we print, and what is written where an encoding has none; as wide as they are in drawings.
_ASCII = {
    **dict.fromkeys("─━⎯", "-"),
    **dict.fromkeys("│┃", "|"),
    **dict.fromkeys("┌┐└┘├┤┬┴┼", "+"),
    "…": "~",
    "→": ">",
    "←": "<",
    "·": ".",
    "×": "x",
    "−": "-",
    "–": "-",
    "µ": "u",
    "°": "deg",
    "±": "+-",
    "²": "2",
    "³": "3",
    "≥": ">=",
    "≤": "<=",
    "≈": "~",
    "✓": "+",
    "✗": "x",
    **dict.fromkeys("█▇▆▅▓", "#"),
    **dict.fromkeys("▄▃▂▁▒░", "."),
}
#: The name of the error handler of encodings that writes look-alikes, and `?` for what has none.
LOOKALIKES = "aces_bus.lookalikes"


def _lookalikes(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(_ASCII.get(c, "?") for c in error.object[error.start : error.end]), error.end


codecs.register_error(LOOKALIKES, _lookalikes)


def cell_text(text: str) -> str:
    """Return a text as a cell of a spreadsheet: with an apostrophe in front where it would be taken for a formula."""
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.match(text) else text


def text_of_cell(cell: str) -> str:
    """Return the text that `cell_text` made a cell of."""
    return cell[1:] if cell.startswith("'") and cell_text(cell[1:]) == cell else cell


#: What a page shows of a table: rows, and characters of a cell.
MOST_ROWS, LONGEST_CELL = 30, 120


def html_table(
    title: str, head: Sequence[str], rows: Iterable[Sequence[str]], total: int | None = None
) -> str:
    """Return a table as HTML, for notebooks: every text escaped and cut, at most `MOST_ROWS` rows.

    `total` is the number of rows where `rows` are only the first of them.

    >>> html_table("lamp", ["field"], [["<b>"]])
    '<table><caption>lamp</caption><tr><th>field</th></tr><tr><td>&lt;b&gt;</td></tr></table>'
    """
    import html

    rows = list(rows)
    total = len(rows) if total is None else total
    shown = rows[:MOST_ROWS]

    def cell(text: str, kind: str) -> str:
        text = text if len(text) <= LONGEST_CELL else text[: LONGEST_CELL - 1] + "…"
        return f"<{kind}>{html.escape(printable(text))}</{kind}>"

    lines = ["".join(cell(text, "th") for text in head)]
    lines += ["".join(cell(text, "td") for text in row) for row in shown]
    if total > len(shown):
        lines.append(cell(f"… {total - len(shown):,} more", "td"))
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table>{cell(title, 'caption')}{body}</table>"


__all__ = [
    "FORMULA",
    "LOOKALIKES",
    "MOST_ROWS",
    "NUMBER",
    "cell_text",
    "html_table",
    "printable",
    "printable_lines",
    "text_of_cell",
    "without_controls",
]
