"""What a spec wrote, brought into the few shapes that everything else handles.

1. construct's own `Enum`, `FlagsEnum` and `Flag` become ours, which know raw mode; choices by an enumeration come out the
   same in both modes (`choices`). Nothing else changes meaning.
2. Whatever would lose bytes (unnamed padding, seeking, ignored tails) or hide them is refused here, with its line, however
   deep it is (`vocabulary`). What has content takes all of its bytes.
3. What repeats moves on: an item that can have no bytes is refused, one that has none just now ends the reading.
4. A multiplexed field goes by the raw number of its selector. In a `BitLayout` that is at hand; a `Struct` knows its fields
   only as records show them, so that there the two must be one (`check_selectors`).
"""

from __future__ import annotations

import copy
import io
import keyword
import unicodedata
from collections.abc import Callable, Collection, Mapping
from typing import Any, BinaryIO

import construct as c

from ...errors import FieldError, SpecError
from .bits import BitLayout, Bits, ByteSplit
from .delimited import Delimited
from .fields import Enumeration, Field, Flags, Multiplexed, Present, Quantity, SignMagnitude
from .head import enumeration_of
from .items import Items
from .place import SourceLine
from .vocabulary import TRANSFORMS, construct_name, refusal_of

# ---------------------------------------------------------------------- what a payload chooses by
#
# 1. A choice comes out the same in both modes, whichever of the two its author wrote: a `Switch` gets its cases under both,
#    an expression is given values that equal both. Records show enumerations by name, raw mode by number.
# 2. An enumeration is known by the way an expression reaches it: `("kind",)`, `("id", "kind")` inside a nested record,
#    `("_", "kind")` around one.


Known = Mapping[tuple[str, ...], Enumeration]


class _Asked(dict[str, Any]):
    """Stands for a context, and notes which enumerations an expression asks it for."""

    def __init__(self, known: Known, found: dict[tuple[str, ...], Any], path: tuple[str, ...] = ()) -> None:
        super().__init__()
        self._known, self._found, self._path = known, found, path

    def __getitem__(self, name: str) -> Any:
        path = (*self._path, name)
        inner = _Asked(self._known, self._found, path)
        return self._found.setdefault(path, inner) if path in self._known else inner

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return self[name]


class _Both(int):
    """A number of an enumeration, equal to its name too."""

    names: Enumeration

    def __eq__(self, other: object) -> bool:
        return self.names.names.get(other) == int(self) if isinstance(other, str) else int(self) == other

    __hash__ = int.__hash__


def enumerations_asked(expression: Any, known: Known) -> tuple[dict[tuple[str, ...], Any], Any]:
    """Return which enumerations an expression asks for, and what it gives when it is handed stand-ins for them."""
    found: dict[tuple[str, ...], Any] = {}
    if not callable(expression) or not known:
        return found, None
    try:
        return found, expression(_Asked(known, found))
    except Exception:  # it computes with what is only a stand-in
        return found, None


def switch_by_both(switch: c.Switch, known: Known) -> c.Switch:
    """Return a `Switch` over an enumeration, its cases under the names that records show and the numbers of raw mode."""
    found, answer = enumerations_asked(switch.keyfunc, known)
    for path, marker in found.items():
        if answer is not marker:
            continue
        enumeration = known[path]
        names, values = enumeration.names, enumeration.values
        numbers = {names[key]: case for key, case in switch.cases.items() if key in names}
        named = {values[key]: case for key, case in switch.cases.items() if key in values}
        return c.Switch(switch.keyfunc, {**numbers, **named, **switch.cases}, switch.default)
    return c.Switch(equal_in_both(switch.keyfunc, known), switch.cases, switch.default)


def equal_in_both(expression: Any, known: Known) -> Any:
    """Return an expression that gives the same answer in both modes: enumerations are numbers to it that equal their
    names.
    """
    found, _ = enumerations_asked(expression, known)
    return _Expression(expression, {path: known[path] for path in found}) if found else expression


