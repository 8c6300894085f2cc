"""What all gatekeepers have in common: what a kind of bus does, what was received, and who wants to know.

1. The thread that receives runs no user code and nothing ends it: an adapter's errors become events.
2. Every loss is counted where it happens: in the system, in a queue, in what the adapter reports.

Events are the shortcut from the hardware upwards: a handler is called at once, on the thread where the event happens, before
anything else is done about it, and must be quick. One that raises is counted, and stops nothing."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, ClassVar, Generic, Literal, Protocol, TypeVar

import msgspec

from ..runtime import Clock, Loop, RealClock
from .gate_events import BusEvent, BusEvents, GateCounters, Handler, Kind
from .lock import BusLock
from .queues import LIMIT, Inbox, Listener, Outbox, OutboxItem

Item = TypeVar("Item")
Filtered = TypeVar("Filtered", contravariant=True)


class ContentFilter(Protocol[Filtered]):
    """What a reader wants: a `CanFilter` for frames."""

    def matches(self, content: Filtered, /) -> bool:
        """Return whether the reader wants this."""
        ...


class Received(msgspec.Struct, Generic[Item], frozen=True, gc=False):
    """What a gate received (a frame, bytes of a line, a datagram), and the host's monotonic clock when it was read (ns).

    `is_own`: bytes that this gate has sent. `source`: who sent a datagram.
    """

    content: Item
    host_ns: int
    is_own: bool = False
    source: tuple[str, int] | None = None


class GateBase(ABC, Generic[Item]):
    """One bus: its readers, its events, and what its kind does. `Gate` sends and opens it."""

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
        #: What this turn of the loop has given so far: packet, age limit (ns), topic. Appended on the loop's thread alone.
        self._given: deque[tuple[Any, int, object]] = deque()
        #: What the transmit thread has in hand.
        self._in_hand: OutboxItem[Any] | None = None
        self._transmitter: threading.Thread | None = None
        self._is_closing = False
        #: How long a bus stays open after the last packet (ns), where its backend may hold it and does not say so.
        self.linger_ns, self._last_sent = 0, 0
        #: What was given while the bus was lost, and not said yet.
        self._refused = 0
        #: On a loop: who gets what arrives, the file that is waited for, and whether the loop itself sends.
        self._loop: Loop | None = None
        self._received: Callable[[list[Received[Item]]], Any] | None = None
        self._file: int | None = None
        self._is_sending_here = self._is_flush_planned = False
        #: Whether what arrives may wait for more there: where each packet says itself when it came.
        self._gathers = False

    # ------------------------------------------------------------------ what a kind of bus does

    @abstractmethod
    def _opened(self) -> Any:
        """Open the bus; raises what the system or a backend raises."""

    @abstractmethod
    def _shut(self, bus: Any) -> None:
        """Close a bus; may raise, and need not succeed."""

    @abstractmethod
    def _receive(self) -> None:
        """Receive until `_stopping` is set or `_lose` returns False: the body of the receive thread."""

    @abstractmethod
    def _put_out(self, packet: Any, /) -> None:
        """Give a packet to the bus, on the transmit thread; raises what the backend raises."""

    def _priority_of(self, packet: Any, /) -> int:
        """Return what goes first of what is given together: the lowest."""
        return 0

    @abstractmethod
    def _name_of(self, packet: Any, /) -> str:
        """Return what a packet is called in events."""

    def _leaves_at(self) -> int:
        """Return the instant (ns) from which the next packet may be given to the bus."""
        return 0

    def _file_of(self, bus: Any) -> int | None:
        """Return the file of a bus that a loop can wait for; None: it takes a thread to receive."""
        return None

    def _watched(self, bus: Any) -> None:
        """Prepare a bus whose file a loop watches: it must never block."""

    def _read_now(self) -> list[Received[Item]]:
        """Return what its file has, without waiting; raises what says that the bus is gone."""
        raise NotImplementedError

    def _can_put_together(self) -> bool:
        """Return whether the bus takes packets at once, on a loop: `_put_together`."""
        return False

    def _put_together(self, packets: list[Any], /) -> tuple[int, Exception | None]:
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
    def _describe(bus: Any) -> str:
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
            self._inboxes = tuple(one for one in self._inboxes if one is not inbox)

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
