"""A variant as C99: a header and a source with a struct, `unpack` and `pack` for each message, without allocation.

1. A struct has raw numbers, as `raw=True` decodes them; `…_decode` gives a quantity in its unit, `…_encode` the raw number.
2. `unpack` takes what the scanner takes of this message: identifier, length, constants, length field, check. A message that
   needs its request, or that C cannot say simply (items, transports, stuffing …), is left out, and is a `Loss`.
3. What `pack` writes is what construct builds. It refuses a raw number that has no room, and never cuts one.
4. Positions are read bit by bit from the plan, so that byte order and alignment of the machine mean nothing.

    int hubo_encoder_unpack(struct hubo_encoder *to, uint32_t id, const uint8_t *data, size_t size);
    int hubo_encoder_pack(uint8_t *data, size_t size, uint32_t *id, const struct hubo_encoder *from);

Of streams both take a whole packet, and no `id`; finding packets in bytes is the caller's.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import dataclass, field

from aces_bus.protocol import IdField, Message, Variant
from aces_bus.protocol.declare.bits import whole_bits
from aces_bus.protocol.declare.fields import ROUNDING_ERROR
from aces_bus.protocol.declare.head import Head
from aces_bus.protocol.exchange.names import PythonNames
from aces_bus.protocol.exchange.problems import Loss
from aces_bus.protocol.plan import nodes as p

from .c_checks import CheckPrinter
from .c_fields import (
    CField,
    c_type,
    captured,
    held_bits,
    place_of,
    put_in,
    rest_mask,
    shifted,
    taken_out,
    under_conditions,
)
from .c_language import (
    LISTED,
    NotInC,
    c_float,
    c_hex,
    c_name,
    comment,
    is_among,
    outside,
    refuse_if,
    terms_of,
    written,
)

#: Bits of integers that a double holds.
EXACT_BITS = 53


@dataclass(frozen=True)
class CMessage:
    """A message that C has: `name` is that of its struct and functions, without `_unpack` and `_pack`."""

    name: str
    message: Message
    fields: tuple[CField, ...]


@dataclass
class CSource:
    """What is printed, and what it does not say."""

    header: str
    source: str
    messages: list[CMessage]
    losses: list[Loss] = field(default_factory=list)


def print_c_source(variant: Variant, *, only: Collection[str] = (), name: str = "") -> CSource:
    """Return the header and source of a variant; `only` names the messages wanted, `name` is that of the header
    without `.h`.
    """
    return _Printer(variant, only).print(name or PythonNames.snake(variant.name))


class _Printer:
    def __init__(self, variant: Variant, only: Collection[str]) -> None:
        self.variant = variant
        self.losses: list[Loss] = []
        self.prefix = c_name(variant.name, set())
        self.wanted = [m for m in variant.messages.values() if not only or m.name in only]
        self.header: list[str] = []
        self.source: list[str] = []
        self.helpers: dict[str, list[str]] = {}
        self.taken: set[str] = set()
        self.macros: set[str] = set()

    def print(self, name: str) -> CSource:
        made: list[CMessage] = []
        for message in self.wanted:
            try:
                made.append(_MessagePrinter(self, message).print())
            except NotInC as why:
                self.losses.append(Loss(message.name, "", f"{why}: left out"))
        guard = re.sub(r"\W", "_", f"{name}_h".upper(), flags=re.ASCII)
        title = comment(f"{self.variant.label} in C, printed by aces-bus from the spec: change that instead.")
        lost = [f" *   {comment(str(loss))}" for loss in self.losses]
        lost = [" *", " * Not as the scanner has it:", *lost] if lost else []
        header = [
            f"/* {title}",
            " * `unpack` gives 0, or -1 for what is not the message; `pack` the number of bytes, or -1 for a number that",
            " * does not fit. `decode` is the quantity in its unit, NAN where unknown; `encode` 0, or -1 for what cannot be",
            " * sent. Fields of a selector are there for its values alone, else 0.",
            *lost,
            " */",
            f"#ifndef {guard}",
            f"#define {guard}",
            "",
            "#include <stddef.h>",
            "#include <stdint.h>",
            "",
            "#ifdef __cplusplus",
            'extern "C" {',
            "#endif",
            *self.header,
            "",
            "#ifdef __cplusplus",
            "}",
            "#endif",
            "",
            f"#endif /* {guard} */",
            "",
        ]
        source = [
            f"/* {title} Needs the mathematical library (-lm). */",
            f'#include "{name}.h"',
            "",
            "#include <math.h>",
            "#include <string.h>",
            *(line for lines in self.helpers.values() for line in ["", *lines]),
            *self.source,
            "",
        ]
        return CSource("\n".join(header), "\n".join(source), made, self.losses)

    def lose(self, message: str, name: str, reason: str) -> None:
        self.losses.append(Loss(message, name, reason))


def _refusal(message: Message) -> str:
    """Say why C does not have a message; empty if it has."""
    plan, framing = message.plan, message.framing
    if message.transport is not None:
        return f"carried by {message.transport.title}, in several frames"
    affine = framing.affine if framing is not None else None
    reasons = {
        "a remote frame": message.remote,
        plan.opaque: plan.opaque,
        "delimited text": plan.split is not None,
        "a list of items": plan.lists,
        "shows fields of its request": plan.needs_request,
        "a check inside its payload": plan.is_checked or message.check is not None,
        "its length depends on its values": plan.lengths_by is not None,
        "its fields share bits": getattr(message.payload, "overlapping", False),
        "its packets are stuffed": framing is not None and framing.stuffing is not None,
        "a payload that begins in its header": bool(message.overlaid),
        "a check in its header": framing is not None and framing.check_head is not None,
        "a check over its request": framing is not None and framing.covers_request,
        "a check behind its end": framing is not None and framing.check_behind,
        "packets of a multiple of bytes": framing is not None and framing.multiple > 1,
        "two marks that may close its packets": framing is not None and framing.short_end,
        "its packets have a trailer": framing is not None and framing.trailer is not None,
        "an escaped length": affine is not None and (affine.escape is not None or affine.flags is not None),
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


class _MessagePrinter:
    """One message. Raises `NotInC`, and leaves nothing of it, where C cannot say it."""

    def __init__(self, printer: _Printer, message: Message) -> None:
        self.printer, self.message, self.plan = printer, message, message.plan
        if refusal := _refusal(message):
            raise NotInC(refusal)
        check = message.framing.check if message.framing is not None else None
        self.check = (
            CheckPrinter(message, check, printer.prefix, printer.helpers) if check is not None else None
        )
        self.name = c_name(f"{printer.prefix}_{message.name}", printer.taken)
        self.macro = self.name.upper()
        self.members: set[str] = set()
        self.fields: list[CField] = []
        self.header: list[str] = []
        self.declared: list[str] = []
        self.functions: list[str] = []

    # ------------------------------------------------------------------ what there is

    def print(self) -> CMessage:
        message, plan = self.message, self.plan
        leaves = [leaf for leaf in plan.leaves if self._is_said(leaf)]
        for leaf in leaves:
            self._field(leaf)
        unpack, pack = self._unpack(), self._pack()
        lines = ["", f"/* {': '.join(filter(None, (message.name, comment(plan.doc))))} */"]
        if message.framing is None:
            lines.append(f"#define {self.macro}_ID {c_hex(message.identifier.constant)}")
            lines.append(f"#define {self.macro}_IS_EXTENDED {int(message.extended)}")
            lines.append(f"#define {self.macro}_IS_FD {int(message.fd)}")
        if plan.lengths is not None:
            lines.append(f"#define {self.macro}_LENGTH {max(plan.lengths)}")
        lines += [*self.header, "", f"struct {self.name} {{", *self.declared]
        if not self.declared:
            lines.append("    uint8_t unused; /* it has no fields */")
        lines += ["};", "", *(f"{line};" for line in (unpack[0], pack[0]))]
        for function in self.functions:
            if function.startswith(("double ", "int ")):
                lines.append(f"{function.partition('{')[0].strip()};")
        self.printer.header += lines
        self.printer.source += ["", *unpack, "", *pack]
        for function in self.functions:
            self.printer.source += ["", *function.split("\n")]
        return CMessage(self.name, message, tuple(self.fields))

    def _is_said(self, leaf: p.NodePath) -> bool:
        node = leaf.node
        if isinstance(node, p.Rest):
            if node.selector is not None or node.more or node.size > 8:
                self.printer.lose(
                    self.message.name, leaf.path, "bits without a field: not kept, written as 0"
                )
                return False
            return bool(rest_mask(node))
        if isinstance(node, p.FromIdentifier):
            return True
        if not isinstance(node, p.Scalar):
            raise NotInC(f"a {type(node).__name__}")
        if len(node.bits) > 64:
            raise NotInC(f"a number of {len(node.bits)} bits")
        if node.kind == "float" and len(node.place) not in (32, 64):
            raise NotInC("a float of 16 bits")
        return True

    def _field(self, leaf: p.NodePath) -> None:
        node = leaf.node
        name = c_name(leaf.identifier, self.members)
        unit = node.unit
        if node.by_bit is not None:
            unit = ""
            self.printer.lose(
                self.message.name, leaf.path, "two scales, of which its highest bit chooses: kept as raw"
            )
        said = comment(", ".join(filter(None, (unit and f"[{unit}]", leaf.doc))))
        said = f" /* {said} */" if said else ""
        type_ = c_type(node)
        if type_ == "rest":
            self.declared += [f"    const uint8_t *{name};{said}", f"    size_t {name}_size;"]
            self.members.add(f"{name}_size")
        elif type_ == "bytes":
            assert isinstance(node, p.Scalar)
            self.declared.append(f"    uint8_t {name}[{node.size}];{said}")
        else:
            self.declared.append(f"    {type_} {name};{said}")
        scale = node.scale
        is_number = type_ not in ("rest", "bytes")
        decodes = is_number and scale is not None
        encodes = decodes and (type_ in ("float", "double") or len(place_of(node)) <= EXACT_BITS)
        made = CField(name, type_, leaf, decodes, encodes)
        self.fields.append(made)
        named = [(label, f"({int(number)})") for number, label in node.value_names.items()]
        named += [(label, c_hex(1 << bit)) for label, bit in node.flags.items()]
        for label, number in named if is_number else ():
            macro = c_name(f"{self.macro}_{name}_{label}".lower(), self.printer.macros).upper()
            self.header.append(f"#define {macro} {number}")
        if scale is not None and decodes:
            self._quantity(made, scale, encodes)

    def _quantity(self, made: CField, scale: p.Scale, encodes: bool) -> None:
        factor, offset = float(scale.scale), float(scale.offset)
        is_float = made.type in ("float", "double")
        unknown = [
            f"raw == {c_float(low)}" if low == high else f"(raw >= {c_float(low)} && raw <= {c_float(high)})"
            for low, high in scale.unknown_runs
            if not math.isnan(low)
        ]
        if any(math.isnan(low) for low, _ in scale.unknown_runs):
            unknown.append("raw != raw")
        if len(unknown) > LISTED:
            raise NotInC("a quantity with many unknown values")
        name = f"{self.name}_{made.name}"
        value = "raw" if factor == 1 else f"raw * {factor!r}"
        value = f"{value} + {offset!r}" if offset else value
        lines = [
            f"double {name}_decode({made.type} number)",
            "{",
            "    const double raw = (double)number;",
            "",
        ]
        if unknown:
            lines += [f"    if ({' || '.join(unknown)}) {{", "        return NAN;", "    }"]
        self.functions.append("\n".join([*lines, f"    return {value};", "}"]))
        if not encodes:
            self.printer.lose(
                self.message.name, made.leaf.path, "more bits than a double has: without …_encode"
            )
            return
        raw = "value" if factor == 1 else f"value / {factor!r}"
        if offset:
            raw = f"value - {offset!r}" if factor == 1 else f"(value - {offset!r}) / {factor!r}"
        tests: list[str] = []
        if scale.bounds is not None:
            tests += outside("value", scale.bounds)
        lines = [f"int {name}_encode({made.type} *number, double value)", "{"]
        if is_float:
            lines += [f"    const double raw = {raw};", ""]
            tests += [test for test in ("raw != raw", *unknown) if test not in tests]
        else:
            if scale.rounding == "nearest":
                lines += [f"    const double raw = nearbyint({raw});", ""]
            else:
                slack = f"{ROUNDING_ERROR!r} * (fabs(exact) + {abs(offset / factor)!r})"
                lines += [
                    f"    const double exact = {raw}, near = nearbyint(exact);",
                    f"    const double raw = fabs(exact - near) <= {slack} ? near : trunc(exact);",
                    "",
                ]
            limits = made.leaf.node.raw_range or (0, 0)
            tests += outside("raw", limits)
            if scale.raw_bounds is not None and scale.raw_bounds != limits:
                tests += outside("raw", scale.raw_bounds)
            tests += unknown
        if tests:
            lines += refuse_if(f"{' || '.join(tests)}")
        self.functions.append("\n".join([*lines, f"    *number = ({made.type})raw;", "    return 0;", "}"]))

    # ------------------------------------------------------------------ unpack

    def _unpack(self) -> list[str]:
        plan, message = self.plan, self.message
        is_can = message.framing is None
        arguments = (
            f"struct {self.name} *to, {'uint32_t id, ' if is_can else ''}const uint8_t *data, size_t size"
        )
        tests = self._size_tests()
        for fixed in plan.constants:
            cell = f"data[{fixed.offset}]"
            cell = cell if fixed.mask == 0xFF else f"({cell} & {fixed.mask:#04x})"
            tests.append(f"{cell} != {fixed.value:#04x}")
        end = message.framing.end if message.framing is not None else b""
        tests += [f"data[size - {len(end) - k}u] != {byte:#04x}" for k, byte in enumerate(end)]
        tests += self._one_of()
        body = [f"int {self.name}_unpack({arguments})", "{"]
        checks = self._identifier_tests() if is_can else []
        for test in [*checks, *tests]:
            body += refuse_if(test)
        body += self._length_test() + (self.check.test() if self.check is not None else [])
        body.append("    memset(to, 0, sizeof *to);")
        for member in self.fields:
            body += under_conditions(member.leaf, self._get(member))
        if not any("data[" in line or "data +" in line for line in body):
            body.append("    (void)data;")
        return [*body, "    return 0;", "}"]

    def _one_of(self) -> list[str]:
        """Return tests of numbers that must be among some values."""
        numbers = [(choice.number.place, choice.values) for choice in self.plan.one_of]
        tests = [is_among(f"({terms_of(bits)})", values, (1 << len(bits)) - 1) for bits, values in numbers]
        return [f"!({test})" for test in tests if test]

    def _size_tests(self) -> list[str]:
        plan = self.plan
        if plan.lengths is None:
            return [f"size < {max(plan.least, plan.framed)}u"] if max(plan.least, plan.framed) else []
        if len(plan.lengths) == 1:
            return [f"size != {plan.lengths[0]}u"]
        return [f"!({is_among('size', plan.lengths)})"]

    def _identifier_tests(self) -> list[str]:
        pattern = self.message.identifier
        if not pattern.captures:
            return [f"id != {self.macro}_ID"]
        tests: list[str] = []
        if len(pattern.captures) == 1:
            (capture,) = pattern.captures
            if pattern.constant:
                tests.append(f"id < {self.macro}_ID")
            rest = f"(id - {self.macro}_ID)"
            if capture.shift:
                tests.append(f"({rest} & {c_hex((1 << capture.shift) - 1)}) != 0")
                rest = f"({rest} >> {capture.shift})"
            return [*tests, f"!({is_among(rest, capture.values)})"]
        mask = 0
        for capture in pattern.captures:
            mask |= ((1 << capture.width) - 1) << capture.shift
            tests.append(f"!({is_among(captured(capture), capture.values)})")
        return [f"(id & {c_hex(~mask & 0xFFFF_FFFF)}) != {self.macro}_ID", *tests]

    def _length_test(self) -> list[str]:
        framing = self.message.framing
        if framing is None or framing.affine is None:
            return []
        affine = framing.affine
        number = terms_of(_head_bits(affine.length))
        factor = f" * {affine.factor}u" if affine.factor != 1 else ""
        return refuse_if(f"({number}){factor} + {affine.constant}u != size")

    def _get(self, member: CField) -> list[str]:
        node, target = member.leaf.node, f"to->{member.name}"
        if isinstance(node, p.Rest):
            mask = rest_mask(node)
            terms = terms_of(whole_bits(node.offset, node.size, "little"))
            return [f"{target} = ({member.type})(({terms}) & {c_hex(mask)});"]
        if member.type == "rest":
            assert isinstance(node, p.Scalar)
            tail = node.offset + self.plan.tail
            return [f"{target} = data + {node.offset};", f"{target}_size = size - {tail}u;"]
        if member.type == "bytes":
            assert isinstance(node, p.Scalar)
            return [f"memcpy({target}, data + {node.offset}, {node.size});"]
        if isinstance(node, p.FromIdentifier) and node.number is None:
            capture = self._capture(member)
            if len(self.message.identifier.captures) == 1:
                shift = f" >> {capture.shift}" if capture.shift else ""
                return [f"{target} = ({member.type})((id - {self.macro}_ID){shift});"]
            return [f"{target} = ({member.type})({captured(capture)});"]
        if isinstance(node, p.FromIdentifier) and node.number is not None and node.is_alone and node.constant:
            shift = f" >> {node.shift}" if node.shift else ""
            return [
                f"{target} = ({member.type})((({terms_of(node.number.place)}) - {node.constant}u){shift});"
            ]
        return taken_out(member)

    def _capture(self, member: CField) -> IdField:
        found = next((c for c in self.message.identifier.captures if c.name == member.leaf.path), None)
        if found is None:
            raise NotInC(f"{member.leaf.path}: a part of the identifier with another name")
        return found

    # ------------------------------------------------------------------ pack

    def _pack(self) -> list[str]:
        plan, message = self.plan, self.message
        is_can = message.framing is None
        arguments = (
            f"uint8_t *data, size_t size, {'uint32_t *id, ' if is_can else ''}const struct {self.name} *from"
        )
        rest = next((member for member in self.fields if member.type == "rest"), None)
        body = [f"int {self.name}_pack({arguments})", "{"]
        length = f"{plan.least}u" + (f" + from->{rest.name}_size" if rest is not None else "")
        if rest is None and plan.lengths is not None and len(plan.lengths) > 1:
            length = f"{max(plan.lengths)}u"
        body += [f"    const size_t length = {length};", ""]
        if rest is not None:
            allowed = plan.lengths
            if allowed is not None:
                body += refuse_if(f"!({is_among('length', allowed)})")
            elif message.framing is not None:
                body += refuse_if(f"length > {message.framing.max_size}u")
        body += [*refuse_if("size < length"), "    memset(data, 0, length);"]
        body += [f"    data[{fixed.offset}] |= {fixed.value:#04x};" for fixed in plan.constants]
        for member in sorted(self.fields, key=lambda member: len(member.leaf.whens)):
            body += under_conditions(member.leaf, put_in(member))
        numbers = self._numbers()
        for number, parts in numbers.items():
            for member, node in parts:
                capture = None if number is not None else self._capture(member)
                values = range(1 << node.width) if capture is None else capture.values
                if test := is_among(f"(uint32_t)from->{member.name}", values, (1 << held_bits(member)) - 1):
                    body += refuse_if(f"!({test})")
            if number is not None:
                whole = [c_hex(parts[0][1].constant), *(shifted(member, node) for member, node in parts)]
                body += ["    {", f"        const uint32_t raw = {' + '.join(whole)};", ""]
                body += [*(f"        {line}" for line in written(number.place)), "    }"]
        for test in self._one_of():
            body += refuse_if(test)
        if is_can:
            whole = [f"{self.macro}_ID", *(shifted(member, node) for member, node in numbers.get(None, ()))]
            body.append(f"    *id = {' + '.join(whole)};")
        else:
            body += self._finish()
        if not self.fields:
            body.append("    (void)from;")
        return [*body, "    return (int)length;", "}"]

    def _numbers(self) -> dict[p.Scalar | None, list[tuple[CField, p.FromIdentifier]]]:
        """Return the members that are parts of a number of the head, or of the identifier (None)."""
        found: dict[p.Scalar | None, list[tuple[CField, p.FromIdentifier]]] = {}
        for member in self.fields:
            if isinstance(member.leaf.node, p.FromIdentifier):
                found.setdefault(member.leaf.node.number, []).append((member, member.leaf.node))
        return found

    def _finish(self) -> list[str]:
        """Return the length field, the end and the check of a packet."""
        framing = self.message.framing
        assert framing is not None
        body: list[str] = []
        if framing.affine is not None:
            affine = framing.affine
            factor = f" / {affine.factor}u" if affine.factor != 1 else ""
            bits = _head_bits(affine.length)
            body += [
                "    {",
                f"        const uint32_t raw = (uint32_t)((length - {affine.constant}u){factor});",
                "",
            ]
            if affine.factor != 1:
                body += refuse_if(f"raw * {affine.factor}u + {affine.constant}u != length", 2)
            if len(bits) < 32:
                body += refuse_if(f"raw > {c_hex((1 << len(bits)) - 1)}", 2)
            body += [*(f"        {line}" for line in written(bits)), "    }"]
        for back, byte in zip(range(len(framing.end), 0, -1), framing.end, strict=True):
            body.append(f"    data[length - {back}u] = {byte:#04x};")
        return body + (self.check.fill() if self.check is not None else [])


def _head_bits(head: Head) -> tuple[int, ...]:
    return whole_bits(head.offset, head.size, head.order)
