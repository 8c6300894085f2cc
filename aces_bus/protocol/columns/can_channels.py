"""CAN frames of several channels to columns, where a protocol is bound to one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...frame_table import FrameTable
from ..declare.message import GivenWay
from ..declare.protocol import Variant
from ..live.channels import ChannelScanners
from .can import CanColumns, Handover
from .slot_batch import merge_tables
from .table import Array, MessageTable


class ChannelColumns(ChannelScanners[CanColumns]):
    """The column scanner of several channels; made by `make_column_scanner` when a protocol is bound to one."""

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: GivenWay | None = None,
        include_unknown: bool = False,
        raw: bool = False,
        defer: bool = False,
    ) -> None:
        super().__init__(
            variants,
            lambda mine: CanColumns(
                mine, direction=direction, include_unknown=include_unknown, raw=raw, defer=defer
            ),
        )
        self._fed = 0

    def hand_over(self) -> dict[str | None, Handover]:
        """Return what has been seen since the last call, by channel; see `CanColumns.hand_over`."""
        given = {channel: scanner.hand_over() for channel, scanner in self._scanners.items()}
        frames, self._fed = self._fed, 0
        return {channel: replace(handover, frames=frames) for channel, handover in given.items()}

    def adopt(self, given: Mapping[str | None, Handover]) -> list[MessageTable]:
        """Go on behind a piece that another process has decoded: the tables of the frames that it left."""
        tables: list[MessageTable] = []
        for channel, handover in given.items():
            scanner = self.of(channel)
            tables += scanner.adopt(handover, self._fed)
        self._fed += max((handover.frames for handover in given.values()), default=0)
        return merge_tables(tables)

    def feed(self, table: FrameTable, /) -> list[MessageTable]:
        """Decode a piece of a capture; return its tables, one a message that occurs in it."""
        tables: list[MessageTable] = []
        for number in np.unique(table.channel).tolist():
            places: Array = np.flatnonzero(table.channel == number)
            scanner = self.of(table.channels.names[number])
            tables += scanner.feed(table.take(places), places + self._fed)
        self._fed += len(table)
        return merge_tables(tables)

    def close(self) -> list[MessageTable]:
        """End a capture; see `CanColumns.close`."""
        return merge_tables(table for scanner in self._scanners.values() for table in scanner.close())


__all__ = ["ChannelColumns"]
