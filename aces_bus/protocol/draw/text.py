"""Pictures of messages as lines of text: what a data sheet would print.

    byte     7        6        5        4        3        2        1        0
         ┌───────────────────────────────────────────────────────────────────────┐
       0 │ period                                                                │
       1 │ limit.0                                                               │
         ├───────────────────────────────────┬───────────────────────────────────┤
       2 │ z_phase.1 11…8                    │ z_phase.0 11…8                    │
         └───────────────────────────────────┴───────────────────────────────────┘

1. Rows are bytes from the first one on, bit 7 on the left. `11…8` are the bits of the field's own number: byte order and
   split fields show as they are.
2. A picture is 79 columns wide.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ..declare.message import Message
from ..plan import nodes as p
from .cells import BIT, ROW, Mark, Row, marks_of, panels


def draw_text(plan: p.MessagePlan, marks: Iterable[Mark] = ()) -> list[str]:
    """Return the layout of a message as lines of text, its panels below each other."""
    lines: list[str] = []
    for panel in panels(plan, marks):
        lines += ["", panel.title] if panel.title else []
        lines += _picture(panel.rows)
    return lines


def picture(message: Message) -> list[str]:
    """Return the layout of a message, with its checks and matched numbers."""
    return draw_text(message.plan, marks_of(message))


def _picture(rows: Sequence[Row]) -> list[str]:
    if not rows:
        return ["(no bytes)"]
    if any(len(cells) > 1 or place.isdecimal() for place, cells in rows):
        bits = "".join(f"{bit:^{BIT + 1}}" for bit in range(7, -1, -1)).rstrip()
        lines = [f" byte  {bits}"]
    else:
        lines = []
    above: set[int] = set()
    for place, parts in rows:
        edges = _edges(parts)
        if not above or edges or above != {0}:
            lines.append(_rule(above, edges, is_first=not above))
        text = "│".join(_fitted(text, width) for width, text in parts)
        if len(place) > 5:  # the next row says where it ends
            place = place.partition("…")[0] + "…"
        lines.append(f"{place:>5} │{text}│")
        above = edges | {0}
    lines.append(_rule(above, set(), is_last=True))
    return [line.rstrip() for line in lines]


def _fitted(text: str, width: int) -> str:
    """Fit a text into a cell, with a blank on each side where there is room; a long name loses its end, never
    its bits.
    """
    if len(text) + 2 <= width:
        return f" {text}".ljust(width)
    if len(text) <= width:
        return text.ljust(width)
    inner = text.rpartition(".")[2]
    if not inner[0].isdigit() and len(inner) < len(text):
        return _fitted(inner, width)  # of a nested record the name alone
    name, blank, bits = text.rpartition(" ")
    if not blank or not bits[0].isdigit():
        return text[: width - 1] + "…"
    room = width - len(bits) - 1
    return f"{name[: room - 1]}… {bits}" if room > 1 else bits[:width].ljust(width)


def _edges(parts: Sequence[tuple[int, str]]) -> set[int]:
    found: set[int] = set()
    at = 0
    for width, _ in parts[:-1]:
        at += width + 1
        found.add(at)
    return found


def _rule(above: set[int], below: set[int], *, is_first: bool = False, is_last: bool = False) -> str:
    left, right = ("┌", "┐") if is_first else ("└", "┘") if is_last else ("├", "┤")
    middle = [
        ("┼" if at in below else "┴") if at in above else "┬" if at in below else "─"
        for at in range(1, ROW + 1)
    ]
    return f"      {left}{''.join(middle)}{right}"
