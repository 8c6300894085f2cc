"""A whole capture as columns: a mapping from messages to tables.

1. Everything is in memory: a capture that does not fit is decoded piece by piece (`make_column_scanner`), or into a file
   (`aces decode -o`, `aces_bus.export`).
2. Nothing here opens anything: a capture is whatever gives frame tables, frames, chunks or bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from inspect import signature
from typing import TYPE_CHECKING, Any

from ...errors import CallerError, UnknownNameError
from ...frame_table import Channels, FrameTable
from ..counts import ScanCounts, sum_counts
from ..declare.message import GivenWay, Way, way_of
from ..declare.protocol import Variant
from .arrow import to_arrow, to_pandas, to_polars
from .layout import Holds, Objects, empty_table
from .scanner import ColumnScanner, RecordColumns, make_column_scanner
from .table import MessageTable

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow

#: Frames that are put into a table at once where a capture gives them one by one.
PIECE = 16_384


class DecodedRecording(Mapping[str, MessageTable]):
    """Messages by name, each the table of the whole capture; messages that did not occur are not among the keys.

        decoded = hubo.decode(capture)
        decoded["Encoder"]["position.0"].values     # an array, in the sheet's unit
        decoded.to_pandas("Encoder")
        decoded.counts                              # where every frame or byte went
        decoded.capture.lines_unreadable            # of `aces_bus.decode(path, …)`; also .problems, .others

    The table named "" is what was not decoded, where that was asked for (`include_unknown`).
    """

    def __init__(self, variant: Variant, tables: Mapping[str, MessageTable], counts: ScanCounts) -> None:
        self.variant = variant
        self.counts = counts
        #: The recording, read and closed, where it was opened here: what of it could not be read is counted there.
        self.capture: Any = None
        self._tables = dict(tables)
        self._objects = Objects([variant])

    def __getitem__(self, message: str) -> MessageTable:
        """Return the table of a message, without rows when it did not occur; raises `UnknownNameError`."""
        if message in self._tables:
            return self._tables[message]
        if message not in self.variant.messages:
            raise UnknownNameError(f"message of {self.variant.label}", str(message), self.variant.messages)
        return empty_table(self.variant, message)

    def __contains__(self, message: object) -> bool:
        return message in self._tables

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)

    def __repr__(self) -> str:
        rows = ", ".join(f"{name or 'not decoded'}: {len(table)}" for name, table in self._tables.items())
        return f"<{self.variant.label}: {rows}>"

    def to_arrow(self, message: str, *, names: bool = False, float32: bool = False) -> pyarrow.Table:
        """Return a message's table as a `pyarrow.Table`; see `aces_bus.export.to_arrow`."""
        table = self[message]
        return to_arrow(table, names=names, float32=float32, objects=self._of(table))

    def to_pandas(self, message: str, *, names: bool = False, float32: bool = False) -> pandas.DataFrame:
        """Return a message's table as a `pandas.DataFrame`; see `aces_bus.export.to_pandas`."""
        return to_pandas(self[message], names=names, float32=float32)

    def to_polars(self, message: str, *, names: bool = False, float32: bool = False) -> polars.DataFrame:
        """Return a message's table as a `polars.DataFrame`; see `aces_bus.export.to_polars`."""
        table = self[message]
        return to_polars(table, names=names, float32=float32, objects=self._of(table))

    def _of(self, table: MessageTable) -> dict[str, Holds]:
        return self._objects.of(table)


