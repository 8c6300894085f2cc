"""Datasets as Arrow: the schema of a layout, and its blocks as record batches.

1. A schema hangs on the layout and on three choices (names or numbers, absolute or relative time), on no value.
2. Units, enumerations, flags and docs are in the metadata of the fields; protocol, message and version in the schema's.

Needs the extra `[columns]` (pyarrow).

    time      timestamp[ns, UTC] when the recording's times are absolute, else duration[ns]
    channel   dictionary of texts
    numbers   as in the table; enumerations stay numbers, or are dictionaries of names (`names=True`)
    absent    null; NaN stays NaN

Metadata of a field: `unit`, `doc`, `names` (JSON, number to name), `flags` (JSON, name to bit), `path` (its name in the
record), `holds` ("json" or "wide" where a text stands for something else). Of the schema: `protocol`, `message`,
`direction`, `doc`, `time`, `aces_bus`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from ... import __version__
from ...errors import CallerError
from .layout import Block, ColumnValues, DatasetColumn, DatasetLayout, Labels
from .table import Array

#: Enumerations of wider numbers are plain texts: a dictionary of them could grow with the capture.
DICTIONARY_BYTES = 2


def load_pyarrow() -> Any:
    """The library; raises `CallerError` with how to install it."""
    try:
        import pyarrow as pa
    except ImportError as missing:
        raise CallerError(
            f"Arrow, Parquet and folders of CSV need pyarrow: pip install 'aces-bus[columns]' ({missing})"
        ) from missing
    return pa


class GrowingDictionary:
    """An enumeration's names as a dictionary that only ever grows at its end, so that pieces may share it."""

    def __init__(self, names: Mapping[float, str]) -> None:
        self.known = dict(names)
        self.labels = Labels(self.known.values())
        self._codes = {number: self.labels.number(name) for number, name in self.known.items()}

    def codes(self, values: Array) -> Array:
        """The codes of raw numbers; a number without a name is its own digits."""
        numbers, places = np.unique(values, return_inverse=True)
        codes = self._codes
        for number in numbers.tolist():
            if number not in codes:
                codes[number] = self.labels.number(str(number))
        return np.array([codes[number] for number in numbers.tolist()] or [0], np.int32)[places]


@dataclass
class ArrowLayout:
    """A layout with its Arrow schema."""

    layout: DatasetLayout
    schema: Any
    enumerations: dict[str, GrowingDictionary]
    labels: Labels
    sources: Labels

    @classmethod
    def of(
        cls, layout: DatasetLayout, labels: Labels, sources: Labels, *, absolute: bool, names: bool = False
    ) -> ArrowLayout:
        """The schema. `absolute`: whether times count from 1970; `names`: enumerations as texts."""
        pa = load_pyarrow()
        enumerations = {
            slot.name: GrowingDictionary(slot.kind.names)
            for slot in layout.slots
            if names and slot.kind is not None and slot.kind.names is not None and slot.holds == "number"
        }
        fields = [
            pa.field(
                slot.name,
                _type(pa, slot, absolute=absolute, is_named=slot.name in enumerations),
                metadata=field_metadata(slot) or None,
            )
            for slot in layout.slots
        ]
        schema = pa.schema(fields, metadata=schema_metadata(layout, absolute=absolute))
        return cls(layout, schema, enumerations, labels, sources)

    def batch(self, block: Block) -> Any:
        """A block as a record batch."""
        pa = load_pyarrow()
        arrays = [
            self._array(pa, slot, type_, values)
            for slot, type_, values in zip(self.layout.slots, self.schema.types, block, strict=True)
        ]
        return pa.RecordBatch.from_arrays(arrays, schema=self.schema)

    def _array(self, pa: Any, slot: DatasetColumn, type_: Any, piece: ColumnValues) -> Any:
        values, absent = piece
        if slot.holds == "label":
            names = self.sources.names if slot.role == "source" else self.labels.names
            return _dictionary(pa, values, absent, names)
        if slot.holds == "time":
            return pa.array(values, pa.int64(), mask=absent, from_pandas=False).view(type_)
        if slot.name in self.enumerations:
            known = self.enumerations[slot.name]
            codes = known.codes(values)
            found = _dictionary(pa, codes, absent, known.labels.names)
            return found if pa.types.is_dictionary(type_) else found.cast(type_)
        if values.dtype == object:
            return pa.array(values.tolist(), type_)
        return pa.array(values, type_, mask=absent, from_pandas=False)


def _dictionary(pa: Any, codes: Array, absent: Array | None, names: list[str]) -> Any:
    indices = pa.array(codes, pa.int32(), mask=absent, from_pandas=False)
    return pa.DictionaryArray.from_arrays(indices, pa.array(names, pa.string()))


def _type(pa: Any, slot: DatasetColumn, *, absolute: bool, is_named: bool) -> Any:
    if slot.holds == "time":
        return pa.timestamp("ns", "UTC") if absolute else pa.duration("ns")
    if slot.holds == "label" or (is_named and slot.dtype.itemsize <= DICTIONARY_BYTES):
        return pa.dictionary(pa.int32(), pa.string())
    if slot.holds == "bool":
        return pa.bool_()
    if slot.holds == "bytes":
        return pa.binary()
    if is_named or slot.holds in ("text", "wide", "json"):
        return pa.string()
    return pa.from_numpy_dtype(slot.dtype)


def field_metadata(slot: DatasetColumn) -> dict[str, str]:
    """What is known of a column, as texts."""
    found: dict[str, str] = {}
    if slot.unit:
        found["unit"] = slot.unit
    if slot.doc:
        found["doc"] = slot.doc
    kind = slot.kind
    if kind is not None:
        if kind.name != slot.name:
            found["path"] = kind.name
        if kind.names is not None:
            found["names"] = json_text({str(number): name for number, name in kind.names.items()})
        if kind.flags is not None:
            found["flags"] = json_text(dict(kind.flags))
        if slot.holds in ("json", "wide"):
            found["holds"] = slot.holds
    return found


def schema_metadata(layout: DatasetLayout, *, absolute: bool) -> dict[str, str]:
    """What is known of a dataset, as texts."""
    found = {
        "protocol": layout.protocol,
        "message": layout.message,
        "direction": layout.direction or "",
        "doc": layout.doc,
        "time": "since 1970-01-01 UTC" if absolute else "as the recording counts it",
        "aces_bus": __version__,
    }
    return {name: text for name, text in found.items() if text}


def json_text(value: Any) -> str:
    """JSON in one line."""
    return msgspec.json.encode(value).decode()
