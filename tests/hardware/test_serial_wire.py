"""The simulated serial line: timing, noise, collisions; and a port that foreign programs open."""

from __future__ import annotations

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.errors import CallerError
from aces_bus.hardware.simulated.serial_line import PtyPort, SimulatedSerialLine
from aces_bus.runtime import VirtualClock

Bytes = list[tuple[bytes, int]]


def joined(heard: Bytes) -> bytes:
    return b"".join(data for data, _ in heard)


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
