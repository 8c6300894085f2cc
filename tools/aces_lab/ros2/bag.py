"""What is published, as a bag: an MCAP of ROS 2's profile, CDR messages and `ros2msg` schemas.

1. A chunk is written once a second; a program that is killed leaves whole chunks.
2. A file that cannot be written ends the bag and is reported; what is published goes on.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from aces_bus.errors import CallerError
from aces_bus.export.files import telling
from aces_lab.tables.mcap_file import McapWriter

from .messages import HASHES, schema_text

#: Messages that wait for the disk: ten seconds of a robot at 1 kHz with four sensors.
WAITING = 50_000


class Bag:
    """A bag that is being written, from any thread. Raises `CallerError` for a path that cannot be."""

    def __init__(self, path: str, report: Callable[[str], object]) -> None:
        if not path.endswith(".mcap"):
            raise CallerError(f"--ros2-bag {path}: a bag's name ends in .mcap")
        with telling(path):
            self._file = McapWriter(path, profile="ros2")
        self.path, self._report = path, report
        self._lock = threading.Lock()
        self._channels: dict[str, int] = {}
        self._waiting: list[tuple[int, int, bytes]] = []
        self.written = self.dropped = 0
        self._is_over = False

    def put(self, topic: str, message: str, instant: int, data: bytes) -> None:
        """Keep a message of an instant (ns since 1970) until `flush`; too many are dropped and counted."""
        with self._lock:
            if self._is_over or len(self._waiting) >= WAITING:
                self.dropped += 1
                return
            channel = self._channels.get(topic)
            if channel is None:
                metadata = {"topic_type_hash": f"RIHS01_{HASHES[message]}"}
                try:
                    channel = self._file.channel(
                        topic,
                        message,
                        schema_text(message).encode(),
                        metadata,
                        schema_encoding="ros2msg",
                        encoding="cdr",
                    )
                except OSError as error:
                    self._failed(error)
                    return
                self._channels[topic] = channel
            self._waiting.append((channel, max(0, instant), data))

    def flush(self) -> None:
        """Write what waits as a chunk."""
        with self._lock:
            waiting, self._waiting = self._waiting, []
            if not waiting or self._is_over:
                return
            try:
                self._file.chunk(waiting)
                self.written += len(waiting)
            except OSError as error:
                self._failed(error)
                self.dropped += len(waiting)

    def _failed(self, error: OSError) -> None:
        self._is_over = True
        self._file.abandon()
        self._report(f"{self.path} is not whole: {error.strerror or error}")

    def close(self) -> None:
        """Write the rest and the index; twice does nothing."""
        self.flush()
        with self._lock:
            if not self._is_over:
                try:
                    self._file.close()
                except OSError as error:
                    self._failed(error)
            self._is_over = True
