"""The bytes of a stream that are searched for framings, and what in them is in packets already."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from aces_bus.protocol.columns.table import Array

#: Bytes that are searched.
SAMPLE = 1 << 16


class Span(NamedTuple):
    """A packet: where it begins and ends, and of which framing it is."""

    start: int
    end: int
    framing: int


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
        """Return the stretches in no packet."""
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
