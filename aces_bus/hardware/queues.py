"""What has arrived and waits for readers, and what waits to be sent by a gate: bounded queues.

1. The receive thread only puts; it never waits for a reader and never runs a reader's code. A full inbox drops its oldest
   items and counts them: what is there is always the newest.
2. What is to be sent ends in exactly one bin: sent, failed, expired, dropped or unsent (`Fate`); its sender may ask which.
3. It has an age limit: what could not leave in time does not leave late.
4. What is urgent, a stop, goes before all else, instead of what waits for the same device, and outlives the loss of a bus.

An outbox has no thread and does no I/O: a gate calls it under its own lock, and reports fates when it has let go of it.
"""

from __future__ import annotations

import heapq
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Generic, Literal, TypeVar

import msgspec

Item = TypeVar("Item")

#: What a queue holds at most by default: eight seconds of a full 1 Mbit/s bus.
LIMIT = 65_536


class Inbox(Generic[Item]):
    """A queue of what arrives; `dropped` counts what did not fit."""

    def __init__(
        self,
        limit: int = LIMIT,
        wanted: Callable[[Item], bool] | None = None,
        leave: Callable[[Any], None] | None = None,
        overflowed: Callable[[int], None] | None = None,
    ) -> None:
        self._items: deque[Item] = deque()
        self._limit = limit
        self._wanted = wanted
        self._leave, self._overflowed = leave, overflowed
        self._ready = threading.Condition(threading.Lock())
        self._is_closed = False
        self.dropped = 0

    def put(self, items: Sequence[Item]) -> None:
        """Add what has arrived; the receive thread's side."""
        if self._wanted is not None:
            items = [item for item in items if self._wanted(item)]
        if not items or self._is_closed:
            return
        with self._ready:
            queue = self._items
            queue.extend(items)
            too_many = len(queue) - self._limit
            if too_many > 0:
                for _ in range(too_many):
                    queue.popleft()
                self.dropped += too_many
            self._ready.notify_all()
        if too_many > 0 and self._overflowed is not None:
            self._overflowed(too_many)

    def get(self, timeout: float | None = None) -> list[Item]:
        """Return all that is there; waits up to `timeout` seconds (None: for ever) for the first. Empty at the end of
        both.
        """
        with self._ready:
            if not self._items and not self._is_closed:
                self._ready.wait_for(lambda: self._items or self._is_closed, timeout)
            found = list(self._items)
            self._items.clear()
            return found

    @property
    def is_closed(self) -> bool:
        """True if nothing more will be put in."""
        return self._is_closed

    def __len__(self) -> int:
        return len(self._items)

    def end(self) -> None:
        """End the queue: readers are woken, and get what is left."""
        with self._ready:
            self._is_closed = True
            self._ready.notify_all()

    def close(self) -> None:
        """Leave: nothing more is put in."""
        self.end()
        if self._leave is not None:
            self._leave(self)


class Listener(Generic[Item]):
    """A reader's function on a thread of its own. What it raises is reported and does not end it."""

    def __init__(
        self,
        inbox: Inbox[Item],
        function: Callable[[list[Item]], None],
        failed: Callable[[BaseException], None],
        name: str,
    ) -> None:
        self.inbox = inbox
        self._function, self._failed = function, failed
        self.failures = 0
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while True:
            items = self.inbox.get()
            if items:
                try:
                    self._function(items)
                except BaseException as error:  # whatever a user's function may raise, SystemExit too
                    self.failures += 1
                    self._failed(error)
            elif self.inbox.is_closed:
                return

    @property
    def dropped(self) -> int:
        """Number of items that came too fast for the function."""
        return self.inbox.dropped

    def stop(self, timeout: float = 5.0) -> None:
        """Leave; what is still queued is given to the function first."""
        self.inbox.close()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout)


Packet = TypeVar("Packet")

#: What became of a packet. "sent": the backend took it. "failed": it refused it. "expired": older than its age limit.
#: "dropped": the bus was lost, or a stop of the same device overtook it. "unsent": it still waited when the gate closed.
Fate = Literal["sent", "failed", "expired", "dropped", "unsent"]
#: Called once with what became of a packet, and why; on the thread where it happens.
Report = Callable[[Fate, str], object]

#: How old a packet may be when it leaves, by default (s).
AGE_S = 1.0


class OutboxItem(msgspec.Struct, Generic[Packet], gc=False, eq=False):
    """One packet that is to be sent: `size` in the gate's unit, `until` the last instant (ns) at which it may leave."""

    packet: Packet
    size: int
    until: int
    urgent: bool
    topic: object
    report: Report | None
    #: Whether its sender has said its age: a question that is asked again, and not a set-point.
    is_timed: bool = False
    fate: Fate | None = None


class Outbox(Generic[Packet]):
    """Packets by priority, the lowest first; equal ones by age."""

    def __init__(self) -> None:
        self._heap: list[tuple[bool, int, int, OutboxItem[Packet]]] = []
        self._count = 0
        #: What waits, in the gate's unit.
        self.size = 0
        #: Nothing in it is too old before this instant (ns).
        self.fresh_until = 0

    def __len__(self) -> int:
        return len(self._heap)

    def push(self, item: OutboxItem[Packet], priority: int) -> None:
        """Queue a packet."""
        self._count += 1
        if item.until < self.fresh_until or not self._heap:
            self.fresh_until = item.until
        heapq.heappush(self._heap, (not item.urgent, priority, self._count, item))
        self.size += item.size

    def pop(self) -> OutboxItem[Packet]:
        """Remove the next packet, and return it."""
        item = heapq.heappop(self._heap)[3]
        self.size -= item.size
        return item

    def first(self, most: int) -> list[OutboxItem[Packet]]:
        """Return the next packets, in order, at most so many; they stay."""
        self._heap.sort()  # a sorted list is a heap, and no two entries have one count
        return [entry[3] for entry in self._heap[:most]]

    def drop_first(self, count: int) -> list[OutboxItem[Packet]]:
        """Take out so many of the next packets, right after `first`."""
        taken = [entry[3] for entry in self._heap[:count]]
        del self._heap[:count]
        self.size -= sum(item.size for item in taken)
        return taken

    def take_old(self, now: int) -> list[OutboxItem[Packet]]:
        """Take out what is too old; a stop never is."""
        if now <= self.fresh_until:
            return []
        old = self.take(lambda item: item.until < now and not item.urgent)
        self.fresh_until = min((entry[3].until for entry in self._heap if not entry[3].urgent), default=now)
        return old

    def take(self, which: Callable[[OutboxItem[Packet]], bool]) -> list[OutboxItem[Packet]]:
        """Take out all those packets, in order."""
        kept: list[tuple[bool, int, int, OutboxItem[Packet]]] = []
        taken: list[OutboxItem[Packet]] = []
        for entry in sorted(self._heap):
            if which(entry[3]):
                taken.append(entry[3])
            else:
                kept.append(entry)
        self._heap = kept  # sorted is a heap
        self.size -= sum(item.size for item in taken)
        return taken


__all__ = ["AGE_S", "LIMIT", "Fate", "Inbox", "Listener", "Outbox", "OutboxItem", "Report"]
