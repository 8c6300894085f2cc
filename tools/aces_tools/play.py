"""Play recordings onto a bus, at their pace. Without --tx they are only described.

  aces play walk.log
  aces play walk.log -i socketcan -c can0 --tx
  aces play monday.blf tuesday.blf -i aces -c unix:can0 --tx --speed 2 --gap 1s
  aces play walk.log --map can0=vcan1 --map can1=vcan0 -i socketcan --tx
  aces play walk.log -p hubo --foxglove
  aces play session.slog --direction to --serial /dev/ttyUSB0 --tx --loop 0

Any recording that 'aces decode' reads: CAN frames go onto a CAN bus, bytes of
a serial line onto a line or into datagrams.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, Literal

from aces_bus import Frame, open_recording
from aces_bus.errors import CallerError, CaptureError
from aces_bus.frame_table import NO_TIME, to_ns
from aces_bus.recordings.base import CanRecording, Chunk, SerialRecording
from aces_bus.recordings.filters import parse_filter

from .bus_arg import BUS_ARGUMENTS, CAN_OPTIONS, ChosenBus, chosen_bus
from .console import ENDLESS, StatusLine, report_unreadable, say, say_note
from .live import LINGER_S, BusEventLines, SendQueue
from .live_view import live_view, wants_view
from .options import (
    DIRECTION,
    FILTER,
    LOOP,
    MAP,
    PROTOCOL,
    RATE,
    TX,
    Arguments,
    argument,
    duration,
)
from .patience import Patience
from .protocols_arg import parse_protocols

if TYPE_CHECKING:
    from aces_bus.hardware.replay import Pace

    from .live_view import LiveView, ShownBus

BATCH = 256
#: What recordings are counted in, by the kind of bus.
UNITS = {"can": "frames", "serial": "bytes", "datagram": "datagrams"}
#: What may wait in a gate's queue.
WAITING = {"frames": 64, "bytes": 4096, "datagrams": 64}
#: Bytes of a serial recording that are sent at once.
PIECE = 512
#: Seconds after which a bus that takes nothing is given up.
PATIENCE_S = 5.0
#: Seconds between two looks at how far it is, on a terminal.
PROGRESS_S = 0.2
#: Identifiers that are listed.
LISTED = 24

SUMMARY = "play recordings onto a bus at their pace; only with --tx"

EPILOG = """\
channels: all frames go to the bus that -c names. With --map OLD=NEW those of
channel OLD go to the bus NEW, and others to -c, or nowhere where none is
given (filtered).

Error frames are made by controllers and cannot be sent: they are skipped.

summary (last on stderr):
  frames = sent + failed + filtered + skipped (+ unsent after Ctrl-C)
  bytes = sent + failed + filtered         (serial; of --udp: datagrams)
