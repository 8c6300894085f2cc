"""canopen's SDO client and server, unmodified, on our virtual bus: segmented transfers both ways, as a bystander reads them.

Its times are real ones: what is asserted is order and content, with limits that a slow machine keeps.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import can
import pytest

from aces_bus import Frame
from aces_bus.frames import message_to_frame
from aces_protocols.canopen.spec import canopen as shipped
from tests.oracles.foreign import oracle
from tests.specs.sdo_like import sdo_like

canopen = oracle("canopen", "canopen")
NODE, INDEX = 5, 0x2000
#: Seconds that a slow machine has.
PATIENCE_S = 30.0
CHANNEL: dict[str, Any] = {"interface": "aces", "channel": "objects", "physics": False}


@pytest.fixture(scope="module")
def both() -> Iterator[tuple[Any, Any]]:
    """A client and the node that it speaks to; the node has one object of any length."""
    dictionary = canopen.ObjectDictionary()
    variable = canopen.objectdictionary.ODVariable("data", INDEX)
    variable.data_type = canopen.objectdictionary.DOMAIN
    variable.access_type = "rw"
    dictionary.add_object(variable)
    client_side, node_side = canopen.Network(), canopen.Network()
    for network in (client_side, node_side):
        network.connect(**CHANNEL)
    client = client_side.add_node(canopen.RemoteNode(NODE, dictionary))
    client.sdo.RESPONSE_TIMEOUT = PATIENCE_S
    node = node_side.create_node(NODE, dictionary)
    yield client.sdo, node
    for network in (client_side, node_side):
        network.disconnect()


@pytest.fixture
def bus() -> Iterator[can.BusABC]:
    with can.Bus(**CHANNEL) as ours:
        yield ours


def check_shipped(record: Any, name: str) -> None:
    """The shipped protocol's dialect for who reads along says the same of the same frames."""
    frames = [Frame(record.meta.identifier, data) for data in record.meta.frames]
    (same,) = shipped.scanner(dialect="transfers", include_unknown=True).feed(frames)
    assert (type(same).__name__, same.node, same.index, same.data) == (name, NODE, INDEX, record.data)


def text(size: int) -> bytes:
    return bytes((11 * place + size) & 0xFF for place in range(size))


def read_until(bus: can.BusABC, name: str) -> tuple[list[str], Any, Any]:
    """What comes, up to the first record of a message; that record, and the frames it was in."""
    scanner = sdo_like.scanner(include_unknown=True)
    found: list[str] = []
    while True:
        message = bus.recv(PATIENCE_S)
        assert message is not None, found
        for one in scanner.feed([message_to_frame(message)]):
            found.append(getattr(one, "reason", type(one).__name__))
            if found[-1] == name:
                return found, one, scanner.counts


@pytest.mark.parametrize("size", [5, 7, 8, 14, 1785 // 5])
def test_what_canopen_writes_and_reads_back_is_one_record_each(
    both: tuple[Any, Any], bus: can.BusABC, size: int
) -> None:
    """Byte for byte, and our encoder makes the same frames; nothing is lost or malformed on the way."""
    sdo, node = both
    data = text(size)
    count = -(-size // 7)
    sdo.download(INDEX, 0, data)
    found, record, counts = read_until(bus, "Write")
    assert (record.node, record.index, record.subindex, record.data) == (NODE, INDEX, 0, data)
    assert counts.malformed == counts.unknown == 0
    assert found.count("control: segment taken") == count - 1
    assert node.get_data(INDEX, 0) == data
    ours = sdo_like.encode("Write", node=NODE, sized=record.sized, index=INDEX, subindex=0, data=data)
    assert tuple(bytes(one.data) for one in ours) == record.meta.frames
    check_shipped(record, "SdoDownloadTransfer")
    assert sdo.upload(INDEX, 0) == data
    found, record, counts = read_until(bus, "Object")
    assert found == ["control: segment taken", "Read", *["control: segment request"] * count, "Object"]
    assert (record.node, record.index, record.data) == (NODE, INDEX, data)
    check_shipped(record, "SdoUploadTransfer")
    ours = sdo_like.encode("Object", node=NODE, sized=record.sized, index=INDEX, subindex=0, data=data)
    assert tuple(bytes(one.data) for one in ours) == record.meta.frames


def test_a_refusal_of_canopen_s_server_is_a_message(both: tuple[Any, Any], bus: can.BusABC) -> None:
    """An object that it does not have."""
    with pytest.raises(canopen.SdoAbortedError):
        both[0].upload(0x3000, 0)
    _, record, _ = read_until(bus, "Refused")
    assert (record.index, record.code) == (0x3000, 0x06020000)


def test_our_frames_are_what_canopen_s_server_takes(both: tuple[Any, Any], bus: can.BusABC) -> None:
    """One after another, each when the one before it is taken."""
    data = text(100)
    for frame in sdo_like.encode("Write", node=NODE, sized=1, index=INDEX, subindex=0, data=data):
        bus.send(can.Message(arbitration_id=frame.arbitration_id, data=frame.data, is_extended_id=False))
        answer = bus.recv(PATIENCE_S)
        assert answer is not None
        assert answer.data[0] >> 5 in (1, 3)
    assert both[1].get_data(INDEX, 0) == data
