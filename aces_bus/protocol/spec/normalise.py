"""What a spec wrote, brought into the few shapes that everything else handles.

1. construct's own `Enum`, `FlagsEnum` and `Flag` become ours, which know raw mode; a `Switch` over an enumeration chooses
   by name and by number, as the latter is what raw mode has. Nothing else changes meaning.
2. Whatever would lose bytes (unnamed padding, seeking, ignored tails) or hide them is refused here, with its line.
"""

from __future__ import annotations

import io
import keyword
import unicodedata
from collections.abc import Mapping
from typing import Any

import construct as c

from ...errors import SpecError
from .bits import BitLayout
from .delimited import Delimited
from .fields import Enumeration, Field, Flags, Multiplexed
from .head import enumeration_of
from .place import Place

_REFUSED = (
    c.Padded,
    c.Aligned,
    c.Pointer,
    c.Peek,
    c.Seek,
    c.Tell.__class__,
    c.RawCopy,
    c.Union,
    c.Select,
    c.Computed,
    c.Probe,
)
#: Names that records use themselves.
TAKEN = frozenset({"meta"})


def normalised(payload: c.Construct | None, place: Place) -> c.Construct:
    """The payload as `Struct`, `BitLayout` or `Delimited`, ready to be flattened."""
    if payload is None:
        return c.Struct()
    if isinstance(payload, c.Renamed):
        payload = payload.subcon
    if not isinstance(payload, (c.Struct, BitLayout, Delimited)):
        raise SpecError(
            f"{place}: a payload is a Struct, a BitLayout or a Delimited, not {payload!r}; one field goes into a Struct, too"
        )
    return _walk(payload, place, "payload")


def check_name(name: str, place: Place) -> None:
    """Raise `SpecError` when `name` cannot be an attribute of a record."""
    if not name.isidentifier() or keyword.iskeyword(name) or (keyword.issoftkeyword(name) and name != "type"):
        raise SpecError(
            f"{place.of_field(name)}: {name!r} cannot be a field name: it is not a plain Python name"
        )
    if unicodedata.normalize("NFKC", name) != name:
        raise SpecError(
            f"{place.of_field(name)}: Python reads {name!r} as {unicodedata.normalize('NFKC', name)!r}: write it so"
        )
    if name.startswith("_") or name in TAKEN:
        raise SpecError(f"{place.of_field(name)}: field name {name!r} is taken by the record itself")


def _walk(con: c.Construct, place: Place, path: str) -> Any:
    if isinstance(con, c.Renamed):
        if con.name is None:
            return _walk(con.subcon, place, path)
        check_name(con.name, place)
        return c.Renamed(_walk(con.subcon, place, f"{path}.{con.name}"), newname=con.name, newdocs=con.docs)
    if isinstance(con, c.Enum):
        return Enumeration(
            _walk(con.subcon, place, path), {str(k): int(v) for k, v in con.encmapping.items()}
        )
    if isinstance(con, c.FlagsEnum):
        masks = {str(k): int(v) for k, v in con.flags.items()}
        wide = [k for k, v in masks.items() if v.bit_count() != 1]
        if wide:
            raise SpecError(f"{place}: {path}: flag {wide[0]!r} is not a single bit")
        return Flags(_walk(con.subcon, place, path), {k: v.bit_length() - 1 for k, v in masks.items()})
    if con is c.Flag:
        raise SpecError(
            f"{place}: {path}: Flag loses bits 1…7; use BitLayout(1, … bits(1)) or Enumeration(Byte, off=0, on=1)"
        )
    if isinstance(con, _REFUSED):
        raise SpecError(
            f"{place}: {path}: {type(con).__name__} would skip or repeat bytes; name them, for instance as Reserved(n)"
        )
    if isinstance(con, c.Struct):
        items = []
        seen: dict[str, None] = {}
        enumerations: dict[str, Enumeration] = {}
        for item in con.subcons:
            name = item.name
            inner = item.subcon if isinstance(item, c.Renamed) else item
            if name is None and not isinstance(inner, (c.Const, c.Terminated.__class__)):
                raise SpecError(
                    f"{place}: {path}: {inner!r} has no name, so its bytes would be lost;"
                    ' name it (bytes that mean nothing: "reserved" / Reserved(n)); only a Const may go without'
                )
            if name is not None and name in seen:
                raise SpecError(f"{place.of_field(name)}: field {name!r} is there twice")
            if isinstance(inner, c.Switch):
                inner = _by_both(inner, enumerations)
                item = inner if name is None else c.Renamed(inner, newname=name, newdocs=item.docs)
            made = _walk(item, place, path)
            body = made.subcon if isinstance(made, c.Renamed) else made
            if name is not None:
                seen[name] = None
                found = enumeration_of(body)
                if found is not None:
                    enumerations[name] = found
            if isinstance(body, Multiplexed):
                if body.selector not in seen:
                    raise SpecError(
                        f"{place.of_field(name or '')}: field {name!r} is multiplexed by {body.selector!r},"
                        " which is not before it"
                    )
                body.enumeration = enumerations.get(body.selector)
            items.append(made)
        return c.Struct(*items)
    if isinstance(con, BitLayout):
        names: dict[str, Enumeration] = {}
        known: set[str] = set()
        if con.trailing:
            check_name(con.trailing, place)
        for slot in con.slots:
            check_name(slot.name, place)
            found = enumeration_of(slot.field)
            if found is not None:
                names[slot.name] = found
            if slot.mux is not None:
                if slot.mux.selector not in known:
                    raise SpecError(
                        f"{place.of_field(slot.name)}: field {slot.name!r} is multiplexed by {slot.mux.selector!r},"
                        " which is not before it"
                    )
                if slot.mux.selector in con.many:
                    raise SpecError(
                        f"{place.of_field(slot.name)}: field {slot.name!r} is multiplexed by {slot.mux.selector!r},"
                        " which is several numbers"
                    )
                slot.mux.enumeration = names.get(slot.mux.selector)
            known.add(slot.name)
        return con
    if isinstance(con, Multiplexed):
        made = Multiplexed(con.selector, con.when, _walk(con.body, place, path))
        made.place = con.place
        return made
    if isinstance(con, (c.Array, c.GreedyRange)):
        inner = _walk(con.subcon, place, path)
        return c.Array(con.count, inner) if isinstance(con, c.Array) else c.GreedyRange(inner)
    if isinstance(con, c.Prefixed):
        return Prefixed(con.lengthfield, _walk(con.subcon, place, path), con.includelength)
    if isinstance(con, c.IfThenElse):
        then, otherwise = (_walk(one, place, path) for one in (con.thensubcon, con.elsesubcon))
        return c.IfThenElse(con.condfunc, then, otherwise)
    if isinstance(con, c.Switch):
        walked: dict[int, Any] = {}  # a case under several keys stays one
        for case in (*con.cases.values(), con.default):
            walked.setdefault(id(case), _walk(case, place, path))
        cases = {key: walked[id(case)] for key, case in con.cases.items()}
        return c.Switch(con.keyfunc, cases, walked[id(con.default)])
    return con


