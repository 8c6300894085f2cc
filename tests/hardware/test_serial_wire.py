"""The simulated serial line: timing, noise, collisions; and a port that foreign programs open."""

from __future__ import annotations

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.errors import CallerError
from aces_bus.hardware import Noise
from aces_bus.hardware.simulated.serial_line import PtyPort, SerialNode, SimulatedSerialLine
from aces_bus.runtime import VirtualClock

Bytes = list[tuple[bytes, int]]


def ear(wire: SimulatedSerialLine, name: str = "", *, echo: bool | None = None) -> tuple[SerialNode, Bytes]:
    """A node, and what it hears with the instant of each byte."""
    heard: Bytes = []
    node = wire.attach(name, lambda data, now: heard.append((data, now)), echo=echo)
    return node, heard


def joined(heard: Bytes) -> bytes:
    return b"".join(data for data, _ in heard)


def test_a_byte_takes_ten_bits() -> None:
    """At 57,600 baud 173.6 µs; bytes follow each other without a gap."""
    clock = VirtualClock()
    wire = SimulatedSerialLine(clock, baud=57_600)
    left, _ = ear(wire)
    _, heard = ear(wire)
    done = left.send(b"\x01\x02\x03")
    assert left.pending == 3
    clock.advance_to(done)
    assert heard == [(bytes([n]), n * wire.byte_ns) for n in (1, 2, 3)]
    assert wire.byte_ns == 173_611
    assert left.pending == 0


def test_a_full_duplex_line_has_two_ways() -> None:
    """Both may speak at once, and neither hears itself."""
    clock = VirtualClock()
    wire = SimulatedSerialLine(clock, baud=1_000_000)
    (left, at_left), (right, at_right) = ear(wire), ear(wire)
    left.send(b"abc")
    right.send(b"xyz")
    clock.advance(1_000_000)
    assert (joined(at_left), joined(at_right), wire.garbled) == (b"xyz", b"abc", 0)


def test_a_half_duplex_line_echoes_and_garbles() -> None:
    """Who speaks hears itself; who speaks at the same time as another is not understood."""
    clock = VirtualClock()
    wire = SimulatedSerialLine(clock, baud=1_000_000, half_duplex=True)
    (left, at_left), (right, at_right) = ear(wire), ear(wire)
    left.send(b"\xaa\x55")
    clock.advance(1_000_000)
    assert joined(at_left) == joined(at_right) == b"\xaa\x55"
    left.send(b"\xf0\xff")
    right.send(b"\x0f")
    clock.advance(1_000_000)
    assert joined(at_left)[2:] == joined(at_right)[2:] == b"\x00\x00\xff"
    assert (left.collisions, right.collisions, wire.garbled) == (1, 1, 2)


def test_a_break_is_longer_than_a_byte() -> None:
    """It is read as a zero, late."""
    clock = VirtualClock()
    wire = SimulatedSerialLine(clock, baud=1_000_000)
    left, _ = ear(wire)
    _, heard = ear(wire)
    left.send_break()
    clock.advance(1_000_000)
    assert heard == [(b"\x00", 20_000)]


@given(st.binary(max_size=200), st.integers(0, 100))
def test_noise_is_counted_and_repeats(data: bytes, seed: int) -> None:
    """What arrives is what was sent, less what was dropped, more what was inserted; a seed is a line."""

    def run() -> tuple[Bytes, int, int, int]:
        clock = VirtualClock()
        wire = SimulatedSerialLine(clock, baud=115_200, noise=Noise(seed, flip=0.1, drop=0.1, insert=0.1))
        left, _ = ear(wire)
        _, heard = ear(wire)
        left.send(data)
        clock.advance(10**9)
        assert len(heard) == len(data) - wire.dropped + wire.inserted
        return heard, wire.dropped, wire.inserted, wire.flipped

    first = run()
    assert run() == first
    if not any(first[1:]):
        assert joined(first[0]) == data


@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.integers(0, 400_000), st.binary(min_size=1, max_size=9)), max_size=8
    ),
    st.booleans(),
    st.none() | st.tuples(st.integers(0, 2), st.integers(0, 400_000), st.booleans()),
)
def test_whole_chunks_are_the_same_bytes(
    sends: list[tuple[int, int, bytes]], half: bool, plug: tuple[int, int, bool] | None
) -> None:
    """Nodes that take chunks hear what others hear one by one, in that order, each piece at its last byte's end."""

    def run(whole: bool) -> tuple[list[Bytes], tuple[int, ...]]:
        clock = VirtualClock()
        wire = SimulatedSerialLine(clock, baud=1_000_000, half_duplex=half)
        heard: list[Bytes] = [[], [], []]
        nodes = [
            wire.attach(received=lambda data, now, place=place: place.append((data, now)), whole=whole)  # type: ignore[misc]
            for place in heard
        ]
        for number, instant, data in sends:
            clock.call_at(instant, lambda number=number, data=data: nodes[number].send(data))  # type: ignore[misc]
        if plug is not None:
            number, instant, on = plug
            clock.call_at(instant, lambda: setattr(nodes[number], "is_connected", on))
        clock.advance(10_000_000)
        collisions = tuple(node.collisions for node in nodes)
        return heard, (wire.bytes, wire.garbled, *collisions)

    bytewise, counts = run(False)
    chunks, same = run(True)
    assert same == counts
    for one, other in zip(bytewise, chunks, strict=True):
        assert joined(other) == joined(one)
        at = 0
        for data, instant in other:
            at += len(data)
            assert one[at - 1][1] == instant


def test_an_unplugged_node_is_silent_and_deaf() -> None:
    """What it sends meanwhile is gone."""
    clock = VirtualClock()
    wire = SimulatedSerialLine(clock, baud=115_200)
    (left, at_left), (right, at_right) = ear(wire), ear(wire)
    right.is_connected = False
    left.send(b"x")
    right.send(b"y")
    clock.advance(10**9)
    assert not at_left
    assert not at_right


def test_impossible_speeds() -> None:
    """A speed that no line has is refused."""
    with pytest.raises(CallerError, match="baud"):
        SimulatedSerialLine(VirtualClock(), baud=1)


def test_a_program_opens_the_line_as_a_port() -> None:
    """pyserial on the pseudo-terminal talks to a simulated device, in real time."""
    wire = SimulatedSerialLine(VirtualClock(), baud=1_000_000)

    def answer(data: bytes, now: int) -> None:
        device.send(bytes([data[0] ^ 0xFF]))

    device = wire.attach("device", answer)
    with PtyPort(wire) as port, serial.Serial(port.path, 1_000_000, timeout=5) as program:
        program.write(b"\x01\x02\x03")
        assert program.read(3) == b"\xfe\xfd\xfc"
