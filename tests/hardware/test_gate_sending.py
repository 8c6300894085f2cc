# Threads are waited for, and a client's end is brought about.
# pyright: reportPrivateUsage=false
"""What is given to a gate is sent, or it is said why not: at the end, after an outage, when it is too old."""

from __future__ import annotations

import socket
import threading
from typing import Any

import can
import pytest

from aces_bus import Frame
from aces_bus.errors import CallerError
from aces_bus.hardware import DatagramGate, SerialGate
from aces_bus.hardware import can as can_module
from aces_bus.hardware import datagram as datagram_module
from aces_bus.hardware import gate as gate_module
from aces_bus.hardware.gate_events import GateCounters
from aces_bus.hardware.served import packets
from aces_bus.hardware.served.channel import PacketLink, ServedChannel
from aces_bus.hardware.served.server import BusServer

from .test_gate import Adapter, Bench

WAIT_S = 10.0


@pytest.fixture(autouse=True)
def short_polls(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gate's end waits for its receive thread, which looks up so often."""
    for module in (can_module, datagram_module):
        monkeypatch.setattr(module, "POLL_S", 0.005)


class Hand:
    """A clock that the test sets."""

    name = "hand"

    def __init__(self) -> None:
        self.instant = 0

    def now(self) -> int:
        return self.instant


class Held(Adapter):
    """An adapter that takes a frame when the test lets it: `goes`; `has` says that it has one in hand."""

    def __init__(self) -> None:
        super().__init__()
        self.goes, self.has = threading.Semaphore(0), threading.Semaphore(0)

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        self.has.release()
        assert self.goes.acquire(timeout=WAIT_S)
        super().send(message, timeout)

    def let(self, count: int = 1) -> None:
        for _ in range(count):
            self.goes.release()


class HeldBench(Bench):
    """A gate on such an adapter."""

    def _open(self) -> Adapter:
        if self.refuse is not None:
            raise self.refuse
        self.adapters.append(Held())
        return self.adapters[-1]

    @property
    def held(self) -> Held:
        found = self.adapter
        assert isinstance(found, Held)
        return found

    def sent(self) -> list[int]:
        return [
            self.adapter.sent.get(timeout=WAIT_S).arbitration_id for _ in range(self.adapter.sent.qsize())
        ]


def balanced(counters: GateCounters) -> bool:
    """Whether what was given is in exactly one bin, with nothing left over."""
    bins = (
        counters.sent,
        counters.send_failed,
        counters.send_expired,
        counters.send_dropped,
        counters.unsent,
    )
    return counters.given == sum(bins)


@pytest.mark.slow
def test_what_was_given_leaves_before_the_gate_closes() -> None:
    """`send` and then `stop`: every frame is on the bus, each time."""
    for number in range(50):
        bench = Bench()
        with bench.gate as gate:
            gate.linger_ns = 0
            gate.send(Frame(number))
            gate.send(Frame(0x100 + number))
        assert [bench.adapter.sent.get_nowait().arbitration_id for _ in range(2)] == [number, 0x100 + number]
        assert (gate.counters.sent, gate.counters.unsent) == (2, 0)


def test_bytes_leave_before_a_line_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also what a port still has in its own buffer is waited for; what it keeps is counted and said."""

    class Port:
        name, baudrate, in_waiting = "port", 9600, 0

        def __init__(self) -> None:
            self.written, self.holds = bytearray(), [3, 2, 1, 0]
            self.is_closed = threading.Event()

        @property
        def out_waiting(self) -> int:
            return self.holds.pop(0) if len(self.holds) > 1 else self.holds[0]

        def read(self, count: int) -> bytes:
            self.is_closed.wait(0.01)
            return b""

        def write(self, data: bytes) -> None:
            self.written += data

        def close(self) -> None:
            self.is_closed.set()

    for holds, left, wait_s in (([3, 2, 1, 0], 0, 5.0), ([3], 3, 0.05)):
        port, events = Port(), list[Any]()
        port.holds = holds
        monkeypatch.setattr(SerialGate, "_opened", lambda self, port=port: port)
        gate = SerialGate("port")
        gate.on_event(events.append)
        with gate:
            gate.send(b"12345")
            gate.send(b"678")
            assert gate.stop(wait_s) == left
        assert bytes(port.written) == b"12345678"
        assert (gate.counters.sent, gate.counters.unsent) == (8 - left, left)
        assert [e.count for e in events if e.kind == "not sent"] == ([3] if left else [])
        assert balanced(gate.counters)


def test_datagrams_leave_before_the_socket_closes() -> None:
    """Each of them."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(WAIT_S)
        for number in range(20):
            with DatagramGate(peer=peer.getsockname()) as gate:
                gate.send(bytes([number]))
            assert peer.recv(16) == bytes([number])
            assert balanced(gate.counters)


def test_a_bus_that_takes_nothing_is_closed_within_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """What could not be sent is the answer of `stop`, an event, and counted: each frame once, also the one in hand."""
    monkeypatch.setattr(gate_module, "JOIN_S", 0.05)
    bench = HeldBench()
    fates: list[str] = []
    gate = bench.gate.start()
    for number in range(5):
        gate.send(Frame(number), report=lambda fate, why: fates.append(fate))
    assert bench.held.has.acquire(timeout=WAIT_S)
    assert gate.stop(drain_s=0.02) == 5
    with pytest.raises(CallerError, match="not open"):
        gate.send(Frame(9))
    assert fates == ["unsent"] * 5
    assert [event.count for event in bench.seen.of("not sent")] == [5]
    bench.held.let()  # the adapter comes back: the frame was counted
    gate._threads[-1].join(WAIT_S)
    assert fates == ["unsent"] * 5
    assert (gate.counters.given, gate.counters.unsent) == (5, 5)
    assert gate.stop() == 5


def test_nothing_stale_leaves_after_an_outage() -> None:
    """What waits when a bus is lost is dropped, what is given meanwhile too, each said once; what is new leaves."""
    bench = HeldBench()
    fates: list[tuple[int, str, str]] = []
    with bench.gate as gate:
        gate.linger_ns = 0

        def give(number: int, **more: Any) -> bool:
            return gate.send(
                Frame(number), report=lambda fate, why: fates.append((number, fate, why)), **more
            )

        first = bench.held
        assert give(1)
        assert first.has.acquire(timeout=WAIT_S)
        assert all(give(number) for number in (2, 3))
        bench.refuse = can.CanInitializationError("no such device")
        first.incoming.put(can.CanOperationError("device removed"))
        assert bench.seen.wait("not sent").detail == "2 frames: the bus is lost"
        assert [give(number) for number in (4, 5)] == [False, False]
        first.send_error = can.CanOperationError("gone")
        first.let()
        assert bench.seen.wait("send failed").detail.startswith("0x1")
        bench.refuse = None
        bench.seen.wait("reopened")
        bench.seen.wait("not sent", 2)
        bench.held.let()
        assert give(6)
        assert bench.held.has.acquire(timeout=WAIT_S)
    assert bench.sent() == [6]
    assert [event.count for event in bench.seen.of("not sent")] == [2, 2]
    assert [(number, fate) for number, fate, _ in sorted(fates)] == [
        (1, "failed"), (2, "dropped"), (3, "dropped"), (4, "dropped"), (5, "dropped"), (6, "sent"),
    ]  # fmt: skip
    assert balanced(gate.counters)


def test_a_stop_waits_for_a_lost_bus_and_leaves_first() -> None:
    """Of all that was given before and during an outage, only what is urgent leaves when the bus is back."""
    bench = Bench()
    with bench.gate as gate:
        gate.linger_ns = 0
        bench.refuse = can.CanInitializationError("no such device")
        bench.adapter.incoming.put(can.CanOperationError("device removed"))
        bench.seen.wait("lost")
        assert not gate.send(Frame(1))
        assert gate.send(Frame(0x7FF), urgent=True)
        assert not gate.send(Frame(2))
        assert gate.waiting == 1
        bench.refuse = None
        bench.seen.wait("reopened")
        assert bench.adapter.sent.get(timeout=WAIT_S).arbitration_id == 0x7FF
    assert bench.adapter.sent.empty()
    assert balanced(gate.counters)


def test_what_is_too_old_does_not_leave() -> None:
    """A frame that waited beyond its age limit is counted and said, as of a stalled adapter where the sender said the limit.

    A stop has no age.
    """
    bench = HeldBench()
    clock = Hand()
    gate = bench.gate
    gate.clock = clock  # type: ignore[assignment]
    fates: dict[int, str] = {}
    with gate:
        gate.linger_ns = 0

        def give(number: int, **more: Any) -> None:
            gate.send(Frame(number), report=lambda fate, why: fates.update({number: fate}), **more)

        give(1)
        assert bench.held.has.acquire(timeout=WAIT_S)
        give(2)
        give(3, age_s=60.0)
        give(4, age_s=0.01)
        give(0x7FF, urgent=True)
        clock.instant = 2_000_000_000
        give(5)
        bench.held.let(4)
    assert bench.sent() == [1, 0x7FF, 3, 5]
    assert fates == {1: "sent", 2: "expired", 3: "sent", 4: "expired", 5: "sent", 0x7FF: "sent"}
    (event,) = bench.seen.of("not sent")
    assert (event.count, event.detail) == (1, "1 frames: too old, they do not leave late")
    (event,) = bench.seen.of("stalled")
    assert (event.count, event.detail[:26]) == (1, "1 frames: the adapter does")
    assert balanced(gate.counters)


def test_a_stop_goes_instead_of_what_waits_for_its_device() -> None:
    """It overtakes all, and what waited with the same topic is dropped: a set-point behind a stop would undo it."""
    bench = HeldBench()
    with bench.gate as gate:
        gate.linger_ns = 0
        gate.send(Frame(1))
        assert bench.held.has.acquire(timeout=WAIT_S)
        left, right = object(), object()
        gate.send(Frame(2), topic=left)
        gate.send(Frame(3), topic=right)
        gate.send(Frame(4))
        gate.send(Frame(0x7FF), topic=left, urgent=True)
        bench.held.let(5)
    assert bench.sent() == [1, 0x7FF, 3, 4]
    assert (gate.counters.sent, gate.counters.send_dropped) == (4, 1)
    assert balanced(gate.counters)


def test_a_full_outbox_still_takes_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Others are refused, and are not counted as given."""
    bench = HeldBench()
    monkeypatch.setattr(type(bench.gate), "most", 2)
    with bench.gate as gate:
        gate.linger_ns = 0
        gate.send(Frame(1))
        assert bench.held.has.acquire(timeout=WAIT_S)
        gate.send(Frame(2))
        gate.send(Frame(3))
        with pytest.raises(CallerError, match="2 frames wait to be sent"):
            gate.send(Frame(4))
        assert gate.send(Frame(5), urgent=True)
        bench.held.let(4)
    assert bench.sent() == [1, 5, 2, 3]
    assert gate.counters.given == gate.counters.sent == 4


def test_a_server_hears_out_who_has_gone() -> None:
    """A served bus finds a client gone when it writes: what the client sent before it left is still put on the bus."""
    server = BusServer([channel := ServedChannel("can0")], unix=None, tcp=("127.0.0.1", 0))
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        ours.setblocking(False)
        link = PacketLink(server, ours, "test", "unix", "can0")
        link.take(packets.value_packet(packets.Hello("can0")))
        node = channel.wire.nodes[0]
        message = can.Message(arbitration_id=5, is_extended_id=False, data=b"\x0e")
        theirs.send(packets.message_packet(message, 0))
        theirs.close()
        server._guarded(link, link.flush)
        assert link.is_closed
        assert node.pending == 1
    finally:
        ours.close()
        server.close()
