"""The physics of the virtual bus: who goes first, how long it takes, what errors do."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_bus.errors import CallerError
from aces_bus.hardware import ListeningNode, SimulatedBus
from aces_bus.hardware.simulated.frame_time import INTERMISSION, frame_bits
from aces_bus.runtime import VirtualClock

BIT = 1_000  # ns, at 1 Mbit/s


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def wire(clock: VirtualClock) -> SimulatedBus:
    return SimulatedBus(clock, bitrate=1_000_000)


def test_a_frame_takes_its_stuffed_bits(clock: VirtualClock, wire: SimulatedBus) -> None:
    """It arrives at the end of EOF; the next one starts three bits later."""
    heard = ListeningNode(wire)
    wire.attach()  # somebody has to acknowledge
    node = wire.attach()
    first, second = Frame(0x123, b"\x00" * 8), Frame(0x124, b"\xaa\x55")
    node.send(first)
    node.send(second)
    clock.advance(10_000_000)
    end = frame_bits(first).total * BIT
    next_end = end + (INTERMISSION + frame_bits(second).total) * BIT
    assert list(heard.received) == [(end, first), (next_end, second)]
    assert wire.load.busy_ns == next_end + INTERMISSION * BIT


def test_fd_frames_switch_the_bit_rate(clock: VirtualClock) -> None:
    """Behind BRS, bits last as long as the data bit rate says."""
    wire = SimulatedBus(clock, bitrate=500_000, data_bitrate=4_000_000)
    heard = ListeningNode(wire)
    wire.attach()
    frame = Frame(0x1ABCDEF0, bytes(range(64)), is_extended_id=True, is_fd=True, bitrate_switch=True)
    wire.attach().send(frame)
    clock.advance(10_000_000)
    bits = frame_bits(frame)
    assert bits.data > 512
    assert list(heard.received) == [(bits.nominal * 2_000 + bits.data * 250, frame)]


IDS = st.builds(
    lambda extended, number, remote: Frame(
        number if extended else number & 0x7FF,
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=0 if remote else None,
    ),
    st.booleans(),
    st.integers(0, 0x1FFF_FFFF),
    st.booleans(),
)


def on_the_wire(frame: Frame) -> list[int]:
    """The bits that nodes contend with, dominant 0: SOF to RTR."""
    number, remote = frame.arbitration_id, int(frame.is_remote_frame)
    if frame.is_extended_id:
        base = [number >> place & 1 for place in range(28, 17, -1)]
        return [*base, 1, 1, *[number >> place & 1 for place in range(17, -1, -1)], remote]
    return [*[number >> place & 1 for place in range(10, -1, -1)], remote, 0]


@given(
    st.lists(
        IDS,
        min_size=2,
        max_size=8,
        unique_by=lambda f: (f.is_extended_id, f.arbitration_id, f.is_remote_frame),
    )
)
def test_contending_nodes_win_by_identifier(frames: list[Frame]) -> None:
    """Whoever sends a recessive bit and sees a dominant one steps back: lists of bits compare like that."""
    clock = VirtualClock()
    wire = SimulatedBus(clock, bitrate=1_000_000)
    heard = ListeningNode(wire)
    for frame in frames:
        wire.attach().send(frame)
    clock.advance(20_000_000)
    assert [frame for _, frame in heard.received] == sorted(frames, key=on_the_wire)


def test_a_node_sends_its_most_urgent_frame_first(clock: VirtualClock, wire: SimulatedBus) -> None:
    """What waits in one controller is ordered by identifier, equal ones by age."""
    heard = ListeningNode(wire)
    wire.attach()
    node = wire.attach()
    for number, data in ((5, b"a"), (3, b"b"), (5, b"c"), (1, b"d")):
        node.send(Frame(number, data))
    clock.advance(10_000_000)
    assert b"".join(frame.data for frame in heard.frames()) == b"dbac"


def test_a_more_urgent_frame_waits_for_the_one_on_the_wire(clock: VirtualClock, wire: SimulatedBus) -> None:
    """What comes during a transmission goes next, and neither is lost; a frame on the wire cannot be taken back."""
    heard = ListeningNode(wire)
    wire.attach()
    node = wire.attach()
    node.send(Frame(5))
    clock.advance(10 * BIT)
    node.send(Frame(1))
    node.send(Frame(7))
    clock.advance(60 * BIT)
    node.abort()
    clock.advance(1_000_000)
    assert [frame.arbitration_id for frame in heard.frames()] == [5, 1]


def test_equal_frames_at_once_are_one_frame(clock: VirtualClock, wire: SimulatedBus) -> None:
    """Two nodes that send the same bits at the same time both succeed."""
    heard = ListeningNode(wire)
    for _ in range(2):
        wire.attach().send(Frame(0x100, b"\x01"))
    clock.advance(1_000_000)
    assert len(heard.received) == 1
    assert not any(node.pending for node in wire.nodes)


def test_a_classic_controller_destroys_fd_frames(clock: VirtualClock, wire: SimulatedBus) -> None:
    """One node that does not know FD, and no FD frame gets through."""
    heard = ListeningNode(wire)
    wire.attach("old", fd=False)
    node = wire.attach("new")
    node.send(Frame(0x10, bytes(12), is_fd=True))
    clock.advance(100_000_000)
    assert not heard.received
    assert node.state == "bus-off"


def test_pulling_the_plug(clock: VirtualClock, wire: SimulatedBus) -> None:
    """A node that is unplugged hears nothing and sends nothing; plugged in again it sends what waited."""
    heard = ListeningNode(wire)
    wire.attach()
    got: list[Frame] = []
    node = wire.attach("node", lambda frame, _: got.append(frame))
    other = wire.attach("other")
    node.is_connected = False
    node.send(Frame(1))
    other.send(Frame(2))
    clock.advance(1_000_000)
    assert not got
    node.is_connected = True
    clock.advance(1_000_000)
    assert [frame.arbitration_id for frame in heard.frames()] == [2, 1]


def test_who_sends_between_two_advances_takes_part(clock: VirtualClock, wire: SimulatedBus) -> None:
    """A program that stops the clock within an intermission may still send the more urgent frame."""
    heard = ListeningNode(wire)
    one, other = wire.attach(), wire.attach()
    one.send(Frame(0x10))
    one.send(Frame(0x20))
    clock.advance_to(frame_bits(Frame(0x10)).total * BIT + BIT)
    other.send(Frame(0x11))
    clock.advance(1_000_000)
    assert [frame.arbitration_id for frame in heard.frames()] == [0x10, 0x11, 0x20]


def test_a_receiver_that_raises_does_not_stop_the_bus(clock: VirtualClock, wire: SimulatedBus) -> None:
    """What it raises comes out of the advance; the frames that wait are carried when something more is sent."""

    def ear(frame: Frame, now: int) -> None:
        if frame.arbitration_id == 1:
            raise RuntimeError("no room")

    heard = ListeningNode(wire)
    wire.attach(received=ear)
    node = wire.attach()
    node.send(Frame(1))
    node.send(Frame(2))
    with pytest.raises(RuntimeError, match="no room"):
        clock.advance(1_000_000)
    node.send(Frame(3))
    clock.advance(1_000_000)
    assert [frame.arbitration_id for frame in heard.frames()] == [1, 2, 3]


@pytest.mark.parametrize("rates", [(500, None), (2_000_000, None), (500_000, 250_000), (500_000, 10_000_000)])
def test_impossible_rates(clock: VirtualClock, rates: tuple[int, int | None]) -> None:
    """A rate that no controller has is refused with the rates that there are."""
    with pytest.raises(CallerError, match="bit rate"):
        SimulatedBus(clock, bitrate=rates[0], data_bitrate=rates[1])


def test_a_listener_cannot_send(wire: SimulatedBus) -> None:
    """By construction, not by discipline."""
    with pytest.raises(CallerError, match="only listens"):
        wire.attach("ear", listen_only=True).send(Frame(1))
