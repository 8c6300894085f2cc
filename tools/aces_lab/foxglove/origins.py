"""The way to a WebSocket server: which browsers' pages may come, before the server sees them.

1. A page of any website may open a WebSocket to a program on its visitor's machine; what browsers add is where the page is
   from, its origin. Those that are not allowed are refused (403). Programs that are not browsers say none, and are let in.
2. The server itself is where no page can guess it: at an address 127.x.y.z drawn by lot, where the system has those.
3. What a viewer sends and gets is passed on as it is; one that stops reading holds up nobody but itself.

*Fact*: RFC 6455 §10.2 leaves the check to the server, and foxglove-sdk 0.30 makes none: it takes any origin.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
from collections.abc import Callable, Collection, Generator
from contextlib import contextmanager, suppress
from urllib.parse import urlsplit

from aces_bus.errors import CallerError
from aces_bus.loopback import is_loopback

#: The app in the browser; the desktop's pages are files.
APP_ORIGINS = frozenset(("https://app.foxglove.dev", "file://"))
#: Bytes of a request, and how long it may take (s).
MOST_BYTES, REQUEST_S = 16_384, 10.0
MOST_VIEWERS = 32
#: Bytes that are passed on at once.
PIECE = 1 << 16


def hidden_host() -> str:
    """Return a loopback address that no page can guess, where the system has others than 127.0.0.1."""
    if sys.platform not in ("linux", "win32"):
        return "127.0.0.1"
    a, b, c = os.urandom(3)
    return f"127.{a}.{b}.{1 + c % 254}"


def is_allowed(origin: str, origins: Collection[str] = ()) -> bool:
    """Return whether a page may look: the app, pages of this machine, and those of `origins`.

    >>> is_allowed("https://app.foxglove.dev"), is_allowed("http://localhost:8080"), is_allowed("https://127.0.evil.example")
    (True, True, False)
    """
    if origin in APP_ORIGINS or origin in origins:
        return True
    try:
        parts = urlsplit(origin)
        return parts.scheme in ("http", "https") and is_loopback(parts.hostname or "")
    except ValueError:
        return False


class _Refused(Exception):
    """A request that is answered with a status."""


class OriginGate:
    """Listens at `host` and `port`, and passes on to `server` who may come. Raises `CallerError` when the port is taken.

    `refused` is called with a sentence for each page that is not let in, on a thread of its own.
    """

    def __init__(
        self,
        host: str,
        port: int,
        server: tuple[str, int],
        origins: Collection[str] = (),
        refused: Callable[[str], object] = lambda text: None,
    ) -> None:
        self._server, self._origins, self._refused = server, origins, refused
        self._sockets: set[socket.socket] = set()
        self._lock = threading.Lock()
        self._is_closed = False
        #: Viewers that are connected; pages that were refused.
        self.viewers = self.refusals = 0
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self._listener = socket.create_server((host, port), family=family, backlog=8)
        except (OSError, OverflowError) as error:
            number = getattr(error, "errno", None)
            why = os.strerror(number) if number and number > 0 else error
            raise CallerError(f"{host}:{port} cannot be served ({why})") from None
        self.port = int(self._listener.getsockname()[1])
        self._thread = threading.Thread(target=self._accept, name="foxglove gate", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Refuse new connections, and end those that there are."""
        with self._lock:
            self._is_closed = True
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        with self._lock:
            known = [*self._sockets]
        for connection in known:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        self._thread.join(5.0)

    def _accept(self) -> None:
        while not self._is_closed:
            try:
                viewer, _ = self._listener.accept()
            except OSError:
                if self._is_closed:
                    return
                continue  # gone before it was there
            threading.Thread(target=self._serve, args=(viewer,), name="foxglove viewer", daemon=True).start()

    def _serve(self, viewer: socket.socket) -> None:
        """Serve one viewer, from its request to its end."""
        with suppress(OSError), viewer, self._kept(viewer):
            try:
                request = self._request(viewer)
            except _Refused as refusal:
                text = f"{refusal}\n".encode()
                head = f"HTTP/1.1 403 Forbidden\r\nContent-Length: {len(text)}\r\nConnection: close\r\n\r\n"
                viewer.sendall(head.encode() + text)
                return
            with socket.create_connection(self._server, 5.0) as server, self._kept(server):
                viewer.settimeout(None)
                server.settimeout(None)
                for side in (viewer, server):
                    side.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                server.sendall(request)
                self._change(1)
                try:
                    back = threading.Thread(
                        target=_pass_on, args=(server, viewer), name="foxglove viewer", daemon=True
                    )
                    back.start()
                    _pass_on(viewer, server)
                    back.join()
                finally:
                    self._change(-1)

    def _change(self, by: int) -> None:
        with self._lock:
            self.viewers += by

    @contextmanager
    def _kept(self, connection: socket.socket) -> Generator[None]:
        """Keep a connection while it is open: `close` ends it."""
        with self._lock:
            if self._is_closed:
                raise OSError("closed")
            self._sockets.add(connection)
        try:
            yield
        finally:
            with self._lock:
                self._sockets.discard(connection)

    def _request(self, viewer: socket.socket) -> bytes:
        """Return the request, whole, if its page may look; raises `_Refused`."""
        viewer.settimeout(REQUEST_S)
        data = b""
        while b"\r\n\r\n" not in data:
            piece = viewer.recv(4096)
            if not piece or len(data) > MOST_BYTES:
                raise OSError("no request")
            data += piece
        lines = data.partition(b"\r\n\r\n")[0].decode("latin-1").split("\r\n")[1:]
        found = [
            value.strip() for name, _, value in (line.partition(":") for line in lines) if _is_origin(name)
        ]
        if len(found) > 1 or any(not is_allowed(origin, self._origins) for origin in found):
            self.refusals += 1
            origin = ", ".join(found)[:200]
            self._refused(f"a page of {origin} wanted to look on, and was refused")
            raise _Refused(f"pages of {origin} may not look on")
        if self.viewers >= MOST_VIEWERS:
            raise _Refused(f"{MOST_VIEWERS} viewers are here already")
        return data


def _is_origin(name: str) -> bool:
    return name.strip().lower() == "origin"


def _pass_on(source: socket.socket, sink: socket.socket) -> None:
    """Pass all bytes on, up to the end of one of the two; both are shut then."""
    with suppress(OSError):
        while piece := source.recv(PIECE):
            sink.sendall(piece)
    for side in (source, sink):
        with suppress(OSError):
            side.shutdown(socket.SHUT_RDWR)
