"""Specs drawn at random, held against `bit_arithmetic`: live, columns, the reference, and what is built again.

    python -m tests.laws.drawn_specs --count 20000 --seed 7

prints how many were refused by the language, and the first failures with their seed and their spec as Python source.

1. A seed gives the same spec and the same bytes everywhere.
2. A refusal is an `AcesError`; any other exception is a fault, as is any difference.
"""

from __future__ import annotations

import argparse
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import Any

import construct

import aces_bus.protocol as words
from aces_bus.errors import AcesError, FieldError
from aces_bus.frame_table import FrameTable
from aces_bus.frames import Frame
from aces_bus.protocol import Protocol, Reference, Unknown, Variant, make_scanner
from aces_bus.protocol.columns.scanner import make_column_scanner
from tests.laws import bit_arithmetic as plain
from tests.laws.bit_arithmetic import Node

#: Names that fields of specs have, and that generated code might like for itself.
FIELDS = tuple(
    name
    for line in (
        "a b kind sel data key time raw rx n q sm v0 v1 all0 all1 word0 select_kind cells count flags re fields t1",
        "request Struct M M_a from_bytes int float str len a_kind channel level x y z value",
    )
    for name in line.split(" ")
)
MESSAGES = (
    *("M", "M_a", "Struct", "Record", "Part", "Any", "FlagSet", "re", "flags", "data", "q", "v0"),
    *("int", "float", "tuple", "decode_M", "from_bytes", "Unusual"),
)
FLOATS = {2: "Float16", 4: "Float32", 8: "Float64"}


#: A message: its name, its payload, and the values of `node` (CAN) or `mark` (streams) that have it, None for all.
Told = tuple[str, Node, frozenset[int] | None]


@dataclass
class Drawn:
    """A spec as source, and what `bit_arithmetic` needs to know of it."""

    source: str
    #: By dialect, or under None.
    messages: dict[str | None, list[Told]]
    is_fd: bool = False
    framing: dict[str, Any] | None = None


