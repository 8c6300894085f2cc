"""A protocol as the source of its spec: what `aces spec import` prints of a database.

1. What is printed, when it is run, declares the same protocol: the same plans, message by message.
2. Names that a file from elsewhere gives become names of Python only if they are some (`foreign.names` sees to that), and
   all other text of it string literals. The first lines are ours, so that no comment of the file sets the encoding.

It prints the words that a database's protocol is made of: bit layouts, structs of plain numbers, quantities, enumerations,
multiplexers, captured identifiers. A construct beyond those raises `CallerError`.
"""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import construct as c

from ...errors import CallerError
from ..declare.bits import BitLayout, Bits, LayoutSlot
from ..declare.fields import Enumeration, Multiplexed, Quantity
from ..declare.message import Message
from ..declare.pattern import IdField, IdPattern
from ..declare.transport import Transport
from ..protocol import Protocol
from .names import PythonNames
from .problems import ImportProblem, ProblemText

#: construct's plain numbers by what they are.
_PLAIN = {
    id(getattr(c, name)): name
    for name in (
        *(f"Int{size}{sign}{order}" for size in (8, 16, 24, 32, 64) for sign in "us" for order in "bl"),
        *(f"Float{size}{order}" for size in (16, 32, 64) for order in "bl"),
        "GreedyBytes",
    )
}


def print_source(
    protocol: Protocol, problems: Sequence[ImportProblem] = (), origin: str = "a database"
) -> str:
    """Return the module that declares `protocol`. `problems` are what is not in it; `origin` is what it was made from,
    in our words ("a DBC file"). Raises `CallerError` for what this page of the language does not hold."""
    if protocol.link != "can":
        raise CallerError(f"{protocol.name} is not a protocol on CAN: its framings are not printed as source")
    return _Printer(protocol).module(problems, origin)


