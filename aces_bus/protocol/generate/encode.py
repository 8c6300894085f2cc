"""Prints encoders: the usual values, straight into bytes.

1. A printed encoder never explains and never guesses: whatever does not fit at once raises, and construct says why.
2. What it returns is what construct builds, byte for byte.

The function is `encode_Name(fields)`; it gives the identifier (None on streams), the head bytes and the payload bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial

from ..declare.bits import runs_of
from ..declare.fields import raw_of_two, truncated
from ..declare.head import Head
from ..declare.message import Message
from ..declare.pattern import IdPattern
from ..plan import nodes as p
from .source import FunctionSetup, NameScope, SourceText, compact, literal

#: What encoders call, given to every module of them.
CALLED = ("Struct", "Unusual")


class NoEncoder(Exception):
    """This message is built by construct; the argument says why."""


def print_encoder(message: Message, plan: p.MessagePlan, names: NameScope) -> tuple[str, list[str]]:
    """Return the function's name, and the module-level lines with the function; raises `NoEncoder` when the message
    has no flat form to build from.

    `names` are the module's, with `CALLED` among them; what is bound in them must be given to the text.
    """
    printer = _Encoder(message, plan, names)
    return printer.function, printer.print()


@dataclass(frozen=True)
class _Packed:
    """One value for `struct.pack`; `order` is "<", ">" or empty for what has none."""

    offset: int
    size: int
    order: str
    format: str
    value: str

    @property
    def end(self) -> int:
        return self.offset + self.size


class _Encoder(FunctionSetup):
    def __init__(self, message: Message, plan: p.MessagePlan, names: NameScope) -> None:
        self.message, self.plan = message, plan
        self.names = NameScope(("fields",), inside=names)
        self.function = names.new(f"encode_{plan.name}", avoid=self.names)
        self.setup = []
        self.out = SourceText()
        self.temporaries = 0

    def print(self) -> list[str]:
        plan, message, out = self.plan, self.message, self.out
        if not plan.is_flat:
            raise NoEncoder(plan.opaque)
        if plan.split is not None or plan.lengths_by is not None or plan.selectors or plan.is_checked:
            raise NoEncoder("its payload depends on its values")
        if plan.lists:
            raise NoEncoder("a list of items")
        if message.counters:
            raise NoEncoder("it has a rolling counter")
        names = [f.name for f in plan.fields if not f.node.is_of_request]
        out.line(f"def {self.function}(fields):")
        out.depth = 1
        out.lines(
            f"if len(fields) != {len(names)}:",
            "    raise Unusual",
        )
        identifier = self._number(message.identifier)
        head, start = self._head(), message.payload_start
        scalars: list[tuple[p.Scalar, str, str]] = []
        for field in plan.fields:
            node = field.node
            if node.is_captured or node.is_of_request or field.name in {h.name for h in message.heads}:
                continue
            if field.name == "reserved" and isinstance(node, p.Rest):
                if any(value is not None for value, _ in node.claimed):
                    raise NoEncoder("its payload depends on its values")
                out.lines(
                    f'if fields["{field.name}"]:',
                    "    raise Unusual",
                )
                continue
            scalars += self._scalars(node, field.name, f'fields["{field.name}"]')
        body = self._body(scalars, start)
        out.line(f"return {identifier if message.framing is None else 'None'}, {head}, {body}")
        return [*self.setup, *out.printed]

    def _scalars(self, node: p.Node, name: str, value: str) -> list[tuple[p.Scalar, str, str]]:
        """Return the numbers and bytes of a field with their names and the words of their values."""
        if isinstance(node, p.Scalar):
            return [(node, name, value)]
        out, children = self.out, node.children
        if isinstance(node, p.Many):
            variables = [self._temporary() for _ in children]
            several = f"{', '.join(variables)}{',' if len(variables) == 1 else ''}" if variables else "()"
            out.line(f"{several} = {value}")
        elif isinstance(node, p.NestedRecord):
            children = [child for child in children if not child[1].node.is_unclaimed]
            record = self._temporary()
            out.lines(
                f"{record} = {value}",
                f"if len({record}) != {len(children)}:",
                "    raise Unusual",
            )
            variables = [f'{record}["{field.name}"]' for _, field in children]
        else:
            raise NoEncoder("values of another shape")
        found: list[tuple[p.Scalar, str, str]] = []
        for (step, field), variable in zip(children, variables, strict=True):
            found += self._scalars(field.node, name if isinstance(step, int) else f"{name}_{step}", variable)
        return found

    def _temporary(self) -> str:
        self.temporaries += 1
        return self.names.new(f"t{self.temporaries}")

    def _number(self, pattern: IdPattern) -> str:
        parts = [f"{pattern.constant:#x}"]
        for capture in pattern.captures:
            # A device's number, again and again.
            to_raw = lru_cache(maxsize=256, typed=True)(partial(capture.to_raw, path=capture.name))
            called, _ = self.names.bind(f"capture_{self.plan.name}_{capture.name}", to_raw)
            raw = f'{called}(fields["{capture.name}"])'
            parts.append(f"({raw} << {capture.shift})" if capture.shift else raw)
        return " + ".join(parts)

    def _head(self) -> str:
        """Return the header and prefix; length and check are written by the framing."""
        message = self.message
        derived = message.framing.derived if message.framing is not None else frozenset[str | None]()
        parts = []
        for head in message.heads_written:
            if head in message.overlaid:
                continue
            if head.name in derived:
                parts.append(literal(bytes(head.size)))
            elif head.pattern is not None and not head.pattern.captures:
                parts.append(literal(head.bytes(head.pattern.constant)))
            else:
                called, _ = self.names.bind(f"head_{self.plan.name}_{head.name}", _head_writer(head))
                parts.append(f"{called}(fields)")
        return " + ".join(parts) if parts else "b''"

    def _body(self, scalars: list[tuple[p.Scalar, str, str]], start: int) -> str:
        # What a template says of bytes that the payload has, too, is seen when the packet is framed.
        first = max([start, *(head.offset + head.size for head in self.message.overlaid)])
        constants = {c.offset: c.value for c in self.plan.constants if c.offset >= first}
        size = self.plan.least - self.plan.tail
        tail = ""
        cells: list[_Packed] = []
        words: dict[tuple[int, int], list[str]] = {}
        shared: set[int] = set()
        for scalar, name, value in scalars:
            if scalar.size is None:
                if scalar.kind == "text":
                    raise NoEncoder("a text of open size")
                tail = f"bytes({value})" if scalar.kind == "bytes" else ""
                self.out.lines(
                    f"if not isinstance({value}, (bytes, bytearray)):",
                    "    raise Unusual",
                )
                self._tail_fits(value, scalar.offset)
                continue
            if scalar.kind == "text":
                raise NoEncoder("text")
            if scalar.kind == "bytes":
                cells.append(_Packed(scalar.offset, scalar.size, "", f"{scalar.size}s", value))
                self.out.lines(
                    f"if len({value}) != {scalar.size}:",
                    "    raise Unusual",
                )
                continue
            if not shared.isdisjoint(scalar.bits):
                raise NoEncoder("its fields share bits")
            shared.update(scalar.bits)
            if scalar.kind == "float" and scalar.bits:
                raise NoEncoder("a float that does not stand in whole bytes")
            number = self._raw(scalar, name, value)
            if scalar.format:
                order = "" if scalar.size == 1 else "<" if scalar.order == "little" else ">"
                cells.append(_Packed(scalar.offset, scalar.size, order, scalar.format, number))
                continue
            self._fits(scalar, number)
            first, last = min(scalar.bits) // 8, max(scalar.bits) // 8 + 1
            key = (first, last) if scalar.is_whole else (scalar.offset, scalar.offset + scalar.size)
            masked = number if scalar.kind == "uint" else f"({number} & {(1 << len(scalar.bits)) - 1:#x})"
            positions = [b - 8 * key[0] for b in scalar.bits]
            pieces = words.setdefault(key, [])
            for at, to, width in runs_of(positions):
                whole = width == len(scalar.bits)
                piece = (
                    masked
                    if whole
                    else f"({masked} >> {to} & {(1 << width) - 1:#x})"
                    if to
                    else f"({masked} & {(1 << width) - 1:#x})"
                )
                pieces.append(f"{piece} << {at}" if at else piece)
        return self._packed(cells, words, constants, start, size) + (f" + {tail}" if tail else "")

    def _tail_fits(self, value: str, offset: int) -> None:
        """Print the test that the tail fits the frame; a stream's packet is tested by its framing."""
        lengths = self.message.lengths
        if lengths is None:
            return
        ends = sorted(length - offset for length in lengths)
        if ends != list(range(ends[0], ends[-1] + 1)):
            test = f"len({value}) not in {literal(tuple(ends))}"
        elif ends[0] <= 0:
            test = f"len({value}) > {ends[-1]}"
        else:
            test = f"not {ends[0]} <= len({value}) <= {ends[-1]}"
        self.out.lines(
            f"if {test}:",
            "    raise Unusual",
        )

    def _fits(self, scalar: p.Scalar, number: str) -> None:
        width = len(scalar.bits)
        shifted = number if scalar.kind == "uint" else f"({number} + {1 << width - 1:#x})"
        self.out.lines(
            f"if {shifted} >> {width}:",
            "    raise Unusual",
        )

    def _packed(
        self,
        cells: list[_Packed],
        words: dict[tuple[int, int], list[str]],
        constants: dict[int, int],
        start: int,
        size: int,
    ) -> str:
        entries: list[tuple[int, int, str]] = []
        runs: list[list[_Packed]] = []
        for cell in sorted(cells, key=lambda c: c.offset):
            order = runs[-1][0].order if runs else ""
            if (
                runs
                and runs[-1][-1].end == cell.offset
                and (not cell.order or not order or cell.order == order)
            ):
                runs[-1].append(cell)
                if not order:
                    runs[-1][0] = replace(runs[-1][0], order=cell.order)
            else:
                runs.append([cell])
        for number, run in enumerate(runs):
            text = (run[0].order or "<") + "".join(c.format for c in run)
            helper = self._table(f"_pack_{self.plan.name}_{number}", f'Struct("{compact(text)}").pack')
            entries.append((run[0].offset, run[-1].end, f"{helper}({', '.join(c.value for c in run)})"))
        for (first, last), pieces in words.items():
            joined = " | ".join(f"({piece})" if "<<" in piece else piece for piece in pieces)
            entries.append((first, last, f'({joined}).to_bytes({last - first}, "little")'))
        for offset, value in sorted(constants.items()):
            entries.append((offset, offset + 1, literal(bytes([value]))))
        entries.sort()
        at = start
        for first, last, _ in entries:
            if first != at:
                raise NoEncoder("its fields do not lie side by side")
            at = last
        if at != size:
            raise NoEncoder("its fields do not fill it")
        return " + ".join(text for _, _, text in entries) or "b''"

    def _raw(self, scalar: p.Scalar, name: str, value: str) -> str:
        """Return a local name that holds the number for the wire (the signed one, of signed numbers)."""
        number = self._temporary()
        text = value
        steps = scalar.steps
        for step in reversed(steps):
            if isinstance(step, p.Scale):
                if step.names:
                    raise NoEncoder("a quantity with names")
                text = self._unscaled(step, text, scalar, name)
            elif isinstance(step, p.ValueNames):
                table = self._bound(f"_numbers_{self.plan.name}_{name}", {v: k for k, v in step.values})
                text = f"{table}.get({text}, {text})"
            elif isinstance(step, p.ScaleByBit):
                text = self._of_two(step, text, name)
            elif isinstance(step, p.FlagBits):
                variable = self._temporary()
                flags = self._bound(f"_flags_{self.plan.name}_{name}", _flags_of(step), dict(step.bits))
                self.out.lines(
                    f"{variable} = {text}",
                    f"if not isinstance({variable}, int):",
                    f"    {variable} = {flags}({variable})",
                )
                text = f"int({variable})"
        self.out.line(f"{number} = {text}")
        if scalar.is_magnitude and scalar.raw_range is not None:
            low, high = scalar.raw_range
            self.out.lines(
                f"if {number}.__class__ is not int or not {low} <= {number} <= {high}:",
                "    raise Unusual",
                f"if {number} < 0:",
                f"    {number} = {high + 1:#x} - {number}",
            )
        elif scalar.kind != "float" and not scalar.format:
            self.out.lines(
                f"if {number}.__class__ is not int:",
                "    raise Unusual",
            )
        return number

    def _of_two(self, step: p.ScaleByBit, text: str, name: str) -> str:
        """Return a local name that holds the raw number of a quantity of two scales."""
        given, raw = self._temporary(), self._temporary()
        scales = tuple((scale.scale, scale.offset) for scale in step.scales)
        bound = self._bound(f"_scales_{self.plan.name}_{name}", scales)
        self.out.lines(
            f"{given} = {text}",
            f"if {given}.__class__ is not float and {given}.__class__ is not int or {given} - {given}:",
            "    raise Unusual",
            f"{raw} = {self._bound('_raw_of_two', raw_of_two, 'raw_of_two')}({given}, {step.half:#x}, {bound})",
            f"if {raw} is None:",
            "    raise Unusual",
        )
        return raw

    def _unscaled(self, step: p.Scale, text: str, scalar: p.Scalar, name: str) -> str:
        out = self.out
        where = f"{self.plan.name}_{name}"
        is_float = scalar.kind == "float"
        if len(scalar.bits) > 53 and (step.scale != 1 or step.offset):
            raise NoEncoder("a scaled number of more bits than a float has")
        given = self._temporary()
        out.lines(
            f"{given} = {text}",
            f"if {given}.__class__ is not float and {given}.__class__ is not int:",
            "    raise Unusual",
        )
        if is_float and step.unknown:
            raise NoEncoder("a float that may mean unknown")
        if step.bounds is not None:
            test = self._outside(step.bounds, given, where)
            if test:
                out.lines(
                    f"if {test}:",
                    "    raise Unusual",
                )
        if step.scale == 1 and not step.offset:
            number = given
        else:
            offset = self._spec_number(f"_offset_{where}", step.offset)
            scale = self._spec_number(f"_scale_{where}", step.scale)
            number = f"({given} - {offset}) / {scale}" if step.offset else f"{given} / {scale}"
        if not is_float:
            if step.rounding == "nearest":
                number = f"round({number})"
            else:
                ratio = self._spec_number(f"_ratio_{where}", step.offset / step.scale)
                number = f"{self._bound('_truncated', truncated, 'truncated')}({number}, {ratio})"
        # Raw numbers that mean unknown; others are never those of an integer.
        unknown = step.unknown
        means: Sequence[int] = (
            unknown
            if isinstance(unknown, range)
            else sorted({int(value) for value in unknown if math.isfinite(value) and value == int(value)})
        )
        if not means and step.raw_bounds is None:
            return number
        raw = self._temporary()
        out.line(f"{raw} = {number}")
        tests = []
        if isinstance(means, range):
            tests.append(f"{raw} in {self._bound(f'_unknown_{where}', means)}")
        elif means:
            tests.append(f"{raw} in {literal(tuple(means))}" if len(means) > 1 else f"{raw} == {means[0]}")
        tests += (
            [test]
            if step.raw_bounds is not None and (test := self._outside(step.raw_bounds, raw, f"raw_{where}"))
            else []
        )
        if tests:
            out.lines(
                f"if {' or '.join(tests)}:",
                "    raise Unusual",
            )
        return raw

    def _outside(self, bounds: tuple[float, float], name: str, where: str) -> str:
        """Return the test whether a number is outside its bounds, those that are infinite left out; empty when both are."""
        low, high = bounds
        first = f"{self._spec_number(f'_least_{where}', low)} <= " if math.isfinite(low) else ""
        last = f" <= {self._spec_number(f'_most_{where}', high)}" if math.isfinite(high) else ""
        return f"not {first}{name}{last}" if first or last else ""


@cache
def _flags_of(step: p.FlagBits) -> Callable[[Collection[str]], int]:
    """Return what makes a number of the names of flags; it raises for other values."""
    bits = dict(step.bits)

    def flags(names: Collection[str]) -> int:
        if isinstance(names, str):
            raise TypeError(names)
        return sum(1 << bits[name] for name in {*names})

    return flags


def _head_writer(head: Head) -> Callable[[dict[str, object]], bytes]:
    """Return the bytes of a head field that is not constant, from a message's fields."""
    name = head.name
    assert name is not None
    if head.pattern is not None and not head.is_own:
        pattern = head.pattern

        def captured(fields: dict[str, object]) -> bytes:
            numbers = {c.name: c.to_raw(fields[c.name], c.name) for c in pattern.captures}
            return head.bytes(pattern.number(numbers))

        return captured

    @lru_cache(maxsize=64, typed=True)  # an opcode or a mode: few values, again and again
    def written(value: object) -> bytes:
        data = bytes(head.field.build(value))
        if head.pattern is not None and head.pattern.match(head.number(bytes(head.offset) + data)) is None:
            raise ValueError(name)
        return data

    return lambda fields: written(fields[name])
