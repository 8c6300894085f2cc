"""Decode recordings and live captures; account for every frame and byte.

  aces decode walk.log -p hubo
  aces decode session.bin -p robotis --direction from
  candump can0 | aces decode -p hubo -
  aces decode walk.log -p hubo --message Encoder --where board=3 -o encoder.csv
  aces decode walk.log -p hubo -o walk.parquet
  aces decode 's3://logs/**/*.mf4' -p car.dbc -o s3://lake/ --cluster local:4

A FILE is a recording of CAN (candump, BLF, ASC, TRC, MF4, pcap, pcapng, CSV,
python-can's SQLite and others: `aces convert --help` lists them) or of a serial
line (.slog, the vendor's hex dump, raw bytes), also packed with gzip or zstd.
Formats are recognised by content; - is standard input. With protocols for CAN
and serial lines, each file goes to those of its kind. More: docs/captures.md.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import repeat
from typing import TYPE_CHECKING, Any

from aces_bus import Frame, Unknown, make_scanner
from aces_bus.errors import CallerError
from aces_bus.export.open import table_formats
from aces_bus.frame_table import to_ns
from aces_bus.frames import key_of
from aces_bus.protocol import Record
from aces_bus.protocol.live.scanner import Scanner
from aces_bus.recordings.base import CanRecording, Link, Recording, SerialRecording

from .console import Output, abandon_stdout, say_note, standard_input, terminal_width, wants_colour
from .decoding import Decoding, utf8
from .options import (
    COLOR,
    COUNT,
    DIRECTION,
    FILTER,
    FROM,
    JOBS,
    MESSAGE,
    OUTPUT,
    PROTOCOL,
    QUIET,
    STRICT,
    TIME,
    TO,
    UNKNOWN,
    WHERE,
    Arguments,
    argument,
    flag,
    several,
)
from .output import LIVE, Writer, line_format, table_format
from .patience import Patience
from .reading.pieces import Direction, check_direction
from .reading.totals import Totals

if TYPE_CHECKING:
    from .reading.where import Where
    from .registers import RegisterNotes

BATCH = 1024
#: Unknown items that are looked at for one that can be explained.
EXPLAINED = 20

SUMMARY = "decode recordings: candump, BLF, ASC, MF4, serial captures, pipes"

EPILOG = """\
protocols (-p):
  hubo                an installed protocol; `aces protocols` lists them
  hubo:D08            in one of its dialects
  hubo@drc_hubo       with one of its configurations; also hubo:D08@hubo2
  hubo@robot.toml     with your own: tables such as [channels] with lines such
                      as 0x00 = 2; base = "NAME" on top changes a shipped one
  my_spec.py[:NAME]   declared in a Python file. It is executed with your
                      rights: name only what you trust
  car.dbc             a database: .dbc .kcd .sym .arxml, or CANopen's .eds .dcf;
                      `aces protocols car.dbc` lists what cannot be used of it
  can0=car.dbc        any of these for one channel only, named as in the text
                      output: can0 in a candump log, 0 in BLF and ASC

conditions (--where):
  board=3  position.1<0  servos.id=3  mode=torque  error=overload  data=0a00
  temperature=none  meta.time>12.5
  Fields are named as they are printed. `position>100` holds when any of
  several positions does. Several conditions must all hold. Put < and > in
  quotes: the shell takes them otherwise.

formats:
  text    for people: times count from the first item of a file; on a terminal
          coloured, and folded to its width
  jsonl   one JSON object a line; numbers in the spec's units, enumerations by
          name, flags as a list of names, bytes as hexadecimal, NaN as null
  csv     with one --message: one row a record, one column a field; otherwise
          one row a value (field, value, unit)

tables (-o FILE, by its suffix; millions of frames a second):
  .parquet .arrow .feather   a folder with one file a message, or with a single
                  --message that file; units, enumerations and docs are in
                  the schema's metadata
  DIR/            a folder of Parquet, one file a message (with --cluster, one
                  folder a message)
  .csv/           (with the slash) a folder with one CSV a message
  .npz            arrays by Message/field
  .sqlite .db     one table a message; _messages and _columns describe them
  .mcap           for Foxglove and PlotJuggler
  Enumerations are numbers unless --names is given (in CSV they are names).
  What is not decoded is counted, and with --unknown show written to _lost.
  An output appears only when it is whole: Ctrl-C on a file, or an error while
  writing, leaves what was there before.

