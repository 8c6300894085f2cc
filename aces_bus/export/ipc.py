"""Arrow's own file format (also known as Feather 2): one file a message, laid out as Parquet's is.

1. Dictionaries grow at their end only, and are written as what has come to them: readers join the pieces.
"""

from __future__ import annotations

from typing import Any

from ..protocol.columns.arrow import ArrowLayout
from ..protocol.columns.layout import Block
from .files import ExportFile
from .folder import Folder


class ArrowExport(Folder):
    """`walk.arrow/Encoder.arrow`, or of a single message `walk.arrow`."""

    format = "Arrow"
    suffix = ".arrow"

    def _open(self, arrow: ArrowLayout, sink: ExportFile) -> Any:
        import pyarrow as pa

        options = pa.ipc.IpcWriteOptions(compression="lz4", emit_dictionary_deltas=True)
        return pa.ipc.new_file(sink, arrow.schema, options=options)

    def _put(self, writer: Any, arrow: ArrowLayout, block: Block) -> None:
        if not arrow.labels.names:
            arrow.labels.number("")  # Arrow takes what comes to an empty dictionary for another one
        writer.write_batch(arrow.batch(block))


class FeatherExport(ArrowExport):
    """The same under its other suffix."""

    format = "Feather"
    suffix = ".feather"
