"""A node on a bus that another process serves: `can.Bus(interface="aces", channel="unix:/path/to.sock")`.

1. A server that has gone is an exception at once, from `recv` and from `send`, and from every call after it.
2. Waiting costs nothing: the system wakes whoever waits.
3. What comes from the server is checked like anything else from outside.

There is no thread: whoever receives reads the socket, and keeps what it finds besides. One reader at a time; others wait for
it. `frames` and `offer` are the same for a loop, which waits for the socket itself (`socket_fileno`) and builds no messages.
One read of the socket may bring many frames, so the socket is not the file for a program that takes one frame for each time
that a file is readable, as python-can's asyncio Notifier does: `fileno` stays readable while frames wait in the queue.

Frames under way are counted: the server says how many the bus has taken, and a client with all mailboxes full waits, or its
frame is refused, as with a controller in hardware.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from operator import attrgetter
from typing import Any

from can import CanInitializationError, CanOperationError, CanTimeoutError, Message

from ...errors import AcesError, CallerError
from ...frames import Frame
from ...python_can import frame_to_message
from ..python_can import QUEUE, VirtualBus
from ..simulated.bus_event import SimulatedBusEvent
from . import packets
from .address import ServedAddress
from .packets import FRAMES, OWN, PacketError
from .readable import ReadableFile
from .stream import ANSWER_S, ServerConnection, read_status, wait

_is_fd = attrgetter("is_fd")
#: Events that leave a node in another state.
_STATES = ("error-passive", "error-active", "recovered", "bus-off")


class ServedBus(VirtualBus):
    """A node on a served bus.

    `channel`: an address (`address`). `bitrate`, `data_bitrate`: what the bus is expected to have; another is refused, as
    frames would be on a real one. `fd`: takes CAN FD. `listen_only`, `receive_own_messages`, `restart_ms`, `rx_queue_size`:
    as of `AcesBus`. `timeout`: seconds to wait for the server. `name`: the channel of received messages, for a program whose
    user typed `can0` and that found the address by itself (default: `channel`).

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
        name: str | None = None,
        **more: Any,
    ) -> None:
        try:
            address = ServedAddress.parse(channel)
            hello = packets.Hello(
                address.channel,
                int(bitrate or 0),
                int(data_bitrate or 0),
                listen_only=bool(listen_only),
                fd=bool(fd),
                own=bool(receive_own_messages),
                restart_ms=None if restart_ms is None else max(0, round(restart_ms)),
            )
            self._stream = ServerConnection(address, hello, timeout)
        except AcesError as error:
            raise CanInitializationError(f"{channel}: {error}") from error
        except OSError as error:
            raise CanInitializationError(
                f"{channel}: no server answers ({error.strerror or error}); start one: aces bus serve"
            ) from error
        welcome = self._stream.welcome
        #: What the bus has: bit/s.
        self.bitrate, self.data_bitrate = welcome.bitrate, welcome.data_bitrate or None
        self._window = welcome.mailboxes if welcome.physics else 0
        #: Of `dropped`, those that were lost at the server. Frames that the bus refused.
        self._dropped_there = self.rejected = 0
        self._sent = self._taken = 0
        self._state = "error-active"
        self._status: list[dict[str, Any]] = []
        self._reading = threading.Lock()
        self._sending = threading.Lock()
        #: What `fileno` gave away, once somebody asked for it.
        self._readable: ReadableFile | None = None
        # Instants of `events` are ns since 1970; whoever reads calls `on_event`.
        super().__init__(
            name or channel,
            f"aces served bus {name or channel}",
            can_filters,
            fd=fd,
            listen_only=listen_only,
            rx_queue_size=rx_queue_size,
            **more,
        )
        for kind, body in self._stream.early:
            self._understand(kind, body)

    def fileno(self) -> int:
        """Return a file that is readable while `recv(0)` has something to do; -1 once the bus is closed.

        Raises `NotImplementedError`, as python-can's buses without a file do, on a system without epoll and eventfd.
        """
        if self._is_shutdown:
            return -1
        if self._readable is None:
            self._readable = ReadableFile(self._stream.number)
            self._readable.show(self._queue)
        return self._readable.number

    def socket_fileno(self) -> int:
        """Return the socket's file, for a reader that takes all frames each time it is readable."""
        return self._stream.number

    # ------------------------------------------------------------------ receiving

    def recv(self, timeout: float | None = None) -> Message | None:
        """Return the next message that passes the filters; None when none came in `timeout` seconds (None: for ever).

        Raises `CanOperationError` when the server has gone or the bus is closed.
        """
        queue = self._queue
        until = None if timeout is None else time.monotonic() + timeout
        left = timeout
        while True:
            message = self._next()
            if self._readable is not None:
                self._readable.show(queue)
            if message is not None:
                return message
            self._pump(left)
            if until is not None:
                left = until - time.monotonic()
                if left <= 0 and not queue:
                    return None

    def _pump(self, timeout: float | None) -> None:
        """Read what has come within so many seconds. One thread at a time; it reads for all."""
        if not self._reading.acquire(False):
            if not self._reading.acquire(timeout=-1 if timeout is None else max(0.0, timeout)):
                return
        try:
            if not self._queue:  # else another thread has read while we waited for it
                self._check_open()
                if wait(self._stream.number, timeout):
                    self._read()
        except (OSError, EOFError, PacketError, ValueError) as error:
            raise self._lost(error) from error
        finally:
            self._reading.release()

    def _read(self) -> None:
        """Read what the server has sent; the lock is held."""
        for kind, body in self._stream.read():
            self._understand(kind, body)

    def _understand(self, kind: int, body: bytes) -> None:
        if kind in FRAMES:
            for record in packets.unpack_records(kind, body):
                self._keep(record)
        elif kind == packets.REPORT:
            report = packets.read_value(body, packets.TransmitReport)
            self._taken, self.rejected = report.taken, report.rejected
            if report.dropped != self._dropped_there:
                self.dropped += report.dropped - self._dropped_there
                self._dropped_there = report.dropped
                self.changes += 1
        elif kind == packets.EVENT:
            event = packets.read_value(body, SimulatedBusEvent)
            if event.kind in _STATES:
                self._state = event.kind
            self._note(event)
        elif kind == packets.STATUS:
            self._status.append(read_status(body))
        elif kind == packets.REFUSED:
            raise EOFError(body.decode("utf-8", "replace"))
        else:
            raise PacketError(f"a packet of kind {kind}, which only a client sends")

    def _next(self) -> Message | None:
        queue = self._queue
        while queue:
            try:
                time_ns, identifier, flags, length, data = queue.popleft()
            except IndexError:  # another thread was quicker
                break
            found = packets.record_to_frame(identifier, flags, length, data)
            message = frame_to_message(found, time_ns / 1e9, self.channel, is_rx=not flags & OWN)
            if self._filters is None or self._matches_filters(message):
                return message
        return None

    def frames(self, most: int) -> list[Frame]:
        """Return at most so many frames of those that have come and pass the filters, without waiting.

        Raises `CanOperationError` when the server has gone or the bus is closed.
        """
        queue = self._queue
        found: list[Frame] = []
        if not queue and self._reading.acquire(False):
            try:
                if self._why:
                    raise self._unusable()
                data = self._stream.receive()
                if self._filters is None and len(data) <= most * packets.CLASSIC_PACKET.size:
                    singles = packets.single_frames(data)
                    if singles is not None:  # past the queue
                        return singles
                for kind, body in self._stream.split(data):
                    self._understand(kind, body)
            except (OSError, EOFError, PacketError, ValueError) as error:
                raise self._lost(error) from error
            finally:
                self._reading.release()
        while queue and len(found) < most:
            frame = _frame_of(queue.popleft())
            if self._filters is None or self._matches_filters(frame):  # type: ignore[arg-type]
                found.append(frame)
        return found

    def _lost(self, error: BaseException) -> CanOperationError:
        self._why = self._why or f"is gone: {error or 'the server has closed the connection'}"
        return self._unusable()

    def _check_open(self) -> None:
        if self._why:
            raise self._unusable()

    # ------------------------------------------------------------------ sending

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Give a frame to the bus; with all mailboxes full, wait up to `timeout` seconds (None: not at all) for a free one.

        Raises `CanOperationError` when the server has gone, the bus is closed, only listens, is off or cannot take more.
        """
        if self._why or self._listen_only or (msg.is_fd and not self._fd):
            raise self._refusal()
        if self._window and (self._sent - self._taken) * 2 >= self._window:
            self._wait_for_mailbox(timeout)
        if self._state == "bus-off":
            raise self._untaken(self._state)
        try:
            packet = packets.message_packet(msg, time.time_ns())
        except CallerError as error:
            raise CanOperationError(str(error)) from error
        self._put(packet, timeout)
        self._sent += 1

    def offer(self, frames: Sequence[Frame]) -> int:
        """Give frames to the bus together, without waiting: how many it took. Raises as `send`, where it takes none."""
        if self._why or self._listen_only:
            raise self._refusal()
        if self._state == "bus-off":
            raise self._untaken(self._state)
        if self._window:
            frames = frames[: max(0, self._window - (self._sent - self._taken))]
        if not self._fd and any(map(_is_fd, frames)):
            for number, frame in enumerate(frames):
                if frame.is_fd:
                    if not number:
                        raise self._refusal()
                    frames = frames[:number]
                    break
        if not frames:
            return 0
        packet = packets.frames_packet(frames, time.time_ns())
        with self._sending:
            try:
                is_taken = self._stream.offer(packet)
            except OSError as error:
                raise self._lost(error) from error
        self._sent += len(frames) * is_taken
        return len(frames) * is_taken

    def hold_little(self) -> None:
        """Have the system hold little of what is offered: nothing overtakes what it has."""
        self._stream.hold_little()

    def push(self) -> bool:
        """Send the rest of what the socket took in part; whether nothing is left of it."""
        with self._sending:
            try:
                return self._stream.push()
            except OSError:  # the server has gone, as reading says
                return True

    def _wait_for_mailbox(self, timeout: float | None) -> None:
        """Read how far the bus has come; wait when all mailboxes are full."""
        until = time.monotonic() + (timeout or 0)
        self._look()
        while self._sent - self._taken >= self._window and self._state != "bus-off":
            if (left := until - time.monotonic()) <= 0:
                raise self._untaken(self._state)
            self._look(left)

    def _look(self, timeout: float = 0.0) -> None:
        """Read what the server says, whatever lies in the queue. Another thread that reads does it for us."""
        number = self._stream.number
        try:
            while wait(number, timeout):
                self._check_open()
                if self._reading.acquire(timeout=0.001):
                    try:
                        if wait(number, 0):
                            self._read()
                    finally:
                        self._reading.release()
                timeout = 0.0
        except (OSError, EOFError, PacketError, ValueError) as error:
            raise self._lost(error) from error
        finally:
            if self._readable is not None:
                self._readable.show(self._queue)

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
    def known_state(self) -> str:
        """The state that the server reported last, of what has been read."""
        return self._state

    def _node_state(self) -> str:
        """Return the state that the server reported last."""
        if not self._why:
            self._look()
        return self._state

    def status(self) -> dict[str, Any]:
        """Return what the server knows about itself and its channels. Raises `CanOperationError` when it does not answer."""
        self._check_open()
        self._put(packets.packet(packets.QUERY))
        until = time.monotonic() + ANSWER_S
        while not self._status:
            if (left := until - time.monotonic()) <= 0:
                raise CanTimeoutError(f"{self.channel_info}: the server does not answer")
            self._look(left)
        return self._status.pop(0)

    def take_dropped(self) -> int:
        """Return how many frames were lost since the last call, and begin to count anew."""
        found, self.dropped = self.dropped, 0
        return found

    def shutdown(self) -> None:
        """Leave the bus."""
        if self._is_shutdown:
            return
        super().shutdown()
        self._why = "is closed"
        self._stream.hang_up()  # wakes who waits; only then may the file's number become another's
        if self._reading.acquire(timeout=1):
            self._reading.release()
        self._stream.close()
        if self._readable is not None:
            self._readable.close()


def _frame_of(record: tuple[int, int, int, int, bytes]) -> Frame:
    """Return the frame of a checked record."""
    time_ns, identifier, flags, length, data = record
    if not flags:  # nearly always
        return Frame(
            identifier, data[:length], time_ns / 1e9, None, False, False, False, False, False, False, True
        )
    return packets.record_to_frame(identifier, flags, length, data, time_ns / 1e9, not flags & OWN)
