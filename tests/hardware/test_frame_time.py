"""Frame times, against the standard's rules written out bit by bit."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_bus.frames import FD_LENGTHS
from aces_bus.hardware.simulated.frame_time import TRAILER, FrameBits, frame_bits


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
