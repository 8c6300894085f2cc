"""Decode recordings and live captures; say where every frame and byte went.

  aces decode walk.log -p hubo
  aces decode session.bin -p robotis --direction from
  candump can0 | aces decode -p hubo -
  aces decode walk.log -p hubo --message Encoder --where board=3 -o encoder.csv

A FILE is a candump log, the hex dump of the vendor's serial monitor, or raw
serial bytes; `-` is standard input. What it is, its content says. With
protocols of several links, each file goes to those of its own.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from aces_bus.capture import CanCapture, CanFilter, Capture, SerialCapture, open_capture, parse_filter
from aces_bus.errors import CallerError, CaptureError, UnknownNameError
from aces_bus.protocol import CanScanner, Scanner, StreamScanner, Unknown, Variant, make_scanner
from aces_bus.protocol.keys import key_of

from .console import Output, Patience, abandon_stdout, say, terminal_width, wants_colour
from .output import Writer
from .output.shape import plans_of
from .protocols_arg import parse_protocols
from .where import Where

Format = Literal["text", "jsonl", "csv"]
Link = Literal["can", "serial"]
Direction = Literal["to device", "from device", "both"]

DIRECTIONS: Mapping[str | None, Direction | None] = {
    "to": "to device",
    "from": "from device",
    "both": "both",
    None: None,
}
SUFFIXES: Mapping[str, Format] = {".jsonl": "jsonl", ".ndjson": "jsonl", ".csv": "csv"}
#: Unreadable lines that are shown, of each file.
SHOWN = 3
BATCH = 1024

EPILOG = """\
protocols (-p):
  hubo                an installed protocol; `aces protocols` lists them
  hubo:D08            in one of its dialects
  hubo@drc_hubo       with one of its configurations; also hubo:D08@hubo2
  hubo@robot.toml     with your own: tables such as [channels] with lines such
                      as 0x00 = 2; base = "NAME" on top changes a shipped one
  my_spec.py[:NAME]   declared in a Python file. It is executed with your
                      rights: name only what you trust

conditions (--where):
  board=3  position.1<0  servos.id=3  mode=torque  error=overload  data=0a00
  temperature=none  meta.time>12.5
  Fields are named as they are printed. `position>100` holds when any of
  several positions does. Several conditions must all hold. Put < and > in
  quotes: the shell takes them otherwise.

formats:
  text    for people: times count from the first item of a file; on a terminal
          coloured, and folded to its width
  jsonl   one JSON object a line; numbers in the sheet's units, enumerations by
          name, flags as a list of names, bytes as hexadecimal, NaN as null
  csv     with one --message: one row a record, one column a field; otherwise
          one row a value (field, value, unit)

summary (last on stderr, one line a kind of link; the parts sum to the total):
  frames = decoded + unknown + malformed + filtered + errors           (CAN)
  bytes = decoded + unknown + malformed + skipped + filtered + pending (streams)
  filtered: refused by --filter; or decoded, and refused by --message or
  --where. Filters apply after recognition, so that a reply is told by its
  request even where the request is not shown.

exit status:
  0    also after Ctrl-C where the input was live
  1    --strict, and anything was unknown, malformed, skipped, pending or
       unreadable
  2    a wrong call, or a file that cannot be read (the others are decoded)
  130  after Ctrl-C
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = EPILOG
    add = parser.add_argument
    add("files", nargs="+", metavar="FILE", help="a recording, or - for standard input")
    add(
        "-p",
        "--protocol",
        action="append",
        required=True,
        metavar="PROTOCOL",
        help="may be given several times; the first wins",
    )
    add(
        "--direction",
        choices=["to", "from", "both"],
        help="which way the bytes of a raw file went: to or from the device; both pairs requests and replies",
    )
    add("--format", choices=get_args(Format), help="default: by the suffix of --output, else text")
    add("--output", "-o", metavar="FILE", help="write there instead of standard output")
    add(
        "--filter",
        action="append",
        default=[],
        metavar="FILTER",
        help="CAN: candump's filters, such as 060:7F0 or can0,150~7FF",
    )
    add(
        "--message",
        action="append",
        default=[],
        metavar="NAME",
        help="only these messages; may be given several times",
    )
    add(
        "--where",
        action="append",
        default=[],
        metavar="CONDITION",
        help="only records such as field=value; see below",
    )
    add(
        "--unknown",
        choices=["show", "hide", "only"],
        help="print what is not decoded (default: show; hide with --message or --where)",
    )
    add("-q", "--quiet", action="store_true", help="print no records, only the summary")
    add(
        "--strict",
        action="store_true",
        help="exit 1 when anything was unknown, malformed, skipped, pending or unreadable",
    )
    add("--time", choices=["relative", "absolute"], default="relative", help="of text (default: relative)")
    add(
        "--color",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="colour, also where the output is no terminal; or never",
    )


