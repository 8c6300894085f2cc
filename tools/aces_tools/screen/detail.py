"""Everything about one row: every field with its curve, the bits, the layout of the message.

1. Lines for a width; what does not fit is cut, and the pane scrolls the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

from rich.cells import cell_len

from ..output.text import printable
from .head import Line
from .model import Model, RepeatedFrame
from .paint import FADE_NS, FADES, StyledText, binary, elapsed, fit, mark, milliseconds, paint_bits, rate
from .values import Value

#: The width of a layout's picture.
PICTURE = 79
CURVE = 24
#: Values of a record that are listed, at most.
MOST_VALUES = 400


def detail(
    row: RepeatedFrame, model: Model, now_ns: int, width: int, *, is_marking: bool = True
) -> list[Line]:
    """The lines of the pane."""
    lines = [*_about(row, model, now_ns)]
    fields = model.fields_of(row)
    if fields is not None and row.record is not None:
        values = fields.values(row.record, tuple(row.history), CURVE)
        lines += [[], *_values(values[:MOST_VALUES], width)]
        if len(values) > MOST_VALUES:
            lines.append([StyledText(f"  and {len(values) - MOST_VALUES} more", "dim")])
    elif row.is_lost and row.record is not None and row.record.reason != row.name:
        lines += [[], [StyledText(printable(row.record.reason), "lost")]]
    lines += [[], *_bits(row, now_ns, width, is_marking=is_marking)]
    if fields is not None and width >= PICTURE:
        lines += [[], *([StyledText(text, "dim")] for text in fields.picture)]
    return [fit(line, width) for line in lines]


def _about(row: RepeatedFrame, model: Model, now_ns: int) -> list[Line]:
    fields = model.fields_of(row)
    sign, style = mark(row, model)
    first: Line = [StyledText(f"{row.identifier} ", "id")]
    if row.name:
        first.append(StyledText(f"{row.name} ", "lost" if row.is_lost else "message"))
    if fields is not None:
        way = f"{sign} {fields.direction}, " if fields.direction else ""
        first += [StyledText(way, style), StyledText(f"{fields.label}", "dim")]
    first.append(StyledText(f"  {printable(row.channel)}", "channel"))
    frame = row.frame
    if frame is not None:
        kinds = [
            "29 bits" if frame.is_extended_id else "",
            "FD" if frame.is_fd else "",
            "bit rate switch" if frame.bitrate_switch else "",
            "remote" if frame.is_remote_frame else "",
            "sent by this host" if frame.is_rx is False else "",
        ]
        first.append(StyledText("".join(f"  {kind}" for kind in kinds if kind), "dim"))
    lines: list[Line] = [first]
    if fields is not None and fields.doc:
        lines.append([StyledText(printable(fields.doc.splitlines()[0]), "dim")])
    now = row.rate(now_ns)
    pace: Line = [StyledText(f"{row.count:,} times, {rate(now)}/s", "plain")]
    if row.count > 1:
        pace.append(
            StyledText(
                f", every {milliseconds(row.period_s).strip()} ± {milliseconds(row.jitter_s).strip()} ms",
                "plain",
            )
        )
    if row.wire_bits and now:
        pace.append(StyledText(f", {paint_bits(row.wire_bits * now)}", "plain"))
        if model.bitrate:
            pace.append(StyledText(f" ({100 * row.wire_bits * now / model.bitrate:.2g} %)", "dim"))
    pace.append(StyledText(f", last {elapsed(now_ns - row.host_ns)} ago", "dim"))
    lines.append(pace)
    return lines


def _values(values: Sequence[Value], width: int) -> list[Line]:
    """Fields in columns: name, value and unit, curve, place, what it is."""
    name = min(28, max((cell_len(value.path) for value in values), default=0))
    shown = [printable(value.text) + (f" {value.unit}" if value.unit else "") for value in values]
    text = min(max(12, width - name - CURVE - 4), max(map(cell_len, shown), default=0))
    has_curve = any(value.curve for value in values)
    lines: list[Line] = []
    for value, told in zip(values, shown, strict=True):
        number, unit = printable(value.text), f" {value.unit}" if value.unit else ""
        line: Line = [
            StyledText(f"{value.path:<{name}}  ", "name"),
            StyledText(number, "value"),
            StyledText(unit, "unit"),
        ]
        if has_curve:
            line.append(StyledText(" " * max(0, text - cell_len(told)) + "  ", "plain"))
            line.append(StyledText(f"{value.curve:<{CURVE}}", "curve"))
        else:
            line.append(StyledText(" " * max(0, text - cell_len(told)), "plain"))
        about = "  ".join(part for part in (value.place, printable(value.doc)) if part)
        if about:
            line.append(StyledText(f"  {about}", "dim"))
        lines.append(line)
    return lines


def _bits(row: RepeatedFrame, now_ns: int, width: int, *, is_marking: bool) -> list[Line]:
    """The bytes as hexadecimal digits and as bits, as many in a line as there is room for."""
    data = row.data[:64]
    if not data:
        return [[StyledText("no data", "dim")]]
    lines: list[Line] = []
    marks = row.ages(now_ns, FADE_NS) if is_marking else []
    each = max(1, min(4 if width < 120 else 8, (width + 2) // 18))
    for start in range(0, len(data), each):
        line: Line = []
        for number in range(start, min(start + each, len(data))):
            one = row.data[number : number + 1]
            digits = [StyledText(one.hex().upper(), "data")]
            if marks:
                digits = _digits(row, number, marks)
            line += [StyledText(f"{number:>2} ", "dim"), *digits, StyledText(" ", "plain")]
            line += [*binary(one[0], number, marks), StyledText("  ", "plain")]
        lines.append(line)
    if len(row.data) > len(data):
        lines.append([StyledText(f"and {len(row.data) - len(data)} more bytes", "dim")])
    return lines


def _digits(row: RepeatedFrame, number: int, marks: Sequence[int]) -> list[StyledText]:
    spans: list[StyledText] = []
    for place, digit in enumerate(row.data[number : number + 1].hex().upper()):
        bit = 8 * number + 4 * (1 - place)
        style = next(
            (fade for fade, mask in zip(FADES, marks, strict=True) if mask >> bit & 15),
            "data",
        )
        spans.append(StyledText(digit, style))
    return spans


__all__ = ["detail"]
