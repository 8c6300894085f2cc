"""What python-can's backends, readers and writers are known to do wrong, each as a case that our side stands.

1. The backends are python-can's own, on a pseudo-terminal or on this machine's loopback; the faults are real.
2. Nothing sleeps: what is waited for is an event, a frame or a counter.

Elsewhere: SocketCAN's small receive buffer and silent drops, `tests/socketcan`; packets lost behind a false header or
because of the size of the pieces, `tests/specs/test_streams.py` and the laws; a recording that is killed,
`tests/tools/test_sniff_recording.py`.
"""

from __future__ import annotations

import errno
import io
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.hardware import CanGate
from aces_bus.hardware.gate import Received
from aces_bus.hardware.gate_events import BusEvent
from aces_bus.recordings.base import CanRecording
from aces_bus.recordings.filters import parse_filter
from aces_bus.recordings.write import open_writer

pty = pytest.importorskip("pty", reason="pseudo-terminals")

PATIENCE_S = 10.0


class Seen:
    """The events of a gate; `wait` gives one of a kind when it is there."""

    def __init__(self, gate: CanGate) -> None:
        self.events: list[BusEvent] = []
        self._changed = threading.Condition()
        gate.on_event(self)

    def __call__(self, event: BusEvent) -> None:
        with self._changed:
            self.events.append(event)
            self._changed.notify_all()

    def wait(self, kind: str, count: int = 1) -> BusEvent:
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.of(kind)) >= count, PATIENCE_S), self.events
            return self.of(kind)[count - 1]

    def of(self, kind: str) -> list[BusEvent]:
        return [event for event in self.events if event.kind == kind]


def take(inbox: Any, count: int) -> list[Received[Frame]]:
    """So many frames, or fewer when they do not come."""
    found: list[Received[Frame]] = []
    while len(found) < count and (more := inbox.get(PATIENCE_S)):
        found += more
    return found


def numbers(items: list[Received[Frame]]) -> list[int]:
    return [item.content.arbitration_id for item in items]


# ---------------------------------------------------------------------- slcan, on a pseudo-terminal


