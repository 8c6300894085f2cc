"""The socketcand protocol, so that python-can's own client and other programs join a served bus.

1. A command is at most `LINE` bytes; more without an end ends the connection.
2. What cannot be understood is counted, and no frame is made of it.

*Facts* (linux-can/socketcand, doc/protocol.md and state_raw.c): the server greets with `< hi >`; `< open can0 >`,
`< rawmode >` and `< bcmmode >` are answered with `< ok >`. Frames come as `< frame 123 23.424242 11223344 >`, remote ones
as `< rtr 123 23.424242 4 >`, FD ones as `< fdframe 123 FLAGS 23.424242 1122… >`, errors as `< error CLASS 23.424242 >` with
the class of linux/can/error.h. `< send 123 2 11 22 >`, `< sendrtr 123 4 >` and `< fdsend 123 FLAGS 2 11 22 >` send; an
identifier of eight digits is extended; `< echo >` comes back. In BCM mode only subscribed identifiers come.
*Fact* (python-can 4.6): its client takes what it reads after `< rawmode >` for the answer alone; a frame in the same piece
of the stream ends it.
*Choice*: so frames are held back for `_SETTLE_NS` after that answer. Cyclic sending, content filters, statistics and
ISO-TP of the broadcast manager are not offered; they are answered as an unknown command is.
"""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

from ...frames import FD_LENGTHS
from ..simulated.bus_event import SimulatedBusEvent
from .channel import MAILBOXES, ServerLink
from .packets import BITRATE_SWITCH, ERROR_STATE, EXTENDED, FD, REMOTE, PacketError, unpacked

if TYPE_CHECKING:
    from .server import BusServer

#: Bytes of a command: `fdsend` with 64 data bytes takes 230.
LINE = 1024
#: Answers that wait for a client who does not read.
_ANSWERS = 64 * 1024
_SETTLE_NS = 20_000_000
_SUBSCRIPTIONS = 1024

#: Classes of linux/can/error.h.
_CLASSES = {
    "no acknowledge": 0x20,
    "bit error": 0x80,
    "error-passive": 0x04,
    "error-active": 0x04,
    "bus-off": 0x40,
    "recovered": 0x100,
}


