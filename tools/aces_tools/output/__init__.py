"""How decoded records are written: for programs (`jsonl`), for spreadsheets (`sheet`), for people (`text`).

A writer is given the items of one source, in order, and returns bytes; it never writes anything itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol


class Writer(Protocol):
    """What the three have in common."""

    def begin(self, source: str, link: str, start: float | None = None) -> bytes:
        """What stands before the items of a source; `start` is the time of its first one, shown or not."""
        ...

    def items(self, items: Sequence[Any]) -> bytes:
        """Records and `Unknown`s of the source."""
        ...
