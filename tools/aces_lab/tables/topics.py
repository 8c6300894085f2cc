"""Tables as JSON messages on topics, as Foxglove and PlotJuggler read them: in a file (`mcap`), and live (`access`).

1. A message's JSON schema names every field with its unit; it hangs on the plan and not on values. A file and a live view
   of the same messages have the same topics, schemas and objects, for both are made here.
2. What is given with the instants of a capture keeps its order.

Topic `/protocol/Message`; the fields are nested as in a record, and under `meta` are `channel`, `id` (CAN) or `offset`,
`size` (streams), `rx`, and `source` where several captures are joined. Enumerations are numbers, which can be plotted, or
with `names` names; bytes are hexadecimal. What was not decoded is on `/_lost`. States are on `/states`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import msgspec
import numpy as np

from aces_bus.export.base import LOST, Dataset, Datasets
from aces_bus.frame_table import NO_TIME
from aces_bus.protocol.columns.arrow import json_text, schema_metadata
from aces_bus.protocol.columns.layout import DatasetColumn, DatasetLayout, plain_json
from aces_bus.protocol.columns.table import Column, MessageTable

Tree = dict[str, Any]
#: States, a row an object.
STATES_TOPIC = "/states"
#: A message on its way: its channel, its instant (ns), its JSON.
TopicMessage = tuple[int, int, bytes]


class ChannelSink(Protocol):
    """Where messages go: a file, or a server."""

    def channel(self, topic: str, title: str, schema: bytes, metadata: Mapping[str, str]) -> int:
        """Declare a channel of messages that a JSON schema describes; returns its number."""
        ...


class TableTopics:
    """Tables as messages on the channels of a sink. `datasets` begins a channel where it begins a dataset: by `begin`."""

    def __init__(self, datasets: Datasets, sink: ChannelSink) -> None:
        self._datasets, self._sink = datasets, sink
        self._channels: dict[str, int] = {}
        self._latest = 0
        #: Messages without a time: they have that of the latest one that has one.
        self.untimed = 0
        self._encode = msgspec.json.Encoder().encode

    def begin(self, dataset: Dataset) -> None:
        """Declare the channel of a message that has occurred for the first time."""
        layout = dataset.layout
        topic = f"/{layout.protocol or LOST}" + (f"/{layout.message}" if layout.message else "")
        if dataset.name not in (LOST, layout.message, f"{layout.protocol}.{layout.message}"):
            topic = f"/{layout.protocol}/{dataset.name}"
        schema = json_text(_schema(layout, names=self._datasets.options.names))
        self._channels[dataset.name] = self._sink.channel(
            topic,
            f"{layout.protocol}.{layout.message}" if layout.message else "lost",
            schema.encode(),
            schema_metadata(layout, absolute=bool(self._datasets.absolute)),
        )

    def messages(
        self,
        tables: Sequence[MessageTable],
        source: str | None = None,
        columns: Mapping[str, list[str]] | None = None,
        is_wanted: Callable[[int], bool] | None = None,
    ) -> list[TopicMessage]:
        """Return the messages of tables (none of them empty), in the order of the capture; of channels that are wanted."""
        texts: list[bytes] = []
        times: list[int] = []
        rows: list[int] = []
        channels: list[int] = []
        for table in tables:
            dataset = self._datasets.dataset(table, columns or {})
            channel = self._channels[dataset.name]
            if is_wanted is not None and not is_wanted(channel):
                continue
            dataset.rows += len(table)
            texts += map(self._encode, self._objects_of(table, dataset.layout, source))
            times += table.time.tolist()
            rows += table.row.tolist()
            channels += [channel] * len(table)
        messages: list[TopicMessage] = []
        for index in np.argsort(np.array(rows, np.int64), kind="stable").tolist():
            time = times[index]
            if time == NO_TIME:
                self.untimed += 1
                time = self._latest
            self._latest = max(time, 0)
            messages.append((channels[index], self._latest, texts[index]))
        return messages

    def _objects_of(
        self, table: MessageTable, layout: DatasetLayout, source: str | None
    ) -> list[dict[str, Any]]:
        tree: Tree = {}
        for slot in layout.slots:
            if slot.kind is not None:
                _plant(tree, slot.kind.name, self._values(slot, table[slot.kind.name]))
        fields = _joined(tree, len(table))
        meta = self._meta(table, layout, source)
        return [{**branch, "meta": other} for branch, other in zip(fields, meta, strict=True)]

    def _values(self, slot: DatasetColumn, column: Column) -> list[Any]:
        if column.kind.is_object:
            return [plain_json(value) for value in column.to_list()]
        if column.kind.names is not None and self._datasets.options.names:
            return [value if value is None else str(value) for value in column.to_list()]
        return self._datasets.plain(slot, column.values, column.absent)

    def _meta(self, table: MessageTable, layout: DatasetLayout, source: str | None) -> list[dict[str, Any]]:
        block = layout.block(table, self._datasets.labels, self._datasets.sources, source)
        parts = {
            slot.name: self._datasets.plain(slot, values, absent)
            for slot, (values, absent) in zip(layout.slots, block, strict=True)
            if slot.kind is None and slot.role != "time"
        }
        return [dict(zip(parts, row, strict=True)) for row in zip(*parts.values(), strict=True)]


def _plant(tree: Tree, path: str, values: Any) -> None:
    *way, last = path.split(".")
    for step in way:
        tree = tree.setdefault(step, {})
    tree[last] = values


def _is_list(tree: Tree) -> bool:
    return bool(tree) and list(tree) == [str(number) for number in range(len(tree))]


def _joined(tree: Tree, n: int) -> list[Any]:
    """Return the columns of a tree as one value a row: dicts, and lists where the steps are numbers."""
    if not tree:
        return [{} for _ in range(n)]
    columns = [_joined(branch, n) if isinstance(branch, dict) else branch for branch in tree.values()]
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
    """The schema of one value, which is not a branch of the tree."""


def _object(tree: Tree) -> dict[str, Any]:
    return {"type": "object", "properties": {name: _branch(branch) for name, branch in tree.items()}}


def _branch(branch: Any) -> dict[str, Any]:
    if isinstance(branch, _Leaf):
        return dict(branch)
    if _is_list(branch):
        items = [_branch(item) for item in branch.values()]
        return {"type": "array", "items": items[0], "minItems": len(items), "maxItems": len(items)}
    return _object(branch)


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


# ---------------------------------------------------------------------- what has a schema of its own


def states_schema(units: Mapping[str, str]) -> bytes:
    """Return the schema of rows of states: unit ("" where there is none) by name."""
    properties: dict[str, dict[str, str]] = {}
    for name, unit in units.items():
        properties[name] = {"type": "number", **({"unit": unit, "description": f"in {unit}"} if unit else {})}
    return msgspec.json.encode({"type": "object", "title": "states", "properties": properties})
