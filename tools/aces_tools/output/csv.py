"""Comma-separated values, for spreadsheets.

With one message: one row a record, one column a field (`position.0`, `status.mode`; `Status.id` where a column of the
transport has the name). Otherwise one row a value, in the
columns `field`, `value` and `unit`, as pivot tables and data frames take it.

1. The columns are known before the first record: they depend on the protocols and messages asked for, not on the data.
2. What is not decoded has no message; its reason is under `field`, its bytes under `value`. In the form with one
   message there is no place for it.
3. A text that a spreadsheet would take for a formula (it begins with = + - @, a tab or a carriage return, and is no number)
   has an apostrophe in front. Numbers are as they are.
4. Identifiers are hexadecimal text (0x063), flags are joined by `|`, bytes are hexadecimal; no value is an empty cell.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any

from aces_bus.plain_text import cell_text
from aces_bus.protocol import FlagSet, Unknown

from .shape import OfKind, Plans, RecordLeaf, flag_names, json_value, record_leaves

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
        self._leaves = OfKind(lambda kind: record_leaves(plans[kind]))
        self._is_wide = only is not None
        kinds = plans.named(only) if only is not None else ()
        columns = self._columns = list(
            dict.fromkeys(leaf.path for kind in kinds for leaf in self._leaves[kind])
        )
        taken = {"source", "time", "channel", "direction", "id", "offset", "size", "protocol", "message"}
        self._titles = [f"{only}.{name}" if name in taken else name for name in columns]
        self._has_can = "can" in links
        self._has_streams = not links or any(link != "can" for link in links)
        self._source = ""
        self._is_begun = False

    def begin(self, source: str, link: str, start: float | None = None) -> bytes:
        self._source = source
        if self._is_begun:
            return b""
        self._is_begun = True
        head = ["source", "time", "channel", "direction"]
        head += ["id"] if self._has_can else []
        head += ["offset", "size"] if self._has_streams else []
        head += ["protocol", "message"]
        return self._rows([head + (self._titles if self._is_wide else ["field", "value", "unit"])])

    def items(self, items: Sequence[Any]) -> bytes:
        rows: list[list[Any]] = []
        for item in items:
            head = self._head(item)
            if type(item) is Unknown:
                if not self._is_wide:
                    rows.append([*head, item.reason, item.meta.raw.hex(), ""])
                continue
            found = self._leaves[type(item)]
            if self._is_wide:
                cells = {leaf.path: cell(leaf.get(item)) for leaf in found}
                rows.append([*head, *(cells.get(name, "") for name in self._columns)])
            elif found:
                rows += [
                    [*head, *self._value(leaf, item)]
                    for leaf in found
                    if not leaf.is_inside or leaf.get(item) is not None
                ]
            else:
                rows.append([*head, "", "", ""])
        return self._rows(rows)

    def _head(self, item: Any) -> list[Any]:
        meta = item.meta
        direction = meta.direction or (self._direction if meta.identifier is None else None)
        head = [self._source, meta.time, meta.channel, direction]
        if self._has_can:
            identifier = meta.identifier
            head.append(None if identifier is None else f"{identifier:#0{10 if meta.extended else 5}x}")
        if self._has_streams:
            head += [meta.offset, meta.size]
        return [*head, meta.protocol, meta.message]

    @staticmethod
    def _value(leaf: RecordLeaf, item: Any) -> list[Any]:
        return [leaf.path, cell(leaf.get(item)), leaf.node.unit]

    @staticmethod
    def _rows(rows: list[list[Any]]) -> bytes:
        return "".join([",".join(map(_written, row)) + "\n" for row in rows]).encode("utf-8", "replace")


def _written(value: Any) -> str:
    """A cell as it is written (RFC 4180). The csv module leaves a lone carriage return without quotes."""
    if value is None:
        return ""
    text = cell_text(value) if isinstance(value, str) else str(value)
    return '"' + text.replace('"', '""') + '"' if _SPECIAL(text) else text


def cell(value: Any) -> Any:
    """A value as one cell."""
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
            return json.dumps(json_value(value), ensure_ascii=False)
