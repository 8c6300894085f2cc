"""Rows and counts of the live screen as pieces of text with styles, for any width.

1. Nothing here reads a clock or knows the terminal's library; styles are names, and `styles` says what they are.
2. A piece of text has no control characters, whatever came over a wire; a line is never wider than asked for.
3. Where there is no colour, what is new is bold or underlined: colour alone says nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from rich.cells import cell_len, set_cell_size
from rich.style import Style

from ..output.text import printable
from .model import Model, RepeatedFrame

#: A change is fresh, recent, or about to be forgotten, up to these ages.
FADE_NS = (400_000_000, 1_200_000_000, 2_800_000_000)
FADES = ("fresh", "recent", "fading")


class StyledText(NamedTuple):
    """Text and the name of its style."""

    text: str
    style: str


_COLOURS: dict[str, str] = {
    "title": "bold #8fb8de",
    "rule": "#4a5568",
    "plain": "#c8d0da",
    "dim": "#7d8896",
    "id": "bold #e6ebf2",
    "channel": "#7d8896",
    "message": "bold #6cc7e0",
    "lost": "#e0787b",
    "bad": "bold #ff6b6b",
    "good": "#7fc98f",
    "warn": "bold #e8b75a",
    "to device": "#6c9bf5",
    "from device": "#7fc98f",
    "tx": "#c792ea",
    "rate": "#c8d0da",
    "data": "#8d97a5",
    "fresh": "bold #ffd166",
    "recent": "#dfb45c",
    "fading": "#b0976a",
    "name": "#7d8896",
    "value": "#e6ebf2",
    "unit": "#7d8896",
    "curve": "#6cc7e0",
    "silent": "#56606d",
    "bar": "#7fc98f",
    "bar high": "#e8b75a",
    "bar full": "#ff6b6b",
    "bar rest": "#323b47",
}
_PLAIN: dict[str, str] = {
    "title": "bold",
    "id": "bold",
    "message": "bold",
    "lost": "italic",
    "bad": "bold reverse",
    "warn": "bold reverse",
    "fresh": "bold underline",
    "recent": "underline",
    "dim": "dim",
    "silent": "dim",
    "name": "dim",
    "unit": "dim",
}


def styles(*, has_colour: bool = True) -> dict[str, Style]:
    """Return what the names of styles mean."""
    if has_colour:
        return {name: Style.parse(text) for name, text in _COLOURS.items()}
    return {name: Style.parse(_PLAIN.get(name, "")) for name in _COLOURS}


# ---------------------------------------------------------------------- numbers


def rate(value: float) -> str:
    """Return a rate per second, in five places."""
    if value <= 0:
        return "–"
    if value >= 99_950:
        return f"{value / 1000:.0f}k"
    return f"{value:.0f}" if value >= 99.95 else f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"


def milliseconds(seconds: float) -> str:
    """Return ms, in five places; from 100 s on in seconds."""
    value = seconds * 1000
    if value >= 99_950:
        return f"{value / 1000:.0f}s"
    return f"{value:.0f}" if value >= 99.95 else f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"


def paint_bits(value: float) -> str:
    """Return a bit rate (bit/s) as text."""
    for unit, size in (("Mbit/s", 1e6), ("kbit/s", 1e3)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value:.0f} bit/s"


def elapsed(ns: int) -> str:
    """Return hours, minutes, seconds."""
    seconds = max(0, ns) // 1_000_000_000
    hours, rest = divmod(seconds, 3600)
    minutes, seconds = divmod(rest, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


def bar(share: float, width: int) -> list[StyledText]:
    """Return a bar, an eighth of a character exact."""
    eighths = round(max(0.0, min(1.0, share)) * width * 8)
    full, rest = divmod(eighths, 8)
    part = " ▏▎▍▌▋▊▉"[rest] if rest else ""
    style = "bar" if share < 0.7 else "bar high" if share < 0.9 else "bar full"
    return [StyledText("█" * full + part, style), StyledText("░" * (width - full - len(part)), "bar rest")]


# ---------------------------------------------------------------------- columns


@dataclass(frozen=True)
class TableColumn:
    """One column of the table; `least` and `most` are its width."""

    name: str
    title: str
    width: int
    is_right: bool = False


@dataclass(frozen=True)
class Needs:
    """How wide the rows are: found over all of them, and seldom."""

    channels: int = 1
    channel: int = 4
    identifier: int = 3
    message: int = 7
    size: int = 8
    is_decoded: bool = True
    is_can: bool = True

    @classmethod
    def of(cls, model: Model, rows: Iterable[RepeatedFrame]) -> Needs:
        """Return what these rows need."""
        channel, identifier, message, size, is_can = 4, 2, 7, 1, True
        channels: set[str] = set()
        for row in rows:
            channels.add(row.channel)
            identifier = max(identifier, len(row.identifier))
            message = max(message, len(row.name))
            size = max(size, len(row.data))
            is_can = row.frame is not None
        channel = max([channel, *map(len, channels)])
        return cls(
            max(1, len(channels)), channel, identifier, message, size, model.scanner is not None, is_can
        )


#: The least that values get before other columns are left out or made narrow for them.
LEAST_VALUES = 24


def visible_columns(needs: Needs, width: int) -> list[TableColumn]:
    """Return the columns that fit: what is shown elsewhere, too, is left out first."""
    size = min(needs.size, 16)
    spaced, packed = 3 * size - 1, 2 * size
    message = min(needs.message, 20) if needs.is_decoded else 0
    identifier = min(needs.identifier, 12)
    channel = min(needs.channel, 8)
    tries: list[tuple[bool, bool, bool, bool, int, int]] = []
    for has_channel in (True, needs.channels > 1):
        tries += [
            (has_channel, True, True, True, spaced, message),
            (has_channel, True, False, True, spaced, message),
            (has_channel, True, False, False, spaced, min(message, 16)),
        ]
    several = needs.channels > 1
    tries += [
        (several, True, False, False, packed, min(message, 14)),
        (several, False, False, False, packed, min(message, 12)),
        (several, False, False, False, min(packed, 16), min(message, 10)),
        (False, False, False, False, min(packed, 16), min(message, 10)),
    ]
    found: list[TableColumn] = []
    for has_channel, has_period, has_length, has_jitter, data, name in tries:
        found = [TableColumn("mark", "", 1)]
        if has_channel:
            found.append(TableColumn("channel", "Chan", channel))
        found.append(TableColumn("id", "ID", max(2, identifier), True))
        if name:
            found.append(TableColumn("message", "Message", max(7, name)))
        found.append(TableColumn("rate", "Rate", 5, True))
        if has_period:
            found.append(
                TableColumn("period", "Period ± ms", 11)
                if has_jitter
                else TableColumn("short period", "  ms", 5, True)
            )
        if has_length:
            found.append(TableColumn("length", "Len", 3, True))
        found.append(TableColumn("data", "Data", max(4, data)))
        if _left(found, width) >= (LEAST_VALUES if needs.is_decoded else 0):
            break
    if needs.is_decoded and (left := _left(found, width) - 1) >= 4:
        found.append(TableColumn("values", "Values", left))
    if _left(found, width) < 0:
        found = [column for column in found if column.name != "rate"]
    while len(found) > 1 and _left(found, width) < 0:
        last = found.pop()
        if (room := last.width + _left([*found, last], width)) >= 4:
            found.append(replace(last, width=room))
    return found


def _left(found: Sequence[TableColumn], width: int) -> int:
    """Return what the columns leave of a line."""
    return width - sum(column.width + 1 for column in found)


def title(found: Sequence[TableColumn], sort: str, *, is_reversed: bool) -> list[StyledText]:
    """Return the line above the table; an arrow at the column that the rows are sorted by."""
    sorted_by = {"id": "id", "rate": "rate", "name": "message", "change": "data"}[sort]
    spans: list[StyledText] = []
    for column in found:
        text = column.title
        style = "dim"
        if column.name == sorted_by:
            sign = "▴" if is_reversed else "▾"
            text = f"{text}{sign}" if len(text) < column.width else text[:-1] + sign
            style = "title"
        spans.append(StyledText(_fitted(text, column.width, is_right=column.is_right) + " ", style))
    return spans


def line(
    row: RepeatedFrame, model: Model, found: Sequence[TableColumn], now_ns: int, *, is_marking: bool = True
) -> list[StyledText]:
    """Return one row of the table."""
    silent = row.is_silent(now_ns)
    spans: list[StyledText] = []
    for column in found:
        if column.name == "data":
            spans += _data(row, column.width, now_ns, is_marking=is_marking and not silent)
        elif column.name == "values":
            spans += _values(row, model, column.width, "silent" if silent else "")
        else:
            text, style = _cell(column.name, row, model, now_ns)
            if silent and style not in ("bad", "lost"):
                style = "silent"
            spans.append(StyledText(_fitted(text, column.width, is_right=column.is_right), style))
        spans.append(StyledText(" ", "plain"))
    return spans


def _cell(name: str, row: RepeatedFrame, model: Model, now_ns: int) -> tuple[str, str]:
    match name:
        case "mark":
            return mark(row, model)
        case "channel":
            return row.channel, "channel"
        case "id":
            return row.identifier, "id"
        case "message":
            return row.name, (
                "bad" if row.name in ("malformed", "error frame") else "lost"
            ) if row.is_lost else "message"
        case "rate":
            return rate(row.rate(now_ns)), "rate"
        case "length":
            return str(row.frame.length if row.frame is not None else len(row.data)), "dim"
        case _:
            if row.count < 2:
                return "–".rjust(5), "dim"
            period = milliseconds(row.period_s).rjust(5)
            return (period if name == "short period" else f"{period}±{milliseconds(row.jitter_s)}"), "rate"


def mark(row: RepeatedFrame, model: Model) -> tuple[str, str]:
    """Return which way it goes: to a device or from one, as far as its message says; else whether this host sent it."""
    fields = model.fields_of(row)
    if fields is not None and fields.direction is not None:
        return ("→" if fields.direction == "to device" else "←"), fields.direction
    return ("»", "tx") if row.frame is not None and row.frame.is_rx is False else (" ", "plain")


def _fitted(text: str, width: int, *, is_right: bool = False) -> str:
    text = printable(text)
    length = cell_len(text)
    if length > width:
        return set_cell_size(text, width - 1) + "…" if width > 1 else set_cell_size(text, width)
    return " " * (width - length) + text if is_right else text + " " * (width - length)


def _data(row: RepeatedFrame, width: int, now_ns: int, *, is_marking: bool) -> list[StyledText]:
    data = row.data
    if row.frame is not None and row.frame.is_remote_frame:
        return [StyledText(_fitted(f"remote, {row.frame.length} bytes", width), "dim")]
    gap = " " if width >= 3 * min(len(data), 16) - 1 and width % 3 == 2 else ""
    room = (width + len(gap)) // (2 + len(gap))
    is_cut = len(data) > room
    shown = data[: room - 1] if is_cut else data
    spans = paint_hexadecimal(row, shown, now_ns, gap, is_marking=is_marking)
    length = sum(len(span.text) for span in spans)
    if is_cut:
        spans.append(StyledText("…", "dim"))
        length += 1
    spans.append(StyledText(" " * (width - length), "plain"))
    return spans


def paint_hexadecimal(
    row: RepeatedFrame, shown: bytes, now_ns: int, gap: str, *, is_marking: bool
) -> list[StyledText]:
    """Return bytes as hexadecimal digits, each by the age of the change of its four bits."""
    text = shown.hex(" ").upper() if gap else shown.hex().upper()
    if not is_marking or not row.changes:
        return [StyledText(text, "data")] if text else []
    marks = row.ages(now_ns, FADE_NS)
    if not any(marks):
        return [StyledText(text, "data")] if text else []
    step = 2 + len(gap)
    spans: list[StyledText] = []
    begin, style = 0, ""
    for number in range(len(shown)):
        for nibble in (1, 0):
            now = age_style(marks, 8 * number + 4 * nibble, 15)
            at = number * step + 1 - nibble
            if now != style:
                if at > begin:
                    spans.append(StyledText(text[begin:at], style))
                begin, style = at, now
    spans.append(StyledText(text[begin:], style))
    return spans


def age_style(marks: Sequence[int], bit: int, mask: int) -> str:
    """Return the style of bits by the age of their last change; `marks` are `RepeatedFrame.ages`, or none."""
    return next((fade for fade, mark in zip(FADES, marks, strict=False) if mark >> bit & mask), "data")


def binary(byte: int, number: int, marks: Sequence[int]) -> list[StyledText]:
    """Return one byte as bits, the highest first, each by the age of its change; `number` is the byte's,
    `marks` are `ages`.
    """
    spans: list[StyledText] = []
    for bit in range(7, -1, -1):
        style = age_style(marks, 8 * number + bit, 1)
        text = str(byte >> bit & 1)
        if spans and spans[-1].style == style:
            spans[-1] = StyledText(spans[-1].text + text, style)
        else:
            spans.append(StyledText(text, style))
        if bit == 4:
            spans[-1] = StyledText(spans[-1].text + " ", style)
    return spans


def _values(row: RepeatedFrame, model: Model, width: int, style: str) -> list[StyledText]:
    """Return as many decoded fields as there is room for, or the reason why a row is not decoded."""
    spans: list[StyledText] = []
    if row.is_lost or row.record is None:
        reason = getattr(row.record, "reason", "").partition(": ")[2]
        return [StyledText(_fitted(reason, width), style or "dim")]
    fields = model.fields_of(row)
    if fields is None:
        return [StyledText(" " * width, "plain")]
    left = width
    for token in fields.tokens(row.record):
        lead = "  " if spans else ""
        parts = (
            StyledText(f"{lead}{token.name}=", style or "name"),
            StyledText(printable(token.text), style or "value"),
            StyledText(f" {token.unit}" if token.unit else "", style or "unit"),
        )
        for span in parts:
            length = cell_len(span.text)
            if length > left:
                if left > 0:
                    spans.append(StyledText(set_cell_size(span.text, left - 1) + "…", span.style))
                return spans
            left -= length
            if span.text:
                spans.append(span)
    if left:
        spans.append(StyledText(" " * left, "plain"))
    return spans


def fit(spans: Sequence[StyledText], width: int) -> list[StyledText]:
    """Return as much of a line as there is room for."""
    found: list[StyledText] = []
    for span in spans:
        length = cell_len(span.text)
        if length > width:
            if width > 0:
                found.append(StyledText(set_cell_size(span.text, width - 1) + "…", span.style))
            break
        found.append(span)
        width -= length
    return found