class _Draw:
    """One random choice after the other."""

    def __init__(self, random: Random) -> None:
        self.random = random

    def chance(self, share: float) -> bool:
        return self.random.random() < share

    def name(self, taken: set[str]) -> str:
        free = [name for name in FIELDS if name not in taken]
        # Few names, so that nested ones repeat.
        name = self.random.choice(free[: self.random.choice((3, 6, len(free)))])
        taken.add(name)
        return name

    def number(self, low: int, high: int) -> int:
        return self.random.randint(low, high)

    # ------------------------------------------------------------------ values

    def meaning(self, width: int, kind: str) -> tuple[str, str, Any]:
        """(opening and closing text around a number, its meaning)."""
        draw = self.random.random()
        low, high = {
            "int": (-(1 << width - 1), (1 << width - 1) - 1),
            "magnitude": (1 - (1 << width - 1), (1 << width - 1) - 1),
        }.get(kind, (0, (1 << width) - 1))
        some = sorted(
            {self.number(low, high) for _ in range(self.number(1, 3))} | ({0} if self.chance(0.5) else set())
        )
        if draw < 0.4:
            return "", "", None
        if draw < 0.55 and kind != "float":
            names = {f"n{index} '\"": one for index, one in enumerate(some)}
            return "Enumeration(", f", {names!r})", ("names", names)
        if draw < 0.65 and kind in ("uint", "int"):
            bits = {f"f{bit}": bit for bit in range(width) if self.chance(0.4)}
            return "Flags(", f", {bits!r})", ("flags", bits)
        scale = self.random.choice((1, 1, 1.0, 2, -3, 0.1, 0.5, -0.25, 1e-7, 1e3))
        offset = self.random.choice((0, 0, 0, 5, -7, -40.0, 0.3, 1e6))
        more = ""
        unknown: Sequence[float] = ()
        if self.chance(0.3):
            unknown = (
                [self.random.choice((0.5, 1.0, float("inf"), float("nan"), -0.0))]
                if kind == "float"
                else some[:1]
            )
            more += f", unknown=[{', '.join(_shown(one) for one in unknown)}]"
        elif kind != "float" and self.chance(0.15):
            count, step = self.number(1, 12), 1
            if width >= 8 and self.chance(0.5):
                more += f", unknown=top({count}, bits=8)"
                step = 1 << width - 8
            else:
                more += f", unknown=top({count})"  # refused where no others are left
            unknown = range(high, high - count * step, -1)
        names = {}
        if kind != "float" and self.chance(0.2):
            names = {f"n{one}": one for one in some[1:] if one not in unknown}
            more += f", names={names!r}"
        if self.chance(0.2):
            bounds = self.random.choice(
                (("-math.inf", "math.inf"), ("0", "math.inf"), ("-1e6", "1e6"), ("0", "100"))
            )
            more += f", range=({', '.join(bounds)})"
        elif self.chance(0.01):
            more += ", range=(math.nan, 1)"  # refused
        if self.chance(0.01):
            return "Enumeration(Quantity(", f", scale={scale!r}), {{'one': 1}})", ("refused",)
        text = f", scale={scale!r}" if scale != 1 or self.chance(0.3) else ""
        text += f", offset={offset!r}" if offset else ""
        return "Quantity(", f"{text}{more})", ("quantity", scale, offset, unknown, names)

    def leaf(self) -> tuple[str, Node]:
        """A number of whole bytes."""
        kind = self.random.choice(("uint", "uint", "int", "magnitude", "float"))
        order = self.random.choice(("little", "big"))
        mark = order[0]
        if kind == "float":
            size = self.random.choice((2, 4, 8))
            text = f"{FLOATS[size]}{mark}"
        elif kind == "magnitude":
            size = self.random.choice((1, 2, 3))
            text = f'SignMagnitude({8 * size}, "{order}")'
        else:
            size = self.random.choice((1, 1, 1, 2, 2, 3, 4, 5, 8))
            if size in (5,):
                text = f"BytesInteger({size}, signed={kind == 'int'}, swapped={order == 'little'})"
            else:
                text = f"Int{8 * size}{'s' if kind == 'int' else 'u'}{mark}"
        before, behind, meaning = self.meaning(8 * size, kind)
        return before + text + behind, {
            "kind": "number",
            "size": size,
            "order": order,
            "type": kind,
            "meaning": meaning,
        }

    def layout(self) -> tuple[str, Node]:
        """Bit fields, with selectors among them."""
        size = self.random.choice((1, 1, 1, 2, 2, 3, 4, 8))
        default = self.random.choice(("lsb", "msb"))
        taken: set[str] = {"reserved"}
        fields: list[dict[str, Any]] = []
        texts: list[str] = []
        free = set(range(8 * size))  # in the layout's own numbering; all fields are in its order
        selectors: list[tuple[str, int, str]] = []
        for _ in range(self.number(1, 5)):
            parts, inner = [], []
            for _ in range(2 if self.chance(0.1) else 1):
                pieces: list[tuple[int, int]] = []
                for _ in range(2 if self.chance(0.15) else 1):
                    runs = sorted(free)
                    if not runs:
                        break
                    first = self.random.choice(runs)
                    width = 1
                    while first + width in free and width < 40 and self.chance(0.75):
                        width += 1
                    pieces.append((first, width))
                    free -= set(range(first, first + width))
                if not pieces:
                    break
                width = sum(w for _, w in pieces)
                kind = self.random.choice(("uint", "uint", "int", "magnitude"))
                if len(pieces) == 1:
                    text = f"bits({width}, at={pieces[0][0]}{', signed=True' if kind == 'int' else ''})"
                else:
                    text = f"Split({', '.join(map(str, pieces))}{', signed=True' if kind == 'int' else ''})"
                if kind == "magnitude":
                    text = f"SignMagnitude({text})"
                before, behind, meaning = self.meaning(width, kind)
                inner.append(before + text + behind)
                parts.append({"pieces": pieces, "type": kind, "meaning": meaning})
            if not parts:
                break
            name = self.name(taken)
            mux = None
            text = inner[0] if len(parts) == 1 else f"Tuple({', '.join(inner)})"
            if len(parts) == 1 and selectors and self.chance(0.5):
                selector, width, kind = self.random.choice(selectors)
                when = self.when(width, kind)
                mux = (selector, when)
                text = f"Multiplexed({selector!r}, {_when(when)}, {text})"
            if len(parts) == 1:
                selectors.append((name, sum(w for _, w in parts[0]["pieces"]), parts[0]["type"]))
            fields.append({"name": name, "parts": parts, "order": default, "mux": mux})
            texts.append(f'"{name}" / {text}')
        more = f', order="{default}"' if default != "lsb" else ""
        return f"BitLayout({size}, {', '.join(texts)}{more})", {
            "kind": "layout",
            "size": size,
            "fields": fields,
        }

    def when(self, width: int, kind: str) -> list[int]:
        """Values of a selector: some, a run, many."""
        low, high = (-(1 << width - 1), (1 << width - 1) - 1) if kind == "int" else (0, (1 << width) - 1)
        high = min(high, low + 40) if self.chance(0.5) else high
        if self.chance(0.4):
            first = self.number(low, high)
            return list(range(first, min(high, first + self.number(0, 12)) + 1))
        return sorted({self.number(low, high) for _ in range(self.number(1, 12 if self.chance(0.2) else 2))})

    def struct(self, depth: int, least: int = 0) -> tuple[str, Node]:
        """Fields one behind the other."""
        taken: set[str] = set()
        items: list[tuple[str | None, Node]] = []
        texts: list[str] = []
        selectors: list[tuple[str, Node]] = []
        for _ in range(self.number(least, 4 if depth else 5)):
            draw = self.random.random()
            if draw < 0.1:
                value = bytes(self.random.choice((0, 1, 0x41)) for _ in range(self.number(1, 2)))
                if self.chance(0.6):
                    items.append((None, {"kind": "const", "bytes": value}))
                    texts.append(f"Const({value!r})")
                else:
                    name = self.name(taken)
                    items.append((name, {"kind": "const", "bytes": value}))
                    texts.append(f'"{name}" / Const({value!r})')
                continue
            name = self.name(taken)
            if selectors and draw < 0.35:
                selector, one = self.random.choice(selectors)
                text, node = self.node(depth + 1)
                when = self.when(8 * one["size"], one["type"])
                text, node = (
                    f"Multiplexed({selector!r}, {_when(when)}, {text})",
                    {"kind": "mux", "selector": selector, "when": when, "body": node},
                )
            elif selectors and draw < 0.42:
                on, one = self.random.choice(
                    [(n, s) for n, s in selectors if s["type"] in ("uint", "int")] or [("", {})]
                )
                if not on:
                    continue
                found = [self.node(depth + 1) for _ in range(3)]
                keys = self.when(8 * one["size"], one["type"])[:2]
                by_number = (
                    {number: name for name, number in one["meaning"][1].items()}
                    if one["meaning"] and one["meaning"][0] == "names"
                    else {}
                )
                shown = {
                    by_number.get(key, key) if self.chance(0.5) else key: found[index][0]
                    for index, key in enumerate(keys)
                }
                cases = ", ".join(f"{key!r}: {case}" for key, case in shown.items())
                text = f"Switch(this.{on}, {{{cases}}}, default={found[2][0]})"
                node = {
                    "kind": "switch",
                    "on": on,
                    "cases": {key: found[index][1] for index, key in enumerate(keys)},
                    "default": found[2][1],
                }
            else:
                text, node = self.node(depth)
                if node["kind"] == "number" and node["type"] != "float":
                    meaning = node["meaning"]
                    if meaning is None or meaning[0] in ("names", "flags") or self.chance(0.1):
                        selectors.append((name, node))
            items.append((name, node))
            texts.append(f'"{name}" / {text}')
        return f"Struct({', '.join(texts)})", {"kind": "struct", "items": items}

    def node(self, depth: int) -> tuple[str, Node]:
        """Anything that has a name in a struct."""
        draw = self.random.random()
        if draw < 0.45 or depth > 2:
            return self.leaf()
        if draw < 0.7:
            return self.layout()
        if draw < 0.78:
            size = self.number(0, 3)
            return f"Bytes({size})", {"kind": "bytes", "size": size}
        if draw < 0.9:
            text, node = self.node(depth + 1)
            count = self.random.choice((0, 1, 2, 2, 3))
            return f"Array({count}, {text})", {"kind": "array", "count": count, "item": node}
        return self.struct(depth + 1)

    def listed(self, text: str, node: Node) -> tuple[str, Node]:
        """A struct with a list of items behind its fields."""
        inside = [text[7:-1]] if node["items"] else []
        names = {name for name, _ in node["items"]}
        count: Any = None
        if self.chance(0.6):
            made, items = self.items()
        else:
            made, item = self.group()
            count = self.random.choice((None, None, "prefixed", "field", "rebuilt"))
            if count is None:
                made = f"GreedyRange({made})"
            elif count == "prefixed":
                size, order = self.random.choice(((1, "big"), (2, "little"), (2, "big")))
                made = f"PrefixedArray(Int{8 * size}u{order[0]}, {made})"
                count = (size, order)
            elif "many" in names:
                return text, node
            else:
                number = {"kind": "number", "size": 1, "order": "big", "type": "uint", "meaning": None}
                if self.chance(0.5):
                    node["items"].append(("many", number))
                    inside.append('"many" / Byte')
                    made = f"Array(this.many, {made})"
                else:
                    node["items"].append(("many", number))
                    inside.append('"many" / Rebuild(Byte, len_(this.listed))')
                    made = f"Array(this.many, {made})"
                count = "many"
            items = {"kind": "groups", "item": item, "count": count}
        node["items"].append(("listed", items))
        inside.append(f'"listed" / {made}')
        return f"Struct({', '.join(inside)})", node

    def items(self) -> tuple[str, Node]:
        """Tagged items of some kinds."""
        orders = ("little", "big")
        tag = (self.random.choice((1, 1, 2)), self.random.choice(orders))
        size = (self.random.choice((1, 1, 2)), self.random.choice(orders)) if self.chance(0.8) else None
        first = size is not None and self.chance(0.4)
        counts = self.random.choice(("data", "data", "tag and data", "item")) if size else "data"
        numbers = self.random.sample(range(6), self.number(1, 4))
        kinds, texts = [], []
        for index, number in enumerate(numbers):
            text, body = ("GreedyBytes", {"kind": "rest"}) if self.chance(0.1) else self.node(1)
            name = f"k{index}" if self.chance(0.7) else ("kind", "data", "reason", "tag")[index]
            kinds.append((name, number, body))
            texts.append(f"{name!r}: ({number}, {text})")
        declared = [f"tag=Int{8 * tag[0]}u{tag[1][0]}"]
        if size is not None:
            declared.append(f"size=Int{8 * size[0]}u{size[1][0]}, counts={counts!r}, size_first={first}")
        counted = {"data": 0, "tag and data": tag[0], "item": tag[0] + (size[0] if size else 0)}[counts]
        return f"Items({', '.join(declared)}, kinds={{{', '.join(texts)}}})", {
            "kind": "items",
            "tag": tag,
            "size": size,
            "size_first": first,
            "counted": counted,
            "kinds": kinds,
        }

    def group(self) -> tuple[str, Node]:
        """What repeats: of one size."""
        text, node = self.node(1)
        return (text, node) if plain.width_of(node) else self.leaf()

    def payload(self) -> tuple[str, Node]:
        if self.chance(0.2):
            return self.layout()
        text, node = self.struct(0)
        if self.chance(0.25):
            return self.listed(text, node)
        if self.chance(0.1) and "'more'" not in text:
            node["items"].append(("more", {"kind": "rest"}))
            text = f'{text[:-1]}{", " if len(node["items"]) > 1 else ""}"more" / GreedyBytes)'
        return text, node

    # ------------------------------------------------------------------ whole specs

    def can(self) -> Drawn:
        """A CAN spec: one message, two told apart by a constant, by the dialect or by the configuration."""
        way = self.random.choice(("one", "one", "one", "one", "constants", "dialects", "configured"))
        is_fd = self.chance(0.15)
        names = self.random.sample(MESSAGES, 2)
        if self.chance(0.6):
            names[0] = "M"
        fd = ", fd=True" if is_fd else ""
        made = Drawn("", {}, is_fd)
        lines = ['p = Protocol("p", link="can")']
        one, two = self.payload(), self.payload()
        if way == "one":
            lines.append(
                f'p.message("{names[0]}", id=0x100 + IdField("node", range(4)){fd}, payload={one[0]})'
            )
            made.messages[None] = [(names[0], one[1], None)]
        elif way == "constants":
            found: list[Told] = []
            for index, name in enumerate(names):
                text, node = self.struct(0)
                lead = bytes([index + 1])
                node["items"].insert(0, (None, {"kind": "const", "bytes": lead}))
                inside = text.removeprefix("Struct(")
                text = f"Struct(Const({lead!r}){', ' if inside != ')' else ''}{inside}"
                lines.append(f'p.message("{name}", id=0x100 + IdField("node", range(4)){fd}, payload={text})')
                found.append((name, node, None))
            made.messages[None] = found
        elif way == "dialects":
            lines[0] = 'p = Protocol("p", link="can", dialects={"old": "", "new": ""}, dialect="new")'
            for dialect, (text, node) in (("old", one), ("new", two)):
                lines.append(
                    f'p.message("{names[0]}", id=0x100 + IdField("node", range(4)), dialect="{dialect}"{fd}, payload={text})'
                )
                made.messages[dialect] = [(names[0], node, None)]
        else:
            lines[0] = (
                'p = Protocol("p", link="can", configurations={"all": {"k": {0: "a", 1: "b", 2: "a", 3: "b"}}})'
            )
            lines.append('kind = p.configured("k", by="node")')
            found = []
            for letter, name, (text, node) in (("a", names[0], one), ("b", names[1], two)):
                lines.append(
                    f'p.message("{name}", id=0x100 + IdField("node", range(4)), when=kind("{letter}"){fd}, payload={text})'
                )
                found.append((name, node, frozenset({0, 2} if letter == "a" else {1, 3})))
            made.messages[None] = found
        made.source = "\n".join(lines)
        return made

    def stream(self) -> Drawn:
        """A stream spec: one framing, one message or two told apart by a head field."""
        sync = self.random.choice((b"\xaa", b"\xff\xff", b"\xaa\x55", b"\xab\xcd\xab"))
        ends = self.random.choice(("length", "length", "length", "fixed", "mark", "slip"))
        order = self.random.choice(("little", "big"))
        size = self.random.choice((1, 1, 2, 4))
        check, text = self.random.choice(
            (
                (None, ""),
                ({"kind": "xor", "size": 1}, "Xor()"),
                ({"kind": "sum", "size": size}, f'Sum({size}, order="{order}")'),
                ({"kind": "inverted sum", "size": size}, f'InvertedSum({size}, order="{order}")'),
                ({"kind": "negated sum", "size": size}, f'Sum({size}, negated=True, order="{order}")'),
                (
                    {"kind": "crc", "size": 2, "polynomial": 0x1021, "start": 0xFFFF},
                    f'Crc("CRC16-IBM-3740", order="{order}")',
                ),
                ({"kind": "crc", "size": 1, "polynomial": 0x07, "start": 0}, 'Crc("CRC8-SMBUS")'),
            )
        )
        if check is not None:
            check["order"] = order
        if ends == "slip":
            sync = b""
        two = self.chance(0.4)
        head = 'Struct("mark" / Byte)' if two else ""
        framing: dict[str, Any] = {
            "sync": sync,
            "end": b"",
            "check": check,
            "length": None,
            "head": int(two),
            "slip": False,
            "most": 80,
        }
        payloads = [self.struct(0) if self.chance(0.7) else self.layout() for _ in range(2 if two else 1)]
        payloads = [
            self.listed(text, node) if node["kind"] == "struct" and self.chance(0.4) else (text, node)
            for text, node in payloads
        ]
        declared = [f"sync={sync!r}"] if sync else []
        if ends == "length":
            width = self.random.choice((1, 1, 2))
            way = self.random.choice(("little", "big"))
            factor = self.random.choice((1, 1, 1, 2))
            constant = self.number(0, len(sync) + 9)
            head = f'Struct({"" if not two else chr(34) + "mark" + chr(34) + " / Byte, "}"length" / Int{8 * width}u{way[0]})'
            framing["head"] += width
            framing["length"] = (len(sync) + int(two), width, way, factor, constant)
            declared.append(f"size=this.length{f' * {factor}' if factor != 1 else ''} + {constant}")
        elif ends == "fixed":
            framing["size"] = self.number(
                len(sync) + framing["head"] + (check["size"] if check else 0) + 1, 20
            )
            declared.append(f"size={framing['size']}")
        elif ends == "mark":
            framing["end"] = self.random.choice((b"\r\n", b"\n", b"\x03"))
            declared.append(f"end={framing['end']!r}")
        else:
            framing |= {"end": b"\xc0", "slip": True}
            declared += ["end=b'\\xc0'", "stuffing=Slip()"]
        if head:
            declared.append(f"header={head}")
        if text:
            declared.append(f"check={text}")
        lines = ['p = Protocol("p", link="serial")', f"frame = p.framing({', '.join(declared)}, max_size=80)"]
        names = self.random.sample(MESSAGES, 2)
        found: list[Told] = []
        for index, (name, (text, node)) in enumerate(zip(names, payloads, strict=False)):
            match = f', match={{"mark": {index + 1}}}' if two else ""
            lines.append(f'frame("{name}"{match}, payload={text})')
            found.append((name, node, frozenset({index + 1}) if two else None))
        return Drawn("\n".join(lines), {None: found}, framing=framing)


