"""`aces decode FILE` without a protocol: what a recording holds, and which installed protocols fit it.

1. Frames by channel and identifier: how many, how often, how long, which bytes change. Bytes: how many, and the first.
2. Memory is bounded: one row an identifier, of so many as `IdentifierCounts` has, and the first piece for trying protocols.
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterable
from typing import Any

import numpy as np

from aces_bus import FrameTable
from aces_bus.errors import CallerError, CaptureError
from aces_bus.frame_table import NO_TIME, widened
from aces_bus.plain_text import printable
from aces_bus.recordings.base import CanRecording, Chunk
from aces_bus.recordings.filters import CanFilter, parse_filter, passing

from .console import abandon_stdout, counted, print_json, report_unreadable, say
from .output.columns import Page
from .patience import Patience
from .reading.fitting import TRIED_BYTES, TRIED_FRAMES, fitting_protocols
from .reading.pieces import open_any
from .reading.traffic import BusIdentifier, FrameCount, IdentifierCounts

#: Options that need to know the messages.
_NEED_A_PROTOCOL = (
    "message",
    "where",
    "signals",
    "direction",
    "output",
    "unknown",
    "strict",
    "start",
    "stop",
    "count",
)
#: So many protocols are named.
NAMED = 3


def show_contents(arguments: argparse.Namespace) -> int:
    """Run `aces decode` without a protocol; return its exit status."""
    for option in _NEED_A_PROTOCOL:
        if getattr(arguments, option):
            name = {"start": "from", "stop": "to"}.get(option, option)
            raise CallerError(f"--{name} needs a protocol: -p NAME (aces protocols)")
    wanted = parse_filter(*arguments.filter) if arguments.filter else None
    status = 0
    with Patience() as patience:
        for name in arguments.files:
            try:
                with patience.waiting():
                    recording = open_any(name)
                found: CanContents | SerialContents
                pieces: Iterable[Any]
                piece: Any
                if isinstance(recording, CanRecording):
                    found, pieces = CanContents(name, wanted), recording.tables()
                else:
                    found, pieces = SerialContents(name), recording
                with recording:
                    try:
                        for piece in patience.each(pieces):
                            found.add(piece)
                    except CaptureError as error:  # what there is before the damage is shown all the same
                        status = 2
                        say(str(error))
                    report_unreadable(recording, is_over=True)
                found.show(arguments)
            except CaptureError as error:
                status = 2
                say(str(error))
            except BrokenPipeError:
                abandon_stdout()
                return status
            except KeyboardInterrupt:
                return 130
            if patience.is_over:
                break
    return status


def _shown(name: str) -> str:
    return "standard input" if name == "-" else name


class Row(FrameCount):
    """What is known of the frames of one identifier on one channel."""

    def __init__(self, identifier: BusIdentifier) -> None:
        super().__init__()
        self.identifier = identifier
        self._first: Any = None
        self._changed = np.zeros(64, bool)

    def add(self, table: FrameTable, rows: Any) -> None:
        """Add frames of this identifier, in these rows."""
        self.count(table.time[rows], table.length[rows])
        data = widened(table.data[rows], 64)
        if self._first is None:
            self._first = data[0].copy()
        self._changed |= (data != self._first).any(axis=0)

    @property
    def pattern(self) -> str:
        """One character a byte: `x` where it changes, `.` where it is always the same."""
        return "".join("x" if bit else "." for bit in self._changed[: self.lengths_seen[-1]].tolist())


class CanContents:
    """What the frames of a recording are like."""

    def __init__(self, name: str, wanted: CanFilter | None = None) -> None:
        self.name, self.wanted = name, wanted
        self.rows = IdentifierCounts(Row)
        self.first_ns = self.last_ns = NO_TIME
        self.piece: list[FrameTable] = []

    def add(self, table: FrameTable) -> None:
        """Add frames, of which those count that the filter takes."""
        if self.wanted is not None:
            table = table.take(np.flatnonzero(passing(self.wanted, table)))
        if sum(map(len, self.piece)) < TRIED_FRAMES:
            self.piece.append(table.take(np.arange(min(len(table), TRIED_FRAMES))))
        times = table.time[table.time != NO_TIME]
        if len(times):
            if self.first_ns == NO_TIME:
                self.first_ns = int(times[0])
            self.last_ns = int(times[-1])
        for row, rows in self.rows.groups(table):
            row.add(table, rows)

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return (self.last_ns - self.first_ns) / 1e9 if self.first_ns != NO_TIME else 0.0

    def show(self, arguments: argparse.Namespace) -> None:
        """Print what was found."""
        rows = sorted(self.rows.values(), key=lambda row: (str(row.identifier.channel), row.identifier.key))
        if arguments.format == "jsonl":
            for row in rows:
                print_json(
                    {
                        "channel": row.identifier.channel,
                        "identifier": row.identifier.number,
                        "extended": row.identifier.is_extended,
                        "frames": row.frames,
                        "period_ms": row.period_ms,
                        "length": [row.lengths_seen[0], row.lengths_seen[-1]],
                        "changes": row.pattern,
                    },
                    indent=None,
                )
            return
        names = ", ".join(
            dict.fromkeys(row.identifier.channel for row in rows if row.identifier.channel is not None)
        )
        page = Page(arguments.color)
        title = f"{_shown(self.name)}: {counted(self.rows.frames, 'frame')}"
        title += f" in {self.seconds:.6g} s" if self.seconds else ""
        page.lines([printable(title + (f" on {names}" if names else ""))])
        if rows and not arguments.quiet:
            page.lines([""])
            page.table(
                ("channel", "id", "frames", "period", "bytes", "changes"), [_cells(row) for row in rows]
            )
        if self.rows.beyond:
            page.lines(
                [f"and {counted(self.rows.beyond, 'frame')} of more than {len(self.rows)} identifiers"]
            )
        _advise(page, self.name, FrameTable.concat(self.piece) if self.piece else None)


def _cells(row: Row) -> tuple[str, ...]:
    period = row.period_ms
    return (
        row.identifier.channel or "",
        str(row.identifier),
        str(row.frames),
        "" if period is None else f"{period:.4g} ms",
        "-".join(map(str, dict.fromkeys((row.lengths_seen[0], row.lengths_seen[-1])))),
        row.pattern,
    )


class SerialContents:
    """What the bytes of a recording are like."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.bytes = 0
        self.piece = bytearray()
        self.first_s: float | None = None
        self.last_s: float | None = None

    def add(self, chunk: Chunk) -> None:
        """Take more bytes."""
        data, time = chunk.data, chunk.time
        self.bytes += len(data)
        self.piece += data[: max(0, TRIED_BYTES - len(self.piece))]
        self.first_s, self.last_s = time if self.first_s is None else self.first_s, time or self.last_s

    def show(self, arguments: argparse.Namespace) -> None:
        """Print what was found."""
        page = Page(arguments.color)
        passed = (self.last_s or 0.0) - (self.first_s or 0.0)
        title = f"{_shown(self.name)}: {counted(self.bytes, 'byte')}" + (
            f" in {passed:.6g} s" if passed else ""
        )
        page.lines([printable(title)])
        if self.piece and not arguments.quiet:
            page.lines([""])
            for place in range(0, min(len(self.piece), 64), 16):
                page.lines([f"{place:8}  {bytes(self.piece[place : place + 16]).hex(' ').upper()}"])
        _advise(page, self.name, bytes(self.piece) or None)


# ---------------------------------------------------------------------- which protocols fit


def _advise(page: Page, name: str, piece: Any) -> None:
    """Say what to type next."""
    if piece is None:
        return
    fitting = fitting_protocols(piece)[:NAMED]
    command = "… | aces decode" if name == "-" else f"aces decode {shlex.quote(name)}"
    page.lines([""])
    for protocol in fitting:
        page.lines([printable(f"{protocol.share:4.0%} is {protocol.name}:  {command} {protocol.options}")])
    if not fitting:
        page.lines(
            [
                "no installed protocol fits (aces protocols); a database: -p car.dbc; yours: aces spec guess, spec new"
            ]
        )
