"""Which decoded messages say that a recording is a protocol's: those whose values can be, and that have any.

1. A frame that decodes to bytes alone (a CANopen PDO) says nothing but that its identifier is taken.
2. Float32 of what devices measure have few of all exponents; numbers keep to their declared range, and codes of a byte to
   their names. Random bytes do not.
3. Where packets have a check, or a transport puts them together, nothing of this is asked: that says more.
"""

from __future__ import annotations

from aces_bus._lazy import np
from aces_bus.protocol import Message, Variant
from aces_bus.protocol.columns.table import Array, Column, MessageTable
from aces_bus.protocol.plan.nodes import NodePath

#: Exponents of float32 that measured quantities have, and the least and greatest size that they stand for.
EXPONENTS = (97, 161)
SMALLEST, LARGEST = (2.0 ** (exponent - 127) for exponent in EXPONENTS)
#: An enumeration with greater numbers is a list of codes that others add to.
MOST_NAMED = 0xFF


def plausible(table: MessageTable, variant: Variant) -> Array:
    """Return which rows of decoded messages speak for the protocol; bool (n,)."""
    rows: Array = np.ones(len(table), bool)
    message = variant.messages[table.message]
    has_check = message.framing is not None and message.framing.check is not None
    if not len(table) or has_check or table.frames is not None:
        return rows
    if is_opaque(message):
        return ~rows
    for leaf in message.plan.columns:
        if leaf.path in table and not leaf.node.is_captured:
            rows &= _can_be(leaf, table[leaf.path])
    return rows


def is_opaque(message: Message) -> bool:
    """Return whether a message of a single frame has nothing but bytes that its protocol does not know."""
    plan = message.plan
    if message.transport is not None or plan.constants or plan.one_of or plan.is_checked:
        return False
    nodes = [leaf.node for leaf in plan.columns]
    content = [node for node in nodes if not node.is_captured or node.number_place]
    return bool(content) and all(node.holds == "bytes" for node in content)


def is_tested(message: Message) -> bool:
    """Return whether not all bytes are such a message: it has constants, a check, a transport, floats, ranges or codes."""
    plan = message.plan
    if message.transport is not None or plan.constants or plan.one_of or plan.is_checked:
        return True
    nodes = [leaf.node for leaf in plan.columns if not leaf.node.is_captured]
    return any(
        (node.is_float and node.is_number)
        or (node.scale is not None and node.scale.limits is not None)
        or (node.raw_range is not None and node.raw_range[1] <= MOST_NAMED and node.enumerated)
        for node in nodes
    )


def _can_be(leaf: NodePath, column: Column) -> Array:
    """Return which values of a field can be; those that are absent can."""
    node, values = leaf.node, column.values
    good: Array = np.ones(len(values), bool)
    if values.dtype.kind not in "iuf":
        return good
    scale, ends = node.scale, node.raw_range
    if node.is_float and node.is_number:
        size = np.abs(values)
        good = (size == 0) | (size >= SMALLEST) & (size < LARGEST)
    elif scale is not None and scale.limits is not None:
        low, high = scale.limits
        slack = abs(scale.scale) * 1e-6 + 1e-9 * max(abs(low), abs(high))
        good = ~((values < low - slack) | (values > high + slack))
    elif ends is not None and ends[1] <= MOST_NAMED and node.enumerated:
        good = np.isin(values, list(node.value_names))
    return good if column.absent is None else good | column.absent
