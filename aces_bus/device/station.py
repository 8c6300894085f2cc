"""What both ends of a bus have in common: frames in, records out to the members they address; fields in, frames out.

1. Each record goes to those whose credentials it carries, by one look-up; a broadcast goes to all; one that addresses no
   member is reported.
2. No I/O and no time of its own: a port brings packets and instants.

A record is about a device when its credential fields have the device's values: `board` of Hubo's identifiers, `id` of a
Dynamixel packet. A device may have several (a sensor board's commands carry `board`, its data `sensor`); any that a
message has must agree. Messages with none of them are about every device of their protocol.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, ClassVar, Generic, Literal, TypeVar

from ..compiling import mypyc_attr
from ..errors import CallerError
from ..frames import Frame
from ..protocol import CanScanner, Record, Variant
from ..protocol.declare.message import Message
from ..protocol.encoder import Counts
from ..protocol.live.scanner import make_scanner
from ..protocol.live.stream import StreamScanner
from ..protocol.record import Unknown as UnknownRecord
from ..protocol.record import protocol_name_of
from ..runtime.clock import EventClock, Timer
from .carried_port import CarriedPort
from .config import DeviceConfig, Joint, Robot, Sensor
from .port import Port
from .watched_port import Passed, WatchedPort


@mypyc_attr(allow_interpreted_subclasses=True)
class EndpointMember:
    """What a device and its twin have in common: an entry of the robot's file, credentials, a part of the robot."""

    #: What every instance has as an attribute of its own: no method can have such a name.
    attributes: ClassVar[frozenset[str]] = frozenset(
        ("config", "robot", "variant", "name", "clock", "credentials", "joints", "sensors")
    )

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        for name in cls.attributes:
            if callable(vars(cls).get(name)):
                raise TypeError(
                    f"{cls.__name__}.{name}: every instance has an attribute {name!r}, which hides the method;"
                    " choose another name"
                )

    def __init__(self, clock: EventClock, config: DeviceConfig, robot: Robot, variant: Variant) -> None:
        self.clock, self.config, self.robot, self.variant = clock, config, robot, variant
        self.name = config.name
        self.credentials: dict[str, int] = dict(config.credentials)
        self.joints: tuple[Joint, ...] = tuple(j for j in robot.joints_of(config.name) if j.active)
        self.sensors: tuple[Sensor, ...] = tuple(s for s in robot.sensors_of(config.name) if s.active)

    @property
    def is_listening(self) -> bool:
        """True if the member takes what is sent to it; a transport's packets are let in then."""
        return True

    def receive(self, record: Record, instant: int) -> None:
        """Take a record of this member."""
        raise NotImplementedError

    def received_by_others(self, record: Record, instant: int) -> bool:
        """Take a record of no member here; whether that was to be expected, as a heartbeat of the host."""
        return False

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}: {credential_text(self.credentials)}>"


def refuse_shadowing(cls: type, name: str, role: str, *, mark: str = "") -> None:
    """Raise `TypeError` where `name`, which has a role in `cls`, replaces a method of a base that is for something else.

    Methods that carry the attribute `mark` have the same role, and may be replaced.
    """
    for base in cls.__mro__[1:]:
        other = vars(base).get(name)
        if other is not None and not (mark and hasattr(other, mark)):
            raise TypeError(
                f"{cls.__name__}.{name} is {role}, and would replace {base.__name__}.{name}; choose another name"
            )


def credential_text(credentials: Mapping[str, int]) -> str:
    """Return credentials as a text for messages: `board 0x08`."""
    return ", ".join(f"{name} {value:#04x}" for name, value in credentials.items())


M = TypeVar("M", bound=EndpointMember)
#: A record's type: the credential field to look at (None: it has none), who is meant by its values, and all of them.
_Route = tuple[str | None, dict[int, list[M]], int | None]


