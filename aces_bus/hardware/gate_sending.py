"""How a gate sends: what is given waits in its outbox until the bus takes it, on a thread or at the end of a loop's turn.

1. What is given ends in exactly one bin (`outbox`), and is reported once.
2. What is urgent, a stop, goes before all else that waits here, instead of what waits for the same device.
3. While a bus is lost nothing waits for it: an old set-point, sent when it is back, would move a robot. What is urgent
   waits, and is the first to leave.
"""

from __future__ import annotations

import time
from typing import Any, Literal

from ..errors import CallerError
from .gate_base import GateBase, Item
from .queues import AGE_S, Fate, OutboxItem, Report

#: How soon a bus that takes no more for now is tried again (ns).
AGAIN_NS = 1_000_000
#: How old a packet may be when it leaves, by default (ns).
AGE_NS = round(AGE_S * 1e9)
#: Seconds that a thread waits before it looks at other things.
POLL_S = 0.2

#: Where each fate is counted.
_BINS: dict[Fate, str] = {
    "sent": "sent",
    "failed": "send_failed",
    "expired": "send_expired",
    "dropped": "send_dropped",
    "unsent": "unsent",
}

TOO_OLD = "too old, they do not leave late"
STALLED = "the adapter does not take them in time, and they do not leave late"


