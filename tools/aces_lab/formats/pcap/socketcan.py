"""Linux CAN frames as they are in packets: many at once, from a buffer into columns.

1. No I/O in this file. Whatever the bytes are, nothing is read behind a packet's end, and nothing raises.
2. Every packet gets one status: a frame, readable but no CAN frame, or unreadable with its reason. No other byte order
   than the link type's is tried: where one would be right, the reader says so.

A packet of link type 227 begins with the frame itself, its identifier in network byte order. A packet of Linux' "cooked"
capture (113, and 276 with the number of the interface), which Wireshark's `any` interface makes, has a header that says
which way the packet went and what follows; the identifier is then in the byte order of the machine that recorded.

    0 identifier with the flags 29-bit, remote, error | 4 length | 5 FD flags | 6, 7 unused or a raw length code | 8 data

*Facts*: the LINKTYPE pages of tcpdump.org; include/uapi/linux/can.h; cooked byte order: pcap-common.c of libpcap.
*Choice*: before the FDF flag existed a CAN FD frame was recognised by its 72 bytes, or by its protocol number; both still
count. The raw length code of an 8-byte frame is not kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aces_bus.frame_table import FrameFlag, Ints
from aces_bus.frames import FD_LENGTHS

SOCKETCAN, COOKED, COOKED2 = 227, 113, 276
LINK_TYPES = (SOCKETCAN, COOKED, COOKED2)
#: Where in a packet the CAN frame begins.
FRAME_AT = {SOCKETCAN: 0, COOKED: 16, COOKED2: 20}

EXTENDED_BIT, REMOTE_BIT, ERROR_BIT = 1 << 31, 1 << 30, 1 << 29
FDF, ESI, BRS = 4, 2, 1
CLASSIC_SIZE, FD_SIZE = 16, 72
#: Zero bytes that must follow a buffer's packets.
PADDING = 96

_PROTOCOL_CAN, _PROTOCOL_FD, _PROTOCOL_XL = 0x0C, 0x0D, 0x0E
_XL_FLAG = 0x80
_SENT_BY_US = 4

# A packet's status: 0 a frame, the next two readable but no CAN frame, the others unreadable.
GOOD, IS_XL, IS_NO_CAN = 0, 1, 2
REASONS = {
    3: "shorter than the header of a CAN frame",
    4: "the data are cut short",
    5: "a classic frame of more than 8 bytes",
    6: "a length that CAN FD does not have",
    7: "an 11-bit identifier above 0x7FF",
    8: "a remote frame in CAN FD",
}
_SHORT, _CUT, _LONG, _NO_FD_LENGTH, WIDE, _REMOTE_FD = REASONS

_IS_FD_LENGTH = np.zeros(256, bool)
_IS_FD_LENGTH[list(FD_LENGTHS)] = True


class Packets(NamedTuple):
    """Columns of n packets, meaningful where `status` is `GOOD`; `interface` is −1 where the packet does not say."""

    status: Ints
    id: Ints
    flags: Ints
    length: Ints
    data: Ints
    interface: Ints
    protocol: Ints


def gather_rows(view: Ints, starts: Ints, width: int) -> Ints:
    """Return uint8 of shape (n, width): the bytes at each start. Equal distances need no gathering."""
    n = len(starts)
    if n > 1:
        stride = int(starts[1] - starts[0])
        if stride > 0 and not np.any(np.diff(starts) != stride):
            first = view[int(starts[0]) :]
            return np.lib.stride_tricks.as_strided(first, (n, width), (stride, 1), writeable=False)
    return view[starts[:, None] + np.arange(width)]


def big(rows: Ints, column: int, size: int) -> Ints:
    """Return int64: big-endian numbers at a column of byte rows."""
    return np.ascontiguousarray(rows[:, column : column + size]).view(f">u{size}")[:, 0].astype(np.int64)


def decode_socketcan(view: Ints, starts: Ints, sizes: Ints, links: Ints, is_little: bool) -> Packets:
    """Return the frames in packets of `sizes` bytes at `starts`, of link types `links` (each one of `LINK_TYPES`).

    `view` has `PADDING` bytes behind the last packet. `is_little` is the byte order of the recording machine.
    """
    n = len(starts)
    status = np.zeros(n, np.uint8)
    interface = np.full(n, -1, np.int64)
    protocol = np.zeros(n, np.int64)
    flags = np.zeros(n, np.uint8)
    is_cooked = links != SOCKETCAN
    if is_cooked.any():
        starts, sizes = starts.copy(), sizes.copy()
        for link, header in ((COOKED, FRAME_AT[COOKED]), (COOKED2, FRAME_AT[COOKED2])):
            rows = np.flatnonzero(links == link)
            status[rows[sizes[rows] < header]] = _SHORT
            rows = rows[sizes[rows] >= header]
            if not len(rows):
                continue
            head = gather_rows(view, starts[rows], header)
            if link == COOKED:
                kind, protocol[rows] = big(head, 0, 2), big(head, 14, 2)
            else:
                kind, protocol[rows] = head[:, 10], big(head, 0, 2)
                interface[rows] = big(head, 4, 4)
            flags[rows] = np.where(kind == _SENT_BY_US, FrameFlag.TX, FrameFlag.RX)
            starts[rows] += header
            sizes[rows] -= header
        status[(status == GOOD) & is_cooked & (protocol == _PROTOCOL_XL)] = IS_XL
        no_can = ~np.isin(protocol, (_PROTOCOL_CAN, _PROTOCOL_FD, _PROTOCOL_XL))
        status[(status == GOOD) & is_cooked & no_can] = IS_NO_CAN

    head = np.array(gather_rows(view, starts, 8))
    number = big(head, 0, 4)
    if is_little and is_cooked.any():
        number = np.where(is_cooked, head[:, :4].copy().view("<u4")[:, 0], number)
    length, marks = head[:, 4], head[:, 5]

    status[(status == GOOD) & (sizes < 8)] = _SHORT
    status[(status == GOOD) & ~is_cooked & (length & _XL_FLAG != 0)] = IS_XL
    is_error = number & ERROR_BIT != 0
    is_remote = (number & REMOTE_BIT != 0) & ~is_error
    is_extended = (number & EXTENDED_BIT != 0) & ~is_error
    is_fd = (marks & FDF != 0) | (sizes == FD_SIZE) | (length > 8) | (protocol == _PROTOCOL_FD)
    number &= 0x1FFF_FFFF
    is_cut = ~is_remote & (length.astype(np.int64) > sizes - 8)
    for wrong, code in (
        (is_fd & ~_IS_FD_LENGTH[length], _NO_FD_LENGTH),
        (is_remote & is_fd & (length <= 8), _REMOTE_FD),
        (is_remote & (length > 8), _LONG),
        (is_cut, _CUT),
        (~is_extended & ~is_error & (number > 0x7FF), WIDE),
    ):
        if wrong.any():
            status[(status == GOOD) & wrong] = code

    flags |= (
        is_extended * np.uint8(FrameFlag.EXTENDED)
        | is_remote * np.uint8(FrameFlag.REMOTE)
        | is_error * np.uint8(FrameFlag.ERROR)
    )
    if is_fd.any():
        flags[is_fd] |= FrameFlag.FD
        flags[is_fd & (marks & BRS != 0)] |= FrameFlag.BITRATE_SWITCH
        flags[is_fd & (marks & ESI != 0)] |= FrameFlag.ERROR_STATE
    carried = np.where(is_remote | (status != GOOD), 0, length)
    width = 64 if carried.max(initial=0) > 8 else 8
    data = np.array(gather_rows(view, starts + 8, width))
    if (carried < width).any():
        data[np.arange(width) >= carried[:, None]] = 0
    return Packets(status, number.astype(np.uint32), flags, length.copy(), data, interface, protocol)
