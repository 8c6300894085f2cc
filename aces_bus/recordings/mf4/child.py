"""Reads an MF4 file with asammdf in a process of its own, and sends the frames to `reader.py` as tables.

1. Only this process imports asammdf, and it runs nothing else. What a hostile file may cost is this process: its memory, the
   files it writes and, through the one who waits, its time.
2. Everything it says goes through one pipe as messages: a letter, a length, the bytes. Nothing is sent as a pickle.
3. A group that breaks off costs the rest of that group; what was read of it, and the other groups, stand.
4. asammdf finds the groups and their records; what these mean is said by `group.py` alone, which refuses by name what
   it does not read. No conversion of asammdf's is used: it evaluates formulas, and gives numbers for what it cannot.

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

from ...frame_table import Ints
from ..base import PROBLEMS_KEPT
from .blocks import PROGRAM
from .conversions import ChannelConversion
from .frames import FramePiece, group_kind, merge_by_key, no_log, other_words
from .group import GroupReader, Store, frames_of
from .links import is_tree
from .tree import BUS_EVENT, JOINED, VARIABLE_GROUP, Blocks, ChannelGroup, MdfChannel, start_of

#: Memory on top of what the libraries take once they are loaded.
MEMORY = 1 << 30
#: What sorting and finishing may write to disk, beside four times the file's size.
DISK = 1 << 30

TABLE, COUNTS, ERROR_SAID, END = b"T", b"C", b"E", b"Z"
HEAD = struct.Struct("<cI")
SHAPE = struct.Struct("<IB")

_ROWS = 1 << 15
_PIECE_BYTES = 1 << 23


class Reader:
    """One file. `send` gets a letter and the bytes of a message; `blocks` are those of the file."""

    def __init__(self, mdf: Any, blocks: Blocks, send: Any) -> None:
        self.mdf, self.blocks, self.send = mdf, blocks, send
        self.names: dict[str | None, int] = {}
        self.is_ours = bytes(mdf.identification.program_identification).rstrip(b"\0 ") == PROGRAM
        self.start_ns = start_of(int(mdf.header.abs_time), int(mdf.header.time_flags))
        self.lines = self.frames = self.lines_unreadable = 0
        self.others: Counter[str] = Counter()
        self.problems: list[tuple[int, str]] = []

    def run(self) -> None:
        """Send everything."""
        pieces: list[Iterator[FramePiece]] = []
        has_bus = False
        for index, group in enumerate(self.mdf.groups):
            records, flags = int(group.channel_group.cycles_nr), int(group.channel_group.flags)
            names = [channel.name for channel in group.channels]
            kind = group_kind(names)
            is_bus = bool(flags & BUS_EVENT)
            has_bus = has_bus or is_bus or kind is not None
            if not records or flags & VARIABLE_GROUP:
                continue
            if kind is not None:
                reader = self._reader(index, group, kind)
                pieces.append(frames_of(reader, index, records, self._batches(group), self, self._lose))
                continue
            source = group.channel_group.acq_source
            words = other_words(names, is_bus, getattr(source, "bus_type", 0))
            self.others[words] += records
            self.lines += records
        if not has_bus:
            raise ValueError(no_log(len(self.mdf.groups)))
        for piece in merge_by_key(pieces):
            self._tell()
            n, width = len(piece.time), piece.data.shape[1]
            columns = (piece.time, piece.channel, piece.id, piece.flags, piece.length, piece.data)
            self.send(TABLE, SHAPE.pack(n, width) + b"".join(column.tobytes() for column in columns))
        if joined := self.blocks.joined_at():
            self.lines += 1
            self._lose(self.lines, JOINED.format(joined), 1)
        self._tell()

    def _tell(self) -> None:
        counts = {
            "lines": self.lines,
            "frames": self.frames,
            "unreadable": self.lines_unreadable,
            "others": self.others,
            "problems": self.problems,
            "names": list(self.names),
        }
        self.send(COUNTS, json.dumps(counts).encode())

    def _lose(self, number: int, reason: str, count: int) -> None:
        self.lines_unreadable += count
        if len(self.problems) < PROBLEMS_KEPT:
            self.problems.append((number, reason))

    def _reader(self, index: int, group: Any, kind: str) -> GroupReader:
        block = group.channel_group
        data_bytes = int(block.samples_byte_nr)
        channels = [self._channel(channel, group, at) for at, channel in enumerate(group.channels)]
        size = data_bytes + int(block.invalidation_bytes_nr)
        path = getattr(block.acq_source, "path", "")
        what = ChannelGroup(0, 0, int(block.cycles_nr), int(block.flags), data_bytes, size, 0, path, channels)
        reader = GroupReader(kind, what, self.start_ns, self._number, is_ours=self.is_ours)
        places = [at for at, channel in enumerate(channels) if channel.name == f"{kind}.DataBytes"]
        if reader.is_variable:
            reader.store = self._store(group, places[0])
        return reader

    def _channel(self, channel: Any, group: Any, at: int) -> MdfChannel:
        """A channel as the file has it."""
        conversion = ChannelConversion()
        if channel.conversion is not None:
            conversion = self.blocks.conversion(channel.conversion_addr)
        return MdfChannel(
            channel.name,
            channel.channel_type,
            channel.data_type,
            channel.bit_offset,
            channel.byte_offset,
            channel.bit_count,
            channel.sync_type,
            channel.flags,
            channel.pos_invalidation_bit,
            any(not isinstance(part, tuple) for part in group.channel_dependencies[at] or ()),
            conversion,
        )

    def _store(self, group: Any, at: int) -> Store:
        """The bytes of variable length of a channel."""
        size = sum(int(block.original_size) for block in group.get_signal_data_blocks(at))

        def window(start: int, end: int) -> bytes:
            # asammdf gives all up to the end of the value that begins at the second place
            whole: bytes = self.mdf._load_signal_data(
                group=group, index=at, offsets=(start, max(start, end - 68))
            )
            return whole

        return size, window

    def _batches(self, group: Any) -> Iterator[Ints]:
        """The records of a group; of more than are announced, asammdf tells nothing.

        Raises `ValueError` where they cannot be read on.
        """
        block = group.channel_group
        size = int(block.samples_byte_nr + block.invalidation_bytes_nr)
        group.read_split_count = max(1, min(_ROWS, _PIECE_BYTES // max(size, 1)))
        try:
            for fragment in self.mdf._load_data(group):
                if not fragment.is_record:
                    raise ValueError("its records are kept as columns, which is not read")
                if count := fragment.record_count:
                    yield np.frombuffer(fragment.data, np.uint8, count * size).reshape(count, size)
        except (MemoryError, ValueError):
            raise
        except Exception as error:
            raise ValueError(_words(error)) from error

    def _number(self, name: str | None) -> int:
        return self.names.setdefault(name, min(len(self.names), 0xFFFF))


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


def send_frames(path: str, folder: str, send: Any) -> None:
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
        Reader(getattr(mdf, "_mdf", mdf), Blocks(original, os.path.getsize(path)), send).run()


def run_child(arguments: Sequence[str]) -> None:
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
            send_frames(path, folder, send)
        except MemoryError:
            send(ERROR_SAID, f"reading it needs more than {int(memory) >> 20} MiB of memory".encode())
        except BrokenPipeError:
            return
        except Exception as error:
            send(ERROR_SAID, (str(error) if type(error) is ValueError else _words(error)).encode())
        send(END, b"")
