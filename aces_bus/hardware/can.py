"""The gatekeeper of a CAN bus: one owner, any python-can backend, many who listen.

1. The rules of `gate`. A gate that only listens opens a bus that does not acknowledge, where the backend can do that.
2. What one backend does wrong in its own way is known in `backends`, or found by what it does; see the constants.

Two time stamps are kept. `frame.timestamp` is the adapter's, in seconds of its own clock; `host_ns` is this machine's
monotonic clock when the frame was read. An adapter's clock that goes back is reported as an event "clock".
"""

from __future__ import annotations

import errno
import os
from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from ..errors import CallerError
from ..frames import Frame, message_to_frame
from ..runtime.clock import Clock
from .backends import (
    ServedReader,
    SocketcanReader,
    backend_of,
    check_server,
    forget_line,
    reader_of,
    silence,
)
from .gate import POLL_S, ContentFilter, Gate, Received
from .queues import Report
from .simulated.bus import arbitration

if TYPE_CHECKING:
    import can

#: Frames that are handed over at once, so that a busy bus costs its readers few wake-ups; and that a loop reads in one turn.
BATCH, TURN_BATCH = 256, 64
#: This many times nothing, each at once and not after `POLL_S`, is how some backends say that they are dead.
HOLLOW = 50
#: Exceptions that are no `CanError`, in a row, after which the bus is opened anew.
STRANGE = 20
#: Frames that wait to be sent, at most.
OUTBOX = 4096
#: Time that an adapter may hold a frame after `send` has returned (ns), where the backend is not prompt.
LINGER_NS = 50_000_000
#: Seconds between attempts to send when the system's queue, often of ten frames, is full; and how many there are.
FULL_S, FULL_TIMES = 0.001, 1000


Open = Callable[[], "can.BusABC"]


