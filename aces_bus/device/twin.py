"""Twins: simulated devices, made from the same spec as the drivers that talk to them.

1. A twin knows what the device's data sheet says, and nothing of the driver: it receives requests and answers them.
2. Its time is the clock's, its randomness the world's: the same seed, the same run.
3. It misbehaves on request, in the ways that devices do.

The usual twin has a method a message:

    class FanTwin(Twin):
        @on("AskState")
        def answer(self, request):
            self.reply("State", speed=self.speed, temperature=40)
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, TypeVar
from typing import Protocol as Interface

import msgspec

from ..compiling import mypyc_attr
from ..errors import CallerError, FieldError, UnknownNameError
from ..frames import FD_LENGTHS
from ..protocol import Protocol, Record, Variant
from ..protocol.live.stream import StreamScanner
from ..protocol.record import FieldValue
from ..runtime.clock import EventClock, Timer
from .config import DeviceConfig, Robot
from .physics import MovedBody
from .port import Port
from .station import BusEndpoint, EndpointMember, refuse_shadowing

#: Bytes that are kept of a stream, for twins that answer what is not understood.
TAIL = 512

F = TypeVar("F", bound=Callable[..., Any])


class JointModel(Interface):
    """A simulated joint, as other twins see it (a foot's force sensor asks for the ankle's angle)."""

    def position(self, now: int) -> float:
        """Return where it is at the instant `now` (ns): rad, or m."""
        ...


@dataclass
class World:
    """What all twins of a robot share: the clock, the seed, the joints, and whatever else they put there."""

    clock: EventClock
    seed: int = 0
    joints: dict[str, JointModel] = field(default_factory=dict[str, JointModel])
    #: Where joints are at first, by name (rad, m), as far as that was said.
    pose: Mapping[str, float] = field(default_factory=dict[str, float])
    #: Whether joints are homed at first; else as after power-up.
    homed: bool = True
    #: What else twins have in common (a body's pose, a battery), by a name that its maker chooses.
    shared: dict[str, Any] = field(default_factory=dict[str, Any])
    #: The body from outside that the motors move; None: each joint moves by itself.
    body: MovedBody | None = None

    def random(self, name: str) -> random.Random:
        """Return a random generator for each twin: one twin more or less does not change what another draws."""
        return random.Random(f"{self.seed} {name}")

    def start_of(self, joint: str, usual: float = 0.0) -> float:
        """Return where a joint is at first: as was said, or as its body has it, or as usual."""
        if self.body is not None and joint not in self.pose:
            placed = self.body.position_of(joint)
            usual = usual if placed is None else placed
        return self.pose.get(joint, usual)


def on(*messages: str) -> Callable[[F], F]:
    """Have a twin's method called with each request of these messages."""

    def mark(method: F) -> F:
        method.__dict__["_hears"] = messages
        return method

    return mark


#: How every twin can misbehave; see `Twin.fault`.
FAULTS: Mapping[str, str] = {
    "silent": "receives requests and does not answer",
    "late": "answers 50 ms late (or as many seconds as said)",
    "wrong_check": "the last byte of each answer is wrong",
    "wrong_number": "answers with another device's number (one more, or the number said)",
    "twice": "answers twice, as two devices with one number do",
    "loses": "loses every third answer (or every n-th as said)",
    "short": "its answers are a byte short",
}


#: The amounts of faults where none is said.
AMOUNTS: Mapping[str, float] = {"late": 0.05, "wrong_number": -1, "loses": 3}


