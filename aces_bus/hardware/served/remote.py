"""A node on a bus that another process serves: `can.Bus(interface="aces", channel="unix:/path/to.sock")`.

1. A server that has gone is an exception at once, from `recv` and from `send`, and from every call after it.
2. Waiting costs nothing: the system wakes whoever waits.
3. What comes from the server is checked like anything else from outside.

There is no thread: whoever receives reads the socket, and keeps what it finds besides. One reader at a time; others wait for
it. Frames under way are counted: the server says how many the bus has taken, and a client with all mailboxes full waits or
is told so, as with a controller in hardware.
"""

from __future__ import annotations

import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from can import (
    BusABC,
    BusState,
    CanInitializationError,
    CanOperationError,
    CanProtocol,
    CanTimeoutError,
    Message,
)

from ...errors import AcesError, CallerError
from ..simulated.bus import SimulatedBusEvent
from . import packets
from .address import parse_address
from .packets import BITRATE_SWITCH, ERROR_STATE, EXTENDED, FD, FRAMES, OWN, REMOTE, PacketError
from .shortcut import Neighbour
from .stream import ANSWER_S, ServerConnection, Waiter, read_status, wait

#: Messages that may lie unread; after that the oldest is dropped and counted.
QUEUE = 65_536
#: Seconds between the numbers that a client tells a server of what did not pass through it.
_COUNT_S = 0.25
_STATES = {
    "error-passive": BusState.PASSIVE,
    "error-active": BusState.ACTIVE,
    "recovered": BusState.ACTIVE,
    "bus-off": BusState.ERROR,
}


