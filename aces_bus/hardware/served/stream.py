"""A client's connection to a server of buses, and how servers are found.

1. Every wait has an end, and costs nothing until then.
2. A packet is sent whole or not at all, as far as the next one is concerned: the rest of one goes before another.
"""

from __future__ import annotations

import json
import os
import select
import socket
import time
from typing import Any

from ...errors import AcesError
from . import packets
from .address import ServedAddress, check_timeout, notes
from .packets import PacketError

#: Seconds that a server may take to answer an introduction or a question.
ANSWER_S = 15.0
#: What the system may hold of what is offered and not read by the server (bytes; Linux gives twice as much): some ticks
#: of a robot. What it does not take waits in a gate, where a stop goes first.
OFFERED = 8192
#: Bytes that are read at once.
_READ = 16_384


def wait(number: int, timeout: float | None, *, writing: bool = False) -> bool:
    """Wait until a socket has something to read (or room to write), at most `timeout` seconds (None: however long it
    takes).
    """
    timeout = None if timeout is None else max(0.0, timeout)
    if number < 1000:
        numbers = (number,)
        found = (
            select.select((), numbers, (), timeout) if writing else select.select(numbers, (), (), timeout)
        )
        return bool(found[writing])
    poll = select.poll()  # takes any number, and rounds up to milliseconds
    poll.register(number, select.POLLOUT if writing else select.POLLIN)
    return bool(poll.poll(None if timeout is None else timeout * 1000))


class ServerConnection:
    """A connection to a server, introduced. `early` are packets that came with the answer.

    Raises `OSError` when no server answers, and `PacketError` with the server's reason when it refuses.
    """

    def __init__(self, address: ServedAddress, hello: packets.Hello, timeout: float = ANSWER_S) -> None:
        self._socket = address.connect(timeout)
        self._buffer = self._rest = b""
        self.early: list[tuple[int, bytes]] = []
        try:
            self._socket.setblocking(False)
            self.number = self._socket.fileno()
            self.write(packets.value_packet(hello), timeout)
            self.welcome = self._answer(time.monotonic() + timeout)
        except EOFError as error:
            self.close()
            raise PacketError("the server has closed the connection") from error
        except BaseException:
            self.close()
            raise

    def _answer(self, until: float) -> packets.Welcome:
        welcome = None
        while welcome is None:
            left = until - time.monotonic()
            if left <= 0 or not wait(self.number, left):
                raise TimeoutError("no answer in time")
            for kind, body in self.read():
                if kind == packets.REFUSED:
                    raise PacketError(body.decode("utf-8", "replace"))
                if kind == packets.WELCOME:
                    welcome = packets.read_value(body, packets.Welcome)
                else:
                    self.early.append((kind, body))
        return welcome

    def read(self) -> list[tuple[int, bytes]]:
        """Return the packets that have come. Raises `EOFError` at the end."""
        return self.split(self.receive())

    def receive(self) -> bytes:
        """Return the bytes that have come, with what was left of those before: for `split`. Raises as `read`."""
        try:
            data = self._socket.recv(_READ)
        except BlockingIOError:
            return b""
        if not data:
            raise EOFError("the server has closed the connection")
        if self._buffer:
            data, self._buffer = self._buffer + data, b""
        return data

    def split(self, data: bytes) -> list[tuple[int, bytes]]:
        """Return the whole packets of what `receive` gave; the rest is kept."""
        found, rest = packets.split_packets(data)
        if rest:
            self._buffer = rest
        return found

    def write(self, packet: bytes, timeout: float | None = None) -> None:
        """Send a packet. Raises `TimeoutError` when the socket takes nothing for so long (None: for ever)."""
        if self._rest:
            self._push(timeout)
        count = 0
        while not count:
            try:
                count = self._socket.send(packet)
            except BlockingIOError:
                if not wait(self.number, timeout, writing=True):
                    raise TimeoutError("the server takes nothing") from None
        if count < len(packet):
            self._rest = packet[count:]
            self._push(None)

    def hold_little(self) -> None:
        """Have what the server does not read wait here from now on, and not with the system."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, OFFERED)

    def offer(self, packet: bytes) -> bool:
        """Send a packet without waiting; whether the socket took it. What it left of one goes with `push`."""
        if not self.push():
            return False
        try:
            self._rest = packet[self._socket.send(packet) :]
        except BlockingIOError:
            return False
        return True

    def push(self) -> bool:
        """Send the rest of a packet without waiting; whether nothing is left of it."""
        if self._rest:
            try:
                self._rest = self._rest[self._socket.send(self._rest) :]
            except BlockingIOError:
                pass
        return not self._rest

    def _push(self, timeout: float | None) -> None:
        while self._rest:
            if not wait(self.number, timeout, writing=True):
                raise TimeoutError("the server takes nothing")
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


# ---------------------------------------------------------------------- finding servers


def ask(address: ServedAddress, timeout: float = 1.0) -> dict[str, Any]:
    """Ask a server for its status, without joining a bus. Raises `OSError` or `PacketError`."""
    stream = ServerConnection(address, packets.Hello(address.channel, looks=True), timeout)
    try:
        stream.write(packets.packet(packets.QUERY), timeout)
        until = time.monotonic() + timeout
        while (left := until - time.monotonic()) > 0 and wait(stream.number, left):
            for kind, body in stream.read():
                if kind == packets.STATUS:
                    return read_status(body)
        raise TimeoutError("no answer in time")
    except EOFError as error:
        raise PacketError("the server has closed the connection") from error
    finally:
        stream.close()


def read_status(body: bytes) -> dict[str, Any]:
    """Return what a server says about itself."""
    try:
        found = json.loads(body)
    except ValueError as error:
        raise PacketError(f"no status: {error}") from error
    if not isinstance(found, dict) or not isinstance(found.get("channels"), list):
        raise PacketError("no status")
    return found


def servers(timeout: float = ANSWER_S) -> list[dict[str, Any]]:
    """Return the status of each server of this user on this machine that answers within `timeout` seconds.

    A server that is dead refuses at once, and its note is removed; only one that hangs is waited for.
    Raises `CallerError` for a time-out that is none.
    """
    check_timeout(timeout)
    found = []
    for path, content in notes():
        listed = content.get("addresses")
        texts = [
            text
            for some in (listed.values() if isinstance(listed, dict) else ())
            if isinstance(some, list)
            for text in some
            if isinstance(text, str)
        ]
        status = None
        for text in texts:
            try:
                status = ask(ServedAddress.parse(text), timeout)
                break
            except TimeoutError:  # at its other addresses the same one would be waited for
                break
            except (OSError, AcesError):
                continue
        if status is not None:
            found.append(status)
        elif not _lives(content.get("pid")):
            path.unlink(missing_ok=True)
    return found


def _lives(pid: object) -> bool:
    if not isinstance(pid, int) or pid <= 0 or os.name != "posix":
        return True  # it cannot be found out
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def served_channels() -> dict[str, str]:
    """Return the channels that are served on this machine by this user: one address of each, by its name."""
    return {
        channel["channel"]: channel["addresses"][0]
        for status in servers()
        for channel in status["channels"]
        if channel.get("addresses")
    }
