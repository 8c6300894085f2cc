# Threads are counted, and a client's end is brought about.
# pyright: reportPrivateUsage=false
"""Gates on a robot's loop: no thread where the bus has a file, together what was given together, nothing lost on the way."""

from __future__ import annotations

import os
import socket
import threading
import tty
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus import Frame
from aces_bus.hardware import CanGate, SerialGate
from aces_bus.hardware.backends import SocketcanReader
from aces_bus.hardware.gate import Gate
from aces_bus.hardware.gate_events import BusEvent
from aces_bus.hardware.ports import port_of
from aces_bus.hardware.served import packets
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.remote import ServedBus
from aces_bus.hardware.served.server import BusServer
from aces_bus.runtime.loop import Loop

from .serving import Open, message, received, serve, with_unix_sockets

pytestmark = with_unix_sockets

#: Nothing here takes so long (ns); reached only when something is broken.
PATIENCE_NS = 20_000_000_000
SERVED = {"interface": "aces", "channel": "unix:can0"}


@pytest.fixture
def loop() -> Iterator[Loop]:
    with Loop() as made:
        yield made


class Ported:
    """A gate's port, open, with what it received and what happened to its bus."""

    def __init__(self, gate: Gate[Any, Any, Any], loop: Loop) -> None:
        self.gate, self.loop = gate, loop
        self.received: list[Any] = []
        self.events: list[BusEvent] = []
        gate.on_event(self.events.append)
        self.port: Any = port_of(gate, loop)  # type: ignore[call-overload]
        self.port.open(lambda packet, instant: self.received.append(packet))

    def has(self, count: int) -> bool:
        return self.loop.wait(lambda: len(self.received) >= count, PATIENCE_NS)

    def saw(self, kind: str) -> bool:
        return self.loop.wait(lambda: any(event.kind == kind for event in self.events), PATIENCE_NS)

    def threads(self) -> list[str]:
        return [thread.name for thread in self.gate._threads]

    def __enter__(self) -> Ported:
        return self

    def __exit__(self, *_: object) -> None:
        self.port.close()


