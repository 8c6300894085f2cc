"""What every gatekeeper is: the one owner of a bus, with threads of its own or on a robot's loop, that many may listen to.

1. A bus that is lost is opened again, and what was lost with it is counted and said.
2. A gate that only listens has no way to send: no queue and no thread.
3. `stop` lets what waits leave before it closes the bus.

By itself a gate has two threads, one to receive and one to send. On a loop (`start_on`) it has none where its bus has a
file to wait for: the loop reads what is there, and what was given in one turn leaves together at its end. Threads do only
what may block: a backend without such a file, or that cannot send at once, and the opening of a bus that was lost.

What was received and who wants to know: `gate_base`; how it sends: `gate_sending`."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Self

from ..errors import CallerError
from ..runtime import Loop
from .gate_base import ContentFilter, Item, Received
from .gate_sending import POLL_S, SendingGate

#: Seconds between attempts to open a lost bus: the first, and the longest.
RETRY_S, RETRY_MOST_S = 0.1, 2.0
#: Seconds that `stop` gives to what waits to be sent, and to a thread that is inside a backend.
DRAIN_S, JOIN_S = 1.0, 5.0


class Gate(SendingGate[Item]):
    """One bus and its only owner; a context manager. See `CanGate`, `SerialGate` and `DatagramGate`."""

    def start(self) -> Self:
        """Open the bus and begin to receive.

        Raises what opening raises: a bus that cannot be opened at first is the caller's to know.
        """
        self._open_first()
        self._thread(self._receive, "receive")
        if not self.listen_only:
            self._transmitter = self._thread(self._transmit, "send")
        return self

    def start_on(self, loop: Loop, received: Callable[[list[Received[Item]]], Any]) -> Self:
        """Open the bus; `received` gets what arrives, on the loop's thread; its clock is the loop's. Raises as `start`."""
        self._loop, self._received, self.clock = loop, received, loop
        self._open_first()
        self._attach()
        self._look_again()
        return self

    def stop(self, drain_s: float = DRAIN_S) -> int:
        """Let what waits leave, at most for `drain_s` seconds, and close the bus. Readers get what is still queued.

        How much could not be sent, of all that was given since the gate was opened and is not counted elsewhere
        (`Counters.unsent`); it is an event "not sent" too.
        """
        if self.state in ("new", "closed"):
            self.state = "closed"
            return self.counters.unsent
        try:
            self._drain(drain_s)
        finally:
            self._end()
        return self.counters.unsent

    def _end(self) -> None:
        self._is_closing = True
        self._stopping.set()
        self._detach()
        with self._guard:
            left_over = self._outbox.take(lambda item: True)
            self._outgoing.notify_all()
        held = self._still_held() if self.state == "open" else 0
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(JOIN_S)
        with self._guard:
            if self._in_hand is not None:  # its thread does not come back
                left_over.append(self._in_hand)
        self._settle_all(left_over, "unsent", "the gate was closed")
        if held:  # counted as sent, and known better now
            self.counters.sent -= held
            self.counters.unsent += held
            self._emit(
                "not sent", f"{held} {self.unit}: the adapter still held them when it was closed", held
            )
        self._emit_refused()
        self._close(self._bus)
        self._bus = None
        self._unlock()
        self.state = "closed"
        for inbox in self._inboxes:
            inbox.end()
        for listener in self._listeners:
            listener.stop()
        self._emit("closed")

    def __enter__(self) -> Self:
        return self.start() if self.state == "new" else self

    def __exit__(self, *_: object) -> None:
        self.stop()

    # ------------------------------------------------------------------ opening and losing

    def _open_first(self) -> None:
        if self.state != "new":
            raise CallerError(f"{self.name}: this gate was started before; make another")
        if self.lock is not None:
            self.lock.take()
            if self._loop is not None:
                self.lock.listen(self._loop)
        try:
            self._bus = self._opened()
        except BaseException:
            self._unlock()
            raise
        self.state = "open"
        self._emit("opened", self._describe(self._bus))

    def _unlock(self) -> None:
        if self.lock is not None:
            self.lock.release()

    def _thread(self, target: Callable[[], None], what: str) -> threading.Thread:
        thread = threading.Thread(target=target, name=f"{self.name} {what}", daemon=True)
        thread.start()
        self._threads.append(thread)  # `stop` may come meanwhile, and joins those that run
        return thread

    def _close(self, bus: Any) -> None:
        if bus is not None:
            try:
                self._shut(bus)
            except Exception:  # an adapter that is gone may refuse even this
                pass

    def _lose(self, error: BaseException | None) -> bool:
        """Report a lost bus and open it again, on the receive thread; return False when the gate is to end."""
        self._gone(error)
        bus = self._found_again()
        if bus is None:
            return False
        self._back(bus)
        return True

    def _gone(self, error: BaseException | None) -> None:
        """Report a lost bus, and drop the packets that waited for it."""
        self.state = "lost"
        why = "it does not answer any more" if error is None else f"{type(error).__name__}: {error}"
        self._emit("lost", why)
        self._gather()
        with self._guard:
            gone = self._outbox.take(lambda item: not item.urgent)
            self._outgoing.notify_all()
        self._settle_all(gone, "dropped", "the bus is lost")
        self._close(self._bus)

    def _found_again(self) -> Any:
        """Try to open the bus until that succeeds; None when the gate is to end."""
        wait = RETRY_S
        while self.reopen and not self._stopping.wait(wait):
            try:
                return self._opened()
            except Exception:  # still gone
                wait = min(2 * wait, RETRY_MOST_S)
        if not self.reopen:
            for inbox in self._inboxes:
                inbox.end()
        return None

    def _back(self, bus: Any) -> None:
        """Report that the bus is open again."""
        self._bus = bus
        self.state = "open"
        self.counters.reopened += 1
        self._emit("reopened", self._describe(bus))
        self._emit_refused()
        with self._guard:
            self._outgoing.notify_all()

    # ------------------------------------------------------------------ on a loop

    def _attach(self) -> None:
        """Have the loop serve the bus that was opened; threads do what would block."""
        loop, bus = self._loop, self._bus
        assert loop is not None
        number = self._file_of(bus)
        self._file = number if number is not None and loop.can_watch(number) else None
        if self._file is None:
            self._thread(self._receive, "receive")
        else:
            self._watched(bus)
            loop.watch(self._file, self._readable, gathers=self._gathers)
        if self.listen_only:
            return
        self._is_sending_here = self._file is not None and self._can_put_together()
        if self._is_sending_here:
            self._plan_flush()
        elif self._transmitter is None:
            self._transmitter = self._thread(self._transmit, "send")

    def _detach(self) -> None:
        """Stop watching the file in the loop, before its number can belong to another file."""
        if self._file is None or self._loop is None:
            return
        loop, number, self._file = self._loop, self._file, None
        try:
            loop.call(lambda: loop.unwatch(number))
        except CallerError:  # it has ended
            pass

    def _readable(self) -> None:
        """Read its file, on the loop's thread."""
        if self.state != "open" or self._stopping.is_set():
            return
        try:
            found = self._read_now()
        except Exception as error:  # CanError, OSError, and whatever a backend lets through
            self._lose_here(error)
            return
        if not found:
            return
        for inbox in self._inboxes:
            inbox.put(found)
        if self._received is not None:
            self._received(found)

    def _lose_here(self, error: BaseException | None) -> None:
        """Report a lost bus, and open it again on a thread, which may take its time."""
        self._detach()
        self._gone(error)

        def look() -> None:
            bus = self._found_again()
            if bus is not None:
                assert self._loop is not None
                self._loop.call_soon(lambda: self._back_here(bus))

        self._thread(look, "open")

    def _back_here(self, bus: Any) -> None:
        if self._stopping.is_set():
            self._close(bus)
            return
        self._back(bus)
        self._attach()

    def _look_again(self) -> None:
        """Now and then: what the bus says of itself."""
        if self._loop is not None and not self._stopping.is_set():
            self._loop.call_in(round(POLL_S * 1e9), self._look_again)
            if self._file is not None and self.state == "open":
                self._glance()


__all__ = ["POLL_S", "ContentFilter", "Gate", "Received"]
