# pyright: reportPrivateUsage=false
"""Ports, queues, backends and replay: the parts of a gatekeeper."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_bus.errors import CallerError
from aces_bus.frames import FD_LENGTHS
from aces_bus.hardware import CanGate, ListeningNode, SimulatedBus
from aces_bus.hardware.backends import SocketcanReader, check_server
from aces_bus.hardware.ports import _sender
from aces_bus.hardware.queues import Inbox
from aces_bus.hardware.replay import ReplayBus, paced, replay_into
from aces_bus.runtime import VirtualClock
from tests.hardware.test_faults_of_backends import Server as Server
from tests.hardware.test_faults_of_backends import count_calls as count_calls
from tests.hardware.test_faults_of_backends import server as server
from tests.hardware.test_replay import log as log


class Gate:
    """A gate that can be lost, or full."""

    state = "open"
    is_full = False

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def send(self, packet: Any, *, report: Any, **how: Any) -> bool:
        if self.is_full:
            raise CallerError("4096 frames wait to be sent")
        self.sent.append(packet)
        if report is not None:
            report("sent", "")
        return True


def test_packets_do_not_wait_for_a_lost_bus() -> None:
    """While a bus is lost, or too much waits, a packet is refused: sent later, it would move a robot. Stops wait."""
    gate: Any = Gate()
    clock: Any = VirtualClock()
    give = _sender(gate, clock)
    fates: list[str] = []

    def send(packet: str, *, urgent: bool = False) -> bool:
        return give(packet, urgent=urgent, report=lambda fate, why: fates.append(fate))

    assert send("a")
    gate.state = "lost"
    assert not send("b")
    assert send("stop", urgent=True)
    gate.state = "open"
    gate.is_full = True
    assert not send("c")
    gate.is_full = False
    assert send("d")
    assert gate.sent == ["a", "stop", "d"]
    assert fates == []  # what became of them is told on the clock's thread
    clock.advance(1)
    assert fates == ["sent"] * 3


def test_a_closed_queue_takes_nothing_more_and_tells_its_owner() -> None:
    """`close` ends the queue and leaves: its owner is told which, readers get what is left, and nothing more goes in."""
    left: list[Inbox[int]] = []
    inbox = Inbox[int](leave=left.append)
    inbox.put([1, 2])
    inbox.close()
    assert left == [inbox]
    inbox.put([3])
    assert inbox.is_closed
    assert inbox.get() == [1, 2]
    assert inbox.get() == []


def test_closing_wakes_who_waits() -> None:
    """A reader that waits without a time limit gets an empty list when another thread closes the queue."""
    inbox = Inbox[int]()
    found: list[list[int]] = []
    reader = threading.Thread(target=lambda: found.append(inbox.get()), daemon=True)
    reader.start()
    inbox.close()
    reader.join(10)
    assert found == [[]]


def test_a_full_queue_keeps_the_newest_and_counts_the_others() -> None:
    """What does not fit is dropped from the old end, counted, and said once for each time."""
    said: list[int] = []
    inbox = Inbox[int](3, wanted=lambda item: item != 0, overflowed=said.append)
    inbox.put([0, 1, 2, 3])
    assert (len(inbox), inbox.dropped, said) == (3, 0, [])
    inbox.put([4, 0, 5])
    assert (inbox.dropped, said) == (2, [2])
    assert inbox.get() == [3, 4, 5]


def test_socketcand_server_that_is_not_there(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    """Said at once; python-can alone knocks for ten seconds without a pause."""
    server.refuses = 1
    with pytest.raises(OSError, match="no socketcand server answers"):
        CanGate(server.options).start()
    server.close()
    made = count_calls(socket, "create_connection", monkeypatch)
    with pytest.raises(ConnectionRefusedError):
        CanGate(server.options).start()
    assert len(made) == 1
    check_server({"interface": "virtual"})


FRAMES = [
    Frame(1, timestamp=100.0),
    Frame(2, timestamp=100.25),
    Frame(3),  # no time: at once
    Frame(4, timestamp=100.2),  # the clock went back: at once
    Frame(5, timestamp=160.2),
]


@pytest.mark.parametrize(
    ("speed", "longest", "due"),
    [
        (1.0, None, [0, 0.25, 0.25, 0.25, 60.25]),
        (2.0, None, [0, 0.125, 0.125, 0.125, 30.125]),
        (1.0, 1.0, [0, 0.25, 0.25, 0.25, 1.25]),
        (None, None, [0, 0, 0, 0, 0]),
    ],
)
def test_frames_come_when_they_are_due(speed: float | None, longest: float | None, due: list[float]) -> None:
    """At the capture's pace or another; long silences can be cut short."""
    clock = VirtualClock()
    came = [
        (frame.arbitration_id, clock.now() / 1e9)
        for frame in paced(FRAMES, clock=clock, speed=speed, longest_gap=longest)
    ]
    assert came == list(zip(range(1, 6), due, strict=True))


