"""Checks that the spec does not name: a byte, or two, that the other bytes of every packet give.

1. Only a kind that gives every sample, over many different values, is named; whether it is meant, the author knows.
2. Bytes that mirror others, and packets in which little changes, are left alone: there much would fit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from ..declare.checks import Crc, fletcher_of, xor_of

#: Samples of a message that are kept, and how many are enough; different values that a check must have had.
KEPT, ENOUGH, VALUES = 128, 24, 12
#: Bytes beside the check that must change.
VARYING = 3


class PacketSample(NamedTuple):
    """A frame's identifier (0 of a stream) and data, or a packet."""

    identifier: int
    data: bytes


class HiddenCheck(NamedTuple):
    """Where a check is, in words, and how a spec declares it."""

    offset: int
    size: int
    words: str
    declared: str


def hidden_check(samples: Sequence[PacketSample]) -> HiddenCheck | None:
    """Return the check that all samples have and that no field is said to be; None when there is none."""
    by_length: dict[int, list[PacketSample]] = {}
    for sample in samples:
        by_length.setdefault(len(sample.data), []).append(sample)
    for length, some in sorted(by_length.items(), key=lambda item: -len(item[1])):
        if len(some) < ENOUGH or length < 2 + VARYING - 1:
            continue
        columns = list(zip(*(sample.data for sample in some), strict=True))
        for size in (1, 2):
            for offset in (length - size, 0, *range(1, length - size)):
                found = _at(some, columns, offset, size)
                if found is not None:
                    return found
    return None


def _at(
    samples: Sequence[PacketSample], columns: Sequence[tuple[int, ...]], offset: int, size: int
) -> HiddenCheck | None:
    own = columns[offset : offset + size]
    others = [*columns[:offset], *columns[offset + size :]]
    varying = [column for column in others if len(set(column)) >= 4]
    if min(len(set(column)) for column in own) < VALUES or len(varying) < VARYING:
        return None
    if any(column in others for column in own):
        return None
    for words, declared, fits in _kinds(size):
        if all(fits(sample, offset) for sample in samples):
            return HiddenCheck(offset, size, words, declared)
    return None


Fits = Callable[[PacketSample, int], bool]


def _kinds(size: int) -> Iterator[tuple[str, str, Fits]]:
    """Yield kinds of checks: in words, as declared, and whether one fits a sample; over the data, then with
    the identifier.
    """

    def fit(compute: Callable[[bytes], int], lead: Callable[[PacketSample], bytes], order: str) -> Fits:
        def fits(sample: PacketSample, offset: int) -> bool:
            rest = lead(sample) + sample.data[:offset] + sample.data[offset + size :]
            stored = sample.data[offset : offset + size]
            return int.from_bytes(stored, "little" if order == "little" else "big") == compute(rest)

        return fits

    leads: tuple[tuple[str, str, Callable[[PacketSample], bytes]], ...] = (
        ("the other bytes", "", lambda sample: b""),
        (
            "the identifier's low byte and the other bytes",
            "IdBytes(1), ",
            lambda sample: bytes([sample.identifier & 0xFF]),
        ),
        (
            "the identifier and the other bytes",
            "IdBytes(2), ",
            lambda sample: (sample.identifier & 0xFFFF).to_bytes(2, "big"),
        ),
    )
    for words, over, lead in leads:
        covered = f", over=[{over}…]" if over else ""
        for name, declared, compute in _COMPUTED[size]:
            for order in ("little", "big") if size > 1 else ("little",):
                shown = f"{declared}order={order!r}, " if size > 1 else declared
                yield f"the {name} of {words}", f"{shown}field=…{covered})", fit(compute, lead, order)


def _crc(name: str) -> tuple[str, str, Callable[[bytes], int]]:
    return name, f'Crc("{name}", ', Crc(name).compute


_COMPUTED: dict[int, tuple[tuple[str, str, Callable[[bytes], int]], ...]] = {
    1: (
        ("sum", "Sum(", lambda data: sum(data) & 0xFF),
        ("inverted sum", "InvertedSum(", lambda data: ~sum(data) & 0xFF),
        ("negated sum", "Sum(negated=True, ", lambda data: -sum(data) & 0xFF),
        ("exclusive or", "Xor(", xor_of),
        *map(_crc, ("CRC8-SAE-J1850", "CRC8-AUTOSAR", "CRC8-SMBUS", "CRC8-MAXIM-DOW")),
    ),
    2: (
        ("sum", "Sum(2, ", lambda data: sum(data) & 0xFFFF),
        ("Fletcher pair", "Fletcher(", fletcher_of),
        *map(_crc, ("CRC16-MODBUS", "CRC16-IBM-3740", "CRC16-XMODEM", "CRC16-MCRF4XX")),
    ),
}
