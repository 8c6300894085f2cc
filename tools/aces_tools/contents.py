"""`aces decode FILE` without a protocol: what a recording holds, and which installed protocols fit it.

1. Frames by channel and identifier: how many, how often, how long, which bytes change. Bytes: how many, and the first.
2. Memory is bounded: one row an identifier, of at most `ROWS` identifiers, and the first piece for trying protocols.
"""

from __future__ import annotations

import argparse
import shlex
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from aces_bus.errors import CallerError, CaptureError
from aces_bus.frame_table import ERROR, NO_TIME, FrameTable, widened
from aces_bus.guess import TRIED_BYTES, TRIED_FRAMES, fitting_protocols
from aces_bus.plain_text import printable
from aces_bus.protocol.keys import EXTENDED, FD, REMOTE
from aces_bus.recordings import CanRecording, parse_filter
from aces_bus.recordings.filters import passing
from aces_bus.recordings.pieces import open_any

from .console import Patience, abandon_stdout, counted, print_json, report_unreadable, say
from .output.columns import Page

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
#: Identifiers that have a row; a recording of a bus that works has fewer.
ROWS = 4096
#: Gaps between frames of an identifier that its period is the median of.
GAPS = 1000
#: So many protocols are named.
NAMED = 3


def show_contents(arguments: argparse.Namespace) -> int:
    """One run of `aces decode` without a protocol; its exit status."""
    for option in _NEED_A_PROTOCOL:
        if getattr(arguments, option):
            name = {"start": "from", "stop": "to"}.get(option, option)
            raise CallerError(
                f"--{name} needs to know what is spoken; name a protocol: -p NAME (aces protocols)"
            )
    wanted = parse_filter(*arguments.filter) if arguments.filter else None
    status = 0
    with Patience() as patience:
        for name in arguments.files:
            try:
                with patience.waiting():
                    recording = open_any(name)
                with recording:
                    found: CanContents | SerialContents
                    if isinstance(recording, CanRecording):
                        found = CanContents(name)
                        for table in patience.each(recording.tables()):
                            found.add(
                                table
                                if wanted is None
                                else table.take(np.flatnonzero(passing(wanted, table)))
                            )
                    else:
                        found = SerialContents(name)
                        for chunk in patience.each(recording):
                            found.add(chunk.data, chunk.time)
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


@dataclass
class Row:
    """What is known of the frames of one identifier on one channel; times in ns."""

    channel: str | None
    key: int
    first: bytes
    is_error: bool = False
    frames: int = 0
    shortest: int = 255
    longest: int = 0
    last_ns: int = NO_TIME
    gaps: list[int] = field(default_factory=list)
    changed: Any = None

    @property
    def identifier(self) -> str:
        """As candump writes it, and what is unusual."""
        number = f"{self.key & 0x1FFF_FFFF:0{8 if self.key & EXTENDED else 3}X}"
        marks = [("remote", self.key & REMOTE), ("FD", self.key & FD), ("error", self.is_error)]
        return " ".join([number, *(mark for mark, is_set in marks if is_set)])

    @property
    def period_ms(self) -> float | None:
        """The median time from one frame to the next; None where there are no times or too few frames."""
        return float(np.median(self.gaps)) / 1e6 if len(self.gaps) >= 2 else None

    @property
    def pattern(self) -> str:
        """One character a byte: `x` where it changes, `.` where it is always the same."""
        return "".join("x" if one else "." for one in self.changed[: self.longest].tolist())


