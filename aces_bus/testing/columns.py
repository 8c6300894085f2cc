"""Compares a column scanner with the live one on a scene, knowing nothing of how columns are made.

1. The truth is what the live scanner's records show: every value is found by its path in `as_dict`, and every value of
   a record must have its column.
2. Values are compared by bits and type, but one NaN equals another: converting a float may change which NaN it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..frame_table import Channels, FrameTable, to_ns
from ..frames import key_of
from ..protocol.columns.scanner import make_column_scanner
from ..protocol.columns.table import MessageTable, dtype_of, kinds_of
from ..protocol.live.can import CanScanner
from ..protocol.live.scanner import Scanner
from ..protocol.record import FieldValue, Meta, Unknown, as_dict, getter, plain_value
from .scenes import Scene, Way, Wire, wire_variants
from .trial import ScannedItem, comparable, join_losses, plain_counts

#: raw, everything
MODES = ((True, True), (False, True), (False, False))


def columns_difference(
    wire: Wire,
    direction: Way,
    scene: Scene,
    cuts: Sequence[int],
    live: Scanner,
    raw: bool,
    include_unknown: bool,
) -> str:
    """Return what a column scanner says otherwise than `live`, fed with the same traffic cut at `cuts`; empty when
    nothing.
    """
    is_can = live.link == "can"
    columnar = make_column_scanner(
        wire_variants(wire), direction=direction, include_unknown=include_unknown, raw=raw
    )
    if columnar.link != live.link:
        return f"link is {columnar.link}, not {live.link}"
    tables: list[MessageTable] = []
    items: list[Any] = []
    rows: list[int] = []
    numbered_live: Any = live if isinstance(live, CanScanner) and live.has_transports else None
    channels = Channels()
    whole = FrameTable.from_frames(scene.traffic, channels) if is_can and len(cuts) % 2 else None
    at = 0
    for cut in (*cuts, len(scene)):
        cut = max(at, cut)
        traffic: Any = scene.traffic[at:cut]
        if numbered_live is not None:
            given_live, origins = numbered_live.feed_numbered(traffic, range(at, cut))
            items, rows = items + given_live, rows + origins
        else:
            feed: Any = live.feed
            items += feed(traffic)
        if is_can:
            traffic = (
                FrameTable.from_frames(traffic, channels) if whole is None else whole.take(slice(at, cut))
            )
        given = columnar.feed(traffic)
        if twice := _twice(given):
            return f"fed {at}…{cut}, gives two tables of {twice}"
        tables += given
        at = cut
        if is_can and plain_counts(columnar.counts) != plain_counts(live.counts):
            return (
                f"after {at}, counts {plain_counts(columnar.counts)} instead of {plain_counts(live.counts)}"
            )
    if numbered_live is not None:
        given_live, origins = numbered_live.close_numbered()
        items, rows = items + given_live, rows + origins
    else:
        items += live.close()
    tables += columnar.close()
    if plain_counts(columnar.counts) != plain_counts(live.counts):
        return f"at the end, counts {plain_counts(columnar.counts)} instead of {plain_counts(live.counts)}"
    if numbered_live is not None:
        numbered = list(zip(rows, items, strict=True))
    else:
        numbered = list(enumerate(items)) if is_can else [(item.meta.offset, item) for item in items]
    return _messages(wire, numbered, tables, raw, is_can) or _losses(
        numbered, tables, include_unknown, is_can
    )


def _twice(tables: Sequence[MessageTable]) -> str:
    seen: set[tuple[str, str]] = set()
    for table in tables:
        if (table.protocol, table.message) in seen:
            return f"{table.protocol}.{table.message}"
        seen.add((table.protocol, table.message))
    return ""


def _messages(
    wire: Wire, numbered: Sequence[tuple[int, Any]], tables: Sequence[MessageTable], raw: bool, is_can: bool
) -> str:
    wanted: dict[tuple[str, str], list[tuple[int, Any]]] = {}
    for row, item in numbered:
        if not isinstance(item, Unknown):
            wanted.setdefault((item._protocol, type(item).__name__), []).append((row, item))
    got: dict[tuple[str, str], list[MessageTable]] = {}
    for table in tables:
        if table.message:
            got.setdefault((table.protocol, table.message), []).append(table)
    if extra := got.keys() - wanted.keys():
        return f"has a table of {sorted(extra)}, of which nothing came"
    messages = {(v.name, name): message for v in wire_variants(wire) for name, message in v.messages.items()}
    for name, rows in wanted.items():
        if name not in got:
            return f"has no table of {name[0]}.{name[1]}, of which {len(rows)} came"
        plan = messages[name].plan
        promised = {leaf.path: dtype_of(leaf.node, raw) for leaf in plan.columns}
        inside = {leaf.path: getter(leaf.way) for leaf in plan.columns if leaf.is_inside}
        for table in got[name]:
            if table.kinds != kinds_of(plan, raw):
                return f"{table.message} has the columns {table.kinds}, not {kinds_of(plan, raw)}"
            for column in table.columns():
                dtype = promised[column.name]
                if column.values.dtype != (object if dtype is None else dtype):
                    return f"{table.message}.{column.name} is of {column.values.dtype}, not {dtype}"
                if len(column) != len(table):
                    return f"{table.message}.{column.name} has {len(column)} values of {len(table)}"
        said = _rows(f"{name[0]}.{name[1]}", rows, got[name], inside, is_can)
        if said:
            return said
    return ""


def _rows(
    name: str,
    wanted: Sequence[tuple[int, Any]],
    tables: Sequence[MessageTable],
    inside: Mapping[str, Callable[[Any], Any]],
    is_can: bool,
) -> str:
    """Return what differs in the rows of a message; `inside` reads from a record the columns of what is in lists of
    items.
    """
    whole = MessageTable.concat(tables)
    numbers = whole.row.tolist()
    if numbers != [row for row, _ in wanted]:
        return f"{name} in rows {numbers}, not {[row for row, _ in wanted]}"
    for index, (row, item) in enumerate(wanted):
        said = _transport(whole, index, item.meta, is_can)
        if said:
            return f"{name}, row {row}: {said}"
    fields = [as_dict(item) for _, item in wanted]
    paths = set(whole.names)
    for values in fields:
        for path in _leaves(values, "", paths):
            if path not in paths:
                return f"{name}: no column holds {path}"
    for column in whole.columns():
        shown = column.to_list()
        gone = [False] * len(whole) if column.absent is None else column.absent.tolist()
        for index, (row, item) in enumerate(wanted):
            if column.name in inside:
                value = plain_value(inside[column.name](item))
            else:
                value = _at(fields[index], column.name)
            if gone[index] != (value is None) and not column.kind.is_object:
                return (
                    f"{name}.{column.name}, row {row}: absent is {gone[index]} where the record has {value!r}"
                )
            if not _same(shown[index], value):
                return f"{name}.{column.name}, row {row}: {shown[index]!r}, and the record has {value!r}"
            if value is None and not column.kind.optional:
                return f"{name}.{column.name}, row {row}: absent, and the column is said never to be"
    return ""


def _transport(table: MessageTable, index: int, meta: Meta, is_can: bool) -> str:
    """Return what differs in time, channel, key, direction and size."""
    key = (
        key_of(meta.identifier or 0, extended=meta.extended, remote=meta.remote, fd=meta.fd)
        if is_can
        else meta.offset
    )
    pairs: list[tuple[str, Any, Any]] = [
        ("time", int(table.time[index]), to_ns(meta.time)),
        ("key", int(table.key[index]), key),
        ("channel", table.channels.names[int(table.channel[index])], meta.channel),
        ("rx", int(table.rx[index]), 2 if meta.is_rx is None else int(meta.is_rx)),
        ("is_stream", table.is_stream, not is_can),
    ]
    if table.message:
        pairs.append(("direction", table.direction, meta.direction))
    if not is_can:
        pairs.append(("size", None if table.size is None else int(table.size[index]), meta.size))
    return next((f"{what} {got!r} instead of {wanted!r}" for what, got, wanted in pairs if got != wanted), "")


def _losses(
    numbered: Sequence[tuple[int, Any]], tables: Sequence[MessageTable], include_unknown: bool, is_can: bool
) -> str:
    given = [table for table in tables if not table.message]
    if not include_unknown:
        return "has a table of losses, without include_unknown" if given else ""
    # Of a packet that is given up, the frames came before others that are known already: rows say which is which.
    wanted = sorted(
        ((row, item) for row, item in numbered if isinstance(item, Unknown)), key=lambda pair: pair[0]
    )
    got: list[ScannedItem] = []
    pieces: dict[int, bytes] = {}
    by_row = dict(wanted)
    for table in given:
        if table.names != ("reason", "raw"):
            return f"the table of losses has the columns {table.names}"
        for index, (row, reason, raw) in enumerate(
            zip(table.row.tolist(), table["reason"].to_list(), table["raw"].to_list(), strict=True)
        ):
            size = 1 if is_can or table.size is None else int(table.size[index])
            got.append(ScannedItem(row, size, None, None, reason, None))
            pieces[row] = raw
            if row in by_row and by_row[row].meta.size in (None, size):
                if said := _transport(table, index, by_row[row].meta, is_can):
                    return f"loss in row {row}: {said}"
    truth = [
        ScannedItem(row, 1 if is_can else item.meta.size or 0, None, None, item.reason, None)
        for row, item in wanted
    ]
    got.sort(key=lambda item: item.offset)
    if not is_can:
        got, truth = join_losses(got), join_losses(truth)
    if got != truth:
        return f"losses {list(map(str, got))}, not {list(map(str, truth))}"
    if is_can:
        return next(
            (
                f"loss in row {row}: raw {pieces[row].hex()} instead of {item.meta.raw.hex()}"
                for row, item in wanted
                if pieces[row] != item.meta.raw
            ),
            "",
        )
    lost = b"".join(pieces[row] for row in sorted(pieces))
    return "" if lost == b"".join(item.meta.raw for _, item in wanted) else "the bytes lost are others"


# ---------------------------------------------------------------------- values


def _leaves(value: FieldValue, path: str, columns: set[str]) -> Iterator[str]:
    """Yield the paths of all single values of a record; what is a column as a whole is one."""
    if path in columns or value is None:
        if value is not None:
            yield path
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves(inner, f"{path}.{name}" if path else name, columns)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _leaves(inner, f"{path}.{index}", columns)
    else:
        yield path


def _at(value: Any, path: str) -> Any:
    """Return the value at a path of a record's dictionary; None where a part of the way is not there."""
    for step in path.split("."):
        if value is None:
            return None
        value = value[int(step)] if isinstance(value, list) else value[step]
    return value


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float) and math.isnan(one) and math.isnan(other):
        return True
    if isinstance(one, (list, tuple)) and isinstance(other, (list, tuple)):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_same(one[name], other[name]) for name in one)
    if isinstance(one, np.generic) or isinstance(other, np.generic):
        return False  # a record has plain values
    return bool(comparable(one) == comparable(other)) and isinstance(one, float) == isinstance(other, float)


__all__ = ["MODES", "columns_difference"]
