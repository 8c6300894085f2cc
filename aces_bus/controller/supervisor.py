"""The supervisor: what becomes of a controller when something goes wrong below it, or in it.

1. A table says the reaction to each kind of event: ignore, degrade (by name), or stop motion. What is not in the table is
   taken as "*", and that is to stop unless said otherwise.
2. An event counts when it is looked at: at once where the runner has it so (`attend`), else at the next step. The reason
   reaches the controller's own handler before that.
3. An exception of the controller is an event too, "raised"; it never gets out of `step`. So is what the controller itself
   reports, such as "failed".
4. A controller that gives nothing for `dead_man_s` is taken for dead, unless it says that it has nothing to give
   (`is_idle`). Whatever stopped motion, it stays stopped until `release`.

A supervisor is a controller itself, around one, with the guard below. `step` is all of a cycle; a runner with threads has
its halves: `compute` is the controller's own code, on its thread, all else belongs on the thread of the buses.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping

from .base import NOTHING, ControllerLike, StateLike
from .events import ControlEvent, EventLike, Listeners, raised_text
from .guard import Guard
from .reactions import DEFAULT_REACTIONS, Reaction, stop

#: Events that are kept for a cycle.
MOST_EVENTS = 1_000


class Supervisor:
    """A controller with its guard and its reactions, as one controller.

    >>> from aces_bus.controller import Bounds, ControlEvent, Guard, controller, degrade, stop
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
        *,
        dead_man_s: float | None = None,
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
        self.dead_man_ns = None if dead_man_s is None else round(dead_man_s * 1e9)
        #: When it last gave set-points that went down, or had none to give (ns); None: not yet.
        self._alive: int | None = None
        #: The reactions' own functions that wait for the controller's thread, with their events.
        guard.fault = self._fault_of_guard
        self._to_do: deque[tuple[Callable[[EventLike], object], EventLike]] = deque()
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
    def has_events(self) -> bool:
        """True if events wait to be handled."""
        return bool(self._events)

    @property
    def reason(self) -> str:
        """Why motion is stopped; "" while it is not."""
        return self.guard.tripped.reason if self.guard.tripped else ""

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Give controller and guard their states."""
        self.controller.bind(states)
        self.guard.bind(states)

    def start(self, now: int) -> None:
        """Begin a run; forget what stopped or degraded the last one."""
        self._events.clear()
        self._to_do.clear()
        self._alive = None
        self.degraded.clear()
        self.error = None
        self.guard.release()
        self.guard.forget()
        self.controller.start(now)

    def stop(self, now: int) -> None:
        """End the run."""
        self.controller.stop(now)

    def release(self) -> None:
        """Let motion go on after a stop, once its cause has been looked into."""
        self._alive = None
        self.guard.release()

    def handle(self, event: EventLike) -> None:
        """Handle an event from below, on any thread. The controller's own handler gets it at once."""
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
        """Step the controller and return the set-points that may be sent in this cycle."""
        self._react_to_all()
        return self.pass_on(now_ns, self.compute(now_ns))

    # ------------------------------------------------------------------ the halves of a step

    def compute(self, now_ns: int) -> Mapping[str, float]:
        """Return the set-points that the controller wants; what it raises is an event. On the controller's own thread."""
        while self._to_do:
            do, event = self._to_do.popleft()
            try:
                do(event)
            except (Exception, SystemExit) as error:
                self.guard.trip(f"{self.name}: reaction to {event.kind} raised {raised_text(error)}")
        try:
            return self.controller.step(now_ns)
        except (Exception, SystemExit) as error:  # a thread that calls exit() would be gone without a word
            self._events.append(self._raised(now_ns, error))
            return NOTHING

    def pass_on(self, now_ns: int, setpoints: Mapping[str, float]) -> Mapping[str, float]:
        """Handle all events, then return those of the set-points that may be sent."""
        self._react_to_all()
        guard = self.guard
        try:
            given = guard.apply(now_ns, setpoints)
        except Exception as error:  # set-points that are not a mapping of numbers
            what = f"it gave a {type(setpoints).__name__}; set-points are a dict: a state's name → a number"
            is_dict = hasattr(setpoints, "items")
            self._react(self._raised(now_ns, error if is_dict else TypeError(what)))
            given = guard.tick(now_ns)
        if given or getattr(self.controller, "is_idle", False):
            self._alive = now_ns
        elif self.is_overdue(now_ns):
            assert self._alive is not None
            return self.emit_dead(now_ns, f"no set-points for {(now_ns - self._alive) / 1e6:.0f} ms")
        return given

    def attend(self, now_ns: int) -> Mapping[str, float]:
        """Look at the events that have come, between steps; what goes down where motion is held."""
        self._react_to_all()
        return self.guard.tick(now_ns)

    def is_overdue(self, now_ns: int, since: int | None = None) -> bool:
        """Return whether it has been quiet for longer than its dead-man allows, `since` an instant or the last
        set-points.
        """
        quiet_since = self._alive if since is None else since
        return (
            self.dead_man_ns is not None
            and quiet_since is not None
            and now_ns - quiet_since > self.dead_man_ns
            and self.guard.tripped is None
        )

    def emit_dead(self, now_ns: int, why: str) -> Mapping[str, float]:
        """Report the fault "dead-man", once until the controller gives set-points again."""
        self._alive = None
        event = ControlEvent("dead-man", now_ns, self.name, why)
        self.listeners.emit(event)
        self._react(event)
        return self.guard.tick(now_ns)

    # ------------------------------------------------------------------ reactions

    def _react_to_all(self) -> None:
        while self._events:
            self._react(self._events.popleft())

    def _raised(self, now: int, error: BaseException, who: str = "") -> ControlEvent:
        self.error = error
        return ControlEvent("raised", now, self.name, f"{who}{raised_text(error)}")

    def _fault_of_guard(self, event: ControlEvent) -> None:
        """React to a fault of the guard as a fault of this controller."""
        self._react(ControlEvent(event.kind, event.instant, self.name, event.detail))

    def _react(self, event: EventLike) -> None:
        kind = event.kind
        if kind in self.counts or len(self.counts) < 1_000:
            self.counts[kind] += 1
        reaction = self._reaction(kind, event.source)
        if reaction.what == "stop":
            detail = f": {event.detail}" if event.detail else ""
            self.guard.trip(f"{event.source}: {kind}{detail}", reaction.action, source=event.source)
        elif reaction.what == "degrade" and reaction.name not in self.degraded:
            self.degraded[reaction.name] = f"{event.source}: {kind}"
            self.listeners.emit(
                ControlEvent(
                    "degraded", event.instant, self.name, f"{reaction.name} ({event.source}: {kind})"
                )
            )
        else:
            return
        if reaction.do is not None:
            self._to_do.append((reaction.do, event))

    def _reaction(self, kind: str, source: str) -> Reaction:
        for key in (kind, "*"):
            found = self.reactions.get(key, ())
            for reaction in (found,) if isinstance(found, Reaction) else found:
                if reaction.sources is None or source in reaction.sources:
                    return reaction
        return stop()
