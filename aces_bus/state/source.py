"""What feeds a state, and what became of its samples."""

from __future__ import annotations

from typing import Any, Protocol

import msgspec

from ..runtime import Clock
from .quantity import Listener


class SignalSource(Protocol):
    """What feeds a state: a device's `Signal`, or whatever looks like one."""

    name: str
    unit: str
    clock: Clock
    stale_after_ns: int | None
    listeners: list[Listener]
    last: Any
    instant: int | None

    @property
    def is_writable(self) -> bool:
        """Whether it takes set-points."""
        ...

    def set(self, value: Any) -> None:
        """Take a set-point."""
        ...


class SampleCounts(msgspec.Struct):
    """What became of samples: kept + repeated + late is all that was pushed; `unknown` are among those kept or repeated.

    The others are a running quantity's: samples that a filter refused as uneven, restarts after gaps, and times that a
    filter of the user's own raised.
    """

    kept: int = 0
    repeated: int = 0
    late: int = 0
    unknown: int = 0
    uneven: int = 0
    restarts: int = 0
    failed: int = 0
