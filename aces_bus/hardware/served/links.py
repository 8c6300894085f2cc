"""A server's end of one connection: bytes in, frames to the bus; frames from the bus, bytes out.

1. Neither reading nor writing waits. What a socket does not take at once waits here, bounded, and nobody else waits with it.
2. `PacketError` or `OSError` from a link ends that link and nothing else.
"""

from __future__ import annotations

import json
import socket
import struct
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..simulated.bus import SimulatedBusEvent
from . import packets
from .channel import MAILBOXES, BusClient
from .packets import CLASSIC, CLASSIC_RECORD, FRAMES, HEAD, PacketError

if TYPE_CHECKING:
    from .server import BusServer

#: Bytes that are read at once: some 700 frames, then it is another's turn.
READ = 16_384
#: Records that are packed at once.
WRITE = 2_048
#: Packets besides frames that wait, at most; then the oldest are dropped.
_ASIDE = 256
#: Frames off a client's mailboxes before it is told so.
_REPORT_EVERY = MAILBOXES // 4

_ONE = HEAD.pack(CLASSIC_RECORD.size, CLASSIC)


class ServerLink:
    """One connection of a server, whatever it speaks."""

    kind = "link"

    def __init__(self, server: BusServer, stream: socket.socket, peer: str) -> None:
        self.server, self.stream, self.peer = server, stream, peer
        self.fd = stream.fileno()
        self.member: BusClient | None = None
        self.is_closed = False
        self.is_introduced = False
        #: Whether the socket takes no more for now.
        self.is_blocked = False
        self._rest = b""

    @property
    def name(self) -> str:
        """What it is called in lists."""
        return f"{self.kind} {self.peer}".strip()

    @property
    def wants_input(self) -> bool:
        """Whether to read from it now."""
        return True

    def readable(self) -> None:
        """Read what is there and act on it."""
        try:
            data = self.stream.recv(READ)
        except BlockingIOError:
            return
        if not data:
            raise EOFError
        self.take(data)

    def hear_out(self) -> None:
        """Act on what a client has left behind."""
        try:
            while data := self.stream.recv(READ):
                self.take(data)
        except (OSError, PacketError):  # that was all, or cannot be understood
            pass

    def take(self, data: bytes) -> None:
        """Act on bytes from the client."""
        raise NotImplementedError

    def output(self) -> bytes:
        """The next bytes for the client; none when there is nothing."""
        raise NotImplementedError

    def woken(self) -> None:
        """There is something to send."""
        self.server.dirty.append(self)

    def happened(self, event: SimulatedBusEvent) -> None:
        """Something happened to the member's node."""

    def flush(self) -> None:
        """Send what the socket takes."""
        if self.is_closed:
            return
        if self.member is not None:
            self.member.is_woken = False
        send = self.stream.send
        while True:
            data = self._rest or self.output()
            if not data:
                break
            try:
                count = send(data)
            except BlockingIOError:
                count = 0
            self._rest = data[count:] if count < len(data) else b""
            if self._rest:
                self.block(True)
                return
        self.block(False)

    def block(self, is_blocked: bool) -> None:
        """Remember whether the socket is full."""
        if is_blocked != self.is_blocked:
            self.is_blocked = is_blocked
            self.server.blocked(self)

    def _take_records(self) -> Iterable[bytes]:
        assert self.member is not None
        queue = self.member.queue
        return [queue.popleft() for _ in range(min(len(queue), WRITE))]


