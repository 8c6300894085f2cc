"""Parquet that grows: a folder of parts for each message, which readers of Parquet take for one table.

    walk.parquet/Encoder.parquet/part-00000.parquet     131,072 rows, whole
    walk.parquet/Encoder.parquet/_part-00001.arrows     what came since, a stream of Arrow batches

1. A Parquet file has its index at its end, so rows wait in a journal beside it: Arrow's stream format, which pyarrow reads
   as far as it goes. Readers of the folder leave out what begins with `_`.
2. When a journal is full, and when the export is closed, it becomes a part and goes.
3. What a killed program left, `recover_parts` makes whole.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, BinaryIO

from ..errors import CallerError
from ..protocol.columns.arrow import ArrowLayout
from ..protocol.columns.layout import Block
from ..protocol.declare.protocol import Variant
from .base import ROWS, Dataset, Options
from .files import telling
from .folder import ArrowExport
from .parquet import parquet_of_journal

_BEGINNING, _END = "_part-", ".arrows"


class ParquetParts(ArrowExport):
    """`walk.parquet/Encoder.parquet/part-00000.parquet`, or of a single message `walk.parquet/part-00000.parquet`."""

    format = "Parquet"
    suffix = ".parquet"

    def __init__(self, path: str, options: Options, variants: Sequence[Variant]) -> None:
        #: Rows in the journal of each dataset.
        self._waiting: dict[str, int] = {}
        super().__init__(path, options, variants)

    def _file(self, dataset: Dataset) -> str:
        """Return the journal of the next part."""
        folder = os.path.join(self.place, f"{dataset.name}.parquet") if self.makes_folder else self.place
        with telling(self.path):
            os.makedirs(folder, exist_ok=True)
            number = sum(name.startswith("part-") for name in os.listdir(folder))
        return os.path.join(folder, f"{_BEGINNING}{number:05}{_END}")

    def _open(self, arrow: ArrowLayout, stream: BinaryIO) -> Any:
        import pyarrow as pa

        options = pa.ipc.IpcWriteOptions(emit_dictionary_deltas=True)
        return pa.ipc.new_stream(stream, arrow.schema, options=options)

    def _emit(self, dataset: Dataset, block: Block) -> None:
        super()._emit(dataset, block)
        self._waiting[dataset.name] = self._waiting.get(dataset.name, 0) + len(block[0].values)
        if self._waiting[dataset.name] >= ROWS:
            self._end(dataset)

    def _end(self, dataset: Dataset) -> None:
        if dataset.name in self._writers:
            path = self._writers[dataset.name][-1]
            super()._end(dataset)
            self._behind.wait()
            self._waiting[dataset.name] = 0
            with telling(self.path):
                _close_part(path)

    def _commit(self) -> None:
        super()._commit()
        self._behind.wait()
        for _, _, stream, _ in self._writers.values():
            stream.flush()
        self._pool.flush()


def _close_part(journal: str) -> int:
    """Make the journal a part, which takes its place; the number of rows."""
    folder, name = os.path.split(journal)
    part = name.removeprefix("_").removesuffix(_END) + ".parquet"
    return parquet_of_journal(journal, os.path.join(folder, part))


def recover_parts(path: str | os.PathLike[str]) -> int:
    """Make parts of the journals that a killed program left in a folder of Parquet; the number of rows.

    A journal without a byte had no row yet, and goes. Raises `CallerError` where there is none; and for one that cannot be
    read, when the others are parts.
    """
    text = os.fspath(path)
    with telling(text):
        journals = [
            os.path.join(folder, name)
            for folder, _, names in os.walk(text)
            for name in sorted(names)
            if name.startswith(_BEGINNING) and name.endswith(_END)
        ]
        if not journals:
            raise CallerError(f"{text}: was closed, or is not a folder of Parquet; nothing is to recover")
        rows, failed = 0, list[CallerError]()
        for journal in journals:
            if not os.path.getsize(journal):
                os.remove(journal)
                continue
            try:
                rows += _close_part(journal)
            except CallerError as error:
                failed.append(error)
        if failed:
            raise failed[0]
        return rows
