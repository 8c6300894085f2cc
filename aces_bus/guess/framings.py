"""How packets stand in bytes of which nothing is known: sync, length, end, stuffing, check.

1. A guess is tried by the scanner that will read it: what it finds is what a draft with this framing decodes.
2. Evidence is counted in bits against chance: that the place where a length says the next packet begins has the sync
   bytes, a check that holds. What has less than `ENOUGH_BITS` is not said.
3. The search sees `SAMPLE` bytes; its work is bounded by that, whatever they are.

A framing with sync bytes shows itself where these repeat: the number at some offset behind them plus a constant is the
distance to the next. So for each candidate sync (a byte, or a frequent pair) and each number behind it the distances to the
next few occurrences vote for the constant. Lines and stuffed packets show themselves by what never occurs between two marks.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, pairwise
from math import log2
from typing import Any, Literal, NamedTuple

import numpy as np
from construct import Byte, GreedyBytes, Int16ub, Int16ul, Struct, this

from ..errors import AcesError
from ..protocol.columns.checks import parameters_of
from ..protocol.columns.table import Array
from ..protocol.declare.checks import Check, Crc, InvertedSum, Sum, Xor
from ..protocol.declare.framing import Framing
from ..protocol.declare.protocol import Protocol
from ..protocol.declare.stuffing import Cobs, Insert, Slip, Stuffing
from .checks import CheckGuess, check_source, checks_of_packets

#: Bytes that are searched; packets of which a check is sought.
SAMPLE, PACKETS = 1 << 16, 512
#: Evidence below which nothing is said, beyond what all trials give by chance.
ENOUGH_BITS = 30.0
#: Trials of sync bytes, offsets, widths and constants, in bits: so much any of them may reach by chance.
TRIALS_BITS = 20.0
#: Offsets behind the first sync byte at which a length may be, and what may be added to it.
OFFSETS, LEAST_CONSTANT, MOST_CONSTANT = 12, -4, 32
#: Next occurrences of sync bytes that a length may point at, pairs of bytes that are tried, occurrences that are seen.
AHEAD, PAIRS, OCCURRENCES = 6, 48, 2000
#: The longest packet of one fixed size, and the longest stretch without an end.
FIXED, LONGEST = 512, 4096
#: Candidates that are tried with the scanner.
FINALISTS = 10
#: Constant header bytes below are rather numbers of devices than sync bytes.
LEAST_SYNC = 0x20
#: Share of bytes that are characters where bytes are text.
TEXT = 0.97

Kind = Literal["length", "fixed", "lines", "enclosed", "silence"]


class LengthRule(NamedTuple):
    """Size of a packet in bytes = length + `constant`, with the length `width` bytes at `offset`."""

    offset: int
    width: int
    order: Literal["little", "big"]
    constant: int

    def sizes(self, data: Array, starts: Array) -> Array:
        """The size that each packet says, int64; `data` goes on far enough."""
        places = range(self.width) if self.order == "big" else reversed(range(self.width))
        number = np.zeros(len(starts), np.int64)
        for place in places:
            number = number << 8 | data[starts + self.offset + place]
        return number + self.constant

    @property
    def format(self) -> str:
        """The construct that reads the length."""
        return "Byte" if self.width == 1 else "Int16ub" if self.order == "big" else "Int16ul"


@dataclass(frozen=True)
class FramingGuess:
    """How packets of one kind stand in the bytes; `evidence` says why, a line each.

    `opcode` is where the bytes that say what a packet is are (offset, size), None where none do.
    """

    kind: Kind
    sync: bytes = b""
    length: LengthRule | None = None
    size: int | None = None
    end: bytes = b""
    gap_s: float | None = None
    stuffing: Stuffing | None = None
    not_next: bytes = b""
    check: CheckGuess | None = None
    #: A check in characters at the end of a line.
    written: Check | None = None
    #: Constant bytes behind the check.
    tail: bytes = b""
    opcode: tuple[int, int] | None = None
    max_size: int = 0
    bits: float = 0.0
    #: Packets that the scanner found, their bytes, and the share of the bytes that it looked at.
    packets: int = 0
    bytes: int = 0
    share: float = 0.0
    evidence: tuple[str, ...] = ()

    @property
    def confidence(self) -> float:
        """Between 0 and 1; without a check never above 0.9."""
        sure = 1 - 2.0 ** -max(self.bits / 4, 0.0)
        return float(sure if self.is_checked else 0.9 * sure)

    @property
    def is_checked(self) -> bool:
        """Whether its packets have a check."""
        return self.check is not None or self.written is not None

    @property
    def head_end(self) -> int:
        """Bytes up to the end of what is needed to read a packet: sync, length, opcode."""
        ends = [len(self.sync)]
        if self.kind == "lines":
            return ends[0]
        if self.length is not None:
            ends.append(self.length.offset + self.length.width)
        if self.opcode is not None:
            ends.append(sum(self.opcode))
        return max(ends)

    def head_fields(self) -> Iterator[tuple[str, str]]:
        """The header behind the sync bytes: names, and the constructs by theirs."""
        at = len(self.sync)
        if self.kind == "lines":
            return
        while at < self.head_end:
            if self.length is not None and at == self.length.offset:
                yield "length", self.length.format
                at += self.length.width
            elif self.opcode is not None and at == self.opcode[0]:
                yield "opcode", "Byte" if self.opcode[1] == 1 else "Int16ub"
                at += self.opcode[1]
            else:
                yield f"byte_{at}", "Byte"
                at += 1

    @property
    def stuffing_source(self) -> str:
        """The stuffing as a spec writes it."""
        if isinstance(self.stuffing, Insert):
            return f"Insert({self.stuffing.pattern!r}, {self.stuffing.byte!r})"
        return f"{type(self.stuffing).__name__}()"

    def as_dict(self) -> dict[str, Any]:
        """The guess in JSON's kinds."""
        found: dict[str, Any] = {"kind": self.kind, "confidence": round(self.confidence, 2)}
        if self.sync:
            found["sync"] = self.sync.hex(" ").upper()
        if self.length is not None:
            found["length"] = self.length._asdict()
        if self.size is not None:
            found["size"] = self.size
        if self.end:
            found["end"] = self.end.hex(" ").upper()
        if self.gap_s is not None:
            found["gap_s"] = self.gap_s
        if self.stuffing is not None:
            found["stuffing"] = type(self.stuffing).__name__
        if self.check is not None:
            found["check"] = self.check.declared
        if self.written is not None:
            found["check"] = check_source(self.written)
        if self.opcode is not None:
            found["opcode"] = list(self.opcode)
        return {
            **found,
            "packets": self.packets,
            "share": round(self.share, 4),
            "evidence": list(self.evidence),
        }