class Adapter:
    """An slcan adapter: what it says is written by the test, at a path that stays the same."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "ttyACM0"
        self._ends: tuple[int, ...] = ()
        self.plug()

    def plug(self) -> None:
        import tty

        self._ends = os.openpty()
        tty.setraw(self._ends[1])
        self.path.symlink_to(os.ttyname(self._ends[1]))

    def unplug(self) -> None:
        self.path.unlink(missing_ok=True)
        for end in self._ends:
            os.close(end)
        self._ends = ()

    def say(self, data: bytes) -> None:
        os.write(self._ends[0], data)

    def received(self, ending: bytes) -> bytes:
        """What the host has written, up to these bytes."""
        found = b""
        while not found.endswith(ending):
            found += os.read(self._ends[0], 256)
        return found

    @property
    def options(self) -> dict[str, Any]:
        return {"interface": "slcan", "channel": str(self.path), "sleep_after_open": 0}


@pytest.fixture
def adapter(tmp_path: Path) -> Iterator[Adapter]:
    made = Adapter(tmp_path)
    yield made
    made.unplug()


def test_slcan_one_byte_that_is_no_text(adapter: Adapter) -> None:
    """It costs its own line and nothing behind it, and is counted; python-can alone would read nothing more."""
    with CanGate(adapter.options) as gate:
        seen, inbox = Seen(gate), gate.subscribe()
        adapter.say(b"t1001AA\rt1\xff01BB\r" + b"".join(b"t2%02X1CC\r" % n for n in range(50)))
        assert numbers(take(inbox, 51)) == [0x100, *range(0x200, 0x232)]
        assert "UnicodeDecodeError" in seen.wait("bad input").detail
        assert (gate.counters.bad_input, gate.counters.received, gate.state) == (1, 51, "open")


BAD_LINES = [
    b"t12G0",  # no hexadecimal identifier: ValueError
    b"t12",  # too short: IndexError
    b"T1234567",
    b"tFFF0",  # no such identifier
    b"t1232AA",  # cut short: python-can gives a frame of one byte that says it has two
    b"t1231A",  # half a byte
    b"t1239" + b"00" * 9,  # nine bytes
    b"d1239" + b"00" * 11,  # CAN FD, cut short
    b"r12",
]


def test_slcan_lines_that_cannot_be(adapter: Adapter) -> None:
    """Each is counted and gives no frame; the good line behind each arrives, and what is not a frame is not a fault."""
    with CanGate(adapter.options) as gate:
        inbox = gate.subscribe()
        for number, line in enumerate(BAD_LINES):
            adapter.say(line + b"\r" + b"t3%02X0\rz\r\a" % number)
        assert numbers(take(inbox, len(BAD_LINES))) == [0x300 + n for n in range(len(BAD_LINES))]
        assert (gate.counters.bad_input, gate.counters.reopened) == (len(BAD_LINES), 0)


def test_slcan_unplugged_and_back(adapter: Adapter) -> None:
    """Told at once; the gate opens the port again when it is there, in the same mode, and goes on."""
    with CanGate(adapter.options, listen_only=True) as gate:
        seen, inbox = Seen(gate), gate.subscribe()
        assert adapter.received(b"L\r") == b"L\r"
        adapter.say(b"t1000\r")
        assert numbers(take(inbox, 1)) == [0x100]
        adapter.unplug()
        seen.wait("lost")
        adapter.plug()
        seen.wait("reopened")
        assert adapter.received(b"L\r") == b"L\r"
        adapter.say(b"t1010\r")
        assert numbers(take(inbox, 1)) == [0x101]
        assert [event.kind for event in seen.events] == ["lost", "reopened"]


# ---------------------------------------------------------------------- socketcand, on the loopback


class Server:
    """A socketcand server under the test's hand, on a port that stays the same."""

    def __init__(self) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listening.getsockname()[1]
        self.clients: list[socket.socket] = []
        #: Clients that will be hung up on without a greeting.
        self.refuses = 0
        self.is_closed = False
        self.is_ready = threading.Semaphore(0)
        self.has_refused = threading.Semaphore(0)
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            if self.refuses:
                self.refuses -= 1
                client.close()
                self.has_refused.release()
                continue
            client.sendall(b"< hi >")
            for _ in ("open", "rawmode"):
                if not client.recv(256):
                    client.close()  # it only looked whether we are there
                    break
                client.sendall(b"< ok >")
            else:
                self.clients.append(client)
                self.is_ready.release()

    def say(self, text: bytes) -> None:
        self.clients[-1].sendall(text)

    def close(self) -> None:
        self.is_closed = True
        self._listening.shutdown(socket.SHUT_RDWR)  # wakes whoever waits in `accept`
        self._listening.close()
        for client in self.clients:
            client.close()

    @property
    def options(self) -> dict[str, Any]:
        return {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1", "port": self.port}


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    yield made
    if not made.is_closed:
        made.close()


def count_calls(owner: Any, name: str, patch: pytest.MonkeyPatch | None = None) -> list[tuple[Any, ...]]:
    """The calls of a method or function from now on: their arguments."""
    calls: list[tuple[Any, ...]] = []
    original = getattr(owner, name)

    def counted(*arguments: Any, **more: Any) -> Any:
        calls.append(arguments)
        return original(*arguments, **more)

    if patch is not None:
        patch.setattr(owner, name, counted)
    else:
        setattr(owner, name, counted)
    return calls


@pytest.mark.slow
def test_socketcand_server_that_hangs_up_and_comes_back(server: Server) -> None:
    """Lost at once and not polled in a circle; found again when it serves again. python-can alone would spin for ever."""
    with CanGate(server.options) as gate:
        seen, inbox = Seen(gate), gate.subscribe()
        assert server.is_ready.acquire(timeout=PATIENCE_S)
        server.say(b"< frame 123 1.5 0A0B >")
        (item,) = take(inbox, 1)
        assert (item.content.arbitration_id, item.content.data, item.content.timestamp) == (
            0x123,
            b"\x0a\x0b",
            1.5,
        )
        server.refuses = 3
        reads, openings = count_calls(gate, "_read"), count_calls(gate, "_opened")
        server.clients[-1].close()
        assert "has closed the connection" in seen.wait("lost").detail
        assert len(reads) <= 2  # the end of the stream is believed the first time
        for _ in range(3):
            assert server.has_refused.acquire(timeout=PATIENCE_S)
        assert gate.state == "lost"
        seen.wait("reopened")
        assert len(openings) == 4
        assert server.is_ready.acquire(timeout=PATIENCE_S)
        server.say(b"< frame 124 2.5  >< frame 12345678 2.75 00 >")
        assert numbers(take(inbox, 2)) == [0x124, 0x1234_5678]
        assert [event.kind for event in seen.events] == ["lost", "reopened"]


# ---------------------------------------------------------------------- UDP multicast, on this machine


GROUP = "239.74.163.2"


@pytest.fixture
def multicast() -> dict[str, Any]:
    """The options of a multicast bus of this machine alone; skips where there is no multicast."""
    pytest.importorskip("msgpack")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = free.getsockname()[1]
    options: dict[str, Any] = {"interface": "udp_multicast", "channel": GROUP, "port": port, "hop_limit": 0}
    try:
        with can.Bus(**options) as one, can.Bus(**options) as two:
            one.send(can.Message(arbitration_id=1), timeout=1)
            if two.recv(1) is None:
                pytest.skip("multicast is not heard on this machine")
    except (can.CanError, OSError) as error:
        pytest.skip(f"no multicast on this machine: {error}")
    return options


def test_udp_multicast_gives_back_what_was_sent(multicast: dict[str, Any]) -> None:
    """A gate does not hear itself, and hears another's equal frame; what is not a frame costs nothing but itself."""
    with CanGate(multicast) as gate, CanGate(multicast) as other:
        seen, inbox, there = Seen(gate), gate.subscribe(), other.subscribe()
        gate.send(Frame(0x10, b"\x01"))
        assert numbers(take(there, 1)) == [0x10]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            stranger.sendto(b"\xc1 no frame", (GROUP, multicast["port"]))
        other.send(Frame(0x10, b"\x01"))
        other.send(Frame(0x11))
        assert numbers(take(inbox, 2)) == [0x10, 0x11]
        seen.wait("bad input")
        assert (gate.counters.echoes, gate.counters.bad_input, gate.counters.reopened) == (1, 1, 0)


# ---------------------------------------------------------------------- Notifier and virtual


class Ending(BaseException):
    """No `Exception`, as `SystemExit`."""


@pytest.mark.parametrize("kind", [RuntimeError, SystemExit, Ending])
def test_a_listener_that_raises_ends_nothing(kind: type[BaseException]) -> None:
    """Neither others nor itself, whatever it raises; python-can's Notifier ends for all."""
    calls: list[int] = []

    def faulty(items: list[Received[Frame]]) -> None:
        calls.extend(numbers(items))
        raise kind("listener")

    with (
        can.Bus(interface="virtual", channel="listener") as far,
        CanGate({"interface": "virtual", "channel": "listener"}) as gate,
    ):
        seen, inbox = Seen(gate), gate.subscribe()
        listener = gate.listen(faulty)
        for number in (1, 2, 3):
            far.send(can.Message(arbitration_id=number, is_extended_id=False))
            assert numbers(take(inbox, 1)) == [number]
            assert kind.__name__ in seen.wait("listener", number).detail
        assert (calls, listener.failures) == ([1, 2, 3], 3)


def test_a_handler_that_ends_programs_ends_nothing(adapter: Adapter) -> None:
    """A handler of events runs on the gate's own thread; not even `sys.exit` in it stops the gate."""

    def faulty(event: BusEvent) -> None:
        raise SystemExit

    with CanGate(adapter.options) as gate:
        inbox = gate.subscribe()
        gate.on_event(faulty)
        adapter.say(b"t12G0\rt1000\r")
        assert numbers(take(inbox, 1)) == [0x100]
        assert gate.events.failures == 1


def test_a_backend_that_uses_one_message_for_all() -> None:
    """A frame is a value, whatever becomes of its message: `virtual` copies deeply, others need not. Bursts are whole."""
    told, most = threading.Event(), 2000

    class OneMessage:
        channel_info, state = "one message for all", can.BusState.ACTIVE

        def __init__(self) -> None:
            self.message = can.Message(arbitration_id=0, is_extended_id=False, data=bytes(1))
            self.count = 0

        def recv(self, timeout: float | None = None) -> can.Message | None:
            if not told.is_set() or self.count == most:
                told.wait(timeout)
                return None
            self.count += 1
            self.message.arbitration_id = self.count
            self.message.data[0] = self.count % 256
            return self.message

        def shutdown(self) -> None: ...

    def open_one() -> Any:
        return OneMessage()

    with CanGate(open_one) as gate:
        inbox = gate.subscribe()
        told.set()
        got = take(inbox, most)
    assert [(item.content.arbitration_id, item.content.data[0]) for item in got] == [
        (number, number % 256) for number in range(1, most + 1)
    ]


class FullQueue:
    """SocketCAN with a queue of ten frames: while it is full, sending fails at once."""

    channel_info, state = "full queue", can.BusState.ACTIVE

    def __init__(self) -> None:
        self.sent: list[int] = []
        self.failures = 3
        self.all_sent = threading.Event()

    def recv(self, timeout: float | None = None) -> None:
        self.all_sent.wait(timeout)

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        if self.failures:
            self.failures -= 1
            raise can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)
        self.sent.append(message.arbitration_id)
        self.failures = 3
        if len(self.sent) == 5:
            self.all_sent.set()

    def shutdown(self) -> None: ...


