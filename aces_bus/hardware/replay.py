"""A capture as a bus: at its own pace, faster, or in virtual time.

1. A replay is only received; nothing can be sent. What a capture says of time and channel is kept in the frames.
2. Frames without a time follow the one before them at once; time that goes back in a capture does not stop the replay.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from can import BusABC, CanInitializationError, CanOperationError, CanProtocol, Message

from ..errors import AcesError, CallerError
from ..frame_table import NO_TIME, to_ns
from ..frames import Frame
from ..python_can import frame_to_message
from ..recordings.base import CanRecording
from ..recordings.open import open_recording
from ..runtime import RealClock, VirtualClock
from ..runtime.clock import Clock

Frames = CanRecording | Iterable[Frame]


class Pace:
    """When a frame of a capture is due, in ns of a clock. `speed` 2 is twice as fast; None is as fast as can be.

    `longest_gap` (seconds of the capture) shortens longer silences.
    """

    def __init__(self, clock: Clock, speed: float | None = 1.0, longest_gap: float | None = None) -> None:
        if speed is not None and not 0 < speed <= 1e6:
            raise CallerError(f"a speed of {speed} is not a pace; 1 is the capture's own")
        self.clock, self.speed = clock, speed
        self._longest = None if longest_gap is None else round(longest_gap * 1e9)
        self._last: int | None = None
        self._due = clock.now()

    def due(self, frame: Frame) -> int:
        """Return the instant at which this frame, the next of the capture, is due."""
        return self.due_at(to_ns(frame.timestamp))

    def due_at(self, stamp: int) -> int:
        """Return when an item with this time stamp (ns of the capture, or `NO_TIME`) is due."""
        if stamp == NO_TIME or self.speed is None:
            return self._due
        if self._last is not None:
            gap = max(0, stamp - self._last)
            if self._longest is not None:
                gap = min(gap, self._longest)
            self._due += round(gap / self.speed)
        self._last = stamp
        return self._due


def paced(
    frames: Frames,
    *,
    clock: Clock | None = None,
    speed: float | None = 1.0,
    longest_gap: float | None = None,
) -> Iterator[Frame]:
    """Yield the frames of a capture, each given out when it is due: waited for in life, brought about in virtual time."""
    clock = clock if clock is not None else RealClock()
    pace = Pace(clock, speed, longest_gap)
    for frame in frames:
        clock.sleep_until(pace.due(frame))
        yield frame


def replay_into(
    clock: VirtualClock, frames: Frames, deliver: Callable[[Frame], object], *, speed: float | None = 1.0
) -> None:
    """Plan a whole capture as events of a virtual clock, one at a time: `deliver` is called when each frame is due.

    >>> from aces_bus.runtime import VirtualClock
    >>> clock = VirtualClock()
    >>> frames = [Frame(1, timestamp=10.0), Frame(2, timestamp=10.5)]
    >>> replay_into(clock, frames, lambda frame: print(clock.now(), frame.arbitration_id))
    >>> clock.advance(10**9)
    0 1
    500000000 2
    """
    if speed is None:
        raise CallerError("in virtual time everything is as fast as can be; give a speed, or none at all")
    pace = Pace(clock, speed)
    source = iter(frames)

    def plan() -> None:
        frame = next(source, None)
        if frame is None:
            return

        def happen() -> None:
            deliver(frame)
            plan()

        clock.call_at(pace.due(frame), happen)

    plan()


class ReplayBus(BusABC):
    """A capture as a python-can bus: `can.Bus("walk.log", "aces-replay", speed=2)`.

    `recv` gives the frames when they are due, with the capture's own stamps and channels; then it waits like a silent
    bus, or raises with `end="raise"`. `loop` begins again. Sending raises `CanOperationError`.
    """

    def __init__(
        self,
        channel: Any,
        can_filters: Any = None,
        *,
        speed: float | str | None = 1.0,
        loop: bool = False,
        longest_gap: float | None = None,
        end: str = "wait",
        **more: Any,
    ) -> None:
        self._path = str(channel)
        self._speed = None if speed in (None, "max") else float(speed)
        self._loop, self._gap = bool(loop), None if longest_gap is None else float(longest_gap)
        if end not in ("wait", "raise"):
            raise CanInitializationError(f"end is 'wait' or 'raise', not {end!r}")
        self._end = end
        self._clock = RealClock()
        self._closed = threading.Event()
        self._next: tuple[int, Frame] | None = None
        #: Whether the capture is over.
        self.is_over = False
        try:
            self._frames = self._opened()
            self._pace = Pace(self._clock, self._speed, self._gap)
            self._look()
        except AcesError as error:
            raise CanInitializationError(str(error)) from error
        self.channel_info = f"replay of {self._path}"
        self._can_protocol = CanProtocol.CAN_20
        super().__init__(channel, can_filters, **more)

    def _opened(self) -> Iterator[Frame]:
        self._capture = open_recording(self._path, link="can")
        return iter(self._capture)

    def _look(self) -> None:
        frame = next(self._frames, None)
        if frame is None and self._loop and self._capture.frames:
            self._frames = self._opened()
            frame = next(self._frames, None)
            self._pace = Pace(self._clock, self._speed, self._gap)
        self._next = None if frame is None else (self._pace.due(frame), frame)
        self.is_over = frame is None

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        if self._closed.is_set():
            raise CanOperationError(f"{self.channel_info} is closed")
        now = self._clock.now()
        until = None if timeout is None else now + round(timeout * 1e9)
        if self._next is None:
            if self._end == "raise":
                raise CanOperationError(f"{self.channel_info} is over")
            self._wait(until, now)
            return None, False
        due, frame = self._next
        if due > now:
            self._wait(due if until is None else min(due, until), now)
            if until is not None and due > until:
                return None, False
        try:
            self._look()
        except AcesError as error:
            raise CanOperationError(str(error)) from error
        stamp, channel = frame.timestamp or 0.0, frame.channel or self._path
        return frame_to_message(frame, stamp, channel, is_rx=frame.is_rx is not False), False

    def _wait(self, until: int | None, now: int) -> None:
        self._closed.wait(None if until is None else max(0, until - now) / 1e9)

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Refuse: nothing can be sent into a recording."""
        raise CanOperationError(f"{self.channel_info}: nothing can be sent into a recording")

    def _apply_filters(self, filters: Any) -> None:
        """Do nothing: filters are applied on reading."""

    def shutdown(self) -> None:
        """Close the capture."""
        super().shutdown()
        self._closed.set()
        self._capture.close()
