"""A CAN frame's identifier and kind as one integer: the key that scanners look messages up by.

Bits 0–28 are the identifier; the flags stand above it, so that a standard data frame's key is its identifier.
"""

from __future__ import annotations

FD, REMOTE, EXTENDED = 1 << 29, 1 << 30, 1 << 31


def key_of(identifier: int, *, extended: bool = False, remote: bool = False, fd: bool = False) -> int:
    """Return the key of a frame."""
    return identifier | (EXTENDED if extended else 0) | (REMOTE if remote else 0) | (FD if fd else 0)