def framing_check(guess: FramingGuess) -> Check | None:
    """The check of a framing as a declaration takes it; None where there is none, or none that can be said.

    Constant bytes behind a CRC become part of a longer one: x⁸ times the polynomial, and the bytes as its final value.
    """
    found = guess.check
    if found is None:
        return guess.written
    check = found.check
    over = [slice(start, stop) for start, stop in found.covers]
    if guess.stuffing is not None and guess.end:
        over = [slice(one.start, (one.stop or 0) - len(guess.end)) for one in over]
    if not guess.tail:
        return _with_over(check, over)
    if not isinstance(check, Crc) or check.order != "big":
        return None
    width, poly, init, refin, refout, xorout = parameters_of(check)
    if refin or refout:
        return None
    more = 8 * len(guess.tail)
    if width + more > 64:
        return None
    return Crc(
        width=width + more,
        poly=poly << more,
        init=init << more,
        xorout=xorout << more | int.from_bytes(guess.tail, "big"),
        over=[slice(one.start, (one.stop or 0)) for one in over],
        order="big",
    )


def _with_over(check: Check, over: list[slice]) -> Check:
    from copy import copy

    made = copy(check)
    constants = [part for part in check.over or () if isinstance(part, bytes)]
    made.over = (*constants, *over)
    return made


