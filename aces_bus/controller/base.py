"""What every controller is: a name, a rate, the states it reads, and one method that gives set-points.

1. No I/O, no thread and no sleep in a controller: the runtime calls `step(now)` at `rate_hz`, and instants are integer ns
   of its clock. The same states and instants give the same set-points.
2. Set-points are tagged with the state's name. An empty mapping says "nothing new".
3. A controller reads states; it never sees a device, a frame or a byte.
4. `handle(event)` may be called from another thread, at any time: it may set a flag, and must return at once.

A state is whatever has `state[0]` (the newest value) and, where a controller asks for them, `state[-0.5]`, `state.rate()`
and `state.integral()`: the State floor's, or a test's own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from types import SimpleNamespace
from typing import Any, Protocol

from ..errors import AcesError, CallerError, UnknownNameError
from .events import EventLike, Listeners

#: Nothing new.
NOTHING: Mapping[str, float] = {}


class StateLike(Protocol):
    """What a controller needs of a state."""

    def __getitem__(self, when: float, /) -> float:
        """Return the value `when` seconds from now: 0 the newest, -0.5 half a second ago."""
        ...


class ControllerLike(Protocol):
    """What the runtime, a guard and a supervisor need of a controller."""

    @property
    def name(self) -> str:
        """Its name, unique in a robot."""
        ...

    @property
    def rate_hz(self) -> float:
        """Rate at which the controller wants to be stepped, in Hz."""
        ...

    @property
    def states(self) -> tuple[str, ...]:
        """The names of the states that it reads."""
        ...

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Take the states it reads."""
        ...

    def start(self, now: int) -> None:
        """Prepare to be stepped from `now` (ns) on."""
        ...

    def stop(self, now: int) -> None:
        """End: no step follows until the next `start`."""
        ...

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Return the set-points of this cycle, by state."""
        ...

    def handle(self, event: EventLike) -> None:
        """Take an event from below."""
        ...


def checked_rate(rate_hz: float, owner: str) -> float:
    """Return the rate, if it is one; the paper's own tests go to 10 kHz."""
    if not (math.isfinite(rate_hz) and 0 < rate_hz <= 1e6):
        raise CallerError(f"{owner}: rate_hz = {rate_hz!r} is not a rate (0 < rate_hz ≤ 1e6)")
    return float(rate_hz)


def known_value(state: StateLike | None) -> float | None:
    """Return a state's newest value; None while it is unknown, however the state says so."""
    if state is None:
        return None
    try:
        value = float(state[0])
    except (AcesError, LookupError, TypeError, ValueError):
        return None
    return value if math.isfinite(value) else None


class Controller:
    """A controller to derive from: say the states, and give `step`.

    >>> class Damper(Controller):
    ...     def __init__(self) -> None:
    ...         super().__init__("damper", rate_hz=100, states=["LKP"], writes=["LKP"])
    ...     def step(self, now_ns):
    ...         return {"LKP": 0.9 * self.bound["LKP"][0]}
    >>> damper = Damper()
    >>> damper.bind({"LKP": [0.5]})
    >>> damper.step(0)
    {'LKP': 0.45}

    `states` are the names it reads, `writes` those it gives set-points for, where that is known before it runs;
    `waiting` says what it waits for, "" when it does not.
    """

    def __init__(
        self, name: str, *, rate_hz: float, states: Iterable[str] = (), writes: Iterable[str] = ()
    ) -> None:
        self.name = name
        self.rate_hz = checked_rate(rate_hz, name)
        self.states = tuple(dict.fromkeys(states))
        self.writes = tuple(dict.fromkeys(writes))
        self.bound: Mapping[str, StateLike] = {}
        self.started_ns: int | None = None
        self.listeners = Listeners()
        self.waiting = ""

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Take the states it reads; `UnknownNameError` lists those that exist when one is missing."""
        for name in self.states:
            if name not in states:
                raise UnknownNameError(f"state (controller {self.name!r} reads it)", name, states)
        self.bound = {name: states[name] for name in self.states}

    def known(self, name: str) -> float | None:
        """Return the newest value of one of its states; None while it is unknown."""
        return known_value(self.bound.get(name))

    def unknown_states(self) -> list[str]:
        """Return those of its states that have no value yet."""
        return [name for name in self.states if self.known(name) is None]

    def start(self, now: int) -> None:
        """Prepare to be stepped from `now` (ns) on."""
        self.started_ns = now
        self.waiting = ""

    def stop(self, now: int) -> None:
        """End: no step follows until the next `start`."""
        self.started_ns = None

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Return the set-points of this cycle, by state."""
        raise NotImplementedError(f"{type(self).__name__} has no step(now_ns)")

    @property
    def is_idle(self) -> bool:
        """True if a healthy controller gives no set-points now; without this, a long silence counts as its death."""
        return False

    def handle(self, event: EventLike) -> None:
        """Handle an event from below (rule 4); by default do nothing."""

    def seconds(self, now_ns: int) -> float:
        """Return the seconds since the start."""
        if self.started_ns is None:
            self.started_ns = now_ns
        return (now_ns - self.started_ns) / 1e9


