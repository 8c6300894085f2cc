"""pcapng of SocketCAN packets, as Wireshark opens it.

1. One section, little-endian; one interface a channel, described before its first packet; times in nanoseconds.
2. Every packet says which way it went, or that this is unknown: all blocks of classic frames are 64 bytes.

*Facts*: draft-ietf-opsawg-pcapng, and the LINKTYPE page for 227. *Choice*: a frame takes as many bytes as Linux gives it
(16, of CAN FD 72), so that readers that know no FDF flag tell them by that.
"""

from __future__ import annotations

import struct
from typing import BinaryIO

import numpy as np

from aces_bus import FrameTable
from aces_bus.frame_table import FrameFlag, Ints
from aces_bus.recordings.write.base import FrameWriter

from ..started import records_in_order
from .pcapng import BYTE_ORDER, ENHANCED, INTERFACE, NAME_BYTES, SECTION, interface_name
from .socketcan import (
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


class PcapngWriter(FrameWriter):
    """Frames as pcapng packets. What has no time is written with the time 0, and counted in `lossy`."""

    format = "pcapng"

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        self._interfaces: dict[str | None, int] = {}
        section = struct.pack("<IHHq", BYTE_ORDER, 1, 0, -1) + _option(4, b"aces-bus") + _option(0, b"")
        file.write(_block(SECTION, section))

    def _encoded(self, table: FrameTable) -> bytes:
        interface = self._numbers(table)
        is_large = (table.flags & FrameFlag.FD != 0) | (table.length > 8) & (
            table.flags & FrameFlag.REMOTE == 0
        )
        parts = ((np.flatnonzero(is_large), _LARGE), (np.flatnonzero(~is_large), _CLASSIC))
        return records_in_order(
            len(table),
            [
                (rows, self._blocks(table.take(rows), interface[rows], kind))
                for rows, kind in parts
                if len(rows)
            ],
        )

    def _numbers(self, table: FrameTable) -> Ints:
        """Return the interface of each frame; a new one is described first."""
        numbers = np.zeros(len(table.channels.names) or 1, np.uint32)
        for channel in np.unique(table.channel).tolist():
            name = table.channels.names[channel]
            if name not in self._interfaces:
                raw = (name or "").encode("utf-8", "backslashreplace")[:NAME_BYTES]
                options = _option(2, raw) if raw else b""
                body = struct.pack("<HHI", SOCKETCAN, 0, 0) + options + _option(9, b"\x09") + _option(0, b"")
                self._file.write(_block(INTERFACE, body))
                if interface_name(raw, len(self._interfaces)) != name:
                    self.lose("channel names")
                self._interfaces[name] = len(self._interfaces)
            numbers[channel] = self._interfaces[name]
        return numbers[table.channel]

    def _blocks(self, table: FrameTable, interface: Ints, kind: np.dtype[np.void]) -> Ints:
        blocks = np.zeros(len(table), kind)
        flags = table.flags
        is_remote = flags & FrameFlag.REMOTE != 0
        time = self._epoch_times(table)
        blocks["type"], blocks["total"], blocks["again"] = ENHANCED, kind.itemsize, kind.itemsize
        blocks["interface"] = interface
        blocks["high"], blocks["low"] = time >> 32, time & 0xFFFF_FFFF
        blocks["captured"] = blocks["original"] = FD_SIZE if kind is _LARGE else CLASSIC_SIZE
        blocks["id"] = (
            table.id.astype(np.uint32)
            | (flags & FrameFlag.EXTENDED != 0) * np.uint32(EXTENDED_BIT)
            | is_remote * np.uint32(REMOTE_BIT)
            | (flags & FrameFlag.ERROR != 0) * np.uint32(ERROR_BIT)
        )
        blocks["length"] = self._remote_lengths(table)
        is_fd = flags & FrameFlag.FD != 0
        blocks["fd"] = (
            is_fd * np.uint8(FDF)
            | (flags & FrameFlag.BITRATE_SWITCH != 0) * np.uint8(BRS)
            | (flags & FrameFlag.ERROR_STATE != 0) * np.uint8(ESI)
        )
        data: Ints = blocks["data"]
        width = min(table.data.shape[1], data.shape[1])
        data[:, :width] = table.data[:, :width]
        if is_remote.any():
            data[is_remote] = 0
        blocks["option"], blocks["size"] = 2, 4
        blocks["way"] = (flags & FrameFlag.RX != 0) * 1 + (flags & FrameFlag.TX != 0) * 2
        return blocks


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + value + bytes(-len(value) % 4)


def _block(kind: int, body: bytes) -> bytes:
    size = struct.pack("<I", len(body) + 12)
    return struct.pack("<I", kind) + size + body + size