def decode_tables(
    variant: Variant,
    capture: Any,
    *,
    message: str | Iterable[str] | None = None,
    direction: GivenWay | None = None,
    include_unknown: bool = False,
    raw: bool = False,
) -> DecodedRecording:
    """Return all messages of a capture, which is one of `aces_bus.recordings`, or an iterable of frame tables, frames
    (also of python-can), chunks or bytes; bytes may also be given as they are.

    `message` limits what is kept to one or several messages; the counts stay those of the whole. `direction` is that of
    a stream which does not say it: "to device" ("to"), "from device" ("from") or "both". With `include_unknown`, what was
    not decoded is the table named "". `raw` leaves out units, scales and names.

    Raises `UnknownNameError` for a message that the protocol does not have, `CallerError` where bytes alone do not tell
    the messages apart and no direction is given, `CaptureError` where reading stops.
    """
    wanted = None if message is None else {message} if isinstance(message, str) else set(message)
    given = way_of(direction)
    for name in wanted or ():
        if name not in variant.messages:
            raise UnknownNameError(f"message of {variant.label}", name, variant.messages)
    parts: dict[str, list[MessageTable]] = {}
    scanners: dict[Any, ColumnScanner] = {}

    def keep(tables: Iterable[MessageTable]) -> None:
        for table in tables:
            if len(table) and (wanted is None or table.message in wanted or not table.message):
                parts.setdefault(table.message, []).append(table)

    for traffic, way, time in capture_pieces(capture, variant):
        way = given or way
        if way not in scanners:
            scanners[way] = make_column_scanner(
                [variant], direction=way, include_unknown=include_unknown, raw=raw
            )
        keep(feed(scanners[way], traffic, time))
    for scanner in scanners.values():
        keep(scanner.close())
    if not scanners:
        make_column_scanner(
            [variant], direction=direction
        )  # an empty capture is decoded under the same rules
    # Declared order, whatever came first.
    order = {name: place for place, name in enumerate(variant.messages)}
    names = sorted(parts, key=lambda name: order.get(name, len(order)))
    tables = {name: MessageTable.concat(parts[name]) for name in names}
    return DecodedRecording(variant, tables, sum_counts(scanner.counts for scanner in scanners.values()))


def feed(scanner: ColumnScanner, traffic: Any, time: float | None) -> list[MessageTable]:
    """Call `scanner.feed`, with the time of a chunk of bytes if the capture has one and the scanner takes it."""
    if time is None:
        return scanner.feed(traffic)
    if isinstance(scanner, RecordColumns):
        live: Any = scanner.scanner
        return scanner.tables(live.feed(traffic, time), None)
    timed: Any = scanner.feed
    tables: list[MessageTable] = (
        timed(traffic, time) if len(signature(timed).parameters) > 1 else timed(traffic)
    )
    return tables


def capture_pieces(capture: Any, variant: Variant) -> Iterator[tuple[Any, Way | None, float | None]]:
    """Yield (data to feed, direction, time) of a capture; raises `CallerError` for a capture of another link."""
    is_can = variant.link == "can"
    link = getattr(capture, "link", None)
    if isinstance(link, str) and (link == "can") is not is_can:
        raise CallerError(
            f"{variant.name} is a protocol on {variant.link}, and this is a capture on {link};"
            " open the capture with the link of the protocol"
        )
    if isinstance(capture, (bytes, bytearray, memoryview)):
        yield bytes(capture), None, None
        return
    if isinstance(capture, FrameTable):
        capture = [capture]
    elif isinstance(capture, str) or not hasattr(capture, "__iter__"):
        raise CallerError(
            f"{type(capture).__name__} is not a capture: open it (aces_bus.recordings.open_recording), give frames or bytes,"
            " or call aces_bus.decode(path, protocol)"
        )
    if is_can:
        for table in _tables_of(capture.tables() if hasattr(capture, "tables") else capture, variant):
            yield table, None, None
        return
    for item in capture:
        if isinstance(item, (bytes, bytearray, memoryview)):
            yield bytes(item), None, None
        elif (
            hasattr(item, "data") and not isinstance(item, FrameTable) and not hasattr(item, "arbitration_id")
        ):
            yield item.data, getattr(item, "direction", None), getattr(item, "time", None)
        else:
            raise _not_decodable(item, variant)


def _tables_of(items: Iterable[Any], variant: Variant) -> Iterator[FrameTable]:
    """Yield tables and frames as tables; single frames are gathered, `PIECE` a table."""
    frames: list[Any] = []
    channels: Channels | None = None
    for item in items:
        if isinstance(item, FrameTable):
            yield item
        elif hasattr(item, "arbitration_id"):
            frames.append(item)
            if len(frames) >= PIECE:
                table = FrameTable.from_frames(frames, channels)
                channels, frames = table.channels, []
                yield table
        else:
            raise _not_decodable(item, variant)
    if frames:
        yield FrameTable.from_frames(frames, channels)


def _not_decodable(item: Any, variant: Variant) -> CallerError:
    return CallerError(f"{variant.name} ({variant.link}) cannot decode a {type(item).__name__}")
