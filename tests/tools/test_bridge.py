"""`aces bridge`: what comes at one end leaves at the other, as far as it is wanted, and all of it is accounted for."""

from __future__ import annotations

import os
import re
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest

from aces_tools.bus_arg import chosen_end
from aces_tools.patience import Patience
from tests.tools.live import WAIT_S, Node, Opened, interrupt

Aces = Callable[..., Any]


@pytest.fixture(autouse=True)
def hasty(quick: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The two ends are not watched for long."""
    monkeypatch.setattr("aces_tools.bridge.WATCH_S", 0.0)


@pytest.fixture
def nodes() -> Iterator[tuple[Node, Node]]:
    made = Node(), Node()
    yield made
    for node in made:
        node.close()


def end(node: Node) -> str:
    return f"aces:{node.channel}?physics=false"


def both_open(opened: Opened) -> None:
    """Wait for the second end."""
    until = time.monotonic() + WAIT_S
    while len(opened.gates) < 2:
        assert time.monotonic() < until
        time.sleep(0.005)


def received(node: Node, count: int) -> list[tuple[int, str]]:
    """So many frames that the node gets."""
    found: list[can.Message] = []
    while len(found) < count:
        more = node.received(WAIT_S)
        assert more, f"{len(found)} of {count} frames came"
        found += more
    return [(message.arbitration_id, bytes(message.data).hex()) for message in found]


def lines_of(found: Any) -> list[dict[str, int]]:
    """The summaries, one a way."""
    lines = [line for line in found.err.splitlines() if " -> " in line]
    return [{name: int(n) for name, n in re.findall(r"(\w+)=(\d+)", line)} for line in lines]


def balanced(line: dict[str, int]) -> bool:
    """Whether the parts sum to what came."""
    return line["frames"] == sum(
        line[name] for name in ("forwarded", "filtered", "skipped", "failed", "late", "unsent")
    )


def test_both_ways(aces: Aces, nodes: tuple[Node, Node], opened: Opened) -> None:
    """Frames of each end come out at the other, once and in order, whatever kind they are."""
    one, two = nodes
    got: list[list[tuple[int, str]]] = []

    def work() -> None:
        both_open(opened)
        one.send(0x123, "DEADBEEF")
        one.send(0x12345678, "00")
        two.send(0x321, "01")
        one.send(0x7FF, "", is_remote_frame=True, dlc=4)
        got.append(received(two, 3))
        got.append(received(one, 1))
        interrupt()

    opened.then(work)
    found = aces("bridge", end(one), end(two), "--tx")
    assert found.status == 0
    assert got == [[(0x123, "deadbeef"), (0x12345678, "00"), (0x7FF, "")], [(0x321, "01")]]
    there, back = lines_of(found)
    assert (there["frames"], there["forwarded"], back["frames"], back["forwarded"]) == (3, 3, 1, 1)
    assert balanced(there)
    assert balanced(back)


def test_a_way_that_fails_ends_the_bridge(
    aces: Aces, nodes: tuple[Node, Node], opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fault on one way's thread is not half a bridge that looks whole."""

    def fails(self: object, frame: object, end: str) -> bool:
        raise ZeroDivisionError

    monkeypatch.setattr("aces_tools.bridge.Selection.frame", fails)

    def work() -> None:
        both_open(opened)
        nodes[0].send(0x123, "00")

    opened.then(work)
    with pytest.raises(ZeroDivisionError):
        aces("bridge", end(nodes[0]), end(nodes[1]), "--tx")


def test_without_tx_nothing_is_sent(aces: Aces, nodes: tuple[Node, Node], opened: Opened) -> None:
    """Both ends are only listened to, and it is said what would go."""
    one, two = nodes

    def work() -> None:
        both_open(opened)
        one.send(0x123, "DEADBEEF")
        until = time.monotonic() + WAIT_S
        while not opened.gates[0].counters.received and time.monotonic() < until:
            time.sleep(0.005)
        assert all(gate.listen_only for gate in opened.gates)
        interrupt()

    opened.then(work)
    found = aces("bridge", end(one), end(two), "--filter", "100:700")
    assert found.status == 0
    assert "nothing was forwarded: add --tx" in found.messages
    assert [line["would_forward"] for line in lines_of(found)] == [1, 0]
    assert two.received() == []


def test_one_way_and_by_identifier(aces: Aces, nodes: tuple[Node, Node], opened: Opened) -> None:
    """candump's filters choose; of one way the first end has no way to send."""
    one, two = nodes
    got: list[Any] = []

    def work() -> None:
        both_open(opened)
        two.send(0x060, "FF")
        for identifier in (0x060, 0x300, 0x061, 0x7FE):
            one.send(identifier, "01")
        got.append(received(two, 2))
        assert opened.gates[0].listen_only
        interrupt()

    opened.then(work)
    found = aces("bridge", end(one), end(two), "--tx", "--one-way", "--filter", "060:7F0")
    assert got == [[(0x060, "01"), (0x061, "01")]]
    (line,) = lines_of(found)
    assert (line["forwarded"], line["filtered"]) == (2, 2)
    assert balanced(line)
    assert one.received() == []


def test_by_message_and_value(aces: Aces, nodes: tuple[Node, Node], opened: Opened, arm: str) -> None:
    """--message and --where choose records; a reply is known by its request from the other end."""
    one, two = nodes
    got: list[Any] = []

    def work() -> None:
        both_open(opened)
        one.send(0x060, "0A000000F6FFFFFF")
        one.send(0x061, "0A000000F6FFFFFF")
        one.send(0x300, "02090064000080BF")
        one.send(0x001, "002407")
        got.append(received(two, 2))
        two.send(0x1C0, "0100FFFF")
        got.append(received(one, 1))
        interrupt()

    opened.then(work)
    where = ["-m", "Encoder", "-m", "Gains,Get", "--where", "board=0"]
    found = aces("bridge", end(one), end(two), "--tx", "-p", arm, *where)
    assert got == [[(0x060, "0a000000f6ffffff"), (0x001, "002407")], [(0x1C0, "0100ffff")]]
    assert all(balanced(line) for line in lines_of(found))


def test_two_names_of_one_wire(
    aces: Aces, nodes: tuple[Node, Node], opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where both ends receive the same frames nothing is forwarded: it would come back for ever."""
    one, two = nodes

    def watched(patience: Patience, instant: int) -> bool:
        """The time in which both are watched is over when all frames have come."""
        until = time.monotonic() + WAIT_S
        while any(gate.counters.received < 5 for gate in opened.gates):
            assert time.monotonic() < until
            time.sleep(0.005)
        return True

    monkeypatch.setattr(Patience, "wait_until", watched)

    def work() -> None:
        both_open(opened)
        for node in nodes:
            for number in range(5):
                node.send(0x100 + number, f"{number:02X}")

    opened.then(work)
    found = aces("bridge", end(one), end(two), "--tx", "--one-way")
    assert found.status == 2
    assert "receive the same frames: they are one wire" in found.err
    assert len(two.received()) == 0


def test_what_a_bus_refuses_is_counted(aces: Aces, opened: Opened) -> None:
    """A classic bus takes no CAN FD frame: that is said, counted, and status 1."""
    one, two = Node(fd=True), Node()

    def work() -> None:
        both_open(opened)
        one.send(0x100, "00" * 12, is_fd=True)
        one.send(0x101, "01")
        received(two, 1)
        interrupt()

    try:
        opened.then(work)
        found = aces("bridge", f"{end(one)}&fd=true", end(two), "--tx", "--one-way")
    finally:
        one.close()
        two.close()
    (line,) = lines_of(found)
    assert (found.status, line["frames"], line["forwarded"], line["failed"]) == (1, 2, 1, 1)
    assert balanced(line)


posix = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals of a Unix system")


@posix
def test_packets_of_a_line_as_datagrams(aces: Aces, opened: Opened) -> None:
    """With a protocol each packet is one datagram, whatever the pieces were; what is none goes too, and none is lost."""
    import tty

    far, near = os.openpty()
    tty.setraw(near)
    name = os.ttyname(near)
    packet, other = bytes.fromhex("FFFF010200FC"), bytes.fromhex("FFFF020200FB")
    got: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sink:
        sink.bind(("127.0.0.1", 0))
        sink.settimeout(WAIT_S)

        def work() -> None:
            both_open(opened)
            for piece in (packet[:2], packet[2:] + b"\x00" + other[:3], other[3:]):
                os.write(far, piece)
            got.extend(sink.recv(100) for _ in range(3))
            interrupt()

        opened.then(work)
        target = f"udp:{sink.getsockname()[1]}"
        more = ["-p", "robotis", "--direction", "from"]
        found = aces("bridge", name, target, "--tx", "--one-way", *more)
    for one in (far, near):
        os.close(one)
    assert got == [packet, b"\x00", other]
    (line,) = lines_of(found)
    assert (found.status, line["datagrams"], line["forwarded"]) == (0, 3, 3)


@posix
def test_bytes_of_two_lines_as_they_come(aces: Aces, opened: Opened) -> None:
    """Without a protocol all bytes go, both ways."""
    import tty

    lines = [os.openpty(), os.openpty()]
    for _, near in lines:
        tty.setraw(near)
    got: list[bytes] = []

    def read(file: int, size: int) -> bytes:
        data = b""
        while len(data) < size:
            data += os.read(file, size)
        return data

    def work() -> None:
        both_open(opened)
        os.write(lines[0][0], bytes(range(200)))
        os.write(lines[1][0], b"back")
        got.extend([read(lines[1][0], 200), read(lines[0][0], 4)])
        interrupt()

    opened.then(work)
    found = aces("bridge", *(os.ttyname(near) for _, near in lines), "--tx")
    for pair in lines:
        for one in pair:
            os.close(one)
    assert got == [bytes(range(200)), b"back"]
    assert [line["forwarded"] for line in lines_of(found)] == [200, 4]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["aces:x", "aces:x", "--tx"], "are one bus: everything would come back for ever"),
        (["aces:x?physics=false", "aces:x"], "are one bus"),
        (["/dev/ttyS1@9600", "/dev/../dev/ttyS1"], "are one bus"),
        (["udp:5000", "udp:127.0.0.1:5000"], "are one bus"),
        (
            ["aces:x", "/dev/ttyS1"],
            "one has frames, the other bytes; a serial CAN adapter is a CAN bus: slcan:",
        ),
        (["aces:x", "aces:y", "-p", "robotis"], "robotis is not spoken on CAN"),
        (["/dev/ttyS1", "udp:1", "-p", "hubo"], "hubo is spoken on CAN"),
        (["aces:x", "aces:y", "-m", "Encoder"], "name a protocol: -p NAME"),
        (["/dev/ttyS1", "udp:1", "--filter", "060:7F0"], "--filter is for CAN frames, and these are bytes"),
        (["/dev/ttyS1", "udp:1", "-p", "robotis"], "--direction"),
        (["/dev/ttyS1", "udp:1", "--rate", "5"], "--rate is for CAN"),
        (["aces:x?fd", "aces:y"], "behind ? write option=value"),
        (["aces:x"], "b"),
        (["aces:x", "aces:y", "-p", "obd2", "-m", "*"], "messages of several frames cannot be chosen"),
    ],
)
def test_wrong_calls(aces: Aces, arguments: list[str], said: str) -> None:
    """One line says what is wrong and what would work; nothing is opened."""
    found = aces("bridge", *arguments)
    assert found.status == 2
    assert said in found.err
    assert len(found.err.splitlines()) == 1


def test_names_of_ends() -> None:
    """An interface of python-can with its options, a serial line with its speed, an address."""
    adapter = chosen_end("slcan:/dev/ttyACM0@500000?ttyBaudrate=115200")
    assert dict(adapter.options) == {
        "interface": "slcan",
        "channel": "/dev/ttyACM0",
        "bitrate": 500_000,
        "ttyBaudrate": 115_200,
    }
    line = chosen_end("/dev/ttyUSB0@57600?half_duplex=true")
    assert dict(line.options) == {"url": "/dev/ttyUSB0", "baud": 57_600, "half_duplex": True}
    assert chosen_end("socket://host:4000").options["url"] == "socket://host:4000"
    assert chosen_end("udp:192.168.1.7:5000").options["address"] == ("192.168.1.7", 5000)
