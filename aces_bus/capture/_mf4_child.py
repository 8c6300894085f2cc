"""Reads an MF4 file in a process of its own, and sends the frames to `mf4.py` as tables.

1. Only this process imports asammdf, and it runs nothing else. What a hostile file may cost is this process: its memory, the
   files it writes and, through the one who waits, its time.
2. Everything it says goes through one pipe as messages: a letter, a length, the bytes. Nothing is sent as a pickle.
3. A group that breaks off costs the rest of that group; what was read of it, and the other groups, stand.

Frames of all groups come in the order of their times (of their own numbers, where `write/mf4.py` wrote them), and within a
group always as they stand there. No group is ever read whole: each gives pieces, and what is earlier than the end of
every piece at hand goes out.
"""

from __future__ import annotations

import json
import os
import shutil
import struct
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any, BinaryIO

import numpy as np

from ..frame_table import Ints
from ._mdf import ORDER, PROGRAM
from ._mf4_frames import (
    Piece,
    broken_off,
    channels_of,
    fields_of,
    group_kind,
    instants,
    instants_of_seconds,
    merged,
    no_log,
    other_words,
    piece_of,
)
from ._mf4_links import is_tree

#: Memory on top of what the libraries take once they are loaded.
MEMORY = 1 << 30
#: What sorting and finishing may write to disk, beside four times the file's size.
DISK = 1 << 30

TABLE, COUNTS, ERROR_SAID, END = b"T", b"C", b"E", b"Z"
HEAD = struct.Struct("<cI")
SHAPE = struct.Struct("<IB")

_ROWS = 1 << 15
_PIECE_BYTES = 1 << 23
_BUS_EVENT = 0x2
_PROBLEMS = 5


