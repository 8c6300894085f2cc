"""Draw signals of recordings over time: in the terminal, into a file, in a window.

  aces plot walk.log -p hubo 'Encoder.position.*'
  aces plot walk.log -p hubo 'Encoder.position.*' - 'Current.current.*' -o a.png
  aces plot walk.log -p hubo --list
  candump can0 | aces plot - -p car.py 'Motor.speed:r-' , 'Motor.torque' --show
  aces plot walk.log --bits -o bits.png              no protocol: flips of bits
  aces plot walk.log --raw 2A0                       the bytes of an identifier

CAPTUREs come first, then SIGNALs; - as the first is standard input. Without
SIGNALs what each message has is drawn; of many signals those that say most.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from aces_bus import FrameTable
from aces_bus.errors import CallerError
from aces_bus.frame_table import NO_TIME
from aces_bus.protocol.columns.table import MessageTable
from aces_bus.protocol.record import PlainValue
from aces_bus.recordings.base import Recording

from .console import check_not_read, counted, say, say_note
from .decode_columns import TableDecoding
from .options import COLOR, DIRECTION, FROM, OUTPUT, PROTOCOL, TIME, TO, Arguments, argument, flag, several
from .plotting.picture import LARGEST, Limits, LineNames, Picture, PlotPanel, panels_of
from .plotting.select import Wanted, declared_signals, parse_groups, parse_pattern, select
from .plotting.series import Collector, Series, TimeAxis
from .plotting.telling import telling_signals
from .reading.totals import Totals

SUMMARY = "draw signals over time: in the terminal, PNG, SVG, PDF"

EPILOG = """\
signals:
  Encoder.position.0           one signal; case does not count
  position.0                   the same of whichever message has it
  Encoder.position             all items of a field
  'Enc*.pos*'                  * is any number of characters, ? is one
  'Encoder[board=3].position'  of one device only; also [board=3,channel=can0],
                               and any field of the message: [selector=7]
  'State.error.hot'            one flag; State.error is all of them
  SIGNAL:FMT                   with matplotlib's colour, marker and line style,
                               such as :r--, :.k or :C2; :| draws stems
  -                            between signals: a new subplot
  ,                            between signals: another vertical axis
  A signal that several devices or channels send is one line each. Enumerations
  and flags have subplots of their own: names as ticks, flags as lanes.

time:
  --from and --to count seconds from the first frame of each capture or, from
  1e8 on, since 1970. The axis begins at the first frame of the first capture;
  where captures have no times it counts frames, or bytes.

exit status: 0; 2 for a wrong call, a file that cannot be read, or when nothing
of what is asked for occurs; 130 after Ctrl-C, with what was read so far drawn
"""


def axis_number(text: str) -> float:
    """Return a number that an axis can go to; for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) < LARGEST:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return value


USAGE = """\
%(prog)s CAPTURE… -p PROTOCOL [SIGNAL | - | ,]… [options]
       %(prog)s CAPTURE… {--bits [ID] | --raw ID} [options]"""
