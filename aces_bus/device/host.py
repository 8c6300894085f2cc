"""The host's side of a bus: its devices, what is sent to them, what is polled, and when.

1. All runs on the port's clock: no thread, no lock, no wait. The same clock, packets and calls give the same packets.
2. Each tick sends set-points first, in as few packets as the rules allow; then polls, in turn, as far as the budget goes.
3. A missing answer, a duplicate reply, a malformed frame and an unknown device are reported by name, and stop nothing.

Its parts: `half_duplex.py` lets one device speak at a time where the line needs it, `gathering.py` makes messages of
set-points, `polling.py` decides what is asked when, `unanswered.py` gives answers to requests and finds those that are
missing, `unknown_traffic.py` reports what was received and belongs to no device.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from ..errors import AcesError, CallerError, DeviceError, NoReplyError
from ..protocol import Record, Variant
from ..protocol.record import Unknown as UnknownRecord
from ..runtime.clock import Timer
from ..runtime.loop import Loop
from .carried_port import CarriedPort
from .coalesce import CoalescingRule, OutgoingMessage
from .config import DeviceConfig, Robot
from .declared import Poll
from .device import Device
from .events import DeviceEvent, EventLog, Kind
from .gathering import gathered
from .half_duplex import HalfDuplexLine
from .poll import HostCounts, PollSlot
from .polling import Polling
from .port import Left, Packet, Port
from .silence import SilenceWatch
from .station import BusEndpoint
from .ticket import Steps, Ticket
from .unanswered import Unanswered
from .unknown_traffic import UnknownTraffic

#: The robot of a probe.
PROBED = Robot(name="probed", buses={}, devices={}, joints={}, sensors={})
#: Why a passive host sends nothing.
LISTENS = "this bus is only listened to"
#: What happens to a bus that nothing reaches then, and after which it does again.
OUTAGES = frozenset(("lost", "bus-off"))
OUTAGES_OVER = frozenset(("reopened", "recovered", "error-active", "error-passive"))
#: Answers of a tick are received together as far as they come within this share of it.
GATHERED_SHARE = 10
#: The share of a tick that polls may fill by default.
BUDGET = 0.9


class Host(BusEndpoint[Device]):
    """Devices on one bus. Made by `connect`, or by hand: `Host(port, [hubo.variant()], rate_hz=200)`.

    `rate_hz` None: no ticks; set-points go out as they are given, nothing is polled unless `poll()` says so. `budget` is
    the share of a tick that packets may fill. `rules` replace the drivers' rules, message by message. `passive`: it sends
    nothing, and receives what other programs request and what is replied to them.
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
            raise CallerError(f"{port.name}: a rate of {rate_hz} Hz; give a rate above 0 Hz")
        self.rate_hz, self.budget = rate_hz, budget
        self.rules = dict(rules or {})
        self.events = events if events is not None else EventLog()
        self.counts = HostCounts()
        #: Called in each tick, and when set-points were given without one, before these are gathered.
        self.before_set_points: list[Callable[[int], None]] = []
        #: Called when it has been opened, and when it has been closed.
        self.when_open: list[Callable[[], None]] = []
        self.when_closed: list[Callable[[], None]] = []
        #: Whether it has a rate, and asks; how long a tick is (ns; 0: it has none).
        self.is_ticked = rate_hz is not None and not passive
        self.period_ns = round(1e9 / rate_hz) if rate_hz is not None and not passive else 0
        self.unknown_traffic = UnknownTraffic(
            self.emit, port.link, self.variants, self.members, self.period_ns
        )
        #: Packets that were not understood, by reason; records of unknown devices, by message and credentials.
        self.unknown, self.unknown_devices = self.unknown_traffic.reasons, self.unknown_traffic.devices
        #: Called with each packet that was not understood: by scans, which do not know yet what is there.
        self.unknown_handlers = self.unknown_traffic.handlers
        self._tick_at = 0
        self._loop = self.clock if isinstance(self.clock, Loop) else None
        self._next_tick: Timer | None = None
        self._woken = False
        #: Who speaks on a half-duplex line; None: both sides may speak at once.
        self.line = HalfDuplexLine(self) if port.half_duplex else None
        #: Why nothing reaches its devices: "lost", "bus-off"; "" while the bus is there.
        self.outage = ""
        port.on_event(self._bus_event)
        self.polling, self.unanswered = Polling(self), Unanswered(self, self.unknown_traffic.duplicate)
        self._silences = SilenceWatch(self.clock, self.members, self.emit)
        #: Called with each record of a device, its message's name and the instant: who asked for it gets it.
        self.answered = self.unanswered.answered
        #: Called with each packet that was sent, as replies may hang on it.
        self.note: Callable[[Any], None] = self.scanner.sent
        if isinstance(self.port, CarriedPort):
            self.note = self._note_frames
        if passive and self._is_can:
            feed, note = self._feed, self.note

            def received_by_others(frames: Any) -> list[Any]:
                """Scan frames of other hosts too: an answer may need its request to be understood."""
                note(frames[0])
                return feed(frames)

            self._feed = received_by_others

    # ------------------------------------------------------------------ devices

    def add(self, member: Device) -> Device:
        """Put a device on the bus; its polls begin with the next tick. Raises `CallerError` as `BusEndpoint.add`."""
        super().add(member)
        # One is asked at a time where only the request tells whose an answer is, or where the device takes no more.
        needs_request = self.port.link == "serial" and any(
            name in member.credentials for m in member.variant.messages.values() for name in m.request_fields
        )
        if needs_request or member.one_at_a_time:
            self.line = self.line or HalfDuplexLine(self)
        self.polling.add(member)
        return member

    def postpone(self, device: Device, message: str, duration_s: float) -> None:
        """Poll a device with this message not before so long from now: its answer could be taken for another's."""
        self.polling.postpone(device, message, self.clock.now() + round(duration_s * 1e9))

    def retime(self, device: Device, poll: Poll, other: Poll) -> None:
        """Poll a device with `other` instead of `poll`: the same request at another period."""
        self.polling.retime(device, poll, other)

    def refresh(self, device: Device, polls: Collection[Poll]) -> None:
        """Poll a device with these in the next tick, within its budget; without ticks now, unless it was asked already."""
        if not self.passive:
            self.polling.refresh(device, polls)

    def probe(self, protocol: str, **credentials: int) -> Device:
        """Return a bare device with these credentials, to ask whether anybody is there; `remove` it by its name afterwards.

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
        """Yield steps that ask whether a device has these credentials; return the record that answered, or None."""
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
        self.polling.remove(device)

    def renumber(self, member: Device, **credentials: int) -> None:
        """Give a device other credentials, and its polls too."""
        super().renumber(member, **credentials)
        self.polling.renew(member)
        member.renumbered()

    @property
    def devices(self) -> dict[str, Device]:
        """The devices, by name."""
        return self.members

    @property
    def slots(self) -> deque[PollSlot]:
        """The polls of its devices, in the order of their turns."""
        return self.polling.slots

    @property
    def asks_one_by_one(self) -> bool:
        """True if requests are sent one at a time: on half-duplex lines, and to devices that take one request."""
        return self.line is not None

    # ------------------------------------------------------------------ opening and ticking

    def check_rate(self) -> None:
        """Raise `CallerError` for a rate that its bus cannot carry, or that is too slow for the watchdog of a device."""
        if not self.period_ns:
            return
        tick_s = self.period_ns / 1e9
        cost = min((slot.cost_ns for slot in self.slots), default=0)
        if cost > self.period_ns:
            raise CallerError(
                f"bus {self.name}: {1 / tick_s:g} Hz are too many: one request with its answer takes"
                f" {cost / 1e6:.3g} ms there, so that {1e9 / cost:.0f} Hz are the most; `aces bus budget` says what a tick"
                " takes in all"
            )
        for device in self.members.values():
            every_s = max(tick_s, min((poll.every_s or tick_s for poll in device.all_polls), default=tick_s))
            if device.fed_within_s is not None and every_s >= device.fed_within_s:
                raise CallerError(
                    f"{device.name}: it would be sent something every {every_s:g} s, and stops by itself after"
                    f" {device.fed_within_s:g} s without: choose a rate above {1 / device.fed_within_s:g} Hz, or a longer"
                    " watchdog in the robot's file"
                )

    def open(self, *, is_started: bool = True) -> None:
        """Start receiving and, with a rate, ticking. Each device's `start` is called; nothing of both when it is passive.

        `is_started` False sends nothing by itself: a stop is the first that leaves.
        """
        self.unknown_traffic.opened_at = self.clock.now()
        super().open()
        for begin in self.when_open:
            begin()
        if self.passive or not is_started:  # no period either: nothing ticks
            return
        for device in self.members.values():
            device.start()
        self._silences.begin()
        if self.period_ns:
            self._next_tick = self.clock.call_at(self.clock.now(), self._begin_ticks)

    def _begin_ticks(self) -> None:
        """Run the first tick. Opening other buses may delay it; no tick before it is counted as missed."""
        self._tick_at = self.clock.now()
        if self._loop is not None:
            self._loop.gather(self.period_ns // GATHERED_SHARE)
        self._tick()

    def close(self) -> None:
        """Stop ticking and receiving."""
        if self._next_tick is not None:
            self._next_tick.cancel()
            self._next_tick = None
        self._silences.end()
        super().close()
        for end in self.when_closed:
            end()

    def _tick(self) -> None:
        self.tick()
        now = self.clock.now()
        self._tick_at += self.period_ns
        if self._tick_at <= now:  # late by whole ticks: they are left out
            passed = (now - self._tick_at) // self.period_ns + 1
            self._tick_at += passed * self.period_ns
            self.counts.ticks_missed += passed
            self.emit(
                "overrun", "", f"ticks left out, for the one before or this machine took too long: {passed}"
            )
        self._next_tick = self.clock.call_at(self._tick_at, self._tick)

    def wake(self) -> None:
        """Send new set-points now, on a bus without a rate."""
        if not self.period_ns and self._is_open and not self._woken:
            self._woken = True
            self.clock.call_soon(self._woke)

    def _woke(self) -> None:
        self._woken = False
        self._send_set_points(self.clock.now())

    def _note_frames(self, packet: Packet) -> None:
        """Note a packet of ours, which may be several frames, as sent."""
        for frame in packet if isinstance(packet, tuple) else (packet,):
            self.scanner.sent(frame)

    def _is_carried_to_us(self, key: int, data: bytes) -> bool:
        return not self.passive and super()._is_carried_to_us(key, data)

    def tick(self) -> None:
        """Run one round: set-points, then polls within the budget."""
        if self.passive:
            return
        now = self.clock.now()
        self.counts.ticks += 1
        self.polling.begin_tick(now)
        used = self._send_set_points(now)
        if self.line is not None:
            self.line.pump()
        else:
            self.polling.ask_due(now, used)

    def poll(self) -> None:
        """Ask everything once, now, whatever the budget: for hosts without a rate."""
        if not self.passive:
            self.polling.ask_all()

    def send_set_points(self) -> None:
        """Send what is wanted now, and not with the next tick: at an end."""
        if not self.passive and self._is_open:
            self._send_set_points(self.clock.now())

    def _send_set_points(self, now: int) -> int:
        """Send what is wanted; how long it occupies the bus (ns). On a line it has to wait for its turn."""
        for step in self.before_set_points:
            step(now)
        if self.line is not None:
            self.line.put_set_points()
            return 0
        used = 0
        for out in self.set_points(now):
            used += self._send_set_point(out, now)
        return used

    def set_points(self, now: int) -> Iterator[OutgoingMessage]:
        """Gather the set-points that are not sent yet, in as few messages as the rules make of it."""
        return gathered(self.members.values(), self.rule_of, now)

    def rule_of(self, message: str, device: Device) -> CoalescingRule | None:
        """Return the rule that makes few messages of a device's set-points; None: it has a message of its own."""
        return self.rules.get(message) or device.rules.get(message)

    def packet_of(self, out: OutgoingMessage) -> Any:
        """Return the packet of set-points that are about to be sent; None where it cannot be made, which is reported."""
        device: Device = out.device
        try:
            packet = self.packet(device, out.message, out.fields)
        except AcesError as error:  # the others go out
            self.emit("not sent", device.name, str(error))
            return None
        self.counts.set_points += 1
        device.is_driven = not self.passive
        for carried in out.carries:
            carried.device.is_driven = not self.passive
        return packet

    def _send_set_point(self, out: OutgoingMessage, now: int) -> int:
        """Send set-points; how long they occupy the bus (ns)."""
        packet = self.packet_of(out)
        if packet is None:
            return 0
        device, message = out.device, out.message
        used = self.port.wire_ns(packet)
        if self.transmit(packet, device, message) and self.polling.stand_ins:
            used += self.polling.stand_in(device, message, now)
        return used

    # ------------------------------------------------------------------ asking

    def ask(self, ticket: Ticket) -> Ticket:
        """Send a ticket's packet, again when it is not answered; on a half-duplex line as soon as that is free."""
        if self.passive:
            ticket.fail(
                DeviceError(f"{self.name} {ticket.device.name}: {ticket.message} was not sent: {LISTENS}")
            )
            return ticket
        self.counts.asked += bool(ticket.reply)
        line = self.line
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
        """Send a ticket's packet, now; it is over when that has left, or is answered."""
        ticket.tries += 1
        ticket.sent_at = now
        if self._loop is not None:
            self._loop.hurry(now + ticket.timeout_ns)
        if ticket.reply:
            # What is not answered in time is asked again: it must not leave later than that.
            self.transmit(
                ticket.packet, ticket.device, ticket.message, ticket.timeout_ns, urgent=ticket.urgent
            )
            self.unanswered.wait_for(ticket, now)
            return

        def left(fate: str, why: str) -> None:
            if fate == "sent":
                ticket.finish()
            else:
                ticket.fail(
                    DeviceError(f"{self.name} {ticket.device.name}: {ticket.message} was not sent: {why}")
                )

        if not self.transmit(
            ticket.packet, ticket.device, ticket.message, 0, urgent=ticket.urgent, report=left
        ):
            left("dropped", "the bus does not take it")

    def transmit(
        self,
        packet: Any,
        device: Device,
        message: str,
        age_ns: int = 0,
        urgent: bool = False,
        report: Left | None = None,
        note: Callable[[], None] | None = None,
    ) -> bool:
        """Put a frame or packet on the bus; one that it does not take is reported."""
        if self.passive:
            self.counts.not_sent += 1
            self.emit("not sent", device.name, f"{message}: {LISTENS}")
            return False
        is_reported = report is None and isinstance(packet, tuple) and len(packet) > 1
        if is_reported:  # whether it left whole is known later, and the caller does not ask
            report = partial(self._ended, device, message)
        if not self._is_open or not self.port.send(
            packet, age_ns, urgent=urgent, topic=device, report=report
        ):
            if is_reported and self._is_open:
                self.counts.not_sent += 1
            else:
                self.not_taken(device, message)
            return False
        self.counts.sent += 1
        if note is None:
            self.note(packet)
        else:
            note()
        return True

    def _ended(self, device: Device, message: str, fate: str, why: str) -> None:
        """Report a packet of several frames that was not sent."""
        if fate != "sent":
            self.emit("not sent", device.name, f"{message}: {why}")

    def not_taken(self, device: Device, message: str) -> None:
        """Count and report a packet of a device that the bus does not take."""
        self.counts.not_sent += 1
        self.emit("not sent", device.name, f"{message}: the bus does not take it")

    def prolong(self, device: Device, duration_s: float) -> None:
        """Extend the deadlines of a device's requests to `duration_s` from now, as it has asked for."""
        self.unanswered.prolong(device, self.clock.now() + round(duration_s * 1e9))

    # ------------------------------------------------------------------ what is wrong

    def _not_understood(self, unknown: UnknownRecord, instant: int) -> None:
        self.unknown_traffic.not_understood(unknown, instant, self.line)

    def _unaddressed(self, record: Record, instant: int) -> None:
        self.unknown_traffic.unaddressed(record)

    def _bus_event(self, kind: Any, detail: str) -> None:
        """Handle an event of the bus itself."""
        if kind in OUTAGES:
            self.outage = kind
        elif kind in OUTAGES_OVER:
            self.outage = ""
        self.emit(kind, "", detail)

    def emit(self, kind: Kind, device: str, detail: str = "") -> None:
        """Report what has happened; see `EventLog.emit` for how often."""
        self.events.emit(DeviceEvent(kind, self.clock.now(), self.name, device, detail))
