"""Served buses: packets, links and addresses."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_bus.frames import FD_LENGTHS
from aces_bus.hardware.served import channel as channel_module
from aces_bus.hardware.served import packets, remote, stream
from aces_bus.hardware.served.address import ServedAddress
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.stream import ServerConnection, servers
from aces_bus.hardware.simulated.bus_event import SimulatedBusEvent
from tests.hardware.serving import PATIENCE, Open, message, received, serve, until, with_unix_sockets

pytestmark = with_unix_sockets


def test_waiting_costs_nothing(opened: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    """`recv` with a time-out sleeps in the system until that is over, and asks it once or twice; 0 does not wait."""
    with serve():
        bus = opened()
        waits: list[float | None] = []

        def noted(number: int, timeout: float | None) -> bool:
            waits.append(timeout)
            return stream.wait(number, timeout)

        monkeypatch.setattr(remote, "wait", noted)
        start = time.monotonic()
        assert bus.recv(0.4) is None
        assert time.monotonic() - start >= 0.4
        assert waits[0] == 0.4
        assert len(waits) <= 3  # what the system rounds down is waited for once more
        waits.clear()
        assert bus.recv(0) is None
        assert waits == [0]


def test_full_mailboxes(opened: Open) -> None:
    """With nobody to acknowledge, a sender hears of it after as many frames as it has mailboxes, and is passive."""
    with serve():
        bus = opened()
        for _ in range(channel_module.MAILBOXES):
            bus.send(message(1))
        with pytest.raises(can.CanOperationError, match="no free mailbox"):
            bus.send(message(1))
        until(lambda: bus.state is can.BusState.PASSIVE)
        assert {event.kind for event in bus.events} == {"no acknowledge", "error-passive"}
        bus.flush_tx_buffer()
        other = opened()
        until(lambda: bus.status()["channels"][0]["members"][0]["waiting"] <= 1)
        bus.send(message(2), timeout=PATIENCE)
        while received(other)[0].arbitration_id != 2:
            pass  # the one frame that was on the wire when the others were dropped


def test_who_comes_is_served_by_a_server_that_cannot_keep_up(opened: Open) -> None:
    """On a machine too slow for what happens on its buses these fall behind, and clients still get their answers."""
    server = serve()

    def again() -> None:
        server.clock.call_in(100, again)  # in less time than that takes

    again()
    with server:
        assert opened().status()["channels"][0]["now_ns"] < time.monotonic_ns()


def test_a_fast_sender_waits_for_the_bus(opened: Open) -> None:
    """With a time-out to wait in, more frames than mailboxes go through without a loss, in order."""
    count = 2 * channel_module.MAILBOXES
    with serve():
        sender, receiver = opened(), opened()
        for number in range(count):
            sender.send(message(1, number.to_bytes(2, "big")), timeout=PATIENCE)
        got = [int.from_bytes(one.data, "big") for one in received(receiver, count)]
        assert got == list(range(count))
        assert (receiver.dropped, sender.rejected) == (0, 0)


def test_a_server_that_is_slow_is_found(monkeypatch: pytest.MonkeyPatch, runtime: Path) -> None:
    """A server is given the time that it has for any answer, and one that gives none is waited for once, not per address."""
    from aces_bus.hardware.served import stream

    asked: list[float] = []

    def hangs(address: object, timeout: float = 0.0) -> dict[str, object]:
        asked.append(timeout)
        raise TimeoutError("no answer in time")

    monkeypatch.setattr(stream, "ask", hangs)
    with serve(ServedChannel("left"), tcp=("127.0.0.1", 0)):
        assert servers() == []
    assert asked == [stream.ANSWER_S]


def plain(address: str = "unix:can0") -> ServerConnection:
    """A client that speaks by hand."""
    return ServerConnection(ServedAddress.parse(address), packets.Hello())


@pytest.mark.slow
def test_who_does_not_read_loses_the_oldest(opened: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    """A member that does not read delays nobody; its losses are counted, and what is kept is the newest."""
    monkeypatch.setattr(channel_module, "QUEUE", 100)
    count = 3_000
    with serve(ServedChannel(physics=False)), ExitStack() as stack:
        slow = plain()
        stack.callback(slow.close)
        sender, reader = opened(), opened()
        for number in range(count):
            sender.send(message(1, number.to_bytes(4, "big")))
            received(reader)
        assert reader.dropped == 0

        def lost() -> int:
            return int(sender.status()["channels"][0]["members"][0]["dropped"])

        until(lambda: lost() > 0)
        kept: list[int] = []
        dropped = 0
        while not kept or kept[-1] != count - 1:
            for kind, body in slow.read():
                if kind == packets.REPORT:
                    dropped = packets.read_value(body, packets.TransmitReport).dropped
                else:
                    kept += [int.from_bytes(one[-1][:4], "big") for one in packets.unpack_records(kind, body)]
        assert kept == sorted(kept)
        assert len(kept) + dropped == count


GARBAGE = [
    b"\x00\x00\xff\x00",
    packets.packet(packets.CLASSIC, bytes(24)),
    packets.packet(packets.HELLO, b"short"),
    packets.packet(packets.HELLO, bytes(20)),
    packets.value_packet(packets.Hello("nowhere")),
    packets.value_packet(packets.Hello(bitrate=123)),
    packets.value_packet(packets.Hello(fd=True)),
    packets.value_packet(packets.Hello()) * 2,
    packets.value_packet(packets.Hello()) + packets.packet(packets.CLASSIC, bytes(23)),
    packets.value_packet(packets.Hello())
    + packets.packet(packets.CLASSIC, packets.CLASSIC_RECORD.pack(0, 0x800, 0, 0, b"")),
    packets.value_packet(packets.Hello())
    + packets.packet(packets.CLASSIC, packets.CLASSIC_RECORD.pack(0, 1, 4, 0, b"")),
    packets.value_packet(packets.Hello())
    + packets.packet(packets.CLASSIC, packets.CLASSIC_RECORD.pack(0, 1, 0, 200, b"")),
    packets.value_packet(packets.Hello())
    + packets.packet(packets.LONG, packets.LONG_RECORD.pack(0, 1, 8, 63, b"")),
    packets.value_packet(packets.Hello()) + packets.packet(packets.EVENT, bytes(9)),
    packets.packet(packets.QUERY),
]


@pytest.mark.parametrize("garbage", GARBAGE, ids=range(len(GARBAGE)))
def test_a_bad_client_costs_only_itself(opened: Open, garbage: bytes) -> None:
    """What nobody may say ends the connection with a reason; the others do not notice."""
    said: list[str] = []
    with serve(said=said.append) as server:
        one, two = opened(), opened()
        bad = ServedAddress.parse("unix:can0").connect(PATIENCE)
        bad.sendall(garbage)
        answer = b""
        while data := bad.recv(65536):
            answer += data
        bad.close()
        kinds = [kind for kind, _ in packets.split_packets(answer)[0]]
        assert kinds[-1] == packets.REFUSED
        one.send(message(1, b"ok"))
        assert received(two)[0].data == b"ok"
        assert server.cut == len(said) == 1


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