class _Expression:
    """An expression over a view of its context."""

    def __init__(self, expression: Callable[[Any], Any], known: Known) -> None:
        self.expression, self.known = expression, known

    def __call__(self, context: c.Container) -> Any:
        return self.expression(_view(context, self.known))

    def __repr__(self) -> str:
        return repr(self.expression)


def _view(context: c.Container, known: Known) -> Any:
    """Return a context in which some enumerations equal number and name."""
    made = c.Container(context)
    below: dict[str, dict[tuple[str, ...], Enumeration]] = {}
    for (name, *rest), enumeration in known.items():
        if rest:
            below.setdefault(name, {})[tuple(rest)] = enumeration
            continue
        value = context.get(name)
        if isinstance(value, str):
            value = enumeration.names.get(value, value)
        if isinstance(value, int):
            made[name] = _Both(value)
            made[name].names = enumeration
    for name, inner in below.items():
        if isinstance(context.get(name), dict):
            made[name] = _view(context[name], inner)
    return made


def enumerations_of(name: str | None, con: c.Construct) -> dict[tuple[str, ...], Enumeration]:
    """Return the enumerations that a field brings, by the way to them from beside it."""
    if name is None:
        return {}
    while isinstance(con, (c.Renamed, c.Default, c.Prefixed, c.FixedSized)):
        con = con.subcon
    found: dict[tuple[str, ...], Enumeration] = {}
    if isinstance(con, c.Struct):
        for item in con.subcons:
            found |= enumerations_of(item.name, item)
    elif isinstance(con, BitLayout):
        for slot in con.slots:
            found |= enumerations_of(slot.name, slot.field) if slot.name not in con.many else {}
    elif not isinstance(con, (c.Array, c.GreedyRange, c.RepeatUntil)):
        own = enumeration_of(con)
        return {(name,): own} if own is not None else {}
    return {(name, *path): enumeration for path, enumeration in found.items()}


def enumerations_around(known: Known) -> dict[tuple[str, ...], Enumeration]:
    """Return the same enumerations seen from inside a nested record."""
    return {("_", *path): enumeration for path, enumeration in known.items()}


# ---------------------------------------------------------------------- payloads


#: Names that records use themselves.
TAKEN = frozenset({"meta"})
#: How many items without a byte a counted array may have.
MOST_EMPTY = 4096


def normalised(
    payload: c.Construct | None, place: SourceLine, around: Known | None = None, heads: Collection[str] = ()
) -> c.Construct:
    """Return the payload as `Struct`, `BitLayout` or `Delimited`, ready to be flattened.

    `around` are the enumerations that it may ask for outside itself, as `this._.name`; `heads` the fields of the header.
    """
    if payload is None:
        return c.Struct()
    if isinstance(payload, c.Renamed):
        payload = payload.subcon
    if not isinstance(payload, (c.Struct, BitLayout, Delimited)):
        raise SpecError(
            f"{place}: a payload is a Struct, a BitLayout or a Delimited, not {payload!r}; one field goes into a Struct, too"
        )
    known = {("_", *path): e for path, e in (around or {}).items()}
    try:
        walked: c.Construct = _Walk(place, heads).of(payload, "payload", known)
    except RecursionError:
        raise SpecError(f"{place}: payload: its LazyBound gives another construct at each look") from None
    return walked


def inner_constructs(con: Any) -> list[Any]:
    """Return the constructs directly inside a construct: items, cases, or what it wraps; empty for what reads bytes
    itself.
    """
    match con:
        case Multiplexed():
            return [con.body]
        case c.IfThenElse():
            return [con.thensubcon, con.elsesubcon]
        case c.Switch():
            return [*con.cases.values(), con.default]
        case _:
            return (
                list(con.subcons)
                if hasattr(con, "subcons")
                else [con.subcon]
                if hasattr(con, "subcon")
                else []
            )


def normalised_field(field: c.Construct, place: SourceLine, name: str) -> Any:
    """Return a field that is in no payload, such as a register's, ready to be flattened; raises `SpecError` as
    `normalised`.
    """
    return _Walk(place).of(field, name, {})


def check_name(name: str, place: SourceLine) -> None:
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


