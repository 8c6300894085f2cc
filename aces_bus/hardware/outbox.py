"""What waits to be sent by a gate.

1. Each word ends in exactly one bin: sent, failed, expired, dropped or unsent (`Fate`). Its sender may ask to be told which.
2. A word has an age limit: one that could not leave in time does not leave late.
3. What is urgent, a stop, goes before all else, instead of what waits for the same device, and outlives the loss of a bus.

No thread and no I/O: a gate calls it under its own lock, and reports fates when it has let go of it.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from typing import Any, Generic, Literal, TypeVar

Word = TypeVar("Word")

#: What became of a word. "sent": the backend took it. "failed": it refused it. "expired": older than its age limit.
#: "dropped": the bus was lost, or a stop of the same device overtook it. "unsent": it still waited when the gate closed.
Fate = Literal["sent", "failed", "expired", "dropped", "unsent"]
#: Called once with what became of a word, and why; on the thread where it happens.
Report = Callable[[Fate, str], object]

#: How old a word may be when it leaves, where nobody says otherwise (s).
AGE_S = 1.0


class OutboxItem(Generic[Word]):
    """One word that is to be sent: `size` in the gate's unit, `until` the last instant (ns) at which it may leave."""

    __slots__ = ("fate", "report", "size", "topic", "until", "urgent", "word")

    def __init__(
        self, word: Word, size: int, until: int, *, urgent: bool, topic: object, report: Report | None
    ) -> None:
        self.word, self.size, self.until = word, size, until
        self.urgent, self.topic, self.report = urgent, topic, report
        self.fate: Fate | None = None


class Outbox(Generic[Word]):
    """Words by priority, the lowest first; equal ones by age."""

    def __init__(self) -> None:
        self._heap: list[tuple[bool, int, int, OutboxItem[Word]]] = []
        self._count = 0
        #: What waits, in the gate's unit.
        self.size = 0

    def __len__(self) -> int:
        return len(self._heap)

    def push(self, item: OutboxItem[Word], priority: int) -> None:
        """Queue a word."""
        self._count += 1
        heapq.heappush(self._heap, (not item.urgent, priority, self._count, item))
        self.size += item.size

    def pop(self) -> OutboxItem[Word]:
        """The next word."""
        item = heapq.heappop(self._heap)[3]
        self.size -= item.size
        return item

    def take(self, which: Callable[[OutboxItem[Word]], bool]) -> list[OutboxItem[Word]]:
        """Take out all those words, in order."""
        kept: list[tuple[bool, int, int, OutboxItem[Word]]] = []
        taken: list[OutboxItem[Word]] = []
        for entry in sorted(self._heap, key=_order):
            if which(entry[3]):
                taken.append(entry[3])
            else:
                kept.append(entry)
        self._heap = kept  # sorted is a heap
        self.size -= sum(item.size for item in taken)
        return taken


def _order(entry: tuple[bool, int, int, Any]) -> tuple[bool, int, int]:
    return entry[:3]


__all__ = ["AGE_S", "Fate", "Outbox", "OutboxItem", "Report"]
