"""What differs between two profiles, and how telling it is.

1. A change is said of bytes and bits that were seen on both sides; what one side did not see is not guessed.
2. `score` is from 0 to 1, and made of shares that can be checked: how much the other side saw (n frames that are all alike:
   n / (n + 1)), in how many of B's windows a change is there, and how often the other side showed something new by itself.

How often something new comes by itself is the share of values that were visited once (Good, Biometrika 40, 1953): where
values come that were never seen, and those before them came once each, too, a number wanders; that does not answer a button.
A bit that follows a bit that changes all the time may be the next one of a counter, and counts half.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from aces_bus._lazy import np
from aces_bus.frame_table import Ints
from aces_bus.protocol.record import PlainValue
from aces_tools.reading.traffic import ArrivalCount, BusIdentifier, GapCounts

from .exposure import Exposure
from .signals import DeviceMessage
from .traffic import BITS_OF_VALUES, IdentifierTraffic, TrafficProfile

ChangeKind = Literal[
    "appears",
    "vanishes",
    "changes",
    "differs",
    "mostly",
    "values",
    "range",
    "period",
    "rate",
    "length",
    "constant",
]
#: What each kind means, in words.
KINDS: Mapping[ChangeKind, str] = {
    "appears": "is in B only",
    "vanishes": "is in A only",
    "changes": "constant in A, changes in B",
    "differs": "constant in both, another value in B",
    "mostly": "is in most of B what it hardly ever is in A: a mark came late",
    "values": "changes in both, has values in B that it never has in A",
    "range": "leaves in B the range that it has in A",
    "period": "comes at another period in B",
    "rate": "comes more or less often in B",
    "length": "has lengths in B that it never has in A",
    "constant": "changes in A, constant in B",
}
#: Periods and rates that differ by less than these factors are the same.
PERIOD_FACTOR, RATE_FACTOR = 1.1, 1.5
#: What a change of the kind counts at most beside one of the others.
WEIGHTS: Mapping[ChangeKind, float] = {
    "length": 0.95,
    "rate": 0.9,
    "mostly": 0.9,
    "values": 0.8,
    "range": 0.8,
    "constant": 0.5,
}
#: What is in so large a share of B is in most of it; in A it is rare with so small a part of that share.
MOST, RARE = 0.5, 0.2
#: Values that are listed.
LISTED = 4
#: Standard deviations of a count by chance that a rate must differ by.
SIGMAS = 4.0


@dataclass(frozen=True)
class TrafficChange:
    """Something that is another in B.

    `subject` is the identifier as candump writes it (behind its channel where there are several), or the message and its
    device, which `device_message` has in parts. `byte` and `bits` (0 is the lowest) say which bytes, `signal` which signal;
    None and () where it is the whole. `a` and `b` say what is seen on either side. `count` of the `frames` that B has of
    the subject show it; it occurs in `seen_in` of the `windows` of B that have the subject.
    """

    score: float
    kind: ChangeKind
    subject: str
    a: str
    b: str
    identifier: BusIdentifier | None = None
    device_message: DeviceMessage | None = None
    byte: int | None = None
    bits: tuple[int, ...] = ()
    signal: str | None = None
    count: int = 0
    frames: int = 0
    seen_in: int = 0
    windows: int = 0

    @property
    def message(self) -> str | None:
        """The message's name."""
        return None if self.device_message is None else self.device_message.message

    @property
    def place(self) -> str:
        """`byte 3 bit 5`, the signal's path, or nothing."""
        if self.signal is not None:
            return self.signal
        if self.byte is None:
            return ""
        return f"byte {self.byte}" + (f" {bits_text(self.bits)}" if self.bits else "")

    def as_dict(self) -> dict[str, Any]:
        """Return the change for JSON; scores have three decimals."""
        out: dict[str, PlainValue] = {
            "score": round(self.score, 3),
            "kind": self.kind,
            "subject": self.subject,
        }
        if self.identifier is not None:
            out |= {
                "channel": self.identifier.channel,
                "identifier": self.identifier.number,
                "extended": self.identifier.is_extended,
            }
        if self.device_message is not None:
            out |= {"message": self.message, "device": dict(self.device_message.device)}
        out |= {} if self.byte is None else {"byte": self.byte, "bits": list(self.bits)}
        out |= {} if self.signal is None else {"signal": self.signal}
        out |= {"a": self.a, "b": self.b}
        if self.windows:
            out |= {
                "count": self.count,
                "frames": self.frames,
                "seen_in": self.seen_in,
                "windows": self.windows,
            }
        return out


