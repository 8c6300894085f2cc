"""Pictures and tables of messages, from their plans: what a data sheet would print.

    byte     7        6        5        4        3        2        1        0
         ┌───────────────────────────────────────────────────────────────────────┐
       0 │ period                                                                │
       1 │ limit.0                                                               │
         ├───────────────────────────────────┬───────────────────────────────────┤
       2 │ z_phase.1 11…8                    │ z_phase.0 11…8                    │
         └───────────────────────────────────┴───────────────────────────────────┘

1. Plan in, lines out: nothing here reads a construct or a file. What a plan does not carry (checks, lengths, the names
   of matched numbers) comes as `Mark`s, which `marks_of` takes from a message.
2. Rows are bytes from the first one on, bit 7 on the left; -1 is the packet's last byte where the length is not fixed.
   `11…8` are the bits of the field's own number: byte order and split fields show as they are.
3. Every bit of a message of fixed length is in exactly one cell; blank cells belong to no field.
4. A picture is 79 columns wide.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from .codegen import plan as p
from .codegen.flatten import flatten
from .spec.fields import described
from .spec.message import Message
from .spec.pattern import describe_values

#: Columns of one bit, and of a row without its frame.
BIT = 8
ROW = 8 * BIT + 7
#: Lists of more bytes than this are one row; in messages of more bytes, so is each number of whole bytes.
LONGEST = 16
#: What stands above a picture of fields whose bits are those of others, too.
SHARING = "of the same bits:"


@dataclass(frozen=True)
class Mark:
    """Bytes that are no field: `offset` counts from the packet's first byte, or, negative, from its end."""

    offset: int
    size: int
    label: str


@dataclass(frozen=True)
class _Block:
    """Whole bytes in one row: `size` None is to the end."""

    offset: int
    size: int | None
    label: str
    is_told: bool = False


@dataclass
class _Cells:
    """Who owns each bit: canonical bit number → (label, bit of the owner's number, number of its bits)."""

    bits: dict[int, tuple[str, int, int]] = field(default_factory=dict)
    blocks: dict[int, _Block] = field(default_factory=dict)
    lines: list[tuple[str, str]] = field(default_factory=list)
    taken: set[int] = field(default_factory=set)

    def claim(self, label: str, bits: Sequence[int]) -> None:
        for index, position in enumerate(bits):
            self.bits.setdefault(position, (label, index, len(bits)))


def draw(plan: p.MessagePlan, marks: Iterable[Mark] = ()) -> list[str]:
    """The layout of a message as lines of text; of multiplexed fields one more picture a selector value, of fields that
    share bits one more for those behind the first."""
    marks = list(marks)
    base = _Cells()
    _mark(base, plan, [m for m in marks if m.offset >= 0])
    always: list[_Cells] = [base]
    variants: dict[tuple[str, tuple[int, ...]], list[_Cells]] = {}
    is_brief = plan.least > LONGEST
    for one, when in _placed(plan.fields, "", None):
        layers = always if when is None else variants.setdefault(when, [_Cells()])
        _claim(_free(layers, one[1]), *one, is_brief=is_brief)
    for (selector, _), layers in variants.items():
        for position in layers[0].bits:
            base.bits.setdefault(position, (f"(by {selector})", -1, 0))
        for offset, block in layers[0].blocks.items():
            base.blocks.setdefault(offset, _Block(offset, block.size, f"(by {selector})"))
    if plan.opaque:
        base.lines.append(("…", f"{', '.join(_payload_names(plan))}: no fixed places ({plan.opaque})"))
    tail = sorted((m for m in marks if m.offset < 0), key=lambda m: m.offset)
    lines = _picture(base, plan, tail)
    for cells in always[1:]:
        lines += ["", SHARING, *_picture(cells, None, [])]
    for (selector, values), layers in variants.items():
        lines += ["", f"{selector} = {_listed(values)}:", *_picture(layers[0], None, [])]
        for cells in layers[1:]:
            lines += ["", SHARING, *_picture(cells, None, [])]
    return lines


