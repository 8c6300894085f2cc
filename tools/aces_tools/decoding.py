"""What both ways of `aces decode` share: the files and their links, the bins, what goes to stderr, the exit status.

1. A wrong call raises before anything is read.
2. Which way values take (one by one, or in columns) changes nothing that is counted or said.
"""

from __future__ import annotations

import argparse
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from aces_bus import open_recording
from aces_bus.errors import CallerError, CaptureError, UnknownNameError
from aces_bus.frame_table import to_ns
from aces_bus.protocol import Variant
from aces_bus.protocol.live.scanner import Scanner
from aces_bus.recordings.base import CanRecording, Link, Recording, SerialRecording
from aces_bus.recordings.filters import CanFilter, parse_filter

from .console import abandon_stdout, counted, report_unreadable, say, say_note
from .output.shape import Plans, plans_of
from .patience import Patience
from .protocols_arg import parse_protocols
from .reading.pieces import CaptureReading, Direction, SerialWays, open_any
from .reading.totals import Totals
from .reading.window import TimeWindow

#: Bytes of the beginnings of streams that are kept.
_SAMPLE = 65_536
#: Options that leave something out, by the names of their arguments.
FILTERS = (
    ("start", "--from"),
    ("stop", "--to"),
    ("filter", "--filter"),
    ("message", "--message"),
    ("where", "--where"),
    ("signals", "--signals"),
)


def named_messages(texts: Sequence[str], plans: Plans) -> frozenset[str]:
    """Return the messages of these names, which may be in any case, with `*` and `?`. Raises `UnknownNameError`."""
    known, found = plans.names, set[str]()
    for name in (name.strip() for text in texts for name in text.split(",")):
        fits = [name] if name in known else [k for k in known if fnmatchcase(k.lower(), name.lower())]
        if not fits:
            raise UnknownNameError("message", name, known)
        found.update(fits)
    return frozenset(found)