class _Walk:
    """One walk over a payload. `known` are the enumerations that an expression at the place may ask for."""

    def __init__(self, place: SourceLine, heads: Collection[str] = (), *, in_bits: bool = False) -> None:
        self.place = place
        #: The fields of the header.
        self.heads = heads
        #: Whether the bytes are bits, as inside `Bitwise`.
        self.in_bits = in_bits
        #: Whether what is walked strips the zeros that its `FixedSized` gives back.
        self.may_strip = False
        #: What is bound late may contain itself: by its construct, what it has become.
        self.bound: dict[int, c.LazyBound] = {}

    def of(self, con: c.Construct, path: str, known: Known) -> Any:
        """Return what replaces `con`; raises `SpecError` for what cannot be in a payload."""
        place = self.place
        match con:
            case c.Renamed():
                if con.name is None:
                    return self.of(con.subcon, path, known)
                check_name(con.name, place)
                inner = self.of(con.subcon, f"{path}.{con.name}", known)
                return c.Renamed(inner, newname=con.name, newdocs=con.docs)
            case c.Enum():
                names = {str(k): int(v) for k, v in con.encmapping.items()}
                return Enumeration(self.of(con.subcon, path, known), names)
            case c.FlagsEnum():
                masks = {str(k): int(v) for k, v in con.flags.items()}
                wide = [k for k, v in masks.items() if v.bit_count() != 1]
                if wide:
                    raise SpecError(f"{place}: {path}: flag {wide[0]!r} is not a single bit")
                inner = self.of(con.subcon, path, known)
                return Flags(inner, {k: v.bit_length() - 1 for k, v in masks.items()})
            case _:
                pass
        if con is c.Flag and not self.in_bits:
            raise SpecError(
                f"{place}: {path}: Flag loses bits 1…7; use BitLayout(1, … bits(1)) or Enumeration(Byte, off=0, on=1)"
            )
        reason = refusal_of(con)
        if not reason and isinstance(con, c.BitsInteger) and not self.in_bits:
            reason = "BitsInteger reads bits, which are in BitStruct and Bitwise alone; use BytesInteger, or a BitLayout"
        if isinstance(con, Bits):
            if con.is_split:
                return con if isinstance(con, ByteSplit) else ByteSplit(con)
            reason = "bits(…) and float_bits(…) go into a BitLayout; whole bytes are Int16ul, Float32l and the like"
        if reason:
            raise SpecError(f"{place}: {path}: {reason}")
        match con:
            case c.Struct():
                return self._struct(con, path, known)
            case c.Sequence() | c.FocusedSeq():
                return self._sequence(con, path, known)
            case BitLayout():
                self._layout(con)
                return con
            case Multiplexed():
                return con.around(self.of(con.body, path, known))
            case c.Array() | c.GreedyRange() | c.RepeatUntil():
                return self._repeated(con, path, known)
            case Items():
                for name in con.data:
                    check_name(name, con.place)
                return con.changed(lambda name, data: self.of(data, f"{path}.{name}", known))
            case c.Prefixed():
                return WholePrefixed(con.lengthfield, self.of(con.subcon, path, known), con.includelength)
            case c.FixedSized():
                self.may_strip = _strips(con.subcon)
                return WholeSized(equal_in_both(con.length, known), self.of(con.subcon, path, known))
            case c.NullTerminated():
                return WholeTerminated(self.of(con.subcon, path, known), con.term)
            case c.NullStripped():
                if self.may_strip:
                    self.may_strip = False
                    return con
                raise SpecError(
                    f"{place}: {path}: NullStripped loses what it strips; put it in a FixedSized, or use Text(n)"
                )
            case c.Transformed():
                return self._transformed(con, path)
            case c.LazyBound():
                return self._late(con, path, known)
            case c.IfThenElse():
                then, otherwise = (
                    self.of(branch, path, known) for branch in (con.thensubcon, con.elsesubcon)
                )
                return c.IfThenElse(equal_in_both(con.condfunc, known), then, otherwise)
            case c.Switch():
                con = switch_by_both(con, known)
                walked: dict[int, Any] = {}  # a case under several keys stays one
                for case in (*con.cases.values(), con.default):
                    walked.setdefault(id(case), self.of(case, path, known))
                cases = {key: walked[id(case)] for key, case in con.cases.items()}
                return c.Switch(con.keyfunc, cases, walked[id(con.default)])
            case c.Bytes() | c.BytesInteger():
                if isinstance(con.length, int) and con.length < 0:
                    raise SpecError(f"{place}: {path}: {con.length} bytes")
                return _changed(con, "length", equal_in_both(con.length, known))
            case _:
                for name in ("condfunc", "func"):  # of StopIf, Check and Rebuild
                    if name in vars(con) and isinstance(con, (c.StopIf, c.Check, c.Rebuild)):
                        con = _changed(con, name, equal_in_both(getattr(con, name), known))
                subcon = getattr(con, "subcon", None)
                if isinstance(subcon, c.Construct) and not isinstance(con, c.Const):
                    return _changed(con, "subcon", self.of(subcon, path, known))
                return con

    def _struct(self, con: c.Struct, path: str, known: Known) -> c.Struct:
        place = self.place
        items = []
        seen: set[str] = set()
        own = {**enumerations_around(known)} if path != "payload" else {**known}
        for item in con.subcons:
            name = item.name
            inner = item.subcon if isinstance(item, c.Renamed) else item
            if name is None and not isinstance(inner, (c.Const, c.Terminated.__class__)):
                raise SpecError(
                    f"{place}: {path}: {inner!r} has no name, so its bytes would be lost;"
                    ' name it (bytes that mean nothing: "reserved" / Reserved(n)); only a Const may go without'
                )
            if name is not None and name in seen:
                raise SpecError(f"{place.of_field(name)}: field {name!r} is declared twice")
            made = self.of(item, path, own)
            body = made.subcon if isinstance(made, c.Renamed) else made
            if isinstance(body, Multiplexed):
                is_outer = isinstance(body, Present) and path == "payload" and body.selector in self.heads
                if body.selector not in seen and not is_outer:
                    raise SpecError(
                        f"{place.of_field(name or '')}: field {name!r} is multiplexed by {body.selector!r},"
                        " which is not before it"
                    )
                body.enumeration = own.get((body.selector,))
            if name is not None:
                seen.add(name)
                own |= enumerations_of(name, body)
            items.append(made)
        return c.Struct(*items)

    def _sequence(self, con: c.Sequence | c.FocusedSeq, path: str, known: Known) -> c.Construct:
        items = []
        own = enumerations_around(known)
        for item in con.subcons:
            inner = item.subcon if isinstance(item, c.Renamed) else item
            if isinstance(con, c.FocusedSeq) and item.name != con.parsebuildfrom:
                if not isinstance(inner, (c.Const, c.Rebuild, c.Terminated.__class__)):
                    raise SpecError(
                        f"{self.place}: {path}: FocusedSeq drops {item.name or inner!r}; use a Struct"
                    )
            made = self.of(item, path, own)
            own |= enumerations_of(item.name, made.subcon if isinstance(made, c.Renamed) else made)
            items.append(made)
        return (
            c.FocusedSeq(con.parsebuildfrom, *items) if isinstance(con, c.FocusedSeq) else c.Sequence(*items)
        )

    def _layout(self, con: BitLayout) -> None:
        place = self.place
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

    def _repeated(self, con: Any, path: str, known: Known) -> c.Construct:
        inner = self.of(con.subcon, path, known)
        least, most = sizes(inner)
        if isinstance(con, c.Array) and isinstance(con.count, int):
            if con.count < 0:
                raise SpecError(f"{self.place}: {path}: an array of {con.count}")
            return c.Array(con.count, inner)
        if most == 0:
            raise SpecError(
                f"{self.place}: {path}: the items of {type(con).__name__} have no bytes, so nothing bounds them"
            )
        if not least:
            inner = _Moving(inner, 0 if not isinstance(con, c.Array) else MOST_EMPTY)
        if isinstance(con, c.Array):
            return c.Array(equal_in_both(con.count, known), inner)
        return c.RepeatUntil(con.predicate, inner) if isinstance(con, c.RepeatUntil) else c.GreedyRange(inner)

    def _transformed(self, con: c.Transformed, path: str) -> c.Transformed:
        factor = TRANSFORMS[con.decodefunc]
        before, self.in_bits = self.in_bits, factor == 8 or self.in_bits
        inner = self.of(con.subcon, path, {})
        self.in_bits = before
        size = sizes(inner)
        if con.decodeamount is None or size != (con.decodeamount * factor,) * 2:
            what = "bits" if factor == 8 else "bytes"
            raise SpecError(
                f"{self.place}: {path}: {size[0]} {what} are read of {con.decodeamount} bytes; read them all,"
                " or use a BitLayout"
            )
        changed: c.Transformed = _changed(con, "subcon", inner)
        return changed

    def _late(self, con: c.LazyBound, path: str, known: Known) -> c.LazyBound:
        if id(con) not in self.bound:
            found: list[Any] = []
            self.bound[id(con)] = c.LazyBound(lambda: found[0])
            found.append(self.of(con.subconfunc(), path, known))
        return self.bound[id(con)]