def _free(layers: list[_Cells], node: p.Node) -> _Cells:
    """The first picture in which no other field has the bits of this one; a new one where there is none."""
    bits: Sequence[int] = node.bits if isinstance(node, p.Scalar) else ()
    if isinstance(node, p.Scalar) and node.kind == "float" and not bits:
        bits = range(8 * node.offset, 8 * (node.offset + (node.size or 0)))
    for cells in layers:
        # Only numbers share bits; bytes of open size stand behind them.
        if cells.taken.isdisjoint(bits):
            break
    else:
        cells = _Cells()
        layers.append(cells)
    cells.taken.update(bits)
    return cells


def picture(message: Message) -> list[str]:
    """The layout of a message, with its checks and matched numbers."""
    return draw(flatten(message), marks_of(message))


def marks_of(message: Message) -> list[Mark]:
    """What a message's template says of its bytes beyond its fields."""
    marks: list[Mark] = []
    framing = message.framing
    if framing is not None and framing.sync:
        marks += [Mark(i, 1, f"sync {byte:#04x}") for i, byte in enumerate(framing.sync)]
    shown = {head.name for head in message.heads}
    for head in message.heads_written:
        name = head.name or "constant"
        if head.is_constant:
            assert head.pattern is not None
            raw = head.bytes(head.pattern.constant)
            marks += [Mark(head.offset + i, 1, f"{name} {byte:#04x}") for i, byte in enumerate(raw)]
        elif head.name not in shown:
            order = f" {8 * head.size - 1}…0, {'high' if head.order == 'big' else 'low'} byte first"
            marks.append(Mark(head.offset, head.size, name + (order if head.size > 1 else "")))
    if message.check is not None:
        offset, size, _ = message.check_span
        marks.append(Mark(offset, size, f"{message.check.field}: {message.check.describe}"))
    if framing is not None:
        end = len(framing.end)
        if framing.check is not None:
            marks.append(
                Mark(-end - framing.check.size, framing.check.size, f"check: {framing.check.describe}")
            )
        marks += [Mark(i - end, 1, f"end {byte:#04x}") for i, byte in enumerate(framing.end)]
    return marks


# ---------------------------------------------------------------------- who owns which bits

_When = tuple[str, tuple[int, ...]] | None
_Place = tuple[str, p.Node]


def _placed(fields: Sequence[p.PlanField], prefix: str, when: _When) -> Iterator[tuple[_Place, _When]]:
    for one in fields:
        inner = one.when or when
        if isinstance(one.node, p.Group):
            yield from _placed(one.node.fields, f"{prefix}{one.name}.", inner)
        elif isinstance(one.node, p.Many) and not _is_long(one.node):
            for index, item in enumerate(one.node.items):
                if isinstance(item, p.Group):
                    yield from _placed(item.fields, f"{prefix}{one.name}.{index}.", inner)
                else:
                    yield from _placed([p.PlanField(f"{one.name}.{index}", item)], prefix, inner)
        else:
            yield (prefix + one.name, one.node), inner


def _is_long(node: p.Node) -> bool:
    span = _span(node)
    return span is not None and span[1] > LONGEST


def _span(node: p.Node) -> tuple[int, int] | None:
    """Offset and size of a list whose items stand one behind the other in whole bytes."""
    if isinstance(node, p.Scalar) and node.size is not None:
        if node.bits and len(node.bits) != 8 * node.size:
            return None
        return node.offset, node.size
    items: list[p.Node] = []
    if isinstance(node, p.Many):
        items = list(node.items)
    elif isinstance(node, p.Group):
        items = [one.node for one in node.fields]
    spans = [_span(item) for item in items]
    if not spans or spans[0] is None:
        return None
    start = end = spans[0][0]
    for span in spans:
        if span is None or span[0] != end:
            return None
        end += span[1]
    return start, end - start