fleets (--cluster; docs/fleets.md):
  FILEs are paths, URIs (s3://, sftp://, http:// …) and patterns of them in
  quotes; -o names a folder or URI. Each message becomes a Parquet dataset with
  a folder a day. A second run decodes what is missing or changed;
  `aces fleet status DATASET` says what there is.

summary (last on stderr, one line a kind of link; the parts sum to the total):
  frames = decoded + unknown + malformed + filtered + errors           (CAN)
           + control + pending, where messages take several frames
  bytes = decoded + unknown + malformed + skipped + filtered + pending (streams)
  filtered: refused by --filter, --from or --to; or decoded, and refused by
  --message, --signals or --where. Filters apply after recognition, so that a
  reply is recognised by its request even where the request is not shown.

exit status:
  0    also after Ctrl-C where the input was live
  1    --strict, and anything was unknown, malformed, skipped, pending or
       unreadable
  2    a wrong call, or a file that cannot be read (the others are decoded)
  130  after Ctrl-C, SIGTERM or SIGHUP
"""


ARGUMENTS: Arguments = (
    argument("files", nargs="*", metavar="FILE", help="a recording; - or none for standard input"),
    PROTOCOL.but(help="protocols; see below; the first that fits wins. Without: what the recording holds"),
    DIRECTION,
    argument(
        "--format",
        choices=[*LIVE, *(name for name in table_formats() if name not in LIVE)],
        metavar="FORMAT",
        help="text, jsonl, csv, or one of the tables below (default: by the suffix of --output, else text)",
    ),
    OUTPUT.but(help="write there instead of on standard output; see tables below"),
    FILTER,
    MESSAGE,
    WHERE.but(help="only records such as field=value; see below"),
    several(
        "--signals", metavar="GLOB", help="tables: only these columns, such as Encoder.position.* or *.speed"
    ),
    FROM,
    TO,
    UNKNOWN,
    QUIET.but(help="print no records, only the summary"),
    STRICT.but(help="exit 1 when anything was unknown, malformed, skipped, pending or unreadable"),
    flag("--names", help="tables: enumerations as names instead of numbers"),
    flag("--float32", help="tables: physical values in half the size, and less exact"),
    JOBS.but(
        help="tables: number of processes (default: 1; 0: one a processor); each message is then a folder of parts"
        " (Parquet, Arrow)",
    ),
    TIME,
    COUNT.but(help="end after this many lines"),
    COLOR,
)


def run(arguments: argparse.Namespace) -> int:
    arguments.jobs = arguments.jobs or os.cpu_count() or 1
    for name in [*arguments.files, arguments.output or ""]:
        if "://" in name and not os.path.exists(name):
            raise CallerError(
                f"{name}: URIs are for fleets: --cluster here, or local:4, or a scheduler's address"
            )
    form = table_format(arguments.output, arguments.format)
    arguments.files = arguments.files or standard_input()
    if not arguments.protocol:
        from .contents import show_contents

        return show_contents(arguments)
    if form is not None and arguments.count is not None:
        raise CallerError(
            "--count is for lines, and tables are written whole; --from and --to choose a piece"
        )
    if form is not None:
        from .decode_columns import ColumnDecoding

        return ColumnDecoding(arguments, form).run()
    for option in ("signals", "names", "float32", "jobs"):
        if getattr(arguments, option) and (option != "jobs" or arguments.jobs > 1):
            raise CallerError(
                f"--{option} is for tables; write some: -o FILE.parquet (or .arrow .npz .sqlite .mcap .csv/)"
            )
    return LiveDecoding(arguments).run()


class LiveDecoding(Decoding):
    """Records one by one, in the order of the recording, as they come."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        super().__init__(arguments)
        self.where = self._where(arguments.where)
        self.is_selective = bool(self.messages) or self.where is not None
        show = arguments.unknown or ("hide" if self.is_selective else "show")
        self.shows_records = show != "only"
        self.shows_losses = show != "hide"
        #: Nothing is printed; what would be is counted all the same.
        self.is_quiet: bool = arguments.quiet
        #: What would be shown is shown elsewhere, too.
        self.is_watched = False
        self.scanners: dict[tuple[Link, Direction | None], Scanner] = {}
        #: The source that the writer does not know of yet.
        self.pending: tuple[str, Link] | None = None
        #: So many unknown items are still looked at for one whose head is right: one is explained.
        self.to_explain = EXPLAINED
        #: End after so many lines, and how many were shown.
        self.count: int | None = arguments.count
        self.printed = 0
        self.registers = self._registers()
        self.output = self._output(arguments)
        self.writer = self._writer(arguments)

    def _output(self, arguments: argparse.Namespace) -> Output:
        return Output(arguments.output, self.files)

    def _where(self, texts: list[str]) -> Where | None:
        if not texts:
            return None
        from .reading.where import Where

        return Where(texts, self.plans.only(self.messages))

    def _registers(self) -> RegisterNotes | None:
        """Return what to say of registers, where a protocol has any."""
        variants = [variant for variants in self.variants.values() for variant in variants]
        if not any(variant.protocol.register_maps for variant in variants):
            return None
        from .registers import RegisterNotes

        return RegisterNotes(variants)

    def _writer(self, arguments: argparse.Namespace) -> Writer:
        form = line_format(arguments.output, arguments.format)
        stated = self.direction if self.direction != "both" else None
        if form == "jsonl":
            from .output.jsonl import JsonLines

            return self._safe(JsonLines(self.plans, stated), "\\u{:04x}")
        if form == "csv":
            from .output.csv import CsvOutput

            only = next(iter(self.messages)) if len(self.messages) == 1 else None
            links = frozenset(link for link, variants in self.variants.items() if variants)
            return self._safe(CsvOutput(self.plans, stated, only=only, links=links), "\\x{:02x}")
        from .output.text import TextOutput, Times, make_paint, no_paint

        is_terminal = self.output.is_terminal
        return TextOutput(
            self.plans,
            stated,
            notes=self.registers,
            times=Times(arguments.time),
            paint=make_paint() if wants_colour(arguments.color, is_terminal) else no_paint,
            width=terminal_width() if is_terminal else None,
            encoding=self.output.encoding,
        )

    def _safe(self, writer: Writer, spelling: str) -> Writer:
        """Return a writer that a terminal may show: control characters of payloads are spelt out there, never in files."""
        if not self.output.is_terminal:
            return writer
        from .output import SpeltOut

        return SpeltOut(writer, spelling)

    # ------------------------------------------------------------------ running

    def _opened(self, capture: CanRecording | SerialRecording) -> None:
        self.pending = (utf8(capture.name), capture.link)

    def _done(self) -> None:
        self._begin(None)

    def _finish(self, *, is_whole: bool) -> None:
        self.output.close()

    def _clean_up(self) -> None:
        """Close the output, however the run has ended, and report what could not be written."""
        try:
            self.output.close()
        except BrokenPipeError:
            abandon_stdout()
        except CallerError as error:
            if str(error) != self.complaint:
                self._complain(str(error))
        except KeyboardInterrupt:  # the reader takes no more
            abandon_stdout()
            self._complain(f"{self.output.path or 'standard output'}: interrupted before all was written")

    def _flush(self) -> None:
        with suppress(CallerError, BrokenPipeError):  # met again by the next write
            self.output.flush()

    def _scanner(self, link: Link, direction: Direction | None) -> Scanner:
        if (link, direction) not in self.scanners:
            if link == "serial":
                check_direction(self.variants["serial"], direction)
            self.scanners[link, direction] = make_scanner(
                self.variants[link], direction=direction, include_unknown=True
            )
        return self.scanners[link, direction]

    def _can(self, capture: CanRecording, totals: Totals, patience: Patience) -> None:
        scanner: Scanner = self._scanner("can", self.direction)
        scanner.reset()
        try:
            for frames in patience.each(capture.batches(BATCH if self.count is None else 1)):
                self._frames(scanner, frames, totals)
                self._after(capture)
                if self.is_done:
                    break
            left = scanner.close()
            self._take(left, map(_frame_of, left), totals)
        finally:
            totals.count(scanner.counts)

    def _frames(self, scanner: Any, frames: list[Frame], totals: Totals) -> None:
        """Decode frames that follow each other, one or more."""
        items = scanner.feed(frames)
        if scanner.has_transports:  # the first item may be of a later frame, or of an earlier one
            self._begin_at(frames[0].timestamp)
        else:
            self._begin(items[0])
        if scanner.contested and not self.is_warned:
            self._warn_of(scanner.contested, items)
        if self.absent:
            self._seen({str(frame.channel) for frame in frames})
        self._take(items, map(_frame_of, items) if scanner.has_transports else frames, totals)

    def _take(self, items: list[Record], frames: Iterable[Frame], totals: Totals) -> None:
        """Take items of frames; with transports an item may be of several frames, or of an earlier one."""
        passed = self._in_window(items)
        if self.filter is not None:
            seen = map(self.filter.matches, frames)
            passed = [ok and found for ok, found in zip(passed or repeat(True), seen, strict=False)]
        self._explain_first(items, is_can=True)
        self._emit(self._kept(items, passed, totals, is_can=True), totals, is_can=True)

    def _stream_scanner(self, direction: Direction | None) -> Any:
        scanner: Scanner = self._scanner("serial", direction)
        scanner.reset()
        return scanner

    def _feed(self, scanner: Any, data: bytes, time: float | None) -> Any:
        return scanner.feed(data, time)

    def _found(self, items: Any, totals: Totals) -> None:
        self._explain_first(items, is_can=False)
        self._emit(self._kept(items, self._in_window(items), totals, is_can=False), totals, is_can=False)

    def _explain_first(self, items: Sequence[Record], *, is_can: bool) -> None:
        """Say of the first item with the head of a message, but not its contents, what is another in it."""
        for item in items if self.to_explain else ():
            if type(item) is not Unknown or item.reason != "unknown":
                continue
            self.to_explain -= 1
            meta = item.meta
            direction: Any = self.direction or meta.direction
            from aces_bus.protocol.explain import why_unknown

            why = why_unknown(item, self.variants["can" if is_can else "serial"], direction=direction)
            if why:
                self.to_explain = 0
                place = f"frame {meta.identifier:03X}" if is_can else f"packet at offset {meta.offset}"
                say_note(f"unknown, though its head is right: {place}. {why} (more: aces spec explain)")
            if not self.to_explain:
                return

    def _begin(self, first: Any) -> None:
        """Tell the writer that a source begins, once its first item is known, or that there is none."""
        self._begin_at(None if first is None else first.meta.time)

    def _begin_at(self, time: float | None) -> None:
        """Begin the pending file, with the time that relative times count from."""
        if self.pending is not None:
            source, link = self.pending
            self.pending = None
            self.output.write(self.writer.begin(source, link, time))

    def _after(self, capture: Recording, frames: int = 0) -> None:
        if capture.live or self.output.is_terminal:
            self.output.flush()
        if capture.live:
            self._problems(capture)

    # ------------------------------------------------------------------ items

    def _in_window(self, items: list[Record]) -> list[bool] | None:
        """Return which items --from and --to let pass; None: all."""
        if self.window is None or not items:
            return None
        import numpy as np

        instants = (to_ns(i.meta.time if type(i) is Unknown else i._time) for i in items)
        passed: list[bool] = self.window.inside(np.fromiter(instants, np.int64, len(items))).tolist()
        return passed

    def _kept(
        self, items: list[Any], passed: list[bool] | None, totals: Totals, *, is_can: bool
    ) -> list[Any]:
        """Return the items that pass; the others go into the bin `filtered`."""
        if passed is None or all(passed):
            return items
        for item in (item for item, is_kept in zip(items, passed, strict=True) if not is_kept):
            self._reject(item, max(1, len(item.meta.frames)) if is_can else item.meta.size, totals)
        return [item for item, is_kept in zip(items, passed, strict=True) if is_kept]

    def _emit(self, items: list[Record], totals: Totals, *, is_can: bool) -> None:
        """Write what is to be shown; what --message and --where refuse goes into the bin `filtered`."""
        if items:
            self._begin(items[0])
        if self.registers is not None:
            self.registers.see(items)
        if self.is_selective:
            wanted = [type(item) is Unknown or self._is_wanted(item) for item in items]
            items = self._kept(items, wanted, totals, is_can=is_can)
        if not (self.shows_records and self.shows_losses):
            items = [
                item for item in items if (self.shows_losses if type(item) is Unknown else self.shows_records)
            ]
        if items and (self.count is not None or not self.is_quiet or self.is_watched):
            self._show(items)

    @property
    def is_done(self) -> bool:
        return self.count is not None and self.printed >= self.count

    def _show(self, items: list[Record]) -> None:
        """Write items that are to be shown, up to `--count`."""
        if self.count is not None:
            items = items[: self.count - self.printed]
        self.printed += len(items)
        if not self.is_quiet:
            self.output.write(self.writer.items(items))

    def _is_wanted(self, record: Record) -> bool:
        if self.messages and type(record).__name__ not in self.messages:
            return False
        return self.where is None or self.where.holds(record)

    @staticmethod
    def _reject(item: Any, size: int, totals: Totals) -> None:
        """Move an item from its bin to `filtered`."""
        totals.add("filtered", size)
        if type(item) is Unknown:
            totals.add(item.kind, -size)
        else:
            totals.add("decoded", -size)
            totals.add("records", -1)

    def _warn_of(self, contested: Mapping[int, tuple[str, str]], items: Iterable[Any]) -> None:
        """Warn when one of the items is of an identifier that two protocols claim."""
        for item in items:
            meta = item.meta
            key = key_of(meta.identifier, extended=meta.extended, remote=meta.remote, fd=meta.fd)
            if key in contested and type(item) is not Unknown:
                self._warn(contested, key, meta.identifier)
                return


def _frame_of(item: Any) -> Frame:
    """Return a frame with the identifier and channel of an item, for filters."""
    meta = item.meta
    return Frame(
        meta.identifier,
        channel=meta.channel,
        is_extended_id=meta.extended,
        is_remote_frame=meta.remote,
        is_error_frame=type(item) is Unknown and item.reason == "error frame",
    )
