"""Convert recordings from one format to another; several into one.

  aces convert walk.log walk.blf
  aces convert drive.asc.gz drive.log
  aces convert monday.log tuesday.log both.mf4
  aces convert --merge left.log right.log --map can1=arm body.blf
  candump -L can0 | aces convert - walk.pcapng
  aces convert walk.blf --filter 060:7F0 --from 10 --to 20 --format candump -
  aces convert session.slog session.bin
  aces convert walk.log walk.gvret.csv           for SavvyCAN
  aces convert walk.log walk.db                  as python-can's SqliteWriter

The last name is the output, and its suffix the format, also before .gz or
.zst. Formats of the others are recognised by content. - is standard input, or
with --format standard output.
"""

from __future__ import annotations

import argparse
import os
import sys
import textwrap
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np

from aces_bus import FrameTable, open_recording
from aces_bus.errors import CallerError, CaptureError, UnknownNameError
from aces_bus.frame_table import NO_TIME, FrameFlag, to_ns
from aces_bus.recordings.base import CanRecording, SerialRecording
from aces_bus.recordings.filters import parse_filter, passing
from aces_bus.recordings.merge import Merge, Relabel
from aces_bus.recordings.open import formats
from aces_bus.recordings.write import (
    FormatOut,
    OpenWriter,
    open_writer,
    split_suffix,
    writer_format,
    writer_formats,
)

from .console import SHOWN, Progress, abandon_stdout, counted, report_unreadable, say, say_note
from .options import FILTER, FROM, MAP, STRICT, TO, Arguments, argument, flag
from .patience import Patience
from .reading.window import TimeWindow

#: Suffixes that promise no format: recordings of many programs have them.
PLAIN = (".log", ".txt", ".bin", ".raw")
KINDS = {"can": "CAN frames", "serial": "bytes of a serial line"}


def _listed(title: str, names: Iterable[str]) -> str:
    return textwrap.fill(f"{title}: {' '.join(names)}", 78, subsequent_indent="  ") + "\n"


SUMMARY = "convert recordings: candump, ASC, BLF, TRC, MF4, pcapng, serial"

EPILOG = f"""\
{_listed("formats written", writer_formats())}{_listed("formats read", formats())}
times (--from, --to; in seconds):
  12.5           from the first frame of each file (with --merge: of all)
  1436509052.25  above 100000000: since 1970, as in the recording
  A frame is taken from --from on and before --to; one whose time is not
  known is left out when either is given.

channels:
  Formats name channels (candump, pcapng, MF4) or number them from 1 (ASC, BLF,
  TRC). can0 is number 1, can1 number 2 and back; another name gets the number
  at its end plus one (vcan4: 5), or the lowest that is free.
  --map 0=can3 renames a channel before that. --filter goes by the names in
  the recording.

summary (last on stderr):
  frames = written + filtered; errors: error frames among those written   (CAN)
  bytes = written + filtered                                           (serial)
  Above it, a line for each kind of entry that the output format cannot hold,
  and for each kind of entry in the input that is not a frame.

exit status:
  0    also after Ctrl-C where the input was live: what had come is written
  1    --strict, and anything was unreadable, no frame, or cannot be held by
       the output format
  2    a wrong call, or a file that cannot be read or written
  130  after Ctrl-C, SIGTERM or SIGHUP
The output appears only when it is whole: an error, or Ctrl-C while a file is
read, leaves what was there before.
"""


ARGUMENTS: Arguments = (
    argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="recordings, or - for standard input; the last one is what is written",
    ),
    argument("--format", metavar="FORMAT", help="the format written (default: by the suffix)"),
    argument("--input-format", metavar="FORMAT", help="the format read (default: by the content)"),
    flag("--merge", help="put frames of several files in order of time"),
    FROM,
    TO,
    FILTER,
    MAP.but(help="CAN: another name for channel OLD; without OLD, for the one that has no name"),
    STRICT.but(help="exit 1 when anything was lost; see below"),
)


def run(arguments: argparse.Namespace) -> int:
    return Conversion(arguments).run()


