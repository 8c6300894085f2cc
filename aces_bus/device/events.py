"""Events of devices, given to handlers at once (the paper's shortcut for errors)."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from typing import Literal

import msgspec

from ..errors import CallerError

Kind = Literal[
    "silent",  # does not answer any more
    "answers",  # does again
    "no reply",  # a request was not answered, however often it was sent
    "late reply",  # an answer after its time
    "duplicate reply",  # a second answer to one request
    "two devices",  # answers come twice again and again: two devices with one number
    "unknown device",  # a device that is not on this bus in the robot's file
    "malformed",  # a frame or packet that is none of the device's messages
    "garbled",  # a packet of a serial line whose check does not hold, or that is not whole
    "rebooted",  # lost its state
    "alarm",  # the device reports a fault
    "alarm over",
    "limited",  # a set-point was beyond its limits, or further away than one tick leads
    "refused",  # set-points are not taken any more: again and again they were not numbers
    "following error",  # a joint is not where it was sent
    "past limit",  # a joint is measured past the limits of its file
    "not homed",  # a joint was given a set-point before its zero is known
    "too fast",  # a joint is measured faster than its file allows
    "not sent",  # a packet cannot be made, the bus does not take it, or it did not leave in time
    "not stopped",  # has not stopped yet
    "stop asked",  # another program asked for a stop of all that is driven
    "overrun",  # a tick's packets did not fit into the tick
    "bug",  # a driver's own code raised
    "estop",  # an e-stop input is pressed, or cannot be read
    "estop clear",
    "reduced",  # limits of speed are reduced
    "full speed",
    # of the bus, as gates and wires report them
    "opened",
    "lost",
    "reopened",
    "closed",
    "error-active",
    "error-passive",
    "bus-off",
    "recovered",
    "dropped",
    "stalled",  # the adapter does not take in time what devices are asked
    "send failed",
    "bad input",
    "clock",
    "listener",
]


class DeviceEvent(msgspec.Struct, frozen=True):
    """What, when (ns), on which bus, of which device ("" where none is meant), and the details."""

    kind: Kind
    instant: int
    bus: str
    device: str
    detail: str = ""

    @property
    def source(self) -> str:
        """Who it is about: the device, or the bus where no device is meant."""
        return self.device or self.bus

    def __str__(self) -> str:
        who = f"{self.bus} {self.device}".strip()
        return f"{self.instant / 1e9:.6f} {who}: {self.kind}{f': {self.detail}' if self.detail else ''}"


#: Events of one kind and device are reported this often at most (ns); all are counted.
REPEAT_NS = 1_000_000_000
#: Reports of a change: each one is given to handlers.
REPORTED_ALWAYS = frozenset(
    (
        *("silent", "answers", "alarm", "alarm over", "rebooted", "stop asked", "past limit", "too fast"),
        *("estop", "estop clear", "reduced", "full speed"),
        *("opened", "lost", "reopened", "closed", "error-active", "error-passive", "bus-off", "recovered"),
    )
)
#: So many different events are distinguished.
MOST_KEYS = 10_000


class EventLog:
    """Handlers, counts a kind and device, and the last events. What a handler raises is kept in `failures`.

    `acts` are called with what is done on purpose (enable, stop, another owner): what, the device, in words.
    """

    def __init__(self, keep: int = 1024) -> None:
        if keep < 0:
            raise CallerError(f"keep is a number of events, not {keep!r}")
        self.handlers: list[Callable[[DeviceEvent], None]] = []
        self.acts: list[Callable[[str, str, str], None]] = []
        self.last: deque[DeviceEvent] = deque(maxlen=keep)
        self.counts: Counter[tuple[str, str]] = Counter()
        self.failures: deque[BaseException] = deque(maxlen=16)
        self._last: dict[tuple[str, str, str], int] = {}

    def emit(self, event: DeviceEvent) -> None:
        """Count it, keep it and hand it on; the same of one device at most once a second, unless it is a change."""
        self.counts[event.kind, event.device] += 1
        # Unknown devices have no name: their details distinguish them.
        who = event.device or event.detail if event.kind == "unknown device" else event.device
        key = (event.bus, event.kind, who)
        last = self._last.get(key)
        if last is not None and event.instant - last < REPEAT_NS and event.kind not in REPORTED_ALWAYS:
            return
        if len(self._last) > MOST_KEYS:
            self._last.clear()
        self._last[key] = event.instant
        self.last.append(event)
        for handler in self.handlers:
            try:
                handler(event)
            except Exception as error:  # a user's code: it must not stop the bus
                self.failures.append(error)

    def act(self, what: str, device: str, detail: str = "") -> None:
        """Say that something is done to a device on purpose."""
        for handler in self.acts:
            try:
                handler(what, device, detail)
            except Exception as error:
                self.failures.append(error)

    def count(self, kind: str, device: str | None = None) -> int:
        """Return how many events of a kind there were, of one device or of all."""
        return sum(n for (k, d), n in self.counts.items() if k == kind and device in (None, d))

    def of(self, kind: str) -> list[DeviceEvent]:
        """Return the last events of a kind."""
        return [event for event in self.last if event.kind == kind]
