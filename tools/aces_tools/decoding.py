"""What both ways of `aces decode` share: the files and their links, the bins, what goes to stderr, the exit status.

1. A wrong call raises before anything is read.
2. Which way values take (one by one, or in columns) changes nothing that is counted or said.
"""

from __future__ import annotations

import argparse
import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Generic, Literal, TypeVar

from aces_bus.errors import CallerError, CaptureError, UnknownNameError
from aces_bus.frame_table import to_ns
from aces_bus.protocol import ScanCounts, Variant, make_scanner
from aces_bus.recordings import (
    CanFilter,
    CanRecording,
    Recording,
    SerialRecording,
    open_recording,
    parse_filter,
)
from aces_bus.recordings.serial.raw import RawCapture
from aces_bus.recordings.window import TimeWindow

from .console import Patience, abandon_stdout, report_unreadable, say, say_note
from .output.shape import Plans, plans_of
from .protocols_arg import parse_protocols

T = TypeVar("T")
Link = Literal["can", "serial"]
Direction = Literal["to device", "from device", "both"]

#: Options that leave something out, by the names of their arguments.
FILTERS = (
    ("start", "--from"),
    ("stop", "--to"),
    ("filter", "--filter"),
    ("message", "--message"),
    ("where", "--where"),
    ("signals", "--signals"),
)


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

    def count(self, counts: ScanCounts) -> None:
        """Add what a scanner counted."""
        for name in (
            "total",
            "decoded",
            "control",
            "unknown",
            "malformed",
            "skipped",
            "errors",
            "pending",
            "records",
        ):
            self.add(name, getattr(counts, name))
        self.missed += counts.missed

    def line(self, link: Link) -> str:
        """The summary line."""
        if link == "can":
            names = ("decoded", "unknown", "malformed", "filtered", "errors")
            # Only transports have frames that steer, and frames of packets that are not whole.
            more = [f"{n}={self[n]}" for n in ("control", "pending") if self[n]]
            parts = [
                f"frames={self['total']}",
                *(f"{n}={self[n]}" for n in names),
                *more,
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


class CaptureReading(Generic[T]):
    """The items of a capture up to where reading fails: what has come is finished before `check` raises the failure."""

    def __init__(self, items: Iterable[T]) -> None:
        self._items = items
        self._failure: CaptureError | None = None

    def __iter__(self) -> Iterator[T]:
        try:
            yield from self._items
        except CaptureError as failure:
            self._failure = failure

    def check(self) -> None:
        """Raise what has failed, if anything has."""
        if self._failure is not None:
            raise self._failure


class Requests:
    """What went to the device, for decoding what came from it: where a capture says which way bytes went, each way is
    a stream of its own, and a reply may hang on a request of the other."""

    def __init__(self, variants: Sequence[Variant]) -> None:
        self._scanner: Any = None
        if any(map(has_requests, variants)):
            self._scanner = make_scanner(variants, direction="to device")

    def of(self, data: bytes, time: float | None) -> list[tuple[bytes, float | None]]:
        """The packets that these bytes complete, with their times."""
        if self._scanner is None:
            return []
        return [(record.meta.raw, record.meta.time) for record in self._scanner.feed(data, time)]


def open_any(name: str) -> CanRecording | SerialRecording:
    """A recording of either link; a file of none of the formats that say what they are is raw bytes."""
    try:
        return open_recording(name)
    except CaptureError:
        if name == "-" or not os.path.isfile(name):
            raise
        return open_recording(name, link="serial")


def has_requests(variant: Variant) -> bool:
    """Whether some message of the protocol hangs on another."""
    return any(message.reply_to or message.after for message in variant.messages.values())


def check_direction(variants: Sequence[Variant], direction: Direction | None) -> None:
    """Raise `CallerError` where bytes of a stream have two meanings unless their direction is known."""
    for variant in variants if direction is None else ():
        clash = variant.direction_conflict
        if clash is not None and variant.link != "can":
            raise CallerError(
                f"{variant.name}: bytes alone do not tell {clash[0].name} from {clash[1].name};"
                " say which way they went: --direction to (to the device), from, or both"
            )


def named_messages(texts: Sequence[str], plans: Plans) -> frozenset[str]:
    """The messages of these names, which may be in any case, with `*` and `?`. Raises `UnknownNameError`."""
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
        self.absent = self.bound | {one.interface for one in named if one.interface}
        #: All that occurred, while one is missing.
        self.present: set[str] = set()
        #: Ctrl-C ended the work before its end.
        self.interrupted = False
        #: What was last said to be wrong.
        self.complaint = ""
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
        used: dict[Direction | None, Any] = {}
        requests = Requests(self.variants["serial"])

        def scanner_of(direction: Direction | None) -> Any:
            if direction not in used:
                check_direction(self.variants["serial"], direction)
                used[direction] = self._stream_scanner(direction)
            return used[direction]

        def gap() -> float:
            return max(getattr(scanner, "gap", 0.0) for scanner in used.values())

        chunks = capture.with_silence(gap) if isinstance(capture, RawCapture) else capture
        reading = CaptureReading(patience.each(chunks))
        try:
            for chunk in reading:
                if not chunk.data:  # a live line is silent: nothing that is incomplete will go on
                    for one in used.values():
                        self._found(one.idle(), totals)
                    self._after(capture)
                    continue
                direction: Direction | None = self.direction or chunk.direction
                scanner = scanner_of(direction)
                if direction == "to device" and self.direction is None:
                    replies = scanner_of("from device")
                    for packet, time in requests.of(chunk.data, chunk.time):
                        self._found(replies.sent(packet, time) or [], totals)
                self._see(to_ns(chunk.time))
                self._found(self._feed(scanner, chunk.data, chunk.time), totals)
                self._after(capture)
                if self.is_done:
                    break
            for scanner in used.values():
                self._found(scanner.close(), totals)
            reading.check()
        finally:
            for scanner in used.values():
                totals.count(scanner.counts)

    def _see(self, instant: int) -> None:
        """Note the instant (ns) of bytes that are about to be decoded."""
        if self.window is not None:
            self.window.see(instant)

    @abstractmethod
    def _stream_scanner(self, direction: Direction | None) -> Any:
        """A scanner for the bytes of one direction."""

    @abstractmethod
    def _feed(self, scanner: Any, data: bytes, time: float | None) -> Any:
        """What a scanner makes of bytes."""

    @abstractmethod
    def _found(self, items: Any, totals: Totals) -> None:
        """Take what a scanner of bytes has found."""

    @abstractmethod
    def _after(self, capture: Recording, frames: int = 0) -> None:
        """A piece of a recording has been decoded, with so many frames."""

    def _opened(self, capture: CanRecording | SerialRecording) -> None:  # noqa: B027 - a way may have nothing to do
        """A file is about to be decoded."""

    def _done(self) -> None:  # noqa: B027
        """A file has been decoded."""

    @abstractmethod
    def _finish(self, *, is_whole: bool) -> None:
        """All files have been decoded; `is_whole` unless Ctrl-C ended one that would have ended by itself."""

    @abstractmethod
    def _flush(self) -> None:
        """Flush what has been written before a message about it is printed. Must not raise."""

    def _clean_up(self) -> None:  # noqa: B027
        """The run is over, whichever way."""

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
        """Whether all that is asked for has been shown."""
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
        """These interfaces have occurred."""
        self.present |= channels
        self.absent -= channels

    # ------------------------------------------------------------------ what goes to stderr

    def _problems(self, capture: Recording, *, is_over: bool = False) -> None:
        """Name the first unreadable lines, each once; those of live sources as they come."""
        if capture.lines_unreadable > self.shown:
            self._flush()
            self.shown = report_unreadable(capture, self.shown, is_over=is_over)

    def _warn(self, contested: Mapping[int, tuple[str, str]], key: int, identifier: int) -> None:
        """Two protocols claim a frame that has come: say so, once."""
        first, other = contested[key]
        say(
            f"{first} and {other} both claim identifier {identifier:#05x}"
            f" ({len(contested)} in all); the one that -p names first is tried first"
        )
        self.is_warned = True

    def _summarise(self) -> None:
        totals: dict[Link, Totals] = self.totals
        if not totals:
            totals = {link: Totals() for link, variants in self.variants.items() if variants}
        there = ", ".join(sorted(self.present - {"None"})) or "none with a name"
        for name in sorted(self.absent) if self.present else ():
            option = "-p" if name in self.bound else "--filter"
            say(f"{option}: no frame came from {name!r} (there are: {there})")
        if self.window is not None and self.window.untimed:
            say(f"--from and --to need times: {self.window.untimed} items have none, and are filtered")
        for total in totals.values():
            if total.dropped:
                say(f"the recorder says that it lost {total.dropped} frames")
            if total.missed:
                say(f"rolling counters say that {total.missed} messages are missing")
            if not self.plans or not total["total"] or total["decoded"]:
                continue
            if not total["filtered"]:
                say("nothing was decoded: is this the right protocol, dialect, configuration and direction?")
            elif given := [option for name, option in FILTERS if getattr(self.arguments, name, None)]:
                say(f"nothing that was decoded passed {', '.join(given)}")
        faults = [fault for total in totals.values() for fault in total.faults]
        if self.arguments.strict and faults:
            say(f"--strict: {', '.join(faults)}")
            self.status = self.status or 1
        for link, total in totals.items():
            say(self._summary(link, total), who="")

    def _summary(self, link: Link, total: Totals) -> str:
        """The last line of a kind of link."""
        return total.line(link)


def utf8(name: str) -> str:
    """A file's name as JSON and terminals take it."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
