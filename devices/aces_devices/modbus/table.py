"""A device's registers as a table, from a robot's file or a TOML file of its own, and what its numbers mean.

A register has 16 bits, a number as many registers as it takes; the rest is as `aces_devices.tables` says.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from aces_bus.errors import CallerError
from aces_devices.tables import NUMBERS, data_of, entries_of, value_of

#: The four tables of a device → the function that reads them.
READERS = {"coil": 1, "input_bit": 2, "holding": 3, "input": 4}
#: What one request reads at most.
MOST_REGISTERS, MOST_BITS = 125, 2000


class RegisterEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One register, or as many as its type takes; or a bit."""

    address: Annotated[int, Meta(ge=0, le=0xFFFF)]
    type: Literal["u16", "s16", "u32", "s32", "u64", "s64", "float", "double", "text", "bit"]
    table: Literal["holding", "input", "coil", "input_bit"] = "holding"
    access: Literal["read", "read-write", "write"] = "read"
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    #: Limits of what is set, in `unit`.
    lower: float | None = None
    upper: float | None = None
    #: Of a text: how many registers it takes, two characters each.
    count: Annotated[int, Meta(ge=1, le=MOST_REGISTERS)] = 1
    words: Literal["high first", "low first"] = "high first"
    bytes: Literal["high first", "low first"] = "high first"
    #: How often it is read (s), where that is not the device's `every_s`; 0: once, when the bus is opened.
    every_s: Annotated[float, Meta(ge=0)] | None = None
    doc: str = ""
    source: str = ""


class ModbusRegister:
    """A register of a device: its place, and its value as the 16-bit numbers on the wire."""

    def __init__(self, name: str, entry: RegisterEntry) -> None:
        self.name, self.entry = name, entry
        self.is_bit = entry.type == "bit"
        if self.is_bit != (entry.table in ("coil", "input_bit")):
            raise CallerError(
                f"register {name}: a bit is in the table 'coil' or 'input_bit', all else in 'holding' or 'input'"
            )
        if entry.access != "read" and entry.table in ("input", "input_bit"):
            raise CallerError(f"register {name}: what is in the table {entry.table!r} can only be read")
        if not entry.scale:
            raise CallerError(f"register {name}: a scale of 0 leaves no value")
        code = NUMBERS.get(entry.type, "")
        self.size = struct.calcsize(f">{code}") // 2 if code else 1 if self.is_bit else entry.count
        if entry.address + self.size > 0x10000:
            raise CallerError(
                f"register {name}: {self.size} registers from {entry.address} on end beyond 65,535"
            )
        self.addresses = range(entry.address, entry.address + self.size)

    def value(self, raw: Sequence[int]) -> Any:
        """Return the value of these registers (or of this bit)."""
        if self.is_bit:
            return bool(raw[0])
        data = struct.pack(f">{len(raw)}H", *self._ordered(raw))
        return value_of(data, self.entry.type, self.entry.scale, self.entry.offset)

    def raw(self, value: Any) -> tuple[int, ...]:
        """Return the registers of a value. Raises `CallerError` for one that does not fit."""
        entry = self.entry
        if self.is_bit:
            if value not in (0, 1):
                raise CallerError(f"register {self.name}: a bit is true or false, not {value!r}")
            return (int(value),)
        what = f"register {self.name}"
        data = data_of(what, value, entry.type, 2 * self.size, entry.scale, entry.offset, entry.unit)
        return self.registers(data)

    def registers(self, data: bytes) -> tuple[int, ...]:
        """Return the registers of a value's bytes, the high one first."""
        return self._ordered(struct.unpack(f">{self.size}H", data))

    def _ordered(self, raw: Sequence[int]) -> tuple[int, ...]:
        """Reverse the order of words and bytes where the table says so; the function undoes itself."""
        words = tuple(raw) if self.entry.words == "high first" else tuple(reversed(raw))
        if self.entry.bytes == "high first":
            return words
        return tuple((word & 0xFF) << 8 | word >> 8 for word in words)


def registers_of(who: str, table: str | None, own: Mapping[str, Any]) -> dict[str, ModbusRegister]:
    """Return the registers of a shipped table or a TOML file, and of a device's own entries, which go before.

    Raises `CallerError` naming the register and what is wrong.
    """
    entries = entries_of(who, "registers", table, own, files("aces_devices.modbus") / "tables")
    found: dict[str, ModbusRegister] = {}
    for name, entry in entries.items():
        try:
            found[name] = ModbusRegister(name, msgspec.convert(entry, RegisterEntry))
        except (msgspec.ValidationError, CallerError) as error:
            text = str(error).removeprefix(f"register {name}: ")
            raise CallerError(f"{who}: register {name}: {text}") from None
    return found


def stretches(registers: Iterable[ModbusRegister]) -> list[tuple[str, int, int]]:
    """Return table, first address and number of what one request each reads: neighbours together, and nothing
    between.

    >>> at = lambda name, address, kind="u16": ModbusRegister(name, RegisterEntry(address=address, type=kind))
    >>> stretches([at("c", 9), at("a", 0, "float"), at("b", 2)])
    [('holding', 0, 3), ('holding', 9, 1)]
    """
    found: list[tuple[str, int, int]] = []
    for register in sorted(registers, key=lambda register: (register.entry.table, register.entry.address)):
        table, first, end = register.entry.table, register.addresses.start, register.addresses.stop
        most = MOST_BITS if register.is_bit else MOST_REGISTERS
        if (
            found
            and found[-1][0] == table
            and first <= found[-1][1] + found[-1][2]
            and end - found[-1][1] <= most
        ):
            end = max(end, found[-1][1] + found[-1][2])
            found[-1] = (table, found[-1][1], end - found[-1][1])
        else:
            found.append((table, first, end - first))
    return found


def bits_from(data: bytes, count: int) -> list[int]:
    """Unpack bits as Modbus packs them: the first is the lowest of the first byte.

    >>> bits_from(bytes.fromhex("CD01"), 10)
    [1, 0, 1, 1, 0, 0, 1, 1, 1, 0]
    """
    return [data[at // 8] >> at % 8 & 1 for at in range(count)]


def bytes_from(bits: Sequence[int]) -> bytes:
    """Return the bytes of bits.

    >>> bytes_from([1, 0, 1, 1, 0, 0, 1, 1, 1, 0]).hex()
    'cd01'
    """
    return bytes(
        sum(bit << place for place, bit in enumerate(bits[at : at + 8])) for at in range(0, len(bits), 8)
    )
