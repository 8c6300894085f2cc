"""The end of a bus that tests a device: it sends packets, and judges what comes by what the spec declares.

1. `DeviceTester` is an end of the bus like a host: it asks the driver's polls, and reads what comes by the spec alone.
2. What was sent is noted with its instant (`Tap`), a driver's and a transport's frames too: played again it does the same.
3. A half-duplex line is quiet before the next packet: one that meets an answer damages it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

from aces_bus import Frame
from aces_bus import Unknown as UnknownRecord
from aces_bus.device import Poll, Robot
from aces_bus.device.config import DeviceConfig
from aces_bus.device.port import Left, Packet, Port
from aces_bus.device.station import BusEndpoint, EndpointMember, credential_text
from aces_bus.protocol import Message, Record, Variant
from aces_bus.protocol.plan.steps import ValueNames
from aces_bus.runtime import VirtualClock

from .packets import AnyPacket, plain_way

#: How long a poll's second answer is waited for (ns).
SECOND_NS = 2_000_000
#: How long a half-duplex line must be quiet before the next packet, and how long that is waited for at most (ns).
QUIET_NS, BUSY_NS = 2_000_000, 400_000_000
#: An answer comes within this (ns), or the time of its poll where that is longer: what comes later is not asked for.
ANSWERED_NS = 50_000_000
#: No answer for so long, and none is under way (ns).
SETTLED_NS = 5_000_000
#: An enumeration with greater numbers is a list of codes to be added to: a number without a name is not a fault there.
MOST_NAMED = 0xFF

Kind = Literal[
    "raises",
    "silent",
    "bus-off",
    "malformed",
    "out of range",
    "another's",
    "twice",
    "not at rest",
    "does not follow",
]


@dataclass(frozen=True)
class Problem:
    """What a device did wrong. `kind` and `subject` say which fault it is, `text` what was seen of it."""

    kind: Kind | str
    subject: str
    text: str

    @property
    def key(self) -> tuple[str, str]:
        """The same for the same fault, whatever values were seen."""
        return self.kind, self.subject


@dataclass(frozen=True)
class SentStep:
    """A packet, the time (ns) that passed behind it, and how it was made ("valid", "boundary", "mutated" …)."""

    packet: AnyPacket
    pause_ns: int
    how: str = "valid"


class Tap:
    """A port that several ends share, and that notes what they send: `sent` are (instant in ns, frame or bytes)."""

    def __init__(self, port: Port) -> None:
        self.port = port
        self.sent: list[tuple[int, Any]] = []
        self.ends: list[Callable[[Frame | bytes, int], object]] = []
        self._handlers: list[Callable[[str, str], object]] = []
        self._is_open = False

    def end(self) -> TapEnd:
        """Return one more end."""
        return TapEnd(self)

    def attach(self, received: Callable[[Frame | bytes, int], object]) -> None:
        """Have `received` called, too; the first one opens the port."""
        self.ends.append(received)
        if not self._is_open:
            self._is_open = True
            self.port.open(self._received)

    def on_event(self, handler: Callable[[str, str], object]) -> None:
        """Call `handler`, too, with what happens to the bus."""
        if not self._handlers:
            self.port.on_event(self._happened)
        self._handlers.append(handler)

    def _received(self, packet: Frame | bytes, instant: int) -> None:
        for received in tuple(self.ends):
            received(packet, instant)

    def _happened(self, kind: str, detail: str) -> None:
        for handler in self._handlers:
            handler(kind, detail)


class TapEnd:
    """One end of a `Tap`: a port."""

    def __init__(self, tap: Tap) -> None:
        port = tap.port
        self.tap, self.clock, self.name = tap, port.clock, port.name
        self.link: Literal["can", "serial", "datagram"] = port.link
        self.half_duplex = port.half_duplex
        self._received: Callable[[Frame | bytes, int], object] | None = None

    def open(self, received: Callable[[Frame | bytes, int], object]) -> None:
        """Begin to receive."""
        self._received = received
        self.tap.attach(received)

    def on_event(self, handler: Callable[[str, str], object]) -> None:
        """Pass the handler on to the port below."""
        self.tap.on_event(handler)

    def send(
        self,
        packet: Packet,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Left | None = None,
    ) -> bool:
        """Send a frame or bytes, and note it."""
        self.tap.sent.append((self.clock.now(), packet))
        return self.tap.port.send(packet, age_ns, urgent=urgent, topic=topic, report=report)

    def wire_ns(self, packet: Packet) -> int:
        """Return what the port below says."""
        return self.tap.port.wire_ns(packet)

    def close(self) -> None:
        """Receive no more; the port below stays open for the other ends."""
        if self._received is not None and self._received in self.tap.ends:
            self.tap.ends.remove(self._received)


class _Ear(EndpointMember):
    """The device, as far as listening to it goes."""

    tester: DeviceTester
    #: Not while its driver speaks to it, who takes its packets.
    listens = True

    @property
    def is_listening(self) -> bool:
        return self.listens

    def receive(self, record: Record, instant: int) -> None:
        self.tester.noted(record, instant)


class DeviceTester(BusEndpoint[_Ear]):
    """An end of a bus that sends to one device, asks its polls, and judges what comes.

    `others` are the credentials of devices that may speak here besides; None: this one is alone on the bus.
    """

    def __init__(
        self,
        port: TapEnd,
        variant: Variant,
        config: DeviceConfig,
        robot: Robot,
        polls: Sequence[Poll],
        others: Sequence[Mapping[str, int]] | None = None,
    ) -> None:
        super().__init__(port, [variant], direction="from device")
        self._end = port
        self.ear = self.add(_Ear(self.clock, config, robot, variant))
        self.ear.tester = self
        self.variant, self.polls, self.others = variant, list(polls), others
        self.problems: list[Problem] = []
        #: What is wrong and known (`Problem.key`).
        self.ignored: Collection[tuple[str, str]] = ()
        #: By message: how often it came, when it came last, and its last enumerations.
        self.counts: Counter[str] = Counter()
        self.last_at: dict[str, int] = {}
        self.rest: dict[tuple[str, str], Any] = {}
        #: Messages that came when nothing was asked for: a device sends them by itself, maybe because it was asked to.
        self.unasked: set[str] = set()
        self._received_ns = self._sent_ns = 0
        #: Whether frames of this end were destroyed until it was off the bus.
        self.was_off = False
        port.on_event(self._bus_changed)
        self._answered_ns = max([ANSWERED_NS, *(round(poll.timeout_s * 1e9) for poll in polls)])
        #: When all that is on the line has left, where that can be known (ns).
        self.line_free_at: Callable[[], int] = lambda: 0
        #: After so long a silence a receiver gives up what is incomplete.
        framings = [m.framing for m in variant.messages.values() if m.framing is not None]
        self._gap_ns = round(1.25e9 * max((framing.gap or 0.0 for framing in framings), default=0.0))
        #: Whether one is asked at a time: on a half-duplex line, and where only the latest request says what an answer is.
        self._takes_turns = self._end.half_duplex or any(
            message.request_fields for message in variant.messages.values() if message.framing is not None
        )

    # ------------------------------------------------------------------ what comes

    def noted(self, record: Record, instant: int) -> None:
        """Count a record that the device has sent."""
        name = type(record).__name__
        self.counts[name] += 1
        self.last_at[name] = instant
        if instant - self._sent_ns > self._answered_ns:
            self.unasked.add(name)
        message = self.variant.messages.get(name)
        if message is None:
            return
        for path, is_wrong in _limits(message):
            if (text := is_wrong(record)) is not None:
                self._found("out of range", f"{name}.{path}", f"{name}: {path} is {text}")
        for path in enumerations(message):
            self.rest[name, path] = getattr(record, path, None)

    def _bus_changed(self, kind: str, detail: str) -> None:
        self.was_off = self.was_off or kind == "bus-off"

    def _received(self, data: bytes, instant: int) -> None:
        self._received_ns = instant
        super()._received(data, instant)

    def _not_understood(self, unknown: UnknownRecord, instant: int) -> None:
        meta = unknown.meta
        if meta.identifier is not None:
            mine = [m for m in self.variant.messages_for("from device") if self._is_mine(m, meta.identifier)]
            if not mine and self.others is not None:
                return  # another device's, whatever it is
            subject = mine[0].name if mine else f"{meta.identifier:#x}"
            if unknown.reason.startswith("malformed") or unknown.reason == "unknown":
                what = f"{meta.identifier:03X}#{meta.raw.hex().upper()}"
                self._found("malformed", subject, f"{what} is {unknown.reason}")
        elif unknown.reason.startswith("malformed"):
            self._found("malformed", "a packet", f"{meta.raw.hex(' ').upper()} is {unknown.reason}")

    def _is_mine(self, message: Message, identifier: int) -> bool:
        found = message.identifier.match(identifier)
        mine = self.ear.credentials
        return found is not None and all(mine.get(name, number) == number for name, number in found.items())

    def _unaddressed(self, record: Record, instant: int) -> None:
        theirs = {n: v for n in self.ear.credentials if (v := getattr(record, n, None)) is not None}
        if self.others is not None and any(
            all(other.get(n, v) == v for n, v in theirs.items()) for other in self.others
        ):
            return
        name = type(record).__name__
        self._found("another's", name, f"{name} came with {credential_text(theirs) or 'no number'}")

    def _found(self, kind: Kind, subject: str, text: str) -> None:
        if (kind, subject) not in {*self.ignored, *(problem.key for problem in self.problems)}:
            self.problems.append(Problem(kind, subject, text))

    # ------------------------------------------------------------------ what is sent

    def pass_time(self, duration_ns: int) -> None:
        """Let time pass."""
        if isinstance(self.clock, VirtualClock):
            self.clock.advance(duration_ns)
        else:
            self.clock.wait(lambda: False, duration_ns)

    def _send(self, packet: AnyPacket, how: str) -> None:
        frames = packet if isinstance(packet, tuple) else (packet,)
        self._sent_ns = self.clock.now() + self._wire_ns(packet)
        for frame in frames:
            self.scanner.sent(frame)
        if how != "mutated":
            self.port.send(packet)
            return
        for frame in frames:  # one behind the other, whatever its receiver allows
            self._end.send(frame)

    def _wire_ns(self, packet: AnyPacket) -> int:
        return sum(map(self._end.wire_ns, packet)) if isinstance(packet, tuple) else self._end.wire_ns(packet)

    def play(self, step: SentStep) -> None:
        """Send a packet, and let the time behind it pass."""
        self.clock.call(lambda: self._send(step.packet, step.how))
        self.pass_time(step.pause_ns)
        self._await_quiet()

    def give(self, packet: AnyPacket, pause_ns: int, how: str) -> SentStep:
        """Send a packet and let so much time pass, on a half-duplex line until it is quiet; the step that does the same."""
        began = self.clock.now()
        self.clock.call(lambda: self._send(packet, how))
        self.pass_time(self._wire_ns(packet) + pause_ns)
        self._await_quiet()
        return SentStep(packet, self.clock.now() - began, how)

    def _await_quiet(self) -> None:
        """Wait, where one speaks at a time, until nothing was on the line for a moment, and for the silence that may end a
        packet."""
        if not self._takes_turns:
            return
        end = self.clock.now() + BUSY_NS
        quiet = max(QUIET_NS, self._end.wire_ns(bytes(4)), self._silence_ns * 5 // 4)
        if not self._end.half_duplex:
            quiet = max(quiet, self._gap_ns)  # the device has given up what is incomplete, too
        while (now := self.clock.now()) < end:
            left = max(self._sent_ns, self._received_ns, self.line_free_at()) + quiet - now
            if left <= 0:
                return
            self.pass_time(left)

    def settle(self) -> int:
        """Wait until nothing is under way: answers, and packets that silence ends; how long that took (ns)."""
        began = self.clock.now()
        quiet = max(SETTLED_NS, self._gap_ns)
        while self.clock.now() < began + BUSY_NS + quiet:
            before = self._answered
            self.pass_time(quiet)
            if before == self._answered:
                break
        return self.clock.now() - began

    @property
    def _answered(self) -> int:
        return sum(map(self._answers, self.polls))

    def ask(self, number: int) -> tuple[SentStep, int]:
        """Ask a poll, by its number: the step that does the same, and how many answers came."""
        poll = self.polls[number]
        packet = self.packet(self.ear, poll.message, poll.fields)
        before = self._answers(poll)
        began = self.clock.now()
        self.clock.call(lambda: self._send(packet, "poll"))
        limit = round(poll.timeout_s * 1e9) + self._wire_ns(packet)
        self.clock.wait(lambda: self._answers(poll) > before, limit)
        self.pass_time(SECOND_NS)
        self._await_quiet()
        return SentStep(packet, self.clock.now() - began, "poll"), self._answers(poll) - before

    def _answers(self, poll: Poll) -> int:
        return sum(self.counts[name] for name in poll.replies)


# ---------------------------------------------------------------------- what a message declares


@lru_cache(maxsize=4096)
def _limits(message: Message) -> tuple[tuple[str, Callable[[Any], str | None]], ...]:
    """Return what is declared of a message's fields: for each a function that says what is wrong in a record, or None."""
    found: list[tuple[str, Callable[[Any], str | None]]] = []
    for leaf in message.plan.leaves if message.plan.is_flat else ():
        scale, way = leaf.node.scale, plain_way(leaf)
        if way is None:
            continue
        if scale is not None and scale.limits is not None:
            low, high = scale.limits
            slack = 1e-9 * max(abs(low), abs(high)) + abs(scale.scale) * 1e-6
            found.append((leaf.path, _beyond(way, low - slack, high + slack, (low, high), leaf.node.unit)))
        elif any(isinstance(step, ValueNames) for step in leaf.node.steps):
            ends = leaf.node.raw_range
            if ends is not None and ends[1] <= MOST_NAMED:
                found.append((leaf.path, _unnamed(way)))
    return tuple(found)


