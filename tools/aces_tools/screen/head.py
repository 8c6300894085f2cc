"""The lines above the table: the bus and its state, its load, what is wrong or lost.

1. What is wrong is never left out for want of room: it comes first in its line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.cells import cell_len

from aces_bus.hardware.gate_events import BusEvent

from ..output.text import printable
from .model import ChannelRates, Model, RepeatedFrame
from .paint import (
    FADE_NS,
    StyledText,
    age_style,
    bar,
    binary,
    elapsed,
    fit,
    mark,
    milliseconds,
    paint_bits,
    rate,
)
from .values import Value
from .view import View

Line = list[StyledText]

#: Channels with a line of their own; the others share one.
MOST_CHANNELS = 4
BAR = 16
#: An event is shown for so long.
TOLD_NS = 15_000_000_000
#: Events that are nothing to worry about.
CALM = frozenset({"opened", "reopened", "closed", "error-active", "recovered"})
_STATES = {"open": "good", "new": "dim", "lost": "bad", "closed": "warn"}


@dataclass(frozen=True)
class Status:
    """What the gate says: its state, and what was lost since counting began."""

    name: str
    title: str = ""
    state: str = "open"
    lost: int = 0
    bad_input: int = 0
    missed: int = 0
    reopened: int = 0
    recording: str = ""
    since_ns: int = 0


def head(model: Model, status: Status, view: View, shown: int, now_ns: int, width: int) -> list[Line]:
    """Return all lines of the head."""
    lines = [_title(status, view, now_ns, width)]
    channels = sorted(model.channels.values(), key=lambda channel: channel.name)
    if not channels:
        lines.append([StyledText(" nothing received yet", "dim")])
    widest = max([len(channel.name) for channel in channels], default=4)
    for channel in channels[:MOST_CHANNELS]:
        lines.append(_channel(model, channel, min(widest, 12), now_ns, width))
    if len(channels) > MOST_CHANNELS:
        more = channels[MOST_CHANNELS:]
        total = sum(channel.frame_meter.per_second(now_ns) for channel in more)
        lines.append([StyledText(f" and {len(more)} more channels: {rate(total)} frames/s", "dim")])
    lines.append(_losses(model, status, view, shown, now_ns))
    return [fit(line, width) for line in lines]


def _title(status: Status, view: View, now_ns: int, width: int) -> Line:
    state = _STATES.get(status.state, "warn")
    frozen = "" if view.frozen_ns is None else f" FROZEN {elapsed(now_ns - view.frozen_ns)} "
    right: Line = [
        *_if(frozen, frozen, "warn"),
        *_if(status.recording, f" ● {printable(status.recording)} ", "bad"),
        StyledText(f" {elapsed(now_ns - status.since_ns)} ", "dim"),
    ]
    size = sum(cell_len(span.text) for span in right)
    left: Line = [
        StyledText(" ● ", state),
        StyledText(printable(status.name), "title"),
        StyledText(f" {status.state}", state),
        *_if(status.title, f"  {printable(status.title)}", "dim"),
    ]
    left = fit(left, max(0, width - size))
    gap = width - size - sum(cell_len(span.text) for span in left)
    return [*left, StyledText(" " * max(0, gap), "plain"), *right]


def _channel(model: Model, channel: ChannelRates, name_width: int, now_ns: int, width: int) -> Line:
    share = model.load(channel, now_ns)
    pace = paint_bits(channel.bit_meter.per_second(now_ns))
    load: Line = [StyledText(f"{pace:>11}", "plain")]
    if share is not None:
        style = "good" if share < 0.7 else "warn" if share < 0.9 else "bad"
        load = [*bar(share, BAR if width >= 72 else 8), StyledText(f" {100 * share:3.0f} %", style)]
        load += _if(width >= 100, f"  {pace}", "dim")
    frames = channel.frame_meter.per_second(now_ns)
    return [
        StyledText(f" {printable(channel.name)[:name_width]:<{name_width}} ", "channel"),
        *load,
        StyledText(f"  {frames:,.0f} {'frames' if model.is_can else 'packets'}/s", "plain"),
        StyledText(f"  {channel.frames:,} in all", "dim"),
        *_if(channel.errors and len(model.channels) > 1, f"  {channel.errors:,} errors", "bad"),
    ]


def _losses(model: Model, status: Status, view: View, shown: int, now_ns: int) -> Line:
    counts = (
        (status.lost, "lost"),
        (model.errors, "errors"),
        (status.bad_input, "bad input"),
        (status.missed, "missed"),
    )
    line = [StyledText(f" {number:,} {what} ", "bad") for number, what in counts if number]
    share = 100 * model.unknown / max(1, model.total)
    rows = f"{shown} of {len(model.rows)} rows" if shown != len(model.rows) else f"{shown} rows"
    others = model.folded
    events = [event for event in model.events if now_ns - event.time_ns < TOLD_NS]
    worrying = [event for event in events if event.kind not in CALM]
    return [
        *(line or [StyledText(" no errors, nothing lost", "good")]),
        *_if(model.malformed, f"  {model.malformed:,} malformed", "bad"),
        *_if(model.unknown, f"  {model.unknown:,} unknown ({share:.2g} %)", "lost"),
        StyledText(f"  {rows}", "dim"),
        *_if(view.text, f"  /{view.text}", "bad" if view.problem else "warn"),
        *_if(view.unknown_only, "  unknown only", "warn"),
        *_if(others.rows, f"  {others.count:,} frames in {others.rows:,} folded rows", "dim"),
        *(_event(model, event) for event in (worrying or events)[-1:]),
    ]


def _event(model: Model, event: BusEvent) -> StyledText:
    number = model.event_counts.get(event.kind, 1)
    times = f" (×{number})" if number > 1 else ""
    said = printable(event.detail) or ""
    style = "dim" if event.kind in CALM else "bad"
    return StyledText(f"  {event.kind}{times}{': ' if said else ''}{said}", style)


def _if(wanted: object, text: str, style: str) -> Line:
    """Return a piece of text where it is wanted."""
    return [StyledText(text, style)] if wanted else []


def plain_text(lines: Sequence[Line]) -> str:
    """Return the text of lines, without styles."""
    return "\n".join("".join(span.text for span in line) for line in lines)


# ---------------------------------------------------------------------- everything about one row

#: The width of a layout's picture.
PICTURE = 79
CURVE = 24
#: Values of a record that are listed, at most.
MOST_VALUES = 400


def detail(
    row: RepeatedFrame, model: Model, now_ns: int, width: int, *, is_marking: bool = True
) -> list[Line]:
    """Return the lines of the pane."""
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
    way = f"{sign} {fields.direction}, " if fields is not None and fields.direction else ""
    first: Line = [
        StyledText(f"{row.identifier} ", "id"),
        *_if(row.name, f"{row.name} ", "lost" if row.is_lost else "message"),
        *_if(way, way, style),
        *([StyledText(fields.label, "dim")] if fields is not None else []),
        StyledText(f"  {printable(row.channel)}", "channel"),
    ]
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
    now = row.rate(now_ns)
    period, jitter = milliseconds(row.period_s).strip(), milliseconds(row.jitter_s).strip()
    bits = row.wire_bits * now
    pace: Line = [
        StyledText(f"{row.count:,} time{'' if row.count == 1 else 's'}, {rate(now)}/s", "plain"),
        *_if(row.count > 1, f", every {period} ± {jitter} ms", "plain"),
        *_if(bits, f", {paint_bits(bits)}", "plain"),
        *_if(bits and model.bitrate, f" ({100 * bits / (model.bitrate or 1):.2g} %)", "dim"),
        StyledText(f", last {elapsed(now_ns - row.host_ns)} ago", "dim"),
    ]
    doc = printable(fields.doc.splitlines()[0]) if fields is not None and fields.doc else ""
    return [first, *([[StyledText(doc, "dim")]] if doc else []), pace]


def _values(values: Sequence[Value], width: int) -> list[Line]:
    """Return fields in columns: name, value and unit, curve, place, doc."""
    name = min(28, max((cell_len(value.path) for value in values), default=0))
    shown = [printable(value.text) + (f" {value.unit}" if value.unit else "") for value in values]
    text = min(max(12, width - name - CURVE - 4), max(map(cell_len, shown), default=0))
    has_curve = any(value.curve for value in values)
    lines: list[Line] = []
    for value, shown_one in zip(values, shown, strict=True):
        number, unit = printable(value.text), f" {value.unit}" if value.unit else ""
        line: Line = [
            StyledText(f"{value.path:<{name}}  ", "name"),
            StyledText(number, "value"),
            StyledText(unit, "unit"),
        ]
        if has_curve:
            line.append(StyledText(" " * max(0, text - cell_len(shown_one)) + "  ", "plain"))
            line.append(StyledText(f"{value.curve:<{CURVE}}", "curve"))
        else:
            line.append(StyledText(" " * max(0, text - cell_len(shown_one)), "plain"))
        about = "  ".join(part for part in (value.place, printable(value.doc)) if part)
        if about:
            line.append(StyledText(f"  {about}", "dim"))
        lines.append(line)
    return lines


def _bits(row: RepeatedFrame, now_ns: int, width: int, *, is_marking: bool) -> list[Line]:
    """Return the bytes as hexadecimal digits and as bits, as many in a line as there is room for."""
    data = row.data[:64]
    if not data:
        return [[StyledText("no data", "dim")]]
    lines: list[Line] = []
    marks = row.ages(now_ns, FADE_NS) if is_marking else []
    each = max(1, min(4 if width < 120 else 8, (width + 2) // 18))
    for start in range(0, len(data), each):
        line: Line = []
        for number in range(start, min(start + each, len(data))):
            byte = row.data[number : number + 1]
            digits = [StyledText(byte.hex().upper(), "data")]
            if marks:
                digits = _digits(row, number, marks)
            line += [StyledText(f"{number:>2} ", "dim"), *digits, StyledText(" ", "plain")]
            line += [*binary(byte[0], number, marks), StyledText("  ", "plain")]
        lines.append(line)
    if len(row.data) > len(data):
        lines.append([StyledText(f"and {len(row.data) - len(data)} more bytes", "dim")])
    return lines


def _digits(row: RepeatedFrame, number: int, marks: Sequence[int]) -> list[StyledText]:
    digits = row.data[number : number + 1].hex().upper()
    return [
        StyledText(digit, age_style(marks, 8 * number + 4 * (1 - place), 15))
        for place, digit in enumerate(digits)
    ]
