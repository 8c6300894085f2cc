"""`aces sniff --record FILE`: everything that is received, on disk within half a second.

1. Lines are only ever appended, and handed to the system every `STEP_S`: a program that is killed loses less than half a
   second, and a machine that loses its power (`SYNC_S`) little more.
2. What is counted is in the file, whole: of a disk that fills up, as many frames as it took, and the others are counted too.
3. Nothing else in the program holds it up: it has a queue and a thread of its own. What its queue drops is counted.
4. A file that is there is never written over.

CAN frames go into a candump log, bytes of a line into our serial log: formats whose lines are whole by themselves. For a
format that has to be finished (BLF, MF4, a packed file …) a log is kept beside it, named FILE.log or FILE.slog; it is
converted when the sniffing ends, and removed when that went well. After a kill it is what there is.
"""

from __future__ import annotations

import errno
import io
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from aces_bus.errors import AcesError, CallerError
from aces_bus.export.files import AppendFile
from aces_bus.frame_table import FrameTable
from aces_bus.recordings import CanRecording, Chunk, open_recording
from aces_bus.recordings.base import Direction, Link
from aces_bus.recordings.write import FORMATS, open_writer, writer_format
from aces_bus.recordings.write.candump import CandumpWriter
from aces_bus.recordings.write.serial import SerialLogWriter

from .live import heard_frame

if TYPE_CHECKING:
    from aces_bus.hardware import CanGate, DatagramGate, SerialGate

#: Seconds between two times at which what has come is written.
STEP_S = 0.25
#: Seconds between two times at which the file is synchronised to the disk.
SYNC_S = 1.0
#: Frames or pieces of bytes that may wait to be written: half a minute of a full 1 Mbit/s bus.
WAITING = 1 << 18
#: What a recording of a link is kept as, and its suffix.
KEPT = {"can": ("candump", ".log"), "serial": ("slog", ".slog")}
#: What the system answers for a pipe or a device that is to be brought to the disk.
NO_DISK = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS)


class RecordingFile:
    """A recording in the making. Raises `CallerError` when the file cannot be written, or is there already."""

    def __init__(self, path: str, link: Link) -> None:
        self.path = path
        self.link: Link = link
        if path == "-":
            raise CallerError("--record - : standard output is for the lines; name a file")
        kept, suffix = KEPT[link]
        form = kept if not os.path.splitext(os.path.basename(path))[1] else self._format(path)
        is_packed = path.lower().endswith((".gz", ".zst"))
        #: The log that is written now, and what it becomes at the end.
        self.journal = path if form == kept and not is_packed else path + suffix
        self.final = None if self.journal == path else form
        self._check()
        #: What the writer has made of the items in hand.
        self._lines = io.BytesIO()
        self._writer: Any = (CandumpWriter if link == "can" else SerialLogWriter)(self._lines, self.journal)
        try:
            self._file = AppendFile(self.journal)
            self._append()
        except (OSError, ValueError) as error:
            said = error.strerror if isinstance(error, OSError) else None
            raise CallerError(f"--record {path}: cannot be written: {said or error}") from error
        #: Frames, or bytes, that are in the file; that were received and are not; and what stopped it.
        self.recorded = self.lost = 0
        self.failure: str | None = None
        self._stopping = threading.Event()
        self._inbox: Any = None
        self._thread: threading.Thread | None = None

    def _format(self, path: str) -> str:
        form = writer_format(path, self.link)
        if form.link != self.link:
            known = " ".join(f.suffixes[0] for f in FORMATS.values() if f.link == self.link)
            what = "CAN frames" if self.link == "can" else "bytes of a serial line"
            raise CallerError(f"--record {path}: {form.what} does not hold {what}; there are {known}")
        return form.name

    def _check(self) -> None:
        for path in {self.path, self.journal}:
            if os.path.isfile(path) and os.path.getsize(path):
                if path == self.journal != self.path:
                    raise CallerError(
                        f"--record {self.path}: {path} is there, of a recording that was cut short; convert it first"
                        f" (aces convert {path} …), or take it away"
                    )
                raise CallerError(f"--record {path}: there is such a file already; choose another name")

    # ------------------------------------------------------------------ recording

    def start(
        self,
        gate: CanGate | SerialGate | DatagramGate,
        name: str,
        epoch_ns: int,
        direction: Direction | None = None,
    ) -> None:
        """Record what the gate receives from now on."""
        self._inbox = gate.subscribe(limit=WAITING)
        self._print: Callable[[Sequence[Any]], object] = lambda items: [
            self._writer.write(Chunk(item.content, (item.host_ns + epoch_ns) / 1e9, direction))
            for item in items
        ]
        if self.link == "can":
            self._print = lambda items: self._writer.write(
                FrameTable.from_frames([heard_frame(item, name, epoch_ns) for item in items])
            )
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """What came faster than the disk took it."""
        return 0 if self._inbox is None else int(self._inbox.dropped)

    def _size(self, items: Sequence[Any]) -> int:
        return len(items) if self.link == "can" else sum(len(item.content) for item in items)

    def _append(self) -> None:
        """What was printed, to the file: all of it, or none and `OSError`."""
        lines = self._lines.getvalue()
        self._lines.seek(0)
        self._lines.truncate()
        self._file.write(lines)

    def _record(self, items: Sequence[Any]) -> None:
        """Write items; what does not go in at once goes one by one, up to the first that does not."""
        self.lost += self._size(items)
        pieces: list[Sequence[Any]] = [items]
        while pieces:
            piece = pieces.pop(0)
            try:
                self._print(piece)
                self._append()
            except OSError:
                if len(piece) == 1:
                    raise
                pieces = [[item] for item in piece]
            else:
                self.lost -= self._size(piece)
                self.recorded += self._size(piece)

    def _sync(self) -> None:
        try:
            self._file.sync()
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
        """There is nothing to record after all: leave no file behind."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._inbox.close()
        self._file.close()
        if os.path.isfile(self.journal):
            os.unlink(self.journal)

    @property
    def written(self) -> str:
        """The file that has the recording."""
        return self.path if self.final is None or not os.path.exists(self.journal) else self.journal

    def stop(self) -> None:
        """Write what is still queued, and finish the file. Raises `CallerError` when it is not whole."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._inbox.close()
            self.lost += self._size(self._inbox.get(0))
        try:
            self._file.close()
        except OSError as error:
            self.failure = self.failure or error.strerror or str(error)
        if self.failure is not None:
            raise CallerError(
                f"--record {self.path}: recording stopped: {self.failure}; {self.journal} has what came before"
            )
        if self.final is not None:
            self._convert(self.final)

    def _convert(self, form: str) -> None:
        """Make the log that was kept what was asked for."""
        try:
            with (
                open_recording(self.journal, link=self.link) as capture,
                open_writer(self.path, form, link=self.link) as writer,
            ):
                pieces: Any = capture.tables() if isinstance(capture, CanRecording) else capture
                for piece in pieces:
                    writer.write(piece)
        except AcesError as error:
            raise CallerError(f"{error}; the recording is {self.journal}") from error
        os.unlink(self.journal)
