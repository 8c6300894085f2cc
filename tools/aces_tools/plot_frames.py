"""`aces plot --bits` and `--raw`: frames drawn without a protocol."""

from __future__ import annotations

import argparse
import math
import os
from abc import ABC, abstractmethod

import numpy as np

from aces_bus import FrameTable
from aces_bus.errors import CallerError, CaptureError
from aces_bus.frame_table import NO_TIME
from aces_bus.frames import REMOTE
from aces_bus.protocol.columns.table import ColumnKind
from aces_bus.recordings.base import CanRecording

from .console import Progress, check_not_read, counted, report_unreadable, say, say_note
from .patience import Patience
from .plotting.bit_image import BitImage, BitImages
from .plotting.bits import BitPicture, print_bits, save_bits
from .plotting.identifiers import choose_identifiers, parse_identifiers
from .plotting.picture import Picture, PlotLine, PlotPanel
from .plotting.select import CHANNEL, ImageFormat, PlotSignal
from .plotting.series import Series, TimeAxis, broken, longest_period
from .reading.pieces import open_any
from .reading.traffic import BusIdentifier, identifier_groups
from .reading.window import TimeWindow

#: Identifiers that are drawn without a choice: those with most frames.
MOST_DRAWN = 64
#: Identifiers that are named in a note.
MOST_NAMED = 12
#: Identifiers whose bytes are kept until it is known which are meant.
MOST_KEPT = 64
#: Options that are about signals or lines.
_OF_SIGNALS = ("protocol", "direction", "list", "ylabel", "ylim", "ymin", "ymax")
_OF_LINES = (*_OF_SIGNALS, "step", "break_time", "show")


def plot_frames(arguments: argparse.Namespace, files: list[str], signals: list[str]) -> int:
    """Run `aces plot` with --bits or --raw; return its exit status. A wrong call raises before anything is read."""
    option = "--raw" if arguments.raw is not None else "--bits"
    if arguments.raw is not None and arguments.bits is not None:
        raise CallerError("--bits and --raw show different things; give one")
    if arguments.bits and (parse_identifiers(arguments.bits) is None or os.path.isfile(arguments.bits)):
        files, arguments.bits = [*files, arguments.bits], ""  # a file behind the option
    if signals:
        raise CallerError(
            f"{signals[0]!r} is not a file, and {option} takes no signals: it needs no protocol"
        )
    for name in _OF_SIGNALS if option == "--raw" else _OF_LINES:
        if getattr(arguments, name) not in (None, False, []):
            raise CallerError(f"--{name.replace('_', '-')} is not for {option}")
    if option == "--bits" and arguments.time == "absolute":
        raise CallerError("--time absolute is not for --bits: its images count from the first frame")
    if sum((arguments.output is not None, arguments.show, arguments.terminal)) > 1:
        raise CallerError("choose one of -o FILE, --show and --terminal")
    drawing: FrameDrawing = ByteDrawing(arguments) if option == "--raw" else BitDrawing(arguments)
    if arguments.output is not None or arguments.show:
        from .plotting import figure

        figure.load_matplotlib()
        figure.check_style(arguments.style)
        if arguments.output is not None:
            figure.check_output(arguments.output)
            check_not_read(arguments.output, files)
    return drawing.run(files)


