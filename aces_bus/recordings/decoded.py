"""A decoded recording: a mapping from messages to tables, which draws itself, and writes itself into a file.

1. Everything is in memory: a recording that does not fit is decoded piece by piece (`make_column_scanner`), or into a file
   (`aces decode -o`, `aces_bus.export`).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from ..errors import CallerError, UnknownNameError
from ..export.open import open_export
from ..plain_text import html_table
from ..protocol.columns.arrow import to_arrow, to_pandas, to_polars
from ..protocol.columns.layout import Holds, Objects, empty_table
from ..protocol.columns.table import MessageTable
from ..protocol.counts import ScanCounts
from ..protocol.declare.protocol import Variant
from .base import Recording

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow
    from matplotlib.axes import Axes


class DecodedRecording(Mapping[str, MessageTable]):
    """Messages by name, each the table of the whole recording; messages that did not occur are not among the keys.

        decoded = decode("walk.log", "hubo")
        decoded["Encoder"]["position.0"].values     # an array, in the sheet's unit
        decoded.plot("Encoder.position.0")
        decoded.save("walk.parquet")
        decoded.to_pandas("Encoder")
        decoded.counts                              # where every frame or byte went
        decoded.recordings[0].lines_unreadable      # also .problems, .others

    The table named "" is what was not decoded, where that was asked for (`include_unknown`).
    """

    def __init__(
        self,
        variant: Variant,
        tables: Mapping[str, MessageTable],
        counts: ScanCounts,
        recordings: tuple[Recording, ...] = (),
    ) -> None:
        self.variant = variant
        self.counts = counts
        #: The files that were read, closed: what of them could not be read is counted there.
        self.recordings = recordings
        self._tables = dict(tables)
        self._objects = Objects([variant])

    def __getitem__(self, message: str) -> MessageTable:
        """Return the table of a message, without rows when it did not occur; raises `UnknownNameError`."""
        if message in self._tables:
            return self._tables[message]
        if message not in self.variant.messages:
            raise UnknownNameError(f"message of {self.variant.label}", str(message), self.variant.messages)
        return empty_table(self.variant, message)

    def __contains__(self, message: object) -> bool:
        return message in self._tables

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)

    def __repr__(self) -> str:
        rows = ", ".join(f"{name or 'not decoded'}: {len(table)}" for name, table in self._tables.items())
        return f"<{self.variant.label}: {rows}>"

    def _repr_html_(self) -> str:
        rows = [
            [name or "not decoded", f"{len(table):,}", ", ".join(table.names), table.doc]
            for name, table in self._tables.items()
        ]
        return html_table(self.variant.label, ["message", "rows", "columns", ""], rows)

    def plot(self, *signals: str) -> list[Axes]:
        """Draw signals over time, those of a unit on one pair of axes; returns the axes of matplotlib, from top to bottom.

        The figure is pyplot's: notebooks show it, `pyplot.show()` does elsewhere, `pyplot.savefig(path)` writes it.
        A signal is `Message.column` (`Encoder.position.0`); a message alone is all its numbers. Where a value is absent,
        and where a message pauses for more than ten times its usual period, the line is broken. `aces plot` has more:
        conditions, styles, windows of time.

        Raises `UnknownNameError` for a name that does not exist, `CallerError` without signals or without matplotlib.
        """
        from ..protocol.columns.plot import plot_signals

        if not signals:
            raise CallerError(
                f"plot takes names of signals: plot({next(iter(self._tables), 'Message')!r}) draws all of a message"
            )
        return plot_signals([self._signal(signal) for signal in signals])

    def _signal(self, text: str) -> tuple[MessageTable, str | None]:
        for name in sorted(self.variant.messages, key=len, reverse=True):
            if text == name:
                return self[name], None
            if text.startswith(f"{name}."):
                return self[name], text[len(name) + 1 :]
        raise UnknownNameError(f"message of {self.variant.label}", text, self.variant.messages)

    def save(self, path: str | os.PathLike[str], *, names: bool = False) -> None:
        """Write all tables into a file or folder, whose suffix says the format: `.parquet`, `.sqlite`, `.mcap`, `.npz`,
        `.arrow`, `.csv/`. `names` writes enumerations as names.

        Raises what `aces_bus.export.open_export` raises.
        """
        only = next(iter(self)) if len(self) == 1 else None
        with open_export(path, variants=[self.variant], only=only, names=names) as export:
            export.write(list(self._tables.values()))

    def to_arrow(self, message: str, *, names: bool = False, float32: bool = False) -> pyarrow.Table:
        """Return a message's table as a `pyarrow.Table`; see `aces_bus.export.to_arrow`."""
        table = self[message]
        return to_arrow(table, names=names, float32=float32, objects=self._of(table))

    def to_pandas(self, message: str, *, names: bool = False, float32: bool = False) -> pandas.DataFrame:
        """Return a message's table as a `pandas.DataFrame`; see `aces_bus.export.to_pandas`."""
        return to_pandas(self[message], names=names, float32=float32)

    def to_polars(self, message: str, *, names: bool = False, float32: bool = False) -> polars.DataFrame:
        """Return a message's table as a `polars.DataFrame`; see `aces_bus.export.to_polars`."""
        table = self[message]
        return to_polars(table, names=names, float32=float32, objects=self._of(table))

    def _of(self, table: MessageTable) -> dict[str, Holds]:
        return self._objects.of(table)
