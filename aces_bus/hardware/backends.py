"""What python-can's backends do each in their own way, under one name; and a SocketCAN socket, which is read here.

1. A backend that is not named here works; only what it could do better is missing.
2. Every frame that the kernel dropped is counted once, in front of the frame that came behind it.
3. A socket of an interface that is down is not open: it would say so once, and then be silent for ever.

*Facts* (python-can 4.6): the constructors' keywords and the behaviour of `recv` as its sources have them.

*Facts* (linux/can.h, linux/can/error.h, net/core/sock.c). A frame is 16 bytes, or 72 of CAN FD: identifier with flags,
length, FD flags, two reserved bytes, data. With `SO_RXQ_OVFL` the kernel hands over, beside a frame, how many frames it had
dropped when it queued that one; nothing while it has dropped none. The usual buffer holds some 278 frames. What was dropped
after the last queued frame is known when the next one comes.

*Choice.* python-can's `recv` leaves no room for the count beside a frame, and peeking for it costs a call a frame.
So the socket is read here, which also saves making a python-can message.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeGuard

from ..frames import Frame
from ..plugins import installed_items

if TYPE_CHECKING:
    import can

    from .served.remote import ServedBus


class Backend(NamedTuple):
    """The peculiarities of a python-can backend; an entry point of the group `aces_bus.backends` is a `Backend`, or a tuple.

    `name` is python-can's name of the interface, or a package that its bus's module is in. The backend itself is an entry
    point of python-can's own group, `can.interface`, ours too.
    """

    name: str
    #: Keywords that make it listen without acknowledging. SocketCAN is set by `ip link set … listen-only on`.
    quiet: Mapping[str, Any] = {}
    #: It becomes passive through its state after it is open.
    is_quiet_by_state: bool = False
    #: It gives back what was sent through it, whether asked or not.
    echoes: bool = False
    #: It says with a `CanError`, too, that it did not understand one datagram.
    of_datagrams: bool = False
    #: It has a file to wait for, and its `recv(0)` takes what is there and keeps what is not whole yet. Others that have a
    #: file read a serial port until a frame is whole.
    by_file: bool = False
    #: It has given a frame away when `send` returns; adapters of others may hold it a moment longer.
    is_prompt: bool = False


#: Our own, and those of python-can that do something in their own way.
BACKENDS: tuple[Backend, ...] = (
    Backend("aces", {"listen_only": True}, is_prompt=True),
    Backend("aces_bus", is_prompt=True),
    Backend("cantact", {"monitor": True}),
    Backend("kvaser", {"driver_mode": False}),
    Backend("nixnet", {"listen_only": True}),
    Backend("pcan", is_quiet_by_state=True),
    Backend("seeedstudio", {"operation_mode": "silent"}),
    Backend("slcan", {"listen_only": True}, by_file=True),
    Backend("socketcan", by_file=True, is_prompt=True),
    Backend("socketcand", by_file=True),
    Backend("udp_multicast", echoes=True, of_datagrams=True, by_file=True, is_prompt=True),
    Backend("vector", {"listen_only": True}),
    Backend("virtual", is_prompt=True),
)


def backend_of(interface: str, bus: can.BusABC | None = None) -> Backend:
    """Return what is known of a backend, by its name or the module of an open bus; otherwise one without peculiarities."""
    known = {backend.name: backend for backend in (*installed_items("aces_bus.backends", Backend), *BACKENDS)}
    names = [interface, *(type(bus).__module__.split(".") if bus is not None else ())]
    return next((known[name] for name in names if name in known), Backend(interface))


#: Seconds in which a socketcand server must greet.
GREETING_S = 3.0


def silence(bus: can.BusABC) -> None:
    """Make an open bus passive where that is how its backend does it."""
    if backend_of("", bus).is_quiet_by_state:
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


def forget_line(bus: can.BusABC) -> None:
    """Make a text backend drop the line that it cannot read: it would come upon it for ever.

    Its own `flush` also throws away the good lines that wait behind.
    """
    line = getattr(bus, "_buffer", None)
    flush = getattr(bus, "flush", None)
    if isinstance(line, bytearray):
        line.clear()
    elif callable(flush):
        flush()


Read = Callable[[float], "can.Message | Frame | None"]


def reader_of(bus: can.BusABC) -> Read:
    """Return a function that gives the next message, or frame, within some seconds; or None.

    It may have `take_dropped` (how many frames the system dropped since the last call), `state` (the controller's) and
    `overflows` (how often the adapter said that it lost frames).
    """
    sock = getattr(bus, "socket", None)
    if isinstance(sock, socket.socket) and sock.family == getattr(socket, "AF_CAN", -1):
        return SocketcanReader(bus, sock)
    sock = getattr(bus, "_SocketCanDaemonBus__socket", None)
    if isinstance(sock, socket.socket):
        return SocketcandReader(bus, sock)
    if _is_served(bus):
        return ServedReader(bus)
    return bus.recv


def _is_served(bus: can.BusABC) -> TypeGuard[ServedBus]:
    return hasattr(bus, "known_state")


class ServedReader:
    """A served bus, which says by itself what state its node is in, and how many frames were lost."""

    def __init__(self, bus: ServedBus) -> None:
        self._bus = bus
        self.frames: Callable[[int], list[Frame]] = bus.frames
        self.offer: Callable[[Sequence[Frame]], int] = bus.offer
        self.push: Callable[[], bool] = bus.push
        self.hold_little: Callable[[], None] = bus.hold_little
        self.fileno: Callable[[], int] = bus.socket_fileno
        self.take_dropped: Callable[[], int] = bus.take_dropped

    @property
    def changes(self) -> int:
        """Grows whenever frames were lost, or its state may be another."""
        return self._bus.changes

    @property
    def state(self) -> str:
        """State of the controller that the server reported last."""
        state = self._bus.known_state
        return "error-active" if state == "recovered" else state

    def __call__(self, timeout: float) -> can.Message | None:
        """Return the next message within some seconds."""
        return self._bus.recv(timeout)


class SocketcandReader:
    """`recv` of python-can's socketcand client that knows when the server is gone.

    Its own then returns nothing, without a pause, for ever.
    """

    def __init__(self, bus: can.BusABC, sock: socket.socket) -> None:
        self._recv, self._socket = bus.recv, sock

    def fileno(self) -> int:
        """Return the socket's file."""
        return self._socket.fileno()

    def __call__(self, timeout: float) -> can.Message | None:
        """Return the next message within some seconds. Raises `EOFError` when the server has hung up."""
        message = self._recv(0)
        if message is not None or not timeout:
            return message
        ready, _, _ = select.select([self._socket], [], [], timeout)
        if not ready:
            return None
        if not self._socket.recv(1, socket.MSG_PEEK):
            raise EOFError("the socketcand server has closed the connection")
        return self._recv(0)


#: The receive buffer that is asked for, in bytes; the kernel doubles it, and a frame takes some 770: 2.7 s of 1 Mbit/s.
RECEIVE_BUFFER = 8 << 20
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_SO_RXQ_OVFL = 40
_ANCILLARY = socket.CMSG_SPACE(16) + socket.CMSG_SPACE(4) if hasattr(socket, "CMSG_SPACE") else 0
_DONT_WAIT = getattr(socket, "MSG_DONTWAIT", 0)
_DONT_ROUTE = getattr(socket, "MSG_DONTROUTE", 0)
_HEADER = struct.Struct("=IBB2x")
_TIME = struct.Struct("@ll")
_COUNT = struct.Struct("=I")
_EXTENDED, _REMOTE, _ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
_CLASSIC_SIZE, _FD_SIZE = 16, 72

State = Literal["error-active", "error-passive", "bus-off"]
# Of an error frame: classes in the identifier, and the controller's problems in byte 1.
_CONTROLLER, _BUS_OFF, _RESTARTED = 0x04, 0x40, 0x100
_OVERFLOW, _WARNING, _PASSIVE, _ACTIVE = 0x01, 0x0C, 0x30, 0x40


class SocketcanReader:
    """Reads frames from the socket of a python-can SocketCAN bus.

    `state` is the controller's, as its error frames report it. Raises `OSError` where the interface is down.
    """

    def __init__(self, bus: can.BusABC, sock: socket.socket) -> None:
        self._socket = sock
        self._channel: str | None = str(getattr(bus, "channel", "")) or None
        # The kernel filters; where that cannot be set, python-can does.
        self._wanted: Callable[[Frame], bool] | None = None
        if not getattr(bus, "_is_filtered", False):
            self._wanted = bus._matches_filters  # type: ignore[assignment]  # it reads what frames have, too
        self._seen = self._dropped = 0
        self.state: State = "error-active"
        #: Grows whenever frames were lost, or its state may be another.
        self.changes = 0
        #: Error frames that reported a full buffer in the adapter: how many frames it lost is unknown.
        self.overflows = 0
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
        if problem := sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            raise OSError(problem, f"{os.strerror(problem)} (ip link set {self._channel or 'canX'} up)")
        self._poll = select.poll()
        self._poll.register(sock, select.POLLIN)

    @property
    def buffer(self) -> int:
        """The bytes that the kernel gives the receive buffer, as it counts them: a frame takes some 770."""
        return self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    def fileno(self) -> int:
        """Return the socket's file."""
        return self._socket.fileno()

    def frames(self, most: int) -> list[Frame]:
        """Return at most so many of the frames that are there. Raises as a call."""
        found: list[Frame] = []
        while len(found) < most and (frame := self(0)) is not None:
            found.append(frame)
        return found

    def offer(self, frames: Sequence[Frame]) -> int:
        """Give frames to the system without waiting: how many its queue took. Raises `OSError` where it takes none."""
        for number, frame in enumerate(frames):
            try:
                self._socket.send(_system_frame(frame), _DONT_WAIT)
            except OSError as error:
                if error.errno in (errno.EAGAIN, errno.ENOBUFS):
                    return number
                if not number:
                    raise
                return number
        return len(frames)

    def push(self) -> bool:
        """Return True: a frame is taken whole."""
        return True

    def __call__(self, timeout: float) -> Frame | None:
        """Return the next frame within some seconds. Raises `OSError` when the interface goes down or away."""
        while True:
            try:
                raw, beside, flags, address = self._socket.recvmsg(_FD_SIZE, _ANCILLARY, _DONT_WAIT)
            except OSError as error:
                if error.errno not in (errno.EAGAIN, errno.EINTR):
                    raise
                if not timeout or not self._poll.poll(timeout * 1000):
                    return None
                timeout = 0  # something is there: a frame, or an error
                continue
            frame = self._frame(raw, beside, flags, address)
            if self._wanted is None or self._wanted(frame):
                return frame

    def _frame(self, raw: bytes, beside: list[Any], flags: int, address: Any) -> Frame:
        stamp = None
        for level, kind, data in beside:
            if level != socket.SOL_SOCKET:
                continue
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIME.unpack_from(data)
                stamp = seconds + nanoseconds * 1e-9
            elif kind == _SO_RXQ_OVFL:
                (count,) = _COUNT.unpack_from(data)
                if count != self._seen:
                    self._dropped += (count - self._seen) & 0xFFFF_FFFF
                    self._seen = count
                    self.changes += 1
        size = len(raw)
        if size not in (_CLASSIC_SIZE, _FD_SIZE):
            raise ValueError(f"a frame of {size} bytes is neither classic CAN nor CAN FD")
        word, length, fd_flags = _HEADER.unpack_from(raw)
        is_fd = size == _FD_SIZE
        is_remote = bool(word & _REMOTE)
        is_error = bool(word & _ERROR)
        frame = Frame(
            word & (0x1FFF_FFFF if word & (_EXTENDED | _ERROR) else 0x7FF),
            b"" if is_remote else raw[8 : 8 + length],
            stamp,
            self._channel or address[0],
            bool(word & _EXTENDED),
            is_remote,
            is_error,
            is_fd,
            is_fd and bool(fd_flags & 1),
            is_fd and bool(fd_flags & 2),
            not flags & _DONT_ROUTE,  # set when it was sent on this machine
            length if is_remote else None,
        )
        if is_error:
            self._look(frame)
        return frame

    def _look(self, frame: Frame) -> None:
        """Take the state of the controller from an error frame."""
        self.changes += 1
        kinds = frame.arbitration_id
        problem = frame.data[1] if kinds & _CONTROLLER and len(frame.data) > 1 else 0
        if problem & _OVERFLOW:
            self.overflows += 1
        if kinds & _BUS_OFF:
            self.state = "bus-off"
        elif problem & _PASSIVE:
            self.state = "error-passive"
        elif kinds & _RESTARTED or problem & (_WARNING | _ACTIVE):
            self.state = "error-active"

    def take_dropped(self) -> int:
        """Return how many frames the kernel has dropped since the last call, and begin to count anew."""
        found, self._dropped = self._dropped, 0
        return found


def _system_frame(frame: Frame) -> bytes:
    """Return a frame as the system's `struct can_frame`, or `canfd_frame`."""
    word = (
        frame.arbitration_id
        | (_EXTENDED if frame.is_extended_id else 0)
        | (_REMOTE if frame.is_remote_frame else 0)
    )
    flags = (
        (1 if frame.bitrate_switch else 0) | (2 if frame.error_state_indicator else 0) if frame.is_fd else 0
    )
    size = _FD_SIZE if frame.is_fd else _CLASSIC_SIZE
    return (_HEADER.pack(word, frame.length, flags) + frame.data).ljust(size, b"\0")


__all__ = [
    "Backend",
    "ServedReader",
    "SocketcanReader",
    "backend_of",
    "check_server",
    "forget_line",
    "reader_of",
    "silence",
]
