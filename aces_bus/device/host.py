"""The host's side of a bus: its devices, what is sent to them, what is polled, and when.

1. All runs on the port's clock: no thread, no lock, no wait. The same clock, words and calls give the same words.
2. Each tick sends set-points first, as few words as the rules make of them; then polls, in turn, as far as the budget goes.
   What did not fit is first in the next tick.
3. A missing answer, a duplicate reply, a malformed frame and an unknown device are reported by name, and stop nothing.

On a half-duplex line one speaks at a time (`half_duplex.py`); what comes and is none of its devices' is `strangers.py`'s.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from ..errors import AcesError, CallerError, DeviceError, FieldError, NoReplyError, UnknownNameError
from ..protocol import CanScanner, Variant
from ..protocol import Unknown as UnknownWord
from ..runtime import Timer
from .carried_port import CarriedPort
from .coalesce import CoalescingRule, OutgoingMessage, Setpoint, per_device
from .config import DeviceConfig, Robot
from .declared import Poll
from .device import Device
from .events import DeviceEvent, EventLog, Kind
from .half_duplex import NEVER_NS, HalfDuplexLine, ask_less
from .poll import HostCounts, PollSlot
from .port import Left, Port
from .station import BusEndpoint, shown
from .strangers import Strangers
from .ticket import Steps, Ticket

#: An answer this soon (ns) after another to the same request is a second device's.
DUPLICATE_REPLY_NS = 20_000_000
#: An answer that is later than this (ns) does not come any more.
LATE_REPLY_NS = 500_000_000
#: When this machine itself was held up for so long (ns), what has come meanwhile is heard before anybody is missed.
HELD_UP_NS, LISTEN_NS = 5_000_000, 10_000_000
#: The robot of a probe.
PROBED = Robot(name="probed", buses={}, devices={}, joints={}, sensors={})
#: A poll without an answer by the next tick, or the one after while others still come, is sent again, so often at most.
ASKED_AGAIN = 2
#: A bus on which nothing came for this part of a tick has nothing under way.
QUIET_SHARE = 5
#: Why a passive host sends nothing.
LISTENS = "this bus is only listened to"
#: The share of a tick that polls may fill by default.
BUDGET = 0.9


def _nothing() -> None:
    """There is nothing to note."""


class Host(BusEndpoint[Device]):
    """Devices on one bus. Made by `connect`, or by hand: `Host(port, [hubo.variant()], rate_hz=200)`.

    `rate_hz` None: no ticks; set-points go out as they are given, nothing is polled unless `poll()` says so. `budget` is
    the share of a tick that words may fill. `rules` replace the drivers' rules, message by message. `passive`: it listens to
    what other programs ask and are answered, and sends nothing.
    """

    def __init__(
        self,
        port: Port,
        variants: Sequence[Variant],
        *,
        rate_hz: float | None = None,
        budget: float = BUDGET,
        rules: Mapping[str, CoalescingRule] | None = None,
        events: EventLog | None = None,
        name: str = "",
        passive: bool = False,
    ) -> None:
        super().__init__(port, variants, direction="from device", name=name)
        self.passive = passive
        if rate_hz is not None and rate_hz <= 0:
            raise CallerError(f"{port.name}: a rate of {rate_hz} Hz is none")
        self.rate_hz, self.budget = rate_hz, budget
        self.rules = dict(rules or {})
        self.events = events if events is not None else EventLog()
        self.counts = HostCounts()
        self._strangers = Strangers(self)
        #: Words that were not understood, by reason; records of unknown devices, by message and credentials.
        self.unknown, self.unknown_devices = self._strangers.words, self._strangers.devices
        #: Who is shown the words that were not understood: scans, which do not know yet what is there.
        self.unknown_handlers = self._strangers.handlers
        self.slots: deque[PollSlot] = deque()
        #: By device and message of set-points: the poll that it stands for, and what answers it.
        self._asked_by: dict[tuple[str, str], tuple[PollSlot, frozenset[str]]] = {}
        #: Whether some devices are asked before others in each tick.
        self._has_priorities = False
        #: Called in each tick, and when set-points were given without one, before these are gathered.
        self.before_set_points: list[Callable[[int], None]] = []
        #: Requests to everybody, and when each was last sent.
        self._asked_all: dict[Any, int] = {}
        self._deadlines: list[tuple[int, int, Ticket]] = []
        self._deadline_timer: Timer | None = None
        self._is_hearing = False
        self._serial_number = 0
        #: Whether it has a rate, and asks.
        self.is_ticked = rate_hz is not None and not passive
        self._period = round(1e9 / rate_hz) if rate_hz is not None and not passive else 0
        self._tick_at = 0
        #: When something was last received.
        self._heard_at = 0
        #: When this tick is over, and after what instant no poll may end.
        self._tick_end, self._polls_end = 0, NEVER_NS
        self._next_tick: Timer | None = None
        self._woken = False
        #: Who speaks on a half-duplex line; None: both sides may speak at once.
        self._line = HalfDuplexLine(self) if port.half_duplex else None
        port.on_event(self._bus_event)
        self._note: Callable[[Any], None] = self.scanner.sent
        if isinstance(self.port, CarriedPort):
            self._note = self._note_frames
        if passive and self._is_can:
            feed, note = self._feed, self._note

            def overheard(words: Any) -> list[Any]:
                """Where others ask, an answer may need what they asked to be understood."""
                note(words[0])
                return feed(words)

            self._feed = overheard

    # ------------------------------------------------------------------ devices

    def add(self, member: Device) -> Device:
        """Put a device on the bus; its polls begin with the next tick. Raises `CallerError` as `BusEndpoint.add`."""
        super().add(member)
        # One is asked at a time where only the request tells whose an answer is, or where the device takes no more.
        needs_request = self.port.link == "serial" and any(
            name in member.credentials for m in member.variant.messages.values() for name in m.request_fields
        )
        if needs_request or member.one_at_a_time:
            self._line = self._line or HalfDuplexLine(self)
        for poll in member.polls:
            for name in poll.replies:
                if name not in member.variant.protocol.messages:
                    raise UnknownNameError(
                        f"message of {member.variant.name}, awaited by {member.name},",
                        name,
                        member.variant.protocol.messages,
                    )
            try:
                word = self.word(member, poll.message, poll.fields)
            except FieldError as error:
                raise CallerError(
                    f"{self.name} {member.name}: it cannot be asked: {error}; its credentials are:"
                    f" {shown(member.credentials) or 'none'}"
                ) from error
            slot = PollSlot(member, poll, word, self.port.wire_ns(word))
            slot.reword(word, self._noting(word))
            if slot.every_ns:  # slow polls begin spread over their period, or all would meet in one tick
                slot.due = self.clock.now() + round(slot.every_ns * (0.618 * len(self.slots) % 1))
            if self._line is not None and not self._period:
                slot.due = NEVER_NS  # asked on request: `poll` or `tick`
            self.slots.append(slot)
            for name, reply in poll.asked_by.items():
                self._asked_by[member.name, name] = slot, frozenset((reply,))
        self._has_priorities = len({slot.priority for slot in self.slots}) > 1
        return member

    def _noting(self, word: Any) -> Callable[[], None] | None:
        """What is called instead of giving a word that was sent to the scanner."""
        if not isinstance(self.scanner, CanScanner) or isinstance(
            word, tuple
        ):  # several frames: each by itself
            return None
        if isinstance(word, tuple):  # the frames of a packet
            return partial(self._note_frames, word)
        return self.scanner.noting(word) or _nothing

    def postpone(self, device: Device, message: str, duration_s: float) -> None:
        """Poll a device with this message not before so long from now: its answer could be taken for another's."""
        until = self.clock.now() + round(duration_s * 1e9)
        for slot in self.slots:
            if slot.device is device and slot.poll.message == message and slot.due < until:
                slot.due = until

    def retime(self, device: Device, poll: Poll, other: Poll) -> None:
        """Poll a device with `other` instead of `poll`: the same request at another period."""
        for slot in self.slots:
            if slot.device is device and slot.poll is poll:
                slot.retime(other)

    def refresh(self, device: Device, polls: Collection[Poll]) -> None:
        """Poll a device with these in the next tick, within its budget; without ticks now, unless it was asked already."""
        if self.passive:
            return
        now = self.clock.now()
        for slot in list(self.slots):
            if slot.device is device and slot.poll in polls and slot.waiting is None:
                slot.due = now
                if not self._period and self._line is None and self._is_open:
                    self.take_slot(slot, now)
        if self._line is not None:
            self._line.pump()

    def probe(self, protocol: str, **credentials: int) -> Device:
        """A bare device with these credentials, to ask whether anybody is there; `remove` it by its name afterwards.

        Its polls and signals are none: `ask` is all that it is for. Raises `CallerError` when nothing here speaks the
        protocol.
        """
        number = 0
        while f"probe {number}" in self.members:
            number += 1
        config = DeviceConfig(
            name=f"probe {number}", driver="probe", bus=self.name, credentials=credentials, protocol=protocol
        )
        if protocol not in self.variants:
            raise CallerError(
                f"{self.name}: nothing here speaks {protocol} (the bus has {', '.join(self.variants)})"
            )
        made = Device(self, config, PROBED, self.variants[protocol])
        BusEndpoint.add(self, made)
        return made

    def answers(
        self,
        protocol: str,
        credentials: Mapping[str, int],
        message: str,
        *,
        reply: str | tuple[str, ...],
        timeout_s: float,
        retries: int = 1,
        **fields: Any,
    ) -> Steps:
        """Steps that ask whether anybody with these credentials is there: the record that answered, or None."""
        probe = self.probe(protocol, **credentials)
        try:
            return (yield probe.ask(message, reply=reply, timeout_s=timeout_s, retries=retries, **fields))
        except NoReplyError:
            return None
        finally:
            self.remove(probe.name)

    def remove(self, name: str) -> None:
        """Take a device off; what was asked of it is forgotten."""
        device = self.members.get(name)
        super().remove(name)
        self.slots = deque(slot for slot in self.slots if slot.device is not device)
        self._asked_by = {key: one for key, one in self._asked_by.items() if one[0].device is not device}

    def renumber(self, member: Device, **credentials: int) -> None:
        """A device has other credentials from now on: its polls ask for them."""
        super().renumber(member, **credentials)
        for slot in self.slots:
            if slot.device is member:
                word = self.word(member, slot.poll.message, slot.poll.fields)
                slot.reword(word, self._noting(word))
        member.renumbered()

    @property
    def devices(self) -> dict[str, Device]:
        """The devices, by name."""
        return self.members

    @property
    def asks_one_by_one(self) -> bool:
        """Whether it asks for one thing at a time: on half-duplex lines, and of devices that take one request."""
        return self._line is not None

    # ------------------------------------------------------------------ opening and ticking

    def open(self) -> None:
        """Start receiving and, with a rate, ticking. Each device's `start` is called; nothing of both when it is passive."""
        super().open()
        if self.passive:  # no period either: nothing ticks
            return
        for device in self.members.values():
            device.start()
        if self._period:
            self._tick_at = self.clock.now()
            self._next_tick = self.clock.call_at(self._tick_at, self._tick)

    def close(self) -> None:
        """Stop ticking and receiving."""
        if self._next_tick is not None:
            self._next_tick.cancel()
            self._next_tick = None
        super().close()

    def _tick(self) -> None:
        self.tick()
        now = self.clock.now()
        self._tick_at += self._period
        if self._tick_at <= now:  # late by whole ticks: they are left out
            passed = (now - self._tick_at) // self._period + 1
            self._tick_at += passed * self._period
            self.counts.ticks_missed += passed
            self.tell(
                "overrun", "", f"ticks left out, for the one before or this machine took too long: {passed}"
            )
        self._next_tick = self.clock.call_at(self._tick_at, self._tick)

    def wake(self) -> None:
        """Set-points were given: without a rate they go out now."""
        if not self._period and self._is_open and not self._woken:
            self._woken = True
            self.clock.call_soon(self._woke)

    def _woke(self) -> None:
        self._woken = False
        self._send_set_points(self.clock.now())

    def _note_frames(self, word: Any) -> None:
        """A word of ours that may be several frames."""
        for frame in word if isinstance(word, tuple) else (word,):
            self.scanner.sent(frame)

    def _is_carried_to_us(self, key: int, data: bytes) -> bool:
        return not self.passive and super()._is_carried_to_us(key, data)

    def tick(self) -> None:
        """One round: set-points, then polls within the budget."""
        if self.passive:
            return
        now = self.clock.now()
        counts = self.counts
        counts.ticks += 1
        self._tick_end = now + self._period
        self._polls_end = now + round(self._period * self.budget) if self._period else NEVER_NS
        line = self._line
        if line is not None:
            line.begin_tick(self._polls_end)
        if self._has_priorities:
            self.slots = deque(sorted(self.slots, key=lambda slot: -slot.priority))
        if line is not None and not self._period:
            for slot in self.slots:
                if not slot.every_ns or now - slot.asked_at >= slot.every_ns:
                    slot.due = now
        used = self._send_set_points(now)
        if line is not None:
            line.pump()
            return
        most = self._polls_end - now
        slots = self.slots
        for _ in range(len(slots)):
            slot = slots[0]
            if self._is_due(slot, now):
                if used + slot.cost_ns > most or self.clock.now() > self._polls_end:
                    carried = sum(1 for one in slots if self._is_due(one, now))
                    counts.polls_carried += carried
                    self.tell(
                        "overrun", "", f"{carried} polls did not fit into a tick of {self._period / 1e6:g} ms"
                    )
                    break
                used += slot.cost_ns
                if slot.waiting is None:
                    self.take_slot(slot, now)
                else:
                    self._ask_again(slot.waiting, now)
            slots.rotate(-1)

    def _is_due(self, slot: PollSlot, now: int) -> bool:
        """Whether a slot is to be asked in this tick, or again as its answer is overdue."""
        ticket = slot.waiting
        if ticket is None:
            return slot.due <= now
        if ticket.tries > ASKED_AGAIN or not self._period or ticket.device.is_silent or slot.common:
            return False  # what asks everybody would be answered by all, and those who had answered would seem to be two
        # While answers still come in, this one may be among them: it has a tick more.
        is_quiet = now - self._heard_at > self._period // QUIET_SHARE
        return now - ticket.sent_at > self._period * (3 if is_quiet else 6) // 4 * ticket.tries

    def _ask_again(self, ticket: Ticket, now: int) -> None:
        """A poll was not answered within its tick: it is sent once more, and one answer of both may come late."""
        slot: PollSlot | None = ticket.poll
        self._again(ticket, now, ticket.reply if slot is None else slot.replies)
        self.transmit(ticket.word, ticket.device, ticket.message, ticket.timeout_ns)

    def _again(self, ticket: Ticket, now: int, reply: frozenset[str]) -> None:
        ticket.tries += 1
        ticket.reply |= reply
        self.counts.repeated += 1
        ticket.device.missed_at = now
        for name in ticket.reply:
            ticket.device.second_answers[name] = ticket.device.second_answers.get(name, 0) + 1

    def poll(self) -> None:
        """Ask everything once, now, whatever the budget: for hosts without a rate."""
        if self.passive:
            return
        now = self.clock.now()
        for slot in self.slots:
            if slot.waiting is None:
                slot.due = now
                if self._line is None:
                    self.take_slot(slot, now)
        if self._line is not None:
            self._line.pump()

    def take_slot(self, slot: PollSlot, now: int, reply: frozenset[str] | None = None) -> None:
        """It is a poll's turn; with `reply` something was sent that is answered so, and stands for it."""
        line = self._line
        if line is not None and not self._period:
            slot.due = NEVER_NS
        elif slot.every_ns:
            slot.due = now + slot.every_ns - self._period // 2
        elif line is not None:
            slot.due = self._tick_end  # once a tick
        else:
            slot.due = now
        slot.asked_at = now
        awaited = slot.replies if reply is None else reply
        ticket = Ticket(
            self.clock, slot.device, slot.poll.message, slot.word, awaited, slot.timeout_ns, 0, slot
        )
        slot.waiting = ticket
        self.counts.polls += 1
        if reply is not None:
            ticket.tries = 1
            self.await_answer(ticket, now)
            return
        if line is not None:
            line.poll(slot, ticket, now)
            return
        if not slot.common or self._asked_all.get(slot.word) != now:
            if slot.common:
                self._asked_all[slot.word] = now
            ticket.tries = 1
            self.transmit(slot.word, slot.device, ticket.message, slot.timeout_ns, note=slot.note)
        self.await_answer(ticket, now)

    def _send_set_points(self, now: int) -> int:
        """Send what is wanted; how long it occupies the bus (ns). On a line it has to wait for its turn."""
        for step in self.before_set_points:
            step(now)
        if self._line is not None:
            self._line.put_set_points()
            return 0
        return sum([self._send_set_point(out, now) for out in self.set_points(now)])

    def set_points(self, now: int) -> Iterator[OutgoingMessage]:
        """What is wanted and not sent yet, as few messages as the rules make of it."""
        #: By message: its rule (None: a message a device), who has set-points of it, and those that go through a rule.
        wanted: dict[str, tuple[CoalescingRule | None, list[Device], list[Setpoint]]] = {}
        for device in self.members.values():
            if type(device).wants is not Device.wants:
                for want in device.wants(now):
                    self._group(wanted, want.message, device)[2].append(want)
                continue
            for message in device.due_messages(now):
                rule, devices, wants = self._group(wanted, message, device)
                if rule is None:
                    devices.append(device)
                else:
                    wants += device.setpoints_of(message)
        for message, (rule, devices, wants) in wanted.items():
            for device in devices:
                fields = device.gathered(message, ())
                if fields is not None:
                    yield OutgoingMessage(device, message, fields)
            if wants:
                yield from (rule or per_device)(wants)

    def rule_of(self, message: str, device: Device) -> CoalescingRule | None:
        """The rule that makes few messages of a device's set-points; None: it has a message of its own."""
        return self.rules.get(message) or device.rules.get(message)

    def _group(
        self,
        wanted: dict[str, tuple[CoalescingRule | None, list[Device], list[Setpoint]]],
        message: str,
        device: Device,
    ) -> tuple[CoalescingRule | None, list[Device], list[Setpoint]]:
        found = wanted.get(message)
        if found is None:
            rule = self.rule_of(message, device)
            found = wanted[message] = (None if rule is per_device else rule, [], [])
        return found

    def word_of(self, out: OutgoingMessage) -> Any:
        """The word of set-points that are about to be sent; None where a value does not fit, which is reported."""
        device: Device = out.device
        try:
            word = self.word(device, out.message, out.fields)
        except AcesError as error:  # the others go out
            self.tell("limited", device.name, str(error))
            return None
        self.counts.set_points += 1
        device.is_driven = not self.passive
        for one in out.carries:
            one.device.is_driven = not self.passive
        return word

    def _send_set_point(self, out: OutgoingMessage, now: int) -> int:
        """Send set-points; how long they occupy the bus (ns)."""
        word = self.word_of(out)
        if word is None:
            return 0
        device, message = out.device, out.message
        used = self.port.wire_ns(word)
        is_sent = self.transmit(word, device, message)
        asked = self._asked_by.get((device.name, message)) if is_sent else None
        if asked is not None and not device.is_silent:  # one that is silent is asked besides
            slot, reply = asked
            used += slot.wire_ns
            if slot.waiting is None:
                self.take_slot(slot, now, reply)
            else:
                self._again(slot.waiting, now, reply)
        return used

    # ------------------------------------------------------------------ asking

    def ask(self, ticket: Ticket) -> Ticket:
        """Send a ticket's word, again when it is not answered; on a half-duplex line as soon as that is free."""
        if self.passive:
            ticket.fail(
                DeviceError(f"{self.name} {ticket.device.name}: {ticket.message} was not sent: {LISTENS}")
            )
            return ticket
        self.counts.asked += bool(ticket.reply)
        line = self._line
        if line is None:
            self.send(ticket, self.clock.now())
            return ticket
        if ticket.urgent:
            line.overtake(ticket)
        else:
            line.put(ticket)
        line.pump()
        return ticket

    def send(self, ticket: Ticket, now: int) -> None:
        """Send a ticket's word, now; it is over when that has left, or is answered."""
        ticket.tries += 1
        ticket.sent_at = now
        if ticket.reply:
            # What is not answered in time is asked again: it must not leave later than that.
            self.transmit(ticket.word, ticket.device, ticket.message, ticket.timeout_ns, urgent=ticket.urgent)
            self.await_answer(ticket, now)
            return

        def left(fate: str, why: str) -> None:
            if fate == "sent":
                ticket.finish()
            else:
                ticket.fail(
                    DeviceError(f"{self.name} {ticket.device.name}: {ticket.message} was not sent: {why}")
                )

        if not self.transmit(
            ticket.word, ticket.device, ticket.message, 0, urgent=ticket.urgent, report=left
        ):
            left("dropped", "the bus does not take it")

    def transmit(
        self,
        word: Any,
        device: Device,
        message: str,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        report: Left | None = None,
        note: Callable[[], None] | None = None,
    ) -> bool:
        """Put a frame or packet on the bus; one that it does not take is reported."""
        if self.passive:
            self.counts.not_sent += 1
            self.tell("not sent", device.name, f"{message}: {LISTENS}")
            return False
        if not self._is_open or not self.port.send(word, age_ns, urgent=urgent, topic=device, report=report):
            self.counts.not_sent += 1
            self.tell("not sent", device.name, f"{message}: the bus does not take it")
            return False
        self.counts.sent += 1
        if note is None:
            self._note(word)
        else:
            note()
        return True

    def await_answer(self, ticket: Ticket, now: int, more_ns: int = 0) -> None:
        """A ticket's word is on its way: wait for the answer until its time is up, and for those before it."""
        ticket.sent_at = now
        slot: PollSlot | None = ticket.poll
        wire_ns = self.port.wire_ns(ticket.word) if slot is None else slot.wire_ns
        ticket.deadline = now + ticket.timeout_ns + wire_ns + more_ns
        ticket.device.awaiting.append(ticket)
        self._watch(ticket)

    def prolong(self, device: Device, duration_s: float) -> None:
        """A device asks for patience: what was asked of it may be answered for so long from now."""
        until = self.clock.now() + round(duration_s * 1e9)
        for ticket in device.awaiting:
            if ticket.deadline < until:
                ticket.deadline = until
                self._watch(ticket)

    def _watch(self, ticket: Ticket) -> None:
        """See to it that a ticket's deadline is looked at."""
        self._serial_number += 1
        heapq.heappush(self._deadlines, (ticket.deadline, self._serial_number, ticket))
        timer = self._deadline_timer
        if timer is None or timer.action is None or timer.instant > ticket.deadline:
            if timer is not None:
                timer.cancel()
            self._deadline_timer = self.clock.call_at(ticket.deadline, self._expire)

    def _expire(self) -> None:
        """Look for tickets whose time is up."""
        now = self.clock.now()
        timer = self._deadline_timer
        if timer is not None and now - timer.instant > HELD_UP_NS and not self._is_hearing:
            self._is_hearing = True  # never in virtual time: it is not held up
            self._deadline_timer = self.clock.call_in(LISTEN_NS, self._expire)
            return
        self._is_hearing = False
        deadlines = self._deadlines
        while deadlines and (
            deadlines[0][0] <= now or deadlines[0][2] not in deadlines[0][2].device.awaiting
        ):
            _, _, ticket = heapq.heappop(deadlines)
            device: Device = ticket.device
            if ticket.deadline <= now and ticket in device.awaiting:
                device.awaiting.remove(ticket)
                self._missed(ticket, now)
        self._deadline_timer = self.clock.call_at(deadlines[0][0], self._expire) if deadlines else None

    def _missed(self, ticket: Ticket, now: int) -> None:
        device: Device = ticket.device
        self.counts.missed += 1
        for name in ticket.reply:
            device.timed_out[name] = device.timed_out.get(name, 0) + 1
        device.missed_at = now
        self.fell_silent()
        if ticket.tries <= ticket.retries:
            self.counts.repeated += 1
            if self._line is not None:
                self._line.again(ticket)
            else:
                self.send(ticket, now)
            return
        if ticket.poll is not None:
            ticket.poll.waiting = None
        if device.misses == 0 or (
            device.last_heard is not None and device.last_heard >= device.missing_since
        ):
            device.misses, device.missing_since = 0, ticket.sent_at
        device.misses += 1
        # Polls of one tick miss together: that is one miss in a row, however many they are.
        is_long = now - device.missing_since > device.silent_after * ticket.timeout_ns // 2
        if device.misses >= device.silent_after and is_long and not device.is_silent:
            device.is_silent = True
            age = (
                "never heard"
                if device.last_heard is None
                else f"last heard {(now - device.last_heard) / 1e9:.3f} s ago"
            )
            self.tell("silent", device.name, f"{device.misses} requests without an answer, {age}")
        if self._line is not None and device.is_silent and ticket.poll is not None:
            ask_less(self.slots, ticket, now)
        if ticket.poll is None:
            tries = f"{ticket.tries} tries" if ticket.tries > 1 else "one try"
            error = NoReplyError(
                f"{self.name} {device.name}: no answer to {ticket.message} within {ticket.timeout_ns / 1e6:g} ms ({tries});"
                " is it powered, on this bus, and of this number?"
            )
            self.tell("no reply", device.name, f"{ticket.message}, {tries}")
            ticket.fail(error)
            device.no_reply(ticket)
        else:
            device.no_reply(ticket)
        if self._line is not None:
            self._line.free(ticket)

    def answered(self, device: Device, name: str, record: Any, instant: int) -> None:
        """A record of a device: the oldest request that it answers is done. Called by `Device.receive`."""
        self.counts.received += 1
        self._heard_at = instant
        if device.is_silent:
            device.is_silent = False
            self.tell("answers", device.name)
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
        ticket.answered_at = instant
        counts = self.counts
        counts.answered += 1
        latency = instant - ticket.sent_at
        if latency > counts.latency_ns:
            counts.latency_ns = latency
        if latency > self._period and self._period:
            counts.answered_late += 1
        slot: PollSlot | None = ticket.poll
        if slot is not None:
            slot.waiting = None
            self._learn(slot, record, instant)
        if self._line is not None:
            self._line.free(ticket)
        ticket.finish(record)

    def _learn(self, slot: PollSlot, record: Any, instant: int) -> None:
        """What a poll costs with its answer, and how long the round takes."""
        counts = self.counts
        cycle = instant - slot.asked_at
        if cycle > counts.cycle_ns:
            counts.cycle_ns = cycle
        counts.cycle_sum_ns += cycle
        counts.cycles += 1
        if self._line is not None:
            slot.cost_ns = cycle

    def _unasked(self, device: Device, name: str, instant: int) -> None:
        """A record that no request waits for: of a device that speaks by itself, late, or of a second one."""
        before = device.answered.get(name)
        late = device.timed_out.get(name, 0)
        expected = device.second_answers.get(name, 0)
        if late:
            device.timed_out[name] = late - 1
            self.tell("late reply", device.name, name)
        elif expected:  # this one was asked for, too: on a full bus the first was only slow
            device.second_answers[name] = expected - 1
        elif before is not None and instant - before < DUPLICATE_REPLY_NS:
            self._strangers.duplicate(device, f"{name} came twice", instant)

    # ------------------------------------------------------------------ what is wrong

    def _not_understood(self, word: UnknownWord, instant: int) -> None:
        self._strangers.not_understood(word, instant, self._line)

    def _unaddressed(self, record: Any, instant: int) -> None:
        self._strangers.unaddressed(record)

    def _bus_event(self, kind: Any, detail: str) -> None:
        """Something happened to the bus itself."""
        self.tell(kind, "", detail)

    def tell(self, kind: Kind, device: str, detail: str = "") -> None:
        """Report what has happened; see `EventLog.tell` for how often."""
        self.events.tell(DeviceEvent(kind, self.clock.now(), self.name, device, detail))
