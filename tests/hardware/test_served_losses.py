"""A served bus and those who do not read, say nonsense, or say nothing."""

from __future__ import annotations

import socket
import threading
from contextlib import ExitStack
from pathlib import Path

import can
import pytest

from aces_bus.hardware.served import channel as channel_module
from aces_bus.hardware.served import packets
from aces_bus.hardware.served import server as server_module
from aces_bus.hardware.served.address import parse_address, parse_host
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.stream import ServerConnection

from .serving import PATIENCE, Open, message, received, serve, until, with_unix_sockets

pytestmark = with_unix_sockets


def plain(address: str = "unix:can0") -> ServerConnection:
    """A client that speaks by hand."""
    return ServerConnection(parse_address(address), packets.Hello())


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


def test_many_members(opened: Open) -> None:
    """Each of many members receives each frame once."""
    with serve(ServedChannel(physics=False)):
        buses = [opened() for _ in range(20)]
        for number in (0, 19):
            buses[number].send(message(number))
        for place, bus in enumerate(buses):
            wanted = [number for number in (0, 19) if number != place]
            assert sorted(one.arbitration_id for one in received(bus, len(wanted))) == wanted
        buses.pop().shutdown()
        assert all(bus.recv(0) is None for bus in buses)
        assert buses[0].status()["channels"][0]["frames"] == 2


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
        bad = parse_address("unix:can0").connect(PATIENCE)
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


def test_a_socketcand_client_that_never_ends_a_command(opened: Open) -> None:
    """A command has a length; who goes on is cut off."""
    with serve(socketcand=("127.0.0.1", 0)) as server:
        bad = socket.create_connection(parse_host(server.socketcand, None), PATIENCE)
        assert bad.recv(100) == b"< hi >"
        try:
            for _ in range(100):
                bad.sendall(b"< send " + b"1" * 1000)
            while bad.recv(100):
                pass
        except OSError:
            pass  # reset
        bad.close()
        until(lambda: server.cut == 1)


@pytest.mark.slow
def test_too_many_clients_and_silent_ones(monkeypatch: pytest.MonkeyPatch, opened: Open) -> None:
    """Connections are bounded, and those that do not say who they are make room."""
    monkeypatch.setattr(server_module, "CLIENTS", 3)
    monkeypatch.setattr(server_module, "INTRODUCTION_S", 1.5)
    with serve() as server:
        silent = [parse_address("unix:can0").connect(PATIENCE) for _ in range(3)]
        with pytest.raises(can.CanInitializationError):
            opened(timeout=PATIENCE)
        assert server.refused == 1
        for one in silent:
            while one.recv(1000):
                pass
            one.close()
        opened()


def test_what_answers_is_no_server(runtime: Path) -> None:
    """A client that reaches something else, or something that never answers, says so."""
    path = str(runtime / "silent.sock")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen()
        with pytest.raises(can.CanInitializationError, match="in time"):
            can.Bus(f"unix:{path}", "aces", timeout=0.05)
    path = str(runtime / "other.sock")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen()
        greeted: list[socket.socket] = []  # kept open: else the client may meet a closed socket first

        def greet() -> None:
            greeted.append(listener.accept()[0])
            greeted[0].sendall(b"220 mail.example\r\n")

        greeter = threading.Thread(target=greet)
        greeter.start()
        with pytest.raises(can.CanInitializationError, match="kind 48"):
            can.Bus(f"unix:{path}", "aces", timeout=PATIENCE)
        greeter.join()
        greeted[0].close()
    with pytest.raises(can.CanInitializationError, match="aces bus serve"):
        can.Bus("unix:nobody", "aces")
