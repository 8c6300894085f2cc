"""CSV in columns: a folder with one file a message, one column a field.

1. A cell says what a record line of `aces decode --format csv` says, but for flags, which are numbers: enumerations by
   name, bytes as hexadecimal, times in seconds with all their digits, nothing where a value is absent.
2. A text that a spreadsheet would take for a formula (it begins with = + - @, a tab or CR, and is not a number)
   has an apostrophe in front.
3. What CSV cannot say (units, enumerations, docs) is in `_columns.csv` of the folder.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, BinaryIO

import numpy as np

from ..plain_text import FORMULA, NUMBER, cell_text
from ..protocol.columns.arrow import ArrowLayout, field_metadata
from ..protocol.columns.layout import Block
from ..protocol.declare.protocol import Variant
from .base import Options
from .folder import Folder

COLUMNS = "_columns"


class CsvExport(Folder):
    """`walk.csv/Encoder.csv`."""

    format = "CSV"
    suffix = ".csv"
    rows_at_once = 1 << 16

    def __init__(self, path: str, options: Options, variants: Sequence[Variant]) -> None:
        super().__init__(path, replace(options, names=True), variants)

    def _reserved(self) -> Sequence[str]:
        return [COLUMNS]

    def _open(self, arrow: ArrowLayout, stream: BinaryIO) -> Any:
        import pyarrow as pa
        import pyarrow.csv

        texts = {"time": pa.string()}
        schema = pa.schema(
            [
                (
                    slot.name,
                    texts.get(
                        slot.role,
                        pa.string() if slot.holds == "bytes" or pa.types.is_dictionary(type_) else type_,
                    ),
                )
                for slot, type_ in zip(arrow.layout.slots, arrow.schema.types, strict=True)
            ]
        )
        return pyarrow.csv.CSVWriter(stream, schema)

    def _batch(self, arrow: ArrowLayout, block: Block) -> Any:
        import pyarrow as pa

        columns: list[Any] = []
        batch = arrow.batch(block)
        for slot, column, (values, absent) in zip(arrow.layout.slots, batch.columns, block, strict=True):
            if slot.role == "time":
                column = pa.array(seconds(values), pa.string(), mask=absent)
            elif slot.holds == "bytes":
                column = pa.array(
                    [None if value is None else value.hex() for value in values.tolist()], pa.string()
                )
            elif pa.types.is_dictionary(column.type):
                column = _guarded(column.dictionary.cast(pa.string())).take(column.indices)
            elif pa.types.is_string(column.type):
                column = _guarded(column)
            columns.append(column)
        return pa.RecordBatch.from_arrays(columns, names=batch.schema.names)

    def _finish(self) -> None:
        datasets = self._all()
        super()._finish()
        if not self.makes_folder:
            return
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(["dataset", "protocol", "message", "column", "unit", "doc", "names", "flags"])
        for dataset in datasets:
            for slot in dataset.layout.slots:
                known = field_metadata(slot)
                row = [known.get(name, "") for name in ("unit", "doc", "names", "flags")]
                if slot.role == "time":
                    row[0] = "s"
                head = [dataset.name, dataset.layout.protocol, dataset.layout.message, slot.name]
                table.writerow([cell_text(cell) for cell in (*head, *row)])
        with open(os.path.join(self.place, f"{COLUMNS}.csv"), "w", encoding="utf-8", newline="") as file:
            file.write(text.getvalue())


def _guarded(texts: Any) -> Any:
    """Return a column of texts with an apostrophe before what would be taken for a formula."""
    import pyarrow.compute as pc

    begins = pc.match_substring_regex(texts, FORMULA)
    if not pc.any(begins).as_py():
        return texts
    guarded = pc.and_(begins, pc.invert(pc.match_substring_regex(texts, NUMBER)))
    return pc.if_else(guarded, pc.binary_join_element_wise("'", texts, ""), texts)


def seconds(time: Any) -> list[str]:
    """Return instants in ns as seconds with nine decimal places."""
    whole, rest = np.divmod(np.abs(time), 1_000_000_000)
    signs = ["-" if early else "" for early in (time < 0).tolist()]
    return [
        f"{sign}{whole_seconds}.{other:09d}"
        for sign, whole_seconds, other in zip(signs, whole.tolist(), rest.tolist(), strict=True)
    ]


__all__ = ["CsvExport", "seconds"]