class PacketLink(ServerLink):
    """A client that speaks our packets."""

    def __init__(self, server: BusServer, stream: socket.socket, peer: str, kind: str, only: str) -> None:
        super().__init__(server, stream, peer)
        self.kind, self._only = kind, only
        self._buffer = b""
        self._aside: deque[bytes] = deque(maxlen=_ASIDE)
        self._looks = False
        self._taken = self._told_taken = self._told_dropped = self._told_rejected = 0
        self._last: tuple[str, Any] = ("", None)

    def take(self, data: bytes) -> None:
        """Packets from the client."""
        found, self._buffer = packets.split_packets(self._buffer + data if self._buffer else data)
        for kind, body in found:
            if kind in FRAMES:
                self._frames(kind, body)
            else:
                self._other(kind, body)

    def _frames(self, kind: int, body: bytes) -> None:
        member = self.member
        if member is None:
            raise PacketError("frames before an introduction")
        send = member.channel.send
        for _, identifier, flags, length, data in packets.unpack_records(kind, body):
            if not send(member, identifier, flags, length, data):
                self._taken += 1  # it is off the mailboxes, unsent
        if member.rejected != self._told_rejected:
            self._report()

    def _other(self, kind: int, body: bytes) -> None:
        if kind == packets.HELLO:
            self._introduced(packets.read_value(body, packets.Hello))
        elif kind == packets.QUERY:
            if not self._looks and self.member is None:
                raise PacketError("a question before an introduction")
            self.put(_status(self.server.status()))
        elif self.member is None:
            raise PacketError(f"a packet of kind {kind} before an introduction")
        elif kind == packets.RESTART:
            if self.member.node is not None:
                self.member.node.restart()
        elif kind == packets.ABORT:
            if self.member.node is not None:
                self._taken += self.member.node.abort()
                self._report()
        else:
            raise PacketError(f"a packet of kind {kind}, which only a server sends")

    def _introduced(self, hello: packets.Hello) -> None:
        if self.member is not None or self._looks:
            raise PacketError("a second introduction")
        channel = self.server.find(hello.channel or self._only)
        data_bitrate = channel.data_bitrate or 0
        if not hello.looks:
            for what, theirs, ours in (
                ("bit/s", hello.bitrate, channel.bitrate),
                ("bit/s of data", hello.data_bitrate, data_bitrate),
            ):
                if theirs and theirs != ours:
                    raise PacketError(f"{channel.name} is served with {ours:,} {what}, not {theirs:,}")
            if hello.fd and not channel.fd:
                raise PacketError(f"{channel.name} is served without CAN FD; serve it with --fd")
            self.member = channel.join(
                self.name,
                self,
                listen_only=hello.listen_only,
                fd=hello.fd,
                own=hello.own,
                restart_ns=None if hello.restart_ms is None else hello.restart_ms * 1_000_000,
            )
        self._looks = hello.looks
        self.is_introduced = True
        welcome = packets.Welcome(channel.name, MAILBOXES, channel.physics, channel.bitrate, data_bitrate)
        self.put(packets.value_packet(welcome))

    def refuse(self, why: str) -> None:
        """Say why this connection ends; nothing else is sent after it."""
        try:
            self.stream.send(packets.packet(packets.REFUSED, why.encode()[:1000]))
        except OSError:
            pass

    def happened(self, event: SimulatedBusEvent) -> None:
        """What became of its frames, and its node's state."""
        if event.kind == "sent":
            self._taken += 1
            if self._taken - self._told_taken >= _REPORT_EVERY:
                self._report()
        elif (event.kind, event.frame) != self._last:  # the same thing again and again is told once
            self._last = (event.kind, event.frame)
            self.put(packets.value_packet(replace(event, instant=event.instant + self.server.epoch_ns)))

    def _report(self) -> None:
        assert self.member is not None
        self._told_taken, self._told_dropped = self._taken, self.member.dropped
        self._told_rejected = self.member.rejected
        report = packets.TransmitReport(self._taken, self.member.rejected, self.member.dropped)
        self.put(packets.value_packet(report))

    def put(self, packet: bytes) -> None:
        """Send a packet besides frames."""
        self._aside.append(packet)
        if self.member is None:
            self.woken()
        elif not self.member.is_woken:
            self.member.is_woken = True
            self.woken()

    def output(self) -> bytes:
        """Packets besides frames first."""
        member = self.member
        if member is not None:
            if member.dropped != self._told_dropped:
                self._report()
            queue = member.queue
            if not self._aside and len(queue) == 1 and len(queue[0]) == CLASSIC_RECORD.size:
                return _ONE + queue.popleft()
        aside = b"".join(self._aside)
        self._aside.clear()
        if member is None:
            return aside
        return aside + b"".join(packets.packed(self._take_records()))


def _status(status: dict[str, Any]) -> bytes:
    """A status as a packet; of a server with very many members, as many as fit."""
    text = json.dumps(status).encode()
    while len(text) > packets.MOST:
        longest = max(status["channels"], key=lambda channel: len(channel["members"]))
        longest["members"] = longest["members"][: len(longest["members"]) // 2]
        text = json.dumps(status).encode()
    return packets.packet(packets.STATUS, text)


def peer_of(stream: socket.socket, where: Any) -> str:
    """What to call the other end: its process, or its address."""
    option = getattr(socket, "SO_PEERCRED", None)
    if stream.family == getattr(socket, "AF_UNIX", -1):
        if option is None:
            return ""
        pid, _, _ = struct.unpack("3i", stream.getsockopt(socket.SOL_SOCKET, option, struct.calcsize("3i")))
        return f"pid {pid}"
    return f"{where[0]}:{where[1]}"
