"""Values as texts for people: a function a node of a plan, and one for values of no fixed shape.

1. A number has as many decimals as one raw step shows.
2. Nothing that came over a wire gives a control character.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from aces_bus.plain_text import printable
from aces_bus.protocol import FlagSet
from aces_bus.protocol.plan import nodes as p

from .shape import flag_names, getter, json_value, nameless_number

Show = Callable[[Any], str]


def unit_mark(node: p.Node) -> str:
    """Return what is behind a value of the node: its unit."""
    return f" {node.unit}" if node.unit else ""


def value_printer(node: p.Node) -> Show:
    """Return how the values of a node are printed."""
    match node:
        case p.Many():
            return _show_many(node)
        case p.NestedRecord():
            inner = [
                (f.name, getter((f.name,)), value_printer(f.node), unit_mark(f.node)) for f in node.fields
            ]
            return lambda value: (
                "{" + ", ".join(f"{n}={_or_unknown(s, g(value))}{u}" for n, g, s, u in inner) + "}"
            )
        case p.DescribedItems():
            return value_printer(node.items)
        case p.TaggedItems():
            nodes = {kind.name: kind.plan.fields[0].node for kind in node.kinds}
            return _show_items(
                {name: (value_printer(inner), unit_mark(inner)) for name, inner in nodes.items()}
            )
        case p.OpaqueItems():
            units = {name: unit_mark(inner) for name, _, inner in node.values}
            return _show_items({}, lambda data: _named_values(data, units))
        case p.Repeated():
            (group,) = node.plan.fields
            return _show_each(group.node)
        case p.Each():
            return _show_each(node.item)
        case p.Scalar() if node.kind == "bytes":
            return spaced_hexadecimal
        case p.Scalar() if node.kind == "text":
            return shell_quoted
        case p.Rest():
            return hex
        case p.Scalar() | p.FromIdentifier():
            return _show_number(node)
        case _:
            return anything


def _or_unknown(shown: Show, value: Any) -> str:
    return "unknown" if value is None else shown(value)


def _show_many(node: p.Many) -> Show:
    shows = [value_printer(item) for item in node.items]
    units = ["" if node.unit else unit_mark(item) for item in node.items]

    def many(values: Any) -> str:
        return f"[{', '.join(_or_unknown(s, v) + u for s, v, u in zip(shows, values, units, strict=True))}]"

    return many


def _show_each(node: p.Node) -> Show:
    one, unit = value_printer(node), unit_mark(node)
    return lambda values: f"[{', '.join(_or_unknown(one, value) + unit for value in values)}]"


def _show_items(shows: Mapping[str, tuple[Show, str]], otherwise: Show | None = None) -> Show:
    """Return each item as its kind and data, one that is unknown or malformed as bytes with the reason."""

    def one(item: Any) -> str:
        kind = "" if item.kind is None else f"{item.kind}="
        known = shows.get(str(item.kind))
        if item.reason is not None or known is None:
            more = f" ({item.reason})" if item.reason is not None else ""
            return kind + (otherwise or anything)(item.data) + more
        shown, unit = known
        return kind + _or_unknown(shown, item.data) + unit

    return lambda items: f"[{', '.join(map(one, items))}]"


def _named_values(data: Any, units: Mapping[str, str]) -> str:
    """Values by name, with their units where they are numbers."""
    names = getattr(data, "__struct_fields__", None)
    if names is None:
        return anything(data)
    values = ((name, getattr(data, name)) for name in names if name[0] != "_")
    number = (int, float)
    shown = (
        f"{name}={anything(value)}{units.get(name, '') if isinstance(value, number) else ''}"
        for name, value in values
    )
    return f"{{{', '.join(shown)}}}"


def _show_number(node: p.Scalar | p.FromIdentifier) -> Show:
    if node.flags:
        return lambda value: "{" + ", ".join(flag_names(value)) + "}"
    form = step_format(node)
    if not node.value_names:
        return lambda value: format(value, form)
    return lambda value: printable(value) if isinstance(value, str) else format(value, form)


def number_format(node: p.Node) -> str | None:
    """Return how the numbers of a node are formatted; None where a value may be something else, or None."""
    number = nameless_number(node)
    return None if number is None or number.has_unknown else step_format(node)


def step_format(node: p.Node) -> str:
    """Return how the numbers of a node are formatted, as many decimals as one raw step has."""
    if isinstance(node, p.Scalar) and node.kind == "float":
        return f".{ {2: 4, 4: 7}.get(node.size or 0, 15) }g"
    scales = [step for step in node.steps if isinstance(step, p.Scale)]
    if scales and not all(float(s.scale).is_integer() and float(s.offset).is_integer() for s in scales):
        return f".{max(decimals(s.scale, s.offset) for s in scales)}f"
    if scales and any(isinstance(s.scale, float) or isinstance(s.offset, float) for s in scales):
        return ".0f"
    return ""


def decimals(scale: float, offset: float) -> int:
    """So many that one raw step shows, and no more than the scale has."""
    wanted = 0
    for number in (scale, offset):
        text = f"{number:.9f}".rstrip("0")
        exact = len(text.partition(".")[2])
        if exact > 6 or (number and abs(number) < 1e-6):
            exact = max(0, math.ceil(-math.log10(abs(scale)))) + 1
        wanted = max(wanted, exact)
    return min(wanted, 15)


def shell_quoted(text: str) -> str:
    return f'"{printable(text)}"'


def anything(value: Any) -> str:
    """Return a value of no fixed shape."""
    match value:
        case None:
            return "unknown"
        case FlagSet():
            return "{" + ", ".join(flag_names(value)) + "}"
        case bool():
            return str(value).lower()
        case float():
            return f"{value:.10g}"
        case bytes():
            return spaced_hexadecimal(value)
        case str():
            return shell_quoted(value)
        case tuple() | list():
            return f"[{', '.join(map(anything, value))}]"
        case _:
            names = getattr(value, "__struct_fields__", None)
            if names is not None:
                return (
                    "{"
                    + ", ".join(
                        f"{name}={anything(getattr(value, name))}" for name in names if name[0] != "_"
                    )
                    + "}"
                )
            return str(json_value(value))


def spaced_hexadecimal(data: bytes) -> str:
    return data.hex(" ").upper()
