"""dronecan, unmodified: its node sends and answers over our virtual bus, we decode byte for byte, and the reverse."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import can
import pytest
from construct import GreedyBytes, Struct

from aces_bus.frames import message_to_frame
from aces_bus.protocol import IdField, Protocol, TailByte
from tests.oracles.dronecan_bus import BusDriver
from tests.oracles.foreign import oracle
from tests.specs.dronecan_like import dronecan_like, signature

dronecan = oracle("dronecan", "dronecan")
#: The node that dronecan is, and ours.
THEIRS, OURS = 20, 42


@pytest.fixture
def bus() -> Iterator[can.BusABC]:
    with can.Bus(interface="aces", channel="drone", physics=False) as ours:
        yield ours


@pytest.fixture
def node(bus: can.BusABC) -> Iterator[Any]:
    """A node of dronecan at the other end of the bus."""
    theirs = can.Bus(interface="aces", channel="drone", physics=False)
    made = dronecan.node.Node(BusDriver(theirs), node_id=THEIRS)
    yield made
    made.close()


def received(bus: can.BusABC) -> list[Any]:
    """All that has arrived."""
    return [message_to_frame(message) for message in iter(lambda: bus.recv(0), None)]


def filled(value: Any, dice: random.Random) -> Any:
    """A value of some type of DSDL with random content, arrays of any length."""
    kind = dronecan.dsdl
    for name, field in dronecan.get_fields(value).items():
        of = dronecan.get_dronecan_data_type(field)
        if isinstance(of, kind.PrimitiveType):
            setattr(value, name, dice.randrange(2) if of.bitlen == 1 else dice.randrange(1, 100))
        elif isinstance(of, kind.ArrayType):
            items = range(of.max_size if of.mode == of.MODE_STATIC else dice.randint(0, min(of.max_size, 40)))
            if isinstance(of.value_type, kind.PrimitiveType):
                setattr(value, name, [dice.randrange(2) for _ in items])
        elif isinstance(of, kind.CompoundType) and not dronecan.is_union(field):
            filled(field, dice)
    return value


@pytest.mark.slow
def test_every_message_type_byte_for_byte(bus: can.BusABC, node: Any) -> None:
    """All types of dronecan's own list, short and long, several of each: the bytes are those that it serialized."""
    types = [
        one
        for (number, kind), one in dronecan.DATATYPES.items()
        if kind == one.KIND_MESSAGE and number is not None and 0 < number < 1 << 16
    ]
    protocol = Protocol("every_type", link="can")
    priority, source = IdField("priority", range(32)), IdField("node", range(1, 128))
    names = {one.default_dtid: f"Type{one.default_dtid}" for one in types}
    for one in types:
        protocol.message(
            names[one.default_dtid],
            transport=TailByte(version=0, max_size=2000),
            id=priority << 24 | one.default_dtid << 8 | source,
            extended=True,
            check_extra=signature(one.get_data_type_signature()),
            payload=Struct("data" / GreedyBytes),
        )
    sent: list[tuple[str, bytes]] = []
    node.add_transfer_hook(
        lambda transfer: sent.append((names[transfer.data_type_id], bytes(transfer.payload)))
    )
    dice = random.Random(1)
    for one in types * 3:
        node.broadcast(filled(one(), dice), priority=dice.randrange(32))
    scanner = protocol.scanner(include_unknown=True)
    got = [(type(record).__name__, getattr(record, "data", record)) for record in scanner.feed(received(bus))]
    assert got == sent
    assert len(types) > 50
    assert max(len(data) for _, data in sent) > 100
    encoder = protocol.variant().encoder
    dice = random.Random(2)
    for name, data in sent[: len(types)]:
        for message in encoder.next(name, priority=16, node=OURS, data=data):
            bus.send(message)
    back: list[tuple[str, bytes]] = []
    for transfer in transfers(node):
        back.append(
            (
                names[transfer.data_type_id],
                bytes(dronecan.transport.Transfer(payload=transfer.payload).payload),
            )
        )
    assert back == sent[: len(types)]


def transfers(node: Any) -> list[Any]:
    """What a node of dronecan takes for transfers, of all that has arrived."""
    found: list[Any] = []
    hook = node.add_transfer_hook(found.append)
    node.spin(0)
    hook.remove()
    return [transfer for transfer in found if transfer.source_node_id != THEIRS]


def test_a_node_is_read_and_asked(bus: can.BusABC, node: Any) -> None:
    """Its status has the values that it was given; our request is answered, and the long answer is read."""
    scanner = dronecan_like.scanner(include_unknown=True)
    node.broadcast(
        dronecan.uavcan.protocol.NodeStatus(uptime_sec=7, health=2, mode=3, vendor_specific_status_code=1234)
    )
    node.broadcast(
        dronecan.uavcan.equipment.esc.Status(error_count=3, voltage=24.0, current=3.5, temperature=300.0)
    )
    status, esc = scanner.feed(received(bus))
    assert (status.node, status.uptime, status.vendor_code) == (THEIRS, 7, 1234)
    assert (status.state.health, status.state.mode) == ("error", "update")
    assert (esc.errors, esc.voltage, esc.current, esc.temperature) == (3, 24.0, 3.5, 300.0)

    node.node_info.name = "a board with a name"
    for message in dronecan_like.encode("GetNodeInfo", priority=30, target=THEIRS, node=OURS):
        bus.send(message)
    node.spin(0)
    (info,) = [one for one in scanner.feed(received(bus)) if type(one).__name__ == "NodeInfo"]
    assert (info.node, info.target) == (THEIRS, OURS)
    assert info.rest.endswith(b"a board with a name")


def test_what_we_send_is_read(bus: can.BusABC, node: Any) -> None:
    """In one frame and in several: the handlers of its node have our values."""
    esc, alive = [], []
    node.add_handler(dronecan.uavcan.equipment.esc.Status, lambda event: esc.append(event.message))
    node.add_handler(dronecan.uavcan.protocol.NodeStatus, lambda event: alive.append(event))
    fields: dict[str, Any] = {"voltage": 12.5, "current": -2.0, "temperature": 290.0, "rest": bytes(5)}
    state = {"health": "critical", "mode": "offline", "sub_mode": 1}
    frames = [
        *dronecan_like.encode("EscStatus", priority=3, node=OURS, errors=5, **fields),
        *dronecan_like.encode("NodeStatus", priority=3, node=OURS, uptime=99, state=state, vendor_code=7),
    ]
    for message in frames:
        bus.send(message)
    node.spin(0)
    assert [(m.error_count, m.voltage, m.current, m.temperature) for m in esc] == [(5, 12.5, -2.0, 290.0)]
    (event,) = alive
    assert event.transfer.source_node_id == OURS
    message = event.message
    assert (message.uptime_sec, message.health, message.mode, message.sub_mode) == (99, 3, 7, 1)
    assert message.vendor_specific_status_code == 7
