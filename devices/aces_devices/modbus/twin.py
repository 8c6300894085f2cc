"""A simulated device on Modbus RTU, with the registers of its table and no others.

1. What is not in the table is refused as a device does: function, address, value.
2. Nothing happens by itself: a register has what was written, or what `put` says.
3. Beside registers it has exception status, diagnostics (echo and counters), its identification, and queues: a register that
   says how many of those behind it are in the queue (Modbus application protocol 6.7, 6.8, 6.13, 6.18, 6.21).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from random import Random
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.errors import UnknownNameError
from aces_bus.protocol import Record

from ..tables import drawn_bytes
from .table import MOST_BITS, MOST_REGISTERS, READERS, ModbusRegister, bits_from, bytes_from, registers_of

#: The longest queue that function 24 reads.
MOST_QUEUED = 31
#: Diagnostics of function 8: what they count; `ECHO` answers with its request, `CLEAR` begins anew.
ECHO, CLEAR = 0x00, 0x0A
COUNTED = {
    0x0B: "messages",
    0x0C: "errors",
    0x0D: "refusals",
    0x0E: "messages",
    0x0F: "unanswered",
    0x12: "overruns",
}
#: Function 43: the type of its identification, how it is read one by one, and how far it goes (basic, either way).
IDENTIFICATION, ONE_BY_ONE, CONFORMITY = 0x0E, 4, 0x81
TABLES = {function: table for table, function in READERS.items()}


class ModbusTwin(Twin):
    """Four tables: `twin.put("voltage", 230.0)`, `twin.take("goal")`; `twin.changed` is called with each write."""

    protocol = "modbus"
    shipped_table: ClassVar[str | None] = None
    faults: ClassVar[Mapping[str, str]] = {"busy": "refuses everything: it is busy"}
    changed: Callable[[str, Any], None] | None = None

    def setup(self) -> None:
        """Begin with all registers zero."""
        settings = self.config.settings
        self.table = registers_of(
            self.name, settings.get("table") or self.shipped_table, settings.get("registers", {})
        )
        #: What function 7 says, and what function 8 counts.
        self.exception_status = 0
        self.counts = dict.fromkeys(COUNTED.values(), 0)
        self.numbers: dict[str, dict[int, int]] = {table: {} for table in READERS}
        self.writable: dict[str, set[int]] = {table: set() for table in READERS}
        for register in self.table.values():
            self.numbers[register.entry.table] |= dict.fromkeys(register.addresses, 0)
            if register.entry.access != "read":
                self.writable[register.entry.table].update(register.addresses)

    def draw(self, dice: Random, share: float = 1.0) -> None:
        """Have each register hold any number of its type."""
        for one in self.table.values():
            bits = (
                (dice.randrange(2),)
                if one.is_bit
                else one.registers(drawn_bytes(dice, one.entry.type, 2 * one.size, share))
            )
            self.numbers[one.entry.table].update(zip(one.addresses, bits, strict=True))

    def _register(self, name: str) -> ModbusRegister:
        if name not in self.table:
            raise UnknownNameError(f"register of {self.name}", name, self.table)
        return self.table[name]

    def put(self, name: str, value: Any) -> None:
        """Have a register's value, in its unit. Raises `UnknownNameError`, `CallerError` for what does not fit."""
        register = self._register(name)
        self.numbers[register.entry.table].update(zip(register.addresses, register.raw(value), strict=True))

    def take(self, name: str) -> Any:
        """Return a register's value, in its unit. Raises `UnknownNameError`."""
        register = self._register(name)
        kept = self.numbers[register.entry.table]
        return register.value([kept[address] for address in register.addresses])

    # ------------------------------------------------------------------ reading

    @on("ReadRegisters")
    def read_registers(self, request: Record) -> None:
        """Answer with holding or input registers."""
        found = self._read(request, request.function, MOST_REGISTERS)
        if found is not None:
            self._answer(request, "Registers", function=request.function, registers=found)

    @on("ReadBits")
    def read_bits(self, request: Record) -> None:
        """Answer with coils or discrete inputs."""
        found = self._read(request, request.function, MOST_BITS)
        if found is not None:
            self._answer(request, "Bits", function=request.function, bits=bytes_from(found))

    def _read(self, request: Record, function: int, most: int) -> list[int] | None:
        kept = self.numbers[TABLES[3 if function == 23 else function]]
        addresses = range(request.start, request.start + request.count)
        if not 1 <= request.count <= most:
            self._refuse(request, function, "value")
        elif any(address not in kept for address in addresses):
            self._refuse(request, function, "address")
        elif "busy" in self.active_faults:
            self._refuse(request, function, "busy")
        else:
            return [kept[address] for address in addresses]
        return None

    # ------------------------------------------------------------------ writing

    @on("WriteRegister")
    def write_register(self, request: Record) -> None:
        """Write one register."""
        if self._write(request, 6, "holding", request.start, [request.value]):
            self._answer(request, "RegisterWritten", start=request.start, value=request.value)

    @on("WriteRegisters")
    def write_registers(self, request: Record) -> None:
        """Write several registers."""
        numbers = list(request.registers)
        if len(numbers) != request.count:
            self._refuse(request, 16, "value")
        elif self._write(request, 16, "holding", request.start, numbers):
            self._answer(request, "RegistersWritten", start=request.start, count=request.count)

    @on("WriteBit")
    def write_bit(self, request: Record) -> None:
        """Write one coil."""
        if request.value not in ("on", "off"):
            self._refuse(request, 5, "value")
        elif self._write(request, 5, "coil", request.start, [int(request.value == "on")]):
            self._answer(request, "BitWritten", start=request.start, value=request.value)

    @on("WriteBits")
    def write_bits(self, request: Record) -> None:
        """Write several coils."""
        if len(request.bits) != (request.count + 7) // 8:
            self._refuse(request, 15, "value")
        elif self._write(request, 15, "coil", request.start, bits_from(request.bits, request.count)):
            self._answer(request, "BitsWritten", start=request.start, count=request.count)

    @on("MaskRegister")
    def mask_register(self, request: Record) -> None:
        """Write bits of a register."""
        old = self.numbers["holding"].get(request.start, 0)
        new = old & request.and_mask | request.or_mask & ~request.and_mask & 0xFFFF
        if self._write(request, 22, "holding", request.start, [new]):
            self._answer(
                request,
                "RegisterMasked",
                start=request.start,
                and_mask=request.and_mask,
                or_mask=request.or_mask,
            )

    @on("ExchangeRegisters")
    def exchange_registers(self, request: Record) -> None:
        """Write registers, then read others."""
        numbers = list(request.registers)
        if len(numbers) != request.write_count:
            self._refuse(request, 23, "value")
        elif self._write(request, 23, "holding", request.write_start, numbers):
            found = self._read(request, 23, MOST_REGISTERS)
            if found is not None:
                self._answer(request, "Registers", function=23, registers=found)

    # ------------------------------------------------------------------ what is not about registers

    def receive(self, record: Record, instant: int) -> None:
        """See `Twin.receive`; requests are counted."""
        self.counts["messages"] = self.counts["messages"] + 1 & 0xFFFF
        super().receive(record, instant)

    @on("Other")
    def answer_other(self, request: Record) -> None:
        """Answer exception status, diagnostics, identification and queues; refuse functions that it does not have."""
        function, data = int(request.function), bytes(request.data)
        found: bytes | str = "function"
        if "busy" in self.active_faults:
            found = "busy"
        elif function == 7:
            found = b"" if data else bytes((self.exception_status,))
        elif function == 8:
            found = self._diagnosed(data)
        elif function == 17:
            name = self.name.encode()[:200]
            found = bytes((len(name) + 1,)) + name + b"\xff"  # it runs
        elif function == 24:
            found = self._queue(data)
        elif function == 43:
            found = self._identification(data)
        if isinstance(found, str):
            self._refuse(request, function, found)
        else:
            self._answer(request, "OtherAnswer", function=function, data=found)

    def _diagnosed(self, data: bytes) -> bytes | str:
        if len(data) < 4:
            return "value"
        kind = int.from_bytes(data[:2], "big")
        if kind == CLEAR:
            self.counts = dict.fromkeys(self.counts, 0)
        elif kind in COUNTED:
            return data[:2] + self.counts[COUNTED[kind]].to_bytes(2, "big")
        elif kind != ECHO:
            return "function"
        return data

    def _queue(self, data: bytes) -> bytes | str:
        kept, start = self.numbers["holding"], int.from_bytes(data, "big")
        if len(data) != 2:
            return "value"
        if start not in kept:
            return "address"
        count = kept[start]
        queued = [kept.get(start + 1 + place) for place in range(min(count, MOST_QUEUED))]
        if count > MOST_QUEUED or None in queued:
            return "value"
        words = [2 + 2 * count, count, *(number or 0 for number in queued)]
        return b"".join(word.to_bytes(2, "big") for word in words)

    def _identification(self, data: bytes) -> bytes | str:
        if len(data) != 3 or data[0] != IDENTIFICATION:
            return "function"
        code, first = data[1], data[2]
        texts = dict(enumerate((b"aces-bus", self.name.encode()[:100], b"1.0")))
        if not 1 <= code <= ONE_BY_ONE:
            return "value"
        if code == ONE_BY_ONE:
            if first not in texts:
                return "address"
            texts = {first: texts[first]}
        else:
            texts = {number: text for number, text in texts.items() if number >= first} or texts
        head = bytes((IDENTIFICATION, code, CONFORMITY, 0, 0, len(texts)))
        return head + b"".join(bytes((number, len(text))) + text for number, text in texts.items())

    def _write(self, request: Record, function: int, table: str, start: int, numbers: Iterable[int]) -> bool:
        given = dict(enumerate(numbers, start))
        if not given:
            self._refuse(request, function, "value")
        elif not self.writable[table].issuperset(given):
            self._refuse(request, function, "address")
        elif "busy" in self.active_faults:
            self._refuse(request, function, "busy")
        else:
            self.numbers[table] |= given
            for register in self.table.values():
                if register.entry.table == table and not given.keys().isdisjoint(register.addresses):
                    self.was_set(register.name)
            return True
        return False

    def was_set(self, name: str) -> None:
        """React to a register that has been written."""
        if self.changed is not None:
            self.changed(name, self.take(name))

    def _refuse(self, request: Record, function: int, reason: str) -> None:
        self.counts["refusals"] = self.counts["refusals"] + 1 & 0xFFFF
        self._answer(request, "Refusal", function=function, reason=reason)

    def _answer(self, request: Record, message: str, **fields: Any) -> None:
        if request.unit != 0:  # a broadcast has no answer
            self.reply(message, **fields)
