"""A device that is a table of registers: reading and writing them by name, through the protocol's `RegisterMap`.

1. An answer is read as what was asked: registers come from the request that has the line, never from an answer's size
   alone. An answer of another size is a late one, and gives no value.
2. What survives power-off is written only when the caller says `confirm=True`; what only can be read, never.
3. Set-points of all devices go out together: one packet a register (`together_rule`), cut where a receiver's buffer ends.

What was written is remembered. When a later reading differs, the device has lost it: it has rebooted (`changed`).

A driver names its `registers`, the message that answers (`reply`) and that message's field with the bytes (`payload`):

    class Servo(RegisterDevice):
        protocol, registers, reply, payload = "robotis", control_table, "Status", "parameters"
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from struct import Struct
from typing import Any, ClassVar

import construct as c

from aces_bus.device import Device, Job, OutgoingMessage, Poll, Steps, Ticket
from aces_bus.device.coalesce import Setpoint
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError, DeviceError, UnknownNameError
from aces_bus.protocol import Record
from aces_bus.protocol.declare.registers import RegisterMap
from aces_bus.protocol.record import FieldValue

#: How often a set-point that did not arrive is sent again.
AGAIN = 3


class RegisterCodec:
    """One register's bytes as a raw number, and that number as its value."""

    __slots__ = ("_values", "address", "name", "pack", "register", "size", "unpack_from")

    def __init__(self, registers: RegisterMap, name: str) -> None:
        self.register = register = registers[name]
        self.name, self.address, self.size = name, register.address, register.size
        inner = register.field
        while isinstance(inner, c.Subconstruct):
            inner = inner.subcon
        if not isinstance(inner, c.FormatField):
            raise CallerError(f"register {name} is not a plain number: {type(inner).__name__}")
        plain = Struct(inner.fmtstr)
        self.pack: Callable[[int], bytes] = plain.pack
        self.unpack_from: Callable[[bytes | bytearray, int], tuple[int]] = plain.unpack_from
        self._values: dict[int, Any] = {}

    def value(self, raw: int) -> Any:
        """Return the value of a raw number, in the sheet's unit."""
        found = self._values.get(raw)
        if found is None:
            if len(self._values) > 4096:
                self._values.clear()
            found = self._values[raw] = self.register.decode(self.pack(raw))
        return found

    def raw(self, value: FieldValue, *, is_raw: bool = False) -> int:
        """Return the raw number of a value; raises `FieldError` when it does not fit."""
        (number,) = self.unpack_from(self.register.encode(value, raw=is_raw), 0)
        return number


class RegisterSpan:
    """Neighbouring registers: what one request reads."""

    __slots__ = ("codecs", "count", "start")

    def __init__(self, start: int, count: int, codecs: Iterable[RegisterCodec]) -> None:
        self.start, self.count = start, count
        #: Each register and its place in the answer.
        self.codecs = tuple(
            (codec.address - start, codec)
            for codec in codecs
            if codec.address >= start and codec.address + codec.size <= start + count
        )


#: What a register's raw number becomes, and the signal it becomes it for.
_Watch = tuple[Callable[[int], Any], Signal]


