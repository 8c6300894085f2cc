"""Prints record classes, and says of what Python type a field is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
    names = NameScope(CALLED)
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
