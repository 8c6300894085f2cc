"""Fields of an MDF 4 bus log become frames, whether our own code or asammdf found the records.

1. What is not a frame is reported with its record's number and the reason; the other records are read.
2. Nothing is kept: a piece comes, a piece goes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from aces_bus import FrameTable
from aces_bus.frame_table import NO_TIME, Channels, FrameFlag, Ints
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.merge import KeyedTable

#: The channels that a group of frames has one of.
KINDS = {"CAN_DataFrame": 0, "CAN_RemoteFrame": FrameFlag.REMOTE, "CAN_ErrorFrame": FrameFlag.ERROR}
_OTHERS = {
    "CAN_OverloadFrame": "CAN overload frames",
    "LIN_Frame": "LIN frames",
    "ETH_Frame": "Ethernet frames",
    "FLX_Frame": "FlexRay frames",
    "MOST_Message": "MOST messages",
}
_BUSES = {3: "LIN", 4: "MOST", 5: "FlexRay", 6: "K-line", 7: "Ethernet", 8: "USB"}

_LENGTHS = np.array(FD_LENGTHS, np.uint8)
_IS_FD_LENGTH = np.zeros(256, bool)
_IS_FD_LENGTH[list(FD_LENGTHS)] = True
#: By length: 0xFF for bytes that count.
_MASKS = (np.arange(64) < np.arange(65)[:, None]) * np.uint8(0xFF)
_MASKS_8 = np.ascontiguousarray(_MASKS[:9, :8]).view(np.uint64)[:, 0]

_NO_MORE = 1 << 63

Fault = tuple[Ints, str]


class FrameNumbers(NamedTuple):
    """The integers of a channel in n records, and the records (n truths) that have none, with the reason."""

    values: Ints
    wrong: tuple[Fault, ...] = ()


class FrameColumns(NamedTuple):
    """Columns of n records: uint32 identifiers, lengths in a type of their own, 0 or 1 for the rest, None if not there.

    `stored` is how many data bytes a record has where each has its own number of them, -1 where they are not there.
    `wrong` are records (n truths) of which a field is not known, and why.
    """

    id: Ints
    length: Ints
    is_wide: Ints
    is_fd: Ints | None
    bitrate_switch: Ints | None
    error_state: Ints | None
    is_sent: Ints | None
    data: Ints | None
    stored: Ints | None
    wrong: list[Fault]


def group_kind(names: Sequence[str]) -> str | None:
    """Return which frames a group of these channels holds; None for anything else."""
    return next((name for name in KINDS if name in names), None)


def other_words(names: Sequence[str], is_bus: bool, bus: int) -> str:
    """Return what a group holds that has no frames."""
    words = next((_OTHERS[name] for name in names if name in _OTHERS), None)
    if words is None:
        words = f"{_BUSES[bus]} events" if is_bus and bus in _BUSES else "samples of other groups"
    return words


def broken_off(kind: str, group: int, announced: int | None, there: int, reason: str = "") -> str:
    """Return what to say of a group that has not as many records as it should."""
    if announced is not None and there >= announced:
        return f"{kind} group {group}: {reason}"
    text = f"{kind} group {group} breaks off: "
    text += (
        f"{announced} records are announced, {there} are there" if announced else f"{there} records are there"
    )
    return f"{text} ({reason})" if reason else text


def no_log(groups: int) -> str:
    """Return what to say of a file without bus logging."""
    return f"it holds no bus logging, but measured signals in {groups} groups; it is not a CAN log"


def frame_columns(
    kind: str,
    number: Callable[[str], FrameNumbers | None],
    data: Ints | None,
    stored: Ints | None,
    invalid_data: Ints | None,
    n: int,
) -> FrameColumns:
    """Return the fields of n records of a kind. `number` gives the integers of a field by its name, None when there is none.

    A field that a record does not need is not looked at. `invalid_data` are records (n truths) without data bytes.
    """
    wrong: list[Fault] = []

    def taken(part: str) -> Ints | None:
        found = number(part)
        if found is None:
            return None
        wrong.extend(found.wrong)
        return found.values

    raw = taken("ID")
    if raw is None:
        raw = np.zeros(n, np.uint32)
    elif raw.dtype.kind != "u" or raw.dtype.itemsize > 4:
        wrong.append(((raw < 0) | (raw >= 1 << 32), "an identifier of more than 32 bits"))
    raw = raw.astype(np.uint32, copy=False)
    wide = taken("IDE")
    is_wide = raw >= 1 << 31 if wide is None else wide != 0
    is_fd = _truth(taken("EDL"))
    if is_fd is not None and not is_fd.any():
        is_fd = None
    parts = ("DLC", "DataLength") if kind == "CAN_RemoteFrame" else ("DataLength", "DLC")
    length = taken(parts[0])
    if length is None and (length := taken(parts[1])) is not None and parts[1] == "DLC":
        code = length
        wrong.append(((code < 0) | (code > 15), "a DLC above 15"))
        length = np.minimum(code, 8)
        if is_fd is not None:
            length = np.where(is_fd, _LENGTHS[np.clip(code, 0, 15)], length)
    if length is None or (data is None and kind == "CAN_ErrorFrame"):
        length = np.zeros(n, np.uint8)
    if length.dtype != np.uint8:
        length = np.minimum(length, 255)
        length = np.where(length < 0, 255, length).astype(np.uint8)
    flags: dict[str, Ints | None] = {}
    for part in ("BRS", "ESI"):
        if is_fd is not None and (found := number(part)) is not None:
            wrong += [(is_fd & rows, reason) for rows, reason in found.wrong]
            flags[part] = found.values != 0
    if invalid_data is not None:
        wrong.append((invalid_data & (length > 0), f"{kind}.DataBytes is marked invalid"))
    return FrameColumns(
        raw & np.uint32(0x1FFF_FFFF),
        length,
        is_wide,
        is_fd,
        flags.get("BRS"),
        flags.get("ESI"),
        _truth(taken("Dir")),
        data,
        stored,
        wrong,
    )


def _truth(values: Ints | None) -> Ints | None:
    return None if values is None else values != 0


def piece_of(
    kind: str, key: Ints, time: Ints, channel: Ints, fields: FrameColumns, channels: Channels
) -> tuple[KeyedTable, list[Fault]]:
    """Return the frames among records, which `key` sorts, and what is wrong with the others: their rows, each but
    once, and why.
    """
    identifier, length, is_wide, is_fd = fields.id, fields.length, fields.is_wide, fields.is_fd
    n = len(identifier)
    is_remote, is_error = kind == "CAN_RemoteFrame", kind == "CAN_ErrorFrame"
    room = 64 if is_remote else 0 if fields.data is None else min(64, fields.data.shape[1])

    faults: list[Fault] = []
    good: Ints | None = None
    wrongs = list(fields.wrong)
    if n and int(time.min()) == NO_TIME:
        wrongs.append((time == NO_TIME, "a time that is not an instant"))
    if fields.stored is not None:
        wrongs.append((fields.stored < 0, "data bytes that are not in the file"))
        wrongs.append((length != fields.stored, "a length that is not that of its data bytes"))
    if n and int(length.max()) > min(room, 8):
        wrongs.append((length > room, "more data bytes than the record holds"))
        is_long = length > 8
        wrongs.append(
            (is_long if is_fd is None else is_long & ~is_fd, "a classic frame of more than 8 bytes")
        )
    if is_fd is not None:
        wrongs.append((is_fd & ~_IS_FD_LENGTH[length], "a length that CAN FD does not have"))
    if not is_error:
        wrongs.append(((identifier > 0x7FF) & ~is_wide, "an 11-bit identifier above 0x7FF"))
    if is_fd is not None and is_remote:
        wrongs.append((is_fd, "a remote frame in CAN FD"))
    for wrong, reason in wrongs:
        if wrong.any():
            faults.append((np.flatnonzero(wrong if good is None else wrong & good), reason))
            good = ~wrong if good is None else good & ~wrong

    flags = np.full(n, KINDS[kind], np.uint8)
    if not is_error:
        flags |= is_wide * np.uint8(FrameFlag.EXTENDED)
    if is_fd is not None:
        flags |= is_fd * np.uint8(FrameFlag.FD)
        for bits, flag in (
            (fields.bitrate_switch, FrameFlag.BITRATE_SWITCH),
            (fields.error_state, FrameFlag.ERROR_STATE),
        ):
            if bits is not None:
                flags |= (is_fd & bits) * np.uint8(flag)
    if fields.is_sent is not None:
        flags |= np.where(fields.is_sent, np.uint8(FrameFlag.TX), np.uint8(FrameFlag.RX))

    carried = length if good is None else np.where(good, length, np.uint8(0))
    data = _data(fields.data, carried)
    table = FrameTable(time, channel, identifier, flags, length, data, channels)
    piece = (key, table) if good is None else (key[good], table.take(good))
    return piece, [fault for fault in faults if len(fault[0])]


def _data(data: Ints | None, length: Ints) -> Ints:
    """Return rows of 8 or 64 bytes, zero behind the length."""
    n = len(length)
    if data is None:
        return np.zeros((n, 8), np.uint8)
    width = 64 if int(length.max(initial=0)) > 8 else 8
    have = data.shape[1]
    if have >= width:
        item = np.dtype(
            "<u8" if width == 8 else (np.void, width)
        )  # whole rows are moved faster than their bytes
        rows: Ints = data[:, :width].view(item)[:, 0].copy().view(np.uint8).reshape(n, width)
    else:
        rows = np.zeros((n, width), np.uint8)
        rows[:, :have] = data
    if width == 8:
        words = rows.view(np.uint64)[:, 0]
        words &= _MASKS_8[length]
    else:
        rows &= _MASKS[length]
    return rows


def instants(since: Ints, start_ns: int) -> Ints:
    """Return int64 nanoseconds since 1970, of integer nanoseconds since `start_ns`; `NO_TIME` where they do not fit."""
    if not len(since) or (int(since.min()) + start_ns > -_NO_MORE and int(since.max()) + start_ns < _NO_MORE):
        return since.astype(np.int64) + start_ns
    wrong = (since <= -_NO_MORE - start_ns) | (since >= _NO_MORE - start_ns)
    return np.where(wrong, NO_TIME, np.where(wrong, 0, since).astype(np.int64) + start_ns)


def instants_of_seconds(since: Ints, start_ns: int) -> Ints:
    """Return the same of seconds; `NO_TIME` too for what is not a number, and for more than a hundred years."""
    wrong = ~(np.abs(since) < 4e9)
    if not wrong.any():
        return instants(np.rint(since * 1e9).astype(np.int64), start_ns)
    return np.where(wrong, NO_TIME, instants_of_seconds(np.where(wrong, 0, since), start_ns))


def channels_of(numbers: Ints, number_of: Callable[[str], int]) -> Ints:
    """Return the numbers of channels, whose names are the numbers in the file."""
    n = len(numbers)
    low, high = (int(numbers.min()), int(numbers.max())) if n else (0, 0)
    if low == high:
        return np.full(n, number_of(str(low)), np.uint16)
    some, places = np.unique(numbers, return_inverse=True)
    return np.array([number_of(str(number)) for number in some.tolist()], np.uint16)[places]
