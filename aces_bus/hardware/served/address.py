"""Where served buses are found: `unix:/path/to.sock`, `unix:can0`, `tcp:127.0.0.1:29536/can0`.

1. What is ours in the file system is for its owner alone: folder 0700, sockets 0600. A folder of another user is refused.
2. A socket file whose server is dead is replaced; one whose server lives never is.

Servers leave a note in the user's runtime folder (`$XDG_RUNTIME_DIR/aces`, else `aces-UID` among the temporary files) that
says where they listen; that is how `aces bus list` and `can.detect_available_configs` find them.
"""

from __future__ import annotations

import json
import os
import socket
import stat
import tempfile
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import CallerError
from ...loopback import is_loopback

#: socketcand's port; the one after it is ours.
SOCKETCAND_PORT, PORT = 29536, 29537
#: Bytes of a path that a Unix socket can have (the kernel's `sun_path`, less the zero behind it).
#: What a program waits for a server at most: a day.
LONGEST_S = 86_400.0
_PATH_MOST = 107
_NOTE_MOST = 1 << 20


@dataclass(frozen=True)
class ServedAddress:
    """A server, and a channel of it: `channel` "" is its only one. Either `path` or `host` and `port` are set."""

    path: str = ""
    host: str = ""
    port: int = 0
    channel: str = ""

    def __str__(self) -> str:
        if self.path:
            return f"unix:{self.path}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"tcp:{host}:{self.port}" + (f"/{self.channel}" if self.channel else "")

    def connect(self, timeout: float) -> socket.socket:
        """Open a stream to the server, `timeout` in s; raises `OSError`, and `CallerError` as `check_timeout`."""
        check_timeout(timeout)
        if not self.path:
            stream = socket.create_connection((self.host, self.port), timeout)
            stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return stream
        stream = socket.socket(_unix())
        try:
            stream.settimeout(timeout)
            stream.connect(self.path)
        except OSError:
            stream.close()
            raise
        return stream

    @staticmethod
    def is_served(channel: object) -> bool:
        """Return whether a channel's name is an address of a served bus."""
        return isinstance(channel, str) and channel.startswith(("unix:", "tcp:"))

    @staticmethod
    def parse(text: str) -> ServedAddress:
        """Parse `unix:PATH`, `unix:NAME` (a default socket of this user) or `tcp:HOST:PORT[/CHANNEL]`."""
        kind, _, rest = text.partition(":")
        if kind == "unix" and rest:
            return ServedAddress(path=rest if "/" in rest or os.sep in rest else str(default_socket(rest)))
        if kind == "tcp":
            where, _, channel = rest.partition("/")
            host, port = ServedAddress.parse_host(where, None)
            return ServedAddress(host=host, port=port, channel=channel)
        raise CallerError(
            f"{text!r} is not an address of a served bus; they are unix:PATH, unix:NAME or tcp:HOST:PORT[/CHANNEL]"
        )

    @staticmethod
    def parse_host(text: str, port: int | None) -> tuple[str, int]:
        """Parse HOST:PORT, [HOST]:PORT, or HOST alone with the default `port`. An empty host is this machine."""
        host, colon, number = text.rpartition(":")
        if (not colon or text.endswith("]")) and port is not None:
            host, number = text, str(port)
        if not number.isascii() or not number.isdigit() or int(number) > 65_535:
            raise CallerError(f"{text!r} is not a HOST:PORT")
        return host.strip("[]") or "127.0.0.1", int(number)


def check_timeout(timeout: float) -> None:
    """Raise `CallerError` for what is not a time (s) that a program can wait."""
    if not 0 < timeout <= LONGEST_S:
        raise CallerError(f"a time-out of {timeout:g} s: it is more than 0 and at most {LONGEST_S:g}")


