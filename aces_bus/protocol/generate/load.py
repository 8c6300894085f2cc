"""Decode functions, record types and readers of lists: printed from plans, compiled when they are first asked for."""

from __future__ import annotations

import keyword
import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, TypeVar

import msgspec
from construct import ConstructError

from ...errors import AcesError
from ..declare.delimited import degrees
from ..declare.fields import FlagSet
from ..declare.message import Message
from ..declare.packet import key_image
from ..declare.protocol import Variant
from ..declare.shapes import has_shapes
from ..plan import nodes as p
from ..plan.flatten import NotFlat
from ..record import Part, Record, from_container, plain_value
from .decode import CALLED, Decoder, ListDecoder
from .source import NameScope, SourceText, comment_line
from .source import load_source as load_source

#: What the text of record classes calls.
CALLED_BY_RECORDS = ("Record", "Part", "FlagSet", "Any")

#: What every record keeps of the transport (see `aces_bus.protocol.record`).
PRIVATE = (
    ("_time", "float | None"),
    ("_channel", "str | None"),
    ("_key", "int"),
    ("_raw", "bytes"),
    ("_rx", "bool | None"),
)


def type_of(node: p.Node, *, raw: bool = False, called: Callable[[str], str] = str) -> str:
    """Return the Python type of a node's value, for annotations and stubs; `called` is how the text names a nested
    record.
    """
    return node.shaped(_Types(raw, called))


@dataclass(frozen=True)
class _Types:
    """Annotations of values, by their shape."""

    raw: bool
    called: Callable[[str], str]

    def single(self, node: p.Node) -> str:
        return node.python_type(raw=self.raw)

    def several(self, node: p.Node, items: Sequence[p.Node]) -> str:
        kinds = [item.shaped(self) for item in items]
        return f"tuple[{', '.join(kinds)}]" if kinds else "tuple[()]"

    def record(self, node: p.Node, type_name: str, fields: Sequence[p.PlanField]) -> str:
        return self.called(type_name)

    def each(self, node: p.Node, item: p.Node) -> str:
        return f"tuple[{item.shaped(self)}, ...]"

    def tagged(self, node: p.Node, type_name: str, kinds: Sequence[p.ItemKind]) -> str:
        return f"tuple[{self.called(type_name)}, ...]" if type_name else "Any"


def part_names(plan: p.MessagePlan) -> list[str]:
    """Names of the nested records of an opaque message: their path, numbered where one path has several shapes."""
    paths = [path for path, _ in plan.parts]
    names: list[str] = []
    for n, path in enumerate(paths):
        name = path if paths.count(path) == 1 else f"{path}_{paths[:n].count(path)}"
        # A field may be called what a numbered path is called.
        while name in names or (name != path and name in paths):
            name += "_"
        names.append(name)
    return names


def print_records(
    label: str, plans: Sequence[p.MessagePlan], types: dict[tuple[str, str], str] | None = None
) -> str:
    """Return the record classes of some messages of a variant.

    `types` is given the text's name of each class, by message and the class's own name.
    """
    out = SourceText()
    names = NameScope(CALLED_BY_RECORDS)
    types = {} if types is None else types
    out.lines(
        f'"""Records of {comment_line(label)}: generated from its spec."""',
        "",
    )
    for plan in plans:
        for group in p.nested_records(plan.fields):
            name = types[plan.name, group.type_name] = names.new(group.type_name)
            out.line(f"class {name}(Part, frozen=True, gc=False):")
            out.depth += 1
            for field in group.fields:
                _annotate(out, field, plan, types)
            if not group.fields:
                out.line("pass")
            out.depth -= 1
            out.line()
        for part, (_, fields) in zip(part_names(plan), plan.parts, strict=True):
            name = types[plan.name, part] = names.new(part)
            out.line(f"class {name}(Part, frozen=True, gc=False):")
            for field_name in fields:
                out.line(f"    {field_name}: Any")
            if not fields:
                out.line("    pass")
            out.line()
        name = types[plan.name, plan.name] = names.new(plan.name)
        out.line(f"class {name}(Record, frozen=True, gc=False):")
        out.depth += 1
        out.lines(
            f'"""{comment_line(plan.doc) or plan.name}"""',
            "",
        )
        for field in plan.fields:
            _annotate(out, field, plan, types)
        for private, kind in PRIVATE:
            out.line(f"{private}: {kind}")
        out.depth -= 1
        out.line()
    return out.text()