def _changed(con: c.Construct, name: str, value: Any) -> Any:
    """Return the same construct with another value of an attribute; itself, where that is the same."""
    if value is getattr(con, name):
        return con
    made = copy.copy(con)
    made.__dict__[name] = value
    return made


class _Moving(c.Subconstruct):
    """An item of what repeats: reading ends with an error when so many items have had no bytes."""

    def __init__(self, subcon: c.Construct, empty: int) -> None:
        super().__init__(subcon)
        self.empty = empty

    def _parse(self, stream: BinaryIO, context: c.Container, path: str) -> Any:
        start = stream.tell()
        value = self.subcon._parsereport(stream, context, path)
        if stream.tell() == start and context._index >= self.empty:
            # What repeats passes on this kind of error alone.
            raise c.ExplicitError("an item without a byte repeats for ever", path=path)
        return value


class WholePrefixed(c.Prefixed):
    """construct's own, whose content takes all of its bytes; what it would leave over were lost."""

    def _parse(self, stream: BinaryIO, context: c.Container, path: str) -> Any:
        length = self.lengthfield._parsereport(stream, context, path)
        if self.includelength:
            length -= self.lengthfield._sizeof(context, path)
        inside = io.BytesIO(c.stream_read(stream, length, path))
        value = self.subcon._parsereport(inside, context, path)
        if inside.read(1):
            raise c.ValidationError(f"its length says {length} bytes, its content has fewer", path=path)
        return value


