"""Virtual time: a clock that jumps from event to event.

1. It moves only when it is advanced; nothing waits, and no thread is needed.
2. Events at the same instant run in the order in which they were asked for: the same program, the same run.
3. What would be planned only to be the next event need not be: `skip_to` goes on at once, with the same result.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from typing import Any, TypeVar

from ..compiling import mypyc_attr
from ..errors import CallerError
from .clock import Timer

T = TypeVar("T")

#: No instant is as early.
_NO_ADVANCE = -(1 << 62)


@mypyc_attr(allow_interpreted_subclasses=True)
class VirtualClock:
    """A clock that jumps from event to event.

    `call_at` and `call_in` plan events; `advance_to`, `advance` and `run` let them happen. An event may plan others.
    Whatever an event raises comes out of the call that advanced the clock, with the clock at that event.

    >>> clock = VirtualClock()
    >>> timer = clock.call_in(5_000, lambda: print("at", clock.now()))
    >>> clock.advance(10_000)
    at 5000
    >>> clock.now()
    10000
    """

    name = "virtual"
    epoch_ns = 0

    def __init__(self, start: int = 0) -> None:
        self._now = start
        self._events: list[tuple[int, int, Any]] = []  # a Timer, or an action itself
        self._count = 0
        #: How far the advance under way goes; `_NO_ADVANCE` where each event is looked at on its own.
        self._horizon = _NO_ADVANCE

    def now(self) -> int:
        """Return the present instant in ns."""
        return self._now

    def call_at(self, instant: int, action: Callable[[], object]) -> Timer:
        """Plan `action` for `instant` (ns); one that has passed happens at the next advance, at its present time."""
        if instant < self._now:
            instant = self._now
        timer = Timer(instant, action)
        self._count += 1
        heapq.heappush(self._events, (instant, self._count, timer))
        return timer

    def post(self, instant: int, action: Callable[[], object]) -> None:
        """Plan what will not be cancelled: `call_at` without its `Timer`, which is what most events cost."""
        if instant < self._now:
            instant = self._now
        self._count += 1
        heapq.heappush(self._events, (instant, self._count, action))

    def skip_to(self, instant: int) -> bool:
        """Have `instant` (ns) come at once; False, and nothing has changed, where something else comes first.

        The last thing that an event does: what it would have planned for `instant` it may do now, for nothing is planned
        before, and the advance under way does not end before. Most events of a busy bus are spared that way.
        """
        if instant < self._now:
            instant = self._now  # it has passed
        events = self._events
        if instant > self._horizon or (events and events[0][0] <= instant):
            return False
        self._now = instant
        return True

    def call_in(self, delay: int, action: Callable[[], object]) -> Timer:
        """Plan `action` for `delay` ns from now."""
        return self.call_at(self._now + delay, action)

    def call_soon(self, action: Callable[[], object]) -> None:
        """Plan `action` for this very instant, behind what is planned for it already."""
        self.post(self._now, action)

    def call(self, action: Callable[[], T]) -> T:
        """Do it now and return what it returns: there is one thread."""
        return action()

    def wait(self, until: Callable[[], bool], timeout_ns: int) -> bool:
        """Let events happen until `until()` holds, at most `timeout_ns`; whether it holds."""
        end = self._now + timeout_ns
        while not until():
            if not self.step(end):
                self._now = max(self._now, end)
                return until()
        return True

    @property
    def next_event(self) -> int | None:
        """When the next event is to happen; None when nothing is planned."""
        events = self._events
        while events and isinstance(events[0][2], Timer) and events[0][2].action is None:
            heapq.heappop(events)
        return events[0][0] if events else None

    def step(self, until: int | None = None) -> bool:
        """Let the next event happen; False when nothing is planned (up to the instant `until`, ns)."""
        return self._happen(1 << 62 if until is None else until, _NO_ADVANCE, is_one=True)

    def _happen(self, end: int, horizon: int, *, is_one: bool = False) -> bool:
        """Let events up to the instant `end` happen, or the next of them; whether there was one."""
        events, pop = self._events, heapq.heappop
        outer, self._horizon = self._horizon, horizon
        has_happened = False
        try:
            while events and events[0][0] <= end:
                instant, _, action = pop(events)
                if action.__class__ is Timer:
                    timer = action
                    action, timer.action = timer.action, None
                    if action is None:
                        continue
                self._now = instant
                has_happened = True
                action()
                if is_one:
                    break
        finally:
            self._horizon = outer
        return has_happened

    def advance_to(self, instant: int) -> None:
        """Let everything happen that is planned up to `instant` (ns), which is then the time."""
        if instant < self._now:
            raise CallerError(f"virtual time cannot go back from {self._now} ns to {instant} ns")
        self._happen(instant, instant)
        self._now = max(self._now, instant)

    def advance(self, duration: int) -> None:
        """Advance by a duration in ns."""
        self.advance_to(self._now + duration)

    def sleep_until(self, instant: int) -> None:
        """Bring `instant` (ns) about; one that has passed is there already."""
        if instant > self._now:
            self.advance_to(instant)

    def run(self, until: Callable[[], bool] | None = None, *, most: int = 10_000_000) -> bool:
        """Let events happen until `until()` holds, nothing is planned or `most` events have passed; whether it holds."""
        for _ in range(most):
            if until is not None and until():
                return True
            if not self.step():
                break
        return until is not None and until()