@mypyc_attr(allow_interpreted_subclasses=True)
class Twin(EndpointMember):
    """One simulated device. `faults` (class) are the ways in which this kind misbehaves beyond `FAULTS`."""

    #: What it speaks: the name of an installed protocol, or a protocol itself.
    protocol: ClassVar[str | Protocol]
    faults: ClassVar[Mapping[str, str]] = {}
    #: The amounts of these where none is said; 1 for others.
    amounts: ClassVar[Mapping[str, float]] = {}
    #: From receiving a request to beginning the answer (ns).
    reply_delay_ns: int = 50_000
    attributes: ClassVar = EndpointMember.attributes | {
        *("twins", "world", "random", "active_faults", "is_powered", "requests", "replies"),
    }
    _hearing: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(cls) -> None:
        above: Any = super(Twin, cls)  # noqa: UP008  # mypyc 2.4 takes `cls` for an instance in `super().…`
        above.__init_subclass__()
        found = dict(cls._hearing)
        for name, method in vars(cls).items():
            for message in getattr(method, "_hears", ()):
                refuse_shadowing(cls, name, f"called with each {message}", mark="_hears")
                found[message] = name
        cls._hearing = found

    def __init__(
        self, twins: Twins, config: DeviceConfig, robot: Robot, variant: Variant, world: World
    ) -> None:
        super().__init__(twins.clock, config, robot, variant)
        self.twins, self.world = twins, world
        self.random = world.random(config.name)
        #: The faults that are on, with their amounts.
        self.active_faults: dict[str, float] = {}
        self.is_powered = True
        #: How many requests were received and how many answers were sent.
        self.requests = self.replies = 0
        for message in self._hearing:
            if message not in variant.protocol.messages:
                raise UnknownNameError(f"message of {variant.name}", message, variant.protocol.messages)
        self._handlers: dict[str, Callable[[Any], None]] = {
            message: getattr(self, name) for message, name in self._hearing.items()
        }
        self._timers: dict[object, Timer] = {}
        self.setup()

    # ------------------------------------------------------------------ for twins to override

    def setup(self) -> None:
        """Make the state of a device that was just powered."""

    def draw(self, dice: random.Random, share: float = 1.0) -> None:
        """Draw what it measures and holds anew, from the middle `share` of its range; this kind has nothing to draw."""

    def received(self, record: Record, instant: int) -> None:
        """Take a request that has no handler."""

    def not_understood(self, data: bytes, reason: str) -> None:
        """Take bytes of a stream that are not a request, from where they begin; only kinds that override this
        get them.
        """

    # ------------------------------------------------------------------ receiving and answering

    @property
    def is_listening(self) -> bool:
        """True if the twin is powered."""
        return self.is_powered

    def receive(self, record: Record, instant: int) -> None:
        """Take a request to this device."""
        if not self.is_powered:
            return
        self.requests += 1
        handler = self._handlers.get(type(record).__name__)
        if handler is not None:
            handler(record)
        else:
            self.received(record, instant)

    def reply(self, message: str, *, delay_ns: int | None = None, **fields: Any) -> None:
        """Send a message of the device, by default `reply_delay_ns` from now; credentials are added."""
        if not self.is_powered:
            return
        twin: Any = self  # a subclass may have its delay in its body, where compiled code does not look
        delay: int = twin.reply_delay_ns if delay_ns is None else delay_ns
        faults = self.active_faults
        if not faults:
            packet = self.twins.packet(self, message, fields)
            self._transmit(packet, delay)
            return
        if "silent" in faults:
            return
        if "loses" in faults and self.replies % max(1, round(faults["loses"])) == 0:
            self.replies += 1
            return
        if "wrong_number" in faults:
            packet = self._misnumbered(message, fields, int(faults["wrong_number"]))
        else:
            packet = self.twins.packet(self, message, fields)
        if "wrong_check" in faults:
            packet = with_data(packet, lambda data: data[:-1] + bytes((data[-1] ^ 0x55,)) if data else data)
        if "short" in faults:
            packet = _shorter(packet)
        if "late" in faults:
            delay += round(faults["late"] * 1e9)
        self._transmit(packet, delay)
        if "twice" in faults:
            self._transmit(packet, delay + 500_000)

    def _transmit(self, packet: Any, delay: int) -> None:
        self.replies += 1
        if delay:
            self.clock.post(self.clock.now() + delay, partial(self.twins.send, packet))
        else:
            self.twins.send(packet)

    def send_raw(self, packet: Any) -> None:
        """Send any frame or bytes, as a faulty device does."""
        self.twins.send(packet)

    def _misnumbered(self, message: str, fields: Mapping[str, FieldValue], number: int) -> Any:
        """Return an answer with the number said, else with the next one that this robot knows, else with the one before."""
        known = set(self.variant[message].fields)
        mine = {k: v for k, v in self.credentials.items() if k in known}
        if number >= 0:
            return self.twins.packet(self, message, {**dict.fromkeys(mine, number), **fields})
        for step in (1, -1):
            try:
                return self.twins.packet(self, message, {**{k: v + step for k, v in mine.items()}, **fields})
            except FieldError:
                pass
        packet = self.twins.packet(self, message, fields)
        if self.variant.link != "can":
            return packet
        # A number that the spec does not know: its identifier is as near as any.
        if isinstance(packet, tuple):
            return tuple(msgspec.structs.replace(f, arbitration_id=f.arbitration_id ^ 1) for f in packet)
        return msgspec.structs.replace(packet, arbitration_id=packet.arbitration_id ^ 1)

    def every(self, period_s: float, action: Callable[[], None]) -> None:
        """Do something again and again, from one period from now on, until the device is switched off.

        Called in `setup`, as what a device begins of its own accord when it is powered. Raises `CallerError` for no period.
        """
        period = round(period_s * 1e9)
        if period <= 0:
            raise CallerError(f"{self.name}: a period of {period_s} s; give a period above 0 s")

        def again() -> None:
            action()
            if key in self._timers:  # it was not switched off just now
                self._timers[key] = self.clock.call_in(period, again)

        key = object()
        self._timers[key] = self.clock.call_in(period, again)

    # ------------------------------------------------------------------ misbehaving

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """Misbehave, or stop: one of `FAULTS` or of this kind's `faults`. Raises `UnknownNameError`."""
        known = {**FAULTS, **self.faults}
        if name not in known:
            raise UnknownNameError(f"fault of {type(self).__name__}", name, known)
        if not on:
            self.active_faults.pop(name, None)
        else:
            self.active_faults[name] = (
                AMOUNTS.get(name, self.amounts.get(name, 1)) if amount is None else amount
            )

    def power(self, on: bool) -> None:
        """Switch it off, or on again: a device that was off has lost its state."""
        if on and not self.is_powered:
            self.setup()
        elif not on:
            self._end_timers()
        self.is_powered = on

    def reboot(self) -> None:
        """Switch it off and on."""
        self.power(False)
        self.power(True)

    def stop(self) -> None:
        """End its timers."""
        self._end_timers()

    def _end_timers(self) -> None:
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()


