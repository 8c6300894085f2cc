"""A bar on the terminal for long recordings: how far, how fast, how long still.

1. It is shown on a terminal only, and only for files that take a while; it never touches standard output.
2. It costs a look at the clock and at the file's place now and then, not once a frame.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from typing import Any

#: Bytes of all files together from which on there is a bar.
LARGE = 8 << 20
#: Seconds between two looks.
STEP_S = 0.1


class Progress:
    """The bar of a run over several files; nothing where there is no terminal, or where the files are small.

    progress = Progress(files)
    progress.opened(capture)       # for each of them
    progress.step(len(frames))     # for each piece
    progress.close()
    """

    def __init__(self, files: Sequence[str]) -> None:
        self._bar: Any = None
        self._task: Any = None
        self._file: Any = None
        self._before = self._place = self._frames = 0
        self._began = self._next = 0.0
        self.total = sum(os.path.getsize(name) for name in files if os.path.isfile(name))
        self._is_wanted = self.total > LARGE and sys.stderr is not None and sys.stderr.isatty()

    def opened(self, capture: Any) -> None:
        """The next file is being read."""
        self._before += self._place
        self._place = 0
        # The file beneath the capture, packed or not: its place says how much has been read.
        self._file = getattr(getattr(capture, "_source", None), "_file", None)
        if self._is_wanted and self._bar is None:
            self._bar, self._task = self._show()

    def _show(self) -> tuple[Any, Any]:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        bar = Progress(
            TextColumn("{task.percentage:>3.0f} %"),
            BarColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            redirect_stdout=False,
        )
        bar.start()
        self._began = time.monotonic()
        return bar, bar.add_task("", total=self.total, rate="")

    def step(self, frames: int) -> None:
        """So many frames more have been read; of a serial line none."""
        if self._bar is None:
            return
        self._frames += frames
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + STEP_S
        try:
            self._place = int(self._file.tell())
        except (AttributeError, OSError, ValueError):
            pass  # no place to tell, or closed at its end
        done, passed = self._before + self._place, max(now - self._began, 1e-3)
        rate = f"{done / passed / 1e6:.0f} MB/s"
        if self._frames:
            rate += f", {self._frames / passed / 1e6:.2f} M frames/s"
        self._bar.update(self._task, completed=done, rate=rate)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
            self._is_wanted = False