class SendingGate(GateBase[Item]):
    """A gate's way out."""

    def _check_may_send(self) -> None:
        if self.listen_only:
            raise CallerError(f"{self.name}: this gate only listens; open it without listen_only to send")
        if self._is_closing or self.state in ("new", "closed"):
            raise CallerError(f"{self.name}: this gate is not open")

    @property
    def waiting(self) -> int:
        """Number of items that wait to be sent, in `unit`."""
        return self._outbox.size + len(self._given)

    def _queue(
        self,
        packet: Any,
        size: int,
        priority: int,
        age_s: float | None,
        urgent: bool,
        topic: object,
        report: Report | None,
    ) -> bool:
        """Queue a packet; False when the bus is lost and it is dropped. Raises `CallerError` as `send`."""
        if self._given:
            self._gather()
        until = self.clock.now() + (AGE_NS if age_s is None else round(age_s * 1e9))
        item = OutboxItem(packet, size, until, urgent, topic, report, age_s is not None)
        overtaken: list[OutboxItem[Any]] = []
        with self._guard:
            if self.state != "open" or self.listen_only or self._is_closing:
                self._check_may_send()
            is_taken = urgent or self.state == "open"
            if is_taken:
                if urgent:
                    if topic is not None and self._outbox:
                        overtaken = self._outbox.take(lambda one: one.topic is topic and not one.urgent)
                elif self._outbox.size + size > self.most:
                    raise CallerError(
                        f"{self.name}: {self._outbox.size} {self.unit} wait to be sent; is anybody on the bus?"
                    )
                self._outbox.push(item, priority)
                if self._is_sending_here:
                    if not self._is_flush_planned:
                        self._plan_flush()
                else:
                    self._outgoing.notify_all()
            else:
                self._refused += size
            self.counters.given += size
        if overtaken:
            self._settle_all(overtaken, "dropped", "a stop overtook them")
        if not is_taken:
            self._settle(item, "dropped", "the bus is lost")
        return is_taken

    def _transmit(self) -> None:
        """Send packets: the body of the transmit thread."""
        while True:
            with self._guard:
                while not self._stopping.is_set() and (not self._outbox or self.state != "open"):
                    self._outgoing.wait(1.0)
            while not self._stopping.is_set() and (left := self._leaves_at() - self.clock.now()) > 0:
                self._stopping.wait(left / 1e9)
            if self._stopping.is_set():
                return
            with self._guard:
                if not self._outbox or self.state != "open":
                    continue
                item = self._in_hand = self._outbox.pop()
            late = self.clock.now() - item.until
            try:
                if late > 0 and not item.urgent:
                    self._expire(item)
                    continue
                self._put_out(item.packet)
                self._last_sent = self.clock.now()
                self._settle(item, "sent", "")
            except Exception as error:  # CanError, OSError, and whatever a backend lets through
                why = f"{type(error).__name__}: {error}"
                self._settle(item, "failed", why)
                self._emit("send failed", f"{self._name_of(item.packet)}: {why}")
            finally:
                with self._guard:
                    self._in_hand = None
                    if not self._outbox:
                        self._outgoing.notify_all()

    def _drain(self, seconds: float) -> None:
        """Take nothing more, and wait until all has left."""
        until = time.monotonic() + seconds
        with self._guard:
            self._is_closing = True
        if self._loop is not None:
            try:
                self._loop.call(
                    self._gather
                )  # there nothing can be given meanwhile, and from now on nothing is taken
            except CallerError:  # it has ended
                self._gather()
        with self._guard:
            while self._outbox or self._in_hand is not None:
                left = until - time.monotonic()
                if left <= 0 or (self._transmitter is not None and not self._transmitter.is_alive()):
                    break
                if self._is_sending_here:
                    self._flush()
                    left = min(left, AGAIN_NS / 1e9)
                self._outgoing.wait(min(left, POLL_S))
        while self.state == "open" and time.monotonic() < until:
            if not self._still_held() and self.clock.now() - self._last_sent >= self.linger_ns:
                return
            time.sleep(0.001)

    # ------------------------------------------------------------------ on a loop

    def _plan_flush(self) -> None:
        loop = self._loop
        assert loop is not None
        self._is_flush_planned = True
        if loop.is_own_thread:
            loop.at_turn_end(self._flush)
        else:
            loop.call_soon(self._flush)

    def _flush_in(self, wait: int) -> None:
        assert self._loop is not None
        self._is_flush_planned = True
        self._loop.call_in(wait, self._flush)

    def _flush(self) -> None:
        """Send together what was gathered, as far as the bus takes it now."""
        with self._guard:
            self._is_flush_planned = False
            if self.state != "open":
                return
            now = self.clock.now()
            if (wait := AGAIN_NS if not self._push() else self._leaves_at() - now) > 0:
                self._gather()
                self._flush_in(wait)
                return
            if self._give_out():
                self._last_sent = now
                if not self._push():
                    self._flush_in(AGAIN_NS)
                return
            self._gather()
            old = self._outbox.take_old(now)
            items = self._outbox.first(self.together)
            taken, error = self._put_together([item.packet for item in items])
            gone = self._outbox.drop_first(taken + (error is not None))
            self._last_sent = now
            if self._outbox or not self._push():
                self._flush_in(AGAIN_NS if error is None and taken < len(items) else 0)
            elif self._is_closing:
                self._outgoing.notify_all()
        self._settle_sent(gone[:taken])
        if error is not None:
            why = f"{type(error).__name__}: {error}"
            self._settle(gone[-1], "failed", why)
            self._emit("send failed", f"{self._name_of(gone[-1].packet)}: {why}")
        self._settle_old(old)

    def _gather(self) -> None:
        """Move given packets into the outbox."""
        now = self.clock.now()
        given = self._given
        with self._guard:
            while given:
                packet, age_ns, topic = given.popleft()
                item = OutboxItem(packet, 1, now + (age_ns or AGE_NS), False, topic, None, bool(age_ns))
                self._outbox.push(item, self._priority_of(packet))
                self.counters.given += 1

    def _give_out(self) -> bool:
        """Put what was given on the bus, where nothing waits and the bus takes all of it; whether that was done."""
        given = self._given
        if self._outbox or not 0 < len(given) <= self.together:
            return False
        packets = [packet for packet, _, _ in given]
        packets.sort(key=self._priority_of)
        taken, error = self._put_together(packets)
        if taken < len(packets):
            # What it took has left; the rest waits, and is refused again if it is refused.
            waiting = sorted(given, key=lambda one: self._priority_of(one[0]))
            given.clear()
            given.extend(waiting[taken:])
        else:
            given.clear()
        self.counters.given += taken
        self.counters.sent += taken
        return error is None and not given

    # ------------------------------------------------------------------ what became of it

    def _expire(self, first: OutboxItem[Any]) -> None:
        """Drop a packet that is too old, and all others that are."""
        now = self.clock.now()
        with self._guard:
            others = self._outbox.take_old(now)
        self._settle_old([first, *others])

    def _settle(self, item: OutboxItem[Any], fate: Fate, why: str) -> bool:
        """Count what became of a packet, once, and report it."""
        with self._guard:
            if item.fate is not None:
                return False
            item.fate = fate
            name = _BINS[fate]
            setattr(self.counters, name, getattr(self.counters, name) + item.size)
        if item.report is not None:
            try:
                item.report(fate, why)
            except Exception:  # a fault of one caller's `report` must not stop the gate
                self.events.failures += 1
        return True

    def _settle_sent(self, items: list[OutboxItem[Any]]) -> None:
        """Settle packets that were sent together."""
        reports: list[Report] = []
        with self._guard:
            for item in items:
                item.fate = "sent"
                self.counters.sent += item.size
                if item.report is not None:
                    reports.append(item.report)
        for report in reports:
            try:
                report("sent", "")
            except Exception:  # as above
                self.events.failures += 1

    def _settle_all(
        self,
        items: list[OutboxItem[Any]],
        fate: Fate,
        why: str,
        kind: Literal["not sent", "stalled"] = "not sent",
    ) -> None:
        """Settle several packets with one fate, and report it as one event."""
        count = sum(item.size for item in items if self._settle(item, fate, why))
        if count:
            self._emit(kind, f"{count} {self.unit}: {why}", count)

    def _settle_old(self, old: list[OutboxItem[Any]]) -> None:
        """Settle packets that waited too long: questions with a stated age will be asked again; others are lost."""
        self._settle_all([item for item in old if item.is_timed], "expired", STALLED, "stalled")
        self._settle_all([item for item in old if not item.is_timed], "expired", TOO_OLD)

    def _emit_refused(self) -> None:
        """Report the packets that were given while the bus was lost."""
        with self._guard:
            count, self._refused = self._refused, 0
        if count:
            self._emit("not sent", f"{count} {self.unit} were given while the bus was lost", count)