@mypyc_attr(allow_interpreted_subclasses=True)
class Twins(BusEndpoint[Twin]):
    """The simulated devices of one bus: they share its port, as boards share a backplane.

    Two twins that must collide on the wire, or be unplugged alone, stand at ports of their own.
    """

    def __init__(self, port: Port, variants: Sequence[Variant]) -> None:
        super().__init__(port, variants, direction="to device")
        #: Packets the bus did not take.
        self.not_sent = 0
        #: Requests that were not understood, or addressed to no twin here.
        self.unknown = self.others = 0
        #: Twins that get what is not understood; what was received last, and its end's place in the stream.
        self._ears: list[Twin] = []
        self._tail = b""
        self._taken = 0
        if port.link == "serial" and isinstance(self.scanner, StreamScanner):
            # As receivers do: a pause inside a packet ends it, or what follows would be taken for its rest.
            self._silence_ns = round(self.scanner.gap * 1e9)

    def send(self, packet: Any) -> None:
        """Put a packet on the bus."""
        if self._is_open and isinstance(packet, tuple) and len(packet) > 1:
            self.port.send(packet, report=self._ended)
        elif not self._is_open or not self.port.send(packet):
            self.not_sent += 1

    def _ended(self, fate: str, why: str) -> None:
        """Count a packet of several frames that was not sent."""
        self.not_sent += fate != "sent"

    def close(self) -> None:
        """Stop receiving and sending."""
        for twin in self.members.values():
            twin.stop()
        super().close()

    def add(self, member: Twin) -> Twin:
        """Put a twin on the bus. Raises `CallerError` as `BusEndpoint.add`."""
        if type(member).not_understood is not Twin.not_understood:
            self._ears.append(member)
        return super().add(member)

    def _received(self, data: bytes, instant: int) -> None:
        if self._ears:
            self._tail = (self._tail + data)[-TAIL:]
            self._taken += len(data)
        super()._received(data, instant)

    def _not_understood(self, unknown: Any, instant: int) -> None:
        self.unknown += 1
        offset = unknown.meta.offset
        if self._ears and offset is not None and unknown.reason != "skipped":
            at = offset - self._taken + len(self._tail)
            data = self._tail[at:] if at >= 0 else b""
            for twin in self._ears:
                twin.not_understood(data, unknown.reason)

    def _unaddressed(self, record: Record, instant: int) -> None:
        self.others += 1


def _shorter(packet: Any) -> Any:
    """Return a frame or packet that is a byte short; a CAN FD frame of more than 8 has the next length that there is.

    Of a transport's frames the last one has a byte: how many of its bytes are only filling is not known here.
    """
    if isinstance(packet, tuple):
        return with_data(packet, lambda data: data[:1])
    if isinstance(packet, (bytes, bytearray)):
        return packet[:-1]
    size = max((n for n in FD_LENGTHS if n < len(packet.data)), default=0)
    return with_data(packet, lambda data: data[:size])


def with_data(packet: Any, change: Callable[[bytes], bytes]) -> Any:
    """Return a frame or packet with other data bytes; of the frames of a transport, the last one."""
    if isinstance(packet, tuple):
        return (*packet[:-1], with_data(packet[-1], change))
    if isinstance(packet, (bytes, bytearray)):
        return change(bytes(packet))
    return msgspec.structs.replace(packet, data=change(packet.data))
