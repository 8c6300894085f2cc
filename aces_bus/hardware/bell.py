"""A bell beside a bus's lock: by it any program asks the one that drives the bus to stop what it drives.

1. Ringing takes no right: a stop is always let through.
2. The driving program answers twice: at once, when its stops are on their way, and again when it knows who has stopped.
3. A program that is suspended or hangs does not answer. It finds the request when it goes on, before it sends anything.

The bell is a Unix datagram socket in the folder of the locks; messages are JSON. Where there are no such sockets (Windows)
there is no bell, and who stops a robot sends the stops itself.
"""

from __future__ import annotations

import json
import os
import select
import socket
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Self
from uuid import uuid4

from ..plain_text import printable

#: The largest message (bytes), how many requests are read together, and the longest name of a program (characters).
MESSAGE_SIZE, MOST_REQUESTS, NAME_SIZE = 1 << 16, 16, 80
_FAMILY = getattr(socket, "AF_UNIX", None)


class StopRequest:
    """A request of another program (`who`: its name and process) to stop what this one drives."""

    def __init__(self, bell: socket.socket, who: str, sender: str | None) -> None:
        self.who, self._bell, self._sender = who, bell, sender

    def answer(self, **content: Any) -> None:
        """Send the other program an answer; nothing happens where it has gone."""
        if self._sender is None:  # a socket without a name
            return
        with suppress(OSError):
            self._bell.sendto(json.dumps(content).encode(), self._sender)


class StopBell:
    """The bell of a program that drives a bus."""

    def __init__(self, path: Path) -> None:
        """Hang it up. Raises `OSError` where there cannot be one."""
        self._path, self._socket = path, _bound(path)

    def fileno(self) -> int:
        """Return the number of its file, which is readable when it was rung."""
        return self._socket.fileno()

    def read(self) -> list[StopRequest]:
        """Return the requests that have come."""
        found: list[StopRequest] = []
        with suppress(OSError):
            while len(found) < MOST_REQUESTS:
                data, sender = self._socket.recvfrom(MESSAGE_SIZE)
                found.append(StopRequest(self._socket, program_of(_content(data)), sender))
        return found

    def close(self) -> None:
        """Take it down."""
        with suppress(OSError):
            self._path.unlink()
        self._socket.close()


class Ringing:
    """A request that this program has sent to the bell at `path`. A context manager.

    Raises `OSError` where nobody has a bell there.
    """

    def __init__(self, path: Path, who: str) -> None:
        self._own = path.with_name(f"{uuid4().hex[:16]}.answer")
        self._socket = _bound(self._own)
        try:
            self._socket.sendto(json.dumps({"who": who}).encode(), os.fspath(path))
        except OSError:
            self.close()
            raise

    def wait(self, timeout_s: float) -> dict[str, Any] | None:
        """Wait for the next answer; None when none came in time."""
        end = time.monotonic() + timeout_s
        while select.select([self._socket], (), (), max(0.0, end - time.monotonic()))[0]:
            with suppress(OSError):
                return _content(self._socket.recv(MESSAGE_SIZE))
        return None

    def close(self) -> None:
        """Wait for no answer any more."""
        with suppress(OSError):
            self._own.unlink()
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def program_of(content: Mapping[str, Any]) -> str:
    """Return the name of the program that sent a message, safe to print; "another program" where it gives none."""
    who = content.get("who")
    return printable(who[:NAME_SIZE]) if isinstance(who, str) and who.strip() else "another program"


def _bound(path: Path) -> socket.socket:
    if _FAMILY is None:
        raise OSError("this system has no Unix sockets")
    made = socket.socket(_FAMILY, socket.SOCK_DGRAM)
    try:
        made.setblocking(False)
        path.unlink(missing_ok=True)  # left by a program that was killed
        made.bind(os.fspath(path))
        path.chmod(0o666)
    except OSError:
        made.close()
        raise
    return made


def _content(data: bytes) -> dict[str, Any]:
    """Return the content of a message; nothing of one that is not ours."""
    try:
        found = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
