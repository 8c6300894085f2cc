"""Without physics, clients on Unix sockets talk to each other directly: half the way, half the time.

1. Who has been welcomed is heard by everybody and hears everybody: the others know of a newcomer before it is answered.
2. A neighbour that does not read delays a sender once, for `PATIENCE_S`; from then on it loses frames, and is told how many.
3. What a neighbour says wrongly costs that neighbour only.

When a client joins, the server makes a pair of sockets for it and each of the others, and hands the ends over (`NEIGHBOUR`,
with the file). Each looks at its connection to the server before it sends, so it has them in time. Members whom this does
not reach (TCP, socketcand, more than `NEIGHBOURS`) get the frames from the server, to whom clients send as well while there
are any (`AUDIENCE`). Frames of two senders may reach two receivers in different order, which a bus with physics never does.
"""

from __future__ import annotations

import select
import socket
from collections.abc import Iterable

from . import packets
from .links import PacketLink, ServerLink
from .packets import PacketError

#: Members of a channel that talk to each other directly, at most: their sockets grow with the square.
NEIGHBOURS = 16
#: Seconds that a sender waits for a neighbour's full socket before it counts it as one that does not read.
PATIENCE_S = 0.05
#: Bytes that a socket may hold; the system gives less where it must. A frame in it costs some 770.
_BUFFER = 1 << 22
_READ = 16_384


def introduce(link: ServerLink, others: Iterable[ServerLink]) -> list[PacketLink]:
    """The server's side: connect a newcomer with its neighbours. Gives those that have something to read now."""
    member = link.member
    assert member is not None
    there = [
        one
        for one in others
        if one.member is not None and one.member.channel is member.channel and not one.is_closed
    ]
    near = [
        one
        for one in there
        if isinstance(one, PacketLink) and one.member is not None and one.member.is_direct
    ]
    if not isinstance(link, PacketLink) or len(near) >= NEIGHBOURS - 1:
        member.is_direct = False
    if member.is_direct:
        assert isinstance(link, PacketLink)
        for other in near:
            assert other.member is not None
            try:
                ours, theirs = _pair()
            except OSError as error:  # no more files
                raise PacketError(f"no sockets for another client: {error.strerror}") from error
            link.passing.append((packets.packet(packets.NEIGHBOUR, bytes([member_flags(other)])), ours))
            other.passing.append((packets.packet(packets.NEIGHBOUR, bytes([member_flags(link)])), theirs))
        if len(near) < len(there):
            link.put(packets.packet(packets.AUDIENCE))
        link.woken()
    else:
        for other in near:
            other.put(packets.packet(packets.AUDIENCE))
    return near


def member_flags(link: ServerLink) -> int:
    """What a neighbour must know of a member."""
    return packets.TAKES_FD if link.member is not None and link.member.fd else 0


def _pair() -> tuple[socket.socket, socket.socket]:
    pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    for one in pair:
        one.setblocking(False)
        one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
    return pair


class Neighbour:
    """A client's side: another client, reached directly."""

    def __init__(self, number: int, body: bytes) -> None:
        self._socket = socket.socket(fileno=number)
        self._socket.setblocking(False)
        self.number = self._socket.fileno()
        self.takes_fd = bool(body[:1] and body[0] & packets.TAKES_FD)
        self._send, self._recv = self._socket.send, self._socket.recv
        self._buffer = b""
        self._rest = b""
        self._lost = 0
        self._is_slow = False

    def read(self) -> bytes:
        """What has come, for `split`. Raises `EOFError` or `OSError` when it has gone."""
        try:
            data = self._recv(_READ)
        except BlockingIOError:
            return b""
        if not data:
            raise EOFError
        if self._buffer:
            data, self._buffer = self._buffer + data, b""
        return data

    def split(self, data: bytes) -> list[tuple[int, bytes]]:
        """The packets in what has come; the rest is kept. Raises `PacketError`."""
        found, self._buffer = packets.split_packets(data)
        return found

    def write(self, packet: bytes) -> None:
        """Send a packet with a frame, or lose it, counted. Raises `OSError` when it has gone."""
        if self._lost or self._rest:
            self._catch_up()
            if self._lost:
                self._lost += 1
                return
        try:
            count = self._send(packet)
        except BlockingIOError:
            count = 0
        if count == len(packet):
            return
        if not self._is_slow and not count and self._has_room():
            self.write(packet)
            return
        if count:
            self._rest = packet[count:]
        else:
            self._is_slow = True
            self._lost = 1

    def _has_room(self) -> bool:
        if self.number >= 1000:
            return False
        return bool(select.select((), (self.number,), (), PATIENCE_S)[1])

    def _catch_up(self) -> None:
        """Send the rest of a packet, and how much was lost."""
        try:
            while self._rest:
                self._rest = self._rest[self._socket.send(self._rest) :]
            if self._lost:
                note = packets.report(0, 0, self._lost)
                count = self._socket.send(note)
                self._rest = note[count:]
                self._lost, self._is_slow = 0, False
        except BlockingIOError:
            pass

    def close(self) -> None:
        """Leave it."""
        self._socket.close()
