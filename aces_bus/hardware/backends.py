"""What python-can's backends do each in their own way, under one name.

1. A backend that is not named here works; only what it could do better is missing.

*Facts* (python-can 4.6): the constructors' keywords and the behaviour of `recv` as its sources have them.
"""

from __future__ import annotations

import select
import socket
from collections.abc import Callable, Mapping
from typing import Any

#: Backend → the keywords that make it listen without acknowledging. SocketCAN is told by `ip link set … listen-only on`.
QUIET: Mapping[str, Mapping[str, Any]] = {
    "aces": {"listen_only": True},
    "slcan": {"listen_only": True},
    "vector": {"listen_only": True},
    "nixnet": {"listen_only": True},
    "cantact": {"monitor": True},
    "seeedstudio": {"operation_mode": "silent"},
    "kvaser": {"driver_mode": False},
}
#: Backends whose bus becomes passive through its state after it is open.
BY_STATE = frozenset({"pcan"})
#: Backends that give back what was sent through them, whether asked or not.
ECHOES = frozenset({"udp_multicast"})

#: Backends that say with a `CanError`, too, that they did not understand one datagram.
DATAGRAMS = frozenset({"udp_multicast"})

#: Seconds in which a socketcand server must greet.
GREETING_S = 3.0


def quiet_options(interface: str) -> Mapping[str, Any]:
    """The keywords with which a backend only listens; none where it has none."""
    return QUIET.get(interface, {})


def silence(bus: Any) -> None:
    """Make an open bus passive where that is how its backend does it."""
    if type(bus).__module__.split(".")[2:3] and type(bus).__module__.split(".")[2] in BY_STATE:
        from can import BusState

        bus.state = BusState.PASSIVE


def check_server(options: Mapping[str, Any]) -> None:
    """Raise `OSError` when a socketcand server is not there, at once.

    python-can's client would knock 10 s long without a pause, and wait for ever for a greeting.
    """
    if options.get("interface") == "socketcand" and "host" in options and "port" in options:
        address = (str(options["host"]), int(options["port"]))
        with socket.create_connection(address, GREETING_S) as probe:
            if not probe.recv(64).startswith(b"< hi"):
                raise OSError(f"no socketcand server answers on {address[0]}:{address[1]}")


def forget_line(bus: Any) -> None:
    """Make a text backend drop the line that it cannot read: it would come upon it for ever.

    Its own `flush` also throws away the good lines that wait behind.
    """
    line = getattr(bus, "_buffer", None)
    flush = getattr(bus, "flush", None)
    if isinstance(line, bytearray):
        line.clear()
    elif callable(flush):
        flush()


Read = Callable[[float], Any]


def reader_of(bus: Any) -> Read:
    """A function that gives the next message, or frame, within some seconds; or None.

    It may have `take_dropped` (how many frames the system dropped since the last call), `state` (the controller's) and
    `overflows` (how often the adapter said that it lost frames).
    """
    sock = getattr(bus, "socket", None)
    if isinstance(sock, socket.socket) and sock.family == getattr(socket, "AF_CAN", -1):
        from .socketcan import SocketcanReader

        return SocketcanReader(bus, sock)
    sock = getattr(bus, "_SocketCanDaemonBus__socket", None)
    if isinstance(sock, socket.socket):
        return SocketcandReader(bus, sock)
    read: Read = bus.recv
    return read


class SocketcandReader:
    """`recv` of python-can's socketcand client that knows when the server is gone.

    Its own then returns nothing, without a pause, for ever.
    """

    def __init__(self, bus: Any, sock: socket.socket) -> None:
        self._recv, self._socket = bus.recv, sock

    def __call__(self, timeout: float) -> Any:
        """The next message within some seconds. Raises `EOFError` when the server has hung up."""
        message = self._recv(0)
        if message is not None or not timeout:
            return message
        ready, _, _ = select.select([self._socket], [], [], timeout)
        if not ready:
            return None
        if not self._socket.recv(1, socket.MSG_PEEK):
            raise EOFError("the socketcand server has closed the connection")
        return self._recv(0)
