"""Specs drawn at random, as Python source: a seed gives the same spec everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

import construct

import aces_bus.protocol as words
from aces_bus.protocol import Protocol
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
        if self.chance(0.3):
            more += ', rounding="truncate"'
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
