"""Tables and datasets as Arrow, pandas and polars: the schema of a layout, its blocks as record batches, tables as frames.

1. A schema hangs on the layout and on three choices (names or numbers, absolute or relative time), on no value.
2. Units, enumerations, flags and docs are in the metadata of the fields; protocol, message and version in the schema's.

3. The columns are those of the files that `aces_bus.export` writes: `layout.py` says which.

Needs the extra `[columns]` (pyarrow); `to_pandas` needs pandas alone, `to_polars` polars and pyarrow.

    time      timestamp[ns, UTC] when the recording's times are absolute, else duration[ns]
    channel   dictionary of texts
    numbers   as in the table; enumerations stay numbers, or are dictionaries of names (`names=True`)
    absent    null; NaN stays NaN

Metadata of a field: `unit`, `doc`, `names` (JSON, number to name), `flags` (JSON, name to bit), `path` (its name in the
record), `holds` ("json" or "wide" where a text represents something else). Of the schema: `protocol`, `message`,
`direction`, `doc`, `time`, `aces_bus`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from ...errors import CallerError
from ...frame_table import NO_TIME
from ...version import __version__
from .layout import (
    ABSOLUTE_NS,
    Block,
    ColumnValues,
    DatasetColumn,
    DatasetLayout,
    Holds,
    Labels,
    objects_by_values,
)
from .table import Array, MessageTable, object_array

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow

#: Enumerations of wider numbers are plain texts: a dictionary of them could grow with the capture.
DICTIONARY_BYTES = 2


def load_pyarrow() -> Any:
    """Return the library; raises `CallerError` with how to install it."""
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
        """Return the codes of raw numbers; a number without a name is its own digits."""
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
        """Return the schema. `absolute`: whether times count from 1970; `names`: enumerations as texts."""
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
        """Return a block as a record batch."""
        pa = load_pyarrow()
        arrays = [
            self._array(pa, slot, type_, values)
            for slot, type_, values in zip(self.layout.slots, self.schema.types, block, strict=True)
        ]
        return pa.RecordBatch.from_arrays(arrays, schema=self.schema)

    def _array(self, pa: ModuleType, slot: DatasetColumn, type_: Any, piece: ColumnValues) -> Any:
        values, absent = piece
        if slot.holds == "label":
            names = self.sources.names if slot.role == "source" else self.labels.names
            return _dictionary(pa, values, absent, names)
        if slot.holds == "time":
            return _as_they_lie(pa, type_, values, np.int64, absent)
        if slot.name in self.enumerations:
            known = self.enumerations[slot.name]
            codes = known.codes(values)
            found = _dictionary(pa, codes, absent, known.labels.names)
            return found if pa.types.is_dictionary(type_) else found.cast(type_)
        if values.dtype == object:
            return _texts(pa, type_, values.tolist())
        return _as_they_lie(pa, type_, values, np.bool_ if slot.holds == "bool" else slot.dtype, absent)


def _dictionary(pa: ModuleType, codes: Array, absent: Array | None, names: list[str]) -> Any:
    indices = _as_they_lie(pa, pa.int32(), codes, np.int32, absent)
    return pa.DictionaryArray.from_arrays(indices, _texts(pa, pa.string(), names))


# `pa.array` begins by importing pandas where that is installed, which costs more than a small recording: what every
# batch has is made of buffers.


def _as_they_lie(pa: Any, type_: Any, values: Array, dtype: Any, absent: Array | None) -> Any:
    """Return numbers or truth values, in memory that Arrow shares if it can; `dtype` is NumPy's word for `type_`."""
    present = None if absent is None else pa.py_buffer(_bits(~absent))
    values = np.ascontiguousarray(values, dtype)
    data = _bits(values) if values.dtype == np.bool_ else values
    return pa.Array.from_buffers(type_, len(values), [present, pa.py_buffer(data)])


def _bits(flags: Array) -> Array:
    return np.packbits(flags, bitorder="little")


def _texts(pa: ModuleType, type_: Any, values: list[Any]) -> Any:
    """Return texts or bytes, None where there is none."""
    present = None
    if None in values:
        present = pa.py_buffer(_bits(np.array([value is not None for value in values])))
    if type_ == pa.string():
        values = [None if value is None else value.encode() for value in values]
    data = values if present is None else [value or b"" for value in values]
    ends = np.zeros(len(data) + 1, np.int64)
    np.cumsum(np.fromiter(map(len, data), np.int64, len(data)), out=ends[1:])
    if ends[-1] > np.iinfo(np.int32).max:  # more than an array can hold
        return pa.array(values, type_)
    buffers = [present, pa.py_buffer(ends.astype(np.int32)), pa.py_buffer(b"".join(data))]
    return pa.Array.from_buffers(type_, len(data), buffers)


