"""One file a message: what Parquet, Arrow and CSV have in common, and Arrow's own file format (also known as Feather 2).

1. A single wanted message is a file; otherwise the export is a folder of them.
2. Pieces become record batches here; a format only writes them, on a thread of its own.
3. Arrow's dictionaries grow at their end only, and are written as what has come to them: readers join the pieces.
"""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, BinaryIO

from ..errors import CallerError
from ..protocol.columns.arrow import ArrowLayout, load_pyarrow
from ..protocol.columns.layout import Block
from ..protocol.declare.protocol import Variant
from .base import Buffered, Dataset, Options
from .behind import Behind
from .files import ExportFile, FilePool

#: Bytes that are written to a file at once, but for larger pieces: each waits for Python's lock.
BUFFER = 1 << 16


class Folder(Buffered):
    """A folder of datasets, each with a writer of pyarrow."""

    is_folder = True

    def __init__(self, path: str, options: Options, variants: Sequence[Variant]) -> None:
        load_pyarrow()
        self._pool = FilePool(path)
        self._behind = Behind()
        #: By dataset: its layout, its writer and the stream that this writes to, its path.
        self._writers: dict[str, tuple[ArrowLayout, Any, Any, str]] = {}
        super().__init__(path, options, variants)

    def _begin(self, dataset: Dataset) -> None:
        if not self.makes_folder and len(self._all()) > 1:
            raise CallerError(
                f"{self.path}: this file is for {self.options.only} alone, and {dataset.layout.message} came too;"
                " leave `only` out to write a folder"
            )

    def _file(self, dataset: Dataset) -> str:
        return os.path.join(self.place, f"{dataset.name}{self.suffix}") if self.makes_folder else self.place

    def _writer(self, dataset: Dataset) -> tuple[ArrowLayout, Any, Any, str]:
        found = self._writers.get(dataset.name)
        if found is None:
            arrow = ArrowLayout.of(
                dataset.layout,
                self.labels,
                self.sources,
                absolute=bool(self.absolute),
                names=self.options.names,
            )
            path = self._file(dataset)
            pa = load_pyarrow()
            stream = pa.BufferedOutputStream(pa.PythonFile(ExportFile(self._pool, path), "w"), BUFFER)
            found = self._writers[dataset.name] = (arrow, self._open(arrow, stream), stream, path)
        return found

    def _emit(self, dataset: Dataset, block: Block) -> None:
        arrow, writer, _, _ = self._writer(dataset)
        batch = self._batch(arrow, block)
        self._behind.do(dataset.name, lambda: self._put(writer, batch))

    def _end(self, dataset: Dataset) -> None:
        _, writer, stream, path = self._writer(dataset)
        del self._writers[dataset.name]

        def end() -> None:
            writer.close()
            stream.close()
            self._pool.release(path)

        self._behind.do(dataset.name, end)

    def _finish(self) -> None:
        super()._finish()
        self._behind.wait()
        self._behind.stop()
        self._pool.close()

    def _drop(self) -> None:
        self._behind.stop()
        self._pool.abandon()
        self._writers.clear()

    @abstractmethod
    def _open(self, arrow: ArrowLayout, stream: BinaryIO) -> Any:
        """Open a writer into a stream of Arrow's, which has `close`."""

    def _batch(self, arrow: ArrowLayout, block: Block) -> Any:
        """Return rows as the record batch that is written."""
        return arrow.batch(block)

    def _put(self, writer: Any, batch: Any) -> None:
        """Write rows. It is called on another thread than the rest, and touches nothing but its arguments."""
        writer.write_batch(batch)


class ArrowExport(Folder):
    """`walk.arrow/Encoder.arrow`, or of a single message `walk.arrow`."""

    format = "Arrow"
    suffix = ".arrow"

    def _open(self, arrow: ArrowLayout, stream: BinaryIO) -> Any:
        import pyarrow as pa

        options = pa.ipc.IpcWriteOptions(compression="lz4", emit_dictionary_deltas=True)
        return pa.ipc.new_file(stream, arrow.schema, options=options)

    def _batch(self, arrow: ArrowLayout, block: Block) -> Any:
        if not arrow.labels.names:
            arrow.labels.number("")  # Arrow takes what comes to an empty dictionary for another one
        return arrow.batch(block)


class FeatherExport(ArrowExport):
    """The same under its other suffix."""

    format = "Feather"
    suffix = ".feather"
