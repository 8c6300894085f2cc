"""The CAN objects of a Vector BLF log as columns: many objects at once, those of one kind together.

    offset 0   "LOBJ", header size u16, header version u16, object size u32, type u32
           16  flags u32 (1: time in 10 µs, otherwise in ns), …, version 1 and 3: u16 u16, 2: u8 u8 u16; time u64
           32  payload; of header version 2 at 40, behind the original time

    CAN_MESSAGE, CAN_MESSAGE2   channel u16, flags u8 (1 sent, 0x80 remote), dlc u8, id u32, data[8]
    CAN_ERROR                   channel u16, length u16
    CAN_ERROR_EXT               channel u16, length u16, flags u32, ecc u8, position u8, dlc u8, -, frame length u32,
                                id u32, flags u16, -, data[8]
    CAN_FD_MESSAGE              channel u16, flags u8, dlc u8, id u32, frame length u32, bits u8, FD flags u8 (1 FD,
                                2 bit rate switch, 4 error state), data bytes u8, -[5], data[64]
    CAN_FD_MESSAGE_64           channel u8, dlc u8, data bytes u8, tx count u8, id u32, frame length u32, flags u32
                                (0x10 remote, 0x1000 FD, 0x2000 bit rate switch, 0x4000 error state), … (20 bytes),
                                bits u16, direction u8 (0 received), offset of further data u8, crc u32, data[…]
    CAN_FD_ERROR_64             channel u8, dlc u8, data bytes u8, ecc u8, flags u16, error code u16, FD flags u16,
                                offset of further data u8, -, id u32, … (28 bytes), data[…]

1. Every object gives a frame that can exist, is unreadable with its reason, or is another kind, which is counted.
2. All fields are little-endian; bit 31 of an id says that it has 29 bits; channels count from 1 and are named from 0,
   as python-can names them. Channel 0 is none.
3. Length code and number of data bytes must agree, and bits 29 and 30 of an id be zero: what means nothing is not left out
   of account. Only an error frame may have fewer bytes than its code says: it was cut short on the bus.

*Facts*: python-can `can/io/blf.py`; the layouts of CAN_ERROR and CAN_FD_ERROR_64, and the numbers of the types, as
Wireshark's `wiretap/blf.h` has them.
*Choice*: fewer data bytes in an object than it announces are filled up with zeros, as Vector's own reader does
(python-can issue 1905). Of a length code from 9 to 15 a classic frame has 8 bytes.
*Doubt*: sources disagree on the FD flags and on the direction of error objects. They are not read: an error frame with
more than 8 bytes is FD, and its direction is unknown.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from aces_bus import FrameTable
from aces_bus.frame_table import NO_TIME, Channels, FrameFlag, Ints
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.text.rows import RowText

CAN_MESSAGE, CAN_ERROR, LOG_CONTAINER, CAN_ERROR_EXT, CAN_MESSAGE2 = 1, 2, 10, 73, 86
CAN_FD_MESSAGE, CAN_FD_MESSAGE_64, CAN_FD_ERROR_64 = 100, 101, 104

#: What else is known by name; all other types are counted by their number.
_NAMES = {
    3: "CAN overload frames",
    4: "CAN statistics",
    5: "triggers",
    6: "environment variables",
    7: "environment variables",
    8: "environment variables",
    9: "environment variables",
    LOG_CONTAINER: "containers within containers",
    11: "LIN frames",
    12: "LIN errors",
    14: "LIN errors",
    15: "LIN errors",
    29: "FlexRay frames",
    31: "CAN driver errors",
    41: "FlexRay frames",
    50: "FlexRay frames",
    51: "real-time clock",
    54: "LIN statistics",
    57: "LIN frames",
    58: "LIN errors",
    60: "LIN errors",
    61: "LIN errors",
    65: "texts",
    66: "FlexRay frames",
    71: "Ethernet frames",
    72: "system variables",
    74: "CAN driver errors",
    90: "serial data",
    91: "driver overruns",
    92: "comments",
    96: "markers",
    102: "Ethernet errors",
    103: "Ethernet status",
    114: "Ethernet statistics",
    118: "test structure",
    119: "diagnostics",
    120: "Ethernet frames",
    121: "Ethernet frames",
    122: "Ethernet errors",
    123: "Ethernet errors",
    125: "loss of data",
    126: "loss of data",
    127: "water marks",
    128: "triggers",
    129: "CAN settings",
}

_EXTENDED_ID, _NO_MEANING, _ID = np.uint32(0x8000_0000), np.uint32(0x6000_0000), np.uint32(0x1FFF_FFFF)
_FD_LENGTH = np.isin(np.arange(256), FD_LENGTHS)
#: Number of bytes → mask that keeps as many of a little-endian word.
_KEPT = np.array([(1 << 8 * count) - 1 for count in range(9)], np.uint64)
_DLC_LENGTH = np.array(FD_LENGTHS, np.uint8)
_FD_FLAGS = np.array(
    [
        n & 1 and FrameFlag.FD | (n >> 1 & 1) * FrameFlag.BITRATE_SWITCH | (n >> 2) * FrameFlag.ERROR_STATE
        for n in range(8)
    ],
    np.uint8,
)
_VERSIONS = (1, 2, 3)
#: An instant beyond is not a time; and so no sum leaves 63 bits.
_MOST_TIME = 1 << 61


def is_can(kind: Any) -> Any:
    """Return whether objects of this type, or of each of an array of types, are CAN frames."""
    if isinstance(kind, int):
        return kind in _READERS
    return np.isin(kind, _CAN_TYPES)


class DecodedObjects(NamedTuple):
    """What some objects gave: frames with the places of their objects, and for unreadable ones place and reason."""

    frames: list[tuple[Ints, FrameTable]]
    unreadable: list[tuple[int, str]]
    others: dict[str, int]


class _Objects:
    """Objects of one type and header version: fields by their offset in the payload."""

    def __init__(self, data: Ints, begins: Ints, sizes: Ints, payload: int, reach: int) -> None:
        self.payload, self.count = payload, len(begins)
        self.sizes = sizes - payload  # bytes of each payload
        if step := _step(begins, sizes):
            self._bytes, self._first, self._step = data, int(begins[0]), step
        else:
            width = payload + reach
            rows: Any = np.ndarray((len(data) - width + 1,), np.dtype((np.void, width)), data, 0, (1,))[
                begins
            ]
            self._bytes, self._first, self._step = rows.view(np.uint8), 0, width
        self.wrong: list[tuple[Ints, Callable[[int], str]]] = []

    def header(self, offset: int, kind: str) -> Ints:
        return np.ndarray((self.count,), kind, self._bytes, self._first + offset, (self._step,))

    def field(self, offset: int, kind: str) -> Ints:
        return self.header(self.payload + offset, kind)

    def rows(self, offset: int, width: int, lengths: Ints) -> Ints:
        """Return data bytes, with zeros behind the length and behind the end of the object."""
        room = self.sizes - offset
        if int(room.min()) < width:
            lengths = np.minimum(lengths, np.maximum(room, 0))
        if width == 8:
            words = self.field(offset, "<u8") & _KEPT[lengths]
            return words.view(np.uint8).reshape(self.count, 8)
        start = self._first + self.payload + offset
        rows: Ints = np.ndarray((self.count, width), np.uint8, self._bytes, start, (self._step, 1)).copy()
        if int(lengths.min()) < width:
            rows[np.arange(width) >= lengths[:, None]] = 0
        return rows

    def check(self, wrong: Ints, why: Callable[[int], str]) -> None:
        if wrong.any():
            self.wrong.append((wrong, why))


class _Frames(NamedTuple):
    """What a kind of object says of its frames."""

    channel: Ints
    id: Ints
    flags: Ints
    length: Ints
    data: Ints


def decode_objects(
    data: Ints, begins: Ints, sizes: Ints, start_ns: int, channels: Channels
) -> DecodedObjects:
    """Return the objects that begin at these bytes of `data`; all of their bytes are there, and at least 16 each.

    Behind the last object `data` has 256 bytes more, whatever they hold.
    """
    out = DecodedObjects([], [], {})
    step = _step(begins, sizes)
    versions, types = _field(data, begins, step, 6, "<u2"), _field(data, begins, step, 12, "<u4")
    kind, version = int(types[0]), int(versions[0])
    if kind in _READERS and version in _VERSIONS and (types == kind).all() and (versions == version).all():
        _kind(out, kind, version, data, begins, sizes, np.arange(len(begins)), start_ns, channels)
        return out
    others = np.ones(len(begins), bool)
    for kind in _READERS:
        of_kind = types == kind
        if not of_kind.any():
            continue
        others &= ~of_kind
        for version in _VERSIONS:
            places = np.flatnonzero(of_kind & (versions == version))
            if len(places):
                _kind(out, kind, version, data, begins[places], sizes[places], places, start_ns, channels)
        for place in np.flatnonzero(of_kind & ~np.isin(versions, _VERSIONS)).tolist():
            out.unreadable.append((place, f"header version {versions[place]} is not known"))
    if others.any():
        for kind, count in zip(
            *(found.tolist() for found in np.unique(types[others], return_counts=True)), strict=True
        ):
            name = _NAMES.get(kind) or (
                f"objects of type {kind}" if kind < 256 else "objects of unknown types"
            )
            out.others[name] = out.others.get(name, 0) + count
    return out


def _kind(
    out: DecodedObjects,
    kind: int,
    version: int,
    data: Ints,
    begins: Ints,
    sizes: Ints,
    places: Ints,
    start_ns: int,
    channels: Channels,
) -> None:
    """Decode objects of one type and header version."""
    name, least, reach, read = _READERS[kind]
    payload = 40 if version == 2 else 32
    short = sizes < payload + least
    if short.any():
        out.unreadable.extend(
            (place, f"{name} object of {size} bytes; it needs {payload + least}")
            for place, size in zip(places[short].tolist(), sizes[short].tolist(), strict=True)
        )
        places, begins, sizes = places[~short], begins[~short], sizes[~short]
        if not len(places):
            return
    objects = _Objects(data, begins, sizes, payload, reach)
    frames = read(objects)
    ids = frames.id & _ID
    if int(frames.id.max()) > int(_ID):
        odd = (frames.id & _NO_MEANING != 0) & (frames.flags & FrameFlag.ERROR == 0)
        objects.check(odd, lambda row: f"identifier {int(frames.id[row]):#010x} has bits that mean nothing")
    if int(ids.max()) > 0x7FF:
        wide = (ids > 0x7FF) & ((frames.flags & (FrameFlag.EXTENDED | FrameFlag.ERROR)) == 0)
        objects.check(wide, lambda row: f"identifier {int(ids[row]):#x} has more than 11 bits")
    time = _time(objects, start_ns)
    channel = _channels(frames.channel, channels)
    table = FrameTable(time, channel, ids, frames.flags, frames.length, frames.data, channels)
    if objects.wrong:
        bad = np.zeros(len(places), bool)
        for wrong, why in objects.wrong:
            rows = np.flatnonzero(wrong & ~bad)
            out.unreadable.extend((int(places[row]), why(int(row))) for row in rows.tolist())
            bad |= wrong
        places, table = places[~bad], table.take(~bad)
    if len(places):
        out.frames.append((places, table))


def _time(objects: _Objects, start_ns: int) -> Ints:
    time = objects.header(24, "<u8").copy()
    tens = objects.header(16, "<u4") == 1
    if tens.any():
        time[time > _MOST_TIME // 10_000] = _MOST_TIME + 1  # before it wraps around
        small = tens & (time <= _MOST_TIME // 10_000)
        time[small] *= np.uint64(10_000)
    far = time > _MOST_TIME
    instants = time.view(np.int64)
    if far.any():
        instants[far] = 0
        instants += start_ns
        instants[far] = NO_TIME
    else:
        instants += start_ns
    return instants


# ---- the kinds


def _message(objects: _Objects) -> _Frames:
    flags, identifier = objects.field(2, "u1"), objects.field(4, "<u4").copy()
    code = objects.field(3, "u1")
    objects.check(code > 15, lambda row: f"length code {int(code[row])} does not exist")
    length = np.minimum(code, np.uint8(8))
    given = length
    out = _way(flags & np.uint8(1))
    if int(identifier.max()) >= _EXTENDED_ID:
        out |= _extended(identifier)
    remote = flags >= 0x80
    if remote.any():
        out |= remote * np.uint8(FrameFlag.REMOTE)
        given = np.where(remote, np.uint8(0), length)
    return _Frames(objects.field(0, "<u2"), identifier, out, length, objects.rows(8, 8, given))


def _error(objects: _Objects) -> _Frames:
    zeros = np.zeros(objects.count, np.uint8)
    data = np.zeros((objects.count, 8), np.uint8)
    return _Frames(
        objects.field(0, "<u2"),
        np.zeros(objects.count, np.uint32),
        zeros | np.uint8(FrameFlag.ERROR),
        zeros,
        data,
    )


def _error_ext(objects: _Objects) -> _Frames:
    identifier, code = objects.field(16, "<u4"), objects.field(10, "u1")
    objects.check(code > 15, lambda row: f"length code {int(code[row])} does not exist")
    length = np.minimum(code, np.uint8(8))
    flags = _extended(identifier) | np.uint8(FrameFlag.ERROR)
    return _Frames(objects.field(0, "<u2"), identifier, flags, length, objects.rows(24, 8, length))


def _fd_message(objects: _Objects) -> _Frames:
    flags, fd_flags, identifier = objects.field(2, "u1"), objects.field(13, "u1"), objects.field(4, "<u4")
    out = _extended(identifier) | _way(flags & 1) | _fd_flags(fd_flags)
    remote = (flags & 0x80) != 0
    return _with_data(
        objects,
        objects.field(0, "<u2"),
        identifier,
        out,
        remote,
        objects.field(3, "u1"),
        objects.field(14, "u1"),
        20,
    )


def _fd_message_64(objects: _Objects) -> _Frames:
    flags, identifier = objects.field(12, "<u4"), objects.field(4, "<u4")
    out = _extended(identifier) | _way(objects.field(34, "u1")) | _fd_flags(flags >> 12)
    _without_further(objects, objects.field(35, "u1"))
    return _with_data(
        objects,
        objects.field(0, "u1"),
        identifier,
        out,
        (flags & 0x10) != 0,
        objects.field(1, "u1"),
        objects.field(2, "u1"),
        40,
    )


def _fd_error_64(objects: _Objects) -> _Frames:
    identifier, length = objects.field(12, "<u4"), objects.field(2, "u1")
    out = _extended(identifier) | np.uint8(FrameFlag.ERROR)
    out |= (length > 8) * np.uint8(FrameFlag.FD)
    _without_further(objects, objects.field(10, "u1"))
    remote = np.zeros(objects.count, bool)
    return _with_data(
        objects, objects.field(0, "u1"), identifier, out, remote, objects.field(1, "u1"), length, 44
    )


def _without_further(objects: _Objects, offset: Ints) -> None:
    """Cut data where further data begin, if there are any; the offset counts from the start of the object."""
    end = offset.astype(np.int64) - objects.payload
    objects.sizes = np.where(offset != 0, np.minimum(objects.sizes, end), objects.sizes)


def _with_data(
    objects: _Objects,
    channel: Ints,
    identifier: Ints,
    flags: Ints,
    remote: Ints,
    code: Ints,
    given: Ints,
    offset: int,
) -> _Frames:
    """Return frames that may be FD: with a length code and a number of data bytes."""
    fd = (flags & FrameFlag.FD) != 0
    objects.check(code > 15, lambda row: f"length code {int(code[row])} does not exist")
    objects.check(remote & fd, lambda row: "a remote frame exists only in classic CAN")
    asked = _DLC_LENGTH[np.minimum(code, np.uint8(8))]
    length = np.where(remote, asked, given).astype(np.uint8)
    impossible = np.where(fd, ~_FD_LENGTH[length], length > 8)
    objects.check(
        impossible,
        lambda row: (
            f"a {'CAN FD' if fd[row] else 'classic'} frame cannot carry {int(length[row])} data bytes"
        ),
    )
    stated = np.where(fd, _DLC_LENGTH[np.minimum(code, np.uint8(15))], asked)
    differ = ~remote & (flags & FrameFlag.ERROR == 0) & (length != stated)
    objects.check(
        differ,
        lambda row: (
            f"length code {int(code[row])} means {int(stated[row])} bytes, and {int(length[row])} are announced"
        ),
    )
    flags = flags | remote * np.uint8(FrameFlag.REMOTE)
    width = 64 if int(length.max()) > 8 else 8
    lengths = np.where(remote | impossible, 0, length).astype(np.int64)
    return _Frames(channel, identifier, flags, length, objects.rows(offset, width, lengths))


def _extended(identifier: Ints) -> Ints:
    flags: Ints = ((identifier & _EXTENDED_ID) != 0) * np.uint8(FrameFlag.EXTENDED)
    return flags


def _way(sent: Ints) -> Ints:
    flags: Ints = (sent != 0) * np.uint8(FrameFlag.TX - FrameFlag.RX) + np.uint8(FrameFlag.RX)
    return flags


def _fd_flags(bits: Ints) -> Ints:
    """Return flags of bits 0 (CAN FD), 1 (bit rate switch) and 2 (error state), of which 1 and 2 mean
    something in CAN FD alone.
    """
    flags: Ints = _FD_FLAGS[bits & 7]
    return flags


def _channels(given: Ints, channels: Channels) -> Ints:
    """Return numbers in a log, which count from 1, as numbers of the channels that are named from 0."""
    first = int(given[0])
    if (given == first).all():
        return np.full(len(given), channels.number(RowText.one_less(first)), np.uint16)
    seen = np.flatnonzero(np.bincount(given))
    table = np.zeros(int(seen[-1]) + 1, np.uint16)
    table[seen] = [channels.number(RowText.one_less(number)) for number in seen.tolist()]
    return table[given]


def _step(begins: Ints, sizes: Ints) -> int:
    """Return the size of all objects when they are equally long and follow each other without gaps, otherwise 0."""
    size, count = int(sizes[0]), len(begins)
    return size if int(begins[-1] - begins[0]) == size * (count - 1) and bool((sizes == size).all()) else 0


def _field(data: Ints, begins: Ints, step: int, offset: int, kind: str) -> Ints:
    if step:
        return np.ndarray((len(begins),), kind, data, int(begins[0]) + offset, (step,))
    return np.ndarray((len(data) - 16,), kind, data, offset, (1,))[begins]


#: Type → its name, the least bytes of its payload, how many of them are looked at, and what reads them.
_READERS: dict[int, tuple[str, int, int, Callable[[_Objects], _Frames]]] = {
    CAN_MESSAGE: ("CAN_MESSAGE", 16, 16, _message),
    CAN_MESSAGE2: ("CAN_MESSAGE2", 16, 16, _message),
    CAN_ERROR: ("CAN_ERROR", 4, 4, _error),
    CAN_ERROR_EXT: ("CAN_ERROR_EXT", 24, 32, _error_ext),
    CAN_FD_MESSAGE: ("CAN_FD_MESSAGE", 20, 84, _fd_message),
    CAN_FD_MESSAGE_64: ("CAN_FD_MESSAGE_64", 40, 104, _fd_message_64),
    CAN_FD_ERROR_64: ("CAN_FD_ERROR_64", 44, 108, _fd_error_64),
}
_CAN_TYPES = np.array(sorted(_READERS), np.uint32)
