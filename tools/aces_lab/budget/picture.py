"""A budget as a picture: when each message has arrived at the latest, from the tick that brings it about.

A panel a bus, a row a kind of message: a bar is the frame itself in its latest place, a cross one that has no bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from aces_bus.plain_text import printable
from aces_tools.plotting.figure import COLOURS, WIDTH, load_matplotlib, write_figure

if TYPE_CHECKING:
    from . import BusBudget, MessageBudget, RobotBudget

#: Of the host's messages, of devices' answers, of what devices send by themselves, and of what misses its deadline.
HOST, ANSWER, ALONE, MISSED = COLOURS[0], COLOURS[2], COLOURS[4], COLOURS[1]
#: Inches of a row, and of what is around a panel.
ROW, AROUND = 0.26, 1.0


def save_budget(found: RobotBudget, path: str) -> None:
    """Draw into a file, whose suffix says the format. Raises `CallerError` when it cannot be written."""
    matplotlib = load_matplotlib()
    from matplotlib.figure import Figure

    buses = [bus for bus in found.buses.values() if bus.utilisation is not None and bus.messages]
    rows = [_rows(bus.messages) for bus in buses]
    heights = [max(len(some), 2) * ROW + AROUND for some in rows] or [AROUND]
    ours = {"font.size": 9, "svg.hashsalt": "aces", "text.usetex": False, "axes.axisbelow": True}
    with matplotlib.rc_context(ours):
        figure = Figure(figsize=(WIDTH, min(60.0, sum(heights) + 0.5)), layout="constrained")
        title = (
            f"{found.traffic.robot} at {found.traffic.rate_hz:g} Hz: when a message has arrived at the latest"
        )
        figure.suptitle(_plain(title), x=0.01, ha="left", fontweight="bold")
        if buses:
            axes = figure.subplots(len(buses), 1, squeeze=False, gridspec_kw={"height_ratios": heights})
            for axis, bus, some in zip(axes[:, 0], buses, rows, strict=True):
                _draw(axis, bus, some)
        write_figure(figure, path)


def _plain(text: str) -> str:
    """Return a text that matplotlib does not read as a formula."""
    return printable(text).replace("$", r"\$")


def _rows(messages: Sequence[MessageBudget]) -> list[tuple[str, list[MessageBudget]]]:
    rows: dict[tuple[str, bool], list[MessageBudget]] = {}
    for message in messages:
        rows.setdefault((message.sent.message, message.sent.node == "host"), []).append(message)
    return [(name, some) for (name, _), some in rows.items()]


def _draw(axis: Any, bus: BusBudget, rows: Sequence[tuple[str, list[MessageBudget]]]) -> None:
    tick = bus.traffic.tick_ns / 1e6
    latest = [message.response_ns / 1e6 for message in bus.messages if message.response_ns is not None]
    is_ticked = any(message.sent.is_ticked for message in bus.messages)
    right = 1.04 * max([*latest, tick] if is_ticked else latest, default=tick)
    for number, (_, some) in enumerate(rows):
        for message in some:
            if message.response_ns is None:
                axis.plot([right * 0.99], [number], "x", color=MISSED, clip_on=False)
                continue
            kind = HOST if message.sent.node == "host" else ANSWER if message.sent.is_ticked else ALONE
            end, length = message.response_ns / 1e6, message.wire_ns / 1e6
            axis.barh(
                number,
                length,
                left=end - length,
                height=0.7,
                color=kind if message.is_met else MISSED,
                edgecolor="white",
                linewidth=0.4,
            )
    axis.set_yticks(
        range(len(rows)), [_plain(name if len(some) == 1 else f"{name} × {len(some)}") for name, some in rows]
    )
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlim(0, right)
    axis.set_xlabel("ms")
    axis.grid(axis="x", color="#E4E4E4", linewidth=0.7)
    missed = len(bus.missed)
    verdict = (
        "every deadline is kept" if not missed else f"{missed} of {len(bus.messages)} messages miss theirs"
    )
    axis.set_title(
        _plain(f"{bus.traffic.name}: {bus.utilisation:.0%} used, {verdict}"), loc="left", fontsize=9
    )
    seen = {
        message.sent.node == "host" or (None if message.sent.is_ticked else False) for message in bus.messages
    }
    handles = [
        axis.barh([0], [0], color=colour, label=label)
        for key, colour, label in (
            (True, HOST, "host"),
            (None, ANSWER, "answers"),
            (False, ALONE, "by itself"),
        )
        if key in seen
    ]
    if missed:
        handles.append(axis.barh([0], [0], color=MISSED, label="misses its deadline"))
    if is_ticked:
        handles.append(axis.axvline(tick, color="#5F5F5F", linestyle="--", linewidth=1, label="next tick"))
    axis.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1, 1),
        borderaxespad=0.1,
        ncols=len(handles),
        fontsize=8,
        frameon=False,
    )
