"""Forward between two buses, whole or filtered.

Without --tx it only counts what it would forward.

  aces bridge can0 vcan0
  aces bridge can0 vcan0 --tx --one-way
  aces bridge slcan:/dev/ttyACM0@500000 unix:can0 --tx --filter 060:7F0
  aces bridge can0 can1 --tx -p hubo -m Encoder --where board=0..3
  aces bridge /dev/ttyUSB0@57600 udp:10.0.0.7:5000 --tx -p ubx --one-way

Frames go between CAN buses of any kind, bytes between serial lines and UDP.
"""

from __future__ import annotations

import argparse
import os
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec

from aces_bus import Frame, Unknown, make_scanner
from aces_bus.errors import CallerError
from aces_bus.hardware.gate import Received
from aces_bus.protocol import Record, Variant
from aces_bus.recordings.base import Direction
from aces_bus.recordings.filters import parse_filter

from .bus_arg import ChosenBus, chosen_end
from .console import say
from .decoding import named_messages
from .live import LINGER_S, BusEventLines, SendQueue, silence_s
from .options import (
    DIRECTION,
    FILTER,
    FOR,
    MESSAGE,
    PROTOCOL,
    RATE,
    TX,
    WHERE,
    Arguments,
    argument,
    flag,
)
from .output.shape import plans_of
from .patience import STEP_S, Patience
from .protocols_arg import parse_protocols
from .reading.pieces import check_direction, has_requests
from .reading.where import Where

if TYPE_CHECKING:
    from .bus_arg import AnyGate

#: How long both ends are listened to before anything is forwarded, to see whether they are one wire (s), and how many
#: frames say so.
WATCH_S = 0.25
SAME = 3
#: How long what is forwarded may wait to leave (s): later it is old, and is dropped and counted.
AGE_S = 1.0
#: Refusals of a bus that are named.
FEW = 3

SUMMARY = "forward between two buses, whole or filtered; only with --tx"

EPILOG = """\
an end (A, B):
  can0  unix:can0            a network interface, a channel of 'aces bus serve'
  INTERFACE:CHANNEL[@BITRATE][?option=value&…]    any bus of python-can:
                             slcan:/dev/ttyACM0@500000, socketcan:can0?fd=true
  /dev/ttyUSB0[@BAUD]  socket://HOST:PORT        a serial line
  udp:[HOST:]PORT            datagrams: sent there, and their answers; as A of
                             --one-way those that come in at this port

what is forwarded: all frames, or those that --filter, -m and --where let pass;
error frames never. Bytes as they come; with -p whole packets, each at once
(one datagram each), and bytes that are none unless -m or --where choose.

safety: nothing is sent without --tx. A and B must not be one bus: that is
refused where their names say it, or the first frames of both are the same. Two
adapters on one silent wire are not recognised: do not bridge these. What cannot
leave within a second is dropped and counted.

summary (last on stderr, a line for each way):
  frames = forwarded + filtered + skipped + failed + late + unsent    (or bytes)
  skipped: error frames; failed: refused by the bus; late: could not leave in
  time, or the bus was lost; dropped: came faster than they were forwarded, and
  are not counted as frames
exit status: 0, also after Ctrl-C; 1 when something was not forwarded; 2 a wrong
call, or a bus that cannot be opened
"""

ARGUMENTS: Arguments = (
    argument("a", metavar="A", help="a bus; see below"),
    argument("b", metavar="B", help="the other one"),
    TX.but(help="really forward; nothing else makes it"),
    flag("--one-way", help="only from A to B; A is only listened to"),
    FILTER,
    PROTOCOL.but(help="protocols, for --message and --where, and to forward whole packets of a stream"),
    MESSAGE,
    WHERE,
    DIRECTION.but(metavar="{to,from}", help="streams: which way the bytes from A to B go"),
    RATE.but(help="CAN: send at most N frames a second on either bus"),
    FOR.but(help="end after this time: 10s, 500ms, 2min"),
)


def run(arguments: argparse.Namespace) -> int:
    return Bridge(arguments).run()