class ServedBus(BusABC):
    """A node on a served bus.

    `channel`: an address (`address`). `bitrate`, `data_bitrate`: what the bus is expected to have; another is refused, as
    frames would be on a real one. `fd`: takes CAN FD. `listen_only`, `receive_own_messages`, `restart_ms`, `rx_queue_size`:
    as of `AcesBus`. `timeout`: seconds to wait for the server.

    Raises `CanInitializationError` when there is no such server, or it refuses.
    """

    def __init__(
        self,
        channel: str,
        can_filters: Any = None,
        *,
        bitrate: int | None = None,
        data_bitrate: int | None = None,
        fd: bool = False,
        listen_only: bool = False,
        receive_own_messages: bool = False,
        restart_ms: float | None = None,
        rx_queue_size: int = QUEUE,
        timeout: float = ANSWER_S,
        **more: Any,
    ) -> None:
        self.channel_info = f"aces served bus {channel}"
        self._listen_only, self._fd = bool(listen_only), bool(fd)
        flags = (
            (packets.LISTEN_ONLY if listen_only else 0)
            | (packets.TAKES_FD if fd else 0)
            | (packets.HEARS_OWN if receive_own_messages else 0)
            | (packets.DIRECT if hasattr(socket, "recv_fds") else 0)
        )
        restart = packets.NO_RESTART if restart_ms is None else max(0, round(restart_ms))
        try:
            address = parse_address(channel)
            hello = packets.Hello(address.channel, flags, int(bitrate or 0), int(data_bitrate or 0), restart)
            self._stream = ServerConnection(address, hello, timeout)
        except AcesError as error:
            raise CanInitializationError(f"{channel}: {error}") from error
        except OSError as error:
            raise CanInitializationError(
                f"{channel}: no server answers ({error.strerror or error}); start one: aces bus serve"
            ) from error
        welcome = self._stream.welcome
        self.channel = channel
        #: What the bus has: bit/s.
        self.bitrate, self.data_bitrate = welcome.bitrate, welcome.data_bitrate or None
        self._window = welcome.mailboxes if welcome.flags & packets.PHYSICS else 0
        self._queue: deque[Message] = deque()
        self._most = int(rx_queue_size) or QUEUE
        #: Frames lost because they were not read in time: here, and at the server.
        self.dropped = 0
        self._dropped_there = 0
        #: Frames that the bus refused.
        self.rejected = 0
        self._sent = self._taken = 0
        self._state = "error-active"
        #: What happened to this node, the last 1,024 events; instants in ns since 1970.
        self.events: deque[SimulatedBusEvent] = deque(maxlen=1024)
        #: Called with each event, by whoever reads; it must not block.
        self.on_event: Callable[[SimulatedBusEvent], None] | None = None
        self._status: list[dict[str, Any]] = []
        self._why: str | None = None
        self._receive_own = bool(receive_own_messages)
        self._near: dict[int, Neighbour] = {}
        self._nears: tuple[Neighbour, ...] = ()
        self._waiter = Waiter()
        self._waiter.watch((self._stream.number,))
        self._news = Waiter()
        self._news.watch((self._stream.number,))
        self._has_audience = False
        self._direct_received = self._direct_dropped = 0
        self._counted_at = 0.0
        self._is_open = True
        self._reading = threading.Lock()
        self._sending = threading.Lock()
        self._can_protocol = CanProtocol.CAN_FD if fd else CanProtocol.CAN_20
        self._is_direct = bool(welcome.flags & packets.DIRECT)
        for kind, body in self._stream.early:
            self._understand(kind, body)
        super().__init__(channel, can_filters, **more)

    # ------------------------------------------------------------------ receiving

    def recv(self, timeout: float | None = None) -> Message | None:
        """The next message that passes the filters; None when none came in `timeout` seconds (None: for ever).

        Raises `CanOperationError` when the server has gone or the bus is closed.
        """
        queue = self._queue
        until = None if timeout is None else time.monotonic() + timeout
        left = timeout
        while True:
            while queue:
                try:
                    message = queue.popleft()
                except IndexError:  # another thread was quicker
                    break
                if self._filters is None or self._matches_filters(message):
                    return message
            self._pump(left)
            if until is not None:
                left = until - time.monotonic()
                if left <= 0 and not queue:
                    return None

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        return self.recv(timeout), True

    def _apply_filters(self, filters: Any) -> None:
        """Filters are applied on reading."""

    def _pump(self, timeout: float | None) -> None:
        """Read what has come within so many seconds. One thread at a time; it reads for all."""
        if not self._reading.acquire(False):
            if not self._reading.acquire(timeout=-1 if timeout is None else max(0.0, timeout)):
                return
        try:
            if not self._queue:  # else another thread has read while we waited for it
                self._check_open()
                for number in self._waiter.wait(timeout):
                    self._read(number)
        except (OSError, EOFError, PacketError, ValueError) as error:
            raise self._lost(error) from error
        finally:
            self._reading.release()

    def _read(self, number: int) -> None:
        """Read this socket, which has something; the lock is held."""
        near = self._near.get(number)
        if near is None:
            for kind, body in self._stream.read():
                self._understand(kind, body)
            return
        try:
            data = near.read()
            found = packets.single(data)
            if found is not None and len(self._queue) < self._most:
                self._queue.append(record_to_message(found, self.channel))
                self._direct_received += 1
                return
            for kind, body in near.split(data):
                if kind in FRAMES:
                    self._direct_received += self._keep_all(kind, body)
                elif kind == packets.REPORT:
                    lost = packets.read_report(body)[2]
                    self.dropped += lost
                    self._direct_dropped += lost
                else:
                    raise PacketError(f"a packet of kind {kind} from a neighbour")
        except (OSError, EOFError, PacketError):
            self._part(number)

    def _part(self, number: int) -> None:
        """A neighbour has gone, or is not to be understood."""
        near = self._near.pop(number, None)
        self._neighbours_changed()
        if near is not None:
            near.close()

    def _neighbours_changed(self) -> None:
        self._nears = tuple(self._near.values())
        self._waiter.watch((self._stream.number, *self._near))

    def _understand(self, kind: int, body: bytes) -> None:
        if kind in FRAMES:
            self._keep_all(kind, body)
        elif kind == packets.REPORT:
            self._taken, self.rejected, dropped = packets.read_report(body)
            self.dropped += dropped - self._dropped_there
            self._dropped_there = dropped
        elif kind == packets.EVENT:
            name, time_ns, frame = packets.read_event(body)
            if name in _STATES:
                self._state = name
            event = SimulatedBusEvent(name, time_ns, frame)
            self.events.append(event)
            if self.on_event is not None:
                self.on_event(event)
        elif kind == packets.NEIGHBOUR and self._stream.files:
            near = Neighbour(self._stream.files.popleft(), body)
            self._near[near.number] = near
            self._neighbours_changed()
        elif kind == packets.AUDIENCE:
            self._has_audience = True
        elif kind == packets.STATUS:
            self._status.append(read_status(body))
        elif kind == packets.REFUSED:
            raise EOFError(body.decode("utf-8", "replace"))
        else:
            raise PacketError(f"a packet of kind {kind}, which only a client sends")

    def _keep_all(self, kind: int, body: bytes) -> int:
        queue, channel, count = self._queue, self.channel, 0
        for found in packets.unpack_records(kind, body):
            queue.append(record_to_message(found, channel))
            count += 1
        while len(queue) > self._most:
            queue.popleft()
            self.dropped += 1
        return count

    def _lost(self, error: BaseException) -> CanOperationError:
        if self._why is None and self._is_open:
            self._why = str(error) or "the server has closed the connection"
        return CanOperationError(f"{self.channel_info} {self._ended()}")

    def _ended(self) -> str:
        return "is closed" if not self._is_open else f"is gone: {self._why}"

    def _check_open(self) -> None:
        if not self._is_open or self._why is not None:
            raise CanOperationError(f"{self.channel_info} {self._ended()}")

    # ------------------------------------------------------------------ sending

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Give a frame to the bus; with all mailboxes full, wait up to `timeout` seconds (None: not at all) for a free one.

        Raises `CanOperationError` when the server has gone, the bus is closed, only listens, is off or cannot take more.
        """
        self._check_open()
        if self._listen_only:
            raise CanOperationError(f"{self.channel_info} was opened to listen only")
        if msg.is_fd and not self._fd:
            raise CanOperationError(f"{self.channel_info} was not opened for CAN FD; open it with fd=True")
        if self._window and (self._sent - self._taken) * 2 >= self._window:
            self._wait_for_mailbox(timeout)
        if self._state == "bus-off":
            raise CanOperationError(f"{self.channel_info} is bus-off")
        try:
            packet = packets.message_packet(msg, time.time_ns())
        except CallerError as error:
            raise CanOperationError(str(error)) from error
        if self._is_direct:
            self._send_direct(msg, packet, timeout)
        else:
            self._put(packet, timeout)
            self._sent += 1

    def _send_direct(self, msg: Message, packet: bytes, timeout: float | None) -> None:
        with self._sending:
            news = self._news.wait(0)
        if news:  # neighbours who have come
            self._look()
        if self._has_audience:
            self._put(packet, timeout)
        is_fd = msg.is_fd
        with self._sending:
            for near in self._nears:
                if is_fd and not near.takes_fd:
                    continue
                try:
                    near.write(packet)
                except OSError:  # gone; its reader's side says so too, and closes it
                    continue
            self._sent += 1
        if self._receive_own:
            (kind, body), *_ = packets.split_packets(packet)[0]
            for time_ns, identifier, flags, length, data in packets.unpack_records(kind, body):
                self._queue.append(
                    record_to_message((time_ns, identifier, flags | OWN, length, data), self.channel)
                )
        now = time.monotonic()
        if now - self._counted_at >= _COUNT_S:
            self._counted_at = now
            self._tell_count()

    def _tell_count(self) -> None:
        """What has not passed through the server, for its status."""
        self._put(packets.count(self._sent, self._direct_received, self._direct_dropped))

    def _wait_for_mailbox(self, timeout: float | None) -> None:
        """Read how far the bus has come; wait when all mailboxes are full."""
        until = time.monotonic() + (timeout or 0)
        self._look()
        while self._sent - self._taken >= self._window and self._state != "bus-off":
            if (left := until - time.monotonic()) <= 0:
                raise CanOperationError(f"{self.channel_info} has no free mailbox; nobody acknowledges?")
            self._look(left)

    def _look(self, timeout: float = 0.0) -> None:
        """Read what the server says, whatever lies in the queue. Another thread that reads does it for us."""
        only = (self._stream.number,)
        try:
            while wait(only, timeout):
                self._check_open()
                if self._reading.acquire(timeout=0.001):
                    try:
                        if wait(only, 0):
                            self._read(self._stream.number)
                    finally:
                        self._reading.release()
                timeout = 0.0
        except (OSError, EOFError, PacketError, ValueError) as error:
            raise self._lost(error) from error

    def _put(self, packet: bytes, timeout: float | None = None) -> None:
        with self._sending:
            try:
                self._stream.write(packet, timeout)
            except TimeoutError as error:
                raise CanTimeoutError(f"{self.channel_info} does not take the frame") from error
            except OSError as error:
                raise self._lost(error) from error

    def flush_tx_buffer(self) -> None:
        """Drop what waits to be sent."""
        self._check_open()
        self._put(packets.packet(packets.ABORT))

    def restart(self) -> None:
        """Come back from bus-off, after 128 times 11 recessive bits."""
        self._check_open()
        self._put(packets.packet(packets.RESTART))

    # ------------------------------------------------------------------ the rest

    @property
    def state(self) -> BusState:
        """Error active, passive or bus-off, as last heard."""
        if self._is_open and self._why is None:
            self._look()
        return _STATES[self._state]

    @state.setter
    def state(self, new_state: BusState) -> None:
        raise NotImplementedError(
            "the state is what the bus makes of the node; open it with listen_only, or restart it"
        )

    def status(self) -> dict[str, Any]:
        """What the server knows about itself and its channels. Raises `CanOperationError` when it does not answer."""
        self._check_open()
        if self._is_direct:
            self._tell_count()
        self._put(packets.packet(packets.QUERY))
        until = time.monotonic() + ANSWER_S
        while not self._status:
            if (left := until - time.monotonic()) <= 0:
                raise CanTimeoutError(f"{self.channel_info}: the server does not answer")
            self._look(left)
        return self._status.pop(0)

    def take_dropped(self) -> int:
        """How many frames were lost since the last call."""
        found, self.dropped = self.dropped, 0
        return found

    def shutdown(self) -> None:
        """Leave the bus."""
        super().shutdown()
        if not self._is_open:
            return
        if self._is_direct and self._why is None:
            try:
                self._tell_count()
            except CanOperationError:
                pass
        self._is_open = False
        self._stream.hang_up()  # wakes who waits; only then may the file's number become another's
        is_ours = self._reading.acquire(timeout=1)
        with self._sending:
            for number in list(self._near):
                self._part(number)
        if is_ours:
            self._reading.release()
        self._stream.close()


def record_to_message(found: tuple[int, int, int, int, bytes], channel: str) -> Message:
    """A checked record as a message."""
    time_ns, identifier, flags, length, data = found
    message = Message.__new__(Message)
    message.timestamp = time_ns / 1e9
    message.arbitration_id = identifier
    message.is_extended_id = flags & EXTENDED != 0
    message.is_remote_frame = flags & REMOTE != 0
    message.is_error_frame = False
    message.channel = channel
    message.dlc = length
    message.data = bytearray() if flags & REMOTE else bytearray(data[:length])
    message.is_fd = flags & FD != 0
    message.is_rx = flags & OWN == 0
    message.bitrate_switch = flags & BITRATE_SWITCH != 0
    message.error_state_indicator = flags & ERROR_STATE != 0
    return message
