# The kernel's buffer is made small.
# pyright: reportPrivateUsage=false
"""SocketCAN with a real kernel: our gatekeeper and our commands beside `candump` and `cangen`.

1. It runs where ACES_SOCKETCAN names two virtual CAN interfaces that it may take down, as in the guest of `run.py`
   (`make test-socketcan`); elsewhere it is skipped.
2. Nothing is waited for by time: who listens is read in /proc/net/can.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import can
import msgspec
import pytest

from aces_bus import Frame, open_recording
from aces_bus.errors import CallerError
from aces_bus.hardware import CanGate
from aces_bus.hardware.backends import SocketcanReader
from aces_bus.hardware.gate import Received
from aces_bus.hardware.gate_events import BusEvent
from aces_bus.recordings.filters import parse_filter

NAMED = os.environ.get("ACES_SOCKETCAN", "")
pytestmark = pytest.mark.skipif(not NAMED, reason="real SocketCAN: run `make test-socketcan`")
BUS, OTHER = (NAMED or "vcan0,vcan1").split(",")
#: The guest is an emulated machine beside others.
PATIENCE_S = 60.0
SIOCGIFFLAGS, SIOCSIFFLAGS, IFF_UP = 0x8913, 0x8914, 1
OPTIONS = {"interface": "socketcan", "channel": BUS, "fd": True}


# ---------------------------------------------------------------------- helpers


def until(condition: Callable[[], object], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, f"it did not come about: {what}"
        time.sleep(0.01)


def listeners(name: str = BUS) -> int:
    """How many sockets hear everything on an interface."""
    text = Path("/proc/net/can/rcvlist_all").read_text()
    return len(re.findall(rf"^ +{name} ", text, re.MULTILINE))


@contextmanager
def heard_by(command: Sequence[str], name: str = BUS) -> Generator[subprocess.Popen[str], None, None]:
    """A program that listens to an interface, from when it does so."""
    before = listeners(name)
    program = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        until(lambda: listeners(name) > before, f"{command} listens")
        yield program
    finally:
        program.kill()
        program.wait()


@contextmanager
def aces(*words: str, listens: bool = False) -> Generator[Any, None, None]:
    """Our command in a process of its own; a fork, as importing takes long in here."""
    from aces_tools.main import main

    before = listeners()
    process = multiprocessing.get_context("fork").Process(target=lambda: os._exit(main(list(words))))
    process.start()
    try:
        if listens:
            until(lambda: listeners() > before or not process.is_alive(), f"aces {words} listens")
        yield process
        process.join(PATIENCE_S)
        assert process.exitcode == 0, (words, process.exitcode)
    finally:
        process.kill()
        process.join()


def opened() -> Any:
    """python-can's bus, a context manager."""
    return can.Bus(interface="socketcan", channel=BUS, fd=True)


def put_up(is_up: bool, name: str = BUS) -> None:
    """`ip link set NAME up|down`."""
    import fcntl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        request = struct.pack("16sh14x", name.encode(), 0)
        (flags,) = struct.unpack_from("h", fcntl.ioctl(control, SIOCGIFFLAGS, request), 16)
        flags = flags | IFF_UP if is_up else flags & ~IFF_UP
        fcntl.ioctl(control, SIOCSIFFLAGS, struct.pack("16sh14x", name.encode(), flags))