def _shown(value: float) -> str:
    return {"inf": "math.inf", "nan": "math.nan"}.get(repr(value), repr(value))


def _when(values: list[int]) -> str:
    if len(values) > 3 and values[-1] - values[0] == len(values) - 1:
        return f"range({values[0]}, {values[-1] + 1})"
    return str(values[0]) if len(values) == 1 else repr(tuple(values))


def draw(seed: int) -> Drawn:
    """The spec of a seed."""
    random = Random(seed)
    made = _Draw(random)
    return made.stream() if random.random() < 0.2 else made.can()


def built(source: str) -> Protocol:
    """The protocol that a spec's source declares."""
    ours = {name: getattr(words, name) for name in words.__all__}
    space: dict[str, Any] = {**vars(construct), **ours, "math": __import__("math")}
    exec(compile(source, "<drawn spec>", "exec"), space)
    protocol: Protocol = space["p"]
    return protocol


# ---------------------------------------------------------------------- held against each other


class Difference(AssertionError):
    """Two that should agree do not."""


def check(seed: int, frames: int = 16) -> str:
    """Hold the spec of `seed` against plain arithmetic: what came of it. Raises `Difference`, or whatever fell out."""
    drawn = draw(seed)
    try:
        protocol = built(drawn.source)
        variants = {
            name: protocol.variant(dialect=name) if name else protocol.variant() for name in drawn.messages
        }
        for variant in variants.values():
            make_scanner([variant])
    except AcesError as error:
        return f"refused: {type(error).__name__}"
    random = Random(f"bytes of {seed}")
    accepted = 0
    for name, messages in drawn.messages.items():
        if drawn.framing is None:
            accepted += _frames(variants[name], messages, drawn.is_fd, random, frames)
        else:
            accepted += _stream(variants[name], messages, drawn.framing, random, frames)
    return "accepted" if accepted else "nothing accepted"


