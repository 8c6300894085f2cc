"""From a message to its plan.

1. Flattening only reads; whatever it cannot read becomes an opaque plan with the reason, never a wrong one.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from functools import lru_cache, reduce
from typing import Any, Literal

import construct as c
from construct import Construct
from msgspec.structs import replace

from ...frames import key_of
from ..declare import delimited as d
from ..declare.bits import BitLayout, Bits, ByteSplit, LayoutSlot, whole_bits
from ..declare.fields import (
    Counter,
    Enumeration,
    Flags,
    Multiplexed,
    Present,
    Quantity,
    SignMagnitude,
    Text,
    TwoScales,
    wire_number,
)
from ..declare.head import Head
from ..declare.items import ItemList, Items
from ..declare.message import Message
from ..declare.normalise import inner_constructs, sizes
from ..declare.pattern import IdField, IdPattern
from ..declare.shapes import Shapes, has_shapes
from ..declare.vocabulary import construct_name
from . import nodes as p

# ---------------------------------------------------------------------- one value: its bits and steps


class NotFlat(Exception):
    """This construct cannot be flattened; the argument says why."""


def scale_of(quantity: Quantity) -> p.Scale:
    """Return what a quantity makes of a raw number."""
    return p.Scale(
        quantity.scale,
        quantity.offset,
        quantity.unknown,
        quantity.range,
        quantity.raw_range,
        quantity.rounding,
        tuple((value, name) for name, value in quantity.names.items()),
    )


def peeled(con: c.Construct) -> tuple[c.Construct, list[p.Step], str, str]:
    """Return the construct below the known adapters, the steps from it outward, unit and doc."""
    steps: list[p.Step] = []
    unit = doc = ""
    while True:
        if isinstance(con, c.Renamed):
            doc = doc or con.docs or ""
            con = con.subcon
        elif isinstance(con, (c.Default, Counter)):
            con = con.subcon
        elif isinstance(con, Quantity):
            doc = doc or con.docs or ""
            unit = unit or con.unit
            steps.append(scale_of(con))
            con = con.subcon
        elif isinstance(con, SignMagnitude):
            steps.append(p.Magnitude(con.width))
            con = con.subcon
        elif isinstance(con, TwoScales):
            doc, unit = doc or con.docs or "", unit or con.unit
            clear, set_ = (p.Scale(scale, offset) for scale, offset in con.scales)
            steps.append(p.ScaleByBit(con.half, (clear, set_)))
            con = con.subcon
        elif isinstance(con, Enumeration):
            steps.append(p.ValueNames(tuple((v, k) for k, v in con.names.items())))
            con = con.subcon
        elif isinstance(con, Flags):
            steps.append(p.FlagBits(tuple(con.names.items())))
            con = con.subcon
        else:
            return con, steps[::-1], unit, doc


def integer_at(
    inner: Bits, offset: int, size: int, positions: Sequence[int], steps: tuple[p.Step, ...], unit: str
) -> p.Scalar:
    """Return an integer at these bits of the `size` bytes from `offset` on."""
    bits = tuple(8 * offset + position for position in positions)
    # What is all of these bytes may be plain ones, the highest first.
    is_big = size > 1 and bits == whole_bits(offset, size, "big")
    return p.Scalar(
        "int" if inner.signed else "uint", offset, size, "big" if is_big else "little", bits, steps, unit
    )


def scalar_of(con: c.Construct, offset: int) -> p.Scalar:
    """One value of fixed size, such as a register's; raises `NotFlat` with the reason."""
    inner, steps, unit, _ = peeled(con)
    found = tuple(steps)
    if isinstance(inner, Text):
        return p.Scalar("text", offset, inner.size, unit=unit, ends=inner.ends)
    if isinstance(inner, c.FormatField) and inner.fmtstr.startswith("="):
        raise NotFlat("native byte order")
    if isinstance(inner, ByteSplit):
        return integer_at(inner, offset, inner.bytes, inner.slot.positions, found, unit)
    wire = wire_number(inner)
    if wire is not None:
        bits = whole_bits(offset, wire.size, wire.order) if wire.kind != "float" else ()
        return p.Scalar(wire.kind, offset, wire.size, wire.order, bits, found, unit)
    if isinstance(inner, c.Bytes) and not isinstance(inner.length, int):
        raise NotFlat("bytes of a length that varies")
    if isinstance(inner, c.Bytes) and not steps:
        return p.Scalar("bytes", offset, inner.length)
    if inner is c.GreedyBytes and not steps:
        return p.Scalar("bytes", offset, None)
    raise NotFlat(f"{construct_name(inner)} has no flat form")