def test_a_served_bus_takes_no_thread_and_a_packet_a_turn(
    loop: Loop, opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is given in one turn goes out in one packet, the most urgent first; what comes is read on the loop."""
    offered: list[int] = []
    offer = ServedBus.offer

    def counted(self: ServedBus, frames: Any) -> int:
        offered.append(len(frames))
        return offer(self, frames)

    monkeypatch.setattr(ServedBus, "offer", counted)
    with serve(), Ported(CanGate(SERVED), loop) as ours:
        other = opened()
        fates: list[str] = []

        def give() -> None:
            for number in (3, 1, 2):
                ours.port.send(Frame(number, b"\x05"), report=lambda fate, why: fates.append(fate))

        loop.call(give)
        assert [one.arbitration_id for one in received(other, 3)] == [1, 2, 3]
        assert offered == [3]
        other.send(message(0x55, b"\x07"))
        assert ours.has(1)
        assert (ours.received[0].arbitration_id, ours.received[0].data, ours.received[0].channel) == (
            0x55,
            b"\x07",
            None,
        )
        assert loop.wait(lambda: fates == ["sent"] * 3, PATIENCE_NS)
        assert ours.threads() == []
        assert (ours.gate.counters.sent, ours.gate.counters.received) == (3, 1)


def test_more_than_the_mailboxes_hold_waits_and_leaves(loop: Loop, opened: Open) -> None:
    """The server says how far the bus has come; every frame leaves once, in order, and what waits is never too much."""
    with serve(ServedChannel(bitrate=1_000_000)), Ported(CanGate(SERVED), loop) as ours:
        other = opened()
        numbers = range(1500)  # of 1,024 mailboxes

        def give() -> None:
            for number in numbers:
                assert ours.port.send(Frame(5, number.to_bytes(2, "big")), 60_000_000_000)

        loop.call(give)
        assert [int.from_bytes(one.data, "big") for one in received(other, 1500)] == list(numbers)
        assert ours.gate.counters.sent == 1500


def test_a_server_that_goes_and_comes_back(loop: Loop, opened: Open) -> None:
    """The loss is known at once, the bus is opened again beside the loop, and frames go both ways as before."""
    with serve(), Ported(CanGate(SERVED), loop) as ours:
        bus = ours.gate._bus
        assert isinstance(bus, ServedBus)
        bus._stream.hang_up()
        assert ours.saw("lost")
        assert ours.saw("reopened")
        other = opened()
        assert loop.call(lambda: ours.port.send(Frame(6)))
        assert received(other)[0].arbitration_id == 6
        other.send(message(7))
        assert ours.has(1)


def test_a_stop_waits_for_a_lost_bus(loop: Loop, opened: Open) -> None:
    """While no server is there, frames are refused; the stop is the first to leave when one is."""
    with serve():
        ours = Ported(CanGate(SERVED), loop)
    with ours:
        assert ours.saw("lost")
        assert not loop.call(lambda: ours.port.send(Frame(1)))
        assert loop.call(lambda: ours.port.send(Frame(0x7FF), urgent=True))
        assert not loop.call(lambda: ours.port.send(Frame(2)))
        with BusServer([ServedChannel(bitrate=1_000_000)]):
            assert ours.saw("reopened")
            other = opened()
            loop.call(lambda: ours.port.send(Frame(3)))
            assert received(other)[0].arbitration_id in (
                0x7FF,
                3,
            )  # the stop may have left before `other` came
            assert loop.wait(lambda: ours.gate.counters.sent == 2, PATIENCE_NS)
    counters = ours.gate.counters
    assert (counters.given, counters.send_dropped, counters.pending) == (2, 0, 0)


def test_a_stop_overtakes_what_a_busy_server_has_not_read(loop: Loop, tmp_path: Path) -> None:
    """While a server does not read, frames wait here: the stop is the next to leave, before all those of its device."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "busy"))
    listener.listen()
    served: list[socket.socket] = []

    def welcome() -> None:
        served.append(listener.accept()[0])
        served[0].recv(4096)
        served[0].sendall(packets.value_packet(packets.Welcome("busy", 0, False, 1_000_000, 0)))

    thread = threading.Thread(target=welcome)
    thread.start()
    gate = CanGate({"interface": "aces", "channel": f"unix:{tmp_path / 'busy'}"})
    with listener, Ported(gate, loop) as ours:
        thread.join()

        def tick(number: int) -> None:
            ours.port.send(Frame(5, number.to_bytes(2, "big")), 60_000_000_000, topic="leg")

        for number in range(2000):
            loop.call(partial(tick, number))
        loop.call(lambda: ours.port.send(Frame(0x7FF), urgent=True, topic="leg"))
        found: list[int] = []
        rest = b""
        with served[0]:
            served[0].settimeout(20)
            while 0x7FF not in found:
                some, rest = packets.split_packets(rest + served[0].recv(65_536))
                found += [one[1] for kind, body in some for one in packets.unpack_records(kind, body)]
        assert found.index(0x7FF) == len(found) - 1 < 100  # of two thousand
        assert gate.counters.send_dropped > 1800


def test_a_frame_that_the_bus_refuses_costs_the_others_nothing(loop: Loop, opened: Open) -> None:
    """CAN FD on a classic bus: it fails, by name, and what was given with it leaves."""
    with serve(), Ported(CanGate(SERVED), loop) as ours:
        other = opened()
        fates: dict[int, str] = {}

        def give() -> None:
            for frame in (Frame(1), Frame(2, is_fd=True), Frame(3)):
                ours.port.send(
                    frame, report=lambda fate, why, number=frame.arbitration_id: fates.update({number: fate})
                )

        loop.call(give)
        assert [one.arbitration_id for one in received(other, 2)] == [1, 3]
        assert loop.wait(lambda: len(fates) == 3, PATIENCE_NS)
        assert fates == {1: "sent", 2: "failed", 3: "sent"}
        assert next(e for e in ours.events if e.kind == "send failed").detail.startswith("0x2: ")


def test_a_driver_that_raises_costs_the_frames_behind_nothing(loop: Loop, opened: Open) -> None:
    """Its fault is the loop's to report; every frame is handed over once."""
    seen: list[int] = []

    def faulty(frame: Frame, instant: int) -> None:
        seen.append(frame.arbitration_id)
        if frame.arbitration_id == 2:
            raise RuntimeError("driver")

    with serve():
        port = port_of(CanGate(SERVED), loop)
        port.open(faulty)
        other = opened()
        for number in (1, 2, 3):
            other.send(message(number))
        assert loop.wait(lambda: len(seen) == 3, PATIENCE_NS)
        assert seen == [1, 2, 3]
        assert [str(error) for error in loop.failures] == ["driver"]
        port.close()


def test_a_backend_without_a_file_keeps_its_threads(loop: Loop) -> None:
    """A bus of this process: threads receive and send, and the loop gets what arrives."""
    options: dict[str, Any] = {"interface": "aces", "channel": "no file", "bitrate": 500_000}
    with can.Bus(**options) as other, Ported(CanGate(options, name="kept"), loop) as ours:
        other.send(message(5))
        assert ours.has(1)
        assert loop.call(lambda: ours.port.send(Frame(6)))
        got = other.recv(20)
        assert got is not None
        assert got.arbitration_id == 6
        assert sorted(ours.threads()) == ["kept receive", "kept send"]


def test_what_was_given_leaves_before_a_gate_on_a_loop_closes(loop: Loop, opened: Open) -> None:
    """From another thread, and on the loop's own, where nobody else could send it."""
    with serve():
        other = opened()
        for close_here in (False, True):
            ours = Ported(CanGate(SERVED), loop)

            def give(ours: Ported = ours, close_here: bool = close_here) -> None:
                ours.port.send(Frame(1))
                ours.port.send(Frame(2))
                if close_here:
                    ours.port.close()

            loop.call(give)
            ours.port.close()
            assert [one.arbitration_id for one in received(other, 2)] == [1, 2]
            assert (ours.gate.counters.sent, ours.gate.counters.unsent) == (2, 0)


# ---------------------------------------------------------------------- serial


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    tty.setraw(master)
    yield master, os.ttyname(slave)
    for end in (master, slave):
        try:
            os.close(end)
        except OSError:
            pass


def test_a_serial_line_takes_no_thread(loop: Loop, line: tuple[int, str]) -> None:
    """Bytes go both ways; what does not fit into the port at once follows, whole and in order."""
    master, path = line
    much = bytes(range(256)) * 400  # more than a terminal holds
    with Ported(SerialGate(path), loop) as ours:
        os.write(master, b"abc")
        assert ours.loop.wait(lambda: b"".join(ours.received) == b"abc", PATIENCE_NS)
        loop.call(lambda: [ours.port.send(much), ours.port.send(b"end")])
        got = b""
        while len(got) < len(much) + 3:
            got += os.read(master, 4096)
        assert got == much + b"end"
        assert ours.threads() == []


def test_a_line_that_is_unplugged_and_comes_back(loop: Loop, line: tuple[int, str], tmp_path: Path) -> None:
    """Handlers know, and it is opened again without holding up the loop."""
    master, path = line
    link = tmp_path / "ttyUSB0"
    link.symlink_to(path)
    with Ported(SerialGate(str(link)), loop) as ours:
        link.unlink()
        os.close(master)
        assert ours.saw("lost")
        assert loop.call(threading.get_ident) != threading.get_ident()
        other, slave = os.openpty()
        tty.setraw(slave)
        link.symlink_to(os.ttyname(slave))
        assert ours.saw("reopened")
        os.write(other, b"b")
        assert ours.has(1)
        os.close(other)
        os.close(slave)


def test_an_echo_on_a_loop_is_taken_out(loop: Loop, line: tuple[int, str]) -> None:
    """Of a half-duplex adapter that hears itself, also when the turnaround has to be waited for."""
    master, path = line
    with Ported(SerialGate(path, half_duplex=True, echo=True, turnaround=0.02), loop) as ours:
        os.write(master, b"x")
        assert ours.has(1)
        loop.call(lambda: ours.port.send(b"\x01\x02"))
        assert os.read(master, 2) == b"\x01\x02"
        assert ours.loop.wait(lambda: ours.gate.counters.sent == 2, PATIENCE_NS)
        os.write(master, b"\x01\x02answer")
        assert ours.loop.wait(lambda: b"".join(ours.received) == b"xanswer", PATIENCE_NS)
        assert ours.gate.counters.echoes == 2


# ---------------------------------------------------------------------- SocketCAN


def test_frames_for_the_system_are_what_it_would_give_back() -> None:
    """All kinds of frames, sent and read through the same calls; a full queue takes as many as fit."""

    class Bus:
        channel = "can0"
        _is_filtered = True

    bus: Any = Bus()
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with near, far:
        sender, reader = SocketcanReader(bus, near), SocketcanReader(bus, far)
        frames = [
            Frame(0x123, b"\x01\x02"),
            Frame(0x1ABCDEF0, bytes(8), is_extended_id=True),
            Frame(0x7, is_remote_frame=True, dlc=4),
            Frame(0x8, bytes(12), is_fd=True, bitrate_switch=True),
        ]
        assert sender.offer(frames) == 4
        found = reader.frames(10)
        assert [
            (f.arbitration_id, f.data, f.is_extended_id, f.is_remote_frame, f.is_fd, f.length) for f in found
        ] == [
            (f.arbitration_id, f.data, f.is_extended_id, f.is_remote_frame, f.is_fd, f.length) for f in frames
        ]
        assert found[3].bitrate_switch
        many = [Frame(1)] * 100_000
        taken = sender.offer(many)
        assert 0 < taken < len(many)
        assert sender.offer(many) == 0
        far.close()
        with pytest.raises(OSError, match=r"refused|Broken|not connected"):
            sender.offer(many)