def _bytes(node: Node, random: Random) -> bytes:
    """Bytes that the payload might take: of the right shape more often than not."""
    kind = node["kind"]
    if kind == "struct":
        out = b""
        for _, item in node["items"]:
            if item["kind"] == "mux" and random.random() < 0.5:
                continue
            if item["kind"] == "groups" and isinstance(item["count"], str):
                count = random.randint(0, 3)  # what stands before it is its count
                out = out[:-1] + bytes([count]) + b"".join(_bytes(item["item"], random) for _ in range(count))
                continue
            out += _bytes(item, random)
        return out
    if kind == "groups":
        count = random.randint(0, 3)
        before = count.to_bytes(*node["count"]) if node["count"] else b""
        return before + b"".join(_bytes(node["item"], random) for _ in range(count))
    if kind == "items":
        return b"".join(_item(node, random) for _ in range(random.randint(0, 3)))
    if kind == "const":
        return bytes(node["bytes"])
    if kind == "array":
        return b"".join(_bytes(node["item"], random) for _ in range(node["count"]))
    if kind == "mux":
        return _bytes(node["body"], random)
    if kind == "switch":
        return _bytes(random.choice([*node["cases"].values(), node["default"]]), random)
    size = random.randint(0, 3) if kind == "rest" else node["size"]
    if kind == "number" and node["type"] == "float" and random.random() < 0.3:
        special = random.choice(("7f800000", "ff800000", "7fc00000", "3f800000", "3f000000", "80000000"))
        raw = {2: special[:4], 4: special, 8: special + "00000000"}[size]
        data = bytes.fromhex(raw)
        return data if node["order"] == "big" else data[::-1]
    wish = random.random()
    if wish < 0.4:
        return bytes(random.randint(0, 3) for _ in range(size))
    return bytes([random.choice((0, 0xFF))]) * size if wish < 0.5 else random.randbytes(size)


