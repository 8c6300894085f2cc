"""What Vector's tools write as ASC, hexadecimal and with absolute times.

    date Fri Jul 10 08:17:32.249 2015
    base hex  timestamps absolute
    internal events logged
    Begin Triggerblock Fri Jul 10 08:17:32.249 2015
       0.000713 1  44              Rx   d 5 2A 36 6C 2B BA
       0.001000 1  18FEF100x       Tx   r 8
       0.002000 1  ErrorFrame
       0.003000 CANFD   1 Rx        123      …      1 0 9 12 00 11 22 …        0    0     3000        0        0 …
    End TriggerBlock

1. A time is in microseconds, as the tools write it, unless nanoseconds are there: then it has nine digits.
2. The date is local time without its zone, as the tools have it: never one that a change of clocks makes two of.

*Facts*: lines as Vector's tools and python-can write them, but for the event "Start of measurement", which says nothing.
Flags of an FD line: bit 12 FD, 13 bit rate switch, 14 error state.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime

import numpy as np

from aces_bus import FrameTable
from aces_bus.frame_table import FrameFlag, Ints
from aces_bus.recordings.write.text import Column, ColumnText

from .started import DLC_OF_LENGTH, StartedWriter, rows_by_kind

_DAYS = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_HOUR, _MILLISECOND = 3_600_000_000_000, 1_000_000

_WAYS = ColumnText.choices([b" Rx  ", b" Tx  "])
_KINDS = ColumnText.choices([b" d ", b" r "])
_DLC = ColumnText.choices([b"%x" % n for n in range(16)])
_MARKS = ColumnText.choices([b"0 0 ", b"1 0 ", b"0 1 ", b"1 1 "])
_FLAGS = ColumnText.choices([b"    1000", b"    3000", b"    5000", b"    7000"])
_SYMBOLIC = b" " * 35  # the name of the message, which is not known here, and the blanks around it
_END = b"        0" * 5 + b"\n"  # CRC and bit timing


def _stated(start: int) -> datetime:
    return datetime.fromtimestamp(start // 1_000_000_000)


class AscWriter(StartedWriter):
    """Frames as lines of an ASC log."""

    format = "asc"

    def _settled(self, first: int) -> int:
        start = first - first % _MILLISECOND
        while _stated(start).replace(fold=0).timestamp() != _stated(start).replace(fold=1).timestamp():
            start -= _HOUR
        return start

    def _count(self, table: FrameTable, offsets: Ints) -> None:
        self._error_classes(table)

    def close(self) -> None:
        """Write the end."""
        super().close()
        self._file.write(b"End TriggerBlock\n")

    def _begin(self) -> None:
        start = self._start or 0
        at = _stated(start)
        date = (
            f"{_DAYS[at.weekday()]} {_MONTHS[at.month - 1]} {at.day:02} {at:%H:%M:%S}"
            f".{start // _MILLISECOND % 1000:03} {at.year}"
        )
        self._file.write(
            f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n"
            f"Begin Triggerblock {date}\n".encode()
        )

    def _encoded(self, table: FrameTable) -> bytes:
        times = _times(self._offsets)
        table = replace(table, length=self._remote_lengths(table))
        channels = self._numbers.numbers(table)
        return ColumnText.interleaved(
            len(table),
            [
                (rows, kind(table.take(rows), times[rows], channels[rows]))
                for rows, kind in zip(rows_by_kind(table), (_classic, _fd, _errors), strict=True)
                if len(rows)
            ],
        )


def _times(offsets: Ints) -> Column:
    seconds, nanoseconds = np.divmod(offsets, 1_000_000_000)
    fraction = ColumnText.decimal(nanoseconds, 9)
    whole = nanoseconds % 1000 == 0
    if whole.any():
        fraction = fraction.copy()
        fraction[whole, 6:] = 0
    point = np.full((len(offsets), 1), ord("."), np.uint8)
    return np.hstack([ColumnText.decimal(seconds, 10, least=1, fill=b"   "), point, fraction])


def _identifiers(table: FrameTable) -> Column:
    """Return digits without zeros in front, and x behind those of 29 bits; blanks in front up to nine."""
    digits = ColumnText.hexadecimal(table.id, least=1)
    mark = np.where(table.flags & FrameFlag.EXTENDED, ord("x"), 0).astype(np.uint8)
    return np.hstack([digits, mark[:, None]])


def _classic(table: FrameTable, times: Column, channels: Ints) -> bytes:
    remote = table.flags & FrameFlag.REMOTE != 0
    identifiers = _identifiers(table)
    # As wide as python-can's: fifteen, whatever is not there is blank behind.
    missing = np.count_nonzero(identifiers == 0, axis=1) + 6
    return ColumnText.join(
        [
            times,
            b" ",
            ColumnText.decimal(channels, 5, least=1),
            b"  ",
            identifiers,
            ColumnText.choices([b" " * n for n in range(16)])[missing],
            _WAYS[(table.flags & FrameFlag.TX != 0).astype(np.uint8)],
            _KINDS[remote.astype(np.uint8)],
            _DLC[table.length],
            ColumnText.only(ColumnText.data(table, blank=True), ~remote),
            b"\n",
        ],
        len(table),
    )


def _fd(table: FrameTable, times: Column, channels: Ints) -> bytes:
    mark = (table.flags & FrameFlag.BITRATE_SWITCH != 0) + 2 * (table.flags & FrameFlag.ERROR_STATE != 0)
    return ColumnText.join(
        [
            times,
            b" CANFD ",
            ColumnText.decimal(channels, 5, least=1, fill=b"  "),
            _WAYS[(table.flags & FrameFlag.TX != 0).astype(np.uint8)],
            _identifiers(table),
            _SYMBOLIC,
            _MARKS[mark],
            _DLC[DLC_OF_LENGTH[table.length]],
            b" ",
            ColumnText.decimal(table.length, 2, least=1, fill=b" "),
            ColumnText.data(table, blank=True),
            b"        0    0 ",
            _FLAGS[mark],
            _END,
        ],
        len(table),
    )


def _errors(table: FrameTable, times: Column, channels: Ints) -> bytes:
    return ColumnText.join(
        [times, b" ", ColumnText.decimal(channels, 5, least=1), b"  ErrorFrame\n"], len(table)
    )