def test_a_capture_is_sent_on_a_virtual_bus() -> None:
    """Planned as events: other nodes live beside it."""
    clock = VirtualClock()
    wire = SimulatedBus(clock)
    recorder = ListeningNode(wire)
    wire.attach()
    node = wire.attach()
    replay_into(clock, FRAMES, node.send, speed=10)
    clock.advance(10**10)
    assert [frame.arbitration_id for frame in recorder.frames()] == [1, 2, 3, 4, 5]
    assert recorder.received[-1][0] > 6_000_000_000


def test_impossible_paces() -> None:
    """Backwards, standing still, or no pace where one is needed."""
    for speed in (0.0, -1.0, float("nan")):
        with pytest.raises(CallerError, match="is not a pace"):
            next(paced(FRAMES, speed=speed))
    with pytest.raises(CallerError, match="virtual time"):
        replay_into(VirtualClock(), FRAMES, print, speed=None)


def test_a_gate_on_a_replay(log: Path) -> None:
    """The end of a capture is a lost bus to a gate that does not reopen: readers are told."""
    gate = CanGate(lambda: ReplayBus(log, speed=None, end="raise"), reopen=False)
    inbox = gate.subscribe()
    with gate:
        found = []
        while items := inbox.get(5):
            found += [item.content.arbitration_id for item in items]
        assert found == [1, 2, 3]
        assert inbox.is_closed


SO_TIMESTAMPNS, SO_RXQ_OVFL = 35, 40


class Scripted(socket.socket):
    """A socket that says, beside each datagram, what the test tells it to."""

    beside: list[Any]

    def recvmsg(self, *arguments: Any) -> Any:
        data, _, flags, address = super().recvmsg(*arguments)
        return data, self.beside.pop(0) if self.beside else [], flags, address


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, Scripted]]:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    made = Scripted(socket.AF_UNIX, socket.SOCK_DGRAM, 0, far.detach())
    made.beside = []
    with near, made:
        yield near, made


def bus(wanted: Any = None) -> Any:
    return SimpleNamespace(channel="can0", _is_filtered=wanted is None, _matches_filters=wanted)


def kernel_bytes(frame: Frame) -> bytes:
    """The frame as the kernel hands it over (linux/can.h)."""
    word = (
        frame.arbitration_id
        | frame.is_extended_id << 31
        | frame.is_remote_frame << 30
        | frame.is_error_frame << 29
    )
    size = 64 if frame.is_fd else 8
    flags = frame.bitrate_switch | frame.error_state_indicator << 1
    return struct.pack("=IBBxx", word, frame.length, flags) + frame.data.ljust(size, b"\0")


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    kind = draw(st.sampled_from(["data", "remote", "error", "fd"]))
    is_extended = kind != "error" and draw(st.booleans())
    identifier = draw(st.integers(0, 0x1FFF_FFFF if is_extended or kind == "error" else 0x7FF))
    size = draw(st.sampled_from(FD_LENGTHS if kind == "fd" else FD_LENGTHS[:9]))
    return Frame(
        identifier,
        b"" if kind == "remote" else draw(st.binary(min_size=size, max_size=size)),
        None,
        "can0",
        is_extended,
        kind == "remote",
        kind == "error",
        kind == "fd",
        kind == "fd" and draw(st.booleans()),
        kind == "fd" and draw(st.booleans()),
        True,
        size if kind == "remote" else None,
    )


