"""Measure on this machine, beside the libraries that people use today."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from dataclasses import asdict
from importlib import import_module
from typing import TYPE_CHECKING

from .console import print_json
from .options import JSON, Arguments, argument, at_least, flag

#: Columns of a table that goes to a file.
WIDTH = 120

#: Frames of a log, at least.
FEWEST = 100

if TYPE_CHECKING:
    from .benchmarks import BenchRow


ARGUMENTS: Arguments = (
    argument(
        "subject",
        choices=["live", "columns", "bus", "control", "robot"],
        help="live: one frame or chunk at a time, beside cantools and dynamixel_sdk; columns: whole recordings, beside "
        "cantools, python-can, polars, asammdf and C; bus: the virtual bus, beside python-can's; "
        "control: states, filters and controllers of a control loop, beside deque, np.interp and scipy; "
        "robot: a complete robot on served buses in real time, beside the same with threads",
    ),
    flag("--quick", help="a few seconds instead of a minute; rougher figures"),
    argument(
        "--frames", type=at_least(FEWEST), metavar="N", help="columns: frames of the log (default: 1,000,000)"
    ),
    JSON.but(help="one JSON object a row instead of the table"),
)


def run(arguments: argparse.Namespace) -> int:
    options = {"frames": arguments.frames} if arguments.subject == "columns" else {}
    subject = import_module(f".benchmarks.{arguments.subject}", __package__)
    rows: Iterable[BenchRow] = subject.run(quick=arguments.quick, **options)
    if arguments.json:
        for row in rows:
            print_json(asdict(row), None)
        return 0
    from rich.console import Console
    from rich.table import Table

    console = Console() if sys.stdout.isatty() else Console(width=WIDTH)
    last = None
    table = Table(box=None, pad_edge=False)
    for column in ("", "figure", "unit", "ratio", "target", ""):
        table.add_column(column, justify="right" if column in ("figure", "ratio") else "left")
    for row in rows:
        if row.subject != last:
            last = row.subject
            table.add_row(f"[bold]{last}[/]")
        mark = {True: "[green]met[/]", False: "[red]below[/]", None: ""}[row.is_met]
        ratio = f"{row.ratio:.2f} ×" if row.ratio is not None else ""
        table.add_row(f"  {row.contender}", _figure(row.value), row.unit, ratio, row.target, mark)
    console.print(table)
    console.print(
        "Fastest of several rounds, contenders in turn; only the ratios carry over to other machines.",
        style="dim",
    )
    return 0


def _figure(value: float) -> str:
    """Three digits, large numbers with their thousands: 12,300,000."""
    return f"{value:.3g}" if value < 1000 else f"{round(value, 3 - len(str(int(value)))):,.0f}"
