"""One CAN frame, as a cheap frozen value.

1. The attribute names are python-can's, so that a scanner takes a `can.Message` and a `Frame` alike.
2. An impossible frame cannot be built.

A python-can message is mutable and costs 1.7 µs to make; captures of millions of frames want neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

import msgspec

from .errors import CallerError

if TYPE_CHECKING:
    import can

#: Flags above an identifier's 29 bits: together they are a frame's key, by which scanners look messages up. The key of a
#: standard data frame is its identifier.
FD, REMOTE, EXTENDED = 1 << 29, 1 << 30, 1 << 31


def key_of(identifier: int, *, extended: bool = False, remote: bool = False, fd: bool = False) -> int:
    """Return the key of a frame."""
    return identifier | (EXTENDED if extended else 0) | (REMOTE if remote else 0) | (FD if fd else 0)


#: Legal numbers of data bytes of a CAN FD frame (ISO 11898-1).
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_FD = frozenset(FD_LENGTHS)


class Frame(msgspec.Struct, frozen=True, gc=False):
    """A CAN frame.

    `timestamp` is in seconds, as the capture wrote it, or None. `is_rx` is True for a received frame, False for one that
    the recording host sent, None when the capture does not say. `dlc` is the length a remote frame asks for; for a data
    frame it is the number of bytes.

    Raises `CallerError` when identifier, length or flags cannot exist on a bus.
    """

    arbitration_id: int
    data: bytes = b""
    timestamp: float | None = None
    channel: str | None = None
    is_extended_id: bool = False
    is_remote_frame: bool = False
    is_error_frame: bool = False
    is_fd: bool = False
    bitrate_switch: bool = False
    error_state_indicator: bool = False
    is_rx: bool | None = None
    dlc: int | None = None

    def __post_init__(self) -> None:
        size = len(self.data)
        if size > 8 and (not self.is_fd or size not in _FD):
            kind = "CAN FD" if self.is_fd else "classic CAN"
            raise CallerError(f"a {kind} frame cannot carry {size} data bytes")
        limit = 0x1FFF_FFFF if self.is_extended_id or self.is_error_frame else 0x7FF
        if not 0 <= self.arbitration_id <= limit:
            raise CallerError(f"identifier {self.arbitration_id:#x} is outside 0…{limit:#x}")
        if self.is_remote_frame and (size or self.is_fd):
            raise CallerError("a remote frame carries no data and exists only in classic CAN")

    @property
    def length(self) -> int:
        """Number of data bytes; of a remote frame, the number it asks for."""
        return self.dlc if self.is_remote_frame and self.dlc is not None else len(self.data)


#: What scanners take for a frame: one of ours, or one of python-can; and what names its channel.
AnyFrame: TypeAlias = "Frame | can.Message"
ChannelName: TypeAlias = "str | int | Sequence[int] | None"


def message_to_frame(
    message: AnyFrame, timestamp: float | None = None, channel: str | None = None, is_rx: bool | None = None
) -> Frame:
    """Return the frame that a python-can message (or another frame) carries; time, channel and direction are the arguments.

    Raises `CallerError` for a message that cannot exist on a bus.
    """
    return Frame(
        message.arbitration_id,
        bytes(message.data),
        timestamp,
        channel,
        message.is_extended_id,
        message.is_remote_frame,
        message.is_error_frame,
        message.is_fd,
        message.bitrate_switch,
        message.error_state_indicator,
        is_rx,
        message.dlc if message.is_remote_frame else None,
    )