class Selection:
    """Which frames, or which bytes, pass from either end. A wrong call raises `CallerError`."""

    def __init__(self, arguments: argparse.Namespace, link: str, names: Sequence[str]) -> None:
        variants = parse_protocols(arguments.protocol)
        for variant in variants:
            if (variant.link == "can") != (link == "can"):
                raise CallerError(f"{variant.name} is spoken on a {variant.link} link, and A and B are none")
        for option in ("message", "where"):
            if getattr(arguments, option) and not variants:
                raise CallerError(f"--{option} needs to know the messages; name a protocol: -p NAME")
        if arguments.filter and link != "can":
            raise CallerError("--filter is for CAN frames, and these are bytes")
        plans = plans_of(variants)
        self.filter = parse_filter(*arguments.filter) if arguments.filter else None
        self.messages = named_messages(arguments.message, plans)
        self.where = Where(arguments.where, plans) if arguments.where else None
        self.chooses = bool(self.messages) or self.where is not None
        #: Of each end: what finds its records; None where nothing looks at them. Of CAN both are one: a reply finds its
        #: request, whichever end that came from.
        self.scanners: dict[str, Any] = dict.fromkeys(names)
        self._lock = threading.Lock()
        self._is_by_channel = any(variant.channel is not None for variant in variants)
        if link == "can":
            if self.chooses:
                scanner: Any = make_scanner(variants, include_unknown=True)
                if scanner.has_transports:
                    raise CallerError(
                        f"{', '.join(v.name for v in variants)}: messages of several frames cannot be chosen by --message"
                        " and --where; choose frames by --filter"
                    )
                self.scanners = dict.fromkeys(names, scanner)
        elif variants:
            self._of_streams(variants, arguments.direction, names)
        self._requests = any(map(has_requests, variants)) and link != "can"

    def _of_streams(
        self, variants: Sequence[Variant], direction: Direction | None, names: Sequence[str]
    ) -> None:
        opposite: dict[Any, Any] = {"to device": "from device", "from device": "to device", None: None}
        if direction not in opposite:
            raise CallerError("--direction both: bytes from A to B go one way; say to or from")
        for name, way in zip(names, (direction, opposite[direction]), strict=True):
            check_direction(variants, way)
            self.scanners[name] = make_scanner(variants, direction=way, include_unknown=True)

    def _is_wanted(self, item: Record) -> bool:
        if not self.chooses:
            return True
        if type(item) is Unknown or (self.messages and type(item).__name__ not in self.messages):
            return False
        return self.where is None or self.where.holds(item)

    def frame(self, frame: Any, end: str) -> bool:
        """Return whether a frame passes."""
        named = msgspec.structs.replace(frame, channel=end)
        is_wanted = self.filter is None or self.filter.matches(named)
        scanner = self.scanners[end]
        if scanner is not None:
            if not self._is_by_channel:
                named = msgspec.structs.replace(frame, channel=None)
            with self._lock:
                is_wanted &= all(self._is_wanted(item) for item in scanner.feed([named]))
        return is_wanted

    def packets(self, content: bytes, end: str, *, is_datagram: bool) -> list[tuple[bytes, bool]]:
        """Return bytes as they came, or whole packets and what lies between them; and whether each passes."""
        scanner = self.scanners[end]
        if scanner is None:
            return [(content, True)]
        with self._lock:
            items = scanner.datagram(content) if is_datagram else scanner.feed(content)
            return self._sorted(items, end)

    def idle(self, end: str) -> list[tuple[bytes, bool]]:
        """Give up what is incomplete after a silence, and return it."""
        with self._lock:
            return self._sorted(self.scanners[end].idle(), end)

    def _sorted(self, items: Sequence[Record], end: str) -> list[tuple[bytes, bool]]:
        found = [(bytes(item.meta.raw), self._is_wanted(item)) for item in items]
        if self._requests:
            for other, scanner in self.scanners.items():
                if other != end:
                    for raw, _ in found:
                        scanner.sent(raw)
        return found