class WholeSized(c.FixedSized):
    """construct's own, whose content has all of its bytes; only what strips zeros may have fewer."""

    def _parse(self, stream: BinaryIO, context: c.Container, path: str) -> Any:
        length = c.evaluate(self.length, context)
        inside = io.BytesIO(c.stream_read(stream, length, path))
        value = self.subcon._parsereport(inside, context, path)
        if inside.read(1):
            raise c.ValidationError(f"it has {length} bytes, its content fewer", path=path)
        return value

    def _build(self, obj: Any, stream: BinaryIO, context: c.Container, path: str) -> Any:
        length = c.evaluate(self.length, context)
        inside = io.BytesIO()
        built = self.subcon._build(obj, inside, context, path)
        data = inside.getvalue()
        if len(data) > length or (len(data) < length and not _strips(self.subcon)):
            raise FieldError(f"{path}: {len(data)} bytes, where there is room for {length}")
        stream.write(data.ljust(length, b"\0"))
        return built


class WholeTerminated(c.NullTerminated):
    """construct's own, whose content takes all of its bytes and has no end inside."""

    def __init__(self, subcon: c.Construct, term: bytes) -> None:
        super().__init__(_Whole(subcon), term)

    def _build(self, obj: Any, stream: BinaryIO, context: c.Container, path: str) -> Any:
        inside = io.BytesIO()
        built = self.subcon._build(obj, inside, context, path)
        data, unit = inside.getvalue(), len(self.term)
        if len(data) % unit or any(data[at : at + unit] == self.term for at in range(0, len(data), unit)):
            raise FieldError(f"{path}: {obj!r} has inside what ends it")
        stream.write(data + self.term)
        return built