def _item(node: Node, random: Random) -> bytes:
    """An item of a list, or something like it."""
    _, number, body = random.choice(node["kinds"])
    data = _bytes(body, random)
    if random.random() < 0.2:
        number, data = random.randint(0, 9), random.randbytes(random.randint(0, 3))
    elif random.random() < 0.1:
        data = data[:-1]
    tag, size = number.to_bytes(*node["tag"]), b""
    if node["size"]:
        said = len(data) + node["counted"] + (random.randint(-3, 3) if random.random() < 0.1 else 0)
        size = max(0, said).to_bytes(*node["size"])
    head: bytes = size + tag if node["size_first"] else tag + size
    return head + data


def _expected(
    messages: list[Told],
    key: int,
    data: bytes,
    *,
    raw: bool,
    seen: plain.Seen | None = None,
) -> tuple[str, dict[str, Any]] | None:
    for name, payload, keys in messages:
        if keys is not None and key not in keys:
            continue
        try:
            return name, plain.read_message(payload, data, raw=raw, seen=seen)
        except plain.Misfit:
            continue
    return None


_FD = (*range(9), 12, 16, 20, 24, 32, 48, 64)


def _frames(variant: Variant, messages: list[Told], is_fd: bool, random: Random, count: int) -> int:
    cases: list[tuple[int, bytes]] = []
    for _ in range(count):
        payload = random.choice(messages)[1]
        data = _bytes(payload, random)
        if random.random() < 0.15:
            data = (
                data[: random.randint(0, len(data))] if random.random() < 0.5 else data + random.randbytes(1)
            )
        if not is_fd or len(data) not in _FD:
            data = data[:8]
        cases.append((random.randint(0, 3), data))
    frames = [
        Frame(0x100 + node, data, timestamp=float(n), is_fd=is_fd) for n, (node, data) in enumerate(cases)
    ]
    wanted = []
    for raw in (False, True):
        wanted = [_expected(messages, node, data, raw=raw) for node, data in cases]
        wanted = [
            None if one is None else (one[0], {"node": node, **one[1]})
            for one, (node, _) in zip(wanted, cases, strict=True)
        ]
        scanner = make_scanner([variant], include_unknown=True, raw=raw)
        records = scanner.feed(frames)
        for (_, data), one, record in zip(cases, wanted, records, strict=True):
            _same("live", data, one, record)
        for (_, data), one, found in zip(
            cases, wanted, Reference([variant], raw=raw).frames(frames), strict=True
        ):
            _agree(
                "reference",
                data,
                one,
                None if found.message is None else (found.message, dict(found.fields or {})),
            )
        _columns(variant, cases, frames, wanted, raw)
    for (node, data), one in zip(cases, wanted, strict=True):
        if one is not None:
            _built(variant, messages, node, data, one)
    return sum(one is not None for one in wanted)