def bits_text(bits: tuple[int, ...]) -> str:
    """Return `bit 5`, `bits 0-3 7`: neighbours together.

    >>> bits_text((5,)), bits_text((0, 1, 2, 3, 7)), bits_text((0, 1))
    ('bit 5', 'bits 0-3 7', 'bits 0 1')
    """
    parts: list[list[int]] = []
    for bit in bits:
        if parts and parts[-1][-1] == bit - 1:
            parts[-1].append(bit)
        else:
            parts.append([bit])
    texts = [f"{p[0]}-{p[-1]}" if len(p) > 2 else " ".join(map(str, p)) for p in parts]
    return f"bit{'s' if len(bits) > 1 else ''} {' '.join(texts)}"


@dataclass
class _Sides:
    """One subject on both sides."""

    subject: str
    identifier: BusIdentifier
    a: IdentifierTraffic
    b: IdentifierTraffic
    exposure: Exposure

    def change(self, kind: ChangeKind, score: float, a: str, b: str, **more: Any) -> TrafficChange:
        return TrafficChange(
            WEIGHTS.get(kind, 1.0) * score, kind, self.subject, a, b, self.identifier, **more
        )


def traffic_changes(a: TrafficProfile, b: TrafficProfile, exposure: Exposure) -> list[TrafficChange]:
    """Return what differs between the identifiers of two profiles, in no order.

    Where each side has one channel the two are compared, whatever they are called.
    """
    channels = [{identifier.channel for identifier in side.identifiers} for side in (a, b)]
    by_name = any(len(names) > 1 for names in channels)
    sides = [
        {
            identifier if by_name else identifier._replace(channel=None): (identifier, traffic)
            for identifier, traffic in side.identifiers.items()
        }
        for side in (a, b)
    ]
    found: list[TrafficChange] = []
    for key in sorted(
        sides[0].keys() | sides[1].keys(), key=lambda identity: (str(identity.channel), identity[1:])
    ):
        subject = f"{key.channel} {key}" if by_name and key.channel is not None else str(key)
        in_a, in_b = sides[0].get(key), sides[1].get(key)
        if in_a is None and in_b is not None:
            found.append(_lone("appears", subject, *in_b, exposure))
        elif in_b is None and in_a is not None:
            found.append(_lone("vanishes", subject, *in_a, exposure))
        elif in_a is not None and in_b is not None:
            both = _Sides(subject, in_b[0], in_a[1], in_b[1], exposure)
            found += _changes_of(both)
    return found


def _lone(
    kind: Literal["appears", "vanishes"],
    subject: str,
    identifier: BusIdentifier,
    traffic: IdentifierTraffic,
    exposure: Exposure,
) -> TrafficChange:
    """Return an identifier of one side."""
    there = occurrence_text(traffic.frames, "frame", traffic.gaps)
    a, b = ("", there) if kind == "appears" else (there, "")
    return TrafficChange(exposure.lone_score(kind, traffic.frames), kind, subject, a, b, identifier)


def occurrence_text(number: int, what: str, gaps: GapCounts) -> str:
    """Return `12 frames, every 10 ms`."""
    text = f"{number} {what}" + ("s" if number != 1 else "")
    median = gaps.median_ns
    return text if median is None else f"{text}, {period_text(median / 1e6)}"


def period_text(period_ms: float) -> str:
    """Return `every 10 ms`, in a unit that suits."""
    if period_ms >= 1000:
        return f"every {period_ms / 1000:.4g} s"
    return f"every {period_ms:.4g} ms" if period_ms >= 1 else f"every {period_ms * 1000:.4g} µs"


def _changes_of(both: _Sides) -> Iterator[TrafficChange]:
    yield from _timing(both)
    yield from _lengths(both)
    for byte in range(min(both.a.width, both.b.width)):
        yield from _byte(both, byte)


