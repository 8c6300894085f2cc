"""`field=value` on the command line: what `aces send` fills a message with.

    board=3                       a number: 0x1F, 1e3 and -2.5 too, in the sheet's unit
    mode=torque                   an enumeration's name, or its number
    error=hot|cold                flags; error=0 for none
    position=[120,-4]             a list; or position.0=120 position.1=-4
    servos=[{id=1,goal=512}]      nested records; or servos.0.id=1 servos.0.goal=512
    data=0a00                     bytes, in hexadecimal (where the spec leaves the kind open: hex:0a00)
    name="left arm"               a text
    temperature=none              no value

1. Nothing here decides whether a value fits: the encoder does, and says what would.
2. What cannot be read raises `CallerError` with the field, the text and what could be written.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.protocol import Message
from aces_bus.protocol.numbers import parse_number
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.record import FieldValue

_ASSIGNMENT = re.compile(r"\s*([A-Za-z_]\w*(?:\.\w+)*)\s*=(.*)", re.DOTALL)
_OPENING, _CLOSING = "[{(", "]})"
#: How deep lists and records may be nested.
DEEPEST = 16


def parse_fields(message: Message, texts: Iterable[str]) -> dict[str, FieldValue]:
    """Return the values of `field=value` arguments, as the encoder takes them.

    Raises `CallerError` for what cannot be read, is given twice or is half a list, and `UnknownNameError` for a field that
    the message has not.
    """
    nodes = {field.name: field.node for field in message.plan.fields}
    tree: dict[str | int, Any] = {}
    for text in texts:
        found = _ASSIGNMENT.fullmatch(text)
        if found is None:
            raise CallerError(f"{text!r} is not a value of {message.name}; write field=value")
        path = tuple(int(part) if part.isdecimal() else part for part in found[1].split("."))
        if path[0] not in message.fields:
            raise UnknownNameError(f"field of {message.name}", str(path[0]), message.fields)
        node = _node_of(nodes.get(str(path[0])), path[1:])
        _put(tree, path, parse_value(found[2].strip(), node, found[1]), found[1])
    return {str(name): _whole(value, str(name)) for name, value in tree.items()}


def _node_of(node: p.Node | None, path: Sequence[str | int]) -> p.Node | None:
    """Return the node at the end of a path; None where the spec leaves the shape open."""
    for step in path:
        inside = dict(node.children) if node is not None else {}
        node = inside[step].node if step in inside else None
    return node


class _Given(dict[str | int, Any]):
    """Values given one by one, under their names or places."""


def _put(tree: dict[str | int, Any], path: Sequence[str | int], value: FieldValue, name: str) -> None:
    for step in path[:-1]:
        inner = tree.setdefault(step, _Given())
        if not isinstance(inner, _Given):
            raise CallerError(f"{name} is given twice: as a whole, and a part of it")
        tree = inner
    if path[-1] in tree:
        raise CallerError(f"{name} is given twice")
    tree[path[-1]] = value


def _whole(value: FieldValue, name: str) -> Any:
    """Build lists and records from values that were given one by one."""
    if not isinstance(value, _Given):
        return value
    if any(isinstance(step, str) for step in value):
        return {str(step): _whole(inner, f"{name}.{step}") for step, inner in value.items()}
    places = {int(step): inner for step, inner in value.items()}
    for place in range(len(places)):
        if place not in places:
            raise CallerError(f"{name}.{place} is not given, and {name}.{max(places)} is")
    return [_whole(places[place], f"{name}.{place}") for place in range(len(places))]


# ---------------------------------------------------------------------- single values


def parse_value(text: str, node: p.Node | None, name: str, depth: int = 0) -> Any:
    """Return a value from its text; `node` says what is expected, None leaves it to the text."""
    if depth > DEEPEST:
        raise CallerError(f"{name}: lists in lists deeper than {DEEPEST}")
    if node is not None and node.holds == "text" and node.known_names is None:
        return _unquoted(text)
    if text == "none":
        return None
    return node.shaped(_Parser(text, name, depth)) if node is not None else _open(text, name, depth)


@dataclass(frozen=True)
class _Parser:
    """The value that a text says, by its shape."""

    text: str
    name: str
    depth: int

    def single(self, node: p.Node) -> Any:
        if node.holds == "bytes":
            return _bytes(self.text.removeprefix("hex:"), self.name)
        if node.known_names is None:
            return _open(self.text, self.name, self.depth)
        return _of_number(self.text, node, self.name)

    def several(self, node: p.Node, items: Sequence[p.Node]) -> Any:
        return _list(self.text, list(items), self.name, self.depth)

    def record(self, node: p.Node, type_name: str, fields: Sequence[p.PlanField]) -> Any:
        return _record(self.text, {field.name: field.node for field in fields}, self.name, self.depth)

    def each(self, node: p.Node, item: p.Node) -> Any:
        return _open(self.text, self.name, self.depth)

    def tagged(self, node: p.Node, type_name: str, kinds: Sequence[p.ItemKind]) -> Any:
        return _open(self.text, self.name, self.depth)


def _of_number(text: str, node: p.Node, name: str) -> Any:
    number = parse_number(text)
    if node.has_flags and number is None:
        inside = text[1:-1] if text[:1] + text[-1:] in ("{}", "[]") else text
        return [part.strip() for part in re.split(r"[|,]", inside) if part.strip()]
    if number is not None:
        return number
    named = node.value_names.values()
    if named:
        if text not in named:
            raise UnknownNameError(f"value of {name}", text, named)
        return text
    unit = f" in {node.unit}" if node.unit else ""
    raise CallerError(f"{name}={text}: {text!r} is not a number; write one{unit}, such as 12, 0x1F or -2.5")


def _open(text: str, name: str, depth: int) -> Any:
    """Return a value whose kind only its text shows."""
    if text[:1] == "[":
        return _list(text, [], name, depth)
    if text[:1] == "{":
        return _record(text, {}, name, depth)
    if text.startswith("hex:"):
        return _bytes(text[4:], name)
    number = parse_number(text)
    return _unquoted(text) if number is None else number


def _bytes(text: str, name: str) -> bytes:
    try:
        return bytes.fromhex(text.removeprefix("0x"))
    except ValueError:
        raise CallerError(
            f"{name}={text}: bytes are written as hexadecimal digits, two a byte: {name}=0a00"
        ) from None


def _unquoted(text: str) -> str:
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'" else text


def _list(text: str, nodes: Sequence[p.Node], name: str, depth: int) -> list[Any]:
    if text[:1] + text[-1:] != "[]":
        raise CallerError(f"{name}={text}: this is a list; write {name}=[1,2], or {name}.0=1 {name}.1=2")
    return [
        parse_value(part, nodes[place] if place < len(nodes) else None, f"{name}.{place}", depth + 1)
        for place, part in enumerate(_parts(text[1:-1], name))
    ]


def _record(text: str, nodes: Mapping[str, p.Node], name: str, depth: int) -> dict[str, FieldValue]:
    if text[:1] + text[-1:] != "{}":
        raise CallerError(
            f"{name}={text}: this is a record of several values; write {name}={{a=1,b=2}}, or {name}.a=1 {name}.b=2"
        )
    found: dict[str, FieldValue] = {}
    for part in _parts(text[1:-1], name):
        key, sign, value = part.partition("=")
        key = key.strip()
        if not sign:
            raise CallerError(f"{name}: {part!r} is not name=value")
        found[key] = parse_value(value.strip(), nodes.get(key), f"{name}.{key}", depth + 1)
    return found


def _parts(text: str, name: str) -> list[str]:
    """Return the parts between commas that are in no bracket and no quotes."""
    parts, start, quote = [], 0, ""
    open_ = 0
    for place, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter in _OPENING:
            open_ += 1
        elif letter in _CLOSING:
            open_ -= 1
        elif letter == "," and not open_:
            parts.append(text[start:place].strip())
            start = place + 1
    if quote or open_:
        raise CallerError(f"{name}: a bracket or a quote is not closed in {text!r}")
    last = text[start:].strip()
    return [*parts, last] if last or parts else []
