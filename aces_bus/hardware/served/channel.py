"""One served bus: a wire in step with this machine's clock, or none, its members, and the connections that they have.

1. Nothing here waits. A member that does not take its frames loses the oldest, counted; what its socket does not take at
   once waits, bounded, and delays no other member.
2. All of it runs on the server's one thread; there is no lock.
3. `PacketError` or `OSError` from a link ends that link and nothing else.

A member's frames wait as records (`packets`) in a queue of its own; its connection sends them when its turn comes. With
physics a member is a node of the `SimulatedBus`. Without, all members get a frame as soon as it has come, whatever the rates
say."""

from __future__ import annotations

import json
import socket
import struct
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from ...errors import CallerError
from ...frames import Frame
from ...runtime import VirtualClock
from ..simulated.bus import NO_FAULTS, BusNode, Faults, SimulatedBus
from ..simulated.bus_event import SimulatedBusEvent
from . import packets
from .packets import (
    BITRATE_SWITCH,
    CLASSIC,
    CLASSIC_RECORD,
    ERROR_STATE,
    EXTENDED,
    FD,
    FRAMES,
    HEAD,
    OWN,
    REMOTE,
    PacketError,
    frame_record,
    pack_record,
    record_to_frame,
)

if TYPE_CHECKING:
    from .server import BusServer

#: Frames that a member may have waiting to be sent.
MAILBOXES = 1024
#: Frames that wait for a member who does not read: eight seconds of a full 1 Mbit/s bus.
QUEUE = 65_536
#: How long a member's last frames may take after it has left.
LINGER_NS = 1_000_000_000
_FLAGS = EXTENDED | REMOTE | FD | BITRATE_SWITCH | ERROR_STATE


class BusClient:
    """Someone on a served bus. Counts: `sent`, `received`, `dropped` (not read in time), `rejected` (refused by the bus)."""

    def __init__(
        self, channel: ServedChannel, name: str, connection: ServerLink, *, fd: bool, own: bool
    ) -> None:
        self.channel, self.name, self.connection = channel, name, connection
        self.fd, self.own = fd, own
        self.node: BusNode | None = None
        self.queue: deque[bytes] = deque()
        self.is_woken = False
        self.sent = self.received = self.dropped = self.rejected = 0

    def deliver(self, record: bytes) -> None:
        """Put a frame into the queue."""
        queue = self.queue
        if len(queue) >= QUEUE:
            queue.popleft()
            self.dropped += 1
        queue.append(record)
        self.received += 1
        if not self.is_woken:
            self.is_woken = True
            self.connection.woken()

    @property
    def waiting(self) -> int:
        """Its frames that are not sent yet."""
        return self.node.pending if self.node is not None else 0

    @property
    def is_off(self) -> bool:
        """True if errors have taken the client off the bus."""
        return self.node is not None and self.node.state == "bus-off"

    def status(self) -> dict[str, Any]:
        """Return what there is to know, for people and programs."""
        node = self.node
        return {
            "name": self.name,
            "state": node.state if node is not None else "error-active",
            "listen_only": node is not None and node.listen_only,
            "transmit_errors": node.transmit_errors if node is not None else 0,
            "receive_errors": node.receive_errors if node is not None else 0,
            "sent": self.sent,
            "received": self.received,
            "dropped": self.dropped,
            "rejected": self.rejected,
            "waiting": self.waiting,
        }


