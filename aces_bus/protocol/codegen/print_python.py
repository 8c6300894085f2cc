"""Prints a plan as Python: record classes and decoders.

1. The printer decides nothing: the same plan gives the same text, byte for byte.
2. What is printed is meant to be read: one function a message, one line a field.
3. User objects (constructs, enumerations' tables) enter by name, never by repr.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from . import plan as p

_FORMATS = {("uint", 1): "B", ("uint", 2): "H", ("uint", 4): "I", ("uint", 8): "Q", ("int", 1): "b", ("int", 2): "h"}
_FORMATS |= {("int", 4): "i", ("int", 8): "q", ("float", 2): "e", ("float", 4): "f", ("float", 8): "d"}


class Source:
    """Lines of Python with an indentation."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.depth = 0

    def line(self, text: str = "") -> None:
        self.lines.append("    " * self.depth + text if text else "")

    def text(self) -> str:
        return "\n".join(self.lines) + "\n"


# ---------------------------------------------------------------------- types


def type_of(node: p.Node, *, raw: bool = False) -> str:
    """The Python type of a node's value, for annotations and stubs."""
    if isinstance(node, p.Scalar):
        return _scalar_type(node.kind, node.steps, raw)
    if isinstance(node, p.FromIdentifier):
        return _scalar_type("uint", node.steps, raw)
    if isinstance(node, p.Many):
        kinds = [type_of(item, raw=raw) for item in node.items]
        return f"tuple[{', '.join(kinds)}]" if kinds else "tuple[()]"
    if isinstance(node, p.Group):
        return node.type_name
    if isinstance(node, p.Rest):
        return "int"
    if isinstance(node, p.FromRequest):
        return "int | None"
    if isinstance(node, p.Cell):
        if raw:
            return "str | None"
        kind = {"text": "str", "number": "float", "integer": "int", "degrees": "float", "names": "str"}[node.conversion]
        return f"{kind} | None"
    if isinstance(node, p.MoreCells):
        return "tuple[str, ...]"
    return "Any"


def _scalar_type(kind: str, steps: Sequence[p.Step], raw: bool) -> str:
    base = {"uint": "int", "int": "int", "float": "float", "bytes": "bytes", "text": "bytes" if raw else "str"}[kind]
    if raw:
        return base
    for step in steps:
        if isinstance(step, p.Scale):
            if step.scale != 1 or step.offset:
                whole = isinstance(step.scale, int) and isinstance(step.offset, int)
                base = base if whole else "float"
            if step.unknown:
                base += " | None"
        elif isinstance(step, p.Names):
            base = "str | int"
        elif isinstance(step, p.FlagBits):
            base = "FlagSet"
    return base


def groups_of(fields: Iterable[p.PlanField]) -> list[p.Group]:
    """The nested records among fields, innermost first, each once."""
    found: dict[str, p.Group] = {}

    def visit(node: p.Node) -> None:
        if isinstance(node, p.Group):
            for field in node.fields:
                visit(field.node)
            found[node.type_name] = node
        elif isinstance(node, p.Many):
            for item in node.items:
                visit(item)

    for field in fields:
        visit(field.node)
    return list(found.values())


def print_records(label: str, plans: Sequence[p.MessagePlan]) -> str:
    """The record classes of a variant."""
    out = Source()
    out.line(f'"""Records of {label}: generated from its spec."""')
    out.line()
    for plan in plans:
        for group in groups_of(plan.fields):
            out.line(f"class {group.type_name}(Part, frozen=True, gc=False):")
            out.depth += 1
            for field in group.fields:
                _annotate(out, field)
            out.depth -= 1
            out.line()
        for index, (path, names) in enumerate(plan.parts):
            out.line(f"class {path}_{index}(Part, frozen=True, gc=False):")
            for name in names:
                out.line(f"    {name}: Any")
            if not names:
                out.line("    pass")
            out.line()
        out.line(f"class {plan.name}(Record, frozen=True, gc=False):")
        out.depth += 1
        out.line(f'"""{_first_line(plan.doc) or plan.name}"""')
        out.line()
        for field in plan.fields:
            _annotate(out, field)
        out.line("_meta: tuple[Any, ...]")
        out.depth -= 1
        out.line()
    return out.text()


def _annotate(out: Source, field: p.PlanField) -> None:
    kind = type_of(field.node)
    if field.when is not None and not kind.endswith("None"):
        kind += " | None"
    out.line(f"{field.name}: {kind}")


def _first_line(doc: str) -> str:
    return doc.strip().split("\n", 1)[0].replace("\\", "\\\\").replace('"', "'")


# ---------------------------------------------------------------------- decoders


