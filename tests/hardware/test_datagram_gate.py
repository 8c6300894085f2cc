# What a gate opens is replaced by a socket of the test's.
# pyright: reportPrivateUsage=false
"""The UDP gatekeeper's receive thread: a port that is silent, that is lost, that is closed."""

from __future__ import annotations

import queue
import threading
from typing import Any

import pytest

from aces_bus.hardware import DatagramGate

from .test_gate import Seen

PEER = ("127.0.0.1", 9)


class Port:
    """A socket under the test's hand: what `recvfrom` gives or raises is put into `incoming`; without, its time is up."""

    def __init__(self) -> None:
        self.incoming: queue.Queue[Any] = queue.Queue()
        self.timeouts = 0
        self.is_closed = threading.Event()

    def recvfrom(self, size: int) -> Any:
        try:
            found = self.incoming.get(timeout=0.01)
        except queue.Empty:
            if self.is_closed.is_set():
                raise OSError(9, "Bad file descriptor") from None
            self.timeouts += 1
            raise TimeoutError("timed out") from None
        if isinstance(found, Exception):
            raise found
        return found, PEER

    def getsockname(self) -> tuple[str, int]:
        return PEER

    def close(self) -> None:
        self.is_closed.set()


class Ports(DatagramGate):
    """A gate whose sockets are `Port`s."""

    def __init__(self, **more: Any) -> None:
        super().__init__(listen_only=True, **more)
        self.ports: list[Port] = []

    def _opened(self) -> Any:
        self.ports.append(Port())
        return self.ports[-1]


def test_a_port_that_was_silent_for_a_while_still_receives() -> None:
    """Neither a time-out nor the news that a datagram reached no socket ends the receive thread, or loses the port."""
    with Ports() as gate:
        inbox = gate.subscribe()
        (port,) = gate.ports
        while not port.timeouts:
            threading.Event().wait(0.001)
        port.incoming.put(ConnectionRefusedError(111, "Connection refused"))
        port.incoming.put(b"one")
        (item,) = inbox.get(10)
        assert (item.content, item.source) == (b"one", PEER)
        assert (gate.state, len(gate.ports), gate.counters.received) == ("open", 1, 1)


def test_a_port_that_is_lost_is_opened_again() -> None:
    """An error of the socket is the event "lost"; what comes to the next one is received."""
    seen = Seen()
    gate = Ports()
    gate.on_event(seen)
    with gate:
        inbox = gate.subscribe()
        gate.ports[0].incoming.put(OSError(19, "No such device"))
        seen.wait("reopened")
        gate.ports[1].incoming.put(b"two")
        (item,) = inbox.get(10)
        assert item.content == b"two"
        assert gate.ports[0].is_closed.is_set()
    assert len(seen.of("lost")) == 1


@pytest.mark.parametrize("reopen", [True, False])
def test_closing_a_port_ends_its_thread_and_is_no_loss(reopen: bool) -> None:
    """`stop` ends the receive thread and readers; the socket's error on the way is not an event."""
    seen = Seen()
    gate = Ports(reopen=reopen)
    gate.on_event(seen)
    gate.start()
    inbox = gate.subscribe()
    threads = list(gate._threads)
    gate.stop()
    for thread in threads:
        thread.join(10)
    assert threads
    assert not any(thread.is_alive() for thread in threads)
    assert seen.of("lost") == []
    assert inbox.get(10) == []
    assert gate.ports[0].is_closed.is_set()
    assert len(gate.ports) == 1