class RegisterDevice(Device):
    """One register-mapped node; see the module's text.

    `eeprom` are the addresses that survive power-off. `remembers` are registers that change only when they are written,
    or by a reboot. `streamed` are those whose set-points go out in each tick; others when set. A packet to many has at
    most `together_bytes` bytes, `together_overhead` of them around the devices' own. `acknowledges` and `answers`: whether
    the device answers writes and reads.
    """

    registers: RegisterMap
    reply: ClassVar[str]
    payload: ClassVar[str]
    eeprom: ClassVar[range] = range(0)
    remembers: ClassVar[Collection[str]] = ()
    streamed: ClassVar[Collection[str]] = ()
    together_bytes: ClassVar[int] = 255
    together_overhead: ClassVar[int] = 0
    #: The message that asks several devices for one stretch (`start`, `count`, `ids`), and its other fields.
    together_read: str = ""
    together_fields: ClassVar[Mapping[str, FieldValue]] = {}
    timeout_s: float = 0.02
    retries: int = 2
    acknowledges: bool = True
    answers: bool = True
    #: By register map: its registers' codecs, made once for all devices.
    _all_codecs: ClassVar[dict[int, tuple[RegisterMap, dict[str, RegisterCodec]]]] = {}

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        registers = getattr(cls, "registers", None)
        if registers is not None and registers.sync_message is not None:
            cls.rules = {**cls.rules, registers.sync_message: together_rule}

    def __init__(self, *args: Any) -> None:
        found = self._all_codecs.get(id(self.registers))
        if found is None or found[0] is not self.registers:
            made = {name: RegisterCodec(self.registers, name) for name in self.registers}
            found = self._all_codecs[id(self.registers)] = (self.registers, made)
        self.codecs: Mapping[str, RegisterCodec] = found[1]
        own = self.registers
        self._read_message, self._write_message, self._sync_message = (
            message or "" for message in (own.read_message, own.write_message, own.sync_message)
        )
        #: The last raw number received of each register, and when.
        self.known: dict[str, tuple[int, int]] = {}
        self._watches: dict[str, list[_Watch]] = {}
        self._spans: dict[Any, RegisterSpan] = {}
        #: What was asked of several last, and the packet for it.
        self._asked: tuple[Any, ...] = ()
        self._asking: Any = None
        #: The register that each signal is read from.
        self._registers: dict[str, RegisterCodec] = {}
        #: Set-points that were given: register → raw number.
        self.goals: dict[str, int] = {}
        self._fresh: dict[str, None] = {}
        #: What was written and read back; what was sent and not read back yet, with how often.
        self._kept: dict[str, int] = {}
        self._sent: dict[str, tuple[int, int]] = {}
        super().__init__(*args)

    # ------------------------------------------------------------------ declaring

    def codec(self, name: str) -> RegisterCodec:
        """Return a register's codec; raises `UnknownNameError`."""
        found = self.codecs.get(name)
        if found is None:
            raise UnknownNameError(f"register of {self.name}", name, self.codecs)
        return found

    def poll(self, first: str, last: str | None = None, **options: Any) -> Poll:
        """Return a poll that reads the registers from `first` to `last`; options are those of `Poll`."""
        span, fields = self._span(first, last or first)
        message = self._read_message
        self._spans[self.host.packet(self, message, fields)] = span
        own: dict[str, Any] = {"timeout_s": self.timeout_s, "together": self.together_read}
        return Poll(message, self.reply, fields, **{**own, **options})

    def packet_together(self, devices: Sequence[Device], poll: Poll) -> Any:
        """Return one packet that asks all devices for a stretch; each answers for itself."""
        ids = [device.credentials["id"] for device in devices]
        asked = (poll.together, *poll.fields.values(), *ids)
        if asked != self._asked:
            fields = {**self.together_fields, **poll.fields, "ids": ids}
            self._asked, self._asking = asked, self.host.packet(self, poll.together, fields)
        return self._asking

    def register_signal(
        self,
        name: str,
        of: str,
        *,
        scale: float = 1,
        to_si: Callable[[int], Any] | None = None,
        set: str | None = None,
        to_raw: Callable[[Any], int] | None = None,
        setter: Callable[[Any], None] | None = None,
        **options: Any,
    ) -> Signal:
        """Add a signal that is read from the register `of` and set through the register `set`.

        `to_si` takes the raw number (by default its value × `scale`), `to_raw` gives it. Set-points of all devices go out in
        one packet. Other options are those of `add_signal`. Raises `UnknownNameError` for an unknown register.
        """
        codec = self.codec(of)
        if set is not None:
            target = self.codec(set)
            convert = to_raw or (
                lambda value: target.raw(value / scale if isinstance(value, (int, float)) else value)
            )

            def give(value: FieldValue) -> None:
                self.want(self._sync_message, target.name, convert(value))

            setter = give
        signal = self.add_signal(name, setter=setter, **options)
        if to_si is None:
            value_of = codec.value
            to_si = value_of if scale == 1 else lambda raw: value_of(raw) * scale
        self._watches.setdefault(of, []).append((to_si, signal))
        self.readable.add(signal.name)
        self._registers[signal.name] = codec
        return signal

    def polls_of(self, name: str) -> list[Poll]:
        """Return the polls that read the signal's register."""
        codec = self._registers.get(name)
        return (
            []
            if codec is None
            else [
                poll
                for poll in self.polls
                if poll.message == self._read_message
                and poll.fields["start"] <= codec.address
                and codec.address + codec.size <= poll.fields["start"] + poll.fields["count"]
            ]
        )

    # ------------------------------------------------------------------ by name

    def read(self, name: str, last: str | None = None, *, raw: bool = False) -> Job:
        """Ask for a register, or for all from it to `last` in one request.

        The result is the value in the sheet's unit (`raw`: the number), or a dict of them by name. Raises
        `UnknownNameError` and `CallerError`; fails with `NoReplyError`, or `DeviceError` when the device refuses.
        """
        span, fields = self._span(name, last or name)
        self._must_answer(f"reading {name}")

        def steps(job: Job) -> Steps:
            record = yield self._ask(self._read_message, span, **fields)
            self._raise_refusal(record, f"reading {name}")
            data = getattr(record, self.payload)
            found: dict[str, FieldValue] = {}
            for at, codec in span.codecs:
                (number,) = codec.unpack_from(data, at)
                found[codec.name] = number if raw else codec.value(number)
            return found if last is not None else found[name]

        return self.job(f"read {name}", steps)

    def read_all(self, *, raw: bool = False) -> Job:
        """Return the whole table, in one request: name → value."""
        ordered = sorted(self.codecs.values(), key=lambda codec: codec.address)
        return self.read(ordered[0].name, ordered[-1].name, raw=raw)

    def write(self, name: str, value: Any, *, confirm: bool = False, raw: bool = False) -> Job:
        """Write a register, and see that it arrived: by the device's acknowledgement, or else by reading it back.

        `value` is in the sheet's unit (`raw`: the number as it is, unchecked). `confirm=True` is needed for what survives
        power-off. Raises `UnknownNameError`, `FieldError`, `CallerError`; fails with `NoReplyError` or `DeviceError`.
        """
        codec = self.codec(name)
        number = codec.raw(value, is_raw=raw)
        self.check_write(name, confirm)

        def steps(job: Job) -> Steps:
            message, fields = self._write_message, {"start": codec.address, "data": codec.pack(number)}
            ticket = self._ask(message, None, **fields) if self.acknowledges else self.send(message, **fields)
            yield from self._seen_written(codec, number, ticket, self.acknowledges)

        return self.job(f"write {name}", steps)

    def write_now(self, name: str, number: int) -> Job:
        """Write a register's raw number as a stop: before all others, and instead of what still waits for this device.

        That it arrived is seen as with `write`; raises and fails like that.
        """
        codec = self.codec(name)
        # Acknowledgements of earlier writes may come late, and look like this one's.
        is_sure = self.acknowledges and not self.timed_out.get(self.reply)
        ticket = self.send_now(
            self._write_message,
            reply=self.reply if self.acknowledges else (),
            timeout_s=self.timeout_s,
            retries=self.retries,
            start=codec.address,
            data=codec.pack(number),
        )
        return self.job(f"write {name}", lambda job: self._seen_written(codec, number, ticket, is_sure))

    def _seen_written(self, codec: RegisterCodec, number: int, ticket: Ticket, is_sure: bool) -> Steps:
        """Yield steps that see a write arrive: by its acknowledgement where that is sure, else by reading the
        register.
        """
        doing = f"writing {codec.name} = {codec.value(number)!r}"
        record = yield ticket
        if self.acknowledges:
            self._raise_refusal(record, doing)
        else:
            yield self.host.port.wire_ns(ticket.packet)
        if self.answers and not is_sure:
            span, fields = self._own_span(codec)
            record = yield self._ask(self._read_message, span, ticket.urgent, **fields)
            self._raise_refusal(record, f"reading {codec.name}")
            (found,) = codec.unpack_from(getattr(record, self.payload), 0)
            if found != number:
                raise DeviceError(
                    f"{self.name}: {doing}: it has {codec.value(found)!r} all the same; is it locked?"
                )
        self.written(codec.name, number)

    def _own_span(self, codec: RegisterCodec) -> tuple[RegisterSpan, dict[str, int]]:
        """Return what reads a register, as long as no poll where there is more beside it: no late answer is taken for
        its own.
        """
        taken = {poll.fields.get("count") for poll in self.polls}
        begins = {other.address: other for other in self.codecs.values()}
        count = codec.size
        while count in taken and (beside := begins.get(codec.address + count)) is not None:
            count += beside.size
        if count in taken:  # there is nothing beside it
            count = codec.size
        fields = {"start": codec.address, "count": count}
        return RegisterSpan(codec.address, count, self.codecs.values()), fields

    def check_write(self, name: str, confirm: bool = False) -> None:
        """Raise `CallerError` when a register may not be written now."""
        register = self.codec(name).register
        if register.access == "read":
            raise CallerError(f"{self.name}: register {name} can only be read")
        if register.address in self.eeprom and not confirm:
            raise CallerError(
                f"{self.name}: register {name} keeps its value without power, and wears out; say confirm=True to write it"
            )

    def written(self, name: str, number: int) -> None:
        """Note that a register has been written and acknowledged."""
        self.known[name] = (number, self.clock.now())
        self._sent.pop(name, None)
        if name in self.goals:
            self.goals[name] = number
        if name in self.remembers:
            self._kept[name] = number
        for to_si, signal in self._watches.get(name, ()):
            signal.update(to_si(number), self.clock.now())

    def cached(self, name: str, *, raw: bool = False) -> Any:
        """Return the last value received of a register, however old; None when it never was."""
        codec = self.codec(name)
        found = self.known.get(name)
        return None if found is None else found[0] if raw else codec.value(found[0])

    def refusal(self, record: Record) -> str:
        """Return why an answer is a refusal; empty for an acceptance. For drivers to override."""
        return ""

    def changed(self, which: Mapping[str, tuple[int, int]]) -> None:
        """Report registers that were lost by a reboot: name → raw number written and found."""
        text = ", ".join(f"{name} is {found}, was set to {was}" for name, (was, found) in which.items())
        self.rebooted(text)

    # ------------------------------------------------------------------ up

    def receive(self, record: Record, instant: int) -> None:
        """Take a record of this device: requested registers become signals."""
        if type(record).__name__ != self.reply:
            super().receive(record, instant)
            return
        ticket = self.awaiting[0] if self.awaiting else None
        if ticket is not None:
            span = self._spans.get(ticket.packet)
            data = getattr(record, self.payload)
            if len(data) != (0 if span is None else span.count):
                if data or not self.refusal(record):
                    self.last_received = instant
                    self.emit_event("late reply", f"{len(data)} bytes, which nothing asks for now")
                    return
            elif span is not None:
                self._take(span, data, instant)
        super().receive(record, instant)

    def _take(self, span: RegisterSpan, data: bytes, instant: int) -> None:
        known, watches, kept = self.known, self._watches, self._kept
        lost: dict[str, tuple[int, int]] | None = None
        for at, codec in span.codecs:
            (number,) = codec.unpack_from(data, at)
            name = codec.name
            known[name] = (number, instant)
            if self._sent and name in self._sent:
                self._arrived(name, number)
            elif name in kept and kept[name] != number:
                lost = lost or {}
                lost[name] = (kept[name], number)
            for to_si, signal in watches.get(name, ()):
                signal.update(to_si(number), instant)
        if lost:
            for name in lost:
                self._kept.pop(name, None)
            self.changed(lost)

    def _arrived(self, name: str, number: int) -> None:
        """Compare a register with what an unacknowledged write to many devices has set."""
        wanted, tries = self._sent.pop(name)
        if number == wanted:
            if name in self.remembers:
                self._kept[name] = number
        elif tries < AGAIN:
            self._sent[name] = (wanted, tries + 1)
            self.goals[name] = wanted
            self._fresh[name] = None
            self.host.wake()
        else:
            self.emit_event("limited", f"{name} was set to {wanted} and stays {number}")

    def forget(self) -> None:
        """Forget all that was known, save what survives power-off."""
        super().forget()
        eeprom = self.eeprom
        self.known = {k: v for k, v in self.known.items() if self.codecs[k].address in eeprom}
        for kept in (self.goals, self._fresh, self._kept, self._sent):
            kept.clear()

    # ------------------------------------------------------------------ down

    def want(self, message: str, path: str, value: Any) -> None:
        """Have a register (`path`) written with the next tick, as a raw number; other messages as `Device.want`."""
        if message != self._sync_message:
            super().want(message, path, value)
            return
        self.goals[path] = value
        self._fresh[path] = None
        if path not in self.streamed:
            self._sent[path] = (value, 0)
        if path in self._kept:
            del self._kept[path]
        self.host.wake()

    def drop(self, message: str) -> None:
        """Forget set-points: of a message, or of a register by its name."""
        if message == self._sync_message:
            for kept in (self.goals, self._fresh, self._sent):
                kept.clear()
            self.epoch += 1
        elif self.goals.pop(message, None) is None:
            super().drop(message)
        else:
            for kept in (self._fresh, self._sent):  # or it would be sent again where it did not arrive
                kept.pop(message, None)
            self.epoch += 1

    def wants(self, now: int) -> list[Setpoint]:
        """Return what is to be sent in this tick."""
        out = super().wants(now) if self._given else []
        goals = self.goals
        if not goals:
            return out
        message = self._sync_message
        if self._held and self._held.get(message, 0) > now:
            return out
        fresh, streamed = self._fresh, self.streamed
        for name, value in goals.items():
            if name in fresh or name in streamed:
                out.append(Setpoint(self, message, name, value))
        fresh.clear()
        return out

    # ------------------------------------------------------------------ inside

    def _ask(
        self, message: str, span: RegisterSpan | None, confirms: bool = False, /, **fields: Any
    ) -> Ticket:
        """Send a request; its answer is remembered by its packet. `confirms` as of `ask`."""
        if span is not None:
            self._spans[self.host.packet(self, message, fields)] = span
        return self.ask(
            message,
            reply=self.reply,
            timeout_s=self.timeout_s,
            retries=self.retries,
            confirms=confirms,
            **fields,
        )

    def _unanswered(self, message: str, **fields: FieldValue) -> Steps:
        """Yield steps that send a message without an answer, and wait until it has left."""
        ticket = self.send(message, **fields)
        yield ticket
        yield self.host.port.wire_ns(ticket.packet)

    def _span(self, first: str, last: str) -> tuple[RegisterSpan, dict[str, int]]:
        low, other = self.codec(first), self.codec(last)
        count = other.address + other.size - low.address
        if count <= 0:
            raise CallerError(f"{self.name}: register {last} comes before {first}")
        return RegisterSpan(low.address, count, self.codecs.values()), {"start": low.address, "count": count}

    def _must_answer(self, doing: str) -> None:
        if not self.answers:
            raise CallerError(f"{self.name}: {doing}: this device is set to answer no reads")

    def _raise_refusal(self, record: Record, doing: str) -> None:
        why = self.refusal(record)
        if why:
            raise DeviceError(f"{self.name}: {doing}: refused: {why}")

    def renumbered(self) -> None:
        """Forget the packets by which its requests were known, as its credentials are others now."""
        self._spans.clear()
        for poll in self.polls:
            if poll.message == self._read_message:
                start, count = poll.fields["start"], poll.fields["count"]
                packet = self.host.packet(self, poll.message, poll.fields)
                self._spans[packet] = RegisterSpan(start, count, self.codecs.values())


def together_rule(wants: Sequence[Setpoint]) -> Iterable[OutgoingMessage]:
    """Send one packet a register for all devices that want it, cut where the smallest receive buffer is full."""
    by_register: dict[
        RegisterCodec, list[Setpoint]
    ] = {}  # devices with other tables have registers of their own
    for want in wants:
        by_register.setdefault(want.device.codec(want.path), []).append(want)
    for codec, mine in by_register.items():
        first: RegisterDevice = mine[0].device
        most = min(want.device.together_bytes for want in mine) - first.together_overhead
        each = max(1, most // (codec.size + 1))
        for at in range(0, len(mine), each):
            carried = mine[at : at + each]
            servos = [
                {"id": want.device.credentials["id"], "data": codec.pack(want.value)} for want in carried
            ]
            fields = {"start": codec.address, "size": codec.size, "servos": servos}
            yield OutgoingMessage(carried[0].device, mine[0].message, fields, carried)
