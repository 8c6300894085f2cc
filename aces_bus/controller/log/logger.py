"""The logger: samples states at a rate, as a controller does, and has them on disk.

1. `step` never waits for a disk. In real time it puts a row into a bounded queue and a thread writes; what does not fit is
   dropped, counted (`dropped`) and reported. In virtual time nothing is waited for but the file, and nothing is dropped.
2. What was sampled `KEPT_S` ago is with the operating system: a killed process loses no more.
3. A disk that is full or gone is reported once, what it did not take is counted (`lost`), and sampling goes on: what can be
   written again later is written.
4. In virtual time the same run gives the same file: rows are written at instants that the rows alone decide.
"""

from __future__ import annotations

import math
import os
import threading
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any, Self

import msgspec

from ...errors import CallerError, UnknownNameError
from ...export.files import telling
from ...runtime import RealClock, VirtualClock
from ...runtime.clock import Clock
from ...state.errors import raise_first
from ...state.quantity import TimeSeries
from ..base import checked_rate
from ..events import ControlEvent, Listeners
from .base import About, LogSink, Row
from .columns import LogColumn, Read, attribute_reader, check_log_columns, parse_column
from .formats import log_format, open_sink

#: Rows are kept back so long at most (s).
KEPT_S = 0.25
#: How often the disk itself is waited for, in real time (ns).
SYNC_NS = 1_000_000_000
#: A disk that took rows for so long is well again, and its next trouble reported (s): a full one takes a small piece now and
#: then.
WELL_S = 5
#: Rows written at once.
MOST_ROWS = 4096
#: The queue holds at least so many rows.
LEAST_QUEUE = 64


