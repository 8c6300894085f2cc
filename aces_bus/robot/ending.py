"""What a runner asks of a logger, and what it says at the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol


class RunLogger(Protocol):
    """What a runner asks of a logger."""

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    @property
    def rate_hz(self) -> float:
        """How often it samples."""
        ...

    @property
    def states(self) -> Sequence[str]:
        """The names of the states that it records."""
        ...

    def bind(self, states: Mapping[str, Any]) -> None:
        """Take them."""
        ...

    def start(self, now: int) -> None:
        """Begin."""
        ...

    def step(self, now: int) -> None:
        """Sample once; must not block."""
        ...

    def stop(self, now: int) -> None:
        """End: all is on disk."""
        ...


@dataclass
class Ended:
    """How a run ended: `reason` "" for its time being up; `tripped` controllers with why; `failed` what went wrong at the
    end itself, and of that `not_stopped` the devices that may still move, with why.
    """

    reason: str
    tripped: dict[str, str]
    seconds: float
    failed: list[str] = field(default_factory=list[str])
    not_stopped: dict[str, str] = field(default_factory=dict[str, str])