@pytest.fixture
def wire() -> Iterator[socket.socket]:
    """A raw socket of a stranger on the bus."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as made:
        made.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        made.bind((BUS,))
        yield made


def classic(identifier: int, data: bytes = b"", length: int | None = None) -> bytes:
    return struct.pack("=IB3x8s", identifier, len(data) if length is None else length, data)


def flexible(identifier: int, data: bytes, flags: int = 0) -> bytes:
    return struct.pack("=IBB2x64s", identifier, len(data), flags, data)


def take(inbox: Any, count: int) -> list[Received[Frame]]:
    found: list[Received[Frame]] = []
    while len(found) < count and (more := inbox.get(PATIENCE_S)):
        found += more
    return found


class Seen:
    """The events of a gate."""

    def __init__(self, gate: CanGate) -> None:
        self.events: list[BusEvent] = []
        self._changed = threading.Condition()
        gate.on_event(self)

    def __call__(self, event: BusEvent) -> None:
        with self._changed:
            self.events.append(event)
            self._changed.notify_all()

    def wait(self, kind: str, count: int = 1) -> BusEvent:
        def found() -> list[BusEvent]:
            return [event for event in self.events if event.kind == kind]

        with self._changed:
            assert self._changed.wait_for(lambda: len(found()) >= count, PATIENCE_S), self.events
            return found()[count - 1]


# ---------------------------------------------------------------------- the gatekeeper


def test_every_kind_of_frame_is_received(wire: socket.socket) -> None:
    """Identifier, length, flags and data as they were sent; the kernel's time, and the interface's name."""
    sent = {
        classic(0x123, b"\x01\x02"): Frame(0x123, b"\x01\x02"),
        classic(0x9234_5678, bytes(8)): Frame(0x1234_5678, bytes(8), is_extended_id=True),
        classic(0x4000_0055, length=4): Frame(0x55, is_remote_frame=True, dlc=4),
        flexible(0x7FF, bytes(range(64)), 1): Frame(0x7FF, bytes(range(64)), is_fd=True, bitrate_switch=True),
        flexible(0x8000_0001, b"", 2): Frame(1, is_extended_id=True, is_fd=True, error_state_indicator=True),
    }
    with CanGate(OPTIONS) as gate:
        inbox = gate.subscribe()
        began = time.time()
        for raw in sent:
            wire.send(raw)
        got = take(inbox, len(sent))
    plain = [msgspec.structs.replace(item.content, timestamp=None, channel=None, is_rx=None) for item in got]
    assert plain == list(sent.values())
    assert {item.content.channel for item in got} == {BUS}
    assert {item.content.is_rx for item in got} == {False}  # sent on this machine
    stamps = [item.content.timestamp or 0.0 for item in got]
    assert stamps == sorted(stamps)
    assert abs(stamps[0] - began) < PATIENCE_S
    assert gate.counters.received == len(sent)


def test_filters_of_the_kernel_and_ours(wire: socket.socket) -> None:
    """python-can's filters are the kernel's; a subscriber's are its own."""
    filters = [{"can_id": 0x100, "can_mask": 0x700, "extended": False}]
    with CanGate({**OPTIONS, "can_filters": filters}) as gate:
        inbox, narrow = gate.subscribe(), gate.subscribe(filter=parse_filter("102:7FF"))
        for identifier in (0x101, 0x201, 0x8000_0102, 0x102):
            wire.send(classic(identifier))
        assert [item.content.arbitration_id for item in take(inbox, 2)] == [0x101, 0x102]
        assert [item.content.arbitration_id for item in take(narrow, 1)] == [0x102]
        assert gate.counters.received == 2


def test_frames_of_all_interfaces(wire: socket.socket) -> None:
    """Without a channel the gate hears every interface, and the frames say which."""
    with (
        CanGate({**OPTIONS, "channel": ""}, name="all") as gate,
        CanGate({**OPTIONS, "channel": OTHER}) as more,
    ):
        inbox = gate.subscribe()
        wire.send(classic(1))
        more.send(Frame(2))
        got = {(item.content.channel, item.content.arbitration_id) for item in take(inbox, 2)}
    assert got == {(BUS, 1), (OTHER, 2)}


def test_error_frames_tell_the_controllers_state(wire: socket.socket) -> None:
    """They are frames like others, and the state in them is an event at once; a full adapter is told as well."""
    with CanGate(OPTIONS) as gate:
        seen, inbox = Seen(gate), gate.subscribe()
        wire.send(classic(0x2000_0004, b"\0\x20" + bytes(6)))
        seen.wait("error-passive")
        wire.send(classic(0x2000_0040, bytes(8)))
        seen.wait("bus-off")
        wire.send(classic(0x2000_0100, bytes(8)))
        seen.wait("error-active")
        wire.send(classic(0x2000_0004, b"\0\x01" + bytes(6)))
        assert "adapter's buffer" in seen.wait("dropped").detail
        got = take(inbox, 4)
    assert [item.content.arbitration_id for item in got] == [0x04, 0x40, 0x100, 0x04]
    assert all(item.content.is_error_frame for item in got)