class FrameDrawing(ABC):
    """Reads recordings and draws them."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.window = TimeWindow.parse(arguments.start, arguments.stop)

    @abstractmethod
    def add(self, table: FrameTable) -> None:
        """Add frames that --from and --to let pass."""

    @abstractmethod
    def draw(self) -> None:
        """Draw: all has been read."""

    def see(self, table: FrameTable) -> None:  # noqa: B027  # only one kind of drawing has to know
        """Take all frames, before --from and --to."""

    def run(self, files: list[str]) -> int:
        """Read the files, then draw; the exit status."""
        progress = Progress(files)
        status, frames, was_live = 0, 0, False
        with Patience() as patience:
            try:
                for name in files:
                    with patience.waiting():
                        capture = open_any(name)
                    was_live = capture.live
                    with capture:
                        if not isinstance(capture, CanRecording):
                            raise CallerError(
                                f"{capture.name}: bytes of a serial line, which have no identifiers; with a protocol their"
                                " signals are drawn: -p NAME ('aces decode FILE' says what fits)"
                            )
                        progress.opened(capture)
                        if self.window is not None:
                            self.window.begin()
                        for table in patience.each(capture.tables()):
                            frames += len(table)
                            progress.step(len(table))
                            self.see(table)
                            if self.window is not None:
                                table = table.take(np.flatnonzero(self.window.inside(table.time)))
                            if len(table):
                                self.add(table)
                        report_unreadable(capture, is_over=True)
                    if patience.is_over:
                        break
            except CaptureError as error:
                say(str(error))
                status = 2
            except KeyboardInterrupt:
                return 130
            finally:
                progress.close()
        if not frames:
            if status:
                return status
            raise CallerError(f"nothing to draw: {', '.join(map(os.path.basename, files))} holds no frames")
        self.draw()
        return 130 if patience.is_over and not was_live else status

    @property
    def _absent(self) -> str:
        return (
            "no frame is between --from and --to"
            if self.window is not None
            else "there is no frame with data"
        )


class BitDrawing(FrameDrawing):
    """`--bits`."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        super().__init__(arguments)
        self.images = BitImages()

    def add(self, table: FrameTable) -> None:
        self.images.add(table)

    def draw(self) -> None:
        arguments, images = self.arguments, self.images
        if arguments.bits:
            chosen = [
                images.images[identifier]
                for identifier in choose_identifiers(
                    parse_identifiers(arguments.bits) or (), list(images.images)
                )
            ]
        else:
            chosen = self._all()
        chosen = [image for image in chosen if image.length]
        if not chosen:
            came = "no identifier came twice" if images.images and not arguments.bits else self._absent
            raise CallerError(f"nothing to draw: {came}")
        if images.left_out:
            say_note(
                f"left out: {counted(len(images.left_out), 'identifier')}, which came behind {len(images.images)} others"
            )
        if images.timeless:
            has = "has no time, and is" if images.timeless == 1 else "have no time, and are"
            say(f"{counted(images.timeless, 'frame')} {has} left out")
        picture = BitPicture(images, chosen, arguments.title, arguments.style)
        if arguments.output is not None:
            save_bits(picture, arguments.output)
        else:
            print_bits(picture, arguments.color, is_by_byte=len(chosen) > 1)

    def _all(self) -> list[BitImage]:
        """Return those that have data and are not errors, by channel and identifier; of too many those with most frames."""
        every = [
            image for image in self.images.images.values() if image.length and not image.identifier.is_error
        ]
        some = [image for image in every if image.steps.any()]
        if len(some) < len(every):
            single = ", ".join(
                sorted(str(image.identifier) for image in every if not image.steps.any())[:MOST_NAMED]
            )
            say_note(f"not drawn: {counted(len(every) - len(some), 'identifier')} with one frame ({single})")
        some.sort(key=lambda image: -int(image.frames.sum()))
        if len(some) > MOST_DRAWN:
            say_note(
                f"drawn: the {MOST_DRAWN} of {len(some)} identifiers with most frames; name others: --bits 2A0,3*"
            )
        return sorted(
            some[:MOST_DRAWN],
            key=lambda image: (str(image.identifier.channel), image.identifier.is_extended, image.identifier),
        )


