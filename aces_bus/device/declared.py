"""What a driver declares of its device: what is asked again and again, and which fields of messages are which quantities."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ..protocol import Record
from ..protocol.record import FieldValue


@dataclass(frozen=True)
class Poll:
    """What is asked again and again: `message` with `fields`, answered by one of `reply`.

    `every_s` None: in each tick of the host. `timeout_s` counts from the end of the request on the wire. `asked_by`:
    set-points that are answered, too, and by which message: in a tick that sends one, this is not sent besides. `together`
    is the message that asks several devices for the same at once (`Device.packet_together`); empty: there is none.
    """

    message: str
    reply: str | tuple[str, ...]
    fields: Mapping[str, Any] = field(default_factory=dict[str, Any])
    every_s: float | None = None
    timeout_s: float = 0.05
    asked_by: Mapping[str, str] = field(default_factory=dict[str, str])
    together: str = ""

    @property
    def replies(self) -> frozenset[str]:
        """The names of the messages that answer."""
        return frozenset((self.reply,) if isinstance(self.reply, str) else self.reply)


@dataclass(frozen=True)
class SignalSpec:
    """A quantity as a driver declares it: `signal("speed", unit="rad/s", of="State.speed")`.

    It is read from the field `of` and set through the field `set` ("Message.field" or "Message.field.1"). `unit` is SI;
    SI = field × `scale` + `offset`. `lower` and `upper` limit what is set, in SI. `stale_s` is how old a value may be
    (default: five polls, at least 0.1 s).
    """

    name: str
    unit: str = field(default="", kw_only=True)
    of: str | None = field(default=None, kw_only=True)
    set: str | None = field(default=None, kw_only=True)
    scale: float = field(default=1, kw_only=True)
    offset: float = field(default=0, kw_only=True)
    lower: float | None = field(default=None, kw_only=True)
    upper: float | None = field(default=None, kw_only=True)
    stale_s: float | None = field(default=None, kw_only=True)
    doc: str = field(default="", kw_only=True)
    source: str = field(default="", kw_only=True)


signal = SignalSpec


def same(value: FieldValue) -> Any:
    """Return a number in the sheet's unit that is SI already."""
    return value


def slot_of(path: str) -> tuple[str, str, int | None]:
    """Split `position.1` into field and place; the place is None for the field itself."""
    name, _, index = path.partition(".")
    return path, name, int(index) if index else None


def field_reader(path: str, to_si: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return the value at `position.1` of a record, converted; None where the record has none."""
    name, _, index = path.partition(".")
    if not index:
        if to_si is same:
            return lambda record: getattr(record, name)

        def plain(record: Record) -> Any:
            value = getattr(record, name)
            return None if value is None else to_si(value)

        return plain
    if not index.isdigit():
        inner = field_reader(index, to_si)
        return lambda record: inner(getattr(record, name))
    number = int(index)
    return lambda record: to_si(getattr(record, name)[number])
