"""What a robot sends: found by letting it run, with its twins in virtual time, so that it is what its drivers really send.

1. The robot is enabled, every joint is given a set-point in each tick, every poll is asked; then the host falls silent, and
   what still is sent is what devices send by themselves.
2. Periods of polls are those that drivers declare; of all else those that were seen, in whole ticks. Lengths are the longest
   seen, and stuffed as much as can be.
3. How long a device takes to answer is what its twin takes, unless the caller says more.

What was sent once only (the steps of enabling) is not traffic.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal

from msgspec import structs

from aces_bus import Frame, Unknown, make_scanner
from aces_bus.device import Driver, Robot, load_driver
from aces_bus.device.host import Host
from aces_bus.device.poll import PollSlot
from aces_bus.device.port import Packet
from aces_bus.errors import AcesError, CallerError
from aces_bus.hardware import SimulatedBus
from aces_bus.hardware.ports import port_of
from aces_bus.robot import connect
from aces_bus.robot.buses import is_half_duplex, wire_of
from aces_bus.robot.rig import Rig, Simulation, simulate, spoken_on
from aces_bus.runtime import VirtualClock

#: What the host is called among the nodes of a bus; no device may have this name and a queue of its own.
HOST = "host"
#: Hz, of robots whose file states no rate.
USUAL_RATE_HZ = 100.0
#: Enabling may take so long (s), is followed by this, and so is the driven robot watched twice: while it is asked
#: everything, and then in its usual course. The devices alone are watched for longer: some send once a second.
ENABLE_S, SETTLE_S, ALONE_S = 10.0, 0.3, 2.5
#: What was asked has been answered so long after the host fell silent (ns).
QUIET_NS = 200_000_000
#: Ticks for which the driven robot is watched at least, each time.
TICKS = 40


@dataclass(frozen=True)
class SentMessage:
    """One message of a robot's bus.

    `node` is `HOST` or a device; `device` the device that it is to or from ("": several). `size` is in bytes, of a frame or
    a packet. `is_ticked`: the host's tick brings it about, at once or through the message `after`, `delay_ns` after that has
    arrived (the device's time to answer); else its node sends it by itself. What is not sent in each tick is first sent
    `first_ns` after the host was opened: polls are spread so. `timeout_ns` is how long its answer is waited for (0: there is
    none). `identifier` is None on lines.
    """

    name: str
    node: str
    device: str
    size: int
    period_ns: int
    is_ticked: bool
    after: str = ""
    delay_ns: int = 0
    first_ns: int = 0
    timeout_ns: int = 0
    identifier: int | None = None
    extended: bool = False
    fd: bool = False
    bitrate_switch: bool = False

    @property
    def message(self) -> str:
        """Its protocol's name for it: what it has in common with those of other devices."""
        return self.name.removeprefix(f"{self.device}.").partition(" ")[0]


@dataclass(frozen=True)
class BusTraffic:
    """What is sent on one bus of a robot, in the order in which a tick queues it.

    `bitrate` is the baud rate of a line, None of datagrams. `one_by_one`: the host asks for one thing at a time (half-duplex
    lines, devices that take one request). `budget` is the share of a tick that the host fills with set-points and polls.
    """

    name: str
    link: Literal["can", "serial", "datagram"]
    tick_ns: int
    messages: tuple[SentMessage, ...]
    bitrate: int | None = None
    data_bitrate: int | None = None
    half_duplex: bool = False
    one_by_one: bool = False
    budget: float = 1.0
    notes: tuple[str, ...] = ()

    def at(self, factor: float) -> BusTraffic:
        """Return the same with ticks that are this many times as fast: what is sent in each tick is sent more often."""
        tick = round(self.tick_ns / factor)
        return replace(
            self,
            tick_ns=tick,
            messages=tuple(
                replace(message, period_ns=tick)
                if message.is_ticked and message.period_ns <= self.tick_ns
                else message
                for message in self.messages
            ),
        )


@dataclass(frozen=True)
class RobotTraffic:
    """What is sent on each bus of a robot; `notes` say what could not be had."""

    robot: str
    rate_hz: float
    buses: Mapping[str, BusTraffic]
    notes: tuple[str, ...] = ()

    def at(self, factor: float) -> RobotTraffic:
        """Return the same at so many times the rate."""
        return replace(
            self,
            rate_hz=self.rate_hz * factor,
            buses={name: bus.at(factor) for name, bus in self.buses.items()},
        )


def robot_traffic(
    robot: Robot, *, rate_hz: float | None = None, load: Callable[[str], Driver] = load_driver
) -> RobotTraffic:
    """Return what the robot's host and devices send at this tick (default: the robot's, else 100 Hz).

    `rate_hz` is of buses for which the file states none. Takes a fraction of a second to some seconds: the robot is run in
    virtual time. Raises as `aces_bus.robot.connect` for robots that cannot be connected.
    """
    if rate_hz is not None and not 0 < rate_hz <= 1e6:
        raise CallerError(f"a rate of {rate_hz} Hz; give a rate above 0 Hz")
    return _Watch(robot, rate_hz or robot.rate_hz or USUAL_RATE_HZ, load).traffic()


def _key(packet: Packet) -> Any:
    """Return what makes two packets the same."""
    if isinstance(packet, tuple):
        return tuple(map(_key, packet))
    return (
        (packet.arbitration_id, packet.is_extended_id, packet.data)
        if isinstance(packet, Frame)
        else bytes(packet)
    )


@dataclass
class _SentPacket:
    """One frame or packet that was sent, when, and when a host's had arrived (-1: not seen)."""

    instant: int
    packet: Any
    from_host: bool
    arrived: int = -1
    message: str = ""
    device: str = ""
    #: The poll whose request it is.
    slot: PollSlot | None = None


class _Log:
    """The packets of one bus."""

    def __init__(self) -> None:
        self.packets: list[_SentPacket] = []
        self._under_way: dict[Any, deque[_SentPacket]] = {}

    def sent(self, instant: int, packet: Packet, from_host: bool) -> None:
        found = _SentPacket(instant, packet, from_host)
        self.packets.append(found)
        if from_host:
            self._under_way.setdefault(_key(packet), deque()).append(found)

    def arrived(self, instant: int, packet: Packet) -> None:
        waiting = self._under_way.get(_key(packet))
        if waiting:
            waiting.popleft().arrived = instant


class _Tap:
    """A port that notes what is sent through it; the twins' one also what arrives."""

    def __init__(self, port: Any, log: _Log, from_host: bool) -> None:
        self._port, self._log, self._from_host = port, log, from_host

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    def open(self, received: Callable[[Frame | bytes, int], object]) -> None:
        if self._from_host:
            self._port.open(received)
            return
        arrived, clock = self._log.arrived, self._port.clock

        def take(packet: Frame | bytes, instant: int) -> None:
            arrived(clock.now(), packet)
            received(packet, instant)

        self._port.open(take)

    def send(self, packet: Packet, *rest: Any, **options: Any) -> bool:
        taken: bool = self._port.send(packet, *rest, **options)
        if isinstance(packet, Frame) and self._port.switches(packet):
            packet = structs.replace(packet, bitrate_switch=True)
        if taken:
            self._log.sent(self._port.clock.now(), packet, self._from_host)
        return taken


class _Stream:
    """The packets that are one message."""

    def __init__(self, name: str, first: _SentPacket) -> None:
        self.name, self.device, self.message = name, first.device, first.message
        self.node = HOST if first.from_host else first.device or name
        self.slot, self.example = first.slot, first.packet
        self.packets: list[_SentPacket] = []

    @property
    def instants(self) -> list[int]:
        return [sent.instant for sent in self.packets]

    @property
    def size(self) -> int:
        return max(
            len(sent.packet.data if isinstance(sent.packet, Frame) else sent.packet) for sent in self.packets
        )

    def sent(self, period_ns: int, *, is_ticked: bool, **more: Any) -> SentMessage:
        packet = self.example
        if isinstance(packet, Frame):
            more |= {
                "identifier": packet.arbitration_id,
                "extended": packet.is_extended_id,
                "fd": packet.is_fd,
                "bitrate_switch": packet.bitrate_switch,
            }
        return SentMessage(self.name, self.node, self.device, self.size, period_ns, is_ticked, **more)

    def rhythm(self, tick_ns: int, begin: int) -> tuple[int, int]:
        """Return how many are sent in a tick in which it is sent, and how many ticks later it is sent again."""
        ticks = Counter((instant - begin) // tick_ns for instant in self.instants if instant >= begin)
        if len(ticks) < 2:
            return 1, 1
        steps = sorted(after - before for before, after in pairwise(sorted(ticks)))
        return max(1, round(ticks.total() / len(ticks))), steps[(len(steps) - 1) // 2]

    def period_ns(self) -> int:
        """Return the shortest time between two, of those that are not sent at once."""
        times = sorted(set(self.instants))
        return min(after - before for before, after in pairwise(times))


class _Watch:
    """A robot in virtual time whose packets are noted."""

    def __init__(self, robot: Robot, rate_hz: float, load: Callable[[str], Driver]) -> None:
        self.robot, self.rate_hz, self.load = robot, rate_hz, load
        self.clock = VirtualClock()
        self.protocols = spoken_on(robot, load)
        self.logs = {name: _Log() for name in self.protocols}
        self.wires = {
            name: wire_of(robot.buses[name], protocol, self.clock)
            for name, protocol in self.protocols.items()
        }
        hosts, twins = self._taps("host"), self._taps("twins")
        self.rig: Rig = connect(robot, hosts, rate_hz=rate_hz, load=load)
        self.twins: Simulation = simulate(robot, twins, load=load)
        #: When each poll is first due, as the hosts spread them.
        self.first = {
            id(slot): slot.due - self.clock.now() for host in self.rig.hosts.values() for slot in host.slots
        }
        #: In which order they are asked, as long as a tick has room for all.
        self.order = {
            id(slot): place
            for place, slot in enumerate(slot for host in self.rig.hosts.values() for slot in host.slots)
        }
        self.notes: list[str] = []

    def _taps(self, end: str) -> dict[str, Any]:
        """Return a port of each wire for one end of it, which notes what is sent."""
        return {
            name: _Tap(port_of(wire, name=f"{name} {end}"), self.logs[name], end == "host")
            for name, wire in self.wires.items()
        }

    def traffic(self) -> RobotTraffic:
        period_s = 1 / min(host.rate_hz or self.rate_hz for host in self.rig.hosts.values())
        with self.twins:
            self.rig.open()
            try:
                self._enable()
                self._set()
                self._advance(SETTLE_S)
                driven = self.clock.now()
                for device in self.rig.devices.values():  # slow polls, too, are seen once at least
                    device.host.refresh(device, [poll for poll in device.polls if poll.every_s])
                self._advance(max(SETTLE_S, TICKS * period_s))
                steady = self.clock.now()
                self._advance(max(SETTLE_S, TICKS * period_s))
                alone = self.clock.now()
                for host in self.rig.hosts.values():
                    host.passive = True
                for wire in self.wires.values():  # what a full bus has not carried yet, it need not
                    for node in wire.nodes if isinstance(wire, SimulatedBus) else ():
                        node.abort()
                self._advance(ALONE_S)
            finally:
                self.rig.close()
        return RobotTraffic(
            self.robot.name,
            self.rate_hz,
            {name: self._bus(name, driven, steady, alone) for name in self.rig.hosts},
            tuple(self.notes),
        )

    def _advance(self, seconds: float) -> None:
        self.clock.advance(round(seconds * 1e9))

    def _enable(self) -> None:
        self._advance(SETTLE_S)
        jobs: dict[str, Any] = {
            device.name: getattr(device, "enable")()  # noqa: B009  # an action: not every driver has it
            for device in self.rig.devices.values()
            if "enable" in device.actions
        }
        waited = [job for job in jobs.values() if job is not None]
        self.clock.wait(lambda: all(job.is_over for job in waited), round(ENABLE_S * 1e9))
        for name, job in jobs.items():
            if job is not None and (job.error is not None or not job.is_over):
                why = str(job.error) if job.error is not None else f"not over after {ENABLE_S:g} s"
                self.notes.append(f"{name} could not be enabled, so that its set-points are missing: {why}")

    def _set(self) -> None:
        """Have every joint given a set-point in each tick: where it is."""
        for host in self.rig.hosts.values():
            host.before_set_points.insert(0, self._setter(host))

    def _setter(self, host: Host) -> Callable[[int], None]:
        signals = [
            self.rig[joint.name]
            for joint in self.robot.joints.values()
            if joint.active
            and joint.device in host.members
            and self.rig.whole(joint.name) in self.rig.signals
            and self.rig[joint.name].is_writable
        ]
        aims: dict[str, float] = {}

        def step(now: int) -> None:
            for signal in signals:
                if signal.name not in aims:
                    last = signal.last
                    aims[signal.name] = last if isinstance(last, (int, float)) else 0.0
                try:
                    signal.set(aims[signal.name])
                except AcesError:
                    continue  # one that takes none now

        return step

    # ------------------------------------------------------------------ what was sent

    def _bus(self, name: str, driven: int, steady: int, alone: int) -> BusTraffic:
        host, config, protocol = self.rig.hosts[name], self.robot.buses[name], self.protocols[name]
        packets = self.logs[name].packets
        self._name(host, packets)
        tick = round(1e9 / (host.rate_hz or self.rate_hz))
        streams = _streams([packet for packet in packets if driven <= packet.instant < alone])
        silent = _streams([packet for packet in packets if packet.instant >= alone + QUIET_NS])
        by_itself = {
            key: stream
            for key, stream in silent.items()
            if stream.node != HOST and len(set(stream.instants)) > 1
        }
        messages = self._ticked(
            host, [stream for key, stream in streams.items() if key not in by_itself], tick, steady
        )
        messages += [stream.sent(stream.period_ns(), is_ticked=False) for stream in by_itself.values()]
        wire = self.wires[name]
        return BusTraffic(
            name,
            config.link,
            tick,
            tuple(messages),
            bitrate=getattr(wire, "bitrate", None) or getattr(wire, "baud", None),
            data_bitrate=getattr(wire, "data_bitrate", None),
            half_duplex=config.link == "serial" and is_half_duplex(config, protocol),
            one_by_one=host.asks_one_by_one,
            budget=host.budget,
        )

    def _name(self, host: Host, packets: Sequence[_SentPacket]) -> None:
        """Say of each packet which message it is, to or from which device."""
        variants = list(host.variants.values())
        down: Any = make_scanner(variants, direction="to device", include_unknown=True)
        up: Any = make_scanner(variants, direction="from device", include_unknown=True)
        slots = {_key(part): slot for slot in host.slots for part in _parts(slot.packet)}
        #: Frames of a packet that is not whole yet, by identifier.
        begun: dict[Any, list[_SentPacket]] = {}
        for packet in packets:
            is_can = isinstance(packet.packet, Frame)
            records = (down if packet.from_host else up).feed((packet.packet,) if is_can else packet.packet)
            if packet.from_host:
                up.sent(packet.packet)
                slot = slots.get(_key(packet.packet))
                if slot is not None:
                    packet.slot, packet.message = slot, slot.poll.message
                    packet.device = "" if slot.common else slot.device.name
                    continue
            parts = begun.setdefault((packet.from_host, packet.packet.arbitration_id if is_can else None), [])
            parts.append(packet)
            found = next((record for record in reversed(records) if not isinstance(record, Unknown)), None)
            if found is None:
                continue
            members = list(host.meant_by(found))
            for part in parts:
                part.message = type(found).__name__
                part.device = members[0].name if len(members) == 1 else ""
            parts.clear()

    def _ticked(self, host: Host, streams: Sequence[_Stream], tick: int, begin: int) -> list[SentMessage]:
        """Return the messages that ticks bring about, requests before their answers."""
        made: list[SentMessage] = []
        requests: list[_Stream] = []
        periods: dict[str, int] = {}
        for stream in sorted(
            streams, key=lambda stream: -1 if stream.slot is None else self.order[id(stream.slot)]
        ):
            if stream.node != HOST:
                continue
            number, more = 1, dict[str, int]()
            if stream.slot is not None:
                period = max(stream.slot.every_ns, tick)
                more = {"first_ns": self.first[id(stream.slot)], "timeout_ns": stream.slot.timeout_ns}
            elif len(set(stream.instants)) < 2:
                continue  # a step of something, not traffic
            else:
                number, ticks = stream.rhythm(tick, begin)
                period = ticks * tick
                together = [slot.timeout_ns for slot in host.slots if slot.poll.together == stream.message]
                more = {"timeout_ns": max(together, default=0)}
            requests.append(stream)
            periods[stream.name] = period
            made += _numbered(stream.sent(period, is_ticked=True, **more), number)
        for stream in streams:
            if stream.node == HOST:
                continue
            for place, (cause, packets) in enumerate(_answered(host, stream, requests)):
                answers = _Stream(
                    stream.name if not place else f"{stream.name} ({place + 1})", stream.packets[0]
                )
                answers.packets = packets
                arrived = [packet.arrived for packet in cause.packets]
                delays = [
                    packet.instant - arrived[bisect_right(arrived, packet.instant) - 1] for packet in packets
                ]
                found = answers.sent(
                    periods[cause.name],
                    is_ticked=True,
                    after=cause.name,
                    delay_ns=max((delay for delay in delays if delay < tick), default=0),
                )
                made += _numbered(found, max(1, round(len(packets) / len(cause.packets))))
        return made


def _numbered(sent: SentMessage, number: int) -> list[SentMessage]:
    """Return a message as often as it is sent at once, each by a name of its own."""
    return [sent, *(replace(sent, name=f"{sent.name} #{n}") for n in range(2, number + 1))]


def _parts(packet: Packet) -> tuple[Any, ...]:
    return packet if isinstance(packet, tuple) else (packet,)


def _streams(packets: Sequence[_SentPacket]) -> dict[Any, _Stream]:
    """Return the packets by message, device, identifier and, of polls, what they ask."""
    streams: dict[Any, _Stream] = {}
    names: Counter[str] = Counter()
    for packet in packets:
        frame = packet.packet if isinstance(packet.packet, Frame) else None
        identity = None if frame is None else (frame.arbitration_id, frame.is_extended_id)
        key = (
            packet.from_host,
            packet.message,
            packet.device,
            identity,
            id(packet.slot) if packet.slot else None,
        )
        stream = streams.get(key)
        if stream is None:
            name = ".".join(part for part in (packet.device, packet.message) if part)
            if not name:
                name = "not decoded" if frame is None else f"0x{frame.arbitration_id:03X}"
            names[name] += 1
            stream = streams[key] = _Stream(name if names[name] == 1 else f"{name} ({names[name]})", packet)
        stream.packets.append(packet)
    return streams


def _answered(
    host: Host, answer: _Stream, requests: Sequence[_Stream]
) -> list[tuple[_Stream, list[_SentPacket]]]:
    """Return the requests that a device's message answers, each with the packets that do: those that polls declare, or
    whatever its device was sent last.
    """
    declared = [request for request in requests if _is_declared(host, request, answer)]
    candidates = declared or [request for request in requests if request.device in (answer.device, "")]
    arrived = sorted(
        (packet.arrived, place)
        for place, request in enumerate(candidates)
        for packet in request.packets
        if packet.arrived >= 0
    )
    found: dict[int, list[_SentPacket]] = {}
    for packet in answer.packets:
        at = bisect_right(arrived, (packet.instant, len(candidates)))
        if at:
            found.setdefault(arrived[at - 1][1], []).append(packet)
    return [(candidates[place], packets) for place, packets in sorted(found.items())]


def _is_declared(host: Host, request: _Stream, answer: _Stream) -> bool:
    """Return whether a poll says that this answers that."""
    slot = request.slot
    if slot is not None:
        return answer.message in slot.replies and (slot.common or request.device == answer.device)
    return any(
        slot.device.name == answer.device
        and (
            (slot.poll.together == request.message and answer.message in slot.replies)
            or slot.poll.asked_by.get(request.message) == answer.message
        )
        for slot in host.slots
        if request.device in (answer.device, "")
    )
