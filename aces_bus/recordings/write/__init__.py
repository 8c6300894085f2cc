"""Recordings written: the formats, and `open_writer`, which opens one by the suffix of a path.

1. A file appears under its name whole or not at all: it is written beside it and renamed by `close`; an exception in the
   `with` block, Ctrl-C too, leaves nothing behind.
2. What a format cannot hold is written as near as it can be, and counted in words in `lossy`; nothing is dropped in silence.
3. The formats' modules, and the libraries that some need, are imported when that format is written.

**A writer** is a `RecordingWriter`, made with an open file and what messages call it. Its `write` takes `FrameTable`s (or a
serial line's `Chunk`s) in the order of the recording, of one capture or of several: their `channels` may differ. `close`
writes what is still kept back, and leaves the file open: the caller, who opened it, closes it. A writer that goes back in
its file (a header with the number of frames) says `needs_seek`; it is then given a seekable file even where the output is a
pipe or is packed. A writer raises `CallerError` or `OSError`, and is not used after that.

**`lossy`** has one entry a kind of loss, the words fit behind a number: {"times finer than 1 µs": 12}. It counts frames, but
"channel names" counts names. `notes` says what loses nothing that a bus has, and is yet not the same: a channel 0 that is
written as can0, the 29-bit flag of an error frame.

**Channels.** Some formats name channels, others number them from 1. `ChannelNumbers` gives a name the number that
is at its end, plus one: "0" and "can0" are channel 1, as with python-can, whose channels count from 0 while files count
from 1. Readers give channel 1 the name "0"; formats with names write it "can0". So can0 survives candump → BLF →
candump. A name whose number is taken or that has none gets the lowest free one, and counts as a lost name, as do
those that do not come back the same ("vcan0"). BLF has a number for frames without a channel: 0.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import TracebackType
from typing import Any, BinaryIO, Self, cast

from ..._lazy import np
from ...errors import CallerError, UnknownNameError
from ...frame_table import FrameFlag, FrameTable
from ...plugins import installed_items
from ..base import Chunk, Link
from ._file import OutFile

__all__ = ["open_writer"]


@dataclass(frozen=True)
class FormatOut:
    """A format that can be written: its name, the suffixes that choose it, and where its writer is.

    An entry point of the group `aces_bus.writers` is one, or a tuple of them.
    """

    name: str
    suffixes: tuple[str, ...]
    what: str
    link: Link
    module: str
    writer: str
    #: The writer goes back in its file.
    needs_seek: bool = False
    #: People can read it on a terminal.
    is_text: bool = False
    #: It reads back while it grows, whenever its writer has settled: it needs no end.
    grows: bool = False


#: The core's formats.
FORMATS: tuple[FormatOut, ...] = (
    FormatOut(
        "candump",
        (".log", ".candump"),
        "candump -L",
        "can",
        ".candump",
        "CandumpWriter",
        is_text=True,
        grows=True,
    ),
    FormatOut(
        "csv",
        (".csv",),
        "python-can's CSV",
        "can",
        ".canlog",
        "CanlogCsvWriter",
        is_text=True,
        grows=True,
    ),
    FormatOut(
        "sqlite",
        (".sqlite", ".sqlite3", ".db"),
        "python-can's SQLite",
        "can",
        ".canlog",
        "CanlogSqliteWriter",
    ),
    FormatOut(
        "slog", (".slog",), "serial log of aces-bus", "serial", ".serial", "SerialLogWriter", grows=True
    ),
    FormatOut("raw", (".bin", ".raw"), "raw serial bytes", "serial", ".serial", "RawWriter", grows=True),
    FormatOut(
        "dxconf",
        (".dxconf.txt", ".txt"),
        "hex dump of serial bytes",
        "serial",
        ".serial",
        "DxconfWriter",
        is_text=True,
    ),
)


def writer_formats() -> Mapping[str, FormatOut]:
    """Return all formats by name, those of installed packages behind the core's, whose names they cannot take."""
    installed = installed_items("aces_bus.writers", FormatOut)
    return {form.name: form for form in (*FORMATS, *installed)} | {form.name: form for form in FORMATS}


#: How a path that ends so is packed.
PACKED: Mapping[str, str] = {".gz": "gzip", ".zst": "zstd"}


def split_suffix(path: str) -> tuple[str, str, str]:
    """Return a path without its suffixes, the format's suffix (the longest that is one, else the last), and the packing's.

    >>> split_suffix("logs/walk.gvret.csv.gz")
    ('logs/walk', '.gvret.csv', '.gz')
    """
    packing = next((path[-len(end) :] for end in PACKED if path.lower().endswith(end)), "")
    bare = path.removesuffix(packing)
    known = (suffix for form in writer_formats().values() for suffix in form.suffixes)
    own = max((suffix for suffix in known if bare.lower().endswith(suffix)), key=len, default=None)
    size = len(own) if own is not None else len(os.path.splitext(bare)[1])
    place = len(bare) - size
    return bare[:place], bare[place:], packing


