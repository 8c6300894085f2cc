"""How long a message takes at most, from the begin of its period until it has arrived: for messages that know nothing of
one another.

1. Exact for nodes that send by priority: Davis, Burns, Bril, Lukkien, *Controller Area Network (CAN) schedulability
   analysis: Refuted, revisited and revised*, Real-Time Systems 35 (2007): all instances within a busy period.
2. For nodes that send in order (FIFO) a bound as of Davis, Kollmann, Pollex, Slomka, *CAN schedulability analysis with FIFO
   queues*, ECRTS 2011: what waits in a FIFO competes as its least urgent message, and what was queued behind others comes
   to the bus with that much more jitter.
3. A number that is not found within `LONGEST_NS` is None: there is no bound, or none that is of use.

*Choice*: the papers' FIFO test asks that a message has left before its next instance is queued. Here the busy period at the
level of the FIFO's least urgent message is looked through, and in it each instant at which something is queued (as Davis and
Navet do, WFCS 2012), so that it holds for any deadline.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

from .messages import ERROR_BITS, BusMessage, MessageSet

#: A busy period longer than this (ns) is taken to have no end.
LONGEST_NS = 600_000_000_000
#: So many instances of one message are looked at in a busy period.
MOST_INSTANCES = 100_000
#: Queues that wait for one another are settled in so many turns, or not at all: nor where one waits for so many of the
#: longest periods.
MOST_TURNS, MOST_PERIODS = 200, 30


@dataclass(frozen=True)
class ResponseTime:
    """What a message may have to wait: all in ns, None where there is no bound.

    `response_ns` is from the begin of its period until it has arrived, `blocking_ns` the frame of less urgency that was
    already on the bus, `busy_ns` the busy period in which the worst is, `instance` which one it is of those within (from 0).
    """

    message: BusMessage
    response_ns: int | None
    blocking_ns: int
    busy_ns: int | None
    instance: int = 0

    @property
    def is_met(self) -> bool:
        """True if the message always arrives by its deadline."""
        return self.response_ns is not None and self.response_ns <= self.message.due_ns


def response_times(messages: MessageSet) -> dict[str, ResponseTime]:
    """Return the worst-case response time of each message, by its name, in order of priority.

    >>> ms = 1_000_000
    >>> found = response_times(MessageSet((                    # Davis et al. 2007, table 2
    ...     BusMessage("A", 1, 1 * ms, 5 * ms // 2),
    ...     BusMessage("B", 2, 1 * ms, 7 * ms // 2, deadline_ns=13 * ms // 4),
    ...     BusMessage("C", 3, 1 * ms, 7 * ms // 2, deadline_ns=13 * ms // 4)), bit_ns=8_000))
    >>> [(name, one.response_ns / ms, one.is_met) for name, one in found.items()]
    [('A', 2.0, True), ('B', 3.0, True), ('C', 3.5, False)]
    """
    ordered = sorted(messages.messages, key=lambda message: message.priority)
    most = MOST_PERIODS * max((message.period_ns for message in ordered), default=0)
    found: dict[str, ResponseTime] = {}
    queued = dict[str, int]()
    later = {message.name: message.jitter_ns for message in ordered}  # until it may take part in arbitration
    turn = 0
    while later != queued:
        queued, later, turn = later, dict(later), turn + 1
        for message in ordered:
            if not messages.is_fifo(message):
                found[message.name] = _of_priority(messages, message, queued)
                continue
            result = _of_fifo(messages, message, queued)
            delay = LONGEST_NS if result.response_ns is None else result.response_ns - message.wire_ns
            if delay > most or (turn > MOST_TURNS and delay != queued[message.name]):
                # Queues that drive one another up: there is no bound for them.
                result, delay = replace(result, response_ns=None, busy_ns=None, instance=0), LONGEST_NS
            found[message.name], later[message.name] = result, delay
    return found


def _is_overloaded(messages: MessageSet, some: Sequence[BusMessage], blocking_ns: int) -> bool:
    """Return whether a busy period of these need not end."""
    load = sum((Fraction(message.wire_ns, message.period_ns) for message in some), Fraction())
    if messages.errors.burst:
        longest = max(message.wire_ns for message in some)
        load += Fraction(ERROR_BITS * messages.bit_ns + longest, messages.errors.every_ns)
    is_delayed = blocking_ns or messages.errors.burst or any(message.jitter_ns for message in some)
    return load > 1 or (load == 1 and bool(is_delayed))


def _fixed_point(start: int, step: Callable[[int], int]) -> int | None:
    """Return the least number from `start` on that `step`, which never falls, leaves as it is; None: none within
    `LONGEST_NS`.
    """
    now = start
    while now <= LONGEST_NS:
        following = step(now)
        if following == now:
            return now
        now = following
    return None


def _count(window_ns: int, jitter_ns: int, period_ns: int) -> int:
    """Return how many instances of a message are queued within a window that opens with one that is as late as can be."""
    return -(-(window_ns + jitter_ns) // period_ns)


def _of_priority(messages: MessageSet, message: BusMessage, queued: dict[str, int]) -> ResponseTime:
    """Return the revised analysis of 2007. Messages of the same priority are taken to go first."""
    above = [
        other for other in messages.messages if other is not message and other.priority <= message.priority
    ]
    below = [other for other in messages.messages if other.priority > message.priority]
    wire, period, jitter = message.wire_ns, message.period_ns, queued[message.name]
    blocking = max((other.wire_ns for other in below), default=0)
    if _is_overloaded(messages, [message, *above], blocking) or any(
        queued[other.name] >= LONGEST_NS for other in above
    ):
        return ResponseTime(message, None, blocking, None)
    again = [wire, *(other.wire_ns for other in above)]
    level = [(other.wire_ns, queued[other.name], other.period_ns) for other in above]
    bit = messages.bit_ns

    def busy_until(now: int) -> int:
        own = _count(now, jitter, period) * wire
        more = sum(_count(now, late, every) * long for long, late, every in level)
        return messages.error_ns(now, again) + blocking + own + more

    busy = _fixed_point(wire, busy_until)
    if busy is None or (instances := _count(busy, jitter, period)) > MOST_INSTANCES:
        return ResponseTime(message, None, blocking, None)
    worst, which, wait = 0, 0, 0
    for instance in range(instances):

        def waits(now: int, before: int = instance * wire) -> int:
            more = sum(_count(now + bit, late, every) * long for long, late, every in level)
            return messages.error_ns(now + wire, again) + blocking + before + more

        found = _fixed_point(max(wait, blocking + instance * wire), waits)
        if found is None:
            return ResponseTime(message, None, blocking, None)
        wait = found
        response = jitter + wait - instance * period + wire
        if response > worst:
            worst, which = response, instance
    return ResponseTime(message, worst, blocking, busy, which)


def _of_fifo(messages: MessageSet, message: BusMessage, queued: dict[str, int]) -> ResponseTime:
    """Return a message that waits behind all that its node has queued before."""
    mine = [other for other in messages.messages if other.node == message.node]
    lowest = max(other.priority for other in mine)
    above = [other for other in messages.messages if other.node != message.node and other.priority <= lowest]
    below = [other for other in messages.messages if other.node != message.node and other.priority > lowest]
    blocking = max((other.wire_ns for other in below), default=0)
    if _is_overloaded(messages, [*mine, *above], blocking) or any(
        queued[other.name] >= LONGEST_NS for other in above
    ):
        return ResponseTime(message, None, blocking, None)
    again = [other.wire_ns for other in (*mine, *above)]
    level = [(other.wire_ns, queued[other.name], other.period_ns) for other in above]
    bit = messages.bit_ns

    def busy_until(now: int) -> int:
        own = sum(_count(now, other.jitter_ns, other.period_ns) * other.wire_ns for other in mine)
        more = sum(_count(now, late, every) * long for long, late, every in level)
        return messages.error_ns(now, again) + blocking + own + more

    busy = _fixed_point(message.wire_ns, busy_until)
    if busy is None:
        return ResponseTime(message, None, blocking, None)
    # What was queued by an instant changes at the begin of periods; the wait is longest just then.
    instants = {0}
    for other in mine:
        first = max(1, -(-other.jitter_ns // other.period_ns))
        last = (busy + other.jitter_ns) // other.period_ns
        if last - first > MOST_INSTANCES:
            return ResponseTime(message, None, blocking, None)
        instants.update(n * other.period_ns - other.jitter_ns for n in range(first, last + 1))
    worst, which, wait = 0, 0, 0
    for instant in sorted(begin for begin in instants if begin < busy):
        before = (
            sum(((instant + other.jitter_ns) // other.period_ns + 1) * other.wire_ns for other in mine)
            - message.wire_ns
        )

        def waits(now: int, before: int = before) -> int:
            more = sum(_count(now + bit, late, every) * long for long, late, every in level)
            return messages.error_ns(now + message.wire_ns, again) + blocking + before + more

        found = _fixed_point(max(wait, blocking + before), waits)
        if found is None:
            return ResponseTime(message, None, blocking, None)
        wait = found  # a later instant waits no less
        response = message.jitter_ns + wait + message.wire_ns - instant
        if response > worst:
            worst, which = response, (instant + message.jitter_ns) // message.period_ns
    return ResponseTime(message, worst, blocking, busy, which)