def run(arguments: argparse.Namespace) -> int:
    return Decoding(arguments).run()


@dataclass
class Totals:
    """The bins of one kind of link, over all files."""

    bins: dict[str, int] = field(default_factory=dict)
    lines_unreadable: int = 0
    missed: int = 0
    dropped: int = 0

    def add(self, name: str, number: int) -> None:
        self.bins[name] = self.bins.get(name, 0) + number

    def __getitem__(self, name: str) -> int:
        return self.bins.get(name, 0)

    def line(self, link: Link) -> str:
        """The summary line."""
        if link == "can":
            names = ("decoded", "unknown", "malformed", "filtered", "errors")
            parts = [
                f"frames={self['total']}",
                *(f"{n}={self[n]}" for n in names),
                f"lines_unreadable={self.lines_unreadable}",
            ]
            return " ".join(parts)
        bins = ("decoded", "unknown", "malformed", "skipped", "filtered", "pending", "records")
        text = " ".join([f"bytes={self['total']}", *(f"{n}={self[n]}" for n in bins)])
        return f"{text} lines_unreadable={self.lines_unreadable}" if self.lines_unreadable else text

    @property
    def faults(self) -> list[str]:
        """What --strict does not allow."""
        found = [f"{self[n]} {n}" for n in ("unknown", "malformed", "skipped", "pending") if self[n]]
        if self.lines_unreadable:
            found.append(f"{self.lines_unreadable} unreadable line{'s' if self.lines_unreadable > 1 else ''}")
        return found


