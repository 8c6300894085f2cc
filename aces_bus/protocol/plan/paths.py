"""Where a value is: in the plan, in the record, and by its name; and the walk that finds all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import msgspec
from msgspec.structs import replace

from ..record import WayStep

if TYPE_CHECKING:
    from .nodes import ItemKind, Node, PlanField, When


class NodePath(msgspec.Struct, frozen=True):
    """A node and where its value is: `path` as columns and conditions name it (`servos.0.id`), `way` as the steps to the
    value in the record.

    `field` is the field of the message, `doc` that of the innermost one. `whens` are the conditions that it is there for,
    the outermost first; `conditions` the same with the paths of their selectors, and with the conditions of these.
    """

    path: str
    way: tuple[WayStep, ...]
    node: Node
    field: PlanField
    doc: str = ""
    whens: tuple[When, ...] = ()
    conditions: tuple[tuple[str, When], ...] = ()

    @property
    def identifier(self) -> str:
        """The path as one name: `motor_0_errors`."""
        return self.path.replace(".", "_")


class ItemPath(NodePath, frozen=True):
    """A value inside a list; positions count from the data of its item (of `kind`) or from its group (None)."""

    kind: ItemKind | None = None
    #: The path in the plan of that.
    inner: str = ""


def walk(
    fields: Sequence[PlanField], is_whole: Callable[[Node], bool] = lambda node: False
) -> Iterator[NodePath]:
    """Yield every node below these fields, the outer before the inner; of those that are taken as a whole only
    themselves.
    """
    for field in fields:
        yield from _inside(field.name, field, None, "", is_whole)


def _inside(
    step: str | int,
    field: PlanField,
    outer: NodePath | None,
    prefix: str,
    is_whole: Callable[[Node], bool],
) -> Iterator[NodePath]:
    path, when = f"{prefix}{step}", field.when
    if outer is None:
        here = NodePath(path, (step,), field.node, field, field.doc)
    else:
        # What is said of a list is said of its first item.
        doc = field.doc if isinstance(step, str) else "" if step else outer.doc
        here = NodePath(path, (*outer.way, step), field.node, outer.field, doc, outer.whens, outer.conditions)
    if when is not None:
        conditions = _conditions(prefix, when, here.conditions)
        here = replace(here, whens=(*here.whens, when), conditions=conditions)
    yield here
    for inner, child in field.node.children if not is_whole(field.node) else ():
        yield from _inside(inner, child, here, f"{path}.", is_whole)


def _conditions(
    prefix: str, when: When | None, known: tuple[tuple[str, When], ...]
) -> tuple[tuple[str, When], ...]:
    if when is None or any(when == one for _, one in known):
        return known
    return (*_conditions(prefix, when.selector.when, known), (prefix + when.selector.name, when))