ARGUMENTS: Arguments = (
    argument(
        "items", nargs="*", metavar="CAPTURE… SIGNAL…", help="recordings (- is standard input), then signals"
    ),
    PROTOCOL,
    DIRECTION,
    flag("--list", help="list the signals that occur, with count, range and unit"),
    argument(
        "--bits",
        nargs="?",
        const="",
        metavar="ID",
        help="without a protocol: how often the bits of each identifier flip, as images; or of these only: 2A0,18FEF100,3*",
    ),
    argument("--raw", metavar="ID", help="without a protocol: the bytes of this identifier as steps"),
    OUTPUT.but(help="draw into FILE.png, FILE.svg or FILE.pdf"),
    flag("--terminal", help="draw in the terminal, as without -o and --show"),
    flag("--show", help="open a window"),
    FROM,
    TO,
    TIME.but(
        choices=["relative", "absolute"], help="from the first frame on, or as recorded (default: relative)"
    ),
    argument(
        "--break-time",
        type=axis_number,
        metavar="SECONDS",
        help="interrupt a line after this time without values; -1: never (default: five periods of a message)",
    ),
    flag("--step", help="hold each value until the next one, instead of straight lines"),
    argument("--title", default="", metavar="TEXT", help="above all"),
    argument("--xlabel", default="", metavar="TEXT", help="below the time axis"),
    several("--ylabel", metavar="TEXT", help="once for all, or once an axis, in order"),
    several(
        "--ylim",
        metavar="LOW:HIGH",
        help="either may be empty; once for all, or once an axis, in order; write --ylim=-5:5",
    ),
    argument("--ymin", type=axis_number, metavar="LOW", help="of all axes"),
    argument("--ymax", type=axis_number, metavar="HIGH", help="of all axes"),
    argument("--style", metavar="STYLE", help="a style of matplotlib, such as ggplot"),
    COLOR,
)
#: What `Decoding` also asks for.
DEFAULTS: dict[str, PlainValue] = {"message": [], "filter": [], "strict": False}


def run(arguments: argparse.Namespace) -> int:
    if not arguments.items and arguments.bits:
        arguments.items, arguments.bits = [arguments.bits], ""  # a file behind the option
    if not arguments.items:
        raise CallerError("name a recording: aces plot walk.log -p hubo (- is standard input)")
    files, signals = split_arguments(arguments.items)
    if arguments.bits is not None or arguments.raw is not None:
        from .plot_frames import plot_frames

        return plot_frames(arguments, files, signals)
    if not arguments.protocol:
        raise CallerError(
            "which protocol? -p NAME; 'aces decode FILE' says which fit a recording; --bits and --raw ID need no protocol"
        )
    if not signals and not arguments.list and all(os.path.isfile(file) for file in files):
        survey = SignalSurvey(argparse.Namespace(**vars(arguments)))
        survey.run()
        if chosen := survey.chosen:
            arguments.items = [*files, *chosen]
            number = len(chosen) - chosen.count("-")
            say_note(
                f"drawn: {number} of {len(survey.collector.series)} signals; --list shows all, name those you want"
            )
    return Plotting(arguments).run()


