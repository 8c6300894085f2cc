"""Rows of a capture as the images that `aces plot --bits` draws."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aces_bus import FrameTable
from aces_bus.errors import CallerError
from aces_bus.frame_table import Channels, FrameFlag
from aces_bus.frames import REMOTE
from aces_tools.plotting.bit_image import BitImages
from aces_tools.plotting.bits import BitPicture

from .capture import Columns, TrafficRow

#: Bytes of a packet that are drawn: those of the longest frame.
MOST_BYTES = 64


def add_columns(images: BitImages, row: TrafficRow, columns: Columns, number: int) -> None:
    """Add frames of a row to images, as those of identifier `number`."""
    count, width = len(columns), 8 if columns.data.shape[1] <= 8 else MOST_BYTES
    data = np.zeros((count, width), np.uint8)
    shown = columns.data[:, :width]
    data[:, : shown.shape[1]] = shown
    images.add(
        FrameTable(
            columns.times,
            np.zeros(count, np.uint16),
            np.full(count, number, np.uint32),
            np.full(count, FrameFlag.EXTENDED, np.uint8),
            np.minimum(columns.lengths, width).astype(np.uint8),
            data,
            Channels([None]),
        )
    )


def row_pictures(rows: Sequence[TrafficRow], title: str = "") -> BitPicture:
    """Return a picture of the bits of rows; raises `CallerError` where no row has bytes."""
    images = BitImages()
    labels: dict[int, str] = {}
    for number, row in enumerate(rows):
        is_remote = row.identifier.key >= 0 and row.identifier.key & REMOTE
        if row.data and not is_remote and not row.identifier.is_error:
            add_columns(images, row, row.columns(), number)
            labels[number] = row.label
    chosen = [
        (image, labels[identifier.number]) for identifier, image in images.images.items() if image.length
    ]
    if not chosen:
        raise CallerError("nothing to draw: no row that is shown has bytes")
    return BitPicture(images, [image for image, _ in chosen], title, labels=[label for _, label in chosen])
