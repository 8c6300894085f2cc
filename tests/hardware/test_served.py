"""A virtual bus across processes: what joins it, what is heard, and what ends."""

from __future__ import annotations

import os
import threading
import time
from contextlib import ExitStack
from typing import Any

import can
import msgspec
import pytest

from aces_bus import Frame
from aces_bus.hardware import CanGate, Faults
from aces_bus.hardware.served.address import ServedAddress
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.simulated.frame_time import INTERMISSION, frame_bits

from .serving import PATIENCE, Open, message, received, serve, until, with_unix_sockets

pytestmark = with_unix_sockets


MESSAGES = [
    message(0x123, b"\x01\x02\x03"),
    message(0x1ABCDEF0, bytes(range(8)), is_extended_id=True),
    message(0x7FF),
    message(0x10, is_remote_frame=True, dlc=5),
    message(0x11, bytes(range(48)), is_fd=True, bitrate_switch=True),
    message(0x12, b"\x01", is_fd=True, error_state_indicator=True),
]


@pytest.mark.parametrize("physics", [True, False])
@pytest.mark.parametrize("link", [0, 1], ids=["unix", "tcp"])
def test_everything_that_a_message_carries_arrives(opened: Open, physics: bool, link: int) -> None:
    """Over either kind of socket, with and without physics, and every receiver has its own copy."""
    channel = ServedChannel("can0", bitrate=1_000_000, data_bitrate=4_000_000, fd=True, physics=physics)
    with serve(channel, unix="", tcp=("127.0.0.1", 0)) as server:
        address = server.addresses["can0"][link]
        sender, one, two = (opened(address, fd=True) for _ in range(3))
        for sent in MESSAGES:
            sender.send(sent)
            for receiver in (one, two):
                (got,) = received(receiver)
                assert got.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)
                assert (got.channel, got.is_rx) == (address, True)
                assert abs(got.timestamp - time.time()) < PATIENCE
        assert sender.recv(0) is None


@pytest.mark.parametrize("filtered", [False, True])
def test_frames_for_a_gate_are_what_was_sent(opened: Open, filtered: bool) -> None:
    """A gate takes frames without python-can's messages in between: every flag, length and byte is the sender's.

    With filters, plain frames take the way of all others.
    """
    with serve(ServedChannel(bitrate=1_000_000, data_bitrate=4_000_000, fd=True, physics=False)):
        sender, receiver = opened(fd=True), opened(fd=True)
        if filtered:
            receiver.set_filters([{"can_id": 0, "can_mask": 0}])
        for sent in MESSAGES:
            sender.send(sent)
            got: list[Frame] = []

            def has_come(got: list[Frame] = got) -> bool:
                got += receiver.frames(8)
                return bool(got)

            until(has_come)
            assert abs((got[0].timestamp or 0.0) - time.time()) < PATIENCE
            assert [msgspec.structs.replace(frame, timestamp=None, channel=None) for frame in got] == [
                Frame(
                    sent.arbitration_id,
                    bytes(sent.data),
                    is_extended_id=sent.is_extended_id,
                    is_remote_frame=sent.is_remote_frame,
                    is_fd=sent.is_fd,
                    bitrate_switch=sent.bitrate_switch,
                    error_state_indicator=sent.error_state_indicator,
                    is_rx=True,
                    dlc=sent.dlc if sent.is_remote_frame else None,
                )
            ]


def test_the_bus_decides_who_goes_first(opened: Open) -> None:
    """What waits is sent by identifier, and stamps are the frames' ends on the wire, to the bit."""
    with serve(ServedChannel(bitrate=1_000)):
        sender, receiver = opened(), opened()
        for identifier in (0, 5, 4, 3, 2, 1):  # the first one is on the wire for 50 ms
            sender.send(message(identifier))
        got = received(receiver, 6)
        assert [one.arbitration_id for one in got] == [0, 1, 2, 3, 4, 5]
        gap = got[2].timestamp - got[1].timestamp  # seconds since 1970 are floats, good to half a microsecond
        assert gap == pytest.approx((frame_bits(Frame(2)).total + INTERMISSION) / 1_000, abs=1e-6)


@pytest.mark.parametrize("acknowledge", [True, False])
def test_a_lone_sender_is_heard_where_the_bus_acknowledges(opened: Open, acknowledge: bool) -> None:
    """With only listeners around it a frame is sent for ever; a bus with a witness of its own takes it at once."""
    with serve(ServedChannel(bitrate=1_000_000, acknowledge=acknowledge), unix="") as server:
        (address,) = server.addresses["can0"]
        ear, node = opened(address, listen_only=True), opened(address)
        node.send(message(0x42))
        if acknowledge:
            assert received(ear)[0].arbitration_id == 0x42
        else:
            until(lambda: server.status()["channels"][0]["errors"] > 3)
            assert ear.recv(0) is None


@pytest.mark.parametrize("physics", [True, False])
def test_own_messages_listeners_filters(opened: Open, physics: bool) -> None:
    """Own frames come back when asked for, marked as sent; who only listens cannot send; filters apply."""
    with serve(ServedChannel(physics=physics)):
        own, ear = opened(receive_own_messages=True), opened(listen_only=True)
        other = opened(can_filters=[{"can_id": 0x20, "can_mask": 0x7F0, "extended": False}])
        with pytest.raises(can.CanOperationError, match="listen only"):
            ear.send(message(1))
        for identifier in (0x10, 0x21):
            own.send(message(identifier, b"x"))
        assert [(one.arbitration_id, one.is_rx) for one in received(own, 2)] == [(0x10, False), (0x21, False)]
        assert [one.arbitration_id for one in received(ear, 2)] == [0x10, 0x21]
        assert [one.arbitration_id for one in received(other)] == [0x21]