def _type(pa: ModuleType, slot: DatasetColumn, *, absolute: bool, is_named: bool) -> Any:
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
    """Return what is known of a column, as texts."""
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
    """Return what is known of a dataset, as texts."""
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
    """Return JSON in one line."""
    return msgspec.json.encode(value).decode()


def is_absolute(time: Array) -> bool | None:
    """Return whether instants (int64, ns) count from 1970; None when none of them is known."""
    known = time[time != NO_TIME]
    return None if not len(known) else bool(known[0] >= ABSOLUTE_NS)


def to_arrow(
    table: MessageTable,
    *,
    names: bool = False,
    float32: bool = False,
    objects: Mapping[str, Holds] | None = None,
) -> pyarrow.Table:
    """Return the table as a `pyarrow.Table`. With `names` enumerations are dictionaries of names; with `float32`
    physical values
    have half the size. `objects` says what columns of Python objects hold (`layout.objects_of`), else their values do.

    Raises `CallerError` where pyarrow is missing.
    """
    pa = load_pyarrow()
    layout = DatasetLayout.of(
        table, objects_by_values(table) if objects is None else objects, float32=float32
    )
    labels, sources = Labels(), Labels()
    arrow = ArrowLayout.of(layout, labels, sources, absolute=bool(is_absolute(table.time)), names=names)
    return pa.Table.from_batches([arrow.batch(layout.block(table, labels, sources))], arrow.schema)


def to_polars(
    table: MessageTable, *, names: bool = False, float32: bool = False, **options: Any
) -> polars.DataFrame:
    """Return the table as a `polars.DataFrame`; arguments as `to_arrow`. Units are in the metadata of
    `to_arrow(table).schema`.

    Raises `CallerError` where polars or pyarrow is missing.
    """
    try:
        import polars
    except ImportError as missing:
        raise CallerError(f"polars is not installed: pip install polars ({missing})") from missing
    return polars.DataFrame(to_arrow(table, names=names, float32=float32, **options))


def to_pandas(table: MessageTable, *, names: bool = False, float32: bool = False) -> pandas.DataFrame:
    """Return the table as a `pandas.DataFrame`.

    `time` is datetime64[ns, UTC] or timedelta64[ns]; integers that may be absent are pandas' nullable ones; with `names`
    enumerations are categories; objects are as records have them. `frame.attrs` holds "protocol", "message",
    "direction", "doc", "time", "aces_bus", and under "columns" for each column what is known of it: "unit", "doc",
    "names", "flags", "path".

    Raises `CallerError` where pandas is missing.
    """
    try:
        import pandas
    except ImportError as missing:
        raise CallerError(f"pandas is not installed: pip install pandas ({missing})") from missing
    layout = DatasetLayout.of(table, objects_by_values(table), float32=float32)
    labels, sources = Labels(), Labels()
    absolute = bool(is_absolute(table.time))
    made: dict[str, Any] = {}
    for slot, values in zip(layout.slots, layout.block(table, labels, sources), strict=True):
        if slot.kind is not None and slot.kind.is_object:
            column = table[slot.kind.name]
            made[slot.name] = pandas.Series(object_array(column.to_list()), dtype=object)
        else:
            made[slot.name] = _series(pandas, slot, values, labels, absolute=absolute, names=names)
    frame = pandas.DataFrame(made)
    frame.attrs.update(schema_metadata(layout, absolute=absolute))
    frame.attrs["columns"] = {slot.name: known for slot in layout.slots if (known := field_metadata(slot))}
    return frame


def _series(
    pandas: Any, slot: DatasetColumn, piece: ColumnValues, labels: Labels, *, absolute: bool, names: bool
) -> Any:
    values, absent = piece
    if slot.holds == "time":  # NO_TIME is NaT
        if absolute:
            return pandas.DatetimeIndex(values.view("M8[ns]")).tz_localize("UTC")
        return pandas.TimedeltaIndex(values.view("m8[ns]"))
    if slot.holds == "label":
        return pandas.Categorical.from_codes(values, labels.names)
    if names and slot.kind is not None and slot.kind.names is not None:
        known = GrowingDictionary(slot.kind.names)
        codes = known.codes(values)
        if absent is not None:
            codes[absent] = -1
        return pandas.Categorical.from_codes(codes, known.labels.names)
    if absent is None:
        return values
    if values.dtype == bool:
        return pandas.arrays.BooleanArray(values, absent)
    if values.dtype.kind in "iu":
        return pandas.arrays.IntegerArray(values, absent)
    return np.where(absent, np.nan, values).astype(values.dtype)
