"""Who drives a bus: a lock between the programs of one machine, so that two never drive one robot by accident.

1. It is advisory: it binds those who take it, whatever user they run as. Who only listens takes none.
2. The system holds it: it is gone when its program is, kill -9 included. What is left of it is a file that says nothing.
3. A refusal names the program that has the lock, and its process.
4. A stop takes no lock: who has it can be asked to stop (`bell`), and is passed over where it does not answer.

The lock is `flock(2)` on a file in a folder of the temporary files that all users share, named after the bus's channel.
Where there is no `flock` (Windows) there is no lock.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from urllib.parse import quote

from ..errors import CallerError
from ..plain_text import printable
from ..runtime.loop import Loop
from .bell import Ringing, StopBell, StopRequest
from .served.address import ServedAddress

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]

#: Characters of a program's name in a lock, and of a channel's in a file's name.
NAME_LENGTH, FILE_LENGTH = 100, 150


class BusLock:
    """The right to drive the bus at `channel` ("can0", "/dev/ttyUSB0"); `name` is what messages call the bus."""

    def __init__(self, channel: str, name: str) -> None:
        self.channel, self.name = _whole(channel), name
        #: Called on the loop's thread with a request of another program to stop what is driven here.
        self.on_stop: Callable[[StopRequest], None] | None = None
        self._file: int | None = None
        self._bell: StopBell | None = None
        self._loop: Loop | None = None

    def take(self) -> None:
        """Take it. Raises `CallerError` with the program that has it, or where the lock's file cannot be had."""
        if fcntl is None or self._file is not None:
            return
        path = lock_folder() / _file_name(self.channel)
        try:
            file = _opened(path)
        except OSError as error:
            raise CallerError(f"bus {self.name}: {path} cannot be opened: {error.strerror}") from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            holder = printable(os.read(file, 2 * NAME_LENGTH).decode(errors="replace")) or "another program"
            os.close(file)
            raise CallerError(
                f"bus {self.name} ({self.channel}) is driven by {holder}: two programs cannot drive it; end that one, or"
                " only listen (without --ask and --tx; in Python passive=True). `aces stop` stops what it drives"
            ) from None
        os.ftruncate(file, 0)
        os.write(file, program_name().encode())
        self._file = file
        with suppress(OSError):
            self._bell = StopBell(_bell_path(self.channel))

    def listen(self, loop: Loop) -> None:
        """Have `on_stop` called with the requests of other programs, before anything that is late on the loop."""
        if self._bell is not None:
            self._loop = loop
            loop.watch(self._bell.fileno(), self._rung, is_first=True)

    def _rung(self) -> None:
        for request in self._bell.read() if self._bell is not None else ():
            if self.on_stop is None:
                request.answer(devices=[])  # nothing is driven here
            else:
                self.on_stop(request)

    def ring(self) -> Ringing | None:
        """Ask the program that has this lock to stop what it drives; None where no program can be asked."""
        try:
            return Ringing(_bell_path(self.channel), program_name())
        except OSError:
            return None

    def release(self) -> None:
        """Let others have it."""
        if self._bell is not None:
            bell, self._bell = self._bell, None
            loop, self._loop = self._loop, None
            if loop is not None:
                with suppress(CallerError):  # the loop has ended
                    loop.call(partial(loop.unwatch, bell.fileno()))
            bell.close()
        if self._file is not None:
            os.ftruncate(self._file, 0)
            os.close(self._file)
            self._file = None


def lock_folder() -> Path:
    """Return the folder of all users' locks, and make it where it is not there. Raises `CallerError` where that fails."""
    folder = Path(tempfile.gettempdir(), "aces-locks")
    try:
        folder.mkdir(exist_ok=True)
        found = os.lstat(folder)
        if found.st_uid == os.getuid():
            folder.chmod(0o1777)
    except OSError as error:
        raise CallerError(f"{folder}: cannot be made: {error.strerror}") from error
    if not stat.S_ISDIR(found.st_mode):
        raise CallerError(f"{folder} is not a folder; remove it")
    return folder


def _opened(path: Path) -> int:
    """Return the lock's file; one that is there is not created, which Linux refuses for a file of another user in such
    a folder.
    """
    try:
        return os.open(path, os.O_RDWR | os.O_NOFOLLOW)
    except FileNotFoundError:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        if os.fstat(file).st_uid == os.getuid():
            os.fchmod(file, 0o666)
        return file


def _whole(channel: str) -> str:
    """Return one name for one line: the target of `/dev/serial/by-id/…`, the path of a served bus."""
    if ServedAddress.is_served(channel):
        return str(ServedAddress.parse(channel))
    return os.path.realpath(channel) if channel.startswith("/") else channel


def _file_name(channel: str) -> str:
    name = quote(channel, safe="")
    if len(name) > FILE_LENGTH:
        name = f"{name[:80]}-{hashlib.sha256(name.encode()).hexdigest()}"
    return name


def _bell_path(channel: str) -> Path:
    """Return the socket of the program that has a channel's lock: a short path, for such a path has room for 100
    characters.
    """
    return lock_folder() / f"{hashlib.sha256(channel.encode()).hexdigest()[:16]}.stop"


def program_name() -> str:
    """Return what this program is called, and its process: `aces run (pid 4711)`."""
    words = [
        os.path.basename(word) for word in sys.argv[:2] if not word.startswith("-")
    ]  # `-c` is not a name
    return f"{' '.join(words)[:NAME_LENGTH].strip() or 'python'} (pid {os.getpid()})"