def test_socketcan_transmit_queue_that_is_full() -> None:
    """It is waited for; python-can alone raises for every frame behind the tenth."""
    bus: Any = FullQueue()
    with CanGate(lambda: bus) as gate:
        for number in range(5):
            gate.send(Frame(number))
        assert bus.all_sent.wait(PATIENCE_S)
    assert bus.sent == list(range(5))
    assert (gate.counters.sent, gate.counters.send_failed) == (5, 0)


def test_a_filter_that_excludes() -> None:
    """ID~MASK lets everything else pass; in python-can's programs it does nothing."""
    kept = [Frame(n) for n in (0x122, 0x123, 0x124) if parse_filter("123~7FF").matches(Frame(n))]
    assert [frame.arbitration_id for frame in kept] == [0x122, 0x124]


@pytest.mark.slow
def test_python_can_starts_without_asammdf() -> None:
    """Where asammdf is installed, python-can imports it at its start, for a second; our commands keep it out."""
    code = """
import sys
from aces_tools.main import main
sys.argv = ["aces", "sniff", "--help"]
assert main() == 0
assert "can" in sys.modules and not sys.modules.get("asammdf")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


# ---------------------------------------------------------------------- recordings


def read(content: bytes, name: str) -> tuple[list[Frame], CanRecording]:
    with open_recording(io.BytesIO(content), link="can", name=name) as capture:
        return list(capture), capture


ASC = b"""date Sat Sep 30 15:06:13.191 2017
base hex  timestamps absolute
internal events logged
Begin Triggerblock Sat Sep 30 15:06:13.191 2017
   0.000000 Start of measurement
   0.500000 1  123             Rx   d 2 01 02
   0.750000 1  ErrorFrame
   1.000000 1  456             Rx   d 1 03
