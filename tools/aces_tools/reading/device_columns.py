"""Which columns of a message say whose it is: a board's number, a servo's id."""

from __future__ import annotations

from aces_bus.protocol.plan import nodes as p

#: Names of top-level integers that say whose values a message carries.
DEVICE_NAMES = frozenset(
    {"address", "board", "device", "id", "joint", "motor", "node", "sender", "servo", "slave", "source"}
)


def is_device_column(leaf: p.NodePath) -> bool:
    """Return whether a column is captured from the identifier, or an integer of the payload that is named like a device."""
    node = leaf.node
    is_unsigned = node.is_number and node.raw_range is not None and node.raw_range[0] >= 0
    return node.is_captured or (len(leaf.way) == 1 and leaf.path in DEVICE_NAMES and is_unsigned)
