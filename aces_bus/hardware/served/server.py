"""The server of virtual buses: one thread, one clock, many clients.

1. Nothing that a client says, leaves unsaid or does not read stops the bus or another client: a bad one is cut off.
2. What is open at once is bounded: clients, what they may say before they introduce themselves, what waits for them.
3. Its files are gone when it ends, and only its own.

One loop: let the clock catch up with the machine's (the wires move), send what has come up, wait for the next event of the
clock or of a socket. `select` waits in microseconds, where `epoll` rounds up to milliseconds: a frame takes 100 µs.
"""

from __future__ import annotations

import os
import select
import socket
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple, Self

from ...errors import AcesError, CallerError
from ...runtime import VirtualClock
from .address import (
    ServedAddress,
    bind_tcp,
    bind_unix,
    check_loopback,
    default_socket,
    runtime_folder,
    write_note,
)
from .channel import PacketLink, ServedChannel, ServerLink, peer_of
from .packets import PacketError
from .socketcand import SocketcandLink

#: Clients at once; `select` knows 1,024 files.
CLIENTS = 256
#: Seconds that a client may take to say who it is.
INTRODUCTION_S = 30
#: Seconds between looks at the world when nothing happens.
_IDLE_S = 60.0
#: The buses catch up with this machine's clock for so long (ns) at a time, in slices of so much of their time (ns).
_TURN_NS, _SLICE_NS = 20_000_000, 1_000_000


class _Listener(NamedTuple):
    """A listening socket, and what its connections speak; `only`: the channel that it is of."""

    socket: socket.socket
    kind: str
    only: str


