"""A clock and states that are elsewhere, as they are seen from here.

1. Instants are the publisher's, unchanged: derivatives and integrals are as good as they are there. Only "now" is a guess.
2. The guess is late by the quickest message of the last seconds, never more: a message that waited moves nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..device.signals import UNKNOWN
from ..runtime import Clock
from ..state import State

if TYPE_CHECKING:
    from .zenoh import RemoteStates

#: After which the quickest message of before does not count (ns): clocks drift by some 50 µs in it.
FORGET_NS = 5_000_000_000


class RemoteClock:
    """The publisher's clock: the local one, and how much it is behind, by what messages say."""

    def __init__(self, local: Clock, name: str) -> None:
        self.local, self.name = local, f"remote {name}"
        self._behind: int | None = None
        self._least = self._least_before = 0
        self._turned = 0
        self._heard_at: int | None = None

    def heard(self, now: int) -> None:
        """It was `now` there when this was sent."""
        here = self.local.now()
        behind = here - now
        if self._behind is None:
            self._least = self._least_before = behind
            self._turned = here
        elif here - self._turned > FORGET_NS:
            self._least_before, self._least, self._turned = self._least, behind, here
        self._least = min(self._least, behind)
        self._behind = min(self._least, self._least_before)
        self._heard_at = here

    def forget(self) -> None:
        """Another clock is there."""
        self._behind = self._heard_at = None

    @property
    def silence_ns(self) -> int:
        """How long nothing was heard; for ever before the first."""
        heard = self._heard_at
        return 1 << 62 if heard is None else self.local.now() - heard

    def now(self) -> int:
        """What it is there now (ns), as far as is known."""
        behind = self._behind
        return 0 if behind is None else self.local.now() - behind

    def sleep_until(self, instant: int) -> None:
        """Wait until it is `instant` there."""
        self.local.sleep_until(instant + (self._behind or 0))


class RemoteState(State):
    """A state of a robot that is elsewhere."""

    def __init__(
        self,
        name: str,
        remote: RemoteStates,
        unit: str,
        writable: bool,
        stale_after_s: float | None,
        history: int,
    ) -> None:
        self._remote = remote
        super().__init__(
            name,
            unit=unit,
            clock=remote.clock,
            setter=lambda value: remote.give({name: value}),
            writable=writable,
            history=history,
            stale_after_s=stale_after_s,
        )
        self._taken: tuple[Any, int] | None = None

    def take(self, value: Any, instant: int) -> None:
        """A sample as it was published; the one that is there already is none."""
        if (value, instant) == self._taken:
            return
        before, self._taken = self._taken, (value, instant)
        if value is UNKNOWN and before is not None and before[1] == instant:
            # The same sample, stale there by now: our own clock says that too, and its value stays in the history.
            self._taken = before
            return
        self.push(value, instant)

    def clear(self) -> None:
        """Forget all."""
        self._taken = None
        super().clear()

    @property
    def is_stale(self) -> bool:
        """Whether the newest value is too old, or the connection is lost."""
        return self._remote.is_lost or super().is_stale

    def __getitem__(self, t: float) -> Any:
        if t == 0 and self._remote.is_lost:
            return UNKNOWN
        return super().__getitem__(t)
