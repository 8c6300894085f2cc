"""A group of frames in an MDF 4 file: where the fields of its records are, and the frames that the records are.

1. This is the only place that decides how a channel is read; the records come from here or from asammdf, as bytes.
2. A channel that a frame needs, and that cannot be read as the file means it, refuses the group: each record of it is
   unreadable, with the channel's name and the reason. Nothing is taken for a default that is there and not understood.
3. A record with a field that has no value (marked invalid, converted to no whole number or to an unknown text) is
   unreadable, and the others are read.

Taken are CAN_DataFrame, CAN_RemoteFrame and CAN_ErrorFrame with their ID, IDE, DLC, DataLength, EDL, BRS, ESI, BusChannel,
Dir and DataBytes, and the time. For each of them counts: where it is in the record or that it is virtual (no bits; the
number of the record), its data type and byte order, its conversion, and its invalidation bit. The group's own channel
counts as marked invalid with all of its record. Times are seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from aces_bus.frame_table import Channels, Ints
from aces_bus.recordings.base import PROBLEMS_KEPT, CanRecording
from aces_bus.recordings.merge import KeyedTable

from .blocks import ORDER
from .conversions import IDENTITY, LINEAR, conversion_meaning, convert_values
from .data import values_at
from .fields import BitField, Refused, bytes_at, field_of, numbers, refuse
from .frames import (
    Fault,
    FrameNumbers,
    broken_off,
    channels_of,
    frame_columns,
    instants,
    instants_of_seconds,
    piece_of,
)
from .tree import (
    ALL_INVALID,
    HAS_INVALID,
    MASTER,
    REMOTE_MASTER,
    SIZED,
    TIMES,
    VALUE,
    VARIABLE,
    VIRTUAL,
    VIRTUAL_MASTER,
    ChannelGroup,
    MdfChannel,
)

_PARTS = ("ID", "IDE", "DLC", "DataLength", "EDL", "BRS", "ESI", "BusChannel", "Dir")
_BYTES = 10
#: Fields of so many bits are converted by a table of all their values.
_TABLED = 10


class _Number:
    """A channel as the numbers of its records. Raises `Refused` where it cannot be read so."""

    def __init__(self, channel: MdfChannel, group: ChannelGroup, part: str = "") -> None:
        self._name, self._part = channel.name, part
        self.conversion = channel.conversion
        if channel.conversion.fault:
            raise Refused(f"{channel.name} has {channel.conversion.fault}, which is not read")
        self.field = None
        if channel.kind not in (VIRTUAL, VIRTUAL_MASTER):
            self.field = field_of(channel, group.data_bytes)
        self._mark = _mark_of(channel, group)
        self._is_plain = self.conversion.kind == IDENTITY
        is_text = self.field is not None and self.field.is_bytes
        refuse(
            (
                channel.kind == VIRTUAL and self._is_plain,
                "is virtual, and has no conversion with its value",
            ),
            (
                is_text and (part != "Dir" or channel.data_type == _BYTES),
                f"has data type {channel.data_type}, and is not a number",
            ),
            (is_text and not self._is_plain, "is a text with a conversion, which is not read"),
            name=channel.name,
        )
        if self.field is not None and self.field.is_real:
            self._is_plain = False
        self._table: FrameNumbers | None = None
        if self._is_plain:
            return
        if self.field is None and self.conversion.kind == LINEAR and not self.conversion.parameters[1]:
            self._table = self._whole(np.zeros(1, np.int64))
        elif self.field is not None and self.field.bits <= _TABLED and not self.field.is_signed:
            self._table = self._whole(np.arange(1 << self.field.bits))

    def raw(self, rows: Ints, first: int) -> Ints:
        """Return the numbers in the records, of which the first is the group's `first`."""
        return np.arange(first, first + len(rows)) if self.field is None else numbers(rows, self.field)

    def reals(self, rows: Ints, first: int) -> Ints:
        """Return the numbers converted, as float64, NaN where there is none."""
        return convert_values(self.conversion, self.raw(rows, first), self._part)

    def invalid(self, rows: Ints) -> Ints | None:
        """Return which records have no value; None when all have."""
        return _marked(rows, self._mark)

    def wholes(self, rows: Ints, first: int) -> FrameNumbers:
        """Return the numbers as integers."""
        found = self._wholes(rows, first)
        if (invalid := self.invalid(rows)) is None:
            return found
        return FrameNumbers(found.values, ((invalid, f"{self._name} is marked invalid"), *found.wrong))

    def _wholes(self, rows: Ints, first: int) -> FrameNumbers:
        if self.field is not None and self.field.is_bytes:
            return self._words(bytes_at(rows, self.field))
        if self._table is not None:
            table, wrong = self._table
            if self.field is None:
                return FrameNumbers(
                    np.broadcast_to(table, len(rows)),
                    tuple((np.full(len(rows), bool(w[0])), r) for w, r in wrong),
                )
            raw = self.raw(rows, first)
            return FrameNumbers(table[raw], tuple((where[raw], reason) for where, reason in wrong))
        raw = self.raw(rows, first)
        return FrameNumbers(raw) if self._is_plain else self._whole(raw)

    def _whole(self, raw: Ints) -> FrameNumbers:
        values = convert_values(self.conversion, raw, self._part)
        is_whole = (np.abs(values) < 2.0**53) & (values == np.rint(values))
        if is_whole.all():
            return FrameNumbers(values.astype(np.int64))
        values = np.where(is_whole, values, 0.0).astype(np.int64)
        return FrameNumbers(values, ((~is_whole, f"{self._name} has no value that is understood"),))

    def _words(self, rows: Ints) -> FrameNumbers:
        words, places = np.unique(
            np.ascontiguousarray(rows).view(f"S{rows.shape[1]}")[:, 0], return_inverse=True
        )
        means = np.array(
            [
                conversion_meaning(word.split(b"\0")[0].decode("latin-1"), self._part)
                for word in words.tolist()
            ]
        )
        wrong = np.isnan(means)
        values = np.where(wrong, 0, means).astype(np.int64)[places]
        return FrameNumbers(
            values, ((wrong[places], f"{self._name} has no value that is understood"),) * bool(wrong.any())
        )


