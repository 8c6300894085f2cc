"""The virtual bus as a python-can backend: `can.Bus(interface="aces", channel="can0", bitrate=1_000_000)`.

1. All buses of one channel name in a process share one wire. Who opens it first says what it is like; who says otherwise
   later is refused.
2. A message is copied once, when it is sent: no receiver can change what another has received.
3. No thread of its own: whoever sends or receives moves the wire on, under one lock.

Three kinds of time, by `physics` and `clock`:

- `physics=False`: no wire at all, a frame arrives when it is sent. The quickest, for tests of logic.
- paced (the default): the wire of `wire` in step with this machine's clock. Foreign programs, which block, use this.
- virtual: `with virtual_clock("can0") as clock:` first. Then `recv(timeout)` moves the simulation on until a frame comes or
  the time is up, without waiting.

Time stamps are seconds: since 1970 for the first two, of the virtual clock (from 0) for the third.

A channel that is an address (`unix:can0`, `unix:/path/to.sock`, `tcp:127.0.0.1:29537/can0`) is a bus of another process: see
`served`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any, TypeVar

from can import CanInitializationError, CanOperationError, Message

from ...errors import CallerError
from ...frames import Frame, message_to_frame
from ...python_can import copy_message, frame_to_message
from ...runtime import VirtualClock
from ..python_can import QUEUE, VirtualBus
from ..served.address import ServedAddress
from .bus import NO_FAULTS, BusNode, Faults, SimulatedBus
from .bus_event import SimulatedBusEvent

T = TypeVar("T")


class Medium:
    """What the buses of one channel share: the wire (or none), its clock and the lock."""

    def __init__(
        self, channel: str, settings: tuple[Any, ...], clock: VirtualClock | None, *, physics: bool
    ) -> None:
        bitrate, data_bitrate, faults = settings[:3]
        self.channel, self.settings, self.physics = channel, settings, physics
        self.is_virtual = clock is not None
        self.clock = clock if clock is not None else VirtualClock(time.monotonic_ns())
        self.wire = SimulatedBus(self.clock, bitrate=bitrate, data_bitrate=data_bitrate, faults=faults)
        self.epoch_ns = 0 if self.is_virtual else time.time_ns() - time.monotonic_ns()
        self.changed = threading.Condition(threading.RLock())
        self.buses: list[AcesBus] = []

    def move_on(self) -> None:
        """Let happen what is due; the lock is held."""
        if not self.is_virtual:
            now = time.monotonic_ns()
            if now > self.clock.now():
                self.clock.advance_to(now)


_media: dict[str, Medium] = {}
_clocks: dict[str, VirtualClock] = {}
_media_lock = threading.Lock()


@contextmanager
def virtual_clock(*channels: str, clock: VirtualClock | None = None) -> Generator[VirtualClock]:
    """Run these channels under a virtual clock, one for all: buses opened inside the block use it."""
    clock = clock if clock is not None else VirtualClock()
    with _media_lock:
        for channel in channels:
            if channel in _media or channel in _clocks:
                raise CanInitializationError(f"channel {channel!r} is open already; say its clock before")
        _clocks.update(dict.fromkeys(channels, clock))
    try:
        yield clock
    finally:
        with _media_lock:
            for channel in channels:
                _clocks.pop(channel, None)


class AcesBus(VirtualBus):
    """A node on a virtual bus.

    `channel`: its name. `bitrate`, `data_bitrate`: bit/s; None: those of the open channel, else 500,000 and no other.
    `fd`: whether the node takes CAN FD. `physics`: see the module.
    `listen_only`: never sends, not even an acknowledgement. `faults`: a `Faults`, of whoever opens the channel first.
    `restart_ms`: comes back from bus-off by itself after so long. `rx_queue_size`: frames kept unread.

    With the address of a served bus as its channel this makes a `served.ServedBus`.
    """

    def __new__(cls, channel: Any = "can0", *rest: Any, **options: Any) -> AcesBus:
        if ServedAddress.is_served(channel):
            from ..served.remote import ServedBus

            return ServedBus(channel, *rest, **options)  # type: ignore[return-value]
        return super().__new__(cls)

    def __init__(
        self,
        channel: Any = "can0",
        can_filters: Any = None,
        *,
        bitrate: int | None = None,
        data_bitrate: int | None = None,
        fd: bool = False,
        physics: bool = True,
        listen_only: bool = False,
        receive_own_messages: bool = False,
        faults: Faults = NO_FAULTS,
        restart_ms: float | None = None,
        rx_queue_size: int = QUEUE,
        **more: Any,
    ) -> None:
        name = str(channel)
        with _media_lock:
            medium = _media.get(name)
            usual = (500_000, None) if medium is None else medium.settings[:2]
            rates = (None if rate is None else int(rate) for rate in (bitrate, data_bitrate))
            settings = (
                *(known if rate is None else rate for rate, known in zip(rates, usual, strict=True)),
                *(faults, bool(physics)),
            )
            if medium is None:
                medium = Medium(name, settings, _clocks.get(name), physics=bool(physics))
                _media[name] = medium
            elif medium.settings != settings:
                raise CanInitializationError(
                    f"channel {name!r} is open with bitrate, data_bitrate, faults, physics = {medium.settings},"
                    f" not {settings}"
                )
            medium.buses.append(self)
        self._medium = medium
        self._receive_own = receive_own_messages
        super().__init__(
            name,
            f"aces virtual bus {name}",
            can_filters,
            fd=fd,
            listen_only=listen_only,
            rx_queue_size=rx_queue_size,
            **more,
        )
        restart = None if restart_ms is None else round(restart_ms * 1e6)
        with medium.changed:
            self.node: BusNode = medium.wire.attach(
                name, self._received, self._happened, listen_only=self._listen_only, fd=fd, restart_ns=restart
            )
        self.node.hears_sent = receive_own_messages

    # ------------------------------------------------------------------ from the wire

    def _received(self, frame: Frame, instant: int) -> None:
        self._keep(frame_to_message(frame, (instant + self._medium.epoch_ns) / 1e9, self.channel))

    def _happened(self, event: SimulatedBusEvent) -> None:
        if event.kind != "sent":
            self._note(event)
        elif self._receive_own and event.frame is not None:
            stamp = (event.instant + self._medium.epoch_ns) / 1e9
            self._keep(frame_to_message(event.frame, stamp, self.channel, is_rx=False))

    # ------------------------------------------------------------------ python-can's side

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Queue a frame. Raises `CanOperationError` when the bus is closed, only listens, is off or cannot take more."""
        if self._why or self._listen_only or (msg.is_fd and not self._fd):
            raise self._refusal()
        medium = self._medium
        if medium.is_virtual:  # one thread, by contract: no lock
            self._send(msg)
            return
        with medium.changed:
            medium.move_on()
            self._send(msg)
            medium.changed.notify_all()

    def _send(self, msg: Message) -> None:
        if not self._medium.physics:
            self._spread(msg)
            return
        try:
            is_taken = self.node.send(message_to_frame(msg))
        except CallerError as error:
            raise CanOperationError(str(error)) from error
        if not is_taken:
            raise self._untaken(self.node.state)

    def _spread(self, msg: Message) -> None:
        """Give a frame to everybody at once: there is no wire."""
        stamp = self._medium.clock.now() / 1e9 if self._medium.is_virtual else time.time()
        for bus in self._medium.buses:
            if bus is self and not self._receive_own:
                continue
            if not bus._fd and msg.is_fd:
                continue
            bus._keep(copy_message(msg, msg.dlc, stamp, self.channel, bus is not self))

    def recv(self, timeout: float | None = None) -> Message | None:
        """Return the next message that passes the filters; None when none came in `timeout` seconds (None: for ever)."""
        queue = self._queue
        if queue and self._filters is None and not self._medium.physics and not self._why:
            first: Message = queue.popleft()  # appended to and popped from in one step each: no lock needed
            return first
        if self._why:
            raise self._unusable()
        medium = self._medium
        if medium.is_virtual:
            return self._recv_virtual(timeout)
        with medium.changed:
            until = None if timeout is None else time.monotonic_ns() + max(0, round(timeout * 1e9))
            while True:
                is_over = (
                    until is not None and time.monotonic_ns() >= until
                )  # not later: what was due by then has come
                if medium.physics:
                    medium.move_on()
                found = self._next()
                if found is not None or is_over:
                    return found
                following = medium.clock.next_event if medium.physics else None
                ends = [end for end in (following, until) if end is not None]
                wait = None if not ends else max(0, min(ends) - time.monotonic_ns()) / 1e9
                medium.changed.wait(wait)
                if self._why:
                    raise self._unusable()

    def _recv_virtual(self, timeout: float | None) -> Message | None:
        clock = self._medium.clock
        until = None if timeout is None else clock.now() + max(0, round(timeout * 1e9))
        queue, step = self._queue, clock.step
        while True:
            while not queue:
                if not step(until):
                    if until is None:
                        raise CanOperationError(
                            f"{self.channel_info}: waits for ever, and nothing is left to happen"
                        )
                    clock.sleep_until(until)
                    return None
            found = self._next()
            if found is not None:
                return found

    def call(self, action: Callable[[], T]) -> T:
        """Return what `action()` returns, called while no other thread moves the wire, which has been moved up to now."""
        with self._medium.changed:
            self._medium.move_on()
            result = action()
            self._medium.changed.notify_all()
        return result

    def flush_tx_buffer(self) -> None:
        """Drop what waits to be sent."""
        with self._medium.changed:
            self.node.abort()

    def _node_state(self) -> str:
        with self._medium.changed:
            self._medium.move_on()
            return self.node.state

    @property
    def load(self) -> float:
        """The share of time in which the bus was busy since it was opened."""
        with self._medium.changed:
            self._medium.move_on()
            return self._medium.wire.load.ratio(self._medium.clock.now())

    def restart(self) -> None:
        """Come back from bus-off, after 128 times 11 recessive bits."""
        with self._medium.changed:
            self.node.restart()
            self._medium.changed.notify_all()

    def shutdown(self) -> None:
        """Leave the bus; the last one out ends it."""
        super().shutdown()
        if self._why:
            return
        self._why = "is closed"
        medium = self._medium
        with _media_lock, medium.changed:
            medium.wire.detach(self.node)
            medium.buses.remove(self)
            if not medium.buses and _media.get(self.channel) is medium:
                del _media[self.channel]
            medium.changed.notify_all()

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        from ..served.stream import served_channels

        with _media_lock:
            names = list(_media) or ["can0"]
        return [{"interface": "aces", "channel": name} for name in [*names, *served_channels().values()]]
