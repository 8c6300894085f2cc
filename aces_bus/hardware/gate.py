"""What every gatekeeper is: the one owner of a bus, with threads of its own or on a robot's loop, that many may listen to.

1. The receive thread runs no user code and dies of nothing: what an adapter says wrongly, loses or stops saying becomes
   an event, and the bus is opened again.
2. Every loss is counted where it happens: in the system, in a queue, in the adapter's words.
3. A gate that only listens has no way to send: no queue and no thread.
4. What is given to be sent ends in exactly one bin (`outbox`), and `stop` lets what waits leave before it closes the bus.

By itself a gate has two threads, one to receive and one to send. On a loop (`start_on`) it has none where its bus has a
file to wait for: the loop reads what is there, and what was given in one turn leaves together at its end. Threads do only
what may block: a backend without such a file, or that cannot send at once, and the opening of a bus that was lost.

While a bus is lost nothing waits for it: an old set-point, sent when it is back, would move a robot. What is urgent (a
stop) waits, and is the first to leave.

Events are the shortcut from the hardware to whoever must know at once: a handler is called on the thread where it happens,
before anything else is done about it, and must be quick. One that raises is counted, and stops nothing."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, ClassVar, Generic, Literal, Protocol, Self, TypeVar

import msgspec

from ..errors import CallerError
from ..runtime import Clock, Loop, RealClock
from .gate_events import BusEvent, BusEvents, GateCounters, Handler, Kind
from .lock import BusLock
from .queues import AGE_S, LIMIT, Fate, Inbox, Listener, Outbox, OutboxItem, Report

Item = TypeVar("Item")
Filtered = TypeVar("Filtered", contravariant=True)

#: Seconds that the receive thread waits before it looks at other things.
POLL_S = 0.2
#: Seconds between attempts to open a lost bus: the first, and the longest.
RETRY_S, RETRY_MOST_S = 0.1, 2.0
#: How soon a bus that takes no more for now is tried again (ns).
AGAIN_NS = 1_000_000
#: How old a word may be when it leaves, by default (ns).
AGE_NS = round(AGE_S * 1e9)
#: Seconds that `stop` gives to what waits to be sent, and to a thread that is inside a backend.
DRAIN_S, JOIN_S = 1.0, 5.0


#: Where each fate is counted.
_BINS: dict[Fate, str] = {
    "sent": "sent",
    "failed": "send_failed",
    "expired": "send_expired",
    "dropped": "send_dropped",
    "unsent": "unsent",
}


TOO_OLD = "too old, they do not leave late"


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
    #: How many words are given to the bus together, at most.
    together: int = 64

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
        #: Guards the outbox; `_outgoing` is notified when it changes.
        self._guard = threading.RLock()
        self._outgoing = threading.Condition(self._guard)
        self._outbox: Outbox[Any] = Outbox()
        #: What this turn of the loop has given so far: word, age limit (ns), topic. Appended on the loop's thread alone.
        self._given: deque[tuple[Any, int, object]] = deque()
        #: What the transmit thread has in hand.
        self._in_hand: OutboxItem[Any] | None = None
        self._transmitter: threading.Thread | None = None
        self._is_closing = False
        #: How long a bus stays open after the last word (ns), where its backend may hold it and does not say so.
        self.linger_ns, self._last_sent = 0, 0
        #: What was given while the bus was lost, and not said yet.
        self._refused = 0
        #: On a loop: who gets what arrives, the file that is waited for, and whether the loop itself sends.
        self._loop: Loop | None = None
        self._received: Callable[[list[Received[Item]]], Any] | None = None
        self._file: int | None = None
        self._is_sending_here = self._is_flush_planned = False

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

    def _priority_of(self, word: Any) -> int:
        """What goes first of what is given together: the lowest."""
        return 0

    @abstractmethod
    def _name_of(self, word: Any) -> str:
        """What a word is called in events."""

    def _leaves_at(self) -> int:
        """The instant (ns) from which the next word may be given to the bus."""
        return 0

    def _file_of(self, bus: Any) -> int | None:
        """The file of a bus that a loop can wait for; None: it takes a thread to receive."""
        return None

    def _watched(self, bus: Any) -> None:
        """A loop waits for its file from now on: it must never block."""

    def _read_now(self) -> list[Received[Item]]:
        """What its file has, without waiting; raises what says that the bus is gone."""
        raise NotImplementedError

    def _can_put_together(self) -> bool:
        """Whether the bus takes words at once, on a loop: `_put_together`."""
        return False

    def _put_together(self, words: list[Any]) -> tuple[int, Exception | None]:
        """Give words to the bus without waiting: how many it took, and why it refused the next one (None: it is full)."""
        raise NotImplementedError

    def _push(self) -> bool:
        """Give the bus the rest of a word that it took in part; whether nothing is left of it."""
        return True

    def _glance(self) -> None:
        """Look, now and then, at what the bus says of itself."""

    def _still_held(self) -> int:
        """How much the backend itself says that it still holds."""
        return 0

    # ------------------------------------------------------------------ opening and closing

    def start(self) -> Self:
        """Open the bus and begin to receive.

        Raises what opening raises: a bus that cannot be opened at first is the caller's to know.
        """
        self._open_first()
        self._thread(self._receive, "receive")
        if not self.listen_only:
            self._transmitter = self._thread(self._transmit, "send")
        return self

    def _open_first(self) -> None:
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

    def _unlock(self) -> None:
        if self.lock is not None:
            self.lock.release()

    def _thread(self, target: Callable[[], None], what: str) -> threading.Thread:
        thread = threading.Thread(target=target, name=f"{self.name} {what}", daemon=True)
        thread.start()
        self._threads.append(thread)  # `stop` may come meanwhile, and joins those that run
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
        """The bus is gone: tell, and open it again, on the receive thread; False when the gate is to end."""
        self._gone(error)
        bus = self._found_again()
        if bus is None:
            return False
        self._back(bus)
        return True

    def _gone(self, error: BaseException | None) -> None:
        """The bus is gone: tell, and drop what waited for it."""
        self.state = "lost"
        why = "it does not answer any more" if error is None else f"{type(error).__name__}: {error}"
        self._tell("lost", why)
        self._gather()
        with self._guard:
            gone = self._outbox.take(lambda item: not item.urgent)
            self._outgoing.notify_all()
        self._settle_all(gone, "dropped", "the bus is lost")
        self._close(self._bus)

    def _found_again(self) -> Any:
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

    def _back(self, bus: Any) -> None:
        """The bus is there again."""
        self._bus = bus
        self.state = "open"
        self.counters.reopened += 1
        self._tell("reopened", self._describe(bus))
        self._tell_refused()
        with self._guard:
            self._outgoing.notify_all()

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
        return self._outbox.size + len(self._given)

    def give(self, word: Any, age_ns: int = 0, topic: object = None) -> bool:
        """Send a word of size 1 with all that this turn of the loop gives, on its thread: cheap, for what a tick sends.

        False: the bus is lost, or does not take it. See `send` for the rest.
        """
        if self.state != "open" or self._is_closing or self.waiting >= self.most:
            return False
        self._given.append((word, age_ns, topic))
        if not self._is_flush_planned:  # after the append: who flushes looks again
            with self._guard:
                self._plan_flush()
        return True

    def _gather(self) -> None:
        """What was given joins what waits."""
        now = self.clock.now()
        given = self._given
        with self._guard:
            while given:
                word, age_ns, topic = given.popleft()
                item = OutboxItem(word, 1, now + (age_ns or AGE_NS), False, topic, None)
                self._outbox.push(item, self._priority_of(word))
                self.counters.given += 1

    def _give_out(self) -> bool:
        """Put what was given on the bus, where nothing waits and the bus takes all of it; whether that was done."""
        given = self._given
        if self._outbox or not 0 < len(given) <= self.together:
            return False
        words = [word for word, _, _ in given]
        words.sort(key=self._priority_of)
        taken, error = self._put_together(words)
        if taken < len(words):
            # What it took has left; the rest waits, and is refused again if it is refused.
            waiting = sorted(given, key=lambda one: self._priority_of(one[0]))
            given.clear()
            given.extend(waiting[taken:])
        else:
            given.clear()
        self.counters.given += taken
        self.counters.sent += taken
        return error is None and not given

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
        if self._given:
            self._gather()
        until = self.clock.now() + (AGE_NS if age_s is None else round(age_s * 1e9))
        item = OutboxItem(word, size, until, urgent, topic, report)
        overtaken: list[OutboxItem[Any]] = []
        with self._guard:
            if self.state != "open" or self.listen_only or self._is_closing:
                self._check_may_send()
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
        """The transmit thread."""
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
                self._put_out(item.word)
                self._last_sent = self.clock.now()
                self._settle(item, "sent", "")
            except Exception as error:  # CanError, OSError, and whatever a backend lets through
                why = f"{type(error).__name__}: {error}"
                self._settle(item, "failed", why)
                self._tell("send failed", f"{self._name_of(item.word)}: {why}")
            finally:
                with self._guard:
                    self._in_hand = None
                    if not self._outbox:
                        self._outgoing.notify_all()

    def _expire(self, first: OutboxItem[Any]) -> None:
        """This one is too old, and others may be."""
        now = self.clock.now()
        with self._guard:
            others = self._outbox.take_old(now)
        self._settle_all([first, *others], "expired", TOO_OLD)

    def _settle(self, item: OutboxItem[Any], fate: Fate, why: str) -> bool:
        """Count what became of a word, once, and report it."""
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

    def _settle_sent(self, items: list[OutboxItem[Any]]) -> None:
        """The same for words that left together."""
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

    def _settle_all(self, items: list[OutboxItem[Any]], fate: Fate, why: str) -> None:
        """The same became of several, which is one event."""
        count = sum(item.size for item in items if self._settle(item, fate, why))
        if count:
            self._tell("not sent", f"{count} {self.unit}: {why}", count)

    def _tell_refused(self) -> None:
        """What was given while the bus was lost."""
        with self._guard:
            count, self._refused = self._refused, 0
        if count:
            self._tell("not sent", f"{count} {self.unit} were given while the bus was lost", count)

    # ------------------------------------------------------------------ on a loop

    def start_on(self, loop: Loop, received: Callable[[list[Received[Item]]], Any]) -> Self:
        """Open the bus; `received` is called with what arrives, on the loop's thread. Raises as `start`."""
        self._loop, self._received = loop, received
        self._open_first()
        self._attach()
        self._look_again()
        return self

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
            loop.watch(self._file, self._readable)
        if self.listen_only:
            return
        self._is_sending_here = self._file is not None and self._can_put_together()
        if self._is_sending_here:
            self._plan_flush()
        elif self._transmitter is None:
            self._transmitter = self._thread(self._transmit, "send")

    def _detach(self) -> None:
        """The loop is to serve it no more, before its file's number becomes another's."""
        if self._file is None or self._loop is None:
            return
        loop, number, self._file = self._loop, self._file, None
        try:
            loop.call(lambda: loop.unwatch(number))
        except CallerError:  # it has ended
            pass

    def _readable(self) -> None:
        """On the loop's thread: its file has something."""
        if self.state != "open" or self._stopping.is_set():
            return
        try:
            found = self._read_now()
        except Exception as error:  # CanError, OSError, and whatever a backend lets through
            self._lose_here(error)
        else:
            if found:
                self._put(found)

    def _lose_here(self, error: BaseException | None) -> None:
        """The bus is gone: a thread opens it again, which may take its time."""
        self._detach()
        self._gone(error)

        def look() -> None:
            bus = self._found_again()
            if bus is not None:
                assert self._loop is not None
                self._loop.call_soon(lambda: self._back_here(bus))

        self._thread(look, "open")

    def _back_here(self, bus: Any) -> None:
        if self._stopping.is_set():
            self._close(bus)
            return
        self._back(bus)
        self._attach()

    def _look_again(self) -> None:
        """Now and then: what the bus says of itself."""
        if self._loop is not None and not self._stopping.is_set():
            self._loop.call_in(round(POLL_S * 1e9), self._look_again)
            if self._file is not None and self.state == "open":
                self._glance()

    def _plan_flush(self) -> None:
        loop = self._loop
        assert loop is not None
        self._is_flush_planned = True
        if loop.is_own_thread:
            loop.at_turn_end(self._flush)
        else:
            loop.call_soon(self._flush)

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
            taken, error = self._put_together([item.word for item in items])
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
            self._tell("send failed", f"{self._name_of(gone[-1].word)}: {why}")
        self._settle_all(old, "expired", TOO_OLD)

    def _flush_in(self, wait: int) -> None:
        assert self._loop is not None
        self._is_flush_planned = True
        self._loop.call_in(wait, self._flush)

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
        received, loop = self._received, self._loop
        if received is None or loop is None:
            return
        if loop.is_own_thread:
            received(batch)
        else:
            loop.call_soon(lambda: received(batch))
