"""One line of candump's languages, the slow way: it knows all that candump has ever written.

    (1436509052.249713) can0 044#2A366C2BBA         log: a classic frame, 11-bit identifier
    (1436509052.249713) can0 0000012345#…           refused: an identifier has 3 or 8 digits
    (1436509052.249713) can0 18FEF100#2A.36 R       29-bit identifier, bytes with dots, received (T: sent)
    (1436509052.249713) can0 123##1AABB             CAN FD, flags 1 (bit rate switch) | 2 (error state)
    (1436509052.249713) can0 123#R8                 remote frame that asks for 8 bytes
    (1436509052.249713) can0 123#0011223344556677_B 8 bytes, raw length code B (the code is not kept)
    (1436509052.249713) can0 20000004#0004000000000000   error frame (bit 0x20000000)

     (1436509052.249713)  can0  RX - -  123   [2]  41 42   'AB'      screen: -t a|d|z|A, -x, -a, -c, -e, -i, -S, -8

1. A line gives a frame that can exist, or `UnreadableRow` with the reason; nothing else is raised.
2. The bytes that `[n]` announces are there, no more and no fewer; the log states no length, and a whole number of bytes is
   all that can be asked of it.
3. Numbers stay as written: a delta or zero-based time stamp is not made absolute.

*Facts*: lib.h, lib.c and candump.c of can-utils.
*Choice*: `-t A` prints local time without its zone, so it is read as the local time of this machine.
*Doubt*: early candumps pad identifiers with blanks; they are known by the two blanks before `[n]`, and there the width
tells 11-bit from 29-bit identifiers.
"""

from __future__ import annotations

import re
import time
from binascii import unhexlify

from ...errors import CallerError
from ...frame_table import NO_TIME, to_ns
from ...frames import Frame
from ..base import REMOTE_AND_ERROR, printable_start
from ..text.rows import UnreadableRow

_ERROR_FLAG = 0x2000_0000
#: A name of a channel, at most 64 bytes.
NAME = rb"[!-~\x80-\xff]{1,64}"
_LOG = re.compile(rb"\(([^()]*)\)\s+(" + NAME + rb")\s+([0-9A-Za-z]+)#(\S*)(?:\s+([TtRr])[Xx]?)?")
_SCREEN = re.compile(
    rb"(?:\(([^()]*)\)\s+)?(" + NAME + rb")(?:\s+([TR])X ([B-]) ([E-]))?(\s+)([0-9A-Fa-f]{1,8})(\s+)"
    rb"(?:\[([0-9]{1,2})\]|\{([0-9A-Fa-f])\})(.*)"
)
_XL = re.compile(rb"[^#]*###|.*\[[0-9]{4}\] \([0-9A-F]{2}[|:]|[^#]*\s[0-9A-F]{5}#[0-9A-F]{2}:")
COLOUR = re.compile(rb"\x1b\[[0-9;]*m")

_DOTTED = re.compile(rb"\.?(?:[0-9A-Fa-f]{2}\.?)*")
_REMOTE = re.compile(rb"[Rr]([0-8])?(?:_[9A-Fa-f])?")
_RAW_LENGTH = re.compile(rb"(.*)_([9A-Fa-f])")
_CELLS = re.compile(rb"\s*((?:[0-9A-Fa-f]{2}(?: |$))*)")
_CELL = re.compile(rb"([01]{8}|[0-9A-Fa-f]{2})([ `]|$)")
_SECONDS = re.compile(rb"[0-9]{1,12}(?:\.[0-9]{1,9})?")
_STAMP = re.compile(rb"\(([0-9]{1,12})(?:\.([0-9]{1,9}))?\)")
_DATE = re.compile(rb"([0-9]{4}-[0-9]{2}-[0-9]{2} [0-9]{2}:[0-9]{2}:[0-9]{2})(\.[0-9]{1,9})?")

RECEIVED: dict[bytes, bool] = {b" R": True, b" T": False, b"R": True, b"r": True, b"T": False, b"t": False}


class ChannelNames(dict[bytes, str]):
    """Bytes → name of a channel; bounded, and one string a name."""

    def __missing__(self, raw: bytes) -> str:
        if len(self) >= 256:
            self.clear()
        found = self[raw] = raw.decode("utf-8", "backslashreplace")
        return found


def read_line(text: bytes, names: ChannelNames | None = None) -> Frame:
    """Return the frame of one stripped line; raises `UnreadableRow`."""
    names = ChannelNames() if names is None else names
    if b"\x1b" in text:
        text = COLOUR.sub(b"", text).strip()
    reason = "not a line of candump"
    try:
        if found := _LOG.fullmatch(text):
            return _log_frame(found, names)
        if found := _SCREEN.fullmatch(text):
            return _screen_frame(found, names)
    except (UnreadableRow, CallerError) as error:  # CallerError: a frame that cannot exist
        reason = str(error)
    raise UnreadableRow("CAN XL is not supported" if _XL.match(text) else reason)


