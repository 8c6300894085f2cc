"""A small SVG writer: rectangles, lines and texts, in points, with the one style sheet of all our pictures.

1. Plain SVG 1.1, which browsers, LibreOffice and LaTeX converters read: no script, no font of its own.
2. Whatever text comes in is escaped; characters that XML does not have become `?`.
3. Texts are set in a monospace font, so that their widths are known here: `CHARACTER` × their number.
"""

from __future__ import annotations

from xml.sax.saxutils import escape, quoteattr

#: Size of the text, and the width of one character as a share of it (a little generous: fonts differ).
SIZE = 12.0
CHARACTER = 0.64
FONT = "DejaVu Sans Mono, Menlo, Consolas, monospace"

#: Colours by what they say.
INK = "#1f2933"
FAINT = "#7b8794"
LINE = "#9aa5b1"
PAPER = "#ffffff"
#: Fills that neighbours are told apart by.
FILLS = ("#dbeafe", "#dcfce7", "#fef3c7", "#fce7f3", "#ede9fe", "#cffafe", "#ffedd5", "#e2e8f0")
GOOD, BAD, OPEN = "#bbf7d0", "#fecaca", "#f1f5f9"
GOOD_INK, BAD_INK = "#166534", "#991b1b"


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
        fill: str = PAPER,
        *,
        line: str = LINE,
        weight: float = 1.0,
        round: float = 0,
    ) -> None:
        """A rectangle; `line` "none" for one without a border."""
        corner = f' rx="{round:g}"' if round else ""
        self._parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}"{corner}'
            f' fill="{fill}" stroke="{line}" stroke-width="{weight:g}"/>'
        )
        self._reach(x + width, y + height)

    def line(
        self, x: float, y: float, to_x: float, to_y: float, colour: str = LINE, *, weight: float = 1.0
    ) -> None:
        """A straight line."""
        self._parts.append(
            f'<path d="M{x:g} {y:g}L{to_x:g} {to_y:g}" stroke="{colour}" stroke-width="{weight:g}" fill="none"/>'
        )
        self._reach(max(x, to_x), max(y, to_y))

    def text(
        self,
        x: float,
        y: float,
        text: str,
        colour: str = INK,
        *,
        size: float = SIZE,
        anchor: str = "start",
        is_bold: bool = False,
        tip: str = "",
    ) -> None:
        """A text whose base line begins, has its middle or ends (`anchor` "start", "middle", "end") at (x, y)."""
        bold = ' font-weight="bold"' if is_bold else ""
        title = f"<title>{_clean(tip)}</title>" if tip else ""
        self._parts.append(
            f'<text x="{x:g}" y="{y:g}" fill="{colour}" font-size="{size:g}" text-anchor="{anchor}"{bold}'
            f' xml:space="preserve">{title}{_clean(text)}</text>'
        )
        reach = text_width(text, size)
        self._reach(
            x + (reach if anchor == "start" else reach / 2 if anchor == "middle" else 0), y + size / 3
        )

    def svg(self, title: str, *, margin: float = 12) -> str:
        """The picture as a file."""
        width, height = self.width + 2 * margin, self.height + 2 * margin
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}"'
            f' viewBox="{-margin:g} {-margin:g} {width:g} {height:g}" font-family={quoteattr(FONT)}>\n'
            f"<title>{_clean(title)}</title>\n"
            f'<rect x="{-margin:g}" y="{-margin:g}" width="{width:g}" height="{height:g}" fill="{PAPER}"/>\n'
            + "\n".join(self._parts)
            + "\n</svg>\n"
        )


def text_width(text: str, size: float = SIZE) -> float:
    """How wide a text is, in points."""
    return CHARACTER * size * len(text)


def fitted(text: str, width: float, size: float = SIZE) -> str:
    """A text that is no wider than `width` points: its end is cut off, and marked by `…`."""
    room = int(width / (CHARACTER * size))
    return text if len(text) <= room else text[: max(0, room - 1)] + "…" if room > 0 else ""


def _clean(text: str) -> str:
    return escape("".join(ch if ch.isprintable() else "?" for ch in text))


__all__ = ["Canvas", "fitted", "text_width"]