def declare_framing(protocol: Protocol, guess: FramingGuess, name: str) -> Framing:
    """The framing in a protocol, as the draft declares it; raises `SpecError` where the language cannot say it."""
    constructs = {"Byte": Byte, "Int16ub": Int16ub, "Int16ul": Int16ul}
    fields = [name / constructs[construct] for name, construct in guess.head_fields()]
    more: dict[str, Any] = {"header": Struct(*fields)} if fields else {}
    if guess.length is not None:
        more["size"] = this.length + guess.length.constant
    elif guess.size is not None:
        more["size"] = guess.size
    elif guess.kind == "silence":
        more["end"] = "silence"
    else:
        more["end"] = guess.end
    check = framing_check(guess)
    if check is not None:
        more["check"] = check
    if guess.gap_s is not None:
        more["gap"] = guess.gap_s
    if guess.not_next:
        more["not_next"] = guess.not_next
    return protocol.framing(
        name=name, sync=guess.sync, stuffing=guess.stuffing, max_size=guess.max_size or None, **more
    )


class Span(NamedTuple):
    """A packet: where it begins and ends, and of which framing it is."""

    start: int
    end: int
    framing: int


def spans_of(
    guesses: Sequence[FramingGuess], lines: Iterable[Iterable[tuple[bytes, float | None]]]
) -> list[list[Span]]:
    """The packets that a draft with these framings decodes in the chunks of each line, offsets from its first byte on."""
    protocol = Protocol("draft", link="serial")
    names: dict[str, int] = {}
    for number, guess in enumerate(guesses):
        name = f"Packet{number}"
        declare_framing(protocol, guess, f"framing {number}")(name, payload=Struct("data" / GreedyBytes))
        names[name] = number
    scanner = protocol.scanner()
    gap = min((one.gap_s for one in guesses if one.gap_s is not None), default=None)
    found: list[list[Span]] = []
    for line in lines:
        scanner.reset()
        records: list[Any] = []
        last: float | None = None
        for data, time in line:
            if gap is not None and time is not None and last is not None and time - last > gap:
                records += scanner.idle()
            records += scanner.feed(data)
            last = time
        records += scanner.idle() if gap is not None else []
        records += scanner.close()
        placed = ((record.meta, names.get(record.meta.message or "")) for record in records)
        found.append(
            [
                Span(meta.offset, meta.offset + meta.size, number)
                for meta, number in placed
                if number is not None
            ]
        )
    return found


# ---------------------------------------------------------------------- the search


@dataclass
class Sample:
    """Bytes of one or several lines, one behind the other, of which some are already in packets."""

    data: bytes
    #: Where lines begin, and the end of the last.
    borders: list[int]
    #: Where times are known: pauses (s), and the stretches (start, end) between pauses that are longer.
    silences: list[tuple[float, list[tuple[int, int]]]] = field(
        default_factory=list[tuple[float, list[tuple[int, int]]]]
    )
    taken: list[Span] = field(default_factory=list[Span])

    def __post_init__(self) -> None:
        self.array: Array = np.frombuffer(self.data, np.uint8)

    def free(self) -> list[tuple[int, int]]:
        """The stretches in no packet."""
        edges = sorted({*self.borders, 0, len(self.data)})
        found: list[tuple[int, int]] = []
        taken = sorted(self.taken)
        at = 0
        for low, high in pairwise(edges):
            start = low
            while at < len(taken) and taken[at].start < high:
                if taken[at].start > start:
                    found.append((start, taken[at].start))
                start = max(start, taken[at].end)
                at += 1
            if start < high:
                found.append((start, high))
        return found


def framings_of(sample: Sample) -> list[FramingGuess]:
    """The framings of the bytes, the one with most of them first; none that has too little evidence."""
    found: list[FramingGuess] = []
    total = max(len(sample.data), 1)
    for _ in range(4):
        free = sample.free()
        left = sum(end - start for start, end in free)
        if left < max(8, 0.02 * total):
            break
        judged: list[tuple[tuple[float, ...], FramingGuess, list[Span]]] = []
        for candidate in _candidates(sample, free):
            one = _judged(sample, candidate, len(found), left)
            if one is not None:
                judged.append(one)
                if one[1].is_checked and one[1].share > 0.98 and one[1].kind != "silence" and one[0][2]:
                    break
        judged.sort(key=lambda one: one[0], reverse=True)
        best = next((one for one in judged if _go_together([*found, one[1]])), None)
        if best is None:
            break
        found.append(best[1])
        sample.taken += best[2]
    return found


def _go_together(guesses: Sequence[FramingGuess]) -> bool:
    """Whether one protocol can have these framings: no packet may be of two."""
    try:
        spans_of(guesses, ())
    except AcesError:
        return False
    return True


