"""Listen to a bus: decoded lines as they come. It cannot send.

  aces sniff can0
  aces sniff can0 can1
  aces sniff can0 -p hubo --message Encoder --where board=3
  aces sniff -i slcan -c /dev/ttyACM0 -b 1000000 -t delta --filter 060:7F0
  aces sniff can0 -o walk.blf --rotate 100MB
  aces sniff can0 -p hubo -o walk.parquet
  aces sniff can0 -p hubo --record walk.log
  aces sniff can0 -b 1000000 -p hubo --screen
  aces sniff can0 -p hubo -q --foxglove
  aces sniff /dev/ttyUSB0 -p robotis --direction both
  aces sniff --udp 14550 -p my_spec.py --format jsonl

Without -p frames are shown as candump shows them, and bytes as they came.
Ctrl-C ends it with the summary.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from aces_bus import Frame, FrameTable, Unknown
from aces_bus.errors import CallerError
from aces_bus.export.files import telling
from aces_bus.protocol import CanScanner
from aces_bus.protocol.counts import ScanCounts
from aces_bus.protocol.live.scanner import Scanner
from aces_bus.protocol.record import Meta
from aces_bus.recordings.base import Chunk, Link
from aces_bus.recordings.filters import CanFilter, parse_filter

from .bus_arg import BUS_ARGUMENTS, ChosenBus, chosen_bus
from .console import ENDLESS, Output, abandon_stdout, say, say_note, terminal_width, wants_colour
from .decode import LiveDecoding
from .decoding import utf8
from .live import BusEventLines, losses, received_frame, silence_s
from .live_text import CandumpLines
from .live_view import live_view, show_bus_event, wants_view
from .options import (
    COLOR,
    COUNT,
    DIRECTION,
    FILTER,
    FOR,
    MESSAGE,
    OUTPUT,
    PROTOCOL,
    QUIET,
    ROTATE,
    TIME,
    UNKNOWN,
    WHERE,
    Arguments,
    argument,
    flag,
)
from .output import Writer, line_format, live_kind
from .output.text import TextOutput, Times
from .patience import STEP_S, Patience
from .protocols_arg import parse_protocols
from .reading.totals import Totals
from .rotation import Rotation

if TYPE_CHECKING:
    from .bus_arg import AnyGate
    from .live_log import LogSeries
    from .live_view import LiveView, ShownRecords
    from .recorder import RecordingFile
    from .several_buses import SeveralBuses, SeveralGates

#: Frames that come close behind each other are shown together, once in this time (s): less work, and not visible.
TOGETHER_S = 0.01
#: Seconds between two times at which a log is handed to the system.
LOG_S = 0.25

SUMMARY = "listen to a bus: decoded lines, filters, recordings; cannot send"

EPILOG = """\
times (-t): with jsonl they are always absolute.

