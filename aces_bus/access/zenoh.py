"""States over zenoh: published where the robot is, and looking like states wherever a controller runs.

1. Endpoints are explicit and loopback by default; nothing is searched for on the network (no multicast, no gossip).
2. Instants and ages are those of the publisher's clock: a remote state's `clock` is that one, as it is guessed from here.
3. A connection that is lost makes every remote state unknown after `lost_s`, and is told; another run of the publisher
   begins all histories anew. Where set-points stop coming, the robot's side is told after `dead_man_s`, and `on_lost`
   called.
4. What comes is untrusted: bounded, of the stated types, counted in `bad`, never raised.

The keys, for programs in other languages (JSON, UTF-8), with `aces/ROBOT` before them: `/values`, published at the rate:
`{"session": 7, "now": NS, "states": {"RHY": [0.1, NS]}}`, value null where unknown, then the instant it was measured at;
`/set`, which the robot takes: `{"RHY": 0.1}`; `/about`, a query: units, which can be set, after which age values are
stale.

Needs the extra `[zenoh]` (eclipse-zenoh).
"""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any, Self

import msgspec

from ..errors import CallerError, NoReplyError, UnknownNameError
from ..runtime import Clock, RealClock, VirtualClock
from ..state import UNKNOWN, State
from .events import AccessEvent, AccessEvents
from .inlet import Inlet
from .remote import RemoteClock, RemoteState
from .zenoh_wire import (
    ANSWER_S,
    ENDPOINT,
    MOST_ANSWER_S,
    MOST_STATES,
    AboutStates,
    Options,
    StateAbout,
    StateValues,
    closed,
    decoded,
    open_session,
    robot_key,
    subscribe,
)


class Publisher:
    """Publishes states at a rate, and takes set-points where `allow_set`; a `Runner` has it among its `loggers`.

        run = run_virtual(robot, [], loggers=[Publisher(["RHY", "LHY"], 100, allow_set=True)])

    `on_lost` is called on the clock's thread when set-points came and have not for `dead_man_s` (None: never), such as
    `run.rig.stop_motion`. `options` are zenoh's own, by key ("transport/link/tls": {…}). Raises `CallerError` when the
    endpoint cannot be had.
    """

    def __init__(
        self,
        states: Iterable[str],
        rate_hz: float = 100.0,
        endpoint: str = ENDPOINT,
        *,
        robot: str = "",
        clock: Any = None,
        allow_set: bool = False,
        dead_man_s: float | None = 0.5,
        on_lost: Callable[[], Any] | None = None,
        options: Options | None = None,
    ) -> None:
        self.name = f"zenoh {endpoint}"
        if not 0 < rate_hz <= 10_000:
            raise CallerError(f"{self.name}: rate_hz = {rate_hz!r} is no rate up to 10 kHz")
        self.rate_hz, self.endpoint, self.robot = rate_hz, endpoint, robot
        self.states = tuple(dict.fromkeys(states))
        if not 0 < len(self.states) <= MOST_STATES:
            raise CallerError(
                f"{self.name}: 1 to {MOST_STATES} states can be published, not {len(self.states)}"
            )
        self.allow_set, self.dead_man_s, self.on_lost = allow_set, dead_man_s, on_lost
        self.events = AccessEvents()
        #: Messages sent; that zenoh did not take; that were no set-points.
        self.sent = self.failed = self.bad = 0
        self._clock = clock
        self._options = dict(options or {})
        self._bound: dict[str, Any] = {}
        self._session: Any = None
        self._publisher: Any = None
        self._threads: list[threading.Thread] = []
        self._inlet: Inlet | None = None
        self._number = 0
        self._about = b""
        self._is_lost = False
        self._encode = msgspec.json.Encoder().encode
        self._decode = msgspec.json.Decoder(dict[str, float]).decode

    @property
    def inlet(self) -> Inlet | None:
        """Where set-points come in, once it is started; None when none are taken."""
        return self._inlet

    def bind(self, states: Mapping[str, Any]) -> None:
        """Take the states; `UnknownNameError` lists those that exist when one is missing."""
        for name in self.states:
            if name not in states:
                raise UnknownNameError(f"state ({self.name} is to publish it)", name, states)
        self._bound = {name: states[name] for name in self.states}
        rig = getattr(states, "rig", None)
        self.robot = self.robot or str(getattr(getattr(rig, "robot", None), "name", "")) or "robot"
        if self._clock is None:
            self._clock = getattr(rig, "clock", None) or next(iter(self._bound.values())).clock
        if self.allow_set and not hasattr(self._clock, "call_soon"):
            raise CallerError(
                f"{self.name}: set-points need a clock that plans: give clock=, a Loop for example"
            )

    def start(self, now: int) -> None:
        """Listen and publish."""
        if not self._bound:
            raise CallerError(f"{self.name}: give it its states first: bind(states)")
        key = robot_key(self.robot)
        # A number that no other run has, and that fits JSON in every language.
        self._number = int.from_bytes(os.urandom(6))
        about = AboutStates(self._number, self.rate_hz, self._clock.name, {}, self.allow_set)
        for name, state in self._bound.items():
            about.states[name] = StateAbout(
                state.unit or "",
                self.allow_set and bool(getattr(state, "is_writable", False)),
                state.stale_after_s,
            )
        self._about = msgspec.json.encode(about)
        self._session = open_session([self.endpoint], [], self._options)
        atexit.register(self.stop, 0)
        self._publisher = self._session.declare_publisher(f"{key}/values")
        if self.allow_set:
            # Virtual time has one thread, and it is not zenoh's: there, each step takes what has come.
            plans = not isinstance(self._clock, VirtualClock)
            self._inlet = Inlet(self._clock, self._bound, self.events, self.name, plans=plans)
            self._threads.append(subscribe(self._session.declare_subscriber, f"{key}/set", self._set))
        # Last: whoever is answered knows of the others by then, as zenoh tells them in order.
        self._threads.append(subscribe(self._session.declare_queryable, f"{key}/about", self._tell_about))
        self.step(now)

    def step(self, now: int) -> None:
        """Publish once. zenoh drops what it cannot send, and does not wait."""
        publisher = self._publisher
        if publisher is None:
            return
        cycle = StateValues(self._number, now, {})
        for name, state in self._bound.items():
            try:
                value = float(state[0])
            except Exception:  # UNKNOWN, or a derived quantity's own
                value = None
            cycle.states[name] = (value, state.instant)
        try:
            publisher.put(self._encode(cycle))
            self.sent += 1
        except Exception:  # the library's own kinds
            self.failed += 1
        if self._inlet is not None:
            if not self._inlet.plans:
                self._inlet.flush()
            self._watch(now)

    def stop(self, now: int) -> None:
        """Publish no more; twice does nothing."""
        session, self._session, self._publisher = self._session, None, None
        if session is not None:
            atexit.unregister(self.stop)
            closed(session, self._threads)

    def _watch(self, now: int) -> None:
        """The dead-man of rule 3."""
        assert self._inlet is not None
        taken = self._inlet.taken_at
        if taken is None or self.dead_man_s is None:
            return
        if now - taken <= self.dead_man_s * 1e9:
            self._is_lost = False
        elif not self._is_lost:
            self._is_lost = True
            detail = f"no set-points for {self.dead_man_s:g} s"
            self.events.tell(AccessEvent("lost", now, self.name, detail))
            if self.on_lost is not None:
                self._clock.call_soon(self.on_lost)

    def _tell_about(self, query: Any) -> None:
        with suppress(Exception):  # whoever asked is gone
            query.reply(query.key_expr, self._about)

    def _set(self, sample: Any) -> None:
        inlet = self._inlet
        values = decoded(self._decode, sample)
        if values is None or inlet is None or len(values) > MOST_STATES:
            self.bad += 1
        else:
            inlet.put(values)

    def __enter__(self) -> Self:
        self.start(self._clock.now())
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(0)


