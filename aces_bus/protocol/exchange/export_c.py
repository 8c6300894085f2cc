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
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

from ..declare.bits import whole_bits
from ..declare.checks import Check, Crc, Extra, IdBytes, Sum
from ..declare.head import Head
from ..declare.message import Message
from ..declare.pattern import IdField
from ..declare.protocol import Variant
from ..plan import nodes as p
from .dissector_tables import bit_pieces
from .names import snake
from .problems import Loss, one_line

#: Values that a test lists one by one.
LISTED = 64
#: Bits of integers that a double holds.
EXACT_BITS = 53
_WORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register restrict
return short signed sizeof static struct switch typedef union unsigned void volatile while bool true false asm typeof
alignas alignof and bitand bitor class compl delete explicit export friend mutable namespace new not operator or private
protected public template this throw try using virtual xor
"""
#: What C and C++ keep for themselves, and the headers that are included.
KEYWORDS = frozenset(_WORDS.split())


@dataclass(frozen=True)
class CField:
    """A member of a struct: its C name and type ("bytes" and "rest" for a pointer with a size), and where it comes from."""

    name: str
    type: str
    leaf: p.NodePath
    #: Whether there are `…_decode` and `…_encode`.
    can_decode: bool = False
    can_encode: bool = False


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
    """The header and source of a variant; `only` names the messages wanted, `name` is that of the header without `.h`."""
    return _Printer(variant, only).print(name or snake(variant.name))


class _Refused(Exception):
    """C does not say this message; the argument is why."""


def _c_name(text: str, taken: set[str]) -> str:
    made = snake(text)
    made = f"n{made}" if made[:1].isdigit() or not made.strip("_") else made
    while made in taken or made in KEYWORDS:
        made += "_"
    taken.add(made)
    return made


def _unsigned(width: int) -> int:
    """Bits of the C integer that holds so many."""
    return next(size for size in (8, 16, 32, 64) if size >= width)


def _hex(number: int, wide: bool) -> str:
    return f"{number:#x}{'ull' if wide else 'u'}"


def _among(name: str, values: Collection[int], most: int | None = None) -> str:
    """The test that an unsigned number is one of these; empty where they are all up to `most`."""
    runs: list[list[int]] = []
    for value in sorted(values):
        if runs and value == runs[-1][1] + 1:
            runs[-1][1] = value
        else:
            runs.append([value, value])
    if len(runs) > LISTED:
        raise _Refused(f"a number among {len(values)} values")
    tests: list[str] = []
    for low, high in runs:
        parts = [f"{name} >= {low}u"] if low else []
        parts += [f"{name} <= {high}u"] if high != most else []
        tests.append(f"{name} == {low}u" if low == high else " && ".join(parts))
    return (
        tests[0] if len(tests) == 1 else " || ".join(f"({test})" if "&&" in test else test for test in tests)
    )


class _Printer:
    def __init__(self, variant: Variant, only: Collection[str]) -> None:
        self.variant = variant
        self.losses: list[Loss] = []
        self.prefix = _c_name(variant.name, set())
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
            except _Refused as why:
                self.losses.append(Loss(message.name, "", f"{why}: left out"))
        guard = re.sub(r"\W", "_", f"{name}_h".upper(), flags=re.ASCII)
        title = one_line(
            f"{self.variant.label} in C, printed by aces-bus from the spec: change that instead."
        )
        title = title.replace("*/", "* /")
        lost = [f" *   {one_line(str(loss)).replace('*/', '* /')}" for loss in self.losses]
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


class _MessagePrinter:
    """One message. Raises `_Refused`, and leaves nothing of it, where C cannot say it."""

    def __init__(self, printer: _Printer, message: Message) -> None:
        self.printer, self.message, self.plan = printer, message, message.plan
        self.check: Check | None = None
        self._refuse()
        self.name = _c_name(f"{printer.prefix}_{message.name}", printer.taken)
        self.macro = self.name.upper()
        self.members: set[str] = set()
        self.fields: list[CField] = []
        self.header: list[str] = []
        self.declared: list[str] = []
        self.functions: list[str] = []

    def _refuse(self) -> None:
        message, plan = self.message, self.plan
        framing = message.framing
        if message.transport is not None:
            raise _Refused(f"carried by {message.transport.title}, in several frames")
        if message.remote:
            raise _Refused("a remote frame")
        if plan.opaque:
            raise _Refused(plan.opaque)
        if plan.split is not None:
            raise _Refused("delimited text")
        if plan.lists:
            raise _Refused("a list of items")
        if any(isinstance(one.node, p.FromRequest) for one in plan.fields):
            raise _Refused("shows fields of its request")
        if plan.is_checked or message.check is not None:
            raise _Refused("a check inside its payload")
        if plan.lengths_by is not None:
            raise _Refused("its length depends on its values")
        if getattr(message.payload, "overlapping", False):
            raise _Refused("its fields share bits")
        if framing is None:
            return
        if framing.stuffing is not None:
            raise _Refused("its packets are stuffed")
        if framing.trailer is not None:
            raise _Refused("its packets have a trailer")
        affine = framing.affine
        if affine is not None and (affine.escape is not None or affine.flags is not None):
            raise _Refused("an escaped length")
        self.check = framing.check

    # ------------------------------------------------------------------ what there is

    def print(self) -> CMessage:
        message, plan = self.message, self.plan
        leaves = [leaf for leaf in plan.leaves if self._is_said(leaf)]
        for leaf in leaves:
            self._field(leaf)
        unpack, pack = self._unpack(), self._pack()
        doc = one_line(plan.doc).replace("*/", "* /")
        lines = ["", f"/* {message.name}{': ' + doc if doc else ''} */"]
        if message.framing is None:
            lines.append(f"#define {self.macro}_ID {_hex(message.identifier.constant, False)}")
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
            return bool(_rest_mask(node))
        if isinstance(node, p.FromIdentifier):
            return True
        if not isinstance(node, p.Scalar):
            raise _Refused(f"a {type(node).__name__}")
        if len(node.bits) > 64:
            raise _Refused(f"a number of {len(node.bits)} bits")
        if node.kind == "float" and len(node.place) not in (32, 64):
            raise _Refused("a float of 16 bits")
        return True

    def _field(self, leaf: p.NodePath) -> None:
        node = leaf.node
        name = _c_name(leaf.identifier, self.members)
        comment = ", ".join(filter(None, (node.unit and f"[{node.unit}]", one_line(leaf.doc))))
        comment = f" /* {comment.replace('*/', '* /')} */" if comment else ""
        type_ = self._type(node)
        if type_ == "rest":
            self.declared.append(f"    const uint8_t *{name};{comment}")
            self.declared.append(f"    size_t {name}_size;")
            self.members.add(f"{name}_size")
        elif type_ == "bytes":
            assert isinstance(node, p.Scalar)
            self.declared.append(f"    uint8_t {name}[{node.size}];{comment}")
        else:
            self.declared.append(f"    {type_} {name};{comment}")
        scale = node.scale
        is_number = type_ not in ("rest", "bytes")
        decodes = is_number and scale is not None
        encodes = decodes and (type_ in ("float", "double") or len(_place(node)) <= EXACT_BITS)
        made = CField(name, type_, leaf, decodes, encodes)
        self.fields.append(made)
        for number, label in node.value_names.items() if is_number else ():
            macro = _c_name(f"{self.macro}_{name}_{label}".lower(), self.printer.macros).upper()
            self.header.append(f"#define {macro} ({int(number)})")
        for label, bit in node.flags.items() if is_number else ():
            macro = _c_name(f"{self.macro}_{name}_{label}".lower(), self.printer.macros).upper()
            self.header.append(f"#define {macro} {_hex(1 << bit, bit > 31)}")
        if scale is not None and decodes:
            self._quantity(made, scale, encodes)

    def _type(self, node: p.Node) -> str:
        if isinstance(node, p.Scalar) and node.is_bytes:
            if node.size == 0:
                raise _Refused("bytes of no size")
            return "rest" if node.size is None else "bytes"
        if isinstance(node, p.Rest):
            return f"uint{_unsigned(8 * node.size)}_t"
        if isinstance(node, p.Scalar) and node.kind == "float":
            return "float" if len(node.place) == 32 else "double"
        low, high = node.raw_range or (0, 0)
        if low < 0:
            return f"int{_unsigned(max(high.bit_length(), (-low - 1).bit_length()) + 1)}_t"
        return f"uint{_unsigned(max(1, high.bit_length()))}_t"

    def _quantity(self, made: CField, scale: p.Scale, encodes: bool) -> None:
        factor, offset = float(scale.scale), float(scale.offset)
        is_float = made.type in ("float", "double")
        unknown = [
            f"raw == {_c_float(low)}"
            if low == high
            else f"(raw >= {_c_float(low)} && raw <= {_c_float(high)})"
            for low, high in scale.unknown_runs
            if not math.isnan(low)
        ]
        if any(math.isnan(low) for low, _ in scale.unknown_runs):
            unknown.append("raw != raw")
        if len(unknown) > LISTED:
            raise _Refused("a quantity with many unknown values")
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
            tests += _outside("value", scale.bounds)
        lines = [f"int {name}_encode({made.type} *number, double value)", "{"]
        if is_float:
            lines += [f"    const double raw = {raw};", ""]
            tests += [test for test in ("raw != raw", *unknown) if test not in tests]
        else:
            rounding = "nearbyint" if scale.rounding == "nearest" else "trunc"
            lines += [f"    const double raw = {rounding}({raw});", ""]
            limits = made.leaf.node.raw_range or (0, 0)
            tests += _outside("raw", limits)
            if scale.raw_bounds is not None and scale.raw_bounds != limits:
                tests += _outside("raw", scale.raw_bounds)
            tests += unknown
        if tests:
            lines += _refuse_if(f"{' || '.join(tests)}")
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
            body += _refuse_if(test)
        body += self._length_test() + self._check_test()
        body.append("    memset(to, 0, sizeof *to);")
        for one in self.fields:
            body += _when(one.leaf, self._get(one))
        if not any("data[" in line or "data +" in line for line in body):
            body.append("    (void)data;")
        return [*body, "    return 0;", "}"]

    def _one_of(self) -> list[str]:
        """Tests of numbers that must be among some values."""
        numbers = [(one.number.place, one.values) for one in self.plan.one_of]
        tests = [_among(f"({_terms(bits)})", values, (1 << len(bits)) - 1) for bits, values in numbers]
        return [f"!({test})" for test in tests if test]

    def _size_tests(self) -> list[str]:
        plan = self.plan
        if plan.lengths is None:
            return [f"size < {max(plan.least, plan.framed)}u"] if max(plan.least, plan.framed) else []
        if len(plan.lengths) == 1:
            return [f"size != {plan.lengths[0]}u"]
        return [f"!({_among('size', plan.lengths)})"]

    def _identifier_tests(self) -> list[str]:
        pattern = self.message.identifier
        if not pattern.captures:
            return [f"id != {self.macro}_ID"]
        tests: list[str] = []
        if len(pattern.captures) == 1:
            (one,) = pattern.captures
            if pattern.constant:
                tests.append(f"id < {self.macro}_ID")
            rest = f"(id - {self.macro}_ID)"
            if one.shift:
                tests.append(f"({rest} & {_hex((1 << one.shift) - 1, False)}) != 0")
                rest = f"({rest} >> {one.shift})"
            return [*tests, f"!({_among(rest, one.values)})"]
        mask = 0
        for one in pattern.captures:
            mask |= ((1 << one.width) - 1) << one.shift
            tests.append(f"!({_among(_captured(one), one.values)})")
        return [f"(id & {_hex(~mask & 0xFFFF_FFFF, False)}) != {self.macro}_ID", *tests]

    def _length_test(self) -> list[str]:
        framing = self.message.framing
        if framing is None or framing.affine is None:
            return []
        affine = framing.affine
        number = _terms(_head_bits(affine.length))
        factor = f" * {affine.factor}u" if affine.factor != 1 else ""
        return _refuse_if(f"({number}){factor} + {affine.constant}u != size")

    def _get(self, one: CField) -> list[str]:
        node, target = one.leaf.node, f"to->{one.name}"
        if isinstance(node, p.Rest):
            mask = _rest_mask(node)
            terms = _terms(whole_bits(node.offset, node.size, "little"))
            return [f"{target} = ({one.type})(({terms}) & {_hex(mask, node.size > 4)});"]
        if one.type == "rest":
            assert isinstance(node, p.Scalar)
            tail = node.offset + self.plan.tail
            return [f"{target} = data + {node.offset};", f"{target}_size = size - {tail}u;"]
        if one.type == "bytes":
            assert isinstance(node, p.Scalar)
            return [f"memcpy({target}, data + {node.offset}, {node.size});"]
        if isinstance(node, p.FromIdentifier) and node.number is None:
            capture = self._capture(one)
            if len(self.message.identifier.captures) == 1:
                shift = f" >> {capture.shift}" if capture.shift else ""
                return [f"{target} = ({one.type})((id - {self.macro}_ID){shift});"]
            return [f"{target} = ({one.type})({_captured(capture)});"]
        if isinstance(node, p.FromIdentifier) and node.number is not None and node.is_alone and node.constant:
            shift = f" >> {node.shift}" if node.shift else ""
            return [f"{target} = ({one.type})((({_terms(node.number.place)}) - {node.constant}u){shift});"]
        bits = _place(node)
        wide = len(bits) > 32
        word = "uint64_t" if wide else "uint32_t"
        terms = _terms(bits)
        if one.type in ("float", "double"):
            return [
                "{",
                f"    const {word} raw = {terms};",
                f"    memcpy(&{target}, &raw, sizeof raw);",
                "}",
            ]
        if one.type.startswith("uint"):
            return [f"{target} = ({one.type})({terms});"]
        half = 1 << len(bits) - 1
        if node.is_magnitude:
            return [
                "{",
                f"    const {word} raw = {terms};",
                f"    {target} = ({one.type})(raw < {_hex(half, wide)} ? (int64_t)raw :"
                f" -(int64_t)(raw - {_hex(half, wide)}));",
                "}",
            ]
        if wide and len(bits) == 64:
            return [
                "{",
                f"    const uint64_t raw = {terms};",
                f"    memcpy(&{target}, &raw, sizeof raw);",
                "}",
            ]
        raised = f"(int64_t)(({terms}) ^ {_hex(half, wide)})"
        return [f"{target} = ({one.type})({raised} - {half}{'ll' if half > 1 << 30 else ''});"]

    def _capture(self, one: CField) -> IdField:
        found = next((c for c in self.message.identifier.captures if c.name == one.leaf.path), None)
        if found is None:
            raise _Refused(f"{one.leaf.path}: a part of the identifier with another name")
        return found

    # ------------------------------------------------------------------ pack

    def _pack(self) -> list[str]:
        plan, message = self.plan, self.message
        is_can = message.framing is None
        arguments = (
            f"uint8_t *data, size_t size, {'uint32_t *id, ' if is_can else ''}const struct {self.name} *from"
        )
        rest = next((one for one in self.fields if one.type == "rest"), None)
        body = [f"int {self.name}_pack({arguments})", "{"]
        length = f"{plan.least}u" + (f" + from->{rest.name}_size" if rest is not None else "")
        if rest is None and plan.lengths is not None and len(plan.lengths) > 1:
            length = f"{max(plan.lengths)}u"
        body += [f"    const size_t length = {length};", ""]
        if rest is not None:
            allowed = plan.lengths
            if allowed is not None:
                body += _refuse_if(f"!({_among('length', allowed)})")
            elif message.framing is not None:
                body += _refuse_if(f"length > {message.framing.max_size}u")
        body += ["    if (size < length) {", "        return -1;", "    }", "    memset(data, 0, length);"]
        body += [f"    data[{fixed.offset}] |= {fixed.value:#04x};" for fixed in plan.constants]
        for one in sorted(self.fields, key=lambda field: len(field.leaf.whens)):
            body += _when(one.leaf, self._put(one))
        numbers = self._numbers()
        for number, parts in numbers.items():
            for one, node in parts:
                capture = None if number is not None else self._capture(one)
                values = range(1 << node.width) if capture is None else capture.values
                if test := _among(f"(uint32_t)from->{one.name}", values, (1 << _held(one)) - 1):
                    body += _refuse_if(f"!({test})")
            if number is not None:
                whole = [_hex(parts[0][1].constant, False), *(_shifted(one, node) for one, node in parts)]
                body += ["    {", f"        const uint32_t raw = {' + '.join(whole)};", ""]
                body += [*(f"        {line}" for line in _written(number.place)), "    }"]
        for test in self._one_of():
            body += _refuse_if(test)
        if is_can:
            whole = [f"{self.macro}_ID", *(_shifted(one, node) for one, node in numbers.get(None, ()))]
            body.append(f"    *id = {' + '.join(whole)};")
        else:
            body += self._finish()
        if not self.fields:
            body.append("    (void)from;")
        return [*body, "    return (int)length;", "}"]

    def _numbers(self) -> dict[p.Scalar | None, list[tuple[CField, p.FromIdentifier]]]:
        """The members that are parts of a number of the head, or of the identifier (None)."""
        found: dict[p.Scalar | None, list[tuple[CField, p.FromIdentifier]]] = {}
        for one in self.fields:
            if isinstance(one.leaf.node, p.FromIdentifier):
                found.setdefault(one.leaf.node.number, []).append((one, one.leaf.node))
        return found

    def _put(self, one: CField) -> list[str]:
        node, value = one.leaf.node, f"from->{one.name}"
        refuse = ["    return -1;", "}"]
        if isinstance(node, p.Rest):
            mask, full = _rest_mask(node), (1 << _unsigned(8 * node.size)) - 1
            test = f"if (({value} & {_hex(full & ~mask, node.size > 4)}) != 0) {{"
            return ([test, *refuse] if mask != full else []) + [
                f"data[{node.offset + k}] |= (uint8_t)({value}{f' >> {8 * k}' if k else ''});"
                for k in range(node.size)
            ]
        if one.type == "rest":
            assert isinstance(node, p.Scalar)
            return [
                f"if ({value}_size != 0) {{",
                f"    memcpy(data + {node.offset}, {value}, {value}_size);",
                "}",
            ]
        if one.type == "bytes":
            assert isinstance(node, p.Scalar)
            return [f"memcpy(data + {node.offset}, {value}, {node.size});"]
        if isinstance(node, p.FromIdentifier):
            return []  # together with what is in its number beside it
        bits = _place(node)
        wide = len(bits) > 32
        word = "uint64_t" if wide else "uint32_t"
        lines: list[str] = []
        if one.type in ("float", "double"):
            start = [f"{word} raw;", "", f"memcpy(&raw, &{value}, sizeof raw);"]
        else:
            low, high = node.raw_range or (0, 0)
            held = int(one.type.removeprefix("u").removeprefix("int").removesuffix("_t"))
            tests = []
            if one.type.startswith("u"):
                if high != (1 << held) - 1:
                    tests.append(f"{value} > {_hex(high, high > 0xFFFF_FFFF)}")
            else:
                if low != -(1 << held - 1):
                    tests.append(f"{value} < {low}")
                if high != (1 << held - 1) - 1:
                    tests.append(f"{value} > {high}")
            if tests:
                lines += [f"if ({' || '.join(tests)}) {{", *refuse]
            number = f"({word}){value}"
            if node.is_magnitude:
                half = _hex(1 << len(bits) - 1, wide)
                number = f"{value} < 0 ? {half} + ({word})(-(int64_t){value}) : ({word}){value}"
            start = [f"const {word} raw = {number};", ""]
        return [*lines, "{", *(f"    {line}" if line else "" for line in [*start, *_written(bits)]), "}"]

    def _finish(self) -> list[str]:
        """The length field, the end and the check of a packet."""
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
                body += _refuse_if(f"raw * {affine.factor}u + {affine.constant}u != length", 2)
            if len(bits) < 32:
                body += _refuse_if(f"raw > {_hex((1 << len(bits)) - 1, False)}", 2)
            body += [*(f"        {line}" for line in _written(bits)), "    }"]
        for back, byte in zip(range(len(framing.end), 0, -1), framing.end, strict=True):
            body.append(f"    data[length - {back}u] = {byte:#04x};")
        if self.check is not None:
            body += [f"    {line}" for line in self._computed("length")]
            for k, cell in enumerate(self._cells("length")):
                shift = 8 * (k if self.check.order == "little" else self.check.bytes - 1 - k)
                body.append(f"    {cell} = (uint8_t)(check >> {shift});")
        return body

    # ------------------------------------------------------------------ checks

    def _cells(self, size: str) -> list[str]:
        """The bytes of the check."""
        assert self.check is not None
        assert self.message.framing is not None
        back = self.check.size + len(self.message.framing.end)
        return [f"data[{size} - {back - k}u]" for k in range(self.check.size)]

    def _check_test(self) -> list[str]:
        check = self.check
        if check is None:
            return []
        order = range(check.bytes) if check.order == "little" else range(check.bytes - 1, -1, -1)
        terms = [
            f"(uint32_t){cell} << {8 * k}" if k else f"(uint32_t){cell}"
            for cell, k in zip(self._cells("size"), order, strict=True)
        ]
        lines = ["{", *(f"    {line}" for line in self._computed("size"))]
        lines += [f"    if (check != ({' | '.join(terms)})) {{", "        return -1;", "    }", "}"]
        return [f"    {line}" for line in lines]

    def _computed(self, size: str) -> list[str]:
        """Declares `check`, the number over what it covers."""
        check, framing = self.check, self.message.framing
        assert check is not None
        assert framing is not None
        if check.text is not None or check.bytes > 4:
            raise _Refused(f"a check ({check.describe}) that is text, or wider than 32 bits")
        begin, update, finish = self._engine(check)
        runs: list[tuple[str, str] | bytes] = []
        back = check.size + len(framing.end)
        if check.over is None:
            runs.append((str(len(framing.sync)), f"{size} - {back}u"))
        for part in check.over or ():
            if isinstance(part, slice):
                runs.append((_bound(part.start or 0, size), _bound(part.stop, size)))
            elif isinstance(part, Extra):
                runs.append(self.message.check_extra)
            elif isinstance(part, IdBytes):
                raise _Refused("a check over an identifier")
            else:
                runs.append(part)
        lines = [f"uint32_t check = {begin};"]
        for run in runs:
            if isinstance(run, bytes):
                lines += [f"check = {update}_byte(check, {byte:#04x});" for byte in run]
            else:
                lines.append(f"check = {update}(check, data + {run[0]}, {run[1]} - {run[0]});")
        return [*lines, f"check = {finish};"]

    def _engine(self, check: Check) -> tuple[str, str, str]:
        """What a check begins with, the function that goes on with it, and what it ends with."""
        mask = _hex((1 << 8 * check.bytes) - 1, False)
        if isinstance(check, Crc):
            width, poly, start, refin, refout, xorout = check.parameters
            if width < 8 or width > 32 or refin != refout:
                raise _Refused(f"a check ({check.describe}) of an unusual kind")
            name = f"{self.printer.prefix}_crc{width}_{poly:x}{'r' if refin else ''}"
            top = _hex((1 << width) - 1, False)
            if refin:
                poly, start = (int(f"{n:0{width}b}"[::-1], 2) for n in (poly, start))
                step = f"check = check & 1u ? check >> 1 ^ {_hex(poly, False)} : check >> 1;"
                first = "check ^= byte;"
            else:
                high = _hex(1 << width - 1, False)
                step = f"check = (check & {high} ? check << 1 ^ {_hex(poly, False)} : check << 1) & {top};"
                first = f"check ^= (uint32_t)byte << {width - 8};" if width > 8 else "check ^= byte;"
            inner = [first, "for (bit = 0; bit < 8; bit++) {", f"    {step}", "}", "return check;"]
            self._helper(name, inner, has_bits=True)
            return _hex(start, False), name, f"(check ^ {_hex(xorout, False)}) & {top}"
        name = f"{self.printer.prefix}_{check.kind}"
        if check.kind == "sum" and isinstance(check, Sum):
            self._helper(name, ["return check + byte;"])
            finish = {"": "check", "~": "~check", "-": "0u - check"}[check.sign]
            return "0u", name, f"{finish} & {mask}"
        if check.kind == "xor":
            self._helper(name, ["return check ^ byte;"])
            return "0u", name, "check & 0xffu"
        if check.kind == "fletcher":
            self._helper(
                name,
                [
                    "const uint32_t first = (check + byte) & 0xffu;",
                    "",
                    "return first | (((check >> 8) + first) & 0xffu) << 8;",
                ],
            )
            return "0u", name, "check & 0xffffu"
        raise _Refused(f"a check ({check.describe}) of its own kind")

    def _helper(self, name: str, inner: Sequence[str], *, has_bits: bool = False) -> None:
        bits = ["    int bit;", ""] if has_bits else []
        self.printer.helpers[name] = [
            f"static uint32_t {name}_byte(uint32_t check, uint8_t byte)",
            "{",
            *bits,
            *(f"    {line}" if line else "" for line in inner),
            "}",
            "",
            f"static uint32_t {name}(uint32_t check, const uint8_t *data, size_t size)",
            "{",
            "    size_t at;",
            "",
            "    for (at = 0; at < size; at++) {",
            f"        check = {name}_byte(check, data[at]);",
            "    }",
            "    return check;",
            "}",
        ]


def _bound(index: int | None, size: str) -> str:
    if index is None:
        raise _Refused("a check over what is behind it")
    return f"({size} - {-index}u)" if index < 0 else f"{index}u"


def _refuse_if(test: str, depth: int = 1) -> list[str]:
    """Statements that end a function with -1."""
    indent = "    " * depth
    return [f"{indent}if ({test}) {{", f"{indent}    return -1;", f"{indent}}}"]


def _held(one: CField) -> int:
    """The bits of an unsigned member."""
    return int(one.type.removeprefix("uint").removesuffix("_t"))


def _shifted(one: CField, node: p.FromIdentifier) -> str:
    """A member where it is in its number."""
    return f"((uint32_t)from->{one.name} << {node.shift})" if node.shift else f"(uint32_t)from->{one.name}"


def _captured(one: IdField) -> str:
    shifted = f"id >> {one.shift} & " if one.shift else "id & "
    return f"({shifted}{_hex((1 << one.width) - 1, False)})"


def _head_bits(head: Head) -> tuple[int, ...]:
    return whole_bits(head.offset, head.size, head.order)


def _place(node: p.Node) -> tuple[int, ...]:
    """The bits of a number, lowest first."""
    if isinstance(node, p.FromIdentifier) and node.number is not None:
        return node.number.place[node.shift : node.shift + node.width]
    return node.place


def _rest_mask(node: p.Rest) -> int:
    claimed = dict(node.claimed)[None]
    return (1 << 8 * node.size) - 1 & ~claimed


def _terms(bits: Sequence[int]) -> str:
    """The unsigned number of these bits, out of `data`."""
    word = "uint64_t" if len(bits) > 32 else "uint32_t"
    found: list[str] = []
    for byte, shift, width, place in bit_pieces(bits):
        text = f"data[{byte}]" + (f" >> {shift}" if shift else "")
        if shift + width < 8:
            text = (
                f"({text}) & {_hex((1 << width) - 1, False)}"
                if shift
                else f"{text} & {_hex((1 << width) - 1, False)}"
            )
        text = f"({word})({text})" if " " in text else f"({word}){text}"
        found.append(f"{text} << {place}" if place else text)
    return " | ".join(found)


def _written(bits: Sequence[int]) -> list[str]:
    """Statements that put `raw` into these bits of `data`, which are 0."""
    found: list[str] = []
    for byte, shift, width, place in bit_pieces(bits):
        text = f"raw >> {place}" if place else "raw"
        if width < 8:
            text = f"({text} & {_hex((1 << width) - 1, False)})"
            text = f"{text} << {shift}" if shift else text
        found.append(f"data[{byte}] |= (uint8_t)({text});")
    return found


def _when(leaf: p.NodePath, lines: Sequence[str]) -> list[str]:
    """Statements under the conditions of a field."""
    conditions = [f"({one})" for when in leaf.whens for one in _conditions(when)]
    if not conditions or not lines:
        return [f"    {line}" if line else "" for line in lines]
    inside = [f"        {line}" if line else "" for line in lines]
    return [f"    if ({' && '.join(dict.fromkeys(conditions))}) {{", *inside, "    }"]


def _conditions(when: p.When) -> list[str]:
    outer = [] if when.selector.when is None else _conditions(when.selector.when)
    if any(value < 0 for value in when.values):
        raise _Refused("a selector that is negative")
    return [*outer, _among(f"({_terms(when.selector.number.place)})", when.values)]


def _outside(name: str, limits: tuple[float, float]) -> list[str]:
    """Tests that refuse what is not within, NaN too."""
    low, high = limits
    parts = [f"{name} >= {_c_float(low)}"] if math.isfinite(low) else []
    parts += [f"{name} <= {_c_float(high)}"] if math.isfinite(high) else []
    return [f"!({' && '.join(parts)})"] if parts else []


def _c_float(number: float) -> str:
    return repr(float(number))
