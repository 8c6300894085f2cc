"""Messages as pictures in SVG, and the small writer that draws them: rectangles, lines and texts, in points, with the one
style sheet of all our pictures.

1. Plain SVG 1.1, which browsers, LibreOffice and LaTeX converters read: no script, no font of its own.
2. Whatever text comes in is escaped; characters that XML does not have become `?`.
3. Texts are set in a monospace font, so that their widths are known here: `CHARACTER` × their number.
"""

from __future__ import annotations

from collections.abc import Iterable
from xml.sax.saxutils import escape, quoteattr

from ..declare.message import Message
from .cells import BIT, ROW, LayoutPanel, marks_of, panels

#: Size of the text, and the width of one character as a share of it (a little generous: fonts differ).
SIZE = 12.0
CHARACTER = 0.64
FONT = "DejaVu Sans Mono, Menlo, Consolas, monospace"


class Colour:
    """Colours by what they say."""

    INK = "#1f2933"
    FAINT = "#7b8794"
    LINE = "#9aa5b1"
    PAPER = "#ffffff"
    GOOD, BAD, OPEN = "#bbf7d0", "#fecaca", "#f1f5f9"
    GOOD_INK, BAD_INK = "#166534", "#991b1b"


#: Fills of neighbouring cells.
FILLS = ("#dbeafe", "#dcfce7", "#fef3c7", "#fce7f3", "#ede9fe", "#cffafe", "#ffedd5", "#e2e8f0")


class Canvas:
    """Shapes, and the SVG of them. Coordinates are in points from the top left corner."""

    def __init__(self) -> None:
        self._parts: list[str] = []
        self.width = 0.0
        self.height = 0.0

    def _reach(self, x: float, y: float) -> None:
        self.width, self.height = max(self.width, x), max(self.height, y)

    def box(
        self,
        x: float,
        y: float,
        width: float,
        height: float,
        fill: str = Colour.PAPER,
        *,
        line: str = Colour.LINE,
        weight: float = 1.0,
        round: float = 0,
    ) -> None:
        """Draw a rectangle; `line` "none" leaves the border out."""
        corner = f' rx="{round:g}"' if round else ""
        self._parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}"{corner}'
            f' fill="{fill}" stroke="{line}" stroke-width="{weight:g}"/>'
        )
        self._reach(x + width, y + height)

    def line(
        self, x: float, y: float, to_x: float, to_y: float, colour: str = Colour.LINE, *, weight: float = 1.0
    ) -> None:
        """Draw a straight line."""
        self._parts.append(
            f'<path d="M{x:g} {y:g}L{to_x:g} {to_y:g}" stroke="{colour}" stroke-width="{weight:g}" fill="none"/>'
        )
        self._reach(max(x, to_x), max(y, to_y))

    def text(
        self,
        x: float,
        y: float,
        text: str,
        colour: str = Colour.INK,
        *,
        size: float = SIZE,
        anchor: str = "start",
        is_bold: bool = False,
        tip: str = "",
    ) -> None:
        """Write a text whose base line begins, has its middle or ends (`anchor` "start", "middle", "end") at (x, y)."""
        bold = ' font-weight="bold"' if is_bold else ""
        title = f"<title>{_clean(tip)}</title>" if tip else ""
        self._parts.append(
            f'<text x="{x:g}" y="{y:g}" fill="{colour}" font-size="{size:g}" text-anchor="{anchor}"{bold}'
            f' xml:space="preserve">{title}{_clean(text)}</text>'
        )
        reach = Canvas.text_width(text, size)
        self._reach(
            x + (reach if anchor == "start" else reach / 2 if anchor == "middle" else 0), y + size / 3
        )

    def svg(self, title: str, *, margin: float = 12) -> str:
        """Return the picture as a file."""
        width, height = self.width + 2 * margin, self.height + 2 * margin
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}"'
            f' viewBox="{-margin:g} {-margin:g} {width:g} {height:g}" font-family={quoteattr(FONT)}>\n'
            f"<title>{_clean(title)}</title>\n"
            f'<rect x="{-margin:g}" y="{-margin:g}" width="{width:g}" height="{height:g}" fill="{Colour.PAPER}"/>\n'
            + "\n".join(self._parts)
            + "\n</svg>\n"
        )

    @staticmethod
    def text_width(text: str, size: float = SIZE) -> float:
        """Return how wide a text is, in points."""
        return CHARACTER * size * len(text)

    @staticmethod
    def fitted(text: str, width: float, size: float = SIZE) -> str:
        """Return a text that is not wider than `width` points: its end is cut off, and marked by `…`."""
        room = int(width / (CHARACTER * size))
        return text if len(text) <= room else text[: max(0, room - 1)] + "…" if room > 0 else ""