def check_loopback(host: str, port: int) -> None:
    """Refuse an address that other machines can reach."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as error:
        raise CallerError(f"{host}: {error.strerror or error}") from error
    for _, _, _, _, where in found:
        if not is_loopback(str(where[0])):
            raise CallerError(
                f"{host} can be reached from other machines, and whoever does may send; say --bind-anywhere if you mean it"
            )


def _unix() -> int:
    family = getattr(socket, "AF_UNIX", None)
    if family is None:
        raise CallerError("this system has no Unix sockets; use tcp:HOST:PORT")
    return int(family)


# ---------------------------------------------------------------------- the runtime folder


def runtime_folder(*, create: bool = False) -> Path:
    """Return where this user's sockets and notes are. Raises `CallerError` when it belongs to another user."""
    given = os.environ.get("XDG_RUNTIME_DIR")
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(given, "aces") if given else Path(tempfile.gettempdir(), f"aces-{user}")
    if create:
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise CallerError(f"{folder}: cannot be made: {error.strerror}") from error
    if hasattr(os, "getuid") and folder.exists():
        found = os.lstat(folder)
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != user or found.st_mode & 0o022:
            raise CallerError(
                f"{folder} is not a folder of this user alone; remove it or set XDG_RUNTIME_DIR"
            )
    return folder


def default_socket(channel: str) -> Path:
    """Return the default socket of a channel."""
    return runtime_folder() / f"{channel}.sock"


def write_note(content: dict[str, Any]) -> Path:
    """Say where this process serves; the file is to be removed at the end."""
    folder = runtime_folder(create=True)
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", dir=folder, prefix="server-", suffix=".tmp", delete=False
    ) as file:
        json.dump(content, file)
    path = Path(file.name).with_suffix(".json")
    os.replace(file.name, path)  # readers see all of it or nothing
    return path


def notes() -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield what this user's servers have left."""
    try:
        paths = sorted(runtime_folder().glob("server-*.json"))
    except CallerError:
        return
    for path in paths:
        try:
            if path.stat().st_size > _NOTE_MOST:
                continue
            content = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        if isinstance(content, dict):
            yield path, content


# ---------------------------------------------------------------------- binding


def bind_unix(path: str) -> socket.socket:
    """Open a listening socket at `path`, 0600. Raises `CallerError` when it is served already or cannot be made."""
    if len(os.fsencode(path)) > _PATH_MOST:
        raise CallerError(f"{path}: longer than the {_PATH_MOST} bytes that a Unix socket's path can have")
    listener = socket.socket(_unix())
    try:
        with _alone(os.path.dirname(path) or "."):
            if os.path.lexists(path):
                _clear(path)
            before = os.umask(0o177)
            try:
                listener.bind(path)
            finally:
                os.umask(before)
        listener.listen(16)
    except OSError as error:
        listener.close()
        raise CallerError(f"{path}: cannot be served: {error.strerror or error}") from error
    except CallerError:
        listener.close()
        raise
    return listener


def _clear(path: str) -> None:
    """Remove the socket of a dead server."""
    if not stat.S_ISSOCK(os.lstat(path).st_mode):
        raise CallerError(f"{path} exists and is not a socket; choose another path")
    try:
        ServedAddress(path=path).connect(1.0).close()
    except ConnectionRefusedError:
        os.unlink(path)
        return
    except OSError as error:
        raise CallerError(f"{path}: cannot be served: {error.strerror or error}") from error
    raise CallerError(f"{path} is served already; join it (-i aces -c unix:{path}) or choose another path")


@contextmanager
def _alone(folder: str) -> Generator[None]:
    """Hold a lock while one server looks for dead sockets in a folder; go on without it after a second."""
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        for _ in range(20):
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except OSError:
                time.sleep(0.05)
        yield
    finally:
        os.close(handle)


def bind_tcp(host: str, port: int) -> socket.socket:
    """Open a listening TCP socket. Raises `CallerError`."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # elsewhere it would let two servers share a port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(16)
    except OSError as error:
        listener.close()
        raise CallerError(f"{host}:{port}: cannot be served: {error.strerror or error}") from error
    return listener
