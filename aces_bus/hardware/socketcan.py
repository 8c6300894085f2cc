"""Reading a SocketCAN socket: a large buffer, the kernel's count of what it dropped, the controller's state.

1. Every frame that the kernel dropped is counted once, in front of the frame that came behind it.
2. A socket of an interface that is down is not open: it would say so once, and then be silent for ever.

*Facts* (linux/can.h, linux/can/error.h, net/core/sock.c). A frame is 16 bytes, or 72 of CAN FD: identifier with flags,
length, FD flags, two reserved bytes, data. With `SO_RXQ_OVFL` the kernel hands over, beside a frame, how many frames it had
dropped when it queued that one; nothing while it has dropped none. The usual buffer holds some 278 frames. What was dropped
after the last queued frame is known when the next one comes.

*Choice.* python-can's `recv` leaves no room for the second word beside a frame, and peeking for it costs a call a frame.
So the socket is read here, which also saves making a python-can message.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
from typing import Any, Literal

from ..frames import Frame

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

    `state` is the controller's, as its error frames tell it. Raises `OSError` where the interface is down.
    """

    def __init__(self, bus: Any, sock: socket.socket) -> None:
        self._socket = sock
        self._channel: str | None = str(bus.channel) or None
        # The kernel filters; where it could not be told how, python-can does.
        self._wanted = None if getattr(bus, "_is_filtered", False) else bus._matches_filters
        self._seen = self._dropped = 0
        self.state: State = "error-active"
        #: Error frames that told of a full buffer in the adapter: nobody knows how many frames it lost.
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

    def __call__(self, timeout: float) -> Frame | None:
        """The next frame within some seconds. Raises `OSError` when the interface goes down or away."""
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
                self._dropped += (count - self._seen) & 0xFFFF_FFFF
                self._seen = count
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
        """What an error frame says of the controller."""
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
        """How many frames the kernel has dropped since the last call."""
        found, self._dropped = self._dropped, 0
        return found


__all__ = ["SocketcanReader"]
