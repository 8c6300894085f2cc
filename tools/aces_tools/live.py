"""What the live commands share: events on stderr, frames with a time and a channel, silence, frames to send.

1. An event is said when it happens, but a flood of one kind is counted instead of printed.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import msgspec

from aces_bus import Frame

from .console import say
from .patience import Patience

if TYPE_CHECKING:
    from aces_bus.device import Robot
    from aces_bus.device.events import DeviceEvent
    from aces_bus.hardware import CanGate, DatagramGate, SerialGate
    from aces_bus.hardware.gate import Received
    from aces_bus.hardware.gate_events import BusEvent
    from aces_bus.robot.rig import Rig

    from .several_buses import SeveralGates


#: Seconds that a bus stays open after the last frame was handed over: an adapter may still hold it.
LINGER_S = 0.05
#: The shortest silence that is believed: USB adapters hand over bytes up to 16 ms late (s).
LEAST_SILENCE_S = 0.02
#: The silence after which nothing goes on, where no protocol declares a gap (s).
SILENCE_S = 1.0
#: Events of one kind that are printed within `PAUSE_S`.
FEW, PAUSE_S = 3, 1.0
#: What is as it should be.
EXPECTED = frozenset({"opened", "closed"})

#: Events → what to look at.
HINTS: Mapping[str, str] = {
    "error-passive": "is another node there, at the same bit rate? One that only sniffs acknowledges nothing",
    "bus-off": "the controller left the bus after too many errors; look at bit rate, wires and terminators",
    "duplicate reply": "`aces discover` shows which devices answer",
}


class BusEventLines:
    """The events of a gate as lines on stderr. Listens from when it is made; `send` prints what has come since."""

    def __init__(self, gate: CanGate | SerialGate | DatagramGate | SeveralGates) -> None:
        self._queue: deque[BusEvent] = deque(maxlen=4096)
        self._hints = {} if gate.listen_only else HINTS
        gate.on_event(self._queue.append)
        #: How many events of each kind came.
        self.counts: dict[str, int] = {}
        self._shown: dict[str, int] = {}
        self._held: dict[tuple[str, str], int] = {}
        self._since = time.monotonic()

    def report(self, *, last: bool = False) -> bool:
        """Print what has happened; whether anything was printed. With `last`, also what is held back."""
        said = False
        while self._queue:
            event = self._queue.popleft()
            self.counts[event.kind] = self.counts.get(event.kind, 0) + 1
            if event.kind in EXPECTED:
                continue
            self._shown[event.kind] = shown = self._shown.get(event.kind, 0) + 1
            if shown <= FEW:
                hint = self._hints.get(event.kind)
                say(f"{event}; {hint}" if hint else str(event))
                said = True
            else:
                key = event.bus, event.kind
                self._held[key] = self._held.get(key, 0) + 1
        now = time.monotonic()
        if last or now - self._since >= PAUSE_S:
            for (bus, kind), number in self._held.items():
                say(f"{bus}: {kind}: {number} more times")
                said = True
            self._held.clear()
            self._shown.clear()
            self._since = now
        return said


def received_frame(item: Received[Frame], name: str, epoch_ns: int) -> Frame:
    """Return a frame as it was received, with the host's time and the bus's name where the adapter gives none."""
    frame = item.content
    if frame.channel is None or not frame.timestamp:
        return msgspec.structs.replace(
            frame,
            channel=name if frame.channel is None else frame.channel,
            timestamp=frame.timestamp or (item.host_ns + epoch_ns) / 1e9,
        )
    return frame


def losses(gate: CanGate | SerialGate | DatagramGate | SeveralGates, dropped: int) -> str:
    """Return what was lost on the way, for the end of a summary line; `dropped`: came faster than the command took it."""
    from .several_buses import SeveralGates

    of = [each.counters for each in (gate.gates if isinstance(gate, SeveralGates) else [gate])]
    kernel_dropped, bad_input = sum(one.kernel_dropped for one in of), sum(one.bad_input for one in of)
    reopened = sum(one.reopened for one in of)
    return f"dropped={dropped} kernel_dropped={kernel_dropped} bad_input={bad_input} reopened={reopened}"


def silence_s(scanner: Any) -> float:
    """Return the silence after which what is incomplete to a stream's scanner never will be whole."""
    return max(getattr(scanner, "gap", 0.0) or SILENCE_S, LEAST_SILENCE_S)


