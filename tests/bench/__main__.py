"""Measure on this machine, beside the libraries that people use today: `python -m tests.bench SUBJECT`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib import import_module
from typing import TYPE_CHECKING

from aces_bus.errors import AcesError
from aces_tools.console import print_json, say
from aces_tools.options import JSON, Arguments, add_arguments, argument, at_least, flag

#: Columns of a table that goes to a file.
WIDTH = 120

#: Frames of a log, at least.
FEWEST = 100

if TYPE_CHECKING:
    from tests.bench.rows import BenchRow


ARGUMENTS: Arguments = (
    argument(
        "subject",
        choices=["live", "columns", "transports", "text", "bus", "control", "robot", "bits"],
        help="live: one frame or chunk at a time, beside cantools and dynamixel_sdk; columns: whole recordings, beside "
        "cantools, python-can, polars, asammdf and C; transports: of these, packets in several frames, beside loops in "
        "Python and python-can-isotp; text: whole recordings to lines, beside cantools decode; "
        "bus: the virtual bus, beside python-can's; "
        "control: states, filters and controllers of a control loop, beside deque, np.interp and scipy; "
        "robot: a complete robot on served buses in real time, beside the same with threads; "
        "bits: fields and sizes by bits, beside fixed layouts of the same fields",
    ),
    flag("--quick", help="a few seconds instead of a minute; rougher figures"),
    argument(
        "--frames",
        type=at_least(FEWEST),
        metavar="N",
        help="columns, text: frames of the log (default: 1,000,000)",
    ),
    argument("--save", metavar="FILE", help="write the figures there, for --compare"),
    argument("--compare", metavar="FILE", help="show what has changed since figures that --save has written"),
    JSON.but(help="one JSON object a row instead of the table"),
)


def run(arguments: argparse.Namespace) -> int:
    from tests.bench.saved import SavedFigures, changes, read_saved, this_machine

    name: str = arguments.subject
    before = None if arguments.compare is None else read_saved(arguments.compare, name)
    machine = this_machine()
    options = {"frames": arguments.frames} if name in ("columns", "text") else {}
    subject = import_module(f"tests.bench.{name}")
    rows: list[BenchRow] = []
    for row in subject.run(quick=arguments.quick, **options):
        rows.append(row)
        if arguments.json and before is None:
            print_json(asdict(row), None)
    changed = changes(rows, before.rows) if before is not None else {}
    if not arguments.json:
        _print_table(rows, changed if before is not None else None)
    elif before is not None:
        for row in rows:
            print_json({**asdict(row), "change": changed.get((row.subject, row.contender))}, None)
    say(machine.note, who="")
    if before is not None:
        say(f"compared with: {before.machine.note}", who="")
    if arguments.save is not None:
        SavedFigures(name, machine, rows).save(arguments.save)
    return 0


def _print_table(rows: Sequence[BenchRow], changed: Mapping[tuple[str, str], float] | None) -> None:
    """The rows below their subjects; with what has `changed` since an earlier run, a column of that."""
    from rich.console import Console
    from rich.table import Table

    console = Console() if sys.stdout.isatty() else Console(width=WIDTH)
    last = None
    table = Table(box=None, pad_edge=False)
    for column in ("", "figure", "unit", "ratio", "target", "", *(["change"] if changed is not None else [])):
        right = column in ("figure", "ratio", "change")
        table.add_column(column, justify="right" if right else "left")
    for row in rows:
        if row.subject != last:
            last = row.subject
            table.add_row(f"[bold]{last}[/]")
        mark = {True: "[green]met[/]", False: "[red]below[/]", None: ""}[row.is_met]
        ratio = f"{row.ratio:.2f} ×" if row.ratio is not None else ""
        cells = [f"  {row.contender}", _figure(row.value), row.unit, ratio, row.target, mark]
        change = (changed or {}).get((row.subject, row.contender))
        if changed is not None:
            cells.append("new" if change is None else f"{change:.2f} ×")
        table.add_row(*cells)
    console.print(table)
    console.print(
        "Contenders in turn; only the ratios carry over to other machines."
        + (" change: of the ratio, else of the figure." if changed is not None else ""),
        style="dim",
    )


def _figure(value: float) -> str:
    """Three digits, large numbers with their thousands: 12,300,000."""
    return f"{value:.3g}" if value < 1000 else f"{round(value, 3 - len(str(int(value)))):,.0f}"


def main(argv: Sequence[str] | None = None) -> int:
    """Read the call, measure, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=__doc__)
    add_arguments(parser, ARGUMENTS)
    try:
        return run(parser.parse_args(argv))
    except AcesError as error:
        say(str(error))
        return 2


if __name__ == "__main__":
    # python-can imports asammdf where it is installed: a second of every start; `optional` finds it again.
    sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]  # how an import is forbidden
    sys.exit(main())
