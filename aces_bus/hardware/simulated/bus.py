"""A CAN bus as a simulation: bit rate, arbitration, acknowledgement, errors, load.

1. Time is the clock's. All that happens is an event of it; the same clock, calls and seed give the same bus, bit for bit.
2. Nothing is lost in silence: a frame is delivered, waits, is retransmitted, or what became of it is reported to its sender.
3. Cost is per frame, not per bit.

A frame takes its real stuffed length (`frame_time`). Whoever wants to send when the bus falls idle takes part in
arbitration; the lowest arbitration field wins, as on the wire: identifier, then RTR, SRR and IDE. A frame that no node
acknowledges, or that a fault destroys, ends in an error frame, counts at both ends (ISO 11898-1:2015, 12.1.4) and is
sent again, until its sender is bus-off. So do frames of one identifier that meet, until those that lose by their data are
error-passive: their passive error flags disturb no other frame, so that the dominant one passes (Cho and Shin, "Error
Handling of In-vehicle Networks Makes Them Vulnerable", CCS 2016, section 4).

**Not modelled**: propagation delay, sampling and clock tolerance; receivers that disagree about a frame without a fault
asking for it; overload frames. An error flag is taken to be answered one bit late, so an error frame is 15 bits.

Faults on purpose are drawn from a seed, so that what went wrong once goes wrong again; each is drawn by its
chance, per frame or per frame and receiver, in the order of the bus.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from heapq import heapify, heappop, heappush
from typing import Literal

from ...errors import CallerError
from ...frames import Frame
from ...runtime import VirtualClock
from .bus_event import SimulatedBusEvent
from .frame_time import ERROR_FRAME, INTERMISSION, SUSPEND, FrameBits, classic_bits, frame_bits


@dataclass(frozen=True)
class Faults:
    """Chances from 0 to 1.

    `corrupt`: a frame is destroyed by a bit error and sent again. `drop`: a receiver misses a frame (an overrun).
    `duplicate`: a receiver gets it twice (the last bit of EOF). `delay`: it comes late to a receiver, by up to `delay_ns`.
    """

    seed: int = 0
    corrupt: float = 0.0
    drop: float = 0.0
    duplicate: float = 0.0
    delay: float = 0.0
    delay_ns: int = 1_000_000

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name not in ("seed", "delay_ns") and not 0 <= getattr(self, field.name) <= 1:
                raise CallerError(
                    f"fault {field.name}: {getattr(self, field.name)} is not a chance from 0 to 1"
                )

    def start(self) -> FaultSource:
        """Begin the faults anew, from the seed's beginning."""
        return FaultSource(self)


NO_FAULTS = Faults()


