"""Figures as text: the live panel of a terminal, and the lines that a pipe gets.

1. Pure: figures and a width in, lines out. No line is wider than the width; columns that have no room are left out, the
   least telling first.
2. Nothing that came from a wire or a file of the user's reaches the terminal as a control character.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..output.text import printable
from .figures import USUAL, BusLine, Component, Figures, StateLine

#: (style of rich, text).
Piece = tuple[str, str]
Line = list[Piece]
#: Head, whether it is put to the right, and how readily it is left out (0: never).
Column = tuple[str, bool, int]
LEAST_WIDTH = 20
GAP = 2

COMPONENTS: Sequence[Column] = (
    ("component", False, 0),
    ("Hz", True, 4),
    ("is", True, 1),
    ("late ms", True, 3),
    ("99 %", True, 2),
    ("missed", True, 1),
    ("overruns", True, 5),
    ("", False, 0),
)
BUSES: Sequence[Column] = (
    ("bus", False, 0),
    ("load", True, 1),
    ("sent/s", True, 3),
    ("received/s", True, 4),
    ("unanswered", True, 2),
    ("ticks missed", True, 6),
    ("slowest ms", True, 5),
    ("", False, 0),
)
STATES: Sequence[Column] = (
    ("state", False, 0),
    ("value", True, 0),
    ("set-point", True, 1),
    ("unit", False, 4),
    ("age ms", True, 2),
)


def panel(figures: Figures, title: str, width: int, height: int) -> list[Line]:
    """Return the whole panel, at most `width` × `height`."""
    width = max(LEAST_WIDTH, width)
    parts = [
        _head(figures, title, width),
        *_components(figures.components, width),
        *_buses(figures.buses, width),
    ]
    feet = _feet(figures, width)
    room = height - len(parts) - len(feet) - 1
    parts += _states(figures, width, room) if room >= 3 else []
    return [_fitted(line, width) for line in [*parts, *feet]][:height]


def plain_line(figures: Figures) -> str:
    """Return one line that says how the run is."""
    parts = [f"{figures.seconds:9.2f} s"]
    for component in figures.components:
        late = f" late {_ms(component.median_ns)}/{_ms(component.most_ns)} ms" if component.most_ns else ""
        says = f" {component.says}" if component.says else ""
        parts.append(f"{component.name} {component.rate_hz:.1f} Hz{late} missed {component.missed}{says}")
    for bus in figures.buses:
        load = f" {_load(bus)}" if bus.load is not None else ""
        parts.append(f"{bus.name}{load} unanswered {bus.missed}" + (f" {bus.state}" if bus.state else ""))
    oldest = figures.oldest
    if oldest is not None:
        parts.append(f"oldest {oldest.name} {_ms(oldest.age_ns or 0)} ms")
    if figures.unknown:
        parts.append(f"unknown {len(figures.unknown)}")
    parts.append(f"clipped {figures.clipped}")
    parts.append(f"events {sum(n for kind, n in figures.counts.items() if kind not in USUAL)}")
    return printable("; ".join(parts))


def _head(figures: Figures, title: str, width: int) -> Line:
    pace = f"  {figures.pace:.2g} × real time" if abs(figures.pace - 1) > 0.1 else ""
    return [("bold", title), ("", f"  {figures.seconds:.2f} s{pace}"), ("dim", "  Ctrl-C ends")]


def _components(components: Sequence[Component], width: int) -> list[Line]:
    rows = [
        [
            component.name,
            f"{component.wanted_hz:g}",
            f"{component.rate_hz:.1f}",
            _ms(component.median_ns) if component.most_ns else "",
            _ms(component.most_ns) if component.most_ns else "",
            str(component.missed),
            str(component.overruns),
            component.says,
        ]
        for component in components
    ]
    styles = [
        "bold red" if component.is_bad else "yellow" if component.missed else "" for component in components
    ]
    return _table(COMPONENTS, rows, styles, width)


def _buses(buses: Sequence[BusLine], width: int) -> list[Line]:
    rows = [
        [
            bus.name,
            "" if bus.load is None else _load(bus),
            f"{bus.sent_hz:.0f}",
            f"{bus.received_hz:.0f}",
            str(bus.missed),
            str(bus.ticks_missed),
            _ms(bus.latency_ns),
            bus.state,
        ]
        for bus in buses
    ]
    return _table(BUSES, rows, ["bold red" if bus.state else "" for bus in buses], width)


def _states(figures: Figures, width: int, room: int) -> list[Line]:
    """Return those without a fresh value first, then as the controllers name them."""
    states = sorted(figures.states, key=lambda state: state.is_fresh)
    shown = states if len(states) < room else states[: max(1, room - 2)]
    rows = [
        [
            state.name,
            _value(state),
            "" if state.set_point is None else f"{state.set_point:.4f}",
            state.unit,
            "" if state.age_ns is None else _ms(state.age_ns),
        ]
        for state in shown
    ]
    lines = _table(STATES, rows, ["" if state.is_fresh else "bold yellow" for state in shown], width)
    if len(shown) < len(states):
        oldest = figures.oldest
        text = f"and {len(states) - len(shown)} more"
        text += f", the oldest {_ms(oldest.age_ns or 0)} ms ({oldest.name})" if oldest is not None else ""
        lines.append([("dim", text)])
    return lines


def _feet(figures: Figures, width: int) -> list[Line]:
    clipped = f", {figures.clipped} clipped (most: {figures.clipped_most})" if figures.clipped else ""
    counts = {kind: n for kind, n in figures.counts.items() if kind not in USUAL}
    lines: list[Line] = [[("", f"{figures.set_points} set-points"), ("yellow" if clipped else "", clipped)]]
    if counts:
        text = ", ".join(f"{kind} {number}" for kind, number in sorted(counts.items()))
        lines[0].append(("bold", f"; events: {text}"))
    lines += [[("red", event)] for event in figures.events[-3:]]
    return lines


def _value(state: StateLine) -> str:
    if state.age_ns is None:
        return "unknown"
    return f"{state.value:.4f}" if isinstance(state.value, float) else str(state.value)


def _ms(ns: int) -> str:
    return f"{ns / 1e6:.2f}" if ns < 100_000_000 else f"{ns / 1e6:.0f}"


def _load(bus: BusLine) -> str:
    return f"{'≤ ' if bus.is_most else ''}{bus.load or 0.0:.0%}".replace("%", " %")


def _table(
    columns: Sequence[Column], rows: Sequence[Sequence[str]], styles: Sequence[str], width: int
) -> list[Line]:
    """Return a head and rows, with those columns that there is room for."""
    if not rows:
        return []
    cells = [[printable(cell) for cell in row] for row in rows]
    sizes = [max(len(head), *(len(row[i]) for row in cells)) for i, (head, _, _) in enumerate(columns)]
    used = [i for i in range(len(columns)) if any(row[i] for row in cells)]
    while True:
        fixed = [i for i in used if columns[i][0]]  # the last, without a head, takes what is left
        taken = sum(sizes[i] for i in fixed) + GAP * (len(fixed) - 1)
        least = GAP + 8 if len(fixed) < len(used) else 0
        readily = max((columns[i][2] for i in fixed), default=0)
        if taken + least <= width or not readily:
            break
        used.remove(next(i for i in fixed if columns[i][2] == readily))
    if taken > width:  # nothing more to leave out: long names are cut
        sizes[fixed[0]] = max(4, sizes[fixed[0]] - (taken - width))
    lines: list[Line] = []
    for row, style in zip([[head for head, _, _ in columns], *cells], ["dim", *styles], strict=True):
        text = (" " * GAP).join(_cell(row[i], sizes[i] if columns[i][0] else 0, columns[i][1]) for i in used)
        lines.append([(style, text.rstrip())])
    return lines


def _cell(text: str, size: int, right: bool) -> str:
    if not size:
        return text
    if len(text) > size:
        text = text[: size - 1] + "…"
    return text.rjust(size) if right else text.ljust(size)


def _fitted(line: Line, width: int) -> Line:
    out: Line = []
    left = width
    for style, raw in line:
        text = printable(raw)
        if len(text) > left:
            text = text[: max(0, left - 1)] + "…" if left else ""
        left -= len(text)
        if text:
            out.append((style, text))
    return out


def to_rich(lines: Sequence[Line]) -> Any:
    """Return lines as rich shows them."""
    from rich.text import Text

    whole = Text(no_wrap=True, overflow="crop")
    for number, line in enumerate(lines):
        whole.append("\n" if number else "")
        for style, text in line:
            whole.append(text, style or None)
    return whole