class BusServer:
    """Serves channels until it is stopped.

    `unix`: the path of the socket of a single channel, of the folder for several, "" for this user's runtime folder, None
    for no Unix socket. `tcp` and `socketcand`: (host, port), port 0 for any free one. Hosts that other machines can reach
    are refused unless `bind_anywhere`. `said` gets a line about each client that is cut off.

        with BusServer([ServedChannel("can0")]):
            bus = can.Bus(interface="aces", channel="unix:can0")

    Raises `CallerError` when an address cannot be had.
    """

    def __init__(
        self,
        channels: Iterable[ServedChannel],
        *,
        unix: str | None = "",
        tcp: tuple[str, int] | None = None,
        socketcand: tuple[str, int] | None = None,
        bind_anywhere: bool = False,
        said: Callable[[str], None] | None = None,
    ) -> None:
        self.channels = {channel.name: channel for channel in channels}
        if not self.channels:
            raise CallerError("no channel to serve")
        if unix is None and tcp is None and socketcand is None:
            raise CallerError("nowhere to serve: say a Unix socket, tcp or socketcand")
        self._said = said
        self.clock = VirtualClock(time.monotonic_ns())
        self.epoch_ns = time.time_ns() - time.monotonic_ns()
        #: Links with something to send.
        self.dirty: list[ServerLink] = []
        #: Clients that were cut off for what they said, and connections refused because there were too many.
        self.cut = self.refused = 0
        #: Channel → where it is served, as `can.Bus` takes it.
        self.addresses: dict[str, list[str]] = {name: [] for name in self.channels}
        #: Where socketcand is spoken.
        self.socketcand = ""
        self._links: dict[int, ServerLink] = {}
        self._blocked: dict[int, ServerLink] = {}
        self._listeners: dict[int, _Listener] = {}
        self._files: list[tuple[str, int, int]] = []
        self._note: Path | None = None
        self._waker, self._woken = socket.socketpair()
        self._waker.setblocking(False)
        self._woken.setblocking(False)
        self._stopping = False
        self._thread: threading.Thread | None = None
        try:
            self._bind(unix, tcp, socketcand, bind_anywhere=bind_anywhere)
        except BaseException:
            self.close()
            raise
        for channel in self.channels.values():
            channel.start(self.clock, self.epoch_ns)

    # ------------------------------------------------------------------ where it listens

    def _bind(
        self,
        unix: str | None,
        tcp: tuple[str, int] | None,
        socketcand: tuple[str, int] | None,
        *,
        bind_anywhere: bool,
    ) -> None:
        if not bind_anywhere:
            for where in (tcp, socketcand):
                if where is not None:
                    check_loopback(*where)
        if unix is not None:
            for name in self.channels:
                path = self._unix_path(unix, name)
                listener = bind_unix(path)
                found = os.stat(path)
                self._files.append((path, found.st_dev, found.st_ino))
                self._listen(listener, "unix", name)
                self.addresses[name].append(str(ServedAddress(path=path)))
        if tcp is not None:
            listener = bind_tcp(*tcp)
            self._listen(listener, "tcp", next(iter(self.channels)) if len(self.channels) == 1 else "")
            host, port = listener.getsockname()[:2]
            for name in self.channels:
                self.addresses[name].append(str(ServedAddress(host=host, port=port, channel=name)))
        if socketcand is not None:
            listener = bind_tcp(*socketcand)
            self._listen(listener, "socketcand")
            host, port = listener.getsockname()[:2]
            self.socketcand = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        try:
            self._note = write_note({"pid": os.getpid(), "addresses": self.addresses})
        except (CallerError, OSError):
            if unix == "":
                raise  # then the sockets are nowhere either

    def _unix_path(self, unix: str, name: str) -> str:
        if not unix:
            runtime_folder(create=True)
            return str(default_socket(name))
        if len(self.channels) == 1:
            return os.path.abspath(unix)
        try:
            os.makedirs(unix, mode=0o700, exist_ok=True)
        except OSError as error:
            raise CallerError(f"{unix}: cannot be made a folder: {error.strerror}") from error
        return os.path.join(os.path.abspath(unix), f"{name}.sock")

    def _listen(self, sock: socket.socket, kind: str, only: str = "") -> None:
        sock.setblocking(False)
        self._listeners[sock.fileno()] = _Listener(sock, kind, only)

    # ------------------------------------------------------------------ running

    def start(self) -> Self:
        """Serve on a thread of its own. Raises `CallerError` when it has been started before."""
        if self._thread is not None:
            raise CallerError("this server was started before; make another")
        self._thread = threading.Thread(target=self.serve, name="served bus", daemon=True)
        self._thread.start()
        return self

    def stop(self) -> None:
        """End the serving; from any thread, or a signal's handler."""
        self._stopping = True
        try:
            self._waker.send(b"\0")
        except OSError:
            pass  # it is full of the same, or closed

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()
        if self._thread is not None:
            self._thread.join(10)

    def serve(self) -> None:
        """Serve until `stop`, on the caller's thread; then close."""
        clock, links, listeners = self.clock, self._links, self._listeners
        woken = self._woken.fileno()
        always = [*listeners, woken]
        try:
            while not self._stopping:
                self._catch_up()
                if self.dirty:
                    self._flush()
                following = clock.next_event
                wait = _IDLE_S
                if following is not None:
                    wait = min(max(0, following - time.monotonic_ns()) / 1e9, _IDLE_S)
                reading = always + [fd for fd, link in links.items() if link.wants_input]
                readable, writable, _ = select.select(reading, list(self._blocked), [], wait)
                if readable or writable:
                    self._catch_up()
                for fd in readable:
                    link = links.get(fd)
                    if link is not None:
                        self._guarded(link, link.readable)
                    elif fd in listeners:
                        self._accept(listeners[fd])
                for fd in writable:
                    link = links.get(fd)
                    if link is not None:
                        self.dirty.append(link)
        finally:
            self.close()

    def _catch_up(self) -> None:
        """Bring the buses to this machine's time; where that takes long, some of the way, and clients are served first."""
        clock, now = self.clock, time.monotonic_ns()
        until = now + _TURN_NS
        while (at := clock.now()) < now:
            clock.advance_to(min(now, max(at, clock.next_event or now) + _SLICE_NS))
            if time.monotonic_ns() > until:
                break

    def _flush(self) -> None:
        dirty, self.dirty = self.dirty, []
        for link in dirty:
            self._guarded(link, link.flush)

    def _guarded(self, link: ServerLink, action: Callable[[], None]) -> None:
        """End a link when anything goes wrong with it."""
        if link.is_closed:
            return
        try:
            action()
        except EOFError:  # it has gone, and all that it said was read
            self._drop(link)
        except OSError:  # it has gone: what it has sent before, a stop perhaps, is still read
            link.hear_out()
            self._drop(link)
        except PacketError as error:
            self._cut(link, str(error))
        except Exception as error:  # a fault of ours must not cost the others their bus
            self._cut(link, f"{type(error).__name__}: {error}")

    def _cut(self, link: ServerLink, why: str) -> None:
        self.cut += 1
        if isinstance(link, PacketLink):
            link.refuse(why)
        self._drop(link)
        if self._said is not None:
            self._said(f"{link.name} was cut off: {why}")

    def _drop(self, link: ServerLink) -> None:
        if link.is_closed:
            return
        link.is_closed = True
        self._links.pop(link.fd, None)
        self._blocked.pop(link.fd, None)
        if link.member is not None:
            link.member.channel.leave(link.member)
        link.stream.close()

    def blocked(self, link: ServerLink) -> None:
        """Note that a link's socket is full, or not any more."""
        if link.is_blocked:
            self._blocked[link.fd] = link
        else:
            self._blocked.pop(link.fd, None)

    # ------------------------------------------------------------------ clients

    def _accept(self, listener: _Listener) -> None:
        try:
            stream, where = listener.socket.accept()
        except OSError:  # it has gone, or there are no more files to open
            return
        stream.setblocking(False)
        if len(self._links) >= CLIENTS or stream.fileno() >= 1000:
            self.refused += 1
            stream.close()
            return
        if stream.family != getattr(socket, "AF_UNIX", -1):
            stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            peer = peer_of(stream, where)
        except OSError:
            stream.close()
            return
        link: ServerLink
        if listener.kind == "socketcand":
            link = SocketcandLink(self, stream, peer)
        else:
            link = PacketLink(self, stream, peer, listener.kind, listener.only)
        self._links[link.fd] = link
        self.clock.call_in(INTRODUCTION_S * 1_000_000_000, lambda: self._impatient(link))

    def _impatient(self, link: ServerLink) -> None:
        if link.member is None and not link.is_closed and not link.is_introduced:
            self._cut(link, f"it did not say within {INTRODUCTION_S} s who it is")

    def find(self, name: str) -> ServedChannel:
        """Return a channel by its name."""
        channel = self.channels.get(name)
        if channel is None:
            names = ", ".join(self.channels)
            raise PacketError(
                f"no channel {name!r} is served here; there are: {names}"
                if name
                else f"say which channel: {names}"
            )
        return channel

    def status(self) -> dict[str, Any]:
        """Return what there is to know about the server and its channels."""
        return {
            "pid": os.getpid(),
            "clients": len(self._links),
            "cut": self.cut,
            "refused": self.refused,
            "socketcand": self.socketcand,
            "channels": [
                {**channel.status(), "addresses": self.addresses[name]}
                for name, channel in self.channels.items()
            ],
        }

    # ------------------------------------------------------------------ the end

    def close(self) -> None:
        """Close everything and remove our files. What `serve` does at its end."""
        for link in list(self._links.values()):
            try:
                link.flush()
            except (OSError, AcesError):
                pass
            self._drop(link)
        for listener in self._listeners.values():
            listener.socket.close()
        self._listeners.clear()
        for path, device, inode in self._files:
            try:
                found = os.stat(path)
                if (found.st_dev, found.st_ino) == (device, inode):
                    os.unlink(path)
            except OSError:
                pass
        self._files.clear()
        if self._note is not None:
            self._note.unlink(missing_ok=True)
            self._note = None
        self._waker.close()
        self._woken.close()