class OneWay:
    """From one end to the other, on a thread of its own. With `target` None nothing is sent."""

    def __init__(self, name: str, source: AnyGate, target: AnyGate | None, selection: Selection) -> None:
        self.name, self.source, self.target, self.selection = name, source, target, selection
        self.inbox: Any = source.subscribe()
        self._queue = None if target is None else SendQueue(target, AGE_S)
        self._unit_is_one = unit_of(source, target) != "bytes"
        self.total = self.filtered = self.skipped = self.passed = self.refused = 0
        self._is_can = source.items == "frames"
        scanner = selection.scanners[source.name]
        self._gap_s = silence_s(scanner) if scanner else 0.0
        self._received_at: float | None = None
        #: What ended it before the end.
        self.error: Exception | None = None

    def run(self, patience: Patience) -> None:
        """Carry frames until there is an end; a way that fails is the end of both."""
        try:
            while not patience.is_over and not self.inbox.is_closed:
                wait = STEP_S if self._received_at is None else min(STEP_S, self._gap_s)
                self.forward(self.inbox.get(wait))
        except Exception as error:
            self.error = error
            patience.is_over = True

    def forward(self, items: Sequence[Received[Any]]) -> None:
        """Forward what was received, as far as it passes; nothing was: a silence."""
        if self._is_can:
            for item in items:
                self._frame(item.content)
            return
        for item in items:
            self._received_at = time.monotonic() if self._gap_s else None
            is_datagram = self.source.items == "datagrams"
            self._bytes(self.selection.packets(item.content, self.source.name, is_datagram=is_datagram))
        if not items and self._received_at is not None and time.monotonic() - self._received_at > self._gap_s:
            self._received_at = None
            self._bytes(self.selection.idle(self.source.name))

    def close(self) -> None:
        """Forward the beginning of a packet that is still held, at the end."""
        if not self._is_can and self._gap_s:
            self._bytes(self.selection.idle(self.source.name))

    def _frame(self, frame: Any) -> None:
        self.total += 1
        if frame.is_error_frame:
            self.skipped += 1
        elif not self.selection.frame(frame, self.source.name):
            self.filtered += 1
        else:
            self._send(frame, 1)

    def _bytes(self, packets: Sequence[tuple[bytes, bool]]) -> None:
        for raw, is_wanted in packets:
            size = 1 if self._unit_is_one else len(raw)
            self.total += size
            if is_wanted:
                self._send(raw, size)
            else:
                self.filtered += size

    def _send(self, packet: Frame | bytes, size: int) -> None:
        self.passed += size
        if self._queue is None:
            return
        try:
            self._queue.send(packet)
        except CallerError as error:
            self.refused += size
            if self.refused <= FEW * size:
                say(f"{self.name}: {error}")

    @property
    def lost(self) -> int:
        """Number of frames or bytes that were read here and did not reach the other side."""
        return self.passed - self._sent if self.target is not None else 0

    @property
    def _sent(self) -> int:
        return 0 if self.target is None else self.target.counters.sent

    def summary(self) -> str:
        """Return what was forwarded, in one line."""
        unit = unit_of(self.source, self.target)
        parts = [f"{unit}={self.total}"]
        if self.target is None:
            parts.append(f"would_forward={self.passed} filtered={self.filtered} skipped={self.skipped}")
        else:
            counters = self.target.counters
            failed = counters.send_failed + self.refused
            late = counters.send_dropped + counters.send_expired
            unsent = self.lost - failed - late
            parts.append(
                f"forwarded={self._sent} filtered={self.filtered} skipped={self.skipped} failed={failed} late={late}"
                f" unsent={unsent}"
            )
        dropped = self.inbox.dropped + self.source.counters.kernel_dropped
        return f"{self.name}: {' '.join(parts)} dropped={dropped}"


def unit_of(source: AnyGate, target: AnyGate | None) -> str:
    """Return what a way counts: frames, the datagrams that it sends, or bytes."""
    end = source if target is None else target
    return {"frames": "frames", "datagrams": "datagrams"}.get(end.items, "bytes")


