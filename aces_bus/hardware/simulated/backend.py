"""The virtual bus as a python-can backend: `can.Bus(interface="aces", channel="can0", bitrate=1_000_000)`.

1. All buses of one channel name in a process share one wire. Who opens it first says what it is like; who says otherwise
   later is refused.
2. A message is copied once, when it is sent: nobody can change what another has received.
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
from collections import deque
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from can import BusABC, BusState, CanInitializationError, CanOperationError, CanProtocol, Message

from ...errors import CallerError
from ...frames import Frame
from ...runtime import VirtualClock
from ..served.address import is_served
from .bus import BusNode, SimulatedBus, SimulatedBusEvent
from .faults import NO_FAULTS, Faults

#: Frames a receiver may leave unread; after that the oldest is dropped and counted.
QUEUE = 65_536

_STATES = {
    "error-active": BusState.ACTIVE,
    "error-passive": BusState.PASSIVE,
    "bus-off": BusState.ERROR,
}


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


class AcesBus(BusABC):
    """A node on a virtual bus.

    `channel`: its name. `bitrate`, `data_bitrate`: bit/s. `fd`: whether the node takes CAN FD. `physics`: see the module.
    `listen_only`: never sends, not even an acknowledgement. `faults`: a `Faults`, of whoever opens the channel first.
    `restart_ms`: comes back from bus-off by itself after so long. `rx_queue_size`: frames kept unread.

    With the address of a served bus as its channel this makes a `served.ServedBus`.
    """

    def __new__(cls, channel: Any = "can0", *rest: Any, **options: Any) -> AcesBus:
        if is_served(channel):
            from ..served.remote import ServedBus

            return ServedBus(channel, *rest, **options)  # type: ignore[return-value]
        return super().__new__(cls)

    def __init__(
        self,
        channel: Any = "can0",
        can_filters: Any = None,
        *,
        bitrate: int = 500_000,
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
        settings = (int(bitrate), None if data_bitrate is None else int(data_bitrate), faults, bool(physics))
        with _media_lock:
            medium = _media.get(name)
            if medium is None:
                medium = Medium(name, settings, _clocks.get(name), physics=bool(physics))
                _media[name] = medium
            elif medium.settings != settings:
                raise CanInitializationError(
                    f"channel {name!r} is open with bitrate, data_bitrate, faults, physics = {medium.settings},"
                    f" not {settings}"
                )
            medium.buses.append(self)
        self.channel = name
        self.channel_info = f"aces virtual bus {name}"
        self._medium = medium
        self._receive_own = receive_own_messages
        self._listen_only = bool(listen_only)
        self._queue: deque[Message] = deque()
        self._most = int(rx_queue_size) or QUEUE
        #: Frames lost because nobody read them in time.
        self.dropped = 0
        #: What happened to this node, the last 1,024 events.
        self.events: deque[SimulatedBusEvent] = deque(maxlen=1024)
        #: Called with each event, from within the simulation; it must not block.
        self.on_event: Callable[[SimulatedBusEvent], None] | None = None
        self._is_open = True
        restart = None if restart_ms is None else round(restart_ms * 1e6)
        with medium.changed:
            self.node: BusNode = medium.wire.attach(
                name, self._received, self._happened, listen_only=self._listen_only, fd=fd, restart_ns=restart
            )
        self.node.hears_sent = receive_own_messages
        self._can_protocol = CanProtocol.CAN_FD if fd else CanProtocol.CAN_20
        self._fd = fd
        super().__init__(name, can_filters, **more)

    # ------------------------------------------------------------------ from the wire

    def _received(self, frame: Frame, instant: int) -> None:
        self._keep(frame_to_message(frame, (instant + self._medium.epoch_ns) / 1e9, self.channel))

    def _keep(self, message: Message) -> None:
        queue = self._queue
        if len(queue) >= self._most:
            queue.popleft()
            self.dropped += 1
        queue.append(message)

    def _happened(self, event: SimulatedBusEvent) -> None:
        if event.kind == "sent":
            if self._receive_own and event.frame is not None:
                stamp = (event.instant + self._medium.epoch_ns) / 1e9
                own = frame_to_message(event.frame, stamp, self.channel)
                own.is_rx = False
                self._keep(own)
            return
        self.events.append(event)
        if self.on_event is not None:
            self.on_event(event)

    # ------------------------------------------------------------------ python-can's side

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Queue a frame. Raises `CanOperationError` when the bus is closed, only listens, is off or cannot take more."""
        self._check_open()
        if self._listen_only:
            raise CanOperationError(f"{self.channel_info} was opened to listen only")
        if msg.is_fd and not self._fd:
            raise CanOperationError(f"{self.channel_info} was not opened for CAN FD; open it with fd=True")
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
        elif not self.node.send(message_to_frame(msg)):
            off = self.node.state == "bus-off"
            raise CanOperationError(
                f"{self.channel_info} {'is bus-off' if off else 'has no free mailbox; nobody acknowledges?'}"
            )

    def _spread(self, msg: Message) -> None:
        """Without a wire: everybody has it at once."""
        stamp = self._medium.clock.now() / 1e9 if self._medium.is_virtual else time.time()
        for bus in self._medium.buses:
            if bus is self and not self._receive_own:
                continue
            if not bus._fd and msg.is_fd:
                continue
            copy = copy_message(msg, stamp, self.channel)
            copy.is_rx = bus is not self
            bus._keep(copy)

    def recv(self, timeout: float | None = None) -> Message | None:
        """The next message that passes the filters; None when none came in `timeout` seconds (None: for ever)."""
        queue = self._queue
        if queue and self._filters is None and not self._medium.physics and self._is_open:
            return queue.popleft()  # appended to and popped from in one step each: no lock needed
        self._check_open()
        medium = self._medium
        if medium.is_virtual:
            return self._recv_virtual(timeout)
        with medium.changed:
            until = None if timeout is None else time.monotonic_ns() + max(0, round(timeout * 1e9))
            while True:
                if medium.physics:
                    medium.move_on()
                found = self._next()
                if found is not None or (until is not None and time.monotonic_ns() >= until):
                    return found
                following = medium.clock.next_event if medium.physics else None
                ends = [end for end in (following, until) if end is not None]
                wait = None if not ends else max(0, min(ends) - time.monotonic_ns()) / 1e9
                medium.changed.wait(wait)
                self._check_open()

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

    def _next(self) -> Message | None:
        queue = self._queue
        while queue:
            message = queue.popleft()
            if self._filters is None or self._matches_filters(message):
                return message
        return None

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        return self.recv(timeout), True

    def _apply_filters(self, filters: Any) -> None:
        """Filters are applied on reading."""

    def flush_tx_buffer(self) -> None:
        """Drop what waits to be sent."""
        with self._medium.changed:
            self.node.abort()

    @property
    def state(self) -> BusState:
        """Error active, passive or bus-off."""
        with self._medium.changed:
            self._medium.move_on()
            return _STATES[self.node.state]

    @state.setter
    def state(self, new_state: BusState) -> None:
        raise NotImplementedError(
            "the state is what the bus makes of the node; open it with listen_only, or restart it"
        )

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
        if not self._is_open:
            return
        self._is_open = False
        medium = self._medium
        with _media_lock, medium.changed:
            medium.wire.detach(self.node)
            medium.buses.remove(self)
            if not medium.buses and _media.get(self.channel) is medium:
                del _media[self.channel]
            medium.changed.notify_all()

    def _check_open(self) -> None:
        if not self._is_open:
            raise CanOperationError(f"{self.channel_info} is closed")

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        from ..served.stream import served_channels

        with _media_lock:
            names = list(_media) or ["can0"]
        return [{"interface": "aces", "channel": name} for name in [*names, *served_channels()]]


