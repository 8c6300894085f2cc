"""The socketcand protocol of a served bus, by hand and with python-can's client."""

from __future__ import annotations

import socket
import time

import can

from aces_bus.hardware.served.address import ServedAddress
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.server import BusServer

from .serving import PATIENCE, Open, message, received, sending, serve, with_unix_sockets

pytestmark = with_unix_sockets


class Text:
    """A socketcand client by hand."""

    def __init__(self, server: BusServer) -> None:
        self._socket = socket.create_connection(ServedAddress.parse_host(server.socketcand, None), PATIENCE)
        self._buffer = ""
        assert self.next() == "< hi >"

    def say(self, text: str) -> None:
        self._socket.sendall(text.encode())

    def next(self) -> str:
        """The next answer."""
        while ">" not in self._buffer:
            data = self._socket.recv(1000)
            assert data
            self._buffer += data.decode("ascii")
        found, _, self._buffer = self._buffer.partition(">")
        return found + ">"

    def __enter__(self) -> Text:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()


def test_socketcand_commands(opened: Open) -> None:
    """Each command of the protocol's documentation that is offered; and what is not, is answered as unknown."""
    with (
        serve(ServedChannel(fd=True, data_bitrate=2_000_000), unix="", socketcand=("127.0.0.1", 0)) as server,
        Text(server) as text,
    ):
        bus = opened(fd=True)
        text.say("< rawmode >< open can0")
        assert text.next() == "< error unknown command >"
        text.say(" >")
        assert text.next() == "< ok >"
        text.say("<echo>< subscribe 0 0 123 >< send 124 0  >< echo >")
        assert [text.next(), text.next()] == ["< echo >", "< echo >"]
        assert received(bus)[0].arbitration_id == 0x124
        for identifier in (0x122, 0x123):
            bus.send(message(identifier, b"\x11\x22"))
        word, identifier_text, stamp, data = text.next().strip("<> ").split()
        assert (word, identifier_text, data) == ("frame", "123", "1122")
        assert abs(float(stamp) - time.time()) < PATIENCE
        text.say("< rawmode >")
        assert text.next() == "< ok >"
        for sent, wanted in (
            (message(0x1ABCDEF0, b"\xff", is_extended_id=True), "frame 1ABCDEF0 FF"),
            (message(0x7, is_remote_frame=True, dlc=4), "rtr 007 4"),
            (message(0x8, bytes(12), is_fd=True, bitrate_switch=True), f"fdframe 008 01 {'00' * 12}"),
            (message(0x9), "frame 009"),
        ):
            bus.send(sent)
            words = text.next().strip("<> ").split()
            del words[3 if words[0] == "fdframe" else 2]  # the time
            assert " ".join(words) == wanted
        got = []
        for command in (
            "send 123 2 1 f1",
            "sendrtr 1AAAAAAA 2",
            "fdsend 5 1 12 0 1 2 3 4 5 6 7 8 9 a b",
            "send 7 0",
        ):
            text.say(f"< {command} >")
            got += received(bus)
        assert [bytes(one.data) for one in got] == [b"\x01\xf1", b"", bytes(range(12)), b""]
        assert (got[1].is_remote_frame, got[1].is_extended_id, got[1].dlc) == (True, True, 2)
        assert (got[2].is_fd, got[2].bitrate_switch) == (True, True)
        text.say("< isotpmode >")
        assert text.next() == "< error unknown command >"


def test_socketcand_nonsense_makes_no_frames(opened: Open) -> None:
    """Commands that cannot be understood are counted, and the connection goes on."""
    with serve(unix="", socketcand=("127.0.0.1", 0)) as server, Text(server) as text:
        bus = opened()
        text.say("< open can0 >< rawmode >")
        assert [text.next(), text.next()] == ["< ok >", "< ok >"]
        for nonsense in (
            "< send >", "< send 800 0 >", "< send xyz 0 >", "< send 1 9 >", "< send 1 2 1 >", "< send 1 1 100 >",
            "< send 1 -1 >", "< send 20000000 0 >", "< sendrtr 1 >", "< fdsend 1 0 9 1 2 3 4 5 6 7 8 9 >", "<>", "x>",
            "< send \xff 0 >",
        ):  # fmt: skip
            text.say(nonsense)
        text.say("< send 1 1 aa >")
        assert received(bus)[0].data == b"\xaa"
        assert bus.recv(0.01) is None


def test_socketcand_hears_of_errors() -> None:
    """A sender whom nobody acknowledges gets error frames, as python-can's client reads them."""
    with serve(unix="", socketcand=("127.0.0.1", 0)) as server:
        host, port = ServedAddress.parse_host(server.socketcand, None)
        with can.Bus("can0", "socketcand", host=host, port=port) as bus:
            bus.send(message(1))
            first, second = received(bus, 2)
            assert (first.is_error_frame, first.arbitration_id) == (True, 0x20)
            assert (second.is_error_frame, second.arbitration_id) == (True, 0x04)


def test_socketcand_frames_do_not_run_into_the_handshake(opened: Open) -> None:
    """python-can's client takes all that comes with an answer for the answer; on a busy bus it can still join."""
    with serve(unix="", socketcand=("127.0.0.1", 0)) as server:
        sender, _ = opened(), opened()
        host, port = ServedAddress.parse_host(server.socketcand, None)
        with sending(sender, message(0x55), 0.001):
            for _ in range(5):
                with can.Bus("can0", "socketcand", host=host, port=port) as bus:
                    assert received(bus)[0].arbitration_id == 0x55
