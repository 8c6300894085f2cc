"""Gatekeepers of serial lines and datagrams, over pseudo-terminals and loopback."""

from __future__ import annotations

import os
import threading
import tty
from collections.abc import Iterator
from typing import Any

import pytest

from aces_bus.errors import CallerError
from aces_bus.hardware import DatagramGate, SerialGate
from aces_bus.hardware.gate import Received
from aces_bus.hardware.gate_events import BusEvent


class Line:
    """A pseudo-terminal: the test holds one end, the gate opens the other."""

    def __init__(self) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        tty.setraw(self.master)
        self.path = os.ttyname(slave)
        self._slave = slave

    def close(self) -> None:
        for end in (self.master, self._slave):
            try:
                os.close(end)
            except OSError:
                pass


@pytest.fixture
def line() -> Iterator[Line]:
    made = Line()
    yield made
    made.close()


class Seen:
    """Events as they come."""

    def __init__(self) -> None:
        self.events: list[BusEvent] = []
        self._changed = threading.Condition()

    def __call__(self, event: BusEvent) -> None:
        with self._changed:
            self.events.append(event)
            self._changed.notify_all()

    def wait(self, kind: str) -> BusEvent:
        with self._changed:
            assert self._changed.wait_for(lambda: any(e.kind == kind for e in self.events), 5), self.events
            return next(e for e in self.events if e.kind == kind)


def heard(inbox: Any, size: int) -> bytes:
    """So many bytes, or fewer when they do not come."""
    data = b""
    while len(data) < size and (items := inbox.get(5.0)):
        data += b"".join(item.content for item in items)
    return data


@pytest.mark.slow
def test_bytes_go_both_ways(line: Line) -> None:
    """What arrives is handed over with its time; what is sent is sent whole."""
    with SerialGate(line.path, baud=57_600) as gate:
        inbox = gate.subscribe()
        os.write(line.master, b"\xff\xff\x01\x02\x00\xfc")
        assert heard(inbox, 6) == b"\xff\xff\x01\x02\x00\xfc"
        gate.send(b"\x01\x02")
        gate.send(b"\x03")
        assert os.read(line.master, 2) + os.read(line.master, 1) in (b"\x01\x02\x03",)
        assert (gate.counters.received, gate.counters.echoes) == (6, 0)


def test_a_half_duplex_line_hears_itself(line: Line) -> None:
    """Own bytes are taken out, also cut in pieces and with an answer right behind; equal bytes of others stay."""
    with SerialGate(line.path, half_duplex=True) as gate:
        inbox = gate.subscribe()
        gate.send(b"ping")
        assert os.read(line.master, 4) == b"ping"
        os.write(line.master, b"pi")
        os.write(line.master, b"ngpong")
        assert heard(inbox, 4) == b"pong"
        os.write(line.master, b"ping")
        assert heard(inbox, 4) == b"ping"
        assert gate.counters.echoes == 4


def test_an_adapter_without_an_echo_is_found_out(line: Line) -> None:
    """Answers that are not what was sent are heard whole, from the first one on, though they begin like it."""
    with SerialGate(line.path, half_duplex=True) as gate:
        inbox = gate.subscribe()
        for _ in range(3):
            gate.send(b"\xff\xff\x01\x02\x01\xfb")
            assert len(os.read(line.master, 6)) == 6
            os.write(line.master, b"\xff\xff\x01")
            os.write(line.master, b"\x02\x00\xfc")
            assert heard(inbox, 6) == b"\xff\xff\x01\x02\x00\xfc"
        assert (gate.echo, gate.counters.echoes) == (False, 0)


def test_a_collision_is_told(line: Line) -> None:
    """An echo that differs from what was sent is somebody else speaking: its bytes are heard."""
    seen = Seen()
    gate = SerialGate(line.path, half_duplex=True, echo=True)
    gate.on_event(seen)
    with gate:
        inbox = gate.subscribe()
        gate.send(b"\x01\x02\x03")
        assert os.read(line.master, 3) == b"\x01\x02\x03"
        os.write(line.master, b"\x01\x42\x03")
        assert heard(inbox, 2) == b"\x42\x03"
        assert "0x42 was received where 0x2 was sent" in seen.wait("bad input").detail.replace("0x02", "0x2")


