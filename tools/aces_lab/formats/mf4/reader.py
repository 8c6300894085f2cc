"""ASAM MDF 4 with CAN bus logging (`.mf4`), read in one way; of unusual files another process copies the records first.

1. asammdf is never imported here: where it is loaded before python-can, python-can loses its `.mf4`.
2. Frames and counts are the same whether our own code or asammdf found the records.
3. Damaged and hostile files cost a refusal here, or the other process: its memory is limited (`child.MEMORY` on top of
   the libraries; not on Windows, which has no such limit), and it is stopped when it says nothing for too long.
4. Every record is a frame, one of `others` in words, or unreadable with its reason; problems have a record's number in its
   group.
5. What is not understood is refused by name. A group of frames with a channel that cannot be read as the file means it (a
   formula as its conversion, an unknown data type) is unreadable, record by record; so is a record with a field that has
   no value, or that is not in the file. `group.py` decides that, and it alone.

Frames of all groups come merged by time. Sorted and unsorted, finished and unfinished, packed and plain files are read;
`tree.py` says which need asammdf. A channel is named by its number, "1", as with python-can; in
files of our own it has the name it had.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any, BinaryIO, ClassVar

from aces_bus import FrameTable
from aces_bus.errors import CaptureError
from aces_bus.recordings.base import PROBLEMS_KEPT, CanRecording, UnreadableEntry, printable_start
from aces_bus.recordings.source import ByteSource, on_disk

from . import child as child
from .arrays import BusLog
from .tree import Blocks, Damaged, UnusualFile, tree_of

#: Seconds after which the other process is stopped: so many, and one more for so many bytes of the file.
PATIENCE = 60.0
SLOWEST = 10_000_000
#: An answer is some kilobytes a group; a longer one would be a fault.
_ANSWER = 1 << 28

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    " from aces_lab.formats.mf4.child import run_child; run_child(sys.argv[2:])"
)


class Mf4Capture(CanRecording):
    """CAN frames of an MDF 4 bus log.

    Reading raises `CaptureError` when the file cannot be read or holds no bus logging, when it is not an ordinary one and
    asammdf is not installed, and when reading it takes more memory, disk or time than is allowed. What does not come from
    a plain file is kept in a temporary one.
    """

    format: ClassVar[str] = "MF4"

    def __init__(self, source: ByteSource) -> None:
        super().__init__(source)
        self._patience = PATIENCE
        self._why = ""
        self._process: subprocess.Popen[bytes] | None = None

    def close(self) -> None:
        """Close the file, and stop the process that reads it."""
        super().close()
        if self._process is not None:
            _stop(self._process)

    def _tables(self) -> Iterator[FrameTable]:
        with on_disk(self._source) as (path, folder):
            try:
                with open(path, "rb") as file:
                    if (log := self._ordinary(file)) is not None:
                        yield from log.tables(self, folder, self._lose)
                    else:
                        yield from self._through_asammdf(folder, path)
            except OverflowError:
                raise self._refusal("sorting its mixed groups needs more room than is allowed") from None
            except OSError as error:
                raise CaptureError(f"{self.name}: reading stopped: {error.strerror or error}") from error
        self.close()

    def _ordinary(self, file: BinaryIO) -> BusLog | None:
        """Return what can be read here; None where another must, and `_why` says why."""
        size = os.fstat(file.fileno()).st_size
        try:
            return BusLog(file, size, tree_of(file, size))
        except UnusualFile as reason:
            self._why = str(reason)
            return None
        except Damaged as error:
            raise self._refusal(str(error)) from None

    def _through_asammdf(self, folder: str, path: str) -> Iterator[FrameTable]:
        self._patience = PATIENCE + os.path.getsize(path) / SLOWEST
        try:
            process = self._process = _start(folder, [path])
        except OSError as error:
            raise CaptureError(
                f"{self.name}: an MF4 file is read by another process, and {sys.executable or 'Python'} cannot be"
                f" started: {error}"
            ) from error
        try:
            yield from self._read(process, path, folder)
        finally:
            _stop(process)

    def _lose(self, number: int, reason: str, count: int) -> None:
        self.lines_unreadable += count
        if len(self.problems) < PROBLEMS_KEPT:
            self.problems.append(UnreadableEntry(number, reason, ""))

    def _read(self, process: subprocess.Popen[bytes], path: str, folder: str) -> Iterator[FrameTable]:
        """Yield the tables of the file of which the process says next where its records are."""
        said = self._answer(process)
        if missing := said.get("missing"):
            raise CaptureError(
                f"{self.name}: this is not an ordinary MF4 bus log: {self._why}; such files need"
                f" {missing}: pip install 'aces-bus[mf4]'"
            )
        if error := said.get("error"):
            raise self._refusal(error)
        with open(path, "rb") as file, open(said["path"], "rb") as records:
            size = os.path.getsize(path)
            try:
                log = BusLog(records, size, child.described_tree(said, Blocks(file, size)))
            except (UnusualFile, Damaged) as error:
                raise self._refusal(str(error)) from None
            yield from log.tables(self, folder, self._lose)

    def _answer(self, process: subprocess.Popen[bytes]) -> dict[str, Any]:
        """Return what the process says of a file."""
        assert process.stdout is not None
        is_over = threading.Event()

        def stop() -> None:
            is_over.set()
            process.kill()

        timer = threading.Timer(self._patience, stop)
        timer.daemon = True
        timer.start()
        try:
            line = process.stdout.readline(_ANSWER)
        finally:
            timer.cancel()
        if is_over.is_set():
            raise CaptureError(
                f"{self.name}: no progress for {self._patience:.0f} s while reading this MF4 file, which was stopped; it"
                " is damaged"
            )
        if not line.endswith(b"\n"):
            code = process.wait()
            raise CaptureError(
                f"{self.name}: the process that reads this MF4 file ended early (status {code}); the file is damaged, or"
                " the system stopped it for want of memory"
            )
        said: dict[str, Any] = json.loads(line)
        return said

    def _refusal(self, said: str) -> CaptureError:
        return CaptureError(f"{self.name}: this MF4 file cannot be read: {printable_start(said.encode())}")


def _start(folder: str, paths: list[str]) -> subprocess.Popen[bytes]:
    """Start the other process on its way through these files."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "TMPDIR": folder}
    arguments = [sys.executable, "-c", _START, json.dumps(sys.path), str(child.MEMORY), folder, *paths]
    return subprocess.Popen(
        arguments,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
        start_new_session=True,  # Ctrl-C is for the one who reads, who then stops this process
    )


def _stop(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.kill()
    process.wait()
    if process.stdout is not None:
        process.stdout.close()
