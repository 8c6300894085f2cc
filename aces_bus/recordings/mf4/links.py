"""Whether the blocks of an MDF 4 file hang together as a tree.

1. Every block is looked at once at most, so that this ends on any file; nothing but block heads is read.
2. What is not a block is left alone: the one who reads the file for good says so.

A program that follows links, as asammdf does, never comes back from blocks that are linked in circles, and a list that names
one packed block a million times is a bomb. In a file that was written for reading, no group, channel or data block has
two places.
"""

from __future__ import annotations

import struct
from typing import BinaryIO

_HEAD = struct.Struct("<4sIQQ")
_HEADER_AT = 64

#: Which links of a block lead on to what has one place only: by number, None for all.
_LINKS: dict[bytes, tuple[int, ...] | None] = {
    b"##HD": (0, 1, 2, 3, 4),
    b"##FH": (0,),
    b"##AT": (0,),
    b"##EV": (0,),
    b"##CH": (0, 1),
    b"##DG": (0, 1, 2),
    b"##CG": (0, 1),
    b"##CN": (0, 1, 5),
    b"##HL": None,
    b"##DL": None,
    b"##LD": None,
    b"##DT": (),
    b"##DZ": (),
    b"##SD": (),
    b"##DV": (),
    b"##DI": (),
}
#: A channel's data may be a channel group's or an attachment, which has its own place.
_SIGNAL_DATA = (b"##HL", b"##DL", b"##LD", b"##SD", b"##DZ")


def is_tree(file: BinaryIO) -> bool:
    """Whether each group, channel and data block that can be reached from the header is reached once."""
    seen: set[int] = set()
    ahead: list[tuple[int, bool]] = [(_HEADER_AT, False)]
    while ahead:
        at, is_signal = ahead.pop()
        file.seek(at)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            continue
        name, _, size, count = _HEAD.unpack(head)
        wanted = _LINKS.get(name, ())
        if name not in _LINKS or (is_signal and name not in _SIGNAL_DATA):
            continue
        if at in seen:
            return False
        seen.add(at)
        count = min(count, size // 8)
        if wanted is not None:
            count = min(count, max(wanted, default=-1) + 1)
        raw = file.read(8 * count)
        links = struct.unpack(f"<{len(raw) // 8}Q", raw[: len(raw) // 8 * 8])
        for number in range(len(links)) if wanted is None else wanted:
            if number < len(links) and links[number] and links[number] < 1 << 63:
                ahead.append((links[number], name == b"##CN" and number == 5))
    return True