def _claim(cells: _Cells, label: str, node: p.Node, *, is_brief: bool) -> None:
    if isinstance(node, p.Scalar):
        _claim_scalar(cells, label, node, is_brief=is_brief)
    elif isinstance(node, p.Many):
        span = _span(node)
        assert span is not None
        cells.blocks[span[0]] = _Block(*span, f"{label}.0…{len(node.items) - 1}")
    elif isinstance(node, p.FromIdentifier) and node.number is not None:
        bits = node.number.bits
        if node.is_alone:
            text = f"{label}" if not node.constant and not node.shift else f"{node.constant:#04x} + {label}"
            cells.claim(text if not node.shift else f"{text} << {node.shift}", bits)
        else:
            cells.claim(label, bits[node.shift : node.shift + node.width])
    elif isinstance(node, p.Cell):
        cells.lines.append((f"#{node.index}", label + (" (optional)" if node.optional else "")))
    elif isinstance(node, p.MoreCells):
        cells.lines.append((f"#{node.start}…", label))


def _claim_scalar(cells: _Cells, label: str, node: p.Scalar, *, is_brief: bool) -> None:
    if node.kind in ("bytes", "text"):
        if node.size == 1:
            cells.claim(label, range(8 * node.offset, 8 * node.offset + 8))
        else:
            cells.blocks[node.offset] = _Block(node.offset, node.size, label)
        return
    assert node.size is not None
    bits = node.bits
    if not bits:  # a float
        little = tuple(range(8 * node.offset, 8 * (node.offset + node.size)))
        bits = little if node.order == "little" else p.big_endian_bits(node.offset, node.size)
    is_flags = any(isinstance(step, p.FlagBits) for step in node.steps)
    is_whole = not node.bits if node.kind == "float" else node.is_whole
    if is_brief and node.size > 1 and not is_flags and is_whole:
        order = "low" if bits[0] < bits[-1] else "high"
        cells.blocks[node.offset] = _Block(
            node.offset, node.size, f"{label} {len(bits) - 1}…0, {order} byte first", is_told=True
        )
        return
    flags = {
        number: name for step in node.steps if isinstance(step, p.FlagBits) for name, number in step.bits
    }
    for number, name in flags.items():
        cells.claim(name, (bits[number],))
    cells.claim(label, bits)


def _mark(cells: _Cells, plan: p.MessagePlan, marks: Sequence[Mark]) -> None:
    for mark in marks:
        if mark.size == 1:
            cells.claim(mark.label, range(8 * mark.offset, 8 * mark.offset + 8))
        else:
            cells.blocks[mark.offset] = _Block(mark.offset, mark.size, mark.label, is_told=True)
    for constant in plan.constants:
        if constant.mask == 0xFF:
            cells.claim(f"{constant.value:#04x}", range(8 * constant.offset, 8 * constant.offset + 8))
            continue
        for bit in range(8):
            if constant.mask >> bit & 1:
                cells.claim(f"={constant.value >> bit & 1}", (8 * constant.offset + bit,))


def _payload_names(plan: p.MessagePlan) -> list[str]:
    return [one.name for one in plan.fields if isinstance(one.node, p.Opaque)]


# ---------------------------------------------------------------------- lines

#: A row: what stands in front, and its cells as (columns, text).
_Row = tuple[str, list[tuple[int, str]]]


def _picture(cells: _Cells, plan: p.MessagePlan | None, tail: Sequence[Mark]) -> list[str]:
    rows = _rows(cells, plan, sum(mark.size for mark in tail))
    fixed = (
        plan.lengths[0] if plan is not None and plan.lengths is not None and len(plan.lengths) == 1 else None
    )
    for mark in tail:
        if fixed is not None:
            place = _range(fixed + mark.offset, mark.size)
        else:
            place = f"{mark.offset}" if mark.size == 1 else f"{mark.offset}…"
        rows.append((place, [(ROW, mark.label)]))
    if not rows:
        return ["(no bytes)"]
    if any(len(cells) > 1 or place.isdecimal() for place, cells in rows):
        bits = "".join(f"{bit:^{BIT + 1}}" for bit in range(7, -1, -1)).rstrip()
        lines = [f" byte  {bits}"]
    else:
        lines = []
    above: set[int] = set()
    for place, parts in rows:
        edges = _edges(parts)
        if not above or edges or above != {0}:
            lines.append(_rule(above, edges, is_first=not above))
        text = "│".join(_fitted(text, width) for width, text in parts)
        lines.append(f"{place:>5} │{text}│")
        above = edges | {0}
    lines.append(_rule(above, set(), is_last=True))
    return [line.rstrip() for line in lines]