def _mark_of(channel: MdfChannel, group: ChannelGroup) -> int | None:
    """Return the bit of a record that says that a channel has no value; -1 when it never has, None when it always has."""
    if channel.flags & ALL_INVALID:
        return -1
    if not channel.flags & HAS_INVALID:
        return None
    if channel.invalid_bit >= 8 * (group.size - group.data_bytes):
        raise Refused(f"{channel.name} has an invalidation bit that its records do not have")
    return 8 * group.data_bytes + channel.invalid_bit


def _marked(rows: Ints, mark: int | None) -> Ints | None:
    if mark is None:
        return None
    if mark < 0:
        return np.ones(len(rows), bool)
    return (rows[:, mark >> 3] >> np.uint8(mark & 7) & np.uint8(1)).astype(bool)


class _Layout:
    """The channels of a group of frames. Raises `Refused` when they cannot be read."""

    def __init__(self, kind: str, group: ChannelGroup, *, is_ours: bool) -> None:
        if group.flags & REMOTE_MASTER:
            raise Refused("its times are in another group, which is not read")
        named: dict[str, MdfChannel] = {}
        for channel in group.channels:
            if channel.name in named and (channel.name.startswith(kind) or channel.name == ORDER):
                raise Refused(f"two of its channels are called {channel.name}")
            named[channel.name] = channel
        times = [channel for channel in group.channels if channel.kind in (MASTER, VIRTUAL_MASTER)]
        refuse(
            (len(times) != 1, f"it has {len(times) or 'no'} time channels, and one is needed"),
            (any(time.sync != TIMES for time in times), f"{times[0].name if times else ''} is not a time"),
        )
        self.time = _Number(times[0], group)
        if self.time.field is not None and self.time.field.is_bytes:
            raise Refused(f"{times[0].name} is not a number")
        self.numbers: dict[str, _Number] = {}
        for part in _PARTS:
            if (found := named.get(f"{kind}.{part}")) is not None:
                self.numbers[part] = _Number(found, group, part)
        code = self.numbers.get("DLC")
        needs_code = kind == "CAN_DataFrame" and "DataLength" not in self.numbers
        refuse(
            ("ID" not in self.numbers and kind != "CAN_ErrorFrame", "it has no identifiers"),
            (needs_code and code is None, "it has no lengths"),
            (  # whether it then is a length or still a code, it does not say
                needs_code and code is not None and code.conversion.kind != IDENTITY,
                f"{kind}.DLC has a conversion, and there is no DataLength",
            ),
        )
        self.order = _Number(named[ORDER], group) if is_ours and ORDER in named else None
        self.whole = _mark_of(named[kind], group)
        self.data: BitField | None = None
        self.data_mark: int | None = None
        #: Of the field of data bytes: it has the offset of bytes of variable length.
        self.is_variable = False
        data = named.get(f"{kind}.DataBytes")
        if data is not None and kind != "CAN_RemoteFrame":
            refuse(
                (
                    data.kind not in (VALUE, SIZED, VARIABLE) or data.data_type != _BYTES,
                    f"has data type {data.data_type}, and is not bytes",
                ),
                (
                    bool(data.conversion.fault) or data.conversion.kind != IDENTITY,
                    "has a conversion, and is not bytes",
                ),
                name=data.name,
            )
            self.data, self.data_mark = field_of(data, group.data_bytes), _mark_of(data, group)
            self.is_variable = data.kind == VARIABLE


