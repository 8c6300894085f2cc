"""`aces decode "s3://logs/**/*.mf4" -p car.dbc -o s3://lake/ --cluster local:4`: the call, the progress, the summary.

1. What is decoded, and where, is `aces_lab.fleet`'s; here is what is asked for and what is said.
2. What one process could leave out and a fleet cannot is refused by name.
"""

from __future__ import annotations

import argparse
from typing import Any

from aces_bus.errors import CallerError
from aces_tools.console import SHOWN, StatusLine, say, say_note
from aces_tools.decode_columns import wanted_columns
from aces_tools.decoding import named_messages
from aces_tools.output.shape import plans_of
from aces_tools.protocols_arg import named_protocol

from . import FleetInput, FleetProgress, FleetProtocol, FleetRun
from . import decode as decode_with_fleet


def run(arguments: argparse.Namespace) -> int:
    """Run `aces decode --cluster`; return the exit status."""
    if arguments.count is not None:
        raise CallerError("--count is for lines, and --cluster writes tables; --from and --to choose a piece")
    if arguments.output is None or arguments.format not in (None, "parquet"):
        raise CallerError("--cluster writes folders of Parquet: -o DIR/ or -o s3://bucket/folder/")
    if arguments.jobs != 1:
        raise CallerError("--jobs or --cluster; local:4 is four processes of this machine")
    if "-" in arguments.files:
        raise CallerError("--cluster reads files and URIs, not standard input")
    named = [named_protocol(text) for text in arguments.protocol]
    plans = plans_of([protocol.variant() for protocol in named])
    line = StatusLine(is_wanted=not arguments.quiet)
    try:
        run = decode_with_fleet(
            arguments.files,
            [_travelling(protocol) for protocol in named],
            arguments.output,
            cluster=arguments.cluster,
            direction=arguments.direction,
            message=named_messages(arguments.message, plans),
            columns=wanted_columns(arguments.signals, plans),
            unknown=arguments.unknown or "hide",
            names=arguments.names,
            float32=arguments.float32,
            where=arguments.where,
            filter=arguments.filter,
            start=arguments.start,
            stop=arguments.stop,
            progress=lambda progress: line.show(progress_line(progress)),
            note=say,
        )
    finally:
        line.clear()
    return _summary(run, arguments)


def _travelling(named: Any) -> FleetProtocol:
    dialect, configuration = named.decided()
    return FleetProtocol.of(named.source, dialect=dialect, configuration=configuration, channel=named.channel)


def progress_line(progress: FleetProgress) -> str:
    """Return how far a run is, in a line."""
    parts = [
        f"{progress.done} of {progress.inputs} inputs",
        f"{progress.rate / 1e6:.1f} MB/s",
        f"{progress.items / progress.seconds / 1e6:.2f} M/s",
    ]
    if progress.faulty:
        parts.append(f"{progress.faulty} with faults")
    if progress.seconds_left is not None:
        parts.append(f"{duration_text(progress.seconds_left)} left")
    return ", ".join(parts)


def duration_text(seconds: float) -> str:
    """Return a duration for people: `40 s`, `12 min`, `3.5 h`, `2.1 d`."""
    for limit, unit, text in ((100, 1, "s"), (6000, 60, "min"), (172_800, 3600, "h")):
        if seconds < limit:
            return f"{seconds / unit:.3g} {text}"
    return f"{seconds / 86_400:.3g} d"


def say_faults(inputs: list[FleetInput], where: str) -> None:
    """Print the first faults of the inputs to stderr."""
    faults = [fault for entry in inputs for fault in entry.faults]
    for fault in faults[:SHOWN]:
        say(fault)
    if len(faults) > SHOWN:
        say(f"and {len(faults) - SHOWN} more: aces fleet status {where} --faults")


def _summary(run: FleetRun, arguments: argparse.Namespace) -> int:
    say_faults(run.failed, arguments.output)
    for entry in run.inputs:
        for note in entry.notes:
            say_note(f"{entry.uri}: {note}")
    if run.stood:
        say_note(f"{run.stood} inputs stand as they were decoded before")
    total = run.total
    unread = any(entry.state != "done" or not _is_read(entry) for entry in run.failed)
    status = 2 if unread else 0
    if arguments.strict and (faults := [fault for bins in total.values() for fault in bins.faults]):
        say(f"--strict: {', '.join(faults)}")
        status = status or 1
    for link, bins in total.items():
        say(bins.line(link), who="")
    if run.interrupted:
        say(f"interrupted: {len(run.inputs)} inputs are done, the same call goes on")
        return 130
    return status


def _is_read(entry: FleetInput) -> bool:
    """Return whether only single lines of it could not be read."""
    return len(entry.faults) <= entry.lines_unreadable
