"""Any device on Modbus RTU, by the table of its registers.

1. One asks at a time, and a value has a name only through the request that it answers. When an answer did not come, the
   device is not asked anew before it cannot come any more: it would be taken for the answer to the next request.
2. Nothing is written but what is set; a write counts when the device has confirmed it. Where nothing confirms, it says so.
3. What stops such a device, only its file knows: `stop` names the registers that are written then, before all that waits.
   One that was set and has no `stop` counts as not stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, ClassVar

import msgspec
from msgspec import Meta

from aces_bus.device import Device, Driver, HostLoss, Job, Poll, Steps, Ticket
from aces_bus.device.settings import described, settings_of
from aces_bus.errors import CallerError, DeviceError, NoReplyError, UnknownNameError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue

from ..scanning import scan_numbers
from .table import READERS, ModbusRegister, bits_from, registers_of, stretches
from .twin import ModbusTwin

#: What answers reading and writing.
READ = ("Registers", "Bits", "Refusal")
WRITTEN = ("RegisterWritten", "RegistersWritten", "BitWritten", "Refusal")
#: An answer that has not come for so long behind its time does not come any more (ns).
LATE_NS = 500_000_000
#: Who looks for devices asks each number once, and waits so long (s).
PATIENCE_S = 0.06


class ModbusSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    registers: Annotated[
        dict[str, Any],
        Meta(
            description="a table of registers: name = { address, type, table, access, unit, scale, offset, … }"
        ),
    ] = {}
    table: (
        Annotated[str, Meta(description="a table that ships, or the path of a TOML file with [registers]")]
        | None
    ) = None
    every_s: Annotated[
        float, Meta(gt=0, description="how often its registers are read (s), 0.1 when absent")
    ] = 0.1
    timeout_s: Annotated[
        float, Meta(gt=0, description="how long an answer may take (s), 0.2 when absent")
    ] = 0.2
    write_many: Annotated[
        bool,
        Meta(description="true: single registers are written by function 16, too, for devices without 6"),
    ] = False
    stop: (
        Annotated[
            dict[str, float],
            Meta(
                description="registers and the values that stop the device: { speed = 0 }; {}: nothing needs to be stopped"
            ),
        ]
        | None
    ) = None


class ModbusDevice(Device):
    """Signals: one a register of the table. `settings_type` and `shipped_table` are for devices of one kind."""

    protocol = "modbus"
    when_host_is_lost = HostLoss(
        "unknown", "Modbus has no time-out; what a device does is its own maker's affair"
    )
    settings_type: ClassVar[type[ModbusSettings]] = ModbusSettings
    shipped_table: ClassVar[str | None] = None
    actions: ClassVar = {"read": "ask for one register: its name"}
    asking: ClassVar = ("read",)
    #: Whether what is set may have to be stopped.
    moves: ClassVar[bool] = True
    settings: ModbusSettings

    def setup(self) -> None:
        """Add a signal for each register, and a poll for each run of neighbours that is read equally often."""
        self.settings = given = settings_of(self.name, self.settings_type, self.config.settings)
        self.table = registers_of(self.name, given.table or self.shipped_table, given.registers)
        #: What reads each register: table, first address and number.
        self.spans: dict[str, tuple[str, int, int]] = {}
        self._span_polls: dict[tuple[str, int, int], Poll] = {}
        #: Set-points that wait, and what writes them.
        self._wanted: dict[str, FieldValue] = {}
        self._writing: dict[str, Job] = {}
        #: Until when an answer may come late (ns).
        self._quiet_until = 0
        periods: dict[float, list[ModbusRegister]] = {}
        for register in self.table.values():
            if register.entry.access != "write":
                every = given.every_s if register.entry.every_s is None else register.entry.every_s
                periods.setdefault(every, []).append(register)
        for every, mine in periods.items():
            for span in stretches(mine):
                inside = [register for register in mine if _is_in(register, span)]
                self.spans |= {register.name: span for register in inside}
                if every:
                    self._span_polls[span] = Poll(
                        *self._question(span), every_s=every, timeout_s=given.timeout_s
                    )
        self.polls = tuple(self._span_polls.values())
        for register in self.table.values():
            self._add(register)
        for name in given.stop or {}:
            if name not in self.table or self.table[name].entry.access == "read":
                raise CallerError(
                    f"{self.name}: stop = {{ {name} = … }}: there is no register {name} that can be written"
                )
        for name, value in (given.stop or {}).items():
            self.table[name].raw(value)  # raises for what does not fit

    def _add(self, register: ModbusRegister) -> None:
        entry = register.entry
        every = self.settings.every_s if entry.every_s is None else entry.every_s
        setter: Callable[[Any], None] | None = None
        if entry.access != "read":
            setter = partial(self._set, register.name)
        self.add_signal(
            register.name,
            unit=entry.unit,
            setter=setter,
            lower=entry.lower,
            upper=entry.upper,
            read_from=() if entry.access == "write" else ("Bits" if register.is_bit else "Registers",),
            stale_s=max(0.5, 5 * every) if every else 1e9,
            doc=entry.doc,
            source=entry.source,
        )

    def _question(self, span: tuple[str, int, int]) -> tuple[str, tuple[str, ...], dict[str, int]]:
        table, start, count = span
        function = READERS[table]
        message = "ReadBits" if function < 3 else "ReadRegisters"
        return message, READ, {"function": function, "start": start, "count": count}

    def polls_of(self, name: str) -> list[Poll]:
        """Return the poll that reads the signal's register."""
        span = self.spans.get(name.partition(".")[2])
        found = self._span_polls.get(span) if span is not None else None
        return [] if found is None else [poll for poll in self.polls if poll.fields == found.fields]

    def start(self) -> Job | None:
        """Read what is read once."""
        once = dict.fromkeys(span for span in self.spans.values() if span not in self._span_polls)
        if not once:
            return None

        def steps(job: Job) -> Steps:
            for span in once:
                yield from self._asked(*self._question(span))

        return self.job("read what does not change", steps)

    # ------------------------------------------------------------------ up

    def receive(self, record: Record, instant: int) -> None:
        """Take a record; an answer of another size than was asked for is late, and updates no signal."""
        if type(record).__name__ in ("Registers", "Bits") and self._raw_of(record) is None:
            self.last_received = instant
            self.emit_event("late reply", f"{len(record.meta.raw)} bytes, which nothing asks for now")
            return
        super().receive(record, instant)

    def no_reply(self, ticket: Ticket) -> None:
        """Ask nothing until the answer cannot come any more."""
        self._quiet_until = self.clock.now() + LATE_NS
        for message in ("ReadRegisters", "ReadBits"):
            self.host.postpone(self, message, LATE_NS / 1e9)

    def received(self, record: Record, instant: int) -> None:
        """Take the registers that were asked for."""
        name = type(record).__name__
        if name == "Refusal":
            self.emit_event("alarm", f"refuses function {record.function}: {record.reason}")
        elif name in ("Registers", "Bits"):
            raw = self._raw_of(record)
            assert raw is not None  # see `receive`
            for register in self.table.values():
                span = self.spans.get(register.name)
                if span is None or READERS[span[0]] != record.function:
                    continue
                at = register.entry.address - record.start
                if at >= 0 and at + register.size <= len(raw):
                    self.signals[f"{self.name}.{register.name}"].update(
                        register.value(raw[at : at + register.size]), instant
                    )

    def _raw_of(self, record: Record) -> list[int] | None:
        """Return the numbers of an answer; None where they are not as many as were asked for."""
        if type(record).__name__ == "Bits":
            is_whole = len(record.bits) == (record.count + 7) // 8
            return bits_from(record.bits, record.count) if is_whole else None
        return list(record.registers) if len(record.registers) == record.count else None

    # ------------------------------------------------------------------ down

    def _asked(self, message: str, reply: tuple[str, ...], fields: dict[str, Any]) -> Steps:
        """Yield steps that ask, and ask again after no answer; return the record."""
        for is_last in (False, True):
            if (left := self._quiet_until - self.clock.now()) > 0:
                yield left
            try:
                return (
                    yield self.ask(
                        message, reply=reply, timeout_s=self.settings.timeout_s, retries=0, **fields
                    )
                )
            except NoReplyError:
                if is_last:
                    raise

    def read(self, name: str) -> Job:
        """Ask for one register: its value. Fails with `DeviceError` when it is refused, `NoReplyError` without an answer.

        Raises `UnknownNameError`, `CallerError` for what can only be written.
        """
        register = self._register(name)
        if register.entry.access == "write":
            raise CallerError(f"{self.name}: register {name} can only be written")

        def steps(job: Job) -> Steps:
            answer = yield from self._asked(
                *self._question((register.entry.table, register.entry.address, register.size))
            )
            self._raise_refusal(answer, f"reading {name}")
            raw = self._raw_of(answer)
            if raw is None:
                raise DeviceError(
                    f"{self.name}: reading {name}: the answer has another size than was asked for"
                )
            return register.value(raw)

        return self.job(f"read {name}", steps)

    def write(self, name: str, value: Any) -> Job:
        """Write one register; over when the device has confirmed it.

        Fails with `DeviceError` when it refuses, `NoReplyError` without an answer. Raises `UnknownNameError`, `CallerError`.
        """
        register = self._register(name)
        if register.entry.access == "read":
            raise CallerError(f"{self.name}: register {name} can only be read")
        raw = register.raw(value)

        def steps(job: Job) -> Steps:
            answer = yield from self._asked(*self._order(register, raw))
            self._raise_refusal(answer, f"writing {name} = {value!r}")

        return self.job(f"write {name}", steps)

    def _register(self, name: str) -> ModbusRegister:
        found = self.table.get(name)
        if found is None:
            raise UnknownNameError(f"register of {self.name}", name, self.table)
        return found

    def _order(
        self, register: ModbusRegister, raw: tuple[int, ...]
    ) -> tuple[str, tuple[str, ...], dict[str, FieldValue]]:
        start = register.entry.address
        if register.is_bit:
            return "WriteBit", WRITTEN, {"start": start, "value": "on" if raw[0] else "off"}
        if register.size == 1 and not self.settings.write_many:
            return "WriteRegister", WRITTEN, {"start": start, "value": raw[0]}
        return "WriteRegisters", WRITTEN, {"start": start, "count": len(raw), "registers": list(raw)}

    def _raise_refusal(self, answer: Record, doing: str) -> None:
        if type(answer).__name__ == "Refusal":
            raise DeviceError(f"{self.name}: {doing}: refused: {answer.reason}")

    def _set(self, name: str, value: FieldValue) -> None:
        """Write a set-point now, or when the present write is over; of several waiting set-points only the
        last is written.
        """
        self._register(name).raw(value)  # raises for what does not fit
        if self.host.passive:
            self.emit_event("not sent", f"{name}: this bus is only listened to")
            return
        self.is_driven = True
        self._wanted[name] = value
        before = self._writing.get(name)
        if before is None or before.is_over:
            self._writing[name] = self.lead(f"set {name}", partial(self._write_wanted, name))

    def _write_wanted(self, name: str, job: Job) -> Steps:
        register = self.table[name]
        while name in self._wanted:
            value = self._wanted.pop(name)
            answer = yield from self._asked(*self._order(register, register.raw(value)))
            self._raise_refusal(answer, f"setting {name} = {value!r}")

    # ------------------------------------------------------------------ stopping

    def stop_motion(self) -> Job | None:
        """Write what the file's `stop` says, before all that waits; over when the device has confirmed each."""
        self._wanted.clear()
        self.end_led()  # what has to be written again after a lost answer, too
        if not self.settings.stop:
            return None
        tickets: list[tuple[str, Ticket, dict[str, FieldValue]]] = []
        for name, value in self.settings.stop.items():
            register = self.table[name]
            message, reply, fields = self._order(register, register.raw(value))
            ticket = self.send_now(
                message, reply=reply, timeout_s=self.settings.timeout_s, retries=2, **fields
            )
            tickets.append((name, ticket, fields))

        def steps(job: Job) -> Steps:
            for name, ticket, fields in tickets:
                answer = yield ticket
                self._raise_refusal(answer, f"stopping by {name}")
                if any(getattr(answer, key, value) != value for key, value in fields.items()):
                    raise DeviceError(f"{self.name}: stopping by {name}: confirmed was another write, late")

        return self.job("stop", steps)

    def confirm_stopped(self) -> Job | None:
        """Check that a stop was carried out; fail if a register was set and nothing says what stops it.

        Where answers are missing, which may come late and be taken for a stop's, what was written is read back.
        """
        if self.settings.stop is None:
            return (
                self.job("say that nothing stops it", self._goes_on)
                if self.moves and self.is_driven
                else None
            )
        stop = {self.table[name]: value for name, value in self.settings.stop.items()}
        readable = {register: value for register, value in stop.items() if register.entry.access != "write"}
        return self.job("read back", partial(self._stays, readable)) if any(self.timed_out.values()) else None

    def _goes_on(self, job: Job) -> Steps:
        yield 0
        raise DeviceError(f"{self.name} was set, and its file says no `stop`: what it does, it goes on doing")

    def _stays(self, wanted: dict[ModbusRegister, float], job: Job) -> Steps:
        for register, value in wanted.items():
            message, reply, fields = self._question(
                (register.entry.table, register.entry.address, register.size)
            )
            answer = yield self.ask(
                message, reply=reply, timeout_s=self.settings.timeout_s, retries=1, confirms=True, **fields
            )
            self._raise_refusal(answer, f"reading {register.name}")
            raw = self._raw_of(answer)
            if raw is None or tuple(raw) != tuple(register.raw(value)):
                raise DeviceError(f"{self.name}: stopping by {register.name}: it has not stayed {value:g}")