def _log_frame(found: re.Match[bytes], names: ChannelNames) -> Frame:
    stamp, channel, digits, body, suffix = found.groups()
    identifier, extended, error = _identifier(digits)
    fd = remote = False
    flags, size = 0, None
    data = b""
    if body.startswith(b"#"):
        fd = True
        try:
            flags = int(body[1:2], 16)
        except ValueError:
            raise UnreadableRow("no flags digit after ##") from None
        data = _hex(body[2:])
    elif body[:1] in (b"R", b"r"):
        remote = True
        if error:
            raise UnreadableRow(REMOTE_AND_ERROR)
        if not (asked := _REMOTE.fullmatch(body)):
            raise UnreadableRow("after R comes a length of 0 to 8")
        size = int(asked[1] or b"0")
    elif coded := _RAW_LENGTH.fullmatch(body):
        data = _hex(coded[1])
        if len(data) != 8:
            raise UnreadableRow(f"raw length code with {len(data)} data bytes; only 8 may have one")
    else:
        data = _hex(body)
    return Frame(
        identifier,
        data,
        _seconds(stamp),
        names[channel],
        extended,
        remote,
        error,
        fd,
        bool(flags & 1),
        bool(flags & 2),
        RECEIVED.get(suffix),
        size,
    )


def _screen_frame(found: re.Match[bytes], names: ChannelNames) -> Frame:
    stamp, channel, way, rate, state, before, digits, after, length, code, rest = found.groups()
    fd = length is not None and len(length) == 2
    size = int(length) if length is not None else min(int(code, 16), 8)
    if after == b"  " and length is not None and not fd:  # an early candump: see *Doubt*
        wide = len(before) - 2 + len(digits) == 8
        digits = digits.rjust(8 if wide else 3, b"0")
    identifier, extended, error = _identifier(digits)
    remote = rest.strip() == b"remote request"
    if remote and error:
        raise UnreadableRow(REMOTE_AND_ERROR)
    return Frame(
        identifier,
        b"" if remote else _cells(rest, size),
        None if stamp is None else _seconds(stamp),
        names[channel],
        extended,
        remote,
        error,
        fd,
        fd and rate == b"B",
        fd and state == b"E",
        RECEIVED.get(way),
        size if remote else None,
    )


def _identifier(digits: bytes) -> tuple[int, bool, bool]:
    """Return number, whether extended, whether of an error frame."""
    text = digits.decode()
    try:
        number = int(text, 16)
    except ValueError:
        raise UnreadableRow(f"identifier {text} is not hexadecimal") from None
    if len(text) == 3:
        return number, False, False  # its range is the frame's to check
    if len(text) != 8:
        raise UnreadableRow(f"identifier {text} has {len(text)} digits, not 3 or 8")
    if number & ~0x1FFF_FFFF == _ERROR_FLAG:
        return number & 0x1FFF_FFFF, False, True
    return number, True, False


def _hex(text: bytes) -> bytes:
    if b"." not in text or _DOTTED.fullmatch(text):
        try:
            return unhexlify(text.replace(b".", b""))
        except ValueError:
            pass
    if wrong := re.search(rb"[^0-9A-Fa-f.]", text):
        raise UnreadableRow(f"{printable_start(wrong[0])!r} in the data is not hexadecimal")
    if b"." in text:
        raise UnreadableRow("a dot splits a byte")
    raise UnreadableRow("odd number of hexadecimal digits")


def _cells(rest: bytes, size: int) -> bytes:
    """Return the data bytes of a screen line: pairs, bits (-i), swapped (-S); then an ASCII column (-a) or a remark."""
    start = _CELLS.match(rest)
    assert start is not None  # it matches the empty string too
    data, end = bytes.fromhex(start[1].decode()), start.end()
    if len(data) == size and end == len(rest):
        return data
    if len(data) != size:
        data, end = _odd_cells(rest, size)
    tail = rest[end:].strip()
    if tail in (b"", b"ERRORFRAME"):
        return data
    if len(tail) == size + 2 and tail[:1] == tail[-1:] and tail[:1] in b"'`":
        return data
    raise UnreadableRow(f"more than its [{size}] bytes, or a remark that candump does not write")


def _odd_cells(rest: bytes, size: int) -> tuple[bytes, int]:
    place = len(rest) - len(rest.lstrip())
    values: list[int] = []
    swapped = False
    while len(values) < size:
        cell = _CELL.match(rest, place)
        if cell is None:
            raise UnreadableRow(f"[{size}] bytes are announced, {len(values)} are there")
        values.append(int(cell[1], 2 if len(cell[1]) == 8 else 16))
        swapped = swapped or cell[2] == b"`"
        place = cell.end()
    return bytes(reversed(values) if swapped else values), place


_last_date: tuple[bytes, str] = (b"", "")


def _seconds(stamp: bytes) -> float:
    """Seconds as written; a date is local time."""
    if _SECONDS.fullmatch(stamp):
        return float(stamp)
    found = _DATE.fullmatch(stamp)
    if found is None:
        raise UnreadableRow(f"time stamp {printable_start(stamp)!r} is neither seconds nor a date")
    global _last_date
    date, fraction = found[1], (found[2] or b"").decode()
    if date != _last_date[0]:
        try:
            _last_date = date, str(int(time.mktime(time.strptime(date.decode(), "%Y-%m-%d %H:%M:%S"))))
        except (ValueError, OverflowError):
            raise UnreadableRow(f"time stamp {printable_start(stamp)!r} is not a date") from None
    return float(_last_date[1] + fraction)  # read as one number, so that no digit is lost in a sum


def line_time_ns(text: bytes, frame: Frame) -> int:
    """Return the instant of the frame of this line, to the digit; `NO_TIME` where the line has none."""
    found = _STAMP.match(text)
    if found is None:
        return to_ns(frame.timestamp)
    instant = int(found[1] + (found[2] or b"").ljust(9, b"0"))
    return instant if instant < 1 << 63 else NO_TIME