# ---------------------------------------------------------------------- messages


#: The fields of an item's record.
ITEM = ("kind", "data", "reason")


@lru_cache(maxsize=4096)
def flatten(message: Message) -> p.MessagePlan:
    """Return the plan of a message."""
    framing = message.framing
    tail = framing.check_size + len(framing.end) if framing is not None else 0
    base = message.identifier.constant + key_of(
        0, extended=message.extended, remote=message.remote, fd=message.fd
    )
    fields = [
        _capture_field(capture, base, message.identifier.captures, None)
        for capture in message.identifier.captures
    ]
    fields += [p.PlanField(name, p.FromRequest()) for name in message.request_fields]
    constants: list[p.Constant] = []
    one_of: list[p.OneOf] = []
    if framing is not None:
        constants += [p.Constant(i, 0xFF, byte) for i, byte in enumerate(framing.sync)]
    for head in message.heads_written:
        _head(head, head in message.heads, fields, constants, one_of)
    builder = _Builder(message, tail)
    opaque = ""
    all_fields: p.MessagePlan | None = None
    try:
        for head in message.heads_written:
            if head.pattern is not None and _numbers(head.pattern) is None:
                raise NotFlat(f"{head.name} has {len(head.pattern)} scattered values")
        builder.payload(message.payload)
    except NotFlat as reason:
        opaque = str(reason)
        names = message.fields[len(fields) :]
        read = builder.constants  # what was read before it stopped is true all the same
        builder = _Builder(message, tail)
        builder.constants = read
        all_fields = _all_fields(message)
        inside = _by_bits(message, all_fields, opaque) if all_fields is not None else {}
        builder.fields = [
            p.PlanField(name, inside[name] if name in inside else _opaque(message, name, opaque))
            for name in names
        ]
    check = message.check.field if message.check is not None else None
    fields += [f for f in builder.fields if f.name != check]
    least = message.payload_start + (sizes(message.payload)[0] if opaque else builder.least) + tail
    lengths: tuple[int, ...] | None
    if framing is None:
        assert message.lengths is not None
        lengths = tuple(message.lengths)
    elif opaque or builder.is_open:
        lengths = None
    else:
        lengths = (message.payload_start + builder.size + tail,)
    return p.MessagePlan(
        name=message.name,
        fields=tuple(fields),
        constants=tuple(constants + builder.constants),
        one_of=tuple(one_of),
        lengths=lengths if builder.lengths_by is None else None,
        least=least,
        sync=len(framing.sync) if framing is not None else 0,
        framed=framing.min_size if framing is not None else 0,
        tail=tail,
        lengths_by=builder.lengths_by,
        selectors=tuple(builder.selectors),
        split=builder.split,
        is_checked=check is not None,
        opaque=opaque,
        parts=tuple(_parts(message.payload, message.name)) if opaque else (),
        all_fields=all_fields,
        doc=message.doc,
        place=message.place.stable,
    )


def _opaque(message: Message, name: str, reason: str) -> p.Opaque:
    """Return a field that construct decodes, with what is known of its inside."""
    items: Any = next((item for item in getattr(message.payload, "subcons", ()) if item.name == name), None)
    while isinstance(items, c.Renamed):
        items = items.subcon
    if isinstance(items, Items):
        return _Builder(message, 0).described(items, f"{message.name}_{name}", reason)
    if not isinstance(items, ItemList):
        unit, units = _unit_of(items), dict(_units_inside(items))
        return p.OpaqueQuantity(reason, unit, tuple(units.items())) if unit or units else p.Opaque(reason)
    values: list[tuple[str, int, p.NamedValue]] = []
    for value, (number, unit, names) in items.values.items():
        steps = (p.ValueNames(tuple(names.items())),) if names else ()
        values.append((value, number, p.NamedValue(unit, steps, is_float=names is None)))
    return p.OpaqueItems(reason, tuple(values))