class ServedChannel:
    """A bus for the members of a server. Rates in bit/s; `fd`: whether members may take CAN FD. With `acknowledge` the bus
    has a node that does nothing else: the frames of a lone sender, with only listeners around it, are acknowledged.

    Raises `CallerError` for rates that do not exist, a name that is no file's, or faults without physics.
    """

    def __init__(
        self,
        name: str = "can0",
        *,
        bitrate: int = 500_000,
        data_bitrate: int | None = None,
        fd: bool = False,
        faults: Faults = NO_FAULTS,
        physics: bool = True,
        acknowledge: bool = False,
    ) -> None:
        if (
            not name
            or len(name) > 64
            or not name.replace("-", "").replace("_", "").replace(".", "").isalnum()
        ):
            raise CallerError(f"{name!r} is not a name of a channel: letters, digits, '-', '_' and '.'")
        if faults != NO_FAULTS and not physics:
            raise CallerError("faults are the wire's, and without physics there is none")
        if data_bitrate is not None and not fd:
            raise CallerError("a data bit rate is CAN FD's: say --fd too")
        SimulatedBus(
            VirtualClock(), bitrate=bitrate, data_bitrate=data_bitrate
        )  # says what is wrong with the rates
        self.name, self.fd, self.physics, self.acknowledge = name, fd, physics, acknowledge
        self.bitrate, self.data_bitrate, self.faults = bitrate, data_bitrate, faults
        self.members: list[BusClient] = []
        self.frames = 0
        self._last: tuple[Frame | None, int, bytes] = (None, 0, b"")

    def start(self, clock: VirtualClock, epoch_ns: int) -> None:
        """Begin at the clock's time; `epoch_ns` added to an instant is the time since 1970."""
        self._clock, self._epoch_ns = clock, epoch_ns
        self._since = clock.now()
        self.wire = SimulatedBus(
            clock, bitrate=self.bitrate, data_bitrate=self.data_bitrate, faults=self.faults
        )
        if self.acknowledge:
            self.wire.attach("witness")

    # ------------------------------------------------------------------ members

    def join(
        self,
        name: str,
        connection: ServerLink,
        *,
        listen_only: bool = False,
        fd: bool = False,
        own: bool = False,
        restart_ns: int | None = None,
    ) -> BusClient:
        """Add a member, and return it. `own`: it receives what it sends."""
        member = BusClient(self, name, connection, fd=fd, own=own)
        if self.physics:
            node = self.wire.attach(
                name,
                partial(self._received, member),
                partial(self._happened, member),
                listen_only=listen_only,
                fd=fd,
                mailboxes=MAILBOXES,
                restart_ns=restart_ns,
            )
            member.node = node
        self.members.append(member)
        return member

    def leave(self, member: BusClient) -> None:
        """Take a member off the bus. What it has given to the bus is still sent, for up to `LINGER_NS`."""
        if member in self.members:
            self.members.remove(member)
        node = member.node
        if node is None:
            return
        node.received = None
        if not node.pending or node.state == "bus-off":
            self.wire.detach(node)
            return
        node.happened = partial(self._left, node)
        self._clock.call_in(LINGER_NS, partial(self.wire.detach, node))

    def _left(self, node: BusNode, event: SimulatedBusEvent) -> None:
        if not node.pending:
            self.wire.detach(node)

    # ------------------------------------------------------------------ frames

    def send(self, member: BusClient, identifier: int, flags: int, length: int, data: bytes) -> bool:
        """Put a checked frame of a member on the bus; return False when the bus does not take it."""
        flags &= _FLAGS
        if flags & FD and not member.fd:
            member.rejected += 1
            return False
        if member.node is not None:
            node = member.node
            if node.listen_only or not node.send(record_to_frame(identifier, flags, length, data)):
                member.rejected += 1
                return False
            return True
        now = self._clock.now() + self._epoch_ns
        record = pack_record(now, identifier, flags, length, data)
        for other in self.members:
            if other is not member and (other.fd or not flags & FD):
                other.deliver(record)
        self.frames += 1
        member.sent += 1
        if member.own:
            member.deliver(pack_record(now, identifier, flags | OWN, length, data))
        return True

    def _received(self, member: BusClient, frame: Frame, instant: int) -> None:
        last, when, record = self._last
        if last is not frame or when != instant:  # packed once for all receivers
            record = frame_record(frame, instant + self._epoch_ns)
            self._last = (frame, instant, record)
        member.deliver(record)

    def _happened(self, member: BusClient, event: SimulatedBusEvent) -> None:
        if event.kind == "sent":
            member.sent += 1
            if member.own and event.frame is not None:
                member.deliver(frame_record(event.frame, event.instant + self._epoch_ns, OWN))
        member.connection.happened(event)

    # ------------------------------------------------------------------ what it is doing

    def status(self) -> dict[str, Any]:
        """Return what there is to know, for people and programs; instants in ns of the server's clock."""
        load = self.wire.load
        return {
            "channel": self.name,
            "bitrate": self.bitrate,
            "data_bitrate": self.data_bitrate,
            "fd": self.fd,
            "physics": self.physics,
            "frames": load.frames if self.physics else self.frames,
            "errors": load.errors,
            "busy_ns": load.busy_ns,
            "now_ns": self._clock.now(),
            "since_ns": self._since,
            "members": [member.status() for member in self.members],
        }


#: Bytes that are read at once: some 700 frames, then it is another's turn.
READ = 16_384
#: Records that are packed at once.
WRITE = 2_048
#: Packets besides frames that wait, at most; then the oldest are dropped.
_ASIDE = 256
#: Frames off a client's mailboxes before that is reported to it.
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
        """Name of the link in lists."""
        return f"{self.kind} {self.peer}".strip()

    @property
    def wants_input(self) -> bool:
        """True if the link is to be read now."""
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
        """Return the next bytes for the client; none when there is nothing."""
        raise NotImplementedError

    def woken(self) -> None:
        """Send what waits."""
        self.server.dirty.append(self)

    def happened(self, event: SimulatedBusEvent) -> None:
        """Handle an event of the member's node."""

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
        self._taken = self._reported_taken = self._reported_dropped = self._reported_rejected = 0
        self._last: tuple[str, Any] = ("", None)

    def take(self, data: bytes) -> None:
        """Take packets from the client."""
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
        if member.rejected != self._reported_rejected:
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
        """Tell the client the fate of its frames, and the state of its node."""
        if event.kind == "sent":
            self._taken += 1
            if self._taken - self._reported_taken >= _REPORT_EVERY:
                self._report()
        elif (event.kind, event.frame) != self._last:  # the same event again and again is reported once
            self._last = (event.kind, event.frame)
            self.put(packets.value_packet(replace(event, instant=event.instant + self.server.epoch_ns)))

    def _report(self) -> None:
        assert self.member is not None
        self._reported_taken, self._reported_dropped = self._taken, self.member.dropped
        self._reported_rejected = self.member.rejected
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
        """Return output for the client: other packets first, then frames."""
        member = self.member
        if member is not None:
            if member.dropped != self._reported_dropped:
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
    """Return a status as a packet; of a server with very many members, as many as fit."""
    text = json.dumps(status).encode()
    while len(text) > packets.MOST:
        longest = max(status["channels"], key=lambda channel: len(channel["members"]))
        longest["members"] = longest["members"][: len(longest["members"]) // 2]
        text = json.dumps(status).encode()
    return packets.packet(packets.STATUS, text)


def peer_of(stream: socket.socket, where: Any) -> str:
    """Return what to call the other end: its process, or its address."""
    option = getattr(socket, "SO_PEERCRED", None)
    if stream.family == getattr(socket, "AF_UNIX", -1):
        if option is None:
            return ""
        pid, _, _ = struct.unpack("3i", stream.getsockopt(socket.SOL_SOCKET, option, struct.calcsize("3i")))
        return f"pid {pid}"
    return f"{where[0]}:{where[1]}"
