"""The lines above the table: the bus and its state, its load, what is wrong or lost.

1. What is wrong is never left out for want of room: it stands first in its line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.cells import cell_len

from ..output.text import printable
from .model import ChannelRates, Model
from .paint import StyledText, bar, elapsed, fit, paint_bits, rate
from .view import View

Line = list[StyledText]

#: Channels with a line of their own; the others share one.
MOST_CHANNELS = 4
BAR = 16
#: An event is told for so long.
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
    """All lines of the head."""
    lines = [_title(status, view, now_ns, width)]
    channels = sorted(model.channels.values(), key=lambda one: one.name)
    if not channels:
        lines.append([StyledText(" nothing heard yet", "dim")])
    widest = max([len(channel.name) for channel in channels], default=4)
    for channel in channels[:MOST_CHANNELS]:
        lines.append(_channel(model, channel, min(widest, 12), now_ns, width))
    if len(channels) > MOST_CHANNELS:
        more = channels[MOST_CHANNELS:]
        total = sum(one.frame_meter.per_second(now_ns) for one in more)
        lines.append([StyledText(f" and {len(more)} more channels: {rate(total)} frames/s", "dim")])
    lines.append(_losses(model, status, view, shown, now_ns))
    return [fit(line, width) for line in lines]


def _title(status: Status, view: View, now_ns: int, width: int) -> Line:
    state = _STATES.get(status.state, "warn")
    left: Line = [
        StyledText(" ● ", state),
        StyledText(printable(status.name), "title"),
        StyledText(f" {status.state}", state),
    ]
    if status.title:
        left.append(StyledText(f"  {printable(status.title)}", "dim"))
    right: Line = []
    if view.frozen_ns is not None:
        right.append(StyledText(f" FROZEN {elapsed(now_ns - view.frozen_ns)} ", "warn"))
    if status.recording:
        right.append(StyledText(f" ● {printable(status.recording)} ", "bad"))
    right.append(StyledText(f" {elapsed(now_ns - status.since_ns)} ", "dim"))
    size = sum(cell_len(span.text) for span in right)
    left = fit(left, max(0, width - size))
    gap = width - size - sum(cell_len(span.text) for span in left)
    return [*left, StyledText(" " * max(0, gap), "plain"), *right]


def _channel(model: Model, channel: ChannelRates, name_width: int, now_ns: int, width: int) -> Line:
    line: Line = [StyledText(f" {printable(channel.name)[:name_width]:<{name_width}} ", "channel")]
    share = model.load(channel, now_ns)
    pace = paint_bits(channel.bit_meter.per_second(now_ns))
    if share is not None:
        line += bar(share, BAR if width >= 72 else 8)
        style = "good" if share < 0.7 else "warn" if share < 0.9 else "bad"
        line.append(StyledText(f" {100 * share:3.0f} %", style))
        if width >= 100:
            line.append(StyledText(f"  {pace}", "dim"))
    else:
        line.append(StyledText(f"{pace:>11}", "plain"))
    frames = channel.frame_meter.per_second(now_ns)
    what = "frames" if model.is_can else "packets"
    line.append(StyledText(f"  {frames:,.0f} {what}/s", "plain"))
    line.append(StyledText(f"  {channel.frames:,} in all", "dim"))
    if channel.errors and len(model.channels) > 1:
        line.append(StyledText(f"  {channel.errors:,} errors", "bad"))
    return line


def _losses(model: Model, status: Status, view: View, shown: int, now_ns: int) -> Line:
    line: Line = []
    for number, what in (
        (status.lost, "lost"),
        (model.errors, "errors"),
        (status.bad_input, "bad input"),
        (status.missed, "missed"),
    ):
        if number:
            line.append(StyledText(f" {number:,} {what} ", "bad"))
    if not line:
        line.append(StyledText(" no errors, nothing lost", "good"))
    if model.malformed:
        line.append(StyledText(f"  {model.malformed:,} malformed", "bad"))
    if model.unknown:
        share = 100 * model.unknown / max(1, model.total)
        line.append(StyledText(f"  {model.unknown:,} unknown ({share:.2g} %)", "lost"))
    rows = f"{shown} of {len(model.rows)} rows" if shown != len(model.rows) else f"{shown} rows"
    line.append(StyledText(f"  {rows}", "dim"))
    if view.text:
        line.append(StyledText(f"  /{view.text}", "bad" if view.problem else "warn"))
    if view.unknown_only:
        line.append(StyledText("  unknown only", "warn"))
    others = model.folded
    if others.rows:
        line.append(StyledText(f"  {others.count:,} frames in {others.rows:,} folded rows", "dim"))
    events = [event for event in model.events if now_ns - event.time_ns < TOLD_NS]
    worrying = [event for event in events if event.kind not in CALM]
    for event in (worrying or events)[-1:]:
        style = "dim" if event.kind in CALM else "bad"
        number = model.event_counts.get(event.kind, 1)
        times = f" (×{number})" if number > 1 else ""
        said = printable(event.detail) or ""
        line.append(StyledText(f"  {event.kind}{times}{': ' if said else ''}{said}", style))
    return line


def plain_text(lines: Sequence[Line]) -> str:
    """Lines without styles."""
    return "\n".join("".join(span.text for span in line) for line in lines)


__all__ = ["Line", "Status", "head", "plain_text"]