def _columns(variant: Variant, cases: list[Any], frames: list[Frame], wanted: list[Any], raw: bool) -> None:
    scanner: Any = make_column_scanner([variant], raw=raw)
    tables = [*scanner.feed(FrameTable.from_frames(frames)), *scanner.close()]
    by_row = dict(enumerate(wanted))
    _tables(tables, by_row, {row: data for row, (_, data) in enumerate(cases)}, lambda table: table.row)


def _tables(
    tables: list[Any], wanted: dict[int, Any], raws: dict[int, bytes], rows_of: Callable[[Any], Any]
) -> None:
    """Hold tables against what is wanted, by row of the capture or by offset."""
    seen: set[int] = set()
    for table in tables:
        rows = rows_of(table).tolist()
        for path in (kind.name for kind in table.kinds):
            for row, value in zip(rows, table[path].to_list(), strict=True):
                one, raw = wanted.get(row), raws.get(row, b"").hex(" ")
                if one is None or one[0] != table.message:
                    raise Difference(f"columns: {raw} is {one}, not {table.message}")
                if path != "mark" and not _equal(_at(one[1], path), value):
                    raise Difference(f"columns: {path} of {raw}: {value!r}, wanted {_at(one[1], path)!r}")
        seen.update(rows)
    missing = {row for row, one in wanted.items() if one is not None} - seen
    if missing:
        raise Difference(f"columns: left out: {[raws[row].hex(' ') for row in missing]}")


