"""Keys of the keyboard: their names in a robot's file, and the terminal that they come from."""

from __future__ import annotations

import atexit
import os
import select
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

#: What a file may call keys that have no character of their own.
KEYS: Final = {"space": " ", "enter": "\n", "tab": "\t", "escape": "\x1b"}


def character_of(name: str) -> str | None:
    """Return the character of a key's name; None where no key is called so."""
    return KEYS.get(name, name if len(name) == 1 and name.isprintable() and name != " " else None)


class Keyboard:
    """The terminal that this program was started in, read key by key while a robot is open.

    Ctrl-C stays what it is. A program in the background has no keyboard: reading it would suspend the program.
    """

    path = "/dev/tty"

    def __init__(self) -> None:
        self.takers: list[Callable[[str], None]] = []
        #: Why no key can be read; "" while they can.
        self.failure = "it is not open"
        self._file: int | None = None
        self._before: Any = None

    def open(self) -> None:
        """Have keys come one by one, unseen."""
        try:
            import termios
        except ImportError:
            self.failure = "this system has no terminals that can be read key by key"
            return
        try:
            self._file = os.open(self.path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
            self._before = termios.tcgetattr(self._file)
            atexit.register(self.close)
            self._is_ours()
        except (OSError, termios.error) as error:
            self.close()
            self.failure = f"{self.path}: {error.args[-1]}"

    def _is_ours(self) -> bool:
        """Return whether this program is in the foreground of its terminal, and see that keys come one by one.

        A shell that suspended the program may have changed that.
        """
        import termios
        import tty

        assert self._file is not None
        is_ours = os.tcgetpgrp(self._file) == os.getpgrp()
        self.failure = "" if is_ours else "this program is in the background"
        if is_ours and termios.tcgetattr(self._file)[3] & termios.ICANON:
            tty.setcbreak(self._file, termios.TCSANOW)
        return is_ours

    def look(self) -> None:
        """Hand on the keys that were pressed since the last look."""
        if self._file is None:
            return
        try:
            while self._is_ours() and select.select([self._file], [], [], 0)[0]:
                data = os.read(self._file, 1024)
                if not data:
                    raise OSError("its terminal has gone")
                for character in data.decode(errors="replace").replace("\r", "\n"):
                    for take in self.takers:
                        take(character)
        except Exception as error:  # termios has an error of its own
            self.close()
            self.failure = str(error.args[-1])

    def close(self) -> None:
        """Leave the terminal as it was found."""
        atexit.unregister(self.close)
        file, self._file = self._file, None
        self.failure = "it is not open"
        if file is None:
            return
        import termios

        with suppress(OSError, termios.error):  # of a terminal that has gone
            if self._before is not None and os.tcgetpgrp(file) == os.getpgrp():
                termios.tcsetattr(file, termios.TCSANOW, self._before)
        os.close(file)
