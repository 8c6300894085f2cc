"""States over zenoh, published where the robot is: sessions, keys, messages, and the publisher. `remote` has the other end.

1. Endpoints are explicit and loopback by default; nothing is searched for on the network (no multicast, no gossip).
2. Instants and ages are those of the publisher's clock: a remote state's `clock` is that one, as it is guessed from here.
3. A connection that is lost makes every remote state unknown after `lost_s`, and is reported; another run of the publisher
   begins all histories anew. Where set-points stop coming, the robot's side reports it after `dead_man_s`, and `on_lost`
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
import json
import os
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from types import ModuleType
from typing import Any, Self

import msgspec

from aces_bus.access.inlet import AccessEvent, AccessEvents, Inlet
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.runtime import VirtualClock

ENDPOINT = "tcp/127.0.0.1:7447"
#: Bytes of a message: 2,000 states.
MOST_BYTES = 1 << 18
MOST_STATES = 2_000
#: Messages that wait to be taken, at most.
WAITING = 64
#: How long an answer is waited for at first, and twice as long each time up to the last (s): the first question is often
#: asked before the way is known.
ANSWER_S, MOST_ANSWER_S = 0.1, 2.0
Options = Mapping[str, Any]


class StateValues(msgspec.Struct):
    """One cycle of a publisher: by state the value (None where unknown) and its instant."""

    session: int
    now: int
    states: dict[str, tuple[float | None, int | None]]


class StateAbout(msgspec.Struct):
    """What a state is."""

    unit: str = ""
    writable: bool = False
    stale_after_s: float | None = None


class AboutStates(msgspec.Struct):
    """What a publisher publishes."""

    session: int
    rate_hz: float
    clock: str
    states: dict[str, StateAbout]
    takes: bool = False


def zenoh() -> ModuleType:
    """Return the library; `CallerError` naming the extra when it is missing."""
    try:
        import zenoh as library
    except ImportError as missing:
        raise CallerError(
            f"zenoh needs eclipse-zenoh: pip install 'aces-bus[zenoh]' ({missing})"
        ) from missing
    return library


def open_session(listen: Iterable[str], connect: Iterable[str], options: Options) -> Any:
    """Open a session with these endpoints and no others. Raises `CallerError` when that cannot be."""
    library = zenoh()
    settings = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/exit_on_failure": False,
        "connect/timeout_ms": 0,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5},
        **options,
    }
    try:
        config = library.Config()
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return library.open(config)
    except library.ZError as error:
        why = " ".join(str(error).partition(" at /")[0].split()).removeprefix("Json5Err(Message { msg: ")
        raise CallerError(f"zenoh at {', '.join([*listen, *connect])}: {why[:300]}") from None


def subscribe(declare: Callable[..., Any], key: str, take: Callable[[Any], None]) -> threading.Thread:
    """Have `take` called with all that comes at a key, until the session is closed; the oldest of too many is left out.

    On a thread of our own: a program that ends with one of the library's (eclipse-zenoh 1.10) does not end.
    """
    channel = declare(key, zenoh().handlers.RingChannel(WAITING))

    def run() -> None:
        with suppress(Exception):  # the library's own kind: the session is closed
            for setter in channel:
                take(setter)

    thread = threading.Thread(target=run, name=f"zenoh {key}", daemon=True)
    thread.start()
    return thread


def closed(session: Any, threads: list[threading.Thread]) -> None:
    """Close a session, and let what receives from it end: a thread inside the library must not outlive the interpreter."""
    session.close()
    for thread in threads:
        if thread is not threading.current_thread():
            thread.join(2.0)
    threads.clear()


def robot_key(robot: str) -> str:
    """Return the beginning of a robot's keys; raises `CallerError` for a name that cannot be in one."""
    if not robot or len(robot) > 100 or set(robot) & set("*$?#/ ") or not robot.isprintable():
        raise CallerError(
            f"{robot!r} cannot be a robot's name in zenoh; say robot=, without * $ ? # / and blanks"
        )
    return f"aces/{robot}"


def decoded(decode: Callable[[bytes], Any], sample: Any) -> Any:
    """Return a message, or None."""
    try:
        payload = sample.payload
        if len(payload) > MOST_BYTES:
            return None
        return decode(bytes(payload))
    except Exception:  # the library's own kinds too
        return None


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
        on_lost: Callable[[], object] | None = None,
        options: Options | None = None,
    ) -> None:
        self.name = f"zenoh {endpoint}"
        if not 0 < rate_hz <= 10_000:
            raise CallerError(f"{self.name}: rate_hz = {rate_hz!r} is not a rate up to 10 kHz")
        self.rate_hz, self.endpoint, self.robot = rate_hz, endpoint, robot
        self.states = tuple(dict.fromkeys(states))
        if not 0 < len(self.states) <= MOST_STATES:
            raise CallerError(
                f"{self.name}: 1 to {MOST_STATES} states can be published, not {len(self.states)}"
            )
        self.allow_set, self.dead_man_s, self.on_lost = allow_set, dead_man_s, on_lost
        self.events = AccessEvents()
        #: Messages sent; that zenoh did not take; that were not set-points.
        self.sent = self.failed = self.bad = 0
        self._clock = clock
        self._options = dict(options or {})
        self._bound: dict[str, Any] = {}
        self._all: Mapping[str, Any] = {}
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
        """Inlet of set-points, once the publisher has started; None when it accepts none."""
        return self._inlet

    def bind(self, states: Mapping[str, Any]) -> None:
        """Take the states; `UnknownNameError` lists those that exist when one is missing."""
        for name in self.states:
            if name not in states:
                raise UnknownNameError(f"state ({self.name} is to publish it)", name, states)
        self._bound, self._all = {name: states[name] for name in self.states}, states
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
            self._inlet = Inlet(
                self._clock, self._bound, self.events, self.name, plans=plans, all_states=self._all
            )
            self._threads.append(subscribe(self._session.declare_subscriber, f"{key}/set", self._set))
        # Last: whoever is answered knows of the others by then, as zenoh tells them in order.
        self._threads.append(subscribe(self._session.declare_queryable, f"{key}/about", self._answer_about))
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
            if self._inlet is not None:
                self._inlet.give_up()

    def _watch(self, now: int) -> None:
        """Check the dead-man of rule 3."""
        assert self._inlet is not None
        taken = self._inlet.taken_at
        if taken is None or self.dead_man_s is None:
            return
        if now - taken <= self.dead_man_s * 1e9:
            self._is_lost = False
        elif not self._is_lost:
            self._is_lost = True
            detail = f"no set-points for {self.dead_man_s:g} s"
            self.events.emit(AccessEvent("lost", now, self.name, detail))
            if self.on_lost is not None:
                self._clock.call_soon(self.on_lost)

    def _answer_about(self, query: Any) -> None:
        with suppress(Exception):  # the asker is gone
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
