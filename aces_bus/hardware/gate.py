"""What every gatekeeper is: the one owner of a bus, with threads of its own, that many may listen to.

1. The receive thread runs no user code and dies of nothing: what an adapter says wrongly, loses or stops saying becomes
   an event, and the bus is opened again.
2. Every loss is counted where it happens: in the system, in a queue, in the adapter's words.
3. A gate that only listens has no way to send: no queue and no thread.
4. What is given to be sent ends in exactly one bin (`outbox`), and `stop` lets what waits leave before it closes the bus.

While a bus is lost nothing waits for it: an old set-point, sent when it is back, would move a robot. What is urgent (a
stop) waits, and is the first to leave.

Events are the shortcut from the hardware to whoever must know at once: a handler is called on the thread where it happens,
before anything else is done about it, and must be quick. One that raises is counted, and stops nothing."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Literal, Protocol, Self, TypeVar

import msgspec

from ..errors import CallerError
from ..runtime import Clock, RealClock
from .lock import BusLock
from .queues import AGE_S, LIMIT, Fate, Inbox, Listener, Outbox, OutboxItem, Report

Kind = Literal[
    "opened",
    "lost",
    "reopened",
    "closed",
    "error-active",
    "error-passive",
    "bus-off",
    "dropped",
    "clock",
    "bad input",
    "listener",
    "send failed",
    "not sent",
]


class BusEvent(msgspec.Struct, frozen=True):
    """Something that happened to a bus.

    `kind`: "opened"; "lost" (unplugged, the server is gone); "reopened"; "closed"; "error-active", "error-passive" and
    "bus-off" (the controller's state); "dropped" (frames lost: `count` of them, `detail` says where); "clock" (the adapter's
    stamps went back); "bad input" (the adapter said what cannot be understood); "listener" (one raised: its exception in
    `detail`); "send failed" (the backend refused a word); "not sent" (`count` frames, bytes or datagrams were too old, were
    given to a lost bus, overtaken by a stop, or left over at the end: `detail` says which). `time_ns` is the host's
    monotonic clock, `bus` the name of the gate.
    """

    kind: Kind
    time_ns: int
    bus: str
    detail: str = ""
    count: int = 0

    def __str__(self) -> str:
        return f"{self.bus}: {self.kind}" + (f": {self.detail}" if self.detail else "")


Handler = Callable[[BusEvent], None]


class BusEvents:
    """The handlers of one bus. `failures` counts what they raised."""

    def __init__(self) -> None:
        self._handlers: tuple[Handler, ...] = ()
        self._lock = threading.Lock()
        self.failures = 0

    def add(self, handler: Handler) -> None:
        """Call `handler` with every event from now on."""
        with self._lock:
            self._handlers += (handler,)

    def remove(self, handler: Handler) -> None:
        """Do not call it any more."""
        with self._lock:
            self._handlers = tuple(one for one in self._handlers if one is not handler)

    def tell(self, event: BusEvent) -> None:
        """Call all handlers, whatever they do."""
        for handler in self._handlers:
            try:
                handler(event)
            except KeyboardInterrupt:  # the user's, and only on the main thread
                raise
            except BaseException:  # whatever a handler may raise, SystemExit too: rule 2
                self.failures += 1


Item = TypeVar("Item")
Filtered = TypeVar("Filtered", contravariant=True)

#: Seconds that the receive thread waits before it looks at other things.
POLL_S = 0.2
#: Seconds between attempts to open a lost bus: the first, and the longest.
RETRY_S, RETRY_MOST_S = 0.1, 2.0
#: Seconds that `stop` gives to what waits to be sent, and to a thread that is inside a backend.
DRAIN_S, JOIN_S = 1.0, 5.0


@dataclass
class GateCounters:
    """What went through a gate, and what did not: frames of CAN, bytes of a serial line, datagrams.

    `dropped` came faster than a reader took it. `kernel_dropped` is what the system says it dropped before we could read.
    `bad_input` counts what an adapter sent that cannot be understood, `echoes` what a backend returned of our own, unasked.

    Of what was `given` to be sent, each is in one of `sent`, `send_failed` (the backend refused it), `send_expired` (too
    old), `send_dropped` (the bus was lost, or a stop overtook it) and `unsent` (left over at the end), or still waits.
    """

    received: int = 0
    given: int = 0
    sent: int = 0
    send_failed: int = 0
    send_expired: int = 0
    send_dropped: int = 0
    unsent: int = 0
    dropped: int = 0
    kernel_dropped: int = 0
    bad_input: int = 0
    echoes: int = 0
    reopened: int = 0

    @property
    def not_sent(self) -> int:
        """What was given and will never leave."""
        return self.send_failed + self.send_expired + self.send_dropped + self.unsent

    @property
    def pending(self) -> int:
        """What was given and is in no bin yet."""
        return self.given - self.sent - self.not_sent


#: Where each fate is counted.
_BINS: dict[Fate, str] = {
    "sent": "sent",
    "failed": "send_failed",
    "expired": "send_expired",
    "dropped": "send_dropped",
    "unsent": "unsent",
}


class ContentFilter(Protocol[Filtered]):
    """What a reader wants: a `CanFilter` for frames."""

    def matches(self, content: Filtered, /) -> bool:
        """Whether the reader wants this."""
        ...


class Received(msgspec.Struct, Generic[Item], frozen=True, gc=False):
    """What a gate received (a frame, bytes of a line, a datagram), and the host's monotonic clock when it was read (ns).

    `is_own`: bytes that this gate has sent. `source`: who sent a datagram.
    """

    content: Item
    host_ns: int
    is_own: bool = False
    source: tuple[str, int] | None = None


class Gate(ABC, Generic[Item]):
    """One bus and its only owner; a context manager. See `CanGate`, `SerialGate` and `DatagramGate`."""

    #: What items are called in events, and what is counted of what is sent.
    items: ClassVar[str]
    unit: ClassVar[str]
    #: How much may wait to be sent, in that unit.
    most: ClassVar[int]

    def __init__(self, name: str, *, listen_only: bool, reopen: bool, clock: Clock | None) -> None:
        self.name, self.listen_only, self.reopen = name, listen_only, reopen
        self.clock: Clock = clock if clock is not None else RealClock()
        #: What is taken before the bus is opened, so that one program of this machine drives it; None: nothing.
        self.lock: BusLock | None = None
        self.counters = GateCounters()
        self.events = BusEvents()
        self.state: Literal["new", "open", "lost", "closed"] = "new"
        self._bus: Any = None
        self._inboxes: tuple[Inbox[Received[Item]], ...] = ()
        self._listeners: list[Listener[Received[Item]]] = []
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._threads: list[threading.Thread] = []
        self._outgoing = threading.Condition(threading.Lock())
        self._outbox: Outbox[Any] = Outbox()
        #: What the transmit thread has in hand.
        self._in_hand: OutboxItem[Any] | None = None
        self._transmitter: threading.Thread | None = None
        self._is_closing = False
        #: How long a bus stays open after the last word (ns), where its backend may hold it and does not say so.
        self.linger_ns, self._last_sent = 0, 0
        #: What was given while the bus was lost, and not said yet.
        self._refused = 0

    # ------------------------------------------------------------------ what a kind of bus does

    @abstractmethod
    def _opened(self) -> Any:
        """Open the bus; raises what the system or a backend raises."""

    @abstractmethod
    def _shut(self, bus: Any) -> None:
        """Close a bus; may raise, and need not succeed."""

    @abstractmethod
    def _receive(self) -> None:
        """The receive thread: until `_stopping`, or until `_lose` says so."""

    @abstractmethod
    def _put_out(self, word: Any) -> None:
        """Give a word to the bus, on the transmit thread; raises what the backend raises."""

    @abstractmethod
    def _name_of(self, word: Any) -> str:
        """What a word is called in events."""

    def _may_leave(self) -> bool:
        """Wait until the next word may be given to the bus; False when the gate is to end."""
        return True

    def _still_held(self) -> int:
        """How much the backend itself says that it still holds."""
        return 0

    # ------------------------------------------------------------------ opening and closing

    def start(self) -> Self:
        """Open the bus and begin to receive.

        Raises what opening raises: a bus that cannot be opened at first is the caller's to know.
        """
        if self.state != "new":
            raise CallerError(f"{self.name}: this gate was started before; make another")
        if self.lock is not None:
            self.lock.take()
        try:
            self._bus = self._opened()
        except BaseException:
            self._unlock()
            raise
        self.state = "open"
        self._tell("opened", self._describe(self._bus))
        self._thread(self._receive, "receive")
        if not self.listen_only:
            self._transmitter = self._thread(self._transmit, "send")
        return self

    def _unlock(self) -> None:
        if self.lock is not None:
            self.lock.release()

    def _thread(self, target: Callable[[], None], what: str) -> threading.Thread:
        thread = threading.Thread(target=target, name=f"{self.name} {what}", daemon=True)
        self._threads.append(thread)
        thread.start()
        return thread

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

    def _drain(self, seconds: float) -> None:
        """Take nothing more, and wait until all has left."""
        until = time.monotonic() + seconds
        with self._outgoing:
            self._is_closing = True
            while self._outbox or self._in_hand is not None:
                left = until - time.monotonic()
                if left <= 0 or (self._transmitter is not None and not self._transmitter.is_alive()):
                    break
                self._outgoing.wait(min(left, POLL_S))
        while self.state == "open" and time.monotonic() < until:
            if not self._still_held() and self.clock.now() - self._last_sent >= self.linger_ns:
                return
            time.sleep(0.001)

    def _end(self) -> None:
        self._is_closing = True
        self._stopping.set()
        with self._outgoing:
            left_over = self._outbox.take(lambda item: True)
            self._outgoing.notify_all()
        held = self._still_held() if self.state == "open" else 0
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(JOIN_S)
        with self._outgoing:
            if self._in_hand is not None:  # its thread does not come back
                left_over.append(self._in_hand)
        self._settle_all(left_over, "unsent", "the gate was closed")
        if held:  # counted as sent, and known better now
            self.counters.sent -= held
            self.counters.unsent += held
            self._tell(
                "not sent", f"{held} {self.unit}: the adapter still held them when it was closed", held
            )
        self._tell_refused()
        self._close(self._bus)
        self._bus = None
        self._unlock()
        self.state = "closed"
        for inbox in self._inboxes:
            inbox.end()
        for listener in self._listeners:
            listener.stop()
        self._tell("closed")

    def __enter__(self) -> Self:
        return self.start() if self.state == "new" else self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _close(self, bus: Any) -> None:
        if bus is not None:
            try:
                self._shut(bus)
            except Exception:  # an adapter that is gone may refuse even this
                pass

    def _lose(self, error: BaseException | None) -> bool:
        """The bus is gone: tell, and open it again; False when the gate is to end."""
        self.state = "lost"
        why = "it does not answer any more" if error is None else f"{type(error).__name__}: {error}"
        self._tell("lost", why)
        with self._outgoing:
            gone = self._outbox.take(lambda item: not item.urgent)
            self._outgoing.notify_all()
        self._settle_all(gone, "dropped", "the bus is lost")
        self._close(self._bus)
        wait = RETRY_S
        while self.reopen and not self._stopping.wait(wait):
            try:
                bus = self._opened()
            except Exception:  # still gone
                wait = min(2 * wait, RETRY_MOST_S)
                continue
            self._bus = bus
            self.state = "open"
            self.counters.reopened += 1
            self._tell("reopened", self._describe(bus))
            self._tell_refused()
            with self._outgoing:
                self._outgoing.notify_all()
            return True
        if not self.reopen:
            for inbox in self._inboxes:
                inbox.end()
        return False

    @staticmethod
    def _describe(bus: Any) -> str:
        """What an event says of an open bus."""
        return str(getattr(bus, "channel_info", "") or getattr(bus, "name", "") or "")

    def _tell(self, kind: Kind, detail: str = "", count: int = 0) -> None:
        self.events.tell(BusEvent(kind, self.clock.now(), self.name, detail, count))

    def _check_may_send(self) -> None:
        if self.listen_only:
            raise CallerError(f"{self.name}: this gate only listens; open it without listen_only to send")
        if self._is_closing or self.state in ("new", "closed"):
            raise CallerError(f"{self.name}: this gate is not open")

    # ------------------------------------------------------------------ sending

    @property
    def waiting(self) -> int:
        """How much waits to be sent, in `unit`."""
        return self._outbox.size

    def _queue(
        self,
        word: Any,
        size: int,
        priority: int,
        age_s: float | None,
        urgent: bool,
        topic: object,
        report: Report | None,
    ) -> bool:
        """Queue a word; False when the bus is lost and it is dropped. Raises `CallerError` as `send`."""
        self._check_may_send()
        until = self.clock.now() + round((AGE_S if age_s is None else age_s) * 1e9)
        item = OutboxItem(word, size, until, urgent=urgent, topic=topic, report=report)
        overtaken: list[OutboxItem[Any]] = []
        with self._outgoing:
            self._check_may_send()  # it may have been closed meanwhile
            is_taken = urgent or self.state == "open"
            if is_taken:
                if urgent:
                    if topic is not None and self._outbox:
                        overtaken = self._outbox.take(lambda one: one.topic is topic and not one.urgent)
                elif self._outbox.size + size > self.most:
                    raise CallerError(
                        f"{self.name}: {self._outbox.size} {self.unit} wait to be sent; is anybody on the bus?"
                    )
                self._outbox.push(item, priority)
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
        """The transmit thread."""
        while True:
            with self._outgoing:
                while not self._stopping.is_set() and (not self._outbox or self.state != "open"):
                    self._outgoing.wait(1.0)
            if self._stopping.is_set() or not self._may_leave():
                return
            with self._outgoing:
                if not self._outbox or self.state != "open":
                    continue
                item = self._in_hand = self._outbox.pop()
            late = self.clock.now() - item.until
            try:
                if late > 0 and not item.urgent:
                    self._expire(item)
                    continue
                self._put_out(item.word)
                self._last_sent = self.clock.now()
                self._settle(item, "sent", "")
            except Exception as error:  # CanError, OSError, and whatever a backend lets through
                why = f"{type(error).__name__}: {error}"
                self._settle(item, "failed", why)
                self._tell("send failed", f"{self._name_of(item.word)}: {why}")
            finally:
                with self._outgoing:
                    self._in_hand = None
                    if not self._outbox:
                        self._outgoing.notify_all()

    def _expire(self, first: OutboxItem[Any]) -> None:
        """This one is too old, and others may be."""
        now = self.clock.now()
        with self._outgoing:
            others = self._outbox.take(lambda item: item.until < now and not item.urgent)
        self._settle_all([first, *others], "expired", "too old, they do not leave late")

    def _settle(self, item: OutboxItem[Any], fate: Fate, why: str) -> bool:
        """Count what became of a word, once, and report it."""
        with self._outgoing:
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

    def _settle_all(self, items: list[OutboxItem[Any]], fate: Fate, why: str) -> None:
        """The same became of several, which is one event."""
        count = sum(item.size for item in items if self._settle(item, fate, why))
        if count:
            self._tell("not sent", f"{count} {self.unit}: {why}", count)

    def _tell_refused(self) -> None:
        """What was given while the bus was lost."""
        with self._outgoing:
            count, self._refused = self._refused, 0
        if count:
            self._tell("not sent", f"{count} {self.unit} were given while the bus was lost", count)

    # ------------------------------------------------------------------ who wants to know

    def subscribe(
        self, *, limit: int = LIMIT, filter: ContentFilter[Item] | None = None
    ) -> Inbox[Received[Item]]:
        """A queue of what arrives from now on, at most `limit` items of those that `filter` matches; `close` it to leave."""
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
            self._tell("listener", f"{type(error).__name__}: {error}")

        inbox = self.subscribe(limit=limit, filter=filter)
        made = Listener(inbox, listener, failed, f"{self.name} listener")
        self._listeners.append(made)
        return made

    def on_event(self, handler: Handler) -> None:
        """Call `handler` at once with everything that happens to the bus."""
        self.events.add(handler)

    def _leave(self, inbox: Inbox[Received[Item]]) -> None:
        with self._lock:
            self._inboxes = tuple(one for one in self._inboxes if one is not inbox)

    def _overflowed(self, count: int) -> None:
        self.counters.dropped += count
        self._tell("dropped", f"{count} {self.items} came faster than a reader takes them", count)

    def _put(self, batch: list[Received[Item]]) -> None:
        """Hand over what has arrived."""
        for inbox in self._inboxes:
            inbox.put(batch)
