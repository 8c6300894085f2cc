"""What differs between two versions or dialects of a protocol: messages, templates, fields.

1. Messages are compared by name; of those that are in one only, two with the same template are taken for one message under
   two names.
2. Docs and sources do not count; what changes a byte or its meaning does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from aces_bus.protocol import Message, Quantity
from aces_bus.protocol.declare.bits import Bits
from aces_bus.protocol.declare.fields import wire_number
from aces_bus.protocol.draw.table import FieldRow
from aces_bus.protocol.lint.fields import Written, payload_fields
from aces_bus.protocol.plan.flatten import flatten
from aces_bus.protocol.record import PlainValue

#: Columns of a field's line that are compared, and what each is called.
COMPARED = ("place", "type", "unit", "scale", "offset", "range", "names")


@dataclass(frozen=True)
class Change:
    """Something that is another: `what` was `old` and is `new`; "" where there is none."""

    what: str
    old: str
    new: str


@dataclass
class Changed:
    """A message that both have, perhaps under two names."""

    old: str
    new: str
    template: list[Change] = field(default_factory=list)
    #: Field → what is another; a field that only one has is one change of "field".
    fields: dict[str, list[Change]] = field(default_factory=dict)

    @property
    def is_same(self) -> bool:
        return self.old == self.new and not self.template and not self.fields


@dataclass
class Difference:
    """What differs between two specs, by message."""

    removed: list[str]
    added: list[str]
    changed: list[Changed]
    same: int

    @property
    def is_none(self) -> bool:
        return not (self.removed or self.added or self.changed)

    def as_dict(self) -> dict[str, PlainValue]:
        """Return it for JSON."""
        return {
            "removed": self.removed,
            "added": self.added,
            "changed": [
                {
                    "message": message.new,
                    "was": message.old,
                    "template": [vars(c) for c in message.template],
                    "fields": {name: [vars(c) for c in changes] for name, changes in message.fields.items()},
                }
                for message in self.changed
            ],
            "same": self.same,
        }


def spec_difference(old: Mapping[str, Message], new: Mapping[str, Message]) -> Difference:
    """Return what differs from `old` to `new`."""
    removed = [name for name in old if name not in new]
    added = [name for name in new if name not in old]
    pairs = [(name, name) for name in old if name in new]
    for before, other in _renamed([old[n] for n in removed], [new[n] for n in added]):
        removed.remove(before)
        added.remove(other)
        pairs.append((before, other))
    changed = [_compared(old[before], new[other]) for before, other in pairs]
    different = [message for message in changed if not message.is_same]
    return Difference(removed, added, different, len(changed) - len(different))


def _renamed(removed: Sequence[Message], added: Sequence[Message]) -> list[tuple[str, str]]:
    """Return pairs with one template, where it is clear which goes with which; same fields before same
    template alone.
    """
    found: list[tuple[str, str]] = []
    for key in (_exactly, _template_key):
        mine = [m for m in removed if m.name not in {before for before, _ in found}]
        theirs = [m for m in added if m.name not in {other for _, other in found}]
        by_key: dict[Any, tuple[list[str], list[str]]] = {}
        for side, messages in enumerate((mine, theirs)):
            for message in messages:
                by_key.setdefault(key(message), ([], []))[side].append(message.name)
        found += [
            (before[0], other[0]) for before, other in by_key.values() if len(before) == len(other) == 1
        ]
    return found


def _template_key(message: Message) -> Any:
    plan = flatten(message)
    return (
        message.identifier.describe(),
        (message.extended, message.remote, message.formats),
        plan.constants,
        plan.one_of,
        message.direction,
    )


def _exactly(message: Message) -> Any:
    plan = flatten(message)
    return (
        _template_key(message),
        plan.lengths,
        tuple((row.name, *(getattr(row, column) for column in COMPARED)) for row in FieldRow.table(plan)),
    )


def _compared(old: Message, new: Message) -> Changed:
    found = Changed(old.name, new.name)
    before, behind = _facts(old), _facts(new)
    for what in before:
        if before[what] != behind[what]:
            found.template.append(Change(what, before[what], behind[what]))
    rows, others = _rows(old), _rows(new)
    gone = [name for name in rows if name not in others]
    fresh = [name for name in others if name not in rows]
    for name in list(gone):
        like = [n for n in fresh if (others[n].place, others[n].type) == (rows[name].place, rows[name].type)]
        if len(like) == 1 and rows[name].place not in ("", "request", "other bits"):
            gone.remove(name)
            fresh.remove(like[0])
            found.fields[name] = [Change("name", name, like[0]), *_columns(rows[name], others[like[0]])]
    for name in rows:
        if name in others and (changes := _columns(rows[name], others[name])):
            found.fields[name] = changes
    for name in gone:
        found.fields[name] = [Change("field", _described(rows[name]), "")]
    for name in fresh:
        found.fields[name] = [Change("field", "", _described(others[name]))]
    return found


def _rows(message: Message) -> dict[str, FieldRow]:
    """Return the lines of a message's fields; of those that only construct takes apart, what is in them too."""
    plan = flatten(message)
    rows = {row.name: row for row in FieldRow.table(plan, FieldRow.captured(message))}
    opaque = set(plan.opaque_names)
    for written in payload_fields(message):
        name = written.name
        if name.partition(".")[0] in opaque and name not in opaque:
            while name in rows:  # another branch has a field of this name
                name += "'"
            rows[name] = _written_row(name, written)
    return rows


