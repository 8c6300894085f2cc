"""States for tests: values that a test sets, with a history."""

from __future__ import annotations

from collections.abc import Mapping


class Fake:
    """A state whose newest value, rate and integral a test sets; `past` has values by (negative) seconds."""

    def __init__(self, value: float = 0.0, *, rate: float = 0.0, integral: float = 0.0) -> None:
        self.value, self.past = value, dict[float, float]()
        self._rate, self._integral = [rate], [integral]

    def __getitem__(self, when: float) -> float:
        return self.past[when] if when else self.value

    def rate(self) -> list[float]:
        """The derivative, by time."""
        return self._rate

    def integral(self) -> list[float]:
        """The integral, by time."""
        return self._integral


def fakes(**values: float) -> dict[str, Fake]:
    """One state a name."""
    return {name: Fake(value) for name, value in values.items()}


def close(setpoints: Mapping[str, float], **expected: float) -> bool:
    """Whether these are the set-points, to 1e-9."""
    return set(setpoints) == set(expected) and all(
        abs(setpoints[name] - value) < 1e-9 for name, value in expected.items()
    )
