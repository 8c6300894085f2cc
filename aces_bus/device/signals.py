"""One quantity of a device: its newest value, when it was measured, its listeners, and how it is set.

1. Unknown is a value: `UNKNOWN` until a value is received, and again after `forget` (a board that rebooted).
2. A stale value never passes as fresh: `value` is `UNKNOWN` once it is older than `stale_after_ns`; `last` says what it was.
3. An update costs two stores and one call a listener: there are thousands a second.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..errors import CallerError
from ..protocol.record import FieldValue
from ..runtime.clock import Clock
from .reading import UNKNOWN, Reading

Listener = Callable[[Any, int], None]


class Signal:
    """One quantity, as a device knows it.

    `name` is unique within a robot ("RHY.position"), `unit` SI or "" (enumerations, flags). `setter` takes a new set-point;
    without one the quantity is read-only. `lower` and `upper` are in `unit`, None where they are not stated.
    """

    __slots__ = (
        "clock",
        "doc",
        "door",
        "given",
        "instant",
        "last",
        "limit",
        "listeners",
        "lower",
        "name",
        "request",
        "setter",
        "source",
        "stale_after_ns",
        "unit",
        "upper",
    )

    def __init__(
        self,
        name: str,
        clock: Clock,
        *,
        unit: str = "",
        stale_after_ns: int | None = None,
        setter: Callable[[Any], None] | None = None,
        lower: float | None = None,
        upper: float | None = None,
        doc: str = "",
        source: str = "",
    ) -> None:
        self.name, self.clock, self.unit = name, clock, unit
        self.stale_after_ns = stale_after_ns
        self.setter = setter
        #: Asks the device for a new value, from any thread; None: it cannot be asked.
        self.request: Callable[[], None] | None = None
        self.lower, self.upper = lower, upper
        self.doc, self.source = doc, source
        #: The last value received, however old; `UNKNOWN` before.
        self.last: Any = UNKNOWN
        #: When that was measured (ns of `clock`).
        self.instant: int | None = None
        self.listeners: list[Listener] = []
        #: Called with what is handed to the driver.
        self.given: list[Listener] = []
        #: What a device makes of a set-point beyond `lower` or `upper`; None: the signal cannot be set.
        self.limit: Callable[[Signal, Any], Any] | None = None
        #: Where set-points go on a robot, instead of straight to the driver: limits, rates, owners.
        self.door: Callable[[FieldValue], None] | None = None

    def update(self, value: Any, instant: int) -> None:
        """Take a new value and call the listeners."""
        self.last = value
        self.instant = instant
        for listener in self.listeners:
            listener(value, instant)

    def forget(self) -> None:
        """Make it unknown again, for listeners too."""
        if self.instant is None:
            return
        self.last, self.instant = UNKNOWN, None
        now = self.clock.now()
        for listener in self.listeners:
            listener(UNKNOWN, now)

    @property
    def value(self) -> Any:
        """The value if it is fresh, else `UNKNOWN`."""
        return UNKNOWN if self.is_stale else self.last

    @property
    def age_ns(self) -> int | None:
        """Age of the value in ns; None if it was never received."""
        return None if self.instant is None else self.clock.now() - self.instant

    @property
    def is_stale(self) -> bool:
        """True if the value is too old, or was never received."""
        if self.instant is None:
            return True
        return self.stale_after_ns is not None and self.clock.now() - self.instant > self.stale_after_ns

    def read(self) -> Reading:
        """Return value, instant, age and staleness, together."""
        return Reading(self.last, self.instant, self.age_ns, self.is_stale)

    @property
    def is_writable(self) -> bool:
        """True if the signal can be set."""
        return self.setter is not None

    def set(self, value: Any) -> None:
        """Give a set-point, in `unit`; it is sent with the next tick, or led there at the joint's rate.

        Raises `CallerError` for what is read-only, has another owner, or is not a finite number.
        """
        if self.setter is None:
            raise CallerError(f"{self.name} is read-only")
        if self.door is not None:
            self.door(value)
            return
        if self.limit is not None:
            value = self.limit(self, value)
        self.setter(value)
        if self.given:
            now = self.clock.now()
            for listener in self.given:
                listener(value, now)

    def __repr__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return f"<{self.name} = {self.value!r}{unit}>"
