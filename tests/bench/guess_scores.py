"""How much of what was said of recordings is right: precision, recall, F1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass
class Score:
    """Right ones among those that were said, and among those that there are."""

    right: int = 0
    said: int = 0
    there: int = 0

    def add(self, right: int, said: int, there: int) -> None:
        self.right += right
        self.said += said
        self.there += there

    def merge(self, other: Score) -> None:
        self.add(other.right, other.said, other.there)

    @property
    def precision(self) -> float:
        return self.right / self.said if self.said else float("nan")

    @property
    def recall(self) -> float:
        return self.right / self.there if self.there else float("nan")

    @property
    def f1(self) -> float:
        return 2 * self.right / (self.said + self.there) if self.said + self.there else float("nan")

    def __str__(self) -> str:
        if not self.said and not self.there:
            return "–"
        return f"{self.precision:4.0%} {self.recall:4.0%} {self.f1:4.0%} ({self.there})"


#: What is scored of fields, and of streams.
FIELDS = (
    "boundaries",
    "boundaries READ",
    "fields",
    "constants",
    "counters",
    "counters READ",
    "checks",
    "order",
    "sign",
)
STREAMS = ("packets", "sync", "length", "check")


@dataclass
class Scores:
    """A line of a table, and what went wrong."""

    name: str
    kinds: Sequence[str]
    by: dict[str, Score] = field(default_factory=dict[str, Score])
    wrong: list[str] = field(default_factory=list[str])

    def __post_init__(self) -> None:
        for kind in self.kinds:
            self.by.setdefault(kind, Score())

    def merge(self, other: Scores) -> None:
        for kind, score in other.by.items():
            self.by[kind].merge(score)
        self.wrong += other.wrong


@dataclass(frozen=True)
class Truth:
    """A field as its spec has it."""

    name: str
    positions: tuple[int, ...]
    order: str
    signed: bool | None
    kind: str


def table(title: str, lines: Sequence[Scores]) -> None:
    """Precision, recall, F1 and how many there are, a line each and all together."""
    if not lines:
        return
    kinds = lines[0].kinds
    print(f"\n{title}: precision, recall, F1 (how many there are)")
    print(f"{'':34}" + "".join(f"{kind:>24}" for kind in kinds))
    total = Scores("all", kinds)
    for line in lines:
        print(f"{line.name[:33]:34}" + "".join(f"{line.by[kind]!s:>24}" for kind in kinds))
        total.merge(line)
    if len(lines) > 1:
        print(f"{'all':34}" + "".join(f"{total.by[kind]!s:>24}" for kind in kinds))
