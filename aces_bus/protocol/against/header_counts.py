"""Counters in the header of a framing, seen over the packets of all its messages: one message's packets alone skip counts.

1. Senders are not told apart but by direction: what counts with several senders is not found.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..columns.table import Array, MessageTable
from ..declare.fields import Counter
from ..declare.framing import Framing
from ..declare.message import Message
from .finding import Observation

#: Packets at least, of two messages at least, and the share of them with the next number.
ENOUGH, SHARE = 64, 0.95


class HeaderCounts:
    """Integer fields of one framing's header, and how often each is the next number."""

    def __init__(self, framing: Framing) -> None:
        self.framing = framing
        self._names = [
            head.name
            for head in framing.heads
            if head.name is not None
            and head.name not in framing.derived
            and not isinstance(head.field, Counter)
        ]
        #: By field and direction: the last value, how often it was the next number, of how many.
        self._seen: dict[tuple[str, Any], tuple[int, int, int]] = {}
        self._messages: set[str] = set()

    def take(self, messages: Sequence[tuple[Message, MessageTable]]) -> None:
        """Take the packets of a piece of the recording, message by message."""
        for way in dict.fromkeys(message.direction for message, _ in messages):
            mine = [(message, table) for message, table in messages if message.direction == way]
            self._messages.update(message.name for message, _ in mine)
            rows = np.concatenate([table.row for _, table in mine])
            order = np.argsort(rows, kind="stable")
            for name in self._names:
                if not all(
                    any(head.name == name and head.pattern is None for head in m.heads) for m, _ in mine
                ):
                    continue
                columns = [table[name].values for _, table in mine]
                if all(column.dtype.kind in "iu" for column in columns):
                    self._add(name, way, np.concatenate(columns).astype(np.int64)[order])

    def _add(self, name: str, way: Any, values: Array) -> None:
        last, following, total = self._seen.get((name, way), (int(values[0]), 0, 0))
        steps = np.diff(values, prepend=last)
        found = (steps == 1) | (steps < 0) & (values == 0)
        self._seen[name, way] = int(values[-1]), following + int(found.sum()), total + len(values)

    def observations(self, known: set[tuple[str, str]]) -> Iterator[Observation]:
        """Yield the fields that count the packets of several messages; `known` are fields that a message's own packets
        have shown, as (message, field)."""
        framing = self.framing
        for (name, _), (_, following, total) in self._seen.items():
            is_known = any((message, name) in known for message in self._messages)
            if total >= ENOUGH and following >= SHARE * total and len(self._messages) > 1 and not is_known:
                yield Observation(
                    "warning",
                    "counter",
                    framing.place,
                    f"{framing.name}: {name} of its header counts up by one from packet to packet, in {following} of"
                    f" {total}, whatever their message",
                    count=following,
                    total=total,
                    remedy="if it is a rolling counter, declare it as Counter: then missing packets are counted",
                )
                return
