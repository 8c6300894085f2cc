"""One served bus: a wire in step with this machine's clock, or none, and the members who are on it.

1. Nothing here waits: a member that does not take its frames loses the oldest, counted, and delays nobody.
2. All of it runs on the server's one thread; there is no lock.

A member's frames wait as records (`packets`) in a queue of its own; its connection sends them when its turn comes. With
physics a member is a node of the `Wire`. Without, a frame is everybody's as soon as it has come, whatever the rates say.
"""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import Any, Protocol

from ...errors import CallerError
from ...frames import Frame
from ...runtime import VirtualClock
from ..simulated.bus import BusNode, SimulatedBus, SimulatedBusEvent
from ..simulated.faults import NO_FAULTS, Faults
from .packets import (
    BITRATE_SWITCH,
    ERROR_STATE,
    EXTENDED,
    FD,
    OWN,
    REMOTE,
    frame_record,
    pack_record,
    record_to_frame,
)

#: Frames that a member may have waiting to be sent.
MAILBOXES = 1024
#: Frames that wait for a member who does not read: eight seconds of a full 1 Mbit/s bus.
QUEUE = 65_536
#: How long a member's last frames may take after it has left.
LINGER_NS = 1_000_000_000
_FLAGS = EXTENDED | REMOTE | FD | BITRATE_SWITCH | ERROR_STATE


class Connection(Protocol):
    """What a member's link does when something has come for it."""

    def woken(self) -> None:
        """There is something to send."""

    def happened(self, event: SimulatedBusEvent) -> None:
        """Something happened to the member's node."""


class BusClient:
    """Someone on a served bus. Counts: `sent`, `received`, `dropped` (not read in time), `rejected` (refused by the bus)."""

    def __init__(
        self, channel: ServedChannel, name: str, connection: Connection, *, fd: bool, own: bool
    ) -> None:
        self.channel, self.name, self.connection = channel, name, connection
        self.fd, self.own = fd, own
        self.node: BusNode | None = None
        self.queue: deque[bytes] = deque()
        self.is_woken = False
        self.sent = self.received = self.dropped = self.rejected = 0

    def deliver(self, one: bytes) -> None:
        """Put a frame into the queue."""
        queue = self.queue
        if len(queue) >= QUEUE:
            queue.popleft()
            self.dropped += 1
        queue.append(one)
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
        """Whether its errors have taken it off the bus."""
        return self.node is not None and self.node.state == "bus-off"

    def status(self) -> dict[str, Any]:
        """What there is to know, for people and programs."""
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
    has a node of its own that does nothing else: a lone sender, with only listeners around it, is heard.

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
            raise CallerError(f"{name!r} is no name of a channel: letters, digits, '-', '_' and '.'")
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
        connection: Connection,
        *,
        listen_only: bool = False,
        fd: bool = False,
        own: bool = False,
        restart_ns: int | None = None,
    ) -> BusClient:
        """A new member. `own`: it hears what it sends."""
        member = BusClient(self, name, connection, fd=fd, own=own)
        if self.physics:
            node = self.wire.attach(
                name,
                partial(self._heard, member),
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
        """A checked frame of a member; False when the bus does not take it."""
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
        one = pack_record(now, identifier, flags, length, data)
        for other in self.members:
            if other is not member and (other.fd or not flags & FD):
                other.deliver(one)
        self.frames += 1
        member.sent += 1
        if member.own:
            member.deliver(pack_record(now, identifier, flags | OWN, length, data))
        return True

    def _heard(self, member: BusClient, frame: Frame, instant: int) -> None:
        last, when, one = self._last
        if last is not frame or when != instant:  # packed once for all who hear it
            one = frame_record(frame, instant + self._epoch_ns)
            self._last = (frame, instant, one)
        member.deliver(one)

    def _happened(self, member: BusClient, event: SimulatedBusEvent) -> None:
        if event.kind == "sent":
            member.sent += 1
            if member.own and event.frame is not None:
                member.deliver(frame_record(event.frame, event.instant + self._epoch_ns, OWN))
        member.connection.happened(event)

    # ------------------------------------------------------------------ what it is doing

    def status(self) -> dict[str, Any]:
        """What there is to know, for people and programs; instants in ns of the server's clock."""
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
