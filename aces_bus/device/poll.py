"""Whose turn it is to be asked, and what a host has counted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .config import priority_of
from .declared import Poll
from .device import Device
from .port import Packet
from .station import tags_of
from .ticket import Ticket


@dataclass(slots=True)
class HostCounts:
    """What went over a host's bus; latencies in ns.

    `ticks_missed` were left out, because the one before was not over. `polls_carried` is how often a poll had to wait for
    another tick, `repeated` how often something was asked again, `answered_late` counts answers that came more than a tick
    after their request. `cycle_ns` is the longest time from a tick to the last answer to what was asked in it,
    `latency_ns` that of a single request.
    """

    ticks: int = 0
    sent: int = 0
    set_points: int = 0
    polls: int = 0
    polls_carried: int = 0
    asked: int = 0
    answered: int = 0
    answered_late: int = 0
    missed: int = 0
    repeated: int = 0
    received: int = 0
    not_sent: int = 0
    latency_ns: int = 0
    cycle_ns: int = 0
    cycle_sum_ns: int = 0
    cycles: int = 0
    ticks_missed: int = 0


class PollSlot:
    """One poll of one device, and when it is due."""

    __slots__ = (
        "asked_at",
        "common",
        "cost_ns",
        "device",
        "due",
        "every_ns",
        "has_counter",
        "note",
        "packet",
        "poll",
        "priority",
        "replies",
        "ticket",
        "timeout_ns",
        "waiting",
        "wire_ns",
    )

    def __init__(
        self, device: Device, poll: Poll, packet: Packet, note: Callable[[], None], wire_ns: int
    ) -> None:
        #: How long its packet occupies the bus.
        self.wire_ns = wire_ns
        self.device = device
        self.replies = poll.replies
        #: The ticket of each of its rounds, which follow one another; `waiting` while there is no answer.
        self.ticket = Ticket(
            device.clock, device, poll.message, packet, self.replies, round(poll.timeout_s * 1e9), 0, self
        )
        self.waiting: Ticket | None = None
        self.ask_with(packet, note)
        self.priority = priority_of(device.config)
        #: It asks everybody: when several devices want it in one tick, it is sent once.
        self.common = not tags_of(device, device.variant[poll.message])
        #: Its packet has a rolling counter, and is built anew for each round.
        self.has_counter = bool(device.variant[poll.message].counters)
        self.retime(poll)
        self.timeout_ns = self.ticket.timeout_ns
        self.due = self.asked_at = 0
        #: What it costs on the wire, with its answer; learnt.
        self.cost_ns = 2 * wire_ns

    def ask_with(self, packet: Packet, note: Callable[[], None]) -> None:
        """Ask with this packet; `note` is called when it has left, as replies may hang on it."""
        self.packet = self.ticket.packet = packet
        self.note = note

    def retime(self, poll: Poll) -> None:
        """Have this poll's period."""
        self.poll = poll
        self.every_ns = 0 if poll.every_s is None else round(poll.every_s * 1e9)
