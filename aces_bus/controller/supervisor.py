"""The supervisor: what becomes of a controller when something goes wrong below it, or in it.

1. A table says the reaction to each kind of event: ignore, degrade (by name), or stop motion. What is not in the table is
   taken as "*", and that is to stop unless said otherwise.
2. An event counts at the next step, at the latest: the reason reaches the controller's own handler before that.
3. An exception of the controller is an event too, "raised"; it never gets out of `step`. So is what the controller itself
   tells, such as "failed".

A supervisor is a controller itself, around one, with the guard below: the runtime steps the supervisor.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from ..errors import CallerError
from .base import ControllerLike, StateLike
from .events import ControlEvent, EventLike, Listeners, raised_text
from .guard import ACTIONS, Action, Guard


@dataclass(frozen=True)
class Reaction:
    """What to do about an event: nothing, go on in a worse way called `name`, or stop motion by `action`.

    `sources` narrows it to events from these (None: all); `do` is called with the event when it is carried out.
    """

    what: Literal["ignore", "degrade", "stop"]
    name: str = ""
    action: Action | None = None
    sources: frozenset[str] | None = None
    do: Callable[[EventLike], object] | None = None


#: Go on as if nothing had happened; it is counted.
IGNORE = Reaction("ignore")


def degrade(
    name: str, do: Callable[[EventLike], object] | None = None, *, sources: Iterable[str] | None = None
) -> Reaction:
    """Go on in a worse way; `do` makes it so (a gain to zero, another controller)."""
    return Reaction("degrade", name, None, None if sources is None else frozenset(sources), do)


def stop(action: Action | None = None, *, sources: Iterable[str] | None = None) -> Reaction:
    """Stop motion by "hold", "zero duty" or "disable"; None: the guard's own action."""
    if action is not None and action not in ACTIONS:
        raise CallerError(f"the action is one of {', '.join(ACTIONS)}, not {action!r}")
    return Reaction("stop", "", action, None if sources is None else frozenset(sources))


#: What happens on any bus on a good day.
HARMLESS = (
    "opened",
    "reopened",
    "closed",
    "error-active",
    "answers",
    "alarm over",
    "late reply",
    "limited",
    "clipped",
    "late",
)
#: Events that are kept for a cycle.
MOST_EVENTS = 1_000
DEFAULT_REACTIONS: Mapping[str, Reaction | tuple[Reaction, ...]] = {
    **dict.fromkeys(HARMLESS, IGNORE),
    "*": stop(),
}


class Supervisor:
    """A controller with its guard and its reactions, as one controller.

    >>> from aces_bus.controller import Bounds, ControlEvent, Guard, controller
    >>> @controller(rate_hz=10)
    ... def still():
    ...     return {"LKP": 0.0}
    >>> guard = Guard({"LKP": Bounds()}, period_s=0.1, dead_man_s=0.3)
    >>> safe = Supervisor(still, guard, {"ft saturated": degrade("no compliance"), "bus-off": stop("disable")})
    >>> safe.start(0)
    >>> safe.step(0)
    {'LKP': 0.0}
    >>> safe.handle(ControlEvent("bus-off", 40_000_000, "can0"))
    >>> safe.step(100_000_000), safe.reason
    ({}, 'can0: bus-off')

    `reactions` adds to the defaults: harmless kinds are ignored, all others stop. A kind may have several reactions, for
    different sources; the first that fits is taken. `degraded` are the names of what has been given up, `counts` how many
    events of each kind came, `reason` why motion was stopped.
    """

    def __init__(
        self,
        controller: ControllerLike,
        guard: Guard,
        reactions: Mapping[str, Reaction | tuple[Reaction, ...]] | None = None,
    ) -> None:
        self.controller, self.guard = controller, guard
        self.name, self.rate_hz = controller.name, controller.rate_hz
        self.reactions = {**DEFAULT_REACTIONS, **(reactions or {})}
        self.degraded: dict[str, str] = {}
        self.counts: Counter[str] = Counter()
        self.listeners = Listeners()
        self.error: BaseException | None = None
        self._events: deque[EventLike] = deque(maxlen=2 * MOST_EVENTS)
        self.dropped = 0
        listeners = getattr(controller, "listeners", None)
        if isinstance(listeners, Listeners):  # "failed" is said, not raised
            listeners.add(self._events.append)

    @property
    def states(self) -> tuple[str, ...]:
        """The names of the states that the controller reads."""
        return self.controller.states

    @property
    def writes(self) -> tuple[str, ...]:
        """The states that the controller sets, as far as it says so."""
        return tuple(getattr(self.controller, "writes", ()))

    @property
    def reason(self) -> str:
        """Why motion is stopped; "" while it is not."""
        return self.guard.tripped.reason if self.guard.tripped else ""

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Give controller and guard their states."""
        self.controller.bind(states)
        self.guard.bind(states)

    def start(self, now: int) -> None:
        """A run begins; what stopped or degraded the last one is forgotten."""
        self._events.clear()
        self.degraded.clear()
        self.error = None
        self.guard.release()
        self.guard.forget()
        self.controller.start(now)

    def stop(self, now: int) -> None:
        """The run is over."""
        self.controller.stop(now)

    def release(self) -> None:
        """Let motion go on after a stop, once its cause has been looked into."""
        self.guard.release()

    def handle(self, event: EventLike) -> None:
        """Something happened below; from any thread. The controller's own handler hears it at once."""
        if len(self._events) < MOST_EVENTS:
            self._events.append(event)
        else:  # a flood: what would stop motion still does, the rest is counted
            self.dropped += 1
            reaction = self._reaction(event.kind, event.source)
            if reaction.what != "ignore":
                self.guard.trip(
                    f"{event.source}: {event.kind} (and {MOST_EVENTS} events before it)", reaction.action
                )
        try:
            self.controller.handle(event)
        except Exception as error:
            self._events.append(self._raised(event.instant, error, "its handler "))

    def step(self, now_ns: int) -> Mapping[str, float]:
        """What may go down in this cycle."""
        while self._events:
            self._react(self._events.popleft())
        try:
            setpoints = self.controller.step(now_ns)
            return self.guard.apply(now_ns, setpoints)
        except Exception as error:
            self._react(self._raised(now_ns, error))
            return self.guard.tick(now_ns)

    def _raised(self, now: int, error: Exception, who: str = "") -> ControlEvent:
        self.error = error
        return ControlEvent("raised", now, self.name, f"{who}{raised_text(error)}")

    def _react(self, event: EventLike) -> None:
        kind = event.kind
        if kind in self.counts or len(self.counts) < 1_000:
            self.counts[kind] += 1
        reaction = self._reaction(kind, event.source)
        if reaction.what == "stop":
            detail = f": {event.detail}" if event.detail else ""
            self.guard.trip(f"{event.source}: {kind}{detail}", reaction.action)
        elif reaction.what == "degrade" and reaction.name not in self.degraded:
            self.degraded[reaction.name] = f"{event.source}: {kind}"
            self.listeners.tell(
                ControlEvent(
                    "degraded", event.instant, self.name, f"{reaction.name} ({event.source}: {kind})"
                )
            )
        else:
            return
        if reaction.do is not None:
            try:
                reaction.do(event)
            except Exception as error:
                self.guard.trip(f"{self.name}: reaction to {kind} raised {raised_text(error)}")

    def _reaction(self, kind: str, source: str) -> Reaction:
        for key in (kind, "*"):
            found = self.reactions.get(key, ())
            for one in (found,) if isinstance(found, Reaction) else found:
                if one.sources is None or source in one.sources:
                    return one
        return stop()
