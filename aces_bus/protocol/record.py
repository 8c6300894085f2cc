"""What scanners give: records, and `Unknown` for what is not a message.

1. A record is immutable. Its fields are attributes; everything of the transport is under `meta`.
2. Making one costs as little as Python allows: `meta` is put together when it is asked for.

Every record ends with five private fields: `_time`, `_channel`, `_key` (the CAN identifier with the flags of
`aces_bus.frames`; of a stream the packet's offset), `_raw` and `_rx`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from decimal import Decimal
from math import isfinite
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

import msgspec

from ..frames import EXTENDED, FD, REMOTE


class Meta(msgspec.Struct, frozen=True, gc=False):
    """The transport's side of a record.

    `time` is in seconds, as the capture or the adapter has it, None when unknown. `offset` and `size` are in bytes and
    only of streams; `identifier`, `extended` and `fd` only of CAN. `direction` is "to device", "from device" or None.
    `raw` are the data bytes (CAN) or the packet as it was on the wire (streams). Of a packet that a transport carried in
    several frames, `raw` are its bytes, `time` is that of its last frame, `first_time` that of its first one, and `frames`
    are the data of each.
    """

    protocol: str | None
    message: str | None
    time: float | None
    channel: str | None
    direction: str | None
    raw: bytes
    identifier: int | None = None
    extended: bool = False
    fd: bool = False
    remote: bool = False
    is_rx: bool | None = None
    offset: int | None = None
    size: int | None = None
    first_time: float | None = None
    frames: tuple[bytes, ...] = ()

    @property
    def time_ns(self) -> int | None:
        """The same instant in integer nanoseconds, exactly as the decimal digits of `time` say; None where it has none."""
        if self.time is None or not isfinite(self.time):
            return None
        return int(Decimal(repr(float(self.time))).scaleb(9))


class CarriedBytes(bytes):
    """The bytes of a packet that a transport carried, with the data of its frames and the time of the first one."""

    frames: tuple[bytes, ...]
    first_time: float | None

    @classmethod
    def of(cls, data: bytes, frames: Sequence[bytes], first_time: float | None) -> CarriedBytes:
        """Return the bytes with what they came in."""
        made = cls(data)
        made.frames, made.first_time = tuple(frames), first_time
        return made


class Record(msgspec.Struct, frozen=True, gc=False):
    """The base of all records; one subclass a message is generated from its plan."""

    _protocol: ClassVar[str] = ""
    _direction: ClassVar[str | None] = None
    _is_stream: ClassVar[bool] = False
    #: The message (`declare.message`) it is a record of; Any, as signatures of records are evaluated here.
    _declared: ClassVar[Any]

    if TYPE_CHECKING:
        # A checker sees what every record has; a message's own fields it knows from the types that `aces spec stubs` writes.
        def __getattr__(self, name: str) -> Any: ...

    @property
    def meta(self) -> Meta:
        """Time, channel, identifier or offset, raw bytes: see `Meta`."""
        kind = type(self)
        head = (kind._protocol, kind.__name__, self._time, self._channel, kind._direction, self._raw)
        key: int = self._key
        is_rx: bool | None = self._rx
        if kind._is_stream:
            return Meta(*head, is_rx=is_rx, offset=key, size=len(head[-1]))
        flags = (key & 0x1FFF_FFFF, bool(key & EXTENDED), bool(key & FD), bool(key & REMOTE), is_rx)
        raw = head[-1]
        if isinstance(raw, CarriedBytes):
            return Meta(*head[:-1], bytes(raw), *flags, first_time=raw.first_time, frames=raw.frames)
        return Meta(*head, *flags)

    def __repr__(self) -> str:
        inside = ", ".join(f"{name}={getattr(self, name)!r}" for name in field_names(type(self)))
        return f"{type(self).__name__}({inside})"


class Part(msgspec.Struct, frozen=True, gc=False):
    """The base of nested records."""


class Unknown(Record, frozen=True, gc=False):
    """A record of bytes or of a frame that no message claims, with the reason: nothing vanishes.

    `reason` is "unknown", "unknown: needs request A|B", "malformed: <why>", "skipped", "pending", "error frame" or, of a
    frame that only steers a transport, "control: <what>".
    """

    reason: str
    meta: Meta  # pyright: ignore[reportIncompatibleMethodOverride]  # a field, as it is at hand

    if TYPE_CHECKING:
        __getattr__: ClassVar[None]  # type: ignore[assignment,misc]  # it has no other fields

    @property
    def kind(self) -> str:
        """The bin of the accounting that this falls into."""
        return "errors" if self.reason == "error frame" else self.reason.partition(":")[0]

    def __repr__(self) -> str:
        return f"Unknown(reason={self.reason!r}, raw={self.meta.raw.hex()})"


#: What a field may be given: a number, a name of an enumeration, names of flags, text, bytes, a list, a group of fields;
#: None where it is not known.
FieldValue: TypeAlias = (
    "float | str | bytes | Part | AbstractSet[int | str] | Values | Mapping[str, FieldValue] | None"
)
Values: TypeAlias = "Sequence[FieldValue]"


#: A value of a record as JSON has it: bytes stay bytes.
PlainValue: TypeAlias = "float | str | bytes | Sequence[PlainValue] | Mapping[str, PlainValue] | None"


def protocol_name_of(kind: type[Record]) -> str:
    """Return the name of the protocol whose records these are; empty of `Unknown`."""
    return kind._protocol  # pyright: ignore[reportPrivateUsage]  # private, as a message may have a field "protocol"


def field_names(kind: type[msgspec.Struct]) -> tuple[str, ...]:
    """Return the names of a record type's fields."""
    return tuple(name for name in kind.__struct_fields__ if not name.startswith("_"))