class FaultSource:
    """Draws the faults of one bus."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._random = random.Random(faults.seed)

    def corrupts(self, bits: int) -> int | None:
        """Return the bit at which a frame of so many bits is destroyed; None: not at all."""
        if self._faults.corrupt and self._random.random() < self._faults.corrupt:
            return self._random.randrange(1, bits)
        return None

    def arrivals(self) -> tuple[int, ...]:
        """Return the delays (ns) with which a frame comes to a receiver: none, one or two."""
        faults, draw = self._faults, self._random.random
        if faults.drop and draw() < faults.drop:
            return ()
        delay = (
            self._random.randrange(1, faults.delay_ns + 1) if faults.delay and draw() < faults.delay else 0
        )
        if faults.duplicate and draw() < faults.duplicate:
            return delay, delay
        return (delay,)


State = Literal["error-active", "error-passive", "bus-off"]
#: Error counters above these make a node passive, or take it off the bus (12.1.4.3).
PASSIVE, OFF = 127, 255
_NOBODY = 1 << 40
_NEVER = 1 << 62
#: A node comes back after 128 times 11 recessive bits.
RECOVERY = 128 * 11


@dataclass
class Load:
    """What a bus has carried: frames, retransmissions included in `errors`, and nanoseconds in which it was busy."""

    frames: int = 0
    errors: int = 0
    busy_ns: int = 0
    since: int = 0

    def ratio(self, now: int) -> float:
        """Return the share of time in which the bus was busy, intermissions included."""
        return self.busy_ns / (now - self.since) if now > self.since else 0.0


class BusNode:
    """A controller on a bus; made by `SimulatedBus.attach`.

    `received` is called with each frame of others and the instant (ns) of its end; `happened` with each
    `SimulatedBusEvent` of its own. Both are called from within the simulation: they may send, and must not block.
    """

    def __init__(
        self,
        wire: SimulatedBus,
        name: str,
        received: Callable[[Frame, int], None] | None,
        happened: Callable[[SimulatedBusEvent], None] | None,
        *,
        listen_only: bool,
        fd: bool,
        mailboxes: int,
        restart_ns: int | None,
    ) -> None:
        self.wire, self.name = wire, name
        self.received, self.happened = received, happened
        self._listen_only, self.fd = listen_only, fd
        self.mailboxes, self.restart_ns = mailboxes, restart_ns
        self.transmit_errors = self.receive_errors = 0
        self.state: State = "error-active"
        self._is_connected = True
        self.quiet_until = 0
        #: Whether `happened` is called for every frame that was sent.
        self.hears_sent = happened is not None
        self.waiting: list[tuple[int, int, Frame]] = []
        #: Who wants to know what becomes of a frame, by its number.
        self.reports: dict[int, Callable[[str, str], object]] = {}
        #: What is on the wire, not among those that wait.
        self.sending: tuple[int, int, Frame] | None = None

    @property
    def listen_only(self) -> bool:
        """True if the node never sends, not even an acknowledgement."""
        return self._listen_only

    @listen_only.setter
    def listen_only(self, on: bool) -> None:
        self._listen_only = on
        self.wire.changed()

    @property
    def pending(self) -> int:
        """Number of frames that are not sent yet, with the one on the wire."""
        return len(self.waiting) + (self.sending is not None)

    def send(self, frame: Frame, report: Callable[[str, str], object] | None = None, age_ns: int = 0) -> bool:
        """Queue a frame; the most urgent identifier goes first. False when all mailboxes are full or the node is bus-off.

        `report` is called with "sent", "expired" (it did not leave within `age_ns`) or "unsent" (the node was taken off),
        and why.
        """
        if self._listen_only:
            raise CallerError(f"{self.name} only listens")
        if frame.is_error_frame:
            raise CallerError("an error frame is not sent but made by faults")
        if self.state == "bus-off" or len(self.waiting) >= self.mailboxes:
            return False
        wire = self.wire
        wire.count += 1
        is_usual = not frame.is_extended_id and not frame.is_remote_frame
        key = frame.arbitration_id << 21 if is_usual else arbitration(frame)
        heappush(self.waiting, (key, wire.count, frame))
        if report is not None:
            number = wire.count
            self.reports[number] = report
            if age_ns:
                wire.clock.call_in(age_ns, lambda: self._expire(number))
        wire.wake()
        return True

    def _expire(self, number: int) -> None:
        """Drop a frame that is too old from its mailbox, unless it is on the wire."""
        if number in self.reports:
            left = [entry for entry in self.waiting if entry[1] != number]
            if len(left) < len(self.waiting):
                heapify(left)
                self.waiting = left
            self.reports.pop(number)("expired", "it was not taken; is anybody on the bus?")

    @property
    def is_connected(self) -> bool:
        """True if the node is plugged in; otherwise nothing arrives or leaves, and waiting frames go on waiting."""
        return self._is_connected

    @is_connected.setter
    def is_connected(self, on: bool) -> None:
        self._is_connected = on
        self.wire.changed()
        if on and self.waiting:
            self.wire.wake()

    def report_sent(self) -> None:
        """Report the frame on the wire as sent."""
        if self.sending is not None:
            report = self.reports.pop(self.sending[1], None)
            if report is not None:
                report("sent", "")

    def abort(self) -> int:
        """Drop what waits to be sent; how many frames that was. The one on the wire is sent."""
        gone = self.waiting
        self.waiting = []
        for _, number, _ in gone if self.reports else ():
            if (report := self.reports.pop(number, None)) is not None:
                report("unsent", "the node was taken off, or its mailboxes were emptied")
        return len(gone)

    def restart(self) -> None:
        """Come back from bus-off: after 128 times 11 recessive bits."""
        if self.state == "bus-off":
            wire = self.wire
            wire.clock.call_in(RECOVERY * wire.bit_ns, self._recover)

    def _recover(self) -> None:
        if self.state == "bus-off":
            self.transmit_errors = self.receive_errors = 0
            self.state = "error-active"
            self.wire.changed()
            self.emit("recovered")
            if self.waiting:
                self.wire.wake()

    def emit(self, kind: str, frame: Frame | None = None) -> None:
        """Report something that happened to this node."""
        if self.happened is not None:
            self.happened(SimulatedBusEvent(kind, self.wire.clock.now(), frame))

    def count_errors(self, transmit: int, receive: int, frame: Frame) -> None:
        """Add to the error counters; tell when the state changes."""
        self.transmit_errors = max(0, self.transmit_errors + transmit)
        self.receive_errors = max(0, self.receive_errors + receive)
        if self.receive_errors > PASSIVE and receive < 0:
            self.receive_errors = PASSIVE  # back into 119…127 (12.1.4.2 h)
        if self.transmit_errors > OFF:
            self.state = "bus-off"
            self.wire.changed()
            self.emit("bus-off", frame)
            if self.restart_ns is not None:
                self.wire.clock.call_in(self.restart_ns, self.restart)
            return
        state: State = (
            "error-passive"
            if self.transmit_errors > PASSIVE or self.receive_errors > PASSIVE
            else "error-active"
        )
        if state != self.state:
            self.state = state
            self.emit(state, frame)

    def __repr__(self) -> str:
        return f"<node {self.name}: {self.state}, {self.pending} waiting>"


def arbitration(frame: Frame) -> int:
    """Return what nodes contend with, as a number: the lower one wins."""
    identifier = frame.arbitration_id
    remote = 1 if frame.is_remote_frame else 0
    if frame.is_extended_id:
        return (identifier >> 18) << 21 | 3 << 19 | (identifier & 0x3FFFF) << 1 | remote
    return identifier << 21 | remote << 20


class SimulatedBus:
    """One bus segment. `bitrate` and `data_bitrate` are in bit/s; `seed` is of the faults.

    Raises `CallerError` for rates that no CAN controller has (up to 1 and 8 Mbit/s, ISO 11898-2:2016).
    """

    def __init__(
        self,
        clock: VirtualClock,
        *,
        bitrate: int = 500_000,
        data_bitrate: int | None = None,
        faults: Faults = NO_FAULTS,
    ) -> None:
        if not 1_000 <= bitrate <= 1_000_000:
            raise CallerError(f"a bit rate of {bitrate} bit/s; CAN has 1,000 to 1,000,000")
        if data_bitrate is not None and not bitrate <= data_bitrate <= 8_000_000:
            raise CallerError(f"a data bit rate of {data_bitrate} bit/s; it is from {bitrate} to 8,000,000")
        self.clock = clock
        self.bitrate, self.data_bitrate = bitrate, data_bitrate
        self.bit_ns = round(1_000_000_000 / bitrate)
        self._pause = INTERMISSION * self.bit_ns
        self._is_whole = self.bit_ns * bitrate == 1_000_000_000
        self.nodes: list[BusNode] = []
        #: Those that take part, neither unplugged nor bus-off, and how many of them acknowledge; looked up anew when None.
        self._present: tuple[BusNode, ...] | None = None
        self._acknowledging = 0
        #: What is on the wire: who sends it, the frame, how long it takes (ns).
        self._senders: list[BusNode] = []
        self._frame: Frame | None = None
        self._duration = 0
        self.load = Load(since=clock.now())
        self.count = 0
        self._faults = faults.start() if faults != NO_FAULTS else None
        self._is_busy = False
        self._is_woken = False
        self._idle_from = 0

    def attach(
        self,
        name: str = "",
        received: Callable[[Frame, int], None] | None = None,
        happened: Callable[[SimulatedBusEvent], None] | None = None,
        *,
        listen_only: bool = False,
        fd: bool = True,
        mailboxes: int = 1024,
        restart_ns: int | None = None,
    ) -> BusNode:
        """Attach a new node. `restart_ns` is when it comes back from bus-off by itself, None: only by `restart`."""
        node = BusNode(
            self,
            name or f"node{len(self.nodes)}",
            received,
            happened,
            listen_only=listen_only,
            fd=fd,
            mailboxes=mailboxes,
            restart_ns=restart_ns,
        )
        self.nodes.append(node)
        self.changed()
        return node

    def detach(self, node: BusNode) -> None:
        """Take a node off for good."""
        node.abort()
        if node in self.nodes:
            self.nodes.remove(node)
        self.changed()

    def changed(self) -> None:
        """Look at all nodes anew: one came, went, was plugged in or out, or changed its bus-off state."""
        self._present = None

    def _look(self) -> tuple[BusNode, ...]:
        """Return the nodes that take part."""
        present = tuple(node for node in self.nodes if node.is_connected and node.state != "bus-off")
        self._acknowledging = sum(1 for node in present if not node.listen_only)
        self._present = present
        return present

    # ------------------------------------------------------------------ the bus

    def wake(self) -> None:
        """Wake the bus: a node has a frame to send."""
        if not self._is_busy and not self._is_woken:
            self._is_woken = True
            self.clock.post(self._idle_from, self._woke)  # or now, if that has passed

    def _woke(self) -> None:
        self._is_woken = False
        if not self._is_busy:
            self._carry()

    def _carry(self) -> None:
        """End the frame on the wire and begin the next, from frame to frame until another event is due."""
        clock = self.clock
        now = clock.now()
        while True:
            if self._frame is not None:
                self._deliver(now)
                for node in self.nodes:
                    if node.waiting:
                        break
                else:
                    return
                now = self._idle_from
                if not clock.skip_to(now):
                    self.wake()
                    return
            if not self._arbitrate(now):
                return
            now += self._duration
            if not clock.skip_to(now):
                clock.post(now, self._carry)
                return

    def _arbitrate(self, now: int) -> bool:
        """Begin to send the frame with the lowest arbitration field; return False if there is none, or it
        ends in an error frame.

        False: nobody sends, or it ends in an error frame.
        """
        best = _NOBODY
        sender: BusNode | None = None
        others: list[BusNode] | None = None
        later = _NEVER
        for node in self._present or self._look():
            if not node.waiting:
                continue
            if node.quiet_until > now:
                later = min(later, node.quiet_until)
                continue
            key = node.waiting[0][0]
            if key < best:
                best, sender, others = key, node, None
            elif key == best:
                others = [*(others or ()), node]
        if sender is None:
            if later != _NEVER:
                self._is_woken = True
                self.clock.call_at(later, self._woke)
            return False
        self._is_busy = True
        sender.sending = entry = heappop(sender.waiting)
        frame = entry[2]
        senders = [sender]
        if others is not None:
            senders += others
            for node in others:
                node.sending = heappop(node.waiting)
            frame = min((_sent(node) for node in senders), key=_dominance)
            losers = [node for node in senders if _dominance(_sent(node)) != _dominance(frame)]
            if any(node.state != "error-passive" for node in losers):
                self._destroy(senders, frame, "bit error", 20)
                return False
            senders = [node for node in senders if node not in losers]
            for node in losers:
                self._retry(node, "bit error", frame, now + self._time_of(frame_bits(frame)) + self._pause)
        elif self._acknowledging < 2:
            self._destroy(senders, frame, "no acknowledge", -8)
            return False
        if frame.is_fd and any(
            not node.fd and not node.listen_only and node not in senders for node in self._present or ()
        ):  # a classic controller takes FDF for a fault of form
            self._destroy(senders, frame, "bit error", 20)
            return False
        if self._faults is not None:
            place = self._faults.corrupts(frame_bits(frame).total)
            if place is not None:
                self._destroy(senders, frame, "bit error", place)
                return False
        self._senders, self._frame = senders, frame
        if self._is_whole and not frame.is_fd:
            self._duration = classic_bits(frame) * self.bit_ns
        else:
            self._duration = self._time_of(frame_bits(frame))
        return True

    def _time_of(self, bits: FrameBits) -> int:
        if not bits.data and self._is_whole:
            return bits.nominal * self.bit_ns
        return bits.duration_ns(self.bitrate, self.data_bitrate)

    def _deliver(self, now: int) -> None:
        """Deliver a good frame at its last bit."""
        senders, frame, load = self._senders, self._frame, self.load
        assert frame is not None
        self._frame = None
        load.frames += 1
        load.busy_ns += self._duration + self._pause
        self._idle_from = now + self._pause
        self._is_woken = True  # what is sent from here on takes part in the arbitration behind this frame
        try:
            for node in senders:
                if node.reports:
                    node.report_sent()
                node.sending = None
                if node.transmit_errors or node.receive_errors:
                    if node.transmit_errors:
                        node.count_errors(-1, 0, frame)
                    if node.state == "error-passive":
                        node.quiet_until = self._idle_from + SUSPEND * self.bit_ns
            self._is_busy = False
            faults = self._faults
            for node in self._present or self._look():
                if node in senders or not node.is_connected:
                    continue
                if node.receive_errors:
                    node.count_errors(0, -1, frame)
                if node.received is None:
                    continue
                if faults is None:
                    node.received(frame, now)
                    continue
                for delay in faults.arrivals():
                    self._arrive(node, frame, now, delay)
            for node in senders:
                if node.hears_sent:
                    node.emit("sent", frame)
        finally:
            self._is_woken = False

    def _arrive(self, node: BusNode, frame: Frame, now: int, delay: int) -> None:
        received = node.received
        assert received is not None
        if not delay:
            received(frame, now)
        else:
            self.clock.call_in(delay, lambda: received(frame, self.clock.now()))

    def _destroy(self, senders: list[BusNode], frame: Frame, kind: str, place: int) -> None:
        """End a frame in an error frame behind its bit `place` (negative: counted from its end)."""
        bits = frame_bits(frame)
        place = min(place, bits.total - 1) if place >= 0 else bits.total + place
        part = FrameBits(min(place, bits.nominal), max(0, min(place - bits.nominal, bits.data)))
        duration = self._time_of(part) + ERROR_FRAME * self.bit_ns

        def end() -> None:
            self.load.errors += 1
            self.load.busy_ns += duration + self._pause
            self._idle_from = self.clock.now() + self._pause
            self._is_busy = False
            for node in senders:
                self._retry(node, kind, frame, self._idle_from)
            for node in self.nodes:
                if node not in senders and node.is_connected and node.state != "bus-off":
                    node.count_errors(0, 1, frame)
            self.wake()

        self.clock.call_in(duration, end)

    def _retry(self, node: BusNode, kind: str, frame: Frame, idle_from: int) -> None:
        """Count an error of a sender, whose frame waits again; a passive one lets others go first."""
        if node.sending is not None and node in self.nodes:
            heappush(node.waiting, node.sending)
        node.sending = None
        # A passive node whose frame no node acknowledges does not count it (12.1.4.2 c, exception 1).
        if kind != "no acknowledge" or node.state != "error-passive":
            node.emit(kind, frame)
            node.count_errors(8, 0, frame)
        if node.state == "error-passive":
            node.quiet_until = idle_from + SUSPEND * self.bit_ns


def _sent(node: BusNode) -> Frame:
    assert node.sending is not None
    return node.sending[2]


def _dominance(frame: Frame) -> tuple[int, ...]:
    """Return the bits behind the arbitration field, in their order: the lower tuple is dominant at the first difference."""
    return (frame.is_fd, frame.bitrate_switch, frame.error_state_indicator, frame.length, *frame.data)


class Babbler:
    """A broken node that sends the same frame without end, as long as it is not bus-off."""

    def __init__(self, wire: SimulatedBus, frame: Frame) -> None:
        self.frame = frame
        self.node = wire.attach("babbler", happened=self._again)
        self.node.send(frame)

    def _again(self, event: SimulatedBusEvent) -> None:
        if event.kind in ("sent", "recovered"):
            self.node.send(self.frame)

    def stop(self) -> None:
        """Be quiet."""
        self.node.wire.detach(self.node)


class ListeningNode:
    """A node that only listens and keeps what it hears, the last `most` frames: (instant in ns, frame)."""

    def __init__(self, wire: SimulatedBus, most: int = 1_000_000) -> None:
        self.received: deque[tuple[int, Frame]] = deque(maxlen=most)
        self.node = wire.attach(
            "recorder", lambda frame, now: self.received.append((now, frame)), listen_only=True
        )

    def frames(self) -> Iterable[Frame]:
        """Return the frames, in order."""
        return (frame for _, frame in self.received)