def _all_fields(message: Message) -> p.MessagePlan | None:
    """Return the plan of a packet that has all fields of a message whose fields are there by bits, where that is flat."""
    if not has_shapes(message):
        return None
    found = flatten(message.with_payload(c.Struct(*Shapes(message).all_items)))
    return found if found.is_flat else None


def _by_bits(message: Message, all_fields: p.MessagePlan, reason: str) -> dict[str, p.Node]:
    """Return what the fields of a message are that are there by bits."""
    nodes = {field.name: field.node for field in all_fields.fields}
    return {
        item.name: p.ByBits(reason, nodes[item.name], body.selector, body.bit)
        if isinstance(body, Present)
        else p.ByBits(reason, nodes[item.name])
        for item, body in Shapes(message).items
        if item.name in nodes
    }


def _unit_of(con: c.Construct | None) -> str:
    """Return the unit of a value that construct decodes, or of all values of an array; empty where there are several."""
    while con is not None:
        body, _, unit, _ = peeled(con)
        if unit or isinstance(body, (c.Struct, c.Sequence, BitLayout, Items)):
            return unit
        inner = inner_constructs(body)
        if len(inner) > 1:
            units = {_unit_of(part) for part in inner if part is not c.Pass}
            return units.pop() if len(units) == 1 else ""
        con = inner[0] if inner else None
    return ""


