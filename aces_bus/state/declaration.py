"""What a state is made with: its declaration, whose faults are found when it is made, and what feeds it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, Protocol

import msgspec

from ..runtime.clock import Clock
from .errors import StateError, raise_first

#: Samples kept by default: five seconds at 200 Hz.
HISTORY = 1_000
#: 16 bytes a sample, twice: 512 MiB.
MOST_HISTORY = 1 << 24
#: Beyond this order a polynomial through even samples swings wildly between them.
MOST_ORDER = 9

Interpolation = Literal["hold", "linear", "cubic"] | int
ORDERS = {"hold": 0, "linear": 1, "cubic": 3}


def checked_name(name: Any, unit: Any) -> str:
    """Return the name, if it is one, and the unit is a text."""
    raise_first(
        StateError,
        (not isinstance(name, str) or not name, f"a state needs a name, not {name!r}"),
        (
            not (unit is None or isinstance(unit, str)),
            f'state {name!r}: a unit is a text like "rad/s", "" or None, not {unit!r}',
        ),
    )
    return str(name)


def checked_seconds(name: str, what: str, seconds: float | None) -> float | None:
    """Return a duration, or None."""
    if seconds is not None and not 0 < seconds < math.inf:
        raise StateError(f"state {name!r}: {what} = {seconds!r} is not a duration in seconds")
    return seconds


def checked_history(name: str, history: int | None, history_s: float | None, period_s: float | None) -> int:
    """Return how many samples to keep, both ends of `history_s` included."""
    if history is not None and history_s is not None:
        raise StateError(f"state {name!r}: give history (samples) or history_s (seconds), not both")
    if history_s is not None:
        if period_s is None:
            raise StateError(f"state {name!r}: history_s needs period_s; or give history in samples")
        checked_seconds(name, "history_s", history_s)
        history = math.ceil(history_s / period_s - 1e-9) + 1
    kept: Any = HISTORY if history is None else history
    if not hasattr(kept, "__index__") or not 1 <= kept <= MOST_HISTORY:
        raise StateError(f"state {name!r}: a history of {kept!r} samples (1 … {MOST_HISTORY})")
    return int(kept)


def checked_order(name: str, interpolation: Interpolation | None, *, is_real: bool) -> int:
    """Return the order of the interpolating polynomial; by default 1, and for whole numbers 0: the last one is held."""
    if interpolation is None:
        return 1 if is_real else 0
    order: Any = ORDERS.get(interpolation) if isinstance(interpolation, str) else interpolation
    if not isinstance(order, int) or isinstance(order, bool) or not 0 <= order <= MOST_ORDER:
        raise StateError(
            f"state {name!r}: interpolation {interpolation!r}; there are 'hold', 'linear', 'cubic' "
            f"and orders 0 … {MOST_ORDER}"
        )
    return order


class SignalSource(Protocol):
    """What feeds a state: a device's `Signal`, or whatever looks like one."""

    name: str
    unit: str
    clock: Clock
    stale_after_ns: int | None
    listeners: list[Callable[[Any, int], None]]
    last: Any
    instant: int | None
    request: Callable[[], None] | None

    @property
    def is_writable(self) -> bool:
        """True if the signal takes set-points."""
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