class _Whole(c.Subconstruct):
    """Content that takes all bytes that there are."""

    def _parse(self, stream: BinaryIO, context: c.Container, path: str) -> Any:
        value = self.subcon._parsereport(stream, context, path)
        if stream.read(1):
            raise c.ValidationError("bytes are left over before the end", path=path)
        return value


def _strips(con: c.Construct) -> bool:
    """Return whether a construct takes off the zeros behind its content."""
    while isinstance(con, (c.Renamed, c.Adapter)):
        con = con.subcon
    return isinstance(con, c.NullStripped) and con.subcon is c.GreedyBytes and not con.pad.strip(b"\0")


def sizes(con: c.Construct) -> tuple[int, int | None]:
    """Return the least and the greatest number of bytes of a construct; None for no bound."""
    while isinstance(con, c.Renamed):
        con = con.subcon
    match con:
        case c.Struct() | c.Sequence() | c.FocusedSeq():
            low = 0
            high: int | None = 0
            stops = False
            for item in con.subcons:
                one, most = sizes(item)
                stops = stops or isinstance(item.subcon if isinstance(item, c.Renamed) else item, c.StopIf)
                low += 0 if stops else one
                high = None if high is None or most is None else high + most
            # Fields that exclude each other overlay; what the selector allows is decided when parsing.
            return low, high
        case Multiplexed():
            return 0, sizes(con.body)[1]
        case c.Array():
            low, most = sizes(con.subcon)
            if isinstance(con.count, int):
                return low * con.count, None if most is None else most * con.count
            return 0, None
        case c.IfThenElse():
            return _either([con.thensubcon, con.elsesubcon])
        case c.Switch():
            return _either([*con.cases.values(), con.default])
        case BitLayout():
            return con.size, None if con.trailing else con.size
        case Delimited():
            return con.least_size, None
        case c.Default() | c.Rebuild() | c.Adapter() | _Moving():
            return sizes(con.subcon)
        case c.Prefixed():
            return sizes(con.lengthfield)[0], None
        case c.NullTerminated():
            return len(con.term), None
        case c.RepeatUntil():
            return sizes(con.subcon)[0], None
        case _:
            if con is c.VarInt or con is c.ZigZag:
                return 1, None
            try:
                size = int(con.sizeof())
            except Exception:  # it depends on a field, by whatever program
                return 0, None
            return size, size


def _either(cases: list[c.Construct]) -> tuple[int, int | None]:
    """Return the sizes of what is one of several constructs."""
    found = [sizes(case) for case in cases]
    tops = [high for _, high in found if high is not None]
    return min(low for low, _ in found), max(tops) if len(tops) == len(found) else None


def check_selectors(con: c.Construct, place: SourceLine, path: str = "payload") -> None:
    """Raise `SpecError` for a `Multiplexed` that is not a field of its own, or goes by what is not the raw number."""
    if isinstance(con, Multiplexed):
        raise SpecError(f"{con.place}: {path}: Multiplexed makes a named field of a Struct or BitLayout")
    if isinstance(con, c.Struct):
        by_name = {item.name: item for item in con.subcons if item.name}
        for item in con.subcons:
            body = item.subcon if isinstance(item, c.Renamed) else item
            if isinstance(body, Multiplexed):
                if body.selector in by_name:  # else it is in the header
                    _check_selector(by_name[body.selector], body.selector, place)
                body = body.body
            check_selectors(body, place, f"{path}.{item.name}" if item.name else path)
        return
    for construct in inner_constructs(con):
        check_selectors(construct, place, path)


def _check_selector(field: c.Construct, name: str, place: SourceLine) -> None:
    while isinstance(field, (c.Renamed, c.Default, Field)):
        if isinstance(field, SignMagnitude) or (
            isinstance(field, Quantity) and (field.scale != 1 or field.offset or field.unknown or field.names)
        ):
            raise SpecError(
                f"{place.of_field(name)}: selector {name!r} is a {construct_name(field)}; a field of a Struct is"
                " multiplexed by a plain number, an Enumeration or Flags"
            )
        field = field.subcon
