"""Lays an unusual MF4 file out plainly with asammdf, in a process of its own, for `arrays.py` to read.

1. Only this process imports asammdf, and it runs nothing else. What a hostile file may cost is this process: its memory, the
   files it writes and, through the one who waits, its time.
2. asammdf finds the groups and their records, and these are copied, as bytes, one group after the other into a file. What
   they mean is said elsewhere: no conversion of asammdf's is used, as it evaluates formulas, and gives numbers for what it
   cannot.
3. A group that breaks off has its fault beside the records that were there; the other groups go on.
4. The answer is a line of JSON for each file: where the records are and what the file says of them, or what is wrong.
5. Blocks that hang together as a tree are needed first: asammdf never comes back from blocks that are linked in circles, and
   a list that names one packed block a million times is a bomb.
"""

from __future__ import annotations

import json
import os
import shutil
import struct
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from types import SimpleNamespace
from typing import Any, BinaryIO

from aces_bus.protocol.record import PlainValue

from .conversions import ChannelConversion
from .frames import group_kind
from .tree import (
    BLOCK_HEAD,
    HEADER_AT,
    VARIABLE,
    VARIABLE_GROUP,
    Blocks,
    ChannelGroup,
    DataGroup,
    MdfChannel,
    MdfTree,
    Segment,
    start_of,
)

#: Memory on top of what the libraries take once they are loaded.
MEMORY = 1 << 30
#: What copying, sorting and finishing may write to disk, beside four times the file's size.
DISK = 1 << 30

_ROWS = 1 << 15
_PIECE_BYTES = 1 << 23


