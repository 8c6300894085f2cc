"""Signals on a terminal, kept up to date in place."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from .device_text import json_reading, shown_value

if TYPE_CHECKING:
    from aces_bus.device import Signal

Show = Callable[[float, "list[Signal]"], None]


@contextmanager
def watched(signals: list[Signal]) -> Generator[Show]:
    """A function that shows them, at so many seconds; what is said on stderr meanwhile stands above."""
    from rich.live import Live
    from rich.text import Text

    with Live(Text("…"), auto_refresh=False, redirect_stdout=False) as live:

        def show(seconds: float, signals: list[Signal]) -> None:
            live.update(_table(seconds, signals), refresh=True)

        yield show


def _table(seconds: float, signals: list[Signal]) -> Any:
    from rich.table import Table
    from rich.text import Text

    table = Table(
        box=None, padding=(0, 1, 0, 0), show_header=False, title=f"{seconds:.1f} s", title_justify="left"
    )
    table.add_column(no_wrap=True)
    table.add_column(justify="right", overflow="fold")
    table.add_column(no_wrap=True)
    table.add_column(overflow="ellipsis", no_wrap=True)
    for one in signals:
        value, note, style = "unknown", "", "dim"
        if one.instant is not None:
            value, style = shown_value(json_reading(one.last)), ""
            if one.is_stale and one.age_ns is not None:
                note, style = f"stale, {one.age_ns / 1e9:.1f} s old", "dim"
        table.add_row(
            one.name, Text(value, style), one.unit if one.instant is not None else "", Text(note, "dim")
        )
    return table


__all__ = ["watched"]
