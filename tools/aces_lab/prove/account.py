"""What was proved of each message, and what was not, with the reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

from .decoding import Witness

#: From strong to weak; a message is what the weakest of its parts is.
Status = Literal["proved", "bounded", "sampled", "unknown", "refuted"]
ORDER: tuple[Status, ...] = ("proved", "bounded", "sampled", "unknown", "refuted")


@dataclass(frozen=True)
class Claim:
    """One claim about a message: `what` it is of, and why it is no more than `status`."""

    what: str
    status: Status
    reason: str = ""


@dataclass
class Outcome:
    """All claims about one message. `label` is its variant's; `count` messages have the same functions and declaration."""

    label: str
    message: str
    parts: list[Claim] = field(default_factory=list)
    witness: Witness | None = None
    seconds: float = 0.0
    paths: int = 0
    count: int = 1

    @property
    def status(self) -> Status:
        return ORDER[max((ORDER.index(part.status) for part in self.parts), default=ORDER.index("unknown"))]

    @property
    def reason(self) -> str:
        """Why it is no more than it is."""
        groups: dict[str, list[str]] = {}
        for claim in self.parts:
            if claim.status == self.status and claim.reason:
                groups.setdefault(claim.reason, []).append(claim.what.partition(",")[0])
        return "; ".join(f"{', '.join(dict.fromkeys(what))}: {reason}" for reason, what in groups.items())

    def add(self, what: str, status: Status, reason: str = "") -> None:
        self.parts.append(Claim(what, status, reason))


def summary(outcomes: Iterable[Outcome]) -> str:
    """Return `proved 71, bounded 4, sampled 2 (reason; reason)`: all messages, the weak ones with their reasons."""
    listed = list(outcomes)
    counts = Counter[Status]()
    for outcome in listed:
        counts[outcome.status] += outcome.count
    texts: list[str] = []
    for status in ORDER:
        if not counts[status]:
            continue
        reasons = Counter[str]()
        for outcome in listed:
            if outcome.status == status and status != "proved":
                reasons[outcome.reason] += outcome.count
        shown = "; ".join(
            reason if n == 1 else f"{n} × {reason}" for reason, n in reasons.most_common(6) if reason
        )
        more = f"; and {len(reasons) - 6} other reasons" if len(reasons) > 6 else ""
        texts.append(f"{status} {counts[status]}" + (f" ({shown}{more})" if shown else ""))
    return ", ".join(texts) or "nothing to prove"
