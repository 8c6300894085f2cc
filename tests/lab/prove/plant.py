"""Faults planted by a script: in the text of generated functions, and in plans before they are printed.

1. A fault is a small change of one message: a shifted bit, a mask, a byte order, a sign, a constant, a length, a swapped
   field, a range off by one, a selector's value.
2. A fault counts only when it changes an answer: on some payload the faulty function differs from the reference. Payloads
   are drawn, without the prover's help.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from msgspec.structs import replace

from aces_bus import load_protocol, make_scanner
from aces_bus.protocol import Message, Variant
from aces_bus.protocol.generate.decode import Decoder
from aces_bus.protocol.generate.load import decoders_of, print_decoder
from aces_bus.protocol.generate.source import load_source
from aces_bus.protocol.plan import nodes as p
from aces_bus.testing.laws import Way
from aces_lab.prove import witness as w
from aces_lab.prove.decoding import Witness, drawn, proof_lengths, source_of

#: What is changed in a text, by the name of the fault: (pattern, replacement of a match).
TEXTS: list[tuple[str, str, Callable[[re.Match[str]], str]]] = [
    ("shifted bit", r">> (\d+)", lambda m: f">> {int(m[1]) + 1}"),
    ("mask", r"& (0x[0-9a-f]+)", lambda m: f"& {int(m[1], 16) >> 1 or 2:#x}"),
    ("byte order", r'Struct\("([<>])(?=[^"]*[hHiIqQefd])', lambda m: f'Struct("{"<>"[m[1] == "<"]}'),
    ("byte order", r'"(little|big)"', lambda m: '"little"' if m[1] == "big" else '"big"'),
    ("sign", r'(Struct\("[<>][^"]*?)([hHiIqQbB])', lambda m: m[1] + m[2].swapcase()),
    ("constant", r"!= (0x[0-9a-f]{2}):", lambda m: f"!= {int(m[1], 16) ^ 1:#04x}:"),
    ("constant", r"- (0x[0-9a-f]+)(?=[,)])", lambda m: f"- {int(m[1], 16) + 1:#x}"),
    ("length", r"len\(data\) != (\d+)", lambda m: f"len(data) != {int(m[1]) - 1}"),
    ("range off by one", r"<= len\(data\) <= (\d+)", lambda m: f"<= len(data) <= {int(m[1]) - 1}"),
    ("range off by one", r"data\[\d+\] > (\d+)", lambda m: m[0].replace(f"> {m[1]}", f"> {int(m[1]) - 1}")),
    ("range off by one", r"not (\d+) <= (data\[\d+\])", lambda m: f"not {int(m[1]) + 1} <= {m[2]}"),
    ("swapped field", r"\((v\d+), (v\d+)", lambda m: f"({m[2]}, {m[1]}"),
    ("swapped field", r"data\[(\d+)\], data\[(\d+)\]", lambda m: f"data[{m[2]}], data[{m[1]}]"),
    ("scale", r"(\d\.\d+(?:e-\d+)?) \* ", lambda m: f"{float(m[1]) * 2!r} * "),
    ("offset", r" - (\d+\.\d+)(?=[,)])", lambda m: f" - {float(m[1]) + 1!r}"),
    ("sign", r"< (0x8[0]+) else", lambda m: f"<= {m[1]} else"),
    ("sign", r"\^ (0x8[0]*)\) - ", lambda m: f"^ {int(m[1], 16) >> 1:#x}) - "),
    ("selector value", r"if (v\d+|select_\w+|data\[\d+\]) == (\d+)", lambda m: f"if {m[1]} == {int(m[2]) + 1}"),
    ("table", r"(_names_\w+)\[(v\d+|data\[\d+\])\]", lambda m: f"{m[1]}[{m[2]} ^ 1]"),
]  # fmt: skip


class Planted(NamedTuple):
    """A faulty decode function of a message, and a payload on which it differs from the reference."""

    where: str
    fault: str
    variant: Variant
    message: Message
    function: Any
    raw: bool
    payload: Witness


def of_text(
    variant: Variant, message: Message, *, raw: bool, chance: random.Random
) -> Iterator[tuple[str, Any]]:
    """Functions of a message whose text has a fault."""
    real: Any = decoders_of(variant, raw)[message.name]
    text = source_of(real)
    head, mark, body = text.partition(f"def {real.__name__}(")
    for name, pattern, change in TEXTS:
        matches = list(re.finditer(pattern, text))
        if not matches:
            continue
        found = chance.choice(matches)
        wrong = text[: found.start()] + change(found) + text[found.end() :]
        if wrong == text or head is mark or not body:
            continue
        space = load_source(wrong, f"aces planted {message.name} {name}", dict(_globals(real)))
        yield f"{name}: {found[0]} → {change(found)}", space[real.__name__]


def _globals(function: Any) -> dict[str, Any]:
    return {name: value for name, value in function.__globals__.items() if name != "__builtins__"}


def of_plan(
    variant: Variant, message: Message, *, raw: bool, chance: random.Random
) -> Iterator[tuple[str, Any]]:
    """Functions of a message whose plan had a fault before it was printed."""
    real: Any = decoders_of(variant, raw)[message.name]
    plan = message.plan
    for name, wrong in _wrong_plans(plan, chance):
        printed = Decoder(wrong, raw=raw)
        source = print_decoder(printed)
        names = {**_globals(real), **printed.module.bound}
        try:
            space = load_source(source, f"aces planted plan {message.name} {name}", names)
        except Exception:
            continue
        yield name, space[printed.function]


def _wrong_plans(plan: p.MessagePlan, chance: random.Random) -> Iterator[tuple[str, p.MessagePlan]]:
    fields = list(plan.fields)
    scalars = [i for i, field in enumerate(fields) if isinstance(field.node, p.Scalar) and field.node.bits]

    def with_field(index: int, node: p.Scalar) -> p.MessagePlan:
        field = replace(fields[index], node=node)
        return replace(plan, fields=(*fields[:index], field, *fields[index + 1 :]))

    if scalars:
        index = chance.choice(scalars)
        node: Any = fields[index].node
        least = min(node.bits)
        room = 8 * (plan.least - plan.tail)
        moved = tuple(bit + 1 for bit in node.bits)
        if max(moved) < room and not node.is_whole:
            yield "shifted bit", with_field(index, replace(node, bits=moved))
        if len(node.bits) > 1:
            yield (
                "swapped bits",
                with_field(index, replace(node, bits=(node.bits[1], node.bits[0], *node.bits[2:]))),
            )
        yield "sign", with_field(index, replace(node, kind="int" if node.kind == "uint" else "uint"))
        if node.is_whole and node.size and node.size > 1:
            other = "big" if node.order == "little" else "little"
            bits = tuple(8 * (2 * node.offset + node.size - 1 - b // 8) + b % 8 for b in node.bits)
            yield "byte order", with_field(index, replace(node, order=other, bits=bits))
        if least >= 8 and node.is_whole:
            bits = tuple(bit - 8 for bit in node.bits)
            yield "offset", with_field(index, replace(node, offset=node.offset - 1, bits=bits))
        if node.steps and isinstance(node.steps[-1], p.Scale):
            step = replace(node.steps[-1], offset=node.steps[-1].offset + 1)
            yield "scale", with_field(index, replace(node, steps=(*node.steps[:-1], step)))
        if len(scalars) > 1:
            other_index = chance.choice([i for i in scalars if i != index])
            one, two = fields[index], fields[other_index]
            swapped = list(fields)
            swapped[index], swapped[other_index] = replace(one, node=two.node), replace(two, node=one.node)
            yield "swapped field", replace(plan, fields=tuple(swapped))
    if plan.constants[plan.sync :]:
        constant = plan.constants[-1]
        wrong = replace(constant, value=constant.value ^ 1)
        yield "constant", replace(plan, constants=(*plan.constants[:-1], wrong))
        yield (
            "mask",
            replace(
                plan,
                constants=(*plan.constants[:-1], replace(constant, mask=0xFE, value=constant.value & 0xFE)),
            ),
        )
    if plan.lengths and len(plan.lengths) > 1:
        yield "length", replace(plan, lengths=plan.lengths[1:])
    if plan.one_of:
        values = plan.one_of[0].values
        wrong_values = tuple(values)[1:] if len(values) > 1 else (min(values, default=0) + 1,)
        yield (
            "selector value",
            replace(plan, one_of=(replace(plan.one_of[0], values=wrong_values), *plan.one_of[1:])),
        )


def payload_of(message: Message, function: Any, *, raw: bool) -> Witness | None:
    """A drawn payload on which a function and the reference differ; None when none was found."""
    sizes, _ = proof_lengths(message)
    for found in drawn(message, sizes, 600):
        image = w.image_of(message, found)
        got = w.by_function(message, function, found, image)
        if w.text_of(got) != w.text_of(w.by_reference(message, image, raw=raw)):
            return found
    return None


def planted(protocols: Sequence[str], make: Any, most: int, seed: int) -> list[Planted]:
    """Faults of different messages, each with a payload that shows it: at most four of a message."""
    chance = random.Random(seed)
    every: list[tuple[Variant, Message]] = []
    for name in protocols:
        for variant in load_protocol(name).variants()[-1:]:
            every += [(variant, m) for m in variant.messages.values() if m.plan.is_flat and not m.reply_to]
    chance.shuffle(every)
    found: list[Planted] = []
    kinds: dict[str, int] = {}
    for variant, message in every:
        mine = 0
        raw = bool(chance.getrandbits(1))
        for fault, function in make(variant, message, raw=raw, chance=chance):
            kind = fault.partition(":")[0]
            if mine >= 4 or kinds.get(kind, 0) >= most // 5:
                continue
            payload = payload_of(message, function, raw=raw)
            if payload is None:
                continue
            mine += 1
            kinds[kind] = kinds.get(kind, 0) + 1
            found.append(
                Planted(f"{variant.label} {message.name}", fault, variant, message, function, raw, payload)
            )
            if len(found) == most:
                return found
    return found


# ---------------------------------------------------------------------- scanners of streams

#: Protocol, direction, what the printed text has, and what is planted.
SCANNERS: list[tuple[str, Way, str, str]] = [
    ("minihubo_adc", None, "i = j\n                    continue", "i = j + 1\n                    continue"),
    ("minihubo_adc", None, "j = i + 8", "j = i + 9"),
    ("minihubo_adc", None, "!= 0xff", "!= 0xfe"),
    ("minihubo_adc", None, "end - i < 8", "end - i < 7"),
    ("hubovia", None, "packet[-1]", "packet[-2]"),
    ("hubovia", None, "packet[3:7]", "packet[2:7]"),
    ("hubovia", None, "& 0xff", "& 0x7f"),
    ("robotis", "to device", "buffer[i + 3]", "buffer[3]"),
    ("robotis", "to device", "+ 4\n", "+ 5\n"),
    ("robotis", "to device", "not 5 <= size", "not 4 <= size"),
    ("robotis", "to device", "lose(base + i, j - i, 'unknown')", "lose(base + i, 1, 'unknown')"),
    ("ubx", None, '"little")', '"big")'),
    ("vesc_uart", "to device", "'malformed: checksum'", "'malformed: length'"),
]


def faulty_scanner(name: str, way: Way, right: str, wrong: str) -> Any:
    """Return a scanner whose printed text has a fault."""
    scanner: Any = make_scanner(
        [load_protocol(name).variant()], direction=way, include_unknown=True, raw=True
    )
    assert right in scanner.source, scanner.source
    scanner.source = scanner.source.replace(right, wrong, 1)
    names = {n: value for n, value in scanner._scan.__globals__.items() if n != "__builtins__"}
    space = load_source(scanner.source, f"aces planted {name} {wrong}", names)
    scanner._scan, scanner._failure = space["scan"], scanner._failure and space["check_0"]
    return scanner
