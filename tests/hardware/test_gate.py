# Failing handlers and adapters are planted in private parts.
# pyright: reportPrivateUsage=false
"""The CAN gatekeeper: readers that fail, adapters that lie, buses that go away and come back."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest

from aces_bus import Frame
from aces_bus.errors import CallerError
from aces_bus.hardware import CanGate
from aces_bus.hardware.gate import Received
from aces_bus.hardware.gate_events import BusEvent
from aces_bus.hardware.simulated.backend import AcesBus
from aces_bus.recordings.filters import parse_filter


class Adapter:
    """A backend under the test's hand: what `recv` gives or raises is put into `incoming`."""

    channel_info = "test adapter"
    state = can.BusState.ACTIVE

    def __init__(self) -> None:
        self.incoming: queue.Queue[Any] = queue.Queue()
        self.sent: queue.Queue[can.Message] = queue.Queue()
        self.is_shut = self.is_hollow = False
        self.send_error: Exception | None = None

    def recv(self, timeout: float | None = None) -> Any:
        if self.is_hollow:
            return None
        try:
            item = self.incoming.get(timeout=timeout) if timeout else self.incoming.get_nowait()
        except queue.Empty:
            return None
        if isinstance(item, BaseException):
            raise item
        return item

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        if self.send_error is not None:
            raise self.send_error
        self.sent.put(message)

    def shutdown(self) -> None:
        self.is_shut = True


class Seen:
    """Events as they come; `wait` gives the first of a kind."""

    def __init__(self) -> None:
        self.events: list[BusEvent] = []
        self._changed = threading.Condition()

    def __call__(self, event: BusEvent) -> None:
        with self._changed:
            self.events.append(event)
            self._changed.notify_all()

    def wait(self, kind: str, count: int = 1) -> BusEvent:
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.of(kind)) >= count, 5), self.events
            return self.of(kind)[count - 1]

    def of(self, kind: str) -> list[BusEvent]:
        return [event for event in self.events if event.kind == kind]


def message(identifier: int, data: bytes = b"", stamp: float = 0.0) -> can.Message:
    return can.Message(stamp, identifier, is_extended_id=False, data=data, channel="can0")


