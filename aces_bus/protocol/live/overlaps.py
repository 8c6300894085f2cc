"""Checks of candidates that overlap: what one candidate had read is not read again for the next.

1. The answer is the printed check's, word for word; only where its sum comes from differs.
2. While checks hold, a packet is summed directly, once, by the printed check. A failed one makes prefix sums, which answer
   for the candidates that begin in it (see `Sums`): these alone are asked here.
"""

from __future__ import annotations

from typing import Any

from ..declare.checks import Covered, Extra, Sums
from ..declare.framing import Framing


class Overlaps:
    """Why the check of the packet at [start, end) of a buffer fails, or None, where prefix sums reach to `start`."""

    def __init__(self, framing: Framing, sums: Sums, extras: dict[int, bytes] | None) -> None:
        assert framing.check is not None
        self.sums, self._check = sums, framing.check
        self._extras, self._key = extras or {}, framing.extra_number
        self._back = self._check.size + len(framing.end)
        self._over: tuple[Covered, ...] = self._check.over or (slice(len(framing.sync), -self._back),)
        self._has_extra = any(isinstance(part, Extra) for part in self._over)

    def __call__(self, buffer: bytes, base: int, start: int, end: int) -> str | None:
        extra: Any = b""
        if self._has_extra:
            key = self._key(buffer[start:end])
            extra = self._extras.get(key)
            if extra is None:
                return f"malformed: no message {key} to check by"
        check, sums, at = self._check, self.sums, end - self._back
        found = sums.compute_runs(buffer, base, base + start, base + end, self._over, extra)
        if not check.same(buffer[at : at + check.size], check.write(found)):
            return "malformed: checksum"
        sums.work -= end - start  # counted with the records, not read again
        return None


__all__ = ["Overlaps"]