@mypyc_attr(allow_interpreted_subclasses=True)
class BusEndpoint(Generic[M]):
    """One side of a bus; see `Host` and `Twins`."""

    def __init__(
        self,
        port: Port,
        variants: Sequence[Variant],
        *,
        direction: Literal["to device", "from device"],
        name: str = "",
    ) -> None:
        if not variants:
            raise CallerError(f"{port.name}: a bus endpoint needs at least one protocol")
        if any(m.transport is not None for variant in variants for m in variant.messages.values()):
            port = CarriedPort(port, variants, self._is_carried_to_us)
        self.port: Port = port
        self.clock, self.name = port.clock, name or port.name
        self.variants = {variant.name: variant for variant in variants}
        self.direction: Literal["to device", "from device"] = direction
        self.scanner = make_scanner(list(variants), direction=direction, include_unknown=True)
        self.members: dict[str, M] = {}
        self._routes: dict[type, _Route[M]] = {}
        #: By member and message: what makes the frame or packet of it, credentials included.
        self._writers: dict[tuple[str, str], Callable[[Mapping[str, Any]], Any]] = {}
        #: By protocol: the rolling counters of what this side has sent.
        self._counts: dict[str, Counts] = {}
        #: A datagram is whole: what it leaves incomplete, the next one does not continue.
        self._feed: Callable[[Any], list[Any]] = (
            self.scanner.datagram
            if port.link == "datagram" and isinstance(self.scanner, StreamScanner)
            else self.scanner.feed
        )
        self._is_can = port.link == "can"
        self._is_open = False
        #: When bytes were last received (ns).
        self.bytes_at = 0
        #: Where packets may end by silence: how long that is (ns), and when it is over.
        self._silence_ns = 0
        self._silence: Timer | None = None
        if isinstance(self.scanner, StreamScanner) and port.link == "serial":
            if any(framing.is_silent for framing in self.scanner.framings):
                self._silence_ns = round(self.scanner.gap * 1e9)

    # ------------------------------------------------------------------ members

    def add(self, member: M) -> M:
        """Put a device or twin on the bus.

        Raises `CallerError` when the name is taken or nothing here speaks its protocol.
        """
        if member.name in self.members:
            raise CallerError(f"{self.name}: there is a device {member.name} already")
        if member.variant.name not in self.variants:
            raise CallerError(
                f"{self.name}: nothing here speaks {member.variant.name} ({member.name} does); the bus has "
                + ", ".join(self.variants)
            )
        self.members[member.name] = member
        self._routes.clear()
        return member

    def remove(self, name: str) -> None:
        """Take a device or twin off."""
        self.members.pop(name, None)
        self._routes.clear()
        self._writers = {key: write for key, write in self._writers.items() if key[0] != name}

    def renumber(self, member: M, **credentials: int) -> None:
        """Give a member other credentials."""
        member.credentials = {**member.credentials, **credentials}
        self._writers = {key: write for key, write in self._writers.items() if key[0] != member.name}
        self._routes.clear()

    def _route(self, record: Record) -> _Route[M]:
        """Return which members a record of this type can address."""
        kind = type(record)
        protocol = protocol_name_of(kind)
        members = [m for m in self.members.values() if m.variant.name == protocol]
        fields = kind.__struct_fields__
        names = {name for m in members for name in m.credentials}
        # The field with the most different numbers tells devices apart best.
        chosen = max(
            sorted(names.intersection(fields)),
            key=lambda name: len({m.credentials.get(name) for m in members}),
            default=None,
        )
        if chosen is None:
            return None, {0: members}, None
        table: dict[int, list[M]] = {}
        for member in members:
            if chosen in member.credentials:
                table.setdefault(member.credentials[chosen], []).append(member)
        return chosen, table, self.variants[protocol].protocol.broadcast.get(chosen)

    def meant_by(self, record: Record) -> Collection[M]:
        """Return the members that a record is about."""
        route = self._routes.get(type(record))
        if route is None:
            route = self._routes[type(record)] = self._route(record)
        name, table, everybody = route
        if name is None:
            return table[0]
        number = getattr(record, name)
        found = table.get(number)
        if found is None:
            if number is not None and number == everybody:
                return [m for members in table.values() for m in members]
            return ()
        if len(found) == 1:
            return found
        return [m for m in found if agrees(m.credentials, record)]

    # ------------------------------------------------------------------ packets

    def watch(self, passed: Passed) -> None:
        """Have `passed` called with all that this side receives and sends, on the clock's thread, from its opening on.

        Raises `CallerError` when it is open already.
        """
        if self._is_open:
            raise CallerError(f"{self.name}: is open already; watch it before")
        if isinstance(self.port, CarriedPort):  # frames, and not packets
            self.port.port = WatchedPort(self.port.port, passed)
        else:
            self.port = WatchedPort(self.port, passed)

    @property
    def is_open(self) -> bool:
        """True if the bus is open: it receives, and may send."""
        return self._is_open

    def open(self) -> None:
        """Start receiving; what is open stays so."""
        if not self._is_open:
            self.port.open(self._receiver() if self._is_can else self._received)
            self._is_open = True  # not before: what is planned already may send from another thread

    def close(self) -> None:
        """Stop receiving."""
        if self._is_open:
            self._is_open = False
            if self._silence is not None:
                self._silence.cancel()
            self.port.close()

    def _is_carried_to_us(self, key: int, data: bytes) -> bool:
        """Return whether the packet that a frame begins is for a member here: it is answered with a go-ahead."""
        other: Literal["to device", "from device"] = (
            "to device" if self.direction == "from device" else "from device"
        )
        for member in self.members.values():
            sent = member.variant.messages_for(other)
            for message in member.variant.messages_for(self.direction):
                if member.is_listening and any(
                    way is not None and way.is_for(key, data, message, member.credentials, sent)
                    for way in message.ways
                ):
                    return True
        return False

    def _receiver(self) -> Callable[[Any, int], None]:
        """Return what is called with each frame of a CAN bus: as `_received` and `deliver`, with what it touches in
        local names.
        """
        scanner, feed, routes, deliver = self.scanner, self._feed, self._routes, self.deliver
        take: Callable[[Any], Any] = lambda frame: None  # noqa: E731
        if isinstance(scanner, CanScanner) and feed is scanner.feed:
            take = scanner.take

        def received(frame: Frame, instant: int) -> None:
            record = take(frame)
            if record is None:
                for received in feed((frame,)):
                    deliver(received, instant)
                return
            route = routes.get(record.__class__)
            if route is not None and route[0] is not None:
                found = route[1].get(getattr(record, route[0]))
                if found is not None and len(found) == 1:  # nearly always
                    found[0].receive(record, instant)
                    return
            deliver(record, instant)

        return received

    def _received(self, data: bytes, instant: int) -> None:
        """Scan bytes from the port and deliver their records."""
        self.bytes_at = instant
        for record in self._feed(data):
            self.deliver(record, instant)
        if self._silence_ns:
            self._await_silence()

    def _await_silence(self) -> None:
        """Restart the timer that ends an incomplete packet after the protocol's time of silence."""
        if self._silence is not None:
            self._silence.cancel()
            self._silence = None
        if isinstance(self.scanner, StreamScanner) and self.scanner.buffered:
            self._silence = self.clock.call_in(self._silence_ns, self.fell_silent)

    def fell_silent(self) -> None:
        """Give up an incomplete packet: the stream is silent."""
        now = self.clock.now()
        for record in self.scanner.idle():
            self.deliver(record, now)

    def deliver(self, record: Record | UnknownRecord, instant: int) -> None:
        """Give a record to whom it is about."""
        if isinstance(record, UnknownRecord):
            self._not_understood(record, instant)
            return
        members = self.meant_by(record)
        if not members:
            if not sum(
                member.received_by_others(record, instant) for member in self.members.values()
            ):  # each of them
                self._unaddressed(record, instant)
            return
        for member in members:
            member.receive(record, instant)

    def _not_understood(self, unknown: UnknownRecord, instant: int) -> None:
        """Take a frame or packet that is not a known message."""

    def _unaddressed(self, record: Record, instant: int) -> None:
        """Take a record of a device that is not on this side."""

    def packet(self, member: M, message: str, fields: Mapping[str, Any]) -> Any:
        """Return the frame or packet of a member's message: its credentials are added.

        Raises `UnknownNameError` and `FieldError` as encoders do.
        """
        write = self._writers.get((member.name, message))
        if write is None:
            found = member.variant[message]
            counts = self._counts.setdefault(member.variant.name, {})
            write = member.variant.encoder.writer(found, tags_of(member, found), counts)
            self._writers[member.name, message] = write
        return write(fields)


def tags_of(member: EndpointMember, message: Message) -> dict[str, int]:
    """Return the credentials that a message has fields for."""
    return {name: value for name, value in member.credentials.items() if name in message.fields}


def agrees(credentials: Mapping[str, int], record: Record) -> bool:
    """Return whether every credential that a record has is this one's."""
    return all(getattr(record, name, number) == number for name, number in credentials.items())
