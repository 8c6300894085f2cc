"""A clock and states that are elsewhere, as they are seen from here.

1. Instants are the publisher's, unchanged: derivatives and integrals are as good as they are there. Only "now" is a guess.
2. The guess is late by the quickest message of the last seconds, never more: a message that waited moves nothing.
"""

from __future__ import annotations

import atexit
import threading
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Self

import msgspec

from aces_bus.access.inlet import AccessEvent, AccessEvents
from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError, NoReplyError, UnknownNameError
from aces_bus.runtime import RealClock, VirtualClock
from aces_bus.runtime.clock import Clock
from aces_bus.state import State

from .publisher import (
    ANSWER_S,
    ENDPOINT,
    MOST_ANSWER_S,
    MOST_STATES,
    AboutStates,
    Options,
    StateValues,
    closed,
    decoded,
    open_session,
    robot_key,
    subscribe,
)

#: After which the quickest message of before does not count (ns): clocks drift by some 50 µs in it.
FORGET_NS = 5_000_000_000


class RemoteClock:
    """The publisher's clock: the local one, and how much it is behind, by what messages say."""

    def __init__(self, local: Clock, name: str) -> None:
        self.local, self.name = local, f"remote {name}"
        self._behind: int | None = None
        self._least = self._least_before = 0
        self._turned = 0
        self._received_at: int | None = None

    def received(self, now: int) -> None:
        """Note that a message was received which was sent at `now` of the remote clock."""
        here = self.local.now()
        behind = here - now
        if self._behind is None:
            self._least = self._least_before = behind
            self._turned = here
        elif here - self._turned > FORGET_NS:
            self._least_before, self._least, self._turned = self._least, behind, here
        self._least = min(self._least, behind)
        self._behind = min(self._least, self._least_before)
        self._received_at = here

    def forget(self) -> None:
        """Forget the clock: another one is there."""
        self._behind = self._received_at = None

    @property
    def silence_ns(self) -> int:
        """Time (ns) since anything was received; endless before the first message."""
        received = self._received_at
        return 1 << 62 if received is None else self.local.now() - received

    def now(self) -> int:
        """Return what it is there now (ns), as far as is known."""
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
        """Take a sample as it was published; ignore a repetition of the present sample."""
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
        """True if the newest value is too old, or the connection is lost."""
        return self._remote.is_lost or super().is_stale

    def __getitem__(self, t: float) -> Any:
        if t == 0 and self._remote.is_lost:
            return UNKNOWN
        return super().__getitem__(t)