class Plotting(TableDecoding):
    """One run of `aces plot`. A wrong call raises before anything is read."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        arguments.files, texts = split_arguments(arguments.items)
        super().__init__(arguments)
        self.declared = declared_signals(
            [variant for variants in self.variants.values() for variant in variants]
        )
        self.groups = parse_groups(texts)
        self.limits = [parse_limits(text) for text in arguments.ylim]
        low, high = arguments.ymin, arguments.ymax
        if low is not None and high is not None and not low < high:
            raise CallerError(f"--ymin {low:g} is not below --ymax {high:g}")
        wanted = self._wanted()
        self._check_output()
        self.clock = TimeAxis()
        self.collector = Collector(
            wanted, self.clock, self.window, keeps_points=not arguments.list, leaves_out=not self.groups
        )

    def _wanted(self) -> Mapping[tuple[str, str], Wanted]:
        patterns = [pattern for group in self.groups for axis in group for pattern in axis]
        if patterns:
            return select(patterns, self.declared)
        include_unknown = self.arguments.list
        return {
            owner: Wanted(
                tuple(
                    (signal, ())
                    for signal in message.signals
                    if signal.column not in message.devices
                    and (include_unknown or (signal.is_number and not signal.is_quiet))
                ),
                message.devices,
            )
            for owner, message in self.declared.items()
        }

    def _check_output(self) -> None:
        asked = self.arguments
        path: str | None = asked.output
        if sum((path is not None, asked.show, asked.terminal, asked.list)) > 1:
            raise CallerError("choose one of -o FILE, --show, --terminal and --list")
        if path is not None or asked.show:
            from .plotting import figure

            figure.load_matplotlib()
            figure.check_style(asked.style)
            if path is not None:
                figure.check_output(path)
                check_not_read(path, self.files)
        elif asked.style is not None:
            raise CallerError("--style is for pictures: give -o FILE.png or --show as well")

    # ------------------------------------------------------------------ reading

    def _kept(self, frames: FrameTable) -> None:
        """Decode all frames, as replies need their requests. The collector keeps to --from and --to."""
        self.clock.see(frames.time)
        known = frames.time[frames.time != NO_TIME]
        if self.window is not None and len(known):
            self.window.see(int(known[0]))

    def _see(self, instant: int) -> None:
        super()._see(instant)
        self.clock.see(np.array([instant]))

    def _inside(self, tables: Sequence[MessageTable], totals: Totals) -> Sequence[MessageTable]:
        return tables

    def _take(self, tables: Sequence[MessageTable], totals: Totals) -> None:
        for table in tables:
            self.collector.add(table)

    def _finish(self, *, is_whole: bool) -> None:
        self.progress.close()
        if self.arguments.list:
            self._list()
        elif self.collector.series or not self.status:
            self._draw()

    def _flush(self) -> None:
        pass  # nothing is written before all is read

    # ------------------------------------------------------------------ drawing

    def _draw(self) -> None:
        series = [curve for curve in self.collector.series.values() if curve.count and curve.points()[0].size]
        for curve in [curve for curve in series if curve.others]:
            say(f"{LineNames(series).full(curve)} holds {curve.others}, which no line can show")
        series = [curve for curve in series if not curve.others]
        if not series:
            raise CallerError(f"nothing to draw: {self._absent()}")
        series.sort(key=self._place)
        panels = panels_of(
            # Without SIGNALs what each message has is a subplot of its own.
            self.groups
            or [[[parse_pattern(name)]] for name in dict.fromkeys(s.signal.message for s in series)],
            series,
            longest_gap=self._longest_gap,
            by_unit=not self.groups,
        )
        self._say_what_is_absent(series)
        self._label(panels)
        picture = Picture(
            panels,
            self.clock,
            self.arguments.title,
            self.arguments.xlabel,
            "byte" if self.variants["serial"] and not self.variants["can"] else "frame",
            self.arguments.time == "absolute",
            self.arguments.step,
            self.arguments.style,
        )
        if self.arguments.output is not None:
            from .plotting import figure

            figure.save_figure(picture, self.arguments.output)
        elif self.arguments.show:
            from .plotting import figure

            figure.show_figure(picture)
        else:
            from .plotting import terminal

            terminal.print_picture(picture, self.arguments.color)

    @property
    def _longest_gap(self) -> float | None:
        """Gap (s) that interrupts a line; None to take it from each message's period."""
        given: float | None = self.arguments.break_time
        return math.inf if self.clock.origin is None or (given is not None and given < 0) else given

    def _place(self, curve: Series) -> Any:
        """Return what series are sorted by: messages as they are declared, then devices."""
        return list(self.declared).index(curve.signal.owner), _natural(curve.key)

    def _absent(self) -> str:
        if self.window is not None:
            return "none of these signals occurs between --from and --to"
        return "none of these signals occurs; --list shows those that do"

    def _say_what_is_absent(self, series: Sequence[Series]) -> None:
        for pattern in (pattern for group in self.groups for axis in group for pattern in axis):
            if not any(pattern.takes(curve.signal) and pattern.holds(curve.key) for curve in series):
                say(f"nothing that {pattern.text!r} means occurs")

    def _label(self, panels: Sequence[PlotPanel]) -> None:
        """Give each vertical axis of numbers what --ylabel, --ylim, --ymin and --ymax say."""
        asked = self.arguments
        number = 0
        for panel in panels:
            if panel.sort != "numbers":
                continue
            for place in range(len(panel.axes)):
                low, high = _nth(self.limits, number) or (None, None)
                panel.limits[place] = (
                    low if asked.ymin is None else asked.ymin,
                    high if asked.ymax is None else asked.ymax,
                )
                panel.captions[place] = _nth(asked.ylabel, number) or ""
                number += 1

    def _list(self) -> None:
        from .output.columns import Page
        from .output.text import printable

        series = sorted(
            (
                curve
                for curve in self.collector.series.values()
                if curve.count and (curve.low or curve.high or not curve.signal.is_quiet)
            ),
            key=self._place,
        )
        if not series:
            raise CallerError(f"nothing to list: {self._absent().partition(';')[0]}")
        names = LineNames(series, always=True)
        rows = [
            (
                printable(names.full(curve)),
                str(curve.count),
                printable(_shown(curve, curve.low)),
                printable(_shown(curve, curve.high)),
                printable(
                    curve.signal.kind.unit
                    or {"str": "text", "dict": "record"}.get(curve.others, curve.others)
                ),
            )
            for curve in series
        ]
        sizes = [max(len(row[index]) for row in [*rows, LIST_HEAD]) for index in range(5)]
        aligned = [
            (row[0], *(row[index].rjust(sizes[index]) for index in (1, 2, 3)), row[4])
            for row in [LIST_HEAD, *rows]
        ]
        Page(self.arguments.color).table(aligned[0], aligned[1:])

    def _summarise(self) -> None:
        if self.collector.left_out:
            say_note(
                "there are more signals than a picture or a list shows: some are left out; name those wanted: [board=3]"
            )
        if self.clock.timeless:
            has = "has no time, and is" if self.clock.timeless == 1 else "have no time, and are"
            say(f"{counted(self.clock.timeless, 'message')} {has} left out")
        super()._summarise()


