"""How a command ends that reads or waits.

1. Ctrl-C, SIGTERM and SIGHUP end it as if its time were up: what was received is shown and counted, and what is not whole
   is not written.
2. Waiting is done in steps, so that a signal never waits long; the last step ends at the deadline.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Self, TypeVar

T = TypeVar("T")
#: Seconds after which a waiting command looks at other things than its bus: a signal never waits longer.
STEP_S = 0.1


class Patience:
    """While it is entered, Ctrl-C, SIGTERM and SIGHUP let the work in hand be finished and end the waiting for more.

        with Patience() as patience:
            for batch in patience.each(batches):
                …                                  # never interrupted
        patience.is_over                           # whether a signal ended it

    A second signal interrupts at once, but not in `stopping`. One that is ignored, as under `nohup`, stays so.
    """

    def __init__(self) -> None:
        self.is_over = False
        self._is_waiting = self._is_stopping = False
        self._before: dict[int, Any] = {}
        self._is_ours = threading.current_thread() is threading.main_thread()

    def __enter__(self) -> Self:
        if self._is_ours:
            self._before[signal.SIGINT] = signal.signal(signal.SIGINT, self._interrupted)
            for name in ("SIGTERM", "SIGHUP"):
                number = getattr(signal, name, None)
                if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                    self._before[number] = signal.signal(number, self._interrupted)
        return self

    def __exit__(self, *_: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        self._before.clear()

    def _interrupted(self, number: int, frame: FrameType | None) -> None:
        was_over, self.is_over = self.is_over, True
        if self._is_waiting or (was_over and not self._is_stopping):
            self._is_waiting = False
            raise KeyboardInterrupt

    @contextmanager
    def stopping(self) -> Generator[None, None, None]:
        """In here a second Ctrl-C interrupts nothing either: for what may move and is stopped at its end, within a bound."""
        self._is_stopping = True
        try:
            yield
        finally:
            self._is_stopping = False

    @contextmanager
    def waiting(self) -> Generator[None, None, None]:
        """Ctrl-C raises `KeyboardInterrupt` in here."""
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
        """The items, until there are no more or Ctrl-C."""
        iterator = iter(items)
        while not self.is_over:
            try:
                with self.waiting():
                    if self.is_over:  # a Ctrl-C between the two: nothing would end the waiting
                        return
                    item = next(iterator)
            except (StopIteration, KeyboardInterrupt):
                return
            yield item
