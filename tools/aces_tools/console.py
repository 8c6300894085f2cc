"""Where output goes, and what becomes of it when a pipe is closed or a disk is full.

1. `main` imports this: nothing here may be slow to import.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager, suppress
from typing import Any, BinaryIO, TypeVar

from aces_bus.errors import CallerError
from aces_bus.plain_text import printable_lines

T = TypeVar("T")
#: Unreadable lines that are named, of each file.
SHOWN = 3


def say(message: str, *, who: str = "aces: ") -> None:
    """Print one message to stderr, safe for a terminal whatever file its words came from. Losing it must not
    lose the work.
    """
    with suppress(OSError):
        print(printable_lines(f"{who}{message}"), file=sys.stderr, flush=True)


#: Whether notes are printed; `main` decides it for each command.
_shows_notes = True


def show_notes(wanted: bool) -> None:
    """Print notes from now on, or leave them out: for `-q`, and for a user who has set ACES_NOTES=off."""
    global _shows_notes
    _shows_notes = wanted and os.environ.get("ACES_NOTES", "on").lower() not in ("off", "no", "0")


def say_note(message: str) -> None:
    """Say what is good to know but no fault: a hint, what was written, how to end it. Not where notes are switched off."""
    if _shows_notes:
        say(message)


#: What is said where neither time nor number ends a command.
ENDLESS = "runs until Ctrl-C"


def abandon_stdout() -> None:
    """Discard what is still buffered for a reader that has gone, or it raises once again when Python ends."""
    with suppress(OSError, ValueError, AttributeError):  # not a file of the system (a test's)
        number = sys.stdout.fileno()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, number)
        os.close(nowhere)


def standard_input() -> list[str]:
    """Return `-` for a call that names no file and has a pipe at its standard input; raise `CallerError` for
    a terminal.
    """
    if sys.stdin is None or sys.stdin.isatty():
        raise CallerError("name a recording, or pipe one in: candump -L can0 | aces decode -p hubo")
    return ["-"]


def print_json(value: Any, indent: int | None = 2) -> None:
    """Print a value as JSON to standard output; without `indent` on one line."""
    import json

    print(json.dumps(value, ensure_ascii=False, indent=indent), flush=True)


def counted(number: int, what: str) -> str:
    """Return `1 message`, `2 messages`, `3 buses`.

    >>> counted(1, "bus"), counted(2, "bus"), counted(0, "joint")
    ('1 bus', '2 buses', '0 joints')
    """
    return f"{number} {what}" + ("" if number == 1 else "es" if what.endswith("s") else "s")


def check_not_read(path: str, inputs: Iterable[str]) -> None:
    """Raise `CallerError` for an output that is one of the inputs."""
    for name in inputs:
        if os.path.exists(path) and os.path.exists(name) and os.path.samefile(path, name):
            raise CallerError(f"--output {path} is one of the files to read; choose another name")


def write_text(
    path: str | None,
    text: str,
    inputs: Iterable[str] = (),
    *,
    encoding: str = "utf-8",
    is_quiet: bool = False,
) -> None:
    """Write a text to a file, or for None and `-` to standard output. Raises `CallerError`."""
    output = Output(path, inputs)
    try:
        output.write(text.encode(encoding))
    finally:
        output.close()
    if path not in (None, "-") and not is_quiet:
        say_note(f"wrote {path}")


def check_suffix(option: str, path: str | None, *suffixes: str) -> None:
    """Raise `CallerError` for a file whose suffix names a format that is not in `suffixes`; a path without a
    suffix passes.
    """
    suffix = os.path.splitext(path or "")[1].lower()
    if suffix and suffix not in suffixes:
        raise CallerError(f"{option} {path}: it is not written as {suffix}; name it {' or '.join(suffixes)}")


class Output:
    """Bytes to stdout, or to a file that is none of the inputs. Raises `BrokenPipeError` when the reader has gone."""

    def __init__(self, path: str | None, inputs: Iterable[str] = ()) -> None:
        self.path = path
        self._file: BinaryIO | None = None
        if path is not None and path != "-":
            check_not_read(path, inputs)
            try:
                self._file = open(path, "wb")  # noqa: SIM115 - closed by `close`
            except FileNotFoundError:
                folder = os.path.dirname(path)
                raise CallerError(f"{path}: cannot be written: there is no folder {folder!r}") from None
            except OSError as error:
                raise CallerError(f"{path}: cannot be written: {error.strerror or error}") from error

    @property
    def is_terminal(self) -> bool:
        return self._file is None and sys.stdout is not None and sys.stdout.isatty()

    @property
    def encoding(self) -> str:
        """Encoding of text for people."""
        return "utf-8" if self._file is not None else getattr(sys.stdout, "encoding", None) or "utf-8"

    def write(self, data: bytes) -> None:
        file: Any = self._file if self._file is not None else sys.stdout
        if not data or file is None:
            return
        with self._checked():
            if self._file is not None or hasattr(file, "buffer"):
                getattr(file, "buffer", file).write(data)
            else:
                file.write(data.decode("utf-8", "replace"))

    def flush(self) -> None:
        file: Any = self._file if self._file is not None else sys.stdout
        if file is not None and not (self._file is not None and self._file.closed):
            with self._checked():
                file.flush()

    @contextmanager
    def _checked(self) -> Generator[None, None, None]:
        try:
            yield
        except BrokenPipeError:
            raise
        except OSError as error:
            if self._file is None:
                abandon_stdout()
            raise CallerError(
                f"{self.path or 'standard output'}: writing stopped: {error.strerror or error}"
            ) from error

    def close(self) -> None:
        """Write what is buffered and close the file. Do nothing if that has succeeded before."""
        if self._file is not None and self._file.closed:
            return
        try:
            self.flush()
        except (CallerError, BrokenPipeError):
            if self._file is not None:
                with suppress(OSError):
                    self._file.close()
            raise
        if self._file is not None:
            with self._checked():
                self._file.close()


class StatusLine:
    """A line on stderr that is written over again and again: on a terminal only, unless it is not wanted."""

    def __init__(self, *, is_wanted: bool = True) -> None:
        self.is_shown = is_wanted and _shows_notes and sys.stderr is not None and sys.stderr.isatty()
        self._width = 0

    def show(self, text: str) -> None:
        """Show this instead of what was shown before."""
        if self.is_shown:
            text = text[: max(20, terminal_width() - 1)]
            print(f"\r{text:<{self._width}}", end="", file=sys.stderr, flush=True)
            self._width = len(text)

    def clear(self) -> None:
        """Take the line away."""
        if self._width:
            self.show("")
            print("\r", end="", file=sys.stderr, flush=True)


def report_unreadable(capture: Any, shown: int = 0, *, is_over: bool = False) -> int:
    """Name the unreadable lines of a recording from the one of number `shown` on, up to `SHOWN`; how many were named.

    With `is_over` also how many more there are.
    """
    named = capture.problems[shown:SHOWN]
    for problem in named:
        say(f"{capture.name}:{problem}")
    if is_over and capture.lines_unreadable > SHOWN:
        say(f"{capture.name}: and {capture.lines_unreadable - SHOWN} more unreadable lines")
    return shown + len(named)


def terminal_width() -> int:
    """Return the columns of the terminal; 80 when it does not say."""
    try:
        wanted = int(os.environ.get("COLUMNS", ""))
    except ValueError:
        wanted = 0
    if wanted > 0:
        return wanted
    try:
        return os.get_terminal_size(sys.stdout.fileno()).columns or 80
    except (OSError, ValueError, AttributeError):
        return 80


def wants_colour(chosen: bool | None, is_terminal: bool) -> bool:
    """Return what the option says; else a terminal that can, and a user who has not set NO_COLOR (no-color.org)."""
    if chosen is not None:
        return chosen
    return is_terminal and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


# ---------------------------------------------------------------------- progress

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
        self._is_wanted = (
            _shows_notes and self.total > LARGE and sys.stderr is not None and sys.stderr.isatty()
        )

    def opened(self, capture: Any) -> None:
        """Begin the progress of the next file."""
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
        """Note that `frames` more frames have been read; of a serial line none."""
        if self._bar is None:
            return
        self._frames += frames
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + STEP_S
        with suppress(AttributeError, OSError, ValueError):  # no place to tell, or closed at its end
            self._place = int(self._file.tell())
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
