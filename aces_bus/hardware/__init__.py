"""The hardware floor: one bus, its words, its time. Nothing here knows a protocol."""

from __future__ import annotations

from .frame_time import FrameBits, frame_bits

__all__ = ["FrameBits", "frame_bits"]