class RemoteStates(Mapping[str, State]):
    """The states of a robot that is elsewhere. `with RemoteStates("tcp/192.168.0.5:7447", robot="hubo") as states: …`

    They have values, ages, histories, `rate()` and all else; `states["RHY"].set(0.1)` and `give({"RHY": 0.1, …})` send
    set-points. `lost_s` (default: five of the publisher's periods, at least 0.25 s) is the silence after which all are
    unknown. `open` raises `NoReplyError` when nobody answers within `timeout_s`, `CallerError` for a wrong endpoint.
    `bad` counts messages that were none, `cycles` those that were, `strangers` states that came without being announced.
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
        self.cycles = self.bad = self.strangers = 0
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
        self._threads = [subscribe(self._session.declare_subscriber, f"{self._key}/values", self._heard)]
        self._wants.set()
        self._patience_s = ANSWER_S
        self._watcher = threading.Thread(target=self._watch, name=self.name, daemon=True)
        self._watcher.start()
        if not self._known.wait(self.timeout_s):
            self.close()
            raise NoReplyError(
                f"{self.name}: nobody publishes there (waited {self.timeout_s:g} s); is a Publisher of this robot's name"
                " running, and the endpoint its own?"
            )
        return self

    def close(self) -> None:
        """Hear no more: all states become unknown. Twice does nothing."""
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
        """Whether nothing has come for `lost_s`."""
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
            with suppress(Exception):  # a connection that is lost is told by its silence
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
            return  # nobody answered in time: asked again, if need be
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
        for name, one in about.states.items():
            known = self._states.get(name)
            if known is None:
                self._states[name] = RemoteState(
                    name, self, one.unit, one.writable, one.stale_after_s, self.history
                )
            else:
                known.clear()
                known.is_writable = one.writable
        for name in self._states.keys() - about.states.keys():
            self._states[name].clear()
            self._states[name].is_writable = False
            if len(self._states) > MOST_STATES:
                del self._states[name]
        self.clock.forget()
        self._about, self.takes = about, about.takes
        self._patience_s = ANSWER_S / 2  # `_ask` doubles it
        if before is not None:
            self.events.tell(AccessEvent("restarted", self.local.now(), self.name, "another run answers"))
        self._known.set()

    def _heard(self, sample: Any) -> None:
        cycle = decoded(self._decode, sample)
        if cycle is None or not 0 <= cycle.now < 1 << 62 or len(cycle.states) > MOST_STATES:
            self.bad += 1
            return
        if self._about is None or cycle.session != self._about.session:
            self._wants.set()
            return
        with self._lock:
            self.cycles += 1
            self.clock.heard(cycle.now)
            for name, (value, instant) in cycle.states.items():
                state = self._states.get(name)
                if state is None:
                    self.strangers += 1
                elif instant is not None and abs(instant) < 1 << 62:
                    state.take(UNKNOWN if value is None else value, instant)

    def _watch(self) -> None:
        """Ask who publishes, and what; tell when nothing comes any more, and when it does again."""
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
                self.events.tell(AccessEvent(kind, self.local.now(), self.name, detail))
