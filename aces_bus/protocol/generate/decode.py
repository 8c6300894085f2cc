"""Prints decoders: one function a message, from data bytes to a record."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec

from ..declare.bits import runs_of
from ..declare.pattern import bounds
from ..plan import nodes as p
from .source import FunctionSetup, NameScope, SourceText, comment_line, compact, is_plain, literal

# ---------------------------------------------------------------------- numbers of the wire, fetched together


class FetchedBytes(msgspec.Struct, frozen=True):
    """Bytes [start, end) fetched under a local name: as one unsigned integer, or (not `is_unsigned`) as the value itself."""

    name: str
    start: int
    end: int
    order: str
    is_unsigned: bool = True


class Fetch(FunctionSetup):
    """The numbers of a message, as expressions of a function's `data`, and the lines that fetch them.

    `names` are the function's; what the module needs goes into `setup`.
    """

    def __init__(self, plan: p.MessagePlan, names: NameScope, setup: list[str]) -> None:
        self.plan, self.names, self.setup = plan, names, setup
        #: The names of numbers that are fetched already.
        self.named: dict[p.Scalar, str] = {}
        #: By offset and size: the name of the little-endian number of each layout that has bits of no field.
        self.layouts: dict[tuple[int, int], str] = {}
        self.ranges: list[FetchedBytes] = []
        #: The lines that fetch, and whether one of them takes data of the right length only.
        self.unpacks: list[str] = []
        self.is_exact = False

    def prepare(self) -> None:
        """Plan the fetching: one `struct` call for each byte order gets every number, bit fields by the bytes they share."""
        leaves = self.plan.leaves
        present = [leaf.node for leaf in leaves if isinstance(leaf.node, p.Scalar) and not leaf.whens]
        whole: list[p.Scalar] = []
        taken: list[tuple[int, int]] = []
        for s in dict.fromkeys(present):
            end = s.offset + (s.size or 0)
            # Of numbers that share bytes, one is fetched so; the others read for themselves.
            if s.size is not None and s.format and not any(a < end and s.offset < b for a, b in taken):
                whole.append(s)
                taken.append((s.offset, end))
        chunks: list[tuple[int, int, str, p.Scalar | None]] = [
            (s.offset, s.offset + (s.size or 0), s.order if s.size != 1 else "", s) for s in whole
        ]
        loose = [s for s in dict.fromkeys(present) if s.bits and s not in whole]
        for start, end, order in clusters(loose):
            size = end - start
            if (size > 4 and size < 8) or size > 8 or any(a < end and start < b for a, b in taken):
                continue
            chunks.append((start, end, order if size > 1 else "", None))
            taken.append((start, end))
        if sum(end - start == 1 for start, end, _, _ in chunks) == len(chunks) and len(chunks) < 4:
            chunks = [c for c in chunks if c[3] is not None and c[3].kind == "int"]
        orders = {order for _, _, order, _ in chunks} - {""}
        for order in sorted(orders, reverse=True) or ([""] if chunks else []):
            mine = [c for c in chunks if c[2] == order or (c[2] == "" and order == max(orders, default=""))]
            self._unpack_call(sorted(mine, key=lambda c: c[0]), order)
        for start, end, order in clusters(
            [s for s in loose if self._range_with(s) is None and not in_one_byte(s)]
        ):
            if sum(start <= s.bits[0] // 8 < end for s in loose) > 1:
                name = self.names.new(f"word{len(self.ranges)}")
                self.ranges.append(FetchedBytes(name, start, end, order or "little"))
                self.unpacks.append(f'{name} = from_bytes({self._slice(start, end)}, "{order or "little"}")')
        for node in (leaf.node for leaf in leaves):
            if not isinstance(node, p.Rest) or (node.offset, node.size) in self.layouts:
                continue
            name = self.layouts[node.offset, node.size] = self.names.new(f"all{node.offset}")
            end = node.offset + node.size
            self.ranges.append(FetchedBytes(name, node.offset, end, "little"))
            self.unpacks.append(f'{name} = from_bytes({self._slice(node.offset, end)}, "little")')

    def _unpack_call(self, chunks: Sequence[tuple[int, int, str, p.Scalar | None]], order: str) -> None:
        text = ">" if order == "big" else "<"
        at = chunks[0][0]
        names: list[str] = []
        after: list[str] = []
        for start, end, _, scalar in chunks:
            if start > at:
                text += f"{start - at}x"
            at = end
            name = self.names.new(f"v{len(self.ranges)}")
            size = end - start
            if scalar is not None:
                text += scalar.format
                names.append(name)
                self.named[scalar] = name
            elif size == 3:
                text += "BH" if order == "big" else "HB"
                one, other = self.names.new(f"{name}a"), self.names.new(f"{name}b")
                names += [one, other]
                after.append(
                    f"{name} = {one} << 16 | {other}" if order == "big" else f"{name} = {one} | {other} << 16"
                )
            else:
                text += p.FORMATS["uint", size]
                names.append(name)
            is_unsigned = scalar is None or scalar.kind == "uint"
            self.ranges.append(FetchedBytes(name, start, end, order or "little", is_unsigned))
        start = chunks[0][0]
        whole = start == 0 and self.plan.lengths == (at,)
        self.is_exact = self.is_exact or whole
        made = f'Struct("{compact(text)}").{"unpack" if whole else "unpack_from"}'
        helper = self._table(f"_unpack_{self.plan.name}" + ("_be" if order == "big" else ""), made)
        call = f"{helper}(data)" if start == 0 else f"{helper}(data, {start})"
        self.unpacks.append(f"{', '.join(names)}{',' if len(names) == 1 else ''} = {call}")
        self.unpacks += after

    def _range_with(self, scalar: p.Scalar) -> FetchedBytes | None:
        first, last = min(scalar.bits) // 8, max(scalar.bits) // 8
        order = run_order(scalar)
        for span in self.ranges:
            if (
                span.is_unsigned
                and span.start <= first
                and last < span.end
                and (span.order == order or span.end - span.start == 1)
            ):
                return span
        return None

    def _slice(self, start: int, end: int) -> str:
        if start == 0 and self.plan.lengths == (end,):
            return "data"
        return f"data[{start or ''}:{end}]"

    def integer(self, scalar: p.Scalar, *, fetched: bool = True) -> str:
        """Return the unsigned number (the signed one, of whole signed numbers), as an expression; from `data`, unless
        `fetched`.
        """
        if fetched and scalar in self.named:
            return self.named[scalar]
        assert scalar.size is not None
        part = self._range_with(scalar) if fetched else None
        order = run_order(scalar)
        if part is None:
            first, last = min(scalar.bits) // 8, max(scalar.bits) // 8
            text = (
                f"data[{first}]"
                if first == last
                else f'from_bytes({self._slice(first, last + 1)}, "{order}")'
            )
            part = FetchedBytes(text, first, last + 1, order)
        if part.order == "little" or part.end - part.start == 1:
            positions = [b - 8 * part.start for b in scalar.bits]
        else:
            positions = [(part.end - 1 - b // 8) * 8 + b % 8 for b in scalar.bits]
        pieces = []
        for at, to, width in runs_of(positions):
            piece = f"{part.name} >> {at}" if at else part.name
            if at + width < 8 * (part.end - part.start):
                piece = f"{piece} & {(1 << width) - 1:#x}"
            if to:
                piece = f"({piece}) << {to}"
            pieces.append(piece)
        if len(pieces) == 1:
            return pieces[0]
        return " | ".join(f"({piece})" if "&" in piece or ">>" in piece else piece for piece in pieces)

    def number(self, scalar: p.Scalar, name: str) -> str:
        """Return the number of a field, with its sign, as an expression."""
        if scalar.kind == "float" and scalar.bits:
            return self._scattered(scalar)
        if scalar in self.named:
            return self.named[scalar]
        return self._lone(scalar, name) if scalar.kind == "float" else self.whole(scalar)

    def whole(self, scalar: p.Scalar) -> str:
        """Return a whole number with its sign, as an expression."""
        number = self.integer(scalar)
        if scalar.kind != "int":
            return number
        top = 1 << len(scalar.bits) - 1
        return f"(({number}) ^ {top:#x}) - {top:#x}"

    def _lone(self, scalar: p.Scalar, name: str) -> str:
        """Return a float that is not always there."""
        mark = "<" if scalar.order == "little" else ">"
        made = f'Struct("{mark}{p.FORMATS["float", scalar.size or 0]}").unpack_from'
        return f"{self._table(f'_unpack_{self.plan.name}_{name}', made)}(data, {scalar.offset})[0]"

    def _scattered(self, scalar: p.Scalar) -> str:
        """Return a float whose bits are not whole bytes."""
        size = len(scalar.bits) // 8
        helper = self._table(f"_float{8 * size}", f'Struct("<{p.FORMATS["float", size]}").unpack')
        return f'{helper}(({self.integer(scalar)}).to_bytes({size}, "little"))[0]'


def clusters(scalars: Sequence[p.Scalar]) -> list[tuple[int, int, str]]:
    """Byte ranges that the scalars cover, merged where they overlap, with the byte order that suits all in it."""
    spans = sorted(
        (min(s.bits) // 8, max(s.bits) // 8 + 1, "" if in_one_byte(s) else run_order(s)) for s in scalars
    )
    found: list[tuple[int, int, str]] = []
    for start, end, order in spans:
        if found and start < found[-1][1]:
            first, last, other = found[-1]
            if order and other and order != other:
                # Two orders over the same bytes: each reads for itself.
                found.append((start, end, order))
                continue
            found[-1] = (first, max(last, end), other or order)
        else:
            found.append((start, end, order))
    return found


def in_one_byte(scalar: p.Scalar) -> bool:
    bits = scalar.bits
    return bool(bits) and bits[0] // 8 == bits[-1] // 8 and bits == tuple(range(bits[0], bits[0] + len(bits)))


def run_order(scalar: p.Scalar) -> str:
    """Return the byte order in which the field falls into fewer pieces."""
    little = len(scalar.runs)
    size = scalar.size or 0
    big = len(runs_of([(scalar.offset + size - 1 - b // 8) * 8 + b % 8 for b in scalar.bits]))
    return "big" if big < little else "little"


# ---------------------------------------------------------------------- what a record shows of them


TRANSPORT = "time, channel, key, raw, rx"
#: The arguments of a decode function.
ARGUMENTS = "data, key, time, channel, raw, rx"
#: What decoders call, given to every module of them.
CALLED = ("Struct", "from_bytes", "re", "degrees", "flags")
#: The arguments of a decode function, and what its expressions use in passing.
LOCAL = ("data", "key", "time", "channel", "raw", "rx", "request", "cells", "cell", "count", "q", "n", "sm")


class Decoder(FunctionSetup):
    """Prints the decode function of one message.

    The function is `decode_Name(data, key, time, channel, raw, rx)`: `data` are the frame's data bytes or the packet
    without stuffing, the rest is the transport's; messages that show fields of their request take it last. It gives the
    record, or None when the data is not this message. Without `guard` the length check is left to `struct.unpack`,
    which raises `struct.error`. `names` are the module's (with `CALLED` among them): what is `bound` in them must be
    given to the text, and the types in `types`.

    With `result` it is the function of an item's data or of a group, which takes its bytes alone: `result` makes the text
    of what it gives, from that of the value.
    """

    def __init__(
        self,
        plan: p.MessagePlan,
        *,
        raw: bool,
        guard: bool = True,
        names: NameScope | None = None,
        result: Callable[[str], str] | None = None,
    ) -> None:
        self.plan, self.result = plan, result
        self.raw = raw
        self.guard = guard
        self.setup = []
        self.module = names if names is not None else NameScope(CALLED)
        self.names = NameScope(LOCAL, inside=self.module)
        self.function = self.module.new(f"decode_{plan.name}", avoid=self.names)
        #: Of each record type that the function makes: the name in the text, and its own (see `print_records`).
        self.types: dict[str, str] = {}
        self._type_names: dict[str, str] = {}
        #: The text's names of what only the loader knows: a decode function through construct, and the message's own check.
        self.opaque = self.holds = ""
        self.body = SourceText()
        self.fetch = Fetch(plan, self.names, self.setup)
        #: The local name of each selector.
        self.present: dict[p.Selector, str] = {}

    def print(self) -> tuple[list[str], list[str]]:
        """Return (module-level lines, function lines)."""
        plan, out = self.plan, self.body
        needs = not plan.is_flat or plan.needs_request
        arguments = ARGUMENTS if self.result is None else "data"
        out.line(f"def {self.function}({arguments}{', request=None' if needs else ''}):")
        out.depth = 1
        out.line(f'"""{comment_line(plan.doc) or plan.name} ({comment_line(plan.place)})"""')
        if not plan.is_flat:
            out.line(f"# through construct: {comment_line(plan.opaque)}")
            self.opaque = self.module.new(f"opaque_{plan.name}", avoid=self.names)
            out.line(f"return {self.opaque}(data, key, time, channel, raw, rx, request)")
            return self.setup, out.printed
        self.fetch.prepare()
        tests = plan.constants[plan.sync :] or plan.one_of or plan.is_checked or plan.lengths_by or plan.lists
        if self.guard or tests or not self.fetch.is_exact:
            self._lengths()
        self._constants()
        self._repeats()
        if plan.is_checked:
            self.holds = self.module.new(f"holds_{plan.name}", avoid=self.names)
            out.lines(
                f"if not {self.holds}(data, key):",
                "    return None",
            )
        if plan.split is not None:
            self._split(plan.split)
        out.lines(*self.fetch.unpacks)
        self._selectors()
        if plan.lengths_by is not None:
            selector, table, other = plan.lengths_by
            lengths = self._table(f"_lengths_{plan.name}", literal(dict(table)))
            out.lines(
                f"if len(data) != {lengths}.get({self.present[selector]}, {other}):",
                "    return None",
            )
        self._returned()
        return self.setup, out.printed

    def _returned(self) -> None:
        """Print the return of the record, or of what is made of the only value."""
        plan, out = self.plan, self.body
        if self.result is not None:
            out.line(f"return {self.result(self._value(plan.fields[0]))}")
            return
        made = self._type(plan.name)
        arguments = [self._value(field) for field in plan.fields]
        if sum(map(len, arguments)) + len(plan.name) < 60:
            out.line(f"return {made}({', '.join([*arguments, TRANSPORT])})")
        else:
            out.line(f"return {made}(")
            for field, argument in zip(plan.fields, arguments, strict=True):
                out.line(f"    {argument},  # {field.name}")
            out.lines(
                f"    {TRANSPORT},",
                ")",
            )

    def _lengths(self) -> None:
        plan, out = self.plan, self.body
        if plan.lengths is None:
            if plan.least <= plan.framed:
                return
            out.line(f"if len(data) < {plan.least}:")
        else:
            low, high = min(plan.lengths), max(plan.lengths)
            if low == high:
                out.line(f"if len(data) != {low}:")
            elif plan.lengths == tuple(range(low, high + 1)):
                out.line(f"if not {low} <= len(data) <= {high}:")
            else:
                out.line(f"if len(data) not in {literal(plan.lengths)}:")
        out.line("    return None")

    def _constants(self) -> None:
        tests = []
        for constant in self.plan.constants[self.plan.sync :]:
            if constant.mask == 0xFF:
                tests.append(f"data[{constant.offset}] != {constant.value:#04x}")
            else:
                tests.append(f"data[{constant.offset}] & {constant.mask:#04x} != {constant.value:#04x}")
        for choice in self.plan.one_of:
            values = choice.values
            low, high = bounds(values)
            run = len(values) > 2 and len(values) == high - low + 1
            number = self.fetch.integer(choice.number, fetched=False)  # the test comes before the fetching
            if run and low == 0 and number.startswith("data["):
                tests.append(f"{number} > {high}")
            else:
                tests.append(
                    f"not {low} <= {number} <= {high}" if run else f"{number} not in {literal(values)}"
                )
        for test in tests:
            self.body.lines(
                f"if {test}:",
                "    return None",
            )

    # -------------------------------------------------- values

    def _type(self, name: str) -> str:
        """Return the text's name for a record type."""
        if name not in self._type_names:
            found = self._type_names[name] = self.module.new(name, avoid=self.names)
            self.types[found] = name
        return self._type_names[name]

    def _selectors(self) -> None:
        """Print the raw numbers of all selectors."""
        for selector in self.plan.selectors:
            self._select(selector)

    def _select(self, selector: p.Selector, there: str = "") -> None:
        """Print a selector's raw number under a local name; None while the selector itself is absent. `there` is the test
        that the field which holds it is there, if it is not always.
        """
        scalar, when = selector.number, selector.when
        number = self.fetch.named.get(scalar) if when is None else None
        if number is None:
            number = self.fetch.whole(scalar)
        if when is not None:
            number = f"{number} if {self._is_there(when)} else None"
        if there and not number.isidentifier():
            number = f"({number}) if {there} else None"
        if not number.isidentifier():
            name = self.names.new(f"select_{selector.name}")
            self.body.line(f"{name} = {number}")
            number = name
            if when is None:
                self.fetch.named[scalar] = number
        self.present[selector] = number

    def _is_there(self, when: p.When) -> str:
        """Return the test of a multiplexed field's selector, as an expression."""
        selector, values = when.selector, when.values
        number = self.present[selector]
        if len(values) == 1:
            return f"{number} == {values[0]}"
        if len(values) > 2 and values[-1] - values[0] == len(values) - 1:
            test = f"{values[0]} <= {number} <= {values[-1]}"
            return f"{number} is not None and {test}" if selector.when is not None else test
        if len(values) > 8:
            return f"{number} in {{{', '.join(map(str, values))}}}"
        return f"{number} in {literal(values)}"

    def _value(self, field: p.PlanField) -> str:
        text = self._node(field.node, field.name)
        return f"({text} if {self._is_there(field.when)} else None)" if field.when is not None else text

    def _node(self, node: p.Node, name: str) -> str:
        if isinstance(node, p.Scalar):
            return self._scalar(node, name)
        if isinstance(node, p.Many):
            items = [self._node(item, name) for item in node.items]
            return f"({', '.join(items)}{',' if len(items) == 1 else ''})"
        if isinstance(node, p.NestedRecord):
            return f"{self._type(node.type_name)}({', '.join(self._value(field) for field in node.fields)})"
        if isinstance(node, p.FromIdentifier):
            return self._captured(node, name)
        if isinstance(node, p.FromRequest):
            return f'request["{name}"] if request is not None else None'
        if isinstance(node, p.Rest):
            return self._rest(node)
        if isinstance(node, p.ListNode):
            return self._listed(node)
        if isinstance(node, p.DelimitedField):
            return self._cell(node, name)
        if isinstance(node, p.MoreCells):
            return f"tuple([cell.decode('latin-1') for cell in cells[{node.start}:]])"
        raise AssertionError(node)

    def _scalar(self, scalar: p.Scalar, name: str) -> str:
        if scalar.is_bytes:
            end = (
                f"{scalar.offset + scalar.size}"
                if scalar.size is not None
                else (f"-{self.plan.tail}" if self.plan.tail else "")
            )
            text = self.fetch.named.get(scalar) or f"data[{scalar.offset}:{end}]"
            if scalar.kind == "bytes" or self.raw:
                return text
            text = f'{text}.decode("latin-1")'
            if scalar.size is None:
                return text
            cuts = [f".partition({end!a})[0]" for end in scalar.ends]
            return text + ("".join(cuts) or '.rstrip("\\0")')
        number = self.fetch.number(scalar, name)
        return self._steps(number, scalar.steps, name, len(scalar.bits) if scalar.kind == "uint" else 0)

    def _steps(self, number: str, steps: Sequence[p.Step], name: str, width: int = 0) -> str:
        number_is_index = True
        for step in steps:
            if isinstance(step, p.Magnitude):
                number_is_index = False
                half = 1 << step.width - 1
                if number.isidentifier():
                    number = f"({number} if {number} < {half:#x} else {half:#x} - {number})"
                else:
                    number = f"(sm if (sm := {number}) < {half:#x} else {half:#x} - sm)"
            elif self.raw:
                continue
            elif isinstance(step, p.Scale):
                number = self._scaled(number, step, name)
            elif isinstance(step, p.ScaleByBit):
                where = f"{self.plan.name}_{name}"
                clear, set_ = (
                    f"{{}} * {self._spec_number(f'_scale{n}_{where}', scale.scale)}"
                    f" + {self._spec_number(f'_offset{n}_{where}', scale.offset)}"
                    for n, scale in enumerate(step.scales)
                )
                border = f"{step.half:#x}"
                number = f"({clear.format('q')} if (q := {number}) < {border} else {set_.format(f'(q - {border})')})"
            elif isinstance(step, p.ValueNames):
                names = dict(step.values)
                small = 0 < width <= 8 and number_is_index
                table = self._bound(
                    f"_names_{self.plan.name}_{name}",
                    [names.get(n, n) for n in range(1 << width)] if small else names,
                    shown=names,
                )
                if not small:
                    table = f"{table}.get"
                if small:
                    number = f"{table}[{number}]"
                else:
                    number = (
                        f"{table}({number}, {number})"
                        if number.isidentifier()
                        else f"{table}((n := {number}), n)"
                    )
            else:
                bits = self._bound(f"_bits_{self.plan.name}_{name}", dict(step.bits))
                table = self._table(f"_flags_{self.plan.name}_{name}", f"flags({bits})")
                number = f"{table}[{number}]"
        return number

    def _scaled(self, number: str, step: p.Scale, name: str) -> str:
        before = "q" if step.unknown or step.names else number
        text = (
            before
            if before.isidentifier()
            or (before.startswith("(") and before.endswith(")") and is_balanced(before))
            else f"({before})"
        )
        where = f"{self.plan.name}_{name}"
        offset = step.offset
        if step.scale != 1:  # in front, where a float multiplies without asking the integer first
            text = f"{self._spec_number(f'_scale_{where}', step.scale)} * {text}"
            if isinstance(step.scale, float) and abs(offset) < 1 << 53:
                offset = float(offset)  # a float less an integer takes twice as long
        if offset:
            is_less = is_plain(offset) and offset < 0
            text += " - " if is_less else " + "
            text += self._spec_number(f"_offset_{where}", -offset if is_less else offset)
        elif step.scale == 1:
            text = before
        if not step.unknown and not step.names:
            return text
        tests = []
        if step.unknown:
            is_range = isinstance(step.unknown, range)
            is_short = not is_range and all(map(is_plain, step.unknown))
            among = literal(step.unknown) if is_short else self._bound(f"_unknown_{where}", step.unknown)
            is_nan = " or q != q" if not is_range and any(value != value for value in step.unknown) else ""
            tests.append(f"None if q in {among}{is_nan} else ")
        if step.names:
            table = self._bound(f"_names_{where}", dict(step.names))
            tests.append(f"{table}[q] if q in {table} else ")
        tests[0] = tests[0].replace(" if q in", f" if (q := {number}) in", 1)
        return f"({''.join(tests)}{text})"

    def _captured(self, node: p.FromIdentifier, name: str) -> str:
        number = "key" if node.number is None else self.fetch.integer(node.number)
        if node.is_alone:
            if not number.isidentifier() and (node.constant or node.shift):
                number = f"({number})"
            text = f"{number} - {node.constant:#x}" if node.constant else number
            if node.shift:
                text = f"({text}) >> {node.shift}" if node.constant else f"{text} >> {node.shift}"
        else:
            mask = (1 << node.width) - 1
            text = f"{number} >> {node.shift} & {mask:#x}" if node.shift else f"{number} & {mask:#x}"
            if node.number is not None and not number.isidentifier():
                text = text.replace(number, f"({number})", 1)
        return self._steps(text, node.steps, name)

    def _rest(self, node: p.Rest) -> str:
        word = self.fetch.layouts[node.offset, node.size]
        full = (1 << 8 * node.size) - 1
        masks = {value: full & ~claimed for value, claimed in node.claimed}
        if node.selector is None:
            text = f"{word} & {masks[None]:#x}"
            for selector, added in node.more:
                inside = ", ".join(f"{value}: {full & ~mask:#x}" for value, mask in added)
                helper = self._table(f"_rest_{self.plan.name}_{selector.name}", f"{{{inside}}}.get")
                text += f" & {helper}({self.present[selector]}, {full:#x})"
            return text
        inside = ", ".join(f"{value}: {mask:#x}" for value, mask in masks.items() if value is not None)
        table = self._table(f"_rest_{self.plan.name}", f"{{{inside}}}.get")
        return f"{word} & {table}({self.present[node.selector]}, {masks[None]:#x})"

    # -------------------------------------------------- lists of items

    def _repeats(self) -> None:
        """Print the tests that a list of groups has as many bytes as its groups need."""
        for _, node in self.plan.lists:
            if not isinstance(node, p.Repeated):
                continue
            around = node.offset + self.plan.tail
            if node.count is None:
                left = f"(len(data) - {around})" if around else "len(data)"
                test = f"{left} % {node.width}" if node.width > 1 else ""
            else:
                test = f"len(data) != {around} + {node.width} * ({self.fetch.integer(node.count, fetched=False)})"
            if test:
                self.body.lines(
                    f"if {test}:",
                    "    return None",
                )

    def _listed(self, node: p.ListNode) -> str:
        end = f"len(data) - {self.plan.tail}" if self.plan.tail else "len(data)"
        printed = ListDecoder(node, self.plan.name, raw=self.raw, names=self.module)
        text = f"{printed.print()}(data, {printed.offset}, {end})"
        self.setup += printed.setup
        self.types |= printed.types
        return text

    # -------------------------------------------------- delimited payloads

    def _split(self, split: p.DelimitedSplit) -> None:
        out = self.body
        end = f"-{split.end}" if split.end else ""
        if split.lead:
            out.lines(
                f"if not data.startswith({literal(split.separator)}, {split.start}, len(data) - {split.end}):",
                "    return None",
            )
        start = split.start + (len(split.separator) if split.lead else 0)
        out.lines(
            f"cells = data[{start}:{end}].split({literal(split.separator)})",
            "count = len(cells)",
            f"if count < {split.least}:"
            if split.most is None
            else f"if not {split.least} <= count <= {split.most}:",
            "    return None",
        )
        for field in self.plan.fields:
            node = field.node
            if isinstance(node, p.DelimitedField) and node.form:
                made = f"re.compile({literal(node.form.encode())}).fullmatch"
                helper = self._table(f"_form_{field.name}_{self.plan.name}", made)
                guard = f"count > {node.index} and " if node.optional else ""
                out.lines(
                    f"if {guard}cells[{node.index}] and not {helper}(cells[{node.index}]):",
                    "    return None",
                )

    def _cell(self, cell: p.DelimitedField, name: str) -> str:
        text = f"cells[{cell.index}]"
        if self.raw:
            value = f'{text}.decode("latin-1")'
        elif cell.conversion == "number":
            value = f"float({text}) if {text} else None"
        elif cell.conversion == "integer":
            value = f"int({text}) if {text} else None"
        elif cell.conversion == "degrees":
            value = f"degrees({text}) if {text} else None"
        elif cell.conversion == "names":
            table = self._bound(f"_names_{self.plan.name}_{name}", dict(cell.names))
            value = f'{table}.get((n := {text}.decode("latin-1")), n) if {text} else None'
        else:
            value = f'{text}.decode("latin-1") or None'
        if cell.optional:
            value = f"({value}) if count > {cell.index} else None"
        return f"({value})" if " if " in value or " or " in value else value