@lru_cache(maxsize=4096)
def enumerations(message: Message) -> tuple[str, ...]:
    """Return the enumerations of a message that are fields of the record itself."""
    return tuple(
        str(leaf.way[0])
        for leaf in (message.plan.leaves if message.plan.is_flat else ())
        if len(leaf.way) == 1 and any(isinstance(step, ValueNames) for step in leaf.node.steps)
    )


def _at(record: Any, way: Sequence[str | int]) -> Any:
    value = record
    for step in way:
        if value is None:
            return None
        value = value[step] if isinstance(step, int) else getattr(value, step)
    return value


def _beyond(
    way: Sequence[str | int], least: float, greatest: float, said: tuple[float, float], unit: str
) -> Callable[[Any], str | None]:
    def is_wrong(record: Record) -> str | None:
        value = _at(record, way)
        if not isinstance(value, (int, float)) or least <= value <= greatest:
            return None
        return f"{value:g}, outside of {said[0]:g}…{said[1]:g} {unit}".rstrip()

    return is_wrong


def _unnamed(way: Sequence[str | int]) -> Callable[[Any], str | None]:
    def is_wrong(record: Record) -> str | None:
        value = _at(record, way)
        return None if isinstance(value, str) or value is None else f"{value}, which has no name"

    return is_wrong


__all__ = ["DeviceTester", "Kind", "Problem", "SentStep", "Tap", "TapEnd", "enumerations"]
