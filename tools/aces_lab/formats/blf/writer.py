"""Vector's binary log: a header, then containers of objects, packed with zlib.

1. Times are ns from the start that the header states, in whole ms (UTC, as with python-can).
2. A frame without a channel has channel 0, which is none where channels count from 1, and comes back so.
3. The header has the sizes and the number of objects, and is written at the end once more.

    header 144: LOGG, …, sizes, number of objects, start, end
    object: LOBJ, u16 header size, u16 version, u32 size, u32 type, | u32 flags (2: ns), u16, u16, u64 time, | …
      1   CAN_MESSAGE      u16 channel, u8 flags (1 sent, 0x80 remote), u8 length, u32 id, 8 bytes
      100 CAN_FD_MESSAGE   u16 channel, u8 flags, u8 code, u32 id, u32, u8, u8 FD flags (1 FD, 2 BRS, 4 ESI), u8 length, …,
                           64 bytes
      73  CAN_ERROR_EXT    u16 channel, …, u8 length, …, u32 id, …, 8 bytes
      10  LOG_CONTAINER    u16 method (2: zlib), …, u32 size of what is packed

*Facts*: layouts as python-can and vector_blf have them. A container holds 128 KiB; an object may go on in the next one.
*Choice*: zlib's level 2: packing takes half of the time, and level 6 saves a twentieth of the size for twice of it.
"""

from __future__ import annotations

import struct
import zlib
from datetime import UTC, datetime
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from aces_bus import FrameTable
from aces_bus.frame_table import FrameFlag, Ints, widened
from aces_bus.recordings.write.base import ChannelNumbers

from ..started import DLC_OF_LENGTH, EARLIEST, StartedWriter, records_in_order, rows_by_kind

_CONTAINER = 128 * 1024
_LEVEL = 2
_HEADER_SIZE = 144
_HEADER = struct.Struct("<4sI8B2Q2I8H8H")
_BASE = struct.Struct("<4sHHII")
_PACKED = struct.Struct("<H6xI4x")
_APPLICATION = 0  # not one of Vector's

_OBJECT: list[tuple[str, str]] = [
    ("signature", "S4"),
    ("header_size", "<u2"),
    ("header_version", "<u2"),
    ("size", "<u4"),
    ("type", "<u4"),
    ("time_unit", "<u4"),
    ("client", "<u2"),
    ("version", "<u2"),
    ("time", "<u8"),
]
_CLASSIC = np.dtype(
    [*_OBJECT, ("channel", "<u2"), ("flags", "u1"), ("length", "u1"), ("id", "<u4"), ("data", "u1", (8,))]
)
_FD = np.dtype(
    [
        *_OBJECT,
        ("channel", "<u2"),
        ("flags", "u1"),
        ("dlc", "u1"),
        ("id", "<u4"),
        ("frame_time", "<u4"),
        ("bit_count", "u1"),
        ("fd_flags", "u1"),
        ("length", "u1"),
        ("reserved", "u1", (5,)),
        ("data", "u1", (64,)),
    ]
)
_ERROR = np.dtype(
    [
        *_OBJECT,
        ("channel", "<u2"),
        ("reserved_length", "<u2"),
        ("flags", "<u4"),
        ("code", "u1"),
        ("position", "u1"),
        ("length", "u1"),
        ("reserved", "u1"),
        ("frame_time", "<u4"),
        ("id", "<u4"),
        ("more_flags", "<u2"),
        ("reserved_2", "u1", (2,)),
        ("data", "u1", (8,)),
    ]
)
_TYPES = {_CLASSIC: 1, _FD: 100, _ERROR: 73}
_NANOSECONDS = 2


