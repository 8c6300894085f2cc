"""Logs as Parquet, read back; and the journal of one that was never closed.

1. A file is untrusted: types and numbers are looked at before values are, and what the library finds wrong is a `LogError`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import CallerError
from .base import About, about_of
from .columns import MOST_COLUMNS
from .parquet import KEY, batches_of, import_pyarrow, opened_journal
from .table import MOST_NUMBERS, Floats, Log, LogError, made_log, named_columns


def read_parquet_log(path: str, *, most_numbers: int = MOST_NUMBERS) -> Log:
    """Read a Parquet file whose first column is `time`."""
    pa = import_pyarrow()
    parts: list[Floats] = []
    rows = 0
    try:
        with pa.parquet.ParquetFile(path) as file:
            about = _about(path, pa, file.schema_arrow)
            width = 1 + len(about.columns)
            if file.metadata.num_rows * width > most_numbers:
                raise LogError(f"{path}: more than {most_numbers} numbers; read it with pyarrow, in parts")
            for batch in file.iter_batches(65_536):
                rows = _bounded(path, rows + batch.num_rows, width, most_numbers)
                parts.append(_numbers(batch))
    except (pa.ArrowException, OSError, ValueError) as error:
        raise LogError(f"{path}: a Parquet file that cannot be read: {error}") from None
    return _joined(path, "parquet", about, parts, [])


def read_journal(path: str, *, most_numbers: int = MOST_NUMBERS) -> Log:
    """Read the journal of a log that was not closed."""
    pa = import_pyarrow()
    parts: list[Floats] = []
    rows = 0
    try:
        with opened_journal(path) as reader:
            about = _about(path, pa, reader.schema)
            width = 1 + len(about.columns)
            for batch in batches_of(reader):
                rows = _bounded(path, rows + batch.num_rows, width, most_numbers)
                parts.append(_numbers(batch))
    except LogError:
        raise
    except (CallerError, pa.ArrowException, OSError, ValueError) as error:
        raise LogError(f"{path}: {error}") from None
    note = f"{path}: the log was not closed, and is read as far as it was written"
    return _joined(path, "parquet", about, parts, [note])


def _bounded(path: str, rows: int, width: int, most_numbers: int) -> int:
    if rows * width > most_numbers:
        raise LogError(f"{path}: more than {most_numbers} numbers; read it with pyarrow, in parts")
    return rows


def _about(path: str, pa: Any, schema: Any) -> About:
    names = list(schema.names)
    if len(names) < 2 or names[0] != "time":
        raise LogError(f"{path}: its first column is not `time`: no log")
    if len(names) > MOST_COLUMNS + 1:
        raise LogError(f"{path}: more than {MOST_COLUMNS} columns")
    for field in schema:
        if not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type)):
            raise LogError(f"{path}: the column {field.name[:80]!r} is {field.type}: a log has numbers")
    about = about_of((schema.metadata or {}).get(KEY, b""))
    if about is None or about.names != names[1:]:
        about = About(named_columns(path, names[1:]))
    return about


def _numbers(batch: Any) -> Floats:
    """(rows, columns) of a batch, NaN for null. Arrow's own reader takes lengths on trust; `validate` does not."""
    batch.validate(full=True)
    columns = [np.asarray(column.to_numpy(zero_copy_only=False), np.float64) for column in batch.columns]
    return np.stack(columns, axis=1)


def _joined(path: str, format: str, about: About, parts: list[Floats], notes: list[str]) -> Log:
    table = np.concatenate(parts) if parts else np.empty((0, 1 + len(about.columns)))
    return made_log(path, format, about, table, notes)