def _at(value: Any, path: str) -> Any:
    steps = path.split(".")
    for place, step in enumerate(steps):
        if value is None:
            return None
        if isinstance(value, plain.Groups):
            return [_at(group, ".".join(steps[place:])) for group in value]
        if isinstance(value, plain.Tagged):
            good = (item for item in value if item.name == step and item["reason"] is None)
            value = next((item["data"] for item in good), None)
        else:
            value = value[int(step)] if isinstance(value, list) else value[step]
    return value


def _built(
    variant: Variant, messages: list[Told], node: int, data: bytes, one: tuple[str, dict[str, Any]]
) -> None:
    """What is built from raw values is the bytes; from physical values, bytes that mean the same."""
    name, raws = one
    seen = plain.Seen()
    read = _expected(messages, node, data, raw=False, seen=seen)
    assert read is not None
    if not seen.negative_zero and not seen.nan:
        again = bytes(variant.encoder.build(variant[name], raws, raw=True).data)
        if again != data:
            raise Difference(f"built from raw values: {again.hex(' ')}, wanted {data.hex(' ')}")
    fields = {"node": node, **read[1]}
    try:
        again = bytes(variant.encoder.encode(name, **fields).data)
    except FieldError:
        return  # out of range, or an unknown value that this field cannot say
    back = _expected(messages, node, again, raw=False)
    if back is None or back[0] != name or not _equal({"node": node, **back[1]}, fields, loose=True):
        raise Difference(f"encoded from {fields}: {again.hex(' ')} means {back}")


def _stream(
    variant: Variant, messages: list[Told], framing: dict[str, Any], random: Random, count: int
) -> int:
    data = b"".join(_packet(framing, messages, random) for _ in range(count))
    wanted = []
    for offset, packet, inside in plain.packets(framing, data):
        key = inside[0] if messages[0][2] is not None else -1
        payload = inside[framing["head"] :]
        wanted.append((offset, len(packet), key, payload))
    expected: list[tuple[int, int, tuple[str, dict[str, Any]] | None]] = []
    for raw in (False, True):
        expected = [(o, size, _expected(messages, key, payload, raw=raw)) for o, size, key, payload in wanted]
        scanner: Any = make_scanner([variant], include_unknown=True, raw=raw)
        records = []
        at = 0
        while at < len(data):
            step = random.choice((1, 7, 100, len(data)))
            records += scanner.feed(data[at : at + step])
            at += step
        records += scanner.close()
        found = [r for r in records if not isinstance(r, Unknown)]
        said = [(o, size, one) for o, size, one in expected if one is not None]
        places = [(o, size) for o, size, _ in said]
        if (mine := [(r.meta.offset, r.meta.size) for r in found]) != places:
            raise Difference(f"live: packets at {mine}, wanted {places} in {data.hex(' ')}")
        for record, (o, size, one) in zip(found, said, strict=True):
            _same("live", data[o : o + size], one, record)
        if scanner.counts.balance != 0:
            raise Difference(f"live: the bins do not add up: {scanner.counts}")
        reference = [f for f in Reference([variant], raw=raw).stream(data) if f.message is not None]
        if (theirs := [(f.offset, f.size) for f in reference]) != places:
            raise Difference(f"reference: packets at {theirs}, wanted {places} in {data.hex(' ')}")
        for one_found, (o, size, one) in zip(reference, said, strict=True):
            _agree(
                "reference", data[o : o + size], one, (str(one_found.message), dict(one_found.fields or {}))
            )
        columns: Any = make_column_scanner([variant], raw=raw)
        tables = [*columns.feed(data), *columns.close()]
        by_offset = {o: one for o, _, one in said}
        _tables(tables, by_offset, {o: data[o : o + size] for o, size, _ in said}, lambda table: table.key)
    for (o, size, told), (_, _, key, payload) in zip(expected, wanted, strict=True):
        if told is None:
            continue
        name, raws = told
        seen = plain.Seen()
        _expected(messages, key, payload, raw=False, seen=seen)
        if not seen.negative_zero and not seen.nan:
            again = bytes(variant.encoder.build(variant[name], raws, raw=True))
            if again != data[o : o + size]:
                raise Difference(f"built: {again.hex(' ')}, wanted {data[o : o + size].hex(' ')}")
    return sum(one is not None for *_, one in expected)