def _rows(cells: _Cells, plan: p.MessagePlan | None, tail: int) -> list[_Row]:
    rows: list[_Row] = []
    used = {position // 8 for position in cells.bits} | set(cells.blocks)
    last = max(used, default=-1)
    size: int | None = None
    if plan is not None and plan.split is None and not plan.opaque:
        last = max(last, plan.least - tail - 1)
        if plan.lengths is not None and len(plan.lengths) == 1:
            size = plan.lengths[0] - tail
            last = max(last, size - 1)
    byte = 0
    while byte <= last:
        block = cells.blocks.get(byte)
        if block is not None:
            open_end = f"{byte}…"
            rows.append(
                (open_end if block.size is None else _range(byte, block.size), [(ROW, _block_label(block))])
            )
            if block.size is None:
                break
            byte += max(1, block.size)
            if not block.size:
                rows.pop()
            continue
        if byte in used or plan is not None:
            rows.append((str(byte), _byte(cells, byte)))
        byte += 1
    return _merged(rows) + [(place, [(ROW, text)]) for place, text in cells.lines]


def _merged(rows: Sequence[_Row]) -> list[_Row]:
    """Neighbouring bytes of nothing but multiplexed fields are one row."""
    found: list[_Row] = []
    for place, parts in rows:
        if found and found[-1][1] == parts and len(parts) == 1 and parts[0][1].startswith("(by "):
            found[-1] = f"{found[-1][0].partition('…')[0]}…{place.rpartition('…')[2]}", parts
        else:
            found.append((place, parts))
    return found


def _block_label(block: _Block) -> str:
    if block.is_told:
        return block.label
    return f"{block.label} (to the end)" if block.size is None else f"{block.label} ({block.size} bytes)"


def _range(offset: int, size: int) -> str:
    return str(offset) if size == 1 else f"{offset}…{offset + size - 1}"


def _byte(cells: _Cells, byte: int) -> list[tuple[int, str]]:
    """The cells of one byte, bit 7 first: neighbouring bits of one number share a cell."""
    parts: list[tuple[int, str]] = []
    bit = 7
    while bit >= 0:
        label, index, width = cells.bits.get(8 * byte + bit, ("", -1, 0))
        count = 1
        while bit - count >= 0:
            other, lower, _ = cells.bits.get(8 * byte + bit - count, ("", -1, 0))
            if other != label or (index >= 0 and lower != index - count):
                break
            count += 1
        text = label
        if index >= 0 and count < width:
            text += f" {index}…{index - count + 1}" if count > 1 else f" {index}"
        parts.append((count * (BIT + 1) - 1, text))
        bit -= count
    return parts


def _fitted(text: str, width: int) -> str:
    """Text in a cell, with a blank on each side where there is room; a long name loses its end, never its bits."""
    if len(text) + 2 <= width:
        return f" {text}".ljust(width)
    if len(text) <= width:
        return text.ljust(width)
    inner = text.rpartition(".")[2]
    if not inner[0].isdigit() and len(inner) < len(text):
        return _fitted(inner, width)  # of a nested record the name alone
    name, blank, bits = text.rpartition(" ")
    if not blank or not bits[0].isdigit():
        return text[: width - 1] + "…"
    room = width - len(bits) - 1
    return f"{name[: room - 1]}… {bits}" if room > 1 else bits[:width].ljust(width)


def _edges(parts: Sequence[tuple[int, str]]) -> set[int]:
    found: set[int] = set()
    at = 0
    for width, _ in parts[:-1]:
        at += width + 1
        found.add(at)
    return found


def _rule(above: set[int], below: set[int], *, is_first: bool = False, is_last: bool = False) -> str:
    left, right = ("┌", "┐") if is_first else ("└", "┘") if is_last else ("├", "┤")
    middle = [
        ("┼" if at in below else "┴") if at in above else "┬" if at in below else "─"
        for at in range(1, ROW + 1)
    ]
    return f"      {left}{''.join(middle)}{right}"


# ---------------------------------------------------------------------- tables


@dataclass(frozen=True)
class FieldRow:
    """One line of a field table. `place` is where it stands, `range` what it can be or, if stated, what may be sent."""

    name: str
    place: str
    type: str
    unit: str = ""
    scale: str = ""
    offset: str = ""
    range: str = ""
    names: str = ""
    doc: str = ""


def table(plan: p.MessagePlan, captured: Mapping[str, str] | None = None) -> list[FieldRow]:
    """The fields of a message; `captured` says what captured parts can be."""
    return list(_table(plan.fields, "", captured or {}))


def row_of(name: str, node: p.Node, doc: str = "") -> FieldRow:
    """The line of a single value, such as a register's."""
    return _field_row(name, node, doc, {})


def captured_values(message: Message) -> dict[str, str]:
    """The values of the captured parts of identifier and head."""
    captures = list(message.identifier.captures)
    for head in message.heads_written:
        captures += head.pattern.captures if head.pattern is not None else ()
    return {capture.name: describe_values(capture.values) for capture in captures}


def _table(fields: Sequence[p.PlanField], prefix: str, captured: Mapping[str, str]) -> Iterator[FieldRow]:
    for one in fields:
        name, node, doc = prefix + one.name, one.node, one.doc
        if one.when is not None:
            doc = f"only while {one.when[0]} is {_listed(one.when[1])}" + (f"; {doc}" if doc else "")
        if isinstance(node, p.Group):
            yield from _table(node.fields, f"{name}.", captured)
        elif isinstance(node, p.Many) and not _is_long(node):
            for index, item in enumerate(node.items):
                inner = p.PlanField(f"{one.name}.{index}", item, doc if not index else "", None)
                yield from _table([inner], prefix, captured)
        else:
            yield _field_row(name, node, doc, captured)


def _field_row(name: str, node: p.Node, doc: str, captured: Mapping[str, str]) -> FieldRow:
    if isinstance(node, p.Many):
        span = _span(node)
        inner = _field_row("", node.items[0], "", captured) if node.items else FieldRow("", "", "")
        place = "byte " + _range(*span) if span is not None else ""
        kind = f"{len(node.items)} × {inner.type or 'record'}"
        return FieldRow(
            name, place, kind, inner.unit, inner.scale, inner.offset, inner.range, inner.names, doc
        )
    if isinstance(node, p.Scalar):
        return _scalar_row(name, node, doc)
    if isinstance(node, p.FromIdentifier):
        if node.number is not None:
            place = _bits_place(
                node.number.bits if node.is_alone else node.number.bits[node.shift : node.shift + node.width]
            )
        else:
            place = (
                "identifier" if node.is_alone else f"identifier {node.shift + node.width - 1}…{node.shift}"
            )
        scale, offset, _ = _scaling(node.steps)
        names = _names(node.steps)
        return FieldRow(
            name, place, f"uint{node.width}", node.unit, scale, offset, captured.get(name, ""), names, doc
        )
    if isinstance(node, p.FromRequest):
        return FieldRow(name, "request", "as there", doc=doc)
    if isinstance(node, p.Rest):
        return FieldRow(name, "other bits", f"of {node.size} bytes", doc=doc)
    if isinstance(node, p.Cell):
        kind = {"names": "enumeration"}.get(node.conversion, node.conversion)
        names = ", ".join(f"{raw}={text}" for raw, text in node.names)
        note = "may be left out" if node.optional else ""
        return FieldRow(name, f"field {node.index}", kind, node.unit, names=names, doc=doc or note)
    if isinstance(node, p.MoreCells):
        return FieldRow(name, f"field {node.start}…", "texts", doc=doc)
    reason = node.reason if isinstance(node, p.Opaque) else ""
    return FieldRow(name, "", "by construct", doc=doc or reason)


def _scalar_row(name: str, node: p.Scalar, doc: str) -> FieldRow:
    scale, offset, bounds = _scaling(node.steps)
    if node.kind in ("bytes", "text"):
        place = f"byte {node.offset}…" if node.size is None else f"byte {_range(node.offset, node.size)}"
        return FieldRow(name, place, node.kind if node.size is None else f"{node.kind}[{node.size}]", doc=doc)
    assert node.size is not None
    if node.kind == "float":
        return FieldRow(
            name,
            _bits_place(node.bits) if node.bits else f"byte {_range(node.offset, node.size)}",
            f"float{len(node.bits) or 8 * node.size}{_order_of(node)}",
            node.unit,
            scale,
            offset,
            bounds or "",
            doc=doc,
        )
    width = len(node.bits)
    kind = f"{node.kind}{width}{_order_of(node)}"
    low, high = (-(1 << width - 1), (1 << width - 1) - 1) if node.kind == "int" else (0, (1 << width) - 1)
    for step in node.steps:
        if isinstance(step, p.Magnitude):
            kind = f"sign+mag{width}{_order_of(node)}"
            high = (1 << width - 1) - 1
            low = -high
        elif isinstance(step, p.FlagBits):
            kind = f"flags{width}{_order_of(node)}"
        elif isinstance(step, p.Names):
            kind = f"enum{width}{_order_of(node)}"
    span = bounds
    if span is None:
        edges = [float(low), float(high)]
        for step in node.steps:
            if isinstance(step, p.Scale):
                edges = [edge * step.scale + step.offset for edge in edges]
        is_number = any(isinstance(step, p.Scale) for step in node.steps) or not _names(node.steps)
        span = f"{_short(min(edges))}…{_short(max(edges))}" if is_number and width <= 64 else ""
    return FieldRow(
        name, _bits_place(node.bits), kind, node.unit, scale, offset, span, _names(node.steps), doc
    )


def _order_of(node: p.Scalar) -> str:
    """Byte order, where there is one to speak of."""
    if node.size == 1 or (node.bits and len({bit // 8 for bit in node.bits}) == 1):
        return ""
    if not node.bits:
        return " le" if node.order == "little" else " be"
    if list(node.bits) == list(range(node.bits[0], node.bits[0] + len(node.bits))):
        return " le"
    if node.bits == p.big_endian_bits(node.offset, node.size or 0):
        return " be"
    return ""


def _bits_place(bits: Sequence[int]) -> str:
    """`byte 2…5`, `byte 1 bits 7…4 + byte 2`."""
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


def _scaling(steps: Sequence[p.Step]) -> tuple[str, str, str | None]:
    """Scale, offset and stated range of a value."""
    for step in steps:
        if isinstance(step, p.Scale):
            scale = "" if step.scale == 1 else _short(step.scale)
            offset = _short(step.offset) if step.offset else ""
            if step.bounds is not None:
                return scale, offset, f"{_short(step.bounds[0])}…{_short(step.bounds[1])}"
            if step.raw_bounds is not None:
                ends = sorted(raw * step.scale + step.offset for raw in step.raw_bounds)
                return scale, offset, f"{_short(ends[0])}…{_short(ends[1])}"
            return scale, offset, None
    return "", "", None


def _names(steps: Sequence[p.Step]) -> str:
    for step in steps:
        if isinstance(step, p.Names):
            return ", ".join(f"{raw}={name}" for raw, name in step.values)
        if isinstance(step, p.FlagBits):
            return ", ".join(f"bit {number}={name}" for name, number in step.bits)
        if isinstance(step, p.Scale) and (step.unknown or step.names):
            parts = [f"{raw}={name}" for raw, name in step.names]
            unknown = "not known: " + ", ".join(_short(raw) for raw in step.unknown)
            return ", ".join([*parts, unknown] if step.unknown else parts)
    return ""


def _short(number: float) -> str:
    if float(number).is_integer() and abs(number) < 1e12:
        return str(int(number))
    return f"{number:.6g}"


def _listed(values: Sequence[int]) -> str:
    return ", ".join(map(str, values)) if len(values) <= 4 else described(values)


__all__ = ["FieldRow", "Mark", "captured_values", "draw", "marks_of", "picture", "row_of", "table"]
