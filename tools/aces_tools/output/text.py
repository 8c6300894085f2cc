"""Lines for people: aligned, coloured on a terminal, one a record.

       0.001000  can0  063 ← Encoder   board=3  position=[120, -4] count
       0.002000  can0  7FF   unknown   DE AD BE EF

1. Columns are as wide as the widest entry so far: they settle after a few lines, and nothing is held back for them.
2. A line is cut into several only on a terminal, between fields. Elsewhere one record is one line, without colour.
3. Nothing that came over a wire reaches the terminal as a control character.
4. Where lines are neither coloured nor cut, a function that is generated from a message's plan prints its fields; it gives
   what the way by tokens gives.

Left out, because they would only distract: reserved bits that are zero, bytes up to the end where there are none, and
fields that a selector says are not there.
"""

from __future__ import annotations

import datetime
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from aces_bus.plain_text import LOOKALIKES
from aces_bus.plain_text import printable as printable
from aces_bus.protocol import FlagSet, Record, Unknown
from aces_bus.protocol.generate.load import OnDemand
from aces_bus.protocol.keys import EXTENDED
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.record import message_of

from .printing import HEADS, KEPT, LinePrinter, Read, has_few_values
from .shape import OfKind, Plans, RecordLeaf, flag_names, getter, json_value, nameless_number, record_leaves

Show = Callable[[Any], str]
Paint = Callable[[str, str], str]


class PrintedField(NamedTuple):
    """A field as it is printed; `pad` are the blanks that keep the next one in its column."""

    label: str
    value: str
    unit: str
    style: str
    pad: int = 0


class Notes(Protocol):
    """What else is to be said of records."""

    def of(self, record: Any) -> Sequence[PrintedField]: ...


#: What is printed, and how rich styles it.
STYLES: dict[str, str] = {
    "source": "bold",
    "place": "dim",
    "to device": "blue",
    "from device": "green",
    "message": "bold cyan",
    "name": "dim",
    "value": "",
    "unit": "dim",
    "flags": "yellow",
    "unknown": "red",
    "malformed": "bold red",
    "skipped": "red dim",
    "pending": "yellow dim",
    "control": "dim",
    "errors": "magenta",
    "raw": "dim",
}
ARROWS = {"to device": "→", "from device": "←"}
PLAIN_ARROWS = {"to device": ">", "from device": "<"}
BUS: Mapping[bool | None, str] = {True: "rx", False: "tx", None: ""}
#: Of bytes that were not decoded, so many are shown.
SHOWN = 16
GAP = "  "
LEAST_TIME = 12
WIDEST_MESSAGE = 24
WIDEST_FIELD = 40
#: A field with the gap before it.
WIDEST_TOKEN = len(GAP) + WIDEST_FIELD
#: Continued lines begin below the first field, or at `INDENT` where that would leave less than this.
LEAST_FOR_FIELDS = 36
INDENT = 8


def no_paint(style: str, text: str) -> str:
    return text


def make_paint() -> Paint:
    """Colours as rich has them for this terminal."""
    from rich.color import ColorSystem
    from rich.style import Style

    marks: dict[str, tuple[str, str]] = {}
    for name, description in STYLES.items():
        before, _, after = (
            Style.parse(description).render("\0", color_system=ColorSystem.STANDARD).partition("\0")
        )
        marks[name] = before, after

    def paint(style: str, text: str) -> str:
        if style == "value":
            return text
        before, after = marks[style]
        return f"{before}{text}{after}"

    return paint