# ---------------------------------------------------------------------- frames and messages


def message_to_frame(message: Message) -> Frame:
    """A message as an immutable frame; raises `CanOperationError` for one that cannot exist."""
    try:
        return Frame(
            message.arbitration_id,
            bytes(message.data),
            None,
            None,
            message.is_extended_id,
            message.is_remote_frame,
            message.is_error_frame,
            message.is_fd,
            message.bitrate_switch,
            message.error_state_indicator,
            None,
            message.dlc if message.is_remote_frame else None,
        )
    except CallerError as error:
        raise CanOperationError(str(error)) from error


def frame_to_message(frame: Frame, seconds: float, channel: str) -> Message:
    """A frame as a message of its own."""
    return _message(frame, frame.length, seconds, channel)


def copy_message(message: Message, seconds: float, channel: str) -> Message:
    """A copy of a message with another time."""
    return _message(message, message.dlc, seconds, channel)


def _message(word: Frame | Message, dlc: int, seconds: float, channel: str) -> Message:
    """A message with what a frame or another message carries: a constructor without its checks."""
    made = Message.__new__(Message)
    made.timestamp = seconds
    made.arbitration_id = word.arbitration_id
    made.is_extended_id = word.is_extended_id
    made.is_remote_frame = word.is_remote_frame
    made.is_error_frame = word.is_error_frame
    made.channel = channel
    made.dlc = dlc
    made.data = bytearray(word.data)
    made.is_fd = word.is_fd
    made.is_rx = True
    made.bitrate_switch = word.bitrate_switch
    made.error_state_indicator = word.error_state_indicator
    return made
