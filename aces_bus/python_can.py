"""Frames as python-can's messages, for its buses."""

from __future__ import annotations

from can import Message

from .frames import Frame


def frame_to_message(
    frame: Frame, seconds: float = 0.0, channel: str | None = None, *, is_rx: bool = True
) -> Message:
    """Return the python-can message of a frame: `bus.send(frame_to_message(protocol.encode(…)))`."""
    return copy_message(frame, frame.length, seconds, channel, is_rx)


def copy_message(
    frame: Frame | Message, dlc: int, seconds: float, channel: str | None, is_rx: bool
) -> Message:
    """Return a message with what a frame or another message carries, without the constructor, which costs more than
    the rest.
    """
    made = Message.__new__(Message)
    made.timestamp = seconds
    made.arbitration_id = frame.arbitration_id
    made.is_extended_id = frame.is_extended_id
    made.is_remote_frame = frame.is_remote_frame
    made.is_error_frame = frame.is_error_frame
    made.channel = channel
    made.dlc = dlc
    made.data = bytearray(frame.data)
    made.is_fd = frame.is_fd
    made.is_rx = is_rx
    made.bitrate_switch = frame.bitrate_switch
    made.error_state_indicator = frame.error_state_indicator
    return made