class TextOutput:
    """`paint` colours, `width` is the terminal's (None: no limit), `is_relative` counts time from the first item; `notes`
    are shown behind a record's fields."""

    def __init__(
        self,
        plans: Plans,
        direction: str | None,
        *,
        paint: Paint = no_paint,
        width: int | None = None,
        is_relative: bool = True,
        encoding: str = "utf-8",
        notes: Notes | None = None,
    ) -> None:
        self._notes = notes
        self._fields = OfKind(lambda kind: _Fields(plans[kind]))
        self._printed = OfKind(lambda kind: TokenPrinter(plans[kind]).load())
        self._is_plain = width is None and paint is no_paint
        #: What stands between the time (of a stream: the offset) and the fields, without fields and with some; as
        #: long as the columns keep their widths.
        self._heads = OnDemand(self._head, most=HEADS)
        self._direction = direction
        self._paint = paint
        self._width = width
        self._is_relative = is_relative
        self._encoding = encoding
        self._arrows = ARROWS if can_write("→", encoding) else PLAIN_ARROWS
        self._source = ""
        self._is_can = True
        self._start: float | None = None
        self._is_titled = False
        self._is_first = True
        self._widths: dict[str, int] = dict.fromkeys(("time", "channel", "bus", "id", "offset", "message"), 0)

    def begin(self, source: str, link: str, start: float | None = None) -> bytes:
        self._source, self._is_can = source, link == "can"
        self._start = start if self._is_relative else None
        self._is_titled = False
        self._heads.clear()
        return b""

    def items(self, items: Sequence[Any]) -> bytes:
        lines: list[str] = []
        if items and not self._is_titled:
            lines += self._title()
        notes = self._notes
        for item in items:
            kind = type(item)
            if kind is Unknown or not self._is_plain or (notes is not None and notes.of(item)):
                lines += self._line(item)
                continue
            fields = self._printed[kind](item)
            if self._is_can:
                heads = self._heads[kind, item._channel, item._key, item._rx]
                lines.append(f"{self._when(item._time)}{heads[1] if fields else heads[0]}{fields}")
            else:
                heads = self._heads[kind, None, None, None]
                place = self._when(item._time) + self._right("offset", str(item._key), 8)
                lines.append(f"{place}{heads[1] if fields else heads[0]}{fields}")
        lines.append("")
        return "\n".join(lines).encode(self._encoding, LOOKALIKES)

    def _title(self) -> list[str]:
        self._is_titled = True
        shown = "standard input" if self._source == "-" else printable(self._source)
        title = self._paint("source", shown)
        if self._start:
            title += self._paint("place", f"  time 0 = {_instant(self._start)}")
        lines = [title] if self._is_first else ["", title]
        self._is_first = False
        return lines

    def _head(self, of: tuple[type[Record], str | None, int | None, bool | None]) -> tuple[str, str]:
        kind, channel, key, is_rx = of
        place = "" if key is None else self._where(channel, is_rx, key & 0x1FFF_FFFF, key & EXTENDED != 0)
        head = f"{place} {self._arrow(message_of(kind).direction)} {kind.__name__}"
        width = self._column("message", kind.__name__, WIDEST_MESSAGE)
        return head, head + " " * (width - len(kind.__name__))

    def _line(self, item: Any) -> list[str]:
        """The lines of an item, coloured and cut as was asked for."""
        meta = item.meta
        place = self._when(meta.time)
        if self._is_can:
            place += self._where(meta.channel, meta.is_rx, meta.identifier, meta.extended)
        else:
            place += self._right("offset", str(meta.offset), 8)
        if type(item) is Unknown:
            style, name, tokens = item.kind, item.reason.partition(": ")[0], self._lost(item, meta)
        else:
            style, name, tokens = "message", meta.message, self._fields[type(item)].tokens(item)
            if self._notes is not None:
                tokens += self._notes.of(item)
        head = f"{self._paint('place', place)} {self._arrow(meta.direction)} {self._paint(style, name)}"
        width = self._column("message", name, WIDEST_MESSAGE)
        if not tokens:
            return [head]
        size = len(place) + 3 + max(width, len(name))
        return self._wrapped(head + " " * (width - len(name)), size, tokens)

    def _arrow(self, direction: str | None) -> str:
        direction = direction or (None if self._is_can else self._direction)
        arrow = self._arrows.get(direction or "", " ")
        return arrow if direction is None else self._paint(direction, arrow)

    def _when(self, time: float | None) -> str:
        """The column of the time, with the gap behind it."""
        widest = self._widths["time"]
        if time is None:
            return " " * max(widest, LEAST_TIME) + GAP if widest else ""
        text = f"{time - self._start:.6f}" if self._start is not None else self._stamp(time)
        if len(text) > widest:
            widest = self._column("time", text)
        return text.rjust(widest if widest > LEAST_TIME else LEAST_TIME) + GAP

    def _where(self, channel: Any, is_rx: bool | None, identifier: int | None, is_extended: bool) -> str:
        """The columns that CAN says of a frame."""
        columns: list[str] = []
        name = "" if channel is None else printable(str(channel))
        if width := self._column("channel", name):
            columns.append(name.ljust(width))
        bus = BUS[is_rx]
        if width := self._column("bus", bus):
            columns.append(bus.ljust(width))
        columns.append(self._right("id", f"{identifier:0{8 if is_extended else 3}X}", 3))
        return GAP.join(columns)

    def _stamp(self, time: float) -> str:
        return f"{time:.6f}"

    def _column(self, column: str, text: str, most: int = 1000) -> int:
        width = self._widths[column]
        if len(text) > width:
            width = self._widths[column] = min(len(text), most)
            self._heads.clear()
        return width

    def _right(self, column: str, text: str, least: int) -> str:
        return text.rjust(max(least, self._column(column, text)))

    @staticmethod
    def _lost(item: Unknown, meta: Any) -> list[PrintedField]:
        tokens: list[PrintedField] = []
        if why := item.reason.partition(": ")[2]:
            tokens.append(PrintedField("", why, "", "unknown"))
        if meta.remote:
            tokens.append(PrintedField("", "remote frame", "", "raw"))
        if meta.raw:
            more = f" … ({len(meta.raw)} bytes)" if len(meta.raw) > SHOWN else ""
            tokens.append(PrintedField("", spaced_hexadecimal(meta.raw[:SHOWN]) + more, "", "raw"))
        return tokens

    def _wrapped(self, head: str, size: int, tokens: list[PrintedField]) -> list[str]:
        """Fields behind the head, on as many lines as the terminal's width asks for."""
        limit, paint = self._width, self._paint
        if limit is None:
            limit = sys.maxsize
        indent = size if limit - size >= LEAST_FOR_FIELDS else INDENT
        lines, line, at, pad = [], head, size, 0
        for token in tokens:
            rest = token.value
            while True:
                length = len(token.label) + len(rest) + len(token.unit)
                if at + pad + 2 + length > limit and at > indent:
                    lines.append(line)
                    line, at, pad = " " * indent, indent, 0
                part = rest
                if (
                    at + pad + 2 + length > limit
                ):  # longer than a line, as only bytes and texts are: cut between words
                    cut = rest.rfind(" ", 0, max(1, limit - at - 2 - len(token.label)))
                    part = rest[:cut] if cut > 0 else rest
                label = paint("name", token.label) if token.label else ""
                line += f"{' ' * (pad + 2)}{label}{paint(token.style, part)}"
                at += pad + 2 + len(token.label) + len(part)
                if part is rest:
                    break
                rest = rest[len(part) + 1 :]
                token = token._replace(label="")
            if token.unit:
                line += paint("unit", token.unit)
                at += len(token.unit)
            pad = token.pad
        return [*lines, line]


