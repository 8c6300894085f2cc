"""Bytes of a serial line, or datagrams, into the model of the live screen.

1. Silence is told to the scanner once: after the protocol's gap, what is incomplete never will be whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from aces_bus.errors import CallerError

from .model import Model

#: The shortest silence that is believed: USB adapters hand over bytes up to 16 ms late.
LEAST_NS = 20_000_000
#: The silence after which nothing goes on, where no protocol declares a gap.
SILENCE_S = 1.0
#: Bit times of a byte on a serial line: start, eight bits, stop.
BYTE = 10


class ModelFeed:
    """Feeds a model. Times are the host's, of its monotonic clock."""

    def __init__(self, model: Model, *, are_datagrams: bool = False) -> None:
        if model.scanner is None:
            raise CallerError(
                "bytes make rows only where a protocol finds packets in them; name one: -p NAME"
            )
        self._model = model
        self._scanner: Any = model.scanner
        self._are_datagrams = are_datagrams
        self._gap_ns = max(LEAST_NS, round((getattr(self._scanner, "gap", 0.0) or SILENCE_S) * 1e9))
        self._heard_ns = 0
        self._is_settled = True

    def feed(self, items: Sequence[Any]) -> None:
        """What a gate handed over."""
        feed = self._scanner.datagram if self._are_datagrams else self._scanner.feed
        for item in items:
            self.idle(item.host_ns)
            self._model.feed_records(
                feed(item.content, item.host_ns / 1e9), item.host_ns, BYTE * len(item.content)
            )
            self._heard_ns, self._is_settled = item.host_ns, self._are_datagrams

    def idle(self, now_ns: int) -> None:
        """Nothing came until now."""
        if not self._is_settled and now_ns - self._heard_ns > self._gap_ns:
            self._is_settled = True
            self._model.feed_records(self._scanner.idle(now_ns / 1e9), now_ns)


__all__ = ["ModelFeed"]
