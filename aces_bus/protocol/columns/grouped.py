"""Frames of a transport, session behind session: one stable sort a table, behind which frames of a packet are side by side.

1. In a session frames stay in the order of the capture.
2. A column is brought into this order when something asks for it; one that is the same throughout is not moved at all.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ...frame_table import FrameFlag, FrameTable, rows_at
from ...frames import FD
from .table import Array


class GroupedFrames:
    """Frames of a table in the order of their sessions: `order` are their places in the table, `session` their sessions."""

    def __init__(self, table: FrameTable, order: Array, session: Array) -> None:
        self.table, self.order, self.session = table, order, session

    @classmethod
    def of(cls, table: FrameTable, session: Array) -> GroupedFrames:
        """Return all frames of a table, whose sessions are these."""
        order = np.argsort(session, kind="stable")
        return cls(table, order, session.take(order))

    def __len__(self) -> int:
        return len(self.order)

    @cached_property
    def data(self) -> Array:
        """Their bytes, uint8 (n, width), contiguous."""
        return np.ascontiguousarray(rows_at(self.table.data, self.order))

    @cached_property
    def length(self) -> Array:
        """Length of each frame in bytes, uint8 (n,)."""
        length = self.table.length
        if (length == length[0]).all():
            return np.full(len(self), length[0], length.dtype)
        return length.take(self.order)

    @cached_property
    def keys(self) -> Array:
        """Their keys without the flag of CAN FD, uint32 (n,)."""
        return bare_keys(self.table).take(self.order)

    @property
    def channel(self) -> Array:
        """The numbers of their channels."""
        return self.table.channel.take(self.order)

    def keys_of(self, which: Array) -> Array:
        """Return the keys of some."""
        return bare_keys(self.table).take(self.order.take(which))

    def take(self, which: Array) -> GroupedFrames:
        """Return some of the frames, in rising order."""
        return GroupedFrames(self.table, self.order[which], self.session[which])


def bare_keys(table: FrameTable) -> Array:
    """Return the keys of frames without the flag of CAN FD."""
    if not len(table.flags) or not int(np.bitwise_or.reduce(table.flags)) & FrameFlag.FD:
        return table.key
    keys: Array = table.key & np.uint32(~FD & 0xFFFF_FFFF)
    return keys