def _instant(time: float) -> str:
    if time < 1e8:  # not since 1970: the recorder's own clock
        return f"{time:.6f} s"
    try:
        instant = datetime.datetime.fromtimestamp(time, datetime.UTC)
    except (OverflowError, ValueError, OSError):
        return f"{time:.6f} s"
    return f"{instant:%Y-%m-%d %H:%M:%S.%f} UTC ({time:.6f})"


# ---------------------------------------------------------------------- fields


class _Fields:
    """The fields of one message as tokens."""

    def __init__(self, plan: p.MessagePlan) -> None:
        self._entries = [
            (leaf, f"{leaf.path}=", value_printer(leaf.node), _unit(leaf.node), _Width())
            for leaf in record_leaves(plan, is_split=False)
        ]

    def tokens(self, record: Any) -> list[PrintedField]:
        out: list[PrintedField] = []
        for leaf, label, shown, unit, width in self._entries:
            value = leaf.get(record)
            if value is None:
                if leaf.conditional or isinstance(leaf.node, p.FromRequest):
                    continue
                text, mark = "unknown", ""
            elif not value and leaf.node.is_quiet:
                continue
            else:
                text, mark = shown(value), unit
            style = "flags" if isinstance(value, FlagSet) and value else "value"
            out.append(PrintedField(label, text, mark, style, width.pad(len(label) + len(text) + len(mark))))
        return out


