"""pycyphal, unmodified, through a media of ours: what it sends we decode byte for byte, and what we send it receives."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import can
import pytest

from aces_bus.frames import message_to_frame
from tests.oracles.foreign import oracle
from tests.specs.cyphal_like import cyphal_like

cyphal = oracle("pycyphal.transport", "pycyphal")
can_transport = oracle("pycyphal.transport.can", "pycyphal")
media = oracle("pycyphal.transport.can.media", "pycyphal")
#: The node that pycyphal is, and ours.
THEIRS, OURS = 123, 42
#: Seconds that a slow machine has.
PATIENCE_S = 30.0
SIZES = [0, 1, 6, 7, 8, 11, 12, 13, 14, 20, 61, 62, 63, 64, 100, 300]


class BusMedia(media.Media):  # type: ignore[name-defined,misc]
    """A bus of python-can as pycyphal has its media."""

    def __init__(self, bus: can.BusABC, mtu: int) -> None:
        self.bus, self._mtu = bus, mtu
        self._handler: Callable[[Any], None] = lambda frames: None

    interface_name, number_of_acceptance_filters = "aces", 1

    @property
    def mtu(self) -> int:
        return self._mtu

    def start(self, handler: Any, no_automatic_retransmission: bool, error_handler: Any = None) -> None:
        self._handler = handler

    def configure_acceptance_filters(self, configuration: Sequence[Any]) -> None:
        """Everything comes."""

    async def send(self, frames: Iterable[Any], monotonic_deadline: float) -> int:
        """Send at once."""
        sent = 0
        for envelope in frames:
            frame, is_fd = envelope.frame, self._mtu > 8
            self.bus.send(
                can.Message(
                    arbitration_id=frame.identifier,
                    data=frame.data,
                    is_fd=is_fd,
                    is_extended_id=frame.format == media.FrameFormat.EXTENDED,
                )
            )
            sent += 1
        return sent

    def receive(self) -> None:
        """Hand over what has arrived."""
        for message in iter(lambda: self.bus.recv(0), None):
            frame = media.DataFrame(
                media.FrameFormat.EXTENDED, message.arbitration_id, bytearray(message.data)
            )
            self._handler([(cyphal.Timestamp.now(), media.Envelope(frame, loopback=False))])

    def close(self) -> None:
        self.bus.shutdown()


@pytest.fixture
def buses() -> Iterator[tuple[can.BusABC, can.BusABC]]:
    """The two ends of a bus."""
    both = [can.Bus(interface="aces", channel="cyphal", physics=False, fd=True) for _ in range(2)]
    yield both[0], both[1]
    for bus in both:
        bus.shutdown()


def transfer(data: bytes, number: int = 0) -> Any:
    return cyphal.Transfer(cyphal.Timestamp.now(), cyphal.Priority.NOMINAL, number, [memoryview(data)])


def pattern(size: int) -> bytes:
    return bytes((7 * place + size) & 0xFF for place in range(size))


def received(bus: can.BusABC) -> list[Any]:
    return [message_to_frame(message) for message in iter(lambda: bus.recv(0), None)]


@pytest.mark.parametrize(("name", "number", "mtu"), [("Array", 4919, 8), ("LongArray", 4920, 64)])
def test_subjects_both_ways(buses: tuple[can.BusABC, can.BusABC], name: str, number: int, mtu: int) -> None:
    """Of all lengths, in classic frames and in CAN FD, where zeros fill up the last frame."""
    bus, theirs = buses
    subject, metadata = cyphal.MessageDataSpecifier(number), cyphal.PayloadMetadata(1024)

    async def talk() -> list[bytes]:
        node = can_transport.CANTransport(BusMedia(theirs, mtu), THEIRS)
        out = node.get_output_session(cyphal.OutputSessionSpecifier(subject, None), metadata)
        into = node.get_input_session(cyphal.InputSessionSpecifier(subject, None), metadata)
        deadline = asyncio.get_running_loop().time() + PATIENCE_S
        for count, size in enumerate(SIZES):
            assert await out.send(transfer(pattern(size), count), deadline)
        records = cyphal_like.scanner(include_unknown=True).feed(received(bus))
        assert [(type(one).__name__, one.node, one.priority) for one in records] == [
            (name, THEIRS, "nominal") for _ in SIZES
        ]
        for size, record in zip(SIZES, records, strict=True):
            assert record.data[:size] == pattern(size)
            assert not any(record.data[size:])
            assert len(record.data) == size or mtu == 64

        encoder = cyphal_like.variant().encoder
        got = []
        for size in SIZES:
            carrier = cyphal_like[name].transport
            assert carrier is not None
            fill = next(n for n in range(64) if carrier.carries(size + n))
            data = pattern(size) + bytes(fill)
            for message in encoder.next(name, priority="fast", reserved_bits=3, node=OURS, data=data):
                bus.send(message)
            node._maybe_media.receive()
            one = await into.receive(deadline)
            assert (one.source_node_id, one.priority) == (OURS, cyphal.Priority.FAST)
            got.append(b"".join(bytes(piece) for piece in one.fragmented_payload))
        out.close()
        into.close()
        node.close()
        return got

    for size, data in zip(SIZES, asyncio.run(talk()), strict=True):
        assert data[:size] == pattern(size)
        assert not any(data[size:])


def test_services_both_ways(buses: tuple[can.BusABC, can.BusABC]) -> None:
    """We ask and it answers, in several frames; it asks and we answer."""
    bus, theirs = buses
    role, metadata = cyphal.ServiceDataSpecifier.Role, cyphal.PayloadMetadata(1024)
    info = pattern(40)

    async def talk() -> None:
        node = can_transport.CANTransport(BusMedia(theirs, 8), THEIRS)
        deadline = asyncio.get_running_loop().time() + PATIENCE_S
        request, response = (cyphal.ServiceDataSpecifier(430, one) for one in (role.REQUEST, role.RESPONSE))
        asked = node.get_input_session(cyphal.InputSessionSpecifier(request, None), metadata)
        answer = node.get_output_session(cyphal.OutputSessionSpecifier(response, OURS), metadata)
        scanner = cyphal_like.scanner(include_unknown=True)
        for message in cyphal_like.encode("GetInfo", priority="nominal", node=OURS, target=THEIRS):
            bus.send(message)
        node._maybe_media.receive()
        question = await asked.receive(deadline)
        assert (question.source_node_id, question.fragmented_payload) in ((OURS, []), (OURS, [b""]))
        await answer.send(transfer(info, question.transfer_id), deadline)
        (record,) = scanner.feed(received(bus))
        assert (type(record).__name__, record.node, record.target) == ("Info", THEIRS, OURS)
        assert record.protocol + record.hardware + record.software + record.rest == info

        ask = node.get_output_session(cyphal.OutputSessionSpecifier(request, OURS), metadata)
        answered = node.get_input_session(cyphal.InputSessionSpecifier(response, OURS), metadata)
        await ask.send(transfer(b"", 5), deadline)
        (record,) = scanner.feed(received(bus))
        assert (type(record).__name__, record.node, record.target) == ("GetInfo", THEIRS, OURS)
        number = record.meta.frames[0][-1] & 0x1F
        fields: dict[str, Any] = {
            "protocol": info[:2],
            "hardware": info[2:4],
            "software": info[4:6],
            "rest": info[6:],
        }
        encoder = cyphal_like.variant().encoder
        for message in encoder.numbered(
            number, "Info", priority="nominal", node=OURS, target=THEIRS, **fields
        ):
            bus.send(message)
        node._maybe_media.receive()
        reply = await answered.receive(deadline)
        assert reply.transfer_id == 5
        assert b"".join(bytes(piece) for piece in reply.fragmented_payload) == info
        node.close()

    asyncio.run(talk())