def _packet(framing: dict[str, Any], messages: list[Told], random: Random) -> bytes:
    """A packet, or something like it, or noise."""
    if random.random() < 0.2:
        return random.choice(
            (random.randbytes(random.randint(1, 6)), framing["sync"], framing["end"], framing["sync"][:1])
        )
    _, payload, keys = random.choice(messages)
    sync, check, length = framing["sync"], framing["check"], framing["length"]
    body = _bytes(payload, random)[:60]
    if random.random() < 0.1:
        body += b"\x00"
    mark = bytes([min(keys) if random.random() < 0.95 else 9]) if keys is not None else b""
    head = mark
    if length is not None:
        size = len(sync) + framing["head"] + len(body) + (check["size"] if check else 0)
        number = max(0, (size - length[4]) // length[3])
        head += (number % (1 << 8 * length[1])).to_bytes(length[1], length[2])
    inside = head + body
    if check:
        number = plain.check_number(check, inside)
        number ^= random.random() < 0.1
        inside += number.to_bytes(check["size"], check["order"])
    if framing["slip"]:
        inside = plain.stuffed(inside)
    return bytes(sync + inside + framing["end"])


def _same(who: str, data: bytes, wanted: tuple[str, dict[str, Any]] | None, record: Any) -> None:
    if isinstance(record, Unknown):
        _agree(who, data, wanted, None, record.reason)
        return
    fields = {
        name: getattr(record, name) for name in type(record).__struct_fields__ if not name.startswith("_")
    }
    wanted_fields = None if wanted is None else wanted
    if wanted_fields is not None and "mark" in fields and "mark" not in wanted_fields[1]:
        fields.pop("mark")
    _agree(who, data, wanted, (type(record).__name__, fields))


def _agree(
    who: str,
    data: bytes,
    wanted: tuple[str, dict[str, Any]] | None,
    found: tuple[str, dict[str, Any]] | None,
    why: str = "",
) -> None:
    if (wanted is None) != (found is None) or (
        wanted is not None
        and found is not None
        and (wanted[0] != found[0] or not _equal(wanted[1], found[1]))
    ):
        raise Difference(f"{who}: {data.hex(' ')}: {found} {why}\nwanted {wanted}")


def _equal(one: Any, other: Any, *, loose: bool = False) -> bool:
    """Whether values are the same: NaN is NaN, lists and tuples are lists, nested records are dicts."""
    if isinstance(one, dict):
        if not isinstance(other, dict):
            names = getattr(other, "__struct_fields__", None)
            if names is None:
                return False
            other = {name: getattr(other, name) for name in names}
        other = {name: value for name, value in other.items() if not str(name).startswith("_")}
        return set(one) == set(other) and all(_equal(one[name], other[name], loose=loose) for name in one)
    if isinstance(one, (list, tuple)):
        return (
            isinstance(other, (list, tuple))
            and len(one) == len(other)
            and all(_equal(a, b, loose=loose) for a, b in zip(one, other, strict=True))
        )
    if one is None or other is None or isinstance(one, (str, bytes)) or isinstance(other, (str, bytes)):
        return type(one) is type(other) and bool(one == other)
    if one != one or other != other:
        return bool(one != one and other != other)
    return bool(one == other) or (loose and abs(one - other) <= 1e-3 * max(1.0, abs(one)))


@dataclass
class Outcome:
    """How a run of specs went."""

    counts: Counter[str] = field(default_factory=Counter)
    #: (seed, what happened).
    failures: list[tuple[int, str]] = field(default_factory=list)


def run(seeds: Iterable[int], report: Callable[[int, str], None] | None = None) -> Outcome:
    """Check the specs of these seeds; `report` is given each failure when it is found."""
    outcome = Outcome()
    for seed in seeds:
        try:
            outcome.counts[check(seed)] += 1
        except Exception as error:
            where = (
                ""
                if isinstance(error, Difference)
                else "".join(traceback.format_tb(error.__traceback__)[-2:])
            )
            what = f"{type(error).__name__}: {error}\n{where}"
            outcome.failures.append((seed, what))
            if report is not None:
                report(seed, what)
            outcome.counts["failed"] += 1
    return outcome


def main(arguments: list[str] | None = None) -> int:
    """The command line: 0 when nothing differed."""
    parser = argparse.ArgumentParser(description="hold drawn specs against plain bit arithmetic")
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1, help="the first seed is a million times this")
    parser.add_argument("--first", type=int, default=0, help="leave out so many")
    given = parser.parse_args(arguments)
    start = 1_000_000 * given.seed

    def report(seed: int, what: str) -> None:
        print(f"---- seed {seed}\n{draw(seed).source}\n{what}", flush=True)

    outcome = run(range(start + given.first, start + given.count), report)
    print(", ".join(f"{number} {what}" for what, number in sorted(outcome.counts.items())))
    return 1 if outcome.failures else 0


if __name__ == "__main__":
    sys.exit(main())