End TriggerBlock
"""


def test_asc_error_frames_and_absolute_times() -> None:
    """An error frame is a frame, and times are from 1970 where the file has a date."""
    frames, _ = read(ASC, "x.asc")
    assert [frame.is_error_frame for frame in frames] == [False, True, False]
    began = time.mktime((2017, 9, 30, 15, 6, 13, 0, 0, -1)) + 0.191
    assert [round((frame.timestamp or 0) - began, 6) for frame in frames] == [0.5, 0.75, 1.0]


def test_asc_lines_that_cannot_be_read_are_counted() -> None:
    """None is dropped in silence."""
    frames, capture = read(ASC.replace(b"d 1 03", b"d 4 03"), "x.asc")
    assert (len(frames), capture.lines_unreadable) == (2, 1)
    assert capture.problems[0].line == 8


def test_blf_error_frames(tmp_path: Path) -> None:
    """What python-can's own writer wrote and its reader leaves out."""
    path = tmp_path / "x.blf"
    with can.BLFWriter(path) as writer:
        writer(can.Message(10.0, 0x123, is_extended_id=False, data=b"\x01", channel=0))
        writer(can.Message(11.0, 0, is_error_frame=True, channel=0))
        writer(can.Message(12.0, 0x124, is_extended_id=False, channel=0))
    with open_recording(path, link="can") as capture:
        assert [frame.is_error_frame for frame in capture] == [False, True, False]
        assert capture.lines == capture.frames == 3


def test_candump_half_bytes_and_error_frames() -> None:
    """Half a byte is not data, and an error frame is not data frame."""
    log = b"(1.0) can0 123#ABC\n(2.0) can0 20000004#0004000000000000\n(3.0) can0 123#AB\n"
    frames, capture = read(log, "x.log")
    assert [(frame.is_error_frame, frame.arbitration_id) for frame in frames] == [(True, 4), (False, 0x123)]
    assert [problem.reason for problem in capture.problems] == ["odd number of hexadecimal digits"]


@pytest.mark.parametrize("suffix", ["log", "asc", "blf", "trc", "pcapng"])
def test_everything_that_was_written_is_there(tmp_path: Path, suffix: str) -> None:
    """Whoever closes a recording finds all frames in it, however many were written last."""
    path = tmp_path / f"x.{suffix}"
    frames = [Frame(n % 0x800, n.to_bytes(4, "big"), 1_700_000_000 + n / 1000, "0") for n in range(5000)]
    with open_writer(path) as writer:
        for start in range(0, 5000, 333):
            writer.write(FrameTable.from_frames(frames[start : start + 333]))
    with open_recording(path, link="can") as capture:
        assert [frame.data for frame in capture] == [frame.data for frame in frames]
