"""The simulated wire: time of frames, nodes, errors, datagrams."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_bus.frames import FD_LENGTHS
from aces_bus.hardware import Faults, ListeningNode, Noise, SimulatedBus
from aces_bus.hardware.ports import port_of
from aces_bus.hardware.simulated.bus import OFF, PASSIVE, RECOVERY, Babbler, BusNode
from aces_bus.hardware.simulated.bus_event import SimulatedBusEvent
from aces_bus.hardware.simulated.datagrams import SimulatedDatagrams
from aces_bus.hardware.simulated.frame_time import (
    ERROR_FRAME,
    INTERMISSION,
    SUSPEND,
    TRAILER,
    FrameBits,
    frame_bits,
)
from aces_bus.hardware.simulated.serial_line import SerialNode, SimulatedSerialLine
from aces_bus.runtime import VirtualClock
from tests.hardware.test_serial_wire import joined as joined
from tests.hardware.test_wire import clock as clock
from tests.hardware.test_wire import wire as wire

BIT = 1_000
Bytes = list[tuple[bytes, int]]


def bits_of(number: int, width: int) -> list[int]:
    """The bits of a field, first on the wire first."""
    return [number >> place & 1 for place in reversed(range(width))]


def crc15(bits: list[int]) -> int:
    """The CRC as the standard gives it: a shift register (10.4.2.6)."""
    register = 0
    for bit in bits:
        following = bit ^ (register >> 14 & 1)
        register = register << 1 & 0x7FFF
        if following:
            register ^= 0x4599
    return register


def stuffed(bits: list[int]) -> list[int]:
    """Bits with a complementary one behind every five equal ones; a stuff bit counts as the first of the next run."""
    out: list[int] = []
    run = 0
    for bit in bits:
        run = run + 1 if out and bit == out[-1] else 1
        out.append(bit)
        if run == 5:
            out.append(1 - bit)
            run = 1
    return out


def header(frame: Frame) -> list[int]:
    """SOF to the bit before the control field."""
    remote = int(frame.is_remote_frame)
    if frame.is_extended_id:
        base, rest = frame.arbitration_id >> 18, frame.arbitration_id & 0x3FFFF
        return [0, *bits_of(base, 11), 1, 1, *bits_of(rest, 18), remote]
    return [0, *bits_of(frame.arbitration_id, 11), remote]


def slow_bits(frame: Frame) -> FrameBits:
    """The frame written out."""
    data = [bit for byte in frame.data for bit in bits_of(byte, 8)]
    if not frame.is_fd:
        code = frame.dlc or 0 if frame.is_remote_frame else len(frame.data)
        bits = [*header(frame), 0, 0, *bits_of(code, 4), *data]
        bits += bits_of(crc15(bits), 15)
        return FrameBits(len(stuffed(bits)) + TRAILER, 0)
    front = [*header(frame), *([] if frame.is_extended_id else [0]), 1, 0, int(frame.bitrate_switch)]
    back = [int(frame.error_state_indicator), *bits_of(FD_LENGTHS.index(len(frame.data)), 4), *data]
    whole = stuffed([*front, *back])
    if ends_in_stuff([*front, *back]):
        whole.pop()  # the first fixed stuff bit stands here
    first = len(stuffed(front)) - ends_in_stuff(front)  # a stuff bit behind BRS is sent at the new rate
    check = 4 + (17 if len(frame.data) <= 16 else 21)
    fixed = sum(1 for place in range(check + 1) if place % 4 == 0)
    nominal, fast = first + TRAILER - 1, len(whole) - first + check + fixed + 1
    return FrameBits(nominal, fast) if frame.bitrate_switch else FrameBits(nominal + fast, 0)


def ends_in_stuff(bits: list[int]) -> bool:
    """Whether a stuff bit stands behind the last bit."""
    return len(stuffed(bits)) - len(stuffed(bits[:-1])) == 2


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Any frame but an error frame; data that likes long runs."""
    extended, fd = draw(st.booleans()), draw(st.booleans())
    limit = 0x1FFF_FFFF if extended else 0x7FF
    identifier = draw(st.one_of(st.integers(0, limit), st.sampled_from([0, limit, limit & 0x0F0F_0F0F])))
    size = draw(st.sampled_from(FD_LENGTHS if fd else range(9)))
    data = bytes(
        draw(
            st.lists(
                st.sampled_from([0, 0xFF, 0xF8, 0x07, 0x1F, 0xE0, 0x55]) | st.integers(0, 255),
                min_size=size,
                max_size=size,
            )
        )
    )
    if fd:
        return Frame(
            identifier,
            data,
            is_extended_id=extended,
            is_fd=True,
            bitrate_switch=draw(st.booleans()),
            error_state_indicator=draw(st.booleans()),
        )
    if draw(st.booleans()):
        return Frame(identifier, data, is_extended_id=extended)
    return Frame(identifier, is_extended_id=extended, is_remote_frame=True, dlc=size)


@given(frames())
def test_bits_are_those_of_the_frame_written_out(frame: Frame) -> None:
    """Counting by table gives what writing every bit gives."""
    assert frame_bits(frame) == slow_bits(frame)


@given(frames())
def test_no_frame_is_longer_than_the_bound(frame: Frame) -> None:
    """A classic frame has at most ⌊(g + 8 n − 1) / 4⌋ stuff bits, g = 34 or 54 (Davis, Burns, Bril, Lukkien 2007, eq. 1)."""
    if frame.is_fd:
        return
    n, g = len(frame.data), 54 if frame.is_extended_id else 34
    plain = g + 8 * n + TRAILER
    assert plain <= frame_bits(frame).total <= plain + (g + 8 * n - 1) // 4


def test_durations_are_in_nanoseconds() -> None:
    """Bits at 500 kbit/s take 2 µs each; bits behind the switch 0.25 µs at 4 Mbit/s."""
    assert FrameBits(100, 0).duration_ns(500_000) == 200_000
    assert FrameBits(30, 400).duration_ns(500_000, 4_000_000) == 60_000 + 100_000


def test_datagrams_reach_all_others() -> None:
    """A datagram wire delivers whole, late, and counts what it loses."""
    clock = VirtualClock()
    wire = SimulatedDatagrams(clock, delay_ns=1_000, drop=0.5, seed=1)
    heard: list[tuple[bytes, int]] = []
    port = port_of(wire)
    port.open(lambda packet, now: heard.append((packet, now)))
    other = port_of(wire)
    other.open(lambda packet, now: heard.append((b"own", now)))
    for number in range(100):
        assert other.send(bytes([number]))
    clock.advance(10_000)
    assert len(heard) == 100 - wire.lost
    assert 0 < wire.lost < 100
    assert {now for _, now in heard} == {1_000}


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


def ear(wire: SimulatedSerialLine, name: str = "", *, echo: bool | None = None) -> tuple[SerialNode, Bytes]:
    """A node, and what it hears with the instant of each byte."""
    heard: Bytes = []
    node = wire.attach(name, lambda data, now: heard.append((data, now)), echo=echo)
    return node, heard


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
