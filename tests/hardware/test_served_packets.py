"""The packets of served buses: frames survive them, and nonsense is named."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_bus.frames import FD_LENGTHS
from aces_bus.hardware.served import packets
from aces_bus.hardware.simulated.bus_event import SimulatedBusEvent

FRAMES = st.builds(
    lambda identifier, extended, data, remote: Frame(
        identifier if extended else identifier & 0x7FF,
        b"" if remote else data,
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=len(data) if remote else None,
    ),
    st.integers(0, 0x1FFF_FFFF),
    st.booleans(),
    st.binary(max_size=8),
    st.booleans(),
) | st.builds(
    lambda identifier, size, seed, brs, esi: Frame(
        identifier,
        bytes((seed + at) % 256 for at in range(size)),
        is_fd=True,
        bitrate_switch=brs,
        error_state_indicator=esi,
    ),
    st.integers(0, 0x7FF),
    st.sampled_from(FD_LENGTHS),
    st.integers(0, 255),
    st.booleans(),
    st.booleans(),
)


@given(st.lists(st.tuples(FRAMES, st.integers(0, 2**62)), max_size=60), st.data())
def test_frames_survive_packets(frames: list[tuple[Frame, int]], data: st.DataObject) -> None:
    """Frames come out of packets as they went in, in order, wherever the stream is cut."""
    stream = b"".join(packets.packed(packets.frame_record(frame, when) for frame, when in frames))
    cut = data.draw(st.integers(0, len(stream)))
    first, rest = packets.split_packets(stream[:cut])
    second, rest = packets.split_packets(rest + stream[cut:])
    assert rest == b""
    found = [
        (packets.record_to_frame(identifier, flags, length, padded), when)
        for kind, body in first + second
        for when, identifier, flags, length, padded in packets.unpack_records(kind, body)
    ]
    assert found == frames


@given(st.lists(FRAMES, max_size=40))
def test_what_is_quick_for_plain_frames_says_the_same(frames: list[Frame]) -> None:
    """Frames offered together are the packets of any frames; packets of a plain frame each are read at once, others not."""
    records = [packets.frame_record(frame, 5) for frame in frames]
    assert packets.frames_packet(frames, 5) == b"".join(packets.packed(records))
    found = packets.single_frames(b"".join(one for record in records for one in packets.packed([record])))
    is_plain = all(not (f.is_extended_id or f.is_remote_frame or f.is_fd) for f in frames)
    assert (found is not None) == is_plain
    for frame, other in zip(frames, found or frames, strict=True):
        assert (frame.arbitration_id, frame.data) == (other.arbitration_id, other.data)


def test_a_packet_with_more_than_one_frame_is_left_to_the_other_reader() -> None:
    """One packet of two frames is as long as no number of single ones, or is seen to be none."""
    plain = [Frame(0x10 + n, bytes(8)) for n in range(8)]
    assert packets.single_frames(packets.frames_packet(plain, 0)) is None
    assert packets.single_frames(b"") == []


@given(st.binary(max_size=300))
def test_no_bytes_break_a_reader(data: bytes) -> None:
    """Whatever comes is packets or a `PacketError`; frames that come out can exist."""
    for wanted in (packets.Hello, packets.Welcome, packets.TransmitReport, SimulatedBusEvent):
        try:
            packets.read_value(data, wanted)
        except packets.PacketError:
            pass
    for kind in (packets.CLASSIC, packets.LONG):
        try:
            for _, identifier, flags, length, padded in packets.unpack_records(kind, data):
                packets.record_to_frame(identifier, flags, length, padded)
        except packets.PacketError:
            pass
    try:
        packets.split_packets(data)
    except packets.PacketError:
        pass
