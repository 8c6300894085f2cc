"""The single values of a message, from its plan: nested records and lists taken apart, each value under its path.

1. A leaf's path is what a record's attribute path is: `motor.0.errors`. A selector is named by the path of its field.
2. Every field of the plan is a leaf; what a printer cannot say of one is a `Loss`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import construct as c

from ..declare.message import Message
from ..plan import nodes as p
from ..plan.flatten import NotFlat, flatten, scalar_of
from .problems import clean_text


@dataclass(frozen=True)
class Loss:
    """What another form cannot say of a field ("" for the whole message), of a message ("" for all), and what is done."""

    message: str
    field: str
    reason: str

    def __str__(self) -> str:
        where = ".".join(filter(None, (self.message, self.field)))
        return f"{where}: {self.reason}" if where else self.reason


#: (path of the selector, raw values) that a leaf is there for, the outermost first.
Whens = tuple[tuple[str, tuple[int, ...]], ...]


@dataclass(frozen=True)
class PlanLeaf:
    """One value: where it is (`node`), what it is called, when it is there."""

    path: str
    node: p.Node
    whens: Whens = ()
    doc: str = ""

    @property
    def identifier(self) -> str:
        """The path as one name: `motor_0_errors`."""
        return self.path.replace(".", "_")


def plan_leaves(plan: p.MessagePlan) -> list[PlanLeaf]:
    """The single values of a message, in order."""
    return list(_leaves(plan.fields, "", ()))


def fixed_leaves(message: Message) -> tuple[list[PlanLeaf], int]:
    """As `leaves`; and of a payload that does not flatten those numbers that stand before what has no fixed place, and
    where that begins."""
    plan = flatten(message)
    found, offset = plan_leaves(plan), message.payload_start
    if not plan.opaque or not isinstance(message.payload, c.Struct):
        return found, offset
    known: dict[str, p.Scalar] = {}
    for item in message.payload.subcons:
        body = item.subcon if isinstance(item, c.Renamed) else item
        if isinstance(body, c.Const):
            offset += len(body.build(None))
            continue
        try:
            scalar = scalar_of(item, offset)
        except NotFlat:
            break
        if scalar.size is None:
            break
        if item.name:
            known[item.name] = scalar
        offset += scalar.size
    return [replace(leaf, node=known.get(leaf.path, leaf.node)) for leaf in found], offset


def _leaves(fields: Sequence[p.PlanField], prefix: str, outer: Whens) -> Iterator[PlanLeaf]:
    by_name = {one.name: one for one in fields}
    for one in fields:
        whens = (*outer, *_whens(one, by_name, prefix))
        yield from _node(prefix + one.name, one.node, whens, one.doc)


def _whens(field: p.PlanField, by_name: Mapping[str, p.PlanField], prefix: str) -> Whens:
    found: list[tuple[str, tuple[int, ...]]] = []
    when = field.when
    while when is not None and all(prefix + when.selector.name != path for path, _ in found):
        found.insert(0, (prefix + when.selector.name, when.values))
        selector = by_name.get(when.selector.name)
        when = selector.when if selector is not None else None
    return tuple(found)


def _node(path: str, node: p.Node, whens: Whens, doc: str) -> Iterator[PlanLeaf]:
    if isinstance(node, p.NestedRecord):
        yield from _leaves(node.fields, f"{path}.", whens)
    elif isinstance(node, p.Many):
        for index, item in enumerate(node.items):
            yield from _node(f"{path}.{index}", item, whens, doc if not index else "")
    else:
        yield PlanLeaf(path, node, whens, doc)


def bits_of(node: p.Scalar) -> tuple[int, ...]:
    """The canonical bit numbers of a number of fixed size, lowest bit first."""
    if node.bits:
        return node.bits
    assert node.size is not None
    if node.order == "big":
        return p.big_endian_bits(node.offset, node.size)
    return tuple(range(8 * node.offset, 8 * (node.offset + node.size)))


def number_bits(node: p.FromIdentifier) -> tuple[int, ...]:
    """The bits of a captured part of a head number; of the whole number where the part is added to it."""
    assert node.number is not None
    bits = bits_of(node.number)
    return bits if node.is_alone else bits[node.shift : node.shift + node.width]


def runs(bits: Sequence[int]) -> list[tuple[int, int]]:
    """Bit numbers as runs that go upward: (first bit, width), in order."""
    found: list[tuple[int, int]] = []
    for bit in bits:
        if found and found[-1][0] + found[-1][1] == bit:
            found[-1] = (found[-1][0], found[-1][1] + 1)
        else:
            found.append((bit, 1))
    return found


def scale_of(node: p.Scalar | p.FromIdentifier) -> p.Scale | None:
    """What makes the raw number a quantity."""
    return next((step for step in node.steps if isinstance(step, p.Scale)), None)


def value_names(node: p.Scalar | p.FromIdentifier) -> dict[int, str]:
    """The names of raw numbers."""
    found: dict[int, str] = {}
    for step in node.steps:
        if isinstance(step, p.ValueNames):
            found.update(step.values)
        elif isinstance(step, p.Scale):
            found.update(step.names)
    return found


def flags_of(node: p.Scalar) -> dict[int, str]:
    """The names of single bits."""
    found = [(bit, name) for step in node.steps if isinstance(step, p.FlagBits) for name, bit in step.bits]
    return dict(sorted(found))


def is_magnitude(node: p.Scalar) -> bool:
    return any(isinstance(step, p.Magnitude) for step in node.steps)


def one_line(text: str) -> str:
    """A text of somebody's as part of a comment: printable, without line ends."""
    return " ".join(clean_text(text).split())


def snake(name: str) -> str:
    """`NameInfo3` as `name_info3`, in ASCII."""
    return re.sub(r"\W", "_", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name), flags=re.ASCII).lower()


__all__ = [
    "Loss",
    "PlanLeaf",
    "Whens",
    "bits_of",
    "fixed_leaves",
    "flags_of",
    "is_magnitude",
    "number_bits",
    "one_line",
    "plan_leaves",
    "runs",
    "scale_of",
    "snake",
    "value_names",
]