def as_dict(record: msgspec.Struct) -> dict[str, Any]:
    """Return a record's fields as plain values: nested records as dicts, tuples as lists."""
    return {name: plain_value(getattr(record, name)) for name in field_names(type(record))}


def plain_value(value: Any) -> Any:
    """Return a value of a record or of a construct: nested records and containers as dicts of their fields, tuples as
    lists.
    """
    if isinstance(value, msgspec.Struct):
        return as_dict(value)
    if isinstance(value, Mapping):
        return {str(name): plain_value(item) for name, item in value.items() if not str(name).startswith("_")}
    if isinstance(value, (tuple, list)):
        return [plain_value(item) for item in value]
    return value


class FirstOf(NamedTuple):
    """A step into a list of tagged items: to the first good item of a kind, by its name or (raw) its number."""

    name: str
    number: int


class Held(NamedTuple):
    """A step into a list of items whose data hold values by name: to the first of this name in a good item."""

    name: str


class _Each:
    """A step into a list of groups: to every one of them."""

    def __repr__(self) -> str:
        return "EACH"


EACH = _Each()
WayStep = str | int | FirstOf | Held | _Each


def getter(way: Sequence[WayStep]) -> Callable[[Any], Any]:
    """Return a function that reads the value at the end of `way` in a record; None where a part of the way is not there."""
    if len(way) == 1 and isinstance(way[0], str):
        return attrgetter(way[0])
    return _walker(way)


def _walker(way: Sequence[WayStep]) -> Callable[[Any], Any]:
    if EACH in way:
        place = way.index(EACH)
        outer, inner = _walker(way[:place]), _walker(way[place + 1 :])
        return lambda record: None if (items := outer(record)) is None else tuple(map(inner, items))

    def get(value: Any) -> Any:
        for step in way:
            if value is None:
                return None
            if isinstance(step, FirstOf):
                good = (item for item in value if _part(item, "reason") is None)
                value = next((item for item in good if _part(item, "kind") in step), None)
            elif isinstance(step, Held):
                data = (_part(item, "data") for item in value if _part(item, "reason") is None)
                held = (
                    _part(part, step.name) for part in data if isinstance(part, (Mapping, msgspec.Struct))
                )
                value = next((part for part in held if part is not None), None)
            elif isinstance(step, int):
                value = value[step] if isinstance(value, (tuple, list)) and step < len(value) else None
            else:
                value = _part(value, str(step))
        return value

    return get


def _part(value: Any, name: str) -> Any:
    """Return a field of a nested record or of a container; None where it has none."""
    return value.get(name) if isinstance(value, Mapping) else getattr(value, name, None)


def from_container(value: FieldValue, types: Mapping[tuple[str, tuple[str, ...]], type], path: str) -> Any:
    """Return what construct parsed, as records have it: containers become nested records, lists tuples."""
    if isinstance(value, dict):
        inside = {
            str(k): from_container(v, types, f"{path}_{k}")
            for k, v in value.items()
            if not str(k).startswith("_")
        }
        return types[path, tuple(inside)](**inside)
    if isinstance(value, list):
        return tuple(from_container(item, types, path) for item in value)
    return value
