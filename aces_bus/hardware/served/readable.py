"""A file for foreign event loops that is readable while a queue has items or a socket has bytes.

1. A raised flag without items is harmless: the reader finds nothing and lowers it. Items without a raised flag would starve
   the reader, so whoever appends calls `show` afterwards.

*Facts* (epoll(7), eventfd(2)). An epoll is itself readable while one of its files is ready: one number for two
files. An eventfd is readable while its counter is above zero; reading sets it to zero.
"""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Sized
from contextlib import suppress


class ReadableFile:
    """An epoll of a socket and a flag. `number` is the file to wait for; the caller keeps the socket open.

    Raises `NotImplementedError` on a system without epoll and eventfd.
    """

    def __init__(self, socket_number: int) -> None:
        if not hasattr(select, "epoll") or not hasattr(os, "eventfd"):
            raise NotImplementedError("this system has no epoll and eventfd")
        self._guard = threading.Lock()
        self._is_raised = self._is_closed = False
        self._flag = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._epoll = select.epoll()
        self._epoll.register(socket_number, select.EPOLLIN)
        self._epoll.register(self._flag, select.EPOLLIN)
        self.number = self._epoll.fileno()

    def show(self, items: Sized) -> None:
        """Raise the flag where there are items, lower it where there are none."""
        with self._guard:
            if self._is_closed or self._is_raised == bool(items):
                return
            self._is_raised = not self._is_raised
            if self._is_raised:
                os.eventfd_write(self._flag, 1)
            else:
                with suppress(BlockingIOError):
                    os.eventfd_read(self._flag)

    def close(self) -> None:
        """Give both files back."""
        with self._guard:
            self._is_closed = True
            self._epoll.close()
            os.close(self._flag)