class SignalSurvey(Plotting):
    """A look at what there is, before signals are chosen: nothing is drawn, and nothing said."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        super().__init__(arguments)
        self.collector.keeps_points = False
        #: The signals that say most; none where all can be drawn.
        self.chosen: list[str] = []

    def _finish(self, *, is_whole: bool) -> None:
        self.progress.close()
        self.chosen = telling_signals(sorted(self.collector.series.values(), key=self._place))

    def _complain(self, message: str) -> None:
        self.status = 2

    def _problems(self, capture: Recording, *, is_over: bool = False) -> None:
        pass

    def _warn(self, contested: Mapping[int, tuple[str, str]], key: int, identifier: int) -> None:
        pass

    def _summarise(self) -> None:
        pass


LIST_HEAD = ("signal", "count", "min", "max", "unit")


def split_arguments(items: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split arguments into captures and signals: the first is a capture, and so is each that follows and
    names a file.
    """
    files, rest = [items[0]], list(items[1:])
    while rest and rest[0] not in ("-", ",") and os.path.exists(rest[0]):
        files.append(rest.pop(0))
    return files, rest


def parse_limits(text: str) -> Limits:
    """Parse `LOW:HIGH`, either of which may be empty; raise `CallerError`."""
    low, colon, high = text.partition(":")
    try:
        limits = (axis_number(low) if low.strip() else None, axis_number(high) if high.strip() else None)
    except argparse.ArgumentTypeError:
        colon = ""
        limits = (None, None)
    bottom, top = limits
    if not colon or (bottom is not None and top is not None and not bottom < top):
        raise CallerError(
            f"--ylim {text!r}: write LOW:HIGH, such as 0:10, or --ylim=-5: for the lower end only"
        )
    return limits


def _natural(key: Sequence[tuple[str, str]]) -> list[tuple[int, str]]:
    """Return a sort key by which board 10 comes after board 9, and the bus counts last."""
    return [(int(value) if value.isdecimal() else -1, value) for _, value in [*key[1:], *key[:1]]]


def _nth(given: Sequence[Any], number: int) -> Any:
    if len(given) == 1:
        return given[0]
    return given[number] if number < len(given) else None


def _shown(series: Series, value: float | int | None) -> str:
    if value is None:
        return ""
    names = series.signal.kind.names
    if names is not None and series.signal.bit is None:
        return names.get(value, f"{value:g}")
    return str(value) if isinstance(value, int) else f"{value:.6g}"