class LawController(Controller):
    """A controller that computes a law from `t`, seconds since the start, and `dt`, seconds since the last step.

    The law is not computed before every state that it reads has a value: unknown is not zero. A subclass sets `_law`.
    `values` are the law's parameters, which `set` changes, and its memory, which begins anew with `start`.
    """

    _law: Callable[[float, float], Any]

    def __init__(
        self,
        name: str,
        *,
        rate_hz: float,
        states: Iterable[str],
        writes: Iterable[str],
        parameters: Mapping[str, float],
        memory: Mapping[str, float],
    ) -> None:
        super().__init__(name, rate_hz=rate_hz, states=states, writes=writes)
        self.values = SimpleNamespace(**parameters, **memory)
        self._parameters, self._memory = parameters, memory
        self._last: int | None = None
        self._ready = self._has_given = False

    def set(self, **parameters: float) -> None:
        """Change parameters, from the next step on."""
        for parameter, value in parameters.items():
            if parameter not in self._parameters:
                raise UnknownNameError(f"parameter of {self.name!r}", parameter, self._parameters)
            setattr(self.values, parameter, float(value))

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Take the states it reads."""
        super().bind(states)
        self._ready = False

    def start(self, now: int) -> None:
        """Begin a run: memory gets its first values."""
        super().start(now)
        self.values.__dict__.update(self._memory)
        self._last, self._ready, self._has_given = None, False, False

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Return the set-points of the law; nothing while a state that it reads is unknown."""
        if not self._ready:
            self.waiting = ", ".join(self.unknown_states())
            if self.waiting:
                return NOTHING
            self._ready = True
        if self.started_ns is None:
            self.started_ns = now_ns
        dt = 1.0 / self.rate_hz if self._last is None else (now_ns - self._last) / 1e9
        self._last = now_ns
        try:
            setpoints: Mapping[str, float] | None = self._law((now_ns - self.started_ns) / 1e9, dt)
        except (TypeError, AcesError) as error:
            if not self._excuses(error):
                raise
            self._ready = False
            return NOTHING
        self._has_given = True
        return setpoints or NOTHING

    def _excuses(self, error: Exception) -> bool:
        """Return whether what a law raised only says that something is not known: `waiting` then has it.

        A number that is unknown cannot be computed with (TypeError); a history that is still too short is an error of the
        state, and excused until the first set-points, unless waiting does not help. All else is the law's own fault.
        """
        if isinstance(error, TypeError) and "Unknown" in str(error):
            self.waiting = ", ".join(self.unknown_states()) or "a value is unknown"
            return True
        if isinstance(error, AcesError) and not self._has_given and not getattr(error, "is_permanent", False):
            self.waiting = str(error)
            return True
        return False