class BlfWriter(StartedWriter):
    """Frames as objects of a BLF file, which must be seekable."""

    format = "blf"
    keeps_error_width = True

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        self._begins_at = file.tell()
        self._kept = bytearray()
        self._objects = 0
        self._unpacked = self._size = _HEADER_SIZE
        file.write(self._header())

    def _numbering(self) -> ChannelNumbers:
        return ChannelNumbers(none=0)

    def _settled(self, first: int) -> int:
        return first - first % 1_000_000

    def _count(self, table: FrameTable, offsets: Ints) -> None:
        is_long = (table.flags & FrameFlag.ERROR != 0) & (table.length > 8)
        self.lose("error frames with more than 8 bytes", np.count_nonzero(is_long))

    def _encoded(self, table: FrameTable) -> bytes:
        channels, offsets = self._numbers.numbers(table), self._offsets
        self._objects += len(table)
        self._kept += records_in_order(
            len(table),
            [
                (rows, make(table.take(rows), offsets[rows], channels[rows]))
                for rows, make in zip(rows_by_kind(table), (_classic, _fd, _error), strict=True)
                if len(rows)
            ],
        )
        return b"".join(self._packed(_CONTAINER) for _ in range(len(self._kept) // _CONTAINER))

    def settle(self) -> None:
        """Write what is kept, and the header once more."""
        while self._kept:
            self._file.write(self._packed(_CONTAINER))
        self._file.seek(self._begins_at)
        self._file.write(self._header())
        self._file.seek(0, 2)

    def close(self) -> None:
        """Settle it; a file to which nothing was written has its header, too."""
        self.settle()

    def _packed(self, count: int) -> bytes:
        """Return a container of the first bytes that are kept."""
        content = bytes(self._kept[:count])
        del self._kept[:count]
        packed = zlib.compress(content, _LEVEL)
        size = _BASE.size + _PACKED.size + len(packed)
        self._unpacked += _BASE.size + _PACKED.size + len(content)
        self._size += size + size % 4
        head = _BASE.pack(b"LOBJ", _BASE.size, 1, size, 10) + _PACKED.pack(2, len(content))
        return (
            head + packed + bytes(size % 4)
        )  # so much, and not what is missing to four: all readers go by it

    def _header(self) -> bytes:
        start = self._start or 0
        last = start + self._last
        numbers = (_APPLICATION, 0, 0, 0, 2, 6, 8, 1)  # the last four: the version of the format's library
        header = _HEADER.pack(
            *(b"LOGG", _HEADER_SIZE, *numbers, self._size, self._unpacked, self._objects & 0xFFFF_FFFF, 0),
            *(*_system_time(start), *_system_time(last)),
        )
        return header.ljust(_HEADER_SIZE, b"\0")


def _system_time(ns: int) -> tuple[int, ...]:
    """Return Windows' SYSTEMTIME; all zero for times that count from no calendar."""
    if ns < EARLIEST:
        return (0,) * 8
    at = datetime.fromtimestamp(ns // 1_000_000_000, UTC)
    milliseconds = ns // 1_000_000 % 1000
    return at.year, at.month, at.isoweekday() % 7, at.day, at.hour, at.minute, at.second, milliseconds


def _made(kind: np.dtype[Any], table: FrameTable, offsets: Ints, channels: Ints) -> npt.NDArray[Any]:
    """Return objects with the head that all kinds have."""
    made = np.zeros(len(table), kind)
    made["signature"] = b"LOBJ"
    made["header_size"], made["header_version"] = 32, 1
    made["size"], made["type"], made["time_unit"] = kind.itemsize, _TYPES[kind], _NANOSECONDS
    made["time"], made["channel"] = offsets, channels
    made["id"] = np.where(table.flags & FrameFlag.EXTENDED, table.id | np.uint32(1 << 31), table.id)
    made["length"] = table.length
    return made


def _classic(table: FrameTable, offsets: Ints, channels: Ints) -> npt.NDArray[Any]:
    made = _made(_CLASSIC, table, offsets, channels)
    made["flags"] = table.flags // FrameFlag.TX + 0x80 * (table.flags & FrameFlag.REMOTE != 0)
    made["data"] = table.data[:, :8]
    return made


def _fd(table: FrameTable, offsets: Ints, channels: Ints) -> npt.NDArray[Any]:
    made = _made(_FD, table, offsets, channels)
    made["flags"] = table.flags // FrameFlag.TX
    made["dlc"] = DLC_OF_LENGTH[table.length]
    made["fd_flags"] = (
        1 + 2 * (table.flags & FrameFlag.BITRATE_SWITCH != 0) + 4 * (table.flags & FrameFlag.ERROR_STATE != 0)
    )
    made["data"] = widened(table.data, 64)
    return made


def _error(table: FrameTable, offsets: Ints, channels: Ints) -> npt.NDArray[Any]:
    made = _made(_ERROR, table, offsets, channels)
    made["length"] = np.minimum(table.length, 8)
    made["data"] = table.data[:, :8]
    return made
