"""Which frame answers which: requests and replies, by their order, their delay, and what the one repeats of the other.

1. A reply mostly comes next after its request, and soon. Frames that a clock sends one after the other do so too: a pair of
   those is only said where bytes of the request come back, or the identifiers are a pair by an open standard.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from aces_bus import FrameTable
from aces_bus._lazy import np
from aces_bus.frame_table import NO_TIME
from aces_bus.frames import EXTENDED, REMOTE
from aces_bus.protocol.record import PlainValue

from .fields import Array

#: Identifiers among which pairs are sought, and frames that are looked at.
AMONG, LOOKED_AT = 1024, 200_000
#: Replies, the share of them that come right after the request, and of requests that are answered.
TIMES, NEXT, ANSWERED = 6, 0.8, 0.5
#: A reply comes within so many ns.
SOON_NS = 200_000_000
#: Different steps that a byte must have made for its coming back to be no accident.
VALUES = 3


@dataclass(frozen=True)
class PairGuess:
    """A request and its reply (keys), the median delay, and what speaks for it."""

    request: int
    reply: int
    count: int
    delay_ns: int | None
    confidence: float
    evidence: str

    def as_dict(self) -> dict[str, PlainValue]:
        """Return the guess in JSON's kinds."""
        return {
            "request": self.request & 0x1FFF_FFFF,
            "reply": self.reply & 0x1FFF_FFFF,
            "count": self.count,
            "delay_ms": None if self.delay_ns is None else self.delay_ns / 1e6,
            "confidence": round(self.confidence, 2),
            "evidence": self.evidence,
        }


def pairs_of(frames: FrameTable, clocked: Collection[int] = ()) -> list[PairGuess]:
    """Return the pairs among frames in the order of a recording, surest first; frames of `clocked` keys come by themselves.

    Several frames of one identifier in a row are one turn: what answers in several frames answers once.
    """
    found: dict[int, PairGuess] = {}
    frames = frames.take(slice(0, LOOKED_AT))
    for some in (frames, frames.take(~np.isin(frames.key, np.array(list(clocked), np.uint32)))):
        for pair in _pairs_among(some):
            best = found.get(pair.reply)
            if best is None or (best.confidence, best.count) < (pair.confidence, pair.count):
                found[pair.reply] = pair
    return sorted(found.values(), key=lambda pair: -pair.confidence)


def _pairs_among(frames: FrameTable) -> Iterator[PairGuess]:
    if len(frames) < 2:
        return
    is_same = (frames.key[1:] == frames.key[:-1]) & (frames.channel[1:] == frames.channel[:-1])
    frames = frames.take(np.concatenate([[True], ~is_same]))
    keys, codes, counts = np.unique(frames.key, return_inverse=True, return_counts=True)
    if not 2 <= len(keys) <= AMONG:
        return
    same = frames.channel[1:] == frames.channel[:-1]
    first, second = codes[:-1], codes[1:]
    pairs = np.bincount(first[same] * len(keys) + second[same], minlength=len(keys) ** 2)
    follow = pairs.reshape(len(keys), len(keys))
    for reply, request in enumerate(np.argmax(follow, axis=0).tolist()):
        times = int(follow[request, reply])
        if (
            request == reply
            or times < TIMES
            or times < NEXT * counts[reply]
            or times < ANSWERED * counts[request]
        ):
            continue
        at = np.flatnonzero(same & (first == request) & (second == reply))
        asked = np.flatnonzero(codes == request)
        guess = _judged(frames, int(keys[request]), int(keys[reply]), at, asked, times, int(counts[reply]))
        if guess is not None:
            yield guess


def _judged(
    frames: FrameTable, request: int, reply: int, at: Array, asked: Array, times: int, replies: int
) -> PairGuess | None:
    """Return the pair, where more speaks for it than the order; `at` are the rows of the requests that are followed by
    a reply.
    """
    before, after = frames.time[at], frames.time[at + 1]
    timed = (before != NO_TIME) & (after != NO_TIME)
    delays = (after - before)[timed]
    delay = int(np.median(delays)) if len(delays) else None
    if delay is not None and not 0 <= delay <= SOON_NS:
        return None
    evidence = [f"{times} of {replies} come right after it"]
    confidence = 0.0
    if delay is not None:
        evidence.append(f"{delay / 1e6:.3g} ms later")
        gaps = np.diff(frames.time[asked])
        gaps = gaps[gaps > 0]
        if len(gaps) > TIMES and len(delays) > TIMES:
            spread = float(np.subtract(*np.quantile(gaps, (0.9, 0.1)))) / float(np.median(gaps))
            if spread > 0.5 and delay < 0.2 * np.median(gaps):
                confidence += 0.5
                evidence.append("requests come at no fixed rate")
    if (echo := _echo(frames, at)) is not None:
        confidence += 0.5
        evidence.append(echo)
    if (standard := _standard(request, reply)) is not None:
        confidence += 0.4
        evidence.append(standard)
    if confidence < 0.4:
        return None
    return PairGuess(request, reply, times, delay, min(0.95, confidence), "; ".join(evidence))


def _echo(frames: FrameTable, at: Array) -> str | None:
    """Return a byte of the reply that is a byte of the request, always as much higher."""
    at = at[:2000]
    size = min(8, int(frames.length[at].min()), int(frames.length[at + 1].min()))
    asked, answered = frames.data[at, :size], frames.data[at + 1, :size]
    for byte in range(size):
        steps, repeats = np.unique(np.diff(asked[:, byte]), return_counts=True)
        if len(steps) < VALUES or repeats.max() > 0.9 * len(at):
            continue  # it never changes, or counts: whatever counts, too, is not an answer
        for place in range(size):
            values, counts = np.unique(answered[:, place] - asked[:, byte], return_counts=True)
            if counts.max() >= 0.95 * len(at):
                more = int(values[np.argmax(counts)])
                return f"its byte {place} is byte {byte} of the request" + (
                    f" + 0x{more:02X}" if more else ""
                )
    return None


def _standard(request: int, reply: int) -> str | None:
    """Say why an open standard makes two identifiers a pair; return None if none does."""
    if request & REMOTE and request & ~REMOTE == reply:
        return "a remote frame asks for it"
    if not (request | reply) & EXTENDED:
        if 0x600 < request < 0x680 and reply == request - 0x80:
            return "identifiers of a CANopen SDO server"
        if 0x7E0 <= request < 0x7E8 and reply == request + 8:
            return "identifiers of ISO 15765-4"
    elif request >> 16 & 0x3FF in (0xDA, 0xEA) and request >> 8 & 0xFF == reply & 0xFF:
        return "addresses are swapped"
    return None
