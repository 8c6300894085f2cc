"""Filters on whole tables of frames.

1. A frame passes here when it passes `CanFilter.matches`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..frame_table import ERROR, EXTENDED, REMOTE, FrameTable
from .filters import EFF, ERR, RTR, CanFilter

Mask = npt.NDArray[np.bool_]


def passing(wanted: CanFilter, table: FrameTable) -> Mask:
    """Which of the frames pass, as a boolean array.

    >>> from aces_bus.frames import Frame
    >>> from aces_bus.recordings import parse_filter
    >>> frames = FrameTable.from_frames([Frame(id) for id in (0x05F, 0x060, 0x06F, 0x070)])
    >>> passing(parse_filter("060:7F0"), frames).tolist()
    [False, True, True, False]
    """
    is_error = table.flags & ERROR != 0
    word = table.id.astype(np.uint32)
    word |= (table.flags & EXTENDED != 0) * np.uint32(EFF)
    word |= (table.flags & REMOTE != 0) * np.uint32(RTR)
    passed = np.zeros(len(table), np.bool_)
    for one in wanted.sets:
        data = np.full(len(table), not one.rules or one.join)
        for rule_id, mask, inverted in one.rules:
            hit = (word & np.uint32(mask) == np.uint32(rule_id)) != inverted
            data = data & hit if one.join else data | hit
        if one.error_mask is None:
            errors = np.full(len(table), not one.rules)
        else:
            errors = (table.id | np.uint32(ERR)) & np.uint32(one.error_mask) != 0
        found = np.where(is_error, errors, data)
        if one.interface is not None:
            is_there = np.array([str(name) == one.interface for name in table.channels.names], np.bool_)
            found &= is_there[table.channel]
        passed |= found
    return passed
