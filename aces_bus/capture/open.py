"""Which format a source has, told by its first bytes.

1. The suffix is never looked at, and the link of the protocol in use decides only what bytes alone cannot: any file
   at all may be a raw serial recording.
2. A wrong source is refused here, before anything is decoded, with what would work; a pipe that shows itself too late
   is refused while it is read.
"""

from __future__ import annotations

import re
from typing import BinaryIO, Literal, overload

from ..errors import CallerError, CaptureError
from ._source import BLOCK, PathSource, Source
from .base import CanCapture, Link, SerialCapture, printable
from .candump import CandumpCapture, looks_like_candump, not_a_log, only_remarks
from .dxconf import OPENING, DxconfCapture
from .serial import RawCapture

_CONVERT = "convert it first: python -m can.logconvert FILE walk.log"

#: Beginning → what such a file is, and what to do with it.
_OTHERS: tuple[tuple[bytes, str, str], ...] = (
    (b"\x1f\x8b", "gzip", "unpack it first: gzip -dc FILE | aces decode … -"),
    (b"\x28\xb5\x2f\xfd", "zstandard", "unpack it first: zstd -dc FILE | aces decode … -"),
    (b"\xfd7zXZ\x00", "xz", "unpack it first: xz -dc FILE | aces decode … -"),
    (b"LOGG", "a Vector BLF log", _CONVERT),
    (b"MDF ", "an MDF measurement", _CONVERT),
    (b"date ", "a Vector ASC log", _CONVERT),
    (b";$FILEVERSION", "a PEAK trace", _CONVERT),
    (b"SQLite format 3\x00", "an SQLite file", _CONVERT),
    (b"\xff\xfe", "UTF-16 text", "convert it first: iconv -f UTF-16 -t UTF-8 FILE > walk.log"),
    (b"\xfe\xff", "UTF-16 text", "convert it first: iconv -f UTF-16 -t UTF-8 FILE > walk.log"),
)
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")


@overload
def open_capture(
    source: PathSource | BinaryIO, *, link: Literal["can"], name: str | None = None
) -> CanCapture: ...
@overload
def open_capture(
    source: PathSource | BinaryIO, *, link: Literal["serial"], name: str | None = None
) -> SerialCapture: ...
@overload
def open_capture(
    source: PathSource | BinaryIO, *, link: Link | None = None, name: str | None = None
) -> CanCapture | SerialCapture: ...
def open_capture(
    source: PathSource | BinaryIO, *, link: Link | None = None, name: str | None = None
) -> CanCapture | SerialCapture:
    """Open a recording: a path, "-" for standard input, or a file opened in binary mode.

    `link` is what the protocol in use speaks; None leaves it to the content, which then must say it: a candump log or a
    hex dump. `name` is what messages call the source, by default its path.

    Raises `CaptureError`, naming the source and what would work, when it cannot be opened or is no such capture. Of a
    pipe the first bytes are awaited.

    >>> import io
    >>> log = io.BytesIO(b"(0.001) can0 060#0A00\\noops\\n")
    >>> with open_capture(log) as capture:
    ...     [(hex(frame.arbitration_id), frame.data.hex()) for frame in capture]
    ...     capture.problems
    [('0x60', '0a00')]
    [Problem(line=2, reason='not a line of candump', excerpt='oops')]
    """
    if link not in ("can", "serial", None):
        raise CallerError(f"no capture format for a {link!r} link yet; there are formats for can and serial")
    opened = Source(source, name)
    try:
        return _tell(opened, link)
    except BaseException:
        opened.close()
        raise


def _tell(source: Source, link: Link | None) -> CanCapture | SerialCapture:
    head = _text(source.head())
    while link != "can" and len(head) < BLOCK and OPENING.startswith(head.lstrip()) and source.look_further():
        head = _text(source.head())  # a pipe may give less than what tells the format
    if head.lstrip().startswith(OPENING):
        if link == "can":
            raise CaptureError(f"{source.name}: a hex dump of a serial line; name a serial protocol")
        return DxconfCapture(source)
    candump = looks_like_candump(head)
    if link == "serial":
        if candump:
            raise CaptureError(f"{source.name}: a candump log, not a serial capture; name a CAN protocol")
        return RawCapture(source)
    if candump:
        return CandumpCapture(source)
    for start, kind, advice in _OTHERS:
        if head.startswith(start):
            raise CaptureError(f"{source.name}: this is {kind}; {advice}")
    if only_remarks(head) or (link == "can" and source.live):
        return CandumpCapture(source)  # it can still show what it is
    raise _refusal(source, head, link)


def _text(head: bytes) -> bytes:
    return head.removeprefix(b"\xef\xbb\xbf")


def _refusal(source: Source, head: bytes, link: Link | None) -> CaptureError:
    if control := _CONTROL.search(head):
        what = f"it looks binary (byte {head[control.start()]:#04x} at offset {control.start()})"
    else:
        first = head.lstrip().split(b"\n", 1)[0]
        what = f"it begins with {printable(first)!r}"
    if link is None:
        return CaptureError(
            f"{source.name}: neither a candump log nor a hex dump: {what}; bytes alone do not say what they are: "
            "say link='serial' for a raw serial capture"
        )
    return not_a_log(source.name, what)
