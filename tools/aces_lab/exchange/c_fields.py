"""Fields in C: the member of a struct, and the statements that take its number out of the bytes and put it there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from aces_bus.protocol import IdField
from aces_bus.protocol.plan import nodes as p

from .c_language import NotInC, c_hex, is_among, refuse_if, terms_of, unsigned_bits, word_of, written


@dataclass(frozen=True)
class CField:
    """A member of a struct: its C name and type ("bytes" and "rest" for a pointer with a size), and where it comes from."""

    name: str
    type: str
    leaf: p.NodePath
    #: Whether there are `…_decode` and `…_encode`.
    can_decode: bool = False
    can_encode: bool = False


def held_bits(field: CField) -> int:
    """Return the bits of an unsigned member."""
    return int(field.type.removeprefix("uint").removesuffix("_t"))


def shifted(field: CField, node: p.FromIdentifier) -> str:
    """Return a member where it is in its number."""
    return (
        f"((uint32_t)from->{field.name} << {node.shift})" if node.shift else f"(uint32_t)from->{field.name}"
    )


def captured(capture: IdField) -> str:
    """Return a part of the identifier."""
    return f"({f'id >> {capture.shift}' if capture.shift else 'id'} & {c_hex((1 << capture.width) - 1)})"


def place_of(node: p.Node) -> tuple[int, ...]:
    """Return the bits of a number, lowest first."""
    if isinstance(node, p.FromIdentifier) and node.number is not None:
        return node.number.place[node.shift : node.shift + node.width]
    return node.place


def rest_mask(node: p.Rest) -> int:
    """Return the bits that no field claims."""
    claimed = dict(node.claimed)[None]
    return (1 << 8 * node.size) - 1 & ~claimed


def under_conditions(leaf: p.NodePath, lines: Sequence[str]) -> list[str]:
    """Return statements under the conditions of a field."""
    conditions = [f"({test})" for when in leaf.whens for test in _conditions(when)]
    if not conditions or not lines:
        return [f"    {line}" if line else "" for line in lines]
    inside = [f"        {line}" if line else "" for line in lines]
    return [f"    if ({' && '.join(dict.fromkeys(conditions))}) {{", *inside, "    }"]


def _conditions(when: p.When) -> list[str]:
    outer = [] if when.selector.when is None else _conditions(when.selector.when)
    if any(value < 0 for value in when.values):
        raise NotInC("a selector that is negative")
    return [*outer, is_among(f"({terms_of(when.selector.number.place)})", when.values)]


def c_type(node: p.Node) -> str:
    """Return the type of a member, see `CField.type`. Raises `NotInC` for bytes of no size."""
    if isinstance(node, p.Scalar) and node.is_bytes:
        if node.size == 0:
            raise NotInC("bytes of no size")
        return "rest" if node.size is None else "bytes"
    if isinstance(node, p.Rest):
        return f"uint{unsigned_bits(8 * node.size)}_t"
    if isinstance(node, p.Scalar) and node.kind == "float":
        return "float" if len(node.place) == 32 else "double"
    low, high = node.raw_range or (0, 0)
    if low < 0:
        return f"int{unsigned_bits(max(high.bit_length(), (-low - 1).bit_length()) + 1)}_t"
    return f"uint{unsigned_bits(max(1, high.bit_length()))}_t"


def taken_out(field: CField) -> list[str]:
    """Return statements that take a number out of `data`."""
    node, target, bits = field.leaf.node, f"to->{field.name}", place_of(field.leaf.node)
    word, terms, half = word_of(bits), terms_of(bits), 1 << len(bits) - 1
    if field.type.startswith("uint"):
        return [f"{target} = ({field.type})({terms});"]
    if node.is_magnitude:
        sign = c_hex(half)
        copied = f"{target} = ({field.type})(raw < {sign} ? (int64_t)raw : -(int64_t)(raw - {sign}));"
    elif field.type in ("float", "double") or len(bits) == 64:
        copied = f"memcpy(&{target}, &raw, sizeof raw);"
    else:
        raised = f"(int64_t)(({terms}) ^ {c_hex(half)})"
        return [f"{target} = ({field.type})({raised} - {half}{'ll' if half > 1 << 30 else ''});"]
    return ["{", f"    const {word} raw = {terms};", f"    {copied}", "}"]


def put_in(field: CField) -> list[str]:
    """Return statements that put a member into `data`, which is 0 there; parts of a shared number are put in
    with that number.
    """
    node, value = field.leaf.node, f"from->{field.name}"
    if isinstance(node, p.Rest):
        free = (1 << unsigned_bits(8 * node.size)) - 1 & ~rest_mask(node)
        cells = [
            f"data[{node.offset + k}] |= (uint8_t)({value}{f' >> {8 * k}' if k else ''});"
            for k in range(node.size)
        ]
        return (refuse_if(f"({value} & {c_hex(free)}) != 0", 0) if free else []) + cells
    if isinstance(node, p.FromIdentifier):
        return []
    assert isinstance(node, p.Scalar)
    if field.type == "rest":
        copied = f"    memcpy(data + {node.offset}, {value}, {value}_size);"
        return [f"if ({value}_size != 0) {{", copied, "}"]
    if field.type == "bytes":
        return [f"memcpy(data + {node.offset}, {value}, {node.size});"]
    bits = place_of(node)
    word = word_of(bits)
    if field.type in ("float", "double"):
        return _block([f"{word} raw;", "", f"memcpy(&raw, &{value}, sizeof raw);", *written(bits)])
    number = f"({word}){value}"
    if node.is_magnitude:
        number = f"{value} < 0 ? {c_hex(1 << len(bits) - 1)} + ({word})(-(int64_t){value}) : {number}"
    tests = _too_large(field, value)
    return [
        *(refuse_if(" || ".join(tests), 0) if tests else []),
        *_block([f"const {word} raw = {number};", "", *written(bits)]),
    ]


def _too_large(field: CField, value: str) -> list[str]:
    """Return tests for values that fit the member and do not fit the bits."""
    low, high = field.leaf.node.raw_range or (0, 0)
    width = int(field.type.removeprefix("u").removeprefix("int").removesuffix("_t"))
    if field.type.startswith("u"):
        return [f"{value} > {c_hex(high)}"] if high != (1 << width) - 1 else []
    half = 1 << width - 1
    return [f"{value} < {low}"] * (low != -half) + [f"{value} > {high}"] * (high != half - 1)


def _block(lines: Sequence[str]) -> list[str]:
    return ["{", *(f"    {line}" if line else "" for line in lines), "}"]