@pytest.mark.parametrize("physics", [True, False])
def test_members_of_all_kinds_hear_each_other(opened: Open, physics: bool) -> None:
    """Unix, TCP and socketcand clients, whoever came first; a classic member gets no FD frame."""
    channel = ServedChannel(physics=physics, fd=not physics)
    with serve(channel, unix="", tcp=("127.0.0.1", 0), socketcand=("127.0.0.1", 0)) as server:
        buses: list[can.BusABC] = [opened("unix:can0"), opened(server.addresses["can0"][1])]
        host, port = ServedAddress.parse_host(server.socketcand, None)
        with can.Bus("can0", "socketcand", host=host, port=port) as foreign:
            buses += [foreign, opened("unix:can0")]
            for number, sender in enumerate(buses):
                sender.send(message(0x100 + number, bytes([number])))
                for bus in buses:
                    if bus is not sender:
                        (got,) = received(bus)
                        assert (got.arbitration_id, bytes(got.data)) == (0x100 + number, bytes([number]))
            if not physics:
                fd = opened("unix:can0", fd=True)
                fd.send(message(0x200, bytes(12), is_fd=True))
                fd.send(message(0x201))
                assert [received(bus)[0].arbitration_id for bus in buses[:2]] == [0x201, 0x201]


@pytest.mark.parametrize("physics", [True, False])
def test_a_server_that_goes_is_an_error_at_once(opened: Open, physics: bool) -> None:
    """A blocked `recv` is woken with an exception; every call after it says the same, without waiting."""
    running = ExitStack()
    running.enter_context(serve(ServedChannel(physics=physics)))
    blocked, idle = opened(), opened()
    errors: list[Exception] = []

    def wait() -> None:
        try:
            blocked.recv(PATIENCE)
        except can.CanOperationError as error:
            errors.append(error)

    reader = threading.Thread(target=wait)
    reader.start()
    running.close()
    reader.join(PATIENCE)
    assert "is gone" in str(errors[0])
    for _ in range(3):
        for bus in (blocked, idle):
            with pytest.raises(can.CanOperationError, match="is gone"):
                bus.recv(PATIENCE)
    with pytest.raises(can.CanOperationError, match="is gone"):
        idle.send(message(1))


def test_a_gate_finds_the_server_again() -> None:
    """To the gatekeeper a served bus is one that can be unplugged and comes back."""
    kinds: list[str] = []
    told = threading.Condition()

    def happened(event: Any) -> None:
        with told:
            kinds.append(event.kind)
            told.notify_all()

    gate = CanGate({"interface": "aces", "channel": "unix:can0"})
    with serve():
        gate.start()
        gate.events.add(happened)
        inbox = gate.subscribe()
    try:
        with told:
            assert told.wait_for(lambda: "lost" in kinds, PATIENCE)
        with serve():
            with told:
                assert told.wait_for(lambda: "reopened" in kinds, PATIENCE)
            with can.Bus("unix:can0", "aces") as bus:
                bus.send(message(0x42))
                assert [item.content.arbitration_id for item in inbox.get(PATIENCE)] == [0x42]
    finally:
        gate.stop()


def test_closing_wakes_whoever_waits(opened: Open) -> None:
    """A thread in `recv` gets an exception when another closes the bus; closing twice is not harm."""
    with serve():
        bus = opened()
        errors: list[str] = []

        def wait() -> None:
            try:
                bus.recv(None)
            except can.CanOperationError as error:
                errors.append(str(error))

        reader = threading.Thread(target=wait)
        reader.start()
        bus.shutdown()
        bus.shutdown()
        reader.join(PATIENCE)
        assert "is closed" in errors[0]
        with pytest.raises(can.CanOperationError, match="closed"):
            bus.send(message(1))


def test_bus_off_and_back(opened: Open) -> None:
    """Faults take a sender off; it is told, refused, and comes back when restarted."""
    with serve(ServedChannel(bitrate=1_000_000, faults=Faults(corrupt=1.0))):
        sender, witness = opened(), opened()
        sender.send(message(1))
        until(lambda: sender.state is can.BusState.ERROR)
        assert [event.kind for event in sender.events][-1] == "bus-off"
        with pytest.raises(can.CanOperationError, match="bus-off"):
            sender.send(message(2))
        sender.flush_tx_buffer()
        sender.restart()
        until(lambda: sender.state is can.BusState.ACTIVE)
        assert witness.recv(0) is None


def test_last_words_are_still_said(opened: Open) -> None:
    """Frames given to the bus are sent though their sender has left, as a controller would."""
    with serve(ServedChannel(bitrate=50_000)):
        receiver = opened()
        with can.Bus("unix:can0", "aces") as sender:
            for number in range(10):
                sender.send(message(number))
        assert len(received(receiver, 10)) == 10


def test_nothing_is_left_open(opened: Open) -> None:
    """Files of the process are as many after a server and its clients as before."""
    if not os.path.isdir("/proc/self/fd"):
        pytest.skip("no /proc to look at")
    before = len(os.listdir("/proc/self/fd"))
    for physics in (True, False):
        with serve(ServedChannel(physics=physics)):
            buses = [opened() for _ in range(4)]
            buses[0].send(message(1))
            received(buses[1])
            for bus in buses:
                bus.shutdown()
    assert len(os.listdir("/proc/self/fd")) == before
