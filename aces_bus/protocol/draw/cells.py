"""Which bits and bytes of a message belong to whom, as panels of rows: what `text` and `svg` draw.

1. Plan in, rows out: nothing here reads a construct or a file. What a plan does not carry (checks, lengths, the names of
   matched numbers) comes as `Mark`s, which `marks_of` takes from a message.
2. Every bit of a message of fixed length is in exactly one cell; blank cells belong to no field.
3. A row is `ROW` columns of cells, `BIT` a bit and one between two bits; -1 is the last byte where the length is not fixed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from ..declare.fields import number_runs
from ..declare.message import Message
from ..plan import nodes as p

#: Columns of one bit, and of a row without its frame.
BIT = 8
ROW = 8 * BIT + 7
#: Lists of more bytes than this are one row; in messages of more bytes, so is each number of whole bytes.
LONGEST = 16
#: The title of a picture of fields whose bits are those of others, too.
SHARING = "of the same bits:"


@dataclass(frozen=True)
class Mark:
    """Bytes that are not field: `offset` counts from the packet's first byte, or, negative, from its end."""

    offset: int
    size: int
    label: str


@dataclass(frozen=True)
class _Block:
    """Whole bytes in one row: `size` None is to the end."""

    offset: int
    size: int | None
    label: str
    is_named: bool = False


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


#: A row: the text in front, and its cells as (columns, text).
Row = tuple[str, list[tuple[int, str]]]


@dataclass(frozen=True)
class LayoutPanel:
    """One picture of a message's bytes; `title` says when it is so, "" for always."""

    title: str
    rows: list[Row]


def panels(plan: p.MessagePlan, marks: Iterable[Mark] = ()) -> list[LayoutPanel]:
    """Return the layout of a message; of multiplexed fields one more panel a selector value, of fields that share bits
    one more for those behind the first."""
    marks = list(marks)
    base = _Cells()
    _mark(base, plan, [m for m in marks if m.offset >= 0])
    always: list[_Cells] = [base]
    variants: dict[p.When, list[_Cells]] = {}
    is_brief = plan.least > LONGEST
    for path in p.walk(plan.fields, is_long):
        if path.node.is_leaf or is_long(path.node):
            layers = variants.setdefault(path.whens[-1], [_Cells()]) if path.whens else always
            _claim(_free(layers, path.node), path.path, path.node, is_brief=is_brief)
    for when, layers in variants.items():
        selector = when.selector.name
        for position in layers[0].bits:
            base.bits.setdefault(position, (f"(by {selector})", -1, 0))
        for offset, block in layers[0].blocks.items():
            base.blocks.setdefault(offset, _Block(offset, block.size, f"(by {selector})"))
    if plan.opaque:
        base.lines.append(("…", f"{', '.join(plan.opaque_names)}: no fixed places ({plan.opaque})"))
    tail = sorted((m for m in marks if m.offset < 0), key=lambda m: m.offset)
    found = [LayoutPanel("", _all_rows(base, plan, tail))]
    found += [LayoutPanel(SHARING, _all_rows(cells, None, [])) for cells in always[1:]]
    for when, layers in variants.items():
        found.append(
            LayoutPanel(f"{when.selector.name} = {listed(when.values)}:", _all_rows(layers[0], None, []))
        )
        found += [LayoutPanel(SHARING, _all_rows(cells, None, [])) for cells in layers[1:]]
    for leaf in plan.leaves:
        node = leaf.node.items if isinstance(leaf.node, p.DescribedItems) else leaf.node
        if isinstance(node, p.ListNode):
            found += _list_panels(leaf.path, node)
    return found


