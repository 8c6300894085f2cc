"""MCAP, as Foxglove and PlotJuggler open it: a channel of JSON messages for each message of a protocol.

1. Messages are in the order of the capture, piece by piece: readers need no sorting.
2. Topics, schemas and objects are those of `topics`, which a live view has, too.

`log_time` is ns since 1970, or as the recording counts; a message without time has the time of the latest one that has one.

Chunks are packed where zstandard is installed (extra `[mcap]`).
"""

from __future__ import annotations

from collections.abc import Sequence

from aces_bus.errors import CallerError
from aces_bus.export.base import Dataset, Export, Options
from aces_bus.export.files import telling
from aces_bus.protocol import Variant
from aces_bus.protocol.columns.table import MessageTable

from .mcap_file import McapWriter
from .topics import TableTopics

#: Messages of a chunk: about a megabyte.
CHUNK_MESSAGES = 8192


class McapExport(Export):
    """`walk.mcap`."""

    format = "MCAP"
    suffix = ".mcap"

    def __init__(self, path: str, options: Options, variants: Sequence[Variant]) -> None:
        super().__init__(path, options, variants)
        try:
            with telling(path):
                self._file = McapWriter(self.place)
        except CallerError:
            self.abandon()
            raise
        self._topics = TableTopics(self, self._file)

    @property
    def notes(self) -> list[str]:
        """Values that could not be written unchanged."""
        untimed = self._topics.untimed
        if not untimed:
            return []
        return [f"{untimed} messages have no time; in the MCAP they have the time of the one before"]

    def _begin(self, dataset: Dataset) -> None:
        self._topics.begin(dataset)

    def _write(
        self, tables: Sequence[MessageTable], source: str | None, columns: dict[str, list[str]]
    ) -> None:
        messages = self._topics.messages(tables, source, columns)
        for start in range(0, len(messages), CHUNK_MESSAGES):
            self._file.chunk(messages[start : start + CHUNK_MESSAGES])

    def _commit(self) -> None:
        """Do nothing: each chunk is with the system already."""

    def _finish(self) -> None:
        self._file.close()

    def _drop(self) -> None:
        if (file := getattr(self, "_file", None)) is not None:
            file.abandon()
