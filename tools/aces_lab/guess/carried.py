"""Packets of transports that show themselves only when they are put together: J1939's sessions, tail bytes with their CRC.

1. What is said was tried by the scanner that a draft will have: at least `PACKETS` packets of several frames are whole, and
   hardly a frame is malformed.
2. A number that counts is not a tail byte: without a packet whose CRC holds none is said.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

from construct import GreedyBytes, Struct

from aces_bus import FrameTable, make_column_scanner
from aces_bus._lazy import np
from aces_bus.frames import EXTENDED, FD, REMOTE
from aces_bus.protocol import IdField, J1939Transport, Protocol, TailByte, Transport
from aces_bus.protocol.declare.j1939 import CONNECTION, DATA

from .fields import Array

#: Whole packets of several frames that there must be, and the share of frames that may be malformed.
PACKETS, MALFORMED = 3, 0.05
#: Frames of tail bytes that are put together (of J1939 it is all: packets have other keys than they), and frames at once.
TRIED, AT_ONCE = 20_000, 1 << 16
#: Keys of packets; with more of them than a bus has senders and groups, packets are an accident.
KEYS = 1024
#: Bits of a tail byte that say where in its transfer a frame is: of one that is all of it, and the rest, which counts.
PLACE, WHOLE, NUMBER = 0xE0, 0xE0, 0x1F


@dataclass(frozen=True)
class CarriedGuess:
    """Packets of one key: the frames that they took, how many they are, and their sizes in bytes."""

    key: int
    frames: int
    count: int
    sizes: tuple[int, ...]


def j1939_packets(frames: FrameTable, keys: Iterable[int]) -> tuple[tuple[int, ...], list[CarriedGuess]]:
    """Return the keys of the frames of J1939's transport, and the packets in them; none where these are not whole."""
    own = tuple(key for key in keys if _is_plain(key) and key >> 16 & 0x3FF in (CONNECTION, DATA))
    found = _put_together(_of(frames, own), J1939Transport())
    return (own, found) if found else ((), [])


def cyphal_packets(
    frames: FrameTable, rows: Mapping[int, Array]
) -> tuple[tuple[int, ...], list[CarriedGuess]]:
    """Return the keys of transfers of Cyphal, and these; none where those of several frames are not whole, with their
    CRC.
    """
    own = tuple(key for key, some in rows.items() if _is_plain(key) and _has_tails(frames, some))
    found = _put_together(_of(frames, own).take(slice(0, TRIED)), TailByte())
    return (own, found) if found else ((), [])


def _is_plain(key: int) -> bool:
    return bool(key & EXTENDED) and not key & (FD | REMOTE)


def _has_tails(frames: FrameTable, rows: Array) -> bool:
    """Return whether the last bytes say that frames are transfers, which are counted, or parts of some."""
    lengths = frames.length[rows]
    if (lengths < 1).any():
        return False
    tails = frames.data[rows, lengths - 1]
    if (tails & PLACE == WHOLE).all():
        steps = np.diff(tails & NUMBER) & NUMBER
        return bool((steps == 1).sum() >= (1 - MALFORMED) * len(steps))
    begins, goes_on = tails & 0x80 != 0, tails & 0x40 == 0
    return bool(begins.any() and (tails[begins] & 0x20 != 0).all() and (lengths[goes_on] == 8).all())


def _of(frames: FrameTable, keys: Sequence[int]) -> FrameTable:
    return (
        frames.take(np.flatnonzero(np.isin(frames.key, np.array(keys, np.uint32))))
        if keys
        else FrameTable.empty()
    )


def _put_together(frames: FrameTable, transport: Transport) -> list[CarriedGuess]:
    """Return the packets of a transport in its frames, one guess a key; none where they are not whole."""
    if not len(frames):
        return []
    protocol = Protocol("tried", link="can")
    protocol.message(
        "Packet",
        id=IdField("identifier", range(1 << 29)),
        extended=True,
        transport=transport,
        payload=Struct("data" / GreedyBytes),
    )
    scanner = make_column_scanner([protocol.variant()])
    pieces = (frames.take(slice(at, at + AT_ONCE)) for at in range(0, len(frames), AT_ONCE))
    taken: dict[int, list[int]] = {}
    sizes: dict[int, set[int]] = {}
    for table in chain(chain.from_iterable(map(scanner.feed, pieces)), scanner.close()):
        of_each = table.frames if table.frames is not None else np.ones(len(table), np.int64)
        for key, data, count in zip(table.key.tolist(), table["data"].values, of_each.tolist(), strict=True):
            taken.setdefault(key, []).append(count)
            sizes.setdefault(key, set()).add(len(data))
    several = sum(count > 1 for counts in taken.values() for count in counts)
    if several < PACKETS or len(taken) > KEYS or scanner.counts.malformed > MALFORMED * scanner.counts.total:
        return []
    return [
        CarriedGuess(key, sum(taken[key]), len(taken[key]), tuple(sorted(sizes[key])))
        for key in sorted(taken)
    ]