def _annotate(
    out: SourceText, field: p.PlanField, plan: p.MessagePlan, types: dict[tuple[str, str], str]
) -> None:
    kind = type_of(field.node, called=lambda name: types[plan.name, name])
    if field.when is not None and not kind.endswith("None"):
        kind += " | None"
    out.line(f"{field.name}: {kind}")


# ---------------------------------------------------------------------- decoders and readers


Decode = Callable[..., Any]
K = TypeVar("K")
V = TypeVar("V")


@cache
def flag_type(bits: tuple[tuple[str, int], ...]) -> type[FlagSet]:
    """Return the value type of a flags field."""
    return type("FlagSet", (FlagSet,), {"bits": dict(bits), "__slots__": ()})


class OnDemand(dict[K, V]):
    """Values made when they are first asked for; `most` of them are kept (None: all)."""

    def __init__(
        self, make: Callable[[K], V], given: Mapping[K, V] | None = None, most: int | None = None
    ) -> None:
        super().__init__(given or {})
        self._make, self._most = make, most

    def __missing__(self, key: K) -> V:
        made = self._make(key)
        if self._most is None or len(self) < self._most:
            self[key] = made
        return made


def _flags(bits: Mapping[str, int]) -> OnDemand[int, FlagSet]:
    """Return what generated decoders call for the values of a flags field."""
    return OnDemand(flag_type(tuple(bits.items())), most=4096)


#: What printed decoders call (see `decode.CALLED`).
_CALLED: Mapping[str, Any] = {
    "Struct": struct.Struct,
    "from_bytes": int.from_bytes,
    "re": re,
    "degrees": degrees,
    "flags": _flags,
}


def _part_type(shape: tuple[str, tuple[str, ...]]) -> type:
    """Return the type of a nested record, by path and fields, that no walk of a construct foresees (fields that stop
    half way, values of a user's adapter)."""
    path, names = shape
    if not all(name.isidentifier() and not keyword.iskeyword(name) for name in names):
        return dict  # keys that cannot be attributes
    made: type = msgspec.defstruct(path, names, bases=(Part,), frozen=True, gc=False)
    return made


@cache
def decoders_of(variant: Variant, raw: bool = False, guard: bool = True) -> Mapping[str, Decode]:
    """Return the decode functions of a variant by message, in physical units or raw; each is made when it is first
    asked for.

    Without `guard` a function may raise `struct.error` for data of the wrong length, where it would give None.
    """
    label = f"aces {variant.label} {'raw ' if raw else ''}{'' if guard else 'quick '}decoders"

    def made(name: str) -> Decode:
        message = variant.messages[name]
        types = _types(variant)[name]
        printed, source = _printed(message, types, raw=raw, guard=guard)
        names = {**_CALLED, **printed.module.bound}
        names |= {called: types[kind] for called, kind in printed.types.items()}
        if printed.opaque:
            names[printed.opaque] = _opaque(message, variant, raw=raw)
        if printed.holds:
            names[printed.holds] = _holds(message)
        decode: Decode = load_source(source, f"{label}: {name}", names)[printed.function]
        return decode

    return OnDemand(made)


def _printed(message: Message, types: Mapping[str, Any], *, raw: bool, guard: bool) -> tuple[Decoder, str]:
    """Return the printer of a message's decode function, and the text."""
    if has_shapes(message):
        from .shapes import ByBitsDecoder

        with suppress(NotFlat):
            by_bits = ByBitsDecoder(message, raw=raw)
            source = print_decoder(by_bits)
            if all(kind in types for kind in by_bits.types.values()):
                return by_bits, source
    printed = Decoder(message.plan, raw=raw, guard=guard)
    return printed, print_decoder(printed)


def _holds(message: Message) -> Callable[[bytes, int], bool]:
    """Return whether the message's own check holds."""
    check = message.check
    assert check is not None
    start, size, order = message.check_span
    end = start + size

    def holds(data: bytes, key: int) -> bool:
        return int.from_bytes(data[start:end], order) == check.compute(
            message.covered(data, key & 0x1FFF_FFFF)
        )

    return holds


