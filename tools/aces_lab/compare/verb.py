"""What differs between two recordings, or two times of one; most telling first.

  aces diff before.log after.log
  aces diff run.log --b 10..12               B: I pressed a button; A: the rest
  aces diff run.log --a 0..10 --b 10..20
  aces diff run.log --marks marks.txt        B are the times that the file names
  aces diff run.log --marks marks.txt --a released --b pressed -o diff.png
  aces diff before.log after.log -p car.dbc  messages and signals as well
  aces diff run.log --b 10..12 -p hubo -m Encoder --where board=3

Without a protocol: identifiers that appear, vanish, come at another period or
with another length; bits that change in B only, and values seen in B only.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from aces_bus import open_recording
from aces_bus.errors import CallerError, CaptureError
from aces_bus.plain_text import printable
from aces_bus.protocol import Variant
from aces_bus.protocol.columns.table import Array, MessageTable
from aces_bus.protocol.record import PlainValue
from aces_bus.recordings.base import CanRecording, SerialRecording
from aces_bus.recordings.filters import parse_filter
from aces_tools.console import (
    Progress,
    abandon_stdout,
    check_not_read,
    counted,
    print_json,
    report_unreadable,
    say,
    say_note,
)
from aces_tools.decoding import named_messages
from aces_tools.options import (
    COLOR,
    DIRECTION,
    FILTER,
    JSON,
    MESSAGE,
    OUTPUT,
    PROTOCOL,
    WHERE,
    Arguments,
    argument,
    duration,
    several,
)
from aces_tools.output.columns import Page
from aces_tools.output.shape import plans_of
from aces_tools.patience import Patience
from aces_tools.protocols_arg import parse_protocols
from aces_tools.reading.pieces import open_any
from aces_tools.reading.where import WhereColumns
from aces_tools.reading.window import TimeWindow

from . import RecordingComparison, TimeMark, parse_marks
from .changes import KINDS
from .comparer import LEAST, ComparedSide, RecordingComparer
from .marks import parse_window, windows_of

_KINDS = "\n".join(f"  {kind:<9} {words}" for kind, words in KINDS.items())
SUMMARY = "compare recordings, or times of one: identifiers, bits, signals"

EPILOG = f"""\
what a line says:
{_KINDS}

  The number in front is how telling a change is: how sure it is that it does
  not come of having looked at another time. It weighs how much A has seen, in
  how many of B's times the change is there, and how often A brings something
  new by itself: counters and noise come last.

times (--a, --b): START..STOP, either of which may be empty; also several times
  12.5..14       seconds from the first frame of the recording, or since 1970
  14:05..14:06   by the clock, and 2026-11-22T14:05:30..2026-11-22T14:06

marks: a line reads '12.3 pressed' (until the next line, or so long as --for
  says) or '12.3..14 pressed'; # begins a remark. --a and --b then name marks,
  in any case, with * and ?; without --b the first one is B.

exit status: 0 when nothing is as telling as --least, 1 when something is, 2 for
  a wrong call or a file that cannot be read, 130 after Ctrl-C