class SendQueue:
    """What goes out through a gate: in the order given, never more than it takes, all of it accounted for.

    `pending` counts in the gate's own unit: frames, bytes or datagrams.
    """

    def __init__(self, gate: CanGate | SerialGate | DatagramGate, age_s: float | None = None) -> None:
        self.gate = gate
        #: How long a packet may wait (None: the gate's own limit).
        self.age_s = age_s
        self.items = 0
        self._queued = 0
        self._send: Any = gate.send

    def send(self, packet: Frame | bytes) -> None:
        """Queue a frame or bytes, behind all that were queued before. Raises `CallerError` where the gate refuses.

        While the bus is lost it is dropped, and counted by the gate.
        """
        if isinstance(packet, Frame):
            self._send(packet, priority=0, age_s=self.age_s)
            self._queued += 1
        else:
            self._send(packet, age_s=self.age_s)
            self._queued += len(packet) if self.gate.items == "pieces" else 1
        self.items += 1

    @property
    def pending(self) -> int:
        """Number of items that are queued and have not left yet."""
        counters = self.gate.counters
        return self._queued - counters.sent - counters.not_sent

    def drain(self, patience: Patience | None = None, most: int = 0, seconds: float = 2.0) -> bool:
        """Wait until no more than `most` is pending; False when nothing has left for so long, or `patience` is over."""
        before, until = self.pending, time.monotonic() + seconds
        while (left := self.pending) > most:
            now = time.monotonic()
            if left != before:
                before, until = left, now + seconds
            if now > until or (patience is not None and patience.is_over):
                return False
            time.sleep(0.0005)
        return True


# ---------------------------------------------------------------------- events of devices

#: How long a device must be silent before that is said (ns).
SILENCE_NS = 600_000_000
#: Late answers are reported when they are more than `FEW` and more than this share of all.
LATE_SHARE = 0.1


class DeviceEventLines:
    """Listens to a rig from when it is made; `send` prints what has come since.

    `robot` is the whole robot: its other devices, which other programs talk to, are known.
    """

    def __init__(self, rig: Rig, robot: Robot) -> None:
        self.rig, self.robot = rig, robot
        self._queue: deque[DeviceEvent] = deque(maxlen=4096)
        #: Kinds that are kept back until `last`, and what has been: the caller may know better why they happen.
        self.holding: set[str] = set()
        self._held: list[DeviceEvent] = []
        #: Who has fallen silent, and that has not been said yet.
        self._silent: dict[str, DeviceEvent] = {}
        self._said_silent: set[str] = set()
        #: The buses that are lost.
        self._lost: set[str] = set()
        self._others = {
            frozenset(f"{name} {value:#04x}" for name, value in config.credentials.items())
            for config in robot.devices.values()
        }
        rig.on_event(self._queue.append)

    def report(self, *, last: bool = False, without: Collection[str] = ()) -> None:
        """Print what has happened, `without` some kinds; with `last` also what was held back."""
        while self._queue:
            event = self._queue.popleft()
            if event.kind in self.holding:
                self._held.append(event)
            elif event.kind not in {*EXPECTED, "error-active", *without}:
                self._sort(event)
        if last:
            self.holding.clear()
            for event in self._held:
                self._sort(event)
            self._held.clear()
        now = self.rig.clock.now()
        for name, event in list(self._silent.items()):
            if now - event.instant > SILENCE_NS or last:
                del self._silent[name]
                self._said_silent.add(name)
                if "silent" not in without:
                    say(f"{name}: silent: {event.detail}; {self._look_at(name)}")
        if last:
            self._report_late()

    def drop(self, kind: str) -> None:
        """Say nothing of what was held back of a kind."""
        self._held = [event for event in self._held if event.kind != kind]

    def _sort(self, event: DeviceEvent) -> None:
        who = event.device
        match event.kind:
            case "silent":
                self._silent[who] = event
            case "answers":
                if self._silent.pop(who, None) is None and who in self._said_silent:
                    self._said_silent.discard(who)
                    say(f"{who}: answers again")
            case "late reply":
                pass  # counted by the rig; see `_report_late`
            case "lost":
                self._lost.add(event.bus)
                say(f"{event.bus}: lost: {event.detail}; it is opened again as soon as it is there")
            case "not sent" if event.bus in self._lost:
                pass  # of course
            case "unknown device" if self._is_known(event.detail):
                pass  # another device of the robot
            case _:
                self._lost -= {event.bus} if event.kind == "reopened" else set()
                hint = HINTS.get(event.kind)
                detail = f": {event.detail}" if event.detail else ""
                say(f"{event.source}: {event.kind}{detail}{f'; {hint}' if hint else ''}")

    def _is_known(self, detail: str) -> bool:
        """Return whether an unknown device ("Encoder of board 0x01, sensor 0x02, which …") is another device of the
        robot.
        """
        numbers = set(detail.partition(" of ")[2].partition(", which")[0].split(", "))
        return any(numbers <= other for other in self._others)

    def _look_at(self, name: str) -> str:
        """Return what to look at when a device does not answer."""
        config = self.robot.devices.get(name)
        if config is None:
            return "is it powered?"
        numbers = ", ".join(f"{key} {value:#04x}" for key, value in config.credentials.items())
        return f"is it powered, on bus {config.bus}, and {numbers}? `aces discover` shows who is there"

    def _report_late(self) -> None:
        answered = sum(host.counts.answered for host in self.rig.hosts.values())
        for (kind, who), number in self.rig.events.counts.items():
            if kind == "late reply" and number > FEW and number > LATE_SHARE * answered:
                say(
                    f"{who}: {number} answers came late, {answered} in time; is the bus or this machine busy?"
                )