def _judged(
    sample: Sample, guess: FramingGuess, number: int, left: int
) -> tuple[tuple[float, ...], FramingGuess, list[Span]] | None:
    """How good a guess is by what the scanner finds with it in the bytes that are left."""
    free = sample.free()
    try:
        some = spans_of([guess], [[(sample.data[start:end], None)] for start, end in free])
    except AcesError:
        return None
    spans = [
        Span(one.start + start, one.end + start, number)
        for (start, _), found in zip(free, some, strict=True)
        for one in found
    ]
    if guess.kind == "silence":
        bursts = dict(sample.silences)[guess.gap_s or 0.0]
        spans = [Span(start, end, number) for start, end in bursts]
    covered = sum(one.end - one.start for one in spans)
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
    yield from _synced(sample, free)
    yield from _bursts(sample)


# ---------------------------------------------------------------------- lines of characters


_CHARACTERS = np.zeros(256, bool)
_CHARACTERS[32:127] = _CHARACTERS[[9, 10, 13]] = True
#: A line among other bytes.
_SENTENCE = re.compile(rb"[!$#][ -~]{4,}\r?\n")
#: A check at the end of a line: a character that is no digit, then hexadecimal digits.
_WRITTEN = re.compile(rb"([^0-9A-Za-z])([0-9A-Fa-f]{2}|[0-9A-Fa-f]{4})$")


def _lines(sample: Sample, free: list[tuple[int, int]]) -> Iterator[FramingGuess]:
    """Text that ends by a line end, of each first character a framing."""
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
        packets = [one for start, end in free for one in sample.data[start:end].split(mark)[1:-1] if one]
        packets = packets[:PACKETS]
        if len(packets) < 4:
            continue
        plain: list[bytes] = []
        for one in packets:
            try:
                plain.append(stuffing.unstuff(one))
            except ValueError:
                continue
        if len(plain) < 0.9 * len(packets):
            continue
        if name == "COBS":
            # A wrong block ends anywhere; a right one at the mark.
            bits = sum(min(log2(1 + len(one)), 6.0) for one in plain) - len(packets)
            words = f"between zeros {len(plain)} of {len(packets)} packets are whole COBS blocks"
        else:
            escapes = sum(one.count(b"\xdb") for one in packets)
            bits = 7.0 * escapes + 2.0 * sum(1 for one in packets if len(one) > 64)
            words = f"between C0 {len(plain)} of {len(packets)} packets have DB before DC and DD only ({escapes} times)"
        most = max(map(len, packets))
        guess = FramingGuess(
            "enclosed", end=mark, stuffing=stuffing, max_size=max(64, 2 * most), bits=bits, evidence=(words,)
        )
        yield _with_check(guess, plain)


def _with_check(guess: FramingGuess, packets: Sequence[bytes], least_share: float = 0.9) -> FramingGuess:
    """The guess with the check at the end of its packets, if there is one."""
    for check in sorted(checks_of_packets(packets, least_share=least_share), key=lambda one: -one.bits):
        behind = -check.offset - check.size
        tails = Counter(packet[len(packet) - behind :] for packet in packets)
        tail, count = tails.most_common(1)[0]
        if check.covers[-1][1] is None or (behind and count < 0.9 * len(packets)):
            continue
        words = [check.evidence]
        if tail:
            words.append(f"{tail.hex(' ').upper()} behind the check of {count} packets")
        return replace(
            guess, check=check, tail=tail, bits=guess.bits + check.bits, evidence=(*guess.evidence, *words)
        )
    return guess


# ---------------------------------------------------------------------- packets behind sync bytes


class _Vote(NamedTuple):
    bits: float
    sync: bytes
    length: LengthRule | None
    size: int | None
    hits: Array
    #: Bytes of the packets.
    covered: int


def _synced(sample: Sample, free: list[tuple[int, int]]) -> Iterator[FramingGuess]:
    votes = [vote for vote in _votes(sample, free) if vote.bits > 0]
    by_bits = sorted(votes, key=lambda one: -one.bits)
    by_bytes = sorted(votes, key=lambda one: -one.covered)
    seen: set[tuple[object, ...]] = set()
    for vote in chain.from_iterable(zip(by_bits, by_bytes, strict=True)):
        guess = _of_vote(sample, vote)
        key = guess.sync, guess.length, guess.size
        if key not in seen:
            seen.add(key)
            yield guess
        if len(seen) == FINALISTS:
            return


