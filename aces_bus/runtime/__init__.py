"""Clocks and what runs on them."""

from __future__ import annotations

from .clock import Clock, RealClock, Timer, VirtualClock
from .loop import EventClock, Loop

__all__ = ["Clock", "EventClock", "Loop", "RealClock", "Timer", "VirtualClock"]
