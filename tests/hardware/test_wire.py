"""The physics of the virtual bus: who goes first, how long it takes, what errors do."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_bus.errors import CallerError
from aces_bus.hardware import Faults, ListeningNode, SimulatedBus
from aces_bus.hardware.simulated.bus import OFF, PASSIVE, RECOVERY, Babbler, BusNode
from aces_bus.hardware.simulated.bus_event import SimulatedBusEvent
from aces_bus.hardware.simulated.frame_time import ERROR_FRAME, INTERMISSION, SUSPEND, frame_bits
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


def test_nobody_acknowledges(clock: VirtualClock, wire: SimulatedBus) -> None:
    """A lone node retransmits, becomes passive, and stays so: it does not go bus-off for want of company."""
    events: list[SimulatedBusEvent] = []
    node = wire.attach("lone", happened=events.append)
    ListeningNode(wire)  # listens, and acknowledges nothing
    node.send(Frame(0x10))
    clock.advance(100_000_000)
    assert (node.state, node.transmit_errors, node.pending) == ("error-passive", PASSIVE + 1, 1)
    kinds = [event.kind for event in events]
    assert kinds == ["no acknowledge"] * 16 + ["error-passive"]
    partner = wire.attach("partner")
    clock.advance(1_000_000)
    assert node.pending == 0
    assert partner.state == "error-active"


def test_two_nodes_with_one_identifier_destroy_each_other_until_one_is_passive(
    clock: VirtualClock, wire: SimulatedBus
) -> None:
    """Equal identifiers and other data: bit errors at both, until the passive loser disturbs the other no more.

    Cho and Shin, CCS 2016: 16 errors of each, and one more of the loser, whose frame goes when it is alone.
    """
    events: list[SimulatedBusEvent] = []
    left, right = wire.attach("left", happened=events.append), wire.attach("right", happened=events.append)
    witness = ListeningNode(wire)
    wire.attach("partner")
    right.send(Frame(0x100, b"\x02"))
    left.send(Frame(0x100, b"\x01"))
    clock.advance(100_000_000)
    assert [event.kind for event in events].count("bit error") == 16 + 17
    assert [bytes(frame.data) for _, frame in witness.received] == [b"\x01", b"\x02"]
    assert (left.transmit_errors, right.transmit_errors) == (127, 135)
    assert (left.state, right.state) == ("error-active", "error-passive")


def test_who_loses_each_time_is_bus_off_and_may_come_back(clock: VirtualClock, wire: SimulatedBus) -> None:
    """A node whose each frame meets a dominant one of its identifier is bus-off; the other goes on."""
    wire.attach("witness")
    left, right = wire.attach("left"), wire.attach("right")
    for _ in range(OFF):
        if left.state == "bus-off":
            break
        assert left.send(Frame(0x100, b"\x02"))
        right.send(Frame(0x100, b"\x01"))
        clock.advance(10_000_000)
    assert (left.state, right.state) == ("bus-off", "error-active")
    assert not left.send(Frame(1))
    left.restart()
    clock.advance(RECOVERY * BIT - 1)
    assert left.state == "bus-off"
    clock.advance(1_000_000)
    assert (left.state, left.transmit_errors, left.pending) == ("error-active", 0, 0)


def test_equal_frames_at_once_are_one_frame(clock: VirtualClock, wire: SimulatedBus) -> None:
    """Two nodes that send the same bits at the same time both succeed."""
    heard = ListeningNode(wire)
    for _ in range(2):
        wire.attach().send(Frame(0x100, b"\x01"))
    clock.advance(1_000_000)
    assert len(heard.received) == 1
    assert not any(node.pending for node in wire.nodes)


def test_error_counters_go_down_with_success(clock: VirtualClock, wire: SimulatedBus) -> None:
    """Each frame that works takes one off the transmitter's counter; at 127 it is active again."""
    node = wire.attach("node")
    other = wire.attach("other", listen_only=True)
    node.send(Frame(0x10))
    clock.advance(50_000_000)
    assert node.state == "error-passive"
    other.listen_only = False
    for _ in range(2):
        node.send(Frame(0x10))
    clock.advance(5_000_000)
    assert (node.state, node.transmit_errors) == ("error-active", PASSIVE - 2)


def test_a_passive_transmitter_waits_longer(clock: VirtualClock, wire: SimulatedBus) -> None:
    """Behind its own frame a passive node leaves eight bits more to others."""
    heard = ListeningNode(wire)
    wire.attach()
    node = wire.attach()
    node.transmit_errors, node.state = 200, "error-passive"
    node.send(Frame(0x10))
    node.send(Frame(0x10))
    clock.advance(1_000_000)
    (first, _), (second, _) = heard.received
    assert second - first == (INTERMISSION + SUSPEND + frame_bits(Frame(0x10)).total) * BIT


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