exit status: 0, also after Ctrl-C; 1 when something was not sent; 2 a wrong
call, a file that cannot be read, or a bus that cannot be opened
"""


ARGUMENTS: Arguments = (
    argument(
        "files", nargs="+", metavar="FILE", help="recordings, played one after another; - is standard input"
    ),
    TX,
    argument("--speed", default="1", metavar="N", help="this many times as fast, or max (default: 1)"),
    LOOP,
    argument("--gap", type=duration, metavar="DURATION", help="make no silence longer than this: 1s, 500ms"),
    RATE,
    FILTER.but(help="CAN: only what candump's filters pass, such as 060:7F0; by the recording's channels"),
    MAP.but(help="CAN: channel OLD onto the bus NEW"),
    PROTOCOL.but(help="with --foxglove: protocols, as of 'aces decode'; the first that fits wins"),
    DIRECTION.but(metavar="{to,from}", help="serial: only what went to, or came from, the device"),
    *BUS_ARGUMENTS,
)


def run(arguments: argparse.Namespace) -> int:
    playing = Playing(arguments)
    if not wants_view("play", arguments):
        return playing.run() if arguments.tx else playing.show()
    with live_view("play", arguments, f"play {', '.join(arguments.files)}") as playing.view:
        return playing.run()


class Playing:
    """One run of `aces play`. A wrong call raises before anything is opened."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.files: list[str] = arguments.files
        self.speed = _speed(arguments.speed)
        self.gap = None if arguments.gap is None else arguments.gap / 1e9
        self.loops: int = arguments.loop
        if self.loops != 1 and "-" in self.files:
            raise CallerError("standard input can be played once only; --loop needs a file")
        self.filter = parse_filter(*arguments.filter) if arguments.filter else None
        self.map = _mapped(arguments.map)
        self.direction = arguments.direction if arguments.direction != "both" else None
        is_named = any(name in arguments for name in CAN_OPTIONS) or arguments.serial or arguments.udp
        self.bus: ChosenBus | None = chosen_bus(arguments) if arguments.tx or is_named or self.map else None
        if self.bus is not None and self.bus.kind != "can":
            for option in ("filter", "map", "rate"):
                if getattr(arguments, option):
                    raise CallerError(f"--{option} is for CAN, and {self.bus.name} is not a CAN bus")
        if self.bus is not None and self.bus.kind == "can" and self.direction is not None:
            raise CallerError("--direction is for bytes of a serial line, and this is a CAN bus")
        self.total = self.filtered = self.skipped = self.unsent = 0
        self.unit = "frames" if self.bus is None else UNITS[self.bus.kind]
        self.variants = parse_protocols(arguments.protocol)
        if self.variants and not wants_view("play", arguments):
            raise CallerError(
                "-p is for a live view (--foxglove): what is played onto a bus is played as it is"
            )
        #: Who looks on live, and what is shown of each link.
        self.view: LiveView | None = None
        self.live: dict[str, ShownBus] = {}
        self.buses = self._buses()
        self.status = 0
        #: Of a recording that is shown: frames by identifier, channels, first and last time.
        self.seen: Counter[str] = Counter()
        self.channels: dict[str, None] = {}
        self.outgoing: dict[str, SendQueue] = {}
        self.events: list[BusEventLines] = []
        self.status_line = StatusLine()
        self._shown_at = 0.0
        self._began = 0.0

    # ------------------------------------------------------------------ what is played

    def _open(self, name: str) -> CanRecording | SerialRecording:
        if self.bus is not None:
            return open_recording(name, link=self.bus.link)
        is_serial = bool(self.variants) and all(variant.link != "can" for variant in self.variants)
        return open_recording(name, link="serial" if is_serial else None)

    def _items(self, capture: CanRecording | SerialRecording, patience: Patience) -> Iterator[Frame | Chunk]:
        """Yield what of a recording is to be sent; the rest is counted."""
        if isinstance(capture, CanRecording):
            for frames in patience.each(capture.batches(BATCH)):
                for frame in frames:
                    self.total += 1
                    if frame.is_error_frame:
                        self.skipped += 1
                    elif (self.filter is not None and not self.filter.matches(frame)) or not (
                        not self.map or str(frame.channel) in self.map or "channel" in self.arguments
                    ):
                        self.filtered += 1
                    else:
                        yield frame
            return
        for chunk in patience.each(capture):
            size = 1 if self.unit == "datagrams" else len(chunk.data)
            self.total += size
            if self.direction is not None and chunk.direction not in (None, self.direction):
                self.filtered += size
            else:
                yield chunk

    def _failed(self, error: CaptureError) -> None:
        say(str(error))
        self.status = 2

    # ------------------------------------------------------------------ without --tx

    def show(self) -> int:
        """Say what would be sent, and send nothing."""
        with Patience() as patience:
            for name in self.files:
                try:
                    with self._open(name) as capture:
                        if self.bus is None:
                            self.unit = UNITS[capture.link]
                        self._describe(capture, patience)
                        report_unreadable(capture, is_over=True)
                except CaptureError as error:
                    self._failed(error)
                except KeyboardInterrupt:
                    patience.is_over = True
                if patience.is_over:
                    return 130
        if not self.status:
            say("nothing was sent: add --tx" + ("" if self.bus is not None else " and a bus"))
        self._summarise(0, 0)
        return self.status

    def _describe(self, capture: CanRecording | SerialRecording, patience: Patience) -> None:
        first = last = None
        self.seen.clear()
        self.channels.clear()
        size = 0
        for item in self._items(capture, patience):
            if isinstance(item, Frame):
                instant = item.timestamp
                size += 1
                self.channels[str(item.channel)] = None
                self.seen[f"{item.arbitration_id:0{8 if item.is_extended_id else 3}X}"] += 1
            else:
                instant = item.time
                size += len(item.data)
                self.seen[item.direction or "direction not known"] += len(item.data)
            if instant is not None:
                first = instant if first is None else first
                last = instant if last is None else max(last, instant)
        unit = "frames" if capture.link == "can" else "bytes"
        seconds = (last - first) if first is not None and last is not None else None
        lasts = "" if seconds is None else f" in {seconds:.3f} s"
        where = f", channels {', '.join(self.channels)}" if self.channels else ""
        print(f"{capture.name}: {size} {unit}{lasts}{where}")
        rows = self.seen.most_common(LISTED)
        for name, number in sorted(rows) if capture.link == "can" else rows:
            rate = f"  {number / seconds:10.1f} /s" if seconds else ""
            print(f"  {name:>8}  {number:8}{rate}")
        if len(self.seen) > LISTED:
            print(f"  and {len(self.seen) - LISTED} more identifiers")

    # ------------------------------------------------------------------ with --tx

    def run(self) -> int:
        """Play: onto buses with --tx, and for who looks on."""
        gates = {
            name: bus.gate(listen_only=False, send_rate=self.arguments.rate)
            for name, bus in (self.buses if self.arguments.tx else {}).items()
        }
        with Patience() as patience:
            try:
                for name, gate in gates.items():
                    self.events.append(BusEventLines(gate))
                    self.buses[name].start(gate)
                    self.outgoing[name] = SendQueue(gate, PATIENCE_S)
                self._began = time.monotonic()
                self._play(patience)
                for outgoing in self.outgoing.values():
                    outgoing.drain(patience, seconds=PATIENCE_S)
                patience.wait_until(time.monotonic_ns() + round(LINGER_S * 1e9))
            except KeyboardInterrupt:
                patience.is_over = True
            finally:
                for gate in gates.values():
                    gate.stop()
                self.status_line.clear()
                self._tell(last=True)
        sent = sum(gate.counters.sent for gate in gates.values())
        failed = sum(gate.counters.send_failed for gate in gates.values())
        if not self.arguments.tx:
            say_note("nothing was sent: that takes --tx and a bus")
            self._summarise(0, 0)
            return self.status
        self.unsent = self.total - self.filtered - self.skipped - sent - failed
        self._summarise(sent, failed)
        dropped = sum(gate.counters.send_dropped + gate.counters.send_expired for gate in gates.values())
        if failed or dropped or (self.unsent and not patience.is_over):
            self.status = self.status or 1
        return self.status

    def _buses(self) -> dict[str, ChosenBus]:
        """Return the buses that are played onto, by name."""
        if self.bus is None:
            return {}
        found = {self.bus.name: self.bus} if not self.map or "channel" in self.arguments else {}
        for name in self.map.values():
            found.setdefault(name, self.bus.on(name))
        return found

    def _to(self, item: Frame | Chunk) -> SendQueue:
        assert self.bus is not None
        name = self.map.get(str(item.channel)) if isinstance(item, Frame) else None
        return self.outgoing[name if name is not None else self.bus.name]

    def _play(self, patience: Patience) -> None:
        done = 0
        if not self.loops:
            say_note(ENDLESS)
        while not patience.is_over and (not self.loops or done < self.loops):
            done += 1
            before = self.total
            for name in self.files:
                if patience.is_over:
                    return
                try:
                    with patience.waiting():
                        capture = self._open(name)
                    with capture:
                        if self.bus is None:
                            self.unit = UNITS[capture.link]
                        self._file(capture, patience)
                        if done == 1:
                            report_unreadable(capture, is_over=True)
                except CaptureError as error:
                    self._failed(error)
            if self.total == before:
                return  # nothing in them: for ever would be for nothing

    def _file(self, capture: CanRecording | SerialRecording, patience: Patience) -> None:
        from aces_bus.hardware.replay import Pace
        from aces_bus.runtime import RealClock

        pace = Pace(RealClock(), self.speed, self.gap)
        line = _Line(pace, self._byte_ns)
        for item in self._items(capture, patience):
            outgoing = self._to(item) if self.arguments.tx else None
            stamp = to_ns(item.timestamp if isinstance(item, Frame) else item.time)
            for due, piece in line.pieces(item, stamp, is_split=self.unit == "bytes"):
                if not patience.wait_until(due):
                    return
                if outgoing is None:
                    continue
                most = self.most
                if outgoing.pending > most and not outgoing.drain(patience, most // 2, PATIENCE_S):
                    if not patience.is_over:
                        say(f"{outgoing.gate.name}: it takes no more; is another node on the bus?")
                        patience.is_over = True
                        self.status = 1
                    return
                try:
                    outgoing.send(piece)
                except CallerError as error:
                    say(str(error))
                    patience.is_over = True
                    self.status = 1
                    return
            if self.view is not None:
                self._show_live(self.view, item, stamp)
            self._tell()
            self._progress()

    def _show_live(self, view: LiveView, item: Frame | Chunk, stamp: int) -> None:
        """Show a played item in the live view, at the recording's own time."""
        is_can = isinstance(item, Frame)
        link: Literal["can", "serial", "datagram"] = (
            "can" if is_can else "datagram" if self.unit == "datagrams" else "serial"
        )
        instant = (time.time_ns() if stamp == NO_TIME else stamp) - view.epoch_ns
        shown = self.live.get(link)
        if shown is None:
            variants = [variant for variant in self.variants if (variant.link == "can") is is_can]
            if not variants and not is_can:
                raise CallerError("live view: what do these bytes mean? name a protocol: -p NAME")
            shown = self.live[link] = view.bus(variants, name="", link=link, direction="both")
        if isinstance(item, Frame):
            shown.passed(item, instant, True)
        else:
            shown.passed(item.data, instant, item.direction == "to device")

    @property
    def most(self) -> int:
        """Most items that may wait to be sent: as many as leave within `PATIENCE_S`, so that few are old
        after a standstill.
        """
        most, rate = WAITING[self.unit], self.arguments.rate
        return most if rate is None else max(1, min(most, int(rate * PATIENCE_S / 2)))

    @property
    def _byte_ns(self) -> float:
        """Duration of a byte (ns), for a recording without times."""
        baud = self.bus.options.get("baud") if self.bus is not None else None
        return 10e9 / baud / self.speed if baud and self.speed else 0.0

    def _tell(self, *, last: bool = False) -> None:
        for events in self.events:
            events.report(last=last)

    def _progress(self) -> None:
        now = time.monotonic()
        if now - self._shown_at >= PROGRESS_S:
            self._shown_at = now
            self.status_line.show(f"{now - self._began:.1f} s  {self.total} {self.unit}")

    def _summarise(self, sent: int, failed: int) -> None:
        parts = [f"{self.unit}={self.total}", f"sent={sent}", f"failed={failed}", f"filtered={self.filtered}"]
        if self.unit == "frames":
            parts.append(f"skipped={self.skipped}")
        if self.unsent:
            parts.append(f"unsent={self.unsent}")
        say(" ".join(parts), who="")


class _Line:
    """When each piece of a recording goes out."""

    def __init__(self, pace: Pace, byte_ns: float) -> None:
        self._pace, self._byte_ns = pace, byte_ns
        self._free = 0.0

    def pieces(self, item: Any, stamp: int, *, is_split: bool) -> Iterable[tuple[int, Frame | bytes]]:
        """Yield the pieces of a frame or chunk, each with its instant; where there are no times, as fast as the line."""
        due = self._pace.due_at(stamp)
        if isinstance(item, Frame):
            yield due, item
            return
        step = PIECE if is_split else max(1, len(item.data))
        for start in range(0, len(item.data), step):
            piece = item.data[start : start + step]
            if stamp == NO_TIME:
                due = round(max(due, self._free))
                self._free = due + len(piece) * self._byte_ns
            yield due, piece


def _speed(text: str) -> float | None:
    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed <= 1e6:
        raise CallerError(f"--speed {text!r} is not a pace; write 1, 0.5, 10 or max")
    return speed


def _mapped(texts: list[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for text in texts:
        old, sign, new = text.partition("=")
        if not (old and sign and new):
            raise CallerError(f"--map {text!r}: write OLD=NEW, such as can0=vcan1")
        if old in found:
            raise CallerError(f"--map: {old} is named twice")
        found[old] = new
    return found
