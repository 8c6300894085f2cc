"""`aces bench`: measure on this machine, beside the libraries people use today."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "subject",
        choices=["live"],
        help="live: one frame or chunk at a time, beside cantools and dynamixel_sdk",
    )
    parser.add_argument(
        "--quick", action="store_true", help="a few seconds instead of a minute; rougher figures"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a row instead of the table")


def run(arguments: argparse.Namespace) -> int:
    from .benchmarks import live

    rows = live.run(quick=arguments.quick)
    if arguments.json:
        for row in rows:
            print(json.dumps(asdict(row), ensure_ascii=False), flush=True)
        return 0
    from rich.console import Console
    from rich.table import Table

    console = Console()
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
        table.add_row(f"  {row.contender}", f"{row.value:.3g}", row.unit, ratio, row.target, mark)
    console.print(table)
    console.print(
        "Fastest of several rounds, contenders in turn; only the ratios carry over to other machines.",
        style="dim",
    )
    return 0
