"""Prints decoders: one function a message, from data bytes to a record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..spec.pattern import bounds
from . import plan as p
from .source import Source, first_line

FORMATS = {
    ("uint", 1): "B",
    ("uint", 2): "H",
    ("uint", 4): "I",
    ("uint", 8): "Q",
    ("int", 1): "b",
    ("int", 2): "h",
    ("int", 4): "i",
    ("int", 8): "q",
    ("float", 2): "e",
    ("float", 4): "f",
    ("float", 8): "d",
}

TRANSPORT = "time, channel, key, raw, rx"


@dataclass(frozen=True)
class Cell:
    """Bytes [start, end) fetched as one unsigned integer (or as the value itself) under a local name."""

    name: str
    start: int
    end: int
    order: str


class Decoder:
    """Prints the decode function of one message.

    The function is `decode_Name(data, key, time, channel, raw, rx)`: `data` are the frame's data bytes or the packet
    without stuffing, the rest is the transport's; messages that show fields of their request take it last. It gives the
    record, or None when the data is not this message. Without `guard` the length check is left to `struct.unpack`,
    which raises `struct.error`.
    """

    def __init__(self, plan: p.MessagePlan, *, raw: bool, guard: bool = True) -> None:
        self.plan = plan
        self.raw = raw
        self.guard = guard
        self.setup: list[str] = []
        self.body = Source()
        self.atoms: dict[p.Scalar, str] = {}
        self.cells: list[Cell] = []
        self.present: dict[str, str] = {}
        self.unpacks: list[str] = []
        self.is_exact = False

    def print(self) -> tuple[list[str], list[str]]:
        """(module-level lines, function lines)."""
        plan, out = self.plan, self.body
        needs = not plan.is_flat or any(isinstance(field.node, p.FromRequest) for field in plan.fields)
        out.line(
            f"def decode_{plan.name}(data, key, time, channel, raw, rx{', request=None' if needs else ''}):"
        )
        out.depth = 1
        out.line(f'"""{first_line(plan.doc) or plan.name} ({plan.place})"""')
        if not plan.is_flat:
            out.line(f"# through construct: {plan.opaque}")
            out.line(f"return opaque_{plan.name}(data, key, time, channel, raw, rx, request)")
            return self.setup, out.lines
        self._fetch()
        tests = plan.constants[plan.sync :] or plan.one_of or plan.is_checked or plan.lengths_by
        if self.guard or tests or not self.is_exact:
            self._lengths()
        self._constants()
        if plan.is_checked:
            out.line(f"if not holds_{plan.name}(data, key):")
            out.line("    return None")
        if plan.split is not None:
            self._split(plan.split)
        for line in self.unpacks:
            out.line(line)
        for name, scalar in plan.selectors:
            number = self._integer(scalar)
            if not number.isidentifier():
                out.line(f"select_{name} = {number}")
                number = self.atoms[scalar] = f"select_{name}"
            self.present[name] = number
        if plan.lengths_by is not None:
            name, table, other = plan.lengths_by
            self.setup.append(f"_lengths_{plan.name} = {dict(table)!r}")
            out.line(f"if len(data) != _lengths_{plan.name}.get({self.present[name]}, {other}):")
            out.line("    return None")
        arguments = [self._value(field) for field in plan.fields]
        if sum(map(len, arguments)) + len(plan.name) < 60:
            out.line(f"return {plan.name}({', '.join([*arguments, TRANSPORT])})")
        else:
            out.line(f"return {plan.name}(")
            for field, argument in zip(plan.fields, arguments, strict=True):
                out.line(f"    {argument},  # {field.name}")
            out.line(f"    {TRANSPORT},")
            out.line(")")
        return self.setup, out.lines

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
                out.line(f"if len(data) not in {plan.lengths}:")
        out.line("    return None")

    def _constants(self) -> None:
        tests = []
        for constant in self.plan.constants[self.plan.sync :]:
            if constant.mask == 0xFF:
                tests.append(f"data[{constant.offset}] != {constant.value:#04x}")
            else:
                tests.append(f"data[{constant.offset}] & {constant.mask:#04x} != {constant.value:#04x}")
        for one in self.plan.one_of:
            values = one.values
            low, high = bounds(values)
            run = len(values) > 2 and len(values) == high - low + 1
            number = self._integer(one.number, fetched=False)  # the test stands before the fetching
            if run and low == 0 and number.startswith("data["):
                tests.append(f"{number} > {high}")
            else:
                among = repr(values) if isinstance(values, range) else _members(values)
                tests.append(f"not {low} <= {number} <= {high}" if run else f"{number} not in {among}")
        for test in tests:
            self.body.line(f"if {test}:")
            self.body.line("    return None")

    # -------------------------------------------------- fetching

    def _scalars(self) -> list[tuple[p.Scalar, bool]]:
        """Every scalar, with whether it is always present."""
        found: list[tuple[p.Scalar, bool]] = []

        def visit(node: p.Node, always: bool) -> None:
            if isinstance(node, p.Scalar):
                found.append((node, always))
            elif isinstance(node, p.Many):
                for item in node.items:
                    visit(item, always)
            elif isinstance(node, p.Group):
                for field in node.fields:
                    visit(field.node, always and field.when is None)

        for field in self.plan.fields:
            visit(field.node, field.when is None)
        return found

    def _fetch(self) -> None:
        """Plan the fetching: one `struct` call for each byte order gets every number, bit fields by the bytes they share."""
        present = [s for s, always in self._scalars() if always]
        whole = [s for s in dict.fromkeys(present) if s.size is not None and format_of(s)]
        taken = [(s.offset, s.offset + (s.size or 0)) for s in whole]
        chunks: list[tuple[int, int, str, p.Scalar | None]] = [
            (s.offset, s.offset + (s.size or 0), s.order if s.size != 1 else "", s) for s in whole
        ]
        loose = [s for s in dict.fromkeys(present) if s.kind in ("uint", "int") and s not in whole]
        for start, end, order in _clusters(loose):
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
        for start, end, order in _clusters(
            [s for s in loose if self._cell_of(s) is None and not _one_byte(s)]
        ):
            if sum(start <= s.bits[0] // 8 < end for s in loose) > 1:
                name = f"word{len(self.cells)}"
                self.cells.append(Cell(name, start, end, order or "little"))
                self.unpacks.append(f'{name} = from_bytes({self._slice(start, end)}, "{order or "little"}")')
        for node in self._rests():
            cell = Cell(f"all{node.offset}", node.offset, node.offset + node.size, "little")
            self.cells.append(cell)
            self.unpacks.append(f'{cell.name} = from_bytes({self._slice(cell.start, cell.end)}, "little")')

    def _unpack_call(self, chunks: Sequence[tuple[int, int, str, p.Scalar | None]], order: str) -> None:
        text = ">" if order == "big" else "<"
        at = chunks[0][0]
        names: list[str] = []
        after: list[str] = []
        for start, end, _, scalar in chunks:
            if start > at:
                text += f"{start - at}x"
            at = end
            name = f"v{len(self.cells)}"
            size = end - start
            if scalar is not None:
                text += format_of(scalar)
                names.append(name)
                self.atoms[scalar] = name
            elif size == 3:
                text += "BH" if order == "big" else "HB"
                names += [f"{name}a", f"{name}b"]
                after.append(
                    f"{name} = {name}a << 16 | {name}b"
                    if order == "big"
                    else f"{name} = {name}a | {name}b << 16"
                )
            else:
                text += FORMATS["uint", size]
                names.append(name)
            self.cells.append(Cell(name, start, end, order or "little"))
        start = chunks[0][0]
        whole = start == 0 and self.plan.lengths == (at,)
        self.is_exact = self.is_exact or whole
        helper = f"_unpack_{self.plan.name}" + ("_be" if order == "big" else "")
        self.setup.append(f'{helper} = Struct("{compact(text)}").{"unpack" if whole else "unpack_from"}')
        call = f"{helper}(data)" if start == 0 else f"{helper}(data, {start})"
        self.unpacks.append(f"{', '.join(names)}{',' if len(names) == 1 else ''} = {call}")
        self.unpacks += after

    def _cell_of(self, scalar: p.Scalar) -> Cell | None:
        first, last = min(scalar.bits) // 8, max(scalar.bits) // 8
        order = _run_order(scalar)
        for cell in self.cells:
            if (
                cell.start <= first
                and last < cell.end
                and (cell.order == order or cell.end - cell.start == 1)
            ):
                return cell
        return None

    def _rests(self) -> list[p.Rest]:
        """Every rest, also those of each nested record in an array."""
        found: list[p.Rest] = []

        def visit(node: p.Node) -> None:
            if isinstance(node, p.Rest):
                found.append(node)
            elif isinstance(node, p.Many):
                for item in node.items:
                    visit(item)
            elif isinstance(node, p.Group):
                for field in node.fields:
                    visit(field.node)

        for field in self.plan.fields:
            visit(field.node)
        return found

    def _slice(self, start: int, end: int) -> str:
        if start == 0 and self.plan.lengths == (end,):
            return "data"
        return f"data[{start or ''}:{end}]"

    def _integer(self, scalar: p.Scalar, *, fetched: bool = True) -> str:
        """The unsigned number (the signed one, of whole signed numbers), as an expression; from `data`, unless `fetched`."""
        if fetched and scalar in self.atoms:
            return self.atoms[scalar]
        assert scalar.size is not None
        cell = self._cell_of(scalar) if fetched else None
        order = _run_order(scalar)
        if cell is None:
            first, last = min(scalar.bits) // 8, max(scalar.bits) // 8
            text = (
                f"data[{first}]"
                if first == last
                else f'from_bytes({self._slice(first, last + 1)}, "{order}")'
            )
            cell = Cell(text, first, last + 1, order)
        if cell.order == "little" or cell.end - cell.start == 1:
            positions = [b - 8 * cell.start for b in scalar.bits]
        else:
            positions = [(cell.end - 1 - b // 8) * 8 + b % 8 for b in scalar.bits]
        pieces = []
        for at, to, width in runs_of(positions):
            piece = f"{cell.name} >> {at}" if at else cell.name
            if at + width < 8 * (cell.end - cell.start):
                piece = f"{piece} & {(1 << width) - 1:#x}"
            if to:
                piece = f"({piece}) << {to}"
            pieces.append(piece)
        if len(pieces) == 1:
            return pieces[0]
        return " | ".join(f"({piece})" if "&" in piece or ">>" in piece else piece for piece in pieces)

    # -------------------------------------------------- values

    def _value(self, field: p.PlanField) -> str:
        text = self._node(field.node, field.name)
        if field.when is not None:
            selector, values = field.when
            test = f"== {values[0]}" if len(values) == 1 else f"in {_members(values)}"
            return f"({text} if {self.present[selector]} {test} else None)"
        return text

    def _node(self, node: p.Node, name: str) -> str:
        if isinstance(node, p.Scalar):
            return self._scalar(node, name)
        if isinstance(node, p.Many):
            items = [self._node(item, name) for item in node.items]
            return f"({', '.join(items)}{',' if len(items) == 1 else ''})"
        if isinstance(node, p.Group):
            return f"{node.type_name}({', '.join(self._value(field) for field in node.fields)})"
        if isinstance(node, p.FromIdentifier):
            return self._captured(node, name)
        if isinstance(node, p.FromRequest):
            return f'request["{name}"] if request is not None else None'
        if isinstance(node, p.Rest):
            return self._rest(node)
        if isinstance(node, p.Cell):
            return self._cell(node, name)
        if isinstance(node, p.MoreCells):
            return f"tuple([cell.decode('latin-1') for cell in cells[{node.start}:]])"
        raise AssertionError(node)

    def _scalar(self, scalar: p.Scalar, name: str) -> str:
        if scalar.kind in ("bytes", "text"):
            end = (
                f"{scalar.offset + scalar.size}"
                if scalar.size is not None
                else (f"-{self.plan.tail}" if self.plan.tail else "")
            )
            text = f"data[{scalar.offset}:{end}]"
            if scalar.kind == "bytes" or self.raw:
                return text
            return f'{text}.decode("latin-1")' + ('.rstrip("\\0")' if scalar.size is not None else "")
        if scalar.kind == "float":
            number = self.atoms.get(scalar) or self._lone(scalar, name)
        elif scalar in self.atoms:
            number = self.atoms[scalar]
        else:
            number = self._integer(scalar)
            if scalar.kind == "int":
                top = 1 << len(scalar.bits) - 1
                number = f"(({number}) ^ {top:#x}) - {top:#x}"
        return self._steps(number, scalar.steps, name, len(scalar.bits) if scalar.kind == "uint" else 0)

    def _lone(self, scalar: p.Scalar, name: str) -> str:
        """A float that is not always there."""
        mark = "<" if scalar.order == "little" else ">"
        helper = f"_unpack_{self.plan.name}_{name}"
        self.setup.append(f'{helper} = Struct("{mark}{FORMATS["float", scalar.size or 0]}").unpack_from')
        return f"{helper}(data, {scalar.offset})[0]"

    def _steps(self, number: str, steps: Sequence[p.Step], name: str, width: int = 0) -> str:
        for step in steps:
            if isinstance(step, p.Magnitude):
                half = 1 << step.width - 1
                if number.isidentifier():
                    number = f"({number} if {number} < {half:#x} else {half:#x} - {number})"
                else:
                    number = f"(sm if (sm := {number}) < {half:#x} else {half:#x} - sm)"
            elif self.raw:
                continue
            elif isinstance(step, p.Scale):
                number = self._scaled(number, step)
            elif isinstance(step, p.Names):
                table = f"_names_{self.plan.name}_{name}"
                small = 0 < width <= 8
                value = f"{dict(step.values)!r}.get"
                if small:
                    value = f"[{value}(n, n) for n in range({1 << width})]"
                table = self._table(table, value)
                if small:
                    number = f"{table}[{number}]"
                else:
                    number = (
                        f"{table}({number}, {number})"
                        if number.isidentifier()
                        else f"{table}((n := {number}), n)"
                    )
            else:
                table = self._table(f"_flags_{self.plan.name}_{name}", f"flags({dict(step.bits)!r})")
                number = f"{table}[{number}]"
        return number

    def _table(self, name: str, value: str) -> str:
        """The name of a table with this value: `name`, or with a number behind it where that is another table."""
        found, count = name, 1
        while f"{found} = {value}" not in self.setup:
            if not any(line.startswith(f"{found} = ") for line in self.setup):
                self.setup.append(f"{found} = {value}")
                break
            count += 1
            found = f"{name}_{count}"
        return found

    def _scaled(self, number: str, step: p.Scale) -> str:
        before = number
        if step.unknown:
            before = "q"
        text = (
            before
            if before.isidentifier()
            or (before.startswith("(") and before.endswith(")") and _balanced(before))
            else f"({before})"
        )
        if step.offset:
            text = f"{text} * {step.scale!r}" if step.scale != 1 else text
            text += f" - {-step.offset!r}" if step.offset < 0 else f" + {step.offset!r}"
        elif step.scale != 1:
            text = f"{text} * {step.scale!r}"
        else:
            text = before
        if step.unknown:
            return f"(None if (q := {number}) in {_members(step.unknown)} else {text})"
        return text

    def _captured(self, node: p.FromIdentifier, name: str) -> str:
        number = "key" if node.number is None else self._integer(node.number)
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
        word = f"all{node.offset}"
        full = (1 << 8 * node.size) - 1
        masks = {value: full & ~claimed for value, claimed in node.claimed}
        if node.selector is None:
            return f"{word} & {masks[None]:#x}"
        table = f"_rest_{self.plan.name}"
        inside = ", ".join(f"{value}: {mask:#x}" for value, mask in masks.items() if value is not None)
        self.setup.append(f"{table} = {{{inside}}}.get")
        return f"{word} & {table}({self.present[node.selector]}, {masks[None]:#x})"

    # -------------------------------------------------- delimited payloads

    def _split(self, split: p.Split) -> None:
        out = self.body
        end = f"-{split.end}" if split.end else ""
        if split.lead:
            out.line(f"if not data.startswith({split.separator!r}, {split.start}, len(data) - {split.end}):")
            out.line("    return None")
        start = split.start + (len(split.separator) if split.lead else 0)
        out.line(f"cells = data[{start}:{end}].split({split.separator!r})")
        out.line("count = len(cells)")
        out.line(
            f"if count < {split.least}:"
            if split.most is None
            else f"if not {split.least} <= count <= {split.most}:"
        )
        out.line("    return None")
        for field in self.plan.fields:
            node = field.node
            if isinstance(node, p.Cell) and node.form:
                helper = f"_form_{field.name}_{self.plan.name}"
                self.setup.append(f"{helper} = re.compile({node.form.encode()!r}).fullmatch")
                guard = f"count > {node.index} and " if node.optional else ""
                out.line(f"if {guard}cells[{node.index}] and not {helper}(cells[{node.index}]):")
                out.line("    return None")

    def _cell(self, cell: p.Cell, name: str) -> str:
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
            table = f"_names_{self.plan.name}_{name}"
            self.setup.append(f"{table} = {dict(cell.names)!r}.get")
            value = f'{table}((n := {text}.decode("latin-1")), n) if {text} else None'
        else:
            value = f'{text}.decode("latin-1") or None'
        if cell.optional:
            value = f"({value}) if count > {cell.index} else None"
        return f"({value})" if " if " in value or " or " in value else value


def format_of(scalar: p.Scalar) -> str:
    """The `struct` format of a whole number of usual size, else empty."""
    if scalar.size is None or (scalar.kind, scalar.size) not in FORMATS:
        return ""
    if scalar.kind != "float" and not scalar.is_whole:
        return ""
    return FORMATS[scalar.kind, scalar.size]


def _clusters(scalars: Sequence[p.Scalar]) -> list[tuple[int, int, str]]:
    """Byte ranges that the scalars cover, merged where they overlap, with the byte order that suits all in it."""
    spans = sorted(
        (min(s.bits) // 8, max(s.bits) // 8 + 1, "" if _one_byte(s) else _run_order(s)) for s in scalars
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


def _one_byte(scalar: p.Scalar) -> bool:
    bits = scalar.bits
    return bool(bits) and bits[0] // 8 == bits[-1] // 8 and bits == tuple(range(bits[0], bits[0] + len(bits)))


def _run_order(scalar: p.Scalar) -> str:
    """The byte order in which the field falls into fewer pieces."""
    little = len(runs_of(list(scalar.bits)))
    size = scalar.size or 0
    big = len(runs_of([(scalar.offset + size - 1 - b // 8) * 8 + b % 8 for b in scalar.bits]))
    return "big" if big < little else "little"


def runs_of(positions: Sequence[int]) -> list[tuple[int, int, int]]:
    """Contiguous runs: (position of the lowest bit, its place in the number, width)."""
    runs: list[tuple[int, int, int]] = []
    for to, at in enumerate(positions):
        if runs and runs[-1][0] + runs[-1][2] == at:
            first, place, width = runs[-1]
            runs[-1] = (first, place, width + 1)
        else:
            runs.append((at, to, 1))
    return runs


def _members(values: Sequence[float]) -> str:
    """A container display that the compiler makes constant."""
    return f"({', '.join(map(repr, values))}{',' if len(values) == 1 else ''})"


def _balanced(text: str) -> bool:
    """Whether the first parenthesis closes at the end."""
    depth = 0
    for index, char in enumerate(text):
        depth += (char == "(") - (char == ")")
        if depth == 0 and index < len(text) - 1:
            return False
    return True


def compact(text: str) -> str:
    """`<hhh` as `<3h`."""
    out, last, count = text[0], "", 0
    for char in text[1:] + "\0":
        if char == last and not char.isdigit():
            count += 1
            continue
        if last:
            out += (str(count) if count > 1 else "") + last
        last, count = char, 1
        if char.isdigit():
            out += char
            last, count = "", 0
    return out