class ByteDrawing(FrameDrawing):
    """`--raw ID`: the bytes of identifiers as steps."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        super().__init__(arguments)
        patterns = parse_identifiers(arguments.raw)
        if patterns is None:
            raise CallerError(
                f"--raw {arguments.raw!r} is not an identifier; write it in hexadecimal, such as 2A0 or 18FEF100"
            )
        self.patterns = patterns
        self.clock = TimeAxis()
        #: Of each identifier that may be meant, its bytes; and all identifiers that have data.
        self.bytes: dict[BusIdentifier, list[Series]] = {}
        self.seen: dict[BusIdentifier, None] = {}
        self.frames = 0

    def see(self, table: FrameTable) -> None:
        self.clock.see(table.time)

    def add(self, table: FrameTable) -> None:
        for identifier, rows in identifier_groups(table):
            lengths = table.length[rows]
            if identifier.key & REMOTE or not lengths.any():
                continue
            self.seen[identifier] = None
            if not any(pattern.fits(identifier) for pattern in self.patterns):
                continue
            if identifier not in self.bytes and len(self.bytes) >= MOST_KEPT:
                raise CallerError(
                    f"--raw {self.arguments.raw} means more than {MOST_KEPT} identifiers; name fewer"
                )
            series = self.bytes.setdefault(identifier, [])
            if self.clock.origin is None:
                x = (self.frames + rows).astype(np.float64)
            else:
                x = (table.time[rows] - self.clock.origin) / 1e9
                known = table.time[rows] != NO_TIME
                rows, lengths, x = rows[known], lengths[known], x[known]
            for byte in range(int(lengths.max(initial=0))):
                if byte == len(series):
                    series.append(_series(identifier, byte))
                has = lengths > byte
                values = table.data[rows, byte].astype(np.float64)
                values[~has] = np.nan
                series[byte].note(values[has])
                series[byte].extend(x, values)
        self.frames += len(table)

    def draw(self) -> None:
        arguments = self.arguments
        if not self.seen:
            raise CallerError(f"nothing to draw: {self._absent}")
        chosen = choose_identifiers(self.patterns, list(self.seen))
        several = len({identifier.channel for identifier in self.seen}) > 1
        panels: list[PlotPanel] = []
        for identifier in chosen:
            name = f"{identifier.channel} {identifier}" if several else str(identifier)
            panels += self._panels(name, self.bytes[identifier])
        picture = Picture(
            panels,
            self.clock,
            arguments.title,
            arguments.xlabel,
            is_absolute=arguments.time == "absolute",
            is_step=True,
            style=arguments.style,
        )
        if arguments.output is not None or arguments.show:
            from .plotting import figure

            if arguments.output is not None:
                figure.save_figure(picture, arguments.output)
            else:
                figure.show_figure(picture)
        else:
            from .plotting import terminal

            terminal.print_picture(picture, arguments.color)

    def _panels(self, name: str, series: list[Series]) -> list[PlotPanel]:
        """Return a panel a byte; where some change, those that do not are said and not drawn."""
        still = [curve for curve in series if curve.low == curve.high]
        moving = [curve for curve in series if curve.low != curve.high] or series
        if len(moving) < len(series):
            values = ", ".join(f"{curve.signal.path} is {int(curve.low or 0):02X}" for curve in still)
            say_note(f"{name}: not drawn, being constant: {values}")
        panels: list[PlotPanel] = []
        for curve in moving:
            x, y = curve.points()
            given: float | None = self.arguments.break_time
            gap = longest_period(x) if given is None else math.inf if given < 0 else given
            x, y = broken(x, y, gap if self.clock.origin is not None else math.inf)
            panel = PlotPanel(
                "numbers", [[PlotLine(curve, ImageFormat(), x, y)]], f"{name}  {curve.signal.path}"
            )
            panel.units, panel.captions, panel.limits = [""], ["value"], [(None, None)]
            panel.is_small = True
            panels.append(panel)
        return panels


def _series(identifier: BusIdentifier, byte: int) -> Series:
    signal = PlotSignal("", str(identifier), f"byte {byte}", "", ColumnKind(f"byte {byte}"))
    return Series(signal, ((CHANNEL, str(identifier.channel)),))
