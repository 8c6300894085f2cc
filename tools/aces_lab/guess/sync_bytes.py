"""Packets behind sync bytes: where these repeat, and which number behind them says how far it is to the next.

For each candidate sync (a byte, or a frequent pair) and each number behind it the distances to the next few occurrences
vote for the constant that is added to the number. Bits of evidence are against chance, less what all trials may give.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from math import log2
from typing import NamedTuple

import numpy as np

from aces_bus.protocol import Insert
from aces_bus.protocol.columns.table import Array

from .framings import LONGEST, PACKETS, FramingGuess, LengthRule, with_check
from .sample import Sample

#: Trials of sync bytes, offsets, widths and constants, in bits: so much any of them may reach by chance.
TRIALS_BITS = 20.0
#: Offsets behind the first sync byte at which a length may be, and what may be added to it.
OFFSETS, LEAST_CONSTANT, MOST_CONSTANT = 12, -4, 32
#: Next occurrences of sync bytes that a length may point at, pairs of bytes that are tried, occurrences that are seen.
AHEAD, PAIRS, OCCURRENCES = 6, 48, 2000
#: The longest packet of one fixed size.
FIXED = 512
#: Candidates that are tried with the scanner.
FINALISTS = 10
#: Constant header bytes below are rather numbers of devices than sync bytes.
LEAST_SYNC = 0x20


class _Vote(NamedTuple):
    bits: float
    sync: bytes
    length: LengthRule | None
    size: int | None
    hits: Array
    #: Bytes of the packets.
    covered: int


def synced(sample: Sample, free: list[tuple[int, int]]) -> Iterator[FramingGuess]:
    """Yield the likeliest framings with sync bytes of what is `free`, at most `FINALISTS`."""
    votes = [vote for vote in _votes(sample, free) if vote.bits > 0]
    by_bits = sorted(votes, key=lambda vote: -vote.bits)
    by_bytes = sorted(votes, key=lambda vote: -vote.covered)
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
            # What one size explains as well is not a length.
            usual = int(np.bincount(sizes).max())
            bits = _chain_bits(int(hits.sum()), count, density) - (8.0 if width == 2 else 0.0)
            if len(sizes) - usual < 3 and usual > 0.9 * len(sizes):
                continue
            yield _Vote(bits, sync, rule._replace(constant=constant), None, places[hits], int(sizes.sum()))


def _chain_bits(hits: int, count: int, density: float) -> float:
    """Return bits of evidence that `hits` of `count` places are followed by another one where a number says it."""
    share = hits / count
    if share <= density:
        return 0.0
    bits = share * log2(share / density)
    if share < 1:
        bits += (1 - share) * log2((1 - share) / (1 - density))
    return count * bits - TRIALS_BITS


def _of_vote(sample: Sample, vote: _Vote) -> FramingGuess:
    """Return a framing with all its sync bytes, its check and what is constant behind it."""
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
    guess = with_check(guess, some, least_share=0.8)
    if (
        guess.check is None
        and len(set(sync)) == 1
        and all(packet[len(sync) : len(sync) + 1] != sync[:1] for packet in packets)
    ):
        guess = replace(guess, not_next=sync[:1])
    return _stuffed(guess, packets)


def _wider(array: Array, hits: Array, length: LengthRule, first: int) -> LengthRule:
    """Return a length of one byte beside a byte that is hardly ever anything but 0 is one of two bytes: long packets
    are rare.
    """
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
    """Return a byte that is put in wherever the data would look like the sync bytes (Dynamixel 2)."""
    if len(guess.sync) < 3 or guess.length is None:
        return guess
    pattern = guess.sync[:3]
    byte = pattern[-1:]
    inside = [packet[3:] for packet in packets]
    there = sum(data.count(pattern) for data in inside)
    followed = sum(data.count(pattern + byte) for data in inside)
    if there < 2 or followed < there:
        return guess
    words = f"{pattern.hex(' ').upper()} inside of packets is always followed by {byte.hex().upper()} ({there} times)"
    return replace(guess, stuffing=Insert(pattern, byte), evidence=(*guess.evidence, words))
