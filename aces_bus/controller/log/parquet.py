"""Logs as Parquet, which has its index at the end: until then rows are in a journal beside it.

1. `walk.parquet.journal` is a stream of Arrow record batches, each of them whole; `walk.parquet` appears when the log is
   closed, with all rows, and the journal goes. `read_log("walk.parquet")` reads the journal of a writer that was killed,
   `recover` makes the Parquet file of it.
2. A file that is read is not trusted: types and numbers are looked at before values are.

Columns `time` (float64, seconds since the start) and the log's own, null where unknown; units in the fields' metadata, the
rest as JSON under `aces_log` in the schema's. Needs the extra `[columns]` (pyarrow).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ...errors import CallerError
from ...export.parquet import ParquetJournal, journal_batches, load_parquet, opened_journal
from .base import About, Floats, Log, LogError, LogSink, Row, about_columns
from .columns import MOST_COLUMNS

KEY = b"aces_log"


class ParquetSink(LogSink):
    """`walk.parquet`."""

    def __init__(self, path: str, about: About) -> None:
        super().__init__(path, about)
        pa = load_parquet()
        fields = [pa.field("time", pa.float64(), nullable=False, metadata={"unit": "s"})]
        for column in about.columns:
            metadata = {"unit": column.unit, "state": column.state, "attribute": column.attribute}
            fields.append(pa.field(column.name, pa.float64(), metadata=metadata))
        self._schema = pa.schema(fields, metadata={KEY: about.to_json().encode()})
        # The first batch of a program has the library import what it needs, for half a second: not while rows wait.
        self._batch([(0, [math.nan] * len(about.columns))])
        self._file: ParquetJournal = ParquetJournal(path, self._schema)

    def append(self, rows: Sequence[Row]) -> None:
        """Write one record batch."""
        self._file.append(self._batch(rows))

    def _batch(self, rows: Sequence[Row]) -> Any:
        pa = load_parquet()
        table = np.array([values for _, values in rows], np.float64)
        table = table.reshape(len(rows), len(self.about.columns))
        arrays = [pa.array(np.array([ns for ns, _ in rows], np.int64) / 1e9)]
        arrays += [
            pa.array(np.ascontiguousarray(column), from_pandas=True) for column in table.T
        ]  # NaN: null
        return pa.RecordBatch.from_arrays(arrays, schema=self._schema)


def read_parquet_log(path: str, most_numbers: int) -> Log:
    """Read a Parquet file whose first column is `time`."""
    pa = load_parquet()
    try:
        with pa.parquet.ParquetFile(path) as file:
            return _read(path, file.schema_arrow, file.iter_batches(65_536), most_numbers, [])
    except (pa.ArrowException, OSError, ValueError) as error:
        raise LogError(f"{path}: a Parquet file that cannot be read: {error}") from None


def read_journal(path: str, most_numbers: int) -> Log:
    """Read the journal of a log that was not closed."""
    pa = load_parquet()
    try:
        with opened_journal(path) as reader:
            notes = [Log.NOT_CLOSED.format(path)]
            return _read(path, reader.schema, journal_batches(reader), most_numbers, notes)
    except LogError:
        raise
    except (CallerError, pa.ArrowException, OSError, ValueError) as error:
        raise LogError(f"{path}: {error}") from None


def _read(path: str, schema: Any, batches: Iterable[Any], most_numbers: int, notes: list[str]) -> Log:
    names = list(schema.names)
    if len(names) < 2 or names[0] != "time":
        raise LogError(f"{path}: its first column is not `time`: no log")
    if len(names) > MOST_COLUMNS + 1:
        raise LogError(f"{path}: more than {MOST_COLUMNS} columns")
    types = load_parquet().types
    for field in schema:
        if not (types.is_floating(field.type) or types.is_integer(field.type)):
            raise LogError(f"{path}: the column {field.name[:80]!r} is {field.type}: a log has numbers")
    about = about_columns(path, (schema.metadata or {}).get(KEY, b""), names[1:])
    parts = [np.empty((0, len(names)))]
    numbers = 0
    for batch in batches:
        numbers += batch.num_rows * len(names)
        if numbers > most_numbers:
            raise LogError(f"{path}: more than {most_numbers} numbers; read it with pyarrow, in parts")
        parts.append(_numbers(batch))
    return Log.of_table(path, "parquet", about, np.concatenate(parts), notes)


def _numbers(batch: Any) -> Floats:
    """Return a batch as (rows, columns), NaN for null. Arrow's own reader takes lengths on trust; `validate`
    does not.
    """
    batch.validate(full=True)
    columns = [np.asarray(column.to_numpy(zero_copy_only=False), np.float64) for column in batch.columns]
    return np.stack(columns, axis=1)