class Bridge:
    """One run of `aces bridge`. A wrong call raises before anything is opened."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        variants = parse_protocols(arguments.protocol)
        self.ends = [replace(chosen_end(text, variants), name=text) for text in (arguments.a, arguments.b)]
        a, b = self.ends
        if (a.kind == "can") != (b.kind == "can"):
            raise CallerError(
                f"{a.name} and {b.name}: one has frames, the other bytes; a serial CAN adapter is a CAN bus:"
                " slcan:/dev/ttyACM0@500000"
            )
        if same_bus(a, b):
            raise CallerError(f"{a.name} and {b.name} are one bus: everything would come back for ever")
        if arguments.rate is not None and a.kind != "can":
            raise CallerError("--rate is for CAN, and these are bytes")
        self.selection = Selection(arguments, a.link, [a.name, b.name])
        self.status = 0

    def run(self) -> int:
        tx: bool = self.arguments.tx
        is_both = not self.arguments.one_way
        a, b = self.ends
        # A socket that nothing is given to sends nothing; one that only listens would take the address that is B's.
        gates = [
            end.gate(
                listen_only=not (sends or (is_both and end.kind == "datagram")),
                send_rate=self.arguments.rate if sends else None,
            )
            for end, sends in ((a, tx and is_both), (b, tx or b.kind == "datagram"))
        ]
        ways = [OneWay(f"{a.name} -> {b.name}", gates[0], gates[1] if tx else None, self.selection)]
        if is_both:
            ways.append(OneWay(f"{b.name} -> {a.name}", gates[1], gates[0] if tx else None, self.selection))
        back = gates[1].subscribe() if not is_both and a.kind == "can" else None
        events = [BusEventLines(gate) for gate in gates]
        with Patience() as patience:
            try:
                for end, gate in zip(self.ends, gates, strict=True):
                    end.start(gate)
                self._forward(ways, back, events, patience)
            except KeyboardInterrupt:
                patience.is_over = True
            finally:
                for gate in gates:
                    gate.stop()
                for lines in events:
                    lines.report(last=True)
        if not tx:
            say("nothing was forwarded: add --tx")
        for way in ways:
            say(way.summary(), who="")
            if way.lost and not self.status:
                self.status = 1
        return self.status

    def _forward(
        self, ways: Sequence[OneWay], back: Any, events: Sequence[BusEventLines], patience: Patience
    ) -> None:
        duration: int | None = self.arguments.duration
        until = None if duration is None else time.monotonic_ns() + duration
        held = self._watched(ways, back, patience)
        threads = [threading.Thread(target=way.run, args=(patience,), daemon=True) for way in ways]
        for way, thread, items in zip(ways, threads, held, strict=True):
            way.forward(items)
            thread.start()
        while not patience.is_over and (until is None or time.monotonic_ns() < until):
            if any(way.inbox.is_closed for way in ways):
                break
            patience.wait_until(min(until or 1 << 62, time.monotonic_ns() + round(STEP_S * 1e9)))
            for lines in events:
                lines.report()
        patience.is_over = True
        for way, thread in zip(ways, threads, strict=True):
            thread.join()
            if way.error is not None:
                raise way.error
            way.forward(way.inbox.get(0))
            way.close()
        if self.arguments.tx:
            time.sleep(LINGER_S)

    def _watched(self, ways: Sequence[OneWay], back: Any, patience: Patience) -> list[list[Any]]:
        """Return what each way receives before anything is forwarded; raise `CallerError` if both ends
        receive the same.
        """
        if self.ends[0].kind != "can":
            return [[] for _ in ways]
        patience.wait_until(time.monotonic_ns() + round(WATCH_S * 1e9))
        held = [way.inbox.get(0) for way in ways]
        other = back.get(0) if back is not None else held[1]
        if back is not None:
            back.close()
        one, two = (
            Counter((item.content.arbitration_id, item.content.data) for item in some)
            for some in (held[0], other)
        )
        most = max(one.total(), two.total())
        if (one & two).total() >= max(SAME, most - max(1, most // 10)):
            a, b = self.ends
            raise CallerError(
                f"{a.name} and {b.name} receive the same frames: they are one wire, or are bridged already;"
                " everything would come back for ever"
            )
        return held


def same_bus(a: ChosenBus, b: ChosenBus) -> bool:
    """Return whether two names are of one bus, as far as names say it."""

    def place(end: ChosenBus) -> tuple[Any, ...]:
        if end.kind == "can":
            return end.options.get("interface"), end.options.get("channel")
        return (os.path.realpath(end.options["url"]),) if end.kind == "serial" else end.options["address"]

    return a.kind == b.kind and place(a) == place(b)
