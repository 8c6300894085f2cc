"""What an exception of a user's program says, and which of the program's lines it came from."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path


def exception_text(error: BaseException) -> str:
    """Return what an exception says, in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def innermost_line(error: BaseException, is_wanted: Callable[[str], object]) -> traceback.FrameSummary | None:
    """Return the innermost line of a traceback whose file is wanted; None where there is none."""
    frames = reversed(traceback.extract_tb(error.__traceback__))
    return next((frame for frame in frames if is_wanted(frame.filename)), None)


def shown_path(file: str | Path) -> str:
    """Return a file's path from the current folder, if it is below it."""
    try:
        return str(Path(file).relative_to(Path.cwd()))
    except (OSError, ValueError):
        return str(file)
