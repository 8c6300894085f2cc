"""Lines for people: aligned, coloured on a terminal, one a record.

       0.001000  can0  063 ← Encoder   board=3  position=[120, -4] count
       0.002000  can0  7FF   unknown   DE AD BE EF

1. Columns are as wide as the widest entry so far: they settle after a few lines, and nothing is held back for them.
2. A line is cut into several only on a terminal, between fields. Elsewhere one record is one line, without colour.
3. Nothing that came over a wire reaches the terminal as a control character.
"""

from __future__ import annotations

import datetime
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from aces_bus import Unknown
from aces_bus.frames import EXTENDED
from aces_bus.plain_text import LOOKALIKES
from aces_bus.plain_text import printable as printable
from aces_bus.protocol import Record
from aces_bus.protocol.generate.load import OnDemand
from aces_bus.protocol.record_plans import message_of

from .field_text import GAP, PrintedField, RecordTokens, TokenPrinter
from .printing import HEADS
from .shape import OfKind, Plans
from .value_text import spaced_hexadecimal

Paint = Callable[[str, str], str]


class Notes(Protocol):
    """What else is to be said of records."""

    def of(self, record: Record) -> Sequence[PrintedField]: ...


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
LEAST_TIME = 12
WIDEST_MESSAGE = 24
#: Continued lines begin below the first field, or at `INDENT` where that would leave less than this.
LEAST_FOR_FIELDS = 36
INDENT = 8


def no_paint(style: str, text: str) -> str:
    return text


def make_paint() -> Paint:
    """Return a function that colours as rich does for this terminal."""
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


class Times:
    """The times of shown lines in one of candump's modes. `digits` is the least number before the point."""

    def __init__(self, mode: str, start: float | None = None) -> None:
        self.mode = mode
        self.start = start
        self._last: float | None = None

    def number(self, time: float) -> float | None:
        """Return what is shown for an instant (s); None where that is a date."""
        if self.mode == "date":
            return None
        if self.mode == "absolute":
            return time
        if self.start is None:
            self.start = time
        if self.mode == "relative":
            return time - self.start
        last, self._last = self._last, time
        return 0.0 if last is None else time - last

    @staticmethod
    def date(time: float) -> str:
        """Return an instant as date and local time."""
        try:
            return f"{datetime.datetime.fromtimestamp(time):%Y-%m-%d %H:%M:%S.%f}"
        except (OverflowError, ValueError, OSError):
            return f"{time:.6f}"


class TextOutput:
    """Lines for people. `paint` colours, `width` is the terminal's (None: no limit). `times` says how times are shown; None
    counts them from the first item. `notes` are shown behind a record's fields; `has_title` False hides the source's name.
    """

    def __init__(
        self,
        plans: Plans,
        direction: str | None,
        *,
        paint: Paint = no_paint,
        width: int | None = None,
        times: Times | None = None,
        has_title: bool = True,
        encoding: str = "utf-8",
        notes: Notes | None = None,
    ) -> None:
        self._notes, self._times, self._has_title = notes, times, has_title
        self._fields = OfKind(lambda kind: RecordTokens(plans[kind]))
        self._printed = OfKind(lambda kind: TokenPrinter(plans[kind]).load())
        self._is_plain = width is None and paint is no_paint
        #: What stands between the time (of a stream: the offset) and the fields, without fields and with some; as
        #: long as the columns keep their widths.
        self._heads = OnDemand(self._head, most=HEADS)
        self._direction = direction
        self._paint = paint
        self._width = width
        self._is_relative = times is None or times.mode == "relative"
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
        if not self._has_title:
            return []
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
        """Return the lines of an item, coloured and cut as was asked for."""
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
        """Return the column of the time, with the gap behind it."""
        widest = self._widths["time"]
        if time is None:
            return " " * max(widest, LEAST_TIME) + GAP if widest else ""
        text = f"{time - self._start:.6f}" if self._start is not None else self._stamp(time)
        if len(text) > widest:
            widest = self._column("time", text)
        return text.rjust(widest if widest > LEAST_TIME else LEAST_TIME) + GAP

    def _where(self, channel: Any, is_rx: bool | None, identifier: int | None, is_extended: bool) -> str:
        """Return the columns that CAN says of a frame."""
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
        if self._times is None or self._is_relative:
            return f"{time:.6f}"
        number = self._times.number(time)
        return self._times.date(time) if number is None else f"{number:.6f}"

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
        """Yield fields behind the head, on as many lines as the terminal's width asks for."""
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


def can_write(text: str, encoding: str) -> bool:
    """Return whether an output of this encoding has these characters."""
    try:
        text.encode(encoding)
    except (UnicodeEncodeError, LookupError):
        return False
    return True