class Conversion:
    """One run of `aces convert`. A wrong call raises before anything is read."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        if len(arguments.files) < 2:
            raise CallerError("name what to read and, last, what to write: aces convert walk.log walk.blf")
        self.inputs: list[str] = arguments.files[:-1]
        self.target: str = arguments.files[-1]
        self.form = self._form()
        if self.form.link == "serial":
            for option in ("filter", "map", "merge"):
                if getattr(arguments, option):
                    raise CallerError(f"--{option} is for CAN frames, and {self.form.what} has none")
        self.filter = parse_filter(*arguments.filter) if arguments.filter else None
        self.relabel = Relabel(_renamed(arguments.map))
        self.window = TimeWindow.parse(arguments.start, arguments.stop)
        #: The first time of the file, or with --merge of all, so far.
        self.first: int | None = None
        self.progress = Progress(self._measured())
        self.total = self.written = self.errors = 0
        self.lines_unreadable = self.dropped = 0
        self.others: dict[str, int] = {}
        self.captures: list[CanRecording | SerialRecording] = []
        self.said: dict[int, int] = {}
        self.status = 0

    def _form(self) -> FormatOut:
        name: str | None = self.arguments.format
        if name is None and self.target == "-":
            raise CallerError(
                f"standard output has no suffix; name the format: --format {'|'.join(writer_formats())}"
            )
        if name is not None and name not in writer_formats():
            raise UnknownNameError("format", name, writer_formats())
        form = writer_formats()[name] if name is not None else writer_format(self.target)
        suffix = split_suffix(self.target)[1].lower()
        for other in writer_formats().values() if suffix not in (*form.suffixes, *PLAIN) else ():
            if suffix in other.suffixes:
                raise CallerError(
                    f"{self.target}: the suffix says {other.name}, and --format {form.name}; leave one of them away,"
                    " or give the file another name"
                )
        if self.target == "-" and not form.is_text and sys.stdout is not None and sys.stdout.isatty():
            raise CallerError(f"{form.what} is not for a terminal; redirect it, or name a file")
        return form

    def _measured(self) -> list[str]:
        """Return the files whose reading shows how far it is: of files that are read side by side the largest."""
        files = [name for name in self.inputs if os.path.isfile(name)]
        return [max(files, key=os.path.getsize)] if self.arguments.merge and files else files

    # ------------------------------------------------------------------ running

    def run(self) -> int:
        with Patience() as patience, ExitStack() as stack:
            writer = open_writer(self.target, self.form.name, inputs=self.inputs)
            stack.callback(writer.abort)  # does nothing once it is closed
            try:
                try:
                    if self.form.link == "can":
                        self._can(writer, patience, stack)
                    else:
                        self._serial(writer, patience, stack)
                finally:
                    self.progress.close()
                if patience.is_over and not (
                    self.captures and all(capture.live for capture in self.captures)
                ):
                    self._problems()
                    say(f"interrupted: {writer.name} is not written")
                    return 130
                writer.close()
            except BrokenPipeError:
                abandon_stdout()
            except CallerError:
                self._problems()
                raise
        self._problems()
        self._summarise(writer)
        return self.status

    def _open(self, name: str, patience: Patience, stack: ExitStack) -> Any:
        form = self.arguments.input_format
        try:
            with patience.waiting():  # for the first bytes of a pipe
                capture = open_recording(name, link=self.form.link, format=form)
        except CaptureError:
            if form is None and os.path.isfile(name) and (other := _link(name)) not in (None, self.form.link):
                raise CallerError(
                    f"{name}: {KINDS[other]}, which {self.form.what} does not hold; write one of "
                    + " ".join(f.suffixes[0] for f in writer_formats().values() if f.link == other)
                ) from None
            raise
        self.captures.append(capture)
        return stack.enter_context(capture)

    def _one_by_one(self, patience: Patience, stack: ExitStack) -> Iterator[Any]:
        for name in self.inputs:
            if patience.is_over:
                return
            try:
                capture = self._open(name, patience, stack)
            except KeyboardInterrupt:
                patience.is_over = True
                return
            self.progress.opened(capture)
            self.first = None
            if self.window is not None:
                self.window.begin()
            yield capture

    # ------------------------------------------------------------------ CAN

    def _can(self, writer: OpenWriter, patience: Patience, stack: ExitStack) -> None:
        if not self.arguments.merge:
            for capture in self._one_by_one(patience, stack):
                for table in patience.each(capture.tables()):
                    self._write(self.relabel(self._passing(table)), writer)
            return
        captures = [self._open(name, patience, stack) for name in self.inputs]
        measured = self._measured()
        for capture in captures:
            if capture.live:
                raise CallerError(f"{capture.name}: --merge is for files, and this is a pipe")
            if [capture.name] == measured:
                self.progress.opened(capture)
        wanted = [map(self._passing, capture.tables()) for capture in captures]
        for table in patience.each(Merge.by_time(wanted, self.relabel)):
            self._write(table, writer)

    def _write(self, table: FrameTable, writer: OpenWriter) -> None:
        if self.window is not None:
            if self.first is not None:
                self.window.see(self.first)
            table = table.take(self.window.inside(table.time))
        self.written += len(table)
        self.errors += int(np.count_nonzero(table.flags & FrameFlag.ERROR))
        if len(table):
            writer.write(table)
        self._after(writer)

    def _passing(self, table: FrameTable) -> FrameTable:
        """Return what --filter lets pass, which goes by the names in the recording."""
        self.total += len(table)
        self.progress.step(len(table))
        if self.window is not None and (known := table.time != NO_TIME).any():
            first = int(table.time[int(np.argmax(known))])
            self.first = first if self.first is None else min(self.first, first)
        return table if self.filter is None else table.take(passing(self.filter, table))

    # ------------------------------------------------------------------ serial lines

    def _serial(self, writer: OpenWriter, patience: Patience, stack: ExitStack) -> None:
        for capture in self._one_by_one(patience, stack):
            for chunk in patience.each(capture):
                self.total += len(chunk.data)
                self.progress.step(0)
                if self.window is None or self.window.inside(np.array([to_ns(chunk.time)]))[0]:
                    self.written += len(chunk.data)
                    writer.write(chunk)
                self._after(writer)

    # ------------------------------------------------------------------ what goes to stderr

    def _after(self, writer: OpenWriter) -> None:
        if self.captures[-1].live:
            writer.flush()
            self._problems()

    def _problems(self) -> None:
        """Name the first unreadable lines of each file, each once."""
        for place, capture in enumerate(self.captures):
            self.said[place] = report_unreadable(capture, self.said.get(place, 0))

    def _summarise(self, writer: OpenWriter) -> None:
        for capture in self.captures:
            report_unreadable(capture, SHOWN, is_over=True)
            self.lines_unreadable += capture.lines_unreadable
            for kind, count in capture.others.items():
                self.others[kind] = self.others.get(kind, 0) + count
            if isinstance(capture, CanRecording):
                self.dropped += capture.frames_dropped
        unit = "frame" if self.form.link == "can" else "byte"
        self._absences()
        if self.dropped:
            say(f"the recorder says that it lost {counted(self.dropped, 'frame')}")
        if self.window is not None and self.window.untimed:
            what = "frames" if self.form.link == "can" else "chunks"
            say(f"{what} without a time, which are outside of --from and --to: {self.window.untimed}")
        for kind, count in self.others.items():
            say(f"not written, being no {unit}s: {count} {kind}")
        for note in writer.notes:
            say_note(f"{self.form.what}: {note}")
        for kind, count in writer.lossy.items():
            say(f"{self.form.what} does not hold: {count} {kind}")
        faults = [f"{count} {kind}" for kind, count in (*self.others.items(), *writer.lossy.items())]
        if self.lines_unreadable:
            faults.append(
                f"{self.lines_unreadable} unreadable line{'s' if self.lines_unreadable > 1 else ''}"
            )
        if self.arguments.strict and faults:
            say(f"--strict: {', '.join(faults)}")
            self.status = 1
        filtered = self.total - self.written
        parts = [f"{unit}s={self.total}", f"written={self.written}", f"filtered={filtered}"]
        if unit == "frame":
            parts.append(f"errors={self.errors}")
        say(" ".join([*parts, f"lines_unreadable={self.lines_unreadable}"]), who="")

    def _absences(self) -> None:
        """Report channels that options name and that did not occur."""
        seen = self.relabel.seen
        if not seen:
            return
        there = ", ".join(sorted(str(name) for name in seen if name is not None)) or "none with a name"
        wanted = (
            {entry.interface for entry in self.filter.sets if entry.interface}
            if self.filter is not None
            else set()
        )
        for option, names in (("--filter", wanted), ("--map", set(self.relabel.names))):
            for name in sorted(str(name) for name in names - seen):
                say(f"{option}: no frame came from {name!r} (there are: {there})")


def _renamed(texts: list[str]) -> dict[str | None, str]:
    names: dict[str | None, str] = {}
    for text in texts:
        old, sign, new = text.partition("=")
        if not sign or not new:
            raise CallerError(f"--map {text}: write OLD=NEW, such as can0=drive")
        if (old or None) in names:
            raise CallerError(f"--map {text}: {old or 'the one without a name'} has a new name already")
        names[old or None] = new
    return names


def _link(name: str) -> str | None:
    """Return the link of a file by its content; None if it cannot be read."""
    try:
        with open_recording(name) as capture:
            return capture.link
    except CaptureError:
        return None