class TokenPrinter(LinePrinter):
    """Prints the function that gives the fields of a message's records as text, each behind a gap: what `_Fields` gives, in
    columns. The widest token of each field so far is a variable of the function's module."""

    def __init__(self, plan: p.MessagePlan) -> None:
        super().__init__(plan)
        leaves = record_leaves(plan, is_split=False)
        #: The local name of each token.
        self._tokens = [self.names.new(leaf.identifier) for leaf in leaves]
        self._most = [self.names.new(f"most_{leaf.identifier}") for leaf in leaves]
        sure = [number for number, leaf in enumerate(leaves) if not self._absent(leaf)]
        last = sure[-1] if sure else -1
        more = len(leaves) - last - 1
        if widths := self._most[: len(leaves) if more else max(last, 0)]:
            self.setup.append(f"{' = '.join(widths)} = 0")
            self.body.line(f"global {', '.join(widths)}")
        for number, leaf in enumerate(leaves[: last + 1]):
            self._before_sure(number, leaf, is_last=number == last)
        line = f"f'{''.join(f'{{{name}}}' for name in self._tokens[: last + 1])}'"
        if not more:
            self.body.line(f"return {line}")
            return
        self.body.lines(f"line = {line}", "pad = 0")
        if last >= 0:
            self._widen(last)
            self.body.line(f"pad = {self._most[last]} - n")
        for number, leaf in enumerate(leaves[last + 1 :], last + 1):
            self._behind(number, leaf)
        self.body.line("return line")

    def _absent(self, leaf: RecordLeaf) -> str:
        """The test for a value that is left out, which is `v` then; empty where it never is."""
        if leaf.node.is_quiet:
            return f"not (v := {self.read(leaf)})"
        is_optional = leaf.conditional or isinstance(leaf.node, p.FromRequest)
        return f"(v := {self.read(leaf)}) is None" if is_optional else ""

    def _before_sure(self, number: int, leaf: RecordLeaf, *, is_last: bool) -> None:
        """A token that others follow, or the last sure one."""
        body, name, most = self.body, self._tokens[number], self._most[number]
        absent = self._absent(leaf)
        value = "v" if absent else self.read(leaf)
        if absent:
            body.lines(f"if {absent}:", f"    {name} = ''", "else:")
            body.depth += 1
        if not is_last and has_few_values(leaf.node):
            texts = self._bound(f"padded_{leaf.identifier}", Padded(token_of(leaf)), shown=leaf.path)
            body.line(f"{name} = {texts}[{value}]")
        else:
            body.line(f"{name} = {self._token(leaf, value)}")
            if not is_last:
                body.line(f"if (n := len({name})) < {most}: {name} = {name}.ljust({most})")
                body.line(f"elif n > {most}: {most} = min(n, {WIDEST_TOKEN})")
        if absent:
            body.depth -= 1

    def _behind(self, number: int, leaf: RecordLeaf) -> None:
        """A token behind the last sure one: what keeps it in its column is added only where it is there."""
        body, name = self.body, self._tokens[number]
        body.line(f"if not ({self._absent(leaf)}):")
        body.depth += 1
        body.line(f"{name} = {self._token(leaf, 'v')}")
        self._widen(number)
        body.lines(f"line += ' ' * pad + {name}", f"pad = {self._most[number]} - n")
        body.depth -= 1

    def _widen(self, number: int) -> None:
        most = self._most[number]
        self.body.line(f"if (n := len({self._tokens[number]})) > {most}: {most} = min(n, {WIDEST_TOKEN})")

    def _token(self, leaf: RecordLeaf, value: str) -> str:
        """The expression of a token."""
        node = leaf.node
        label, unit = _label(leaf), _unit(node)
        parts = None if has_few_values(node) else self._numbers(node, value)
        if parts is not None:
            return self.literal([label, *parts, unit])
        number = nameless_number(node)
        if number is None or has_few_values(node):
            return self.shown(leaf.identifier, node, token_of(leaf), value)
        text = self.literal([label, Read(f"v:{_format(node)}"), unit])
        return f"{text} if (v := {value}) is not None else {self.constant(token_of(leaf)(None))}"

    def _numbers(self, node: p.Node, value: str) -> list[str | Read] | None:
        """The text of a number, or of a list of numbers; None where it may be something else."""
        if isinstance(node, p.Many):
            found: list[str | Read] = []
            for number, item in enumerate(node.items):
                parts = self._numbers(item, f"{value}[{number}]")
                if parts is None:
                    return None
                found += [", " if number else "[", *parts, "" if node.unit else _unit(item)]
            return [*found, "]"] if found else None
        form = number_format(node)
        return None if form is None else [Read(f"{value}:{form}")]


