"""Whether a robot's buses can carry it: utilisation, response times, cycles, deadlines.

1. What the host's tick brings about has to be over before the next tick, whatever its own period; what a device sends
   by itself has its period as its deadline.
2. CAN: `round_times` for ticks, over each different content that a tick can have as the host spreads its slow polls.
   Lines: a byte is ten bits; half-duplex ones, and devices that take one request at a time, are one chain of
   requests and answers; on full-duplex ones each way is a wire of its own.
3. Where a number is not known (datagrams have no bit rate) there is none: nothing is guessed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import lcm

from aces_bus import Frame
from aces_bus.errors import UnknownNameError
from aces_bus.hardware.simulated.bus import arbitration
from aces_bus.hardware.simulated.serial_line import BITS

from .messages import NO_ERRORS, BusMessage, ErrorModel, MessageSet, Queue, bits_ns, frame_ns
from .response import ResponseTime
from .rounds import RoundFrame, RoundTimes, round_times
from .traffic import HOST, BusTraffic, RobotTraffic, SentMessage

#: So many ticks are looked at; what takes longer to repeat is taken to be in each.
MOST_TICKS = 1000


@dataclass(frozen=True)
class Assumptions:
    """What a robot's file and its twins do not say. Times in ns.

    `queues`: how nodes queue (node → "fifo" or "priority"), by default the host as SocketCAN does, in order, and devices by
    priority. `errors` are of CAN buses. `jitter_ns`: how late a tick may be; `answer_ns`: how long devices take to answer at
    least (their twins' time, where that is longer); `latency_ns`: how long the host takes from an answer to the next
    request, where it asks one by one. `together`: all slow polls may be due in one tick.
    """

    queues: Mapping[str, Queue] = field(default_factory=dict[str, Queue])
    errors: ErrorModel = NO_ERRORS
    jitter_ns: int = 0
    answer_ns: int = 0
    latency_ns: int = 0
    together: bool = False


USUAL = Assumptions()


@dataclass(frozen=True)
class MessageBudget:
    """A message and how long it may take, from the tick that brings it about (or the begin of its period): ns.

    `response_ns` is None where there is no bound. `is_carried`: it does not fit into the host's share of a tick, so that it,
    or another in its place, waits for the next one.
    """

    sent: SentMessage
    wire_ns: int
    response_ns: int | None
    deadline_ns: int
    is_carried: bool = False

    @property
    def name(self) -> str:
        """The message's name."""
        return self.sent.name

    @property
    def is_met(self) -> bool:
        """True if the message always keeps its deadline."""
        return self.response_ns is not None and self.response_ns <= self.deadline_ns and not self.is_carried


@dataclass(frozen=True)
class BusBudget:
    """One bus: `utilisation` is a share of 1 (of the fuller way, where there are two), None of datagrams.

    `round_ns`: when all that a tick brings about is over; `silent_ns`: the same with a device that does not answer, where
    the host waits for it.
    """

    traffic: BusTraffic
    utilisation: float | None
    messages: tuple[MessageBudget, ...]
    round_ns: int | None = None
    silent_ns: int | None = None

    @property
    def missed(self) -> tuple[MessageBudget, ...]:
        """The messages whose deadline cannot be promised."""
        return tuple(message for message in self.messages if not message.is_met)

    @property
    def is_met(self) -> bool:
        """True if every deadline of the bus is kept."""
        return not self.missed


@dataclass(frozen=True)
class RobotBudget:
    """A robot's buses at a rate."""

    traffic: RobotTraffic
    buses: Mapping[str, BusBudget]

    @property
    def is_met(self) -> bool:
        """True if every deadline of every bus is kept."""
        return all(bus.is_met for bus in self.buses.values())


def robot_budget(traffic: RobotTraffic, assumptions: Assumptions = USUAL) -> RobotBudget:
    """Return the budget of each bus. Raises `UnknownNameError` for a queue of a node that there is not.

    ```python
    traffic = robot_traffic(load_robot("hubo2plus"))
    now, twice = robot_budget(traffic), robot_budget(traffic.at(2))
    ```
    """
    nodes = {message.node for bus in traffic.buses.values() for message in bus.messages}
    for node in assumptions.queues:
        if node not in nodes:
            raise UnknownNameError(f"node of {traffic.robot}", node, nodes)
    return RobotBudget(traffic, {name: _bus_budget(bus, assumptions) for name, bus in traffic.buses.items()})


def _bus_budget(bus: BusTraffic, assumptions: Assumptions) -> BusBudget:
    if bus.bitrate is None:
        return BusBudget(bus, None, ())
    wires = {message.name: _wire_ns(bus, message) for message in bus.messages}
    put_off: set[str] = set()
    found: dict[str, ResponseTime] = {}
    ends: list[int | None] = []
    ways = [bus.messages]
    if bus.link == "serial" and not bus.half_duplex:
        ways = [
            tuple(message for message in bus.messages if message.node == HOST),
            tuple(message for message in bus.messages if message.node != HOST),
        ]
    for number, way in enumerate(ways):
        starts = {name: bound.response_ns or 0 for name, bound in found.items()} if number else {}
        for whole in _contents(bus, way, assumptions.together):
            content = _fitting(bus, whole, wires, assumptions)
            put_off |= {
                message.name
                for message in whole
                if message not in content and message.period_ns <= bus.tick_ns
            }
            times = _times(bus, content, way, wires, assumptions, starts)
            ends.append(times.round_ns)
            for name, bound in (*times.frames.items(), *times.others.items()):
                before = found.get(name)
                if before is None or _longer(bound.response_ns, before.response_ns):
                    found[name] = bound
    round_ns = None if None in ends else max((end for end in ends if end is not None), default=0)
    messages = []
    for message in bus.messages:
        times_of = found.get(message.name)
        deadline = bus.tick_ns if message.is_ticked else message.period_ns
        response = None if times_of is None else times_of.response_ns
        if bus.one_by_one and response is not None and (message.after or message.timeout_ns):
            response = round_ns  # where the line is asked one by one, whose turn is the last changes
        is_carried = times_of is None or message.name in put_off
        messages.append(MessageBudget(message, wires[message.name], response, deadline, is_carried))
    loads = [sum(wires[message.name] / message.period_ns for message in way) for way in ways]
    return BusBudget(bus, max(loads), tuple(messages), round_ns, _silent_ns(bus, messages, round_ns))


def _longer(first: int | None, other: int | None) -> bool:
    return other is not None and (first is None or first > other)


def _wire_ns(bus: BusTraffic, message: SentMessage) -> int:
    assert bus.bitrate is not None
    if bus.link != "can":
        return bits_ns(message.size * BITS, bus.bitrate)
    return frame_ns(
        message.size,
        bus.bitrate,
        extended=message.extended,
        fd=message.fd,
        bitrate_switch=message.bitrate_switch,
        data_bitrate=bus.data_bitrate,
    )


def _fitting(
    bus: BusTraffic,
    content: Sequence[SentMessage],
    wires: Mapping[str, int],
    assumptions: Assumptions,
) -> tuple[SentMessage, ...]:
    """Return what a host sends of a tick's content, in its order, and what answers it; polls that do not fit wait for
    the next one.

    One that asks one by one knows what an answer costs; any other takes it to be as long as its request (`Host.tick`).
    """
    used, left_out, polls = 0, set[str](), 0
    for message in sorted(
        (command for command in content if command.node == HOST), key=lambda command: command.timeout_ns > 0
    ):
        cost = wires[message.name]
        if message.timeout_ns:
            answers = [answer for answer in content if answer.after == message.name]
            if not bus.one_by_one:
                cost *= 2
            elif answers:
                delays = [max(answer.delay_ns, assumptions.answer_ns) for answer in answers]
                longest = max(range(len(answers)), key=delays.__getitem__)
                cost += max(
                    sum(wires[answer.name] for answer in answers),
                    delays[longest] + wires[answers[longest].name],
                )
                cost += assumptions.latency_ns
            is_first = bus.one_by_one and not polls  # it goes out whatever it costs, or it never would
            if used + cost > bus.budget * bus.tick_ns and not is_first:
                left_out.add(message.name)
                continue
            polls += 1
        used += cost
    return tuple(
        message for message in content if message.name not in left_out and message.after not in left_out
    )


def _contents(
    bus: BusTraffic, messages: Sequence[SentMessage], together: bool
) -> Iterable[tuple[SentMessage, ...]]:
    """Yield what different ticks have in them, of all that ticks bring about."""
    ticked = tuple(message for message in messages if message.is_ticked)
    tick = bus.tick_ns
    by_name = {message.name: message for message in bus.messages}
    #: Of a slow poll: it is sent each so many ticks, from which one on (`Polling.take`).
    rhythms: dict[str, tuple[int, int]] = {}
    for message in ticked:
        poll = by_name.get(message.after, message)
        if not together and poll.timeout_ns and poll.period_ns > tick:
            every = -(-(poll.period_ns - tick // 2) // tick)
            rhythms[message.name] = every, -(-poll.first_ns // tick) % every
    for name, (every, _) in sorted(rhythms.items(), key=lambda item: -item[1][0]):
        if lcm(*(every for every, _ in rhythms.values())) <= MOST_TICKS:
            break
        del rhythms[name]
    found: set[frozenset[str]] = set()
    for number in range(lcm(*(every for every, _ in rhythms.values()))):
        found.add(
            frozenset(
                message.name
                for message in ticked
                if message.name not in rhythms
                or number % rhythms[message.name][0] == rhythms[message.name][1]
            )
        )
    for content in found:
        if not any(content < other for other in found):
            yield tuple(message for message in ticked if message.name in content)


def _times(
    bus: BusTraffic,
    content: Sequence[SentMessage],
    way: Sequence[SentMessage],
    wires: Mapping[str, int],
    assumptions: Assumptions,
    starts: Mapping[str, int],
) -> RoundTimes:
    """Return the response times of one tick's messages; `starts` are when requests have arrived that went the other way."""
    assert bus.bitrate is not None
    is_can = bus.link == "can"
    alone = [message for message in way if not message.is_ticked]
    there = {message.name for message in content}
    frames: list[RoundFrame] = []
    last, longest = "", -1
    for request in (message for message in content if not message.after or message.after not in there):
        after, delay = "", assumptions.jitter_ns
        if request.after:  # its request went the other way
            delay = starts.get(request.after, 0) + max(request.delay_ns, assumptions.answer_ns)
        elif bus.one_by_one and last:
            after, delay = last, assumptions.latency_ns if longest >= 0 else 0
        frames.append(RoundFrame(_message(request, wires, delay), after))
        if bus.one_by_one and not request.after:
            last, longest = request.name, -1
        for answer in content:
            if answer.after == request.name:
                delay = max(answer.delay_ns, assumptions.answer_ns)
                frames.append(RoundFrame(_message(answer, wires, delay), request.name))
                if bus.one_by_one and delay >= longest:
                    last, longest = answer.name, delay
    nodes = {message.node for message in alone}
    queues: dict[str, Queue] = {HOST: "fifo", **assumptions.queues}
    others = MessageSet(
        tuple(_message(message, wires, 0) for message in alone),
        bits_ns(1, bus.bitrate),
        {node: queue for node, queue in queues.items() if node in nodes},
        assumptions.errors if is_can else NO_ERRORS,
    )
    return round_times(frames, others, bus.tick_ns, queues=queues)


def _message(sent: SentMessage, wires: Mapping[str, int], jitter_ns: int) -> BusMessage:
    priority = 0  # on a line who is first is first
    if sent.identifier is not None:
        priority = arbitration(Frame(sent.identifier, is_extended_id=sent.extended))
    return BusMessage(sent.name, priority, wires[sent.name], sent.period_ns, jitter_ns, None, sent.node)


def _silent_ns(bus: BusTraffic, messages: Sequence[MessageBudget], round_ns: int | None) -> int | None:
    """Return when a tick is over in which one device does not answer, if the host waits for it."""
    if not bus.one_by_one or round_ns is None:
        return None
    timeouts = {message.name: message.sent.timeout_ns for message in messages if message.sent.timeout_ns}
    lost = [
        timeouts[message.sent.after] - message.sent.delay_ns - message.wire_ns
        for message in messages
        if message.sent.after in timeouts and message.response_ns is not None
    ]
    return round_ns + max(lost) if lost else None


def at_bitrate(
    traffic: RobotTraffic, *, bitrate: int | None = None, data_bitrate: int | None = None
) -> RobotTraffic:
    """Return the same traffic on CAN buses of these bit rates (bit/s; None: as they are)."""
    return replace(
        traffic,
        buses={
            name: replace(bus, bitrate=bitrate or bus.bitrate, data_bitrate=data_bitrate or bus.data_bitrate)
            if bus.link == "can"
            else bus
            for name, bus in traffic.buses.items()
        },
    )