class SocketcandLink(ServerLink):
    """A client that speaks socketcand's text."""

    kind = "socketcand"

    def __init__(self, server: BusServer, stream: socket.socket, peer: str) -> None:
        super().__init__(server, stream, peer)
        self._buffer = b""
        self._answers = b""
        self._is_raw = False
        self._subscribed: set[tuple[int, bool]] = set()
        self._quiet_until = 0
        self._last: tuple[str, object] = ("", None)
        #: Commands that were not understood.
        self.bad = 0
        self._say(b"< hi >")

    @property
    def wants_input(self) -> bool:
        """A client that sends faster than the bus takes it waits, as it would on a real one."""
        member = self.member
        return len(self._answers) < _ANSWERS and (
            member is None or member.is_off or member.waiting < MAILBOXES // 2
        )

    def take(self, data: bytes) -> None:
        """Take commands from the client."""
        parts = (self._buffer + data).split(b">")
        self._buffer = parts.pop()
        if len(self._buffer) > LINE:
            raise PacketError(f"{len(self._buffer)} bytes and no end of a command")
        for part in parts:
            before, _, command = part.rpartition(b"<")
            if before.strip() or len(command) > LINE:
                self.bad += 1
            self._command(command.decode("ascii", "replace").split())

    def _command(self, words: list[str]) -> None:
        if not words:
            self.bad += 1
            return
        name, rest = words[0], words[1:]
        if name == "echo":
            self._say(b"< echo >")
        elif self.member is None:
            if name != "open" or len(rest) != 1:
                self.bad += 1
                self._say(b"< error unknown command >")
            else:
                self._open(rest[0])
        elif name in ("rawmode", "bcmmode"):
            self._is_raw = name == "rawmode"
            self.member.queue.clear()
            self._quiet_until = self.server.clock.now() + _SETTLE_NS
            self.server.clock.call_at(self._quiet_until, self.woken)
            self._say(b"< ok >")
        else:
            self._act(name, rest)

    def _open(self, name: str) -> None:
        channel = self.server.find(name)
        self.member = channel.join(self.name, self, fd=channel.fd)
        self.is_introduced = True
        self._say(b"< ok >")

    def _act(self, name: str, rest: list[str]) -> None:
        assert self.member is not None
        try:
            if name == "send":
                length = _length(rest[1])
                data = _data(rest[2:], length, 8)
                self._send(rest[0], 0, length, data)
            elif name == "sendrtr":
                self._send(rest[0], REMOTE, _length(rest[1]), b"")
            elif name == "fdsend":
                flags, length = int(rest[1], 16), int(rest[2])
                more = (BITRATE_SWITCH if flags & 1 else 0) | (ERROR_STATE if flags & 2 else 0)
                if length not in FD_LENGTHS:
                    raise ValueError(length)
                self._send(rest[0], FD | more, length, _data(rest[3:], length, 64))
            elif name == "subscribe":
                if len(self._subscribed) >= _SUBSCRIPTIONS:
                    raise ValueError("too many")
                self._subscribed.add(_identifier(rest[2]))
            elif name == "unsubscribe":
                self._subscribed.discard(_identifier(rest[0]))
            else:
                self.bad += 1
                self._say(b"< error unknown command >")
        except (
            ValueError,
            IndexError,
        ):  # as socketcand does: no answer, which clients would take for a frame
            self.bad += 1

    def _send(self, word: str, flags: int, length: int, data: bytes) -> None:
        assert self.member is not None
        identifier, is_extended = _identifier(word)
        self.member.channel.send(
            self.member, identifier, flags | (EXTENDED if is_extended else 0), length, data
        )

    def happened(self, event: SimulatedBusEvent) -> None:
        """Send errors of the node as error frames."""
        code = _CLASSES.get(event.kind)
        if code is not None and self._is_raw and (event.kind, event.frame) != self._last:
            self._last = (event.kind, event.frame)
            self._say(f"< error {code:03X} {_stamp(event.instant + self.server.epoch_ns)} >".encode())

    def _say(self, text: bytes) -> None:
        if len(self._answers) < 2 * _ANSWERS:
            self._answers += text
        self.woken()

    def output(self) -> bytes:
        """Return output for the client: answers, then frames."""
        answers, self._answers = self._answers, b""
        member = self.member
        if answers or member is None or self.server.clock.now() < self._quiet_until:
            return answers
        while member.queue:
            text = b"".join(map(self._frame, self._take_records()))
            if text:  # in BCM mode a whole batch may be unsubscribed
                return text
        return b""

    def _frame(self, record: bytes) -> bytes:
        time_ns, identifier, flags, length, data = unpacked(record)
        is_extended = bool(flags & EXTENDED)
        if not self._is_raw and (identifier, is_extended) not in self._subscribed:
            return b""
        word = f"{identifier:08X}" if is_extended else f"{identifier:03X}"
        if flags & REMOTE:
            return f"< rtr {word} {_stamp(time_ns)} {length} >".encode()
        text = data[:length].hex().upper()
        if flags & FD:
            more = (1 if flags & BITRATE_SWITCH else 0) | (2 if flags & ERROR_STATE else 0)
            return f"< fdframe {word} {more:02X} {_stamp(time_ns)} {text} >".encode()
        return f"< frame {word} {_stamp(time_ns)} {text} >".encode()


def _stamp(time_ns: int) -> str:
    return f"{time_ns // 1_000_000_000}.{time_ns // 1000 % 1_000_000:06d}"


def _identifier(word: str) -> tuple[int, bool]:
    """Return (identifier, whether it is extended): by the number of digits."""
    number = int(word, 16)
    is_extended = len(word) == 8
    if not 0 <= number <= (0x1FFF_FFFF if is_extended else 0x7FF):
        raise ValueError(word)
    return number, is_extended


def _length(word: str) -> int:
    length = int(word)
    if not 0 <= length <= 8:
        raise ValueError(word)
    return length


def _data(words: list[str], length: int, most: int) -> bytes:
    if len(words) != length or length > most:
        raise ValueError(words)
    return bytes(int(word, 16) for word in words)