def test_a_babbling_node_takes_the_bus(clock: VirtualClock, wire: SimulatedBus) -> None:
    """Its frames have the bus to themselves until it stops."""
    heard = ListeningNode(wire)
    wire.attach()
    babbler = Babbler(wire, Frame(0))
    node = wire.attach()
    node.send(Frame(1))
    clock.advance(10_000_000)
    assert node.pending == 1
    assert {frame.arbitration_id for frame in heard.frames()} == {0}
    babbler.stop()
    clock.advance(1_000_000)
    assert node.pending == 0


def at_once(clock: VirtualClock, end: int) -> None:
    clock.advance_to(end)


def in_pieces(clock: VirtualClock, end: int) -> None:
    """In advances of all lengths, many of them shorter than a frame or an intermission."""
    rng = random.Random(9)
    while clock.now() < end:
        clock.advance_to(min(end, clock.now() + rng.choice((700, 2_000, 7_000, 60_000, 400_000))))


def event_by_event(clock: VirtualClock, end: int) -> None:
    clock.wait(lambda: False, end - clock.now())


def traffic(
    faults: Faults, seconds: float = 0.2, advance: Callable[[VirtualClock, int], None] = at_once
) -> tuple[list[Any], Any]:
    """Three nodes at about 70 % load: all that was heard, and the load."""
    clock = VirtualClock()
    wire = SimulatedBus(clock, bitrate=1_000_000, faults=faults)
    heard: list[Any] = []
    rng = random.Random(3)

    def ear(number: int) -> Callable[[Frame, int], None]:
        return lambda frame, now: heard.append((number, now, frame))

    nodes = [wire.attach(f"n{number}", ear(number), heard.append) for number in range(3)]

    def planned(node: BusNode, base: int) -> None:
        node.send(Frame(base + rng.randrange(256), rng.randbytes(rng.randrange(9))))
        clock.call_in(rng.randrange(200_000, 500_000), lambda: planned(node, base))

    for number, node in enumerate(nodes):
        planned(node, 0x100 * number)
    advance(clock, round(seconds * 1e9))
    return heard, wire.load


FAULTS = Faults(seed=5, corrupt=0.02, drop=0.02, duplicate=0.02, delay=0.05)


def test_the_same_seed_is_the_same_bus() -> None:
    """Every frame, event and instant again; another seed is another bus."""
    first, again = traffic(FAULTS), traffic(FAULTS)
    assert first == again
    assert traffic(Faults(seed=6, corrupt=0.02, drop=0.02, duplicate=0.02, delay=0.05)) != first


@pytest.mark.parametrize("faults", [Faults(), FAULTS])
@pytest.mark.parametrize("advance", [in_pieces, event_by_event])
def test_how_time_is_advanced_changes_nothing(
    faults: Faults, advance: Callable[[VirtualClock, int], None]
) -> None:
    """The events that a bus spares in one long advance are those that would have changed nothing."""
    assert traffic(faults, advance=advance) == traffic(faults)


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


def test_faults_do_what_they_say() -> None:
    """Destroyed frames are sent again; drops lose one receiver's copy, duplicates add one, delays come late."""
    plain, load = traffic(Faults())
    for name in ("drop", "duplicate"):
        faulty, _ = traffic(Faults(seed=1, drop=0.5) if name == "drop" else Faults(seed=1, duplicate=0.5))
        frames = [item for item in faulty if isinstance(item, tuple)]
        ratio = len(frames) / len([item for item in plain if isinstance(item, tuple)])
        assert 0.4 < ratio < 0.6 if name == "drop" else 1.4 < ratio < 1.6
    corrupted, bad_load = traffic(Faults(seed=1, corrupt=0.1))
    assert load.errors == 0 < bad_load.errors
    assert bad_load.busy_ns > load.busy_ns
    assert {e.kind for e in corrupted if isinstance(e, SimulatedBusEvent)} >= {"bit error", "sent"}


def test_an_error_frame_takes_its_time(clock: VirtualClock, wire: SimulatedBus) -> None:
    """Nobody acknowledges: up to the ACK slot, the error frame, the intermission, then again."""
    node = wire.attach()
    frame = Frame(0x2AA, b"\x55")
    node.send(frame)
    clock.advance((frame_bits(frame).total - 8 + ERROR_FRAME) * BIT)
    assert wire.load.errors == 1
    assert wire.load.busy_ns == (frame_bits(frame).total - 8 + ERROR_FRAME + INTERMISSION) * BIT


@pytest.mark.parametrize("rates", [(500, None), (2_000_000, None), (500_000, 250_000), (500_000, 10_000_000)])
def test_impossible_rates(clock: VirtualClock, rates: tuple[int, int | None]) -> None:
    """A rate that no controller has is refused with the rates that there are."""
    with pytest.raises(CallerError, match="bit rate"):
        SimulatedBus(clock, bitrate=rates[0], data_bitrate=rates[1])


def test_a_listener_cannot_send(wire: SimulatedBus) -> None:
    """By construction, not by discipline."""
    with pytest.raises(CallerError, match="only listens"):
        wire.attach("ear", listen_only=True).send(Frame(1))
