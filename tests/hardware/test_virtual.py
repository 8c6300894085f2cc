"""The virtual bus through python-can: what any program that uses python-can sees."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import can
import pytest

from aces_bus import Frame
from aces_bus.hardware import virtual_clock
from aces_bus.hardware.simulated.backend import AcesBus
from aces_bus.hardware.simulated.frame_time import frame_bits
from aces_bus.runtime import VirtualClock


@pytest.fixture
def clock() -> Iterator[VirtualClock]:
    with virtual_clock("can0", "can1") as clock:
        yield clock


def opened(channel: str = "can0", **more: Any) -> AcesBus:
    """A bus as any program opens it: by its name."""
    bus = can.Bus(channel, "aces", **more)
    assert isinstance(bus, AcesBus)
    return bus


def test_a_frame_arrives_when_it_has_been_on_the_wire(clock: VirtualClock) -> None:
    """Everything that a message carries comes through, with the time of the frame's end."""
    sent = can.Message(arbitration_id=0x1ABCDEF0, data=b"\x01\x02\x03")
    with opened(bitrate=1_000_000) as left, opened(bitrate=1_000_000) as right:
        left.send(sent)
        got = right.recv(1)
        assert got is not None
        assert got.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)
        assert (
            got.timestamp == frame_bits(Frame(0x1ABCDEF0, b"\x01\x02\x03", is_extended_id=True)).total / 1e6
        )
        assert (got.channel, got.is_rx) == ("can0", True)
        assert left.recv(0) is None


def test_waiting_moves_virtual_time_on(clock: VirtualClock) -> None:
    """A time-out passes in no time; waiting for ever where nothing can happen is an error and not a hang."""
    with opened() as bus:
        assert bus.recv(3600) is None
        assert clock.now() == 3600 * 10**9
        with pytest.raises(can.CanOperationError, match="nothing is left to happen"):
            bus.recv()


def test_channels_are_apart_and_share_a_clock(clock: VirtualClock) -> None:
    """What is sent on one is not heard on the other; both move together."""
    with opened("can0") as one, opened("can0") as same, opened("can1") as other:
        one.send(can.Message(arbitration_id=1, is_extended_id=False))
        assert other.recv(0.1) is None
        assert same.recv(0) is not None


def test_settings_of_a_channel_are_its_first_opener_s(clock: VirtualClock) -> None:
    """A second opinion about the bit rate is refused, as the frames would be on a real bus."""
    with opened(bitrate=500_000), pytest.raises(can.CanInitializationError, match="is open with"):
        opened(bitrate=250_000)
    with opened(bitrate=250_000):
        pass  # once everybody has left, the channel is new


def test_own_messages_and_filters(clock: VirtualClock) -> None:
    """Own frames come back when asked for, marked as sent; filters apply to all."""
    with opened(receive_own_messages=True) as bus, opened():
        bus.set_filters([{"can_id": 0x10, "can_mask": 0x7F0, "extended": False}])
        for identifier in (0x15, 0x25):
            bus.send(can.Message(arbitration_id=identifier, is_extended_id=False))
        got = bus.recv(0.1)
        assert got is not None
        assert (got.arbitration_id, got.is_rx) == (0x15, False)
        assert bus.recv(0.1) is None


def test_listen_only(clock: VirtualClock) -> None:
    """Such a bus hears, and can neither send nor acknowledge."""
    with opened(listen_only=True) as ear, opened() as node:
        with pytest.raises(can.CanOperationError, match="listen only"):
            ear.send(can.Message(arbitration_id=1))
        node.send(can.Message(arbitration_id=1))
        assert ear.recv(0.1) is None  # nobody acknowledges
        assert node.state is can.BusState.PASSIVE
        with opened():
            assert ear.recv(0.1) is not None


def test_unread_frames_are_dropped_and_counted(clock: VirtualClock) -> None:
    """A receiver that does not read keeps its newest frames and knows what it lost."""
    with opened(rx_queue_size=3) as slow, opened() as node:
        for number in range(5):
            node.send(can.Message(arbitration_id=number, is_extended_id=False))
        clock.advance(10_000_000)
        assert slow.dropped == 2
        kept = [message.arbitration_id for message in iter(lambda: slow.recv(0), None)]
        assert kept == [2, 3, 4]