class Reader:
    """One file. `send` gets a letter and the bytes of a message."""

    def __init__(self, mdf: Any, send: Any) -> None:
        self.mdf, self.send = mdf, send
        self.names: dict[str | None, int] = {}
        self.is_ours = bytes(mdf.identification.program_identification).rstrip(b"\0 ") == PROGRAM
        self.start_ns = int(mdf.header.abs_time)
        self.lines = self.frames = self.bad = 0
        self.others: Counter[str] = Counter()
        self.problems: list[tuple[int, str]] = []

    def run(self) -> None:
        """Send everything."""
        pieces: list[Iterator[Piece]] = []
        has_bus = False
        for index, group in enumerate(self.mdf.groups):
            records = int(group.channel_group.cycles_nr)
            names = [channel.name for channel in group.channels]
            kind = group_kind(names)
            is_bus = bool(group.channel_group.flags & _BUS_EVENT)
            has_bus = has_bus or is_bus or kind is not None
            if not records:
                continue
            if kind is not None:
                pieces.append(self._guarded(index, kind, records))
                continue
            source = group.channel_group.acq_source
            words = other_words(names, is_bus, getattr(source, "bus_type", 0))
            self.others[words] += records
            self.lines += records
        if not has_bus:
            raise ValueError(no_log(len(self.mdf.groups)))
        for piece in merged(pieces):
            self._tell()
            n, width = len(piece.time), piece.data.shape[1]
            columns = (piece.time, piece.channel, piece.id, piece.flags, piece.length, piece.data)
            self.send(TABLE, SHAPE.pack(n, width) + b"".join(column.tobytes() for column in columns))
        self._tell()

    def _tell(self) -> None:
        counts = {
            "lines": self.lines,
            "frames": self.frames,
            "unreadable": self.bad,
            "others": self.others,
            "problems": self.problems,
            "names": list(self.names),
        }
        self.send(COUNTS, json.dumps(counts).encode())

    def _lose(self, number: int, reason: str, count: int = 1) -> None:
        self.bad += count
        if len(self.problems) < _PROBLEMS:
            self.problems.append((number, reason))

    def _guarded(self, index: int, kind: str, records: int) -> Iterator[Piece]:
        """The frames of a group; where it breaks off, the rest counts as one unreadable record."""
        done = 0
        reason = ""
        try:
            for count, piece in self._pieces(index, kind):
                done += count
                self.lines += count
                self.frames += len(piece.time)
                if len(piece.time):
                    yield piece
        except MemoryError:
            reason = "more memory would be needed than is allowed"
        except Exception as error:
            reason = str(error) if type(error) is ValueError else _words(error)
        if reason or done < records:
            self.lines += 1
            self._lose(done + 1, broken_off(kind, index, records, done, reason))

    def _pieces(self, index: int, kind: str) -> Iterator[tuple[int, Piece]]:
        """How many records were looked at, and the frames in them."""
        mdf = self.mdf
        group = mdf.groups[index]
        size = int(group.channel_group.samples_byte_nr + group.channel_group.invalidation_bytes_nr)
        group.read_split_count = max(1, min(_ROWS, _PIECE_BYTES // max(size, 1)))
        places = {channel.name: at for at, channel in enumerate(group.channels)}
        last: int | None = None
        seen = 0
        for fragment in mdf._load_data(group):
            if not fragment.record_count:
                continue

            def column(name: str, fragment: Any = fragment) -> Any:
                at = places.get(name)
                if at is None:
                    return None
                return mdf.get(
                    group=index,
                    index=at,
                    data=fragment,
                    raw=True,
                    samples_only=True,
                    ignore_invalidation_bits=True,
                )[0]

            time = self._time(index, fragment, column)
            order = column(ORDER) if self.is_ours else None
            key = np.maximum.accumulate(time if order is None else np.array(order, np.int64))
            if last is not None:
                key = np.maximum(key, last)
            last = int(key[-1])
            count = len(time)
            piece = self._frames(index, kind, column, key, time, seen)
            seen += count
            yield count, piece

    def _time(self, index: int, fragment: Any, column: Any) -> Ints:
        """int64 nanoseconds since 1970."""
        mdf = self.mdf
        at = mdf.masters_db.get(index)
        if at is None:
            raise ValueError("the group has no times")
        master = mdf.groups[index].channels[at]
        raw = column(master.name) if master.name not in ("",) else None
        conversion = master.conversion
        if (
            raw is not None
            and raw.dtype.kind in "iu"
            and conversion is not None
            and conversion.conversion_type == 1
            and conversion.a == 1e-9
            and not conversion.b
        ):
            return instants(raw, self.start_ns)
        seconds = np.asarray(mdf.get_master(index, data=fragment, one_piece=True), np.float64)
        return instants_of_seconds(seconds, self.start_ns)

    def _channel(self, name: str | None) -> int:
        return self.names.setdefault(name, min(len(self.names), 0xFFFF))

    def _channels(self, index: int, numbers: Ints | None, n: int) -> Ints:
        source = self.mdf.groups[index].channel_group.acq_source
        if self.is_ours:
            path = getattr(source, "path", None)
            return np.full(n, self._channel(path or None), np.uint16)
        if numbers is None:
            return np.full(n, self._channel(None), np.uint16)
        return channels_of(numbers, self._channel)

    def _frames(self, index: int, kind: str, column: Any, key: Ints, time: Ints, seen: int) -> Piece:
        n = len(time)

        def number(part: str) -> Ints | None:
            values = column(f"{kind}.{part}")
            if values is None or values.dtype.kind not in "iubf" or values.shape != (n,):
                return None
            return np.array(values, np.int64)

        way = column(f"{kind}.Dir")
        if way is not None and way.dtype.kind == "S":
            way = np.char.lower(way) != b"rx"
        is_sent = None if way is None or way.shape != (n,) else np.asarray(way) != 0
        data = None if kind == "CAN_RemoteFrame" else _bytes(column(f"{kind}.DataBytes"), n)
        fields = fields_of(kind, number, data, is_sent, n)
        piece, faults = piece_of(kind, key, time, self._channels(index, number("BusChannel"), n), fields)
        for rows, reason in faults:
            self.bad += len(rows)
            for row in rows[:_PROBLEMS].tolist():
                self._lose(seen + row + 1, f"{kind} group {index}: {reason}", 0)
        return piece


def _bytes(values: Any, n: int) -> Ints | None:
    """Data bytes as rows, however the file has them."""
    if values is None:
        return None
    if values.dtype.kind == "S":
        width = max(values.dtype.itemsize, 1)
        return np.frombuffer(values.astype(f"S{width}").tobytes(), np.uint8).reshape(n, width)
    if values.dtype == np.uint8:
        return np.asarray(values.reshape(n, -1))
    if values.dtype.kind == "O":
        width = min(64, max((len(bytes(value)) for value in values), default=0))
        return np.frombuffer(
            b"".join(bytes(v)[:width].ljust(width, b"\0") for v in values), np.uint8
        ).reshape(n, -1)
    raise ValueError(f"data bytes of an unknown kind ({values.dtype})")


# ---- the process ----------------------------------------------------------------------------------------------------


def _limit(memory: int, disk: int) -> None:
    """Bound what this process may take from here on, where the system can (not on Windows)."""
    try:
        import resource
    except ImportError:
        return
    with suppress(OSError, ValueError):
        with open("/proc/self/statm", "rb") as file:
            memory += int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_FSIZE, (disk, disk))
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _words(error: BaseException) -> str:
    text = " ".join(str(error).split())[:200]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def read(path: str, folder: str, send: Any) -> None:
    """Send the frames of the file at `path`; `folder` is for temporary files."""
    from asammdf import MDF

    open_mdf: Any = MDF
    with open(path, "rb") as original:
        file: BinaryIO = original
        head = original.read(64)
        if head[:8].rstrip() == b"UnFinMF" or head[60:64] != bytes(4):  # asammdf finishes it in place
            copy = os.path.join(folder, "unfinished.mf4")
            shutil.copyfile(path, copy)
            file = open(copy, "r+b")  # noqa: SIM115 - the process ends with it
        if not head[8:12].startswith(b"4."):
            version = head[8:12].decode("ascii", "replace").strip("\0 ")
            raise ValueError(f"MDF version {version!r} has no bus logging; only version 4 has")
        if not is_tree(original):
            raise ValueError("its blocks are linked in circles, or one is named twice; it is damaged")
        original.seek(0)
        mdf = open_mdf(file, process_bus_logging=False, temporary_folder=folder)
        Reader(getattr(mdf, "_mdf", mdf), send).run()


def main(arguments: Sequence[str]) -> None:
    """`arguments`: memory in bytes, a folder for temporary files, and the paths of files to read, one after the other."""
    memory, folder, *paths = arguments
    out = os.fdopen(os.dup(1), "wb", buffering=0)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # asammdf prints
    os.dup2(nowhere, 2)
    sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115

    def send(kind: bytes, body: bytes) -> None:
        view = memoryview(HEAD.pack(kind, len(body)) + body)
        while view:
            view = view[out.write(view) or 0 :]

    # asammdf takes polars where it finds it, and a quarter of the time to start with it; reading needs it not.
    sys.modules.setdefault("polars", None)  # type: ignore[arg-type]
    try:
        import_module("asammdf")
    except ImportError as error:
        send(ERROR_SAID, f"missing {error.name}".encode())
        return
    _limit(int(memory), DISK + 4 * max((os.path.getsize(path) for path in paths), default=0))
    for path in paths:
        try:
            read(path, folder, send)
        except MemoryError:
            send(ERROR_SAID, f"reading it needs more than {int(memory) >> 20} MiB of memory".encode())
        except BrokenPipeError:
            return
        except Exception as error:
            send(ERROR_SAID, (str(error) if type(error) is ValueError else _words(error)).encode())
        send(END, b"")