def test_turnaround(line: Line) -> None:
    """After others have spoken, nothing is sent for the turnaround time."""
    with SerialGate(line.path, turnaround=0.05) as gate:
        inbox = gate.subscribe()
        os.write(line.master, b"\x01")
        item: Received[bytes] = inbox.get(5)[0]
        gate.send(b"\x02")
        assert os.read(line.master, 1) == b"\x02"
        assert gate.clock.now() - item.host_ns >= 50_000_000


def test_own_bytes_can_be_kept(line: Line) -> None:
    """For a record of both ways."""
    with SerialGate(line.path, keep_own=True) as gate:
        inbox = gate.subscribe()
        gate.send(b"\x02")
        (item,) = inbox.get(5)
        assert (item.content, item.is_own) == (b"\x02", True)


def test_unplugged_and_back(line: Line, tmp_path: Any) -> None:
    """The port goes away and comes back under its name; handlers know, readers go on."""
    link = tmp_path / "ttyUSB0"
    link.symlink_to(line.path)
    seen = Seen()
    gate = SerialGate(str(link))
    gate.on_event(seen)
    with gate:
        inbox = gate.subscribe()
        os.write(line.master, b"a")
        assert heard(inbox, 1) == b"a"
        link.unlink()
        line.close()
        seen.wait("lost")
        other = Line()
        link.symlink_to(other.path)
        seen.wait("reopened")
        os.write(other.master, b"b")
        assert heard(inbox, 1) == b"b"
        other.close()


def test_a_port_that_is_not_there() -> None:
    """The first opening raises what pyserial raises."""
    import serial

    with pytest.raises(serial.SerialException):
        SerialGate("/dev/none-of-that-name").start()


def test_a_line_that_only_listens(line: Line) -> None:
    """It cannot send."""
    with SerialGate(line.path, listen_only=True) as gate, pytest.raises(CallerError, match="only listens"):
        gate.send(b"x")


def test_a_listener_that_raises(line: Line) -> None:
    """Its exception is an event, and the line goes on."""
    seen = Seen()
    gate = SerialGate(line.path)
    gate.on_event(seen)

    def faulty(items: list[Received[bytes]]) -> None:
        raise RuntimeError("user code")

    with gate:
        gate.listen(faulty)
        inbox = gate.subscribe()
        os.write(line.master, b"x")
        assert "user code" in seen.wait("listener").detail
        assert heard(inbox, 1) == b"x"


@pytest.mark.slow
def test_datagrams_go_both_ways() -> None:
    """Whole, with who sent them; to the peer unless another address is named."""
    with DatagramGate() as robot, DatagramGate(peer=robot.address) as host:
        at_robot, at_host = robot.subscribe(), host.subscribe()
        host.send(b"GET")
        (got,) = at_robot.get(5)
        assert (got.content, got.source) == (b"GET", host.address)
        robot.send(b"", got.source)
        (answer,) = at_host.get(5)
        assert answer.content == b""


@pytest.mark.slow
def test_strangers_are_counted() -> None:
    """With `only_peer`, what others send is told and not handed on."""
    seen = Seen()
    with DatagramGate() as peer, DatagramGate() as stranger:
        gate = DatagramGate(peer=peer.address, only_peer=True)
        gate.on_event(seen)
        with gate:
            inbox = gate.subscribe()
            stranger.send(b"x", gate.address)
            assert "who is not the peer" in seen.wait("bad input").detail
            peer.send(b"y", gate.address)
            items: list[Received[bytes]] = inbox.get(5)
            assert [item.content for item in items] == [b"y"]


def test_datagrams_that_cannot_be_sent() -> None:
    """Too long, to nobody, from a gate that is not open."""
    with DatagramGate() as gate:
        with pytest.raises(CallerError, match="to whom"):
            gate.send(b"x")
        with pytest.raises(CallerError, match="at most"):
            gate.send(bytes(70_000), gate.address)
    with pytest.raises(CallerError, match="not open"):
        gate.send(b"x", ("127.0.0.1", 9))


def test_the_default_address_is_loopback() -> None:
    """Nobody on the network is listened to unless asked for."""
    with DatagramGate() as gate:
        assert gate.address[0] == "127.0.0.1"
