"""ASAM MDF 4.10 with CAN bus logging, as asammdf, python-can and the vendors' tools read it.

1. Memory is bounded: records go out in data blocks of about 1 MiB, and the blocks that describe them are written by `close`.
2. A frame's instant is kept to the nanosecond: the time channel counts integer nanoseconds from the start of the file.
3. A channel has groups of its own, whose source has the channel's name as its path; so names survive.
4. The order survives too: beside the frame, a record says how many frames come before it (modulo 2³²).

A group is a channel × what its records hold: 8 or 64 data bytes, a data, remote or error frame, a direction or none.
*Facts*: ASAM's bus logging: composed channels CAN_DataFrame, CAN_RemoteFrame, CAN_ErrorFrame with their parts; Dir is 0
for received, 1 for sent; BusChannel is a number, here the digits at the end of the channel's name, as with python-can.
*Choice*: our own blocks and not asammdf's: it takes a second to import, and must not be imported before python-can.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np

from aces_bus import FrameTable
from aces_bus.frame_table import NO_TIME, FrameFlag, Ints
from aces_bus.recordings.write.base import ChannelNumbers, RecordingWriter

from ..started import DLC_OF_LENGTH
from . import blocks as mdf
from .blocks import ORDER

#: Bytes of a record before those of the frame.
_FRAME_AT = 12

_BLOCK = 1 << 20
#: Kept back in all groups together.
_KEPT = 16 << 20
_CHANNELS = 256
_COMMENT = "<HDcomment><TX>CAN bus log, written by aces-bus</TX></HDcomment>"
_HISTORY = (
    "<FHcomment><TX>written</TX><tool_id>aces-bus</tool_id><tool_vendor>aces-bus</tool_vendor>"
    "<tool_version>1</tool_version></FHcomment>"
)


def _layout(kind: str, width: int, has_way: bool) -> np.dtype[np.void]:
    """Return the record of a group: the time, then the parts of the frame in the order of their names in the file."""
    parts: list[tuple[str, str] | tuple[str, str, int]] = [
        ("time", "<i8"),
        (ORDER, "<u4"),
        ("BusChannel", "u1"),
        ("ID", "<u4"),
        ("IDE", "u1"),
        ("DLC", "u1"),
        ("DataLength", "u1"),
    ]
    if has_way:
        parts.append(("Dir", "u1"))
    if kind != "CAN_RemoteFrame":
        parts += [("EDL", "u1"), ("BRS", "u1"), ("ESI", "u1"), ("DataBytes", "u1", width)]
    return np.dtype(parts)


@dataclass
class _Group:
    """Records of one kind, of one channel."""

    kind: str
    layout: np.dtype[np.void]
    name: str | None
    number: int
    records: int = 0
    kept: list[bytes] = field(default_factory=list)
    kept_bytes: int = 0
    pieces: list[tuple[int, int]] = field(default_factory=list)


class Mf4Writer(RecordingWriter):
    """Frames as an MDF 4.10 bus log. The file is finished by `close`, and must be seekable.

    A frame without time gets that of the frame before it, and is counted in `lossy`.
    """

    format = "MF4"

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        self._groups: dict[tuple[str | None, str, int, bool], _Group] = {}
        self._numbers: dict[str | None, int] = {}
        self._free = ChannelNumbers(limit=_CHANNELS)
        self._start: int | None = None
        self._last = 0
        self._frames = 0
        self._at = 0
        self._kept = 0
        self._base = file.tell()
        self._put(mdf.identification())
        self._put(mdf.header(0, 0, 0, 0))
        comment = self._put(mdf.text_block(_COMMENT, is_xml=True))
        story = self._put(mdf.text_block(_HISTORY, is_xml=True))
        self._fixed = comment, story

    def _put(self, data: bytes) -> int:
        """Write a block; its offset."""
        at = self._at
        self._file.write(data)
        self._at += len(data)
        return at

    def write(self, table: FrameTable) -> None:
        """Write the frames, in order."""
        if not len(table):
            return
        time = self._times(table.time)
        flags = table.flags
        is_remote, is_error = flags & FrameFlag.REMOTE != 0, flags & FrameFlag.ERROR != 0
        kinds = np.where(is_error, 2, np.where(is_remote, 1, 0))
        is_wide = (table.length > 8) & ~is_remote
        has_way = flags & (FrameFlag.RX | FrameFlag.TX) != 0
        sorts = table.channel.astype(np.int64) * 16 + kinds * 4 + is_wide * 2 + has_way
        for sort in np.unique(sorts).tolist():
            rows = np.flatnonzero(sorts == sort)
            group = self._group(
                table.channels.names[sort >> 4],
                ("CAN_DataFrame", "CAN_RemoteFrame", "CAN_ErrorFrame")[sort >> 2 & 3],
                64 if sort & 2 else 8,
                bool(sort & 1),
            )
            self._add(group, table.take(rows), time[rows], (self._frames + rows) & 0xFFFF_FFFF)
        self._frames += len(table)
        if self._kept > _KEPT:
            for group in self._groups.values():
                self._flush(group)

    def _times(self, time: Ints) -> Ints:
        is_missing = time == NO_TIME
        if is_missing.any():
            self.lose(
                "times that the capture does not say, written as the frame's before", int(is_missing.sum())
            )
            latest = np.maximum.accumulate(np.where(is_missing, -1, np.arange(len(time))))
            time = np.where(latest < 0, self._last, time[latest])
        if self._start is None:
            self._start = max(0, int(time[0]))
        self._last = int(time[-1])
        return time - self._start

    def _group(self, name: str | None, kind: str, width: int, has_way: bool) -> _Group:
        key = name, kind, width, has_way
        if key not in self._groups:
            self._groups[key] = _Group(kind, _layout(kind, width, has_way), name, self._number(name))
        return self._groups[key]

    def _number(self, name: str | None) -> int:
        """Return the number of a channel: that at the end of its name, or the lowest that is free."""
        if name not in self._numbers:
            self._numbers[name] = self._free.number(name) - 1
            self.lose(
                "channel names",
                name is not None and (name != name.strip(" \r\t\n\0") or not name or "\0" in name),
            )
        return self._numbers[name]

    def _add(self, group: _Group, table: FrameTable, time: Ints, order: Ints) -> None:
        records = np.zeros(len(table), group.layout)
        flags = table.flags
        is_fd = flags & FrameFlag.FD != 0
        records["time"], records["ID"], records["BusChannel"] = time, table.id, group.number
        records[ORDER] = order
        records["IDE"] = flags & FrameFlag.EXTENDED != 0
        records["DLC"] = np.where(is_fd, DLC_OF_LENGTH[table.length], table.length)
        records["DataLength"] = 0 if group.kind == "CAN_RemoteFrame" else table.length
        names = group.layout.names or ()
        if "Dir" in names:
            records["Dir"] = flags & FrameFlag.TX != 0
        if "DataBytes" in names:
            records["EDL"] = is_fd
            records["BRS"] = flags & FrameFlag.BITRATE_SWITCH != 0
            records["ESI"] = flags & FrameFlag.ERROR_STATE != 0
            data: Ints = records["DataBytes"]
            width = min(data.shape[1], table.data.shape[1])
            data[:, :width] = table.data[:, :width]
        raw = records.tobytes()
        step = _BLOCK // group.layout.itemsize * group.layout.itemsize
        for start in range(0, len(raw), step):  # whole records, so that no block is longer than 2 MiB
            piece = raw[start : start + step]
            group.kept.append(piece)
            group.kept_bytes += len(piece)
            self._kept += len(piece)
            if group.kept_bytes >= _BLOCK:
                self._flush(group)
        group.records += len(table)

    def _flush(self, group: _Group) -> None:
        if group.kept:
            group.pieces.append((self._put(mdf.data_block(b"".join(group.kept))), group.kept_bytes))
            self._kept -= group.kept_bytes
            group.kept, group.kept_bytes = [], 0

    def close(self) -> None:
        """Write what is kept back, and the blocks that describe the groups."""
        comment, story = self._fixed
        unit = self._put(mdf.text_block("s"))
        conversion = self._put(mdf.ns_conversion(unit))
        time_name = self._put(mdf.text_block("Timestamp"))
        next_at = 0
        for group in reversed(self._groups.values()):
            self._flush(group)
            group_at = self._describe(group, time_name, conversion, unit)
            data_at = group.pieces[0][0] if len(group.pieces) == 1 else self._put(mdf.data_list(group.pieces))
            next_at = self._put(mdf.data_group(next_at, group_at, data_at))
        history = self._put(mdf.history(story, self._start or 0))
        self._file.seek(self._base + mdf.HD_AT)
        self._file.write(mdf.header(next_at, history, comment, self._start or 0))
        self._file.seek(self._base + self._at)

    def _describe(self, group: _Group, time_name: int, conversion: int, unit: int) -> int:
        """Return the blocks of a channel group, the last first; the offset of the group's own."""
        fields: Any = group.layout.fields
        last = 0
        for name in reversed([name for name in group.layout.names or () if name not in ("time", ORDER)]):
            kind, first = fields[name][:2]
            what = mdf.BYTES if name == "DataBytes" else mdf.UNSIGNED
            last = self._channel(f"{group.kind}.{name}", what, first, kind.itemsize, last)
        whole = group.layout.itemsize - _FRAME_AT
        last = self._channel(group.kind, mdf.BYTES, _FRAME_AT, whole, 0, parts_at=last)
        last = self._channel(ORDER, mdf.UNSIGNED, 8, 4, last, is_bus_event=False)
        time = mdf.ChannelBlock(
            time_name, mdf.MASTER, mdf.SIGNED, 0, 64, 0, last, 0, conversion, unit, True, is_bus_event=False
        )
        time_at = self._put(mdf.channel(time))
        source_name = self._put(mdf.text_block(f"CAN{group.number}"))
        path = 0 if group.name is None else self._put(mdf.text_block(group.name))
        source = self._put(mdf.source(source_name, path))
        acquired = self._put(mdf.text_block(group.kind.removeprefix("CAN_")))
        return self._put(mdf.channel_group(time_at, acquired, source, group.records, group.layout.itemsize))

    def _channel(
        self, name: str, data_type: int, first_byte: int, size: int, next_at: int, **more: Any
    ) -> int:
        """Return a channel of so many bytes in each record; its offset."""
        name_at = self._put(mdf.text_block(name))
        block = mdf.ChannelBlock(name_at, mdf.VALUE, data_type, first_byte, 8 * size, next_at=next_at, **more)
        return self._put(mdf.channel(block))
