"""Node numbers inside identifiers: identifiers at equal distances whose frames are alike, bit by bit.

1. At least three identifiers, of the same kind of frame, the same lengths, the same rate.
2. Alike means: the same bits change, about as often. Frames of one kind of device do; neighbours of other kinds seldom.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from aces_bus import FrameTable
from aces_bus._lazy import np
from aces_bus.frame_table import rows_at
from aces_bus.frames import EXTENDED
from aces_bus.protocol.record import PlainValue

from .fields import Array

if TYPE_CHECKING:
    from .traffic import TimingGuess

#: Members of a family; rows that are compared; bits that must change, and how alike they must do.
MEMBERS, ROWS, BITS, ALIKE = 3, 512, 4, 0.75
#: By how much rates of frames may differ.
RATE = 0.15


@dataclass(frozen=True)
class NodeGuess:
    """A number inside identifiers: identifier = `base` + number << `shift`."""

    name: str
    base: int
    shift: int
    numbers: tuple[int, ...]
    confidence: float
    evidence: str

    def as_dict(self) -> dict[str, PlainValue]:
        """Return the guess in JSON's kinds."""
        return {
            "name": self.name,
            "base": self.base,
            "shift": self.shift,
            "numbers": list(self.numbers),
            "confidence": round(self.confidence, 2),
            "evidence": self.evidence,
        }


@dataclass(frozen=True)
class Members:
    """Identifiers that are one message, with all their rows."""

    keys: tuple[int, ...]
    rows: Array
    lengths: tuple[int, ...]
    timing: TimingGuess | None
    node: NodeGuess | None = None


def families(frames: FrameTable, groups: Sequence[Members]) -> list[Members]:
    """Return the groups, those together that only differ in a node number."""
    masks = [_signature(frames, group) for group in groups]
    left = dict.fromkeys(range(len(groups)))
    found: list[Members] = []
    for shift, candidates in _candidates([group.keys[0] for group in groups]):
        numbers = [at for at in candidates if at in left]
        for alike in _alike(groups, masks, numbers):
            if len(alike) >= MEMBERS:
                found.append(_joined(groups, alike, shift))
                for at in alike:
                    del left[at]
    return sorted([*found, *(groups[at] for at in left)], key=lambda family: family.keys[0])


def _candidates(keys: Sequence[int]) -> Iterator[tuple[int, list[int]]]:
    """Yield (shift of the number, indices of keys that only differ in it)."""
    # By extended identifiers: the source address of J1939. Then numbers at the lower end, then above a command.
    for mask, shift, wanted in (
        (0xFF, 0, EXTENDED),
        (0x0F, 0, 0),
        (0x7F, 0, 0),
        (0xF0, 4, 0),
        (0x7E0, 5, 0),
        (0x700, 8, 0),
    ):
        by_rest: dict[int, list[int]] = {}
        for index, key in enumerate(keys):
            if key & EXTENDED == wanted:
                by_rest.setdefault(key & ~mask, []).append(index)
        for rest in sorted(by_rest):
            if len(by_rest[rest]) >= MEMBERS:
                yield shift, by_rest[rest]


def _alike(
    groups: Sequence[Members], masks: Sequence[Array | None], numbers: Iterable[int]
) -> list[list[int]]:
    """Return those of `numbers` that are alike, as lists."""
    found: list[list[int]] = []
    for at in numbers:
        if masks[at] is None:
            continue
        home = next((some for some in found if _are_alike(groups, masks, some[0], at)), None)
        if home is None:
            found.append([at])
        else:
            home.append(at)
    return found


def _are_alike(groups: Sequence[Members], masks: Sequence[Array | None], one: int, other: int) -> bool:
    a, b = groups[one], groups[other]
    if a.lengths != b.lengths or (a.timing is None) != (b.timing is None):
        return False
    if a.timing is not None and b.timing is not None:
        if abs(a.timing.period_ns - b.timing.period_ns) > RATE * max(a.timing.period_ns, b.timing.period_ns):
            return False
    mine, theirs = masks[one], masks[other]
    if mine is None or theirs is None:
        return False
    return float(np.minimum(mine, theirs).sum()) >= ALIKE * float(np.maximum(mine, theirs).sum())


def _signature(frames: FrameTable, group: Members) -> Array | None:
    """Return how often each bit changes, as a weight; None where too little changes to compare."""
    rows = group.rows[:ROWS]
    bits = np.unpackbits(rows_at(frames.data, rows)[:, : max(1, group.lengths[-1])], axis=1)
    if len(bits) < 2 or group.keys[0] >> 30 & 1:
        return None
    weights: Array = np.sqrt((bits[1:] ^ bits[:-1]).mean(axis=0))
    return weights if (weights > 0).sum() >= BITS else None


def _joined(groups: Sequence[Members], alike: Sequence[int], shift: int) -> Members:
    keys = tuple(groups[at].keys[0] for at in alike)
    identifiers = [key & 0x1FFF_FFFF for key in keys]
    # Numbers of devices are neighbours, mostly; identifiers of noise are anywhere.
    density = len(keys) / ((identifiers[-1] - identifiers[0] >> shift) + 1)
    is_source = bool(keys[0] & EXTENDED)
    span = {0: 0xFF if is_source else 0x7F, 4: 0xF0, 5: 0x7E0, 8: 0x700}[shift]
    base = identifiers[0] & ~span if shift or is_source else _base(identifiers)
    node = NodeGuess(
        "source" if is_source else "node",
        base,
        shift,
        tuple((identifier - base) >> shift for identifier in identifiers),
        min(0.9, 0.5 + 0.1 * len(keys)) * (1.0 if is_source else 0.5 + 0.5 * density),
        f"{len(keys)} identifiers with the same lengths and rate, in which the same bits change",
    )
    rows = np.concatenate([groups[at].rows for at in alike])
    return replace(groups[alike[0]], keys=keys, rows=rows, node=node)


def _base(identifiers: Sequence[int]) -> int:
    """Return the base of numbers, so that they count from 0 or 1 above a base with zeros behind it, if they can."""
    for bits in (7, 6, 5, 4):
        base = identifiers[0] >> bits << bits
        if identifiers[-1] < base + (1 << bits):
            shorter = identifiers[0] >> 4 << 4
            return shorter if identifiers[-1] < shorter + 16 else base
    return identifiers[0]
