"""A served bus and those who do not read, say nonsense, or say nothing."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

import can
import pytest

from aces_bus.hardware.served import server as server_module
from aces_bus.hardware.served.address import ServedAddress
from aces_bus.hardware.served.channel import ServedChannel

from .serving import PATIENCE, Open, message, received, serve, until, with_unix_sockets

pytestmark = with_unix_sockets


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


def test_a_socketcand_client_that_never_ends_a_command(opened: Open) -> None:
    """A command has a length; who goes on is cut off."""
    with serve(socketcand=("127.0.0.1", 0)) as server:
        bad = socket.create_connection(ServedAddress.parse_host(server.socketcand, None), PATIENCE)
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
        silent = [ServedAddress.parse("unix:can0").connect(PATIENCE) for _ in range(3)]
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
