"""Comma-separated values, for spreadsheets.

With one message: one row a record, one column a field (`position.0`, `status.mode`; `Status.id` where a column of the
transport has the name). Otherwise one row a value, in the
columns `field`, `value` and `unit`, as pivot tables and data frames take it.

1. The columns are known before the first record: they depend on the protocols and messages asked for, not on the data.
2. What is not decoded has no message; its reason is under `field`, its bytes under `value`. In the form with one
   message there is no place for it.
3. A text that a spreadsheet would take for a formula (it begins with = + - @, a tab or CR, and is not a number)
   has an apostrophe in front. Numbers are as they are.
4. Identifiers are hexadecimal text (0x063), flags are joined by `|`, bytes are hexadecimal; no value is an empty cell.
5. The values of a record are printed by a function that is generated from its plan, what stands before them by `CsvOutput`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from aces_bus import Unknown
from aces_bus.frames import EXTENDED
from aces_bus.plain_text import cell_text
from aces_bus.protocol import FlagSet, Record
from aces_bus.protocol.generate.load import OnDemand
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.record import FieldValue, protocol_name_of
from aces_bus.protocol.record_plans import message_of

from .printing import HEADS, LinePrinter, Read, decimal, has_few_values
from .shape import (
    OfKind,
    Plans,
    RecordLeaf,
    flag_names,
    json_value,
    nameless_number,
    plain_of,
    record_leaves,
)

#: JSON writes the multiples of so small a part, as Python does.
LEAST_USUAL = 10**4
_SPECIAL = re.compile(r'[",\r\n]').search


class CsvOutput:
    """`only` is the one message asked for, if it is one; `links` are those of the protocols in use."""

    def __init__(
        self,
        plans: Plans,
        direction: str | None,
        *,
        only: str | None,
        links: frozenset[str],
    ) -> None:
        self._direction = direction
        self._is_wide = only is not None
        kinds = plans.named(only) if only is not None else ()
        columns = list(dict.fromkeys(leaf.path for kind in kinds for leaf in record_leaves(plans[kind])))
        self._rows = OfKind(
            lambda kind: RowPrinter(kind, plans[kind], columns if only is not None else None).load()
        )
        self._places = OnDemand(self._place, most=HEADS)
        taken = {"source", "time", "channel", "direction", "id", "offset", "size", "protocol", "message"}
        self._titles = [f"{only}.{name}" if name in taken else name for name in columns]
        self._has_can = "can" in links
        self._has_streams = not links or any(link != "can" for link in links)
        self._source = b""
        self._is_begun = False

    def begin(self, source: str, link: str, start: float | None = None) -> bytes:
        self._source = f"{_written(source)},".encode("utf-8", "replace")
        if self._is_begun:
            return b""
        self._is_begun = True
        head = ["source", "time", "channel", "direction"]
        head += ["id"] if self._has_can else []
        head += ["offset", "size"] if self._has_streams else []
        head += ["protocol", "message"]
        return _row([*head, *(self._titles if self._is_wide else ("field", "value", "unit"))])

    def items(self, items: Sequence[Any]) -> bytes:
        source, places, rows = self._source, self._places, self._rows
        lines: list[bytes] = []
        for item in items:
            kind = type(item)
            if kind is Unknown:
                if not self._is_wide:
                    lines += source, self._unknown(item)
                continue
            time = item._time
            head = source + (b"" if time is None else decimal(time))
            if kind._is_stream:
                head += places[kind, item._channel, None] + b"%d,%d," % (item._key, len(item._raw))
            else:
                head += places[kind, item._channel, item._key]
            lines.append(rows[kind](item, head))
        return b"".join(lines)

    def _place(self, of: tuple[type[Record], str | None, int | None]) -> bytes:
        """Return what stands between the time and the names of the message; of packets of a stream, up to the offset."""
        kind, channel, key = of
        direction = message_of(kind).direction
        if key is None:
            return _cells([None, channel, direction or self._direction, *([None] if self._has_can else [])])
        place = [
            None,
            channel,
            direction,
            *self._identifier(key & 0x1FFF_FFFF, is_extended=key & EXTENDED != 0),
        ]
        return _cells([*place, *([None, None] if self._has_streams else [])])

    def _identifier(self, identifier: int, *, is_extended: bool) -> list[str]:
        return [f"{identifier:#0{10 if is_extended else 5}x}"] if self._has_can else []

    def _unknown(self, item: Unknown) -> bytes:
        meta = item.meta
        place = [meta.time, meta.channel]
        if meta.identifier is not None:
            place += [meta.direction, *self._identifier(meta.identifier, is_extended=meta.extended)]
        else:
            place += [meta.direction or self._direction, *([None] if self._has_can else [])]
        place += [meta.offset, meta.size] if self._has_streams else []
        return _row([*place, None, None, item.reason, meta.raw.hex(), None])


def _row(cells: Sequence[Any]) -> bytes:
    return f"{','.join(map(_written, cells))}\n".encode("utf-8", "replace")


def _cells(cells: Sequence[Any]) -> bytes:
    """Return cells with one after them."""
    return f"{','.join(map(_written, cells))},".encode("utf-8", "replace")


def _written(value: FieldValue) -> str:
    """Return a cell as it is written (RFC 4180). The csv module leaves a lone carriage return without quotes."""
    if value is None:
        return ""
    text = cell_text(value) if isinstance(value, str) else str(value)
    return '"' + text.replace('"', '""') + '"' if _SPECIAL(text) else text


# ---------------------------------------------------------------------- values


class RowPrinter(LinePrinter):
    """Prints the function that writes the rows of a message's records: behind `head` one row a value, or (`columns`) one
    row with these."""

    def __init__(self, kind: type[Record], plan: p.MessagePlan, columns: Sequence[str] | None) -> None:
        super().__init__(plan, "head")
        self._names = f"{_written(protocol_name_of(kind))},{_written(kind.__name__)},"
        leaves = record_leaves(plan)
        if columns is not None:
            self._one_row({leaf.path: leaf for leaf in leaves}, columns)
        elif leaves:
            self.joined([part for leaf in leaves for part in self._row(leaf)])
        else:
            self.joined([Read("head"), f"{self._names},,\n"])

    def _one_row(self, leaves: Mapping[str, RecordLeaf], columns: Sequence[str]) -> None:
        parts: list[str | Read] = [Read("head"), self._names[:-1]]
        for column in columns:
            parts += [",", *([self._cell(leaves[column])] if column in leaves else [])]
        self.joined([*parts, "\n"])

    def _row(self, leaf: RecordLeaf) -> list[str | Read]:
        before, after = f"{self._names}{_written(leaf.path)},", f",{_written(leaf.node.unit)}\n"
        if not leaf.is_inside:
            return [Read("head"), before, self._cell(leaf), after]
        cell = self.shown(leaf.identifier, leaf.node, cell_of(leaf.node), "v")
        names = ", ".join(["head", self.constant(before.encode()), cell, self.constant(after.encode())])
        return [Read(f'b"" if (v := {self.read(leaf)}) is None else join(({names}))')]

    def _cell(self, leaf: RecordLeaf) -> Read:
        node, value = leaf.node, self.read(leaf)
        number = nameless_number(node)
        if number is None or (number.is_inexact and has_few_values(node)):
            return self.shown(leaf.identifier, node, cell_of(node), value)
        is_optional = leaf.conditional or leaf.is_inside or number.has_unknown
        is_usual = not number.is_float or 0 < number.whole <= LEAST_USUAL
        text = f"{'json' if is_usual else 'decimal'}({number.mended('v' if is_optional else value)})"
        return Read(f'b"" if (v := {value}) is None else {text}' if is_optional else text)


def cell_of(node: p.Node) -> Callable[[Any], bytes]:
    """Return a function that writes any value of a node as one cell."""
    plain, number = plain_of(node), nameless_number(node)
    if number is not None and number.is_inexact:
        return lambda value: _written(plain(value)).encode()
    return lambda value: _written(cell(value, plain)).encode("utf-8", "replace")


def cell(value: Any, plain: Callable[[Any], Any] = json_value) -> Any:
    """Return a value as one cell."""
    match value:
        case None | str() | float():
            return value
        case FlagSet():
            return "|".join(flag_names(value))
        case bytes():
            return value.hex()
        case int() | bool():
            return value
        case _:
            return json.dumps(plain(value), ensure_ascii=False)