class Decoding(ABC):
    """One run of `aces decode`."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.files: list[str] = arguments.files
        self.direction: Direction | None = arguments.direction
        self.variants: dict[Link, list[Variant]] = {"can": [], "serial": []}
        variants = parse_protocols(arguments.protocol)
        for variant in variants:
            self.variants["can" if variant.link == "can" else "serial"].append(variant)
        self.plans = plans_of(variants)
        self.filter = self._filter(arguments.filter)
        self.messages = self._messages(arguments.message)
        self.window = TimeWindow.parse(arguments.start, arguments.stop)
        self.totals: dict[Link, Totals] = {}
        self.status = 0
        #: Whether it has been said that two protocols claim one frame.
        self.is_warned = False
        #: Channels that -p and --filter name; those that occurred are taken out.
        self.bound = {variant.channel for variant in variants if variant.channel is not None}
        named = self.filter.sets if self.filter is not None else ()
        self.absent = self.bound | {wanted.interface for wanted in named if wanted.interface}
        #: All that occurred, while one is missing.
        self.present: set[str] = set()
        #: Ctrl-C ended the work before its end.
        self.interrupted = False
        #: What was last said to be wrong.
        self.complaint = ""
        #: The first bytes of streams: what they lack may say why nothing was decoded.
        self.sample = b""
        #: Unreadable lines of this file that have been named.
        self.shown = 0

    def _filter(self, texts: list[str]) -> CanFilter | None:
        if texts and not self.variants["can"]:
            raise CallerError("--filter is for CAN frames, and no protocol given with -p is for CAN")
        return parse_filter(*texts) if texts else None

    def _messages(self, texts: list[str]) -> frozenset[str]:
        return named_messages(texts, self.plans)

    # ------------------------------------------------------------------ what a way does

    @abstractmethod
    def _can(self, capture: CanRecording, totals: Totals, patience: Patience) -> None:
        """Decode frames, and count them whatever happens."""

    def _serial(self, capture: SerialRecording, totals: Totals, patience: Patience) -> None:
        """Decode bytes, each direction as a stream of its own, and count them whatever happens."""
        ways = SerialWays(self.variants["serial"], self.direction, self._stream_scanner, self._feed)
        reading = CaptureReading(patience.each(ways.chunks(capture)))
        try:
            for chunk in reading:
                if chunk.data:
                    self._see(to_ns(chunk.time))
                    self.sample += chunk.data[: _SAMPLE - len(self.sample)]
                for items in ways.feed(chunk):
                    self._found(items, totals)
                self._after(capture)
                if chunk.data and self.is_done:
                    break
            for items in ways.close():
                self._found(items, totals)
            reading.check()
        finally:
            for counts in ways.counts:
                totals.count(counts)

    def _see(self, instant: int) -> None:
        """Note the instant (ns) of bytes that are about to be decoded."""
        if self.window is not None:
            self.window.see(instant)

    @abstractmethod
    def _stream_scanner(self, direction: Direction | None) -> Any:
        """Return a scanner for the bytes of one direction."""

    @abstractmethod
    def _feed(self, scanner: Scanner, data: bytes, time: float | None) -> Any:
        """Give a scanner bytes; return what it makes of them."""

    @abstractmethod
    def _found(self, items: Any, totals: Totals) -> None:
        """Take what a scanner of bytes has found."""

    @abstractmethod
    def _after(self, capture: Recording, frames: int = 0) -> None:
        """Note that a piece of a recording with `frames` frames has been decoded."""

    def _opened(self, capture: CanRecording | SerialRecording) -> None:  # noqa: B027 - a way may have nothing to do
        """Note that a file is about to be decoded."""

    def _done(self) -> None:  # noqa: B027
        """Note that a file has been decoded."""

    @abstractmethod
    def _finish(self, *, is_whole: bool) -> None:
        """End: all files have been decoded; `is_whole` unless Ctrl-C ended one that would have ended by itself."""

    @abstractmethod
    def _flush(self) -> None:
        """Flush what has been written before a message about it is printed. Must not raise."""

    def _clean_up(self) -> None:  # noqa: B027
        """Release everything at the end of the run, whether it failed or not."""

    # ------------------------------------------------------------------ running

    def run(self) -> int:
        was_live = False
        with Patience() as patience:
            try:
                for name in self.files:
                    if patience.is_over or self.is_done:
                        break
                    was_live = self._file(name, patience)
                self._finish(is_whole=was_live or not patience.is_over)
            except BrokenPipeError:
                abandon_stdout()
            except KeyboardInterrupt:
                patience.is_over = self.interrupted = True
            except CallerError as error:  # the output, or a call that only shows itself wrong while decoding
                self._complain(str(error))
            finally:
                self._clean_up()
            self._summarise()
        return 130 if patience.is_over and not was_live and not self.status else self.status

    @property
    def is_done(self) -> bool:
        """True once everything that was asked for has been shown."""
        return False

    def _complain(self, message: str) -> None:
        self.status, self.complaint = 2, message
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
            if self.window is not None:
                self.window.begin()
            totals = self.totals.setdefault(capture.link, Totals())
            before = totals["total"]
            self._opened(capture)
            try:
                if isinstance(capture, CanRecording):
                    self._can(capture, totals, patience)
                else:
                    self._serial(capture, totals, patience)
                self._done()
                if totals["total"] == before and not capture.live and not patience.is_over:
                    say(f"{capture.name}: holds no {'frames' if capture.link == 'can' else 'bytes'}")
            except CaptureError as error:
                self._complain(str(error))
            finally:
                self._problems(capture, is_over=True)
                if capture.others:
                    kinds = ", ".join(f"{number} {kind}" for kind, number in capture.others.items())
                    say_note(f"{capture.name}: beside its frames it holds {kinds}")
                totals.lines_unreadable += capture.lines_unreadable
                if isinstance(capture, CanRecording):
                    totals.dropped += capture.frames_dropped
            return capture.live

    def _open(self, name: str, patience: Patience) -> CanRecording | SerialRecording:
        links: list[Link] = [link for link, variants in self.variants.items() if variants]
        with patience.waiting():  # for the first bytes of a pipe
            if len(links) == 1:
                return open_recording(name, link=links[0])
            return open_any(name)

    def _seen(self, channels: set[str]) -> None:
        """Note that these interfaces have occurred."""
        self.present |= channels
        self.absent -= channels

    # ------------------------------------------------------------------ what goes to stderr

    def _problems(self, capture: Recording, *, is_over: bool = False) -> None:
        """Name the first unreadable lines, each once; those of live sources as they come."""
        if capture.lines_unreadable > self.shown:
            self._flush()
            self.shown = report_unreadable(capture, self.shown, is_over=is_over)

    def _warn(self, contested: Mapping[int, tuple[str, str]], key: int, identifier: int) -> None:
        """Say once that two protocols claim a frame."""
        first, other = contested[key]
        say(
            f"{first} and {other} both claim identifier {identifier:#05x}"
            f" ({len(contested)} in all); the one that -p names first is tried first"
        )
        self.is_warned = True

    def _summarise(self) -> None:
        totals: dict[Link, Totals] = self.totals
        if not totals and self.status:
            return  # no file could be opened: what is wrong was said, and there is nothing to count
        if not totals:
            totals = {link: Totals() for link, variants in self.variants.items() if variants}
        there = ", ".join(sorted(self.present - {"None"})) or "none with a name"
        for name in sorted(self.absent) if self.present else ():
            option = "-p" if name in self.bound else "--filter"
            say(f"{option}: no frame came from {name!r} (there are: {there})")
        if self.window is not None and self.window.untimed:
            say(f"--from and --to need times: {self.window.untimed} items have none, and are filtered")
        is_unclear = self.direction is None and "can" in totals and totals["can"]["unknown"]
        for variant in self.variants["can"] if is_unclear else ():
            for message, other in variant.direction_conflicts:
                say(
                    f"{variant.name}: {message.name} and {other.name} differ by direction alone, and are unknown:"
                    " give --direction to|from|both"
                )
        for link, total in totals.items():
            if total.dropped:
                say(f"the recorder says that it lost {counted(total.dropped, 'frame')}")
            if total.missed:
                are = "is" if total.missed == 1 else "are"
                say(f"rolling counters say that {counted(total.missed, 'message')} {are} missing")
            if not self.plans or not total["total"] or total["decoded"]:
                continue
            if not total["filtered"]:
                asked = "is this the right protocol, dialect, configuration and direction?"
                say(f"nothing was decoded: {asked}{self._half_end() if link == 'serial' else ''}")
            elif given := [option for name, option in FILTERS if getattr(self.arguments, name, None)]:
                say(f"nothing that was decoded passed {', '.join(given)}")
        faults = [fault for total in totals.values() for fault in total.faults]
        if self.arguments.strict and faults:
            say(f"--strict: {', '.join(faults)}")
            self.status = self.status or 1
        for link, total in totals.items():
            say(self._summary(link, total), who="")

    def _half_end(self) -> str:
        """Say that packets have only the last byte of their end: a text whose CR LF became LF; "" where that is not so."""
        for variant in self.variants["serial"]:
            framings = {message.framing for message in variant.messages.values() if message.framing}
            for end in {framing.end for framing in framings if not framing.short_end}:
                if len(end) > 1 and end not in self.sample and (count := self.sample.count(end[-1:])):
                    return (
                        f" Packets of {variant.name} end with {end.hex(' ').upper()}, and here is {end[-1:].hex().upper()}"
                        f" {count} times without {end[:-1].hex(' ').upper()} before it"
                        + (" (unix2dos puts it back)" if end == b"\r\n" else "")
                    )
        return ""

    def _summary(self, link: Link, total: Totals) -> str:
        """Return the last line of a kind of link."""
        return total.line(link)


def utf8(name: str) -> str:
    """Return a file's name as JSON and terminals take it."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
