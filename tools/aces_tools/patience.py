"""How a command ends that reads or waits.

1. Ctrl-C, SIGTERM and every other signal that would kill it end it as if its time were up: what was received is shown and
   counted, and what is not whole is not written. Only SIGKILL and a fault of the interpreter do not.
2. Waiting is done in steps, so that a signal never waits long; the last step ends at the deadline.
3. A signal that comes after Python has looked for signals and before a read blocks is not lost: `_Waker` ends the read.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from types import FrameType
from typing import Any, Self, TypeVar

T = TypeVar("T")
#: Seconds after which a waiting command looks at other things than its bus: a signal never waits longer.
STEP_S = 0.1
#: Signals beside Ctrl-C whose default is to kill a program.
ENDING = ("TERM", "HUP", "QUIT", "USR1", "USR2", "XCPU", "ALRM", "VTALRM", "PROF", "IO", "PWR", "STKFLT")
#: Signals that would suspend a program which reads or writes its terminal from the background.
OF_TERMINALS = ("TTIN", "TTOU")
SUSPENDED = b"\naces: Ctrl-Z ends this and stops what moves: a suspended program cannot look after motors\n"


#: Interrupts a blocking call of the main thread, and does nothing else: who ignores it by default loses nothing.
NUDGE: int | None = getattr(signal, "SIGURG", None)
#: After a signal the main thread is nudged this often (s apart): it may not have begun to block.
NUDGES_S = (0.0, 0.01, 0.1, 0.5, 2.0)


class _Waker:
    """Nudges the main thread after each signal, so that it looks for signals even in a read that nothing ends.

    Python's own handler tells of each signal by a byte in a pipe; a thread waits for it.
    """

    def __init__(self, nudge: int) -> None:
        self._nudge, self._main = nudge, threading.get_ident()
        self._is_over = threading.Event()
        self._reading, self._writing = os.pipe()
        os.set_blocking(self._writing, False)
        self._before = signal.signal(nudge, lambda number, frame: None)
        self._told = signal.set_wakeup_fd(self._writing, warn_on_full_buffer=False)
        self._thread = threading.Thread(target=self._watch, name="aces-signals", daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while not self._is_over.is_set():
            if set(os.read(self._reading, 512)) == {self._nudge}:
                continue  # the bytes of nudges
            for seconds in NUDGES_S:
                if self._is_over.wait(seconds):
                    return
                signal.pthread_kill(self._main, self._nudge)

    def close(self) -> None:
        """End the thread; signals are told to whom they were told before."""
        signal.set_wakeup_fd(self._told)
        self._is_over.set()
        with suppress(BlockingIOError):  # full: it does not wait
            os.write(self._writing, b"\0")
        self._thread.join()
        signal.signal(self._nudge, self._before)
        os.close(self._reading)
        os.close(self._writing)


class Patience:
    """While it is entered, Ctrl-C, SIGTERM and their like let the work in hand be finished and end the waiting for more.

        with Patience() as patience:
            for batch in patience.each(batches):
                …                                  # never interrupted
        patience.is_over                           # whether a signal ended it

    A second signal interrupts at once, but not in `stopping`. One that is ignored, as under `nohup`, stays so. With
    `is_driving` Ctrl-Z does the same, and says so: suspended, a program leaves motors on.
    """

    def __init__(self, *, is_driving: bool = False) -> None:
        self.is_over, self.is_driving = False, is_driving
        self._is_waiting = self._is_stopping = False
        self._before: dict[int, Any] = {}
        self._is_ours = threading.current_thread() is threading.main_thread()
        self._waker: _Waker | None = None

    def __enter__(self) -> Self:
        if self._is_ours:
            if NUDGE is not None:
                self._waker = _Waker(NUDGE)
            self._before[signal.SIGINT] = signal.signal(signal.SIGINT, self._interrupted)
            for name in ENDING:
                self._take(name, self._interrupted)
            if self.is_driving:
                self._take("TSTP", self._suspended)
                for name in OF_TERMINALS:
                    self._take(name, signal.SIG_IGN)
        return self

    def _take(self, name: str, handler: Any) -> None:
        number = getattr(signal, f"SIG{name}", None)
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            self._before[number] = signal.signal(number, handler)

    def _suspended(self, number: int, frame: FrameType | None) -> None:
        with suppress(OSError):
            os.write(2, SUSPENDED)  # a stream may be in the middle of a line
        self._interrupted(number, frame)

    def __exit__(self, *_: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        self._before.clear()
        if self._waker is not None:
            self._waker.close()
            self._waker = None

    def _interrupted(self, number: int, frame: FrameType | None) -> None:
        was_over, self.is_over = self.is_over, True
        if self._is_waiting or (was_over and not self._is_stopping):
            self._is_waiting = False
            raise KeyboardInterrupt

    @contextmanager
    def stopping(self) -> Generator[None, None, None]:
        """Ignore a second Ctrl-C in here: for what may move and is stopped at its end, within a bound."""
        self._is_stopping = True
        try:
            yield
        finally:
            self._is_stopping = False

    @contextmanager
    def waiting(self) -> Generator[None, None, None]:
        """Raise `KeyboardInterrupt` for a Ctrl-C in here."""
        self._is_waiting = True
        try:
            yield
        finally:
            self._is_waiting = False

    def wait_until(self, instant: int) -> bool:
        """Wait until `instant` (ns of the monotonic clock); False when the command has to end before."""
        while not self.is_over:
            left = instant - time.monotonic_ns()
            if left <= 0:
                return True
            time.sleep(min(left / 1e9, STEP_S))
        return False

    def each(self, items: Iterable[T]) -> Iterator[T]:
        """Yield the items, until there are no more or Ctrl-C is pressed."""
        iterator = iter(items)
        while not self.is_over:
            found: list[T] = []
            with suppress(KeyboardInterrupt), self.waiting():
                if self.is_over:  # a Ctrl-C between the two: nothing would end the waiting
                    return
                found.extend(islice(iterator, 1))  # not `next`: a Ctrl-C behind it would drop the item
            if not found:
                return
            yield found[0]
