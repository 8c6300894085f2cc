"""Tables of which each holds some of the rows become one, in the order of the recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..frame_table import FrameTable, Ints, widened


def merge_in_order(total: int, places: Sequence[Ints], parts: Sequence[FrameTable]) -> FrameTable:
    """The rows of `parts`, which stand at `places` (each going up, none twice) among `total`, as one table.

    Places without a row are closed up.
    """
    if len(parts) == 1:
        return parts[0]
    count = sum(map(len, parts))
    if count < total:
        taken = np.zeros(total, np.int64)
        for here in places:
            taken[here] = 1
        row = np.cumsum(taken) - 1
        places = [row[here] for here in places]
    width = max(part.data.shape[1] for part in parts)

    def column(of: Callable[[FrameTable], Ints]) -> Ints:
        out: Ints = np.empty(count, of(parts[0]).dtype)
        for here, part in zip(places, parts, strict=True):
            out[here] = of(part)
        return out

    item = np.dtype("<u8" if width == 8 else (np.void, width))  # whole rows are moved faster than their bytes
    return FrameTable(
        column(lambda part: part.time),
        column(lambda part: part.channel),
        column(lambda part: part.id),
        column(lambda part: part.flags),
        column(lambda part: part.length),
        column(lambda part: widened(part.data, width).view(item)[:, 0]).view(np.uint8).reshape(count, width),
        parts[0].channels,
    )
