"""Prints what reads packets whose fields are there by bits: the decode function of a message, and how long a packet is.

1. Neighbouring fields that bits of one number decide are a run. Its bits lead to what `struct` takes its fields apart with:
   masks that never repeat cost what others cost.
2. Memory is bounded: a run has at most `BITS` bits, and what they lead to is made when it first comes.
3. The local name of a field that is not there is `ABSENT`, as `struct` gives it for no bytes: always this object.
4. Fields stand in the plan where a packet with all fields has them; an open field is moved there before it is read.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from msgspec.structs import replace

from ..declare.bits import whole_bits
from ..declare.fields import Present, WireNumber
from ..declare.framing import BitSize, FieldSize
from ..declare.message import Message
from ..declare.shapes import Shapes
from ..plan import nodes as p
from ..plan.flatten import NotFlat
from .decode import Decoder, Fetch, FetchedBytes, in_one_byte, run_order
from .scan import candidate_number
from .source import NameScope, SourceText, load_source

#: Bits that decide about one run.
BITS = 8
ABSENT = struct.unpack("0s", b"")[0]
#: What the reading of a run calls its table's values.
RUN = ("unpack", "size", "absent")


class PackedBytes(NamedTuple):
    """Bytes of a packet as `struct` has them: how many, their format, the local name of their value (empty: none), and the
    byte order of a number (empty: any). `decides` names the fields in them whose bits decide about others; `lines` are
    printed behind those that read them.
    """

    size: int
    format: str
    name: str = ""
    order: str = ""
    present: Present | None = None
    decides: Sequence[str] = ()
    lines: Sequence[str] = ()


PackedRun = list[PackedBytes]


def by_bits(run: PackedRun) -> tuple[list[Any], Callable[[int], Any]]:
    """Return a table and a function that fills it: by the bits that decide about a run, from the lowest, what unpacks it,
    with `ABSENT` for fields that are not there, and the number of its bytes.
    """
    bits = [part.present.bit for part in run if part.present is not None]
    table: list[Any] = [None] * (2 << max(bits) - min(bits))

    def more(number: int) -> Any:
        text = _mark(run)
        for part in run:
            is_there = part.present is None or number >> part.present.bit - min(bits) & 1
            text += part.format if is_there else "0s" if part.name else ""
        fields = struct.Struct(text)
        table[number] = fields.unpack_from, fields.size
        return table[number]

    return table, more


def _mark(run: PackedRun) -> str:
    return ">" if any(part.order == "big" for part in run) else "<"


def _joins(run: PackedRun, part: PackedBytes) -> bool:
    """Return whether bytes belong to the run before them, which ends with what decides about the next ones."""
    deciding = {name for known in run for name in known.decides}
    if (deciding and not part.decides) or len({part.order, *(known.order for known in run)} - {""}) > 1:
        return False
    by, others = part.present, [known.present for known in run if known.present is not None]
    return by is None or (
        by.selector not in deciding
        and all(other.selector == by.selector for other in others)
        and all(abs(other.bit - by.bit) < BITS for other in others)
    )


class RunPrinter:
    """Prints the reading of runs of bytes, from byte `start` on.

    `numbers` are the texts of the deciding numbers, `data` is that of the packet's bytes and `base` (empty: 0) that of where
    they begin. `bind` gives a value a name in the text; `short` is the test that a run which ends there cannot be read, by
    whether it has values and whether it is the last (empty: none).
    """

    def __init__(
        self,
        out: SourceText,
        names: NameScope,
        numbers: Mapping[str, str],
        start: int,
        *,
        bind: Callable[[str, Any, str], str],
        short: Callable[[str, bool, bool], str],
        data: str = "data",
        base: str = "",
    ) -> None:
        self._out, self._names, self._numbers, self._data = out, names, numbers, data
        self._bind, self._short = bind, short
        self._at = base, start

    @property
    def at(self) -> str:
        """The place behind the bytes that were printed, as an expression."""
        base, more = self._at
        return f"{base} + {more}" if base and more else base or str(more)

    def print(self, parts: Iterable[PackedBytes]) -> None:
        """Print the reading of bytes that follow one another."""
        runs: list[PackedRun] = []
        for part in parts:
            if not runs or not _joins(runs[-1], part):
                runs.append([])
            runs[-1].append(part)
        for number, run in enumerate(runs):
            self._run(f"run{number}", run, is_last=run is runs[-1])

    def _run(self, name: str, run: PackedRun, *, is_last: bool) -> None:
        out, start = self._out, self.at
        names = [part.name for part in run if part.name]
        called = ", ".join(names) + ("," if len(names) == 1 else "")
        bits = {part.present.bit: part.present.selector for part in run if part.present is not None}
        text = _mark(run) + " ".join(part.format for part in run)
        if bits:
            table, more = by_bits(run)
            found, make = self._bind(name, table, text), self._bind(f"{name}_more", more, "makes others")
            low, many = min(bits), len(table) - 1
            number = self._numbers[bits[low]] + (f" >> {low}" if low else "") + f" & {many:#x}"
            out.line(f"unpack, size = {found}[{number}] or {make}({number})")
            values, self._at = f"unpack({self._data}, {start})", (f"{start} + size", 0)
            if not is_last:
                self._at = self._names.new("at"), 0
                out.line(f"{self.at} = {start} + size")
        else:
            self._at = self._at[0], self._at[1] + sum(part.size for part in run)
            values = ""
            if called:
                values = f"{self._bind(name, struct.Struct(text).unpack_from, text)}({self._data}, {start})"
        if test := self._short(self.at, bool(called), is_last):
            out.lines(f"if {test}:", "    return None")
        if called and text == "<B" and not bits:
            called, values = called.rstrip(","), f"{self._data}[{start}]"
        if called:
            out.line(f"{called} = {values}")
        for part in run:
            out.lines(*part.lines)


class RunFetch(Fetch):
    """The numbers of a message whose fields are there by bits, under local names that reading its parts gives values.
    `constants` are those of its payload, `numbers` the texts of the numbers whose bits decide.
    """

    def __init__(
        self, plan: p.MessagePlan, names: NameScope, setup: list[str], constants: Sequence[p.Constant]
    ) -> None:
        super().__init__(plan, names, setup)
        self.numbers: dict[str, str] = {}
        self._spans: list[tuple[int, int, Any]] = [
            (known.offset, known.offset + 1, known) for known in constants
        ]
        for node in dict.fromkeys(leaf.node for leaf in plan.leaves):
            number = node.number if isinstance(node, p.FromIdentifier) else node
            if isinstance(number, p.Scalar) and number.bits:
                self._spans.append((min(number.bits) // 8, max(number.bits) // 8 + 1, number))
            elif isinstance(number, (p.Scalar, p.Rest)) and number.size:
                self._spans.append((number.offset, number.offset + number.size, number))
        self._spans.sort(key=lambda span: span[:2])

    def prepare(self) -> None:
        """Plan nothing: `parts` does."""

    def parts(
        self, start: int, end: int, present: Present | None, deciding: Mapping[str, p.Scalar]
    ) -> list[PackedBytes]:
        """Return bytes [start, end) of a packet with all fields, part by part; raises `NotFlat` where fields are over one
        another that are not bits.
        """
        shared: list[tuple[int, int, list[Any]]] = []
        for low, high, node in self._spans:
            if shared and low < shared[-1][1]:
                first, last, nodes = shared.pop()
                shared.append((first, max(last, high), [*nodes, node]))
            elif start <= low < end:
                shared.append((low, high, [node]))
        found: list[PackedBytes] = []
        at = start
        for low, high, nodes in shared:
            if low > at:
                found.append(PackedBytes(low - at, f"{low - at}x", present=present))
            decides = [name for name, number in deciding.items() if low <= number.offset < high]
            found.append(self._part(low, high, nodes)._replace(present=present, decides=decides))
            at = high
        if end > at:
            found.append(PackedBytes(end - at, f"{end - at}x", present=present))
        for name, number in deciding.items():
            text = self.integer(number)
            is_bare = present is None and text.isidentifier()
            self.numbers[name] = text if is_bare else f"({text})" if present is None else f"({text} or 0)"
        return found

    def _part(self, low: int, high: int, nodes: Sequence[Any]) -> PackedBytes:
        """Return bytes [low, high), which some nodes share, as one value."""
        name, size = self.names.new("v"), high - low
        scalars = [node for node in nodes if isinstance(node, p.Scalar)]
        whole = next((s for s in scalars if s.is_bytes or (s.format and len(nodes) == 1)), None)
        if len(scalars) > 1 and not all(scalar.bits for scalar in scalars):
            raise NotFlat("fields over one another")
        order: Any = next((run_order(s) for s in scalars if s.bits and not in_one_byte(s)), "little")
        text, lines = p.FORMATS.get(("uint", size), ""), []
        if whole is not None:
            self.named[whole] = name
            text, order = whole.format or f"{size}s", whole.order
        if whole is None or whole.kind == "uint":
            number = name
            if not text:
                text, number = f"{size}s", self.names.new("word")
                lines.append(f'{number} = from_bytes({name}, "{order}")')
            self.ranges.append(FetchedBytes(number, low, high, order))
        for node in nodes:
            if isinstance(node, p.Constant):
                number = f"({self.integer(whole_number(node.offset, 1))}) & {node.mask:#x}"
                if whole is not None and whole.is_bytes:
                    number = f"{name}[{node.offset - low}]"
                lines += [f"if {name} is not absent and {number} != {node.value:#x}:", "    return None"]
            elif isinstance(node, p.Rest):
                number = self.integer(whole_number(node.offset, node.size))
                self.layouts[node.offset, node.size] = f"({number})"
        return PackedBytes(size, text, name, order if size > 1 and text[-1] != "s" else "", lines=lines)

    def _range_with(self, scalar: p.Scalar) -> FetchedBytes | None:
        first, last = min(scalar.bits) // 8, max(scalar.bits) // 8
        return next((span for span in self.ranges if span.start <= first and last < span.end), None)


class ByBitsDecoder(Decoder):
    """Prints the decode function of a message whose fields are there by bits; raises `NotFlat` where it has none."""

    def __init__(self, message: Message, *, raw: bool) -> None:
        plan, wide, start = message.plan, message.plan.all_fields, message.payload_start
        if wide is None or wide.lengths_by is not None:
            raise NotFlat("a size by a selector beside fields that are there by bits")
        heads = tuple(known for known in wide.constants if known.offset < start)
        inside = [known for known in wide.constants if known.offset >= start]
        super().__init__(replace(wide, constants=heads, lengths=plan.lengths, least=plan.least), raw=raw)
        self.fetch = self._runs = RunFetch(self.plan, self.names, self.setup, inside)
        self._message, self._least = message, wide.least
        for name in RUN:
            self.names.new(name)
        #: The test that a field is there, of those that are not always.
        self._there: dict[str, str] = {}

    def _lengths(self) -> None:
        lengths = self.plan.lengths
        if lengths is None or len(lengths) > 64:
            super()._lengths()
        else:
            self.body.lines(f"if len(data) not in {{{', '.join(map(str, lengths))}}}:", "    return None")

    def _repeats(self) -> None:
        """Print nothing: lists are read behind the runs."""

    def _selectors(self) -> None:
        """Print nothing: selectors are read behind the runs."""

    def _value(self, field: p.PlanField) -> str:
        text = super()._value(field)
        there = self._there.get(field.name, "") if field in self.plan.fields else ""
        return f"({text} if {there} else None)" if there else text

    def _returned(self) -> None:
        """Print the reading of the runs and of a field of open size, and the return of the record."""
        message, runs, out = self._message, self._runs, self.body
        shapes = Shapes(message)
        at = message.payload_start
        heads = {head.name or "": whole_number(head.offset, head.size, head.order) for head in shapes.heads}
        parts = runs.parts(self.plan.sync, at, None, heads)
        is_open, test = False, ""
        #: Of each selector, the test that the field which holds it is there.
        holding: dict[p.Selector, str] = {}
        for (item, body), (least, most), wire in zip(shapes.items, shapes.sizes, shapes.wires, strict=True):
            present = body if isinstance(body, Present) else None
            if is_open := most is None:
                test = (
                    f"{runs.numbers[present.selector]} & {1 << present.bit:#x}" if present is not None else ""
                )
            else:
                found = runs.parts(at, at + least, present, _deciding(item.name, wire, at))
                parts, at = parts + found, at + least
                test = next(
                    (f"{part.name} is not absent" for part in found if part.name and present is not None), ""
                )
            if present is not None and item.name is not None:
                if not test:
                    raise NotFlat(f"{item.name} has no bytes")
                self._there[item.name] = test
            for selector in self.plan.selectors:
                if at - (least if not is_open else 0) <= selector.number.offset < at:
                    holding[selector] = test if present is not None else ""
        tail = f" + {self.plan.tail}" if self.plan.tail else ""

        printed = RunPrinter(
            out,
            self.names,
            runs.numbers,
            self.plan.sync,
            bind=lambda name, value, shown: self._bound(f"_{name}_{self.plan.name}", value, shown),
            short=lambda end, called, last: f"len(data) != {end}{tail}" if last and not is_open else "",
        )
        too_short = self._bound("too_short", (struct.error, IndexError))
        out.lines(f"absent = {self._bound('_absent', ABSENT)}", "try:")
        out.depth += 1
        printed.print(parts)
        out.depth -= 1
        out.lines(f"except {too_short}:", "    return None")
        for selector in self.plan.selectors:
            self._select(selector, holding.get(selector, ""))
        if is_open:
            start = message.payload_start
            out.lines(*[f"if {test}:"] if test else [])
            out.depth += bool(test)
            out.lines(
                f"data = data[:{start}] + bytes({at - start}) + data[{printed.at}:]",
                f"if len(data) < {self._least}:",
                "    return None",
            )
            super()._repeats()
            out.depth -= bool(test)
            out.lines(*[f"elif len(data) != {printed.at}{tail}:", "    return None"] if test else [])
        super()._returned()


def whole_number(offset: int, size: int, order: Any = "little") -> p.Scalar:
    """Return an unsigned number of whole bytes."""
    return p.Scalar("uint", offset, size, order, whole_bits(offset, size, order))


def _deciding(name: str | None, wire: WireNumber | None, offset: int) -> dict[str, p.Scalar]:
    """Return the number that a field is, by its name, if bits of it decide about others."""
    return {} if wire is None or name is None else {name: whole_number(offset, wire.size, wire.order)}


def measure_of(measure: BitSize | FieldSize, label: str) -> Callable[[bytes, int, int], int | None]:
    """Return a function of a buffer, where in it a packet begins, and where the buffer ends: how long the packet is, None
    while the bytes that say it are not there.
    """
    out, bound = SourceText(), dict[str, Any](from_bytes=int.from_bytes)
    out.line("def measure(buffer, i, end):")
    out.depth = 1
    if isinstance(measure, BitSize):
        bound = {f"table_{n}": table for n, (_, table) in enumerate(measure.tables)}
        terms = [f"table_{n}[buffer[i + {offset}]]" for n, (offset, _) in enumerate(measure.tables)]
        out.line(
            f"return {' + '.join([str(measure.constant), *terms])} if end - i >= {measure.reach} else None"
        )
    else:
        assert measure.shapes is not None
        _measured(measure.shapes, measure.behind, out, bound)
    found: Callable[[bytes, int, int], int | None] = load_source(out.text(), label, bound)["measure"]
    return found


def _measured(shapes: Shapes, behind: int, out: SourceText, bound: dict[str, Any]) -> None:
    """Print how long a packet is whose fields say it; `bound` gets the values that the text calls by name."""
    names = NameScope(["buffer", "i", "end", *RUN])
    numbers: dict[str, str] = {}
    parts: list[PackedBytes] = []
    if shapes.heads:
        reach = max(head.offset + head.size for head in shapes.heads)
        out.lines(f"if end - i < {reach}:", "    return None")
    for head in shapes.heads:
        numbers[head.name or ""] = value = names.new("v")
        out.line(f"{value} = {candidate_number(head)}")
    for (item, body), (size, _), wire in zip(shapes.items, shapes.sizes, shapes.wires, strict=True):
        present = body if isinstance(body, Present) else None
        part = PackedBytes(size, f"{size}x", present=present)
        if wire is not None and item.name is not None:
            value, text = names.new("v"), p.FORMATS.get(("uint", size), "")
            numbers[item.name] = f"({value} or 0)" if text else f'from_bytes({value}, "{wire.order}")'
            part = PackedBytes(size, text or f"{size}s", value, wire.order, present, [item.name])
        parts.append(part)

    def bind(name: str, value: Any, shown: str) -> str:
        bound[name] = value
        return name

    printed = RunPrinter(
        out,
        names,
        numbers,
        shapes.message.payload_start,
        bind=bind,
        short=lambda at, called, last: f"end < {at}" if called else "",
        data="buffer",
        base="i",
    )
    printed.print(parts)
    out.line(f"return {printed.at} - i + {behind}")
