"""Requests and replies on a bare bus."""

from __future__ import annotations

from collections import deque
from typing import Any

import pytest
from construct import Const, GreedyBytes, Int8ub, Int16ub, Struct

from aces_bus import Frame
from aces_bus.device import Client
from aces_bus.errors import CallerError, NoReplyError
from aces_bus.protocol import IdField, IsoTp, Protocol, Sum

lamp = Protocol("lamp", link="can")
_node = IdField("node", range(8))
_ask = lamp.message("Ask", id=0x100 + _node, payload=Struct("what" / Int8ub), direction="to device")
lamp.message(
    "Answer", id=0x200 + _node, payload=Struct("level" / Int16ub), direction="from device", reply_to=_ask
)
lamp.message("Beat", id=0x300 + _node, payload=Struct("count" / Int8ub), direction="from device")
lamp.message("Set", id=0x180 + _node, payload=Struct("level" / Int16ub), direction="to device")

line = Protocol("line", link="serial")
_packets = line.framing(
    sync=b"\xa5", header=Struct("id" / Int8ub, "kind" / Int8ub), size=5, check=Sum(over=slice(0, 4))
)
_read = _packets("Read", match={"kind": 1}, payload=Struct("what" / Int8ub), direction="to device")
_packets(
    "Value", match={"kind": 2}, payload=Struct("value" / Int8ub), direction="from device", reply_to=_read
)


diagnostics = Protocol("diagnostics", link="can")
_isotp = IsoTp(to_device=0x7E0, from_device=0x7E8)
_request = diagnostics.message(
    "Ask", transport=_isotp, direction="to device", payload=Struct(Const(0x22, Int8ub), "data" / GreedyBytes)
)
diagnostics.message(
    "Answer",
    transport=_isotp,
    direction="from device",
    reply_to=_request,
    payload=Struct(Const(0x62, Int8ub), "data" / GreedyBytes),
)


class FakeBus:
    """What python-can has: a script says what comes after each frame that is sent; then nothing does, at once."""

    def __init__(self, *replies: list[Frame]) -> None:
        self.replies, self.coming = deque(replies), deque[Frame]()
        self.sent: list[Any] = []

    def send(self, frame: Any) -> None:
        self.sent.append(frame)
        self.coming.extend(self.replies.popleft() if self.replies else ())

    def recv(self, timeout: float | None = None) -> Frame | None:
        return self.coming.popleft() if self.coming else None


class FakePort:
    """What pyserial has."""

    timeout: float | None = None

    def __init__(self, *replies: bytes) -> None:
        self.replies, self.coming = deque(replies), b""

    def write(self, data: bytes) -> None:
        self.coming += self.replies.popleft()

    @property
    def in_waiting(self) -> int:
        return len(self.coming)

    def read(self, size: int) -> bytes:
        data, self.coming = self.coming[:size], self.coming[size:]
        return data


def test_a_request_is_answered() -> None:
    """By the message that the spec says, of the node that was asked; what else comes is kept."""
    bus = FakeBus(
        [Frame(0x305, b"\x01"), Frame(0x203, b"\0\x09"), Frame(0x205, b"\x01\x02"), Frame(0x305, b"\x02")]
    )
    client = Client(bus, lamp)
    answer: Any = client.ask("Ask", node=5, what=7)
    assert (type(answer).__name__, answer.node, answer.level) == ("Answer", 5, 258)
    assert (bus.sent[0].arbitration_id, bytes(bus.sent[0].data)) == (0x105, b"\x07")
    assert [str(record) for record in client.listen(0.01)] == [
        "Beat(node=5, count=1)",
        "Answer(node=3, level=9)",
        "Beat(node=5, count=2)",
    ]


def test_no_answer() -> None:
    """Is an error that says what was waited for."""
    with pytest.raises(NoReplyError, match=r"Ask was not answered within 0.01 s \(Answer\)"):
        Client(FakeBus([Frame(0x204, b"\0\0")]), lamp).ask("Ask", node=5, what=7, timeout=0.01)


def test_what_came_before_is_no_answer() -> None:
    """An answer that was late for an earlier request is kept, and not taken for the answer to this one."""
    bus = FakeBus([Frame(0x205, b"\0\x02")])
    bus.coming.append(Frame(0x205, b"\0\x01"))
    client = Client(bus, lamp)
    assert str(client.ask("Ask", node=5, what=7)) == "Answer(node=5, level=2)"
    assert [str(record) for record in client.listen(0.01)] == ["Answer(node=5, level=1)"]


def test_a_reply_that_the_spec_does_not_know() -> None:
    """Is named by the caller, or refused before anything is sent."""
    bus = FakeBus([Frame(0x305, b"\x07")])
    with pytest.raises(CallerError, match="no reply to Set in the spec; say which it is: reply="):
        Client(bus, lamp).ask("Set", node=5, level=1)
    assert bus.sent == []
    assert str(Client(bus, lamp).ask("Set", reply="Beat", node=5, level=1)) == "Beat(node=5, count=7)"


def test_messages_of_a_transport() -> None:
    """One frame goes and comes as any other; several would need a handshake, and are refused before anything is sent."""
    bus = FakeBus([Frame(0x7E8, bytes.fromhex("03 62 00 07"))])
    client = Client(bus, diagnostics)
    answer: Any = client.ask("Ask", data=b"\x07")
    assert (type(answer).__name__, answer.data) == ("Answer", b"\0\x07")
    with pytest.raises(CallerError, match="takes 3 frames, and a client keeps no handshake"):
        client.ask("Ask", data=bytes(14))
    assert [bytes(frame.data) for frame in bus.sent] == [b"\x02\x22\x07"]


def test_on_a_serial_line() -> None:
    """The same with a pyserial port; garbage and pieces do no harm."""

    def packet(number: int, kind: int, value: int) -> bytes:
        body = bytes([0xA5, number, kind, value])
        return body + bytes([sum(body) & 0xFF])

    port = FakePort(b"??" + packet(3, 2, 9) + packet(4, 2, 77))
    answer: Any = Client(port, line).ask("Read", id=4, what=1)
    assert answer.value == 77


def test_a_bus_of_another_kind() -> None:
    """Is refused by name."""
    with pytest.raises(CallerError, match="line is spoken on serial: a client needs a pyserial port"):
        Client(FakeBus(), line)
    with pytest.raises(CallerError, match="lamp is spoken on can: a client needs a python-can bus"):
        Client(FakePort(), lamp)
