"""The tables of one input as Parquet files of this machine: one a message and day.

1. Rows go to the day (UTC) of their time; rows without one to the day that readers of such datasets take for null. A
   recording whose times do not count from 1970 has no days: its datasets are `Encoder.relative`, with durations for times.
2. Memory is bounded: so many days are open at once, and a day that comes again gets another file.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from aces_bus.errors import CaptureError
from aces_bus.export import open_export
from aces_bus.export.base import Export
from aces_bus.frame_table import NO_TIME
from aces_bus.protocol import Variant
from aces_bus.protocol.columns.arrow import is_absolute
from aces_bus.protocol.columns.table import MessageTable

from .recipe import Recipe

DAY_NS = 86_400 * 10**9
#: Days of an input that are written at once, and that it may have: more are a clock that is wrong.
OPEN_DAYS, MOST_DAYS = 3, 1000
#: How Hive, and who reads its partitions, writes null.
NO_DAY = "__HIVE_DEFAULT_PARTITION__"

#: A day since 1970; None without a time. "relative": the times do not count from 1970.
_Day = int | None | str


class LocalPart(NamedTuple):
    """A file that was written: where it is, and the folder that it belongs into, below the dataset; which one of the day."""

    file: str
    folder: str
    number: int


class DayParts:
    """Tables on their way into parts in `folder`, all of one input; `source` is its name in the column of that name."""

    def __init__(
        self,
        folder: str,
        recipe: Recipe,
        variants: Sequence[Variant],
        source: str,
        *,
        absolute: bool | None = None,
    ) -> None:
        self._folder, self._recipe, self._variants, self._source = folder, recipe, variants, source
        #: Whether times count from 1970; None while no time is known.
        self.absolute = absolute
        self._open: OrderedDict[_Day, tuple[Export, str]] = OrderedDict()
        #: How many files each day has so far.
        self._files: dict[_Day, int] = {}
        self.parts: list[LocalPart] = []
        self.rows: dict[str, int] = {}
        self.notes: dict[str, None] = {}
        self.first: int | None = None
        self.last: int | None = None

    def write(self, tables: Sequence[MessageTable]) -> None:
        """Take tables. Raises `CaptureError` for times on more than `MOST_DAYS` days."""
        tables = [table for table in tables if len(table)]
        for table in tables:
            if self.absolute is None:
                self.absolute = is_absolute(table.time)
            self._see(table)
        if not tables:
            return
        if not self.absolute:
            self._export("relative").write(tables, source=self._source, columns=self._recipe.columns)
            return
        by_day: dict[_Day, list[MessageTable]] = {}
        for table in tables:
            days = np.where(table.time == NO_TIME, np.iinfo(np.int64).min, table.time // DAY_NS)
            low = int(days.min())
            if low == int(days.max()):
                by_day.setdefault(_day(low), []).append(table)
                continue
            for day in np.unique(days).tolist():
                by_day.setdefault(_day(day), []).append(table.take(np.flatnonzero(days == day)))
        for day, some in sorted(by_day.items(), key=lambda item: str(item[0])):
            self._export(day).write(some, source=self._source, columns=self._recipe.columns)

    def _see(self, table: MessageTable) -> None:
        known = table.time[table.time != NO_TIME]
        if len(known):
            first, last = int(known.min()), int(known.max())
            self.first = first if self.first is None else min(self.first, first)
            self.last = last if self.last is None else max(self.last, last)

    def _export(self, day: _Day) -> Export:
        if day in self._open:
            self._open.move_to_end(day)
            return self._open[day][0]
        if len(self._files) >= MOST_DAYS and day not in self._files:
            raise CaptureError(
                f"{self._source}: its times are on more than {MOST_DAYS} days; is the clock right?"
            )
        while len(self._open) >= OPEN_DAYS:
            self._close(next(iter(self._open)))
        number = self._files[day] = self._files.get(day, -1) + 1
        path = os.path.join(self._folder, f"{day}-{number}.parquet")
        export = open_export(
            path,
            "parquet",
            variants=self._variants,
            names=self._recipe.names,
            float32=self._recipe.float32,
            sources=True,
        )
        export.absolute = day != "relative"
        self._open[day] = export, path
        return export

    def _close(self, day: _Day) -> None:
        export, path = self._open.pop(day)
        export.close()
        self.notes.update(dict.fromkeys(export.notes))
        for name, number in export.rows.items():
            self.rows[name] = self.rows.get(name, 0) + number
        for name in sorted(os.listdir(path)):
            message = name.removesuffix(".parquet")
            folder = f"{message}.relative" if day == "relative" else f"{message}/utc_day={_text(day)}"
            self.parts.append(LocalPart(os.path.join(path, name), folder, self._files[day]))

    def close(self) -> list[LocalPart]:
        """Close the parts, which are whole then, and return them."""
        for day in list(self._open):
            self._close(day)
        return self.parts

    def abandon(self) -> None:
        """Abandon every open part."""
        while self._open:
            self._open.popitem()[1][0].abandon()


def _day(number: int) -> int | None:
    return None if number == np.iinfo(np.int64).min else number


def _text(day: _Day) -> str:
    return NO_DAY if day is None else str(np.datetime64(day, "D"))