def timing_change(
    a: ArrivalCount, b: ArrivalCount, exposure: Exposure, what: str
) -> tuple[ChangeKind, float, str, str] | None:
    """Return the change of period or rate of one subject: kind, score before its weight, and both sides in words;
    None: none.
    """
    before, after = a.gaps.median_ns, b.gaps.median_ns
    if before is not None and after is not None:
        distance = a.gaps.differs_by(b.gaps)
        if distance and not 1 / PERIOD_FACTOR < after / before < PERIOD_FACTOR:
            size = min(1.0, abs(math.log2(after / before)) / math.log2(1.5))
            return "period", distance * size, period_text(before / 1e6), period_text(after / 1e6)
    if not (exposure.a and exposure.b):
        return None
    expected = a.frames * exposure.b / exposure.a
    ratio = b.frames / expected
    # Both counts are by chance: the variance of their difference, in frames of B.
    sigma = math.sqrt(b.frames + expected * exposure.b / exposure.a)
    if abs(b.frames - expected) <= SIGMAS * sigma or 1 / RATE_FACTOR < ratio < RATE_FACTOR:
        return None

    def rate(number: int, seen: float) -> str:
        share = f"{number / seen:.3g} a second" if exposure.is_time else f"{number / seen:.1%} of all"
        return f"{number} {what}{'s' if number != 1 else ''}, {share}"

    return "rate", min(1.0, abs(math.log2(ratio)) / 2), rate(a.frames, exposure.a), rate(b.frames, exposure.b)


def _timing(both: _Sides) -> Iterator[TrafficChange]:
    found = timing_change(both.a, both.b, both.exposure, "frame")
    if found is not None:
        yield both.change(*found)


def _lengths(both: _Sides) -> Iterator[TrafficChange]:
    a, b = both.a.lengths, both.b.lengths
    new = np.flatnonzero((b > 0) & (a == 0))
    if len(new):
        n = both.a.frames
        yield both.change(
            "length",
            n / (n + 1),
            _listed_lengths(a),
            _listed_lengths(b),
            count=int(b[new].sum()),
            frames=both.b.frames,
        )
        return
    usual = int(b.argmax())
    count_a, n_a, count, n_b = int(a[usual]), int(a.sum()), int(b[usual]), int(b.sum())
    score = rarity(count_a, n_a, count, n_b, len(both.b.ones))
    if score and n_b > 1:
        before = f"{_listed_lengths(a)} ({usual}: {count_a} of {n_a})"
        yield both.change("mostly", score, before, _listed_lengths(b), count=count, frames=n_b)


def rarity(count_a: int, n_a: int, count_b: int, n_b: int, windows: int) -> float:
    """Return how telling it is that `count_a` of A's n_a are what `count_b` of B's n_b are, over so many times of B;
    0: not at all.

    One time of B may have it by chance, the likelier the more of A has it; all of several times hardly do.
    """
    share_a, share_b = count_a / n_a, count_b / n_b
    if share_b < MOST or share_a > RARE * share_b:
        return 0.0
    chance = (share_a / share_b / RARE) ** max(1, windows)
    return (share_b - share_a) * (1 - chance) * n_a / (n_a + 1)


def _listed_lengths(counts: Ints) -> str:
    found = np.flatnonzero(counts).tolist()
    return f"{', '.join(map(str, found[:LISTED]))}{' …' if len(found) > LISTED else ''} byte{'s' if found != [1] else ''}"


def _byte(both: _Sides, byte: int) -> Iterator[TrafficChange]:
    a, b = both.a, both.b
    seen_a, seen_b = a.values[byte], b.values[byte]
    n_a, n_b = int(seen_a.sum()), int(seen_b.sum())
    if not n_a or not n_b:
        return
    ones_a, zeros_a = _seen(a.ones, byte), _seen(a.zeros, byte)
    ones_b, zeros_b = _seen(b.ones, byte), _seen(b.zeros, byte)
    new = ones_b & ~ones_a | zeros_b & ~zeros_a
    varying = ones_a & zeros_a
    values: dict[str, Any] = {"a": values_text(seen_a), "b": values_text(seen_b), "byte": byte, "frames": n_b}
    found: list[TrafficChange] = []
    if new:
        bits = _bits_of(new)
        count = int(seen_b[(np.arange(256) & new) != (ones_a & new)].sum())
        seen_in, windows = _in_windows(b, byte, ones_a, zeros_a)
        score = n_a / (n_a + 1) * (seen_in / windows) * (1 - 0.3 / count)
        if varying:
            score *= 1 - by_itself(a.visits[byte])
        if _may_carry(a, byte, bits[0]):
            score /= 2
        kind: ChangeKind = "changes" if ones_b & zeros_b & new else "differs"
        found.append(
            both.change(kind, score, **values, bits=bits, count=count, seen_in=seen_in, windows=windows)
        )
    else:
        found += _mostly(both, byte, values)
    fresh = (seen_b > 0) & (seen_a == 0)
    count = int(seen_b[fresh].sum())
    if count and varying:
        score = novelty(count / n_b, by_itself(a.visits[byte]))
        found.append(both.change("values", score, **values, count=count))
    if found:  # of bits that are new and of values that are, what says more
        yield max(found, key=lambda change: change.score)
    gone = ones_a & zeros_a & ~(ones_b & zeros_b)
    if gone:
        flips = a.flips[byte][list(_bits_of(gone))]
        chance = float(flips.max()) * n_b / n_a
        # The more bits change in A, the likelier one of them pauses by chance.
        pauses = np.count_nonzero(a.flips) * math.exp(-chance)
        yield both.change(
            "constant",
            max(0.0, 1 - float(pauses)) * n_b / (n_b + 1),
            **values,
            bits=_bits_of(gone),
        )