class Bench:
    """A gate on an adapter of the test's; `open` makes the next adapter, or raises."""

    def __init__(self, **more: Any) -> None:
        self.adapters: list[Adapter] = []
        self.refuse: Exception | None = None
        self.seen = Seen()
        self.gate = CanGate(self._open, name="bench", **more)
        self.gate.on_event(self.seen)

    def _open(self) -> Any:
        if self.refuse is not None:
            raise self.refuse
        self.adapters.append(Adapter())
        return self.adapters[-1]

    @property
    def adapter(self) -> Adapter:
        return self.adapters[-1]


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gate that stops waits for its reader, which looks up so often."""
    for module in ("can", "gate"):
        monkeypatch.setattr(f"aces_bus.hardware.{module}.POLL_S", 0.02)


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    with made.gate:
        yield made


def take(inbox: Any, count: int) -> list[Received[Frame]]:
    """So many items, or fewer when they do not come."""
    found: list[Received[Frame]] = []
    while len(found) < count and (more := inbox.get(5.0)):
        found += more
    return found


def test_every_subscriber_gets_every_frame(bench: Bench) -> None:
    """In order, with the adapter's stamp and the host's."""
    one, two = bench.gate.subscribe(), bench.gate.subscribe(filter=parse_filter("101:7FF"))
    for number in range(3):
        bench.adapter.incoming.put(message(0x100 + number, bytes([number]), 5.0 + number))
    got = take(one, 3)
    assert [(item.content.arbitration_id, item.content.timestamp) for item in got] == [
        (256, 5.0),
        (257, 6.0),
        (258, 7.0),
    ]
    assert [item.host_ns for item in got] == sorted(item.host_ns for item in got)
    assert [item.content.arbitration_id for item in take(two, 1)] == [0x101]
    assert bench.gate.counters.received == 3


def test_more_frames_than_a_batch_holds_lose_none() -> None:
    """What waits in the adapter is handed over in batches, and no frame falls between two of them."""
    adapter: Any = Adapter()
    for number in range(1000):
        adapter.incoming.put(message(number))
    gate = CanGate(lambda: adapter, name="full")
    inbox = gate.subscribe()
    with gate:
        got = take(inbox, 1000)
    assert [item.content.arbitration_id for item in got] == list(range(1000))


def test_a_reader_that_raises_costs_nobody_else(bench: Bench) -> None:
    """Its exception is an event, it is called again, and others hear everything."""
    calls: queue.Queue[int] = queue.Queue()

    def faulty(items: list[Received[Frame]]) -> None:
        calls.put(len(items))
        raise RuntimeError("user code")

    listener = bench.gate.listen(faulty)
    other = bench.gate.subscribe()
    bench.adapter.incoming.put(message(1))
    assert calls.get(timeout=5) == 1
    assert "RuntimeError: user code" in bench.seen.wait("listener").detail
    bench.adapter.incoming.put(message(2))
    assert calls.get(timeout=5) == 1
    assert len(take(other, 2)) == 2
    bench.seen.wait("listener", 2)
    assert listener.failures == 2


def test_a_handler_that_raises_stops_nothing(bench: Bench) -> None:
    """Events go to all handlers, whatever one of them does."""

    def faulty(event: BusEvent) -> None:
        raise RuntimeError("handler")

    bench.gate.events._handlers = (faulty, *bench.gate.events._handlers)
    bench.adapter.incoming.put(can.CanOperationError("unplugged"))
    bench.seen.wait("reopened")
    assert bench.gate.events.failures >= 2


def test_a_slow_reader_loses_the_oldest_and_is_told(bench: Bench) -> None:
    """A queue is bounded; what it drops is counted there, in the gate, and said at once."""
    inbox = bench.gate.subscribe(limit=10)
    include_unknown = bench.gate.subscribe()
    for number in range(25):
        bench.adapter.incoming.put(message(number))
    assert len(take(include_unknown, 25)) == 25
    assert [item.content.arbitration_id for item in inbox.get(5)] == list(range(15, 25))
    assert inbox.dropped == bench.gate.counters.dropped == 15
    assert sum(event.count for event in bench.seen.of("dropped")) == 15


@pytest.mark.parametrize(
    "bad",
    [
        UnicodeDecodeError("ascii", b"\xff", 0, 1, "ordinal not in range"),
        ValueError("invalid literal for int() with base 16"),
        IndexError("string index out of range"),
    ],
)
def test_an_adapter_that_says_nonsense(bench: Bench, bad: Exception) -> None:
    """One line that cannot be understood is counted; the frames behind it arrive."""
    inbox = bench.gate.subscribe()
    bench.adapter.incoming.put(bad)
    bench.adapter.incoming.put(message(7))
    assert [item.content.arbitration_id for item in take(inbox, 1)] == [7]
    assert type(bad).__name__ in bench.seen.wait("bad input").detail
    assert len(bench.adapters) == 1


def test_an_adapter_that_says_only_nonsense_is_opened_anew(bench: Bench) -> None:
    """Twenty times in a row, and it is treated as lost."""
    first = bench.adapter
    for _ in range(20):
        first.incoming.put(ValueError("?"))
    bench.seen.wait("reopened")
    assert first.is_shut
    assert len(bench.adapters) == 2


def test_an_impossible_frame_is_counted(bench: Bench) -> None:
    """An adapter's frame that cannot exist is bad input and no frame."""
    bad = message(1)
    bad.arbitration_id = 0x9999
    inbox = bench.gate.subscribe()
    bench.adapter.incoming.put(bad)
    bench.adapter.incoming.put(message(2))
    assert [item.content.arbitration_id for item in take(inbox, 1)] == [2]
    assert bench.gate.counters.bad_input == 1


def test_unplugged_and_back(bench: Bench) -> None:
    """Handlers know at once; the gate tries until the adapter is there again, and readers notice nothing else."""
    inbox = bench.gate.subscribe()
    bench.refuse = can.CanInitializationError("no such device")
    bench.adapter.incoming.put(can.CanOperationError("device removed"))
    assert "device removed" in bench.seen.wait("lost").detail
    assert bench.gate.state == "lost"
    bench.refuse = None
    bench.seen.wait("reopened")
    bench.adapter.incoming.put(message(9))
    assert [item.content.arbitration_id for item in take(inbox, 1)] == [9]
    assert (bench.gate.state, bench.gate.counters.reopened) == ("open", 1)


@pytest.mark.slow
def test_a_server_that_is_gone(bench: Bench) -> None:
    """A backend that returns nothing at once, for ever, instead of waiting, is lost and not polled in a circle."""
    bench.adapter.is_hollow = True
    assert "does not answer" in bench.seen.wait("lost").detail
    bench.seen.wait("reopened")


def test_without_reopening_readers_are_told_the_end() -> None:
    """They get what is queued, then nothing, and do not hang."""
    bench = Bench(reopen=False)
    with bench.gate as gate:
        inbox = gate.subscribe()
        bench.adapter.incoming.put(message(1))
        bench.adapter.incoming.put(can.CanOperationError("gone"))
        assert len(take(inbox, 1)) == 1
        assert inbox.get(5) == []
        assert inbox.is_closed


def test_a_bus_that_cannot_be_opened_is_the_caller_s_to_know() -> None:
    """The first opening raises what the backend raises."""
    bench = Bench()
    bench.refuse = can.CanInitializationError("no such device")
    with pytest.raises(can.CanInitializationError):
        bench.gate.start()


