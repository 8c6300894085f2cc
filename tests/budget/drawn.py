"""Drawn message sets, two simulators that know nothing of the analysis, and sets on the simulated bus.

`busy_period` is a bus from the critical instant, to the ns; `worst_seen` lets a set run on `SimulatedBus`, with its
stuffing, arbitration and queues.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Sequence
from functools import partial
from operator import sub

from aces_bus import Frame
from aces_bus.hardware import SimulatedBus
from aces_bus.hardware.simulated.bus import BusNode
from aces_bus.runtime import VirtualClock
from aces_lab.budget import BusMessage, MessageSet, can_message, response_times

#: Bytes that are stuffed much.
STUFFED = (0x00, 0xFF, 0x0F, 0xF0, 0x83, 0xC1, 0x1F, 0x07, 0x78, 0x87, 0x3C, 0xE1, 0x55)


def abstract_set(draw: random.Random) -> MessageSet:
    """Messages with any times: lengths 1 … 20, periods up to 300, jitter up to two periods; a bit is 1."""
    count = draw.randint(1, 6)
    messages = []
    for number in range(count):
        wire = draw.randint(1, 20)
        period = draw.randint(max(wire * count * 3 // 4, 2), 300)
        jitter = draw.choice((0, 0, draw.randint(0, period), draw.randint(0, 2 * period)))
        messages.append(BusMessage(f"m{number}", number, wire, period, jitter))
    return MessageSet(tuple(messages), 1)


def busy_period(messages: MessageSet, of: BusMessage) -> int | None:
    """The longest response of `of` in a busy period that all more urgent messages open as late as they may be, and the
    longest less urgent one just before; None where it goes on and on.
    """
    above = [one for one in messages.messages if one.priority < of.priority]
    now = max((one.wire_ns for one in messages.messages if one.priority > of.priority), default=0)
    sent = dict.fromkeys((*above, of), 0)
    worst = 0

    def queued_at(one: BusMessage) -> int:
        return max(0, sent[one] * one.period_ns - one.jitter_ns)

    while now < 1_000_000:
        ready = [one for one in sorted(sent, key=lambda one: one.priority) if queued_at(one) <= now]
        if not ready:
            return worst
        one = ready[0]
        now += one.wire_ns
        if one is of:
            worst = max(worst, now - (sent[of] * of.period_ns - of.jitter_ns))
        sent[one] += 1
    return None


def can_set(draw: random.Random, *, fifo: bool = False) -> tuple[MessageSet, dict[str, Frame], int]:
    """CAN messages of some nodes, a frame of each by name, and the bit rate: all but full, 11 and 29 bits."""
    bitrate = draw.choice((10_000, 20_000, 50_000))
    count = draw.randint(2, 8)
    load = draw.uniform(0.5, 0.95)
    shares = [draw.uniform(0.2, 1) for _ in range(count)]
    nodes = [f"n{draw.randrange(3)}" for _ in range(count)]
    messages, frames = [], {}
    for number, (share, node) in enumerate(zip(shares, nodes, strict=True)):
        extended = draw.random() < 0.4
        # No two of one identifier: on a bus they would meet.
        identifier = draw.getrandbits(22) << 7 | number if extended else draw.getrandbits(8) << 3 | number
        size = draw.randint(0, 8)
        wire = can_message("", identifier, size, 1 << 40, bitrate=bitrate, extended=extended).wire_ns
        period = max(round(wire * sum(shares) / share / load), wire)
        jitter = draw.choice((0, 0, round(period * draw.uniform(0, 0.8))))
        name = f"m{number}"
        messages.append(
            can_message(
                name,
                identifier,
                size,
                period,
                bitrate=bitrate,
                extended=extended,
                jitter_ns=jitter,
                node=node,
            )
        )
        data = bytes(draw.choice(STUFFED) for _ in range(size))
        frames[name] = Frame(identifier, data, is_extended_id=extended)
    there = sorted(set(nodes))
    queues = {node: "fifo" for node in there if fifo and draw.random() < 0.6}
    return MessageSet(tuple(messages), 1_000_000_000 // bitrate, queues), frames, bitrate  # type: ignore[arg-type]


class _Sender:
    """A node that gives its frames to the bus: all at once, or one by one in their order."""

    def __init__(self, bus: SimulatedBus, name: str, fifo: bool) -> None:
        self.node: BusNode = bus.attach(name)
        self.fifo, self.waiting = fifo, deque[Frame]()

    def send(self, frame: Frame) -> None:
        if not self.fifo:
            self.node.send(frame)
            return
        self.waiting.append(frame)
        if len(self.waiting) == 1:
            self._give()

    def _give(self) -> None:
        self.node.send(self.waiting[0], self._sent)

    def _sent(self, fate: str, why: str) -> None:
        self.waiting.popleft()
        if self.waiting:
            self._give()


def worst_seen(
    messages: MessageSet,
    frames: dict[str, Frame],
    bitrate: int,
    seconds: float,
    draw: random.Random,
    *,
    critical: bool,
) -> dict[str, int]:
    """The longest responses on a simulated bus (ns): all from one instant on, as late as they may be, or anyhow."""
    clock = VirtualClock()
    bus = SimulatedBus(clock, bitrate=bitrate)
    arrived: dict[tuple[int, bool], list[int]] = {
        (frame.arbitration_id, frame.is_extended_id): [] for frame in frames.values()
    }
    bus.attach(
        "listener",
        lambda frame, instant: arrived[frame.arbitration_id, frame.is_extended_id].append(instant),
    )
    senders = {
        node: _Sender(bus, node, messages.queues.get(node) == "fifo")
        for node in {one.node for one in messages.messages}
    }
    lowest = max(messages.messages, key=lambda one: one.priority)
    begun: dict[str, list[int]] = {}
    coming: list[tuple[int, int, _Sender, Frame]] = []
    for one in messages.messages:
        ahead = messages.bit_ns if one is lowest else 0
        begun[one.name], queued = releases(one, round(seconds * 1e9), draw, critical=critical, ahead_ns=ahead)
        coming += [(at, len(coming) + n, senders[one.node], frames[one.name]) for n, at in enumerate(queued)]
    coming.sort()
    following = iter(coming)

    def release(sender: _Sender, frame: Frame) -> None:
        sender.send(frame)
        for at, _, sender, frame in following:
            if at > clock.now():
                clock.post(at, partial(release, sender, frame))
                return
            sender.send(frame)

    at, _, sender, frame = next(following)
    clock.post(at, partial(release, sender, frame))
    clock.advance_to(round(seconds * 1e9))
    return {
        name: max(map(sub, arrived[frame.arbitration_id, frame.is_extended_id], begun[name]), default=0)
        for name, frame in frames.items()
    }


def releases(
    one: BusMessage, end: int, draw: random.Random, *, critical: bool, ahead_ns: int
) -> tuple[list[int], list[int]]:
    """When the periods of a message begin, and when it is queued in each, never before the last one: up to `end` (ns).

    `critical`: the first is queued at one second less `ahead_ns`, as late as can be, so that the second is near.
    """
    period, jitter = one.period_ns, one.jitter_ns
    if critical:
        late = jitter
        nominal = 1_000_000_000 - ahead_ns - jitter
    else:
        nominal, late = draw.randrange(period), draw.randint(0, jitter)
    begun, queued, last = list[int](), list[int](), 0
    while (last := max(last, nominal + late)) < end:
        begun.append(nominal)
        queued.append(last)
        nominal += period
        late = int(draw.random() * (jitter + 1)) if jitter and not (critical and draw.random() < 0.5) else 0
    return begun, queued


def check_sets(numbers: range, seed: int, *, seconds: float, phasings: int) -> Sequence[str]:
    """What drawn sets are seen to take beyond what was computed: nothing, one hopes. Every other set has FIFOs."""
    faults = []
    for number in numbers:
        draw = random.Random(f"{seed} {number}")
        messages, frames, bitrate = can_set(draw, fifo=bool(number % 2))
        computed = response_times(messages)
        for phasing in range(phasings):
            seen = worst_seen(messages, frames, bitrate, seconds, draw, critical=phasing == 0)
            for name, longest in seen.items():
                bound = computed[name].response_ns
                if bound is not None and longest > bound:
                    faults.append(f"set {number}, phasing {phasing}, {name}: {longest} ns, computed {bound}")
    return faults