def _list_panels(path: str, node: p.ListNode) -> list[LayoutPanel]:
    """Return an item of a list, and the data of each kind; a group."""
    if isinstance(node, p.Repeated):
        return [LayoutPanel(f"each of {path}:", panels(node.plan)[0].rows)]
    assert isinstance(node, p.TaggedItems)
    cells = _Cells()
    counts = f" (data + {node.counted})" if node.counted else ""
    for name, number in (("tag", node.tag), (f"size{counts}", node.size)):
        if number is not None:
            _claim_scalar(cells, name, number, is_brief=True)
    cells.blocks[node.head] = _Block(node.head, None, "data (as many bytes as it says)", is_named=True)
    found = [LayoutPanel(f"each of {path}:", _all_rows(cells, None, []))]
    for kind in node.kinds:
        inside = panels(kind.plan)
        title = f"data of {path}.{kind.name}, tag {kind.number}"
        found += [
            LayoutPanel(f"{title}:" if not panel.title else f"{title}, {panel.title}", panel.rows)
            for panel in inside
        ]
    return found


def _free(layers: list[_Cells], node: p.Node) -> _Cells:
    """Return the first picture in which no other field has the bits of this one; a new one where there is none."""
    bits = node.place if isinstance(node, p.Scalar) and not node.is_bytes else ()
    for cells in layers:
        # Only numbers share bits; bytes of open size stand behind them.
        if cells.taken.isdisjoint(bits):
            break
    else:
        cells = _Cells()
        layers.append(cells)
    cells.taken.update(bits)
    return cells


def marks_of(message: Message) -> list[Mark]:
    """Return what a message's template says of its bytes beyond its fields."""
    marks: list[Mark] = []
    framing = message.framing
    if framing is not None and framing.sync:
        marks += [Mark(i, 1, f"sync {byte:#04x}") for i, byte in enumerate(framing.sync)]
    shown = {head.name for head in message.heads}
    for head in message.heads_written:
        if head in message.overlaid:
            continue
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
        end = len(framing.end) + framing.check_behind
        if framing.check is not None:
            marks = [
                mark for mark in marks if mark.offset != framing.check_at
            ]  # the header field that has it
            marks.append(Mark(framing.check_at, framing.check.size, f"check: {framing.describe_check}"))
        marks += [Mark(i - end, 1, f"end {byte:#04x}") for i, byte in enumerate(framing.end)]
    return marks


# ---------------------------------------------------------------------- who owns which bits


def is_long(node: p.Node) -> bool:
    """Return whether a list is drawn and listed as a whole."""
    span = span_of(node) if isinstance(node, p.Many) else None
    return span is not None and span[1] > LONGEST


def span_of(node: p.Node) -> tuple[int, int] | None:
    """Return offset and size of a list whose items stand one behind the other in whole bytes."""
    if isinstance(node, p.Scalar) and node.size is not None:
        if node.bits and len(node.bits) != 8 * node.size:
            return None
        return node.offset, node.size
    spans = [span_of(inner.node) for _, inner in node.children]
    if not spans or spans[0] is None:
        return None
    start = end = spans[0][0]
    for span in spans:
        if span is None or span[0] != end:
            return None
        end += span[1]
    return start, end - start


def _claim(cells: _Cells, label: str, node: p.Node, *, is_brief: bool) -> None:
    match node:
        case p.Scalar():
            _claim_scalar(cells, label, node, is_brief=is_brief)
        case p.Many():
            span = span_of(node)
            assert span is not None
            cells.blocks[span[0]] = _Block(*span, f"{label}.0…{len(node.items) - 1}")
        case p.FromIdentifier() if node.number is not None:
            text = label
            if node.is_alone and (node.constant or node.shift):
                text = f"{node.constant:#04x} + {label}" + (f" << {node.shift}" if node.shift else "")
            cells.claim(text, node.place)
        case p.TaggedItems():
            cells.blocks[node.offset] = _Block(node.offset, None, f"{label}: items", is_named=False)
        case p.Repeated():
            how = "" if node.count is None else ", as many as counted"
            text = f"{label}: groups of {node.width} bytes{how}"
            cells.blocks[node.offset] = _Block(node.offset, None, text, is_named=bool(how))
        case p.DelimitedField():
            cells.lines.append((f"#{node.index}", label + (" (optional)" if node.optional else "")))
        case p.MoreCells():
            cells.lines.append((f"#{node.start}…", label))
        case _:
            pass