class RemoteStates(Mapping[str, State]):
    """The states of a robot that is elsewhere. `with RemoteStates("tcp/192.168.0.5:7447", robot="hubo") as states: …`

    They have values, ages, histories, `rate()` and all else; `states["RHY"].set(0.1)` and `give({"RHY": 0.1, …})` send
    set-points. `lost_s` (default: five of the publisher's periods, at least 0.25 s) is the silence after which all are
    unknown. `open` raises `NoReplyError` without an answer within `timeout_s`, `CallerError` for a wrong endpoint.
    `bad` counts messages that were none, `cycles` those that were, `unannounced` states that came without being announced.
    """

    def __init__(
        self,
        endpoint: str = ENDPOINT,
        *,
        robot: str = "robot",
        lost_s: float | None = None,
        timeout_s: float = 5.0,
        history: int = 512,
        clock: Clock | None = None,
        options: Options | None = None,
    ) -> None:
        self.endpoint, self.robot, self.timeout_s = endpoint, robot, timeout_s
        self.name = f"zenoh {endpoint} {robot}"
        self._key = robot_key(robot)
        if isinstance(clock, VirtualClock):
            raise CallerError(
                f"{self.name}: virtual time does not wait for another machine; use a real clock"
            )
        self.local = RealClock() if clock is None else clock
        self.clock = RemoteClock(self.local, self.name)
        self.history = history
        self.events = AccessEvents()
        self.cycles = self.bad = self.unannounced = 0
        self.takes = False
        self._lost_s = lost_s
        self._options = dict(options or {})
        self._states: dict[str, RemoteState] = {}
        self._about: AboutStates | None = None
        self._session: Any = None
        self._lock = threading.Lock()
        self._known = threading.Event()
        self._closing = threading.Event()
        self._watcher: threading.Thread | None = None
        self._threads: list[threading.Thread] = []
        #: Somebody publishes who was not asked yet what.
        self._wants = threading.Event()
        self._patience_s = ANSWER_S
        self._was_lost = False
        self._decode = msgspec.json.Decoder(StateValues).decode
        self._decode_about = msgspec.json.Decoder(AboutStates).decode

    # ------------------------------------------------------------------ opening

    def open(self) -> Self:
        """Connect, and learn which states there are."""
        if self._session is not None:
            return self
        self._closing.clear()
        self._session = open_session([], [self.endpoint], self._options)
        atexit.register(self.close)
        self._threads = [subscribe(self._session.declare_subscriber, f"{self._key}/values", self._received)]
        self._wants.set()
        self._patience_s = ANSWER_S
        self._watcher = threading.Thread(target=self._watch, name=self.name, daemon=True)
        self._watcher.start()
        if not self._known.wait(self.timeout_s):
            self.close()
            raise NoReplyError(
                f"{self.name}: there is no publisher (waited {self.timeout_s:g} s); is a Publisher of this robot's name"
                " running, and the endpoint its own?"
            )
        return self

    def close(self) -> None:
        """Stop listening: all states become unknown. A second call does nothing."""
        self._closing.set()
        watcher, self._watcher = self._watcher, None
        if watcher is not None and watcher is not threading.current_thread():
            watcher.join(5.0)
        session, self._session = self._session, None
        if session is not None:
            atexit.unregister(self.close)
            closed(session, self._threads)
        self._known.clear()
        self.clock.forget()

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    # ------------------------------------------------------------------ as a mapping

    def __getitem__(self, name: str) -> State:
        try:
            return self._states[name]
        except KeyError:
            raise UnknownNameError(f"state at {self.endpoint}", name, self._states) from None

    def __contains__(self, name: object) -> bool:
        return name in self._states

    def __iter__(self) -> Iterator[str]:
        return iter(list(self._states))

    def __len__(self) -> int:
        return len(self._states)

    @property
    def lost_s(self) -> float:
        """The silence after which states are unknown."""
        if self._lost_s is not None:
            return self._lost_s
        return 0.25 if self._about is None else max(0.25, 5 / self._about.rate_hz)

    @property
    def is_lost(self) -> bool:
        """True if nothing has been received for `lost_s`."""
        return self.clock.silence_ns > self.lost_s * 1e9

    def give(self, values: Mapping[str, float]) -> None:
        """Send set-points together. Raises `CallerError` where one cannot be set, or nothing is connected."""
        session = self._session
        if session is None:
            raise CallerError(f"{self.name}: not open")
        for name, value in values.items():
            if not self[name].is_writable:
                raise CallerError(f"{self.name}: {name} cannot be set from here")
            if not -float("inf") < value < float("inf"):
                raise CallerError(f"{self.name}: {name}: {value!r} is not a finite number")
        if values:
            with suppress(Exception):  # a lost connection shows by its silence
                session.put(f"{self._key}/set", msgspec.json.encode(dict(values)))

    # ------------------------------------------------------------------ what comes

    def _ask(self) -> None:
        """Ask what there is, and wait for the answer."""
        session = self._session
        if session is None:
            return
        with suppress(Exception):  # the library's own kinds: not connected, or closed meanwhile
            for reply in session.get(f"{self._key}/about", timeout=self._patience_s):
                self._answered(reply)
        self._patience_s = min(MOST_ANSWER_S, 2 * self._patience_s)

    def _answered(self, reply: Any) -> None:
        if reply.ok is None:
            return  # no answer in time: asked again, if need be
        about = decoded(self._decode_about, reply.ok)
        if about is None or len(about.states) > MOST_STATES or not 0 < about.rate_hz <= 1e6:
            self.bad += 1
            return
        with self._lock:
            try:
                self._learn(about)
            except Exception:  # names or units that cannot be a state's
                self.bad += 1

    def _learn(self, about: AboutStates) -> None:
        before = self._about
        if before is not None and before.session == about.session:
            return
        for name, state in about.states.items():
            known = self._states.get(name)
            if known is None:
                self._states[name] = RemoteState(
                    name, self, state.unit, state.writable, state.stale_after_s, self.history
                )
            else:
                known.clear()
                known.is_writable = state.writable
        for name in self._states.keys() - about.states.keys():
            self._states[name].clear()
            self._states[name].is_writable = False
            if len(self._states) > MOST_STATES:
                del self._states[name]
        self.clock.forget()
        self._about, self.takes = about, about.takes
        self._patience_s = ANSWER_S / 2  # `_ask` doubles it
        if before is not None:
            self.events.emit(AccessEvent("restarted", self.local.now(), self.name, "another run answers"))
        self._known.set()

    def _received(self, sample: Any) -> None:
        cycle = decoded(self._decode, sample)
        if cycle is None or not 0 <= cycle.now < 1 << 62 or len(cycle.states) > MOST_STATES:
            self.bad += 1
            return
        if self._about is None or cycle.session != self._about.session:
            self._wants.set()
            return
        with self._lock:
            self.cycles += 1
            self.clock.received(cycle.now)
            for name, (value, instant) in cycle.states.items():
                state = self._states.get(name)
                if state is None:
                    self.unannounced += 1
                elif instant is not None and abs(instant) < 1 << 62:
                    state.take(UNKNOWN if value is None else value, instant)

    def _watch(self) -> None:
        """Ask who publishes, and what; report when nothing comes any more, and when it does again."""
        while not self._closing.is_set():
            if self._about is None or self._wants.is_set():
                self._wants.clear()
                self._ask()
            if self._closing.wait(0.02 if self._about is None else min(0.05, self.lost_s / 4)):
                return
            is_lost = self.is_lost and self._about is not None
            if is_lost != self._was_lost:
                self._was_lost = is_lost
                detail = f"nothing for {self.lost_s:g} s; all its states are unknown" if is_lost else ""
                kind = "lost" if is_lost else "back"
                self.events.emit(AccessEvent(kind, self.local.now(), self.name, detail))
