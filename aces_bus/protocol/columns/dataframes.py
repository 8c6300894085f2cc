"""A table as Arrow, pandas or polars has it.

1. The columns are those of the files that `aces_bus.export` writes: `layout.py` says which.

`to_arrow` needs the extra `[columns]`; `to_pandas` needs pandas; `to_polars` needs polars and pyarrow.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...errors import CallerError
from ...frame_table import NO_TIME
from .arrow import ArrowLayout, GrowingDictionary, field_metadata, schema_metadata
from .layout import (
    ABSOLUTE_NS,
    ColumnValues,
    DatasetColumn,
    DatasetLayout,
    Holds,
    Labels,
    objects_by_values,
)
from .table import Array, MessageTable


def is_absolute(time: Array) -> bool | None:
    """Whether instants (int64, ns) count from 1970; None when none of them is known."""
    known = time[time != NO_TIME]
    return None if not len(known) else bool(known[0] >= ABSOLUTE_NS)


def to_arrow(
    table: MessageTable,
    *,
    names: bool = False,
    float32: bool = False,
    objects: Mapping[str, Holds] | None = None,
) -> Any:
    """The table as a `pyarrow.Table`. With `names` enumerations are dictionaries of names; with `float32` physical values
    have half the size. `objects` says what columns of Python objects hold (`layout.objects_of`), else their values do.

    Raises `CallerError` where pyarrow is missing.
    """
    from .arrow import load_pyarrow

    pa = load_pyarrow()
    layout = DatasetLayout.of(
        table, objects_by_values(table) if objects is None else objects, float32=float32
    )
    labels, sources = Labels(), Labels()
    arrow = ArrowLayout.of(layout, labels, sources, absolute=bool(is_absolute(table.time)), names=names)
    return pa.Table.from_batches([arrow.batch(layout.block(table, labels, sources))], arrow.schema)


def to_polars(table: MessageTable, *, names: bool = False, float32: bool = False, **options: Any) -> Any:
    """The table as a `polars.DataFrame`; arguments as `to_arrow`. Units are in the metadata of `to_arrow(table).schema`.

    Raises `CallerError` where polars or pyarrow is missing.
    """
    try:
        import polars
    except ImportError as missing:
        raise CallerError(f"polars is not installed: pip install polars ({missing})") from missing
    return polars.from_arrow(to_arrow(table, names=names, float32=float32, **options))


def to_pandas(table: MessageTable, *, names: bool = False, float32: bool = False) -> Any:
    """The table as a `pandas.DataFrame`.

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
            made[slot.name] = pandas.Series(_objects(column.to_list()), dtype=object)
        else:
            made[slot.name] = _series(pandas, slot, values, labels, absolute=absolute, names=names)
    frame = pandas.DataFrame(made)
    frame.attrs.update(schema_metadata(layout, absolute=absolute))
    frame.attrs["columns"] = {slot.name: known for slot in layout.slots if (known := field_metadata(slot))}
    return frame


def _objects(values: list[Any]) -> Array:
    array = np.empty(len(values), object)
    array[:] = values
    return array


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


__all__ = ["is_absolute", "to_arrow", "to_pandas", "to_polars"]
