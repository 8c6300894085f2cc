"""Decoded values as the live screen shows them: a short line for the table, every single value for the details.

1. What can be known of a message without its records is found once: names, units, places, its page.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from aces_bus.protocol import Message, Record, Variant
from aces_bus.protocol.draw.table import FieldRow
from aces_bus.protocol.draw.text import picture
from aces_bus.protocol.generate.load import records_of
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.record import FieldValue

from ..output.shape import RecordLeaf, getter, record_leaves
from ..output.value_text import value_printer

#: Levels of a curve.
BLOCKS = "▁▂▃▄▅▆▇█"


class Value(NamedTuple):
    """One value of a record. `place` is where it is in the message, `curve` how it went."""

    path: str
    text: str
    unit: str
    place: str
    doc: str
    curve: str


class FieldText(NamedTuple):
    """One field for the table: `name=` `text` ` unit`."""

    name: str
    text: str
    unit: str


class FieldFormat:
    """How one message's records are shown."""

    def __init__(self, variant: Variant, message: Message) -> None:
        self.protocol, self.name = variant.name, message.name
        self.label = variant.label
        self.direction = message.direction
        self._message = message
        plan = self._plan = message.plan
        self.doc = plan.doc
        self.names = tuple(field.name for field in plan.fields)
        decide = dict.fromkeys(
            [head.name for head in message.heads] + [selector.name for selector in plan.selectors]
        )
        #: The fields that say what the rest means, or whom it is about.
        self.page = tuple(name for name in decide if name in self.names)
        self._short: list[tuple[p.PlanField, Callable[[Any], Any], Callable[[Any], str], str]] = [
            (field, getter((field.name,)), value_printer(field.node), field.node.unit)
            for field in plan.fields
        ]
        self._leaves: list[tuple[RecordLeaf, Callable[[Any], str], str]] | None = None
        self._rows: dict[str, FieldRow] = {}
        self._picture: list[str] | None = None

    def page_of(self, record: Record) -> list[tuple[str, Any]]:
        """Return the page's names and values."""
        return [(name, getattr(record, name)) for name in self.page]

    def tokens(self, record: Record) -> Iterator[FieldText]:
        """Yield the fields, each as a whole; those that are not there are left out."""
        for field, get, shown, unit in self._short:
            value = get(record)
            if value is None:
                if field.when is None and not field.node.is_of_request:
                    yield FieldText(field.name, "unknown", "")
            elif value or not field.node.is_quiet:
                yield FieldText(field.name, shown(value), unit)

    def values(self, record: Record, history: Sequence[Record] = (), width: int = 24) -> list[Value]:
        """Return every single value, lists and nested records taken apart, with its curve over `history`."""
        if self._leaves is None:
            self._leaves = [
                (leaf, value_printer(leaf.node), leaf.node.unit) for leaf in record_leaves(self._plan)
            ]
            captured = FieldRow.captured(self._message)
            self._rows = {row.name: row for row in FieldRow.table(self._plan, captured)}
        found: list[Value] = []
        for leaf, shown, unit in self._leaves:
            value = leaf.get(record)
            if value is None and leaf.conditional:
                continue
            row = self._rows.get(leaf.path)
            curve = ""
            if isinstance(value, (int, float)) and len(history) > 1:
                curve = sparkline([leaf.get(sample) for sample in history][-width:])
            found.append(
                Value(
                    leaf.path,
                    "unknown" if value is None else shown(value),
                    unit if value is not None else "",
                    row.place if row is not None else "",
                    row.doc if row is not None else "",
                    curve,
                )
            )
        return found

    @property
    def picture(self) -> list[str]:
        """The message's layout, bit by bit, 79 columns wide."""
        if self._picture is None:
            self._picture = picture(self._message)
        return self._picture


def sparkline(values: Sequence[Any]) -> str:
    """Return a curve of blocks, from the least value to the greatest; nothing where nothing varies.

    >>> sparkline([0, 1, 2, 3, None, 7])
    '▁▂▃▄ █'
    """
    numbers = [value for value in values if _is_number(value)]
    if not numbers:
        return ""
    least, most = min(numbers), max(numbers)
    if not most > least:
        return ""
    scale = (len(BLOCKS) - 1) / (most - least)
    return "".join(BLOCKS[round((v - least) * scale)] if _is_number(v) else " " for v in values)


def _is_number(value: FieldValue) -> bool:
    return isinstance(value, (int, float)) and -1e300 < value < 1e300


class FieldsOfKinds(dict[type, FieldFormat | None]):
    """By the type of an item; None for what is not a record. Each is made when the first of its items comes."""

    def __init__(self, variants: Sequence[Variant]) -> None:
        super().__init__()
        self._variants = variants

    def __missing__(self, kind: type) -> FieldFormat | None:
        made = None
        for variant in self._variants:
            if kind.__name__ in variant.messages and records_of(variant)[kind.__name__] is kind:
                made = FieldFormat(variant, variant.messages[kind.__name__])
        self[kind] = made
        return made
