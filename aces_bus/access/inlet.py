"""Set-points from outside, on their way down; and what happens to those who look in from outside.

1. They reach states on the clock's thread only. However many come, one action waits there, with the newest value of each
   state: a flood costs nothing below.
2. A state that refuses one (read-only, not a number, another's) is counted, and reported once for each state until it
   takes one.
3. Whose set-point a state of a robot takes is its only writer until `give_up`; another writer's is refused.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import msgspec


class AccessEvent(msgspec.Struct, frozen=True):
    """`kind` is "lost" (nothing comes any more), "back", "restarted" (another run answers) or "refused" (a set-point that
    cannot be); `instant` in ns of a local clock, `source` who it is about, `detail` for people."""

    kind: str
    instant: int
    source: str
    detail: str = ""

    def __str__(self) -> str:
        return f"{self.source}: {self.kind}" + (f": {self.detail}" if self.detail else "")


Listener = Callable[[AccessEvent], None]


class AccessEvents:
    """The last events, and listeners. Emitting one never raises."""

    def __init__(self) -> None:
        self.last: deque[AccessEvent] = deque(maxlen=64)
        self.listeners: list[Listener] = []

    def emit(self, event: AccessEvent) -> None:
        """Keep an event and call all listeners with it."""
        self.last.append(event)
        for listener in list(self.listeners):
            try:
                listener(event)
            except Exception:  # a user's own; what failed goes on
                pass


class Soon(Protocol):
    """What of a clock is needed: `Loop` and `VirtualClock` have it."""

    def now(self) -> int:
        """Return the present instant in ns."""
        ...

    def call_soon(self, action: Callable[[], None]) -> None:
        """Call it next, on the clock's thread."""
        ...


class Inlet:
    """Takes set-points (`put`) and sample requests (`ask`) from any thread. `taken` and `refused` count set-points."""

    def __init__(
        self,
        clock: Soon,
        states: Mapping[str, Any],
        events: AccessEvents,
        name: str,
        *,
        plans: bool = True,
        all_states: object = None,
    ) -> None:
        self.clock, self.states, self.events, self.name = clock, states, events, name
        #: The states that these are some of; a robot's know who writes them.
        self.all_states = all_states
        #: Whether it plans on the clock by itself; else its owner calls `flush` on the clock's thread.
        self.plans = plans
        self.taken = self.refused = 0
        #: When the last one was taken (ns); None before the first.
        self.taken_at: int | None = None
        self._writers: dict[str, Callable[[float], None]] = {}
        self._waiting: dict[str, float] = {}
        self._asked: set[str] = set()
        self._complained: set[str] = set()
        self._is_planned = False
        self._lock = threading.Lock()

    def put(self, values: Mapping[str, float]) -> None:
        """Queue set-points by state; refuse unknown states now, other faults later."""
        good = {name: v for name, v in values.items() if name in self.states}
        for name in values.keys() - good.keys():
            self._refuse(name[:80], "no such state")
        if good:
            with self._lock:
                self._waiting.update(good)
            self._plan()

    def ask(self, name: str) -> None:
        """Ask a state's device for a new sample."""
        with self._lock:
            self._asked.add(name)
        self._plan()

    def _plan(self) -> None:
        with self._lock:
            if self._is_planned:
                return
            self._is_planned = True
        if self.plans:
            self.clock.call_soon(self.flush)

    def flush(self) -> None:
        """Hand down what waits; on the clock's thread."""
        with self._lock:
            waiting, self._waiting = self._waiting, {}
            asked, self._asked = self._asked, set()
            self._is_planned = False
        for name, value in waiting.items():
            try:
                self._writer(name)(value)
            except Exception as error:  # a driver's own, too; the others are set nevertheless
                self._refuse(name, str(error))
            else:
                self.taken += 1
                self.taken_at = self.clock.now()
                self._complained.discard(name)
        for name in asked:
            try:
                self.states[name].refresh()
            except Exception as error:
                self._refuse(name, str(error))

    def _writer(self, name: str) -> Callable[[float], None]:
        """Return what takes this writer's set-points of a state."""
        found = self._writers.get(name)
        if found is None:
            state = self.states[name]
            claim = getattr(self.all_states, "writer", None)
            found = self._writers[name] = state.set if claim is None else claim(name, self.name)
        return found

    def give_up(self) -> None:
        """Give up what it writes: others may set these signals now."""
        self._writers.clear()
        door = getattr(self.all_states, "door", None)
        if door is not None:
            door.give_up(self.name)

    def _refuse(self, name: str, why: str) -> None:
        self.refused += 1
        # Names from outside are endless: only so many are remembered and reported.
        if name not in self._complained and len(self._complained) < 256:
            self._complained.add(name)
            detail = f"{name!r}: {why}"[:300]
            self.events.emit(AccessEvent("refused", self.clock.now(), self.name, detail))
