"""Which rows are shown, and in which order.

1. What is typed as a filter never raises: what is not a filter yet is said in `problem`.
2. A frozen view shows copies; the model behind it goes on.

A filter is either one of candump's (`060:7F0`, `can0,150~7FF`) or words, all of which a row must have in its channel,
identifier, message, fields or page: `enc can0`, `board=3`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from aces_bus.errors import CallerError
from aces_bus.recordings.filters import CanFilter, parse_filter

from .model import Model, RepeatedFrame

#: The orders, in the order in which one key goes through them.
SORTS = ("id", "rate", "name", "change")
#: Orders that change by themselves are made anew this often: rows that jump all the time cannot be read.
REORDER_NS = 1_000_000_000

_CANDUMP = re.compile(r"[0-9A-Fa-f]\s*[:~]\s*[0-9A-Fa-f]|#[0-9A-Fa-f]{2}")


class View:
    """The rows that are shown of a model."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.sort = SORTS[0]
        self.is_reversed = False
        self.unknown_only = False
        self.text = ""
        #: What is wrong with the filter as it is typed.
        self.problem = ""
        self.frozen_ns: int | None = None
        self._words: list[str] = []
        self._filter: CanFilter | None = None
        self._frozen: list[RepeatedFrame] = []
        self._order: list[RepeatedFrame] = []
        self._state: Any = None
        self._ordered_ns = 0

    # ------------------------------------------------------------------ what is chosen

    def next_sort(self) -> str:
        """Go on to the next order; gives its name."""
        self.sort = SORTS[(SORTS.index(self.sort) + 1) % len(SORTS)]
        self.is_reversed = False
        return self.sort

    def look_for(self, text: str) -> None:
        """Show only what this filter lets pass; all for an empty one."""
        self.text = text.strip()
        self._filter, self._words, self.problem = None, [], ""
        if _CANDUMP.search(self.text):
            try:
                self._filter = parse_filter(*self.text.split())
            except CallerError as error:
                self.problem = str(error)
        else:
            self._words = self.text.lower().split()
        self._state = None

    def freeze(self, now_ns: int) -> None:
        """Keep what is shown as it is now."""
        self.frozen_ns = now_ns
        self._frozen = [row.frozen() for row in self.model.rows.values()]
        self._state = None

    def thaw(self) -> None:
        """Follow the bus again."""
        self.frozen_ns, self._frozen, self._state = None, [], None

    def instant(self, now_ns: int) -> int:
        """Return the instant that is shown: now, or when it was frozen."""
        return now_ns if self.frozen_ns is None else self.frozen_ns

    # ------------------------------------------------------------------ the rows

    def rows(self, now_ns: int) -> list[RepeatedFrame]:
        """Return the rows to show, in order."""
        generation = -1 if self.frozen_ns is not None else self.model.generation
        state = self.sort, self.is_reversed, self.unknown_only, self.text, generation
        is_moving = self.sort in ("rate", "change") and self.frozen_ns is None
        if state == self._state and not (is_moving and now_ns - self._ordered_ns >= REORDER_NS):
            return self._order
        rows = self._frozen if self.frozen_ns is not None else list(self.model.rows.values())
        instant = self.instant(now_ns)
        self._order = sorted(
            filter(self._passes, rows), key=self._sort_key(instant), reverse=self.is_reversed
        )
        self._state, self._ordered_ns = state, now_ns
        return self._order

    def _passes(self, row: RepeatedFrame) -> bool:
        if self.unknown_only and not row.is_lost:
            return False
        if self._filter is not None:
            return row.frame is not None and self._filter.matches(row.frame)
        return all(word in row.search for word in self._words)

    def _sort_key(self, now_ns: int) -> Callable[[RepeatedFrame], Any]:
        match self.sort:
            case "rate":
                return lambda row: (-row.rate(now_ns), row.channel, row.key, row.number)
            case "name":
                return lambda row: (not row.name, row.name.lower(), row.channel, row.key, _natural(row))
            case "change":
                return lambda row: (-row.changed_ns, row.channel, row.key, row.number)
            case _:
                # Identifiers of both kinds stand by their numbers: the flags of a key are above them.
                return lambda row: (row.channel, row.key, row.name, _natural(row))


def _natural(row: RepeatedFrame) -> tuple[int, str, int]:
    return len(row.identifier), row.identifier, row.number
