"""The loop of a robot: one thread on which all that is planned happens, and on which its buses' files are served.

1. It is to the monotonic clock what events are to the virtual one: actions run in order of their instants, equal ones in
   the order in which they were asked for, on one thread; what is driven by a loop needs no locks.
2. Nothing on it may wait. What an action raises is reported and does not end it.
3. `call_soon` is for other threads; everything else may be called from them too, and is handed over by it.
4. A turn is bounded: what is due and does not fit into `TURN_NS` is left to the next turn, behind the files, and counted.
5. Where that was said (`gather`), a file that `gathers` is read together with what comes in the next moment: each wake-up
   finds cold caches. It is read before anything that is due is done, and at once while an answer is waited for (`hurry`).
6. After a pause (a process that was suspended) the files that are first are read before anything that is late is done: a
   stop that was asked for meanwhile.

A turn: what other threads have handed over, what is due, the ends of the turn (what was gathered for a bus leaves
together), then a wait for the first file that has something, the next instant, or another thread. `select` waits in
microseconds, where `epoll` rounds up to milliseconds.
"""

from __future__ import annotations

import heapq
import os
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import Any, Self, TypeVar

from ..errors import CallerError
from .clock import EventClock, RealClock, Timer

T = TypeVar("T")
Action = Callable[[], object]

#: How long a turn may take (ns) before files are served again: a tenth of the tick of a robot at 500 Hz.
TURN_NS = 200_000
#: The longest that anything is gathered (ns).
GATHER_NS = 500_000
#: An action that is so late (ns) waits until the files that are first were read.
LATE_NS = 50_000_000
#: Files that `select` takes have numbers below this.
MOST_FILES = 1000


