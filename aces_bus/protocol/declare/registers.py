"""Register maps: a device's memory as named, typed registers, and the messages that read and write it.

1. A register is declared once: address, type, access, unit; reading and writing are derived from it.
2. Registers never overlap.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import construct as c
import msgspec

from ...errors import FieldError, SpecError, UnknownNameError
from ..record import FieldValue
from .fields import Quantity
from .normalise import normalised_field
from .place import SourceLine, caller

if TYPE_CHECKING:
    from .message import Message
    from .protocol import DeclaredProtocol

Access = Literal["read", "write", "read-write"]


class Register(msgspec.Struct, frozen=True):
    """One register. `size` is in bytes; `field` is the construct of its value; `default` is raw, None when unknown."""

    name: str
    address: int
    size: int
    field: c.Construct
    access: Access
    unit: str
    doc: str
    source: str
    default: int | None
    place: SourceLine

    def decode(self, data: bytes, *, raw: bool = False) -> Any:
        """Return the value in `size` bytes."""
        return self.field.parse(data, raw=raw)

    def encode(self, value: Any, *, raw: bool = False) -> bytes:
        """Return the bytes of a value; raises `FieldError` when it does not fit or the register cannot be written."""
        try:
            return bytes(self.field.build(value, raw=raw))
        except FieldError as error:
            raise FieldError(f"register {self.name}{str(error).replace('(building)', '')}") from None
        except c.ConstructError as error:
            raise FieldError(f"register {self.name}: {' '.join(str(error).split())}") from None


class RegisterMap(Mapping[str, Register]):
    """The registers of a device, by name.

    `read`, `write` and `sync` name the messages that carry them: `read` has the fields (id, start, count), `write`
    (id, start, data), `sync` (start, size, servos). `reply` is what answers `read`, as "MESSAGE.FIELD" with the field
    that holds the bytes.
    """

    def __init__(
        self,
        protocol: DeclaredProtocol,
        *,
        read: str | Message,
        write: str | Message,
        sync: str | Message | None = None,
        reply: str = "",
        doc: str = "",
    ) -> None:
        self.protocol = protocol
        self.place = caller()
        self.read_message, self.write_message, self.sync_message = (
            self._name(m) for m in (read, write, sync)
        )
        #: What answers `read`, and its field with the bytes; empty where that was not said.
        self.reply_message, self.reply_field = self._reply(reply)
        self.doc = doc
        self._registers: dict[str, Register] = {}

    def _name(self, message: str | Message | None) -> str | None:
        if message is None:
            return None
        name = message if isinstance(message, str) else message.name
        if name not in self.protocol.messages:
            raise SpecError(
                f"{self.place}: no message named {name!r} (there are: {', '.join(self.protocol.messages)})"
            )
        return name

    def _reply(self, reply: str) -> tuple[str, str]:
        message, _, field = reply.partition(".")
        if reply and field not in self.protocol.messages[self._name(message) or ""].fields:
            raise SpecError(f"{self.place}: reply={reply!r} names no field of a message; write 'Status.data'")
        return message, field

    def add(
        self,
        name: str,
        address: int,
        field: c.Construct,
        *,
        unit: str = "",
        scale: float = 1,
        offset: float = 0,
        range: tuple[int, int] | None = None,
        access: Access = "read-write",
        default: int | None = None,
        doc: str = "",
        source: str = "",
    ) -> Register:
        """Declare a register; `range` is of raw values. Raises `SpecError` when it overlaps another."""
        place = caller()
        field = normalised_field(field, place, name)
        size = int(field.sizeof())
        for other in self._registers.values():
            if other.name == name:
                raise SpecError(
                    f"{place}: register {name!r} is declared twice; the other is at {other.place}"
                )
            if address < other.address + other.size and other.address < address + size:
                raise SpecError(
                    f"{place}: register {name!r} (address {address:#04x}, {size} bytes) overlaps {other.name!r}"
                    f" ({other.address:#04x}, {other.size} bytes) at {other.place}"
                )
        if unit or scale != 1 or offset or range is not None:
            field = Quantity(field, unit=unit, scale=scale, offset=offset, raw_range=range)
        made = Register(name, address, size, field, access, unit, doc, source, default, place)
        self._registers[name] = made
        return made

    def __getitem__(self, name: str) -> Register:
        try:
            return self._registers[name]
        except KeyError:
            raise UnknownNameError(f"register of {self.protocol.name}", name, self._registers) from None

    def __contains__(self, name: object) -> bool:
        return name in self._registers

    def __iter__(self) -> Iterator[str]:
        return iter(self._registers)

    def __len__(self) -> int:
        return len(self._registers)

    # ------------------------------------------------------------------ derived messages

    def read(self, id: int, first: str, last: str | None = None) -> bytes:
        """Return the packet that asks device `id` for the registers from `first` to `last`."""
        one, other = self[first], self[last or first]
        count = other.address + other.size - one.address
        if count <= 0:
            raise FieldError(f"register {other.name} comes before {one.name}")
        assert self.read_message is not None
        return bytes(self.protocol.encode(self.read_message, id=id, start=one.address, count=count))

    def write(self, id: int, values: Mapping[str, Any], *, message: str | None = None) -> bytes:
        """Return the packet that writes registers that stand side by side; errors are those of `stretch`."""
        start, data = self.stretch(values)
        name = message or self.write_message
        assert name is not None
        return bytes(self.protocol.encode(name, id=id, start=start, data=data))

    def stretch(self, values: Mapping[str, FieldValue]) -> tuple[int, bytes]:
        """Return the first address and the bytes of registers that stand side by side, by name.

        Raises `UnknownNameError`, and `FieldError` for one that can only be read, for values that do not fit and for gaps.
        """
        chosen = sorted((self[name] for name in values), key=lambda r: r.address)
        data = b""
        for register in chosen:
            if register.access == "read":
                raise FieldError(f"register {register.name} can only be read")
            if register.address != chosen[0].address + len(data):
                raise FieldError(
                    f"registers {', '.join(r.name for r in chosen)} do not stand side by side; write them one by one"
                )
            data += register.encode(values[register.name])
        return chosen[0].address, data

    def sync_write(self, name: str, values: Mapping[int, Any]) -> bytes:
        """Return one packet that writes the register `name` of many devices: id → value."""
        register = self[name]
        if self.sync_message is None:
            raise SpecError(f"{self.place}: {self.protocol.name} has no message that writes to many devices")
        servos = [{"id": id, "data": register.encode(value)} for id, value in values.items()]
        return bytes(
            self.protocol.encode(self.sync_message, start=register.address, size=register.size, servos=servos)
        )

    def decode(self, start: int, data: bytes, *, raw: bool = False) -> dict[str, Any]:
        """Return the whole registers among `data` read from address `start`, by name."""
        found = {}
        for register in self._in_order:
            at = register.address - start
            if at >= 0 and at + register.size <= len(data):
                found[register.name] = register.decode(data[at : at + register.size], raw=raw)
        return found

    @property
    def _in_order(self) -> Sequence[Register]:
        return sorted(self._registers.values(), key=lambda r: r.address)
