"""How frames get into a capture: recordings to their end, a bus as long as the page is served; on a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from aces_bus import FrameTable, Unknown, make_scanner
from aces_bus.errors import AcesError
from aces_bus.frame_table import NO_TIME, Channels, to_ns
from aces_bus.protocol import Variant
from aces_bus.recordings.base import CanRecording, SerialRecording
from aces_tools.bus_arg import ChosenBus
from aces_tools.live import received_frame
from aces_tools.reading.pieces import Direction, SerialWays, open_any

from .capture import Capture

#: How long a bus is waited for at once (s): the end of the command waits no longer.
STEP_S = 0.1


class Feeder:
    """A thread that fills a capture until the source ends, or `stop` is called. `begin` says how it is filled."""

    def __init__(self, capture: Capture, fill: Callable[[Feeder], None]) -> None:
        self.capture = capture
        self._fill = fill
        self.is_over = False
        self._thread = threading.Thread(target=self._run, name="studio feeder", daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """End reading; waits for the thread."""
        self.is_over = True
        self._thread.join(5.0)

    def _run(self) -> None:
        try:
            self._fill(self)
        except AcesError as error:
            self.capture.notes.append(str(error))
        except Exception as error:  # the page says what happened, and shows what was read before
            self.capture.notes.append(f"reading ended: {type(error).__name__}: {error}")
        finally:
            self.capture.is_done = True


def of_recordings(
    names: Sequence[str], variants: Sequence[Variant], direction: Direction | None
) -> Callable[[Feeder], None]:
    """Return what fills a capture from recordings, one behind the other."""

    def fill(feeder: Feeder) -> None:
        for name in names:
            with open_any(name) as recording:
                if isinstance(recording, CanRecording):
                    for table in recording.tables():
                        feeder.capture.add_frames(table)
                        if feeder.is_over:
                            return
                else:
                    _add_serial(feeder, recording, variants, direction)
                if unreadable := recording.lines_unreadable:
                    feeder.capture.notes.append(f"{name}: {unreadable} lines cannot be read")

    return fill


def _add_serial(
    feeder: Feeder, recording: SerialRecording, variants: Sequence[Variant], direction: Direction | None
) -> None:
    some = [variant for variant in variants if variant.link != "can"]
    if not some:
        feeder.capture.notes.append(
            f"{recording.name}: bytes of a serial line: name its protocol with -p; 'aces decode FILE' says what fits"
        )
        return
    ways = SerialWays(
        some,
        direction,
        lambda way: make_scanner(some, direction=way, include_unknown=True),
        lambda scanner, data, instant: scanner.feed(data, instant),
    )
    for chunk in ways.chunks(recording):
        for items in ways.feed(chunk):
            _add_packets(feeder.capture, items, recording.name)
        if feeder.is_over:
            return
    for items in ways.close():
        _add_packets(feeder.capture, items, recording.name)


def of_bus(bus: ChosenBus, variants: Sequence[Variant], gate: Any) -> Callable[[Feeder], None]:
    """Return what fills a capture from a bus whose gate is open; nothing is sent."""

    def fill(feeder: Feeder) -> None:
        capture, inbox = feeder.capture, gate.subscribe()
        epoch_ns = time.time_ns() - time.monotonic_ns()
        channels = Channels()
        scanner: Any = (
            make_scanner(variants, include_unknown=True) if bus.kind != "can" and variants else None
        )
        dropped = 0
        while not feeder.is_over and not inbox.is_closed:
            items = inbox.get(STEP_S)
            if not items:
                continue
            if bus.kind == "can":
                frames = [received_frame(item, bus.name, epoch_ns) for item in items]
                capture.add_frames(FrameTable.from_frames(frames, channels))
            elif scanner is not None:
                for item in items:
                    feed = scanner.datagram if bus.kind == "datagram" else scanner.feed
                    _add_packets(capture, feed(item.content, (item.host_ns + epoch_ns) / 1e9), bus.name)
            if inbox.dropped != dropped:
                dropped = inbox.dropped
                capture.notes[:] = [f"{dropped} frames came faster than they could be taken"]

    return fill


def _add_packets(capture: Capture, items: Iterable[Any], channel: str | None) -> None:
    """Add records by their kind; what is no packet is a kind of its own."""
    kinds: dict[str, list[tuple[int, bytes, Any]]] = {}
    for item in items:
        is_unknown = isinstance(item, Unknown)
        kind = item.kind if is_unknown else type(item).__name__
        instant = NO_TIME if item.meta.time is None else to_ns(item.meta.time)
        kinds.setdefault(kind, []).append((instant, item.meta.raw, None if is_unknown else item))
    for kind, packets in kinds.items():
        capture.add_packets(kind, channel, packets)
