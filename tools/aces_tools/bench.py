"""`aces bench`: measure on this machine, beside the libraries people use today."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from dataclasses import asdict
from typing import TYPE_CHECKING

from aces_bus.errors import CallerError

#: Columns of a table that goes to a file.
WIDTH = 120

#: Frames of a log, at least.
FEWEST = 100

if TYPE_CHECKING:
    from .benchmarks.timing import BenchRow


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "subject",
        choices=["live", "columns", "bus", "control"],
        help="live: one frame or chunk at a time, beside cantools and dynamixel_sdk; columns: whole captures, beside "
        "cantools, python-can, polars, asammdf and C; bus: the virtual bus, beside python-can's; "
        "control: what a control loop pays for states, filters and controllers, beside deque, np.interp and scipy",
    )
    parser.add_argument(
        "--quick", action="store_true", help="a few seconds instead of a minute; rougher figures"
    )
    parser.add_argument(
        "--frames", type=int, metavar="N", help="columns: frames of the log (default: 1,000,000)"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a row instead of the table")


def run(arguments: argparse.Namespace) -> int:
    rows: Iterable[BenchRow]
    if arguments.frames is not None and arguments.frames < FEWEST:
        raise CallerError(f"--frames {arguments.frames}: at least {FEWEST} are needed to measure anything")
    if arguments.subject == "live":
        from .benchmarks import live

        rows = live.run(quick=arguments.quick)
    elif arguments.subject == "bus":
        from .benchmarks import bus

        rows = bus.run(quick=arguments.quick)
    elif arguments.subject == "control":
        from .benchmarks import control

        rows = control.run(quick=arguments.quick)
    else:
        from .benchmarks import columns

        rows = columns.run(quick=arguments.quick, frames=arguments.frames)
    if arguments.json:
        for row in rows:
            print(json.dumps(asdict(row), ensure_ascii=False), flush=True)
        return 0
    from rich.console import Console
    from rich.table import Table

    console = Console() if sys.stdout.isatty() else Console(width=WIDTH)
    subject = None
    table = Table(box=None, pad_edge=False)
    for column in ("", "figure", "unit", "ratio", "target", ""):
        table.add_column(column, justify="right" if column in ("figure", "ratio") else "left")
    for row in rows:
        if row.subject != subject:
            subject = row.subject
            table.add_row(f"[bold]{subject}[/]")
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
    if value < 1000:
        return f"{value:.3g}"
    return f"{round(value, 2 - len(str(int(value))) + 1):,.0f}"
