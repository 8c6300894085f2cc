"""pcapng of SocketCAN packets, as Wireshark opens it.

1. One section, little-endian; one interface a channel, described before its first packet; times in nanoseconds.
2. Every packet says which way it went, or that nobody knows: all blocks of classic frames are 64 bytes.

*Facts*: draft-ietf-opsawg-pcapng, and the LINKTYPE page for 227. *Choice*: a frame takes as many bytes as Linux gives it
(16, of CAN FD 72), so that readers that know no FDF flag tell them by that.
"""

from __future__ import annotations

import struct
from typing import BinaryIO, ClassVar

import numpy as np

from ...frame_table import (
    BITRATE_SWITCH,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    NO_TIME,
    REMOTE,
    RX,
    TX,
    FrameTable,
    Ints,
)
from ..pcap.pcapng import BYTE_ORDER, ENHANCED, INTERFACE, NAME_BYTES, SECTION, interface_name
from ..pcap.socketcan import (
    BRS,
    CLASSIC_SIZE,
    ERROR_BIT,
    ESI,
    EXTENDED_BIT,
    FD_SIZE,
    FDF,
    REMOTE_BIT,
    SOCKETCAN,
)

_HEAD = [
    ("type", "<u4"), ("total", "<u4"), ("interface", "<u4"), ("high", "<u4"), ("low", "<u4"),
    ("captured", "<u4"), ("original", "<u4"), ("id", ">u4"), ("length", "u1"), ("fd", "u1"), ("unused", "<u2"),
]  # fmt: skip
_TAIL = [("option", "<u2"), ("size", "<u2"), ("way", "<u4"), ("end", "<u4"), ("again", "<u4")]
_CLASSIC = np.dtype([*_HEAD, ("data", "u1", 8), *_TAIL])
_LARGE = np.dtype([*_HEAD, ("data", "u1", 64), *_TAIL])
#: Written at once.
_ROWS = 1 << 15


class PcapngWriter:
    """Frames as pcapng packets. What has no time is written with the time 0, and counted in `lossy`."""

    format: ClassVar[str] = "pcapng"

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file, self.name = file, name
        self.lossy: dict[str, int] = {}
        self._interfaces: dict[str | None, int] = {}
        section = struct.pack("<IHHq", BYTE_ORDER, 1, 0, -1) + _option(4, b"aces-bus") + _option(0, b"")
        file.write(_block(SECTION, section))

    def write(self, table: FrameTable) -> None:
        """Write the frames, in order."""
        for start in range(0, len(table), _ROWS):
            self._write(table.take(slice(start, start + _ROWS)))

    def _write(self, table: FrameTable) -> None:
        interface = self._numbers(table)
        is_large = (table.flags & FD != 0) | (table.length > 8) & (table.flags & REMOTE == 0)
        if not is_large.any():
            self._file.write(self._blocks(table, interface, _CLASSIC).tobytes())
            return
        if is_large.all():
            self._file.write(self._blocks(table, interface, _LARGE).tobytes())
            return
        rows = np.zeros((len(table), _LARGE.itemsize), np.uint8)
        is_used = np.ones(rows.shape, bool)
        is_used[~is_large, _CLASSIC.itemsize :] = False
        for mask, kind in ((is_large, _LARGE), (~is_large, _CLASSIC)):
            blocks = self._blocks(table.take(mask), interface[mask], kind)
            rows[mask, : kind.itemsize] = blocks.view(np.uint8).reshape(-1, kind.itemsize)
        self._file.write(rows[is_used].tobytes())

    def close(self) -> None:
        """Nothing is kept back."""

    def _numbers(self, table: FrameTable) -> Ints:
        """The interface of each frame; a new one is described first."""
        numbers = np.zeros(len(table.channels.names) or 1, np.uint32)
        for channel in np.unique(table.channel).tolist():
            name = table.channels.names[channel]
            if name not in self._interfaces:
                raw = (name or "").encode("utf-8", "backslashreplace")[:NAME_BYTES]
                options = _option(2, raw) if raw else b""
                body = struct.pack("<HHI", SOCKETCAN, 0, 0) + options + _option(9, b"\x09") + _option(0, b"")
                self._file.write(_block(INTERFACE, body))
                if interface_name(raw, len(self._interfaces)) != name:
                    self._lose("channel names", 1)
                self._interfaces[name] = len(self._interfaces)
            numbers[channel] = self._interfaces[name]
        return numbers[table.channel]

    def _blocks(self, table: FrameTable, interface: Ints, kind: np.dtype[np.void]) -> Ints:
        blocks = np.zeros(len(table), kind)
        flags = table.flags
        is_remote = flags & REMOTE != 0
        time = table.time
        if (wrong := time < 0).any():
            missing = int((time == NO_TIME).sum())
            self._lose("times that the capture does not say, written as 0", missing)
            self._lose("times before 1970, written as 0", int(wrong.sum()) - missing)
            time = np.where(wrong, 0, time)
        blocks["type"], blocks["total"], blocks["again"] = ENHANCED, kind.itemsize, kind.itemsize
        blocks["interface"] = interface
        blocks["high"], blocks["low"] = time >> 32, time & 0xFFFF_FFFF
        blocks["captured"] = blocks["original"] = FD_SIZE if kind is _LARGE else CLASSIC_SIZE
        blocks["id"] = (
            table.id.astype(np.uint32)
            | (flags & EXTENDED != 0) * np.uint32(EXTENDED_BIT)
            | is_remote * np.uint32(REMOTE_BIT)
            | (flags & ERROR != 0) * np.uint32(ERROR_BIT)
        )
        length = table.length
        if (wrong := is_remote & (length > 8)).any():
            self._lose("lengths above 8 that remote frames ask for", int(wrong.sum()))
            length = np.where(wrong, 8, length)
        blocks["length"] = length
        is_fd = flags & FD != 0
        blocks["fd"] = (
            is_fd * np.uint8(FDF)
            | (flags & BITRATE_SWITCH != 0) * np.uint8(BRS)
            | (flags & ERROR_STATE != 0) * np.uint8(ESI)
        )
        data: Ints = blocks["data"]
        width = min(table.data.shape[1], data.shape[1])
        data[:, :width] = table.data[:, :width]
        if is_remote.any():
            data[is_remote] = 0
        blocks["option"], blocks["size"] = 2, 4
        blocks["way"] = (flags & RX != 0) * 1 + (flags & TX != 0) * 2
        return blocks

    def _lose(self, what: str, count: int) -> None:
        if count:
            self.lossy[what] = self.lossy.get(what, 0) + count


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + value + bytes(-len(value) % 4)


def _block(kind: int, body: bytes) -> bytes:
    size = struct.pack("<I", len(body) + 12)
    return struct.pack("<I", kind) + size + body + size
