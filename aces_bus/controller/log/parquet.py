"""Logs as Parquet, which has its index at the end: until then rows stand in a journal beside it.

1. `walk.parquet.journal` is a stream of Arrow record batches, each of them whole; `walk.parquet` appears when the log is
   closed, with all rows, and the journal goes.
2. Whoever was killed leaves the journal: `read_log("walk.parquet")` reads it, `recover` makes the Parquet file of it.

Columns `time` (float64, seconds since the start) and the log's own, null where unknown; units in the fields' metadata, the
rest as JSON under `aces_log` in the schema's. Needs the extra `[columns]` (pyarrow).
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Generator, Iterator, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from ...errors import CallerError
from .base import About, AppendFile, LogSink, Row

KEY = b"aces_log"
#: Rows of a group: what readers take at once.
GROUP = 131_072


def import_pyarrow() -> Any:
    """The library; `CallerError` naming the extra when it is missing."""
    try:
        import pyarrow

        for part in ("ipc", "parquet"):
            import_module(f"pyarrow.{part}")
    except ImportError as missing:
        raise CallerError(f"Parquet needs pyarrow: pip install 'aces-bus[columns]' ({missing})") from missing
    return pyarrow


def journal_of(path: str) -> str:
    """Where a log that is not closed stands."""
    return path + ".journal"


class ParquetSink(LogSink):
    """`walk.parquet`."""

    format = "parquet"

    def __init__(self, path: str, about: About) -> None:
        pa = import_pyarrow()
        super().__init__(path, about)
        if os.path.isdir(path):
            raise IsADirectoryError(21, "is a folder", path)
        self._schema = _schema(pa, about)
        # The first batch of a program has the library import what it needs, for half a second: not while rows wait.
        self._batch([(0, [math.nan] * len(about.columns))])
        self._journal = AppendFile(journal_of(path))
        self._journal.write(self._schema.serialize().to_pybytes())
        if os.path.exists(path):
            os.remove(path)

    def append(self, rows: Sequence[Row]) -> None:
        """One record batch."""
        self._journal.write(self._batch(rows).serialize().to_pybytes())

    def _batch(self, rows: Sequence[Row]) -> Any:
        pa = import_pyarrow()
        table = np.array([values for _, values in rows], np.float64)
        table = table.reshape(len(rows), len(self.about.columns))
        seconds = np.array([ns for ns, _ in rows], np.int64) / 1e9
        arrays = [pa.array(seconds)]
        for column in table.T:
            arrays.append(pa.array(np.ascontiguousarray(column), from_pandas=True))  # NaN is null
        return pa.RecordBatch.from_arrays(arrays, schema=self._schema)

    def sync(self) -> None:
        """To the disk."""
        self._journal.sync()

    def close(self) -> None:
        """Make the Parquet file of the journal."""
        self._journal.close()
        recover_parquet(self.path)


def _schema(pa: Any, about: About) -> Any:
    fields = [pa.field("time", pa.float64(), nullable=False, metadata={"unit": "s"})]
    for column in about.columns:
        metadata = {"unit": column.unit, "state": column.state, "attribute": column.attribute}
        fields.append(pa.field(column.name, pa.float64(), metadata=metadata))
    return pa.schema(fields, metadata={KEY: about.to_json().encode()})


@contextlib.contextmanager
def opened_journal(path: str) -> Generator[Any]:
    """A reader of record batches; raises `CallerError` for what is no journal."""
    pa = import_pyarrow()
    try:
        with open(path, "rb") as file:
            yield pa.ipc.open_stream(file)
    except pa.ArrowException as error:
        raise CallerError(f"{path}: no journal of a log: {error}") from None


def batches_of(reader: Any) -> Iterator[Any]:
    """Its batches, up to where it was cut."""
    pa = import_pyarrow()
    while True:
        try:
            batch = reader.read_next_batch()
        except (StopIteration, EOFError, pa.ArrowException, OSError):
            return
        yield batch


def recover_parquet(path: str) -> int:
    """Make the Parquet file `path` of its journal, which then goes; returns the number of rows.

    Raises `CallerError` for what is no journal and `OSError` when the file cannot be written; the journal stays then.
    """
    pa = import_pyarrow()
    journal = journal_of(path)
    made = path + ".part"
    rows = 0
    try:
        with opened_journal(journal) as reader:
            schema = reader.schema
            with pa.parquet.ParquetWriter(
                made,
                schema,
                compression="zstd",
                use_dictionary=False,
                column_encoding=dict.fromkeys(schema.names, "BYTE_STREAM_SPLIT"),
            ) as writer:
                kept: list[Any] = []
                waiting = 0
                for batch in batches_of(reader):
                    kept.append(batch)
                    waiting += batch.num_rows
                    if waiting >= GROUP:
                        rows, waiting = rows + _flush(pa, writer, kept, schema), 0
                rows += _flush(pa, writer, kept, schema)
        os.replace(made, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.remove(made)
        raise
    os.remove(journal)
    return rows


def _flush(pa: Any, writer: Any, kept: list[Any], schema: Any) -> int:
    if not kept:
        return 0
    table = pa.Table.from_batches(kept, schema=schema).combine_chunks()
    kept.clear()
    writer.write_table(table, row_group_size=GROUP)
    return int(table.num_rows)
