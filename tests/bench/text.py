"""`python -m tests.bench text`: a whole recording to lines, beside `cantools decode --single-line`.

1. Contenders are whole commands, start and database included, in turn; they read one candump log (see `car`) and write to
   a file. What counts is CPU time, of which other programs take less than of the clock: the median of several rounds, and
   of the ratios within a round.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import median

from .car import car_dbc, write_car_log
from .rows import BenchRow, optional

TARGETS = {"text": 3.0, "jsonl": 3.5, "csv": 3.0}


def run(*, quick: bool, frames: int | None = None) -> Iterable[BenchRow]:
    """A row a format, and that of the peer where it is installed; some ten minutes, half a one with `quick`."""
    count = frames or (50_000 if quick else 1_000_000)
    with tempfile.TemporaryDirectory(prefix="aces-bench-") as name:
        folder = Path(name)
        log, dbc = folder / "car.log", folder / "car.dbc"
        dbc.write_text(car_dbc())
        write_car_log(log, count)
        ours = [sys.executable, "-m", "aces_tools", "decode", str(log), "-p", str(dbc), "--format"]
        commands = {form: [*ours, form] for form in TARGETS}
        if optional("cantools") is not None:
            commands["cantools"] = [sys.executable, "-m", "cantools", "decode", "--single-line", str(dbc)]
        rounds = [
            {form: cpu_seconds(command, log, folder / "lines") for form, command in commands.items()}
            for _ in range(1 if quick else 3)
        ]
    subject = f"{count:,} frames of a car to lines, whole commands"
    for form in commands:
        seconds = median(one[form] for one in rounds)
        if form == "cantools":
            yield BenchRow(subject, "cantools decode --single-line", count / seconds, "frames/s of CPU")
            continue
        ratio = median(one["cantools"] / one[form] for one in rounds) if "cantools" in commands else None
        yield BenchRow(
            subject,
            f"aces decode --format {form}",
            count / seconds,
            "frames/s of CPU",
            ratio,
            f"≥ {TARGETS[form]:g} × cantools" if ratio is not None else "",
            ratio >= TARGETS[form] if ratio is not None else None,
        )


def cpu_seconds(command: Sequence[str], log: Path, output: Path) -> float:
    """What a command costs that reads a log at its standard input, or by name."""
    before = os.times()
    with open(log, "rb") as read, open(output, "wb") as write:
        subprocess.run(command, stdin=read, stdout=write, stderr=subprocess.DEVNULL, check=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system