def _votes(sample: Sample, free: list[tuple[int, int]]) -> Iterator[_Vote]:
    array = sample.array
    ends = np.array(sorted({end for _, end in free}), np.int64)
    starts = np.concatenate([np.arange(start, max(start, end - 2)) for start, end in free])
    if len(starts) < 8:
        return
    padded = np.concatenate([array, np.zeros(OFFSETS + 4, np.uint8)])
    firsts = array[starts]
    pairs = firsts.astype(np.int64) << 8 | array[starts + 1]
    chosen: list[tuple[bytes, Array]] = []
    counts = np.bincount(firsts, minlength=256)
    for byte in np.flatnonzero((counts >= 3) & (counts <= len(starts) / 3)).tolist():
        chosen.append((bytes([byte]), starts[firsts == byte]))
    common = Counter(dict(enumerate(np.bincount(pairs, minlength=65536).tolist()))).most_common(PAIRS)
    for pair, count in common:
        if count >= 3:
            chosen.append((pair.to_bytes(2, "big"), starts[pairs == pair]))
    for sync, places in chosen:
        yield from _votes_of(sync, places[:OCCURRENCES], ends, padded, len(starts))


def _votes_of(sync: bytes, places: Array, ends: Array, padded: Array, total: int) -> Iterator[_Vote]:
    count = len(places)
    stops = np.unique(np.concatenate([places, ends[ends > places[0]]]))
    following = np.searchsorted(stops, places, "right")[:, None] + np.arange(AHEAD)
    inside = following < len(stops)
    distance = stops[np.minimum(following, len(stops) - 1)] - places[:, None]
    distance[~inside] = 1 << 40
    density = min(len(stops) / total, 0.5)
    # One size for all.
    near = distance[(distance >= 3) & (distance <= FIXED)]
    if len(near):
        numbers = np.bincount(near)
        size = int(np.argmax(numbers))
        hits = (distance == size).any(axis=1)
        yield _Vote(
            _chain_bits(int(hits.sum()), count, density),
            sync,
            None,
            size,
            places[hits],
            int(hits.sum()) * size,
        )
    # A number behind the sync bytes says it.
    for offset in range(len(sync), OFFSETS):
        for width, order in ((1, "big"), (2, "little"), (2, "big")):
            rule = LengthRule(offset, width, order, 0)  # type: ignore[arg-type]
            said = rule.sizes(padded, places)
            rest = distance - said[:, None]
            good = (rest >= LEAST_CONSTANT) & (rest <= MOST_CONSTANT)
            if good.sum() < 3:
                continue
            numbers = np.bincount(rest[good] - LEAST_CONSTANT)
            constant = int(np.argmax(numbers)) + LEAST_CONSTANT
            hits = (rest == constant).any(axis=1) & (said + constant >= offset + width)
            sizes = said[hits] + constant
            if len(sizes) < 3 or len(np.unique(sizes)) < 2:
                continue
            # What one size explains as well is no length.
            usual = int(np.bincount(sizes).max())
            bits = _chain_bits(int(hits.sum()), count, density) - (8.0 if width == 2 else 0.0)
            if len(sizes) - usual < 3 and usual > 0.9 * len(sizes):
                continue
            yield _Vote(bits, sync, rule._replace(constant=constant), None, places[hits], int(sizes.sum()))


def _chain_bits(hits: int, count: int, density: float) -> float:
    """Bits of evidence that `hits` of `count` places are followed by another one where a number says it."""
    share = hits / count
    if share <= density:
        return 0.0
    bits = share * log2(share / density)
    if share < 1:
        bits += (1 - share) * log2((1 - share) / (1 - density))
    return count * bits - TRIALS_BITS