class Prefixed(c.Prefixed):
    """construct's own, whose content takes all of its bytes; what it would leave over were lost."""

    def _parse(self, stream: Any, context: Any, path: str) -> Any:
        length = self.lengthfield._parsereport(stream, context, path)
        if self.includelength:
            length -= self.lengthfield._sizeof(context, path)
        inside = io.BytesIO(c.stream_read(stream, length, path))
        value = self.subcon._parsereport(inside, context, path)
        if inside.read(1):
            raise c.ValidationError(f"its length says {length} bytes, its content has fewer", path=path)
        return value


def _by_both(switch: c.Switch, enumerations: Mapping[str, Enumeration]) -> c.Switch:
    """A `Switch` over an enumeration, its cases under the names that records show and the numbers of raw mode."""
    for name, enumeration in enumerations.items():
        marker = object()
        try:
            if switch.keyfunc(c.Container({name: marker})) is not marker:
                continue
        except Exception:  # it asks for something else
            continue
        numbers = {
            enumeration.names[key]: case for key, case in switch.cases.items() if key in enumeration.names
        }
        names = {
            enumeration.values[key]: case for key, case in switch.cases.items() if key in enumeration.values
        }
        return c.Switch(switch.keyfunc, {**numbers, **names, **switch.cases}, switch.default)
    return switch


def sizes(con: c.Construct) -> tuple[int, int | None]:
    """The least and the greatest number of bytes of a construct; None for no bound."""
    while isinstance(con, c.Renamed):
        con = con.subcon
    if isinstance(con, c.Struct):
        low = 0
        high: int | None = 0
        for item in con.subcons:
            one, most = sizes(item)
            low += one
            high = None if high is None or most is None else high + most
        # Fields that exclude each other overlay; what the selector allows is decided when parsing.
        return low, high
    if isinstance(con, Multiplexed):
        return 0, sizes(con.body)[1]
    if isinstance(con, c.Array):
        low, most = sizes(con.subcon)
        if isinstance(con.count, int):
            return low * con.count, None if most is None else most * con.count
        return 0, None
    if isinstance(con, c.IfThenElse):
        return _either([con.thensubcon, con.elsesubcon])
    if isinstance(con, c.Switch):
        return _either([*con.cases.values(), con.default])
    if isinstance(con, BitLayout):
        return con.size, None if con.trailing else con.size
    if isinstance(con, Delimited):
        return con.least_size, None
    if isinstance(con, (c.Default, Field)):
        return sizes(con.subcon)
    try:
        size = int(con.sizeof())
    except (c.SizeofError, LookupError, AttributeError, TypeError):  # it depends on a field
        return 0, None
    return size, size


def _either(cases: list[c.Construct]) -> tuple[int, int | None]:
    """The sizes of what is one of several constructs."""
    found = [sizes(case) for case in cases]
    tops = [high for _, high in found if high is not None]
    return min(low for low, _ in found), max(tops) if len(tops) == len(found) else None
