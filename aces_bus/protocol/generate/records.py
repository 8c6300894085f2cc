"""Prints record classes, and says of what Python type a field is."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..plan import nodes as p
from .source import NameScope, SourceText, comment_line

#: What the text of record classes calls.
CALLED = ("Record", "Part", "FlagSet", "Any")

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
    if isinstance(node, (p.Scalar, p.FromIdentifier)):
        return _scalar_type(node.kind if isinstance(node, p.Scalar) else "uint", node.steps, raw)
    if isinstance(node, p.Many):
        kinds = [type_of(item, raw=raw, called=called) for item in node.items]
        return f"tuple[{', '.join(kinds)}]" if kinds else "tuple[()]"
    if isinstance(node, p.NestedRecord):
        return called(node.type_name)
    if isinstance(node, p.Rest):
        return "int"
    if isinstance(node, p.FromRequest):
        return "int | None"
    if isinstance(node, p.DelimitedField):
        if raw:
            return "str | None"
        kind = {"text": "str", "number": "float", "integer": "int", "degrees": "float", "names": "str"}[
            node.conversion
        ]
        return f"{kind} | None"
    if isinstance(node, p.MoreCells):
        return "tuple[str, ...]"
    if isinstance(node, p.TaggedItems):
        return f"tuple[{called(node.type_name)}, ...]"
    if isinstance(node, p.Repeated):
        (group,) = node.plan.fields
        return f"tuple[{type_of(group.node, raw=raw, called=called)}, ...]"
    return "Any"


def _scalar_type(kind: str, steps: Sequence[p.Step], raw: bool) -> str:
    base = {
        "uint": "int",
        "int": "int",
        "float": "float",
        "bytes": "bytes",
        "text": "bytes" if raw else "str",
    }[kind]
    if raw:
        return base
    for step in steps:
        if isinstance(step, p.Scale):
            if step.scale != 1 or step.offset:
                whole = isinstance(step.scale, int) and isinstance(step.offset, int)
                base = base if whole else "float"
            if step.names:
                base += " | str"
            if step.unknown:
                base += " | None"
        elif isinstance(step, p.ValueNames):
            base = "str | int"
        elif isinstance(step, p.FlagBits):
            base = "FlagSet"
    return base


def groups_of(fields: Sequence[p.PlanField]) -> list[p.NestedRecord]:
    """Return the nested records among fields, innermost first, each once."""
    inward = sorted(p.walk(fields), key=lambda one: -len(one.way))
    listed: list[p.NestedRecord] = []
    for one in inward:
        if isinstance(one.node, p.TaggedItems):
            for kind in one.node.kinds:
                listed += groups_of(kind.plan.fields)
            listed.append(one.node.record)
        elif isinstance(one.node, p.Repeated):
            listed += groups_of(one.node.plan.fields)
    nested = [one.node for one in inward if isinstance(one.node, p.NestedRecord)]
    return list({node.type_name: node for node in [*listed, *nested]}.values())


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
    names = NameScope(CALLED)
    types = {} if types is None else types
    out.lines(
        f'"""Records of {comment_line(label)}: generated from its spec."""',
        "",
    )
    for plan in plans:
        for group in groups_of(plan.fields):
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
