"""How much a scanner may read of a stream: law 7 in figures, from where packets may begin in it."""

from __future__ import annotations

from collections.abc import Sequence

from ..protocol.declare.framing import Framing
from ..protocol.live.candidates import CHAINS

#: A check may cost this many bytes for a candidate besides the sums of its bytes (law 7: O(1)).
PER_CANDIDATE = 16


def candidates_in(framing: Framing, seen: bytes, begin: int) -> Sequence[int]:
    """Return where a packet of a framing may begin."""
    if not framing.sync:
        return range(begin, len(seen))
    found: list[int] = []
    at = seen.find(framing.sync, begin)
    while at >= 0:
        found.append(at)
        at = seen.find(framing.sync, at + 1)
    return found


def work_allowed(framings: Sequence[Framing], traffic: bytes, chunks: int) -> int:
    """Return how many bytes checks may read in `traffic`."""
    limit = len(traffic)  # each byte of an accepted packet once
    for framing in framings:
        if framing.check is None:
            continue
        candidates = len(candidates_in(framing, traffic, 0))
        is_whole = framing.end and framing.stuffing is None  # the bytes on the wire are what is summed
        is_read_anew = framing.check.kind == "crc" or framing.covers_request or framing.check_behind
        if is_read_anew or not ((framing.sync and not framing.end) or is_whole):
            limit += framing.max_size * candidates
            if len(framings) > 1:
                # While another framing waits at the same offset, each chunk has the candidate read again.
                limit += framing.max_size * chunks
        else:
            # Each framing sums by itself, and sums anew behind a packet whose check has failed.
            limit += 2 * len(traffic) + PER_CANDIDATE * candidates
    return limit


def unstuffing_allowed(framings: Sequence[Framing], traffic: bytes, chunks: int) -> int:
    """Return how many bytes may be unstuffed in `traffic`: a few times all of them, and a small part of a packet a
    candidate.
    """
    limit = 0
    for framing in framings:
        if framing.is_enclosed:
            limit += 3 * len(traffic) + (framing.max_size // CHAINS + 1) * len(traffic)
            if len(framings) > 1:
                limit += 2 * framing.max_size * chunks
    return limit