def _claim_scalar(cells: _Cells, label: str, node: p.Scalar, *, is_brief: bool) -> None:
    if node.is_bytes:
        if node.size == 1:
            cells.claim(label, range(8 * node.offset, 8 * node.offset + 8))
        else:
            cells.blocks[node.offset] = _Block(node.offset, node.size, label)
        return
    assert node.size is not None
    bits = node.place
    is_whole = not node.bits if node.kind == "float" else node.is_whole
    if is_brief and node.size > 1 and not node.flags and is_whole:
        order = "low" if bits[0] < bits[-1] else "high"
        cells.blocks[node.offset] = _Block(
            node.offset, node.size, f"{label} {len(bits) - 1}…0, {order} byte first", is_named=True
        )
        return
    for name, number in node.flags.items():
        cells.claim(name, (bits[number],))
    cells.claim(label, bits)


def _mark(cells: _Cells, plan: p.MessagePlan, marks: Sequence[Mark]) -> None:
    for mark in marks:
        if mark.size == 1:
            cells.claim(mark.label, range(8 * mark.offset, 8 * mark.offset + 8))
        else:
            cells.blocks[mark.offset] = _Block(mark.offset, mark.size, mark.label, is_named=True)
    for constant in plan.constants:
        if constant.mask == 0xFF:
            cells.claim(f"{constant.value:#04x}", range(8 * constant.offset, 8 * constant.offset + 8))
            continue
        for bit in range(8):
            if constant.mask >> bit & 1:
                cells.claim(f"={constant.value >> bit & 1}", (8 * constant.offset + bit,))


# ---------------------------------------------------------------------- rows


def _all_rows(cells: _Cells, plan: p.MessagePlan | None, tail: Sequence[Mark]) -> list[Row]:
    rows = _rows(cells, plan, sum(mark.size for mark in tail))
    fixed = (
        plan.lengths[0] if plan is not None and plan.lengths is not None and len(plan.lengths) == 1 else None
    )
    for mark in tail:
        if fixed is not None:
            place = range_text(fixed + mark.offset, mark.size)
        else:
            place = f"{mark.offset}" if mark.size == 1 else f"{mark.offset}…"
        rows.append((place, [(ROW, mark.label)]))
    return rows


def _rows(cells: _Cells, plan: p.MessagePlan | None, tail: int) -> list[Row]:
    rows: list[Row] = []
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
                (
                    open_end if block.size is None else range_text(byte, block.size),
                    [(ROW, _block_label(block))],
                )
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


def _merged(rows: Sequence[Row]) -> list[Row]:
    """Merge neighbouring bytes of nothing but multiplexed fields to one row."""
    found: list[Row] = []
    for place, parts in rows:
        if found and found[-1][1] == parts and len(parts) == 1 and parts[0][1].startswith("(by "):
            found[-1] = f"{found[-1][0].partition('…')[0]}…{place.rpartition('…')[2]}", parts
        else:
            found.append((place, parts))
    return found


def _block_label(block: _Block) -> str:
    if block.is_named:
        return block.label
    return f"{block.label} (to the end)" if block.size is None else f"{block.label} ({block.size} bytes)"


def range_text(offset: int, size: int) -> str:
    return str(offset) if size == 1 else f"{offset}…{offset + size - 1}"


def _byte(cells: _Cells, byte: int) -> list[tuple[int, str]]:
    """Return the cells of one byte, bit 7 first: neighbouring bits of one number share a cell."""
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


def listed(values: Sequence[int]) -> str:
    """List numbers one by one, or many as their runs."""
    return ", ".join(map(str, values)) if len(values) <= 4 else number_runs(values)