def test_what_the_gate_sends_is_on_the_bus() -> None:
    """`candump` sees every kind of frame; the gate does not hear itself."""
    with heard_by(["candump", "-L", "-n", "4", BUS]) as candump, CanGate(OPTIONS) as gate:
        inbox = gate.subscribe()
        for frame in (
            Frame(0x123, b"\xde\xad"),
            Frame(0x1ABB_CCDD, bytes(8), is_extended_id=True),
            Frame(0x321, is_remote_frame=True, dlc=3),
            Frame(0x5A1, bytes(12), is_fd=True, bitrate_switch=True),
        ):
            gate.send(frame)
            until(lambda: not gate.waiting, "the frame left")  # else the most urgent goes first
        lines = [line.split()[2] for line in candump.communicate(timeout=PATIENCE_S)[0].splitlines()]
        assert lines[:3] == ["123#DEAD", "1ABBCCDD#0000000000000000", "321#R3"]
        assert re.fullmatch("5A1##[15]" + 12 * "00", lines[3])  # newer kernels set the FD flag too
        assert (gate.counters.sent, gate.counters.send_failed, len(inbox)) == (4, 0, 0)


def test_a_gate_that_only_listens() -> None:
    """There is no way to send through it, and nothing leaves it."""
    with CanGate(OPTIONS, listen_only=True) as gate:
        with pytest.raises(CallerError, match="only listens"):
            gate.send(Frame(1))
        assert gate.state == "open"


def test_a_large_receive_buffer(wire: socket.socket) -> None:
    """What nobody reads for a while is kept: ten times what the usual buffer holds, and nothing is lost."""
    with opened() as bus:
        reader = SocketcanReader(bus, bus.socket)
        assert reader.buffer >= 8 << 20
        for number in range(3000):
            wire.send(classic(0x100, number.to_bytes(4, "big")))
        got = [frame for _ in range(3000) if (frame := reader(PATIENCE_S)) is not None]
        assert [int.from_bytes(frame.data, "big") for frame in got] == list(range(3000))
        assert (reader(0), reader.take_dropped()) == (None, 0)


def test_what_the_kernel_drops_is_counted(wire: socket.socket) -> None:
    """To the frame, and once: what was sent is what was read and what was dropped."""
    with opened() as bus:
        reader = SocketcanReader(bus, bus.socket)
        bus.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 32_768)
        number = 0
        for burst in (500, 300):
            read: list[int] = []
            first = number
            for _ in range(burst):
                wire.send(classic(0x100, number.to_bytes(4, "big")))
                number += 1
            while (frame := reader(0)) is not None:
                read.append(int.from_bytes(frame.data, "big"))
            assert read == list(range(first, first + len(read)))  # the kernel drops the newest
            assert 0 < len(read) < burst
            assert reader.take_dropped() == 0  # nobody knows yet
            wire.send(classic(0x101))
            frame = reader(PATIENCE_S)
            assert frame is not None
            assert frame.arbitration_id == 0x101
            assert reader.take_dropped() == burst - len(read)
            assert reader.take_dropped() == 0


def test_the_gate_tells_what_the_kernel_dropped(wire: socket.socket) -> None:
    """As an event, and in its counters."""
    with CanGate(OPTIONS) as gate:
        seen, inbox = Seen(gate), gate.subscribe()
        cast(Any, gate._bus).socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        held, go_on = threading.Event(), threading.Event()

        def hold(frame: Frame) -> bool:  # the receive thread, in the middle of its work
            held.set()
            go_on.wait(PATIENCE_S)
            return True

        gate._read._wanted = hold  # type: ignore[attr-defined]
        wire.send(classic(1))
        assert held.wait(PATIENCE_S)
        for _ in range(200):
            wire.send(classic(2))
        go_on.set()
        sent = 201

        def is_told() -> bool:
            nonlocal sent
            sent += wire.send(classic(3)) == 16
            return gate.counters.kernel_dropped > 0

        until(is_told, "a later frame tells of the loss")
        until(
            lambda: gate.counters.received + gate.counters.kernel_dropped == sent,
            "every frame is accounted for",
        )
        assert seen.wait("dropped").count == gate.counters.kernel_dropped
        assert len(take(inbox, gate.counters.received)) == gate.counters.received


def test_an_interface_that_goes_down_and_comes_back(wire: socket.socket) -> None:
    """Lost at once, not taken for open while it is down, and open again when it is up."""
    with CanGate(OPTIONS) as gate:
        seen, inbox = Seen(gate), gate.subscribe()
        wire.send(classic(1))
        assert len(take(inbox, 1)) == 1
        try:
            put_up(False)
            assert "Network is down" in seen.wait("lost").detail
            with pytest.raises(OSError, match="ip link set vcan0 up"):
                CanGate(OPTIONS).start()
        finally:
            put_up(True)
        seen.wait("reopened")
        wire.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)  # the stranger's socket was told, too
        wire.send(classic(2))
        assert take(inbox, 1)[0].content.arbitration_id == 2
    assert [event.kind for event in seen.events] == ["lost", "reopened", "closed"]