@pytest.mark.parametrize("fails", ["silence", "reader_of"])
def test_a_bus_whose_opening_fails_half_way_is_closed(fails: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The adapter that was opened is shut down again, and the reason is the caller's to know."""

    def refuse(bus: Any) -> None:
        raise can.CanInitializationError("has no such mode")

    monkeypatch.setattr(f"aces_bus.hardware.can.{fails}", refuse)
    bench = Bench(listen_only=True)
    with pytest.raises(can.CanInitializationError, match="no such mode"):
        bench.gate.start()
    assert [adapter.is_shut for adapter in bench.adapters] == [True]


def test_the_most_urgent_frame_goes_first() -> None:
    """By arbitration, or by the priority given; equal ones by age."""
    bench = Bench(send_rate=50)
    with bench.gate as gate:
        gate.send(Frame(0x7FF))
        assert bench.adapter.sent.get(timeout=5).arbitration_id == 0x7FF
        for identifier, priority in ((0x300, None), (0x100, None), (0x200, None), (0x400, -1)):
            gate.send(Frame(identifier), priority=priority)
        got = [bench.adapter.sent.get(timeout=5).arbitration_id for _ in range(4)]
        assert got == [0x400, 0x100, 0x200, 0x300]


def test_a_rate_limit() -> None:
    """Frames leave no quicker than asked for."""
    bench = Bench(send_rate=200)
    with bench.gate as gate:
        began = gate.clock.now()
        for number in range(5):
            gate.send(Frame(number))
        for _ in range(5):
            bench.adapter.sent.get(timeout=5)
        assert gate.clock.now() - began >= 4 * 5_000_000


def test_what_cannot_be_sent_is_told(bench: Bench) -> None:
    """The event names the frame; the next one is tried all the same."""
    bench.adapter.send_error = can.CanOperationError("buffer full")
    bench.gate.send(Frame(0x123))
    assert bench.seen.wait("send failed").detail.startswith("0x123: CanOperationError")
    bench.adapter.send_error = None
    bench.gate.send(message(0x124))
    assert bench.adapter.sent.get(timeout=5).arbitration_id == 0x124


def test_a_gate_that_only_listens_cannot_send() -> None:
    """There is no queue, no thread and no bus that would."""
    bench = Bench(listen_only=True)
    with bench.gate as gate:
        with pytest.raises(CallerError, match="only listens"):
            gate.send(Frame(1))
        assert not any("send" in thread.name for thread in gate._threads)


def test_a_clock_that_goes_back_is_told(bench: Bench) -> None:
    """Both stamps are kept; the adapter's is not believed blindly."""
    for stamp in (10.0, 11.0, 9.5):
        bench.adapter.incoming.put(message(1, stamp=stamp))
    assert "1.500000 s" in bench.seen.wait("clock").detail


def test_bus_off_reaches_handlers(bench: Bench) -> None:
    """The controller's state, when it changes."""
    bench.adapter.state = can.BusState.ERROR
    bench.seen.wait("bus-off")
    bench.adapter.state = can.BusState.ACTIVE
    bench.seen.wait("error-active")


def test_own_frames_that_a_backend_gives_back() -> None:
    """Of a backend that always hears itself, each own frame is taken out once; equal frames of others stay."""
    bench = Bench()
    bench.gate._interface = "udp_multicast"
    with bench.gate as gate:
        inbox = gate.subscribe()
        gate.send(Frame(5, b"\x01"))
        own = bench.adapter.sent.get(timeout=5)
        bench.adapter.incoming.put(own)
        bench.adapter.incoming.put(message(5, b"\x01"))
        assert len(take(inbox, 1)) == 1
        assert gate.counters.echoes == 1


@pytest.mark.parametrize("listen_only", [False, True])
def test_a_backend_by_its_keywords(listen_only: bool) -> None:
    """Listen-only has one name here; the backend is given its own."""
    with AcesBus("gate", fd=False) as other:
        gate = CanGate({"interface": "aces", "channel": "gate"}, listen_only=listen_only)
        with gate, AcesBus("gate") as third:
            inbox = gate.subscribe()
            other.send(message(0x55))
            assert [item.content.arbitration_id for item in take(inbox, 1)] == [0x55]
            if not listen_only:
                gate.send(Frame(0x66))
                got = third.recv(5)
                while got is not None and got.arbitration_id != 0x66:
                    got = third.recv(5)
                assert got is not None
            else:
                opened: Any = gate._bus
                assert opened.node.listen_only


def test_stopping_twice_and_starting_again(bench: Bench) -> None:
    """A gate is used once; stopping it is always safe."""
    call: Callable[[], object] = bench.gate.start
    with pytest.raises(CallerError, match="started before"):
        call()
    bench.gate.stop()
    bench.gate.stop()
    assert bench.adapter.is_shut
    with pytest.raises(CallerError, match="not open"):
        bench.gate.send(Frame(1))
    assert [event.kind for event in bench.seen.events] == ["opened", "closed"]