screen (--screen): one row for each identifier, message and board (or servo),
with rate, period and jitter, the digits that changed, and decoded values.
Keys: d details, / filter, s sort, f freeze, ? all of them. The load is a share
of the bit rate (-b, else the protocol's).

logs (-o FILE, by its suffix; instead of lines on standard output):
  without -p   .log .blf .asc .trc .csv .db .mf4 …: the frames that --filter
               lets pass; of serial lines .slog .bin
  with -p      .parquet .sqlite .db .mcap: tables of the decoded messages;
               .parquet is a folder of parts for each message
  either       .txt .jsonl .csv: the lines themselves
  What was received is in the file within half a second, and is there after
  kill -9; MF4 and packed files (.gz .zst), which have to be finished, are kept
  as FILE.log until then. Frames, bytes and tables never overwrite a file.

recording (--record FILE, in the formats of frames and bytes):
  Everything received is recorded, whatever is shown or filtered.
--rotate 100MB, --rotate 10min, or both: -o and --record go on in FILE-00002 …

summary (last on stderr): as of 'aces decode', then what was lost:
  dropped         arrived faster than it could be shown
  kernel_dropped  of which the system says that it dropped it
  bad_input       what the adapter sent that is not a frame
  reopened        how often the bus was lost and came back
Events of the bus (lost, reopened, bus-off …) are reported when they happen.

exit status: 0, also after Ctrl-C; 2 a wrong call, a bus that cannot be
opened, or a recording that is not whole
"""


ARGUMENTS: Arguments = (
    argument(
        "bus",
        nargs="*",
        metavar="BUS",
        help="can0, unix:can0, a serial port or its URL, several CAN buses; or by the options below",
    ),
    PROTOCOL,
    DIRECTION.but(help="only messages to or from the device; both pairs requests and replies"),
    FILTER,
    MESSAGE,
    WHERE,
    UNKNOWN,
    TIME,
    COUNT.but(help="end after this many lines (with -q: that would be)"),
    FOR.but(help="end after this time: 10s, 500ms, 2min"),
    argument(
        "--format", choices=["text", "jsonl", "csv"], help="default: by the suffix of --output, else text"
    ),
    OUTPUT.but(help="write there instead of on standard output; see logs below"),
    ROTATE,
    QUIET.but(help="print no lines, only the summary"),
    argument("--record", metavar="FILE", help="write all that is received there; see below"),
    flag("--screen", help="a table of all that repeats, live; needs 'aces-bus[screen]'"),
    COLOR,
    *BUS_ARGUMENTS,
)
#: What `Decoding` also asks for.
DEFAULTS: dict[str, Any] = {"files": [], "start": None, "stop": None, "strict": False}


def run(arguments: argparse.Namespace) -> int:
    return Sniffing(arguments).run()


def _chosen(arguments: argparse.Namespace) -> ChosenBus | SeveralBuses:
    """Return the bus that the call names, or the CAN buses; raises `CallerError` as `chosen_bus` does."""
    variants, names = parse_protocols(arguments.protocol), arguments.bus

    def chosen(name: str | None) -> ChosenBus:
        return chosen_bus(argparse.Namespace(**{**vars(arguments), "bus": name}), variants)

    if len(names) < 2:
        return chosen(names[0] if names else None)
    buses = tuple(map(chosen, names))
    if other := [bus.name for bus in buses if bus.kind != "can"]:
        raise CallerError(
            f"several buses at once are CAN buses, and {other[0]} is not; listen to it by itself"
        )
    if twice := [name for name in names if names.count(name) > 1]:
        raise CallerError(f"{twice[0]} is named twice")
    from .several_buses import SeveralBuses

    return SeveralBuses(buses)


class Sniffing(LiveDecoding):
    """One run of `aces sniff`. A wrong call raises before anything is opened."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.bus: ChosenBus | SeveralBuses = _chosen(arguments)
        self.link: Link = self.bus.link
        self.duration: int | None = arguments.duration
        for option in ("message", "where"):
            if getattr(arguments, option) and not arguments.protocol:
                raise CallerError(f"--{option} needs to know the messages; name a protocol: -p NAME")
        # Refused before a file is made.
        self.kind = live_kind(
            arguments.output, arguments.format, self.link, is_decoded=bool(arguments.protocol)
        )
        self.rotation = Rotation.parse(arguments.rotate)
        if self.rotation and self.kind == "lines" and arguments.record is None:
            raise CallerError(
                "--rotate is for files of frames, bytes or tables (-o, --record), and these are lines"
            )
        #: What is written instead of lines, and when it was last handed to the system (s).
        self.log: LogSeries | None = None
        self._logged = 0.0
        #: Who looks on live.
        self.live: ShownRecords | None = None
        self.times = Times(arguments.time)
        #: Where no protocol is named: candump's lines.
        self.lines: CandumpLines | None = None
        super().__init__(arguments)
        if self.kind != "lines":
            self.is_quiet = False  # nothing is printed anyway
            if self.kind == "tables":
                self.shows_losses = arguments.unknown in ("show", "only")
        self.name = utf8(self.bus.name)
        self.scanner: Any = self._own_scanner()
        self.scanner.reset()
        self.total = self.totals.setdefault(self.link, Totals())
        self.gap_ns = round(silence_s(self.scanner) * 1e9)
        #: When bytes came last, and whether the scanner knows of the silence since then.
        self.received_at, self.is_settled = 0, True
        self.epoch_ns = time.time_ns() - time.monotonic_ns()
        self.lost = ""

    def _filter(self, texts: list[str]) -> CanFilter | None:
        if texts and self.bus.kind != "can":
            raise CallerError("--filter is for CAN frames, and this is not a CAN bus")
        return parse_filter(*texts) if texts else None

    def _own_scanner(self) -> Scanner | Nameless:
        if self.variants[self.link]:
            return self._scanner(self.link, self.direction)
        return CanScanner((), include_unknown=True) if self.link == "can" else Nameless()

    def _output(self, arguments: argparse.Namespace) -> Output:
        return super()._output(arguments) if self.kind == "lines" else Output(None)

    def _writer(self, arguments: argparse.Namespace) -> Writer:
        if self.kind == "lines" and line_format(arguments.output, arguments.format) != "text":
            return super()._writer(arguments)
        from .output.text import make_paint, no_paint

        is_terminal = self.output.is_terminal
        paint = make_paint() if wants_colour(arguments.color, is_terminal) else no_paint
        if not self.plans:
            self.lines = CandumpLines(self.times, paint=paint, encoding=self.output.encoding)
        return TextOutput(
            self.plans,
            self.direction if self.direction != "both" else None,
            notes=self.registers,
            times=self.times,
            paint=paint,
            width=terminal_width() if is_terminal else None,
            encoding=self.output.encoding,
        )

    # ------------------------------------------------------------------ running

    def run(self) -> int:
        if self.arguments.screen:
            return _run_on_screen(self)
        with live_view("sniff", self.arguments, f"sniff {self.name}") as view:
            return self._run(view)

    def _run(self, view: LiveView | None) -> int:
        gate = self.bus.gate(listen_only=True)
        events, inbox = BusEventLines(gate), gate.subscribe()
        recorder = self.recorder()
        if view is not None:
            gate.on_event(lambda event: show_bus_event(view, event.bus, event.kind, event.detail))
            self.live = view.records(self.variants[self.link], scanner=self.scanner)
            self.is_watched = True
        with Patience() as patience:
            self.open(gate, recorder)
            if self.duration is None and self.count is None:
                say_note(f"{self.name}: {ENDLESS}")
            if self.lines is None and self.kind == "lines":
                self.pending = (self.name, self.link)
            try:
                self._listen(inbox, patience, events, recorder)
                gate.stop()
                if not self.is_done:
                    self._hear(inbox.get(0))
                    self._end()
            except BrokenPipeError:
                abandon_stdout()
            except KeyboardInterrupt:
                patience.is_over = True
            except CallerError as error:
                self._complain(str(error))
            finally:
                gate.stop()
                self._clean_up()
            self.end(gate, events, recorder, inbox.dropped)
        return self.status

    def open(self, gate: AnyGate | SeveralGates, recorder: RecordingFile | None) -> None:
        """Begin to record, and open the bus; where that fails, no file is left."""
        try:
            self.log = self._log()
            if recorder is not None:
                recorder.start(gate, self.name, self.epoch_ns, self._stated)
            self.bus.start(gate)
        except BaseException:
            if recorder is not None:
                recorder.abandon()
            if self.log is not None:
                self.log.abandon()
            raise

    def _log(self) -> LogSeries | None:
        """Return what -o writes, where that is not lines."""
        if self.kind == "lines":
            return None
        from .live_log import LiveFile, LiveRecording, LiveTables, LogSeries

        only = next(iter(self.messages)) if len(self.messages) == 1 and not self.shows_losses else None

        def make(path: str) -> LiveFile:
            if self.kind == "frames":
                return LiveRecording(path, self.link, "-o")
            return LiveTables(
                path, self.variants[self.link], self.scanner, only=only, shows_losses=self.shows_losses
            )

        return LogSeries(self.arguments.output, self.rotation, make, option="-o")

    def end(
        self,
        gate: AnyGate | SeveralGates,
        events: BusEventLines,
        recorder: RecordingFile | None,
        dropped: int,
    ) -> None:
        """Report the last events, finish the recording, sum up; `dropped` items came faster than they were shown."""
        events.report(last=True)
        self._close_log()
        self._close(recorder)
        self.total.count(self.scanner.counts)
        self.lost = losses(gate, dropped)
        self._summarise()

    def recorder(self) -> RecordingFile | None:
        if self.arguments.record is None:
            return None
        from .recorder import RecordingFile

        return RecordingFile(self.arguments.record, self.link, self.rotation)

    @property
    def _stated(self) -> Any:
        """Which way bytes went, as far as it was said."""
        return self.direction if self.direction != "both" else None

    def _listen(
        self, inbox: Any, patience: Patience, events: BusEventLines, recorder: RecordingFile | None
    ) -> None:
        until = None if self.duration is None else time.monotonic_ns() + self.duration
        before = 0.0
        while not patience.is_over and not self.is_done:
            wait = STEP_S if self.is_settled else min(STEP_S, self.gap_ns / 1e9)
            if until is not None:
                left = (until - time.monotonic_ns()) / 1e9
                if left <= 0:
                    return
                wait = min(wait, left)
            items = inbox.get(wait)
            if events.report():
                self._flush()
            if items:
                self._hear(items)
                self.output.flush()
                if time.monotonic() - before < 2 * TOGETHER_S:
                    time.sleep(TOGETHER_S)
                before = time.monotonic()
            else:
                self._silence()
                if inbox.is_closed:
                    return
            self._commit()
            if recorder is not None and recorder.failure is not None:
                return

    def _hear(self, items: Sequence[Any]) -> None:
        """Show what was received, up to the last line that is asked for."""
        if not items:
            return
        if self.bus.kind != "can":
            for item in items:
                if not self.is_done:
                    self._bytes(item)
            return
        frames = [received_frame(item, self.name, self.epoch_ns) for item in items]
        pieces = [frames] if self.count is None else [[frame] for frame in frames]
        for piece in pieces:
            if self.is_done:
                return
            if self.lines is not None:
                self._plain(piece, self.lines)
            else:
                self._frames(self.scanner, piece, self.total)

    def _plain(self, frames: list[Frame], lines: CandumpLines) -> None:
        """Show frames without a protocol."""
        items = self.scanner.feed(frames)
        if self.times.start is None:
            self.times.start = frames[0].timestamp
        if self.absent:
            self._seen({str(frame.channel) for frame in frames})
        kept, shown = [], []
        for frame, item in zip(frames, items, strict=True):
            if self.filter is None or self.filter.matches(frame):
                kept.append(frame)
                shown.append(item)
            else:
                self._reject(item, 1, self.total)
        if kept and self.shows_losses:
            self.printed += len(kept)
            if self.live is not None:
                self.live.put(shown)
            if self.log is not None:
                self._keep(FrameTable.from_frames(kept), len(kept))
            elif not self.is_quiet:
                self.output.write(lines.frames(kept))

    def _bytes(self, item: Any) -> None:
        """Show bytes of a serial line, or a datagram."""
        seconds = (item.host_ns + self.epoch_ns) / 1e9
        if self.lines is not None:
            items = self.scanner.feed(item.content, seconds)
            if self.times.start is None:
                self.times.start = seconds
            if self.shows_losses:
                self.printed += 1
                if self.live is not None:
                    self.live.put(items)
                chunk = Chunk(item.content, seconds, self._stated)
                if self.log is not None:
                    self._keep(chunk, len(chunk.data))
                elif not self.is_quiet:
                    self.output.write(self.lines.chunks([chunk], self.name))
            return
        if self.bus.kind == "datagram":
            self._emit(self.scanner.datagram(item.content, seconds), self.total, is_can=False)
            return
        if not self.is_settled and item.host_ns - self.received_at > self.gap_ns:
            self._emit(self.scanner.idle(seconds), self.total, is_can=False)
        self._emit(self.scanner.feed(item.content, seconds), self.total, is_can=False)
        self.received_at, self.is_settled = item.host_ns, False

    def _silence(self) -> None:
        """Take note that nothing came: after the protocol's gap, what is incomplete never will be whole."""
        now = time.monotonic_ns()
        if self.is_settled or now - self.received_at <= self.gap_ns:
            return
        self.is_settled = True
        self._emit(self.scanner.idle((now + self.epoch_ns) / 1e9), self.total, is_can=False)
        self.output.flush()

    def _end(self) -> None:
        self._begin(None)
        if self.link == "serial" and not self.is_done:
            self._emit(self.scanner.close(), self.total, is_can=False)

    def _show(self, items: list[Any]) -> None:
        if self.live is not None:
            self.live.put(items if self.count is None else items[: self.count - self.printed])
        if self.log is None:
            super()._show(items)
            return
        if self.count is not None:
            items = items[: self.count - self.printed]
        self.printed += len(items)
        self._keep(items, len(items))

    def _keep(self, item: Any, size: int) -> None:
        """Write to the log, which may go on in its next file."""
        if self.log is not None:
            with telling(self.log.file.written):
                self.log.write(item, size)

    def _commit(self) -> None:
        """Hand to the system what was written to the log, a few times a second."""
        now = time.monotonic()
        if self.log is not None and now - self._logged >= LOG_S:
            self._logged = now
            with telling(self.log.file.written):
                self.log.commit()

    def _close_log(self) -> None:
        if self.log is None:
            return
        try:
            if self.complaint:
                self.log.leave()
            else:
                self.log.close()
        except CallerError as error:
            self._complain(str(error))
        unit = "records" if self.kind == "tables" else "frames" if self.link == "can" else "bytes"
        say(f"wrote {self.log.committed} {unit} to {self.log.written}")

    def _close(self, recorder: RecordingFile | None) -> None:
        if recorder is None:
            return
        try:
            recorder.stop()
        except CallerError as error:
            self._complain(str(error))
        unit = "frames" if self.link == "can" else "bytes"
        lost = f", {recorder.dropped} came faster than they could be written" if recorder.dropped else ""
        if recorder.lost:
            lost += f", {recorder.lost} are not in it"
        say(f"recorded {recorder.recorded} {unit} in {recorder.written}{lost}")

    def _summary(self, link: Link, total: Totals) -> str:
        return f"{super()._summary(link, total)} {self.lost}"


class Nameless:
    """The scanner of bytes where no protocol is named: all of them are unknown."""

    link = "serial"
    gap = 0.0

    def __init__(self) -> None:
        self.counts = ScanCounts()

    def feed(self, data: bytes, time: float | None = None) -> list[Any]:
        offset = self.counts.total
        self.counts.total += len(data)
        self.counts.lose(len(data), "unknown")
        return [Unknown("unknown", Meta(None, None, time, None, None, data, offset=offset, size=len(data)))]

    datagram = feed

    def idle(self, time: float | None = None) -> list[Any]:
        return []

    def close(self) -> list[Any]:
        return []

    def reset(self) -> None:
        self.counts = ScanCounts()


# ---------------------------------------------------------------------- aces sniff --screen

#: Options that say something about lines.
_OF_LINES = ("where", "unknown", "count", "format", "output")


def _run_on_screen(sniffing: Sniffing) -> int:
    """Run on the screen; return the exit status. Raises `CallerError` for a wrong call, a missing terminal, a
    bus that does not open.
    """
    from .screen import check_screen, make_screen

    arguments, bus = sniffing.arguments, sniffing.bus
    for option in _OF_LINES:
        if getattr(arguments, option):
            raise CallerError(f"--{option} is about lines, and --screen prints none; press / there to filter")
    if wants_view("sniff", arguments):
        raise CallerError("choose one of --screen and a live view: two of 'aces sniff' may listen to one bus")
    if len(sniffing.messages) > 1:
        raise CallerError("--screen takes one --message; press / there to filter")
    if not isinstance(bus, ChosenBus):
        raise CallerError(f"--screen shows one bus, and {bus.name} are {len(bus.buses)}; name one of them")
    if bus.kind != "can" and not arguments.protocol:
        raise CallerError("--screen shows the packets of a protocol, and no bare bytes; name one: -p NAME")
    check_screen()
    gate = bus.gate(listen_only=True)
    events, recorder = BusEventLines(gate), sniffing.recorder()
    until = None if sniffing.duration is None else time.monotonic_ns() + sniffing.duration
    with Patience() as patience:

        def is_over() -> bool:
            is_late = until is not None and time.monotonic_ns() >= until
            return patience.is_over or is_late or (recorder is not None and recorder.failure is not None)

        screen = make_screen(
            gate,
            sniffing.scanner,
            filter=sniffing.filter,
            title=" ".join(arguments.protocol),
            record=None if recorder is None else lambda: f"{recorder.path} {recorder.recorded:,}",
            bitrate=bus.options.get("bitrate"),
            data_bitrate=bus.options.get("data_bitrate"),
            show=sorted(sniffing.messages),
            end=is_over,
            colour=arguments.color,
        )
        try:
            sniffing.open(gate, recorder)
            screen.run()
        except KeyboardInterrupt:
            pass
        finally:
            gate.stop()
        dropped = gate.counters.dropped - (recorder.dropped if recorder is not None else 0)
        sniffing.end(gate, events, recorder, dropped)
    return sniffing.status or int(screen.return_code or 0)
