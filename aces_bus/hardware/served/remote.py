"""A node on a bus that another process serves: `can.Bus(interface="aces", channel="unix:/path/to.sock")`.

1. A server that has gone is an exception at once, from `recv` and from `send`, and from every call after it.
2. Waiting costs nothing: the system wakes whoever waits.
3. What comes from the server is checked like anything else from outside.

There is no thread: whoever receives reads the socket, and keeps what it finds besides. One reader at a time; others wait for
it. Frames under way are counted: the server says how many the bus has taken, and a client with all mailboxes full waits or
is told so, as with a controller in hardware.
"""

from __future__ import annotations

import json
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from can import BusABC, BusState, CanInitializationError, CanOperationError, CanProtocol, CanTimeoutError, Message

from ...errors import AcesError, CallerError
from ..wire import WireEvent
from . import packets
from .address import Address, notes, parse_address
from .packets import BITRATE_SWITCH, CLASSIC, ERROR_STATE, EXTENDED, FD, LONG, OWN, REMOTE, PacketError

#: Seconds that a server may take to answer an introduction or a question.
ANSWER_S = 5.0
#: Messages that may lie unread; after that the oldest is dropped and counted.
QUEUE = 65_536
#: Bytes that are read at once.
_READ = 65_536
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
        )
        restart = packets.NO_RESTART if restart_ms is None else max(0, round(restart_ms))
        try:
            address = parse_address(channel)
            hello = packets.Hello(
                address.channel, flags, int(bitrate or 0), int(data_bitrate or 0), restart
            )
            self._stream = Stream(address, hello, timeout)
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
        self.events: deque[WireEvent] = deque(maxlen=1024)
        #: Called with each event, by whoever reads; it must not block.
        self.on_event: Callable[[WireEvent], None] | None = None
        self._status: list[dict[str, Any]] = []
        self._why: str | None = None
        self._is_open = True
        self._reading = threading.Lock()
        self._sending = threading.Lock()
        self._can_protocol = CanProtocol.CAN_FD if fd else CanProtocol.CAN_20
        super().__init__(channel, can_filters, **more)

    # ------------------------------------------------------------------ receiving

    def recv(self, timeout: float | None = None) -> Message | None:
        """The next message that passes the filters; None when none came in `timeout` seconds (None: for ever).

        Raises `CanOperationError` when the server has gone or the bus is closed.
        """
        queue = self._queue
        until = None if timeout is None else time.monotonic() + timeout
        while True:
            while queue:
                try:
                    message = queue.popleft()
                except IndexError:  # another thread was quicker
                    break
                if self._filters is None or self._matches_filters(message):
                    return message
            if not self._pump(until) and until is not None and time.monotonic() >= until:
                return None

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        return self.recv(timeout), True

    def _apply_filters(self, filters: Any) -> None:
        """Filters are applied on reading."""

    def _pump(self, until: float | None) -> bool:
        """Read what has come, or wait for it until then; whether anything came. One thread at a time."""
        left = -1.0 if until is None else max(0.0, until - time.monotonic())
        if not self._reading.acquire(timeout=left):
            return False
        try:
            if self._queue:  # another thread has read while we waited for it
                return True
            self._check_open()
            left_now = None if until is None else max(0.0, until - time.monotonic())
            found = self._stream.read(left_now)
            for kind, body in found:
                self._understand(kind, body)
            return bool(found)
        except (OSError, EOFError, PacketError, ValueError) as error:
            raise self._lost(error) from error
        finally:
            self._reading.release()

    def _understand(self, kind: int, body: bytes) -> None:
        if kind == CLASSIC or kind == LONG:
            keep = self._keep
            for found in packets.records(kind, body):
                keep(to_message(found, self.channel))
        elif kind == packets.REPORT:
            self._taken, self.rejected, dropped = packets.read_report(body)
            self.dropped += dropped - self._dropped_there
            self._dropped_there = dropped
        elif kind == packets.EVENT:
            name, time_ns, frame = packets.read_event(body)
            if name in _STATES:
                self._state = name
            event = WireEvent(name, time_ns, frame)
            self.events.append(event)
            if self.on_event is not None:
                self.on_event(event)
        elif kind == packets.STATUS:
            self._status.append(json.loads(body))
        elif kind == packets.REFUSED:
            raise EOFError(body.decode("utf-8", "replace"))
        else:
            raise PacketError(f"a packet of kind {kind}, which only a client sends")

    def _keep(self, message: Message) -> None:
        queue = self._queue
        if len(queue) >= self._most:
            queue.popleft()
            self.dropped += 1
        queue.append(message)

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
        """Give a frame to the bus. With all mailboxes full it waits up to `timeout` seconds (None: not at all) for a free one.

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
            packet = packets.message_packet(msg)
        except CallerError as error:
            raise CanOperationError(str(error)) from error
        self._put(packet, timeout)

    def _wait_for_mailbox(self, timeout: float | None) -> None:
        """Read how far the bus has come; wait when all mailboxes are full."""
        until = time.monotonic() + (timeout or 0)
        self._look()
        while self._sent - self._taken >= self._window and self._state != "bus-off":
            if time.monotonic() >= until:
                raise CanOperationError(f"{self.channel_info} has no free mailbox; nobody acknowledges?")
            self._look(until)

    def _look(self, until: float = 0.0) -> None:
        """Read even though messages lie in the queue."""
        left = max(0.0, until - time.monotonic())
        if not self._reading.acquire(timeout=left):
            return
        try:
            for kind, body in self._stream.read(max(0.0, until - time.monotonic())):
                self._understand(kind, body)
        except (OSError, EOFError, PacketError, ValueError) as error:
            raise self._lost(error) from error
        finally:
            self._reading.release()

    def _put(self, packet: bytes, timeout: float | None = None) -> None:
        with self._sending:
            try:
                self._stream.write(packet, timeout)
            except TimeoutError as error:
                raise CanTimeoutError(f"{self.channel_info} does not take the frame") from error
            except OSError as error:
                raise self._lost(error) from error
            self._sent += 1

    def flush_tx_buffer(self) -> None:
        """Drop what waits to be sent."""
        self._command(packets.ABORT)

    def restart(self) -> None:
        """Come back from bus-off, after 128 times 11 recessive bits."""
        self._command(packets.RESTART)

    def _command(self, kind: int) -> None:
        self._check_open()
        self._put(packets.packet(kind))
        self._sent -= 1  # no frame

    # ------------------------------------------------------------------ the rest

    @property  # type: ignore[misc]  # python-can's can be set; this one is what the bus makes of the node
    def state(self) -> BusState:
        """Error active, passive or bus-off, as last heard."""
        if self._is_open and self._why is None and not self._queue:
            self._look()
        return _STATES[self._state]

    def status(self) -> dict[str, Any]:
        """What the server knows about itself and its channels."""
        self._command(packets.QUERY)
        until = time.monotonic() + ANSWER_S
        while not self._status:
            if time.monotonic() >= until:
                raise CanTimeoutError(f"{self.channel_info}: the server does not answer")
            self._look(until)
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
        self._is_open = False
        self._stream.hang_up()  # wakes who waits; only then may the file's number become another's
        if self._reading.acquire(timeout=1):
            self._reading.release()
        self._stream.close()


class Stream:
    """A connection to a server, introduced."""

    def __init__(self, address: Address, hello: packets.Hello, timeout: float = ANSWER_S) -> None:
        self._socket = address.connect(timeout)
        self._buffer = b""
        self._rest = b""
        try:
            self._socket.setblocking(False)
            self._number = self._socket.fileno()
            self.write(hello.packet(), timeout)
            kind, body = self._answer(time.monotonic() + timeout)
            if kind == packets.REFUSED:
                raise PacketError(body.decode("utf-8", "replace"))
            if kind != packets.WELCOME:
                raise PacketError("what answers is no server of a bus")
            self.welcome = packets.read_welcome(body)
        except EOFError as error:
            self._socket.close()
            raise PacketError("the server has closed the connection") from error
        except BaseException:
            self._socket.close()
            raise

    def _answer(self, until: float) -> tuple[int, bytes]:
        """The first packet; what follows it stays in the buffer."""
        while True:
            if len(self._buffer) >= 4:
                size, kind = packets.HEAD.unpack_from(self._buffer)
                if not 1 <= kind <= packets.STATUS:
                    raise PacketError("what answers is no server of a bus")
                if len(self._buffer) >= 4 + size:
                    body, self._buffer = self._buffer[4 : 4 + size], self._buffer[4 + size :]
                    return kind, body
            left = until - time.monotonic()
            if left <= 0 or not self._wait(left, False):
                raise TimeoutError("no answer in time")
            self._receive()

    def _receive(self) -> None:
        data = self._socket.recv(_READ)
        if not data:
            raise EOFError("the server has closed the connection")
        self._buffer = self._buffer + data if self._buffer else data

    def _wait(self, timeout: float | None, writing: bool) -> bool:
        """Whether the socket is ready within so many seconds."""
        number = self._number
        if number < 1000:
            one = (number,)
            found = select.select((), one, (), timeout) if writing else select.select(one, (), (), timeout)
            return bool(found[1] if writing else found[0])
        poll = select.poll()
        poll.register(number, select.POLLOUT if writing else select.POLLIN)
        return bool(poll.poll(None if timeout is None else timeout * 1000))

    def read(self, timeout: float | None) -> list[tuple[int, bytes]]:
        """The packets that have come, after up to `timeout` seconds (None: for ever). Raises `EOFError` at the end."""
        if len(self._buffer) < 4:
            if not self._wait(timeout, False):
                return []
        elif (found := packets.split(self._buffer))[0]:
            self._buffer = found[1]
            return found[0]
        elif not self._wait(timeout, False):
            return []
        try:
            self._receive()
        except BlockingIOError:
            return []
        found, self._buffer = packets.split(self._buffer)
        return found

    def write(self, packet: bytes, timeout: float | None = None) -> None:
        """Send a packet, all of it. Raises `TimeoutError` when the socket takes nothing for so long (None: for ever)."""
        if self._rest:  # of a packet that was cut short: first
            self._push(timeout)
        try:
            count = self._socket.send(packet)
        except BlockingIOError:
            count = 0
        if count == len(packet):
            return
        if not count:
            if not self._wait(timeout, True):
                raise TimeoutError
            return self.write(packet, timeout)
        self._rest = packet[count:]
        self._push(None)

    def _push(self, timeout: float | None) -> None:
        while self._rest:
            if not self._wait(timeout, True):
                raise TimeoutError
            try:
                self._rest = self._rest[self._socket.send(self._rest) :]
            except BlockingIOError:
                continue

    def hang_up(self) -> None:
        """End the connection; whoever waits for it is woken."""
        try:
            self._socket.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()


def to_message(found: tuple[int, int, int, int, bytes], channel: str) -> Message:
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


# ---------------------------------------------------------------------- finding servers


def ask(address: Address, timeout: float = 1.0) -> dict[str, Any]:
    """A server's status, without joining a bus. Raises `OSError` or `PacketError`."""
    stream = Stream(address, packets.Hello(address.channel, packets.LOOKS), timeout)
    try:
        stream.write(packets.packet(packets.QUERY), timeout)
        until = time.monotonic() + timeout
        while (left := until - time.monotonic()) > 0:
            for kind, body in stream.read(left):
                if kind == packets.STATUS:
                    found = json.loads(body)
                    if isinstance(found, dict):
                        return found
        raise TimeoutError("no answer in time")
    except (EOFError, ValueError) as error:
        raise PacketError(f"no status: {error}") from error
    finally:
        stream.close()


def servers(timeout: float = 0.5) -> list[dict[str, Any]]:
    """The status of each server of this user on this machine. The notes of dead ones are removed."""
    found = []
    for path, content in notes():
        addresses = content.get("addresses")
        texts = [
            text
            for some in (addresses.values() if isinstance(addresses, dict) else ())
            if isinstance(some, list)
            for text in some
            if isinstance(text, str)
        ]
        status = None
        for text in texts:
            try:
                status = ask(parse_address(text), timeout)
                break
            except (OSError, AcesError):
                continue
        if status is not None:
            found.append(status)
        elif texts and not _lives(content.get("pid")):
            path.unlink(missing_ok=True)
    return found


def _lives(pid: object) -> bool:
    import os

    if not isinstance(pid, int) or pid <= 0 or os.name != "posix":
        return True  # who knows
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def served_channels() -> list[str]:
    """One address of each channel that is served on this machine by this user."""
    return [
        channel["addresses"][0]
        for status in servers()
        for channel in status.get("channels", ())
        if channel.get("addresses")
    ]