def _is_in(register: ModbusRegister, span: tuple[str, int, int]) -> bool:
    table, start, count = span
    return (
        register.entry.table == table
        and start <= register.addresses.start
        and register.addresses.stop <= start + count
    )


EXAMPLE = """
name = "modbus_example"
rate_hz = 20

[buses]
line = { link = "serial", protocol = "modbus", baud = 115_200 }

[devices.METER]
driver = "modbus"
bus = "line"
credentials = { unit = 5 }

[devices.METER.settings.registers]
voltage = { address = 0, type = "u16", table = "input", unit = "V", scale = 0.1 }
power = { address = 2, type = "float", table = "input", words = "low first", unit = "W" }
energy = { address = 4, type = "u32", table = "input", unit = "W·h" }
serial = { address = 100, type = "text", count = 4, every_s = 0 }

[devices.OVEN]
driver = "modbus"
bus = "line"
credentials = { unit = 6 }

[devices.OVEN.settings]
every_s = 0.2
stop = { heater = 0, goal = 20 }

[devices.OVEN.settings.registers]
temperature = { address = 10, type = "s16", unit = "°C", scale = 0.1, offset = -50 }
goal = { address = 11, type = "s16", access = "read-write", unit = "°C", scale = 0.1, lower = 0, upper = 250 }
heater = { address = 3, type = "bit", table = "coil", access = "read-write" }
door = { address = 0, type = "bit", table = "input_bit" }
"""

driver = Driver(
    "modbus",
    device=ModbusDevice,
    twin=ModbusTwin,
    example=EXAMPLE,
    doc="Any device on Modbus RTU, by a table of its registers.",
    source="Modbus application protocol",
    # The first holding register: a unit that is there answers, if only with an exception.
    scan=scan_numbers(
        "modbus",
        "UNIT",
        "unit",
        range(1, 248),
        "ReadRegisters",
        reply=("Registers", "Refusal"),
        timeout_s=PATIENCE_S,
        retries=0,
        function=3,
        start=0,
        count=1,
    ),
    settings=described(ModbusSettings),
)
