"""How much a second, smoothly, at the cost of one multiplication a batch.

1. Time is a parameter: instants in integer ns of one clock.
2. What is added fades with e^(-t/τ): a meter reads right from the beginning, and falls to nothing when nothing comes.
3. An amount came between the one before and now: it is taken for older by half of that, or batches would read too high.
"""

from __future__ import annotations

from math import exp

#: Younger than this, nothing is divided by a meter's age, in seconds.
YOUNGEST_S = 0.05


class Meter:
    """Adds amounts, gives the amount a second over about the last `tau_s` seconds.

    >>> meter = Meter(1.0, 0)
    >>> for tenth in range(1, 51):
    ...     meter.add(tenth * 100_000_000, 80)
    >>> round(meter.per_second(5_000_000_000))
    800
    """

    __slots__ = ("_amount", "_at", "_start", "_tau")

    def __init__(self, tau_s: float, start_ns: int) -> None:
        self._tau = tau_s * 1e9
        self._start = self._at = start_ns
        self._amount = 0.0

    def add(self, now_ns: int, amount: float) -> None:
        """So much has come until `now_ns`."""
        age = now_ns - self._at
        if age > 0:
            half = exp(-0.5 * age / self._tau)
            self._amount = self._amount * half * half + amount * half
            self._at = now_ns
        else:
            self._amount += amount

    def _faded(self, now_ns: int) -> float:
        age = now_ns - self._at
        return self._amount * exp(-age / self._tau) if age > 0 else self._amount

    def per_second(self, now_ns: int) -> float:
        """The amount a second at `now_ns`."""
        tau = self._tau / 1e9
        age = max((now_ns - self._start) / 1e9, YOUNGEST_S)
        return self._faded(now_ns) / (tau * (1.0 - exp(-age / tau)))