class ListDecoder(FunctionSetup):
    """Prints the function that reads a list of items, and those of what is in it, into `setup`.

    The function takes the packet's bytes, where in them the list begins and where it ends, and gives a tuple. `offset` is
    where lists of this plan begin.
    """

    def __init__(self, node: p.ListNode, name: str, *, raw: bool, names: NameScope | None = None) -> None:
        self.node, self.name, self.raw = node, name, raw
        self.setup = []
        self.names = names if names is not None else NameScope(CALLED)
        self.types: dict[str, str] = {}
        self.offset = node.offset

    def print(self) -> str:
        """Print the function, and return its name; its text is in `setup` then, and the record types are in `types`."""
        node = self.node
        return self._items(node) if isinstance(node, p.TaggedItems) else self._groups(node)

    def _data(self, plan: p.MessagePlan, result: Callable[[str], str] = str) -> str:
        printed = Decoder(plan, raw=self.raw, names=self.names, result=result)
        setup, lines = printed.print()
        self.setup += [*setup, "", *lines, ""]
        self.types |= printed.types
        return printed.function

    def _groups(self, node: p.ListNode) -> str:
        assert isinstance(node, p.Repeated)
        inside = self._data(node.plan)
        function = self.names.new(f"groups_{node.plan.name}")
        self.setup += [
            f"def {function}(data, at, end):",
            f"    return tuple([{inside}(data[i : i + {node.width}]) for i in range(at, end, {node.width})])",
            "",
        ]
        return function

    def _items(self, node: p.TaggedItems) -> str:
        made = self.names.new(node.type_name)
        self.types[made] = node.type_name
        kinds: list[str] = []
        for kind in node.kinds:
            shown = literal(kind.number) if self.raw else repr(kind.name)
            function = self._data(kind.plan, lambda value, shown=shown: f"{made}({shown}, {value}, None)")  # type: ignore[misc]
            kinds.append(f"{kind.number}: ({shown}, {kind.name!r}, {kind.size}, {function}),")
        table = self.names.new(f"_kinds_{node.type_name}")
        function = self.names.new(f"items_{node.type_name}")
        out = SourceText()
        out.lines(
            f"{table} = {{", *(f"    {line}" for line in kinds), "}", "", f"def {function}(data, at, end):"
        )
        out.depth = 1
        out.lines(
            "found = []",
            "while at < end:",
            "    left = end - at",
            f"    if left < {node.head}:",
            f'        reason = f"malformed: {{left}} of the {node.head} bytes before an item\'s data"',
            f"        found.append({made}(None, data[at:end], reason))",
            "        break",
            f"    tag = {_number_at(node.tag)}",
            f"    kind = {table}.get(tag)",
        )
        out.depth = 2
        if node.size is not None:
            more = node.head - node.counted
            out.lines(
                f"size = {_number_at(node.size)}",
                f"stop = at + {more} + size" if more else "stop = at + size",
                f"if not at + {node.head} <= stop <= end:" if node.counted else "if stop > end:",
                '    reason = f"malformed: its size says {size}, and {left} bytes are left"',
                f"    found.append({made}(None, data[at:end], reason))",
                "    break",
            )
        else:
            out.line(
                f"stop = end if kind is None or kind[2] is None else min(end, at + {node.head} + kind[2])"
            )
        out.lines(
            f"inside = data[at + {node.head} : stop]",
            "at = stop",
            "if kind is None:",
            f'    found.append({made}(tag, inside, "unknown"))',
            "    continue",
            "item = kind[3](inside)",
            "if item is None:",
            '    reason = f"malformed: data of size {len(inside)} are not a {kind[1]}"',
            f"    item = {made}(kind[0], inside, reason)",
            "found.append(item)",
        )
        out.depth = 1
        out.line("return tuple(found)")
        self.setup += [*out.printed, ""]
        return function


def _number_at(number: p.Scalar) -> str:
    """Return an item's tag or size, from `data` and where the item begins, `at`."""
    places = [
        f"data[at + {number.offset + i}]" if number.offset + i else "data[at]"
        for i in range(number.size or 0)
    ]
    if len(places) == 1:
        return places[0]
    start = f"at + {number.offset}" if number.offset else "at"
    return f'from_bytes(data[{start} : at + {number.offset + len(places)}], "{number.order}")'


def is_balanced(text: str) -> bool:
    """Return whether the first parenthesis closes at the end."""
    depth = 0
    for index, char in enumerate(text):
        depth += (char == "(") - (char == ")")
        if depth == 0 and index < len(text) - 1:
            return False
    return True