class CanGate(Gate[Frame, Frame, "can.BusABC"]):
    """One CAN bus and its only owner.

    with CanGate({"interface": "socketcan", "channel": "can0"}) as gate:
        inbox = gate.subscribe()
        gate.send(Frame(0x123, b"\\x01"))
        for item in inbox.get(1.0): ...

    `open_bus` is a function that gives a python-can bus, or python-can's own keywords. `reopen`: a lost bus is opened
    again, for ever. `send_rate` limits what is sent, in frames/s; `allow` says which frames may be sent at all (None: all).
    """

    items = unit = "frames"
    most = OUTBOX

    def __init__(
        self,
        open_bus: Open | Mapping[str, Any],
        *,
        name: str = "",
        listen_only: bool = False,
        reopen: bool = True,
        send_rate: float | None = None,
        allow: ContentFilter[Frame] | None = None,
        clock: Clock | None = None,
    ) -> None:
        if send_rate is not None and send_rate <= 0:
            raise CallerError(f"a send rate of {send_rate} frames/s lets nothing through")
        options = None if callable(open_bus) else dict(open_bus)
        self._interface = "" if options is None else str(options.get("interface") or "")
        self._open: Open
        if options is None:
            assert callable(open_bus)
            self._open = open_bus
        else:
            self._open = _opener(options, listen_only=listen_only)
        channel = str(options.get("channel") or self._interface) if options else "can"
        super().__init__(name or channel, listen_only=listen_only, reopen=reopen, clock=clock)
        self.send_rate, self.allow = send_rate, allow
        self._pause = 0 if send_rate is None else round(1e9 / send_rate)
        if send_rate is not None:
            self.together = 1
        self._due = 0
        self._echoes: deque[tuple[int, bytes]] = deque(maxlen=OUTBOX)
        self._controller = "error-active"
        self._last_stamp: float | None = None

    # ------------------------------------------------------------------ the bus

    def _opened(self) -> can.BusABC:
        bus = self._open()
        try:
            if self.listen_only:
                silence(bus)
            self._read = reader_of(bus)
        except Exception:
            self._close(bus)
            raise
        self._overflows = self._changes = 0
        self._last_stamp = None
        self._controller = "error-active"
        known = backend_of(self._interface, bus)
        self._is_echoing = known.echoes
        self.linger_ns = 0 if known.is_prompt else LINGER_NS
        self._is_of_datagrams = known.of_datagrams
        self._quick = self._read if isinstance(self._read, (SocketcanReader, ServedReader)) else None
        self._gathers = self._quick is not None
        self._has_file = self._quick is not None or known.by_file
        self._hollow = self._strange = 0
        return bus

    def _shut(self, bus: can.BusABC) -> None:
        bus.shutdown()

    # ------------------------------------------------------------------ receiving

    def _receive(self) -> None:
        """Receive frames: the body of the receive thread."""
        hollow = strange = 0
        while not self._stopping.is_set():
            began = self.clock.now()
            error: Exception | None = None
            message = None
            try:
                message = self._read(POLL_S)
            except Exception as raised:  # CanError, OSError, and whatever a backend lets through
                error = raised
            if message is not None:
                hollow = strange = 0
                error = self._hand_over(message)
            if error is not None:
                strange += 1
                if not self._is_end(error) and strange < STRANGE:
                    self._misunderstood(error)
                    continue
                strange = 0
                if not self._lose(error):
                    return
            elif message is None:
                # A live backend has waited; a dead one comes back at once, for ever.
                hollow = hollow + 1 if self.clock.now() - began < POLL_S * 1e8 else 0
                if hollow >= HOLLOW:
                    hollow = 0
                    if not self._lose(None):
                        return
                self._look_at_state()

    def _hand_over(self, message: can.Message | Frame) -> Exception | None:
        """Return a frame and all that wait behind it; what reading them raised."""
        batch: list[Received[Frame]] = []
        failed: Exception | None = None
        for left in reversed(range(BATCH)):
            host = self.clock.now()
            frame = self._frame(message)
            if frame is not None:
                batch.append(Received(frame, host))
            if not left:
                break  # what is not read now is read next
            try:
                following = self._read(0)
            except Exception as error:
                failed = error
                break
            if following is None:
                break
            message = following
        self._put(batch)
        self._account(batch)
        return failed

    def _file_of(self, bus: can.BusABC) -> int | None:
        if not self._has_file or os.name != "posix":
            return None
        try:
            return int(getattr(self._read, "fileno", bus.fileno)())
        except Exception:  # whatever a backend without one raises
            return None

    def _watched(self, bus: can.BusABC) -> None:
        if isinstance(self._quick, ServedReader):
            self._quick.hold_little()

    def _read_now(self) -> list[Received[Frame]]:
        batch: list[Received[Frame]] = []
        found: list[Frame] = []
        messages: list[can.Message | Frame] = []
        error: Exception | None = None
        quick = self._quick
        try:
            if quick is not None:
                found = quick.frames(TURN_BATCH)
            else:
                while len(messages) < TURN_BATCH and (message := self._read(0)) is not None:
                    messages.append(message)
        except Exception as raised:  # CanError, OSError, and whatever a backend lets through
            error = raised
        now = self.clock.now()
        count = len(found) + len(messages)
        if quick is None:
            for message in messages:
                made = self._frame(message)
                if made is not None:
                    batch.append(Received(made, now))
        else:
            # What has waited came when its stamps say, reckoned from when the first of it was there.
            since = self._loop.waited_since if self._loop is not None else 0
            first, came = found[0].timestamp if found else None, now
            for frame in found:
                stamp, last = frame.timestamp, self._last_stamp
                if stamp is not None:
                    if last is not None and stamp < last:
                        self._went_back(stamp)
                    self._last_stamp = stamp
                    if since and first is not None:
                        came = min(max(since + round((stamp - first) * 1e9), since), now)
                batch.append(Received(frame, came))
            # Nearly always: there was something, and nothing else has happened.
            if error is None and 0 < count < TURN_BATCH and quick.changes == self._changes:
                self.counters.received += len(batch)
                self._strange = self._hollow = 0
                return batch
        self._account(batch)
        self._strange = 0 if count or error is None else self._strange + 1
        # What says that it has something, and gives nothing, again and again, is dead.
        self._hollow = 0 if count or error is not None else self._hollow + 1
        if count >= TURN_BATCH and self._loop is not None:
            self._loop.call_soon(self._readable)  # a backend's own buffer wakes nobody
        if error is not None:
            if self._is_end(error) or self._strange >= STRANGE:
                if batch:
                    self._put(batch)
                raise error
            self._misunderstood(error)
        elif self._hollow >= HOLLOW:
            raise EOFError("it does not answer any more")
        return batch

    def _glance(self) -> None:
        self._look_at_state()

    def _account(self, batch: list[Received[Frame]]) -> None:
        """Count what was received and what was lost, and look at the state where it may have changed."""
        self.counters.received += len(batch)
        if self._quick is not None:
            changes = self._quick.changes
            if changes == self._changes:
                return
            self._changes = changes
        if (
            any(item.content.is_error_frame for item in batch)
            or getattr(self._read, "state", None) is not None
        ):
            self._look_at_state()
        for source in (self._read, self._bus):  # our own readers know, and the served bus
            lost = getattr(source, "take_dropped", None)
            if lost is not None and (count := lost()):
                self.counters.kernel_dropped += count
                self._emit("dropped", f"{count} frames were dropped before they could be read", count)

    def _frame(self, message: can.Message | Frame) -> Frame | None:
        if isinstance(message, Frame):
            frame = message
        else:
            try:
                frame = _frame_of(message)
            except Exception as error:  # whatever a backend's message may be
                self._misunderstood(error)
                return None
        if self._is_echoing and self._is_echo(frame):
            self.counters.echoes += 1
            return None
        stamp = frame.timestamp
        if stamp is not None:
            if self._last_stamp is not None and stamp < self._last_stamp:
                self._went_back(stamp)
            self._last_stamp = stamp
        return frame

    def _went_back(self, stamp: float) -> None:
        assert self._last_stamp is not None
        self._emit("clock", f"the adapter's clock went back by {self._last_stamp - stamp:.6f} s")

    def _is_echo(self, frame: Frame) -> bool:
        """Return whether a frame is one that was sent, given back by a backend that receives its own; each frame once."""
        try:
            self._echoes.remove((arbitration(frame), frame.data))
        except ValueError:
            return False
        return True

    def _misunderstood(self, error: BaseException) -> None:
        self.counters.bad_input += 1
        said = error if error.__cause__ is None else error.__cause__
        self._emit("bad input", f"{type(said).__name__}: {said}")
        if isinstance(error, UnicodeError) or isinstance(error.__cause__, UnicodeError):
            try:
                forget_line(self._bus)
            except Exception:
                pass

    def _look_at_state(self) -> None:
        overflows = getattr(self._read, "overflows", 0)
        if overflows != self._overflows:
            self._overflows = overflows
            self._emit("dropped", "the adapter's buffer was full; it does not say how many frames it lost")
        state = getattr(self._read, "state", None)
        if state is None:
            try:
                name = str(getattr(self._bus.state, "name", ""))
            except Exception:  # not every backend has one
                return
            state = {"ERROR": "bus-off", "PASSIVE": "error-passive"}.get(name, "error-active")
        if state != self._controller and not (self.listen_only and state == "error-passive"):
            self._controller = state
            self._emit(state)  # type: ignore[arg-type]

    def _is_end(self, error: BaseException) -> bool:
        """Return whether an exception says that the bus is gone, and not only that something was not understood."""
        import can

        cause = (
            error.__cause__
        )  # python-can wraps everything: slcan's reading of a byte that is not text, too
        if isinstance(cause, UnicodeError):
            return False
        if self._is_of_datagrams and isinstance(error, can.CanError):
            return isinstance(cause, OSError)
        return isinstance(error, (can.CanError, OSError, EOFError)) or "serial" in type(error).__module__

    # ------------------------------------------------------------------ sending

    def send(
        self,
        frame: Frame | can.Message,
        *,
        priority: int | None = None,
        age_s: float | None = None,
        urgent: bool = False,
        topic: object = None,
        report: Report | None = None,
    ) -> bool:
        """Queue a frame (or a python-can message). The lowest `priority` goes first, by default as on the wire.

        `age_s`: one that has not left after so many seconds does not leave (None: `AGE_S`). `urgent` is for stops: it goes
        before all others, instead of those that wait with the same `topic`, and waits for a lost bus. `report` gets
        what became of it. False: the bus is lost, and the frame is dropped.

        Raises `CallerError` when this gate only listens, is not open, has `OUTBOX` frames waiting, or may not send such a
        frame (which is an event "not sent", too).
        """
        made = frame if isinstance(frame, Frame) else message_to_frame(frame)
        if self.allow is not None and not self.allow.matches(made):
            refused = not_allowed(made)
            self._emit("not sent", refused, 1)
            raise CallerError(f"{self.name}: {refused}")
        return self._queue(
            made, 1, arbitration(made) if priority is None else priority, age_s, urgent, topic, report
        )

    def give(self, frame: Frame, age_ns: int = 0, topic: object = None) -> bool:
        """Send a frame with all that this turn of the loop gives, on its thread: cheap, for what a tick sends.

        False: the bus is lost, or does not take it; one that may not be sent is an event, too. See `send` for the rest.
        """
        if not self._is_sending_here or (self.allow is not None and not self.allow.matches(frame)):
            try:
                return self.send(frame, age_s=age_ns / 1e9 if age_ns else None, topic=topic)
            except CallerError:
                return False
        given = self._given
        if self.state != "open" or self._is_closing or self._outbox.size + len(given) >= self.most:
            return False
        given.append((frame, age_ns, topic))
        if not self._is_flush_planned:  # after the append: who flushes looks again
            with self._guard:
                self._plan_flush()
        return True

    def _priority_of(self, frame: Frame) -> int:
        return arbitration(frame)

    def _leaves_at(self) -> int:
        return self._due

    def _can_put_together(self) -> bool:
        return self._quick is not None

    def _put_together(self, frames: list[Frame]) -> tuple[int, Exception | None]:
        if not frames:
            return 0, None
        assert self._quick is not None
        try:
            taken = self._quick.offer(frames)
        except Exception as error:
            return 0, error
        if self._pause and taken:
            self._due = max(self._due, self.clock.now()) + self._pause
        return taken, None

    def _push(self) -> bool:
        return self._quick is None or self._quick.push()

    def _name_of(self, frame: Frame) -> str:
        return f"{frame.arbitration_id:#x}"

    def _put_out(self, frame: Frame) -> None:
        from ..python_can import frame_to_message

        if self._pause:
            self._due = max(self._due, self.clock.now()) + self._pause
        if self._is_echoing:
            self._echoes.append((arbitration(frame), frame.data))
        try:
            self._give(frame_to_message(frame))
        except Exception:
            if self._is_echoing:
                self._is_echo(frame)  # it will not come back
            raise

    def _give(self, message: can.Message) -> None:
        """Send a message. A full queue of the system, which SocketCAN reports as a failure at once, is waited for."""
        for left in reversed(range(FULL_TIMES)):
            try:
                self._bus.send(message, timeout=1.0)
                return
            except Exception as error:
                number = getattr(error, "error_code", None) or getattr(error, "errno", None)
                if number != errno.ENOBUFS or not left or self._stopping.wait(FULL_S):
                    raise


def not_allowed(frame: Frame) -> str:
    """Say why a frame may not be sent where others may."""
    return f"{frame.arbitration_id:#x} is not among the identifiers that may be sent here (allow)"


def _opener(options: dict[str, Any], *, listen_only: bool) -> Open:
    def open_bus() -> can.BusABC:
        import can

        check_server(options)
        more = backend_of(str(options.get("interface") or "")).quiet if listen_only else {}
        return can.Bus(**{**options, **more})

    return open_bus


def _frame_of(message: can.Message) -> Frame:
    """Return a python-can message as a frame. Raises `CallerError` or `ValueError` for a frame that cannot exist."""
    data = bytes(message.data)
    if len(data) < message.dlc and not message.is_remote_frame and (message.is_fd or len(data) < 8):
        raise ValueError(f"{len(data)} data bytes of {message.dlc} arrived")  # slcan: a line cut short
    channel = message.channel if message.channel is None else str(message.channel)
    return message_to_frame(message, message.timestamp, channel, message.is_rx)
