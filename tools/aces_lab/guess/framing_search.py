"""Which framings bytes have: lines of characters, packets between marks, behind sync bytes, between silences.

1. A guess is tried by the scanner that will read it: what it finds is what a draft with this framing decodes.
2. What has less than `ENOUGH_BITS` of evidence is not said.

Lines and stuffed packets show themselves by what never occurs between two marks, packets behind sync bytes by numbers that
say where the next one begins (`sync_bytes`), packets between silences by a check that holds in each.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from math import log2

import numpy as np

from aces_bus.errors import AcesError
from aces_bus.protocol import Check, Cobs, InvertedSum, Slip, Sum, Xor

from .framings import LONGEST, PACKETS, FramingGuess, spans_of, with_check
from .sample import Sample, Span
from .sync_bytes import synced

#: Evidence below which nothing is said, beyond what all trials give by chance.
ENOUGH_BITS = 30.0
#: Share of bytes that are characters where bytes are text.
TEXT = 0.97


def framings_of(sample: Sample) -> list[FramingGuess]:
    """Return the framings of the bytes, the one with most of them first; none that has too little evidence."""
    found: list[FramingGuess] = []
    total = max(len(sample.data), 1)
    for _ in range(4):
        free = sample.free()
        left = sum(end - start for start, end in free)
        if left < max(8, 0.02 * total):
            break
        judged: list[tuple[tuple[float, ...], FramingGuess, list[Span]]] = []
        for candidate in _candidates(sample, free):
            verdict = _judged(sample, candidate, len(found), left)
            if verdict is not None:
                judged.append(verdict)
                if (
                    verdict[1].is_checked
                    and verdict[1].share > 0.98
                    and verdict[1].kind != "silence"
                    and verdict[0][2]
                ):
                    break
        judged.sort(key=lambda verdict: verdict[0], reverse=True)
        best = next((verdict for verdict in judged if _go_together([*found, verdict[1]])), None)
        if best is None:
            break
        found.append(best[1])
        sample.taken += best[2]
    return found


def _go_together(guesses: Sequence[FramingGuess]) -> bool:
    """Return whether one protocol can have these framings: no packet may be of two."""
    try:
        spans_of(guesses, ())
    except AcesError:
        return False
    return True


def _judged(
    sample: Sample, guess: FramingGuess, number: int, left: int
) -> tuple[tuple[float, ...], FramingGuess, list[Span]] | None:
    """Return how good a guess is by what the scanner finds with it in the bytes that are left."""
    free = sample.free()
    try:
        some = spans_of([guess], [[(sample.data[start:end], None)] for start, end in free])
    except AcesError:
        return None
    spans = [
        Span(candidate.start + start, candidate.end + start, number)
        for (start, _), found in zip(free, some, strict=True)
        for candidate in found
    ]
    if guess.kind == "silence":
        bursts = dict(sample.silences)[guess.gap_s or 0.0]
        spans = [Span(start, end, number) for start, end in bursts]
    covered = sum(span.end - span.start for span in spans)
    share = covered / max(left, 1)
    if guess.bits < ENOUGH_BITS or len(spans) < 3 or share < 0.02:
        return None
    made = replace(guess, packets=len(spans), bytes=covered, share=share)
    # What has a check is sure; beyond that, what explains plainly more. Where bytes are constant behind a packet, it could
    # as well begin with them: recordings begin with packets. Two sync bytes are seldom one that repeats; and three packets
    # are no one packet.
    begins = any(span.start in sample.borders for span in spans)
    sure = round(share + (1.0 if share > 0.1 else 0.25) * guess.is_checked, 1)
    rank = (sure, guess.kind == "lines", begins, len(guess.sync) > 1, guess.bits * len(spans))
    return rank, made, spans


def _candidates(sample: Sample, free: list[tuple[int, int]]) -> Iterator[FramingGuess]:
    yield from _lines(sample, free)
    yield from _enclosed(sample, free)
    yield from synced(sample, free)
    yield from _bursts(sample)


# ---------------------------------------------------------------------- lines of characters


_CHARACTERS = np.zeros(256, bool)
_CHARACTERS[32:127] = _CHARACTERS[[9, 10, 13]] = True
#: A line among other bytes.
_SENTENCE = re.compile(rb"[!$#][ -~]{4,}\r?\n")
#: A check at the end of a line: a character that is not a digit, then hexadecimal digits.
_WRITTEN = re.compile(rb"([^0-9A-Za-z])([0-9A-Fa-f]{2}|[0-9A-Fa-f]{4})$")


def _lines(sample: Sample, free: list[tuple[int, int]]) -> Iterator[FramingGuess]:
    """Yield framings of text lines, one for each first character."""
    texts: list[bytes] = []
    for start, stop in free:
        data = sample.data[start:stop]
        is_text = _CHARACTERS[np.frombuffer(data, np.uint8)].mean() >= TEXT
        texts += [data] if is_text else _SENTENCE.findall(data)
    if not texts:
        return
    whole = b"".join(texts)
    if whole.count(b"\n") >= 3:
        end = b"\r\n" if whole.count(b"\r\n") >= 0.9 * whole.count(b"\n") else b"\n"
    elif whole.count(b"\r") >= 3:
        end = b"\r"
    else:
        return
    lines = [line for text in texts for line in text.split(end)[:-1] if line]
    if len(lines) < 3:
        return
    firsts = Counter(line[:1] for line in lines)
    for first, count in firsts.most_common(2):
        if count < max(3, 0.02 * len(lines)) or first.isalnum():
            continue
        yield _of_lines([line for line in lines if line[:1] == first], first, end)
    if firsts.most_common(1)[0][0].isalnum():
        yield _of_lines(lines, b"", end)


def _of_lines(lines: list[bytes], sync: bytes, end: bytes) -> FramingGuess:
    most = max(map(len, lines)) + len(end)
    evidence = [f"{len(lines)} lines of characters end with {end!r}"]
    if sync:
        evidence.append(f"each begins with {sync!r}")
    # A line end at the same character every time, where 98 others might be.
    guess = FramingGuess(
        "lines", sync, end=end, max_size=max(128, 2 * most), bits=6.0 * len(lines), evidence=tuple(evidence)
    )
    written = [(line, _WRITTEN.search(line)) for line in lines]
    marks = Counter((m[1], len(m[2])) for _, m in written if m is not None)
    if not marks or marks.most_common(1)[0][1] < 0.9 * len(lines):
        return guess
    mark, digits = marks.most_common(1)[0][0]
    for make in (Xor, Sum, InvertedSum, partial(Sum, negated=True)) if digits == 2 else ():
        text = f"{mark.decode()}{{:0{digits}X}}"
        check: Check = make(text=text)
        agreeing = sum(
            check.same(line[m.start() :], check.encode(line[len(sync) : m.start()]))
            for line, m in written
            if m is not None
        )
        if agreeing >= max(3, 0.8 * len(lines)):
            words = f"{check.describe} of what is before, written as {text!r}, in {agreeing} of {len(lines)} lines"
            return replace(
                guess, written=check, bits=guess.bits + 8.0 * (agreeing - 1), evidence=(*evidence, words)
            )
    return guess


# ---------------------------------------------------------------------- packets between marks, stuffed


def _enclosed(sample: Sample, free: list[tuple[int, int]]) -> Iterator[FramingGuess]:
    for name, mark, stuffing in (("COBS", b"\0", Cobs()), ("SLIP", b"\xc0", Slip())):
        packets = [
            packet for start, end in free for packet in sample.data[start:end].split(mark)[1:-1] if packet
        ]
        packets = packets[:PACKETS]
        if len(packets) < 4:
            continue
        plain: list[bytes] = []
        for packet in packets:
            try:
                plain.append(stuffing.unstuff(packet))
            except ValueError:
                continue
        if len(plain) < 0.9 * len(packets):
            continue
        if name == "COBS":
            # A wrong block ends anywhere; a right one at the mark.
            bits = sum(min(log2(1 + len(packet)), 6.0) for packet in plain) - len(packets)
            words = f"between zeros {len(plain)} of {len(packets)} packets are whole COBS blocks"
        else:
            escapes = sum(packet.count(b"\xdb") for packet in packets)
            bits = 7.0 * escapes + 2.0 * sum(1 for packet in packets if len(packet) > 64)
            words = f"between C0 {len(plain)} of {len(packets)} packets have DB before DC and DD only ({escapes} times)"
        most = max(map(len, packets))
        guess = FramingGuess(
            "enclosed", end=mark, stuffing=stuffing, max_size=max(64, 2 * most), bits=bits, evidence=(words,)
        )
        yield with_check(guess, plain)


# ---------------------------------------------------------------------- packets between silences


def _bursts(sample: Sample) -> Iterator[FramingGuess]:
    for gap, bursts in sample.silences:
        packets = [sample.data[start:end] for start, end in bursts][:PACKETS]
        if len(packets) < 4:
            continue
        words = f"{len(bursts)} packets with silences of more than {1000 * gap:.3g} ms between them"
        most = min(LONGEST, max(64, 2 * max(map(len, packets))))
        guess = with_check(FramingGuess("silence", gap_s=gap, max_size=most, evidence=(words,)), packets)
        if guess.check is not None:
            yield guess
