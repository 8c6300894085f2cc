"""Values as texts for people: a function a node of a plan, and one for values of no fixed shape.

1. A number has as many decimals as one raw step shows.
2. Nothing that came over a wire gives a control character.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from aces_bus.plain_text import printable
from aces_bus.protocol import FlagSet
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.record import FieldValue

from .shape import flag_names, getter, json_value, nameless_number

Show = Callable[[Any], str]


def unit_mark(node: p.Node) -> str:
    """Return what is behind a value of the node: its unit."""
    return f" {node.unit}" if node.unit else ""


def value_printer(node: p.Node) -> Show:
    """Return how the values of a node are printed."""
    return node.shaped(_Texts())


class _Texts:
    """Functions that print values, by their shape."""

    def single(self, node: p.Node) -> Show:
        if node.is_unclaimed:
            return hex
        if units := node.inner_units:
            return _show_items({}, lambda data: _with_units(data, units))
        if node.part_units:
            return lambda value: _with_units(value, node.part_units)
        return _show_number(node) if node.is_number else anything

    def several(self, node: p.Node, items: Sequence[p.Node]) -> Show:
        shows = [item.shaped(self) for item in items]
        units = ["" if node.unit else unit_mark(item) for item in items]

        def many(values: Any) -> str:
            shown = (_or_unknown(s, v) + u for s, v, u in zip(shows, values, units, strict=True))
            return f"[{', '.join(shown)}]"

        return many

    def record(self, node: p.Node, type_name: str, fields: Sequence[p.PlanField]) -> Show:
        inner = [(f.name, getter((f.name,)), f.node.shaped(self), unit_mark(f.node)) for f in fields]
        return lambda value: (
            "{" + ", ".join(f"{n}={_or_unknown(s, g(value))}{u}" for n, g, s, u in inner) + "}"
        )

    def each(self, node: p.Node, item: p.Node) -> Show:
        shown, unit = item.shaped(self), unit_mark(item)
        return lambda values: f"[{', '.join(_or_unknown(shown, value) + unit for value in values)}]"

    def tagged(self, node: p.Node, type_name: str, kinds: Sequence[p.ItemKind]) -> Show:
        nodes = {kind.name: kind.plan.fields[0].node for kind in kinds}
        return _show_items({name: (inner.shaped(self), unit_mark(inner)) for name, inner in nodes.items()})


def _or_unknown(shown: Show, value: FieldValue) -> str:
    return "unknown" if value is None else shown(value)


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


def _with_units(value: FieldValue, units: Mapping[str, str], path: str = "") -> str:
    """Return values of no fixed shape, numbers with their units: by the path of names."""
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(_with_units(item, units, path) for item in value)}]"
    names = getattr(value, "__struct_fields__", None)
    if names is not None and not isinstance(value, FlagSet):
        shown = (
            f"{name}={_with_units(getattr(value, name), units, f'{path}.{name}' if path else name)}"
            for name in names
            if name[0] != "_"
        )
        return f"{{{', '.join(shown)}}}"
    unit = units.get(path, "") if isinstance(value, (int, float)) and not isinstance(value, bool) else ""
    return f"{anything(value)} {unit}".rstrip()


def _show_number(node: p.Node) -> Show:
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
    if node.digits is not None:
        return f".{node.digits}g"
    scales = node.scales if node.by_bit is None else node.by_bit.scales
    if scales and not all(float(s.scale).is_integer() and float(s.offset).is_integer() for s in scales):
        return f".{max(decimals(s.scale, s.offset) for s in scales)}f"
    if scales and any(isinstance(s.scale, float) or isinstance(s.offset, float) for s in scales):
        return ".0f"
    return ""


def decimals(scale: float, offset: float) -> int:
    """Return the number of decimals that one raw step shows, and no more than the scale has."""
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


def anything(value: FieldValue) -> str:
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