def test_nobody_can_change_what_another_received(clock: VirtualClock) -> None:
    """Messages are mutable; each receiver has its own."""
    for physics in (True, False):
        with opened(physics=physics) as node, opened(physics=physics) as one, opened(physics=physics) as two:
            message = can.Message(arbitration_id=1, data=b"\x01")
            node.send(message)
            message.data[0] = 9
            first = one.recv(1)
            assert first is not None
            first.data[0] = 8
            second = two.recv(1)
            assert second is not None
            assert second.data == b"\x01"


def test_a_closed_bus_says_so(clock: VirtualClock) -> None:
    """Sending and receiving after shutdown raise; shutting down twice does not."""
    bus = opened()
    bus.shutdown()
    bus.shutdown()
    with pytest.raises(can.CanOperationError, match="closed"):
        bus.recv(0)
    with pytest.raises(can.CanOperationError, match="closed"):
        bus.send(can.Message(arbitration_id=1))


def test_bus_off_and_back(clock: VirtualClock) -> None:
    """A node whose frames meet dominant ones of their identifier is off; events tell, a restart brings it back."""
    with opened() as left, opened() as right, opened() as witness:
        for _ in range(40):
            if left.state is can.BusState.ERROR:
                break
            left.send(can.Message(arbitration_id=5, data=b"\x02"))
            right.send(can.Message(arbitration_id=5, data=b"\x01"))
            clock.advance(10_000_000)
        assert left.state is can.BusState.ERROR
        assert right.state is can.BusState.ACTIVE
        assert [event.kind for event in left.events][-1] == "bus-off"
        with pytest.raises(can.CanOperationError, match="bus-off"):
            left.send(can.Message(arbitration_id=6))
        left.restart()
        clock.advance(10_000_000)
        left.send(can.Message(arbitration_id=6))
        heard = [message.arbitration_id for message in iter(lambda: witness.recv(0.1), None)]
        assert heard[-1] == 6


@pytest.mark.parametrize("physics", [True, False])
def test_threads_in_real_time(physics: bool) -> None:
    """Without a virtual clock, blocking readers in threads are woken by what is sent."""
    with opened("threads", physics=physics) as left, opened("threads", physics=physics) as right:
        got: list[can.Message | None] = []
        reader = threading.Thread(target=lambda: got.append(right.recv(5)))
        reader.start()
        left.send(can.Message(arbitration_id=0x77, is_extended_id=False))
        reader.join(5)
        assert [message.arbitration_id for message in got if message] == [0x77]


@pytest.mark.slow
def test_notifier_and_periodic_tasks() -> None:
    """python-can's Notifier and send_periodic work as on any other interface."""
    with opened("periodic") as left, opened("periodic") as right:
        enough = threading.Event()
        seen: list[can.Message] = []

        def listener(message: can.Message) -> None:
            seen.append(message)
            if len(seen) >= 3:
                enough.set()

        notifier = can.Notifier(right, [listener])
        task = left.send_periodic(can.Message(arbitration_id=9, is_extended_id=False), 0.005)
        assert enough.wait(5)
        task.stop()
        notifier.stop()


@pytest.mark.slow
def test_a_canopen_master_and_node() -> None:
    """A canopen network on the virtual bus: heartbeat state, an SDO upload and download, NMT."""
    canopen = pytest.importorskip("canopen")
    from canopen.objectdictionary import ODVariable

    objects = canopen.ObjectDictionary()
    for index, name, kind in ((0x1000, "Device type", 7), (0x2000, "Gain", 6), (0x1017, "Heartbeat", 6)):
        variable = ODVariable(name, index)
        variable.data_type, variable.access_type, variable.default = kind, "rw", 0
        objects.add_object(variable)
    master, slave = canopen.Network(), canopen.Network()
    master.connect(interface="aces", channel="canopen", bitrate=1_000_000)
    slave.connect(interface="aces", channel="canopen", bitrate=1_000_000)
    local = slave.create_node(5, objects)
    try:
        remote = master.add_node(5, objects)
        remote.sdo.RESPONSE_TIMEOUT = 5
        remote.sdo["Gain"].raw = 1234
        assert local.sdo["Gain"].raw == 1234
        assert remote.sdo["Gain"].raw == 1234
        remote.nmt.state = "OPERATIONAL"
        local.nmt.start_heartbeat(5)
        remote.nmt.wait_for_heartbeat(5)
    finally:
        local.nmt.stop_heartbeat()
        master.disconnect()
        slave.disconnect()