class _Printer:
    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        #: Words that the source imports, from construct and from aces_bus.protocol.
        self.words: dict[str, set[str]] = {"construct": set(), "aces_bus.protocol": {"Protocol"}}
        #: Names that the source must not give to anything of its own; what captures are called.
        self.taken: set[str] = {*PythonNames.TAKEN_BY_CODE, *dir(c), *_OURS}
        self.captures: dict[Call, str] = {}

    def module(self, problems: Sequence[ImportProblem], origin: str) -> str:
        own = PythonNames.unused(self.protocol.name, self.taken)
        body = [
            line
            for message in self.protocol.declared
            for line in ("", *expression_lines(self._message(message, own)))
        ]
        head = [f'"""Made by `aces spec import` from {origin}: yours to edit from here on."""', ""]
        if problems:
            head += ["# What is not in it, or differently:"]
            head += [f"#   {ProblemText.one_line(str(problem))}" for problem in problems]
            head += [""]
        head += ["from __future__ import annotations", ""]
        for module in ("construct", "aces_bus.protocol"):
            if words := self.words[module]:
                head += [*_import(module, words), ""]
        declared = Call("Protocol", (Code(python_string(self.protocol.name)),), tuple(self._about()))
        head += expression_lines(declared, 0, f"{own} = ")
        for capture, name in self.captures.items():
            head += expression_lines(capture, 0, f"{name} = ")
        return "\n".join([*head, *body, ""])

    def _about(self) -> list[tuple[str, Expression]]:
        protocol = self.protocol
        found: list[tuple[str, Expression]] = [("link", python_literal(protocol.link))]
        if protocol.bitrate is not None:
            found.append(("bitrate", Code(f"{protocol.bitrate:_}")))
        if protocol.doc:
            found.append(("doc", python_literal(protocol.doc)))
        if protocol.source:
            # The path of the file does not belong into the spec.
            found.append(("source", python_literal(re.split(r"[/\\]", protocol.source)[-1])))
        return found

    def _word(self, name: str) -> str:
        self.words["aces_bus.protocol" if name in _OURS else "construct"].add(name)
        return name

    # ------------------------------------------------------------------ messages

    def _message(self, message: Message, own: str) -> Expression:
        if message.heads_written:
            raise CallerError(
                f"{message.name}: a message with fixed values in front is not printed as source"
            )
        keywords: list[tuple[str, Expression]] = [("id", self._identifier(message))]
        for name in ("extended", "fd", "any_format", "remote"):
            if getattr(message, name):
                keywords.append((name, Code("True")))
        if message.transport is not None:
            keywords.append(("transport", self._transport(message.transport)))
        if message.direction is not None:
            keywords.append(("direction", python_literal(message.direction)))
        if (length := self._length(message)) is not None:
            keywords.append(("length", length))
        if not isinstance(message.payload, c.Struct) or message.payload.subcons:
            keywords.append(("payload", self._payload(message.payload)))
        for name in ("doc", "source"):
            if getattr(message, name):
                keywords.append((name, python_literal(getattr(message, name))))
        return Call(f"{own}.message", (python_literal(message.name),), tuple(keywords))

    def _transport(self, transport: Transport) -> Expression:
        """Return a transport by its settings; identifiers are those of the messages."""
        settings = tuple(
            (field.name, self._transport(value) if isinstance(value, Transport) else python_literal(value))
            for field in fields(transport)
            if field.init and field.name not in ("kinds", "to_device", "from_device")
            if (value := getattr(transport, field.name)) != field.default
        )
        name = type(transport).__name__
        self.words["aces_bus.protocol"].add(name)
        return Call(name, (), settings)

    def _length(self, message: Message) -> Expression | None:
        """Return the data lengths, where they are not those that the payload gives by itself."""
        again = Protocol("again", link="can").message(
            "Again",
            id=message.identifier,
            transport=message.transport,
            payload=message.payload,
            extended=message.extended,
            fd=message.fd,
            remote=message.remote,
        )
        assert message.lengths is not None
        if again.lengths is not None and tuple(again.lengths) == tuple(message.lengths):
            return None
        values = message.lengths
        return python_literal(next(iter(values)) if len(values) == 1 else values)

    def _identifier(self, message: Message) -> Expression:
        pattern, digits = message.identifier, 8 if message.extended else 3
        parts: list[Expression] = []
        if pattern.constant or not pattern.captures:
            parts.append(Code(f"0x{pattern.constant:0{digits}X}"))
        for capture in pattern.captures:
            made = self._capture(capture)
            # A shift binds tighter than | does, and is on its own.
            parts.append(Code(f"{made} << {capture.shift}" if capture.shift else made))
        operator = "|" if _is_apart(pattern) else "+"
        return Operation(parts[0], tuple((operator, part) for part in parts[1:]))

    def _capture(self, capture: IdField) -> str:
        """Return the variable that holds a captured part."""
        keywords = [("doc", python_literal(capture.doc))] if capture.doc else []
        values = capture.values if isinstance(capture.values, range) else tuple(capture.values)
        made = Call(
            self._word("IdField"), (python_literal(capture.name), python_literal(values)), tuple(keywords)
        )
        if made not in self.captures:
            self.captures[made] = PythonNames.unused(capture.name.capitalize(), self.taken)
        return self.captures[made]

    # ------------------------------------------------------------------ payloads

    def _payload(self, payload: c.Construct) -> Expression:
        if isinstance(payload, BitLayout):
            return self._layout(payload)
        if not isinstance(payload, c.Struct):
            raise CallerError(f"a payload of {type(payload).__name__} cannot be printed as source")
        return Call(
            self._word("Struct"), tuple(self._named(item, self._plain(item)) for item in payload.subcons)
        )

    def _named(self, item: c.Construct, field: Expression) -> Expression:
        return _under(item.name, field)

    def _plain(self, item: c.Construct) -> Expression:
        """Return a field of a struct, below its name."""
        doc = item.docs if isinstance(item, c.Renamed) else ""
        body = item.subcon if isinstance(item, c.Renamed) else item
        if isinstance(body, (Enumeration, Quantity)):
            return self._adapted(body, self._plain(body.subcon), doc)
        if id(body) in _PLAIN:
            name = "Byte" if body is c.Byte else _PLAIN[id(body)]
            return self._documented(Code(self._word(name)), doc)
        if isinstance(body, c.Bytes) and isinstance(body.length, int):
            return self._documented(Call(self._word("Bytes"), (python_literal(body.length),)), doc)
        raise CallerError(f"a field of {type(body).__name__} cannot be printed as source")

    def _documented(self, field: Expression, doc: str) -> Expression:
        return Operation(field, (("*", python_literal(doc)),)) if doc else field

    def _layout(self, layout: BitLayout) -> Expression:
        orders = [slot.inner.order or layout.order for slot in layout.slots]
        order = "msb" if orders.count("msb") > orders.count("lsb") else "lsb"
        fields: list[Expression] = []
        cursor = 0
        for slot in layout.slots:
            own, width = slot.inner.order or layout.order, slot.inner.width
            if slot.name in layout.many or len(slot.inner.pieces or ((0, 0),)) > 1:
                raise CallerError(f"field {slot.name}: bits in several places cannot be printed as source")
            at = slot.positions[0] if own == "lsb" else slot.positions[-1] ^ 7
            place = self._bits(slot.inner, at if at != cursor else None, order, layout.order)
            cursor = at + width
            fields.append(_under(slot.name, self._slot(slot, place)))
        keywords: list[tuple[str, Expression]] = [("order", python_literal(order))] if order != "lsb" else []
        if layout.overlapping:
            keywords.append(("overlapping", Code("True")))
        if layout.trailing:
            keywords.append(("trailing", python_literal(layout.trailing)))
        return Call(self._word("BitLayout"), (python_literal(layout.size), *fields), tuple(keywords))

    def _bits(self, inner: Bits, at: int | None, order: str, usual: str) -> Expression:
        arguments = [python_literal(inner.width)] + ([python_literal(at)] if at is not None else [])
        keywords: list[tuple[str, Expression]] = [("signed", Code("True"))] if inner.signed else []
        if (own := inner.order or usual) != order:
            keywords.append(("order", python_literal(own)))
        return Call(self._word("float_bits" if inner.is_float else "bits"), tuple(arguments), tuple(keywords))

    def _slot(self, slot: LayoutSlot, place: Expression) -> Expression:
        field = self._adapted(slot.field, place, slot.doc)
        if slot.mux is None:
            return field
        when: Collection[int] = slot.mux.when
        values = next(iter(when)) if len(when) == 1 else _compact(when)
        return Call(
            self._word(Multiplexed.__name__),
            (python_literal(slot.mux.selector), python_literal(values), field),
        )

    def _adapted(self, field: c.Construct, place: Expression, doc: str) -> Expression:
        """Return what a number means, around its place."""
        if isinstance(field, Quantity):
            keywords = _quantity(field)
            if said := doc or field.docs:
                keywords.append(("doc", python_literal(said)))
            return Call(self._word("Quantity"), (place,), tuple(keywords))
        if isinstance(field, Enumeration):
            return self._documented(self._enumeration(field, place), doc)
        if isinstance(field, Bits) or id(field) in _PLAIN:
            return self._documented(place, doc)
        raise CallerError(f"a field of {type(field).__name__} cannot be printed as source")

    def _enumeration(self, field: Enumeration, place: Expression) -> Expression:
        if all(
            name.isidentifier() and not keyword.iskeyword(name) and name.isascii() for name in field.names
        ):
            keywords = tuple((name, python_literal(value)) for name, value in field.names.items())
            return Call(self._word("Enumeration"), (place,), keywords)
        return Call(self._word("Enumeration"), (place, python_literal(field.names)))


