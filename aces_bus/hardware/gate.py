"""What every gatekeeper is: the one owner of a bus, with threads of its own or on a robot's loop, that many may listen to.

1. A bus that is lost is opened again, and what was lost with it is counted and reported.
2. A gate that only listens has no way to send: no queue and no thread.
3. The thread that receives runs no user code and survives every exception: an adapter's errors become events.
4. Every loss is counted where it happens: in the system, in a queue, in what the adapter reports.
5. A packet that was given ends in exactly one bin (`outbox`), and is reported once.
6. An urgent packet, a stop, goes before all else that waits here, and takes the place of what waits for its device.
7. While a bus is lost no set-point waits for it: an old set-point, sent when the bus is back, would move a robot. Urgent
   packets wait, and leave first.
8. `stop` lets waiting packets leave before it closes the bus.

By itself a gate has two threads, one to receive and one to send. On a loop (`start_on`) it has none where its bus has a
file to wait for: the loop reads what is there, and what was given in one turn leaves together at its end. Threads do only
what may block: a backend without such a file, or that cannot send at once, and the opening of a bus that was lost.

Events are the shortcut from the hardware upwards: a handler is called at once, on the thread where the event happens, before
anything else is done about it, and must be quick. A handler that raises is counted, and stops nothing.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import ClassVar, Generic, Literal, Protocol, Self, TypeVar

import msgspec

from ..errors import CallerError
from ..runtime import RealClock
from ..runtime.clock import Clock
from ..runtime.loop import Loop
from .gate_events import BusEvent, BusEvents, GateCounters, Handler, Kind
from .lock import BusLock
from .queues import AGE_S, LIMIT, Fate, Inbox, Listener, Outbox, OutboxItem, Report

Item = TypeVar("Item")
Packet = TypeVar("Packet")
Bus = TypeVar("Bus")
Filtered = TypeVar("Filtered", contravariant=True)

#: Seconds between attempts to open a lost bus: the first, and the longest.
RETRY_S, RETRY_MOST_S = 0.1, 2.0
#: Seconds that `stop` gives to what waits to be sent, and to a thread that is inside a backend.
DRAIN_S, JOIN_S = 1.0, 5.0
#: How soon a bus that takes no more for now is tried again (ns).
AGAIN_NS = 1_000_000
#: How old a packet may be when it leaves, by default (ns).
AGE_NS = round(AGE_S * 1e9)
#: Seconds that a thread waits before it looks at other things.
POLL_S = 0.2

#: Where each fate is counted.
_BINS: dict[Fate, str] = {
    "sent": "sent",
    "failed": "send_failed",
    "expired": "send_expired",
    "dropped": "send_dropped",
    "unsent": "unsent",
}

TOO_OLD = "too old, they do not leave late"
STALLED = "the adapter does not take them in time, and they do not leave late"


class ContentFilter(Protocol[Filtered]):
    """A filter of received items: a `CanFilter` for frames."""

    def matches(self, content: Filtered, /) -> bool:
        """Return whether the reader wants this."""
        ...


class Received(msgspec.Struct, Generic[Item], frozen=True, gc=False):
    """A received frame, run of bytes or datagram, with the instant of the host's monotonic clock when it was read (ns).

    `is_own`: bytes that this gate has sent. `source`: who sent a datagram.
    """

    content: Item
    host_ns: int
    is_own: bool = False
    source: tuple[str, int] | None = None


class Gate(ABC, Generic[Item, Packet, Bus]):
    """One bus and its only owner; a context manager. See `CanGate`, `SerialGate` and `DatagramGate`.

    `Item` is received, `Packet` is sent, `Bus` is what a kind of gate opens.
    """

    #: What items are called in events, and what is counted of what is sent.
    items: ClassVar[str]
    unit: ClassVar[str]
    #: How much may wait to be sent, in that unit.
    most: ClassVar[int]
    #: How many packets are given to the bus together, at most.
    together: int = 64

    def __init__(self, name: str, *, listen_only: bool, reopen: bool, clock: Clock | None) -> None:
        self.name, self.listen_only, self.reopen = name, listen_only, reopen
        self.clock: Clock = clock if clock is not None else RealClock()
        #: What is taken before the bus is opened, so that one program of this machine drives it; None: nothing.
        self.lock: BusLock | None = None
        self.counters = GateCounters()
        self.events = BusEvents()
        self.state: Literal["new", "open", "lost", "closed"] = "new"
        self._bus: Bus  # from its first opening on
        self._inboxes: tuple[Inbox[Received[Item]], ...] = ()
        self._listeners: list[Listener[Received[Item]]] = []
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._threads: list[threading.Thread] = []
        #: Guards the outbox; `_outgoing` is notified when it changes.
        self._guard = threading.RLock()
        self._outgoing = threading.Condition(self._guard)
        self._outbox: Outbox[Packet] = Outbox()
        #: What this turn of the loop has given so far: packet, age limit (ns), topic. Appended on the loop's thread alone.
        self._given: deque[tuple[Packet, int, object]] = deque()
        #: What the transmit thread has in hand.
        self._in_hand: OutboxItem[Packet] | None = None
        self._transmitter: threading.Thread | None = None
        self._is_closing = False
        #: How long a bus stays open after the last packet (ns), where its backend may hold it and does not say so.
        self.linger_ns, self._last_sent = 0, 0
        #: What was given while the bus was lost, and not said yet.
        self._refused = 0
        #: On a loop: who gets what arrives, the file that is waited for, and whether the loop itself sends.
        self._loop: Loop | None = None
        self._received: Callable[[list[Received[Item]]], object] | None = None
        self._file: int | None = None
        self._is_sending_here = self._is_flush_planned = False
        #: Whether what arrives may wait for more there: where each packet says itself when it came.
        self._gathers = False

    def start(self) -> Self:
        """Open the bus and begin to receive.

        Raises what opening raises: a bus that cannot be opened at first is the caller's to know.
        """
        self._open_first()
        self._thread(self._receive, "receive")
        if not self.listen_only:
            self._transmitter = self._thread(self._transmit, "send")
        return self

    def start_on(self, loop: Loop, received: Callable[[list[Received[Item]]], object]) -> Self:
        """Open the bus; `received` gets what arrives, on the loop's thread; its clock is the loop's. Raises as `start`."""
        self._loop, self._received, self.clock = loop, received, loop
        self._open_first()
        self._attach()
        self._look_again()
        return self

    def stop(self, drain_s: float = DRAIN_S) -> int:
        """Let what waits leave, at most for `drain_s` seconds, and close the bus. Readers get what is still queued.

        How much could not be sent, of all that was given since the gate was opened and is not counted elsewhere
        (`Counters.unsent`); it is an event "not sent" too.
        """
        if self.state in ("new", "closed"):
            self.state = "closed"
            return self.counters.unsent
        try:
            self._drain(drain_s)
        finally:
            self._end()
        return self.counters.unsent

    def _end(self) -> None:
        self._is_closing = True
        self._stopping.set()
        self._detach()
        with self._guard:
            left_over = self._outbox.take(lambda item: True)
            self._outgoing.notify_all()
        held = self._still_held() if self.state == "open" else 0
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(JOIN_S)
        with self._guard:
            if self._in_hand is not None:  # its thread does not come back
                left_over.append(self._in_hand)
        self._settle_all(left_over, "unsent", "the gate was closed")
        if held:  # counted as sent, and known better now
            self.counters.sent -= held
            self.counters.unsent += held
            self._emit(
                "not sent", f"{held} {self.unit}: the adapter still held them when it was closed", held
            )
        self._emit_refused()
        self._close(self._bus)
        self._unlock()
        self.state = "closed"
        for inbox in self._inboxes:
            inbox.end()
        for listener in self._listeners:
            listener.stop()
        self._emit("closed")

    def __enter__(self) -> Self:
        return self.start() if self.state == "new" else self

    def __exit__(self, *_: object) -> None:
        self.stop()

    # ------------------------------------------------------------------ what a kind of bus does

    @abstractmethod
    def _opened(self) -> Bus:
        """Open the bus; raises what the system or a backend raises."""

    @abstractmethod
    def _shut(self, bus: Bus) -> None:
        """Close a bus; may raise, and need not succeed."""

    @abstractmethod
    def _receive(self) -> None:
        """Receive until `_stopping` is set or `_lose` returns False: the body of the receive thread."""

    @abstractmethod
    def _put_out(self, packet: Packet, /) -> None:
        """Give a packet to the bus, on the transmit thread; raises what the backend raises."""

    def _priority_of(self, packet: Packet, /) -> int:
        """Return what goes first of what is given together: the lowest."""
        return 0

    @abstractmethod
    def _name_of(self, packet: Packet, /) -> str:
        """Return what a packet is called in events."""

    def _leaves_at(self) -> int:
        """Return the instant (ns) from which the next packet may be given to the bus."""
        return 0

    def _file_of(self, bus: Bus) -> int | None:
        """Return the file of a bus that a loop can wait for; None: it takes a thread to receive."""
        return None

    def _watched(self, bus: Bus) -> None:
        """Prepare a bus whose file a loop watches: it must never block."""

    def _read_now(self) -> list[Received[Item]]:
        """Return what its file has, without waiting; raises what says that the bus is gone."""
        raise NotImplementedError

    def _can_put_together(self) -> bool:
        """Return whether the bus takes packets at once, on a loop: `_put_together`."""
        return False

    def _put_together(self, packets: list[Packet], /) -> tuple[int, Exception | None]:
        """Give packets to the bus without waiting: how many it took, and why it refused the next one (None: it is full)."""
        raise NotImplementedError

    def _push(self) -> bool:
        """Give the bus the rest of a packet that it took in part; whether nothing is left of it."""
        return True

    def _glance(self) -> None:
        """Look, now and then, at what the bus says of itself."""

    def _still_held(self) -> int:
        """Return how much the backend itself says that it still holds."""
        return 0

    @staticmethod
    def _describe(bus: Bus) -> str:
        """Return what an event says of an open bus."""
        return str(getattr(bus, "channel_info", "") or getattr(bus, "name", "") or "")

    # ------------------------------------------------------------------ who wants to know

    def subscribe(
        self, *, limit: int = LIMIT, filter: ContentFilter[Item] | None = None
    ) -> Inbox[Received[Item]]:
        """Open a queue of what arrives from now on, at most `limit` items of those that `filter` matches; `close` it
        to leave.
        """
        wanted = None if filter is None else lambda item: filter.matches(item.content)
        inbox: Inbox[Received[Item]] = Inbox(limit, wanted, self._leave, self._overflowed)
        with self._lock:
            self._inboxes += (inbox,)
        if self.state == "closed":
            inbox.end()
        return inbox

    def listen(
        self,
        listener: Callable[[list[Received[Item]]], None],
        *,
        limit: int = LIMIT,
        filter: ContentFilter[Item] | None = None,
    ) -> Listener[Received[Item]]:
        """Call `listener` with what arrives, on a thread of its own. What it raises becomes an event."""

        def failed(error: BaseException) -> None:
            self._emit("listener", f"{type(error).__name__}: {error}")

        inbox = self.subscribe(limit=limit, filter=filter)
        made = Listener(inbox, listener, failed, f"{self.name} listener")
        self._listeners.append(made)
        return made

    def on_event(self, handler: Handler) -> None:
        """Call `handler` at once with everything that happens to the bus."""
        self.events.add(handler)

    def _leave(self, inbox: Inbox[Received[Item]]) -> None:
        with self._lock:
            self._inboxes = tuple(known for known in self._inboxes if known is not inbox)

    def _overflowed(self, count: int) -> None:
        self.counters.dropped += count
        self._emit("dropped", f"{count} {self.items} came faster than a reader takes them", count)

    def _put(self, batch: list[Received[Item]]) -> None:
        """Hand over what has arrived."""
        for inbox in self._inboxes:
            inbox.put(batch)
        received, loop = self._received, self._loop
        if received is None or loop is None:
            return
        if loop.is_own_thread:
            received(batch)
        else:
            loop.call_soon(lambda: received(batch))

    def _emit(self, kind: Kind, detail: str = "", count: int = 0) -> None:
        self.events.emit(BusEvent(kind, self.clock.now(), self.name, detail, count))

    # ------------------------------------------------------------------ opening and losing

    def _open_first(self) -> None:
        if self.state != "new":
            raise CallerError(f"{self.name}: this gate was started before; make another")
        if self.lock is not None:
            self.lock.take()
            if self._loop is not None:
                self.lock.listen(self._loop)
        try:
            self._bus = self._opened()
        except BaseException:
            self._unlock()
            raise
        self.state = "open"
        self._emit("opened", self._describe(self._bus))

    def _unlock(self) -> None:
        if self.lock is not None:
            self.lock.release()

    def _thread(self, target: Callable[[], None], what: str) -> threading.Thread:
        thread = threading.Thread(target=target, name=f"{self.name} {what}", daemon=True)
        thread.start()
        self._threads.append(thread)  # `stop` may come meanwhile, and joins those that run
        return thread

    def _close(self, bus: Bus) -> None:
        if bus is not None:
            try:
                self._shut(bus)
            except Exception:  # an adapter that is gone may refuse even this
                pass

    def _lose(self, error: BaseException | None) -> bool:
        """Report a lost bus and open it again, on the receive thread; return False when the gate is to end."""
        self._gone(error)
        bus = self._found_again()
        if bus is None:
            return False
        self._back(bus)
        return True

    def _gone(self, error: BaseException | None) -> None:
        """Report a lost bus, and drop the packets that waited for it."""
        self.state = "lost"
        why = "it does not answer any more" if error is None else f"{type(error).__name__}: {error}"
        self._emit("lost", why)
        self._gather()
        with self._guard:
            gone = self._outbox.take(lambda item: not item.urgent)
            self._outgoing.notify_all()
        self._settle_all(gone, "dropped", "the bus is lost")
        self._close(self._bus)

    def _found_again(self) -> Bus | None:
        """Try to open the bus until that succeeds; None when the gate is to end."""
        wait = RETRY_S
        while self.reopen and not self._stopping.wait(wait):
            try:
                return self._opened()
            except Exception:  # still gone
                wait = min(2 * wait, RETRY_MOST_S)
        if not self.reopen:
            for inbox in self._inboxes:
                inbox.end()
        return None

    def _back(self, bus: Bus) -> None:
        """Report that the bus is open again."""
        self._bus = bus
        self.state = "open"
        self.counters.reopened += 1
        self._emit("reopened", self._describe(bus))
        self._emit_refused()
        with self._guard:
            self._outgoing.notify_all()

    # ------------------------------------------------------------------ sending

    def _check_may_send(self) -> None:
        if self.listen_only:
            raise CallerError(f"{self.name}: this gate only listens; open it without listen_only to send")
        if self._is_closing or self.state in ("new", "closed"):
            raise CallerError(f"{self.name}: this gate is not open")

    @property
    def waiting(self) -> int:
        """Number of items that wait to be sent, in `unit`."""
        return self._outbox.size + len(self._given)

    def _queue(
        self,
        packet: Packet,
        size: int,
        priority: int,
        age_s: float | None,
        urgent: bool,
        topic: object,
        report: Report | None,
    ) -> bool:
        """Queue a packet; False when the bus is lost and it is dropped. Raises `CallerError` as `send`."""
        if self._given:
            self._gather()
        until = self.clock.now() + (AGE_NS if age_s is None else round(age_s * 1e9))
        item = OutboxItem(packet, size, until, urgent, topic, report, age_s is not None)
        overtaken: list[OutboxItem[Packet]] = []
        with self._guard:
            if self.state != "open" or self.listen_only or self._is_closing:
                self._check_may_send()
            is_taken = urgent or self.state == "open"
            if is_taken:
                if urgent:
                    if topic is not None and self._outbox:
                        overtaken = self._outbox.take(
                            lambda queued: queued.topic is topic and not queued.urgent
                        )
                elif self._outbox.size + size > self.most:
                    raise CallerError(
                        f"{self.name}: {self._outbox.size} {self.unit} wait to be sent; is anybody on the bus?"
                    )
                self._outbox.push(item, priority)
                if self._is_sending_here:
                    if not self._is_flush_planned:
                        self._plan_flush()
                else:
                    self._outgoing.notify_all()
            else:
                self._refused += size
            self.counters.given += size
        if overtaken:
            self._settle_all(overtaken, "dropped", "a stop overtook them")
        if not is_taken:
            self._settle(item, "dropped", "the bus is lost")
        return is_taken

    def _transmit(self) -> None:
        """Send packets: the body of the transmit thread."""
        while True:
            with self._guard:
                while not self._stopping.is_set() and (not self._outbox or self.state != "open"):
                    self._outgoing.wait(1.0)
            while not self._stopping.is_set() and (left := self._leaves_at() - self.clock.now()) > 0:
                self._stopping.wait(left / 1e9)
            if self._stopping.is_set():
                return
            with self._guard:
                if not self._outbox or self.state != "open":
                    continue
                item = self._in_hand = self._outbox.pop()
            late = self.clock.now() - item.until
            try:
                if late > 0 and not item.urgent:
                    self._expire(item)
                    continue
                self._put_out(item.packet)
                self._last_sent = self.clock.now()
                self._settle(item, "sent", "")
            except Exception as error:  # CanError, OSError, and whatever a backend lets through
                why = f"{type(error).__name__}: {error}"
                self._settle(item, "failed", why)
                self._emit("send failed", f"{self._name_of(item.packet)}: {why}")
            finally:
                with self._guard:
                    self._in_hand = None
                    if not self._outbox:
                        self._outgoing.notify_all()

    def _drain(self, seconds: float) -> None:
        """Take nothing more, and wait until all has left."""
        until = time.monotonic() + seconds
        with self._guard:
            self._is_closing = True
        if self._loop is not None:
            try:
                self._loop.call(
                    self._gather
                )  # there nothing can be given meanwhile, and from now on nothing is taken
            except CallerError:  # it has ended
                self._gather()
        with self._guard:
            while self._outbox or self._in_hand is not None:
                left = until - time.monotonic()
                if left <= 0 or (self._transmitter is not None and not self._transmitter.is_alive()):
                    break
                if self._is_sending_here:
                    self._flush()
                    left = min(left, AGAIN_NS / 1e9)
                self._outgoing.wait(min(left, POLL_S))
        while self.state == "open" and time.monotonic() < until:
            if not self._still_held() and self.clock.now() - self._last_sent >= self.linger_ns:
                return
            time.sleep(0.001)

    # ------------------------------------------------------------------ sending on a loop

    def _plan_flush(self) -> None:
        loop = self._loop
        assert loop is not None
        self._is_flush_planned = True
        if loop.is_own_thread:
            loop.at_turn_end(self._flush)
        else:
            loop.call_soon(self._flush)

    def _flush_in(self, wait: int) -> None:
        assert self._loop is not None
        self._is_flush_planned = True
        self._loop.call_in(wait, self._flush)

    def _flush(self) -> None:
        """Send together what was gathered, as far as the bus takes it now."""
        with self._guard:
            self._is_flush_planned = False
            if self.state != "open":
                return
            now = self.clock.now()
            if (wait := AGAIN_NS if not self._push() else self._leaves_at() - now) > 0:
                self._gather()
                self._flush_in(wait)
                return
            if self._give_out():
                self._last_sent = now
                if not self._push():
                    self._flush_in(AGAIN_NS)
                return
            self._gather()
            old = self._outbox.take_old(now)
            items = self._outbox.first(self.together)
            taken, error = self._put_together([item.packet for item in items])
            gone = self._outbox.drop_first(taken + (error is not None))
            self._last_sent = now
            if self._outbox or not self._push():
                self._flush_in(AGAIN_NS if error is None and taken < len(items) else 0)
            elif self._is_closing:
                self._outgoing.notify_all()
        self._settle_sent(gone[:taken])
        if error is not None:
            why = f"{type(error).__name__}: {error}"
            self._settle(gone[-1], "failed", why)
            self._emit("send failed", f"{self._name_of(gone[-1].packet)}: {why}")
        self._settle_old(old)

    def _gather(self) -> None:
        """Move given packets into the outbox."""
        now = self.clock.now()
        given = self._given
        with self._guard:
            while given:
                packet, age_ns, topic = given.popleft()
                item = OutboxItem(packet, 1, now + (age_ns or AGE_NS), False, topic, None, bool(age_ns))
                self._outbox.push(item, self._priority_of(packet))
                self.counters.given += 1

    def _give_out(self) -> bool:
        """Put what was given on the bus, where nothing waits and the bus takes all of it; whether that was done."""
        given = self._given
        if self._outbox or not 0 < len(given) <= self.together:
            return False
        packets = [packet for packet, _, _ in given]
        packets.sort(key=self._priority_of)
        taken, error = self._put_together(packets)
        if taken < len(packets):
            # What it took has left; the rest waits, and is refused again if it is refused.
            waiting = sorted(given, key=lambda item: self._priority_of(item[0]))
            given.clear()
            given.extend(waiting[taken:])
        else:
            given.clear()
        self.counters.given += taken
        self.counters.sent += taken
        return error is None and not given

    # ------------------------------------------------------------------ what became of it

    def _expire(self, first: OutboxItem[Packet]) -> None:
        """Drop a packet that is too old, and all others that are."""
        now = self.clock.now()
        with self._guard:
            others = self._outbox.take_old(now)
        self._settle_old([first, *others])

    def _settle(self, item: OutboxItem[Packet], fate: Fate, why: str) -> bool:
        """Count what became of a packet, once, and report it."""
        with self._guard:
            if item.fate is not None:
                return False
            item.fate = fate
            name = _BINS[fate]
            setattr(self.counters, name, getattr(self.counters, name) + item.size)
        if item.report is not None:
            try:
                item.report(fate, why)
            except Exception:  # a fault of one caller's `report` must not stop the gate
                self.events.failures += 1
        return True

    def _settle_sent(self, items: list[OutboxItem[Packet]]) -> None:
        """Settle packets that were sent together."""
        reports: list[Report] = []
        with self._guard:
            for item in items:
                item.fate = "sent"
                self.counters.sent += item.size
                if item.report is not None:
                    reports.append(item.report)
        for report in reports:
            try:
                report("sent", "")
            except Exception:  # as above
                self.events.failures += 1

    def _settle_all(
        self,
        items: list[OutboxItem[Packet]],
        fate: Fate,
        why: str,
        kind: Literal["not sent", "stalled"] = "not sent",
    ) -> None:
        """Settle several packets with one fate, and report it as one event."""
        count = sum(item.size for item in items if self._settle(item, fate, why))
        if count:
            self._emit(kind, f"{count} {self.unit}: {why}", count)

    def _settle_old(self, old: list[OutboxItem[Packet]]) -> None:
        """Settle packets that waited too long: questions with a stated age will be asked again; others are lost."""
        self._settle_all([item for item in old if item.is_timed], "expired", STALLED, "stalled")
        self._settle_all([item for item in old if not item.is_timed], "expired", TOO_OLD)

    def _emit_refused(self) -> None:
        """Report the packets that were given while the bus was lost."""
        with self._guard:
            count, self._refused = self._refused, 0
        if count:
            self._emit("not sent", f"{count} {self.unit} were given while the bus was lost", count)

    # ------------------------------------------------------------------ served by a loop

    def _attach(self) -> None:
        """Have the loop serve the bus that was opened; threads do what would block."""
        loop, bus = self._loop, self._bus
        assert loop is not None
        number = self._file_of(bus)
        self._file = number if number is not None and loop.can_watch(number) else None
        if self._file is None:
            self._thread(self._receive, "receive")
        else:
            self._watched(bus)
            loop.watch(self._file, self._readable, gathers=self._gathers)
        if self.listen_only:
            return
        self._is_sending_here = self._file is not None and self._can_put_together()
        if self._is_sending_here:
            self._plan_flush()
        elif self._transmitter is None:
            self._transmitter = self._thread(self._transmit, "send")

    def _detach(self) -> None:
        """Stop watching the file in the loop, before its number can belong to another file."""
        if self._file is None or self._loop is None:
            return
        loop, number, self._file = self._loop, self._file, None
        try:
            loop.call(lambda: loop.unwatch(number))
        except CallerError:  # it has ended
            pass

    def _readable(self) -> None:
        """Read its file, on the loop's thread."""
        if self.state != "open" or self._stopping.is_set():
            return
        try:
            found = self._read_now()
        except Exception as error:  # CanError, OSError, and whatever a backend lets through
            self._lose_here(error)
            return
        if not found:
            return
        for inbox in self._inboxes:
            inbox.put(found)
        if self._received is not None:
            self._received(found)

    def _lose_here(self, error: BaseException | None) -> None:
        """Report a lost bus, and open it again on a thread, which may take its time."""
        self._detach()
        self._gone(error)

        def look() -> None:
            bus = self._found_again()
            if bus is not None:
                assert self._loop is not None
                self._loop.call_soon(lambda: self._back_here(bus))

        self._thread(look, "open")

    def _back_here(self, bus: Bus) -> None:
        if self._stopping.is_set():
            self._close(bus)
            return
        self._back(bus)
        self._attach()

    def _look_again(self) -> None:
        """Ask the bus for its state, now and then."""
        if self._loop is not None and not self._stopping.is_set():
            self._loop.call_in(round(POLL_S * 1e9), self._look_again)
            if self._file is not None and self.state == "open":
                self._glance()