def _written_row(name: str, written: Written) -> FieldRow:
    """Return the line of a field without a fixed place, from its adapters and the number below them."""
    wire = wire_number(written.inner)
    kind = type(written.inner).__name__
    if wire is not None:
        kind = f"{wire.kind}{8 * wire.size}{f' {wire.order[0]}e' if wire.size > 1 else ''}"
    elif isinstance(written.inner, Bits):
        kind = f"{'int' if written.inner.signed else 'uint'}{written.inner.width}"
    unit = scale = offset = span = ""
    names: list[str] = []
    for adapter in written.adapters:
        kind = f"{type(adapter).__name__} of {kind}"
        names += [f"{number}={text}" for text, number in getattr(adapter, "names", {}).items()]
        if isinstance(adapter, Quantity):
            unit, scale, offset = adapter.unit, f"{adapter.scale:g}", f"{adapter.offset:g}"
            span = " ".join(
                str(bounds) for bounds in (adapter.range, adapter.raw_range) if bounds is not None
            )
            names += [f"not known: {adapter.unknown}"] if adapter.unknown else []
    return FieldRow(name, "", kind, unit, scale, offset, span, ", ".join(names))


def _columns(old: FieldRow, new: FieldRow) -> list[Change]:
    return [
        Change(column, getattr(old, column), getattr(new, column))
        for column in COMPARED
        if getattr(old, column) != getattr(new, column)
    ]


def _described(row: FieldRow) -> str:
    return ", ".join(filter(None, [row.place, row.type, row.unit]))


def _facts(message: Message) -> dict[str, str]:
    """Return what says which frames or packets are this message, and how long they are."""
    plan = flatten(message)
    kinds = (("29 bits", message.extended), ("remote", message.remote), ("CAN FD", message.fd))
    framing = message.framing
    check = message.check if message.check is not None else framing.check if framing is not None else None
    return {
        "identifier": message.identifier.describe(8 if message.extended else 3) if framing is None else "",
        "kind": ", ".join(kind for kind, given in kinds if given),
        "sync": framing.sync.hex(" ").upper() if framing is not None else "",
        "constants": ", ".join(
            _constant(constant.offset, constant.mask, constant.value) for constant in plan.constants
        ),
        "length": message.describe_lengths
        or ("" if plan.lengths is None else f"{', '.join(map(str, plan.lengths))} bytes")
        or f"{plan.least} bytes or more",
        "check": check.describe if check is not None else "",
        "direction": message.direction or "",
        "reply to": ", ".join(map(str, message.reply_to)),
        "after": ", ".join(map(str, message.after)),
        "only where": ", ".join(
            f"{c.key} of {c.capture} is {', '.join(sorted(map(str, c.values)))}" for c in message.when
        ),
        "decoded by": f"construct ({plan.opaque})" if plan.opaque else "",
    }


def _constant(offset: int, mask: int, value: int) -> str:
    return f"byte {offset}{'' if mask == 0xFF else f' & {mask:#04x}'}={value:#04x}"


def difference_lines(found: Difference) -> list[tuple[str, str]]:
    """Return (style, line) of a difference for people: `-` is gone, `+` is new, `~` has changed."""
    lines: list[tuple[str, str]] = []
    lines += [("malformed", f"- {name}") for name in found.removed]
    lines += [("from device", f"+ {name}") for name in found.added]
    for message in found.changed:
        name = message.new if message.old == message.new else f"{message.old} → {message.new}"
        lines.append(("message", f"~ {name}"))
        lines += [("value", f"    {c.what}: {_arrow(c)}") for c in message.template]
        for field_name, changes in message.fields.items():
            first = changes[0]
            if first.what == "field":
                sign, style, text = (
                    ("+", "from device", first.new) if first.new else ("-", "malformed", first.old)
                )
                lines.append((style, f"    {sign} {field_name}: {text}"))
                continue
            moved = any(c.what == "place" for c in changes)
            parts = [f"moved {_arrow(c)}" if c.what == "place" else f"{c.what} {_arrow(c)}" for c in changes]
            lines.append(("flags" if moved else "value", f"    ~ {field_name}: {'; '.join(parts)}"))
    return lines


def _arrow(change: Change) -> str:
    return f"{change.old or 'none'} → {change.new or 'none'}"
