"""What every gatekeeper is: the one owner of a bus, with threads of its own, that many may listen to.

1. The receive thread runs no user code and dies of nothing: what an adapter says wrongly, loses or stops saying becomes
   an event, and the bus is opened again.
2. Every loss is counted where it happens: in the system, in a queue, in the adapter's words.
3. A gate that only listens has no way to send: no queue and no thread.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Literal, Self, TypeVar

from ..errors import CallerError
from ..runtime import Clock, RealClock
from .events import BusEvent, Events, Handler, Kind
from .inbox import LIMIT, Inbox, Listener

Item = TypeVar("Item")

#: Seconds that the receive thread waits before it looks at other things.
POLL_S = 0.2
#: Seconds between attempts to open a lost bus: the first, and the longest.
RETRY_S, RETRY_MOST_S = 0.1, 2.0


@dataclass
class Counters:
    """What went through a gate, and what did not: frames of CAN, bytes of a serial line, datagrams.

    `dropped` came faster than a reader took it. `kernel_dropped` is what the system says it dropped before we could read.
    `bad_input` counts what an adapter said and nobody understood, `echoes` what a backend gave back of our own unasked.
    """

    received: int = 0
    sent: int = 0
    send_failed: int = 0
    dropped: int = 0
    kernel_dropped: int = 0
    bad_input: int = 0
    echoes: int = 0
    reopened: int = 0


class Gate(ABC, Generic[Item]):
    """One bus and its only owner; a context manager. See `CanGate`, `SerialGate` and `DatagramGate`."""

    #: What items are called in events.
    items: ClassVar[str]

    def __init__(self, name: str, *, listen_only: bool, reopen: bool, clock: Clock | None) -> None:
        self.name, self.listen_only, self.reopen = name, listen_only, reopen
        self.clock: Clock = clock if clock is not None else RealClock()
        self.counters = Counters()
        self.events = Events()
        self.state: Literal["new", "open", "lost", "closed"] = "new"
        self._bus: Any = None
        self._inboxes: tuple[Inbox[Item], ...] = ()
        self._listeners: list[Listener[Item]] = []
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._threads: list[threading.Thread] = []
        self._outgoing = threading.Condition(threading.Lock())

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
    def _transmit(self) -> None:
        """The transmit thread: until `_stopping`."""

    # ------------------------------------------------------------------ opening and closing

    def start(self) -> Self:
        """Open the bus and begin to receive.

        Raises what opening raises: a bus that cannot be opened at first is the caller's to know.
        """
        if self.state != "new":
            raise CallerError(f"{self.name}: this gate was started before; make another")
        self._bus = self._opened()
        self.state = "open"
        self._tell("opened", self._describe(self._bus))
        self._thread(self._receive, "receive")
        if not self.listen_only:
            self._thread(self._transmit, "send")
        return self

    def _thread(self, target: Callable[[], None], what: str) -> None:
        thread = threading.Thread(target=target, name=f"{self.name} {what}", daemon=True)
        self._threads.append(thread)
        thread.start()

    def stop(self) -> None:
        """Close the bus. Readers get what is still queued; what was not sent is not."""
        if self.state in ("new", "closed"):
            self.state = "closed"
            return
        self._stopping.set()
        with self._outgoing:
            self._outgoing.notify_all()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(5.0)
        self._close(self._bus)
        self._bus = None
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
        if self.state in ("new", "closed"):
            raise CallerError(f"{self.name}: this gate is not open")

    # ------------------------------------------------------------------ who wants to know

    def _subscribed(self, limit: int, wanted: Callable[[Item], bool] | None) -> Inbox[Item]:
        inbox: Inbox[Item] = Inbox(limit, wanted, self._leave, self._overflowed)
        with self._lock:
            self._inboxes += (inbox,)
        if self.state == "closed":
            inbox.end()
        return inbox

    def _listened(self, inbox: Inbox[Item], listener: Callable[[list[Item]], None]) -> Listener[Item]:
        def failed(error: BaseException) -> None:
            self._tell("listener", f"{type(error).__name__}: {error}")

        made = Listener(inbox, listener, failed, f"{self.name} listener")
        self._listeners.append(made)
        return made

    def subscribe(self, *, limit: int = LIMIT) -> Inbox[Item]:
        """A queue of what arrives from now on, at most `limit` items; `close` it to leave."""
        return self._subscribed(limit, None)

    def listen(self, listener: Callable[[list[Item]], None], *, limit: int = LIMIT) -> Listener[Item]:
        """Call `listener` with what arrives, on a thread of its own. What it raises becomes an event."""
        return self._listened(self._subscribed(limit, None), listener)

    def on_event(self, handler: Handler) -> None:
        """Call `handler` at once with everything that happens to the bus."""
        self.events.add(handler)

    def _leave(self, inbox: Inbox[Item]) -> None:
        with self._lock:
            self._inboxes = tuple(one for one in self._inboxes if one is not inbox)

    def _overflowed(self, count: int) -> None:
        self.counters.dropped += count
        self._tell("dropped", f"{count} {self.items} came faster than a reader takes them", count)

    def _put(self, batch: list[Item]) -> None:
        """Hand over what has arrived."""
        for inbox in self._inboxes:
            inbox.put(batch)
