"""What was asked on a host's bus and is not answered yet: who gets which answer, and what becomes of what is missed.

1. A record answers the oldest request of its device that it can answer; what no request waits for is late, a second answer,
   or a device that speaks by itself.
2. One timer for all: the earliest deadline. What is missed is asked again as often as was said, then fails or is counted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from heapq import heappop, heappush
from typing import TYPE_CHECKING

from ..errors import NoReplyError
from ..protocol import Record
from ..protocol.live.stream import StreamScanner
from ..runtime.clock import Timer
from .device import Device
from .half_duplex import ask_less
from .poll import PollSlot
from .ticket import Ticket

if TYPE_CHECKING:
    from .host import Host

#: An answer this soon (ns) after another to the same request is a second device's.
DUPLICATE_REPLY_NS = 20_000_000
#: An answer that is later than this (ns) does not come any more.
LATE_REPLY_NS = 500_000_000
#: Held up itself for so long (ns), this machine receives what has come meanwhile before a device counts as missing.
HELD_UP_NS, LISTEN_NS = 5_000_000, 10_000_000
#: It waits for that as long as it was held up, at most so long (ns).
MOST_LISTEN_NS = 100_000_000


class Unanswered:
    """Requests of a host that wait for answers."""

    def __init__(self, host: Host, duplicate: Callable[[Device, str, int], None]) -> None:
        """`duplicate` is called with a second answer: its device, details, the instant (ns)."""
        self.host, self.clock, self._duplicate = host, host.clock, duplicate
        #: When an answer was last received.
        self.received_at = 0
        #: By deadline, who waits until then, and who did: polls of one tick have few; and the deadlines as a heap.
        self._waiting: dict[int, list[Ticket]] = {}
        self._deadlines: list[int] = []
        self._timer: Timer | None = None
        self._is_hearing = False

    # ------------------------------------------------------------------ waiting

    def wait_for(self, ticket: Ticket, now: int, more_ns: int = 0) -> None:
        """Wait for the answer to a packet that is on its way, until its deadline."""
        ticket.sent_at = now
        slot: PollSlot | None = ticket.poll
        wire_ns = self.host.port.wire_ns(ticket.packet) if slot is None else slot.wire_ns
        device: Device = ticket.device
        device.awaiting.append(ticket)
        self._watch(ticket, now + ticket.timeout_ns + wire_ns + more_ns)

    def wait_for_polls(self, slots: Iterable[PollSlot], now: int) -> None:
        """Wait for the answers to the polls of one tick."""
        known = self._waiting
        for slot in slots:
            ticket = slot.ticket
            ticket.sent_at = now
            slot.device.awaiting.append(ticket)
            ticket.deadline = deadline = now + slot.timeout_ns + slot.wire_ns
            if deadline in known:
                known[deadline].append(ticket)
            else:
                self._watch(ticket, deadline)

    def prolong(self, device: Device, until: int) -> None:
        """Extend the deadlines of a device's requests to this instant (ns)."""
        for ticket in device.awaiting:
            if ticket.deadline < until:
                self._watch(ticket, until)

    def _watch(self, ticket: Ticket, deadline: int) -> None:
        """See to it that a ticket's deadline is looked at."""
        ticket.deadline = deadline
        waiting = self._waiting.get(deadline)
        if waiting is not None:
            waiting.append(ticket)
            return
        self._waiting[deadline] = [ticket]
        heappush(self._deadlines, deadline)
        timer = self._timer
        if timer is None or timer.action is None or timer.instant > deadline:
            if timer is not None:
                timer.cancel()
            self._timer = self.clock.call_at(deadline, self._expire)

    def _expire(self) -> None:
        """Look for tickets whose time is up."""
        now = self.clock.now()
        timer = self._timer
        if timer is not None and now - timer.instant > HELD_UP_NS and not self._is_hearing:
            self._is_hearing = True  # never in virtual time: it is not held up
            held_up = (
                now - timer.instant
            )  # whatever held this program up may hold up a server or a simulation, too
            self._timer = self.clock.call_in(max(LISTEN_NS, min(held_up, MOST_LISTEN_NS)), self._expire)
            return
        self._is_hearing = False
        deadlines = self._deadlines
        while deadlines:
            deadline = deadlines[0]
            waiting = [ticket for ticket in self._waiting[deadline] if self._is_waiting(ticket, deadline)]
            if deadline > now and waiting:
                break
            heappop(deadlines)
            del self._waiting[deadline]
            for ticket in waiting:
                if not self._is_waiting(ticket, deadline):
                    continue  # another's end was this one's
                self._end_incomplete(now)
                if self._is_waiting(ticket, deadline):  # its answer was not behind what was garbled
                    ticket.device.awaiting.remove(ticket)
                    self._missed(ticket, now)
        self._timer = self.clock.call_at(deadlines[0], self._expire) if deadlines else None

    @staticmethod
    def _is_waiting(ticket: Ticket, deadline: int) -> bool:
        """Return whether it waits for an answer until then: a poll may have been answered and asked anew."""
        return ticket.deadline == deadline and ticket in ticket.device.awaiting

    def _end_incomplete(self, now: int) -> None:
        """Give up an incomplete packet, which may be a false header: it would hold back the packets behind it."""
        host = self.host
        if not isinstance(host.scanner, StreamScanner):
            return
        # On a half-duplex line only the asked device could speak, and its time is up.
        is_silent = now - host.bytes_at > host.scanner.gap * 1e9
        if host.line is not None or is_silent:
            host.fell_silent()

    def _missed(self, ticket: Ticket, now: int) -> None:
        host, device = self.host, ticket.device
        host.counts.missed += 1
        for name in ticket.reply:
            device.timed_out[name] = device.timed_out.get(name, 0) + 1
        device.missed_at = now
        line = host.line
        if line is not None:
            line.missed(ticket)
        if ticket.tries <= ticket.retries:
            host.counts.repeated += 1
            if line is not None:
                line.again(ticket)
            else:
                host.send(ticket, now)
            return
        if ticket.poll is not None:
            ticket.poll.waiting = None
        self._count_miss(device, ticket, now)
        if ticket.poll is not None and host.period_ns and not device.is_silent:
            ticket.poll.due = now  # at once, not after its period: three in a row are silence
        if line is not None and device.is_silent and ticket.poll is not None:
            ask_less(host.slots, ticket, now)
        if ticket.poll is None:
            tries = f"{ticket.tries} tries" if ticket.tries > 1 else "one try"
            error = NoReplyError(
                f"{host.name} {device.name}: no answer to {ticket.message} within {ticket.timeout_ns / 1e6:g} ms ({tries});"
                " is it powered, on this bus, and of this number?"
            )
            host.emit("no reply", device.name, f"{ticket.message}, {tries}")
            ticket.fail(error)
        device.no_reply(ticket)
        if line is not None:
            line.free(ticket)

    def _count_miss(self, device: Device, ticket: Ticket, now: int) -> None:
        """Count a miss; a device that misses requests again and again is silent."""
        if device.misses == 0 or (
            device.last_received is not None and device.last_received >= device.missing_since
        ):
            device.misses, device.missing_since = 0, ticket.sent_at
        device.misses += 1
        # Polls of one tick miss together: that is one miss in a row, however many they are.
        is_long = now - device.missing_since > device.silent_after * ticket.timeout_ns // 2
        if device.misses >= device.silent_after and is_long and not device.is_silent:
            device.is_silent = True
            age = (
                "never received"
                if device.last_received is None
                else f"last received {(now - device.last_received) / 1e9:.3f} s ago"
            )
            self.host.emit("silent", device.name, f"{device.misses} requests without an answer, {age}")

    # ------------------------------------------------------------------ answers

    def answered(self, device: Device, name: str, record: Record, instant: int) -> None:
        """Settle the oldest request that a record answers. Called by `Device.receive`."""
        host = self.host
        counts = host.counts
        counts.received += 1
        self.received_at = instant
        if device.is_silent:
            device.is_silent = False
            host.emit("answers", device.name)
        for ticket in device.awaiting:
            if name in ticket.reply:
                break
        else:
            self._unasked(device, name, instant)
            return
        device.awaiting.remove(ticket)
        device.misses = 0
        device.answered[name] = instant
        if (device.timed_out or device.second_answers) and instant - device.missed_at > LATE_REPLY_NS:
            device.timed_out.clear()  # what has not come by now never will
            device.second_answers.clear()
        counts.answered += 1
        latency = instant - ticket.sent_at
        if latency > counts.latency_ns:
            counts.latency_ns = latency
        if latency > host.period_ns > 0:
            counts.answered_late += 1
        line = host.line
        slot: PollSlot | None = ticket.poll
        if slot is None:
            ticket.answered_at = instant
        else:  # how long the round takes
            slot.waiting = None
            cycle = instant - slot.asked_at
            if cycle > counts.cycle_ns:
                counts.cycle_ns = cycle
            counts.cycle_sum_ns += cycle
            counts.cycles += 1
            if line is not None:
                slot.cost_ns = cycle  # learnt: the poll with its answer
        if line is not None:
            line.answered(ticket)
        if slot is None:
            ticket.finish(record)

    def _unasked(self, device: Device, name: str, instant: int) -> None:
        """Classify a record that no request waits for: sent unasked, a late answer, or from a second device."""
        before = device.answered.get(name)
        late = device.timed_out.get(name, 0)
        expected = device.second_answers.get(name, 0)
        if late:
            device.timed_out[name] = late - 1
            self.host.emit("late reply", device.name, name)
        elif expected:  # this one was asked for, too: on a full bus the first was only slow
            device.second_answers[name] = expected - 1
        elif before is not None and instant - before < DUPLICATE_REPLY_NS:
            self._duplicate(device, f"{name} came twice", instant)