class Padded(dict[Any, str]):
    """The tokens of a field with few values, as wide as the widest so far."""

    def __init__(self, token: Show) -> None:
        super().__init__()
        self._token, self._most = token, 0

    def __missing__(self, value: Any) -> str:
        text = self._token(value)
        if len(text) > self._most:
            self.clear()
            self._most = min(len(text), WIDEST_TOKEN)
        if len(self) >= KEPT:
            return text.ljust(self._most)
        text = self[value] = text.ljust(self._most)
        return text


def token_of(leaf: RecordLeaf) -> Show:
    """A function that gives any value's token, behind a gap."""
    label, shown, unit = _label(leaf), value_printer(leaf.node), _unit(leaf.node)
    return lambda value: label + ("unknown" if value is None else shown(value) + unit)


def _label(leaf: RecordLeaf) -> str:
    return f"{GAP}{leaf.path}="


class _Width:
    """The widest token of a field so far."""

    def __init__(self) -> None:
        self.most = 0

    def pad(self, length: int) -> int:
        if length > self.most:
            self.most = min(length, WIDEST_FIELD)
        return max(0, self.most - length)


def _unit(node: p.Node) -> str:
    return f" {node.unit}" if node.unit else ""


def value_printer(node: p.Node) -> Show:
    """How the values of a node are printed."""
    match node:
        case p.Many():
            return _show_many(node)
        case p.NestedRecord():
            inner = [(f.name, getter((f.name,)), value_printer(f.node), _unit(f.node)) for f in node.fields]
            return lambda value: (
                "{" + ", ".join(f"{n}={_or_unknown(s, g(value))}{u}" for n, g, s, u in inner) + "}"
            )
        case p.TaggedItems():
            nodes = {kind.name: kind.plan.fields[0].node for kind in node.kinds}
            return _show_items({name: (value_printer(inner), _unit(inner)) for name, inner in nodes.items()})
        case p.OpaqueItems():
            units = {name: _unit(inner) for name, _, inner in node.values}
            return _show_items({}, lambda data: _named_values(data, units))
        case p.Repeated():
            (group,) = node.plan.fields
            return _show_each(group.node)
        case p.Each():
            return _show_each(node.item)
        case p.Scalar() if node.kind == "bytes":
            return spaced_hexadecimal
        case p.Scalar() if node.kind == "text":
            return shell_quoted
        case p.Rest():
            return hex
        case p.Scalar() | p.FromIdentifier():
            return _show_number(node)
        case _:
            return anything


def _or_unknown(shown: Show, value: Any) -> str:
    return "unknown" if value is None else shown(value)


def _show_many(node: p.Many) -> Show:
    shows = [value_printer(item) for item in node.items]
    units = ["" if node.unit else _unit(item) for item in node.items]

    def many(values: Any) -> str:
        return f"[{', '.join(_or_unknown(s, v) + u for s, v, u in zip(shows, values, units, strict=True))}]"

    return many


