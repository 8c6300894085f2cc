"""python-can-isotp and udsoncan, unmodified, on the virtual bus: what they send we read, what our twins send they read."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from typing import Any

import can
import pytest
from construct import Const, GreedyBytes, Struct

from aces_bus import Frame, Unknown
from aces_bus.device import Device, Driver, Twin, on
from aces_bus.frames import message_to_frame
from aces_bus.hardware import CanGate
from aces_bus.hardware.ports import port_of
from aces_bus.protocol import IsoTp, Protocol
from aces_bus.robot import parse_robot
from aces_bus.robot.rig import simulate
from aces_bus.runtime.loop import Loop
from tests.device.ecu import LOAD, robot_of_ecu
from tests.oracles.foreign import oracle

isotp: Any = oracle("isotp", "can-isotp")
udsoncan: Any = oracle("udsoncan", "udsoncan")
#: A limit that a machine twenty times slower keeps, too.
PATIENCE_S = 30.0
SIZES = (1, 7, 8, 20, 62, 300, 4095)


def buses(count: int, *, fd: bool = False) -> list[Any]:
    """Nodes of a virtual bus without physics."""
    channel = f"isotp-{uuid.uuid4().hex[:8]}"
    return [can.Bus(interface="aces", channel=channel, physics=False, fd=fd) for _ in range(count)]


#: Our transport, and theirs: both ends' addresses and parameters.
KINDS: dict[str, tuple[IsoTp, int, bytes, dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    "normal": (
        IsoTp(to_device=0x7E0, from_device=0x7E8), 0x7E0, b"",
        {"txid": 0x7E0, "rxid": 0x7E8}, {"txid": 0x7E8, "rxid": 0x7E0}, {},
    ),
    "extended": (
        IsoTp(addressing="extended", to_device=0x600, from_device=0x601), 0x600, b"\x55",
        {"txid": 0x600, "rxid": 0x601, "source_address": 0xAA, "target_address": 0x55},
        {"txid": 0x601, "rxid": 0x600, "source_address": 0x55, "target_address": 0xAA}, {},
    ),
    "mixed": (
        IsoTp(addressing="mixed", extended=True, to_device=0x18CE10F1, from_device=0x18CEF110), 0x18CE10F1, b"\x99",
        {"source_address": 0xF1, "target_address": 0x10, "address_extension": 0x99},
        {"source_address": 0x10, "target_address": 0xF1, "address_extension": 0x99}, {},
    ),
    "fd": (
        IsoTp(fd=True, to_device=0x7E0, from_device=0x7E8), 0x7E0, b"",
        {"txid": 0x7E0, "rxid": 0x7E8}, {"txid": 0x7E8, "rxid": 0x7E0}, {"can_fd": True, "tx_data_length": 64},
    ),
}  # fmt: skip
MODES = {
    "normal": "Normal_11bits",
    "extended": "Extended_11bits",
    "mixed": "Mixed_29bits",
    "fd": "Normal_11bits",
}


@pytest.mark.parametrize("kind", KINDS)
def test_what_they_say_to_each_other_we_read(kind: str) -> None:
    """Two ends of python-can-isotp exchange packets of all sizes; beside them our scanner has each, byte for byte."""
    ours, number, address, near, far, params = KINDS[kind]
    protocol = Protocol("sniffed", link="can")
    protocol.message(
        "Packet", transport=ours, id=number, extended=ours.extended, payload=Struct("data" / GreedyBytes)
    )
    mode = getattr(isotp.AddressingMode, MODES[kind])
    one, other, listener = buses(3, fd=bool(params))
    params = {**params, "stmin": 0, "blocksize": 8, "blocking_send": True}
    sender = isotp.CanStack(one, address=isotp.Address(mode, **near), params=params)
    receiver = isotp.CanStack(
        other, address=isotp.Address(mode, **far), params={**params, "blocking_send": False}
    )
    sender.start()
    receiver.start()
    try:
        packets = [bytes((size + k) & 0xFF for k in range(size)) for size in SIZES]
        for packet in packets:
            sender.send(packet, send_timeout=PATIENCE_S)
            assert receiver.recv(block=True, timeout=PATIENCE_S) == packet
    finally:
        sender.stop()
        receiver.stop()
    frames = []
    while (message := listener.recv(0)) is not None:
        frames.append(message_to_frame(message, message.timestamp))
    scanner = protocol.scanner(include_unknown=True)
    given = scanner.feed(frames)
    assert [one.data for one in given if not isinstance(one, Unknown)] == [
        address + packet for packet in packets
    ]
    counts = scanner.counts
    assert counts.decoded + counts.control == counts.total == len(frames)
    assert counts.control > 2
    # What they send is what we would send.
    encoded = [frame for packet in packets for frame in protocol.encode("Packet", data=address + packet)]
    mine = [bytes(frame.data) for frame in encoded]
    theirs = [
        frame.data for frame in frames if frame.arbitration_id == number and not _is_control(frame, ours)
    ]
    assert mine == theirs
    for bus in (one, other, listener):
        bus.shutdown()


def _is_control(frame: Frame, transport: IsoTp) -> bool:
    return frame.data[transport.address] >> 4 == 3


@pytest.fixture
def ecu() -> Iterator[tuple[Any, Any]]:
    """Another node of the bus that our twin of an ECU is on, in real time; and the twin."""
    channel = f"isotp-{uuid.uuid4().hex[:8]}"
    options: dict[str, Any] = {"interface": "aces", "channel": channel, "physics": False}
    with (
        can.Bus(**options) as theirs,
        Loop("twins") as loop,
        simulate(robot_of_ecu(), {"line": port_of(CanGate(options), loop)}, load=LOAD) as twins,
    ):
        yield theirs, twins.twins["A"]


def _connection(bus: Any) -> Any:
    """A UDS connection of udsoncan over python-can-isotp, to ECU 1."""
    from udsoncan.connections import PythonIsoTpConnection

    address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E1, rxid=0x7E9)
    return PythonIsoTpConnection(isotp.CanStack(bus, address=address, params={"stmin": 0, "blocksize": 3}))


def test_udsoncan_reads_and_writes_our_twin(ecu: tuple[Any, Any]) -> None:
    """A UDS client reads a long value (with flow control after every three frames) and writes one."""
    bus, twin = ecu

    class Text(udsoncan.DidCodec):  # type: ignore[misc]
        def encode(self, value: bytes) -> bytes:
            return bytes(value)

        def decode(self, payload: bytes) -> bytes:
            return bytes(payload)

        def __len__(self) -> int:
            raise udsoncan.DidCodec.ReadAllRemainingData

    from udsoncan.client import Client

    config: Any = {**udsoncan.configs.default_client_config, "data_identifiers": {1: Text, 2: Text}}
    config |= {"request_timeout": PATIENCE_S, "p2_timeout": PATIENCE_S, "p2_star_timeout": PATIENCE_S}
    client: Any = Client(_connection(bus), config=config)
    with client:
        answer = client.read_data_by_identifier(1)
        assert answer.service_data.values[1] == bytes.fromhex("0007") + bytes(30)
        data = bytes(range(256)) * 2
        assert client.write_data_by_identifier(2, data).positive
    assert twin.written == data


#: How our twin and their end are addressed; the twin's first byte, and the answer's.
ADDRESSED: dict[str, tuple[IsoTp, bytes, bytes, dict[str, Any]]] = {
    "extended": (
        IsoTp(addressing="extended", to_device=0x600, device_address=0x55, from_device=0x601, tester_address=0xAA),
        b"\x55", b"\xaa", KINDS["extended"][3],
    ),
    "mixed": (KINDS["mixed"][0], b"\x99", b"\x99", KINDS["mixed"][3]),
}  # fmt: skip


@pytest.mark.parametrize("kind", ADDRESSED)
def test_addressed_packets_go_both_ways(kind: str) -> None:
    """Our twin lets their long packets go on, and their flow control ours: with an address in each frame."""
    carrier, to_us, from_us, near = ADDRESSED[kind]
    protocol = Protocol(f"{kind}_echo", link="can")
    ways: tuple[tuple[str, Any, bytes], ...] = (("Say", "to device", to_us), ("Echo", "from device", from_us))
    for name, direction, address in ways:
        inside = Struct(Const(address), "data" / GreedyBytes)
        protocol.message(
            name, transport=carrier, direction=direction, extended=carrier.extended, payload=inside
        )

    class Spoken(Device):
        """Only answered."""

    class Echoing(Twin):
        """Says it again."""

        @on("Say")
        def echo(self, request: Any) -> None:
            self.reply("Echo", data=request.data)

    Spoken.protocol = Echoing.protocol = protocol
    text = f"""
    name = "echo"
    [buses]
    line = {{ link = "can", protocol = "{protocol.name}" }}
    [devices]
    A = {{ driver = "echo", bus = "line" }}
    """
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    driver = Driver("echo", Spoken, Echoing, text, doc="an echo", source="invented for tests")
    channel = f"isotp-{uuid.uuid4().hex[:8]}"
    options: dict[str, Any] = {"interface": "aces", "channel": channel, "physics": False}
    with (
        can.Bus(**options) as theirs,
        Loop("twins") as loop,
        simulate(robot, {"line": port_of(CanGate(options), loop)}, load={"echo": driver}.__getitem__),
    ):
        mode = getattr(isotp.AddressingMode, MODES[kind])
        params = {"stmin": 0, "blocksize": 3, "rx_flowcontrol_timeout": 30_000}
        stack = isotp.CanStack(theirs, address=isotp.Address(mode, **near), params=params)
        stack.start()
        try:
            for size in (1, 7, 30, 300):
                data = bytes(k & 0xFF for k in range(size))
                stack.send(data)
                assert stack.recv(block=True, timeout=PATIENCE_S) == data
        finally:
            stack.stop()