class Loop:
    """A thread that does what is planned, when it is due, and serves files.

    with Loop() as loop:
        loop.call_in(1_000_000, tick)

    `carried` counts the turns that had to leave something to the next one. Its time is a parameter: `now` (ns), and `wait`,
    which lets time pass as `select.select` does.
    """

    name = RealClock.name

    def __init__(
        self,
        name: str = "aces loop",
        failed: Callable[[BaseException], None] | None = None,
        *,
        now: Callable[[], int] = time.monotonic_ns,
        wait: Callable[..., tuple[list[int], Any, Any]] = select.select,
    ) -> None:
        #: Add this to one of its instants for nanoseconds since 1970, as of when the loop was made.
        self.epoch_ns = time.time_ns() - time.monotonic_ns()
        self._monotonic_ns, self._select = now, wait
        #: The present instant in ns.
        self.now = now
        self.thread_name = name
        self._failed = failed
        #: What actions raised, the last few.
        self.failures: deque[BaseException] = deque(maxlen=16)
        self.carried = 0
        self._events: list[tuple[int, int, Any]] = []
        self._count = 0
        self._soon: deque[Action] = deque()
        self._ends: list[Action] = []
        self._readers: dict[int, Action] = {}
        #: Files that gather; those that do so now, with the instant since which they have something; when these are read.
        self._gathering: set[int] = set()
        #: Files that are read before what is late.
        self._first: set[int] = set()
        self._held: dict[int, tuple[int, Action]] = {}
        self._gather_ns = self._hurried_until = self._read_at = 0
        #: The instant (ns) since which what is being read has waited; 0: it has not.
        self.waited_since = 0
        self._waker: socket.socket | None = None
        #: Whether another thread has to wake it.
        self._is_asleep = False
        self._stopping = False
        self._thread: threading.Thread | None = None
        #: The number of its thread; 0: it does not run.
        self.own_thread = 0

    # ------------------------------------------------------------------ planning

    def sleep_until(self, instant: int) -> None:
        """Wait until `instant` (ns) on the calling thread, which must not be the loop's own."""
        left = instant - self.now()
        if left > 0:
            time.sleep(left / 1e9)

    def call_at(self, instant: int, action: Action) -> Timer:
        """Plan `action` for `instant` (ns); one that has passed is done at once."""
        timer = Timer(instant, action)
        self._push(instant, timer)
        return timer

    def call_in(self, delay: int, action: Action) -> Timer:
        """Plan `action` for `delay` ns from now."""
        return self.call_at(self.now() + delay, action)

    def post(self, instant: int, action: Action) -> None:
        """Plan what will not be cancelled."""
        self._push(instant, action)

    def _push(self, instant: int, planned: Any) -> None:
        if self._thread is None or self.is_own_thread:
            self._count += 1
            heapq.heappush(self._events, (instant, self._count, planned))
        else:
            self.call_soon(lambda: self._push(instant, planned))

    def call_soon(self, action: Action) -> None:
        """Do it next, on the loop's thread."""
        self._soon.append(action)
        if self._is_asleep:  # after the append: who goes to sleep looks again
            self._wake()

    def at_turn_end(self, action: Action) -> None:
        """Do it when all else of this turn is done, before the loop waits. For the loop's own thread."""
        self._ends.append(action)

    def call(self, action: Callable[[], T]) -> T:
        """Do it on the loop's thread and return what it returns; what it raises is raised here.

        Raises `CallerError` when the loop does not run.
        """
        if self.is_own_thread:
            return action()
        if self._stopping or self._thread is None:
            raise self._ended()
        done: Future[T] = Future()

        def run() -> None:
            try:
                done.set_result(action())
            except BaseException as error:  # it is raised where it was asked for
                done.set_exception(error)

        self.call_soon(run)
        while True:
            try:
                return done.result(0.5)
            except FutureTimeout:
                if done.done():
                    raise
                if self._stopping or not self._thread.is_alive():
                    raise self._ended() from None

    def _ended(self) -> CallerError:
        return CallerError(f"{self.thread_name} does not run: nothing can be done on it")

    @property
    def is_own_thread(self) -> bool:
        """True if the caller runs on the loop's thread."""
        return self.own_thread == threading.get_ident()

    @property
    def is_elsewhere(self) -> bool:
        """True if the loop runs, on another thread than the caller's."""
        return not self._stopping and self.own_thread not in (0, threading.get_ident())

    # ------------------------------------------------------------------ files

    @staticmethod
    def can_watch(number: int) -> bool:
        """Return whether a file of this number can be served."""
        return 0 <= number < MOST_FILES

    def watch(self, number: int, readable: Action, *, gathers: bool = False, is_first: bool = False) -> None:
        """Call `readable` whenever the file of this number has something to read.

        See `gather` for one that `gathers`. One that `is_first` is read before actions that are late.
        """
        if self._thread is None or self.is_own_thread:
            self._readers[number] = readable
            if gathers:
                self._gathering.add(number)
            if is_first:
                self._first.add(number)
        else:
            self.call_soon(lambda: self.watch(number, readable, gathers=gathers, is_first=is_first))

    def unwatch(self, number: int) -> None:
        """Serve the file no more: before it is closed, on the loop's own thread (`call`)."""
        self._readers.pop(number, None)
        self._held.pop(number, None)
        self._gathering.discard(number)
        self._first.discard(number)

    def gather(self, most_ns: int) -> None:
        """Read files from now on that gather once in so long (ns) at most; of several that are said the shortest counts."""
        self._gather_ns = min(most_ns, self._gather_ns or GATHER_NS)

    def hurry(self, until: int) -> None:
        """Read all files at once until this instant (ns): an answer is waited for."""
        self._read_at = 0
        if until > self._hurried_until:
            self._hurried_until = until

    # ------------------------------------------------------------------ running

    def start(self) -> Self:
        """Begin; raises `CallerError` when it was started before."""
        if self._thread is not None:
            raise CallerError(f"{self.thread_name} was started before; make another")
        self._waker, woken = socket.socketpair()
        self._waker.setblocking(False)
        woken.setblocking(False)
        thread = threading.Thread(target=self._run, args=(woken,), name=self.thread_name, daemon=True)
        self._thread = thread
        thread.start()
        return self

    def stop(self, timeout: float = 5.0) -> None:
        """End: what is planned does not happen."""
        self._stopping = True
        self._wake()
        if self._thread is not None and not self.is_own_thread:
            self._thread.join(timeout)

    def __enter__(self) -> Self:
        return self if self._thread is not None else self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _wake(self) -> None:
        self._is_asleep = False
        if self._waker is not None:
            try:
                self._waker.send(b"\0")
            except OSError:  # it is full of the same, or the loop has ended
                pass

    def _run(self, woken: socket.socket) -> None:
        self.own_thread = threading.get_ident()
        self.watch(woken.fileno(), lambda: woken.recv(4096))
        soon, events, readers, select = self._soon, self._events, self._readers, self._select
        held, gathering = self._held, self._gathering
        monotonic_ns, do = self._monotonic_ns, self._do
        try:
            while not self._stopping:
                now = monotonic_ns()
                if self._first and events and now - events[0][0] > LATE_NS:
                    self._read_first()
                if held and (now >= self._read_at or (events and events[0][0] <= now)):
                    self._read_held()
                if soon or self._ends or (events and events[0][0] <= now):
                    self._turn(now)
                    now = monotonic_ns()
                while events and events[0][2].__class__ is Timer and events[0][2].action is None:
                    heapq.heappop(events)  # taken back: no reason to wake up
                left = max(0, events[0][0] - now) / 1e9 if events else None
                if held:
                    rest = max(0, self._read_at - now) / 1e9
                    left = rest if left is None or rest < left else left
                self._is_asleep = True
                if soon or self._stopping:  # handed over before that was seen
                    left = 0
                try:
                    readable, _, _ = select(readers, (), (), left)
                except (OSError, ValueError):  # a file was closed under us
                    self._is_asleep = False
                    self._serve_closed()
                    continue
                self._is_asleep = False
                may_wait = readable and self._gather_ns and self._may_wait(now := monotonic_ns())
                for number in readable:
                    action = readers.get(number)
                    if action is not None:
                        if may_wait and number in gathering:
                            if not held:
                                self._read_at = now + self._gather_ns
                            held[number] = now, readers.pop(number)
                        else:
                            do(action)
        finally:
            woken.close()
            assert self._waker is not None
            self._waker.close()

    def _read_first(self) -> None:
        """Read the files that are first."""
        try:
            readable, _, _ = self._select(self._first, (), (), 0)
        except (OSError, ValueError):  # one was closed under us, which the next wait sees
            return
        for number in readable:
            self._do(self._readers[number])

    def _may_wait(self, now: int) -> bool:
        """Return whether nobody waits for an answer, and nothing is due before what comes now is read."""
        events = self._events
        return now >= self._hurried_until and not (events and events[0][0] <= now + self._gather_ns)

    def _read_held(self) -> None:
        """Read what has gathered."""
        held = self._held
        while held:
            number = next(iter(held))
            since, action = held.pop(number)
            self._readers[number] = action
            self.waited_since = since
            self._do(action)
        self.waited_since = 0

    def _turn(self, now: int) -> None:
        """Run what was handed over, what is due, and what has ended."""
        monotonic_ns = self._monotonic_ns
        soon, events, do = self._soon, self._events, self._do
        until = now + TURN_NS
        for _ in range(len(soon)):
            do(soon.popleft())
            if monotonic_ns() > until:
                break
        while events and events[0][0] <= now:
            planned = heapq.heappop(events)[2]
            if planned.__class__ is Timer:
                action, planned.action = planned.action, None
                if action is None:
                    continue
            else:
                action = planned
            do(action)
            if monotonic_ns() > until:
                break
        while self._ends:
            ends, self._ends = self._ends, []
            for action in ends:
                do(action)
        if soon or (events and events[0][0] <= now):
            self.carried += 1

    def _do(self, action: Action) -> None:
        try:
            action()
        except BaseException as error:  # an action is the user's code too
            self.failures.append(error)
            if self._failed is not None:
                self._failed(error)

    def _serve_closed(self) -> None:
        """Take out the files that are closed: reading says to whom they belong."""
        for number, readable in list(self._readers.items()):
            try:
                os.fstat(number)
            except (OSError, ValueError):
                self.unwatch(number)
                self._do(readable)

    def wait(self, until: Callable[[], bool], timeout_ns: int) -> bool:
        """Wait on another thread until `until()` holds; whether it did within `timeout_ns`. It is asked every millisecond.

        Raises `CallerError` on the loop's own thread, which would wait for itself.
        """
        if self.is_own_thread:
            raise CallerError(f"{self.thread_name} cannot wait for itself; plan what is to follow instead")
        end = time.monotonic_ns() + timeout_ns
        while not until():
            left = end - time.monotonic_ns()
            if left <= 0:
                return until()
            time.sleep(min(left, 1_000_000) / 1e9)
        return True


def call_there(clock: EventClock, action: Callable[[], T]) -> T:
    """Do it where all that is planned on `clock` runs, from whatever thread; here where the clock does not run."""
    if isinstance(clock, Loop) and clock.is_elsewhere:
        return clock.call(action)
    return action()