def _clean(text: str) -> str:
    return escape("".join(ch if ch.isprintable() else "?" for ch in text))


#: Points of one bit, of a row's height, and of the text in front of a row.
WIDE, HIGH, FRONT = 72.0, 26.0, 64.0


def picture_svg(messages: Iterable[Message]) -> str:
    """Return the layouts of some messages below each other, as an SVG file."""
    canvas = Canvas()
    top = 0.0
    names: list[str] = []
    for message in messages:
        names.append(f"{message.protocol.name}.{message.name}")
        canvas.text(0, top + 14, names[-1], is_bold=True, size=15)
        doc = message.doc.strip().partition("\n")[0]
        if doc:
            canvas.text(0, top + 32, Canvas.fitted(doc, FRONT + 8 * WIDE, 11), Colour.FAINT, size=11)
        top += 44 if doc else 26
        fills: dict[str, str] = {}
        for panel in panels(message.plan, marks_of(message)):
            top = _panel(canvas, panel, top, fills) + 12
        top += 16
    return canvas.svg(", ".join(names))


def _panel(canvas: Canvas, panel: LayoutPanel, top: float, fills: dict[str, str]) -> float:
    if panel.title:
        canvas.text(0, top + 12, panel.title, Colour.FAINT)
        top += 20
    if not panel.rows:
        canvas.text(FRONT, top + 12, "no bytes", Colour.FAINT)
        return top + 18
    if any(len(parts) > 1 or place.isdecimal() for place, parts in panel.rows):
        canvas.text(FRONT - 8, top + 11, "byte", Colour.FAINT, size=10, anchor="end")
        for bit in range(8):
            canvas.text(
                FRONT + (bit + 0.5) * WIDE, top + 11, str(7 - bit), Colour.FAINT, size=10, anchor="middle"
            )
        top += 16
    for place, parts in panel.rows:
        canvas.text(FRONT - 8, top + HIGH / 2 + 4, place, Colour.FAINT, anchor="end")
        left = FRONT
        for columns, text in parts:
            width = (columns + 1) / (BIT + 1) * WIDE if columns != ROW else 8 * WIDE
            canvas.box(left, top, width, HIGH, _fill(text, fills))
            if text:
                size = 12.0 if Canvas.text_width(text, 12) < width - 8 else 10.0
                shown = Canvas.fitted(_short(text, width - 6, size), width - 6, size)
                canvas.text(
                    left + width / 2,
                    top + HIGH / 2 + 4,
                    shown,
                    Colour.INK,
                    size=size,
                    anchor="middle",
                    tip=text,
                )
            left += width
        top += HIGH
    return top


def _short(text: str, width: float, size: float) -> str:
    """Return the name alone of a nested record, where there is no room for its path."""
    inner = text.rpartition(".")[2]
    return text if Canvas.text_width(text, size) <= width or not inner or inner[0].isdigit() else inner


def _fill(text: str, fills: dict[str, str]) -> str:
    """Return a field's colour: the same for all its bits and for the pieces of a list."""
    if not text:
        return Colour.PAPER
    if text.startswith(("0x", "sync ", "=", "check: ", "end ", "constant ", "(by ")):
        return Colour.OPEN
    name = text.partition(" ")[0].split(".")[0]
    return fills.setdefault(name, FILLS[len(fills) % len(FILLS)])