@given(st.lists(frames(), max_size=8))
def test_every_frame_is_what_the_kernel_said(sent: list[Frame]) -> None:
    """Of all kinds, in order; then nothing."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with near, far:
        reader = SocketcanReader(bus(), far)
        for frame in sent:
            near.send(kernel_bytes(frame))
        assert [reader(0) for _ in sent] == sent
        assert reader(0) is None


def test_times_and_drops_beside_the_frames(pair: tuple[socket.socket, Scripted]) -> None:
    """The count is the kernel's of all time, of 32 bits: it may begin anew."""
    near, far = pair
    reader = SocketcanReader(bus(), far)
    counts = [0xFFFF_FFF0, 0xFFFF_FFF0, 4]
    far.beside = [
        [
            (socket.SOL_SOCKET, SO_TIMESTAMPNS, struct.pack("@ll", 5 + n, 250_000_000)),
            (socket.SOL_SOCKET, SO_RXQ_OVFL, struct.pack("=I", count)),
        ]
        for n, count in enumerate(counts)
    ]
    found = []
    for _ in counts:
        near.send(kernel_bytes(Frame(1)))
        frame = reader(0)
        assert frame is not None
        found.append((frame.timestamp, reader.take_dropped()))
    assert found == [(5.25, 0xFFFF_FFF0), (6.25, 0), (7.25, 20)]


def test_waiting_and_what_wakes(pair: tuple[socket.socket, Scripted]) -> None:
    """It waits as long as told, and a frame ends that; a filter that the kernel has not is applied here."""
    near, far = pair
    reader = SocketcanReader(bus(lambda frame: frame.arbitration_id > 1), far)
    assert reader(0.001) is None
    near.send(kernel_bytes(Frame(1)))
    near.send(kernel_bytes(Frame(2)))
    frame = reader(5)
    assert frame is not None
    assert frame.arbitration_id == 2


@pytest.mark.parametrize("size", [0, 15, 40, 71])
def test_what_is_no_frame(pair: tuple[socket.socket, Scripted], size: int) -> None:
    """CAN XL, or something else: not understood, and not taken for a frame."""
    near, far = pair
    reader = SocketcanReader(bus(), far)
    near.send(bytes(size))
    with pytest.raises(ValueError, match="neither classic CAN nor CAN FD"):
        reader(0)


@pytest.mark.parametrize(
    ("said", "state"),
    [
        ([(0x04, b"\0\x30")], "error-passive"),
        ([(0x04, b"\0\x10"), (0x04, b"\0\x08")], "error-active"),
        ([(0x40, b""), (0x02, bytes(8))], "bus-off"),
        ([(0x40, b""), (0x100, b"")], "error-active"),
        ([(0x04, b"\0\x20"), (0x04, b"\0\x40")], "error-active"),
        ([(0x04, b"")], "error-active"),
    ],
)
def test_the_controllers_state(
    pair: tuple[socket.socket, Scripted], said: list[tuple[int, bytes]], state: str
) -> None:
    """As error frames tell it (linux/can/error.h); others change nothing."""
    near, far = pair
    reader = SocketcanReader(bus(), far)
    for kinds, data in said:
        near.send(kernel_bytes(msgspec.structs.replace(Frame(kinds, data), is_error_frame=True)))
        reader(0)
    assert (reader.state, reader.overflows) == (state, 0)