class Decoder:
    """Prints the decode function of one message.

    The function is `decode_Name(data, key, meta, request=None)`: `data` are the frame's data bytes or the packet without
    stuffing; it gives the record, or None when the data is not this message.
    """

    def __init__(self, plan: p.MessagePlan, *, raw: bool) -> None:
        self.plan = plan
        self.raw = raw
        self.setup: list[str] = []
        self.body = Source()
        self.atoms: dict[p.Scalar, str] = {}
        self.words: dict[tuple[int, int, str], str] = {}
        self.present: dict[str, str] = {}

    def print(self) -> tuple[list[str], list[str]]:
        """(module-level lines, function lines)."""
        plan, out = self.plan, self.body
        out.line(f"def decode_{plan.name}(data, key, meta, request=None):")
        out.depth = 1
        out.line(f'"""{_first_line(plan.doc) or plan.name} ({plan.place})"""')
        if not plan.is_flat:
            out.line(f"# through construct: {plan.opaque}")
            out.line(f"return opaque_{plan.name}(data, key, meta, request)")
            return self.setup, out.lines
        self._lengths()
        self._constants()
        if plan.is_checked:
            out.line(f"if not holds_{plan.name}(data, key):")
            out.line("    return None")
        if plan.split is not None:
            self._split(plan.split)
        self._unpack()
        self._words()
        for name, scalar in plan.selectors:
            if scalar not in self.atoms:
                out.line(f"select_{name} = {self._integer(scalar)}")
                self.atoms[scalar] = f"select_{name}"
            self.present[name] = self.atoms[scalar]
        if plan.lengths_by is not None:
            name, table, other = plan.lengths_by
            self.setup.append(f"_lengths_{plan.name} = {dict(table)!r}")
            out.line(f"if len(data) != _lengths_{plan.name}.get({self.present[name]}, {other}):")
            out.line("    return None")
        arguments = [self._value(field) for field in plan.fields]
        if sum(map(len, arguments)) + len(plan.name) < 90:
            out.line(f"return {plan.name}({', '.join([*arguments, 'meta'])})")
        else:
            out.line(f"return {plan.name}(")
            for field, argument in zip(plan.fields, arguments, strict=True):
                out.line(f"    {argument},  # {field.name}")
            out.line("    meta,")
            out.line(")")
        return self.setup, out.lines

    def _lengths(self) -> None:
        plan, out = self.plan, self.body
        if plan.lengths is None:
            out.line(f"if len(data) < {plan.least}:")
        elif len(plan.lengths) == 1:
            out.line(f"if len(data) != {plan.lengths[0]}:")
        elif plan.lengths == tuple(range(plan.lengths[0], plan.lengths[-1] + 1)):
            out.line(f"if not {plan.lengths[0]} <= len(data) <= {plan.lengths[-1]}:")
        else:
            out.line(f"if len(data) not in {plan.lengths}:")
        out.line("    return None")

    def _constants(self) -> None:
        tests = []
        for constant in self.plan.constants:
            if constant.mask == 0xFF:
                tests.append(f"data[{constant.offset}] != {constant.value:#04x}")
            else:
                tests.append(f"data[{constant.offset}] & {constant.mask:#04x} != {constant.value:#04x}")
        for one in self.plan.one_of:
            values = one.values
            run = len(values) > 2 and values == tuple(range(values[0], values[-1] + 1))
            number = self._integer(one.number)
            tests.append(f"not {values[0]} <= {number} <= {values[-1]}" if run else f"{number} not in {_members(values)}")
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

    def _unpack(self) -> None:
        """One `struct` call for each byte order fetches all whole numbers of usual size."""
        plan = self.plan
        usual = [
            s
            for s, always in self._scalars()
            if always and s.size is not None and (s.kind, s.size) in _FORMATS and (s.kind == "float" or s.is_whole)
        ]
        wide = [s for s in usual if not (s.kind == "uint" and s.size == 1)]
        if not wide and len(usual) < 4:
            return
        for order, mark in (("little", "<"), ("big", ">")):
            mine = [s for s in usual if s in wide and (s.order == order and s.size != 1)]
            if not mine:
                if order == "little" and not any(s.size != 1 for s in wide):
                    mine = usual
                else:
                    continue
            else:
                mine = sorted({*mine, *(s for s in usual if s.size == 1 and s not in self.atoms)}, key=lambda s: s.offset)
            mine = sorted(set(mine), key=lambda s: s.offset)
            picked: list[p.Scalar] = []
            at = mine[0].offset
            text = mark
            for scalar in mine:
                if scalar.offset < at or scalar in self.atoms:
                    continue
                if scalar.offset > at:
                    text += f"{scalar.offset - at}x"
                text += _FORMATS[scalar.kind, scalar.size or 0]
                at = scalar.offset + (scalar.size or 0)
                picked.append(scalar)
            names = [f"v{len(self.atoms) + i}" for i in range(len(picked))]
            self.atoms.update(zip(picked, names, strict=True))
            start = picked[0].offset
            whole = start == 0 and plan.lengths == (at,)
            helper = f"_unpack_{plan.name}" + ("" if order == "little" else "_be")
            self.setup.append(f'{helper} = Struct("{_compact(text)}").{"unpack" if whole else "unpack_from"}')
            call = f"{helper}(data)" if whole or start == 0 else f"{helper}(data, {start})"
            self.body.line(f"{', '.join(names)}{',' if len(names) == 1 else ''} = {call}")

    def _words(self) -> None:
        """Bit fields that share bytes are cut from one integer."""
        todo: dict[tuple[int, int, str], int] = {}
        for scalar, _ in self._scalars():
            if scalar.kind in ("uint", "int") and scalar not in self.atoms and not _one_byte(scalar):
                order = _run_order(scalar)
                key = (scalar.offset, scalar.size or 0, order)
                todo[key] = todo.get(key, 0) + 1
        for field in self._all_fields():
            if isinstance(field.node, p.Rest):
                todo[field.node.offset, field.node.size, "little"] = 2
        for (offset, size, order), count in todo.items():
            if count > 1:
                name = f"word{len(self.words)}"
                self.words[offset, size, order] = name
                self.body.line(f'{name} = from_bytes({self._slice(offset, offset + size)}, "{order}")')

    def _all_fields(self) -> list[p.PlanField]:
        return [*self.plan.fields, *(f for g in groups_of(self.plan.fields) for f in g.fields)]

    def _slice(self, start: int, end: int) -> str:
        if start == 0 and self.plan.lengths == (end,):
            return "data"
        return f"data[{start or ''}:{end}]"

    def _integer(self, scalar: p.Scalar) -> str:
        """The unsigned number, as an expression."""
        if scalar in self.atoms:
            return self.atoms[scalar]
        assert scalar.size is not None
        if _one_byte(scalar):
            byte = scalar.bits[0] // 8
            shift, width = scalar.bits[0] % 8, len(scalar.bits)
            text = f"data[{byte}]"
            if width == 8:
                return text
            if shift:
                text += f" >> {shift}"
            return text if shift + width == 8 else f"{text} & {(1 << width) - 1:#x}"
        order = _run_order(scalar)
        word = self.words.get((scalar.offset, scalar.size, order))
        offset, size = scalar.offset, scalar.size
        if word is None:
            # Read only the bytes that the field touches.
            first, last = min(scalar.bits) // 8, max(scalar.bits) // 8
            offset, size = first, last - first + 1
            word = f'from_bytes({self._slice(offset, offset + size)}, "{order}")'
        if order == "little":
            positions = [b - 8 * offset for b in scalar.bits]
        else:
            positions = [(offset + size - 1 - b // 8) * 8 + b % 8 for b in scalar.bits]
        pieces = []
        for at, to, width in _runs(positions):
            piece = f"{word} >> {at}" if at else word
            if at + width < 8 * size:
                piece = f"{piece} & {(1 << width) - 1:#x}" if at or to else f"{piece} & {(1 << width) - 1:#x}"
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
            end = f"{scalar.offset + scalar.size}" if scalar.size is not None else (f"-{self.plan.tail}" if self.plan.tail else "")
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
        return self._steps(number, scalar.steps, name)

    def _lone(self, scalar: p.Scalar, name: str) -> str:
        """A float that is not always there."""
        mark = "<" if scalar.order == "little" else ">"
        helper = f"_unpack_{self.plan.name}_{name}"
        self.setup.append(f'{helper} = Struct("{mark}{_FORMATS["float", scalar.size or 0]}").unpack_from')
        return f"{helper}(data, {scalar.offset})[0]"

    def _steps(self, number: str, steps: Sequence[p.Step], name: str) -> str:
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
                line = f"{table} = {dict(step.values)!r}.get"
                if line not in self.setup:
                    self.setup.append(line)
                number = f"{table}({number}, {number})" if number.isidentifier() else f"{table}((n := {number}), n)"
            else:
                number = f"flags_{self.plan.name}_{name}({number})"
        return number

    def _scaled(self, number: str, step: p.Scale) -> str:
        before = number
        if step.unknown:
            before = "q"
        text = before if before.isidentifier() or before.startswith("(") and before.endswith(")") and _balanced(before) else f"({before})"
        if step.offset:
            text = f"{text} * {step.scale!r} + {step.offset!r}"
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
        word = self.words[node.offset, node.size, "little"]
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
        out.line(f"if count < {split.least}:" if split.most is None else f"if not {split.least} <= count <= {split.most}:")
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


def _one_byte(scalar: p.Scalar) -> bool:
    bits = scalar.bits
    return bool(bits) and bits[0] // 8 == bits[-1] // 8 and bits == tuple(range(bits[0], bits[0] + len(bits)))


def _run_order(scalar: p.Scalar) -> str:
    """The byte order in which the field falls into fewer pieces."""
    little = len(_runs(list(scalar.bits)))
    size = scalar.size or 0
    big = len(_runs([(scalar.offset + size - 1 - b // 8) * 8 + b % 8 for b in scalar.bits]))
    return "big" if big < little else "little"


def _runs(positions: Sequence[int]) -> list[tuple[int, int, int]]:
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


def _compact(text: str) -> str:
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