def writer_format(path: str, link: Link | None = None) -> FormatOut:
    """Return the format that a path's longest known suffix means, `.gz` and `.zst` left out of account.

    Raises `CallerError`, with the suffixes that there are, when it means none.

    >>> writer_format("logs/walk.asc.gz").name
    'asc'
    """
    suffix = split_suffix(path)[1].lower()
    for form in writer_formats().values():
        if suffix in form.suffixes:
            return form
    known = " ".join(f.suffixes[0] for f in writer_formats().values() if link in (None, f.link))
    raise CallerError(f"{path}: the suffix names no format; there are {known}, each also with .gz or .zst")


class OpenWriter:
    """A recording being written; made by `open_writer`. A context manager: an exception leaves no file behind."""

    def __init__(self, form: FormatOut, file: OutFile) -> None:
        self.format, self.name, self.link = form.name, file.name, form.link
        self._file = file
        kind = getattr(import_module(form.module, __package__), form.writer)
        self._writer: Any = kind(file.stream, file.name)  # a `RecordingWriter`, of tables or of chunks
        self._wide_errors = 0
        self._is_open = True

    @property
    def lossy(self) -> dict[str, int]:
        """Losses of the format so far: what was lost → how often."""
        return cast("dict[str, int]", self._writer.lossy)

    @property
    def notes(self) -> list[str]:
        """Sentences on content that is written in another form without a loss."""
        renamed: dict[str, str] = self._writer.renamed
        found = [f"channel {name} is named {new}" for name, new in sorted(renamed.items())]
        if self._wide_errors:
            found.append(
                f"{self._wide_errors} error frames lose their 29-bit flag, which means nothing on a bus"
            )
        return found

    def write(self, item: FrameTable | Chunk) -> None:
        """Write a table of frames, or a chunk of a serial line."""
        if isinstance(item, FrameTable) and not self._writer.keeps_error_width:
            self._wide_errors += int(
                np.count_nonzero(
                    item.flags & (FrameFlag.ERROR | FrameFlag.EXTENDED)
                    == FrameFlag.ERROR | FrameFlag.EXTENDED
                )
            )
        with self._file.checked():
            self._writer.write(item)

    def flush(self) -> None:
        """Hand on what has been written so far, for the reader of a pipe."""
        self._file.flush()

    def close(self) -> None:
        """Finish the file and give it its name."""
        if self._is_open:
            self._is_open = False
            try:
                with self._file.checked():
                    self._writer.close()
                self._file.commit()
            except BaseException:
                self._file.discard()
                raise

    def abort(self) -> None:
        """Throw away what was written; a file that already has the name stays as it was."""
        if self._is_open:
            self._is_open = False
            self._file.discard()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


def open_writer(
    path_or_file: str | os.PathLike[str] | BinaryIO,
    format: str | None = None,
    *,
    inputs: Iterable[str] = (),
    link: Link | None = None,
) -> OpenWriter:
    """Open a recording for writing: a path, "-" for standard output, or a file opened in binary mode.

    `format` is a name of `writer_formats()`; None takes the suffix of the path. A path that ends in `.gz` or `.zst` is
    packed.
    `inputs` are paths that must not be overwritten; another file that has the name is replaced once this one is whole.
    With `link`, a format of the other link is refused.

    Raises `CallerError` for an unknown format or suffix, for a path that cannot be written or that is one of `inputs`, and
    when the library that a format needs is not installed.

    >>> import io
    >>> from aces_bus import Frame
    >>> out = io.BytesIO()
    >>> with open_writer(out, "candump") as writer:
    ...     writer.write(FrameTable.from_frames([Frame(0x60, b"\\x0a", 1.5, "can0")]))
    >>> out.getvalue()
    b'(0000000001.500000) can0 060#0A\\n'
    """
    path = os.fspath(path_or_file) if isinstance(path_or_file, (str, os.PathLike)) else None
    if format is None:
        if path is None or path == "-":
            where = "standard output" if path == "-" else "an open file"
            raise CallerError(f"{where} has no suffix; name the format: {', '.join(writer_formats())}")
        form = writer_format(path, link)
    elif format in (known := writer_formats()):
        form = known[format]
    else:
        raise UnknownNameError("format", format, known)
    if link is not None and form.link != link:
        kinds = {"can": "CAN frames", "serial": "bytes of a serial line"}
        raise CallerError(
            f"{path or form.name}: {form.what} holds {kinds[form.link]}, and these are {kinds[link]}; there are "
            + ", ".join(f.name for f in writer_formats().values() if f.link == link)
        )
    packing = next((kind for end, kind in PACKED.items() if (path or "").lower().endswith(end)), None)
    file = OutFile(
        path if path is not None else cast("BinaryIO", path_or_file), packing, form.needs_seek, inputs
    )
    try:
        return OpenWriter(form, file)
    except BaseException:
        file.discard()
        raise
