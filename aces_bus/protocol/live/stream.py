"""The stream scanner: bytes in, records out, however they are cut.

1. No I/O, no clock, no thread: `feed` is given bytes and returns records; `idle` and `close` say that nothing follows.
2. Each byte ends in exactly one bin of `counts`. A failed check costs the header's first byte only; the rest is read again.
3. What is decided does not depend on how the stream was cut: losses are reported when their run ends.
4. The buffer never holds more than the longest packet plus what was just fed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..counts import ScanCounts
from ..declare.checks import Sums, fletcher_of, xor_of
from ..declare.framing import DEAD, Framing, Verdict
from ..declare.message import GivenWay, Message, Way, way_of
from ..declare.protocol import Variant
from ..declare.stuffing import Insert
from ..generate.load import load_source
from ..generate.scan import plain_cover, print_stream, seek_pattern
from ..generate.shapes import measure_of
from ..record import Meta, Record, Unknown
from .candidates import Overlaps, Segments, verdict_of
from .decide import Decider

if TYPE_CHECKING:
    from .find import PacketFinder

#: From how many bytes on a chunk is searched at once, with NumPy.
WORTH = 768
#: A run of lost bytes is reported in pieces of this size at most, so that garbage costs no memory.
RUN = 4096


class _State:
    """What a scan function keeps between calls."""

    def __init__(self) -> None:
        self.work = 0


class _AskedFramings:
    """The framings of answers without a mark that are to be judged now, by their numbers in the scan function."""

    def __init__(
        self,
        awaited: Callable[[float | None], Sequence[tuple[Message, Mapping[str, object]]]],
        framings: Mapping[int, Framing],
    ) -> None:
        self._awaited, self.framings = awaited, framings
        unmarked = [number for number, framing in framings.items() if not framing.sync and not framing.match]
        self._first = frozenset(unmarked[:1])
        #: What was awaited last, and the framings of these answers.
        self._known: tuple[Sequence[object], frozenset[int]] = ((), self._first)

    def now(self, time: float | None) -> frozenset[int]:
        """Return the numbers: those of awaited answers, or the first of those that no byte marks."""
        answers = self._awaited(time)
        if answers is not self._known[0]:
            these = {id(message.framing) for message, _ in answers}
            numbers = frozenset(n for n, framing in self.framings.items() if id(framing) in these)
            self._known = answers, numbers if answers else self._first
        return self._known[1]


class StreamScanner:
    """Finds the packets of one or more protocols in a byte stream; made by `make_scanner`."""

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: GivenWay | None = None,
        include_unknown: bool = False,
        raw: bool = False,
    ) -> None:
        self.link = variants[0].link
        self.variants = tuple(variants)
        self.direction: Way | None = way_of(direction)
        self.include_unknown = include_unknown
        self.max_size = 0
        self.deciders = [Decider(variant, direction, raw=raw) for variant in variants]
        framings: list[tuple[Framing, str]] = []
        names: dict[str, Any] = {"from_bytes": int.from_bytes, "xor": xor_of, "fletcher": fletcher_of}
        self._sums: list[Sums] = []
        #: What judges the candidates of stuffed framings.
        self._segments: list[Segments] = []
        #: By the number of the framing: its checks, where they are sums.
        self._overlaps: dict[int, Overlaps] = {}
        self.reset()
        parts: list[_AskedFramings] = []
        for decider in self.deciders:
            answering = {
                n: f for n, f in enumerate(decider.framings, len(framings)) if f in decider.answering
            }
            if answering:
                parts.append(_AskedFramings(decider.context.awaited, answering))
            for framing in decider.framings:
                number = len(framings)
                decode = f"packet_{number}"
                framings.append((framing, decode))
                messages = [m for m in decider.messages if m.framing is framing]
                chosen = decider.decide(messages)
                names[decode] = chosen
                self._bind(number, framing, decider, decode, names)
                self.max_size = max(self.max_size, framing.max_size)
        self.framings = tuple(framing for framing, _ in framings)
        #: What `sent` looks for: requests with their framings, and the bytes that seed their checks.
        self._asked = [
            (decider, [(m, m.framing, m.extras) for m in decider.asked if m.framing is not None])
            for decider in self.deciders
        ]
        #: Seconds of silence after which no packet goes on.
        self.gap = max((framing.gap or 0.0 for framing in self.framings), default=0.0)
        label = " + ".join(variant.label for variant in variants)
        asked: list[int] = []
        if len(framings) > 1 and parts:
            asked = [number for part in parts for number in part.framings]
            names["asked"] = self._asks(parts)
        self.source = print_stream(label, framings, asked)
        if all(framing.sync for framing in self.framings):
            names["seek"] = re.compile(seek_pattern(self.framings), re.DOTALL).search
        space = load_source(self.source, f"aces {label} stream scanner {direction or ''}", names)
        self._scan: Callable[..., int] = space["scan"]
        # One framing alone on the wire: large chunks are searched at once.
        self._finder: PacketFinder | None = None
        self._failure: Callable[[bytes], str | None] | None = None
        self._overlap: Overlaps | None = None
        if len(framings) == 1 and has_size(self.framings[0]) and self.framings[0].stuffing is None:
            framing = self.framings[0]
            cover = plain_cover(framing)
            from .find import PacketFinder  # NumPy is loaded only where a stream is read

            self._finder = PacketFinder(framing, cover, names.get("measure_0"))
            self._decode: Callable[..., Any] = names["packet_0"]
            if self._finder.cover is None:
                self._failure = space.get("check_0")
                self._overlap = self._overlaps.get(0) if self._failure is not None else None

    def reset(self) -> None:
        """Forget everything seen, counts included: as if just made."""
        self._counts = ScanCounts()
        #: What is not decided yet, its offset in the stream, and the instant (s) of what was fed last.
        self.buffer = b""
        self.base = 0
        self.time: float | None = None
        #: Bytes at the end of a closed stream that began a packet.
        self._cut_off = 0
        self._losses: list[tuple[int, int, str, bytes]] = []
        #: The run of lost bytes that may go on: offset, reason, data.
        self.run: tuple[int, str, bytearray] | None = None
        self._state = _State()
        for sums in self._sums:
            sums.reset()
        for segments in self._segments:
            segments.reset()
        for decider in self.deciders:
            decider.reset()

    def _bind(
        self, number: int, framing: Framing, decider: Decider, decode: str, names: dict[str, Any]
    ) -> None:
        """Set the helpers that the printed text calls by name."""
        check = framing.check
        extras = framing.extras_of(decider.messages)
        if check is not None and check.kind != "crc":
            sums = Sums(check)
            self._sums.append(sums)
            names[f"sums_{number}"] = sums
            self._overlaps[number] = names[f"failure_{number}"] = Overlaps(framing, sums, extras)
        if check is not None:
            names[f"crc_{number}"] = check.engine
            names[f"text_{number}"] = check.text
            names[f"same_{number}"] = check.same
        if extras is not None:
            names[f"extras_{number}"] = extras.get
        if framing.measure is not None:
            names[f"measure_{number}"] = measure_of(framing.measure, f"aces {framing.name} size")
        if framing.is_enclosed:
            segments = Segments(framing, extras)
            self._segments.append(segments)
            names[f"judge_{number}"], names[f"unstuff_{decode}"] = segments, segments.unstuff
            return
        names[f"judge_{number}"] = _judge(framing, extras)
        if framing in decider.answering:
            names[f"judge_{number}"] = self._judge_answers(framing, decider)
        if framing.stuffing is not None:
            names[f"unstuff_{decode}"] = _unstuffer(framing)

    def _asks(self, parts: Sequence[_AskedFramings]) -> Callable[[], frozenset[int]]:
        """Return a function that gives the numbers of the framings of answers without a mark that are to be judged."""
        if len(parts) == 1:
            only = parts[0]
            return lambda: only.now(self.time)
        return lambda: frozenset().union(*(part.now(self.time) for part in parts))

    def _judge_answers(
        self, framing: Framing, decider: Decider
    ) -> Callable[[bytes, int, bool], tuple[str, int, str]]:
        """Judge packets of answers that no byte marks: they are looked for, and waited for, while one is awaited."""
        awaited, extras = decider.context.awaited, framing.extras_of(decider.messages)
        dead = unasked = verdict_of(DEAD, 0)
        # The request that was awaited last, and its bytes: they are the same at each byte.
        known: tuple[Mapping[str, object] | None, bytes] = (None, b"")
        if not framing.sync and not framing.match:
            unasked = ("bad", 0, decider.context.needs(decider.unmarked))

        def judge(buffer: bytes, start: int, silent: bool) -> tuple[str, int, str]:
            nonlocal known
            answers = awaited(self.time)
            for message, request in answers:
                if message.framing is framing:
                    if known[0] is not request:
                        known = request, message.question(request)
                    judged = framing.judge(buffer, start, silent=silent, extras=extras, request=known[1])
                    return verdict_of(judged, start)
            return dead if answers else unasked

        return judge

    @property
    def counts(self) -> ScanCounts:
        """Number of bytes so far by their outcome."""
        self._counts.missed = sum(decider.missed for decider in self.deciders)
        return self._counts

    # ------------------------------------------------------------------ feeding

    def feed(self, data: bytes, time: float | None = None) -> list[Record]:
        """Return the records that `data` completes, in order; with `include_unknown`, `Unknown` for lost
        bytes.

        `time` (seconds) becomes the time of the records. Raises nothing, for any bytes.
        """
        self._counts.total += len(data)
        return self.advance(bytes(data), time if time is not None else self.time, silent=False)

    def idle(self, time: float | None = None) -> list[Record]:
        """Give up an incomplete packet, because the line is silent; return the records found in its bytes.

        With the `time` of now (seconds) nothing happens before the longest declared `gap` has passed since
        the last bytes that came with a time.
        """
        if time is not None and self.time is not None and time - self.time <= self.gap:
            return []
        return self.advance(b"", time if time is not None else self.time, silent=True)

    def datagram(self, data: bytes, time: float | None = None) -> list[Record]:
        """Return the records of one datagram: a packet that it leaves incomplete does not continue in the next one."""
        return [*self.feed(data, time), *self.advance(b"", self.time, silent=True)]

    def close(self) -> list[Record]:
        """End the stream. A packet cut off by the end stays pending; packets behind a false one are found."""
        return self.advance(b"", self.time, silent=True, closing=True)

    def advance(
        self, data: bytes, time: float | None, *, silent: bool, closing: bool = False
    ) -> list[Record]:
        """Return what `data` completes, or with `silent` the silence behind it; the total is counted by who calls."""
        self.time = time
        buffer = self.buffer + data if self.buffer else data
        found: list[Record] = []
        losses = self._losses
        base = self.base
        deciders = self.deciders

        lost = 0
        reasons = self._counts.reasons

        def keep(offset: int, size: int, reason: str) -> None:
            nonlocal lost
            lost += size
            if reason == "unknown":
                reason = next((need for decider in deciders if (need := decider.need_of(offset))), reason)
            losses.append((offset, size, reason, buffer[offset - base : offset - base + size]))

        def count(offset: int, size: int, reason: str) -> None:
            nonlocal lost
            lost += size
            if reason == "unknown":
                reason = next((need for decider in deciders if (need := decider.need_of(offset))), reason)
            reasons[reason] = reasons.get(reason, 0) + size

        lose = keep if self.include_unknown or closing else count
        reached = 0
        # What is held is summed anew by a stride: it must not be the greater part.
        if self._finder is not None and len(data) >= WORTH and 2 * len(data) >= len(buffer):
            reached = self._stride(buffer, base, time, found, lose)
            if self._finder.summed:
                self._state.work -= reached - lost  # accepted: counted with the records
        if reached < len(buffer):
            reached = self._scan(
                buffer, base, reached, len(buffer), silent, time, found.append, lose, self._state
            )
        self.base += reached
        self.buffer = buffer[reached:]
        self._counts.decoded += reached - lost
        self._counts.records += len(found)
        if closing:
            self._leave_pending(found, buffer, base)
        self._counts.pending = len(self.buffer) + self._cut_off
        if closing and not self.include_unknown:
            for _, size, reason, _ in losses:
                if reason != "pending":
                    self._counts.lose(size, reason)
            losses.clear()
            return found
        if losses or self.run is not None:
            return self._settle(found, silent)
        return found

    def _stride(
        self,
        buffer: bytes,
        base: int,
        time: float | None,
        found: list[Record],
        lose: Callable[[int, int, str], None],
    ) -> int:
        """Accept what `Finder` proposes, in order; the bytes between are left to the scan function. Gives what is done."""
        assert self._finder is not None
        finder = self._finder
        starts, ends, stop = finder.find(buffer)
        if finder.summed:
            # The scan function asks them too, for the bytes between.
            self._sums[0].lend(base, base + finder.summed, *finder.sums)
            self._state.work += finder.summed
        decode, scan, emit = self._decode, self._scan, found.append
        state, failure, overlap = self._state, self._failure, self._overlap
        summed = overlap.sums.end - base if overlap is not None else -1
        mark = self.framings[0].sync[:1]
        at = 0
        for start, end in zip(starts, ends):  # noqa: B905  (the hot loop)
            if start != at:
                if start < at:
                    continue
                if buffer.find(mark, at, start) < 0:
                    lose(base + at, start - at, "skipped")
                else:
                    at = scan(buffer, base, at, start, False, time, emit, lose, state)
                    if overlap is not None:
                        summed = overlap.sums.end - base
                    if at > start:  # a packet that begins in one whose check fails
                        continue
                    if at < start:  # and is not whole yet
                        stop = at
                        break
            packet = buffer[start:end]
            if failure is not None:
                if overlap is None:
                    reason = failure(packet)
                    if reason is not None:
                        state.work += end - start
                elif start > summed:
                    reason = failure(packet)
                    if reason is not None:
                        overlap.sums.fail(packet, base + start)
                        summed = end
                else:
                    reason = overlap(buffer, base, start, end)
                    summed = overlap.sums.end - base
                if reason is not None:
                    lose(base + start, 1, reason)
                    at = start + 1
                    continue
            record = decode(packet, base + start, time, None, packet, None)
            if record is None:
                lose(base + start, end - start, "unknown")
            else:
                emit(record)
            at = end
        if at < stop:
            at = scan(buffer, base, at, stop, False, time, emit, lose, self._state)
        if finder.summed:
            self._sums[0].forget()
        return at

    # ------------------------------------------------------------------ losses

    def _leave_pending(self, found: list[Record], buffer: bytes, base: int) -> None:
        """Take what follows the last packet, from the first incomplete one on, for pending: the stream has ended."""
        last = 0
        if found:
            last = found[-1]._key + len(found[-1]._raw)
        for offset, size, reason, _ in self._losses:
            if reason.startswith("unknown"):
                last = max(last, offset + size)
        for index, (offset, _, reason, _) in enumerate(self._losses):
            if offset >= last and reason == "malformed: incomplete":
                del self._losses[index:]
                tail = buffer[offset - base :]
                self._cut_off += len(tail)
                self._losses.append((offset, len(tail), "pending", tail))
                return

    def _settle(self, found: list[Record], silent: bool) -> list[Record]:
        """Return records and losses in the order of the stream; join runs of equal losses."""
        out: list[Record] = []
        losses = self._losses
        at = 0
        for record in found:
            offset = record._key
            while at < len(losses) and losses[at][0] < offset:
                self.add_loss(losses[at], out)
                at += 1
            self.end_run(out)
            out.append(record)
        for loss in losses[at:]:
            self.add_loss(loss, out)
        losses.clear()
        if silent:
            self.end_run(out)
        return out

    def add_loss(self, loss: tuple[int, int, str, bytes], out: list[Record]) -> None:
        """Count a loss (offset, bytes, reason, data) and put it into the run that it goes on with."""
        offset, size, reason, data = loss
        if reason != "pending":
            self._counts.lose(size, reason)
        whole = not reason.startswith(("skipped", "malformed"))
        if self.run is not None and (whole or self.run[1] != reason):
            self.end_run(out)
        if whole:
            out.append(self._unknown(offset, reason, data))
            return
        if self.run is None:
            self.run = (offset, reason, bytearray())
        run = self.run[2]
        run += data
        while len(run) >= RUN:
            out.append(self._unknown(self.run[0], reason, bytes(run[:RUN])))
            self.run = (self.run[0] + RUN, reason, run)
            del run[:RUN]

    def end_run(self, out: list[Record]) -> None:
        """Report the run of equal losses, if there is one."""
        if self.run is not None:
            if self.run[2]:
                out.append(self._unknown(self.run[0], self.run[1], bytes(self.run[2])))
            self.run = None

    def _unknown(self, offset: int, reason: str, data: bytes) -> Unknown:
        direction = self.direction if self.direction != "both" else None
        return Unknown(
            reason, Meta(None, None, self.time, None, direction, data, offset=offset, size=len(data))
        )

    # ------------------------------------------------------------------ requests, and what tests look at

    def sent(self, data: bytes, time: float | None = None) -> None:
        """Note our own transmission, one packet: a request that replies may need. It is not counted and gives
        no record.
        """
        for decider, asked in self._asked:
            whole: dict[Framing, bool] = {}
            for message, framing, extras in asked:
                is_whole = whole.get(framing)
                if is_whole is None or extras is not None:
                    judged = framing.judge(data, 0, silent=True, extras=extras)
                    is_whole = judged.verdict is Verdict.WHOLE and judged.size == len(data)
                    whole[framing] = is_whole
                if is_whole and decider.note(message, framing.logical(data), 0, time, None, data):
                    return

    @property
    def buffered(self) -> int:
        """Bytes held back."""
        return len(self.buffer)

    @property
    def check_work(self) -> int:
        """Number of bytes that checks have read so far."""
        apart = sum(s.work for s in self._sums) + sum(s.checked for s in self._segments)
        return self._counts.decoded + self._counts.unknown + self._state.work + apart

    @property
    def unstuff_work(self) -> int:
        """Number of bytes that were unstuffed so far to find packets, both real and false ones."""
        if not self._segments:
            return 0
        return self._counts.decoded + self._counts.unknown + sum(segment.work for segment in self._segments)


def has_size(framing: Framing) -> bool:
    """Return whether packets of the framing have sync bytes and say their size: what `Finder` can search for."""
    return bool(framing.sync) and not (framing.end or framing.is_silent or framing.covers_request)


def _judge(
    framing: Framing, extras: dict[int, bytes] | None
) -> Callable[[bytes, int, bool], tuple[str, int, str]]:
    def judge(buffer: bytes, start: int, silent: bool) -> tuple[str, int, str]:
        return verdict_of(framing.judge(buffer, start, silent=silent, extras=extras), start)

    return judge


def _unstuffer(framing: Framing) -> Callable[[bytes], bytes | None]:
    def logical(packet: bytes) -> bytes | None:
        try:
            return framing.logical(packet)
        except ValueError:
            return None

    if isinstance(framing.stuffing, Insert):
        pattern = framing.stuffing.pattern
        start, size = framing.head_end, framing.check_size

        def quick(packet: bytes) -> bytes | None:
            if packet.find(pattern, start, len(packet) - size) < 0:
                return packet
            return logical(packet)

        return quick
    return logical
