"""Declares what a device does by itself once nothing comes from its host any more."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

#: What becomes of the joints: they stay where they are, give way, are braked to a stand and may then sink, follow the last
#: set-point for ever; nobody knows; the device has nothing that moves.
Outcome = Literal["holds", "limp", "brakes", "goes on", "unknown", "nothing moves"]


@dataclass(frozen=True)
class HostLoss:
    """What a device does when its host is gone: killed, without power, or hung.

    `after_s` is how long the device obeys the last set-point before its own watchdog acts; None: it has no watchdog, and
    does this from the first missing packet on. `source` is the manual, facts file or firmware that says so; `detail` is
    what else a person must know (who sets the watchdog, what ends it).
    """

    does: Outcome
    source: str
    after_s: float | None = None
    detail: str = ""

    @property
    def lacks_watchdog(self) -> bool:
        """True if the device can move and has no watchdog for the host."""
        return self.after_s is None and self.does != "nothing moves"

    def __str__(self) -> str:
        when = "" if self.after_s is None else f", {self.after_s:g} s after its host is gone"
        text = {
            "holds": "holds its joints where they are",
            "limp": "lets its joints go limp",
            "brakes": "brakes its joints, which may then sink",
            "goes on": "follows its last set-point",
            "unknown": "does what nobody knows",
            "nothing moves": "moves nothing",
        }[self.does]
        return f"{text}{when}"
