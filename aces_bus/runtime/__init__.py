"""Clocks and what runs on them."""

from __future__ import annotations

from .clock import Clock, RealClock, Timer, VirtualClock

__all__ = ["Clock", "RealClock", "Timer", "VirtualClock"]
