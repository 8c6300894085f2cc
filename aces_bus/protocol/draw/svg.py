"""Pictures of messages as SVG: the same panels as `text`, with a colour a field."""

from __future__ import annotations

from collections.abc import Iterable

from ..declare.message import Message
from .canvas import FAINT, FILLS, INK, OPEN, PAPER, Canvas, fitted, text_width
from .cells import BIT, ROW, LayoutPanel, marks_of, panels

#: Points of one bit, of a row's height, and of what stands in front of a row.
WIDE, HIGH, FRONT = 72.0, 26.0, 64.0


def picture_svg(messages: Iterable[Message]) -> str:
    """The layouts of some messages below each other, as an SVG file."""
    canvas = Canvas()
    top = 0.0
    names: list[str] = []
    for message in messages:
        names.append(f"{message.protocol.name}.{message.name}")
        canvas.text(0, top + 14, names[-1], is_bold=True, size=15)
        doc = message.doc.strip().partition("\n")[0]
        if doc:
            canvas.text(0, top + 32, fitted(doc, FRONT + 8 * WIDE, 11), FAINT, size=11)
        top += 44 if doc else 26
        fills: dict[str, str] = {}
        for panel in panels(message.plan, marks_of(message)):
            top = _panel(canvas, panel, top, fills) + 12
        top += 16
    return canvas.svg(", ".join(names))


def _panel(canvas: Canvas, panel: LayoutPanel, top: float, fills: dict[str, str]) -> float:
    if panel.title:
        canvas.text(0, top + 12, panel.title, FAINT)
        top += 20
    if not panel.rows:
        canvas.text(FRONT, top + 12, "no bytes", FAINT)
        return top + 18
    if any(len(parts) > 1 or place.isdecimal() for place, parts in panel.rows):
        canvas.text(FRONT - 8, top + 11, "byte", FAINT, size=10, anchor="end")
        for bit in range(8):
            canvas.text(FRONT + (bit + 0.5) * WIDE, top + 11, str(7 - bit), FAINT, size=10, anchor="middle")
        top += 16
    for place, parts in panel.rows:
        canvas.text(FRONT - 8, top + HIGH / 2 + 4, place, FAINT, anchor="end")
        left = FRONT
        for columns, text in parts:
            width = (columns + 1) / (BIT + 1) * WIDE if columns != ROW else 8 * WIDE
            canvas.box(left, top, width, HIGH, _fill(text, fills))
            if text:
                size = 12.0 if text_width(text, 12) < width - 8 else 10.0
                shown = fitted(_short(text, width - 6, size), width - 6, size)
                canvas.text(
                    left + width / 2, top + HIGH / 2 + 4, shown, INK, size=size, anchor="middle", tip=text
                )
            left += width
        top += HIGH
    return top


def _short(text: str, width: float, size: float) -> str:
    """Of a nested record the name alone, where there is no room for its path."""
    inner = text.rpartition(".")[2]
    return text if text_width(text, size) <= width or not inner or inner[0].isdigit() else inner


def _fill(text: str, fills: dict[str, str]) -> str:
    """A field's colour: the same for all its bits and for the pieces of a list."""
    if not text:
        return PAPER
    if text.startswith(("0x", "sync ", "=", "check: ", "end ", "constant ", "(by ")):
        return OPEN
    name = text.partition(" ")[0].split(".")[0]
    return fills.setdefault(name, FILLS[len(fills) % len(FILLS)])


__all__ = ["picture_svg"]
