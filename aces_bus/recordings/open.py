"""Which format a source has, by its first bytes.

1. The suffix is never looked at, and the link of the protocol in use decides only what bytes alone cannot: any file
   at all may be a raw serial recording.
2. A format is a `RecordingFormat`: its name, what it is in words, how it is recognized, its reader. The order is from the
   most to the least specific, and the first that matches reads: magic numbers and first lines of `FORMATS`, then formats
   of installed packages, then what lines look like (`LAST`).
3. A wrong source is refused here, before anything is decoded, with what would work; a pipe that shows itself too late
   is refused while it is read.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from importlib import import_module
from itertools import chain
from typing import BinaryIO, Literal, NamedTuple, overload

from ..errors import CallerError, CaptureError, UnknownNameError
from ..plugins import installed_items
from .base import CanRecording, Link, SerialRecording, printable_start
from .beginnings import SQLITE, begins, is_python_can_csv
from .candump.reader import EXAMPLE, CandumpCapture, begins_like_candump, looks_like_candump
from .serial.raw import OPENING, RawCapture
from .serial.slog import OPENING as SERIAL_LOG
from .serial.slog import looks_like_serial_log
from .source import BLOCK, ByteSource, PathSource, split_lines


class RecordingFormat(NamedTuple):
    """A format of recordings; an entry point of the group `aces_bus.readers` is one, or a tuple of them.

    `matches` gets the first bytes (up to 64 KiB, of a pipe what is there, without a byte order mark); `place` is the module
    and the class that reads (`their_package.module:Reader`), a `CanRecording` or `SerialRecording` made of a `ByteSource`.
    """

    name: str
    words: str
    link: Link
    matches: Callable[[bytes], bool]
    place: str

    def open(self, source: ByteSource) -> CanRecording | SerialRecording:
        """Open the source as a recording of this format."""
        module, _, name = self.place.partition(":")
        reader: type[CanRecording | SerialRecording] = getattr(import_module(module, __package__), name)
        return reader(source)


def _by_name_only(_: bytes) -> bool:
    return False


#: Most specific first: magic numbers, then first lines that are one format's own, then what lines look like.
FORMATS: tuple[RecordingFormat, ...] = (
    RecordingFormat("sqlite", "SQLite log of python-can", "can", begins(SQLITE), ".sqlite:SqliteCapture"),
    RecordingFormat(
        "slog", "serial log of aces-bus", "serial", looks_like_serial_log, ".serial.slog:SerialLogCapture"
    ),
    RecordingFormat(
        "dxconf",
        "hex dump of the vendor's serial monitor",
        "serial",
        begins(OPENING, after_blanks=True),
        ".serial.raw:DxconfCapture",
    ),
    RecordingFormat("csv", "python-can CSV", "can", is_python_can_csv, ".text.canlog_csv:CanlogCsvCapture"),
)
#: What lines look like, where no format of another package is recognized, and what is used by name alone.
LAST: tuple[RecordingFormat, ...] = (
    RecordingFormat("candump", "candump log", "can", looks_like_candump, ".candump.reader:CandumpCapture"),
    RecordingFormat("raw", "raw serial bytes", "serial", _by_name_only, ".serial.raw:RawCapture"),
)
#: Most logs are candump's, and most of these show it at once.
_AT_ONCE = LAST[0]._replace(matches=begins_like_candump)


def all_formats() -> Iterator[RecordingFormat]:
    """Yield every format in order of trial; packages are searched when none of `FORMATS` has matched."""
    yield from FORMATS
    yield from installed_items("aces_bus.readers", RecordingFormat)
    yield from LAST


#: What we know and do not read: beginning, what it is, what to do with it.
REFUSED: tuple[tuple[bytes, str, str], ...] = (
    (b"\xfd7zXZ\x00", "xz", "unpack it first: xz -dc FILE | aces decode … -"),
    (b"BZh", "bzip2", "unpack it first: bzip2 -dc FILE | aces decode … -"),
    (b"PK\x03\x04", "a zip archive", "unpack it first: unzip -p FILE | aces decode … -"),
    (b"\xff\xfe", "UTF-16 text", "convert it first: iconv -f UTF-16 -t UTF-8 FILE > walk.log"),
    (b"\xfe\xff", "UTF-16 text", "convert it first: iconv -f UTF-16 -t UTF-8 FILE > walk.log"),
)
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")
#: A pipe has shown what it is by the end of a first line, or by this many bytes; a magic number has at most so many.
_ENOUGH, _MAGIC = 4096, 16


def formats() -> dict[str, str]:
    """Return the formats that can be read: the name that `open_recording(format=)` takes, and what it is in words."""
    return {form.name: form.words for form in all_formats()}


@overload
def open_recording(
    source: PathSource | BinaryIO,
    *,
    link: Literal["can"],
    name: str | None = None,
    format: str | None = None,
) -> CanRecording: ...
@overload
def open_recording(
    source: PathSource | BinaryIO,
    *,
    link: Literal["serial"],
    name: str | None = None,
    format: str | None = None,
) -> SerialRecording: ...
@overload
def open_recording(
    source: PathSource | BinaryIO,
    *,
    link: Link | None = None,
    name: str | None = None,
    format: str | None = None,
) -> CanRecording | SerialRecording: ...
def open_recording(
    source: PathSource | BinaryIO,
    *,
    link: Link | None = None,
    name: str | None = None,
    format: str | None = None,
) -> CanRecording | SerialRecording:
    """Open a recording: a path, "-" for standard input, or a file opened in binary mode.

    `link` is what the protocol in use speaks; None leaves it to the content, which then must say it. `name` is what
    messages call the source, by default its path. `format` is one of `formats()` and is used without a look at the
    content.

    Raises `CaptureError`, naming the source and what would work, when it cannot be opened or is no such capture. Of a
    pipe the first bytes are awaited.

    >>> import io
    >>> log = io.BytesIO(b"(0.001) can0 060#0A00\\noops\\n")
    >>> with open_recording(log) as capture:
    ...     [(hex(frame.arbitration_id), frame.data.hex()) for frame in capture]
    ...     capture.problems
    [('0x60', '0a00')]
    [UnreadableEntry(line=2, reason='not a line of candump', excerpt='oops')]
    """
    if link not in ("can", "serial", None):
        raise CallerError(f"no capture format for a {link!r} link yet; there are formats for can and serial")
    forced = None if format is None else _named(format, link)
    opened = ByteSource(source, name)
    try:
        return _recognised(opened, link) if forced is None else forced.open(opened)
    except BaseException:
        opened.close()
        raise


def _named(name: str, link: Link | None) -> RecordingFormat:
    for form in all_formats():
        if form.name == name:
            if link not in (None, form.link):
                raise CallerError(f"format {name!r} is of a {form.link} link, and the protocol speaks {link}")
            return form
    raise UnknownNameError("capture format", name, formats())


def _recognised(source: ByteSource, link: Link | None) -> CanRecording | SerialRecording:
    more = source.live
    while True:
        head = source.head().removeprefix(b"\xef\xbb\xbf")
        for start, kind, advice in REFUSED:
            # First: an archive may show the lines inside. Bytes of a serial line may begin as the short ones.
            if head.startswith(start) and (link != "serial" or len(start) > 3):
                raise CaptureError(f"{source.name}: this is {kind}; {advice}")
        half = more and _is_half_a_line(head, link)
        for form in () if half else chain((_AT_ONCE,), all_formats()):
            if form.matches(head):
                if link in (None, form.link):
                    return form.open(source)
                raise _other_link(source, form)
        if not half and not (more and _may_still_show(head, link)):
            break
        more = source.look_further()  # a pipe may give too little to recognize the format
    if link == "serial":
        return RawCapture(source)
    if _only_remarks(head, b"#") or (link == "can" and source.live):
        return CandumpCapture(source)  # it can still show what it is
    raise _refusal(source, head, link)


def _is_half_a_line(head: bytes, link: Link | None) -> bool:
    """Return whether more is worth waiting for: a magic number, or the end of a text's first line. candump's shows
    itself.
    """
    text = head.lstrip()
    if link == "serial" or text.startswith(b"("):
        return False
    return len(head) < _MAGIC or (len(head) < _ENOUGH and b"\n" not in text and not _CONTROL.search(text))


def _may_still_show(head: bytes, link: Link | None) -> bool:
    text = head.lstrip()
    if link == "serial":  # any bytes may be what was meant: only a first line of a format is waited for
        return len(head) < BLOCK and (OPENING.startswith(text) or SERIAL_LOG.startswith(head))
    return len(head) < BLOCK and _only_remarks(text, b"#", b";", b"//")


def _only_remarks(text: bytes, *marks: bytes) -> bool:
    """Return whether the lines so far are all blank or comments with these marks: nothing that says what follows."""
    return all(not line or line.startswith(marks) for line in map(bytes.strip, text.split(b"\n")))


def _other_link(source: ByteSource, form: RecordingFormat) -> CaptureError:
    if form.link == "can":
        return CaptureError(f"{source.name}: {_a(form.words)}, not a serial capture; name a CAN protocol")
    return CaptureError(f"{source.name}: {_a(form.words)}, of a serial line; name a serial protocol")


def _a(words: str) -> str:
    return f"{'an' if words[0] in 'aeiouAEIOU' else 'a'} {words}"


def _refusal(source: ByteSource, head: bytes, link: Link | None) -> CaptureError:
    if control := _CONTROL.search(head):
        what = f"it looks binary (byte {head[control.start()]:#04x} at offset {control.start()})"
    else:
        first = head.lstrip().split(b"\n", 1)[0]
        what = f"it begins with {printable_start(first)!r}"
    known = ", ".join(form.words for form in all_formats() if form.link == "can")
    if link is None:
        return CaptureError(
            f"{source.name}: not a format that says what it is: {what}; known are: {known}; say link='serial' for a "
            "raw serial capture"
        )
    return CaptureError(
        f"{source.name}: not a CAN capture: {what}; known are: {known}; a line of a candump log reads {EXAMPLE} "
        "(candump -L can0 > walk.log), and a serial capture needs a serial protocol"
    )


# ---- one large log in parts, for several processes: in order, without gaps and of whole lines each, they are the file

#: Bytes of a part that are worth another process.
LEAST = 1 << 16
#: First byte, and the one behind the last.
Span = tuple[int, int]


def split_capture(path: str, pieces: int) -> list[Span] | None:
    """Return that many parts of about the same size, none smaller than `LEAST`.

    None for what can only be read from its start: packed files, pipes, other formats.

    Raises `CaptureError` when the file cannot be opened or is not a CAN capture.
    """
    with open_recording(path, link="can") as capture:
        if not may_be_split(capture):
            return None
    spans = split_lines(path, pieces, LEAST)
    return spans if len(spans) > 1 else None


def may_be_split(capture: CanRecording) -> bool:
    """Return whether a recording can be entered at the beginning of any of its lines."""
    return isinstance(capture, CandumpCapture) and not capture.live and not capture.packing


def open_part(source: PathSource | BinaryIO, span: Span) -> CanRecording:
    """Open a part of a source; lines are counted from its start. A source that is open already gives the part alone."""
    capture = CandumpCapture(ByteSource(source, span=span))
    capture.is_known = True  # by the file's start: a part may begin with unreadable lines
    return capture
