"""MCAP, as Foxglove and PlotJuggler open it: a channel of JSON messages for each message of a protocol.

1. Messages are in the order of the capture, piece by piece: readers need no sorting.
2. A message's JSON schema names every field with its unit; it hangs on the plan and not on values.

Topic `/protocol/Message`; the fields are nested as in a record, and under `meta` are `channel`, `id` (CAN) or `offset`,
`size` (streams), `rx`, and `source` where several captures are joined. Enumerations are numbers, which can be plotted, or
with `names` names; bytes are hexadecimal. `log_time` is ns since 1970, or as the recording counts; a message without time
has the time of the latest one that has one.

Chunks are packed where zstandard is installed (extra `[mcap]`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from ..errors import CallerError
from ..frame_table import NO_TIME
from ..protocol.columns.arrow import json_text, schema_metadata
from ..protocol.columns.layout import DatasetColumn, DatasetLayout, plain_json
from ..protocol.columns.table import Column, MessageTable
from ..protocol.declare.protocol import Variant
from .base import Dataset, Export, Options
from .files import telling
from .mcap_file import McapWriter

Tree = dict[str, Any]
#: Messages of a chunk: about a megabyte.
CHUNK_MESSAGES = 8192


class McapExport(Export):
    """`walk.mcap`."""

    format = "MCAP"
    suffix = ".mcap"

    def __init__(self, path: str, options: Options, variants: Sequence[Variant]) -> None:
        super().__init__(path, options, variants)
        self._channels: dict[str, int] = {}
        self._latest = 0
        self._untimed = 0
        try:
            with telling(path):
                self._file = McapWriter(self.place)
        except CallerError:
            self.abandon()
            raise

    @property
    def notes(self) -> list[str]:
        """What could not be written as it is."""
        if not self._untimed:
            return []
        return [f"{self._untimed} messages have no time; in the MCAP they have the time of the one before"]

    def _begin(self, dataset: Dataset) -> None:
        layout = dataset.layout
        topic = f"/{layout.protocol or '_lost'}" + (f"/{layout.message}" if layout.message else "")
        if dataset.name not in ("_lost", layout.message, f"{layout.protocol}.{layout.message}"):
            topic = f"/{layout.protocol}/{dataset.name}"
        schema = json_text(_schema(layout, names=self.options.names))
        self._channels[dataset.name] = self._file.channel(
            topic,
            f"{layout.protocol}.{layout.message}" if layout.message else "lost",
            schema.encode(),
            schema_metadata(layout, absolute=bool(self.absolute)),
        )

    def _write(
        self, tables: Sequence[MessageTable], source: str | None, columns: dict[str, list[str]]
    ) -> None:
        texts: list[bytes] = []
        times: list[int] = []
        rows: list[int] = []
        channels: list[int] = []
        encode = msgspec.json.Encoder().encode
        for table in tables:
            dataset = self._dataset(table, columns)
            dataset.rows += len(table)
            texts += map(encode, self._objects_of(table, dataset.layout, source))
            times += table.time.tolist()
            rows += table.row.tolist()
            channels += [self._channels[dataset.name]] * len(table)
        messages: list[tuple[int, int, bytes]] = []
        for index in np.argsort(np.array(rows, np.int64), kind="stable").tolist():
            time = times[index]
            if time == NO_TIME:
                self._untimed += 1
                time = self._latest
            self._latest = max(time, 0)
            messages.append((channels[index], self._latest, texts[index]))
        for start in range(0, len(messages), CHUNK_MESSAGES):
            self._file.chunk(messages[start : start + CHUNK_MESSAGES])

    def _objects_of(
        self, table: MessageTable, layout: DatasetLayout, source: str | None
    ) -> list[dict[str, Any]]:
        tree: Tree = {}
        for slot in layout.slots:
            if slot.kind is not None:
                _plant(tree, slot.kind.name, self._values(slot, table[slot.kind.name]))
        fields = _joined(tree, len(table))
        meta = self._meta(table, layout, source)
        return [{**one, "meta": other} for one, other in zip(fields, meta, strict=True)]

    def _values(self, slot: DatasetColumn, column: Column) -> list[Any]:
        if column.kind.is_object:
            return [plain_json(value) for value in column.to_list()]
        if column.kind.names is not None and self.options.names:
            return [value if value is None else str(value) for value in column.to_list()]
        return self._plain(slot, column.values, column.absent)

    def _meta(self, table: MessageTable, layout: DatasetLayout, source: str | None) -> list[dict[str, Any]]:
        block = layout.block(table, self.labels, self.sources, source)
        parts = {
            slot.name: self._plain(slot, values, absent)
            for slot, (values, absent) in zip(layout.slots, block, strict=True)
            if slot.kind is None and slot.role != "time"
        }
        return [dict(zip(parts, row, strict=True)) for row in zip(*parts.values(), strict=True)]

    def _commit(self) -> None:
        """Each chunk is with the system already."""

    def _finish(self) -> None:
        self._file.close()

    def _drop(self) -> None:
        if (file := getattr(self, "_file", None)) is not None:
            file.abandon()


def _plant(tree: Tree, path: str, values: Any) -> None:
    *way, last = path.split(".")
    for step in way:
        tree = tree.setdefault(step, {})
    tree[last] = values


def _is_list(tree: Tree) -> bool:
    return bool(tree) and list(tree) == [str(number) for number in range(len(tree))]


def _joined(tree: Tree, n: int) -> list[Any]:
    """The columns of a tree as one value a row: dicts, and lists where the steps are numbers."""
    if not tree:
        return [{} for _ in range(n)]
    columns = [_joined(one, n) if isinstance(one, dict) else one for one in tree.values()]
    if _is_list(tree):
        return [list(row) for row in zip(*columns, strict=True)]
    return [dict(zip(tree, row, strict=True)) for row in zip(*columns, strict=True)]


def _schema(layout: DatasetLayout, *, names: bool) -> dict[str, Any]:
    tree: Tree = {}
    for slot in layout.slots:
        if slot.kind is not None:
            _plant(tree, slot.kind.name, _leaf(slot, names=names))
    schema = _object(tree)
    meta = {
        slot.name: {"type": _JSON_TYPES.get(slot.holds, "integer"), "description": slot.doc}
        for slot in layout.slots
        if slot.kind is None and slot.role != "time"
    }
    schema["properties"]["meta"] = {"type": "object", "properties": meta}
    schema["title"] = layout.message
    if layout.doc:
        schema["description"] = layout.doc
    return schema


_JSON_TYPES = {"bool": "boolean", "label": "string", "bytes": "string", "text": "string", "wide": "string"}


class _Leaf(dict[str, Any]):
    """The schema of one value, which is no branch of the tree."""


def _object(tree: Tree) -> dict[str, Any]:
    return {"type": "object", "properties": {name: _branch(one) for name, one in tree.items()}}


def _branch(one: Any) -> dict[str, Any]:
    if isinstance(one, _Leaf):
        return dict(one)
    if _is_list(one):
        items = [_branch(item) for item in one.values()]
        return {"type": "array", "items": items[0], "minItems": len(items), "maxItems": len(items)}
    return _object(one)


def _leaf(slot: DatasetColumn, *, names: bool) -> _Leaf:
    kind = slot.kind
    assert kind is not None
    found = _Leaf()
    if slot.holds == "number":
        is_named = names and kind.names is not None
        found["type"] = "string" if is_named else "number" if slot.dtype.kind == "f" else "integer"
    elif slot.holds != "json":
        found["type"] = _JSON_TYPES.get(slot.holds, "integer")
    about = [text for text in (kind.doc, f"in {kind.unit}" if kind.unit else "") if text]
    if kind.names is not None:
        about.append(", ".join(f"{number} = {name}" for number, name in list(kind.names.items())[:64]))
    if kind.flags is not None:
        about.append(", ".join(f"bit {bit} = {name}" for name, bit in kind.flags.items()))
    if about:
        found["description"] = "; ".join(about)
    if kind.unit:
        found["unit"] = kind.unit
    return found