"""


def _score(text: str) -> float:
    with suppress(ValueError):
        if 0 <= (found := float(text)) <= 1:
            return found
    raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 to 1")


ARGUMENTS: Arguments = (
    argument("files", nargs="+", metavar="CAPTURE", help="one recording, or A and B; - is standard input"),
    several("--a", metavar="TIME", help="when A is: START..STOP, or the name of a mark"),
    several("--b", metavar="TIME", help="when B is; of one recording A is then all the rest"),
    argument("--marks", metavar="FILE", help="times with names, a line each: '12.3 pressed'"),
    argument(
        "--for", dest="lasting", type=duration, metavar="DURATION", help="a mark lasts so long: 500ms, 2s"
    ),
    PROTOCOL.but(help="protocols: messages and signals are compared; serial lines need it"),
    DIRECTION,
    MESSAGE.but(help="compare only this message, in any case, also Motor*; may be given several times"),
    WHERE.but(help="compare only records such as field=value, as of 'aces decode'"),
    FILTER,
    argument(
        "--least",
        type=_score,
        default=LEAST,
        metavar="SCORE",
        help="leave out what is less telling, 0 to 1 (default: %(default)s; 0: nothing)",
    ),
    JSON,
    OUTPUT.but(help="draw what changed over time into FILE.png, FILE.svg or FILE.pdf"),
    COLOR,
)


def run(arguments: argparse.Namespace) -> int:
    return Comparing(arguments).run()


class Comparing:
    """One run of `aces diff`. A wrong call raises before anything is read."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.files: list[str] = arguments.files
        if len(self.files) > 2:
            raise CallerError(
                f"two recordings are compared, and these are {len(self.files)}; aces convert joins some"
            )
        if self.files.count("-") > 1:
            raise CallerError("standard input is read once; of one recording say when B is: --b START..STOP")
        self.variants: list[Variant] = parse_protocols(arguments.protocol)
        wanted = parse_filter(*arguments.filter) if arguments.filter else None
        windows_a, windows_b = self._windows()
        b = ComparedSide(windows_b, self.variants)
        rest = b if len(self.files) == 1 and not windows_a else None
        self.comparer = RecordingComparer(
            ComparedSide(windows_a, self.variants, rest),
            b,
            self.variants,
            wanted,
            self._selection(),
            arguments.direction,
        )
        self.picture: Any = None
        if arguments.output is not None:
            self._begin_picture(arguments.output)
        self.lines_unreadable = 0

    def _windows(self) -> tuple[list[TimeWindow], list[TimeWindow]]:
        asked = self.arguments
        marks = read_marks(asked.marks) if asked.marks is not None else []
        if marks and len(self.files) == 2:
            raise CallerError("--marks is for one recording; of two, --a and --b say the times")
        if asked.lasting is not None and not marks:
            raise CallerError("--for is for marks with one time: give --marks FILE")
        names = asked.b or ([marks[0].name] if marks else [])
        if len(self.files) == 1 and not names:
            raise CallerError(
                "one recording is compared with itself: say when B is (--b 10..12, --marks FILE), or name a second recording"
            )

        def windows(option: str, texts: Sequence[str]) -> list[TimeWindow]:
            found: list[TimeWindow] = []
            for text in texts:
                named = windows_of(marks, text, asked.lasting) if marks else []
                if marks and not named and ".." not in text:
                    there = ", ".join(dict.fromkeys(mark.name for mark in marks))
                    raise CallerError(f"{option}: no mark is named {text!r} (there are: {there})")
                found += named or [parse_window(text, option)]
            return found

        return windows("--a", asked.a), windows("--b", names)

    def _selection(self) -> Callable[[MessageTable], Array] | None:
        """Return which rows -m and --where let pass; None: all."""
        asked = self.arguments
        if not (asked.message or asked.where):
            return None
        if not self.variants:
            raise CallerError(
                f"--{'message' if asked.message else 'where'} needs a protocol: -p NAME (aces protocols)"
            )
        plans = plans_of(self.variants)
        names = named_messages(asked.message, plans)
        where = WhereColumns(asked.where, plans) if asked.where else None

        def selected(table: MessageTable) -> Array:
            if names and table.message not in names:
                return np.zeros(len(table), bool)
            return np.ones(len(table), bool) if where is None else where.holds(table)

        return selected

    def _begin_picture(self, path: str) -> None:
        from aces_tools.plotting import figure

        from .lanes import LanePicture

        figure.check_output(path)
        check_not_read(path, self.files)
        self.picture = LanePicture(self.variants)
        self.comparer.watcher = self.picture

    # ------------------------------------------------------------------ running

    def run(self) -> int:
        progress = Progress(self.files)
        with Patience() as patience:
            try:
                for name, sides in (
                    [(self.files[0], "ab")] if len(self.files) == 1 else zip(self.files, "ab", strict=True)
                ):
                    self._read(name, sides, patience, progress)
            except CaptureError as error:
                say(str(error))
                return 2
            except KeyboardInterrupt:
                patience.is_over = True
            finally:
                progress.close()
            if patience.is_over:
                say("interrupted: nothing was compared")
                return 130
        for option, side in (("--a", self.comparer.a), ("--b", self.comparer.b)):
            if side.is_windowed and not side.watched.frames:
                what = (
                    "what --b leaves of the recording"
                    if side.rest_of is not None
                    else f"the times of {option}"
                )
                raise CallerError(f"nothing is in {what}")
        if not any(number for _, side in self._sides() for _, number in _sizes(side)):
            if self.comparer.selected is not None:
                raise CallerError("nothing is compared: no message is what -m and --where ask for")
            if self.comparer.wanted is not None:
                raise CallerError("nothing is compared: no frame passes --filter")
            raise CallerError(
                f"nothing is compared: {' and '.join(dict.fromkeys(self._names()))} holds nothing"
            )
        for name, (_, side) in zip(self._names(), self._sides(), strict=True):
            if not side.watched.frames:
                say(f"{name} holds nothing to compare, so that all of the other is new or gone")
            beyond = side.traffic.identifiers.beyond + side.messages.beyond
            if beyond:
                say(
                    f"{name}: {beyond} frames or messages are not compared: there are too many identifiers or devices"
                )
        found = self.comparer.compare(self.arguments.least)
        try:
            if self.arguments.json:
                print_json(self._as_dict(found))
            else:
                self._print(found)
        except BrokenPipeError:
            abandon_stdout()
        if self.picture is not None:
            self._draw(found)
        sizes = " ".join(
            f"{unit}_{name}={number}" for name, side in self._sides() for unit, number in _sizes(side)
        )
        weaker = f"changes={len(found.changes)} less_telling={found.weaker}"
        say(f"{weaker} {sizes} lines_unreadable={self.lines_unreadable}", who="")
        return 0 if found.is_same else 1

    def _draw(self, found: RecordingComparison) -> None:
        path = self.arguments.output
        drawn = self.picture.save(path, found, self._names())
        if not drawn:
            say(f"{path} is not written: nothing that can be drawn differs")
        elif drawn < len(found.changes):
            say_note(
                f"{path} shows {drawn} of {counted(len(found.changes), 'change')}; --least leaves out more"
            )

    def _open(self, name: str) -> CanRecording | SerialRecording:
        links = {"can" if variant.link == "can" else "serial" for variant in self.variants}
        if len(links) != 1:
            return open_any(name)
        return open_recording(name, link="can") if "can" in links else open_recording(name, link="serial")

    def _read(self, name: str, sides: str, patience: Patience, progress: Progress) -> None:
        with patience.waiting():
            capture = self._open(name)
        with capture:
            progress.opened(capture)

            def each(items: Any) -> Any:
                for item in patience.each(items):
                    yield item
                    progress.step(len(item) if capture.link == "can" else 0)

            try:
                self.comparer.read(capture, sides, each)
            finally:
                report_unreadable(capture, is_over=True)
                self.lines_unreadable += capture.lines_unreadable

    # ------------------------------------------------------------------ what comes out

    def _sides(self) -> list[tuple[str, ComparedSide]]:
        return [("a", self.comparer.a), ("b", self.comparer.b)]

    def _names(self) -> list[str]:
        """Return what A and B are, in words."""
        asked = self.arguments
        names = [os.path.basename(name) if name != "-" else "standard input" for name in self.files]
        if len(names) == 2 and names[0] == names[1]:
            names = list(self.files)
        b = asked.b or ([self._first_mark] if asked.marks is not None else [])
        parts = [", ".join(asked.a), ", ".join(b)]
        if len(names) == 1:
            parts[0] = parts[0] or "the rest"
        return [
            f"{name}, {part}" if part else name
            for name, part in zip([names[0], names[-1]], parts, strict=True)
        ]

    @property
    def _first_mark(self) -> str:
        return read_marks(self.arguments.marks)[0].name

    def _as_dict(self, found: RecordingComparison) -> dict[str, PlainValue]:
        sides = {
            name: {
                "what": words,
                "seconds": side.watched.seconds,
                **dict(_sizes(side)),
            }
            for (name, side), words in zip(self._sides(), self._names(), strict=True)
        }
        return {
            **sides,
            "changes": [change.as_dict() for change in found.changes],
            "less_telling": found.weaker,
        }

    def _print(self, found: RecordingComparison) -> None:
        page = Page(self.arguments.color)
        for (name, side), words in zip(self._sides(), self._names(), strict=True):
            seconds = side.watched.seconds
            passed = f" in {seconds:.4g} s" if seconds else ""
            sizes = ", ".join(counted(number, unit[:-1]) for unit, number in _sizes(side) if number)
            page.lines([printable(f"{name.upper()}  {words}: {sizes or 'nothing'}{passed}")])
        if found.changes:
            page.lines([""])
            page.table(
                ("", "what", "of", "where", "A", "B", "in B"),
                [
                    (
                        f"{change.score:.2f}",
                        change.kind,
                        change.subject,
                        change.place,
                        change.a,
                        change.b,
                        _evidence(change),
                    )
                    for change in found.changes
                ],
            )
        else:
            page.lines(["nothing that tells much" if found.weaker else "no difference"])
        if found.weaker:
            say_note(f"less telling: {counted(found.weaker, 'change')}; --least 0 lists all")


def _sizes(side: ComparedSide) -> list[tuple[str, int]]:
    parts = [("frames", side.traffic.frames), ("identifiers", len(side.traffic.identifiers))]
    return [*parts, ("messages", side.messages.frames)] if side.messages.frames else parts


def _evidence(value: Any) -> str:
    text = f"{value.count} of {value.frames}" if value.count and value.frames else ""
    return text + (f", {value.seen_in} of {value.windows} times" if text and value.windows > 1 else "")


def read_marks(path: str) -> list[TimeMark]:
    """Return the marks of a file; raises `CallerError`."""
    try:
        with open(path, encoding="utf-8-sig") as file:
            return parse_marks(file.read(1 << 20), path)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise CallerError(f"--marks {path}: cannot be read: {reason}") from error
