"""Tables and indented paragraphs for a terminal of any width.

1. Nothing is cut off. Where the last column has no room beside the others, it goes below them, indented.
2. Cells and paragraphs are of others: nothing in them reaches the terminal as a control character.
3. `width` None is not a limit: one row, one line.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Sequence

from aces_bus.plain_text import printable, printable_lines

from ..console import Output, terminal_width, wants_colour
from .text import Paint, make_paint, no_paint

GAP = "  "
#: The last column goes beside the others when it has at least this much room.
LEAST = 28
INDENT = 4


def column_output(
    head: Sequence[str], rows: Sequence[Sequence[str]], width: int | None, paint: Paint
) -> list[str]:
    """Return rows below a head; columns that are empty throughout are left out."""
    rows = [[printable_lines(cell) for cell in row] for row in rows]
    used = [index for index in range(len(head)) if any(row[index] for row in rows)]
    if not used:
        return []
    *front, last = used
    sizes = [max(len(head[index]), *(len(row[index]) for row in rows)) for index in front]
    taken = sum(sizes) + len(GAP) * len(front)
    room = None if width is None else width - taken
    is_below = room is not None and room < min(LEAST, max(len(row[last]) for row in rows))
    lines: list[str] = []
    for row in [head, *rows]:
        cells = [row[index].ljust(size) for index, size in zip(front, sizes, strict=True)]
        text = "" if row is head and is_below else row[last]
        parts = [""] if is_below else _wrapped(text, room)
        line = GAP.join([*cells, parts[0]]).rstrip()
        if row is head:
            if line:
                lines.append(paint("place", line))
            continue
        name = row[front[0]] if front else ""
        lines.append(paint("message", name) + line[len(name) :] if name else line)
        lines += [" " * taken + part for part in parts[1:]]
        if is_below and text:
            lines += [
                " " * INDENT + part for part in _wrapped(text, None if width is None else width - INDENT)
            ]
    return lines


def beside(name: str, texts: Sequence[str], width: int | None, style: str, paint: Paint) -> list[str]:
    """Return a name, and beside it paragraphs."""
    name, texts = printable(name), [printable_lines(text) for text in texts]
    start = len(name) + len(GAP)
    parts = [part for text in texts for part in _wrapped(text, None if width is None else width - start)]
    lines = [paint(style, name) + GAP + (parts[0] if parts else "")]
    return [line.rstrip() for line in lines] + [" " * start + part for part in parts[1:]]


def _wrapped(text: str, width: int | None) -> list[str]:
    if width is None or len(text) <= width:
        return [text]
    return textwrap.wrap(text, max(width, 16), break_long_words=False, break_on_hyphens=False) or [""]


class Page:
    """Lines for people on stdout: coloured and wrapped on a terminal, neither elsewhere.

    `put` takes the lines instead, where they are kept first.
    """

    def __init__(self, colour: bool | None, put: Callable[[Iterable[str]], object] | None = None) -> None:
        self._put = put
        is_terminal = Output(None).is_terminal
        self.is_coloured = wants_colour(colour, is_terminal)
        self.width = terminal_width() if is_terminal else None
        self.paint: Paint = make_paint() if self.is_coloured else no_paint

    def lines(self, lines: Iterable[str]) -> None:
        if self._put is not None:
            self._put(lines)
            return
        for line in lines:
            print(line)

    def beside(self, name: str, texts: Sequence[str], style: str) -> None:
        self.lines(beside(name, texts, self.width, style, self.paint))

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        self.lines(column_output(head, rows, self.width, self.paint))
