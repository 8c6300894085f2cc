"""Lines for people: aligned, coloured on a terminal, one a record.

       0.001000  can0  063 ← Encoder   board=3  position=[120, -4] count
       0.002000  can0  7FF   unknown   DE AD BE EF

1. Columns are as wide as the widest entry so far: they settle after a few lines, and nothing is held back for them.
2. A line is cut into several only on a terminal, between fields. Elsewhere one record is one line, without colour.
3. Nothing that came over a wire reaches the terminal as a control character.

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
from aces_bus.protocol import FlagSet, Unknown
from aces_bus.protocol.plan import nodes as p

from .shape import OfKind, Plans, flag_names, getter, json_value, record_leaves

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
WIDEST_MESSAGE = 24
WIDEST_FIELD = 40
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
        return b""

    def items(self, items: Sequence[Any]) -> bytes:
        lines: list[str] = []
        for item in items:
            meta = item.meta
            if not self._is_titled:
                lines += self._title()
            lines += self._line(item, meta)
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

    def _line(self, item: Any, meta: Any) -> list[str]:
        paint = self._paint
        direction = meta.direction or (None if self._is_can else self._direction)
        place = self._place(meta)
        if type(item) is Unknown:
            style, name, tokens = item.kind, item.reason.partition(": ")[0], self._lost(item, meta)
        else:
            style, name, tokens = "message", meta.message, self._fields[type(item)].tokens(item)
            if self._notes is not None:
                tokens += self._notes.of(item)
        arrow = self._arrows.get(direction or "", " ")
        if direction is not None:
            arrow = paint(direction, arrow)
        head = f"{paint('place', place)} {arrow} {paint(style, name)}"
        width = self._column("message", name, WIDEST_MESSAGE)
        if not tokens:
            return [head]
        size = len(place) + 3 + max(width, len(name))
        return self._wrapped(head + " " * (width - len(name)), size, tokens)

    def _place(self, meta: Any) -> str:
        """Where and when: the columns in front."""
        columns: list[str] = []
        if meta.time is not None:
            columns.append(self._right("time", self._stamp(meta.time), 12))
        elif self._widths["time"]:
            columns.append(self._right("time", "", 12))
        if self._is_can:
            channel = "" if meta.channel is None else printable(str(meta.channel))
            if width := self._column("channel", channel):
                columns.append(channel.ljust(width))
            bus = BUS[meta.is_rx]
            if width := self._column("bus", bus):
                columns.append(bus.ljust(width))
            columns.append(self._right("id", f"{meta.identifier:0{8 if meta.extended else 3}X}", 3))
        else:
            columns.append(self._right("offset", str(meta.offset), 8))
        return "  ".join(columns)

    def _stamp(self, time: float) -> str:
        return f"{time - (self._start or 0):.6f}"

    def _column(self, column: str, text: str, most: int = 1000) -> int:
        width = self._widths[column]
        if len(text) > width:
            width = self._widths[column] = min(len(text), most)
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
    if any(isinstance(step, p.ValueNames) for step in node.steps):
        return _name
    if isinstance(node, p.Scalar) and node.kind == "float":
        digits = {2: 4, 4: 7}.get(node.size or 0, 15)
        return lambda value: f"{value:.{digits}g}"
    scales = [step for step in node.steps if isinstance(step, p.Scale)]
    if any(step.names for step in scales):
        number = _show_scaled(scales)
        return lambda value: printable(value) if isinstance(value, str) else number(value)
    return _show_scaled(scales)


def _name(value: Any) -> str:
    """A name, or a number that has none."""
    return printable(str(value))


def _show_scaled(scales: Sequence[p.Scale]) -> Show:
    if scales and not all(float(s.scale).is_integer() and float(s.offset).is_integer() for s in scales):
        digits = max(decimals(s.scale, s.offset) for s in scales)
        return lambda value: f"{value:.{digits}f}" if isinstance(value, float) else str(value)
    if scales and any(isinstance(s.scale, float) or isinstance(s.offset, float) for s in scales):
        return lambda value: f"{value:.0f}"
    return str


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