def _of_vote(sample: Sample, vote: _Vote) -> FramingGuess:
    """A framing with all its sync bytes, its check and what is constant behind it."""
    array, hits = sample.array, vote.hits
    sync, length, size = vote.sync, vote.length, vote.size
    first_border = set(sample.borders)
    # The packet may begin before the byte that was found.
    while len(sync) < 4 and not (first_border & set(hits.tolist())):
        before = array[hits - 1]
        if (before != before[0]).any() or before[0] < LEAST_SYNC:
            break
        sync, hits = bytes([int(before[0])]) + sync, hits - 1
        if length is not None:
            length = length._replace(offset=length.offset + 1)
    sizes = (
        length.sizes(np.concatenate([array, np.zeros(64, np.uint8)]), hits) if length is not None else None
    )
    ends = hits + (sizes if sizes is not None else size)
    whole = ends <= len(array)
    hits, ends = hits[whole], ends[whole]
    packets = [sample.data[start:end] for start, end in zip(hits.tolist(), ends.tolist(), strict=True)]
    length = length and _wider(array, hits, length, len(sync))
    while len(sync) > 2 and 0 < sync[-1] < LEAST_SYNC:
        sync = sync[:-1]
    limit = length.offset if length is not None else (size or 0)
    least = min(map(len, packets), default=0)
    while len(sync) < min(4, limit, least):
        at = len(sync)
        values = {packet[at] for packet in packets}
        if len(values) > 1 or not (min(values) >= LEAST_SYNC or (min(values) == 0 and at > 1)):
            break
        sync += bytes([min(values)])
    most = max(map(len, packets), default=8)
    words = f"{sync.hex(' ').upper()} where the {len(hits)} packets before end, by " + (
        f"the {8 * length.width}-bit number at byte {length.offset}"
        f"{f' ({length.order} endian)' if length.width > 1 else ''} plus {length.constant}"
        if length is not None
        else f"their size of {size} bytes"
    )
    guess = FramingGuess(
        "length" if length is not None else "fixed",
        sync,
        length,
        size,
        max_size=_max_size(length, most),
        bits=vote.bits,
        evidence=(words,),
    )
    some = [
        packets[n] for n in np.linspace(0, len(packets) - 1, min(len(packets), PACKETS)).astype(int).tolist()
    ]
    guess = _with_check(guess, some, least_share=0.8)
    if (
        guess.check is None
        and len(set(sync)) == 1
        and all(packet[len(sync) : len(sync) + 1] != sync[:1] for packet in packets)
    ):
        guess = replace(guess, not_next=sync[:1])
    return _stuffed(guess, packets)


def _wider(array: Array, hits: Array, length: LengthRule, first: int) -> LengthRule:
    """A length of one byte beside a byte that is hardly ever anything but 0 is one of two bytes: long packets are rare."""
    if length.width > 1:
        return length
    behind = array[np.minimum(hits + length.offset + 1, len(array) - 1)]
    if (behind != 0).mean() < 0.05:
        return length._replace(width=2, order="little")
    before = array[hits + length.offset - 1]
    if length.offset > first and (before != 0).mean() < 0.05:
        return length._replace(offset=length.offset - 1, width=2, order="big")
    return length


def _max_size(length: LengthRule | None, most: int) -> int:
    if length is None:
        return most
    if length.width == 1:
        return 255 + length.constant
    return min(LONGEST, max(256, 1 << (2 * most - 1).bit_length()))


def _stuffed(guess: FramingGuess, packets: Sequence[bytes]) -> FramingGuess:
    """A byte that is put in wherever the data would look like the sync bytes (Dynamixel 2)."""
    if len(guess.sync) < 3 or guess.length is None:
        return guess
    pattern = guess.sync[:3]
    byte = pattern[-1:]
    inside = [packet[3:] for packet in packets]
    there = sum(one.count(pattern) for one in inside)
    followed = sum(one.count(pattern + byte) for one in inside)
    if there < 2 or followed < there:
        return guess
    words = f"{pattern.hex(' ').upper()} inside of packets is always followed by {byte.hex().upper()} ({there} times)"
    return replace(guess, stuffing=Insert(pattern, byte), evidence=(*guess.evidence, words))


# ---------------------------------------------------------------------- packets between silences


def _bursts(sample: Sample) -> Iterator[FramingGuess]:
    for gap, bursts in sample.silences:
        packets = [sample.data[start:end] for start, end in bursts][:PACKETS]
        if len(packets) < 4:
            continue
        words = f"{len(bursts)} packets with silences of more than {1000 * gap:.3g} ms between them"
        most = min(LONGEST, max(64, 2 * max(map(len, packets))))
        guess = _with_check(FramingGuess("silence", gap_s=gap, max_size=most, evidence=(words,)), packets)
        if guess.check is not None:
            yield guess
