"""Checks of candidates that overlap: what one candidate had read is not read again for the next.

1. The answer is the printed check's, word for word; only where its sum comes from differs.
2. While checks hold, a packet is summed directly, once. A failed one makes prefix sums, which answer for the candidates
   that begin in it (see `Sums`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..spec.checks import Covered, Extra, Sums
from ..spec.framing import Framing


class Overlaps:
    """Why the check of the packet at [start, end) of a buffer fails, or None; `check` is the printed function."""

    check: Callable[..., str | None]

    def __init__(self, framing: Framing, sums: Sums, extras: dict[int, bytes] | None) -> None:
        assert framing.check is not None
        self._sums, self._extras, self._key = sums, extras or {}, framing.extra_number
        back = framing.check.size + len(framing.end)
        self._over: tuple[Covered, ...] = framing.check.over or (slice(len(framing.sync), -back),)
        self._has_extra = any(isinstance(part, Extra) for part in self._over)

    def __call__(self, buffer: bytes, base: int, start: int, end: int) -> str | None:
        packet, sums = buffer[start:end], self._sums
        if base + start > sums.end:
            reason = self.check(packet)
            if reason is not None:
                sums.fail(packet, base + start)
            return reason
        extra: Any = self._extras.get(self._key(packet)) if self._has_extra else b""
        if extra is None:
            return self.check(packet)  # which says that nobody knows the message, and sums nothing
        found = sums.compute_runs(buffer, base, base + start, base + end, self._over, extra)
        reason = self.check(packet, found)
        if reason is None:
            sums.work -= end - start  # counted with the records, not read again
        return reason


__all__ = ["Overlaps"]
