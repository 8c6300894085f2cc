"""What a host asks its devices, and when: polls in turn, as far as a tick's budget goes.

1. What did not fit into a tick is first in the next one; devices of a higher priority are asked before the others.
2. A poll that is not answered by the next tick, or the one after while others still come, is sent again.
3. Set-points that are answered as a poll is stand for it. Without ticks, all is asked on request.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

from ..errors import CallerError, FieldError, UnknownNameError
from ..protocol import CanScanner
from .declared import Poll
from .device import Device
from .half_duplex import NEVER_NS
from .poll import PollSlot
from .station import credential_text
from .ticket import Ticket

if TYPE_CHECKING:
    from .host import Host

#: A poll without an answer by the next tick, or the one after while others still come, is sent again, so often at most.
ASKED_AGAIN = 2
#: A bus on which nothing came for this part of a tick has nothing under way.
QUIET_SHARE = 5


def _nothing() -> None:
    """Note nothing."""


class Polling:
    """Made by `Host`, for its bus."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.slots: deque[PollSlot] = deque()
        #: By device and message of set-points: the poll that it stands for, and what answers it.
        self.stand_ins: dict[tuple[str, str], tuple[PollSlot, frozenset[str]]] = {}
        #: Whether some devices are asked before others in each tick.
        self._has_priorities = False
        #: Requests to everybody, and when each was last sent.
        self._asked_all: dict[Any, int] = {}
        #: When this tick is over, and after what instant no poll may end.
        self._tick_end, self._polls_end = 0, NEVER_NS

    # ------------------------------------------------------------------ whom, and what

    def add(self, member: Device) -> None:
        """Ask a device what it declares. Raises `CallerError` and `UnknownNameError` where it cannot be asked."""
        host = self.host
        for poll in member.all_polls:
            for name in poll.replies:
                if name not in member.variant.protocol.messages:
                    raise UnknownNameError(
                        f"message of {member.variant.name}, awaited by {member.name},",
                        name,
                        member.variant.protocol.messages,
                    )
            try:
                packet = host.packet(member, poll.message, poll.fields)
            except FieldError as error:
                raise CallerError(
                    f"{host.name} {member.name}: it cannot be asked: {error}; its credentials are:"
                    f" {credential_text(member.credentials) or 'none'}"
                ) from error
            slot = PollSlot(member, poll, packet, self._noting(packet), host.port.wire_ns(packet))
            if slot.every_ns:  # slow polls begin spread over their period, or all would meet in one tick
                slot.due = host.clock.now() + round(slot.every_ns * (0.618 * len(self.slots) % 1))
            if host.line is not None and not host.period_ns:
                slot.due = NEVER_NS  # asked on request: `poll` or `tick`
            self.slots.append(slot)
            for name, reply in poll.asked_by.items():
                self.stand_ins[member.name, name] = slot, frozenset((reply,))
        self._has_priorities = len({slot.priority for slot in self.slots}) > 1

    def _noting(self, packet: Any) -> Callable[[], None]:
        """Return what is called when a packet was sent, as replies may hang on it."""
        host = self.host
        if not isinstance(host.scanner, CanScanner) or isinstance(packet, tuple):
            return lambda: host.note(packet)
        return host.scanner.noting(packet) or _nothing

    def remove(self, device: Device | None) -> None:
        """Ask a device no more."""
        self.slots = deque(slot for slot in self.slots if slot.device is not device)
        self.stand_ins = {
            key: stand_in for key, stand_in in self.stand_ins.items() if stand_in[0].device is not device
        }

    def renew(self, device: Device) -> None:
        """Build a device's polls anew after its credentials have changed."""
        for slot in self.slots:
            if slot.device is device:
                self._build(slot)

    def _build(self, slot: PollSlot) -> None:
        packet = self.host.packet(slot.device, slot.poll.message, slot.poll.fields)
        slot.ask_with(packet, self._noting(packet))

    def postpone(self, device: Device, message: str, until: int) -> None:
        """Ask a device with this message not before this instant (ns)."""
        for slot in self.slots:
            if slot.device is device and slot.poll.message == message and slot.due < until:
                slot.due = until

    def retime(self, device: Device, poll: Poll, other: Poll) -> None:
        """Ask a device with `other` instead of `poll`: the same request at another period."""
        for slot in self.slots:
            if slot.device is device and slot.poll is poll:
                slot.retime(other)

    # ------------------------------------------------------------------ when

    def begin_tick(self, now: int) -> None:
        """Note when this tick ends, and until when it may poll."""
        host, line = self.host, self.host.line
        period = host.period_ns
        self._tick_end = now + period
        self._polls_end = now + round(period * host.budget) if period else NEVER_NS
        if line is not None:
            line.begin_tick(self._polls_end)
        if self._has_priorities:
            self.slots = deque(sorted(self.slots, key=lambda slot: -slot.priority))
        if line is not None and not period:
            for slot in self.slots:
                if not slot.every_ns or now - slot.asked_at >= slot.every_ns:
                    slot.due = now

    def ask_due(self, now: int, used: int) -> None:
        """Ask what is due, as far as the budget goes, of which `used` ns are taken."""
        host, slots = self.host, self.slots
        most = self._polls_end - now
        if host.clock.now() > self._polls_end:  # this machine was held up
            most = used
        asked, alone = 0, list[PollSlot]()
        for slot in tuple(slots):
            ticket = slot.waiting
            if slot.due <= now if ticket is None else self._is_overdue(slot, ticket, now):
                used += slot.cost_ns
                if used > most:
                    break
                if ticket is not None:
                    self._ask_again(ticket, now)
                elif slot.common:
                    self.take(slot, now)
                else:
                    alone.append(slot)
            asked += 1
        slots.rotate(-asked)
        self._ask(alone, now)
        if used > most:
            self._carry(now)

    def _ask(self, slots: list[PollSlot], now: int) -> None:
        """Ask these in this tick, each its own device: as `take`, with what they share done once."""
        host, is_open = self.host, self.host.is_open
        send, early = host.port.send, host.period_ns // 2
        sent = 0
        for slot in slots:
            every = slot.every_ns
            slot.due = now + every - early if every else now
            slot.asked_at = now
            slot.waiting = ticket = slot.ticket
            ticket.tries, ticket.reply = 1, slot.replies
            if slot.has_counter:
                self._build(slot)
            if is_open and send(slot.packet, slot.timeout_ns, topic=slot.device):
                sent += 1
                slot.note()
            else:
                host.not_taken(slot.device, ticket.message)
        host.counts.sent += sent
        host.counts.polls += len(slots)
        host.unanswered.wait_for_polls(slots, now)

    def _carry(self, now: int) -> None:
        """Count the due polls that have to wait for the next tick."""
        host = self.host
        due = [s.due <= now if s.waiting is None else self._is_overdue(s, s.waiting, now) for s in self.slots]
        host.counts.polls_carried += sum(due)
        host.emit("overrun", "", f"{sum(due)} polls did not fit into a tick of {host.period_ns / 1e6:g} ms")

    def _is_overdue(self, slot: PollSlot, ticket: Ticket, now: int) -> bool:
        """Return whether what was asked is to be asked again in this tick, as there is no answer."""
        period = self.host.period_ns
        if ticket.tries > ASKED_AGAIN or not period or ticket.device.is_silent or slot.common:
            return False  # what asks everybody would be answered by all, and those who had answered would seem to be two
        # While answers still come in, this one may be among them: it has a tick more.
        is_quiet = now - self.host.unanswered.received_at > period // QUIET_SHARE
        return now - ticket.sent_at > period * (3 if is_quiet else 6) // 4 * ticket.tries

    def _ask_again(self, ticket: Ticket, now: int) -> None:
        """Repeat a poll that was not answered within its tick; one of both answers may come late."""
        slot: PollSlot | None = ticket.poll
        self._again(ticket, now, ticket.reply if slot is None else slot.replies)
        self.host.transmit(ticket.packet, ticket.device, ticket.message, ticket.timeout_ns)

    def _again(self, ticket: Ticket, now: int, reply: frozenset[str]) -> None:
        ticket.tries += 1
        ticket.reply |= reply
        self.host.counts.repeated += 1
        ticket.device.missed_at = now
        for name in ticket.reply:
            ticket.device.second_answers[name] = ticket.device.second_answers.get(name, 0) + 1

    def ask_all(self) -> None:
        """Ask everything once, now, whatever the budget."""
        now, line = self.host.clock.now(), self.host.line
        for slot in self.slots:
            if slot.waiting is None:
                slot.due = now
                if line is None:
                    self.take(slot, now)
        if line is not None:
            line.pump()

    def refresh(self, device: Device, polls: Collection[Poll]) -> None:
        """Ask a device these in the next tick; without ticks now, unless it was asked already."""
        host = self.host
        now = host.clock.now()
        for slot in list(self.slots):
            if slot.device is device and slot.poll in polls and slot.waiting is None:
                slot.due = now
                if not host.period_ns and host.line is None and host.is_open:
                    self.take(slot, now)
        if host.line is not None:
            host.line.pump()

    def stand_in(self, device: Device, message: str, now: int) -> int:
        """Let sent set-points stand for a poll that has the same answer; return what that costs (ns)."""
        asked = self.stand_ins.get((device.name, message))
        if asked is None or device.is_silent:  # one that is silent is asked besides
            return 0
        slot, reply = asked
        if slot.waiting is None:
            self.take(slot, now, reply)
        else:
            self._again(slot.waiting, now, reply)
        return slot.wire_ns

    def take(self, slot: PollSlot, now: int, reply: frozenset[str] | None = None) -> None:
        """Send a poll whose turn it is; with `reply` another packet, answered by that message, stands for it."""
        host, line = self.host, self.host.line
        if line is not None and not host.period_ns:
            slot.due = NEVER_NS
        elif slot.every_ns:
            slot.due = now + slot.every_ns - host.period_ns // 2
        elif line is not None:
            slot.due = self._tick_end  # once a tick
        else:
            slot.due = now
        slot.asked_at = now
        slot.waiting = ticket = slot.ticket
        ticket.tries, ticket.reply = 0, slot.replies if reply is None else reply
        if slot.has_counter and reply is None:
            self._build(slot)
        host.counts.polls += 1
        if line is not None and reply is None:
            line.poll(slot, ticket, now)
            return
        if reply is not None:
            ticket.tries = 1
        elif not slot.common or self._asked_all.get(slot.packet) != now:
            if slot.common:
                self._asked_all[slot.packet] = now
            ticket.tries = 1
            host.transmit(slot.packet, slot.device, ticket.message, slot.timeout_ns, False, None, slot.note)
        host.unanswered.wait_for(ticket, now)
