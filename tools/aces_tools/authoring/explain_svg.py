"""An explanation as a picture: parts across, templates down, green where they agree, red where one dies.

1. At most `TEMPLATES` rows and `COLUMNS` parts an attempt; the templates that lived longest are shown, the others counted.
2. A cell says what the template expects there; the brackets above say what was read.
"""

from __future__ import annotations

from collections.abc import Sequence

from aces_bus.protocol.draw.svg import Canvas, Colour
from aces_bus.protocol.explain.attempt import Attempt, Step, TemplateTrace
from aces_bus.protocol.lint.examples import show_value
from aces_bus.protocol.record import plain_value

TEMPLATES = 12
COLUMNS = 20
#: Of those that the first part rules out, so many are enough.
FIRST = 4
HIGH = 22.0
NAME = 170.0
SMALL = 10.0


def svg_of(attempts: Sequence[Attempt], title: str) -> str:
    """Return the picture of some attempts, below each other."""
    canvas = Canvas()
    canvas.text(0, 14, title, is_bold=True, size=15)
    top = 34.0
    for attempt in attempts:
        top = _attempt(canvas, attempt, top) + 26
    return canvas.svg(title)


def _attempt(canvas: Canvas, attempt: Attempt, top: float) -> float:
    canvas.text(0, top + 12, attempt.label, is_bold=True)
    verdict, colour = _verdict(attempt)
    top += 20
    if attempt.run > 1 or not attempt.steps:
        canvas.text(0, top + 12, f"{attempt.raw[:24].hex(' ').upper()}  {verdict}", colour)
        return top + 18
    steps = attempt.steps[:COLUMNS]
    widths = [_width(index, step, attempt.rows) for index, step in enumerate(steps)]
    lefts = [NAME + sum(widths[:index]) for index in range(len(widths))]
    top = _read(canvas, steps, lefts, top)
    for step, left, width in zip(steps, lefts, widths, strict=True):
        canvas.text(left + width / 2, top + 9, step.place, Colour.FAINT, size=SMALL, anchor="middle")
        canvas.box(left, top + 13, width, HIGH, Colour.PAPER, line=Colour.INK, weight=1.4)
        canvas.text(left + width / 2, top + 28, step.part, Colour.INK, anchor="middle", is_bold=True)
    canvas.text(0, top + 28, "parts", Colour.FAINT)
    top += 13 + HIGH + 6
    rows = _chosen(attempt.rows)
    for row in rows:
        _row(canvas, row, lefts, widths, top, len(attempt.steps))
        top += HIGH + 3
    others = len(attempt.rows) - len(rows)
    if others:
        canvas.text(0, top + 13, f"and {others} more, which died sooner or as soon", Colour.FAINT, size=SMALL)
        top += 18
    left_out = len(attempt.steps) - len(steps) + attempt.left_out
    if left_out:
        canvas.text(NAME, top + 13, f"{left_out} more bytes are not drawn", Colour.FAINT, size=SMALL)
        top += 18
    canvas.text(0, top + 15, "→ " + verdict, colour, is_bold=True)
    return top + 18


def _width(index: int, step: Step, rows: Sequence[TemplateTrace]) -> float:
    texts = [step.part, *(_text(row, index) for row in _chosen(rows) if index < len(row.cells))]
    return min(130.0, max(38.0, max(Canvas.text_width(text, SMALL) for text in texts) + 10))


def _read(canvas: Canvas, steps: Sequence[Step], lefts: Sequence[float], top: float) -> float:
    """Return what was read, each over the part that completes it; on as many lines as keep them apart."""
    ends: list[float] = []
    marks: list[tuple[int, float]] = []
    for index, step in enumerate(steps):
        for reading in step.read:
            unit = f" {reading.unit}" if reading.unit and isinstance(reading.value, (int, float)) else ""
            text = f"{reading.name} = {show_value(plain_value(reading.value))}{unit}"
            if len(text) > 48:
                text = text[:47] + "…"
            x = lefts[index] + 4
            line = next((number for number, end in enumerate(ends) if end < x), len(ends))
            if line == len(ends):
                ends.append(0.0)
            ends[line] = x + Canvas.text_width(text, SMALL) + 10
            marks.append((line, lefts[index] + 1))
            canvas.text(x, top + 10 + 14 * line, text, Colour.GOOD_INK, size=SMALL)
    height = 14.0 * len(ends)
    for line, x in marks:
        canvas.line(x, top + 2 + 14 * line, x, top + height + 3, Colour.GOOD_INK, weight=0.7)
    return top + height + (4 if ends else 0)


def _row(
    canvas: Canvas,
    row: TemplateTrace,
    lefts: Sequence[float],
    widths: Sequence[float],
    top: float,
    count: int,
) -> None:
    colour = Colour.GOOD_INK if row.is_chosen else Colour.INK if row.dies_at is None else Colour.FAINT
    name = Canvas.fitted(row.template, NAME - 12)
    canvas.text(0, top + 15, name, colour, is_bold=row.is_chosen, tip=row.template)
    for index, (left, width) in enumerate(zip(lefts, widths, strict=True)):
        if row.dies_at is not None and index > row.dies_at:
            break
        is_end = row.dies_at == index
        canvas.box(left, top, width, HIGH, Colour.BAD if is_end else Colour.GOOD, line=Colour.PAPER)
        text = _text(row, index)
        shown = Canvas.fitted(text, width - 4, SMALL)
        ink = Colour.BAD_INK if is_end else Colour.GOOD_INK
        canvas.text(left + width / 2, top + 15, shown, ink, size=SMALL, anchor="middle", tip=text)
    if row.dies_at is None and count > len(lefts):
        end = lefts[-1] + widths[-1]
        canvas.box(end + 2, top, 16, HIGH, Colour.OPEN, line=Colour.PAPER)
        canvas.text(end + 10, top + 15, "…", Colour.FAINT, anchor="middle")


def _text(row: TemplateTrace, index: int) -> str:
    """Return what a template expects of a part; of the one that kills it, what for."""
    text = row.cells[index] if index < len(row.cells) else ""
    if row.dies_at != index:
        return text
    return f"✗ {row.why if row.why in _BESIDE else text or row.why}"


#: Reasons that are not in the part itself.
_BESIDE = ("request", "order", "content", "template")


def _chosen(rows: Sequence[TemplateTrace]) -> list[TemplateTrace]:
    """Return the templates that are drawn: the accepted one, then those that lived longest."""
    ordered = sorted(
        enumerate(rows),
        key=lambda item: (
            not item[1].is_chosen,
            item[1].dies_at is not None,
            -(item[1].dies_at or 0),
            item[0],
        ),
    )
    chosen: list[TemplateTrace] = []
    for _, row in ordered:
        if row.dies_at != 0 or sum(chosen_row.dies_at == 0 for chosen_row in chosen) < FIRST:
            chosen.append(row)
    return chosen[:TEMPLATES]


def _verdict(attempt: Attempt) -> tuple[str, str]:
    found = attempt.found
    if found.message is not None:
        fields = found.fields or {}
        inside = ", ".join(
            f"{k}={show_value(plain_value(v))}" for k, v in fields.items() if not k.startswith("_")
        )
        text = f"{found.message}({inside})"
        return text if len(text) <= 120 else text[:119] + "…", Colour.GOOD_INK
    more = (
        ""
        if attempt.is_can or found.reason == "pending"
        else f"; the search goes on at offset {attempt.resumes}"
    )
    return found.reason + more, Colour.BAD_INK