class Logger:
    """States on their way into a file: one of a `Runner`'s `loggers`, or alone by `start`, `step` and `stop`.

    `states` are columns: "RHY", "RHY.velocity", "RHY(rate)", "RHY(integral)", "RHY(setpoint)", "RHY(age)"; or quantities
    themselves, such as `(torque * speed).named("power")`. The suffix of `path` says the format: .txt (the original's), .csv,
    .db or .sqlite, .parquet, .mcap; `format` says it where the suffix does not. An existing file is replaced, unless
    `replace` is False. `queue_s` is how much waits for a slow disk before rows are dropped; `digits=6` writes text as the
    original did. `clock` is by default that of the states.

    Raises `CallerError` for columns, rates and paths that cannot be.

    >>> from aces_bus.runtime import VirtualClock
    >>> from aces_bus.state import State
    >>> clock = VirtualClock()
    >>> hip = State("hip", unit="rad", clock=clock)
    >>> logger = Logger("hip.csv", [hip, "hip(rate)"], rate_hz=200)
    >>> logger.states, [column.name for column in logger.columns]
    (('hip',), ['hip', 'hip(rate)'])
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        states: Iterable[str | TimeSeries],
        *,
        rate_hz: float = 100.0,
        format: str | None = None,
        clock: Clock | None = None,
        name: str = "",
        robot: str = "",
        queue_s: float = 5.0,
        digits: int | None = None,
        replace: bool = True,
    ) -> None:
        self.path = os.fspath(path)
        self.name = name or f"log {os.path.basename(self.path)}"
        self.rate_hz = checked_rate(rate_hz, self.name)
        self.format = log_format(self.path, format)
        raise_first(
            CallerError,
            (
                digits is not None and (self.format != "text" or not 1 <= digits <= 17),
                f"{self.path}: digits = {digits!r} is for text, and from 1 to 17",
            ),
            (
                not 0 < queue_s <= 3600,
                f"{self.path}: queue_s = {queue_s!r} is not a number of seconds up to 3600",
            ),
            (isinstance(states, str), f"{self.path}: states are a list of columns, not the text {states!r}"),
        )
        self.robot, self.digits, self.replace = robot, digits, replace
        self._given: dict[str, TimeSeries] = {}
        columns: list[LogColumn] = []
        for state in states:
            if isinstance(state, str):
                columns.append(parse_column(state))
            else:
                self._given[state.name] = state
                columns.append(LogColumn(state.name))
        self.columns = tuple(columns)
        check_log_columns(self.path, [column.name for column in columns])
        if self.format == "text":
            check_log_columns(self.path, [column.original for column in columns])
        #: What `bind` is to give.
        self.states: tuple[str, ...] = tuple(dict.fromkeys(column.state for column in columns))
        self.capacity = max(LEAST_QUEUE, math.ceil(queue_s * self.rate_hz))
        #: Rows that were written; that did not fit into the queue; that the disk did not take.
        self.written = self.dropped = self.lost = 0
        #: What first kept the file from being whole; "" while nothing did.
        self.failure = ""
        #: Called when something is dropped or lost; the events so far, the last few.
        self.listeners = Listeners()
        self.events: deque[ControlEvent] = deque(maxlen=64)
        self._clock = clock
        self._reads: list[Read] = []
        self._sink: LogSink | None = None
        self._queue: deque[Row] = deque()
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._began = self._synced = self._good = 0
        self._is_direct = self._is_dropping = self._is_failing = False
        if self._given and len(self._given) == len(self.states):
            self.bind({})

    # ------------------------------------------------------------------ as a runner calls it

    def bind(self, states: Mapping[str, Any]) -> None:
        """Take the states; `UnknownNameError` lists those that exist when one is missing."""
        reads: list[Read] = []
        columns: list[LogColumn] = []
        found: dict[str, Any] = dict(self._given)
        for column in self.columns:
            name = column.state
            if name not in found:
                if name not in states:
                    raise UnknownNameError(f"state ({self.name} is to record it)", name, states)
                found[name] = states[name]
            read, unit = attribute_reader(column, found[name])
            reads.append(read)
            columns.append(msgspec.structs.replace(column, unit=unit))
        rig = getattr(states, "rig", None)
        if self._clock is None:
            # A robot's, or that of this machine where states are another's; else that of a state.
            self._clock = getattr(rig, "clock", None) or getattr(states, "local", None)
        if self._clock is None:
            self._clock = next((c for s in found.values() if (c := getattr(s, "clock", None))), None)
        self.robot = self.robot or str(getattr(getattr(rig, "robot", None), "name", ""))
        self._reads, self.columns = reads, tuple(columns)

    def start(self, now: int) -> None:
        """Make the file; `now` (ns) is its second 0. Raises `CallerError` when that cannot be."""
        if self._sink is not None:
            raise CallerError(f"{self.name}: was started before")
        if not self._reads:
            raise CallerError(f"{self.name}: give it its states first: bind(states)")
        clock = self._clock = RealClock() if self._clock is None else self._clock
        self._is_direct = isinstance(clock, VirtualClock)
        epoch = None if self._is_direct else getattr(clock, "epoch_ns", None)
        wall = None if epoch is None else now + epoch
        about = About(self.columns, self.rate_hz, self.robot, clock.name, now, wall)
        if not self.replace and os.path.exists(self.path):
            raise CallerError(f"{self.path}: there is a file already; name another, or say replace=True")
        with telling(self.path):
            self._sink = open_sink(self.path, self.format, about, self.digits)
        self._began = self._synced = now
        self._queue.clear()
        self._stopping.clear()
        if not self._is_direct:
            self._thread = threading.Thread(target=self._write_on, name=self.name, daemon=True)
            self._thread.start()

    def step(self, now: int) -> None:
        """Sample once, at `now` (ns)."""
        if self._sink is None:
            return
        queue = self._queue
        if len(queue) >= self.capacity:
            self._drop()
            return
        if self._is_dropping and 2 * len(queue) < self.capacity:
            self._is_dropping = False
        queue.append((now - self._began, [read() for read in self._reads]))
        if self._is_direct:
            waited = queue[-1][0] - queue[0][0]
            if waited >= KEPT_S * 1e9 or len(queue) >= min(MOST_ROWS, self.capacity):
                self._write()

    def stop(self, now: int) -> None:
        """Write what waits, and close the file; twice does nothing."""
        if self._sink is None:
            return
        self._stopping.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join(10.0)
            if thread.is_alive():
                self.lost += len(self._queue)
                self._sink = None
                self._spoil("the disk does not answer")
                self._emit("log-failed", f"the disk does not answer; {self._total()}")
                return
        self._write()
        sink, self._sink = self._sink, None
        for what, act in (("", sink.sync), ("could not be closed: ", sink.close)):
            if act == sink.sync and (self._is_direct or self._is_failing):
                continue
            try:
                act()
            except Exception as error:  # the format's library has errors of its own
                self._spoil(f"{what}{_why(error)}")
                self._emit("log-failed", f"{self.path}: {what}{_why(error)}; {self._total()}")
        if self.dropped:
            self._emit("log-dropped", self._total())

    # ------------------------------------------------------------------ alone

    def __enter__(self) -> Self:
        if self._sink is None:
            self.start((self._clock or RealClock()).now())
        return self

    def __exit__(self, *_: object) -> None:
        self.stop((self._clock or RealClock()).now())

    # ------------------------------------------------------------------ writing

    def _write_on(self) -> None:
        """Write samples until stopped: the body of the writer's thread."""
        while not self._stopping.wait(KEPT_S):
            self._write()
            clock, sink = self._clock, self._sink
            assert clock is not None
            now = clock.now()
            if now - self._synced >= SYNC_NS and sink is not None and not self._is_failing:
                self._synced = now
                try:
                    sink.sync()
                except Exception as error:  # SQLite has errors of its own
                    self._fail(error, 0)

    def _write(self) -> None:
        """Write all waiting rows, in pieces."""
        queue, sink = self._queue, self._sink
        while queue and sink is not None:
            rows = [queue.popleft() for _ in range(min(len(queue), MOST_ROWS))]
            try:
                sink.append(rows)
            except Exception as error:  # a format's library has errors of its own, and sampling goes on
                self._fail(error, len(rows))
            else:
                self.written += len(rows)
                self._good += len(rows)
                if self._good >= WELL_S * self.rate_hz:
                    self._is_failing = False

    def _fail(self, error: Exception, rows: int) -> None:
        self.lost += rows
        self._good = 0
        self._spoil(_why(error))
        if not self._is_failing:
            self._is_failing = True
            self._emit("log-failed", f"{self.path}: {_why(error)}; {self._total()}, and counting")

    def _drop(self) -> None:
        self.dropped += 1
        self._spoil("the disk is too slow")
        if not self._is_dropping:
            self._is_dropping = True
            self._emit("log-dropped", f"{self.path}: the disk is too slow, rows are dropped")

    def _spoil(self, why: str) -> None:
        self.failure = self.failure or why

    def _total(self) -> str:
        return f"{self.written} rows written, {self.dropped} dropped, {self.lost} lost"

    def _emit(self, kind: str, detail: str) -> None:
        now = 0 if self._clock is None else self._clock.now()
        event = ControlEvent(kind, now, self.name, detail)
        self.events.append(event)
        self.listeners.emit(event)

    def __str__(self) -> str:
        return f"{self.name}: {self.rate_hz:g} Hz, {self._total()}"


def _why(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)
