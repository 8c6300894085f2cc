"""What a node of a simulated bus receives beside frames; clients of a served bus receive it, too.

Not in `bus.py`, whose compiled build keeps no types of fields: what goes over a socket is read by them.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...frames import Frame


@dataclass(frozen=True)
class SimulatedBusEvent:
    """Something that happened to a node: what, when (ns), and the frame it was about.

    `kind` is "no acknowledge", "bit error", "error-passive", "error-active", "bus-off", "recovered" or "sent".
    """

    kind: str
    instant: int
    frame: Frame | None = None
