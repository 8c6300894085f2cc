"""Protocols bound to channels: a scanner for each channel.

A frame is decided by the protocols of its channel alone: bound to it or to none, in the order given. Each channel has a
scanner of its own, made when its first frame comes; what is asked on one bus is answered there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any, Generic, Protocol, TypeVar

from ..counts import ScanCounts, sum_counts
from ..declare.message import GivenWay
from ..declare.protocol import Variant
from ..record import Record
from .can import CanScanner

#: Channels with scanners of their own; the frames of more channels share the one of unbound protocols.
MOST = 256


class _Counting(Protocol):
    """What channels have a scanner each of."""

    @property
    def counts(self) -> ScanCounts: ...
    @property
    def contested(self) -> Mapping[int, tuple[str, str]]: ...


Kind = TypeVar("Kind", bound=_Counting)


class ChannelScanners(Generic[Kind]):
    """A scanner for each channel, made on demand."""

    link = "can"

    def __init__(self, variants: Sequence[Variant], make: Callable[[Sequence[Variant]], Kind]) -> None:
        self.variants = tuple(variants)
        self._make: Callable[[Sequence[Variant]], Kind] = make
        self._bound = {variant.channel for variant in variants}
        self._scanners: dict[str | None, Kind] = {}

    def of(self, channel: str | None) -> Kind:
        """Return the scanner of a channel; channels that no protocol is bound to keep apart too."""
        if channel not in self._scanners:
            if len(self._scanners) >= MOST and channel not in self._bound:
                channel = None
            mine = [v for v in self.variants if v.channel is None or v.channel == channel]
            self._scanners[channel] = self._make(mine)
        return self._scanners[channel]

    @property
    def counts(self) -> ScanCounts:
        """Number of frames so far by their outcome, all channels together."""
        return sum_counts(scanner.counts for scanner in self._scanners.values())

    @property
    def contested(self) -> Mapping[int, tuple[str, str]]:
        """Keys that two protocols of one channel claim, with their names, first the one that wins."""
        found: dict[int, tuple[str, str]] = {}
        for scanner in self._scanners.values():
            found.update(scanner.contested)
        return found


class ChannelScanner(ChannelScanners[CanScanner]):
    """The live scanner of several channels; made by `make_scanner` when a protocol is bound to one."""

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: GivenWay | None = None,
        include_unknown: bool = False,
        raw: bool = False,
    ) -> None:
        super().__init__(
            variants,
            lambda mine: CanScanner(mine, direction=direction, include_unknown=include_unknown, raw=raw),
        )

    def feed(self, frames: Iterable[Any], /) -> list[Record]:
        """Return the records of `frames`, in order."""
        out: list[Record] = []
        for channel, some in groupby(frames, key=lambda frame: frame.channel):
            out += self.of(channel).feed(list(some))
        return out

    @property
    def has_transports(self) -> bool:
        """True if some messages are carried in several frames."""
        return any(m.transport is not None for variant in self.variants for m in variant.messages.values())

    def reset(self) -> None:
        """Forget everything seen, counts included: as if just made."""
        self._scanners.clear()

    def sent(self, frame: Any) -> None:
        """Note our own transmission: a request that replies on its channel may need."""
        self.of(frame.channel).sent(frame)

    def idle(self, time: float | None = None) -> list[Record]:
        """Note silence on all channels; see `CanScanner.idle`."""
        return [record for scanner in self._scanners.values() for record in scanner.idle(time)]

    def close(self) -> list[Record]:
        """End a capture; see `CanScanner.close`."""
        return [record for scanner in self._scanners.values() for record in scanner.close()]
