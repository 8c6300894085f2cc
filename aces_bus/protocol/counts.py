"""Where every byte and frame went.

1. The bins sum to the input: frames = decoded + control + unknown + malformed + errors + pending + filtered;
   bytes = decoded + unknown + malformed + skipped + pending + filtered.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

BINS = ("decoded", "control", "unknown", "malformed", "skipped", "filtered", "errors", "pending")


@dataclass
class ScanCounts:
    """The bins of one scanner, in frames (CAN) or bytes (streams); `records` counts decoded messages.

    `reasons` counts losses by reason, in the same unit: the bins of losses are sums over it. `missed` counts messages
    that rolling counters say were lost.
    """

    total: int = 0
    decoded: int = 0
    pending: int = 0
    filtered: int = 0
    records: int = 0
    missed: int = 0
    reasons: dict[str, int] = field(default_factory=dict)

    @property
    def control(self) -> int:
        """Frames that only steer a transport: flow control, acknowledgements."""
        return self._bin("control")

    @property
    def unknown(self) -> int:
        """Valid framing or frame, no message."""
        return self._bin("unknown")

    @property
    def malformed(self) -> int:
        """Check or length failed: whole frames, or of a packet the header byte only."""
        return self._bin("malformed")

    @property
    def skipped(self) -> int:
        """Bytes that begin no packet."""
        return self._bin("skipped")

    @property
    def errors(self) -> int:
        """Error frames."""
        return self._bin("error frame")

    def _bin(self, kind: str) -> int:
        return sum(n for reason, n in self.reasons.items() if reason.partition(":")[0] == kind)

    @property
    def balance(self) -> int:
        """Difference between the total and the sum of the bins: always 0."""
        return self.total - sum(int(getattr(self, name)) for name in BINS)

    def lose(self, size: int, reason: str) -> None:
        """Put `size` frames or bytes into the bin of `reason`."""
        self.reasons[reason] = self.reasons.get(reason, 0) + size

    def __str__(self) -> str:
        parts = [f"{name}={getattr(self, name)}" for name in BINS if getattr(self, name)]
        return f"total={self.total} {' '.join(parts)} records={self.records}"


def sum_counts(all_counts: Iterable[ScanCounts]) -> ScanCounts:
    """Return the sum of counts."""
    total = ScanCounts()
    for counts in all_counts:
        for name in ("total", "decoded", "pending", "filtered", "records", "missed"):
            setattr(total, name, getattr(total, name) + getattr(counts, name))
        for reason, number in counts.reasons.items():
            total.lose(number, reason)
    return total
