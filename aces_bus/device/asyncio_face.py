"""The device floor in programs of asyncio: `await device.ask(…)`, `async for record in client`.

1. Nothing here is a second way: the threads and clocks below stay as they are, and hand over with `call_soon_threadsafe`.
2. A bus is read by a thread while it is iterated over. The thread waits where the program falls behind, so that what is left
   out is the bus's own to count.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import suppress
from typing import TYPE_CHECKING

from ..runtime.loop import Loop

if TYPE_CHECKING:
    from ..protocol import Record
    from .ticket import Awaited

#: How often a reading thread looks whether it is to end (s).
LOOK_S = 0.05
#: Reads that wait for the program; then the thread waits.
MOST_WAITING = 1000


def wait_in_asyncio(awaited: Awaited) -> Generator[object, None, None]:
    """Let other tasks run until `awaited` is over. On a clock that does not run by itself (virtual time) let its time pass,
    and raise as `wait`.
    """
    clock = awaited.clock
    if not isinstance(clock, Loop):
        awaited.wait()
        return
    here = asyncio.get_running_loop()
    over: asyncio.Future[None] = here.create_future()

    def finish() -> None:
        if not over.done():  # it may have been cancelled
            over.set_result(None)

    def tell(_: object) -> None:
        with suppress(RuntimeError):  # the program's loop has been closed
            here.call_soon_threadsafe(finish)

    clock.call_soon(lambda: awaited.then(tell))
    yield from over


async def read_in_asyncio(read: Callable[[float], list[Record]]) -> AsyncGenerator[Record, None]:
    """Yield what `read(timeout_s)` returns, called by a thread until the iteration ends. What it raises is raised here."""
    here = asyncio.get_running_loop()
    waiting: asyncio.Queue[list[Record] | Exception] = asyncio.Queue()
    is_over, has_room = threading.Event(), threading.Semaphore(MOST_WAITING)

    def read_on() -> None:
        found: list[Record] | Exception = []
        while not is_over.is_set() and not isinstance(found, Exception):
            try:
                found = read(LOOK_S)
            except Exception as error:  # whatever a backend may raise
                found = error
            while found and not has_room.acquire(timeout=LOOK_S):
                if is_over.is_set():
                    return
            if found:
                with suppress(RuntimeError):  # the program's loop has been closed
                    here.call_soon_threadsafe(waiting.put_nowait, found)

    thread = threading.Thread(target=read_on, name="records", daemon=True)
    thread.start()
    try:
        while True:
            found = await waiting.get()
            has_room.release()
            if isinstance(found, Exception):
                raise found
            for record in found:
                yield record
    finally:
        is_over.set()
        await asyncio.to_thread(thread.join)