def ip(*words: str) -> None:
    subprocess.run(["ip", "link", *words], check=True, timeout=PATIENCE_S)


def test_an_adapter_that_is_unplugged_and_plugged_in_again() -> None:
    """The interface is gone, comes back under its name, and is not open before it is up."""
    with CanGate({**OPTIONS, "channel": OTHER}) as gate:
        seen, inbox = Seen(gate), gate.subscribe()
        ip("del", "dev", OTHER)
        seen.wait("lost")
        ip("add", "dev", OTHER, "type", "vcan")
        ip("set", OTHER, "up")
        seen.wait("reopened")
        with CanGate({"interface": "socketcan", "channel": OTHER}) as stranger:
            stranger.send(Frame(5))
            assert take(inbox, 1)[0].content.arbitration_id == 5
    kinds = [event.kind for event in seen.events]
    assert kinds == ["lost", "reopened", "closed"]


# ---------------------------------------------------------------------- our commands beside can-utils


def generate(*words: str) -> None:
    """`cangen`: random frames, the same for everybody who listens."""
    subprocess.run(["cangen", BUS, *words], check=True, timeout=PATIENCE_S)


def test_sniff_records_what_candump_logs(tmp_path: Path) -> None:
    """The same frames of the same traffic with the kernel's times, and no loss."""
    log, record = tmp_path / "candump.log", tmp_path / "sniff.log"
    count = 400
    with log.open("w") as file:
        sniff = ["sniff", "-i", "socketcan", "-c", BUS, "--fd", "--record", str(record), "-n", str(count)]
        with aces(*sniff, "-o", str(tmp_path / "lines.txt"), listens=True):
            before = listeners()
            candump = subprocess.Popen(["candump", "-L", "-n", str(count), BUS], stdout=file)
            until(lambda: listeners() > before, "candump listens")
            generate("-g", "1", "-n", "200", "-m")
            generate("-g", "1", "-n", "100", "-e")
            generate("-g", "1", "-n", "50", "-R")
            generate("-g", "1", "-n", "50", "-f")
            assert candump.wait(PATIENCE_S) == 0
    theirs, ours = list(open_recording(log, link="can")), list(open_recording(record, link="can"))
    assert len(theirs) == count

    def bare(frame: Frame) -> Frame:
        return msgspec.structs.replace(frame, timestamp=None, is_rx=None)

    assert [bare(frame) for frame in ours] == [bare(frame) for frame in theirs]
    apart = [
        abs((mine.timestamp or 0) - (other.timestamp or 0)) for mine, other in zip(ours, theirs, strict=True)
    ]
    assert max(apart) < 2e-6
    assert len((tmp_path / "lines.txt").read_text().splitlines()) == count


def test_send_is_seen_by_candump() -> None:
    """Raw frames and a message of a protocol; without --tx nothing leaves."""
    with heard_by(["candump", "-L", "-n", "3", BUS]) as candump:
        with aces("send", "7FF#FF", "-i", "socketcan", "-c", BUS):
            pass
        with aces("send", "123#DEADBEEF", "18FEF100#R8", "-i", "socketcan", "-c", BUS, "--tx"):
            pass
        with aces("send", "ControlOn", "board=3", "-p", "hubo", "-i", "socketcan", "-c", BUS, "--tx"):
            pass
        lines = [line.split()[2] for line in candump.communicate(timeout=PATIENCE_S)[0].splitlines()]
    assert lines[:2] == ["123#DEADBEEF", "18FEF100#R8"]
    assert lines[2].startswith("001#03")


def test_play_puts_a_capture_on_the_bus(tmp_path: Path) -> None:
    """`candump` hears the frames of the capture, in its order."""
    capture = tmp_path / "walk.log"
    frames = [f"{number:03X}#{number:04X}" for number in range(0x100, 0x132)]
    capture.write_text("".join(f"(1700000000.{i:06d}) can7 {frame}\n" for i, frame in enumerate(frames)))
    with heard_by(["candump", "-L", "-n", str(len(frames)), BUS]) as candump:
        with aces("play", str(capture), "-i", "socketcan", "-c", BUS, "--tx"):
            pass
        lines = [line.split()[2] for line in candump.communicate(timeout=PATIENCE_S)[0].splitlines()]
    assert lines == frames
