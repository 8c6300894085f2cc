"""Work of export files that is done while their caller goes on: Arrow encodes and compresses without Python's lock.

1. Work on one file is done in order, each behind the one before; two files may be worked on at once.
2. What fails is raised by the next call.
3. Little waits, so that memory stays flat: `do` waits where the threads fall behind.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

#: Threads. Writing takes about as long as reading and decoding together, so more would find nothing to do.
THREADS = 2
#: What is under way at most, on all threads together.
UNDER_WAY = 4


class Behind:
    """Threads that begin with the first work. Of a file, which is known by name, all work is one thread's."""

    def __init__(self) -> None:
        self._threads: list[ThreadPoolExecutor] = []
        self._thread_of: dict[str, ThreadPoolExecutor] = {}
        self._under_way: deque[Future[object]] = deque()

    def do(self, name: str, work: Callable[[], object]) -> None:
        """Work on a file; raises what earlier work has raised."""
        while len(self._under_way) >= UNDER_WAY:
            self._under_way.popleft().result()
        if not self._threads:
            self._threads = [ThreadPoolExecutor(1, "aces-export") for _ in range(THREADS)]
        thread = self._thread_of.setdefault(name, self._threads[len(self._thread_of) % THREADS])
        self._under_way.append(thread.submit(work))

    def wait(self) -> None:
        """Wait until all is done; raises the first that failed."""
        while self._under_way:
            self._under_way.popleft().result()

    def stop(self) -> None:
        """End: what has begun is finished, the rest left undone. Raises nothing."""
        for thread in self._threads:
            thread.shutdown(cancel_futures=True)
        self._threads = []
        self._thread_of.clear()
        self._under_way.clear()
