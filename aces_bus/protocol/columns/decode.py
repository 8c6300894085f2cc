"""A whole capture as columns: tables by message.

1. Everything is in memory: a capture that does not fit is decoded piece by piece (`make_column_scanner`), or into a file
   (`aces decode -o`, `aces_bus.export`).
2. Nothing here opens anything: a capture is whatever gives frame tables, frames, chunks or bytes.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator
from inspect import signature
from typing import Any

from ...errors import CallerError, UnknownNameError
from ...frame_table import Channels, FrameTable
from ..counts import ScanCounts, sum_counts
from ..declare.message import GivenWay, Way, way_of
from ..declare.protocol import Variant
from .scanner import ColumnScanner, RecordColumns, make_column_scanner
from .table import MessageTable

#: Frames that are put into a table at once where a capture gives them one by one.
PIECE = 16_384


def decode_tables(
    variant: Variant,
    capture: Any,
    *,
    message: str | Iterable[str] | None = None,
    direction: GivenWay | None = None,
    include_unknown: bool = False,
    raw: bool = False,
) -> tuple[dict[str, MessageTable], ScanCounts]:
    """Return the tables of all messages of a capture, and where its frames or bytes went.

    The capture is one of `aces_bus.recordings`, or an iterable of frame tables, frames (also of python-can), chunks or
    bytes; bytes may also be given as they are. The other arguments are those of `aces_bus.decode`.

    Raises `UnknownNameError` for a message that the protocol does not have, `CallerError` where bytes alone do not tell
    the messages apart and no direction is given, `CaptureError` where reading stops.
    """
    wanted = None if message is None else {message} if isinstance(message, str) else set(message)
    given = way_of(direction)
    for name in wanted or ():
        if name not in variant.messages:
            raise UnknownNameError(f"message of {variant.label}", name, variant.messages)
    parts: dict[str, list[MessageTable]] = {}
    scanners: dict[Hashable, ColumnScanner] = {}

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
    return tables, sum_counts(scanner.counts for scanner in scanners.values())


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
            f"{type(capture).__name__} is no recording: decode takes a path or several, what open_recording returns, frames,"
            " or bytes"
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
