"""What a recording says against a spec: a finding with its evidence, and what would be right.

1. An observation is a `Finding`: it has the line of the spec that it speaks of, a level and a rule, and a comment allows it.
2. Its evidence is a count, of how many, and the first frame or packet that shows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from ..lint.finding import Finding
from ..record import PlainValue


class Moment(NamedTuple):
    """Where in a recording something is: the frame's number from 0, or the packet's offset in bytes.

    `time_ns` is counted from the first instant, None where it has none. `source` names the recording where
    there are several, else it is empty.
    """

    row: int
    time_ns: int | None
    is_stream: bool
    source: str = ""

    def __str__(self) -> str:
        text = f"{'byte' if self.is_stream else 'frame'} {self.row}"
        if self.time_ns is not None:
            text += f" ({self.time_ns / 1e9:.3f} s)"
        return f"{text} of {self.source}" if self.source else text


@dataclass(frozen=True)
class Observation(Finding):
    """A remark about a spec that a recording makes.

    `count` frames, packets or values of `total` show it, first at `first`. `remedy` is a line that says what would be right.
    """

    count: int = 0
    total: int = 0
    first: Moment | None = None
    remedy: str = ""

    def as_dict(self) -> dict[str, PlainValue]:
        """Return it for JSON: what every finding has, with the evidence; times in s from the recording's first instant."""
        first = self.first
        return {
            **super().as_dict(),
            "count": self.count,
            "total": self.total,
            "first": None
            if first is None
            else {
                "source": first.source or None,
                "row": first.row,
                "time": None if first.time_ns is None else first.time_ns / 1e9,
            },
            "remedy": self.remedy,
        }
