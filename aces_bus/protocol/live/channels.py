"""Protocols bound to channels: the same identifier means one thing on this bus and another on that.

1. A frame is decided by the protocols of its channel alone: those bound to it and those bound to none, in the order given.
2. Each channel has a scanner of its own, made when its first frame comes; what is asked on one bus is answered there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from ...frame_table import FrameTable
from ..columns.can import CanColumns, Handover, merge_tables
from ..columns.table import Array, MessageTable
from ..counts import ScanCounts
from ..declare.message import Direction
from ..declare.protocol import Variant
from ..record import Record
from .can import CanScanner

#: Channels with scanners of their own; the frames of more channels share the one of unbound protocols.
MOST = 256

Kind = TypeVar("Kind", CanScanner, CanColumns)


class _Channels(Generic[Kind]):
    """A scanner for each channel, made on demand."""

    link = "can"

    def __init__(self, variants: Sequence[Variant], make: Callable[[Sequence[Variant]], Kind]) -> None:
        self.variants = tuple(variants)
        self._make: Callable[[Sequence[Variant]], Kind] = make
        self._bound = {variant.channel for variant in variants}
        self._scanners: dict[str | None, Kind] = {}

    def of(self, channel: str | None) -> Kind:
        """The scanner of a channel; channels that no protocol is bound to keep apart too."""
        if channel not in self._scanners:
            if len(self._scanners) >= MOST and channel not in self._bound:
                channel = None
            mine = [v for v in self.variants if v.channel is None or v.channel == channel]
            self._scanners[channel] = self._make(mine)
        return self._scanners[channel]

    @property
    def counts(self) -> ScanCounts:
        """Where every frame went so far, all channels together."""
        return _sum(scanner.counts for scanner in self._scanners.values())

    @property
    def contested(self) -> Mapping[int, tuple[str, str]]:
        """Keys that two protocols of one channel claim, with their names, first the one that wins."""
        found: dict[int, tuple[str, str]] = {}
        for scanner in self._scanners.values():
            found.update(scanner.contested)
        return found


def _sum(counts: Iterable[ScanCounts]) -> ScanCounts:
    whole = ScanCounts()
    for one in counts:
        whole.total += one.total
        whole.decoded += one.decoded
        whole.records += one.records
        whole.missed += one.missed
        for reason, number in one.reasons.items():
            whole.lose(number, reason)
    return whole


class ChannelScanner(_Channels[CanScanner]):
    """The live scanner of several channels; made by `make_scanner` when a protocol is bound to one."""

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: Direction | Literal["both"] | None = None,
        include_unknown: bool = False,
        raw: bool = False,
    ) -> None:
        super().__init__(
            variants,
            lambda mine: CanScanner(mine, direction=direction, include_unknown=include_unknown, raw=raw),
        )

    def feed(self, frames: Iterable[Any], /) -> list[Record]:
        """Records of `frames`, in order."""
        out: list[Any] = []
        for channel, some in groupby(frames, key=lambda frame: frame.channel):
            out += self.of(channel).feed(list(some))
        return out

    def reset(self) -> None:
        """Forget everything seen, counts included: as if just made."""
        self._scanners.clear()

    def sent(self, frame: Any) -> None:
        """Our own transmission: a request that replies on its channel may hang on."""
        self.of(frame.channel).sent(frame)

    def idle(self, time: float | None = None) -> list[Record]:
        """Frames are whole: silence decides nothing on CAN."""
        return []

    def close(self) -> list[Record]:
        """Frames are whole: the end of a capture decides nothing on CAN."""
        return []


class ChannelColumns(_Channels[CanColumns]):
    """The column scanner of several channels; made by `make_column_scanner` when a protocol is bound to one."""

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: Direction | Literal["both"] | None = None,
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
        """What has been seen since the last call, by channel; see `CanColumns.hand_over`."""
        given = {channel: scanner.hand_over() for channel, scanner in self._scanners.items()}
        frames, self._fed = self._fed, 0
        return {channel: replace(one, frames=frames) for channel, one in given.items()}

    def adopt(self, given: Mapping[str | None, Handover]) -> list[MessageTable]:
        """Go on behind a piece that another process has decoded: the tables of the frames that it left."""
        tables: dict[tuple[str, str], list[MessageTable]] = {}
        for channel, one in given.items():
            scanner = self.of(channel)
            for table in scanner.adopt(one, self._fed):
                tables.setdefault((table.protocol, table.message), []).append(table)
        self._fed += max((one.frames for one in given.values()), default=0)
        return [merge_tables(some) for some in tables.values()]

    def feed(self, table: FrameTable, /) -> list[MessageTable]:
        """The tables of a piece of a capture, one a message that occurs in it."""
        tables: dict[tuple[str, str], list[MessageTable]] = {}
        for number in np.unique(table.channel).tolist():
            places: Array = np.flatnonzero(table.channel == number)
            scanner = self.of(table.channels.names[number])
            for one in scanner.feed(table.take(places), places + self._fed):
                tables.setdefault((one.protocol, one.message), []).append(one)
        self._fed += len(table)
        return [merge_tables(some) for some in tables.values()]

    def close(self) -> list[MessageTable]:
        """Frames are whole: the end of a capture decides nothing on CAN."""
        return []
