"""A message's own check, over many rows at once."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..declare.checks import Check, Extra, IdBytes, Sum
from ..declare.message import Message
from .table import Array


def can_compute(check: Check) -> bool:
    """Whether `numbers` knows this check."""
    return check.bytes <= 4 and check.text is None


def check_holds(message: Message, data: Array, lengths: Array, keys: Array) -> Array:
    """Which rows carry the number that their check gives; rows too short for it do not."""
    check = message.check
    assert check is not None
    start, size, order = message.check_span
    good = np.zeros(len(data), bool)
    for length in np.unique(lengths).tolist():
        if length < start + size:
            continue
        some = np.flatnonzero(lengths == length)
        rows = data[some, :length]
        stored = _number(rows[:, start : start + size], order)
        good[some] = stored == check_numbers(check, _covered(message, rows, keys[some], start, size))
    return good


def _number(cells: Array, order: str) -> Array:
    out = np.zeros(len(cells), np.int64)
    for index in range(cells.shape[1]):
        shift = 8 * (index if order == "little" else cells.shape[1] - 1 - index)
        out |= cells[:, index].astype(np.int64) << shift
    return out


def _covered(message: Message, rows: Array, keys: Array, start: int, size: int) -> Array:
    """What the check covers, uint8 (n, k), as `Message.covered` gives it."""
    check = message.check
    assert check is not None
    if check.over is None:
        return np.concatenate([rows[:, :start], rows[:, start + size :]], axis=1)
    parts: list[Array] = []
    for part in check.over:
        if isinstance(part, slice):
            parts.append(rows[:, part])
        elif isinstance(part, IdBytes):
            number = keys.astype(np.int64) & 0x1FFF_FFFF & part.mask
            places = range(part.size) if part.order == "little" else reversed(range(part.size))
            parts.append(
                np.stack([(number >> 8 * place & 0xFF).astype(np.uint8) for place in places], axis=1)
            )
        else:
            constant = message.check_extra if isinstance(part, Extra) else part
            row = np.frombuffer(constant, np.uint8)
            parts.append(np.broadcast_to(row, (len(rows), len(row))))
    return np.concatenate(parts, axis=1)


def check_numbers(check: Check, covered: Array) -> Array:
    """The check's number of each row of `covered`, int64."""
    if check.kind == "xor":
        out: Array = np.bitwise_xor.reduce(covered, axis=1, dtype=np.uint8).astype(np.int64)
        return out
    if check.kind == "sum":
        assert isinstance(check, Sum)
        total: Array = covered.sum(axis=1, dtype=np.int64)
        return np.bitwise_and(~total if check.inverted else total, check.mask)
    if check.kind == "fletcher":
        first = covered.sum(axis=1, dtype=np.int64)
        weights: Any = np.arange(covered.shape[1], 0, -1, dtype=np.int64)
        second: Array = covered @ weights & 0xFF
        both: Array = np.bitwise_or(first & 0xFF, second << 8)
        return both
    engine = check.engine
    return np.fromiter((engine(row.tobytes()) for row in covered), np.int64, len(covered))
