"""Candidates that overlap: what one had unstuffed or read for its check is not done again for the next.

1. `Segments` says word for word what `Framing.judge` says, of framings whose packets are stuffed as a whole and closed by
   the one byte that stuffing keeps out of them (SLIP by C0, COBS by 00). What is between two of these is unstuffed once.
2. The first candidate behind a mark goes straight through the framing: good streams cost nothing more. Only when it failed
   is the segment looked at as a whole: which candidates can be unstuffed at all, and what they have in common.
3. `work` counts the bytes and blocks that were unstuffed beside those of packets, `checked` the bytes that failed checks
   have read: unstuffing a segment costs a few times its length, and a candidate that can be unstuffed its check.
4. `Overlaps` says what the printed check says; only where its sum comes from differs. While checks hold, a packet is summed
   directly, once, by the printed check. A failed one makes prefix sums, which answer for the candidates that begin in it.

*Facts.* A candidate is a suffix of its segment. In SLIP a suffix can be unstuffed when it has no escape that is none, and
its data are a suffix of the segment's. In COBS a suffix is a chain of blocks that must end at the mark; chains that meet go
on together, so that their data end alike.
"""

from __future__ import annotations

import re
from typing import Any

from ..declare.checks import Covered, Extra, Sums
from ..declare.framing import Framing, Judgement, Verdict
from ..declare.stuffing import Slip

_NO_ESCAPE = re.compile(rb"\xdb(?![\xdc\xdd])")
#: Chains whose data are kept, of one segment; a chain of less than this part of it is followed again each time.
CHAINS = 64


class SlipSegment:
    """The bytes between two marks, and the data of each of their suffixes."""

    def __init__(self, wire: bytes) -> None:
        self.wire = wire
        #: Blocks that were followed.
        self.work = 0
        faults = [found.start() for found in _NO_ESCAPE.finditer(wire)]
        #: Suffixes that begin before cannot be unstuffed.
        self._valid = faults[-1] + 1 if faults else 0
        tail = wire[self._valid :]
        self._data = tail.replace(b"\xdb\xdc", b"\xc0").replace(b"\xdb\xdd", b"\xdb")
        self._seen, self._escapes = self._valid, 0

    reason = "SLIP escape"

    def suffix(self, at: int) -> bytes | None:
        """Return the data of the suffix from `at` on; None where there are none. Suffixes are asked in order, or cost
        more.
        """
        if at < self._valid:
            return None
        if at < self._seen:
            self._seen, self._escapes = self._valid, 0
        self._escapes += self.wire.count(b"\xdb", self._seen, at)
        self._seen = at
        place = at - self._valid - self._escapes
        # The second byte of an escape is data here: the escape before it belongs to no suffix that begins with it.
        if at > self._valid and self.wire[at - 1] == 0xDB:
            return self.wire[at : at + 1] + self._data[place + 1 :]
        return self._data[place:]


class CobsSegment:
    """The same for COBS."""

    reason = "COBS block"

    def __init__(self, wire: bytes) -> None:
        self.wire = wire
        self.work, size = 0, len(wire)
        valid = bytearray(size + 1)
        valid[size] = 1
        for at in range(size - 1, -1, -1):
            code = wire[at]
            then = at + code
            if then <= size and valid[then]:
                # A full block ends the data by itself: an empty one behind it is not how they are stuffed.
                valid[at] = not (code == 255 and then == size - 1 and wire[then] == 1)
        self._valid = valid
        #: Where blocks of known chains begin: the chain's data, and the place in them.
        self._known: dict[int, tuple[bytes, int]] = {}
        self._chains = 0

    def suffix(self, at: int) -> bytes | None:
        """Return the data of the suffix from `at` on; None where there are none."""
        if not self._valid[at]:
            return None
        wire, size, known = self.wire, len(self.wire), self._known
        parts: list[bytes] = []
        starts: list[int] = []
        place = at
        while place < size and place not in known:
            starts.append(place)
            code = wire[place]
            then = place + code
            parts.append(
                wire[place + 1 : then] + b"\0" if code < 255 and then < size else wire[place + 1 : then]
            )
            place = then
        if not parts:
            data, offset = known[at]
            return data[offset:]
        self.work += len(starts)
        if place < size:
            data, offset = known[place]
            parts.append(data[offset:])
        data = b"".join(parts)
        if self._chains < CHAINS and len(starts) * CHAINS > size:
            self._chains += 1
            offset = 0
            for start, part in zip(starts, parts, strict=False):
                known[start] = data, offset
                offset += len(part)
        return data