class Decoding:
    """One run of `aces decode`. A wrong call raises before anything is read."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.files: list[str] = arguments.files
        self.direction: Direction | None = DIRECTIONS[arguments.direction]
        self.variants: dict[Link, list[Variant]] = {"can": [], "serial": []}
        variants = parse_protocols(arguments.protocol)
        for variant in variants:
            self.variants["can" if variant.link == "can" else "serial"].append(variant)
        self.plans = plans_of(variants)
        self.filter = self._filter(arguments.filter)
        self.messages = self._messages(arguments.message)
        self.where = Where(arguments.where, self.plans) if arguments.where else None
        self.is_selective = bool(self.messages) or self.where is not None
        show = arguments.unknown or ("hide" if self.is_selective else "show")
        self.shows_records = show != "only" and not arguments.quiet
        self.shows_losses = show != "hide" and not arguments.quiet
        self.scanners: dict[tuple[Link, Direction | None], Scanner] = {}
        self.totals: dict[Link, Totals] = {}
        self.status = 0
        self.is_warned = False
        #: Interfaces that --filter names; those that occurred are taken out.
        self.absent = (
            {one.interface for one in self.filter.sets if one.interface} if self.filter is not None else set()
        )
        #: All that occurred, while one is missing.
        self.present: set[str] = set()
        #: The source that the writer has not been told of yet.
        self.pending: tuple[str, Link] | None = None
        #: Unreadable lines of this file that have been named.
        self.shown = 0
        self.output = Output(arguments.output, self.files)
        self.writer = self._writer(arguments)

    def _filter(self, texts: list[str]) -> CanFilter | None:
        if texts and not self.variants["can"]:
            raise CallerError("--filter is for CAN frames, and no protocol given with -p is for CAN")
        return parse_filter(*texts) if texts else None

    def _messages(self, texts: list[str]) -> frozenset[str]:
        known = {kind.__name__ for kind in self.plans}
        wanted = [name.strip() for text in texts for name in text.split(",")]
        for name in wanted:
            if name not in known:
                raise UnknownNameError("message", name, known)
        return frozenset(wanted)

    def _writer(self, arguments: argparse.Namespace) -> Writer:
        path: str = arguments.output or ""
        form: Format = arguments.format or SUFFIXES.get(os.path.splitext(path)[1].lower(), "text")
        stated = self.direction if self.direction != "both" else None
        if form == "jsonl":
            from .output.jsonl import JsonLines

            return JsonLines(self.plans, stated)
        if form == "csv":
            from .output.sheet import Sheet

            only = next(iter(self.messages)) if len(self.messages) == 1 else None
            links = frozenset(link for link, variants in self.variants.items() if variants)
            return Sheet(self.plans, stated, only=only, links=links)
        from .output.text import Text, make_paint, no_paint

        is_terminal = self.output.is_terminal
        return Text(
            self.plans,
            stated,
            paint=make_paint() if wants_colour(arguments.color, is_terminal) else no_paint,
            width=terminal_width() if is_terminal else None,
            is_relative=arguments.time == "relative",
            encoding=self.output.encoding,
        )

    # ------------------------------------------------------------------ running

    def run(self) -> int:
        was_live = False
        with Patience() as patience:
            try:
                for name in self.files:
                    if patience.is_over:
                        break
                    was_live = self._file(name, patience)
                self.output.close()
            except BrokenPipeError:
                abandon_stdout()
            except KeyboardInterrupt:
                patience.is_over = True
            except CallerError as error:  # the output, or a call that only shows itself wrong while decoding
                self._complain(str(error))
            self._summarise()
        if patience.is_over and not was_live and not self.status:
            return 130
        return self.status

    def _complain(self, message: str) -> None:
        self.status = 2
        self._flush()
        say(message)

    def _file(self, name: str, patience: Patience) -> bool:
        """Decode one file; whether it was live. What is wrong with it is said, and the others are decoded."""
        try:
            capture = self._open(name, patience)
        except CaptureError as error:
            self._complain(str(error))
            return False
        except KeyboardInterrupt:
            patience.is_over = True
            return name == "-"
        with capture:
            self.shown = 0
            totals = self.totals.setdefault(capture.link, Totals())
            self.pending = (_utf8(capture.name), capture.link)
            try:
                if isinstance(capture, CanCapture):
                    self._can(capture, totals, patience)
                else:
                    self._serial(capture, totals, patience)
                self._begin(None)
            except CaptureError as error:
                self._complain(str(error))
            finally:
                self._problems(capture)
                if capture.lines_unreadable > SHOWN:
                    say(f"{capture.name}: and {capture.lines_unreadable - SHOWN} more unreadable lines")
                totals.lines_unreadable += capture.lines_unreadable
                if isinstance(capture, CanCapture):
                    totals.dropped += capture.frames_dropped
            return capture.live

    def _open(self, name: str, patience: Patience) -> CanCapture | SerialCapture:
        links: list[Link] = [link for link, variants in self.variants.items() if variants]
        with patience.waiting():  # for the first bytes of a pipe
            if len(links) == 1:
                return open_capture(name, link=links[0])
            try:
                return open_capture(name)
            except CaptureError:
                if name == "-" or not os.path.isfile(name):
                    raise
                return open_capture(name, link="serial")  # none of the formats that say what they are

    def _scanner(self, link: Link, direction: Direction | None) -> Scanner:
        if (link, direction) not in self.scanners:
            for variant in self.variants[link] if link == "serial" and direction is None else ():
                clash = variant.needs_direction
                if clash is not None:
                    raise CallerError(
                        f"{variant.name}: bytes alone do not tell {clash[0].name} from {clash[1].name};"
                        " say which way they went: --direction to (to the device), from, or both"
                    )
            self.scanners[link, direction] = make_scanner(
                self.variants[link], direction=direction, everything=True
            )
        return self.scanners[link, direction]

    def _can(self, capture: CanCapture, totals: Totals, patience: Patience) -> None:
        scanner = self._scanner("can", self.direction)
        assert isinstance(scanner, CanScanner)
        scanner.reset()
        try:
            for frames in patience.each(capture.batches(BATCH)):
                items = scanner.feed(frames)
                self._begin(items[0])
                if scanner.contested and not self.is_warned:
                    self._warn(scanner, items)
                if self.absent:
                    channels = {str(frame.channel) for frame in frames}
                    self.present |= channels
                    self.absent -= channels
                if self.filter is not None:
                    matches = self.filter.matches
                    kept = [item for frame, item in zip(frames, items, strict=True) if matches(frame)]
                    if len(kept) < len(items):
                        for frame, item in zip(frames, items, strict=True):
                            if not matches(frame):
                                self._reject(item, 1, totals)
                    items = kept
                self._emit(items, totals, is_can=True)
                self._after_batch(capture)
        finally:
            self._count(scanner, totals)

    def _serial(self, capture: SerialCapture, totals: Totals, patience: Patience) -> None:
        used: dict[Direction | None, StreamScanner] = {}
        try:
            for chunk in patience.each(capture):
                direction: Direction | None = self.direction or chunk.direction
                if direction not in used:
                    scanner = self._scanner("serial", direction)
                    assert isinstance(scanner, StreamScanner)
                    scanner.reset()
                    used[direction] = scanner
                self._emit(used[direction].feed(chunk.data, chunk.time), totals, is_can=False)
                self._after_batch(capture)
            for scanner in used.values():
                self._emit(scanner.close(), totals, is_can=False)
        finally:
            for scanner in used.values():
                self._count(scanner, totals)

    def _begin(self, first: Any) -> None:
        """Tell the writer that a source begins, once its first item is known, or that there is none."""
        if self.pending is not None:
            source, link = self.pending
            self.pending = None
            self.output.write(self.writer.begin(source, link, None if first is None else first.meta.time))

    def _after_batch(self, capture: Capture) -> None:
        if capture.live or self.output.is_terminal:
            self.output.flush()
        if capture.live:
            self._problems(capture)

    # ------------------------------------------------------------------ items

    def _emit(self, items: list[Any], totals: Totals, *, is_can: bool) -> None:
        """Write what is to be shown; what --message and --where refuse goes into the bin `filtered`."""
        if items:
            self._begin(items[0])
        if self.is_selective:
            kept = []
            for item in items:
                if type(item) is Unknown or self._is_wanted(item):
                    kept.append(item)
                else:
                    self._reject(item, 1 if is_can else item.meta.size, totals)
            items = kept
        if not (self.shows_records and self.shows_losses):
            items = [
                item for item in items if (self.shows_losses if type(item) is Unknown else self.shows_records)
            ]
        if items:
            self.output.write(self.writer.items(items))

    def _is_wanted(self, record: Any) -> bool:
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

    @staticmethod
    def _count(scanner: Scanner, totals: Totals) -> None:
        counts = scanner.counts
        for name in ("total", "decoded", "unknown", "malformed", "skipped", "errors", "pending", "records"):
            totals.add(name, getattr(counts, name))
        totals.missed += counts.missed

    def _warn(self, scanner: CanScanner, items: Iterable[Any]) -> None:
        """Two protocols claim a frame that has come: say so, once."""
        for item in items:
            meta = item.meta
            key = key_of(meta.identifier, extended=meta.extended, remote=meta.remote, fd=meta.fd)
            if key in scanner.contested and type(item) is not Unknown:
                first, other = scanner.contested[key]
                say(
                    f"{first} and {other} both claim identifier {meta.identifier:#05x}"
                    f" ({len(scanner.contested)} in all); the one that -p names first is tried first"
                )
                self.is_warned = True
                return

    # ------------------------------------------------------------------ what goes to stderr

    def _problems(self, capture: Capture) -> None:
        """Name the first unreadable lines, each once; those of live sources as they come."""
        for problem in capture.problems[self.shown : SHOWN]:
            self.shown += 1
            self._flush()
            say(f"{capture.name}:{problem.line}: {problem.reason}: {problem.excerpt!r}")

    def _flush(self) -> None:
        """What has been written stands before what is said about it."""
        try:
            self.output.flush()
        except (CallerError, BrokenPipeError):
            pass  # met again by the next write

    def _summarise(self) -> None:
        totals: dict[Link, Totals] = self.totals
        if not totals:
            totals = {link: Totals() for link, variants in self.variants.items() if variants}
        for name in sorted(self.absent) if self.present else ():
            say(f"--filter: no frame came from {name!r} (there are: {', '.join(sorted(self.present))})")
        for total in totals.values():
            if total.dropped:
                say(f"the recorder says that it lost {total.dropped} frames")
            if total.missed:
                say(f"rolling counters say that {total.missed} messages are missing")
            if total["total"] and not total["decoded"] and not total["filtered"]:
                say("nothing was decoded: is this the right protocol, dialect, configuration and direction?")
        faults = [fault for total in totals.values() for fault in total.faults]
        if self.arguments.strict and faults:
            say(f"--strict: {', '.join(faults)}")
            self.status = self.status or 1
        for link, total in totals.items():
            say(total.line(link), who="")


def _utf8(name: str) -> str:
    """A file's name as JSON and terminals take it."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