class _Copy:
    """One file, and the file that its records are copied to."""

    def __init__(self, mdf: Any, out: BinaryIO) -> None:
        self.mdf, self.out = mdf, out

    def described(self) -> dict[str, PlainValue]:
        """Return what `described_tree` takes."""
        header, identification = self.mdf.header, self.mdf.identification
        return {
            "program": bytes(identification.program_identification).hex(),
            "start": [int(header.abs_time), int(header.time_flags)],
            "groups": [self._group(group) for group in self.mdf.groups],
        }

    def _group(self, group: Any) -> dict[str, PlainValue]:
        block = group.channel_group
        source = block.acq_source
        records, flags = int(block.cycles_nr), int(block.flags)
        if flags & VARIABLE_GROUP:  # its records are parts of others
            records = flags = 0
        kind = group_kind([channel.name for channel in group.channels])
        size = int(block.samples_byte_nr + block.invalidation_bytes_nr)
        found: dict[str, PlainValue] = {
            "group": [records, flags, int(block.samples_byte_nr), size if kind else 0],
            "bus": [getattr(source, "bus_type", 0), getattr(source, "path", "")],
            "channels": [self._channel(group, at, kind) for at in range(len(group.channels))],
        }
        if kind is not None and records:
            found["records"] = self._copied(lambda: self._records(group, size))
        return found

    def _channel(self, group: Any, at: int, kind: str | None) -> dict[str, PlainValue]:
        channel = group.channels[at]
        is_array = any(not isinstance(part, tuple) for part in group.channel_dependencies[at] or ())
        found: dict[str, PlainValue] = {
            "channel": [
                *(channel.name, channel.channel_type, channel.data_type, channel.bit_offset),
                *(channel.byte_offset, channel.bit_count, channel.sync_type, channel.flags),
                *(channel.pos_invalidation_bit, is_array),
            ],
            "conversion": 0 if channel.conversion is None else channel.conversion_addr,
        }
        if channel.channel_type == VARIABLE and channel.name == f"{kind}.DataBytes":
            found["data"] = self._copied(lambda: self._signal_data(group, at))
        return found

    def _copied(self, copy: Any) -> list[Any]:
        """Return where the bytes begin that `copy` writes, how many they are, and why there are no more."""
        start, fault = self.out.tell(), ""
        try:
            copy()
        except MemoryError:
            fault = "more memory would be needed than is allowed"
        except Exception as error:
            fault = str(error) if type(error) is ValueError else _words(error)
        return [start, self.out.tell() - start, fault]

    def _records(self, group: Any, size: int) -> None:
        """Write the records of a group; asammdf does not report more records than are announced."""
        group.read_split_count = max(1, min(_ROWS, _PIECE_BYTES // max(size, 1)))
        for fragment in self.mdf._load_data(group):
            if not fragment.is_record:
                raise ValueError("its records are kept as columns, which is not read")
            self.out.write(memoryview(fragment.data)[: fragment.record_count * size])

    def _signal_data(self, group: Any, at: int) -> None:
        """Write a channel's bytes of variable length, block by block."""
        for block in group.get_signal_data_blocks(at):
            single = SimpleNamespace(
                signal_data=[True], get_signal_data_blocks=lambda _, block=block: [block]
            )
            self.out.write(self.mdf._load_signal_data(group=single, index=0))


def described_tree(said: dict[str, Any], blocks: Blocks) -> MdfTree:
    """Return the tree of a file of which this was said; its segments are in the file of records. `blocks` are those of
    the file.
    """
    streams: list[DataGroup] = []
    for each in said["groups"]:
        channels: list[MdfChannel] = []
        for channel in each["channels"]:
            at, size, fault = channel.get("data", (0, 0, ""))
            at_conversion = channel["conversion"]
            conversion = blocks.conversion(at_conversion) if at_conversion else ChannelConversion()
            segments = (Segment(at, size, size),) if size else ()
            channels.append(MdfChannel._make((*channel["channel"], conversion, 0, segments, fault)))
        group = ChannelGroup._make((0, 0, *each["group"], *each["bus"], channels))
        at, size, fault = each.get("records", (0, 0, ""))
        streams.append(DataGroup(0, [group], [Segment(at, size, size)], fault))
    program = bytes.fromhex(said["program"])
    return MdfTree(program, 0, start_of(*said["start"]), True, streams, blocks.joined_at())


# ---- whether blocks hang together as a tree ------------------------------------------------------------------------

#: Which links of a block lead on to what has one place only: by number, None for all.
_LINKS: dict[bytes, tuple[int, ...] | None] = {
    b"##HD": (0, 1, 2, 3, 4),
    b"##FH": (0,),
    b"##AT": (0,),
    b"##EV": (0,),
    b"##CH": (0, 1),
    b"##DG": (0, 1, 2),
    b"##CG": (0, 1),
    b"##CN": (0, 1, 5),
    b"##HL": None,
    b"##DL": None,
    b"##LD": None,
    b"##DT": (),
    b"##DZ": (),
    b"##SD": (),
    b"##DV": (),
    b"##DI": (),
}
#: A channel's data may be a channel group's or an attachment, which has its own place.
_SIGNAL_DATA = (b"##HL", b"##DL", b"##LD", b"##SD", b"##DZ")


def is_tree(file: BinaryIO) -> bool:
    """Return whether each group, channel and data block that can be reached from the header is reached once."""
    seen: set[int] = set()
    ahead: list[tuple[int, bool]] = [(HEADER_AT, False)]
    while ahead:
        at, is_signal = ahead.pop()
        file.seek(at)
        head = file.read(BLOCK_HEAD.size)
        if len(head) < BLOCK_HEAD.size:
            continue
        name, _, size, count = BLOCK_HEAD.unpack(head)
        wanted = _LINKS.get(name, ())
        if name not in _LINKS or (is_signal and name not in _SIGNAL_DATA):
            continue
        if at in seen:
            return False
        seen.add(at)
        count = min(count, size // 8)
        if wanted is not None:
            count = min(count, max(wanted, default=-1) + 1)
        raw = file.read(8 * count)
        links = struct.unpack(f"<{len(raw) // 8}Q", raw[: len(raw) // 8 * 8])
        for number in range(len(links)) if wanted is None else wanted:
            if number < len(links) and links[number] and links[number] < 1 << 63:
                ahead.append((links[number], name == b"##CN" and number == 5))
    return True


# ---- the process ----------------------------------------------------------------------------------------------------


def _limit(memory: int, disk: int) -> None:
    """Bound the memory of this process from here on, where the system can (not on Windows)."""
    try:
        import resource
    except ImportError:
        return
    with suppress(OSError, ValueError), open("/proc/self/statm", "rb") as file:
        memory += int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    for limit, most in ((resource.RLIMIT_FSIZE, disk), (resource.RLIMIT_CORE, 0)):
        with suppress(OSError, ValueError):
            resource.setrlimit(limit, (most, most))


def _words(error: BaseException) -> str:
    text = " ".join(str(error).split())[:200]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def copy_records(path: str, folder: str, records: str) -> dict[str, PlainValue]:
    """Return what the file at `path` holds, its records copied to `records`; `folder` is for temporary files."""
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
        with open(records, "wb") as out:
            return _Copy(getattr(mdf, "_mdf", mdf), out).described()


def run_child(arguments: Sequence[str]) -> None:
    """Run a reader; `arguments`: memory in bytes, a folder for temporary files, and the paths of files to read."""
    memory, folder, *paths = arguments
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # asammdf prints
    os.dup2(nowhere, 2)
    sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115

    def answer(said: dict[str, Any]) -> None:
        print(json.dumps(said), file=out, flush=True)

    # asammdf takes polars where it finds it, and a quarter of the time to start with it; reading needs it not.
    sys.modules.setdefault("polars", None)  # type: ignore[arg-type]
    try:
        import_module("asammdf")
    except ImportError as error:
        answer({"missing": error.name})
        return
    _limit(int(memory), DISK + 4 * max((os.path.getsize(path) for path in paths), default=0))
    for number, path in enumerate(paths):
        records = os.path.join(folder, f"records {number}")
        try:
            answer({"path": records, **copy_records(path, folder, records)})
        except MemoryError:
            answer({"error": f"reading it needs more than {int(memory) >> 20} MiB of memory"})
        except Exception as error:
            answer({"error": str(error) if type(error) is ValueError else _words(error)})
