"""Reading exports back, each with a library of its own, into one shape: dataset → column → values."""

from __future__ import annotations

import csv
import json
import sqlite3
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from aces_bus import Unknown, make_scanner
from aces_bus.protocol import Variant
from aces_bus.protocol.columns.layout import objects_of, plain_json
from aces_bus.protocol.columns.table import kinds_of
from aces_bus.protocol.generate.load import records_of
from aces_bus.protocol.plan.flatten import flatten
from aces_bus.protocol.record import getter, plain_value

Columns = dict[str, list[Any]]
#: What a field is called that has the name of a column of the transport.
RESERVED = {"time", "channel", "id", "extended", "rx", "offset", "size", "source", "fd", "remote"}


def column_of(path: str) -> str:
    """The column of a field."""
    return f"{path}_" if path in RESERVED else path


def live(variants: Sequence[Variant], traffic: Any, direction: Any = None) -> dict[str, Columns]:
    """What the live scanner gives, as columns of plain values: bytes, texts, numbers, None; JSON of what has no shape."""
    scanner: Any = make_scanner(variants, direction=direction, include_unknown=True)
    items = [*scanner.feed(traffic), *scanner.close()]
    found: dict[str, Columns] = {}
    plans = {
        kind: flatten(variant.messages[name])
        for variant in variants
        for name, kind in records_of(variant).items()
    }
    for item in items:
        if isinstance(item, Unknown):
            continue
        plan = plans[type(item)]
        held = objects_of(plan)
        columns = found.setdefault(type(item).__name__, {})
        for leaf in plan.columns:
            path, value = leaf.path, plain_value(getter(leaf.way)(item))
            if value is not None and held.get(path) == "json":
                value = plain_json(value)
            elif value is not None and held.get(path) == "wide":
                value = str(value)
            elif isinstance(value, bool) or (isinstance(value, int) and type(value) is not int):
                value = int(value)
            columns.setdefault(column_of(path), []).append(value)
        meta = item.meta
        rows: dict[str, Any] = {"time": meta.time_ns, "rx": meta.is_rx}
        if meta.identifier is None:
            rows.update(offset=meta.offset, size=meta.size)
        else:
            rows.update(channel=meta.channel, id=meta.identifier, extended=meta.extended)
        for name, value in rows.items():
            columns.setdefault(name, []).append(value)
    return found


def kinds(variants: Sequence[Variant]) -> dict[str, dict[str, Any]]:
    """Message → column → what is known of it."""
    return {
        name: {column_of(kind.name): kind for kind in kinds_of(flatten(message))}
        for variant in variants
        for name, message in variant.messages.items()
    }


def held(variants: Sequence[Variant]) -> dict[str, dict[str, str]]:
    """Message → column of objects → what it holds."""
    return {
        name: {column_of(path): what for path, what in objects_of(flatten(message)).items()}
        for variant in variants
        for name, message in variant.messages.items()
    }


def named(columns: Columns, names: Mapping[str, Mapping[float, str]]) -> Columns:
    """Columns of numbers with the names that are known for them."""
    return {
        name: [
            names[name].get(value, value) if name in names and value is not None else value
            for value in values
        ]
        for name, values in columns.items()
    }


def _unjson(columns: Columns, what: Mapping[str, str]) -> Columns:
    return {
        name: [json.loads(v) if what.get(name) == "json" and v is not None else v for v in values]
        for name, values in columns.items()
    }


def read_arrow(table: Any) -> Columns:
    """A pyarrow table."""
    import pyarrow as pa

    columns: Columns = {}
    what: dict[str, str] = {}
    names: dict[str, dict[float, str]] = {}
    for field in table.schema:
        column = table[field.name]
        if field.name == "time":
            column = column.cast(pa.int64())
        known = {key.decode(): value.decode() for key, value in (field.metadata or {}).items()}
        if "holds" in known:
            what[field.name] = known["holds"]
        if "names" in known and not pa.types.is_dictionary(field.type):
            names[field.name] = {float(number): name for number, name in json.loads(known["names"]).items()}
        columns[field.name] = column.to_pylist()
    return named(_unjson(columns, what), names)


def read_parquet(path: Path) -> dict[str, Columns]:
    """A folder of Parquet files."""
    import pyarrow.parquet as pq

    return {file.stem: read_arrow(pq.read_table(file)) for file in sorted(path.iterdir())}


def read_ipc(path: Path) -> dict[str, Columns]:
    """A folder of Arrow files."""
    import pyarrow as pa

    return {file.stem: read_arrow(pa.ipc.open_file(file).read_all()) for file in sorted(path.iterdir())}


def read_csv(path: Path) -> dict[str, Columns]:
    """A folder of CSV files, all texts; None for an empty cell."""
    found: dict[str, Columns] = {}
    for file in sorted(path.iterdir()):
        if file.stem != "_columns":
            with file.open(newline="", encoding="utf-8") as text:
                head, *rows = csv.reader(text)
            found[file.stem] = {name: [row[place] or None for row in rows] for place, name in enumerate(head)}
    return found


def read_npz(path: Path) -> dict[str, Columns]:
    """An `.npz`, without pickles."""
    import numpy as np

    from aces_lab.tables.npz import unpack

    found: dict[str, Columns] = {}
    with np.load(path, allow_pickle=False) as arrays:
        meta = json.loads(str(arrays["_meta"]))
        channels = arrays["channels"].tolist()
        loaded = {name: arrays[name] for name in arrays.files}
    for message, about in meta.items():
        columns: Columns = {}
        what: dict[str, str] = {}
        names: dict[str, dict[float, str]] = {}
        for name, known in about["columns"].items():
            key = f"{message}/{name}"
            values = loaded[key]
            if f"{key}/ends" in loaded:
                raw = unpack(loaded, key)
                columns[name] = raw
                what[name] = known.get("holds", "")
            elif name == "channel":
                columns[name] = [None if code < 0 else channels[code] for code in values.tolist()]
            else:
                if name == "time":
                    values = values.astype(np.int64)
                    gone = values == -(1 << 63)
                else:
                    gone = loaded.get(f"{key}/absent", np.zeros(len(values), bool))
                columns[name] = [
                    None if away else v for v, away in zip(values.tolist(), gone.tolist(), strict=True)
                ]
            if "names" in known:
                names[name] = {float(number): text for number, text in json.loads(known["names"]).items()}
        found[message] = named(_unjson(columns, what), names)
    return found


def read_sqlite(path: Path) -> dict[str, Columns]:
    """An SQLite file."""
    base = sqlite3.connect(path)
    try:
        found: dict[str, Columns] = {}
        for (table,) in base.execute('SELECT "table" FROM "_messages"').fetchall():
            cursor = base.execute(f'SELECT * FROM "{table}" ORDER BY rowid')
            heads = [part[0] for part in cursor.description]
            rows = cursor.fetchall()
            columns = {name: [row[place] for row in rows] for place, name in enumerate(heads)}
            columns["time"] = columns.pop("time_ns")
            known = base.execute(
                'SELECT "column", "names", "holds" FROM "_columns" WHERE "table" = ?', (table,)
            ).fetchall()
            names = {
                name: {float(number): text for number, text in json.loads(texts).items()}
                for name, texts, _ in known
                if texts
            }
            found[table] = named(_unjson(columns, {name: holds for name, _, holds in known if holds}), names)
        return found
    finally:
        base.close()


def read_mcap(path: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """Topic → (log time, message) in the order of the file."""
    from mcap.reader import make_reader

    found: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
    return found