def _units_inside(con: Construct, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield path and unit of the numbers inside a value that construct decodes; those of a list have the list's path."""
    inside = (
        [c.Renamed(slot.field, newname=slot.name) for slot in con.slots]
        if isinstance(con, BitLayout)
        else inner_constructs(con)
    )
    for inner in inside:
        name = f"{path}.{inner.name}".removeprefix(".") if isinstance(inner, c.Renamed) else path
        unit = peeled(inner)[2]
        if unit and name != path:
            yield name, unit
        elif not unit:
            yield from _units_inside(inner.subcon if isinstance(inner, c.Renamed) else inner, name)


def _claims(always: int, masks: dict[p.Selector, dict[int, int]], outer: p.When | None) -> tuple[Any, ...]:
    """Return what of a layout its fields claim: the last three values of a `Rest`. `outer` is when the layout is there."""
    if not masks:
        return ((None, always),), None, ()
    selectors = list(masks)
    if len(selectors) == 1 and selectors[0].when == outer:
        claimed = [(value, always | mask) for value, mask in sorted(masks[selectors[0]].items())]
        return (*claimed, (None, always)), selectors[0], ()
    more = tuple((selector, tuple(sorted(by_value.items()))) for selector, by_value in masks.items())
    return ((None, always),), None, more


def _parts(con: c.Construct, path: str, *, top: bool = True) -> list[tuple[str, tuple[str, ...]]]:
    """Return the nested records of an opaque payload."""
    found: list[tuple[str, tuple[str, ...]]] = []
    if isinstance(con, c.Struct):
        names = tuple(item.name for item in con.subcons if item.name)
        if not top:
            found.append((path, names))
        for item in con.subcons:
            found += _parts(item, f"{path}_{item.name}" if item.name else path, top=False)
    elif isinstance(con, Items):
        found.append((path, ITEM))
        for data in con.subcons:
            found += _parts(data, f"{path}_data", top=False)
    elif isinstance(con, BitLayout):
        if not top:
            more = [con.trailing] if con.trailing else []
            found.append((path, (*con.names, *(["reserved"] if con.has_reserved else []), *more)))
    else:
        for inner in inner_constructs(con):
            found += _parts(inner, path, top=False)
    return list(dict.fromkeys(found))


def _head(
    head: Head, is_shown: bool, fields: list[p.PlanField], constants: list[p.Constant], one_of: list[p.OneOf]
) -> None:
    number = p.Scalar(
        "uint", head.offset, head.size, head.order, whole_bits(head.offset, head.size, head.order)
    )
    pattern = head.pattern
    if pattern is not None and not pattern.captures:
        raw = head.bytes(pattern.constant)
        constants.extend(p.Constant(head.offset + i, 0xFF, byte) for i, byte in enumerate(raw))
        return
    if pattern is not None:
        values = _numbers(pattern)
        if values is not None:
            one_of.append(p.OneOf(number, values))
        if not head.is_own:
            fields.extend(
                _capture_field(cap, pattern.constant, pattern.captures, number) for cap in pattern.captures
            )
            return
    if head.name is not None and is_shown:
        scalar = scalar_of(head.field, head.offset)
        fields.append(p.PlanField(head.name, scalar, doc=head.field.docs or ""))


def _numbers(pattern: IdPattern) -> tuple[int, ...] | range | None:
    """Return the numbers of a pattern; one capture of a range stays a range, however long. None: too many to list."""
    if len(pattern) > 4096 and len(pattern.captures) == 1:
        values, shift = pattern.captures[0].values, pattern.captures[0].shift
        if isinstance(values, range) and values.step > 0:
            first, last = pattern.constant + (values[0] << shift), pattern.constant + (values[-1] << shift)
            return range(first, last + 1, values.step << shift)
    return tuple(sorted(pattern)) if len(pattern) <= 65536 else None


def _capture_field(
    capture: IdField, constant: int, captures: tuple[IdField, ...], number: p.Scalar | None
) -> p.PlanField:
    steps: tuple[p.Step, ...] = ()
    if isinstance(capture.quantity, Enumeration):
        steps = (p.ValueNames(tuple((v, k) for k, v in capture.quantity.names.items())),)
    elif capture.quantity is not None:
        steps = (scale_of(capture.quantity),)
    node = p.FromIdentifier(
        constant, capture.shift, capture.width, len(captures) == 1, steps, capture.unit, number
    )
    return p.PlanField(capture.name, node, doc=capture.doc)


def _asked(path: str) -> Any:
    """Return the expression of a field, by its path: `this.flags.count`."""
    return reduce(getattr, path.split("."), c.this)


def fixed_leaves(message: Message) -> tuple[Sequence[p.NodePath], int]:
    """Return the leaves of a message and where unfixed fields begin; of a payload that does not flatten, the
    numbers that stand before any field without a fixed place.
    """
    plan = message.plan
    found, offset = plan.leaves, message.payload_start
    if not plan.opaque or not isinstance(message.payload, c.Struct):
        return found, offset
    known: dict[str, p.Node] = {}
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


class _Builder:
    """Walks a payload, keeping the offset of the next field."""

    def __init__(self, message: Message, tail: int) -> None:
        self.message = message
        self.fields: list[p.PlanField] = []
        self.constants: list[p.Constant] = []
        #: A set that keeps its order.
        self.selectors: dict[p.Selector, None] = {}
        #: When the construct that is being walked is there.
        self.outer: p.When | None = None
        self.split: p.DelimitedSplit | None = None
        self.lengths_by: tuple[p.Selector, tuple[tuple[int, int], ...], int] | None = None
        self.offset = message.payload_start
        self.is_open = False
        self.tail = tail
        self._shapes: dict[tuple[str, tuple[str, ...]], str] = {}

    @property
    def size(self) -> int:
        return self.offset - self.message.payload_start

    least = size

    def payload(self, con: c.Construct) -> None:
        if isinstance(con, c.Struct):
            self.fields = self._struct(con, self.message.name, top=True)
        elif isinstance(con, BitLayout):
            self.fields = self._layout(con)
        else:
            assert isinstance(con, d.Delimited)
            self._delimited(con)

    def _advance(self, size: int | None) -> None:
        if size is None:
            self.is_open = True
        else:
            self.offset += size

    def _struct(self, struct: c.Struct, path: str, *, top: bool) -> list[p.PlanField]:
        fields: list[p.PlanField] = []
        overlay: dict[int, int] | None = None
        selector: p.Selector | None = None
        base = 0
        rebuilt: set[str] = set()
        for item in struct.subcons:
            name = item.name
            body = item.subcon if isinstance(item, c.Renamed) else item
            if body is c.Terminated:
                continue
            if self.is_open:
                raise NotFlat(f"{name or body!r} follows a field of open size")
            if isinstance(body, Present):
                raise NotFlat("its fields are present by bits")
            if isinstance(body, Multiplexed):
                if not top or (selector is not None and selector.name != body.selector):
                    raise NotFlat("nested multiplexing")
                if overlay is None or selector is None:
                    overlay, base = {}, self.offset
                    selector = self._select(body.selector, fields)
                starts = {overlay.get(value, 0) for value in body.when}
                if len(starts) != 1:
                    raise NotFlat(f"{name} is at several places")
                start = starts.pop()
                self.offset = base + start
                known = len(self.constants)
                when = p.When(selector, tuple(sorted(map(int, body.when))))
                outer, self.outer = self.outer, when
                node = self._node(body.body, f"{path}_{name}")
                self.outer = outer
                if len(self.constants) > known:
                    del self.constants[known:]
                    raise NotFlat(f"{name} is multiplexed and has a constant")
                if self.is_open:
                    raise NotFlat(f"{name} is multiplexed and of open size")
                for value in body.when:
                    overlay[value] = self.offset - base
                fields.append(p.PlanField(name, node, item.docs or "", when))
                continue
            if overlay is not None:
                raise NotFlat(f"{name} follows multiplexed fields")
            if name is None:
                self._constant(body)
                continue
            if isinstance(body, c.Const):
                self._constant(body)
                fields.append(p.PlanField(name, scalar_of(body.subcon, self.offset - int(body.sizeof()))))
                continue
            if isinstance(body, c.Rebuild):
                rebuilt.add(name)
                item = body.subcon
            if isinstance(body, (c.Array, c.GreedyRange)) and not isinstance(
                getattr(body, "count", None), int
            ):
                node, count = self._repeated(body, fields, f"{path}_{name}")
                rebuilt.discard(count)
            else:
                node = self._node(item, f"{path}_{name}")
            fields.append(p.PlanField(name, node, self._doc(item)))
        if rebuilt:
            raise NotFlat(f"{min(rebuilt)} is computed")
        if overlay is not None and selector is not None:
            self.offset = base
            total = base + self.tail
            self.lengths_by = (selector, tuple((v, total + n) for v, n in sorted(overlay.items())), total)
        return fields

    @staticmethod
    def _doc(item: c.Construct) -> str:
        return peeled(item)[3]

    def _select(self, name: str, fields: list[p.PlanField]) -> p.Selector:
        for field in fields:
            node = field.node
            if field.name == name and isinstance(node, p.Scalar) and node.kind in ("uint", "int"):
                found = p.Selector(name, node, self.outer)
                self.selectors[found] = None
                return found
        raise NotFlat(f"selector {name!r} is not a plain integer")

    def _constant(self, body: c.Construct) -> None:
        if not isinstance(body, c.Const):
            raise NotFlat(f"{body!r} has no name")
        raw = body.build(None)
        self.constants += [p.Constant(self.offset + i, 0xFF, byte) for i, byte in enumerate(raw)]
        self._advance(len(raw))

    def _node(self, con: c.Construct, path: str) -> p.Node:
        body = con
        while isinstance(body, (c.Renamed, c.Default)):
            body = body.subcon
        if isinstance(body, c.Struct):
            return self._group(path, self._struct(body, path, top=False))
        if isinstance(body, BitLayout):
            return self._group(path, self._layout(body))
        if isinstance(body, c.Array) and isinstance(body.count, int):
            if body.count > 64:
                raise NotFlat(f"an array of {body.count}")
            return p.Many(tuple(self._node(body.subcon, path) for _ in range(body.count)))
        if isinstance(body, Items):
            return self._items(body, path)
        if isinstance(body, c.GreedyRange):
            return self._repeated(body, [], path)[0]
        if isinstance(body, c.FocusedSeq):
            return self._prefixed(body, path)
        scalar = scalar_of(con, self.offset)
        self._advance(scalar.size)
        return scalar

    # -------------------------------------------------- lists of items

    def _items(self, items: Items, path: str) -> p.TaggedItems:
        """Return tagged items up to the end."""
        self._only_here()
        kinds = [self._item_kind(items, kind, path) for kind in items.data]
        self.is_open = True
        return self._tagged(items, path, kinds)

    def _item_kind(self, items: Items, kind: str, path: str, *, may_hold_lists: bool = False) -> p.ItemKind:
        plan = self._alone(items.data[kind], f"{path}_{kind}", may_hold_lists=may_hold_lists)
        return p.ItemKind(kind, items.numbers[kind], plan, items.fixed_size(kind))

    def _tagged(self, items: Items, path: str, kinds: Sequence[p.ItemKind]) -> p.TaggedItems:
        name = self._group(path, [p.PlanField(part, p.Opaque("")) for part in ITEM]).type_name
        tag, size = (
            None
            if number is None
            else p.Scalar("uint", at, number.size, number.order, whole_bits(at, number.size, number.order))
            for number, at in ((items.tag, items.tag_at), (items.size, items.size_at))
        )
        assert tag is not None
        return p.TaggedItems(self.offset, tag, size, items.head, items.counted, tuple(kinds), name)

    def described(self, items: Items, path: str, reason: str) -> p.DescribedItems:
        """Return tagged items that construct decodes: what is known of the kinds whose data have a flat form,
        or lists of one.
        """
        kinds: list[p.ItemKind] = []
        for kind in items.data:
            with contextlib.suppress(NotFlat):
                kinds.append(self._item_kind(items, kind, path, may_hold_lists=True))
        return p.DescribedItems(reason, self._tagged(items, path, kinds))

    def _repeated(
        self, con: c.Array | c.GreedyRange, fields: Sequence[p.PlanField], path: str
    ) -> tuple[p.Repeated, str]:
        """Return groups of one size up to the end, or as many as a field among `fields` says; and that field's name."""
        count = getattr(con, "count", None)
        name = ""
        number: p.Scalar | None = None
        if count is not None:
            names = {node_path.path: node_path.node for node_path in p.walk(fields)}
            name = next((name for name in names if repr(count) == repr(_asked(name))), "")
            found = names.get(name)
            if not isinstance(found, p.Scalar) or found.kind != "uint" or found.steps or found.size is None:
                raise NotFlat("an array whose count is not a plain field beside it")
            number = found
        return self._groups(con.subcon, number, path), name

    def _prefixed(self, con: c.FocusedSeq, path: str) -> p.Repeated:
        """Return what construct's `PrefixedArray` is made of: a count, and as many groups."""
        parts: dict[Any, Any] = {
            item.name: item.subcon if isinstance(item, c.Renamed) else item for item in con.subcons
        }
        if con.parsebuildfrom != "items" or list(parts) != ["count", "items"]:
            raise NotFlat("FocusedSeq has no flat form")
        count, items = parts["count"], parts["items"]
        if not isinstance(count, c.Rebuild) or not isinstance(items, c.Array):
            raise NotFlat("FocusedSeq has no flat form")
        if repr(items.count) != repr(c.this.count):
            raise NotFlat("FocusedSeq has no flat form")
        number = scalar_of(count.subcon, self.offset)
        if number.kind != "uint" or number.steps or number.size is None:
            raise NotFlat("a count that is not a plain number")
        self._advance(number.size)
        return self._groups(items.subcon, number, path)

    def _groups(self, con: c.Construct, count: p.Scalar | None, path: str) -> p.Repeated:
        self._only_here()
        plan = self._alone(con, path)
        if plan.lengths is None or not plan.lengths[0]:
            raise NotFlat("repeated groups of no fixed size")
        if plan.constants:
            raise NotFlat("repeated groups with constants")
        self.is_open = True
        return p.Repeated(self.offset, plan.lengths[0], plan, count)

    def _only_here(self) -> None:
        if self.is_open or self.outer is not None:
            raise NotFlat("a list of items that does not end the payload")

    def _alone(self, con: c.Construct, path: str, *, may_hold_lists: bool = False) -> p.MessagePlan:
        """Return the plan of a construct by itself, from byte 0 on, as the one field `data`."""
        inner = _Builder(self.message, 0)
        inner.offset, inner._shapes = 0, self._shapes
        if isinstance(con, c.Struct):
            node: p.Node = inner._group(path, inner._struct(con, path, top=True))
        else:
            node = inner._node(con, path)
        found = p.walk([p.PlanField("data", node)])
        if not may_hold_lists and any(isinstance(node_path.node, p.ListNode) for node_path in found):
            raise NotFlat("lists of items inside one another")
        is_fixed = not inner.is_open and inner.lengths_by is None
        return p.MessagePlan(
            name=path,
            fields=(p.PlanField("data", node),),
            constants=tuple(inner.constants),
            one_of=(),
            lengths=(inner.offset,) if is_fixed else None,
            least=inner.offset,
            lengths_by=inner.lengths_by,
            selectors=tuple(inner.selectors),
            place=self.message.place.stable,
        )

    def _group(self, path: str, fields: list[p.PlanField]) -> p.NestedRecord:
        """Return a nested record. Its type is named after its path; where two paths read alike, the second gets a number."""
        shape = (path, tuple(field.name for field in fields))
        name, count = self._shapes.get(shape, path), 1
        while shape not in self._shapes and name in self._shapes.values():
            count += 1
            name = f"{path}_{count}"
        self._shapes[shape] = name
        return p.NestedRecord(name, tuple(fields))

    def _layout(self, layout: BitLayout) -> list[p.PlanField]:
        found: dict[str, list[p.Scalar]] = {}
        whens: dict[str, p.When | None] = {}
        docs: dict[str, str] = {}
        always = 0
        masks: dict[p.Selector, dict[int, int]] = {}
        for slot in layout.slots:
            scalar, docs[slot.name] = self._slot(slot, layout)
            found.setdefault(slot.name, []).append(scalar)
            mux = slot.mux
            whens[slot.name] = None
            if mux is None:
                always |= slot.mask
                continue
            number = found[mux.selector][0]
            if number.kind == "float":
                raise NotFlat(f"selector {mux.selector!r} is not a plain integer")
            selector = p.Selector(mux.selector, number, whens[mux.selector] or self.outer)
            self.selectors[selector] = None
            whens[slot.name] = p.When(selector, tuple(sorted(map(int, mux.when))))
            by_value = masks.setdefault(selector, {})
            for value in mux.when:
                by_value[value] = by_value.get(value, 0) | slot.mask
        fields = []
        for name in layout.names:
            nodes = found[name]
            node: p.Node = p.Many(tuple(nodes)) if name in layout.many else nodes[0]
            fields.append(p.PlanField(name, node, docs[name], whens[name]))
        if layout.has_reserved:
            rest = p.Rest(self.offset, layout.size, *_claims(always, masks, self.outer))
            fields.append(p.PlanField("reserved", rest, "bits without a field"))
        self._advance(layout.size)
        if layout.trailing:
            behind = p.Scalar("bytes", self.offset, None)
            fields.append(p.PlanField(layout.trailing, behind, "bytes behind the declared ones"))
            self._advance(None)
        return fields

    def _slot(self, slot: LayoutSlot, layout: BitLayout) -> tuple[p.Scalar, str]:
        """Return a field of a layout as the plan has it, and what it means."""
        inner, steps, unit, doc = peeled(slot.field)
        doc = slot.doc or doc
        assert isinstance(inner, Bits)
        bits = tuple(8 * self.offset + q for q in slot.positions)
        if not inner.is_float:
            return integer_at(inner, self.offset, layout.size, slot.positions, tuple(steps), unit), doc
        start, size = min(bits) // 8, len(bits) // 8
        orders: tuple[Literal["little", "big"], ...] = ("little", "big")
        for order in orders:
            if bits == whole_bits(start, size, order):
                return p.Scalar("float", start, size, order, (), tuple(steps), unit), doc
        return p.Scalar("float", self.offset, layout.size, "little", bits, tuple(steps), unit), doc

    def _delimited(self, con: d.Delimited) -> None:
        most = None if con.more else len(con.fields)
        self.split = p.DelimitedSplit(self.offset, self.tail, con.separator, con.lead, con.least, most)
        for index, item in enumerate(con.fields):
            field = item.subcon
            conversion: Any = {
                d.AsciiNumber: "number",
                d.AsciiInteger: "integer",
                d.AsciiDegrees: "degrees",
                d.AsciiEnumeration: "names",
                d.AsciiText: "text",
            }.get(type(field))
            if conversion is None:
                raise NotFlat(f"{type(field).__name__} has no flat form")
            names = tuple(field.values.items()) if isinstance(field, d.AsciiEnumeration) else ()
            form = "" if conversion in ("text", "names") else field.form
            self.fields.append(
                p.PlanField(
                    item.name,
                    p.DelimitedField(index, conversion, form, names, field.unit, index >= con.least),
                    item.docs or field.docs or "",
                )
            )
        if con.more:
            self.fields.append(
                p.PlanField("more", p.MoreCells(len(con.fields)), "fields beyond the declared ones")
            )
        self.is_open = True