class CanContents:
    """What the frames of a recording are like."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.rows: dict[tuple[int, int, bool], Row] = {}
        self.frames = self.beyond = 0
        self.first_ns = self.last_ns = NO_TIME
        self.piece: list[FrameTable] = []

    def add(self, table: FrameTable) -> None:
        """More frames."""
        if not len(table):
            return
        if sum(map(len, self.piece)) < TRIED_FRAMES:
            self.piece.append(table.take(np.arange(min(len(table), TRIED_FRAMES))))
        self.frames += len(table)
        times = table.time[table.time != NO_TIME]
        if len(times):
            if self.first_ns == NO_TIME:
                self.first_ns = int(times[0])
            self.last_ns = int(times[-1])
        is_error = (table.flags & ERROR != 0).astype(np.uint64)
        slots = is_error << np.uint64(48) | table.channel.astype(np.uint64) << np.uint64(32) | table.key
        order = np.argsort(slots, kind="stable")
        ends = np.flatnonzero(np.diff(slots[order])) + 1
        for rows in np.split(order, ends):
            self._add_rows(table, rows)

    def _add_rows(self, table: FrameTable, rows: Any) -> None:
        """Frames of one identifier."""
        first = int(rows[0])
        slot = int(table.channel[first]), int(table.key[first]), bool(table.flags[first] & ERROR)
        row = self.rows.get(slot)
        if row is None:
            if len(self.rows) == ROWS:
                self.beyond += len(rows)
                return
            row = self.rows[slot] = Row(
                table.channels.names[slot[0]],
                slot[1],
                widened(table.data[first : first + 1], 64)[0].tobytes(),
                slot[2],
            )
            row.changed = np.zeros(64, bool)
        data, lengths, times = widened(table.data[rows], 64), table.length[rows], table.time[rows]
        row.frames += len(rows)
        row.shortest, row.longest = (
            min(row.shortest, int(lengths.min())),
            max(row.longest, int(lengths.max())),
        )
        row.changed |= (data != np.frombuffer(row.first, np.uint8)).any(axis=0)
        times = times[times != NO_TIME]
        if len(times) and len(row.gaps) < GAPS:
            steps = np.diff(times, prepend=times[:1] if row.last_ns == NO_TIME else row.last_ns)
            row.gaps += steps[row.last_ns == NO_TIME :].tolist()[: GAPS - len(row.gaps)]
        if len(times):
            row.last_ns = int(times[-1])

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return (self.last_ns - self.first_ns) / 1e9 if self.first_ns != NO_TIME else 0.0

    def show(self, arguments: argparse.Namespace) -> None:
        """Print what was found."""
        rows = sorted(self.rows.values(), key=lambda row: (str(row.channel), row.key))
        if arguments.format == "jsonl":
            for row in rows:
                print_json(
                    {
                        "channel": row.channel,
                        "identifier": row.key & 0x1FFF_FFFF,
                        "extended": bool(row.key & EXTENDED),
                        "frames": row.frames,
                        "period_ms": row.period_ms,
                        "length": [row.shortest, row.longest],
                        "changes": row.pattern,
                    },
                    indent=None,
                )
            return
        names = ", ".join(dict.fromkeys(str(row.channel) for row in rows if row.channel is not None))
        page = Page(arguments.color)
        title = f"{_shown(self.name)}: {counted(self.frames, 'frame')}"
        title += f" in {self.seconds:.6g} s" if self.seconds else ""
        page.lines([printable(title + (f" on {names}" if names else ""))])
        if rows and not arguments.quiet:
            page.lines([""])
            page.table(
                ("channel", "id", "frames", "period", "bytes", "changes"), [_cells(row) for row in rows]
            )
        if self.beyond:
            page.lines([f"and {counted(self.beyond, 'frame')} of more than {ROWS} identifiers"])
        _advise(page, self.name, "can", FrameTable.concat(self.piece) if self.piece else None)


def _cells(row: Row) -> tuple[str, ...]:
    period = row.period_ms
    return (
        row.channel or "",
        row.identifier,
        str(row.frames),
        "" if period is None else f"{period:.4g} ms",
        str(row.longest) if row.shortest == row.longest else f"{row.shortest}-{row.longest}",
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

    def add(self, data: bytes, time: float | None) -> None:
        """More bytes, which came at a time (s)."""
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
        _advise(page, self.name, "serial", bytes(self.piece) or None)


# ---------------------------------------------------------------------- which protocols fit


def _advise(page: Page, name: str, link: str, piece: Any) -> None:
    """Say what to type next."""
    if piece is None:
        return
    fitting = fitting_protocols(piece)[:NAMED]
    command = "… | aces decode" if name == "-" else f"aces decode {shlex.quote(name)}"
    page.lines([""])
    for one in fitting:
        page.lines([printable(f"{one.share:4.0%} is {one.name}:  {command} -p {one.name}")])
    if not fitting:
        page.lines(
            [
                "no installed protocol fits (aces protocols); a database: -p car.dbc; yours: aces spec guess, spec new"
            ]
        )
