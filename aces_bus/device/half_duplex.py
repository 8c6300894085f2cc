"""A half-duplex line: one speaks at a time, and the next one when it was answered or its time is up.

1. A stop speaks next, whatever waits, and so does what confirms one. Each has its turn, however often another is sent again.
   What else is asked leaves in its order; polls that are due speak when nothing waits.
2. Set-points wait for a turn as values: their packet is built when they have the line, so that none is older than the last
   tick, and none of a device that was stopped meanwhile is left.
3. A poll whose answer would come after the budget's end waits for the next tick, unless it is the tick's first.
4. One packet may ask several devices at once: the line is free when all of them have answered.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING

from ..errors import DeviceError
from .coalesce import OutgoingMessage, per_device
from .poll import PollSlot
from .ticket import Ticket

if TYPE_CHECKING:
    from .device import Device
    from .host import Host

#: An instant that does not come (ns).
NEVER_NS = 1 << 62
#: A silent device's time-outs take one part in so many of the time.
SILENT_SHARE = 5


class HalfDuplexLine:
    """Who speaks on a host's line, and who waits for it; made by `Host`."""

    def __init__(self, host: Host) -> None:
        self.host = host
        #: In the order in which they speak: stops and what confirms them, the rest of the set-points' turn, and what waits
        #: (None: for their turn).
        self._stops: deque[Ticket] = deque()
        self._set_points: deque[OutgoingMessage] = deque()
        self._waiting: deque[Ticket | None] = deque()
        #: What has the line (None: it is free).
        self._speaking: Ticket | None = None
        #: Those of a packet that asks several who have not been answered yet, and those that such a packet is made for now.
        self._together: list[Ticket] = []
        self._gathering: list[Ticket] | None = None
        #: Who was asked last; who did not answer in time, where nothing was answered since.
        self.spoke_last: Device | None = None
        self._missed_last: Device | None = None
        #: Whether a ticket was missed right behind another device's.
        self._is_behind_a_miss = False
        #: After what instant no poll of this tick may end, and whether the tick has had one: the first one goes out whatever
        #: it costs, or it never would.
        self._polls_end, self._has_polled = NEVER_NS, False

    @property
    def speaker(self) -> Device | None:
        """Who has the line."""
        ticket = self._together[0] if self._together else self._speaking
        return ticket.device if ticket is not None else None

    def begin_tick(self, polls_end: int) -> None:
        """Begin a tick whose polls are over by `polls_end` (ns)."""
        self._polls_end, self._has_polled = polls_end, False

    def put(self, ticket: Ticket) -> None:
        """Queue a packet behind those that wait; call `pump` then."""
        (self._stops if ticket.confirms else self._waiting).append(ticket)

    def put_set_points(self) -> None:
        """Give wanted set-points a turn behind what waits, unless they wait for one already."""
        if None not in self._waiting:
            self._waiting.append(None)
        self.pump()

    def overtake(self, ticket: Ticket) -> None:
        """Queue a stop before everything that is not a stop, and in place of packets that wait for its
        device; call `pump` then.

        A stop that waits already is not queued again: a device whose stop is repeated would hold up the stops
        of others.
        """
        overtaken = [
            queued for queued in self._waiting if queued is not None and _is_overtaken(queued, ticket)
        ]
        self._waiting = deque(queued for queued in self._waiting if queued not in overtaken)
        self._set_points = deque(self._without(ticket.device))
        if (
            self.host.port.link == "can"
        ):  # the bus itself is free: only the devices take one request at a time
            self.host.send(ticket, self.host.clock.now())
        else:
            same = (
                stop for stop in self._stops if stop.device is ticket.device and stop.packet == ticket.packet
            )
            if (waiting := next(same, None)) is not None:
                waiting.then(ticket.follow)
            else:
                self._stops.append(ticket)
        for dropped in overtaken:  # only now: who hears of it may ask for something else
            _fail_overtaken(dropped)

    def _without(self, device: Device) -> Iterator[OutgoingMessage]:
        """Yield what set-points have still to say, but for those of a device."""
        for out in self._set_points:
            left = [ticket for ticket in out.carries if ticket.device is not device]
            if out.device is not device and len(left) == len(out.carries):
                yield out
            elif left:
                yield from (self.host.rule_of(out.message, left[0].device) or per_device)(left)

    def missed(self, ticket: Ticket) -> None:
        """Note that a request was not answered in time."""
        last, self._missed_last = self._missed_last, ticket.device
        self._is_behind_a_miss = last is not None and last is not ticket.device

    def again(self, ticket: Ticket) -> None:
        """Ask again after a miss, behind stops and before all other requests.

        A stop is repeated at once if the request before it was not answered either: that answer may have come
        late, in place of the stop's.
        """
        if ticket.urgent or ticket.confirms:
            if self._is_behind_a_miss:
                self._stops.appendleft(ticket)
            else:
                self._stops.append(ticket)
        elif any(_is_overtaken(ticket, stop) for stop in self._stops):
            _fail_overtaken(ticket)
        else:
            self._waiting.appendleft(ticket)
        self.free(ticket)

    def pump(self) -> None:
        """Send the next packet if the line is free."""
        host = self.host
        while self._speaking is None and host.is_open:
            if self._stops:
                self._speak(self._stops.popleft())
            elif self._set_points:
                out = self._set_points.popleft()
                packet = host.packet_of(
                    out
                )  # what does not fit is reported, and who hears of it may stop devices
                if packet is not None:
                    reply, within_s = out.device.stream_replies.get(out.message, ("", 0.0))
                    self._speak(
                        Ticket(
                            host.clock,
                            out.device,
                            out.message,
                            packet,
                            frozenset((reply,) if reply else ()),
                            round(within_s * 1e9),
                        )
                    )
            elif self._waiting:
                ticket = self._waiting.popleft()
                if ticket is not None:
                    self._speak(ticket)
                else:
                    self._set_points.extend(host.set_points(host.clock.now()))
            elif not self._take_poll():
                return

    def _take_poll(self) -> bool:
        """Let a poll that is due have the line; whether there was one."""
        host, now = self.host, self.host.clock.now()
        slots = host.slots
        for _ in range(len(slots)):
            slot = slots[0]
            if slot.due <= now and slot.waiting is None:
                if self._has_polled and now + slot.cost_ns > self._polls_end:
                    host.counts.polls_carried += 1
                    return False  # its answer would come after the budget's end
                slots.rotate(-1)
                host.polling.take(slot, now)
                return True
            slots.rotate(-1)
        return False

    def poll(self, slot: PollSlot, ticket: Ticket, now: int) -> None:
        """Send a poll whose turn it is, alone or with others that ask for the same."""
        self._has_polled = True
        if self._gathering is not None:
            self._gathering.append(ticket)
        elif slot.poll.together and not slot.device.misses:
            self._speak_together(slot, ticket, now)
        else:
            self._speak(ticket)

    def _speak(self, ticket: Ticket) -> None:
        host = self.host
        self._speaking = ticket
        self.spoke_last = ticket.device
        host.send(ticket, host.clock.now())
        if not ticket.reply:
            # Its time on the line is over, and it has left: a gate that is late must not send it behind what comes next.
            host.clock.call_in(host.port.wire_ns(ticket.packet), lambda: ticket.then(self.free))

    def _speak_together(self, first: PollSlot, ticket: Ticket, now: int) -> None:
        """Ask all that are due for the same in one packet; each has a ticket of its own.

        Who did not answer the last time is asked alone: those behind it in a common answer may have waited for it in vain.
        """
        host = self.host
        poll, variant = first.poll, first.device.variant
        tickets = self._gathering = [ticket]
        for slot in host.slots:
            if slot.due <= now and slot.waiting is None and not slot.device.misses:
                other = slot.poll
                if (
                    other.together == poll.together
                    and other.fields == poll.fields
                    and slot.device.variant is variant
                ):
                    host.polling.take(slot, now)
        self._gathering = None
        if len(tickets) == 1:
            self._speak(ticket)
            return
        order = {name: number for number, name in enumerate(host.members)}
        tickets.sort(key=lambda asked: order[asked.device.name])  # the same packet each time
        packet = first.device.packet_together([asked.device for asked in tickets], poll)
        self._speaking, self._together = ticket, tickets[:]
        self.spoke_last = first.device
        host.transmit(packet, first.device, poll.together, ticket.timeout_ns)
        answers_ns = 2 * first.wire_ns * len(tickets)
        for asked in tickets:
            asked.tries += 1
            host.unanswered.wait_for(asked, now, answers_ns)

    def answered(self, ticket: Ticket) -> None:
        """Note that the speaking device has answered."""
        self._missed_last = None
        self.free(ticket)

    def free(self, ticket: Ticket) -> None:
        """Free the line: the speaking device has answered, or will not."""
        together = self._together
        if ticket in together:
            together.remove(ticket)
            if together:
                return
        elif self._speaking is not ticket:
            return
        self._speaking = None
        self.host.clock.call_soon(self.pump)


def _is_overtaken(ticket: Ticket, stop: Ticket) -> bool:
    return ticket.device is stop.device and not ticket.urgent and ticket.poll is None


def _fail_overtaken(ticket: Ticket) -> None:
    ticket.fail(DeviceError(f"{ticket.message} to {ticket.device.name}: a stop overtook it"))


def ask_less(slots: Collection[PollSlot], ticket: Ticket, now: int) -> None:
    """Poll a silent device less often until it answers: its time-outs hold up all others."""
    due = now + (SILENT_SHARE - 1) * ticket.timeout_ns
    for slot in slots:
        if slot.device is ticket.device:
            slot.due = max(slot.due, due)