#: So many bytes of variable length, and what gives those from one place to another.
Store = tuple[int, Callable[[int, int], bytes]]


class GroupReader:
    """Frames of the records of one group, piece by piece.

    `channels` are those of the capture; their names are numbers, or in files of our own the group's `path`.
    """

    def __init__(
        self,
        kind: str,
        group: ChannelGroup,
        start_ns: int,
        channels: Channels,
        *,
        is_ours: bool,
    ) -> None:
        self.kind, self.size = kind, group.size
        #: What the data bytes of variable length are taken from, when they are.
        self.store: Store | None = None
        self._start_ns, self._channels = start_ns, channels
        self._is_ours, self._path = is_ours, group.path
        self._last: int | None = None
        self._layout: _Layout | None = None
        self._refusal = ""
        try:
            self._layout = _Layout(kind, group, is_ours=is_ours)
        except Refused as error:
            self._refusal = str(error)

    @property
    def is_variable(self) -> bool:
        """True if the data bytes of the frames are taken from `store`."""
        return self._layout is not None and self._layout.is_variable

    def piece(self, rows: Ints, first: int) -> tuple[KeyedTable | None, list[Fault]]:
        """Return the frames in records, and the row numbers of the others, with what is wrong.

        The first record is number `first` in the group, from 0 on.
        """
        n, layout, kind = len(rows), self._layout, self.kind
        if layout is None:
            return None, [(np.arange(n), self._refusal)]
        time = self._time(layout.time, rows, first)
        key = time if layout.order is None else layout.order.wholes(rows, first).values.astype(np.int64)
        key = np.maximum.accumulate(key)
        if self._last is not None and key[0] < self._last:
            key = np.maximum(key, self._last)
        self._last = int(key[-1])

        def number(part: str) -> FrameNumbers | None:
            found = layout.numbers.get(part)
            return None if found is None else found.wholes(rows, first)

        data, stored = None, None
        if layout.data is not None:
            data = bytes_at(rows, layout.data)
            if layout.is_variable:
                if self.store is None:
                    raise ValueError("its data bytes are missing")
                size, window = self.store
                stored, data = values_at(window, size, numbers(rows, layout.data))
        fields = frame_columns(kind, number, data, stored, _marked(rows, layout.data_mark), n)
        if (invalid := _marked(rows, layout.whole)) is not None:
            fields.wrong.append((invalid, f"{kind} is marked invalid"))
        if (invalid := layout.time.invalid(rows)) is not None:
            fields.wrong.append((invalid, "a time that is marked invalid"))
        channels = None if self._is_ours else number("BusChannel")
        if channels is None:
            channel = np.full(
                n, self._channels.number(self._path or None if self._is_ours else None), np.uint16
            )
        else:
            fields.wrong.extend(channels.wrong)
            channel = channels_of(channels.values, self._channels.number)
        return piece_of(kind, key, time, channel, fields, self._channels)

    def _time(self, time: _Number, rows: Ints, first: int) -> Ints:
        """Return int64 nanoseconds since 1970."""
        conversion, field = time.conversion, time.field
        is_exact = conversion.kind == LINEAR and conversion.parameters[:2].tolist() == [0.0, 1e-9]
        if is_exact and (field is None or not field.is_real):
            return instants(time.raw(rows, first), self._start_ns)
        return instants_of_seconds(time.reals(rows, first), self._start_ns)


#: Count so many records as unreadable; the number of the first in its group, and why, may be kept.
Lose = Callable[[int, str, int], None]


def frames_of(
    reader: GroupReader,
    place: int,
    announced: int | None,
    batches: Iterator[Ints],
    tally: CanRecording,
    lose: Lose,
) -> Iterator[KeyedTable]:
    """Yield the frames of the group that has number `place` in the file; where it breaks off, the rest is one
    unreadable record.

    `batches` are its records; it raises `ValueError` where they cannot be read on. `announced` is None where the file does
    not say how many there should be.
    """
    done = 0
    reason = ""
    try:
        for rows in batches:
            piece, faults = reader.piece(rows, done)
            for wrong, fault in faults:
                for row in wrong[:PROBLEMS_KEPT].tolist():
                    lose(done + row + 1, f"{reader.kind} group {place}: {fault}", 0)
                tally.lines_unreadable += len(wrong)
            done += len(rows)
            tally.lines += len(rows)
            if piece is not None and len(piece[1]):
                tally.frames += len(piece[1])
                yield piece
    except MemoryError:
        reason = "more memory would be needed than is allowed"
    except ValueError as error:
        reason = str(error)
    if reason or (announced is not None and done < announced):
        tally.lines += 1
        lose(done + 1, broken_off(reader.kind, place, announced, done, reason), 1)
