"""`aces sniff --record FILE`: everything that is received, on disk within half a second.

1. Pieces are handed to the system every `STEP_S`: a program that is killed loses less than half a second, and a machine that
   loses its power (`SYNC_S`) little more.
2. What is counted is in the file, whole: of a disk that fills up, as many frames as it took, and the others are counted too.
3. Nothing else in the program holds it up: it has a queue and a thread of its own. What its queue drops is counted.

What it writes is a `LiveRecording`.
"""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from aces_bus import FrameTable
from aces_bus.errors import AcesError, CallerError
from aces_bus.hardware.gate import Received
from aces_bus.recordings.base import Chunk, Direction, Link

from .live import received_frame
from .live_log import LiveRecording, LogSeries
from .rotation import Rotation

if TYPE_CHECKING:
    from aces_bus.hardware import CanGate, DatagramGate, SerialGate

    from .several_buses import SeveralGates

#: Seconds between two times at which what has come is written.
STEP_S = 0.25
#: Seconds between two times at which the file is synchronised to the disk.
SYNC_S = 1.0
#: Frames or pieces of bytes that may wait to be written: half a minute of a full 1 Mbit/s bus.
WAITING = 1 << 18
#: What the system answers for a pipe or a device that is to be brought to the disk.
NO_DISK = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS)


class RecordingFile:
    """A recording in the making. Raises `CallerError` when the file cannot be written, or is there already."""

    def __init__(self, path: str, link: Link, rotation: Rotation = Rotation()) -> None:  # noqa: B008 - frozen
        self.path = path
        self.link: Link = link
        if path == "-":
            raise CallerError("--record - : standard output is for the lines; name a file")
        self._log = LogSeries(
            path, rotation, lambda name: LiveRecording(name, link, "--record"), option="--record"
        )
        #: Frames, or bytes, that were received and are not in the file; and what stopped it.
        self.lost = 0
        self.failure: str | None = None
        self._stopping = threading.Event()
        self._inbox: Any = None
        self._thread: threading.Thread | None = None

    # ------------------------------------------------------------------ recording

    def start(
        self,
        gate: CanGate | SerialGate | DatagramGate | SeveralGates,
        name: str,
        epoch_ns: int,
        direction: Direction | None = None,
    ) -> None:
        """Record what the gate receives from now on."""
        self._inbox = gate.subscribe(limit=WAITING)
        self._pieces: Callable[[Sequence[Any]], list[Any]] = lambda items: [
            Chunk(item.content, (item.host_ns + epoch_ns) / 1e9, direction) for item in items
        ]
        if self.link == "can":
            self._pieces = lambda items: [
                FrameTable.from_frames([received_frame(item, name, epoch_ns) for item in items])
            ]
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of frames or bytes that were dropped because the disk was too slow."""
        return 0 if self._inbox is None else int(self._inbox.dropped)

    @property
    def recorded(self) -> int:
        """Frames, or bytes, that are in the file."""
        return self._log.committed

    def _size(self, items: Sequence[Received[Any]]) -> int:
        return len(items) if self.link == "can" else sum(len(item.content) for item in items)

    def _record(self, items: Sequence[Received[Any]]) -> None:
        """Write items; what does not go in at once goes one by one, up to the first that does not."""
        self.lost += self._size(items)
        pieces: list[Sequence[Any]] = [items]
        while pieces:
            piece = pieces.pop(0)
            try:
                for part in self._pieces(piece):
                    self._log.write(part, len(part) if self.link == "can" else len(part.data))
                self._log.commit()
            except OSError:
                if len(piece) == 1 or not getattr(self._log.file, "is_independent", False):
                    raise
                pieces = [[item] for item in piece]
            else:
                self.lost -= self._size(piece)

    def _sync(self) -> None:
        try:
            self._log.sync()
        except OSError as error:
            if error.errno not in NO_DISK:
                raise

    def _run(self) -> None:
        synced, is_dirty = time.monotonic(), False
        try:
            while True:
                is_last = self._stopping.wait(STEP_S)
                items = self._inbox.get(0)
                if items:
                    self._record(items)
                    is_dirty = True
                now = time.monotonic()
                if is_dirty and (is_last or now - synced >= SYNC_S):
                    self._sync()
                    synced, is_dirty = now, False
                if is_last and not items:
                    return
        except (OSError, AcesError) as error:
            self.failure = (isinstance(error, OSError) and error.strerror) or str(error)

    def abandon(self) -> None:
        """Leave no file behind: there is nothing to record after all."""
        self._end()
        self._log.abandon()

    def _end(self) -> None:
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._inbox.close()

    @property
    def written(self) -> str:
        """The file that has the recording, or the files."""
        return self._log.written

    def stop(self) -> None:
        """Write what is still queued, and finish the file. Raises `CallerError` when it is not whole."""
        self._end()
        if self._inbox is not None:
            self.lost += self._size(self._inbox.get(0))
        if self.failure is not None:
            self._log.leave()
            raise CallerError(
                f"--record {self.path}: recording stopped: {self.failure}; {self._log.file.written} has what came before"
            )
        self._log.close()