def _mostly(both: _Sides, byte: int, values: Mapping[str, Any]) -> Iterator[TrafficChange]:
    """Return bits that have a value in most of B and hardly ever in A."""
    a, b = both.a, both.b
    seen_a, seen_b = a.values[byte], b.values[byte]
    n_a, n_b = int(seen_a.sum()), int(seen_b.sum())
    set_a, set_b = BITS_OF_VALUES @ seen_a, BITS_OF_VALUES @ seen_b
    is_set = 2 * set_b > n_b
    rare, usual = np.where(is_set, set_a, n_a - set_a), np.where(is_set, set_b, n_b - set_b)
    windows = int(np.count_nonzero(b.ones[:, byte] | b.zeros[:, byte]))
    bits = tuple(
        bit for bit in range(8) if rarity(int(rare[bit]), n_a, int(usual[bit]), n_b, windows) and n_b > 1
    )
    if not bits:
        return
    bit = min(bits, key=lambda bit: float(rare[bit]) / float(usual[bit]))
    seen_in = int(np.count_nonzero((b.ones if is_set[bit] else b.zeros)[:, byte] >> bit & 1))
    score = rarity(int(rare[bit]), n_a, int(usual[bit]), n_b, windows) * seen_in / windows
    others = (np.arange(256) >> bit & 1) != is_set[bit]
    if np.count_nonzero(seen_a[others]) > 1:
        score *= 1 - by_itself(a.visits[byte][others])
    if _may_carry(a, byte, bits[0]):
        score /= 2
    own: dict[str, Any] = {**values, "a": f"{values['a']} ({int(rare[bit])} of {n_a})"}
    yield both.change(
        "mostly", score, **own, bits=bits, count=int(usual[bit]), seen_in=seen_in, windows=windows
    )


def _seen(polarities: Ints, byte: int) -> int:
    return int(np.bitwise_or.reduce(polarities[:, byte]))


def _bits_of(mask: int) -> tuple[int, ...]:
    return tuple(bit for bit in range(8) if mask >> bit & 1)


def _in_windows(b: IdentifierTraffic, byte: int, ones_a: int, zeros_a: int) -> tuple[int, int]:
    """Return in how many windows of B a bit has a value that it never has in A, of those that have the byte."""
    ones, zeros = b.ones[:, byte], b.zeros[:, byte]
    there = (ones | zeros) != 0
    new = (ones & np.uint8(~ones_a & 0xFF)) | (zeros & np.uint8(~zeros_a & 0xFF))
    return int(np.count_nonzero(new)), int(np.count_nonzero(there))


def _may_carry(a: IdentifierTraffic, byte: int, lowest: int) -> bool:
    """Return whether the bit below these, in either byte order, changes in A."""
    if lowest:
        return bool(a.flips[byte][lowest - 1])
    return any(0 <= other < a.width and a.flips[other][7] for other in (byte - 1, byte + 1))


def by_itself(visits: Ints) -> float:
    """Return how much of what comes next would be new by itself: the share of visits that were of a value that came once."""
    return min(1.0, (int(np.count_nonzero(visits == 1)) + 1) / (int(visits.sum()) + 1))


def novelty(share: float, expected: float) -> float:
    """Return how telling it is that `share` of B is new where `expected` would be by itself."""
    return max(1 - 2 * expected / share, 0.15 * share)


def values_text(counts: Ints) -> str:
    """Return the values of a byte, the most frequent first: `00 20`, `13 values 00-4F`."""
    found = np.flatnonzero(counts)
    if len(found) > LISTED:
        return f"{len(found)} values {int(found[0]):02X}-{int(found[-1]):02X}"
    order = found[np.argsort(-counts[found].astype(np.int64), kind="stable")]
    return " ".join(f"{value:02X}" for value in order.tolist())