def _show_each(node: p.Node) -> Show:
    one, unit = value_printer(node), _unit(node)
    return lambda values: f"[{', '.join(_or_unknown(one, value) + unit for value in values)}]"


def _show_items(shows: Mapping[str, tuple[Show, str]], otherwise: Show | None = None) -> Show:
    """Each item as its kind and data, one that is unknown or malformed as bytes with the reason."""

    def one(item: Any) -> str:
        kind = "" if item.kind is None else f"{item.kind}="
        known = shows.get(str(item.kind))
        if item.reason is not None or known is None:
            more = f" ({item.reason})" if item.reason is not None else ""
            return kind + (otherwise or anything)(item.data) + more
        shown, unit = known
        return kind + _or_unknown(shown, item.data) + unit

    return lambda items: f"[{', '.join(map(one, items))}]"


def _named_values(data: Any, units: Mapping[str, str]) -> str:
    """Values by name, with their units where they are numbers."""
    names = getattr(data, "__struct_fields__", None)
    if names is None:
        return anything(data)
    values = ((name, getattr(data, name)) for name in names if name[0] != "_")
    number = (int, float)
    shown = (
        f"{name}={anything(value)}{units.get(name, '') if isinstance(value, number) else ''}"
        for name, value in values
    )
    return f"{{{', '.join(shown)}}}"


def _show_number(node: p.Scalar | p.FromIdentifier) -> Show:
    if node.flags:
        return lambda value: "{" + ", ".join(flag_names(value)) + "}"
    form = _format(node)
    if not node.value_names:
        return lambda value: format(value, form)
    return lambda value: printable(value) if isinstance(value, str) else format(value, form)


def number_format(node: p.Node) -> str | None:
    """How the numbers of a node are formatted; None where a value may be something else, or None."""
    number = nameless_number(node)
    return None if number is None or number.has_unknown else _format(node)


def _format(node: p.Node) -> str:
    """How the numbers of a node are formatted, as many decimals as one raw step has."""
    if isinstance(node, p.Scalar) and node.kind == "float":
        return f".{ {2: 4, 4: 7}.get(node.size or 0, 15) }g"
    scales = [step for step in node.steps if isinstance(step, p.Scale)]
    if scales and not all(float(s.scale).is_integer() and float(s.offset).is_integer() for s in scales):
        return f".{max(decimals(s.scale, s.offset) for s in scales)}f"
    if scales and any(isinstance(s.scale, float) or isinstance(s.offset, float) for s in scales):
        return ".0f"
    return ""


def decimals(scale: float, offset: float) -> int:
    """So many that one raw step shows, and no more than the scale has."""
    wanted = 0
    for number in (scale, offset):
        text = f"{number:.9f}".rstrip("0")
        exact = len(text.partition(".")[2])
        if exact > 6 or (number and abs(number) < 1e-6):
            exact = max(0, math.ceil(-math.log10(abs(scale)))) + 1
        wanted = max(wanted, exact)
    return min(wanted, 15)


def spaced_hexadecimal(data: bytes) -> str:
    return data.hex(" ").upper()


def can_write(text: str, encoding: str) -> bool:
    """Whether an output of this encoding has these characters."""
    try:
        text.encode(encoding)
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def shell_quoted(text: str) -> str:
    return f'"{printable(text)}"'


def anything(value: Any) -> str:
    """A value of no fixed shape."""
    match value:
        case None:
            return "unknown"
        case FlagSet():
            return "{" + ", ".join(flag_names(value)) + "}"
        case bool():
            return str(value).lower()
        case float():
            return f"{value:.10g}"
        case bytes():
            return spaced_hexadecimal(value)
        case str():
            return shell_quoted(value)
        case tuple() | list():
            return f"[{', '.join(map(anything, value))}]"
        case _:
            names = getattr(value, "__struct_fields__", None)
            if names is not None:
                return (
                    "{"
                    + ", ".join(
                        f"{name}={anything(getattr(value, name))}" for name in names if name[0] != "_"
                    )
                    + "}"
                )
            return str(json_value(value))
