"""Text of others made harmless where it goes: to a terminal, into a cell of a spreadsheet.

1. Nothing is dropped: what cannot go as it is, is spelt out.
2. Our own drawings and signs have look-alikes in ASCII, for terminals and files that have no others (`LOOKALIKES` as the
   `errors` of an encoding).
"""

from __future__ import annotations

import codecs
import re
import unicodedata

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


__all__ = [
    "FORMULA",
    "LOOKALIKES",
    "NUMBER",
    "cell_text",
    "printable",
    "printable_lines",
    "text_of_cell",
    "without_controls",
]