#: What comes from aces_bus.protocol.
_OURS = frozenset(
    ("BitLayout", "Enumeration", "IdField", "Multiplexed", "Protocol", "Quantity", "bits", "float_bits")
)


def _under(name: str, field: Expression) -> Expression:
    """Return `"name" / field`, with what is said of it behind."""
    first, rest = (field.first, field.rest) if isinstance(field, Operation) else (field, ())
    return Operation(python_literal(name), (("/", first), *rest))


def _quantity(field: Quantity) -> list[tuple[str, Expression]]:
    found: list[tuple[str, Expression]] = []
    if field.unit:
        found.append(("unit", python_literal(field.unit)))
    if field.scale != 1 or isinstance(field.scale, float):
        found.append(("scale", python_literal(field.scale)))
    if field.offset or isinstance(field.offset, float):
        found.append(("offset", python_literal(field.offset)))
    if field.range is not None:
        found.append(("range", Sequenced(tuple(map(_number, field.range)), "()")))
    if field.raw_range is not None:
        found.append(("raw_range", python_literal(field.raw_range)))
    if isinstance(field.unknown, range):
        ends = field.unknown.start, field.unknown.stop, field.unknown.step
        found.append(("unknown", Call("range", tuple(map(python_literal, ends)))))
    elif field.unknown:
        found.append(("unknown", Sequenced(tuple(map(_number, field.unknown)))))
    if field.names:
        found.append(("names", python_literal(field.names)))
    if field.rounding != "nearest":
        found.append(("rounding", python_literal(field.rounding)))
    return found


def _number(value: float) -> Expression:
    if isinstance(value, float) and not math.isfinite(value):
        return Call("float", (python_literal(str(value)),))
    return python_literal(value)


def _compact(values: Collection[int]) -> Any:
    """Return a range where they are one of some length, else a set."""
    low, high = min(values), max(values)
    return range(low, high + 1) if len(values) > 3 and high - low == len(values) - 1 else set(values)


def _is_apart(pattern: IdPattern) -> bool:
    """Return whether constant and captures share no bits, so that `|` says the same as `+`."""
    return len(pattern.captures) > 1 or any(capture.shift for capture in pattern.captures)


def _import(module: str, words: Collection[str]) -> list[str]:
    """Return an import as ruff sorts it: constants, classes, functions."""
    ordered = sorted(words, key=lambda word: (not word.isupper(), not word[:1].isupper(), word))
    whole = f"from {module} import {', '.join(ordered)}"
    if len(whole) <= 88:
        return [whole]
    return [f"from {module} import (", *(f"    {word}," for word in ordered), ")"]