class Segments:
    """Judges the candidates of a framing, as the printed scanner asks: (verdict, end, reason)."""

    def __init__(self, framing: Framing, extras: dict[int, bytes] | None) -> None:
        self._framing, self._extras = framing, extras
        self.reset()

    def reset(self) -> None:
        """Begin anew, as if nothing had been judged."""
        self.work = self.checked = 0
        self._data = b""
        self._forget()

    def _forget(self) -> None:
        #: The buffer in which a candidate failed; empty while none did.
        self._buffer = b""
        self._first, self._end = -1, -1
        self._segment: SlipSegment | CobsSegment | None = None

    def __call__(self, buffer: bytes, start: int, silent: bool) -> tuple[str, int, str]:
        framing = self._framing
        if self._buffer:
            if buffer is not self._buffer or start >= self._end:
                self._forget()
            elif start > self._first and not self._has_not_next(buffer, start):
                return self._judge(buffer, start)
        judged = framing.judge(buffer, start, silent=silent, extras=self._extras)
        if judged.verdict is Verdict.WHOLE:
            self._data = judged.data
        elif judged.verdict is Verdict.BAD and judged.reason not in ("no end", "length"):
            # What begins behind it, up to the same mark, is judged together.
            self._buffer, self._first = buffer, start
            self._end = buffer.index(framing.end, start)
            self._segment = None
            self.work += self._end - start
            if framing.check is not None:
                self.checked += self._end - start
        return verdict_of(judged, start)

    def _judge(self, buffer: bytes, start: int) -> tuple[str, int, str]:
        """Judge a candidate inside the segment."""
        framing = self._framing
        if self._segment is None:
            wire = buffer[start : self._end]
            self._segment = SlipSegment(wire) if type(framing.stuffing) is Slip else CobsSegment(wire)
            self._first = start - 1
            self.work += len(wire)
        segment, before = self._segment, self._segment.work
        data = segment.suffix(start - self._first - 1)
        self.work += segment.work - before
        if data is None:
            return "bad", 0, f"malformed: {segment.reason}"
        judged = framing.judge_data(
            data + framing.end, buffer[start : self._end + len(framing.end)], self._extras
        )
        if judged.verdict is Verdict.BAD and judged.reason != "length" and framing.check is not None:
            self.checked += len(data)
        self._data = judged.data
        return verdict_of(judged, start)

    def unstuff(self, packet: bytes) -> bytes:
        """Return the data of `packet`, the whole one that was judged last."""
        return self._data

    def _has_not_next(self, buffer: bytes, start: int) -> bool:
        return bool(self._framing.not_next) and buffer[start] in self._framing.not_next


def verdict_of(judged: Judgement, start: int) -> tuple[str, int, str]:
    """Return a framing's verdict as scan functions take it: (verdict, end, reason)."""
    if judged.verdict is Verdict.WHOLE:
        return "whole", start + judged.size, ""
    if judged.verdict is Verdict.BAD:
        return "bad", 0, f"malformed: {judged.reason}"
    return ("more" if judged.verdict is Verdict.MORE else "dead"), 0, ""


class Overlaps:
    """Why the check of the packet at [start, end) of a buffer fails, or None, where prefix sums reach to `start`."""

    def __init__(self, framing: Framing, sums: Sums, extras: dict[int, bytes] | None) -> None:
        assert framing.check is not None
        self.sums, self._check = sums, framing.check
        self._extras, self._key = extras or {}, framing.extra_number
        self._at = framing.check_at
        self._over: tuple[Covered, ...] = framing.check_over
        self._has_extra = any(isinstance(part, Extra) for part in self._over)

    def __call__(self, buffer: bytes, base: int, start: int, end: int) -> str | None:
        extra: Any = b""
        if self._has_extra:
            key = self._key(buffer[start:end])
            extra = self._extras.get(key)
            if extra is None:
                return f"malformed: no message {key} to check by"
        check, sums = self._check, self.sums
        at = (start if self._at >= 0 else end) + self._at
        found = sums.compute_runs(buffer, base, base + start, base + end, self._over, extra)
        if not check.same(buffer[at : at + check.size], check.write(found)):
            return "malformed: checksum"
        sums.work -= end - start  # counted with the records, not read again
        return None
