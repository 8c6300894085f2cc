"""What python-can's backends do each in their own way, under one name.

1. A backend that is not named here works; only what it could do better is missing.

*Facts* (python-can 4.6): the constructors' keywords and the behaviour of `recv` as its sources have them.
"""

from __future__ import annotations

import socket
import struct
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

#: The receive buffer that SocketCAN is asked for; the usual one holds some 278 frames.
RECEIVE_BUFFER = 8 << 20
_SO_RCVBUFFORCE = 33
_SO_RXQ_OVFL = 40
_ANCILLARY = socket.CMSG_SPACE(16) + socket.CMSG_SPACE(4) if hasattr(socket, "CMSG_SPACE") else 0


def quiet_options(interface: str) -> Mapping[str, Any]:
    """The keywords with which a backend only listens; none where it has none."""
    return QUIET.get(interface, {})


def silence(bus: Any) -> None:
    """Make an open bus passive where that is how its backend does it."""
    if type(bus).__module__.split(".")[2:3] and type(bus).__module__.split(".")[2] in BY_STATE:
        from can import BusState

        bus.state = BusState.PASSIVE


Read = Callable[[float], Any]


def reader_of(bus: Any) -> Read:
    """A function that gives the next message within some seconds, or None.

    Of SocketCAN it reads the socket itself: with a large buffer, and with the kernel's count of what it dropped.
    """
    sock = getattr(bus, "socket", None)
    if isinstance(sock, socket.socket) and sock.family == getattr(socket, "AF_CAN", -1):
        return SocketcanReader(bus, sock)
    read: Read = bus.recv
    return read


class SocketcanReader:
    """`recv` of a SocketCAN bus that knows how many frames the kernel has dropped."""

    def __init__(self, bus: Any, sock: socket.socket) -> None:
        self._bus, self._socket = bus, sock
        self._seen = self._dropped = 0
        for option in (_SO_RCVBUFFORCE, socket.SO_RCVBUF):  # the first takes a privilege, and knows no limit
            try:
                sock.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BUFFER)
                break
            except OSError:
                continue
        try:
            sock.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        except OSError:
            pass

    def __call__(self, timeout: float) -> Any:
        """The next message that passes the bus's filters."""
        self._look()
        return self._bus.recv(timeout)

    def _look(self) -> None:
        """The kernel's count rides beside a frame: peek at the next one's."""
        try:
            _, ancillary, _, _ = self._socket.recvmsg(1, _ANCILLARY, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except (OSError, AttributeError):
            return
        for level, kind, data in ancillary:
            if level == socket.SOL_SOCKET and kind == _SO_RXQ_OVFL and len(data) >= 4:
                (count,) = struct.unpack_from("=I", data)
                self._dropped += (count - self._seen) & 0xFFFF_FFFF
                self._seen = count

    def take_dropped(self) -> int:
        """How many frames the kernel has dropped since the last call."""
        found, self._dropped = self._dropped, 0
        return found