def print_decoder(printed: Decoder) -> str:
    """Return the text of one message's decode function."""
    setup, lines = printed.print()
    return "\n".join([*setup, "", *lines, ""])


def print_decoders(variant: Variant, *, raw: bool = False, guard: bool = True) -> str:
    """Return the decode functions of a variant."""
    kind = "raw values" if raw else "physical values"
    parts = [f'"""Decoders of {comment_line(variant.label)}, {kind}: generated from its spec."""', ""]
    names = NameScope(CALLED)
    for message in variant.messages.values():
        setup, lines = Decoder(message.plan, raw=raw, guard=guard, names=names).print()
        parts += [*setup, "", *lines, ""] if setup else ["", *lines, ""]
    return "\n".join(parts) + "\n"


def _made_types(variant: Variant, name: str) -> dict[str, Any]:
    """Return the record type of a message and those of its nested records, by their names."""
    message = variant.messages[name]
    called: dict[tuple[str, str], str] = {}
    label = f"{variant.label}: {name}"
    source = print_records(label, [message.plan], called)
    space = load_source(
        source,
        f"aces records of {label}",
        {"Record": Record, "Part": Part, "FlagSet": FlagSet, "Any": Any},
    )
    made: dict[str, Any] = {}
    for (_, own), text in called.items():
        kind = made[own] = space[text]
        kind.__name__ = kind.__qualname__ = own
    made[name]._protocol = variant.name
    made[name]._direction = message.direction
    made[name]._is_stream = message.framing is not None
    made[name]._declared = message
    return made


@cache
def _types(variant: Variant) -> OnDemand[str, dict[str, Any]]:
    return OnDemand(partial(_made_types, variant))


@cache
def list_reader(node: p.ListNode, name: str, raw: bool = False) -> Callable[[bytes, int, int], list[Any]]:
    """Return a function from a packet's bytes, and where in them a list of items begins and ends, to the items as
    plain values; `name` is that of the message."""
    printed = ListDecoder(node, name, raw=raw)
    function = printed.print()
    fields = {
        record.type_name: [f.name for f in record.fields]
        for record in p.nested_records([p.PlanField("items", node)])
    }
    names = {**_CALLED, **printed.names.bound}
    names |= {called: partial(_plain_part, fields[kind]) for called, kind in printed.types.items()}
    read = load_source("\n".join(printed.setup), f"aces {'raw ' if raw else ''}items of {name}", names)[
        function
    ]
    return lambda data, at, end: plain_value(read(data, at, end))


def _plain_part(names: Sequence[str], *values: Any) -> dict[str, Any]:
    return dict(zip(names, values, strict=True))


class _Records(Mapping[str, type[Record]]):
    def __init__(self, variant: Variant) -> None:
        self._variant = variant

    def __getitem__(self, name: str) -> type[Record]:
        if name not in self._variant.messages:
            raise KeyError(name)
        found: type[Record] = _types(self._variant)[name][name]
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._variant.messages)

    def __len__(self) -> int:
        return len(self._variant.messages)


def records_of(variant: Variant) -> Mapping[str, type[Record]]:
    """Return the record types of a variant, by message; each is made when it is first asked for."""
    return _Records(variant)


def _opaque(message: Message, variant: Variant, *, raw: bool) -> Decode:
    """Return a decode function that goes through construct."""
    types = _types(variant)[message.name]
    plan = message.plan
    given = {shape: types[name] for name, shape in zip(part_names(plan), plan.parts, strict=True)}
    parts = OnDemand(_part_type, given, most=4096)
    record = types[message.name]
    framing = message.framing

    def decode(
        data: bytes,
        key: int,
        time: float | None,
        channel: str | int | None,
        raw_bytes: bytes,
        rx: bool | None,
        request: Any = None,
    ) -> Any:
        if framing is None:
            image = key_image(key, data)
        else:
            # Stuffed packets come here without stuffing; construct wants what was on the wire.
            image = raw_bytes
        try:
            values = message.struct.parse(image, raw=raw, request=request)
        except (ConstructError, AcesError):
            return None
        fields = {k: from_container(v, parts, f"{message.name}_{k}") for k, v in values.items()}
        return record(**fields, _time=time, _channel=channel, _key=key, _raw=raw_bytes, _rx=rx)

    return decode