#: Columns of a line.
WIDTH = 88


@dataclass(frozen=True)
class Code:
    """Text that is printed as it is: a name, a number in a notation of its own."""

    text: str


@dataclass(frozen=True)
class Call:
    """A call, with positional and keyword arguments."""

    function: str
    arguments: tuple[Expression, ...] = ()
    keywords: tuple[tuple[str, Expression], ...] = ()


@dataclass(frozen=True)
class Sequenced:
    """Items in brackets: a list, a tuple, a set; with `keys` a dictionary."""

    items: tuple[Expression, ...]
    brackets: str = "[]"
    keys: tuple[Expression, ...] = ()


@dataclass(frozen=True)
class Operation:
    """A first operand, then (operator, operand) of one precedence, evaluated from the left."""

    first: Expression
    rest: tuple[tuple[str, Expression], ...]


Expression = Code | Call | Sequenced | Operation


def python_literal(value: Any) -> Expression:
    """Return a value of Python's own kinds as an expression."""
    match value:
        case str():
            return Code(python_string(value))
        case range():
            first = (value.start,) if value.start or value.step != 1 else ()
            step = (value.step,) if value.step != 1 else ()
            return Call("range", tuple(Code(str(number)) for number in (*first, value.stop, *step)))
        case Mapping():
            return Sequenced(
                tuple(map(python_literal, value.values())), "{}", tuple(map(python_literal, value))
            )
        case list() | tuple() | set() | frozenset():
            is_set = isinstance(value, (set, frozenset))
            items: Iterable[Any] = sorted(value) if is_set else value
            brackets = "{}" if is_set else "[]" if isinstance(value, list) else "()"
            return Sequenced(tuple(map(python_literal, items)), brackets)
        case _:
            return Code(repr(value))


def python_string(text: str) -> str:
    """Return a string literal in double quotes, or in single ones where that takes fewer backslashes."""
    quote = "'" if text.count('"') > text.count("'") else '"'
    parts = []
    for character in text:
        if character in (quote, "\\"):
            parts.append(f"\\{character}")
        elif character.isprintable():
            parts.append(character)
        else:
            parts.append(repr(character)[1:-1])
    return quote + "".join(parts) + quote


def flat(expression: Expression) -> str:
    """Return an expression on one line."""
    match expression:
        case Code():
            return expression.text
        case Operation():
            return flat(expression.first) + "".join(
                f" {operator} {flat(part)}" for operator, part in expression.rest
            )
        case Call():
            parts = [flat(part) for part in expression.arguments]
            parts += [f"{name}={flat(part)}" for name, part in expression.keywords]
            return f"{expression.function}({', '.join(parts)})"
        case _:
            if expression.keys:
                inner = ", ".join(
                    f"{flat(k)}: {flat(v)}" for k, v in zip(expression.keys, expression.items, strict=True)
                )
            else:
                inner = ", ".join(map(flat, expression.items))
                if expression.brackets == "()" and len(expression.items) == 1:
                    inner += ","
            return expression.brackets[0] + inner + expression.brackets[1]


def expression_lines(expression: Expression, indent: int = 0, before: str = "", after: str = "") -> list[str]:
    """Return an expression as lines; `before` and `after` stand on its first and its last line."""
    pad = " " * indent
    whole = pad + before + flat(expression) + after
    if _columns(whole) <= WIDTH or isinstance(expression, Code):
        return [whole]
    if isinstance(expression, Operation):
        found = expression_lines(expression.first, indent, before)
        for number, (operator, part) in enumerate(expression.rest, 1):
            found += expression_lines(
                part, indent, f"{operator} ", after if number == len(expression.rest) else ""
            )
        return found
    if isinstance(expression, Call):
        opening, closing = f"{expression.function}(", ")"
        items: Sequence[tuple[str, Expression]] = [("", part) for part in expression.arguments]
        items = [*items, *((f"{name}=", part) for name, part in expression.keywords)]
    else:
        opening, closing = expression.brackets[0], expression.brackets[1]
        keys = [f"{flat(key)}: " for key in expression.keys] or [""] * len(expression.items)
        items = list(zip(keys, expression.items, strict=True))
    if not items:
        return [whole]
    found = [pad + before + opening]
    for name, part in items:
        found += expression_lines(part, indent + 4, name, ",")
    return [*found, pad + closing + after]


def _columns(line: str) -> int:
    """Count columns as formatters do: wide characters are two."""
    if line.isascii():
        return len(line)
    from unicodedata import combining, east_asian_width

    return sum(0 if combining(ch) else 2 if east_asian_width(ch) in "WF" else 1 for ch in line)
