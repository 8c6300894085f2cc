"""Where every byte and frame went.

1. The bins sum to the input: frames = decoded + unknown + malformed + errors + filtered;
   bytes = decoded + unknown + malformed + skipped + pending + filtered.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

BINS = ("decoded", "unknown", "malformed", "skipped", "filtered", "errors", "pending")


@dataclass
class Counts:
    """The bins of one scanner, in frames (CAN) or bytes (streams); `records` counts decoded messages.

    `reasons` counts losses by reason, in the same unit; `missed` counts messages that rolling counters say were lost.
    """

    total: int = 0
    decoded: int = 0
    unknown: int = 0
    malformed: int = 0
    skipped: int = 0
    filtered: int = 0
    errors: int = 0
    pending: int = 0
    records: int = 0
    missed: int = 0
    reasons: Counter[str] = field(default_factory=Counter)

    @property
    def balance(self) -> int:
        """What is missing from the bins: always 0."""
        return self.total - sum(getattr(self, name) for name in BINS)

    def lose(self, size: int, reason: str) -> None:
        """Put `size` frames or bytes into the bin of `reason`."""
        self.reasons[reason] += size
        kind = "errors" if reason == "error frame" else reason.partition(":")[0]
        setattr(self, kind, getattr(self, kind) + size)
