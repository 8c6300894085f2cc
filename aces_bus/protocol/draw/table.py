"""The fields of a message as a table: place, type, unit, scale, range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ..declare.bits import whole_bits
from ..declare.message import Message
from ..declare.pattern import describe_values
from ..plan import nodes as p
from .cells import is_long, listed, range_text, span_of


@dataclass(frozen=True)
class FieldRow:
    """One line of a field table. `place` is where it is, `range` what it can be or, if stated, what may be sent."""

    name: str
    place: str
    type: str
    unit: str = ""
    scale: str = ""
    offset: str = ""
    range: str = ""
    names: str = ""
    doc: str = ""

    @staticmethod
    def table(plan: p.MessagePlan, captured: Mapping[str, str] | None = None) -> list[FieldRow]:
        """Return the fields of a message; `captured` says what captured parts can be."""
        rows: list[FieldRow] = []
        for path in p.walk(plan.fields, is_long):
            if path.node.is_leaf or is_long(path.node):
                doc = path.doc
                if path.whens:
                    when = path.whens[-1]
                    only = f"only while {when.selector.name} is {listed(when.values)}"
                    doc = f"{only}; {doc}" if doc else only
                rows.append(_field_row(path.path, path.node, doc, captured or {}))
            rows += [_inner_row(inner) for inner in path.node.inside(path)]
        return rows

    @staticmethod
    def of(name: str, node: p.Node, doc: str = "") -> FieldRow:
        """Return the line of a single value, such as a register's."""
        return _field_row(name, node, doc, {})

    @staticmethod
    def captured(message: Message) -> dict[str, str]:
        """Return the values of the captured parts of identifier and head."""
        captures = list(message.identifier.captures)
        for head in message.heads_written:
            captures += head.pattern.captures if head.pattern is not None else ()
        return {capture.name: describe_values(capture.values) for capture in captures}

    @staticmethod
    def bits_place(bits: Sequence[int]) -> str:
        """Return a place in words: `byte 2…5`, `byte 1 bits 7…4 + byte 2`."""
        by_byte: dict[int, list[int]] = {}
        for bit in sorted(bits):
            by_byte.setdefault(bit // 8, []).append(bit % 8)
        parts: list[str] = []
        whole: list[int] = []
        for byte, inside in by_byte.items():
            if len(inside) == 8:
                if whole and whole[-1] == byte - 1:
                    whole.append(byte)
                    parts[-1] = f"byte {whole[0]}…{byte}"
                else:
                    whole = [byte]
                    parts.append(f"byte {byte}")
                continue
            if inside == list(range(inside[0], inside[-1] + 1)):
                text = f"bits {inside[-1]}…{inside[0]}" if len(inside) > 1 else f"bit {inside[0]}"
            else:
                text = f"bits {', '.join(map(str, reversed(inside)))}"
            parts.append(f"byte {byte} {text}")
        return " + ".join(parts)


def _inner_row(leaf: p.NodePath) -> FieldRow:
    """Return the line of a value inside a list of items."""
    row = _field_row(leaf.path, leaf.node.alone, leaf.doc, {})
    where = ["of each"] if leaf.node.repeats else []
    if leaf.kind is not None:
        where.append(f"{'in' if where else 'of'} tag {leaf.kind.number}")
    return replace(row, place=" ".join([row.place, *where]))


def _field_row(name: str, node: p.Node, doc: str, captured: Mapping[str, str]) -> FieldRow:
    match node:
        case p.Many():
            span = span_of(node)
            inner = _field_row("", node.items[0], "", captured) if node.items else FieldRow("", "", "")
            place = "byte " + range_text(*span) if span is not None else ""
            kind = f"{len(node.items)} × {inner.type or 'record'}"
            return FieldRow(
                name, place, kind, inner.unit, inner.scale, inner.offset, inner.range, inner.names, doc
            )
        case p.Scalar():
            return _scalar_row(name, node, doc)
        case p.FromIdentifier():
            place = FieldRow.bits_place(node.place)
            if node.number is None:
                last = node.shift + node.width - 1
                place = "identifier" if node.is_alone else f"identifier {last}…{node.shift}"
            kind = f"uint{node.width}"
            return FieldRow(
                name, place, kind, node.unit, *_scaling(node)[:2], captured.get(name, ""), _names(node), doc
            )
        case p.FromRequest():
            return FieldRow(name, "request", "as there", doc=doc)
        case p.Rest():
            return FieldRow(name, "other bits", f"of {node.size} bytes", doc=doc)
        case p.DescribedItems():
            items = _field_row(name, node.items, doc or node.reason, captured)
            return replace(items, place="", type="items, by construct")
        case p.TaggedItems():
            tags = ", ".join(f"{kind.number}={kind.name}" for kind in node.kinds)
            return FieldRow(name, f"byte {node.offset}…", "items", names=tags, doc=doc)
        case p.Repeated():
            inner = _field_row("", node.plan.fields[0].node, "", captured)
            kind = (
                f"groups of {node.width}" if not node.plan.fields[0].node.is_leaf else f"any × {inner.type}"
            )
            return FieldRow(
                name,
                f"byte {node.offset}…",
                kind,
                inner.unit,
                inner.scale,
                inner.offset,
                inner.range,
                inner.names,
                doc,
            )
        case p.DelimitedField():
            kind = {"names": "enumeration"}.get(node.conversion, node.conversion)
            note = "may be left out" if node.optional else ""
            return FieldRow(name, f"field {node.index}", kind, node.unit, names=_names(node), doc=doc or note)
        case p.MoreCells():
            return FieldRow(name, f"field {node.start}…", "texts", doc=doc)
        case p.ByBits():
            row = _field_row(name, node.known, doc, captured)
            return replace(row, place=node.place_text)
        case p.NamedValue():
            return FieldRow(name, "", "number", node.unit, names=_names(node), doc=doc)
        case _:
            return FieldRow(name, "", "by construct", doc=doc or node.reason)


def _scalar_row(name: str, node: p.Scalar, doc: str) -> FieldRow:
    scale, offset, span = _scaling(node)
    if node.is_bytes:
        place = f"byte {node.offset}…" if node.size is None else f"byte {range_text(node.offset, node.size)}"
        return FieldRow(name, place, node.kind if node.size is None else f"{node.kind}[{node.size}]", doc=doc)
    assert node.size is not None
    if node.kind == "float":
        return FieldRow(
            name,
            FieldRow.bits_place(node.bits) if node.bits else f"byte {range_text(node.offset, node.size)}",
            f"float{len(node.bits) or 8 * node.size}{_order_of(node)}",
            node.unit,
            scale,
            offset,
            span,
            doc=doc,
        )
    width = len(node.bits)
    kind: str = "sign+mag" if node.is_magnitude else node.kind
    for step in node.steps:
        if isinstance(step, p.FlagBits):
            kind = "flags"
        elif isinstance(step, p.ValueNames):
            kind = "enum"
    kind = f"{kind}{width}{_order_of(node)}"
    names = _names(node)
    if not span and width <= 64 and (node.scale is not None or not names) and node.raw_range is not None:
        edges = list(map(float, node.raw_range))
        for step in node.steps:
            if isinstance(step, p.Scale):
                edges = [edge * step.scale + step.offset for edge in edges]
        span = f"{_short(min(edges))}…{_short(max(edges))}"
    return FieldRow(name, FieldRow.bits_place(node.bits), kind, node.unit, scale, offset, span, names, doc)


def _order_of(node: p.Scalar) -> str:
    """Return the byte order, if there are several bytes."""
    if node.size == 1 or (node.bits and len({bit // 8 for bit in node.bits}) == 1):
        return ""
    if not node.bits:
        return " le" if node.order == "little" else " be"
    if list(node.bits) == list(range(node.bits[0], node.bits[0] + len(node.bits))):
        return " le"
    if node.bits == whole_bits(node.offset, node.size or 0, "big"):
        return " be"
    return ""


def _scaling(node: p.Node) -> tuple[str, str, str]:
    """Scale, offset and stated range of a value; empty where there is none."""
    step = node.scale
    if (both := node.by_bit) is not None:
        scale = " or ".join(_short(part.scale) for part in both.scales)
        offset = " or ".join(_short(part.offset) for part in both.scales)
        return scale, offset, " or ".join("…".join(map(_short, ends)) for ends in both.spans)
    if step is None:
        return "", "", ""
    scale = "" if step.scale == 1 else _short(step.scale)
    limits = "" if step.limits is None else "…".join(map(_short, step.limits))
    return scale, _short(step.offset) if step.offset else "", limits


def _names(node: p.Node) -> str:
    parts = [f"{raw}={name}" for raw, name in node.value_names.items()]
    parts += [f"bit {number}={name}" for name, number in node.flags.items()]
    if node.scale is not None and node.scale.unknown:
        runs = ("…".join(map(_short, dict.fromkeys(run))) for run in node.scale.unknown_runs)
        parts.append("not known: " + ", ".join(runs))
    return ", ".join(parts)


def _short(number: float) -> str:
    return str(int(number)) if float(number).is_integer() and abs(number) < 1e12 else f"{number:.6g}"
