"""Faults on purpose: drawn from a seed, so that what went wrong once goes wrong again.

1. A fault is asked for by its chance, per frame or per frame and receiver; the order of asking is that of the bus.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, fields

from ...errors import CallerError


@dataclass(frozen=True)
class Faults:
    """Chances from 0 to 1.

    `corrupt`: a frame is destroyed by a bit error and sent again. `drop`: a receiver misses a frame (an overrun).
    `duplicate`: a receiver gets it twice (the last bit of EOF). `delay`: it comes late to a receiver, by up to `delay_ns`.
    """

    seed: int = 0
    corrupt: float = 0.0
    drop: float = 0.0
    duplicate: float = 0.0
    delay: float = 0.0
    delay_ns: int = 1_000_000

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name not in ("seed", "delay_ns") and not 0 <= getattr(self, field.name) <= 1:
                raise CallerError(
                    f"fault {field.name}: {getattr(self, field.name)} is not a chance from 0 to 1"
                )

    def start(self) -> FaultSource:
        """The faults, from the seed's beginning."""
        return FaultSource(self)


NO_FAULTS = Faults()


class FaultSource:
    """Draws the faults of one bus."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._random = random.Random(faults.seed)

    def corrupts(self, bits: int) -> int | None:
        """The bit at which a frame of so many bits is destroyed; None: not at all."""
        if self._faults.corrupt and self._random.random() < self._faults.corrupt:
            return self._random.randrange(1, bits)
        return None

    def arrivals(self) -> tuple[int, ...]:
        """The delays (ns) with which a frame comes to a receiver: none, one or two."""
        faults, draw = self._faults, self._random.random
        if faults.drop and draw() < faults.drop:
            return ()
        delay = (
            self._random.randrange(1, faults.delay_ns + 1) if faults.delay and draw() < faults.delay else 0
        )
        if faults.duplicate and draw() < faults.duplicate:
            return delay, delay
        return (delay,)
